"""The kinds of simulated sheet that a user can choose, and the variants of the plant that are sealed."""

from __future__ import annotations

from typing import Literal, get_args

from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import Job, JobFile

SheetKind = Literal["fast", "shell", "shell_coarse", "shell_fine"]
"""``fast``: reduced model, seconds per part; ``shell``: elasto-plastic shell elements, minutes per part;
``shell_coarse`` and ``shell_fine``: the same with larger or smaller elements, and the tools quicker or slower."""

SHEET_KINDS: tuple[SheetKind, ...] = get_args(SheetKind)

DEFAULT_SHEET: SheetKind = "fast"

FORCE_TOO_HIGH: dict[SheetKind, float] = {"fast": 1.0, "shell_coarse": 1.8, "shell": 1.55, "shell_fine": 1.4}
"""Axial force on a formed wall over that of the regression of Aerens 2009, at most: a cell yields as a whole (measured,
docs/methods/shell_sheet.md, axial force; the fast sheet goes by the regression)."""

LARGEST_NUMBER = 2**31 - 1
"""Largest variant and seed: what the messages of the node graph carry."""

STRUCTURAL_VARIANTS = tuple(range(21, 41))
"""Numbers of the open variants of the simulated plant that differ from the nominal one in structure."""

SEALED_VARIANTS = tuple(range(101, 121))
"""Numbers of the variants of the simulated plant that are kept to publish results with: no constant and no method is
chosen by them. Nothing refuses them; reports and ``--json`` mark their runs as sealed."""


def is_structural(variant: int) -> bool:
    """The ``variant`` differs from the nominal plant in structure, open or sealed."""
    return variant in STRUCTURAL_VARIANTS or variant in SEALED_VARIANTS


def scans_with_sensor(job: Job, variant: int) -> bool:
    """Scans between contours are those of a scanner, in place of exact ones. The job says so; a ``variant`` of another
    structure has no exact ones unless the job asks for them by name, ``scan_sensor: false``."""
    asked = job.springback
    return asked.scan_sensor or (is_structural(variant) and "scan_sensor" not in asked.model_fields_set)


def default_sheet(job: Job) -> SheetKind:
    """The kind that ``job`` is formed on where none is named: the fast one, unless it does not know the job."""
    return DEFAULT_SHEET if _unknown_to_fast(job) is None else "shell_coarse"


def _unknown_to_fast(job: Job) -> tuple[str, str] | None:
    """What of ``job`` the fast sheet has no model of, and the field that asks for it; None: it knows the job."""
    if job.support_stays:
        return "a support tool that holds the blank beside the contact", "path.support: on_blank"
    for name, tool in (("tool_1", job.tool_1), ("tool_2", job.tool_2)):
        # a flat tip in accumulative forming, which no other sheet knows either, is refused by the planner
        if tool is not None and tool.flat_radius > 0.0 and job.process != "ADSIF":
            return "a flat tip: it would press as a ball of the whole radius", f"{name}.corner_radius"
    return None


def with_raised_force_limit(job_file: JobFile, sheet: str) -> JobFile:
    """``job_file`` on a machine that bears what the cells of the ``sheet`` so named overstate of the force; as it is
    for the fast sheet and for the empty name of a real one."""
    return job_file.with_force_raised(next((times for kind, times in FORCE_TOO_HIGH.items() if kind == sheet), 1.0))


def raised_limit_text(job_file: JobFile) -> str:
    """What a force limit of a job of :func:`with_raised_force_limit` is beside the rig's own, and why; for people."""
    return (
        f"{job_file.force_raised:g} times what {job_file.rig.name} bears, since cells of this size overstate the force"
    )


def sheet_kind(name: str, where: str = "sheet") -> SheetKind | None:
    """The kind called ``name``; None for an empty name: :func:`default_sheet` of the job.

    Raises
    ------
    IsfError : FILE_FIELD, there is none
    """
    if name and name not in SHEET_KINDS:
        raise IsfError(
            ErrorCode.FILE_FIELD,
            f"there is no simulated sheet '{name}'",
            where=where,
            advice=f"known: {', '.join(SHEET_KINDS)}",
        )
    return name or None


def check_sheet(kind: SheetKind, job: Job) -> None:
    """A sheet of ``kind`` can be formed as ``job`` says.

    Raises
    ------
    IsfError : FILE_FIELD, the model has no place for the process, the tip of a tool, or where the support tool stands
    """
    if kind == "fast" and (unknown := _unknown_to_fast(job)) is not None:
        raise IsfError(
            ErrorCode.FILE_FIELD,
            f"the fast sheet does not know {unknown[0]}",
            where=unknown[1],
            advice="take --sheet shell_coarse",
        )
    if kind != "fast" and job.process not in ("SPIF", "DSIF", "TPIF"):
        raise IsfError(
            ErrorCode.FILE_FIELD,
            f"the elasto-plastic sheet forms SPIF, DSIF and TPIF, not {job.process}",
            where="--sheet",
            advice="take --sheet fast",
        )


def check_clock(kind: SheetKind, job: Job, where: str = "sheet") -> None:
    """A sheet of ``kind`` can be formed by the wall clock.

    Raises
    ------
    IsfError : FILE_FIELD, it is an elasto-plastic one, which takes longer
    """
    if kind != "fast":
        other = (
            ", or take the sheet fast" if default_sheet(job) == "fast" else ": the fast sheet does not know this job"
        )
        raise IsfError(
            ErrorCode.FILE_FIELD,
            f"the elasto-plastic sheet '{kind}' is slower than the wall clock",
            where=where,
            advice=f"form it in lockstep (without --real-time){other}",
        )
