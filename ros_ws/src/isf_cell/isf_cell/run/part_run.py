"""One part from blank to last scan, over any cell; free of ROS. The sequence: docs/reference/architecture.md."""

from __future__ import annotations

import logging
import threading
from collections.abc import Sequence
from typing import Protocol

from isf_core.contour import ContourResult, contour_label
from isf_core.errors import ErrorCode, IsfError, coded, failure
from isf_springback.lift_feedback import lift_due
from isf_springback.methods import check_method
from isf_springback.scan.feedback import scan_due

from isf_cell.options import UNCORRECTED
from isf_cell.run.cell import Cell, FormedContour, Operator, PartGoal, PlannedPart
from isf_cell.run.part_step import PartStep

PAUSE = 0.1
"""s between two looks at the operator who paused."""


class Keeper(Protocol):
    """Who keeps the part on the disk: :class:`isf_cell.run.part_keeper.PartKeeper`."""

    def begin(self, goal: PartGoal) -> None:
        """Before the blank is clamped."""

    def keep(
        self, goal: PartGoal, planned: PlannedPart, next_index: int, results: Sequence[ContourResult], lost: str = ""
    ) -> None:
        """Before contour ``next_index``; ``lost``: why the part cannot be completed. Raises IsfError where the
        cell does not go on."""


class PartRun:
    """Forms one part of ``goal`` in ``cell``.

    Attributes
    ----------
    planned : None before the plan is there
    results : of the contours formed so far
    """

    def __init__(self, cell: Cell, goal: PartGoal, operator: Operator, keeper: Keeper | None = None) -> None:
        self.planned: PlannedPart | None = None
        self.results: list[ContourResult] = []
        self._cell = cell
        self._goal = goal
        self._operator = operator
        self._keeper = keeper

    @property
    def completed(self) -> int:
        """Contours that were formed to their end."""
        return sum(result.completed for result in self.results)

    def run(self) -> IsfError | None:
        """Form the part; why it ended early or is lost, None when it is complete.

        Never raises: a fault of this software, too, is not to leave the tools on the sheet. A part whose sheet tears
        ends after the contour.
        """
        error: IsfError | None = None
        try:
            self._form()
        except Exception as caught:
            ended = coded(caught)
            if ended is not caught:
                logging.getLogger(__name__).exception("the part is ended")
            self._cell.stop(ended)  # first: what explains it may take seconds to show
            error = self._cell.explain(ended)
        self._cell.finish()
        return error

    def _form(self) -> None:
        cell, goal, operator = self._cell, self._goal, self._operator
        job_file = goal.job_file
        goal.options.check(job_file)
        if goal.first_index > 0 and goal.method != UNCORRECTED and goal.resume is None:
            raise IsfError(
                ErrorCode.CORRECTION_FAILED,
                f"a part corrected by '{goal.method}' cannot start at first_index {goal.first_index}",
                advice="its corrections would start from zero under a formed sheet; go on from its checkpoint, or with "
                "correction 'none'",
            )
        operator.phase("bringing up the nodes")
        cell.bring_up()
        check_method(goal.method, job_file, goal.options.named_at)  # before the plan, which takes its time
        operator.phase("taking up the part" if goal.first_index else "clamping a fresh blank")
        if self._keeper is not None:
            self._keeper.begin(goal)
        cell.reset(goal)
        cell.tare()
        operator.phase("planning")
        self.planned = planned = cell.plan(goal)
        self._check_plan(planned)
        for text in planned.warnings:
            operator.warned(text)
        cell.arm(goal, planned)
        for index in range(goal.first_index, planned.count):
            self._pause_before(index, planned.count)
            formed = self._form_contour(index)
            if index + 1 < planned.count:
                self._check_operator()
            if lift_due(job_file, index, planned.count, goal.method):
                cell.lift(formed)
            if scan_due(job_file, index, planned.count):
                cell.scan(formed, aside=job_file.job.springback.scan_clear and formed.nominal.closed)
            cell.check()
            if self._keeper is not None:
                self._keeper.keep(goal, planned, index + 1, self.results)

    def _check_plan(self, planned: PlannedPart) -> None:
        """Raise IsfError CHECKPOINT_UNUSABLE unless ``planned`` is the plan that the part was begun with."""
        before = self._goal.resume
        if before is None or (before.plan_id, before.count) == (planned.plan_id, planned.count):
            return
        raise IsfError(
            ErrorCode.CHECKPOINT_UNUSABLE,
            f"the job now has another plan, {planned.plan_id} of {planned.count} contours, than the part was begun "
            f"with, {before.plan_id} of {before.count}",
            advice="a file that the job names (mesh, rig, material), or the software, has changed: restore it, or form "
            "the part again",
        )

    def _form_contour(self, index: int) -> FormedContour:
        formed = self._cell.form_contour(index)
        self.results.append(formed.result)
        if not formed.result.completed:
            raise failure(formed.result.code, formed.result.message, where=contour_label(index))
        self._operator.formed(PartStep.of(formed.nominal, formed.correction, formed.result))
        if (lost := self._cell.torn()) is not None:
            if self._keeper is not None and self.planned is not None:
                self._keeper.keep(self._goal, self.planned, index + 1, self.results, lost.message)
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
