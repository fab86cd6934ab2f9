"""One part from blank to last scan, over any cell; free of ROS. The sequence: docs/reference/architecture.md."""

from __future__ import annotations

import json
import os
import threading
from dataclasses import asdict, dataclass
from pathlib import Path

from isf_core.contour import ContourResult, contour_label
from isf_core.errors import ErrorCode, IsfError
from isf_springback.lift_feedback import lift_due
from isf_springback.methods import check_method
from isf_springback.scan.feedback import scan_due

from isf_cell.options import UNCORRECTED
from isf_cell.run.cell import Cell, FormedContour, Operator, PartGoal, PlannedPart
from isf_cell.run.part_step import PartStep

PAUSE = 0.1
"""s between two looks at the operator who paused."""


class PartRun:
    """Forms one part of ``goal`` in ``cell``.

    Attributes
    ----------
    planned : None before the plan is there
    results : of the contours formed so far
    """

    def __init__(self, cell: Cell, goal: PartGoal, operator: Operator, checkpoint: Path | None = None) -> None:
        self.planned: PlannedPart | None = None
        self.results: list[ContourResult] = []
        self._cell = cell
        self._goal = goal
        self._operator = operator
        self._checkpoint = checkpoint

    @property
    def completed(self) -> int:
        """Contours that were formed to their end."""
        return sum(result.completed for result in self.results)

    def run(self) -> IsfError | None:
        """Form the part; why it ended early or is lost, None when it is complete. Never raises IsfError.

        A part whose sheet tears ends after the contour.
        """
        error: IsfError | None = None
        try:
            self._form()
        except IsfError as caught:
            error = self._cell.explain(caught)
            self._cell.stop(error)
        self._cell.finish()
        return error

    def _form(self) -> None:
        cell, goal, operator = self._cell, self._goal, self._operator
        job_file = goal.job_file
        goal.options.check(job_file)
        if goal.first_index > 0 and goal.method != UNCORRECTED:
            raise IsfError(
                ErrorCode.CORRECTION_FAILED,
                f"a part corrected by '{goal.method}' cannot start at first_index {goal.first_index}",
                advice="its corrections would start from zero under a formed sheet; resume with correction 'none'",
            )
        operator.phase("bringing up the nodes")
        cell.bring_up()
        check_method(goal.method, job_file)  # before the plan, which takes its time
        operator.phase("resetting the machine" if goal.first_index else "clamping a fresh blank")
        cell.reset(goal)
        cell.tare()
        operator.phase("planning")
        self.planned = planned = cell.plan(goal)
        cell.arm(goal, planned)
        for index in range(goal.first_index, planned.count):
            self._pause_before(index, planned.count)
            formed = self._form_contour(index)
            if index + 1 < planned.count:
                self._check_operator()
            if lift_due(job_file, index, planned.count):
                cell.lift(formed)
            if scan_due(job_file, index, planned.count):
                cell.scan(formed, aside=job_file.job.springback.scan_clear and formed.nominal.closed)
            cell.check()
            self._write_checkpoint(index + 1)

    def _form_contour(self, index: int) -> FormedContour:
        formed = self._cell.form_contour(index)
        self.results.append(formed.result)
        if not formed.result.completed:
            raise IsfError(ErrorCode(formed.result.code), formed.result.message, where=contour_label(index))
        self._operator.formed(PartStep.of(formed.nominal, formed.correction, formed.result))
        if (lost := self._cell.torn()) is not None:
            raise lost
        return formed

    def _pause_before(self, index: int, count: int) -> None:
        if not self._operator.paused():
            return
        self._operator.phase("paused", index, count)
        pause = threading.Event()
        while self._operator.paused():
            self._check_operator()
            self._cell.check()
            pause.wait(PAUSE)

    def _check_operator(self) -> None:
        if self._operator.cancelled():
            raise IsfError(ErrorCode.CANCELLED, "cancelled by the operator")

    def _write_checkpoint(self, next_index: int) -> None:
        if self._checkpoint is None or self.planned is None:
            return
        goal, planned = self._goal, self.planned
        name, options = goal.job_file.job.name, goal.options
        Checkpoint(name, planned.plan_id, next_index, planned.count, goal.method, options.variant, options.seed).write(
            self._checkpoint
        )


@dataclass(frozen=True)
class Checkpoint:
    """Progress of one part: the next contour to form is ``next_index`` of ``count``."""

    job_name: str
    plan_id: str
    next_index: int
    count: int
    correction: str
    variant: int
    seed: int

    def write(self, path: Path) -> None:
        """Replace the file in one step: after a crash it holds either the old or the new state."""
        temporary = path.with_suffix(".part")
        temporary.write_text(json.dumps(asdict(self)), encoding="utf-8")
        with temporary.open() as stream:
            os.fsync(stream.fileno())
        temporary.replace(path)
