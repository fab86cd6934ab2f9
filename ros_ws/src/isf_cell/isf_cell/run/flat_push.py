"""A slow push on the flat sheet of the simulated machine: what calibrates the edge of the clamp.

As on a real cell: the encoder's travel less what tool and frame give way by the rig file, against the reading of the
load cell, which has its own error.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile
from isf_sim.machine.simulated_machine import SimulatedMachine
from isf_springback.shell.edge_calibration import PushCurve
from numpy.typing import NDArray

FEED = 5e-3
"""m/s"""
LARGEST_FORCE = 400.0
"""N (published: Ren 2018, 4.3.2)"""
FREE = 1e-3
"""m above the sheet, where the push begins."""
DEEPEST = 15e-3
"""m; a sheet that gives way more is not in its clamp."""
PUSHED = 1
"""The blank that is pushed; the part is formed of another one."""
LOADS = 12
"""Loads of the curve, evenly spaced from the smallest of them on."""


def push_flat_sheet(
    job_file: JobFile,
    variant: int = 0,
    seed: int = 0,
    force: float = LARGEST_FORCE,
    place: tuple[float, float] = (0, 0),
) -> PushCurve:
    """Push of tool 1 of a fresh machine at ``place`` m onto its flat sheet, up to ``force`` N; tool 2 stays parked.

    Raises
    ------
    IsfError : MACHINE_FAULTED; PUSH_CURVE_UNUSABLE, the force is not reached; FILE_FIELD, the sheet lies on something
    """
    held = [name for name in ("backing_plate", "die") if getattr(job_file.job, name) is not None]
    if held:
        raise IsfError(
            ErrorCode.FILE_FIELD,
            "the sheet does not hang in its clamp alone, so that a push says nothing about the clamp",
            where=held[0],
            advice="push a sheet without it: a copy of the job that leaves it out",
        )
    machine = SimulatedMachine(job_file, variant=variant, seed=seed, blank=PUSHED)
    start = machine.sample()
    step = FEED / machine.control_rate
    speed = job_file.rig.limits.speed / machine.control_rate
    tip, parked = start.tip_1.copy(), start.tip_2
    for goal in (np.array([*place, tip[2]]), np.array([*place, FREE])):
        count = max(int(np.ceil(np.linalg.norm(goal - tip) / (0.5 * speed))), 1)
        for point in np.linspace(tip, goal, count + 1)[1:]:
            machine.tick(point, parked)
        tip = goal
    _stop_if_faulted(machine)
    machine.tare()
    readings = [(0.0, 0.0)]
    compliance = float(job_file.rig.tool_1.compliance[2])
    while readings[-1][0] < force:
        tip = tip - np.array([0.0, 0.0, step])
        if tip[2] < -DEEPEST or machine.faults:
            break
        sample = machine.tick(tip, parked)
        load = float(sample.wrench_1[2])
        readings.append((load, -float(sample.tip_1[2]) - compliance * load))
    _stop_if_faulted(machine)
    reached = np.array(readings[1:])
    if reached[:, 0].max() < force:
        raise IsfError(
            ErrorCode.PUSH_CURVE_UNUSABLE,
            f"{force:.0f} N are not reached within {1e3 * DEEPEST:.0f} mm",
            where="flat sheet",
            advice="push with less force",
        )
    curve = _averaged(reached, force)
    return PushCurve(curve[:, 0], curve[:, 1], place)


def _stop_if_faulted(machine: SimulatedMachine) -> None:
    if machine.faults:
        code, text = machine.faults[0]
        raise IsfError(ErrorCode.MACHINE_FAULTED, f"the push was stopped: {code.name}, {text}", where="flat sheet")


def _averaged(readings: NDArray[np.float64], force: float) -> NDArray[np.float64]:
    """(K, 2) N and m, means of the readings around K evenly spaced loads."""
    edges = np.linspace(0.05 * force, force, LOADS + 1)
    inside = [(readings[:, 0] >= low) & (readings[:, 0] < high) for low, high in pairwise(edges)]
    return np.array([readings[chosen].mean(axis=0) for chosen in inside if chosen.any()])
