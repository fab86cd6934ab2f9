"""``isf tryout``: parts formed on the elasto-plastic sheet until a correction is found, before any real sheet is.

1. The first part is formed with the method of the job, in every set-up that is to be tried: as the job says, with the
   support tool under the blank, over a plate near the opening, with other fields. The best set-up is gone on with;
   where none gets through, without a correction.
2. Probes: the same with 1 mm more push over a fifth of the depth each. What the shape of the whole part answers to
   them is its Jacobian: what a push at the opening does to the base is in it.
3. Steps of Gauss and Newton, the Jacobian brought up to date after each (Broyden 1965), with a ridge and bounds.
4. Passes of displacement adjustment place by place (:mod:`isf_springback.estimators.learning`), for what changes around
   the part; as long as they help.
5. Where the job scans between contours, the best part once more with these scans: what they showed goes into the plan,
   so that on a real sheet what scans show to be different is corrected.

With several variants of the plant all of this is for their errors together. The best part is the result; it is formed
once more on variants that had no say in it, with other cells and another tool speed (:data:`JUDGES`), which tells what
to expect of a sheet nobody knows.

Every part stays in the folder as a bag, so that a try-out that was stopped goes on where it was.
"""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import yaml
from isf_analysis.bag.bag_reader import read_bag
from isf_analysis.bag.bag_writer import write_bag
from isf_analysis.figures import style
from isf_analysis.measures.deviation import BANDS, Deviation, compare
from isf_analysis.measures.percent import percent
from isf_analysis.measures.record import PartRecord
from isf_core import __version__
from isf_core.contour import Contour, Process
from isf_core.errors import ErrorCode, IsfError
from isf_core.events import torn
from isf_core.files import yaml_file
from isf_core.files.job import Job, JobFile, correction_refusal, floor_rounds, floor_step, load_job
from isf_core.simulated_sheet import FORCE_TOO_HIGH, SEALED_VARIANTS, SheetKind, check_sheet, sheet_kind
from isf_core.types import Array
from isf_planner import planning
from isf_planner.checks.backing_plate import nearer_plate, plate_fields, plate_text
from isf_planner.part.meshes import Mesh
from isf_springback.estimators import learning
from isf_springback.estimators.learning import LEAST_PUSH, Learned, together
from isf_springback.loop_path import LARGEST_CORRECTION
from isf_springback.methods import check_method
from isf_springback.scan.feedback import contour_over_die
from scipy.optimize import lsq_linear

from isf_cell import in_process
from isf_cell.campaign.content import job_content
from isf_cell.commands import terminal
from isf_cell.commands.learn import learn_record
from isf_cell.commands.report import first_failure
from isf_cell.commands.run_folder import TRYOUT, TRYOUT_JOB, make_folder
from isf_cell.options import RunOptions
from isf_cell.processes.part_pool import formed_beside

CONTROL_RATE = 100.0
"""Hz, at most, of a part that is tried: shapes are those at 500 Hz within 0.01 mm (mini_cone), in half the time."""

PROBES, PROBED = 5, 1.0e-3
"""Bands of depth that are pushed by themselves, and m by which."""

RIDGE = 0.03
"""Weight of a step itself against what it mends, of the mean square of the Jacobian (assumed)."""

LONGEST_STEP = 3.0e-3
"""m of push that a step may change (assumed); half of it after one that made the part worse."""

SHORTEST_STEP = 1e-6
"""m of push below which a step is none: the same part would be formed again."""

RIM_WEIGHT = 0.5
"""Of the error in the rim, against that of wall and base (assumed)."""

DECIMATED = 3
"""Every how many cells of the target are looked at, along x and along y."""

ENOUGH = 0.95
"""Of the best error so far: a step that is not below it has not helped."""

IDLE_STEPS = 2
"""Steps in a row that have not helped, after which there are no more."""

JUDGES: dict[SheetKind, SheetKind] = {
    "fast": "shell_coarse",
    "shell_coarse": "shell",
    "shell": "shell_coarse",
    "shell_fine": "shell",
}
"""Sheet that the result of a try-out on another one is formed on to judge it, unless told otherwise."""

Scans = Literal["none", "exact", "as wanted"]
"""Between the contours of a part with a plan: none, those of the job without a scanner's errors, those of the job."""

ON_BLANK = {
    "path": {"support": "on_blank"},
    "control": {"support_force": None, "engage_depth": None},
    "springback": {"first_contour": None},
}
"""Change of a job with two tools that does not say where the support tool goes: on a sheet that yields it holds the
opening there, in place of a force. Fields that hold for the other way are left out."""

LEARNED = "learned"
"""Method by which a correction that was found is formed."""

FILES = frozenset(
    {
        "part.mesh",
        "part.accuracy_surfaces",
        "die.mesh",
        "path.program",
        "path.set_up",
        "path.machine_error",
        "springback.learning",
        "springback.elastic.database",
    }
)
"""Fields of a job that hold the name of a file, whatever it is called."""

FILES_OR_NAMES = frozenset({"rig", "sheet.material", "adsif.surface"})
"""Fields that hold the name of a file, or one from the library."""


@dataclass(frozen=True)
class Tryout:
    """What to try.

    Attributes
    ----------
    job : Path ; sheet : model that forms the parts ; steps : after the probes, at most
    variants : of the plant, which the correction is for ; checks : on which the best part is formed again
    seed : of sensor noise and variants ; jobs : parts at a time ; correction : of the first part; None: the job's
    alternatives : changes of the job, each as fields in YAML, which make one more set-up each
    check_sheet : model that forms the checks; None: that of JUDGES
    """

    job: Path
    sheet: SheetKind = "shell_coarse"
    steps: int = 6
    variants: tuple[int, ...] = (0,)
    checks: tuple[int, ...] = (21, 22)
    seed: int = 0
    jobs: int = 1
    correction: str | None = None
    alternatives: tuple[str, ...] = ()
    check_sheet: SheetKind | None = None

    @property
    def judge(self) -> SheetKind:
        """Sheet that the checks are formed on."""
        return self.check_sheet or JUDGES[self.sheet]


@dataclass(frozen=True)
class SetUp:
    """A way to hold the sheet and to form it.

    Attributes
    ----------
    name : first, set-up 2, ... ; change : of the job, for people ; job_file : with it
    """

    name: str
    change: str
    job_file: JobFile


@dataclass(frozen=True)
class Trial:
    """One part on one variant.

    Attributes
    ----------
    part : its name: first, probe 1, step 1, ... ; variant ; record ; deviation : of its scan from the target
    """

    part: str
    variant: int
    record: PartRecord
    deviation: Deviation

    @property
    def mean(self) -> float:
        """m, of wall and base."""
        return self.deviation.whole.mean_abs

    @property
    def largest(self) -> float:
        """m, of wall and base."""
        return self.deviation.whole.max_abs

    @property
    def force(self) -> float:
        """N, the largest axial one that was measured."""
        axial = [np.abs(result.forming_force[:, 2]) for result in self.record.results if len(result.forming_force)]
        return float(np.nan_to_num(np.concatenate([[0.0], *axial])).max())

    @property
    def sheet(self) -> SheetKind:
        """That it was formed on."""
        return sheet_kind(str(self.record.sheet["model"])) or "fast"

    @property
    def within(self) -> float:
        """Share of the points of wall and base in tolerance."""
        return self.deviation.within(self.record.tolerance.shape) or 0.0

    @property
    def weighted(self) -> Array:
        """(n,) m, errors of wall, base and rim by their weight; a place that was not seen counts as right."""
        masks = self.deviation.masks
        weight = np.where(masks["wall_and_base"], 1.0, np.where(masks["rim"], RIM_WEIGHT, 0.0))
        some, error = (grid[::DECIMATED, ::DECIMATED] for grid in (weight, self.deviation.error.z))
        return np.asarray(np.nan_to_num(error * some)[some > 0.0])


@dataclass
class Tried:
    """A part with one correction on every variant.

    Attributes
    ----------
    name ; plan : file of its correction, None for the method of the first part ; set_up : name of its own
    trials : of the variants on which it was completed ; failures : why it was not on the others
    """

    name: str
    plan: Path | None
    set_up: str
    trials: list[Trial]
    failures: list[IsfError]

    @property
    def error(self) -> Array:
        """(n,) m, weighted errors of all variants."""
        return np.concatenate([trial.weighted for trial in self.trials])

    @property
    def score(self) -> float:
        """m, root mean square of these: what the steps make small."""
        return float(np.sqrt(np.mean(self.error**2))) if self.trials and not self.failures else np.inf

    @property
    def good(self) -> bool:
        """In tolerance on every variant."""
        return not self.failures and all(trial.within >= trial.record.tolerance.share for trial in self.trials)


def try_out(wanted: Tryout, output: Path | None, *, as_json: bool) -> None:
    """Find a correction for the job and say what to expect of it.

    Raises
    ------
    IsfError : what the job or its method is refused for, FILE_NOT_WRITABLE for a folder of another try-out, the code of
    a first part that does not complete without a correction either
    """
    if sealed := sorted({*wanted.variants, *wanted.checks} & set(SEALED_VARIANTS)):
        raise IsfError(
            ErrorCode.FILE_FIELD,
            f"variants {', '.join(map(str, sealed))} are sealed: they judge what a try-out found",
            where="--variants, --check",
            advice="take others; then isf simulate FOLDER/job.yaml --variant 101 judges the result",
        )
    if shared := [variant for variant in wanted.checks if variant in wanted.variants]:
        names = ", ".join(map(str, shared))
        terminal.warn(f"variants {names}: the correction is made for them, so they are no check of it (--check)")
        wanted = replace(wanted, checks=tuple(variant for variant in wanted.checks if variant not in shared))
    job_file = load_job(wanted.job)
    set_ups = _set_ups(wanted, job_file)
    _check_judge(wanted, set_ups)
    folder = _folder(wanted, set_ups, output)
    search = Search(wanted, set_ups, folder)
    try:
        search.run()
        search.scan_best()
        name = f"check of {search.best.name} on {wanted.judge}"
        (check,) = search.form([(name, search.plan)], wanted.checks, scans="as wanted", sheet=wanted.judge)
    except IsfError:
        if not any(item.is_dir() for item in folder.iterdir()):  # refused before a part was formed
            (folder / TRYOUT).unlink()
            with suppress(OSError):  # holds something else
                folder.rmdir()
        raise
    except KeyboardInterrupt:
        raise IsfError(
            ErrorCode.CANCELLED,
            "stopped by the operator; the parts that were formed are kept",
            where=str(folder),
            advice="the same command goes on with them",
        ) from None
    _finish(search, check, as_json=as_json)


class Search:
    """The parts of a try-out, one after the other.

    Attributes
    ----------
    wanted, set_ups, folder ; parts : formed so far, in order ; best : of them
    set_up : that is gone on with ; refused : set-ups that cannot be formed, and why
    correction : method of the parts without a plan; None: the job's
    steps_used_up : it ended with the last step that it may take, not as nothing helps any more
    plan : what was found, once :meth:`scan_best` was called; None: the method of the first part
    """

    def __init__(self, wanted: Tryout, set_ups: Sequence[SetUp], folder: Path) -> None:
        self.wanted, self.set_ups, self.folder = wanted, set_ups, folder
        self.set_up = set_ups[0]
        self.correction = wanted.correction
        self.parts: list[Tried] = []
        self.refused: dict[str, IsfError] = {}
        self.steps_used_up = False
        self.plan: Path | None = None

    @property
    def best(self) -> Tried:
        """The part with the smallest error so far."""
        return min(self.parts, key=lambda part: part.score)

    @property
    def job_file(self) -> JobFile:
        """Of the set-up."""
        return self.set_up.job_file

    def run(self) -> None:
        """Form parts until one is good or nothing helps any more."""
        first = self._first()
        if first.failures and any(RunOptions(self.correction).method(way.job_file) != "none" for way in self.set_ups):
            terminal.say("begins again without a correction")
            self.correction = "none"
            first = self._first()
        if first.failures:
            raise first.failures[0]
        if first.good:
            return
        record = first.trials[0].record
        start = learn_record(record, self.job_file.base)
        bands = _bands(start, record.nominal)
        base = first
        # each variant had the correction that its forces asked for; no plan has what some methods correct sideways
        if len(self.wanted.variants) > 1 or _moved_sideways(record):
            (base,) = self._add([self._plan("replay", start, start.applied)])
        if not base.failures:
            self._newton(start, bands, self._probed(start, bands, base.error), base)
        self._place_by_place()

    def scan_best(self) -> None:
        """The best part is the plan; where the job scans between contours, with what these show of it."""
        self.plan = best = self.best.plan
        job = self.job_file.job
        if best is None or not job.springback.scan_every or job.process_type is Process.TPIF:
            return
        name = f"scans of {self.best.name}"
        (part,) = self.form([(name, best)], self.wanted.variants, scans="exact")
        if part.failures:
            terminal.warn(f"{part.failures[0].message}; a real part is not corrected by scans")
            return
        seen = together([learn_record(trial.record, self.job_file.base) for trial in part.trials])
        self.plan = self.folder / "scanned.npz"
        learning.save(replace(seen, push=learning.load(best).push), self.plan)

    def form(
        self,
        wanted: Sequence[tuple[str, Path | None]],
        variants: Sequence[int],
        scans: Scans = "none",
        sheet: SheetKind | None = None,
    ) -> list[Tried]:
        """Parts of the names and plans ``wanted``, on each of ``variants``; ``scans`` of those with a plan. ``sheet``
        None: that of the try-out.

        Raises IsfError what the job is refused for, as long as no part was formed in this set-up.
        """
        jobs = [_tried(self.job_file, plan, self.correction, scans) for _, plan in wanted]
        accepted = any(part.trials for part in self.parts if part.set_up == self.set_up.name)
        tasks = [
            _Task(job.text, job.base, job.job.name, sheet or self.wanted.sheet, variant, self.wanted.seed,
                  self.folder / name.replace(" ", "_") / f"variant_{variant}", name, accepted)
            for job, (name, _) in zip(jobs, wanted, strict=True)
            for variant in variants
        ]  # fmt: skip
        ended = _form_all([task for task in tasks if not task.bag.exists()], self.wanted.jobs)
        found = []
        for name, plan in wanted:
            trials: list[Trial] = []
            failures: list[IsfError] = []
            for task in tasks:
                if task.name == name and task in ended:
                    failures.append(_incomplete(task, ended[task], ended[task].where))
                elif task.name == name:
                    record = read_bag(task.bag)
                    if (failure := _failure(task, record)) is not None:
                        failures.append(failure)
                    elif record.scan is not None and record.target is not None:
                        trials.append(Trial(name, task.variant, record, compare(record.scan, record.target)))
            found.append(Tried(name, plan, self.set_up.name, trials, failures))
        return found

    def _first(self) -> Tried:
        """The first part of the best set-up, which is gone on with."""
        found = []
        for way in self.set_ups:
            if way.name in self.refused:
                continue
            if len(self.set_ups) > 1:
                terminal.say(f"{way.name}: {way.change}")
            try:
                found.append(self._first_of(way))
            except IsfError as refusal:
                if way is self.set_ups[0]:
                    raise
                self.refused[way.name] = refusal
                terminal.warn(f"{way.name} cannot be formed: {refusal.message}")
        self.set_up, first = min(found, key=lambda pair: pair[1].score)
        if len(found) > 1 and not first.failures:
            terminal.say(f"goes on with {self.set_up.name}: {self.set_up.change}")
        return first

    def _first_of(self, way: SetUp) -> tuple[SetUp, Tried]:
        """The first part of ``way``."""
        name = way.name
        if self.correction != self.wanted.correction:
            name = "uncorrected" if way is self.set_ups[0] else f"uncorrected {way.name}"
        self.set_up = way
        (part,) = self._add([(name, None)])
        return way, part

    def _add(self, wanted: Sequence[tuple[str, Path | None]]) -> list[Tried]:
        found = self.form(wanted, self.wanted.variants)
        self.parts += found
        for part in found:
            for trial in part.trials:
                tolerance = trial.record.tolerance.shape
                terminal.say(
                    f"{trial.part}, variant {trial.variant}: {1e3 * trial.largest:.2f} mm largest, "
                    f"{1e3 * trial.mean:.2f} mm mean, {percent(trial.within, 0)} within {1e3 * tolerance:g} mm"
                )
                if lost := [step for step in trial.record.corrections if step.code]:
                    count = f"{len(lost)} of {len(trial.record.corrections)} contours"
                    terminal.warn(f"{trial.part} was not corrected at {count}: {lost[0].message}")
            for failure in part.failures:
                terminal.warn(failure.message)
        return found

    def _plan(self, name: str, knowledge: Learned, push: Array) -> tuple[str, Path]:
        """File of a part, by its name; a part that was formed by another one is formed anew."""
        path = self.folder / f"{name.replace(' ', '_')}.npz"
        before = path.read_bytes() if path.exists() else None
        learning.save(replace(knowledge, push=np.clip(push, LEAST_PUSH, LARGEST_CORRECTION), seen=None), path)
        if before is not None and path.read_bytes() != before:
            checks = self.folder.glob(f"check_of_{path.stem}_on_*")
            for stale in (self.folder / path.stem, self.folder / f"scans_of_{path.stem}", *checks):
                shutil.rmtree(stale, ignore_errors=True)
        return name, path

    def _probed(self, start: Learned, bands: Array, error: Array) -> Array:
        """(errors, bands), what a push over each band of depth changes; nothing where such a part is not completed."""
        plans = [self._plan(f"probe {k + 1}", start, start.applied + PROBED * band) for k, band in enumerate(bands.T)]
        probes = self._add(plans)
        return np.column_stack([0.0 * error if probe.failures else probe.error - error for probe in probes]) / PROBED

    def _newton(self, start: Learned, bands: Array, jacobian: Array, base: Tried) -> None:
        """Steps over the bands from the part ``base`` on, which has the correction of ``start``."""
        at, error, best = np.zeros(bands.shape[1]), base.error, base.score
        low, high = LEAST_PUSH - start.applied.max(), LARGEST_CORRECTION - start.applied.min()
        reach, idle = LONGEST_STEP, 0
        for number in range(1, self.wanted.steps + 1):
            step = _step(jacobian, error, np.maximum(low - at, -reach), np.minimum(high - at, reach))
            if np.abs(step).max() < SHORTEST_STEP:  # no probe was completed, or there is no room for more
                return
            (part,) = self._add([self._plan(f"step {number}", start, start.applied + bands @ (at + step))])
            if part.good:
                return
            if not part.failures:
                jacobian = jacobian + np.outer(part.error - error - jacobian @ step, step) / float(step @ step + 1e-12)
            if part.score < best:
                idle = 0 if part.score < ENOUGH * best else idle + 1
                at, error, best = at + step, part.error, part.score
            else:
                reach, idle = 0.5 * min(reach, float(np.abs(step).max())), idle + 1
            if idle == IDLE_STEPS:
                return
        self.steps_used_up = True

    def _place_by_place(self) -> None:
        """Passes of displacement adjustment from the best part on, as long as they help."""
        for number in range(1, self.wanted.steps + 1):
            best = self.best
            if best.good:
                return
            knowledge = together([learn_record(trial.record, self.job_file.base) for trial in best.trials])
            (part,) = self._add([self._plan(f"pass {number}", knowledge, knowledge.push)])
            if part.score > ENOUGH * best.score:
                return
        self.steps_used_up = True


def _moved_sideways(record: PartRecord) -> bool:
    """Contours of the part were moved in plan as well as along the push."""
    return any(bool(made.offset[:, :2].any()) for made in record.corrections)


def _bands(start: Learned, nominal: Sequence[Contour]) -> Array:
    """(places, bands), weights of the bands of depth: hats that add up to 1; depths over a die are those in its
    frame."""
    tips = np.array([float(contour_over_die(contour).forming_tip[:, 2].min()) for contour in nominal])
    count = min(PROBES, len(tips))
    share = (tips.max() - tips) / max(float(np.ptp(tips)), 1e-9) * (count - 1)
    weights = np.maximum(0.0, 1.0 - np.abs(share[:, None] - np.arange(count)))
    return np.asarray(weights[start.contour])


def _step(jacobian: Array, error: Array, low: Array, high: Array) -> Array:
    """(bands,) m, between ``low`` and ``high``, with the least squares of what it leaves of ``error``."""
    count = jacobian.shape[1]
    ridge = np.sqrt(RIDGE * float((jacobian**2).sum()) / count)
    rows = np.vstack([jacobian, ridge * np.eye(count)])
    found = lsq_linear(rows, np.concatenate([-error, np.zeros(count)]), (low, np.maximum(high, low + 1e-9)))
    return np.asarray(found.x)


def _set_ups(wanted: Tryout, job_file: JobFile) -> list[SetUp]:
    """The job as it is, with the support tool under the blank where it does not say where that one goes, and with each
    of the ``alternatives``.

    Raises
    ------
    IsfError : what the job, its method, or an alternative is refused for
    """
    options = RunOptions(wanted.correction, sheet=wanted.sheet)
    _check_correctable(job_file)
    options.check(job_file)
    found = [SetUp("first", "as the job says", job_file)]
    job = job_file.job
    if wanted.sheet != "fast" and job.process == "DSIF" and "support" not in job.path.model_fields_set:
        try:
            found.append(SetUp("set-up 2", "support tool under the blank (path.support: on_blank), no force control",
                               job_file.changed(ON_BLANK)))  # fmt: skip
        except IsfError as error:
            terminal.warn(f"not tried with path.support on_blank: {error.message}")
    if wanted.sheet != "fast" and job.process == "SPIF" and "backing_plate" not in job.model_fields_set:
        found += _with_plate(job_file, f"set-up {len(found) + 1}")
    for text in wanted.alternatives:
        where = f"--or '{text}'"
        advice = 'write fields as in a job file, such as --or "backing_plate: {shape: circle, size: [56 mm, 56 mm]}"'
        try:
            change = yaml_file.content(text if text.lstrip().startswith("{") else f"{{{text}}}", where)
        except IsfError as error:
            raise IsfError(error.code, error.what, where=where, advice=advice) from error
        if not isinstance(change, dict) or not change:
            raise IsfError(ErrorCode.FILE_SYNTAX, "holds no fields of a job", where=where, advice=advice)
        own = change.get("springback")
        if wanted.correction is not None and isinstance(own, dict) and "method" in own:
            raise IsfError(
                ErrorCode.FILE_FIELD,
                "springback.method has no effect: --correction names the method of every first part",
                where=where,
                advice="leave one of the two out",
            )
        try:
            changed = job_file.changed(change)
            _check_correctable(changed)
            check_sheet(wanted.sheet, changed.job)
            options.check(changed)
            check_method(options.method(changed), changed)
        except IsfError as error:
            of_job = error.advice or "the job with these fields is no job; null leaves a field out"
            raise IsfError(error.code, error.what.lstrip(": "), where=where, advice=of_job) from error
        if changed.text == job_file.changed({}).text:
            raise IsfError(ErrorCode.FILE_FIELD, "changes nothing of the job", where=where, advice=advice)
        if same := [way for way in found if job_content(way.job_file) == job_content(changed)]:
            terminal.warn(f"{where} is tried already: {same[0].change}")
            continue
        found.append(SetUp(f"set-up {len(found) + 1}", text.strip(), changed))
    return found


def _check_judge(wanted: Tryout, set_ups: Sequence[SetUp]) -> None:
    """Raise IsfError FILE_FIELD for a sheet of the checks that cannot form one of ``set_ups``, or that no part is
    formed on; warn of one that is the sheet of the try-out."""
    where = f"--check-sheet {wanted.check_sheet}"
    if not wanted.checks:
        if wanted.check_sheet is not None:
            raise IsfError(
                ErrorCode.FILE_FIELD,
                "has no effect: no part is checked",
                where=where,
                advice="name variants by --check",
            )
        return
    for way in set_ups:
        try:
            check_sheet(wanted.judge, way.job_file.job)
        except IsfError as error:
            what = f"{way.name} ({way.change}) cannot be checked on it: {error.what}"
            raise IsfError(error.code, what, where=where, advice=f"take {JUDGES[wanted.sheet]}") from error
    if wanted.judge == wanted.sheet:
        terminal.warn(
            f"the result is judged by the sheet {wanted.sheet} that it was found on: the same cells and speeds"
        )


def _check_correctable(job_file: JobFile) -> None:
    """What a try-out finds, a correction by method learned, fits the job and can be judged.

    Raises
    ------
    IsfError : FILE_FIELD, the process cannot be corrected, the plan corrects the sheet itself, nothing says what the
    part is to be; what the job is refused for with that method
    """
    job = job_file.job
    if refusal := correction_refusal(job.process, LEARNED):
        raise IsfError(
            ErrorCode.FILE_FIELD,
            f"a try-out finds no correction for it: {refusal}",
            where="process",
            advice="form it as it is with isf simulate",
        )
    if "sheet" in job.path.compensation:
        raise IsfError(
            ErrorCode.FILE_FIELD,
            "sheet corrects in the plan what a try-out corrects: the deflection of the sheet",
            where="path.compensation",
            advice="leave sheet out for the try-out, or form the job as it is with isf simulate",
        )
    if job.part is None:
        raise IsfError(
            ErrorCode.FILE_FIELD,
            "a try-out holds every part against its target, and the job names none",
            where="part",
            advice="write part: {mesh: FILE, unit: mm} beside path.program",
        )
    _tried(job_file, Path("plan.npz"), None, "none")


def _with_plate(job_file: JobFile, name: str) -> list[SetUp]:
    """The set-up ``name`` with a backing plate near the opening, where that holds the sheet closer."""
    plan = planning.plan(job_file)
    plate = nearer_plate(plan.contours, Mesh(*plan.mesh), job_file.job, job_file.rig)
    if plate is None:
        return []
    changed = job_file.changed({"backing_plate": plate_fields(plate)})
    return [SetUp(name, f"over a backing plate, which has to be made (backing_plate: {plate_text(plate)})", changed)]


def _folder(wanted: Tryout, set_ups: Sequence[SetUp], output: Path | None) -> Path:
    """Of this try-out, new or begun earlier."""
    job_file = set_ups[0].job_file
    folder = make_folder(output or Path("runs") / f"tryout-{job_file.job.name}")
    ways = [job_content(way.job_file) for way in set_ups]
    said = json.dumps([__version__, *ways, wanted.sheet, wanted.variants, wanted.seed, wanted.correction])
    key = hashlib.sha256(said.encode()).hexdigest()
    state = folder / TRYOUT
    others = [item for item in folder.iterdir() if item != state]  # a refused try-out leaves none
    if others and not state.exists():
        raise IsfError(ErrorCode.FILE_NOT_WRITABLE, "is not empty", where=str(folder), advice="choose another --output")
    if others and key not in state.read_text(encoding="utf-8", errors="replace"):
        raise IsfError(
            ErrorCode.FILE_NOT_WRITABLE,
            "holds a try-out of another job, part, sheet or choice of variants, by another version, or of other "
            "contents of a file that the job names",
            where=str(folder),
            advice="choose another --output, or remove the folder",
        )
    if others:
        terminal.say(f"goes on with what is in {folder}")
    state.write_text(json.dumps({"key": key}), encoding="utf-8")
    return folder


def _tried(
    job_file: JobFile, plan: Path | None, correction: str | None, scans: Scans, rate: float = CONTROL_RATE
) -> JobFile:
    """``job_file`` with what was learned in ``plan`` and ``scans``, or with method ``correction`` before there is a
    plan; its text names files by absolute paths."""
    data = _absolute(yaml_file.content(job_file.text, job_file.job.name), job_file.base, "")
    if plan is not None:
        data["springback"] = {**data.get("springback", {}), "method": LEARNED, "learning": str(plan)}
        if scans == "none":
            data["springback"].pop("scan_every", None)
        elif scans == "exact":
            data["springback"]["scan_sensor"] = False
    elif correction is not None:
        data["springback"] = {**data.get("springback", {}), "method": correction}
    if plan is None and (correction or job_file.job.springback.method) == "none":
        data["path"] |= _path_when_corrected(job_file.job)
    if job_file.job.control.rate > rate:
        data["control"] = {**data.get("control", {}), "rate": f"{rate:g} Hz"}
    return JobFile(yaml.safe_dump(data, sort_keys=False), job_file.base, job_file.job.name)


def _path_when_corrected(job: Job) -> dict[str, Any]:
    """Fields of the path that a correction adds: what is formed without one teaches the parts that have it."""
    if job.path.floor_step != "auto":
        return {}
    corrected = job.model_copy(update={"springback": job.springback.model_copy(update={"method": LEARNED})})
    step = floor_step(corrected)
    return {} if step is None else {"floor_step": f"{1e3 * step:g} mm", "floor_rounds": floor_rounds(corrected)}


def _absolute(value: Any, base: Path, field: str) -> Any:
    """``value`` of the ``field`` with the names of files in it, relative to ``base``, made absolute."""
    if isinstance(value, dict):
        return {key: _absolute(item, base, f"{field}.{key}".lstrip(".")) for key, item in value.items()}
    if not isinstance(value, str):
        return value
    named = field in FILES or (field in FILES_OR_NAMES and yaml_file.is_path(value))
    return str((base / value).resolve()) if named else value


@dataclass(frozen=True)
class _Task:
    """One part to form: text and base of its job, where its bag goes; ``accepted``: its job is known to be formable,
    so that what is raised is the end of this part and no refusal of all."""

    text: str
    base: Path
    job: str
    sheet: SheetKind
    variant: int
    seed: int
    bag: Path
    name: str
    accepted: bool


def _form_all(tasks: list[_Task], jobs: int) -> dict[_Task, IsfError]:
    """Form all parts; those that have no bag, and why."""
    ended: dict[_Task, IsfError | None] = {}
    if jobs > 1 and len(tasks) > 1:
        for task, error in formed_beside(_form, tasks, jobs):
            ended[task] = error
            if error is None:
                terminal.say(f"  {task.name}, variant {task.variant}: formed")
    else:
        for task in tasks:
            with terminal.part_progress(f"{task.name}, variant {task.variant}") as progress:
                ended[task] = _form(task, progress)
    return {task: error for task, error in ended.items() if error is not None}


def _form(task: _Task, progress: terminal.PartProgress | None = None) -> IsfError | None:
    """One part; its bag appears when it is whole. Returns why an accepted part has none."""
    options = RunOptions(variant=task.variant, seed=task.seed, sheet=task.sheet)
    job_file = JobFile(task.text, task.base, task.job)
    try:
        record = in_process.form(job_file, options, progress=progress.contour if progress else None)
    except IsfError as error:
        if not task.accepted or error.code in (ErrorCode.INTERNAL, ErrorCode.LEARNING_UNUSABLE):
            raise
        return error
    part = task.bag.with_suffix(".part")
    shutil.rmtree(part, ignore_errors=True)
    part.parent.mkdir(parents=True, exist_ok=True)
    write_bag(record, part)
    part.rename(task.bag)
    return None


def _failure(task: _Task, record: PartRecord) -> IsfError | None:
    """Why a part tore, stopped or was not measured."""
    failure = torn(record.events) or first_failure(record.results)
    if failure is None and (record.scan is None or record.target is None):
        failure = IsfError(ErrorCode.SHEET_MODEL_FAILED, "it has no scan", advice="try smaller cells: --sheet shell")
    if failure is None:
        return None
    return _incomplete(task, failure, str(task.bag), f"isf report {task.bag} shows it")


def _incomplete(task: _Task, failure: IsfError, where: str, advice: str = "") -> IsfError:
    """``failure`` of a part, told with its name; ``advice`` where it has none."""
    what = f"{task.name} does not complete on variant {task.variant}: {failure.what}"
    return IsfError(failure.code, what, where=where, advice=failure.advice or advice)


def _prevented(search: Search, check: Tried) -> list[str]:
    """What keeps the best part from its tolerance."""
    best = search.best
    failed = [failure.message for failure in check.failures]
    if best.good:
        out = [trial for trial in check.trials if trial.within < trial.record.tolerance.share]
        names = ", ".join(f"{trial.variant} ({percent(trial.within, 0)})" for trial in out)
        return failed + ([f"it is out of tolerance on variants that had no say in it: {names}"] if out else [])
    worst = max(best.trials, key=lambda trial: trial.mean)
    tolerance = search.job_file.job.tolerance.shape
    signed = {name: worst.deviation.regions[name].mean for name in ("wall", "base", "rim")}
    found = [
        f"{name} lies {1e3 * abs(off):.2f} mm too {'high' if off > 0.0 else 'deep'} in the mean"
        for name, off in signed.items()
        if np.isfinite(off) and abs(off) > tolerance
    ]
    if best.plan is not None:
        push = learning.load(best.plan).push
        bound = float(np.mean((push < LEAST_PUSH + 1e-5) | (push > LARGEST_CORRECTION - 1e-5)))
        if bound > 0.05:
            found.append(f"{100 * bound:.0f} % of the places are at the limit of a correction (4 mm up, 10 mm down)")
    job = search.job_file.job
    held = job.backing_plate is not None or job.process_type is Process.TPIF or job.support_stays
    if not held and signed["rim"] < -tolerance:
        found.append("a backing plate near the opening would hold the rim (backing_plate of the job)")
    if worst.mean - min(trial.mean for trial in best.trials) > 0.5 * tolerance:
        found.append("the variants differ by more than one correction can serve")
    own = [part for part in search.parts if part.set_up == search.set_up.name]
    found += [failure.what for part in own for failure in part.failures]
    if search.steps_used_up:
        found.append(f"all steps were taken, and more of them may help (--steps {search.wanted.steps})")
    return failed + (found or ["no step helps any more: the largest error is where no push acts"])


def _overload(search: Search, trials: Sequence[Trial]) -> str:
    """That a part took more than the machine bears, for people; empty: none did."""
    worst, bears = max(trials, key=lambda trial: trial.force), search.job_file.rig.limits.force[2]
    if worst.force <= bears:
        return ""
    return (
        f"the part took {worst.force:.0f} N here, {search.job_file.rig.name} bears {bears:.0f} N: cells of this size "
        f"overstate the force by up to {FORCE_TOO_HIGH[worst.sheet]:g} times, so that a real part may do with less"
    )


def _stands_on(wanted: Tryout, trials: Sequence[Trial]) -> str:
    """What an expectation from ``trials`` stands on, for people."""
    variants = f"variant{'s' * (len(trials) > 1)} {', '.join(str(trial.variant) for trial in trials)}"
    if any(trial.variant in wanted.variants for trial in trials):
        return f"the parts that the correction was made for (sheet {wanted.sheet}, {variants}): no check of it"
    other = "of other cells and tool speed" if wanted.judge != wanted.sheet else "that it was found on, too"
    return f"parts on {variants}, which had no say in it, and on the sheet {wanted.judge}, {other}"


def _finish(search: Search, check: Tried, *, as_json: bool) -> None:
    wanted, folder, best = search.wanted, search.folder, search.best
    name = search.job_file.job.name
    plan = None
    if search.plan is not None:
        plan = Path("plan.npz")  # beside the job
        sheets = f"{wanted.sheet}, checked on {wanted.judge}" if check.trials else wanted.sheet
        found_plan = _with_tried(learning.load(search.plan), check.trials or best.trials)
        learning.save(replace(found_plan, source=f"try-out on the simulated sheet {sheets}"), folder / plan)
    job = folder / TRYOUT_JOB
    head = f"# {name} with the correction of a try-out on the simulated sheet {wanted.sheet}\n"
    if search.set_up.name != search.set_ups[0].name:
        head += f"# Set-up: {' '.join(search.set_up.change.split())}\n"
    found = _tried(search.job_file, plan, search.correction, "as wanted", rate=np.inf)
    job.write_text(head + found.text, encoding="utf-8")
    picture = _draw(search, check.trials, folder / "tryout.png")
    prevented, expected = _prevented(search, check), check.trials or best.trials
    overload = _overload(search, [*best.trials, *check.trials])
    data = {
        "job": name,
        "sheet": wanted.sheet,
        "chosen": best.name,
        "within_tolerance": best.good and check.good,
        "prevented_by": prevented,
        "overload": overload,
        "expected": {
            "largest_mm": {"median": _mm(expected, "largest", np.median), "worst": _mm(expected, "largest", np.max)},
            "mean_mm": {"median": _mm(expected, "mean", np.median), "worst": _mm(expected, "mean", np.max)},
            "from_variants": [trial.variant for trial in expected],
            "from_sheet": expected[0].sheet,
            "stands_on": _stands_on(wanted, expected),
        },
        "set_up": search.set_up.change,
        "set_ups_refused": {
            way.change: search.refused[way.name].message for way in search.set_ups if way.name in search.refused
        },
        "parts": [_row(trial) for part in search.parts for trial in part.trials],
        "checks": [_row(trial) for trial in check.trials],
        "plan": str(job),
        "picture": str(picture),
    }
    (folder / "summary.json").write_text(json.dumps(terminal.without_nan(data), indent=2), encoding="utf-8")
    if as_json:
        terminal.print_json(data)
    table = terminal.table_of(
        f"{name}: tried on {wanted.sheet}, wall and base",
        "part",
        "variant",
        "largest [mm]",
        "mean [mm]",
        f"within {1e3 * search.job_file.job.tolerance.shape:g} mm",
    )
    for part in search.parts:
        for trial in part.trials:
            table.add_row(trial.part + (" (chosen)" if part is best else ""), *_cells(trial))
    for trial in check.trials:
        table.add_row(f"chosen, on {trial.sheet}", *_cells(trial))
    terminal.console.print(table)
    for text in (*prevented, *([overload] if overload else [])):
        terminal.warn(text)
    errors = [_mm(expected, key, of) for of in (np.median, np.max) for key in ("largest", "mean")]
    terminal.say(
        "to expect: {:.2f} mm largest, {:.2f} mm mean (worst {:.2f} / {:.2f}), by ".format(*errors)
        + _stands_on(wanted, expected)
    )
    terminal.say(f"picture {picture}\njob     {job}   (isf form, isf simulate --sheet shell --variant 101)")


def _with_tried(found: Learned, trials: Sequence[Trial]) -> Learned:
    """``found`` with the errors of ``trials`` with this correction: what parts that are formed from it expect."""
    return replace(found, tried=np.array([_by_place(found, trial) for trial in trials]))


def _by_place(found: Learned, trial: Trial) -> Array:
    """(K,) m, error of wall and base by the places of ``found`` on the contours that made the shape; NaN: of others."""
    made = np.isin(found.contour, [contour.index for contour in trial.record.last_stage])
    error = trial.deviation.error
    of_part = np.where(trial.deviation.masks["wall_and_base"], error.z, np.nan)
    by_place = np.full(len(made), np.nan)
    by_place[made] = learning.error_by_place(found.place[made], replace(error, z=of_part))
    return by_place


def _mm(trials: Sequence[Trial], name: str, of: Any) -> float:
    return float(1e3 * of([getattr(trial, name) for trial in trials]))


def _cells(trial: Trial) -> tuple[str, str, str, str]:
    return (
        str(trial.variant),
        f"{1e3 * trial.largest:.2f}",
        f"{1e3 * trial.mean:.2f}",
        percent(trial.within, 0),
    )


def _row(trial: Trial) -> dict[str, Any]:
    regions = trial.deviation.regions
    return {
        "part": trial.part,
        "variant": trial.variant,
        "largest_mm": 1e3 * trial.largest,
        "mean_mm": 1e3 * trial.mean,
        "within_tolerance_fraction": trial.within,
        "within_0_3mm_fraction": trial.deviation.within(BANDS[-1]) or 0.0,
        "mean_by_region_mm": {name: 1e3 * region.mean for name, region in regions.items()},
    }


def _draw(search: Search, checks: Sequence[Trial], path: Path) -> Path:
    """Errors from part to part, and the section of the first and the best part."""
    with style.applied():
        figure = style.new_figure(3.6)
        left, right = figure.subplots(1, 2)
        parts = [part for part in search.parts if not part.failures]
        names = [part.name for part in parts]
        for key, title in (("largest", "largest"), ("mean", "mean")):
            for k, trials in enumerate(zip(*(part.trials for part in parts), strict=True)):
                values = [1e3 * getattr(trial, key) for trial in trials]
                left.plot(values, marker="o", markersize=3, label=title if not k else None)
        at = parts.index(search.best)
        for k, trial in enumerate(checks):
            left.plot([at, at], [1e3 * trial.largest, 1e3 * trial.mean], "x", color=style.INK,
                      label=None if k else "other variants")  # fmt: skip
        left.axhline(1e3 * search.job_file.job.tolerance.shape, linestyle=":", color=style.INK, linewidth=0.8)
        left.set_xticks(range(len(names)), names, rotation=90)
        left.set_ylim(bottom=0.0)
        left.set_ylabel("error of wall and base [mm]")
        left.legend()
        for part, label in ((parts[0], parts[0].name), (search.best, search.best.name)):
            error = part.trials[0].deviation.error
            right.plot(1e3 * error.x, 1e3 * error.z[len(error.y) // 2], label=label)
        right.axhline(0.0, color=style.INK, linewidth=0.8)
        right.set_xlabel("x [mm]")
        right.set_ylabel("error at y = 0 [mm]")
        right.legend(loc="lower left")
        path.write_bytes(style.png(figure))
    return path
