"""The cell as a part run needs it: what it asks of machine, planner, springback and force control, wherever they are.

:class:`isf_cell.run.part_run.PartRun` is the sequence. :class:`isf_cell.run.in_process_cell.InProcessCell` and
:class:`isf_cell.run.graph_cell.GraphCell` are the cells.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from isf_core.contour import Contour, ContourCorrection, ContourResult
from isf_core.errors import IsfError
from isf_core.files.job import JobFile

from isf_cell.options import RunOptions
from isf_cell.run.checkpoint import Checkpoint
from isf_cell.run.part_step import PartStep


@dataclass(frozen=True)
class PartGoal:
    """What is to be formed.

    Attributes
    ----------
    first_index : > 0 goes on with a part whose first contours are formed
    resume : its checkpoint; None: what was formed before is not known
    """

    job_file: JobFile
    options: RunOptions
    first_index: int = 0
    resume: Checkpoint | None = None

    @classmethod
    def resumed(cls, checkpoint: Checkpoint) -> PartGoal:
        """The rest of a part; raises IsfError of the job."""
        return cls(checkpoint.job_file, checkpoint.options, checkpoint.next_index, checkpoint)

    @property
    def method(self) -> str:
        """Springback method of the run."""
        return self.options.method(self.job_file)


@dataclass(frozen=True)
class PlannedPart:
    """A plan, how many contours it has, after which of them (from 1) the part waits for ``executive/go_on``, and what
    the planner warns of."""

    plan_id: str
    count: int
    hold_after: tuple[int, ...] = ()
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True)
class FormedContour:
    """A contour as planned, its correction where it is known, and what happened."""

    nominal: Contour
    correction: ContourCorrection | None
    result: ContourResult


class Cell(Protocol):
    """Every method blocks until it is done, and raises IsfError when it cannot be."""

    def bring_up(self) -> None:
        """Make everything that takes part ready to work."""

    def reset(self, goal: PartGoal) -> None:
        """A fresh blank in the clamp, or for ``first_index`` > 0 the one that is there, a simulated one as it was kept;
        faults are cleared."""

    def tare(self) -> None:
        """Set the load cells to zero."""

    def plan(self, goal: PartGoal) -> PlannedPart:
        """Plan the contours."""

    def arm(self, goal: PartGoal, planned: PlannedPart) -> None:
        """Tell springback and force control what comes; from here on the tools may move."""

    def form_contour(self, index: int) -> FormedContour:
        """Correct and form contour ``index``; a contour that ends early has the code in its result."""

    def lift(self, formed: FormedContour) -> None:
        """Lift the tool off the sheet after ``formed``, for springback. A lift that fails does not end the part."""

    def scan(self, formed: FormedContour, *, aside: bool) -> None:
        """Measure the shape after ``formed``, the tools ``aside`` or where they are. One that fails does not end the
        part."""

    def check(self) -> None:
        """Raise IsfError for what went wrong between two contours."""

    def torn(self) -> IsfError | None:
        """Why the part is lost when the machine told that its sheet tore."""

    def explain(self, error: IsfError) -> IsfError:
        """The cause behind ``error``, where the cell knows one; never raises."""

    def stop(self, error: IsfError) -> None:
        """Bring tools and machine to rest after ``error``; never raises."""

    def finish(self) -> None:
        """Measure the part in its clamp and take the cell down; never raises."""


PLAN_WARNING = "planned, with a warning: "
"""How an operator behind the action is told, as a phase, what the planner warns of."""


class Operator(Protocol):
    """Who watches the part and may stop it."""

    def phase(self, text: str, index: int = 0, count: int = 0) -> None:
        """What is being done."""

    def warned(self, text: str) -> None:
        """The planner has something to look at before the part is formed."""

    def formed(self, step: PartStep) -> None:
        """A contour was formed."""

    def cancelled(self) -> bool:
        """True when the part is to end after this contour."""

    def paused(self) -> bool:
        """True while no further contour is to begin."""
