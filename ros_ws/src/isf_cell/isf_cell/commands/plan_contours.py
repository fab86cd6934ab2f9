"""What ``isf plan`` tells of every contour: step, tool marks, spindle; and the step for a wanted surface."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from isf_core.contour import contour_label
from isf_core.errors import ErrorCode, IsfError
from isf_core.files import quantity
from isf_core.files.job import JobFile
from isf_core.files.tooling import ToolSpec
from isf_planner import Plan
from isf_planner.part.mesh_checks import place_text
from isf_planner.paths.spindle import SPINDLE_TOOL, slip
from isf_planner.predict.predictions import contour_time
from isf_planner.predict.tool_marks import (
    FORCE_EXPONENT,
    NEAR_LIMIT,
    SHARE,
    Surface,
    ToolMarks,
    step_for,
    surface_of,
    tool_marks,
)

MM, UM, RPM = 1e3, 1e6, 30.0 / np.pi


@dataclass(frozen=True)
class WantedMarks:
    """The surface that a part should have: m, ridge between tool marks and their spacing; None: any."""

    ridge: float | None = None
    spacing: float | None = None

    @property
    def any(self) -> bool:
        """True where something is wanted."""
        return self.ridge is not None or self.spacing is not None


def wanted_marks(scallop: str | None, spacing: str | None) -> WantedMarks:
    """Options ``--scallop`` and ``--mark-spacing``; IsfError FILE_UNIT or FILE_FIELD for what is no positive length."""
    return WantedMarks(_length("--scallop", scallop, "5 um"), _length("--mark-spacing", spacing, "0.5 mm"))


def _length(option: str, text: str | None, example: str) -> float | None:
    if text is None:
        return None
    advice = f'write for example {option} "{example}"'
    try:
        value = quantity.parse(text, "m")
    except ValueError as error:
        raise IsfError(ErrorCode.FILE_UNIT, str(error), where=option, advice=advice) from error
    if value <= 0.0:
        raise IsfError(ErrorCode.FILE_FIELD, f"'{text}' is not above 0", where=option, advice=advice)
    return value


@dataclass(frozen=True)
class ContourTable:
    """Rows of all contours, and what the last stage leaves on the walls; None where no pass lies beside another."""

    rows: tuple[dict[str, Any], ...]
    surface: Surface | None


def contour_table(result: Plan, job_file: JobFile) -> ContourTable:
    """Every contour of the plan of a job, in the units of people."""
    marks = tool_marks(result.contours, job_file.job)
    rows = tuple(_row(result, k, mark, job_file.job.tool_1) for k, mark in enumerate(marks))
    return ContourTable(rows, surface_of(result.contours, marks))


def _row(result: Plan, k: int, mark: ToolMarks | None, tool: ToolSpec) -> dict[str, Any]:
    contour = result.contours[k]
    angle = np.degrees(contour.wall_angle)
    turns = bool(result.spindle) and contour.forming_tool == SPINDLE_TOOL
    return {
        "contour": k + 1,
        "stage": contour.stage + 1,
        "feature": contour.feature + 1,
        "forming_tool": contour.forming_tool,
        "depth_mm": MM * -float(contour.forming_tip[:, 2].min()),
        "length_m": contour.length,
        "time_s": contour_time(contour),
        "wall_angle_min_deg": float(angle.min()),
        "wall_angle_max_deg": float(angle.max()),
        "step_mm": None if mark is None else MM * float(np.nanmedian(mark.step)),
        "mark_spacing_mm": None if mark is None else MM * float(np.nanmax(mark.spacing)),
        "scallop_um": None if mark is None else UM * float(np.nanmax(mark.ridge)),
        "spindle_rpm": RPM * result.spindle[k] if result.spindle else None,
        "spindle_slip": slip(contour, result.spindle[k], tool) if turns else None,
    }


def write_rows(rows: tuple[dict[str, Any], ...], path: Path) -> Path:
    """The rows as CSV, one line for each contour; empty where nothing is known."""
    with path.open("w", encoding="ascii", newline="") as file:
        table = csv.writer(file)
        table.writerow(rows[0])
        for row in rows:
            table.writerow([f"{value:.6g}" if isinstance(value, float) else value for value in row.values()])
    return path


def spindle_numbers(result: Plan) -> dict[str, Any] | None:
    """The spindle of a plan for ``--json``; None where it does not turn."""
    if not result.spindle:
        return None
    turns = [abs(RPM * speed) for speed in result.spindle if speed]
    return {
        "rpm": [RPM * speed for speed in result.spindle],
        "lowest_rpm": min(turns, default=0.0),
        "highest_rpm": max(turns, default=0.0),
    }


def marks_numbers(table: ContourTable, result: Plan, job_file: JobFile, wanted: WantedMarks) -> dict[str, Any] | None:
    """Tool marks for ``--json``, and the step for what is ``wanted``; None where no pass lies beside another.

    Raises
    ------
    IsfError : FILE_FIELD for a wanted surface of a part without marks, or rougher than the tool can leave it
    """
    found = table.surface
    if found is None:
        if wanted.any:
            raise IsfError(
                ErrorCode.FILE_FIELD,
                "the plan has no passes beside each other on a wall, so that no step follows from their marks",
                where="--scallop and --mark-spacing",
                advice="leave them out",
            )
        return None
    contour = result.contours[found.contour]
    return {
        "largest_spacing_mm": MM * found.spacing,
        "largest_scallop_um": UM * found.ridge,
        "at_mm": (MM * contour.contact[found.point]).tolist(),
        "on_contour": found.contour + 1,
        "wall_angle_deg": float(np.degrees(contour.wall_angle[found.point])),
        "spacing_mm": MM * found.usual_spacing,
        "scallop_um": UM * found.usual_ridge,
        "floor_spacing_mm": None if found.floor_spacing is None else MM * found.floor_spacing,
        "floor_scallop_um": None if found.floor_ridge is None else UM * found.floor_ridge,
        "wanted": _recommended(found, result, job_file, wanted) if wanted.any else None,
    }


def ridge_warning(found: Surface | None, result: Plan, job_file: JobFile) -> tuple[str, ...]:
    """Warning where the highest ridge between passes beside each other is higher than the part may be off."""
    path, allowed = job_file.job.path, job_file.job.tolerance.shape
    if found is None or found.ridge <= allowed:
        return ()
    advice = "a smaller path.incremental_depth"
    if path.spacing == "scallop":
        advice = "a smaller path.smallest_step, or scallop_height,"
    elif path.spacing == "arc":
        advice = "path.spacing: scallop, or a smaller path.arc_step and smallest_step,"
    elif job_file.job.process != "ADSIF":
        advice = f"path.spacing: scallop, or {advice},"
    place = result.contours[found.contour].contact[found.point]
    return (
        f"{contour_label(found.contour)} at {place_text(place)}: the tool leaves a ridge of {MM * found.ridge:.2f} mm "
        f"beside the contour before, more than tolerance.shape of {MM * allowed:.2f} mm; {advice} brings them closer "
        "together",
    )


def _recommended(found: Surface, result: Plan, job_file: JobFile, wanted: WantedMarks) -> dict[str, Any]:
    """The depth step for what is wanted, and what it costs."""
    radius = job_file.job.tool_1.ball_radius
    for value, most, option in ((wanted.ridge, radius, "--scallop"), (wanted.spacing, 2 * radius, "--mark-spacing")):
        if value is not None and value >= most:
            raise IsfError(
                ErrorCode.FILE_FIELD,
                f"{MM * value:g} mm is more than passes of a ball of {MM * radius:g} mm leave, which meet",
                where=option,
                advice=f"less than {MM * most:g} mm",
            )
    step = step_for(found, radius, ridge=wanted.ridge, spacing=wanted.spacing)
    ratio = step / found.step
    force = max((float(one.predicted_force.max()) for one in result.contours if len(one.predicted_force)), default=None)
    limit = job_file.material.max_wall_angle
    return {
        "scallop_um": None if wanted.ridge is None else UM * wanted.ridge,
        "spacing_mm": None if wanted.spacing is None else MM * wanted.spacing,
        "incremental_depth_mm": MM * step,
        "now_mm": MM * found.step,
        "force_N": None if force is None else force * ratio**FORCE_EXPONENT,
        "force_now_N": force,
        "time_s": result.forming_time / ratio,
        "time_now_s": result.forming_time,
        "near_limit": bool(ratio < 1.0 and result.largest_wall_angle > NEAR_LIMIT * limit),
    }


def texts(marks: dict[str, Any] | None, spindle: dict[str, Any] | None, job_file: JobFile) -> list[str]:
    """Tool marks and spindle for people, a line each."""
    lines = []
    if marks is not None:
        place = ", ".join(f"{value:.1f}" for value in marks["at_mm"])
        lines.append(
            f"tool marks on {100 * SHARE:.0f} % of the walls: at most {marks['spacing_mm']:.2f} mm apart, ridges up to "
            f"{marks['scallop_um']:.0f} um; highest ridge {marks['largest_scallop_um']:.0f} um, on contour "
            f"{marks['on_contour']} at ({place}) mm"
        )
        if marks["wanted"] is not None:
            lines += _wanted_texts(marks["wanted"], job_file)
    if spindle is not None:
        kind = "rolling" if job_file.job.path.spindle == "rolling" else "as the job says"
        low, high = spindle["lowest_rpm"], spindle["highest_rpm"]
        speed = f"{high:.0f}" if high - low < 0.5 else f"{low:.0f} to {high:.0f}"
        lines.append(f"spindle: {speed} rpm, {kind}; only exported programs turn it")
    return lines


def _wanted_texts(wanted: dict[str, Any], job_file: JobFile) -> list[str]:
    surface = [
        text
        for text in (
            "" if wanted["scallop_um"] is None else f"ridges of {wanted['scallop_um']:g} um",
            "" if wanted["spacing_mm"] is None else f"marks {wanted['spacing_mm']:g} mm apart",
        )
        if text
    ]
    step, now = wanted["incremental_depth_mm"], wanted["now_mm"]
    line = f"for {' and '.join(surface)}: incremental_depth: {step:.3f} mm (it is {now:.3f} mm)"
    if wanted["force_N"] is not None:
        line += f"; axial force {wanted['force_N']:.0f} N in place of {wanted['force_now_N']:.0f} N"
    line += f", {wanted['time_s'] / 60:.1f} min in place of {wanted['time_now_s'] / 60:.1f}"
    lines = [line]
    if step < now:
        lines.append("a finer step makes the part more accurate and smoother, and takes longer (Lu 2016, 4.1)")
    if wanted["near_limit"]:
        limit = np.degrees(job_file.material.max_wall_angle)
        lines.append(
            f"its walls are near the {limit:.0f} deg that the sheet bears in one pass, where finer steps tear it: at "
            "60 deg AA7075-O of 1.6 mm tore with steps of 0.5 mm and less, and bore 0.7 mm and more (Lu 2016, 4.1.3)"
        )
    if not 0.01 < step < 5.0:
        lines.append("a job takes steps of more than 0.01 mm and less than 5 mm: that is not the tool for this surface")
    return lines
