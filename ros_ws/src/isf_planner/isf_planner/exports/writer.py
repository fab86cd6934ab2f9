"""One call for every format: which one a file name stands for, and writing it."""

from __future__ import annotations

from pathlib import Path

from isf_core.errors import ErrorCode, IsfError
from isf_core.geometry.serial_arm import SerialArm

from isf_planner.exports.ampl_csv import write_csv
from isf_planner.exports.plan_file import save_plan
from isf_planner.exports.post_processor import load_post, post_names
from isf_planner.exports.programs import write_programs
from isf_planner.exports.target_stl import write_target
from isf_planner.part_plan import Plan

FORMATS = {
    ".npz": "plan",
    ".csv": "csv",
    ".stl": "stl",
    ".nc": "iso",
    ".mpf": "iso_two_channels",
    ".pmc": "pmac",
    ".src": "krl",
    ".mod": "rapid",
}
"""File name ending to format."""


NO_PROGRAMS = ("plan", "stl", "csv")
"""Formats that no post-processor writes."""

OF_SHAPE = ("plan", "stl")
"""Formats that a part over a die has, too."""


def format_of(path: Path, form: str | None = None) -> str:
    """Format of the file ``path``: ``form`` where it is given, else by the ending; IsfError EXPORT_FORMAT_UNKNOWN."""
    known = form or FORMATS.get(path.suffix.lower())
    if known is None:
        endings = ", ".join(f"{ending} {name}" for ending, name in FORMATS.items())
        raise IsfError(
            ErrorCode.EXPORT_FORMAT_UNKNOWN,
            f"'{path.suffix}' is not the ending of a known format",
            where=str(path),
            advice=f"add --format NAME ({', '.join((*NO_PROGRAMS, *post_names()))}), or one of the endings {endings}",
        )
    return known


def check_export(path: Path, form: str | None = None, *, over_die: bool = False) -> str:
    """Format of the file ``path``, after what can be said of it without a plan; ``over_die``: of a part over a die.

    Raises
    ------
    IsfError : as :func:`export`, but for what depends on the contours
    """
    known = format_of(path, form)
    if not path.parent.is_dir():
        raise IsfError(ErrorCode.FILE_NOT_WRITABLE, "no such folder", where=str(path.parent), advice="make it first")
    if over_die and known not in OF_SHAPE:
        raise IsfError(
            ErrorCode.EXPORT_FORMAT_UNKNOWN,
            f"format {known} has no place for the blank holder, whose travel is the depth of a part over a die",
            where=str(path),
            advice="export a plan (.npz); isf form and isf simulate form the job itself",
        )
    if known not in NO_PROGRAMS:
        load_post(known)
    return known


def for_arms(form: str) -> bool:
    """True when ``form`` has programs of its own for rigs with arms; raises IsfError of the post-processor."""
    return form not in NO_PROGRAMS and any(one.plans in ("one arm", "two arms") for one in load_post(form).channels)


def export(
    plan: Plan,
    path: Path,
    form: str | None = None,
    arms: tuple[SerialArm | None, SerialArm | None] = (None, None),
) -> list[Path]:
    """Write ``plan`` and return the files.

    Parameters
    ----------
    plan : to be written
    path : file name; some formats write several files beside it
    form : "plan", "stl" (the target as it is planned), "csv", a post-processor's name or YAML file; None: by the
        ending of the file name
    arms : that carry the upper and the lower tool, for programs of robots

    Raises
    ------
    IsfError : EXPORT_FORMAT_UNKNOWN, also for what a format cannot say; FILE_NOT_WRITABLE; or a fault in the user's
        post-processor
    """
    known = check_export(path, form, over_die=any(contour.holder_height for contour in plan.contours))
    if known == "plan":
        return [save_plan(plan, path)]
    if known == "stl":
        return [write_target(plan, path)]
    if known == "csv":
        if any(contour.tilted for contour in plan.contours):
            raise IsfError(
                ErrorCode.EXPORT_FORMAT_UNKNOWN,
                "the tables of format csv do not hold the axis of a tilted tool",
                where=str(path),
                advice="export a plan (.npz) or a program (iso, iso_two_channels, krl, rapid)",
            )
        return write_csv(plan, path)
    return write_programs(plan.contours, load_post(known), path, plan.ball_radius, arms, plan.origin, plan.spindle)
