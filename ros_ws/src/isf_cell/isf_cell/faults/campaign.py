"""A fault campaign: every kind of fault at random times in real cells, judged, and what was formed gone on with."""

from __future__ import annotations

import json
import math
import random
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from isf_analysis.measures.scan_cloud import height_map_of
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile
from isf_core.types import Array

from isf_cell.faults import judge
from isf_cell.faults.command_cell import CommandCell
from isf_cell.faults.fault_cell import FaultCell
from isf_cell.faults.kinds import KINDS, FaultKind
from isf_cell.faults.part import JOB_FILE, write_part
from isf_cell.run.checkpoint import CheckpointFolder

CASES_FILE = "cases.jsonl"
"""In the folder of a campaign: a line per fault, from which a campaign that was stopped goes on."""

OBSERVED = 6.0
"""s of wall time for which the tools are watched after a fault: they have to be free within RELEASED."""

RELEASED, HELD, OVER_LIMIT, SHAPE = 5.0, 0.05, 1.1, 0.02e-3
"""Goals: s until no tool carries a force, s until the forming tool stands or force control brakes it, share of the
force limit, m by which a part that went on or was resumed in lockstep may differ from the undisturbed one."""

BRAKING = 0.25
"""m/s^2, with which force control brakes: half of its parameter acceleration."""

SEAM = 0.5e-3
"""m, the same by the clock, where a part begins the interrupted contour from the air and no two parts are alike."""

SCANNED = 2.0
"""s of wall time after a part within which its scan comes."""

WITHIN = 0.1, 0.45
"""Of the duration of a contour, in which the fault comes: the last one ends with tools off the sheet."""

PRESSES = 100.0
"""N on the forming tool from which on a fault comes."""

BEGINS = 120.0
"""s for the contours before the fault."""

Report = Callable[[str], None]


@dataclass(frozen=True)
class Case:
    """One fault that was injected, and what came of it.

    Attributes
    ----------
    kind, number, seed : which one ; lockstep : else by the clock
    contour : in which (from 0) ; load : N on the forming tool at that moment
    code, said : of the part ; codes : all that the cell told
    went_on : the part was formed to its end all the same
    held : s until the forming tool stood, None: not to be judged: held_machine for altered messages of the machine,
        which come with its time, held_wall for all else ; reaction : s, held without the time in which force control
        brakes, where it did
    released : s of wall time until no tool carried a force, None: not to be judged or measured
    worst : largest force as a share of the limit, of the resumed part too
    right : the code is one of those that are right
    resumed : the rest was formed by resuming; None: nothing to resume ; resumed_with : its code
    known_after : s, as of its kind
    lost : results of contours that were complete and are neither in the checkpoint nor formed again
    difference : m, largest, of the finished shape from the undisturbed one; None: no finished part
    wrong_success : the part counted as formed and is not, or its record, or differs from the undisturbed one
    """

    kind: str
    number: int
    seed: int
    lockstep: bool
    contour: int = 0
    load: float = 0.0
    code: int = 0
    said: str = ""
    codes: tuple[int, ...] = ()
    went_on: bool = False
    held: float | None = None
    reaction: float | None = None
    held_machine: float | None = None
    held_wall: float | None = None
    released: float | None = None
    worst: float = 0.0
    right: bool = False
    resumed: bool | None = None
    lost: int = 0
    resumed_with: int = 0
    difference: float | None = None
    wrong_success: bool = False
    wall: float = 0.0
    known_after: float = 0.0

    @property
    def sound(self) -> bool:
        """It misses no goal but perhaps those of time, which a busy computer may miss."""
        return (
            self.right
            and not self.wrong_success
            and self.resumed is not False
            and not self.lost
            and self.worst <= OVER_LIMIT
        )

    @property
    def good(self) -> bool:
        """It misses no goal."""
        return (
            self.sound
            and (self.reaction is None or self.reaction <= self.known_after + HELD)
            and (self.released is None or self.released <= self.known_after + RELEASED)
        )


@dataclass(frozen=True)
class Undisturbed:
    """The part without a fault: ``length`` s of each contour, its ``shape`` (m), ``worst`` share of the force limit."""

    length: tuple[float, ...]
    shape: Array
    worst: float


@dataclass(frozen=True)
class Plan:
    """``kinds`` and how many ``faults`` there are of each, in ``folder``; ``resumed``: names of the kinds after which
    the part is gone on with, None: all."""

    folder: Path
    kinds: Sequence[FaultKind]
    faults: int
    seed: int
    resumed: frozenset[str] | None = None


def chosen(names: Sequence[str], *, short: bool) -> list[FaultKind]:
    """Kinds whose names begin with any of ``names`` (none: all); raises IsfError FILE_FIELD for one of no kind."""
    for name in names:
        if not any(kind.name.startswith(name) for kind in KINDS):
            raise IsfError(
                ErrorCode.FILE_FIELD,
                f"no kind of fault begins with '{name}'",
                where="--kinds",
                advice="known: " + ", ".join(kind.name for kind in KINDS),
            )
    if names:
        return [kind for kind in KINDS if kind.name.startswith(tuple(names))]
    return [kind for kind in KINDS if kind.short or not short]


def read_cases(folder: Path) -> list[Case]:
    """Cases of a campaign so far; a line that was being written when it was killed is left out."""
    path = folder / CASES_FILE
    cases = []
    for line in path.read_text(encoding="utf-8").splitlines() if path.exists() else ():
        try:
            cases.append(Case(**{**(data := json.loads(line)), "codes": tuple(data["codes"])}))
        except (ValueError, TypeError, KeyError):
            continue
    return cases


def run(plan: Plan, report: Report) -> Iterator[Case]:
    """The cases of ``plan`` that are not in its folder yet, each as soon as it is judged and written there.

    Raises IsfError where a cell cannot be brought up, CANCELLED for Ctrl-C.
    """
    job_file = write_part(plan.folder / "part")
    # the cases of another seed in the folder are other faults
    done = {(case.kind, case.number) for case in read_cases(plan.folder) if case.seed == plan.seed}
    whole: dict[bool, Undisturbed] = {}
    for place in ("lockstep", "clock", "command"):
        kinds = [kind for kind in plan.kinds if _place(kind) == place]
        waiting = [(n, k) for n in range(plan.faults) for k in kinds if (k.name, n) not in done]
        if place == "command":
            cases = _of_commands(plan, waiting, job_file, report, whole)
        else:
            cases = _of_cell(plan, waiting, job_file, report, whole, lockstep=place == "lockstep")
        for case in cases:
            with (plan.folder / CASES_FILE).open("a", encoding="utf-8") as file:
                file.write(json.dumps(asdict(case)) + "\n")
            yield case


def _place(kind: FaultKind) -> str:
    return "command" if kind.command else "lockstep" if kind.lockstep else "clock"


def _chance(plan: Plan, kind: FaultKind, number: int) -> random.Random:
    return random.Random(f"{plan.seed} {kind.name} {number}")


def _of_cell(
    plan: Plan,
    waiting: list[tuple[int, FaultKind]],
    job_file: JobFile,
    report: Report,
    whole: dict[bool, Undisturbed],
    *,
    lockstep: bool,
) -> Iterator[Case]:
    """In one cell for all, or in a new one after a fault that the cell did not come back from."""
    name = "lockstep" if lockstep else "clock"
    left = list(waiting)
    while left:
        with ExitStack() as stack:
            report(f"starting a cell ({name})")
            cell = stack.enter_context(FaultCell(_unused(plan.folder / name), job_file, lockstep=lockstep))
            if lockstep not in whole:
                report(f"forming the undisturbed part ({name})")
                whole[lockstep] = _undisturbed(cell)
            while left:
                number, kind = left.pop(0)
                report(f"{kind.name}, {number + 1}")
                yield _judged(plan, cell, kind, number, whole[lockstep])
                try:
                    cell.mend()
                except IsfError as error:
                    report(f"the cell does not come back, a new one is started: {error}")
                    break


def _unused(folder: Path) -> Path:
    number = 1
    while folder.with_name(f"{folder.name}_{number}").exists():
        number += 1
    return folder.with_name(f"{folder.name}_{number}")


def _undisturbed(cell: FaultCell | CommandCell) -> Undisturbed:
    cell.outside.forget()
    code, said, _ = cell.form()
    if code:
        raise IsfError(ErrorCode(code), f"the part without a fault was not formed: {said}")
    shape = _shape(cell)
    results = sorted(cell.outside.results, key=lambda result: result.index)
    length = tuple(_seconds(result.end) - _seconds(result.start) for result in results)
    if shape is None or not length:
        raise IsfError(ErrorCode.SCAN_MISSING, "the campaign did not see the undisturbed part")
    return Undisturbed(length, shape, _worst(cell))


def _judged(plan: Plan, cell: FaultCell | CommandCell, kind: FaultKind, number: int, whole: Undisturbed) -> Case:
    chance = _chance(plan, kind, number)
    begun = time.monotonic()
    recorded = cell if kind.recorder and isinstance(cell, FaultCell) else None
    if recorded is not None:
        recorded.begin_record()
    outside = cell.outside
    outside.forget()
    contour = chance.randrange(1, len(whole.length))
    injection = _Injection(cell, kind, contour, chance.uniform(*WITHIN) * whole.length[contour], chance)
    injection.start()
    code, said, contours = cell.form()
    if code == ErrorCode.CANCELLED and (ErrorCode.CANCELLED not in kind.right or not injection.wall):
        raise IsfError(ErrorCode.CANCELLED, "the campaign was stopped", advice="the same command goes on with it")
    injection.join()
    case = Case(kind.name, number, plan.seed, kind.lockstep, contour, injection.load, code, said)
    case = replace(case, known_after=kind.known_after)
    if not injection.wall:
        return replace(case, said=f"no fault was injected, the part ended before: {said}")
    went_on = code == 0
    if not went_on:
        outside.until(lambda: time.time_ns() - injection.wall > 1e9 * OBSERVED, OBSERVED)
    case = replace(case, went_on=went_on, codes=tuple(outside.codes), **_motion(cell, injection, judged=not went_on))
    case = _without_braking(case, cell, injection)
    shape = _shape(cell) if went_on else None
    seen = outside.formed
    cell.restore()
    record = recorded.end_record() if recorded is not None else None
    if went_on and record is not None:
        case = replace(case, code=int(record.code), said=record.message)
    if not went_on and (plan.resumed is None or kind.name in plan.resumed):
        if isinstance(cell, FaultCell):
            cell.mend()
        resumed, with_code, lost, shape = _resumed(cell, seen, len(whole.length))
        case = replace(case, resumed=resumed, resumed_with=with_code, lost=lost, worst=max(case.worst, _worst(cell)))
    if shape is not None:
        case = replace(case, difference=_difference(shape, whole.shape))
    differs = case.difference is not None and case.difference > (SHAPE if kind.lockstep else SEAM)
    right = ErrorCode(case.code) in kind.right
    incomplete = went_on and contours != len(whole.length)
    return replace(
        case,
        right=right,
        resumed=case.resumed and not differs,
        wrong_success=case.code == 0 and (incomplete or differs or not right),
        wall=time.monotonic() - begun,
    )


def _motion(cell: FaultCell | CommandCell, injection: _Injection, *, judged: bool) -> dict[str, Any]:
    """Fields of a case: largest force; where the part ended (``judged``) when the tools stood and were free."""
    outside = cell.outside
    forces = [outside.trace(f"tool_{k}/wrench") for k in (1, 2)]
    found: dict[str, Any] = {"worst": judge.worst(forces, _limit(cell))}
    if judged:
        stood = judge.held(outside.trace("tool_1/pose"), forces[0], stamp=injection.stamp, wall=injection.wall)
        free = judge.released(forces, wall=injection.wall)
        found["held_machine"], found["held_wall"] = float(stood.machine), float(stood.wall)
        found["released"] = None if math.isnan(free) else free
        found["held"] = found["held_machine" if injection.altered else "held_wall"]
        found["reaction"] = found["held"]
    return found


def _without_braking(case: Case, cell: FaultCell | CommandCell, injection: _Injection) -> Case:
    """``case`` with its reaction, where force control has told why it stopped."""
    if case.held is None or not any(code // 100 == 12 for code in (case.code, *case.codes)):
        return case
    pose = cell.outside.trace("tool_1/pose")
    speed = judge.speed(pose, stamp=injection.stamp, until=case.held_machine or 0.0)
    return replace(case, reaction=max(0.0, case.held - speed / BRAKING))


def _resumed(cell: FaultCell | CommandCell, seen: set[int], count: int) -> tuple[bool | None, int, int, Array | None]:
    """Form the rest: whether it was formed, with which code, results that are lost, the shape. ``seen``: contours
    complete before."""
    try:
        kept = CheckpointFolder(cell.checkpoint).read().next_index
    except IsfError as error:
        if error.code is ErrorCode.PART_FINISHED:
            return None, 0, 0, None
        return False, int(error.code), len(seen), None
    cell.outside.forget()
    code, _, _ = cell.form(resume=True)
    formed = {*range(kept), *cell.outside.formed}
    lost = len(seen - formed)
    if code:
        return False, code, lost, None
    return formed == set(range(count)), 0, lost, _shape(cell)


class _Injection(threading.Thread):
    """Waits for the moment in the part, does it, and undoes it in time.

    ``wall``, ``stamp``: ns, of the fault by this computer's clock and the machine's; 0: not done. ``load``: N.
    ``altered``: it was done to messages of the machine.
    """

    def __init__(
        self, cell: FaultCell | CommandCell, kind: FaultKind, contour: int, after: float, chance: random.Random
    ) -> None:
        super().__init__(daemon=True)
        self._cell, self._kind, self._contour, self._after, self._chance = cell, kind, contour, after, chance
        self.wall = self.stamp = 0
        self.load = 0.0
        self.altered = False

    def run(self) -> None:
        outside, kind = self._cell.outside, self._kind
        if not outside.until(lambda: self._contour - 1 in outside.formed, BEGINS):
            return
        begin = max(_nanoseconds(result.end) for result in outside.results)
        due = begin + round(1e9 * self._after)
        if not outside.until(lambda: outside.machine_time >= due and outside.load(1) > PRESSES, BEGINS):
            return
        self.load = outside.load(1)
        stamp, wall = outside.machine_time, time.time_ns()
        kind.inject(self._cell, self._chance)
        if self._cell.outside.altering:
            self.altered = outside.until(lambda: outside.altered is not None, 1.0)
            stamp, wall = outside.altered or (stamp, wall)
        self.stamp, self.wall = stamp, wall
        if kind.lasts is not None:
            outside.until(lambda: False, kind.lasts)
            self._cell.restore()


def _of_commands(
    plan: Plan,
    waiting: list[tuple[int, FaultKind]],
    job_file: JobFile,
    report: Report,
    whole: dict[bool, Undisturbed],
) -> Iterator[Case]:
    """Each with a cell of its own."""
    for number, kind in waiting:
        if True not in whole:
            report("forming the undisturbed part (isf form)")
            with CommandCell(_unused(plan.folder / "command"), job_file, job_file.base / JOB_FILE) as cell:
                whole[True] = _undisturbed(cell)
        report(f"{kind.name}, {number + 1}")
        with CommandCell(_unused(plan.folder / "command"), job_file, job_file.base / JOB_FILE) as cell:
            case = _judged(plan, cell, kind, number, whole[True])
            yield replace(case, said=f"{case.said}; nodes that did not end: {len(cell.left)}") if cell.left else case


def _limit(cell: FaultCell | CommandCell) -> Array:
    return np.asarray(cell.job_file.rig.limits.force, dtype=float)


def _worst(cell: FaultCell | CommandCell) -> float:
    return judge.worst([cell.outside.trace(f"tool_{k}/wrench") for k in (1, 2)], _limit(cell))


def _shape(cell: FaultCell | CommandCell) -> Array | None:
    """(n,) m, heights of the scan after the part, which may come later than the answer to who asked for the part."""
    outside = cell.outside
    outside.until(lambda: outside.scan is not None, SCANNED)
    scan = outside.scan
    return None if scan is None else np.asarray(height_map_of(scan, None).z).ravel()


def _difference(shape: Array, whole: Array) -> float:
    if shape.shape != whole.shape:
        return math.inf
    return float(np.nanmax(np.abs(shape - whole)))


def _seconds(time_message: Any) -> float:
    return float(time_message.sec + 1e-9 * time_message.nanosec)


def _nanoseconds(time_message: Any) -> int:
    return int(time_message.sec) * 1_000_000_000 + int(time_message.nanosec)
