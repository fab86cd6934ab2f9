"""News of a part, from the cell's own types to what the page shows: mm, N and degrees. Free of ROS."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from isf_analysis.measures.contour_scan import ContourScan, kept_scan, levels_reached, scan_errors
from isf_analysis.measures.deviation import compare, flange_level, regions_of
from isf_core.contour import Contour, ContourCorrection, ContourResult, Process, contour_label
from isf_core.errors import ErrorCode, IsfError, told
from isf_core.events import Event
from isf_core.files.job import JobFile, ToleranceSpec
from isf_core.geometry.height_map import HeightMap
from isf_core.types import Array
from numpy.typing import NDArray
from scipy import ndimage

from isf_dashboard.history import History

MM = 1e3

NODES = 20_000
"""Of the drawn surface at most; a finer one is thinned out."""

MOST_EVENTS = 1000
"""Of a part that are told; a machine may tell the same in every tick."""

SAME_FAILURE = 3.0
"""s within which a code that several sources tell is one failure."""

BESIDE = 25e-3
"""m of flange that is drawn beside what is formed."""

PATH_POINTS = 1000
"""Of the drawn path of a contour at most."""


@dataclass(frozen=True)
class Job:
    """What is formed; as in ``isf_msgs/JobInfo``. ``began`` tells two runs of one plan apart."""

    name: str
    text: str
    plan_id: str
    process: str
    correction: str
    support_force: float
    variant: int
    lockstep: bool
    software: str
    base_folder: str
    first_index: int = 0
    began: float = 0.0
    plan_warnings: tuple[str, ...] = ()


@dataclass
class PartFeed:
    """Takes what is heard of a cell or read from a record, and adds it to ``history``. Times: s, of the page."""

    history: History
    _job: Job | None = None
    _target: HeightMap | None = None
    _preforms: tuple[HeightMap, ...] = ()
    _opening: NDArray[np.int32] | None = None
    _paths: dict[int, Array] = field(default_factory=dict)
    _window: tuple[slice, slice] = (slice(None), slice(None))
    _nominal: dict[int, Contour] = field(default_factory=dict)
    _ended: int = -1
    _faults: dict[str, str] = field(default_factory=dict)
    _events: int = 0
    _told: dict[int, float] = field(default_factory=dict)

    def job(self, time: float, job: Job) -> None:
        """A part begins, or goes on: then the news of its first contours stay."""
        known, self._job = self._job, job
        if known == job:
            return
        goes_on = known is not None and job.first_index > 0 and job.plan_id == known.plan_id
        if not goes_on:
            self.history.begin()
            self._nominal, self._ended, self._events = {}, -1, 0
        self.history.add("job", time, **_of_job(job))
        if goes_on:
            return
        for text in job.plan_warnings:
            self.history.add("event", time, severity="note", text=f"the plan warned: {text}")
        if self._target is not None:
            self._tell_target(time, self._target)
        for tool, tips in self._paths.items():  # the target may come later, they are not told again
            self.history.add("path", time, tool=tool, tips=tips)

    def target(self, time: float, target: HeightMap, preforms: tuple[HeightMap, ...] = ()) -> None:
        """The shape that is wanted, and those of the stages before it; told before the job that they belong to, and
        again with it."""
        self._preforms = preforms
        try:
            label = ndimage.label(regions_of(target)["wall_and_base"], structure=np.ones((3, 3)))
        except IsfError:  # flat: there is nothing to draw, the shape of the part before least of all
            self._target = self._opening = None
            return
        self._target, self._opening = target, np.asarray(label[0], dtype=np.int32)
        self._window = _window(target, self._opening)
        self._tell_target(time, target)

    def path(self, time: float, tool: int, tips: Array) -> None:
        """The planned path (N, 3) m of a tool, thinned out; told again with its job, as the target is."""
        self._paths[tool] = MM * tips
        self.history.add("path", time, tool=tool, tips=self._paths[tool])

    def nominal(self, time: float, contour: Contour) -> None:
        """A contour as planned is given out."""
        if contour.index in self._nominal or not self._of_this_part(contour.plan_id):
            return
        self._nominal[contour.index] = contour
        stride = -(-len(contour) // PATH_POINTS)
        self.history.add(
            "contour",
            time,
            index=contour.index,
            count=contour.count,
            tool=contour.forming_tool,
            force_controlled=contour.force_controlled,
            closed=contour.closed,
            contact=MM * contour.contact[::stride],
            depth=abs(MM * float(np.median(contour.contact[:, 2]))),
            levels=self._levels(contour),
        )

    def correction(self, time: float, correction: ContourCorrection) -> None:
        """Springback has corrected a contour."""
        if not self._of_this_part(correction.plan_id):
            return
        offset = np.linalg.norm(correction.offset, axis=1) if len(correction.offset) else np.zeros(1)
        found = correction.springback
        self.history.add(
            "correction",
            time,
            index=correction.index,
            method=correction.method,
            largest=MM * float(offset.max()),
            mean=MM * float(offset.mean()),
            springback=MM * float(np.abs(found).max()) if len(found) else None,
            limited=float(np.mean(correction.saturated)) if len(correction.saturated) else 0.0,
        )
        where = contour_label(correction.index)
        if correction.code:
            self.fault(time, f"springback, {where}", correction.code, correction.message)
        for remark in correction.remarks:
            self._tell_event(time, severity="note", text=f"{where}: {remark}")

    def result(self, time: float, result: ContourResult) -> None:
        """A contour ended."""
        if not self._of_this_part(result.plan_id):
            return
        self._ended = max(self._ended, result.index) if result.completed else self._ended
        engaged = result.tick_engaged
        normal = result.tick_normal_force[engaged] if len(engaged) == len(result.tick_normal_force) else engaged
        self.history.add(
            "result",
            time,
            index=result.index,
            completed=result.completed,
            seconds=result.end - result.start,
            axial_force=float(np.mean(np.abs(result.forming_force[:, 2]))) if len(result.forming_force) else None,
            normal_force=float(np.mean(normal)) if len(normal) else None,
            contact=result.contact_fraction,
        )
        if result.code:
            self.fault(time, contour_label(result.index), result.code, result.message)

    def scan(self, time: float, points: Array, shape: HeightMap | None) -> None:
        """The sheet was measured: ``points`` (P, 3) m, and what they are as a height map where they are of the whole
        part. Compared with what is formed so far."""
        target = self._target
        if target is None:
            return
        last = max(self._nominal.values(), key=lambda contour: contour.index, default=None)
        final = shape is not None and last is not None and self._ended == last.count - 1
        error: HeightMap | None = None
        try:
            if final and shape is not None:
                deviation = compare(shape, target)
                error = HeightMap(target.x, target.y, deviation.error.z)
                values = deviation.errors()
            elif self._ended >= 0:
                error = self._error_so_far(kept_scan(self._ended, time, points), target)
                values = error.z[np.isfinite(error.z)] if error is not None else np.empty(0)
        except IsfError as failure:
            self.fault(time, "scan", int(failure.code), failure.message)
            return
        if error is None or not len(values):
            return
        self.history.add(
            "scan",
            time,
            final=final,
            after=self._ended,
            deviation=MM * error.z[self._window],
            largest=MM * float(np.abs(values).max()),
            mean=MM * float(np.abs(values).mean()),
        )

    def kept_scan(self, time: float, scan: ContourScan) -> None:
        """A scan between contours, from a record."""
        self._ended = scan.index
        self.scan(time, scan.points(), None)

    def event(self, time: float, event: Event, *, harmless: bool = False) -> None:
        """Something happened to sheet or machine."""
        place = [MM * value for value in event.position] if event.has_place else None
        text = f"{event.name}: {event.text}" if event.text else event.name
        self._tell_event(time, severity="note" if harmless else "warning", text=text, place=place)

    def fault(self, time: float, source: str, code: int, text: str) -> None:
        """Something failed at ``source``; the same of one source is told once until :meth:`well`, and what several
        sources tell of one failure (by its code) once."""
        if self._faults.get(source) == text:
            return
        self._faults[source] = text
        if (found := told(text)) is not None:
            code, text = int(found.code), found.message
        before, self._told[code] = self._told.get(code, -np.inf), time
        if time - before < SAME_FAILURE:
            return
        name = ErrorCode(code).name if code in set(ErrorCode) else ""
        self._tell_event(time, severity="fault", source=source, code=code, name=name, text=text)

    def well(self, source: str) -> None:
        """What failed at ``source``, or at several that begin so, is over."""
        for known in [known for known in self._faults if known.startswith(source)]:
            del self._faults[known]

    # -- inside ----------------------------------------------------------------------------------

    def _tell_event(self, time: float, **values: object) -> None:
        self._events += 1
        if self._events <= MOST_EVENTS:
            self.history.add("event", time, **values)
        elif self._events == MOST_EVENTS + 1:
            self.history.add("event", time, severity="warning", text="there are more events, which are not shown")

    def _of_this_part(self, plan_id: str) -> bool:
        return self._job is None or self._job.plan_id == plan_id

    def _error_so_far(self, scan: ContourScan, target: HeightMap) -> HeightMap | None:
        found = scan_errors((scan,), tuple(self._nominal.values()), target, self._preforms)
        return found[0].error if found else None

    def _levels(self, contour: Contour) -> dict[str, float]:
        """mm, how far every opening is formed when the contour is, by its number; accumulative forming has no level."""
        target, opening = self._target, self._opening
        if target is None or opening is None or contour.process is Process.ADSIF:
            return {}
        if contour.process is Process.TPIF:  # over a die: what stands above the holder is formed
            level = MM * (float(np.nanmax(target.z)) + contour.holder_height)
            return {str(label): level for label in np.unique(opening[opening > 0])}
        flange = flange_level(target)
        reached = levels_reached(target, opening, [contour])
        return {str(label): MM * (level + flange) for label, level in reached.items()}

    def _tell_target(self, time: float, target: HeightMap) -> None:
        assert self._opening is not None
        labels = np.asarray(np.clip(self._opening, 0, 255), dtype=np.uint8)
        self.history.add(
            "target",
            time,
            x=MM * target.x[self._window[1]],
            y=MM * target.y[self._window[0]],
            z=MM * target.z[self._window],
            opening=labels[self._window],
            flange=MM * flange_level(target),
        )


def _window(target: HeightMap, opening: NDArray[np.int32]) -> tuple[slice, slice]:
    """Rows and columns of ``target`` that are drawn: what is formed and some flange, thinned out to :data:`NODES`."""
    spans = []
    for axis, inside in ((target.y, opening.any(axis=1)), (target.x, opening.any(axis=0))):
        known = axis[inside]
        first, last = np.searchsorted(axis, (known[0] - BESIDE, known[-1] + BESIDE))
        spans.append((int(first), min(int(last) + 1, len(axis))))
    stride = int(np.ceil(np.sqrt(np.prod([last - first for first, last in spans]) / NODES)))
    rows, columns = (slice(first, last, max(1, stride)) for first, last in spans)
    return rows, columns


def _of_job(job: Job) -> dict[str, object]:
    """For the page; what the job file says only where it can be read."""
    tolerance, limits, radii = ToleranceSpec(), None, []
    try:
        file = JobFile(job.text, Path(job.base_folder), "job")
        tolerance, limits = file.job.tolerance, list(file.rig.limits.force)
        radii = [MM * tool.ball_radius for tool in (file.job.tool_1, file.job.tool_2) if tool is not None]
    except IsfError:
        pass  # a bag from elsewhere: its files are not here
    return {
        "name": job.name,
        "process": job.process,
        "correction": job.correction,
        "set_point": job.support_force,
        "simulated": job.variant >= 0,
        "lockstep": job.lockstep,
        "software": job.software,
        "first": job.first_index,
        "tolerance": MM * tolerance.shape,
        "force_limits": limits,
        "radii": radii,
    }
