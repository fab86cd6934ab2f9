"""What an operator may do with the cell: automatic, manual, set-up and simulation (Torrao 2013, section 6.1).

The executive owns the mode; force_ctrl moves tools by hand only where the executive has armed it so. Blocks: for worker
threads.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import IntEnum
from pathlib import Path

from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile, load_job
from isf_core.types import Array
from isf_planner.gcode.program_check import check_program_text
from isf_planner.gcode.set_up import WORK_SYSTEMS, cell_set_up_path, load_set_up, store_work_offset

from isf_cell.options import RunOptions
from isf_cell.run.cell import PartGoal
from isf_cell.run.graph_cell import GraphCell

FRESH = 1.0
"""s, age up to which a pose says where a tool is."""


class OperatorMode(IntEnum):
    """As the constants of ``isf_msgs/ExecutiveState``."""

    AUTOMATIC = 0
    MANUAL = 1
    SET_UP = 2
    SIMULATION = 3

    @property
    def word(self) -> str:
        """For people, and for commands."""
        return self.name.lower().replace("_", "-")


ZERO_IN = (OperatorMode.MANUAL, OperatorMode.SET_UP)
"""Modes in which work offsets are set."""


@dataclass
class OperatorModes:
    """The present mode, and what it is made of.

    Attributes
    ----------
    new_cell : makes a cell of the graph, for a change
    job_path : of the job where nobody named one yet; empty: none
    set_up : file of work offsets and tools; empty: that of the rig's cell
    mode, changing, code, message : as in ExecutiveState
    job_file : that rig and tools are taken from
    depth : m, how far the sheet in the clamp reaches below its plane, as far as this executive formed it
    """

    new_cell: Callable[[], GraphCell]
    job_path: str = ""
    set_up: str = ""
    mode: OperatorMode = OperatorMode.AUTOMATIC
    changing: bool = False
    code: ErrorCode = ErrorCode.OK
    message: str = ""
    job_file: JobFile | None = None
    depth: float = 0.0
    _cell: GraphCell | None = None
    _tips: dict[int, tuple[float, Array]] = field(default_factory=dict)

    def tip(self, tool: int, tip: Array) -> None:
        """The machine told the ``tip`` (3,) m of ``tool`` (1, 2)."""
        self._tips[tool] = (time.monotonic(), tip)

    def require(self, *modes: OperatorMode, what: str) -> None:
        """Raise IsfError MODE_REFUSED unless one of ``modes`` is on."""
        if self.mode in modes and not self.changing:
            return
        wanted = " or ".join(mode.word for mode in modes)
        now = f"on the way from {self.mode.word} to another mode" if self.changing else f"in mode {self.mode.word}"
        raise IsfError(
            ErrorCode.MODE_REFUSED, f"{what} is not possible {now}", where="executive", advice=f"set it to {wanted}"
        )

    def change(self, wanted: OperatorMode, job_file: JobFile | None, *, new_blank: bool) -> None:
        """Go over to ``wanted``; where that fails nothing is armed, and the mode is automatic. Raises IsfError."""
        if wanted is OperatorMode.MANUAL:
            job_file = job_file or self._known_job()
        self.job_file = job_file or self.job_file
        self.code, self.message = ErrorCode.OK, ""
        try:
            self._leave(stay_up=wanted in ZERO_IN)
            if wanted in ZERO_IN:
                self._enter(wanted, new_blank=new_blank)
            self.mode = wanted
        except IsfError as error:
            self.leave_for(error)
            raise

    def leave_for(self, error: IsfError) -> None:
        """The mode cannot be kept: end what it has begun, and say why."""
        self.code, self.message = error.code, error.message
        if self._cell is not None:
            self._cell.stop(error)
            self._cell.finish()
            self._cell = None
        self.mode = OperatorMode.AUTOMATIC

    def check(self) -> None:
        """Raise IsfError when what the mode needs is gone."""
        if self._cell is not None and not self.changing:
            self._cell.check()

    @property
    def cell(self) -> GraphCell | None:
        """The cell that was brought up for this mode; None: none is needed."""
        return self._cell

    def formed(self, depth: float, *, fresh: bool = False) -> None:
        """A contour was formed down to ``depth`` m below the plane of the sheet, or a ``fresh`` sheet was clamped."""
        self.depth = 0.0 if fresh else max(self.depth, depth)

    # -- zero, programs --------------------------------------------------------------------------

    def zero(self, system: int, tool: int, axes: str) -> tuple[tuple[float, float, float], Path]:
        """Set the origin of work coordinates ``system`` to where the tip of ``tool`` is, in ``axes`` (such as "xy").

        ``axes`` "none" sets nothing, and is possible in any mode.

        Returns the origin (3,) m in frame ``sheet`` and the file that has it now. Raises IsfError MODE_REFUSED,
        POSE_LOST, FILE_FIELD, FILE_NOT_WRITABLE.
        """
        wanted = "" if axes == "none" else axes or "xyz"
        if wanted:
            self.require(*ZERO_IN, what="setting a work offset")
        if system not in WORK_SYSTEMS or tool not in (1, 2) or not set(wanted) <= set("xyz"):
            raise IsfError(
                ErrorCode.FILE_FIELD,
                f"G{system}, tool {tool}, axes '{axes}'",
                where="executive/zero",
                advice="G54 to G57; tool 1 or 2; axes such as xy",
            )
        path = self.set_up_path()
        before = load_set_up(path).offset(system) if path.is_file() else (0.0, 0.0, 0.0)
        if not wanted:
            return before, path
        heard = self._tips.get(tool)
        if heard is None or time.monotonic() - heard[0] > FRESH:
            raise IsfError(
                ErrorCode.POSE_LOST,
                f"nothing on tool_{tool}/pose in the last {FRESH:g} s: where the tool is is not known",
                where="executive/zero",
                advice="is the machine active? set the mode manual",
            )
        x, y, z = (float(heard[1][k]) if axis in wanted else before[k] for k, axis in enumerate("xyz"))
        store_work_offset(path, system, (x, y, z))
        return (x, y, z), path

    def set_up_path(self) -> Path:
        """File of the cell's work offsets and tools. Raises IsfError of the job."""
        if self.set_up:
            return Path(self.set_up).absolute()
        return cell_set_up_path(self._known_job().rig.name)

    def check_program(self, text: str, name: str) -> tuple[IsfError | None, str]:
        """What is at fault in a program for this cell, first, and all of it as JSON. Nothing is sent to the machine.

        Raises IsfError MODE_REFUSED, and of job and set-up.
        """
        self.require(OperatorMode.SIMULATION, what="checking a program")
        job_file, path = self._known_job(), self.set_up_path()
        set_up = load_set_up(path) if path.is_file() else None
        checked = check_program_text(text, name or "program", job_file, set_up)
        return checked.failure, json.dumps(checked.numbers())

    # -- inside ----------------------------------------------------------------------------------

    def _known_job(self) -> JobFile:
        if self.job_file is None and self.job_path:
            self.job_file = load_job(Path(self.job_path))
        if self.job_file is None:
            raise IsfError(
                ErrorCode.MODE_REFUSED,
                "which rig, sheet and tools there are is not known: no part was formed yet",
                where="executive",
                advice="name a job (isf mode manual JOB), or start the executive with the parameter job",
            )
        return self.job_file

    def _enter(self, wanted: OperatorMode, *, new_blank: bool) -> None:
        if self._cell is None:
            self._cell = self.new_cell()
            self._cell.bring_up()
        if wanted is OperatorMode.MANUAL:
            goal = PartGoal(self._known_job(), RunOptions())
            if self._cell.arm_by_hand(goal, depth=self.depth, new_blank=new_blank):
                self.formed(0.0, fresh=True)

    def _leave(self, *, stay_up: bool) -> None:
        if self._cell is None:
            return
        if self.mode is OperatorMode.MANUAL:
            self._cell.disarm()
        if not stay_up:
            self._cell.finish()
            self._cell = None
