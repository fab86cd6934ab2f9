"""A whole replay: what was recorded, what was decided again, and what the part would have become; as numbers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from isf_analysis.measures import deviation
from isf_analysis.measures.force_metrics import force_metrics
from isf_analysis.measures.record import PartRecord
from isf_core.contour import ContourCorrection, ContourResult, contour_label
from isf_core.errors import ErrorCode, IsfError
from isf_core.types import Array, Mask

from isf_cell.replay.correction_replay import lifted_after, replay_corrections
from isf_cell.replay.differences import Difference, difference
from isf_cell.replay.force_replay import ForceReplay, replay_force
from isf_cell.replay.recorded_run import Armed, RecordedRun, Ticks
from isf_cell.replay.replant import change_at, check_simulated, form_again, form_from, recorded_config
from isf_cell.replay.what_if import WhatIf
from isf_cell.run.part_step import PartStep

LOCKSTEP = "bit for bit"
BY_CLOCK = "by time of receipt"
BY_PLANT = "bit for bit, the part formed again"

Indexed = TypeVar("Indexed", ContourResult, ContourCorrection)


@dataclass(frozen=True)
class Replay:
    """Outcome; what could not be done is None.

    Attributes
    ----------
    force : answers of force control ; corrections : of the springback method ; again : the part formed again
    notes : for people
    start : contour, from 0, that is the first with the changes, where the contours before it are without; None: all
        have them
    """

    run: RecordedRun
    what_if: WhatIf
    force: ForceReplay | None
    corrections: tuple[ContourCorrection, ...] | None
    again: PartRecord | None
    notes: tuple[str, ...]
    start: int | None = None

    @property
    def how(self) -> str:
        """How decisions were compared; empty: not at all."""
        if self.force is not None and self.run.ticks is not None:
            return LOCKSTEP if self.run.ticks.exact else BY_CLOCK
        return BY_PLANT if self.again is not None else ""

    @property
    def identical(self) -> bool | None:
        """True when every decision is the recorded one; None where that cannot be known, since some are not in the bag
        and all others are the same."""
        if self._not_comparable:
            return None
        parts = [part for part in (self.results, self.corrected) if part is not None]
        same = all(part.identical for part in parts)
        if self.how == LOCKSTEP:
            if not same or self.force is None or self.force.unfed or self.target_distance.any():
                return False
            return None if self.lost_targets else True
        if any(part.differing for part in parts):
            return False
        if self.run.incomplete or self._shape_not_recorded:
            return None
        return same and self._same_shape()

    @property
    def identical_unknown(self) -> str:
        """Why :attr:`identical` is None; empty: it is not."""
        if self.identical is not None:
            return ""
        lacking = "the formed shape is not in the bag" if self._shape_not_recorded else ""
        return (
            self._not_comparable or self.run.incomplete or lacking or f"{self.lost_targets} targets are not in the bag"
        )

    @property
    def _shape_not_recorded(self) -> bool:
        return self.run.part.scan is None and self.again is not None and self.again.scan is not None

    @property
    def _not_comparable(self) -> str:
        """Why the record says nothing of a whole decided again bit by bit; empty: it does."""
        if self.how == "":
            return "nothing was decided again"
        if self.run.by_clock:
            return "formed by the clock: which wrench a tick used is not recorded"
        if self.run.retuned:
            return f"set while the part was formed: {', '.join(self.run.retuned)}"
        return "the wrenches of some ticks are not in the bag" if self.how == LOCKSTEP and self.missing else ""

    @property
    def span(self) -> range | None:
        """Contours, from 0, from :attr:`start` on that record and part formed again both have; None without a start."""
        if self.start is None or self.again is None:
            return None
        ends = [found.results[-1].index + 1 for found in (self.run.part, self.again) if found.results]
        return range(self.start, min(ends, default=0))

    @cached_property
    def before(self) -> Difference | None:
        """Of the contours before :attr:`start`, results and corrections together; None where there are none."""
        if not self.start or self.again is None:
            return None
        part, again, start = self.run.part, self.again, self.start
        results = difference(_up_to(part.results, start), _up_to(again.results, start))
        corrections = difference(_up_to(part.corrections, start), _up_to(again.corrections, start))
        firsts = [found.first for found in (results, corrections) if found.first is not None]
        differing = {**results.differing, **{f"correction.{k}": v for k, v in corrections.differing.items()}}
        missing = max(results.missing, corrections.missing)
        return Difference(results.compared, differing, min(firsts, default=None), missing)

    @property
    def missing(self) -> int:
        """Recorded targets that were not replayed, since their wrenches are not in the bag."""
        return self.run.ticks.missing if self.run.ticks is not None else 0

    @cached_property
    def target_distance(self) -> Array:
        """(n,) m, of the farther tool, between every target that was answered and the recorded one; 0 where that one is
        not in the bag, infinite where the answer is no number."""
        ticks, force = self.run.ticks, self.force
        if ticks is None or force is None or not len(force.tick):
            return np.empty(0)
        away = (force.target - ticks.target[force.tick]).reshape(-1, 2, 3)
        distance = np.linalg.norm(away, axis=2).max(axis=1)
        distance[~np.isfinite(force.target).all(axis=1)] = np.inf
        distance[_lost(ticks, force)] = 0.0
        return np.asarray(distance)

    @cached_property
    def lost_targets(self) -> int:
        """Ticks that were fed, whose recorded targets are not in the bag."""
        ticks, force = self.run.ticks, self.force
        return int(_lost(ticks, force).sum()) if ticks is not None and force is not None else 0

    @cached_property
    def results(self) -> Difference | None:
        """Of the results of contours."""
        if self.force is not None:
            return difference(self.run.part.results, self.force.results)
        return difference(self.run.part.results, self.again.results) if self.again is not None else None

    @cached_property
    def corrected(self) -> Difference | None:
        """Of the corrections."""
        found = self.corrections
        if found is None and self.force is None and self.again is not None:
            found = self.again.corrections
        return difference(self.run.part.corrections, found) if found is not None else None

    @cached_property
    def moved(self) -> Array:
        """(C, 3), contour, and largest distance, m, of forming and support tip from the recorded targets at the same
        points of it; NaN without a support tool."""
        before = {result.index: result for result in self.run.part.results}
        rows = []
        for result in self.force.results if self.force is not None else ():
            recorded = before[result.index]
            pairs = (
                (recorded.forming_target, result.forming_target),
                (recorded.support_target, result.support_target),
            )
            rows.append([float(result.index), *(_farthest(one, other) for one, other in pairs)])
        return np.array(rows, dtype=np.float64).reshape(-1, 3)

    def _same_shape(self) -> bool:
        one, other = self.run.part.scan, self.again.scan if self.again is not None else None
        if one is None or other is None:
            return one is other
        return bool(np.array_equal(one.z, other.z, equal_nan=True))

    def numbers(self) -> dict[str, Any]:
        """For ``--json``; lengths in mm or um, forces in N."""
        part, distance = self.run.part, self.target_distance
        data: dict[str, Any] = {
            "bag": str(self.run.path),
            "job": part.job_name,
            "what_if": dict(self.what_if.given),
            "from": None if self.start is None else self.start + 1,
            "identical": self.identical,
            "identical_unknown": self.identical_unknown or None,
            "before": _of_difference(self.before),
            "compared": {"how": self.how, "contours": len(part.results)},
            "targets": None,
            "moved": None,
            "results": _of_difference(self.results),
            "corrections": _of_difference(self.corrected),
            "prediction": None,
            "notes": list(self.notes),
        }
        if self.force is not None:
            differing = distance > 0.0
            first = int(self.force.contour[np.argmax(differing)]) if differing.any() else None
            data["targets"] = {
                "compared": len(distance) - self.lost_targets,
                "differing": int(differing.sum()),
                "not_replayed": self.force.unfed + self.missing,
                "largest_um": 1e6 * float(distance.max(initial=0.0)),
                "rms_um": 1e6 * float(np.sqrt(np.mean(distance**2))) if len(distance) else None,
                "first_contour": first,
            }
            away = 1e6 * self.moved
            data["moved"] = {
                "forming_tip_largest_um": _largest(away[:, 1]),
                "support_tip_largest_um": _largest(away[:, 2]),
                "contours": len(away),
            }
        if self.corrections is not None:
            data["corrections"]["largest_mm"] = 1e3 * largest_change(part.corrections, self.corrections)
        if self.again is not None and (self.what_if or self.force is not None or self.start is not None):
            span = self.span
            data["prediction"] = {"recorded": part_numbers(part, span), "what_if": part_numbers(self.again, span)}
        return data


def replay(
    run: RecordedRun,
    what_if: WhatIf,
    *,
    base: Path | None = None,
    replant: bool | None = None,
    start: int | None = None,
    phase: Callable[[str], None] = lambda _: None,
    formed: Callable[[PartStep], None] | None = None,
) -> Replay:
    """Replay ``run`` with the changes ``what_if``.

    ``replant`` : form the part again on the simulated machine; None: where it is simulated, its sheet is the fast one,
    and there is a change to try or nothing else to compare. ``base`` : folder that the job's paths refer to.
    ``start`` : contour, from 0, that is the first with the changes: the part is formed again, and that is the whole
    answer.

    Raises
    ------
    IsfError : the job, its rig or its material cannot be used; a change, or ``start``, is refused
    """
    part = run.part
    notes = list(part.notes)
    if start is not None:
        _check_start(run, start, replant)
        return _from_contour(run, what_if, base, start, phase, formed)
    if run.retuned:
        notes.append(
            f"set while the part was formed: {', '.join(run.retuned)}; it is replayed with what it was armed with"
        )
    fast = run.simulated and part.sheet.get("model", "fast") == "fast"
    wanted = fast and (bool(what_if) or run.ticks is None) if replant is None else replant
    if replant is None and not wanted and run.simulated and what_if:
        notes.append("the part was not formed again: its elasto-plastic sheet takes minutes; --replant does it")
    job_file = run.job_file(base, what_if.job_text(part.job_text))
    config = what_if.control(recorded_config(run, base, job_file))

    def count(what: str) -> Callable[[int, int], None]:
        return lambda done, of: phase(f"{what}: contour {done} of {of}")

    force = None
    if what_if.changes_set_point:
        notes.append(
            "with another set-point the recorded forces are an error that never goes away: what force control would do "
            "with them says nothing"
        )
    elif run.ticks is not None and part.corrected:
        armed = run.armed or _armed(run.ticks, part, config)
        if run.armed is None:
            notes.append("recorded without force_ctrl/armed: parameters of force control are those of the job")
        phase("force control")
        force = replay_force(
            run.ticks, armed, part.corrected, part.results, job_file, config, lifted_after(run), count("force control")
        )
        notes += force.notes
        lost = int(_lost(run.ticks, force).sum())
        if lost:
            notes.append(
                f"the recorder lost the targets of {lost} ticks: what was decided there is compared with nothing"
            )
        if run.ticks.exact and run.ticks.missing:
            notes.append(
                f"the wrenches of {run.ticks.missing} ticks are not in the bag: what was decided after them cannot be "
                "compared bit by bit"
            )
        if not run.ticks.exact:
            notes.append(
                "formed by the clock: which wrench a tick used is not recorded, so nothing is the same bit by bit"
            )
    corrections = None
    if run.ticks is not None and part.corrections:
        phase("springback")
        method = what_if.method or part.correction
        corrections = replay_corrections(run, job_file, method, count("springback"))
    if run.ticks is None and not wanted:
        notes.append(
            "the bag has no wrenches or no target poses of both tools (of output:=twist there are velocities instead): "
            "force control is not replayed"
        )
    again = None
    if wanted:
        phase("forming the part again")
        again = form_again(run, what_if, base, progress=formed)
        notes += _ended_early(run, again)
    return Replay(run, what_if, force, corrections, again, tuple(dict.fromkeys(notes)))


def _check_start(run: RecordedRun, start: int, replant: bool | None) -> None:
    """Raise IsfError FILE_FIELD, BAG_INCOMPLETE when the part cannot be formed again with changes before contour
    ``start``."""
    where = f"--from {start + 1}"
    if replant is False:
        raise IsfError(
            ErrorCode.FILE_FIELD,
            "from a contour on a part is formed again, which --no-replant leaves out",
            where=where,
            advice="leave out --no-replant, or --from",
        )
    check_simulated(run, "--from")
    recorded = [result.index for result in run.part.results]
    if not recorded:
        raise IsfError(
            ErrorCode.BAG_INCOMPLETE,
            "no contour is recorded as formed",
            where=str(run.path),
            advice="a run of which at least one contour was formed",
        )
    if not 0 <= start <= recorded[-1]:
        of = f"contours 1 to {recorded[-1] + 1}"
        what = f"the record holds {of}" if not run.incomplete else f"the record holds {of} so far: {run.incomplete}"
        raise IsfError(ErrorCode.FILE_FIELD, what, where=where, advice=f"--from 1 to {recorded[-1] + 1}")


def _from_contour(
    run: RecordedRun,
    what_if: WhatIf,
    base: Path | None,
    start: int,
    phase: Callable[[str], None],
    formed: Callable[[PartStep], None] | None,
) -> Replay:
    """The part formed again with the changes before contour ``start``."""

    def step(done: PartStep) -> None:
        if formed is not None:
            formed(done)
        if done.index + 1 == start:
            phase(f"from {contour_label(start)} on{' with the changes' if what_if else ' as recorded'}")

    change = change_at(run, what_if, base, start)
    phase(f"forming contours 1 to {start} again as recorded" if start else "forming the part again")
    again = form_from(run, change, base, progress=step)
    notes = (*run.part.notes, *_ended_early(run, again))
    return Replay(run, what_if, None, None, again, tuple(dict.fromkeys(notes)), start)


def _ended_early(run: RecordedRun, again: PartRecord) -> list[str]:
    """What ended the part that was formed again before its end, where it did not end the recorded one."""
    failure, recorded = again.failure(), run.part.failure()
    if failure is None or (recorded is not None and (failure[0], again.formed) == (recorded[0], run.part.formed)):
        return []
    return [f"formed again it ended early, {again.formed} of {again.planned} contours: {failure[1]}"]


def _up_to(items: Sequence[Indexed], start: int) -> list[Indexed]:
    return [item for item in items if item.index < start]


def _lost(ticks: Ticks, force: ForceReplay) -> Mask:
    """(n,) True for ticks that were fed, whose recorded targets are not in the bag."""
    return np.asarray(np.isnan(ticks.target[force.tick]).any(axis=1))


def _armed(ticks: Ticks, part: PartRecord, config: Any) -> Armed:
    """Of a bag that does not tell: the tools where the machine reported them first."""
    tips = []
    for tool in (1, 2):
        of_tool = ticks.pose[ticks.pose[:, 0] == tool]
        sign = 1.0 if tool == 1 else -1.0
        tips.append(tuple(of_tool[0, 1:].tolist()) if len(of_tool) else (0.0, 0.0, sign * config.park_height))
    first = part.nominal[0].index if part.nominal else 0
    return Armed(config, first, part.planned, tips[0], tips[1], None)


def part_numbers(part: PartRecord, span: range | None = None) -> dict[str, Any]:
    """Force and time of the contours in ``span`` (from 0; None: all), shape of the whole part."""
    results = tuple(result for result in part.results if span is None or result.index in span)
    force = force_metrics(results, part.control_rate)
    data: dict[str, Any] = {
        "contours": sum(result.completed for result in results),
        "force_error_rms_N": force.rms_error if force else None,
        "force_error_max_N": force.max_abs_error if force else None,
        "within_10N_fraction": force.within_band if force else None,
        "contact_fraction": force.contact_fraction if force else None,
        "forming_time_s": results[-1].end - results[0].start if results else None,
        "backoffs": sum(result.backoffs for result in results),
        "events": len(part.events),
        "error_mean_mm": None,
        "error_max_mm": None,
        "within_tolerance_fraction": None,
        "within_0_3mm_fraction": None,
    }
    if part.scan is not None and part.target is not None:
        try:
            shape = deviation.compare(part.scan, part.target)
        except IsfError:  # nothing in common, or nothing formed
            return data
        data["error_mean_mm"] = 1e3 * shape.whole.mean_abs
        data["error_max_mm"] = 1e3 * shape.whole.max_abs
        data["within_tolerance_fraction"] = shape.within(part.tolerance.shape)
        data["within_0_3mm_fraction"] = shape.within(deviation.BANDS[-1])
    return data


def largest_change(recorded: tuple[ContourCorrection, ...], again: tuple[ContourCorrection, ...]) -> float:
    """m, by which a correction differs most from the recorded one."""
    before = {item.index: item for item in recorded}
    sizes = [
        float(np.linalg.norm(item.offset - before[item.index].offset, axis=1).max(initial=0.0))
        for item in again
        if item.index in before and item.offset.shape == before[item.index].offset.shape
    ]
    return max(sizes, default=0.0)


def _farthest(one: Array, other: Array) -> float:
    if one.shape != other.shape or not len(one):
        return float("nan")
    return _largest(np.linalg.norm(one - other, axis=1))


def _largest(values: Array) -> float:
    known = values[np.isfinite(values)]
    return float(known.max()) if len(known) else float("nan")


def _of_difference(found: Difference | None) -> dict[str, Any] | None:
    if found is None:
        return None
    return {
        "compared": found.compared,
        "differing_fields": found.differing,
        "first_contour": found.first,
        "in_one_alone": found.missing,
    }
