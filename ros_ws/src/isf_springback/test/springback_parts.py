"""Parts, contours and results for the tests: a cone in the published rig (Ren 2018, 4.3)."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from isf_core.contour import Contour, ContourResult, Process
from isf_core.files.job import JobFile
from isf_core.process.thickness_and_tips import forming_tip, sine_law, support_tip
from isf_springback.corrector import Corrector
from isf_springback.estimators.estimator import Estimator

JOB_TEXT = """\
name: cone
part: {mesh: cone.stl, unit: mm}
process: DSIF
rig: ren2018
sheet: {material: AA5754-O, thickness: 1.0 mm}
tool_1: {radius: 5 mm}
tool_2: {radius: 5 mm}
path: {incremental_depth: 0.5 mm, point_spacing: 0.5 mm, feed: 30 mm/s}
control: {support_force: 120 N}
springback: {method: analytic, gain: 1.0, fused: {model: analytic}}
"""


def job_file(**replacements):
    """Job of the cone; ``replacements`` are texts to exchange, e.g. gain="gain: 0.5"."""
    text = JOB_TEXT
    for old, new in {"gain": "gain: 1.0", "edge": ""}.items():
        if old in replacements and new:
            text = text.replace(new, replacements[old])
    return JobFile(text, Path("."))


def cone_contour(index, *, plan_id="plan", count=42, opening=36e-3, angle=50.0, tool=1, radius=None, start=0.0):
    """Contour ``index`` of a cone with straight wall; lower forming tool: the part mirrored at z = 0."""
    wall = np.radians(angle)
    depth = 0.5e-3 * (index + 1)
    r = radius or max(opening - depth / np.tan(wall), 5e-3)
    n = max(40, round(2 * np.pi * r / 0.5e-3))
    turn = start + 2 * np.pi * np.arange(n) / n
    up = 1.0 if tool == 1 else -1.0
    out = np.column_stack([np.cos(turn), np.sin(turn), np.zeros(n)])
    contact = r * out + [0.0, 0.0, -up * depth]
    normal = -np.sin(wall) * out + [0.0, 0.0, up * np.cos(wall)]
    thickness = sine_law(1e-3, np.full(n, wall))
    return Contour(
        plan_id=plan_id,
        index=index,
        count=count,
        process=Process.DSIF,
        feed=0.03,
        contact=contact,
        normal=normal,
        wall_angle=np.full(n, wall),
        thickness=thickness,
        forming_tip=forming_tip(contact, normal, 5e-3, upper=tool == 1),
        support_tip=support_tip(contact, normal, 5e-3, thickness, upper=tool != 1),
        support_force=np.full(n, 120.0),
        forming_tool=tool,
    )


def result_of(contour, sheet_load, *, squeeze=120.0, rng=None, completed=True):
    """Result in which the sheet is pushed with ``sheet_load`` N and squeezed with ``squeeze`` N horizontally."""
    n = len(contour)
    up = 1.0 if contour.forming_tool == 1 else -1.0
    axial_squeeze = squeeze / np.tan(contour.wall_angle)
    forming = np.zeros((n, 3))
    support = np.zeros((n, 3))
    forming[:, 2] = up * (np.broadcast_to(sheet_load, n) + axial_squeeze)
    support[:, 2] = -up * axial_squeeze
    if rng is not None:
        forming *= 1.0 + 0.01 * rng.standard_normal((n, 1))
        support *= 1.0 + 0.01 * rng.standard_normal((n, 1))
    empty = np.empty(0)
    return ContourResult(
        plan_id=contour.plan_id,
        index=contour.index,
        start=0.0,
        end=1.0,
        completed=completed,
        forming_force=forming,
        support_force=support,
        forming_target=contour.forming_tip,
        support_target=contour.support_tip,
        force_offset=np.zeros(n),
        compliance_offset=np.zeros((n, 3)),
        tick_time=empty,
        tick_set_point=empty,
        tick_normal_force=empty,
        tick_engaged=np.empty(0, dtype=bool),
    )


def corrector_of(kind: Callable[..., Estimator], job_file: JobFile, *options: object) -> Corrector:
    """A corrector by the method ``kind`` with its own ``options``."""
    return Corrector(kind(job_file, *options), job_file)
