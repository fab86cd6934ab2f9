"""What force control and compliance compensation do to the shape of a part: neither, each alone, both at once.

    ./isf python benchmarks/both_loops.py                            # ren_cone, ren_pyramid; uncorrected and elastic
    ./isf python benchmarks/both_loops.py --jobs mini_cone --corrections none --factors 0 0.5 1
    ./isf python benchmarks/both_loops.py --write                    # and put the table into
    docs/results/force_control.md

Three places where the loops show, because springback hides them in the finished part:

* *tool off its path*: the tip of the forming ball, deflection included (only a simulated machine knows it), against the
  corrected contour, in the plane and across the path; mean over the points of the contours under force control. This
  is what compensation is for, and what moves the wall while it is formed.
* *wall*, *base*, *opening*: of the finished part in the clamp against the CAD surface, along the surface normal.
* *contact*: true normal force of the support tool on the same contours.

Results are kept as those of force_control.py.
"""

from __future__ import annotations

import argparse
import hashlib
import json
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from force_control import CONTACT, JOBS, ROOT, job_text, measured, sources, write
from isf_analysis.measures.deviation import Deviation, compare
from isf_core.contour import Contour
from isf_core.files.job import JobFile
from isf_force_ctrl import ControlConfig, ForceController
from isf_force_ctrl.control_state import Mode
from isf_planner import plan
from isf_sim.machine.simulated_machine import MachineSample, SimulatedMachine
from isf_springback.corrector import apply
from isf_springback.methods import make_corrector
from numpy.typing import NDArray
from scipy.spatial import KDTree

HEADER = (
    "| job | springback correction | force control | compensation | tool off its path, mean [um] | 95 % [um] | "
    "wall, mean [mm] | wall, 95 % [mm] | base, mean [mm] | opening, mean [mm] | largest [mm] | normal force [N] | "
    "its standard deviation [N] | without contact [%] | axial force [N] | back-offs |\n" + "|---" * 16 + "|"
)
COLUMNS = (
    *(("path_mean", "+.0f"), ("path_95", ".0f"), ("wall", ".3f"), ("wall_95", ".3f"), ("base", "+.3f")),
    *(("mean", ".3f"), ("most", ".3f"), ("force", ".0f"), ("spread", ".1f"), ("free", ".1f"), ("axial", ".0f")),
    ("backoffs", ".0f"),
)
FINE = 0.05e-3
"""m, spacing of the points a path is compared with."""


@dataclass(frozen=True)
class Loops:
    """One part: set-point N (0: off), factor of the compensation, method of springback correction."""

    job: str
    correction: str
    force: float
    factor: float
    world: int = 0

    def key(self) -> str:
        """Name of its result: the case, the job and all sources it depends on."""
        own = (ROOT / "benchmarks" / "both_loops.py").read_bytes()
        text = json.dumps(asdict(self)) + job_text(self.job) + sources()
        return hashlib.sha256(own + text.encode()).hexdigest()


class Path:
    """A contour's path of the forming tip, for distances across it in the plane."""

    def __init__(self, contour: Contour) -> None:
        tips = np.asarray(contour.forming_tip)[:, :2]
        ends = np.vstack([tips, tips[:1]]) if contour.closed else tips
        along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(ends, axis=0).T))])
        self._places = np.arange(0.0, along[-1], FINE)
        self._points = np.column_stack([np.interp(self._places, along, ends[:, k]) for k in (0, 1)])
        step = np.roll(self._points, -1, axis=0) - self._points
        out = np.column_stack([step[:, 1], -step[:, 0]])
        inward = np.asarray(contour.normal)[np.clip(np.searchsorted(along, self._places), 0, len(tips) - 1), :2]
        out *= -np.sign((out * inward).sum(axis=1, keepdims=True))  # from the forming to the support side
        self._out = out / np.maximum(np.hypot(*out.T), 1e-12)[:, None]
        self._tree = KDTree(self._points)

    def across(self, tips: NDArray[np.float64]) -> NDArray[np.float64]:
        """Mean distance (M,) m of ``tips`` (T, 2) m to the outside, per mm of path that was met."""
        _, nearest = self._tree.query(tips)
        off = ((tips - self._points[nearest]) * self._out[nearest]).sum(axis=1)
        cell = (self._places[nearest] / 1e-3).astype(int)
        count = np.bincount(cell)
        return np.asarray(np.bincount(cell, off)[count > 0] / count[count > 0])


@dataclass
class Seen:
    """What is kept of the contours that the plan wants under force control."""

    off: list[NDArray[np.float64]]
    force: list[float]
    axial: list[float]


def form(case: Loops) -> tuple[Seen, Deviation, int, int]:
    """Form a part; what was seen, its deviation in the clamp, back-offs of the monitor, code."""
    old = "compliance_compensation: 1.0"
    text = job_text(case.job)
    assert old in text
    job_file = JobFile(text.replace(old, f"compliance_compensation: {case.factor}"), JOBS, case.job)
    part = plan(job_file)
    machine = SimulatedMachine(job_file, variant=case.world)
    machine.tare()
    compliance = np.array(job_file.rig.tool_1.compliance[:2]) * machine.variant.compliance
    method = make_corrector(case.correction, job_file)
    controller = ForceController(ControlConfig.from_job(job_file, support_force=case.force))
    sample = machine.sample()
    controller.arm(part.plan_id, 0, len(part.contours), sample.tip_1.tolist(), sample.tip_2.tolist())
    seen, backoffs, code = Seen([], [], []), 0, 0
    for nominal in part.contours:
        corrected = apply(nominal, method.correct(nominal))
        controller.start(corrected)
        tips: list[NDArray[np.float64]] = []
        while controller.busy:
            before = controller.targets
            targets = controller.tick(sample.tick, sample.time, sample.wrench_1.tolist(), sample.wrench_2.tolist())
            if nominal.force_controlled and controller.mode in (Mode.CONTROL, Mode.POSITION):
                tips.append(sample.tip_1[:2] + compliance * sample.true_force_1[:2])
                seen.force.append(_normal(before.tip_1, before.tip_2, sample))
                seen.axial.append(float(sample.true_force_1[2]))
            sample = machine.tick(targets.tip_1, targets.tip_2, targets.holder_height)
        result = controller.take_result()
        assert result is not None
        backoffs, code = backoffs + result.backoffs, code or result.code
        if not result.completed:
            break
        if tips:
            seen.off.append(Path(corrected).across(np.array(tips)))
        method.add_result(corrected, result)
    return seen, compare(machine.measured_shape(), part.target), backoffs, code


def _normal(tip_1: tuple[float, ...], tip_2: tuple[float, ...], sample: MachineSample) -> float:
    away = np.subtract(tip_2[:2], tip_1[:2])
    return float(away @ sample.true_force_2[:2]) / max(float(np.hypot(*away)), 1e-6)


def measure(case: Loops) -> dict[str, Any]:
    """Numbers of one part; lengths in mm, those of the path in um."""
    seen, found, backoffs, code = form(case)
    off, force = np.concatenate(seen.off), np.array(seen.force)
    wall, base = found.regions["wall"], found.regions["base"]
    error = np.abs(found.error.z[found.masks["wall"]])
    share = wall.mean_abs_normal / wall.mean_abs
    return {
        "code": code,
        "backoffs": backoffs,
        "path_mean": 1e6 * float(off.mean()),
        "path_95": 1e6 * float(np.percentile(np.abs(off), 95.0)),
        "wall": 1e3 * wall.mean_abs_normal,
        "wall_95": 1e3 * share * float(np.nanpercentile(error, 95.0)),
        "base": 1e3 * base.mean,
        "mean": 1e3 * found.whole.mean_abs_normal,
        "most": 1e3 * found.whole.max_abs_normal,
        "force": float(force.mean()),
        "spread": float(force.std()),
        "free": 100.0 * float((force < CONTACT).mean()),
        "axial": float(np.mean(seen.axial)),
    }


def row(case: Loops, data: dict[str, Any]) -> str:
    """One line of the table."""
    failed = f" (ended with {data['code']})" if data["code"] else ""
    force = f"{case.force:.0f} N" if case.force else "off"
    numbers = " | ".join(format(data[name], form) for name, form in COLUMNS)
    return f"| {case.job}{failed} | {case.correction} | {force} | {case.factor:g} | {numbers} |"


def main() -> None:
    """Form all parts and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--jobs", nargs="+", default=("ren_cone", "ren_pyramid"))
    parser.add_argument("--corrections", nargs="+", default=("none", "elastic"))
    parser.add_argument("--forces", nargs="+", type=float, default=(0.0, 120.0))
    parser.add_argument("--factors", nargs="+", type=float, default=(0.0, 1.0))
    parser.add_argument("--worlds", nargs="+", type=int, default=(0,))
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--write", action="store_true", help="put the table into the page")
    arguments = parser.parse_args()
    cases = [
        Loops(job, correction, force, factor, world)
        for job in arguments.jobs
        for correction in arguments.corrections
        for world in arguments.worlds
        for force in arguments.forces
        for factor in arguments.factors
    ]
    lines = [HEADER]
    print(HEADER, flush=True)
    for case, data in measured(cases, arguments.processes, measure):
        lines.append(row(case, data))
        print(lines[-1], flush=True)
    if arguments.write:
        write("loops", "\n".join(lines))


if __name__ == "__main__":
    main()
