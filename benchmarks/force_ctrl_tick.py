"""Processor time of one tick of the force controller's core, both tools, both loops on.

    ./isf python benchmarks/force_ctrl_tick.py [--ticks 20000] [--repeats 7]

Time is thread CPU time with the collector off. A virtual core that is taken away in mid-tick still shows in it, so the
same ticks are run several times, and the least time of every tick is what the code costs; "as run" is the plain 99th
percentile of all repeats. One tool is half a tick.
"""

from __future__ import annotations

import argparse
import gc
import math
import time

import numpy as np
from isf_core.contour import Contour, Process
from isf_core.errors import ErrorCode
from isf_force_ctrl import ControlConfig, ForceController, Mode

FORCE = 120.0
"""N, set-point of the ring, and what the tools are squeezed with wherever they are."""


def ring(points: int, radius: float = 60e-3, plan_id: str = "tick", index: int = 0, count: int = 1) -> Contour:
    """One ring of a 50 degree cone, 120 N; contour ``index`` of ``count``."""
    angle = 2 * np.pi * np.arange(points) / points
    out = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(points)])
    wall = np.radians(50.0)
    normal = -np.sin(wall) * out + [0.0, 0.0, np.cos(wall)]
    contact = radius * out + [0.0, 0.0, -5e-3]
    thickness = 1e-3 * np.cos(wall)
    return Contour(
        plan_id=plan_id,
        index=index,
        count=count,
        process=Process.DSIF,
        feed=0.03,
        contact=contact,
        normal=normal,
        wall_angle=np.full(points, wall),
        thickness=np.full(points, thickness),
        forming_tip=contact + 5e-3 * normal - [0.0, 0.0, 5e-3],
        support_tip=contact - (5e-3 + thickness) * normal + [0.0, 0.0, 5e-3],
        support_force=np.full(points, FORCE),
    )


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--ticks", type=int, default=20000)
    parser.add_argument("--repeats", type=int, default=7)
    arguments = parser.parse_args()
    config = ControlConfig(
        rate=500.0,
        park_height=0.03,
        travel=(0.125, 0.125, 0.11),
        speed_limit=0.1,
        force_limit=(1500.0, 1500.0, 2000.0),
        servo_bandwidth=30.0,
        contact_stiffness=0.45e6,
        forming_compliance=(1e-6, 1e-6),
        compensation=1.0,
        offset_limit=1.5e-3,
        drift_limit=1e4,  # the wrenches are those of contact, in the air too
        drift_stop=1e4,
    )
    noise = np.random.default_rng(0).normal(0.0, 1.2, (1000, 12)).tolist()
    gc.disable()
    spent = np.array([one_run(config, noise, arguments.ticks) for _ in range(arguments.repeats)]) * 1e-3
    least = spent.min(axis=0)
    print(
        "| ticks | repeats | median [us] | 99 % [us] | 99 % per tool [us] | as run, 99 % per tool [us] |\n"
        + "|---" * 6
        + "|"
    )
    print(
        f"| {arguments.ticks} | {arguments.repeats} | {np.median(least):.1f} | {np.percentile(least, 99):.1f} | "
        f"{np.percentile(least, 99) / 2:.1f} | {np.percentile(spent, 99) / 2:.1f} |"
    )


def one_run(config: ControlConfig, noise: list[list[float]], ticks: int) -> list[int]:
    """(ticks,) ns of every tick on the contour under force control; the same ticks every time."""
    controller = ForceController(config)
    spent: list[int] = []
    while len(spent) < ticks:
        controller.arm("tick", 0, 1, (0.0, 0.0, 0.03), (0.0, 0.0, -0.03))
        controller.start(ring(750))
        tick = 0
        while controller.busy and len(spent) < ticks:
            wrench_1, wrench_2 = squeezed(controller, noise[tick % len(noise)])
            start = time.thread_time_ns()
            controller.tick(tick, tick * 0.002, wrench_1, wrench_2)
            took = time.thread_time_ns() - start
            if controller.mode is Mode.CONTROL:
                spent.append(took)
            tick += 1
        controller.fail(ErrorCode.STOPPED, "measured")
        result = controller.take_result()
        if result is not None and result.code not in (ErrorCode.OK, ErrorCode.STOPPED):
            raise SystemExit(f"the ring was not formed: {result.message}")
    return spent


def squeezed(controller: ForceController, noise: list[float]) -> tuple[list[float], list[float]]:
    """Wrenches (6,) on both tools, N: the set-point along the normal, up to the ``noise`` (12,)."""
    tips = controller.targets
    x, y = tips.tip_2[0] - tips.tip_1[0], tips.tip_2[1] - tips.tip_1[1]
    share = FORCE / max(math.hypot(x, y), 1e-4)
    wrench_1, wrench_2 = noise[:6], noise[6:]
    wrench_1[0] -= share * x
    wrench_1[1] -= share * y
    wrench_2[0] += share * x
    wrench_2[1] += share * y
    return wrench_1, wrench_2


if __name__ == "__main__":
    main()
