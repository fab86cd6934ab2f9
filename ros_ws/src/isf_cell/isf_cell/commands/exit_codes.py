"""Exit codes of the ``isf`` command: what kind of thing went wrong, for scripts, and what has been reported already."""

from __future__ import annotations

from enum import IntEnum

from isf_core.errors import ErrorCode, IsfError


class Exit(IntEnum):
    """Exit codes; 2 is also what the command line parser uses for wrong options."""

    OK = 0
    INTERNAL = 1
    """A fault of this software; please report it."""
    USAGE = 2
    INPUT = 3
    """A job, rig, material or mesh file cannot be used."""
    PROCESS = 4
    """Force control, springback or the machine stopped the part."""
    CELL = 5
    """A node is missing, died, or did not answer."""
    ANALYSIS = 6
    """A bag cannot be read or a report cannot be written."""
    CHECK_FAILED = 7
    """``isf doctor`` found something that will not work, or ``isf faults`` a goal that is missed."""
    CANCELLED = 130
    """Stopped by the operator (Ctrl-C)."""


def exit_for(code: ErrorCode) -> Exit:
    """Exit code for an error code."""
    if code == ErrorCode.OK:
        return Exit.OK
    if code in (ErrorCode.CANCELLED, ErrorCode.PLAN_CANCELLED):
        return Exit.CANCELLED
    by_owner = {
        "software": Exit.INTERNAL,
        "files": Exit.INPUT,
        "planner": Exit.INPUT,
        "force_ctrl": Exit.PROCESS,
        "springback": Exit.PROCESS,
        "machine": Exit.PROCESS,
        "executive": Exit.CELL,
        "analysis": Exit.ANALYSIS,
    }
    return by_owner[code.owner]


class ReportedError(IsfError):
    """The same failure; it is part of the JSON object that was printed."""

    def __init__(self, error: IsfError) -> None:
        super().__init__(error.code, error.what, where=error.where, advice=error.advice)
