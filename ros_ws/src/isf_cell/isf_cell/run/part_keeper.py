"""Keeps a part on the disk after every contour, and counts over all sessions in which it is formed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from isf_core.contour import ContourResult, contour_label
from isf_core.errors import ErrorCode, IsfError

from isf_cell.run.cell import Operator, PartGoal, PlannedPart
from isf_cell.run.checkpoint import Checkpoint, CheckpointFolder


@dataclass(frozen=True)
class TickCounts:
    """What the machine counted: ticks, late ones, and targets that were lost."""

    ticks: int = 0
    late: int = 0
    lost: int = 0


class StateSaver(Protocol):
    """A cell as far as its state can be kept."""

    @property
    def counts(self) -> TickCounts:
        """Of the machine since this session began."""

    def save_state(self, next_index: int) -> tuple[str, ...]:
        """Have machine and springback write their states before contour ``next_index``.

        Returns how the names of their files begin, below the folder of the checkpoint. Raises IsfError.
        """


@dataclass(frozen=True)
class PartTotals:
    """Numbers of a part over all its sessions.

    ``began``, ``ended``: s by the clock of the results. Between them lies the time of the process: of a part that went
    on by the wall clock, ``began`` is later by the time in which nobody formed it.
    """

    contours: int
    ticks: int
    late_ticks: int
    lost_messages: int
    began: float
    ended: float

    @classmethod
    def of(cls, results: Sequence[ContourResult], counts: TickCounts, before: Checkpoint | None) -> PartTotals:
        """Of the ``results`` and ``counts`` of this session, and of what is known of those ``before``."""
        now = cls(
            contours=sum(result.completed for result in results),
            ticks=counts.ticks,
            late_ticks=counts.late + sum(result.late_ticks for result in results),
            lost_messages=counts.lost + sum(result.lost_messages for result in results),
            began=results[0].start if results else 0.0,
            ended=results[-1].end if results else 0.0,
        )
        if before is None:
            return now
        nobody = now.began - before.ended if results and not before.lockstep else 0.0
        return cls(
            before.next_index + now.contours,
            before.ticks + now.ticks,
            before.late_ticks + now.late_ticks,
            before.lost_messages + now.lost_messages,
            before.began + nobody,
            now.ended or before.ended,
        )


_CELL_ENDS = (ErrorCode.NODE_DIED, ErrorCode.CANCELLED)
"""What a part does not go on after, though it comes while its state is saved."""


NOT_KEPT = "no checkpoint"
"""How the operator is told, as a phase, that a part or a contour is not kept."""


def not_kept(error: IsfError) -> str:
    """Phase of a part that no checkpoints are kept of."""
    return f"{NOT_KEPT} is kept: {error}"


class PartKeeper:
    """Writes the checkpoint of one part in ``folder``; what keeps it from that is told to the ``operator``, once.

    ``lockstep``: how the cell forms; False by the wall clock.
    """

    def __init__(self, folder: CheckpointFolder, saver: StateSaver, operator: Operator, *, lockstep: bool) -> None:
        self._folder = folder
        self._saver = saver
        self._operator = operator
        self._lockstep = lockstep
        self._refused = False
        self._told = False

    def begin(self, goal: PartGoal) -> None:
        """Before the blank of ``goal`` is clamped: the checkpoint of another part goes."""
        try:
            if goal.resume is None:
                self._folder.begin()
        except IsfError as error:
            self._refused = True
            self._operator.phase(not_kept(error))

    def keep(
        self, goal: PartGoal, planned: PlannedPart, next_index: int, results: Sequence[ContourResult], lost: str = ""
    ) -> None:
        """Write the checkpoint before contour ``next_index``. A part whose checkpoint cannot be written is formed
        nevertheless, and it is tried again after the next contour. ``lost`` says why it cannot be completed.

        Raises IsfError NODE_DIED, CANCELLED.
        """
        if self._refused:
            return
        try:
            expected = self._saver.save_state(next_index) if next_index < planned.count and not lost else ()
            checkpoint = self._checkpoint(goal, planned, next_index, results, lost)
            _check_files(checkpoint, expected)
            self._folder.write(checkpoint)
        except IsfError as error:
            if error.code in _CELL_ENDS:
                raise
            if not self._told:
                self._told = True
                self._operator.phase(f"{NOT_KEPT} after {contour_label(next_index - 1)}: {error}")

    def _checkpoint(
        self, goal: PartGoal, planned: PlannedPart, next_index: int, results: Sequence[ContourResult], lost: str
    ) -> Checkpoint:
        job_file, options = goal.job_file, goal.options
        totals = PartTotals.of(results, self._saver.counts, goal.resume)
        return Checkpoint(
            job_name=job_file.job.name,
            job_text=job_file.text,
            base_folder=str(job_file.base),
            correction=goal.method,
            support_force=options.support_force,
            variant=options.variant,
            seed=options.seed,
            sheet=options.sheet_of(job_file),
            plan_id=planned.plan_id,
            count=planned.count,
            next_index=next_index,
            began=totals.began,
            ended=totals.ended,
            ticks=totals.ticks,
            late_ticks=totals.late_ticks,
            lost_messages=totals.lost_messages,
            lost=lost,
            lockstep=self._lockstep,
            files=self._folder.checksums(next_index),
        )


def _check_files(checkpoint: Checkpoint, expected: Sequence[str]) -> None:
    """Raise IsfError FILE_NOT_FOUND unless every state that was saved lies where the checkpoint is."""
    for beginning in expected:
        if not any(name.startswith(beginning) for name in checkpoint.files):
            raise IsfError(
                ErrorCode.FILE_NOT_FOUND,
                f"the state {beginning} is not in the folder of the checkpoint",
                where="parameter state_folder of machine, springback and force_ctrl",
                advice="start them with the folder that the executive has as checkpoint",
            )
