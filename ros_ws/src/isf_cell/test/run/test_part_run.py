"""The sequence of a part over a third cell, scripted: what is asked of it in which order, and how a part ends early."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import pytest
from isf_cell.options import RunOptions
from isf_cell.run.cell import FormedContour, PartGoal, PlannedPart
from isf_cell.run.checkpoint import Checkpoint
from isf_cell.run.part_run import PartRun
from isf_cell.run.part_step import PartStep
from isf_core.contour import Contour, ContourResult
from isf_core.errors import ErrorCode, IsfError
from isf_planner import plan
from quick_cone import CONTOURS_OF_LONGER as CONTOURS
from quick_cone import LONGER, quick_cone
from springback_parts import result_of

BEGIN = ["bring_up", "reset", "tare", "plan", "arm"]

MEASURED = "method: fused\n  lift_every: 2\n  scan_every: 3\n  scan_clear: true"


@pytest.fixture(scope="module")
def contours() -> tuple[Contour, ...]:
    return plan(quick_cone("method: none", step=LONGER)).contours


@dataclass
class ScriptedCell:
    """Does nothing and notes what it was asked; ``failing`` is what raises or, for a contour, does not complete."""

    contours: tuple[Contour, ...]
    failing: dict[str, ErrorCode] = field(default_factory=dict)
    broken: str = ""
    """What meets a fault of this software."""
    cause: ErrorCode | None = None
    asked: list[str] = field(default_factory=list)

    def _note(self, what: str) -> None:
        self.asked.append(what)
        if what == self.broken:
            raise ValueError("9001 is not a valid something")
        if what in self.failing:
            raise IsfError(self.failing[what], f"{what} failed")

    def bring_up(self) -> None:
        self._note("bring_up")

    def reset(self, goal: PartGoal) -> None:
        self._note("reset" if goal.first_index == 0 else "reset without a new blank")

    def tare(self) -> None:
        self._note("tare")

    def plan(self, goal: PartGoal) -> PlannedPart:
        self._note("plan")
        return PlannedPart("cone-1", len(self.contours), warnings=("thin at (0, 0, -5) mm",))

    def arm(self, goal: PartGoal, planned: PlannedPart) -> None:
        self._note("arm")

    def form_contour(self, index: int) -> FormedContour:
        name = f"contour {index}"
        self.asked.append(name)
        code = self.failing.get(name, ErrorCode.OK)
        return FormedContour(self.contours[index], None, _result(self.contours[index], code))

    def lift(self, formed: FormedContour) -> None:
        self._note(f"lift {formed.nominal.index}")

    def scan(self, formed: FormedContour, *, aside: bool) -> None:
        self._note(f"scan {formed.nominal.index}" + (" aside" if aside else ""))

    def check(self) -> None:
        if "check" in self.failing:
            raise IsfError(self.failing["check"], "check failed")

    def torn(self) -> IsfError | None:
        return IsfError(ErrorCode.SHEET_TORN, "torn") if "torn" in self.failing and len(self.asked) > 7 else None

    def explain(self, error: IsfError) -> IsfError:
        return error if self.cause is None else IsfError(self.cause, "the cause", advice=error.message)

    def stop(self, error: IsfError) -> None:
        self.asked.append(f"stop {error.code.name}")

    def finish(self) -> None:
        self.asked.append("finish")


@dataclass
class NotingKeeper:
    """Notes before which contour the part was kept."""

    kept: list[int] = field(default_factory=list)
    lost: list[str] = field(default_factory=list)

    def begin(self, goal: PartGoal) -> None:
        assert not self.kept

    def keep(
        self, goal: PartGoal, planned: PlannedPart, next_index: int, results: Sequence[ContourResult], lost: str = ""
    ) -> None:
        assert [result.index for result in results] == list(range(goal.first_index, next_index))
        self.kept.append(next_index)
        self.lost += [lost] if lost else []


@dataclass
class Watching:
    """An operator who cancels after ``patience`` contours, and looks at pauses ``pauses`` times."""

    patience: int = 1000
    pauses: int = 0
    steps: list[PartStep] = field(default_factory=list)
    phases: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)

    def warned(self, text: str) -> None:
        self.warnings.append(text)

    def phase(self, text: str, index: int = 0, count: int = 0) -> None:
        self.phases.append(text)

    def formed(self, step: PartStep) -> None:
        self.steps.append(step)

    def cancelled(self) -> bool:
        return len(self.steps) >= self.patience

    def paused(self) -> bool:
        self.pauses -= 1
        return self.pauses >= 0


def _result(contour: Contour, code: ErrorCode) -> ContourResult:
    complete = result_of(contour, 500.0)
    return complete if code is ErrorCode.OK else replace(complete, completed=False, code=int(code), message="it failed")


def _run(cell: ScriptedCell, operator: Watching, springback: str = "method: none", **more: object) -> IsfError | None:
    keeper = more.pop("keeper", None)
    goal = replace(PartGoal(quick_cone(springback, step=LONGER), RunOptions()), **more)  # type: ignore[arg-type]
    return PartRun(cell, goal, operator, keeper).run()  # type: ignore[arg-type]


def test_the_whole_part(contours: tuple[Contour, ...]) -> None:
    cell, operator, keeper = ScriptedCell(contours), Watching(), NotingKeeper()
    assert _run(cell, operator, keeper=keeper) is None
    assert cell.asked == [*BEGIN, *(f"contour {k}" for k in range(CONTOURS)), "finish"]
    assert [step.index for step in operator.steps] == list(range(CONTOURS))
    assert operator.warnings == ["thin at (0, 0, -5) mm"]
    assert keeper.kept == list(range(1, CONTOURS + 1))


def test_a_torn_part_ends_after_the_contour(contours: tuple[Contour, ...]) -> None:
    cell, operator = ScriptedCell(contours, {"torn": ErrorCode.SHEET_TORN}), Watching()
    keeper = NotingKeeper()
    error = _run(cell, operator, keeper=keeper)
    assert keeper.lost == ["torn"]
    assert error is not None
    assert error.code is ErrorCode.SHEET_TORN
    assert cell.asked == [*BEGIN, "contour 0", "contour 1", "contour 2", "stop SHEET_TORN", "finish"]
    assert [step.index for step in operator.steps] == [0, 1, 2]


def test_lifts_and_scans_come_when_the_job_asks_for_them(contours: tuple[Contour, ...]) -> None:
    cell = ScriptedCell(contours)
    assert _run(cell, Watching(), MEASURED) is None
    first, then = ["contour 0", "lift 0", "contour 1", "lift 1"], ["contour 2", "scan 2 aside", "contour 3", "lift 3"]
    assert cell.asked == [*BEGIN, *first, *then, "contour 4", "finish"]


@pytest.mark.parametrize("step", [*BEGIN, "contour 2", "lift 1", "scan 2 aside", "check"])
def test_a_step_that_fails_ends_the_part_at_rest(contours: tuple[Contour, ...], step: str) -> None:
    cell = ScriptedCell(contours, {step: ErrorCode.FORCE_LIMIT})
    failed = _run(cell, Watching(), MEASURED)
    assert failed is not None
    assert failed.code is ErrorCode.FORCE_LIMIT
    assert cell.asked[-2:] == ["stop FORCE_LIMIT", "finish"]
    if step != "check":
        assert cell.asked[-3] == step


@pytest.mark.parametrize("step", ["tare", "arm", "lift 1"])
def test_a_fault_of_this_software_ends_the_part_at_rest_too(contours: tuple[Contour, ...], step: str) -> None:
    cell = ScriptedCell(contours, broken=step)
    failed = _run(cell, Watching(), MEASURED)
    assert failed is not None
    assert failed.code is ErrorCode.INTERNAL
    assert "9001" in failed.what
    assert cell.asked[-3:] == [step, "stop INTERNAL", "finish"]


def test_what_lies_behind_a_failure_is_reported(contours: tuple[Contour, ...]) -> None:
    cell = ScriptedCell(contours, {"contour 1": ErrorCode.WRENCH_LOST}, cause=ErrorCode.NODE_DIED)
    failed = _run(cell, Watching())
    assert failed is not None
    assert (failed.code, failed.what) == (ErrorCode.NODE_DIED, "the cause")
    assert "it failed" in failed.advice
    assert cell.asked[-2:] == ["stop WRENCH_LOST", "finish"]  # stopped before the cause is looked for


def test_cancelled_after_two_contours_no_lift_follows(contours: tuple[Contour, ...]) -> None:
    cell = ScriptedCell(contours)
    failed = _run(cell, Watching(patience=2), "method: fused\n  lift_every: 2")
    assert failed is not None
    assert failed.code is ErrorCode.CANCELLED
    assert cell.asked == [*BEGIN, "contour 0", "lift 0", "contour 1", "stop CANCELLED", "finish"]


def test_cancelled_when_all_is_formed_the_part_is_complete(contours: tuple[Contour, ...]) -> None:
    assert _run(ScriptedCell(contours), Watching(patience=CONTOURS)) is None


def test_a_pause_ends(contours: tuple[Contour, ...]) -> None:
    cell, operator = ScriptedCell(contours), Watching(pauses=3)
    assert _run(cell, operator) is None
    assert operator.phases.count("paused") == 1
    assert len(operator.steps) == CONTOURS


def test_a_pause_is_watched(contours: tuple[Contour, ...]) -> None:
    failed = _run(ScriptedCell(contours, {"check": ErrorCode.NODE_DIED}), Watching(pauses=10**9))
    assert failed is not None
    assert failed.code is ErrorCode.NODE_DIED


def test_a_part_goes_on_where_it_was(contours: tuple[Contour, ...]) -> None:
    cell = ScriptedCell(contours)
    assert _run(cell, Watching(), first_index=3) is None
    assert cell.asked == [
        "bring_up",
        "reset without a new blank",
        "tare",
        "plan",
        "arm",
        "contour 3",
        "contour 4",
        "finish",
    ]


def test_a_corrected_part_goes_on_from_its_checkpoint(contours: tuple[Contour, ...]) -> None:
    cell, keeper = ScriptedCell(contours), NotingKeeper()
    assert _run(cell, Watching(), "method: analytic", first_index=3, resume=_checkpoint(), keeper=keeper) is None
    assert cell.asked[-3:] == ["contour 3", "contour 4", "finish"]
    assert keeper.kept == [4, 5]


@pytest.mark.parametrize("other", [{"plan_id": "cone-2"}, {"count": CONTOURS + 1}])
def test_a_part_does_not_go_on_with_another_plan(contours: tuple[Contour, ...], other: dict[str, object]) -> None:
    cell = ScriptedCell(contours)
    failed = _run(cell, Watching(), first_index=3, resume=replace(_checkpoint(), **other))  # type: ignore[arg-type]
    assert failed is not None
    assert failed.code is ErrorCode.CHECKPOINT_UNUSABLE
    assert cell.asked[-3:] == ["plan", "stop CHECKPOINT_UNUSABLE", "finish"]


def _checkpoint() -> Checkpoint:
    job_file = quick_cone("method: analytic", step=LONGER)
    job = (job_file.job.name, job_file.text, str(job_file.base))
    return Checkpoint(*job, "analytic", None, 0, 0, "fast", "cone-1", CONTOURS, 3)


def test_a_corrected_part_does_not_go_on_without(contours: tuple[Contour, ...]) -> None:
    cell = ScriptedCell(contours)
    failed = _run(cell, Watching(), "method: analytic", first_index=3)
    assert failed is not None
    assert failed.code is ErrorCode.CORRECTION_FAILED
    assert cell.asked == ["stop CORRECTION_FAILED", "finish"]


def test_a_method_that_does_not_exist_is_refused_before_the_plan(contours: tuple[Contour, ...]) -> None:
    cell = ScriptedCell(contours)
    goal = PartGoal(quick_cone(), RunOptions(correction="constnat"))
    failed = PartRun(cell, goal, Watching()).run()
    assert failed is not None
    assert (failed.code, failed.where) == (ErrorCode.METHOD_UNKNOWN, "--correction")
    assert cell.asked == ["bring_up", "stop METHOD_UNKNOWN", "finish"]
