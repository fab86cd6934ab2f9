"""What a replay needs of a bag: the part, the ticks of force control, scans and tool lifts as they came. SI units."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import isf_analysis
import numpy as np
from isf_analysis.bag import topics
from isf_analysis.bag.bag_reader import PartSpan, last_part, namespace_of
from isf_analysis.bag.cdr_columns import Columns
from isf_analysis.bag.open_bag import ENDED_BY_FORCE
from isf_analysis.bag.tables import Bag, read_tables
from isf_analysis.measures.record import PartRecord
from isf_analysis.measures.scan_cloud import stamp_of
from isf_core.contour import ContourResult
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile
from isf_core.geometry.tool_axis import UPRIGHT
from isf_core.simulated_sheet import with_raised_force_limit
from isf_core.types import Array, Indices
from isf_force_ctrl.control_config import ControlConfig
from isf_ros import fields

from isf_cell.options import RunOptions

NANO = 1_000_000_000
WRENCH = tuple(f"wrench.{part}.{axis}" for part in ("force", "torque") for axis in "xyz")
POSITION = tuple(f"pose.position.{axis}" for axis in "xyz")


@dataclass(frozen=True)
class Armed:
    """With what force control was armed.

    Attributes
    ----------
    config : parameters ; tip_1, tip_2 : (3,) m, where the tools were ; axis : (3,) unit, of tool 1
    first_index, count : contours that were to come
    support_force : N in place of the set-points of the contours; None: as in the contours
    """

    config: ControlConfig
    first_index: int
    count: int
    tip_1: tuple[float, float, float]
    tip_2: tuple[float, float, float]
    support_force: float | None
    axis: tuple[float, float, float] = UPRIGHT


@dataclass(frozen=True)
class Ticks:
    """The ticks that force control answered with targets.

    Attributes
    ----------
    stamp : (n,) ns, time of the tick
    wrench : (n, 12) N and N m of tool 1 and tool 2
    target : (n, 6) m, recorded answer: tips of tool 1 and tool 2; NaN where the recorder lost it
    pose_stamp : (m,) ns ; pose : (m, 4), tool (1, 2) and its tip in m as the machine reported it
    exact : False where it is not recorded which wrench a tick used (by the clock)
    missing : recorded targets whose wrenches are not in the bag
    """

    stamp: Indices
    wrench: Array
    target: Array
    pose_stamp: Indices
    pose: Array
    exact: bool
    missing: int


@dataclass(frozen=True)
class RecordedRun:
    """One part of a bag.

    Attributes
    ----------
    part : its record
    armed : None for a bag that does not hold it
    ticks : None for a bag without wrenches and targets
    retuned : parameters that were set while the part was formed; a replay has those of the arming
    scans, lifts : (stamp s, points (P, 3) m) and (stamp s, rows (K, 4) m and N), those that came between contours too
    """

    path: Path
    part: PartRecord
    armed: Armed | None
    ticks: Ticks | None
    scans: tuple[tuple[float, Array], ...]
    lifts: tuple[tuple[float, Array], ...]
    retuned: tuple[str, ...] = ()

    @cached_property
    def result_of(self) -> dict[int, ContourResult]:
        """Result of each contour that got so far, by its index."""
        return {result.index: result for result in self.part.results}

    @property
    def simulated(self) -> bool:
        """True for a part of the simulated machine."""
        return self.part.variant >= 0

    @property
    def by_clock(self) -> bool:
        """True when it is not recorded which wrench a tick used."""
        return self.ticks is not None and not self.ticks.exact

    @property
    def incomplete(self) -> str:
        """What the record lacks of the part; empty: it goes to the part's end, however that came."""
        failure = self.part.failure()
        if failure is None or failure[0]:
            return ""
        left = f"only {self.part.formed} of {self.part.planned} contours are recorded"
        return "; ".join([left, *(note for note in self.part.notes if note == ENDED_BY_FORCE)])

    def job_file(self, base: Path | None = None, text: str | None = None) -> JobFile:
        """The recorded job, or ``text`` in its place; ``base``: folder that its paths refer to, None: the recorded one.

        Raises IsfError of the job, its rig or its material.
        """
        job_file = recorded_job(self.part, base, text)
        return with_raised_force_limit(job_file, str(self.part.sheet.get("model", "")))

    def options(self, job_file: JobFile) -> RunOptions:
        """What the run chose beyond its job."""
        part = self.part
        force = None if self.armed is None else self.armed.support_force
        if self.armed is None and not np.isclose(part.support_force, job_file.job.support_force_at()):
            force = part.support_force
        sheet: Any = part.sheet.get("model", "fast")
        return RunOptions(part.correction, force, max(0, part.variant), part.seed, sheet)


def recorded_job(part: PartRecord, base: Path | None = None, text: str | None = None) -> JobFile:
    """The job of ``part``, or ``text`` in its place; ``base``: folder that its paths refer to, None: the recorded one.

    Raises IsfError of the job, its rig or its material.
    """
    try:
        return JobFile(text or part.job_text, base or Path(part.base_folder or "."), f"job {part.job_name}")
    except IsfError as error:
        if error.code is not ErrorCode.FILE_NOT_FOUND:
            raise
        raise IsfError(
            error.code, error.what, where=error.where, advice="--base DIR: folder that the job's paths refer to"
        ) from error


def read_run(path: Path, namespace: str | None = None) -> RecordedRun:
    """The last part of the bag, or of the run folder, at ``path``; of the cell ``namespace``, None: the only one.

    Raises
    ------
    IsfError : BAG_UNREADABLE, BAG_INCOMPLETE; FILE_FIELD, it holds several cells, or none of that name
    """
    with isf_analysis.open(path, namespace) as bag:
        part = bag.part
        try:
            namespace = namespace_of(bag.raw, namespace)
            span = last_part(bag.raw, namespace)
            began = span.start
            # force control of a part that went on was not armed at the first of its ticks
            streams = _streams(bag, namespace, began) if span.announced == span.begun else {}
            return RecordedRun(
                path=bag.raw.path,
                part=part,
                armed=_armed(bag, namespace, part.plan_id),
                ticks=_ticks(streams, part),
                scans=_clouds(bag, f"{namespace}/{topics.SCAN.name}", "xyz", span),
                lifts=_clouds(bag, f"{namespace}/{topics.LIFT.name}", fields.LIFT, span),
                retuned=_retuned(bag, namespace, part.plan_id, began),
            )
        except (KeyError, ValueError) as error:
            raise IsfError(
                ErrorCode.BAG_INCOMPLETE,
                f"cannot be replayed: {error}",
                where=str(bag.raw.path),
                advice="record the run with the cell's recorder: ./isf record, ./isf form",
            ) from error


def _messages(bag: Bag, name: str) -> list[tuple[int, Any]]:
    return list(bag.raw.messages(bag.connections[name])) if name in bag.connections else []


def _armed(bag: Bag, namespace: str, plan_id: str) -> Armed | None:
    found = [m for _, m in _messages(bag, f"{namespace}/{topics.ARMED.name}") if m.plan_id == plan_id]
    if not found:
        return None
    message = found[-1]
    return Armed(
        config=ControlConfig.from_json(message.settings),
        first_index=int(message.first_index),
        count=int(message.count),
        tip_1=(message.tip_1.x, message.tip_1.y, message.tip_1.z),
        tip_2=(message.tip_2.x, message.tip_2.y, message.tip_2.z),
        support_force=None if np.isnan(message.support_force) else float(message.support_force),
        axis=UPRIGHT if (axis := getattr(message, "axis", None)) is None else (axis.x, axis.y, axis.z),  # an older bag
    )


def _retuned(bag: Bag, namespace: str, plan_id: str, began: int) -> tuple[str, ...]:
    """Parameters of the nodes that decide, set between the arming and the last result of the part."""
    times = {
        topic: [t for t, m in _messages(bag, f"{namespace}/{topic.name}") if m.plan_id == plan_id and t >= began]
        for topic in (topics.ARMED, topics.RESULT)
    }
    if not all(times.values()):
        return ()
    nodes = {f"{namespace}/{name}": name for name in ("force_ctrl", "springback")}
    found = [
        f"{nodes[message.node]}.{item.name}"
        for time, message in _messages(bag, "/parameter_events")
        if message.node in nodes and times[topics.ARMED][-1] < time <= times[topics.RESULT][-1]
        for item in message.changed_parameters
    ]
    return tuple(dict.fromkeys(found))


def _clouds(bag: Bag, name: str, columns: Sequence[str], span: PartSpan) -> tuple[tuple[float, Array], ...]:
    """Of the topic ``name``, of the part."""
    return tuple(
        (
            stamp_of(message),
            fields.cloud_columns(message, columns) if message.data.size else np.empty((0, len(columns))),
        )
        for time, message in _messages(bag, name)
        if span.holds(time)
    )


@dataclass(frozen=True)
class _Stream:
    """(n,) ns, stamp and time of receipt, and (n, C) values of the newest message of every stamp."""

    stamp: Indices
    received: Indices
    values: Array


def _streams(bag: Bag, namespace: str, began: int) -> dict[str, _Stream]:
    """Wrenches, targets and poses, in one pass through the file."""
    wanted = {f"tool_{k}/{kind}": WRENCH if kind == "wrench" else POSITION for k in (1, 2) for kind in _KINDS}
    connections = {name: bag.connections[full] for name in wanted if (full := f"{namespace}/{name}") in bag.connections}
    parts: dict[str, list[Columns]] = {name: [] for name in connections}
    for name, columns in read_tables(bag.raw, connections):
        parts[name].append({key: columns[key] for key in ("received", "header.stamp", *wanted[name])})
    return {name: _stream(found, wanted[name], began) for name, found in parts.items() if found}


_KINDS = ("wrench", "target", "pose")


def _stream(parts: list[Columns], names: tuple[str, ...], began: int) -> _Stream:
    table = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    order = np.argsort(table["received"], kind="stable")
    order = order[table["received"][order] >= began]
    stamp = table["header.stamp"][order]
    # of a stamp that came several times (signs of life, a tare) the newest counts
    _, last = np.unique(stamp[::-1], return_index=True)
    chosen = order[len(stamp) - 1 - last]
    values = np.column_stack([table[name][chosen] for name in names])
    return _Stream(table["header.stamp"][chosen], table["received"][chosen], values)


def _ticks(streams: dict[str, _Stream], part: PartRecord) -> Ticks | None:
    wrenches = [streams.get(f"tool_{k}/wrench") for k in (1, 2)]
    targets = [streams.get(f"tool_{k}/target") for k in (1, 2)]
    if any(stream is None or not len(stream.stamp) for stream in (*wrenches, *targets)):
        return None
    (w1, w2), (t1, t2) = wrenches, targets
    assert w1 is not None and w2 is not None and t1 is not None and t2 is not None  # noqa: PT018, checked above
    due, at_1, at_2 = np.intersect1d(t1.stamp, t2.stamp, assume_unique=True, return_indices=True)
    target = np.hstack([t1.values[at_1], t2.values[at_2]])
    poses = [(k, stream) for k in (1, 2) if (stream := streams.get(f"tool_{k}/pose")) is not None]
    pose_stamp = np.concatenate([stream.stamp for _, stream in poses]) if poses else np.empty(0, dtype=np.int64)
    pose = np.vstack([np.empty((0, 4)), *(np.column_stack([np.full(len(s.stamp), k), s.values]) for k, s in poses)])
    order = np.argsort(pose_stamp, kind="stable")
    pose_stamp, pose = pose_stamp[order], pose[order]
    if not part.lockstep:
        received = t1.received[at_1]
        first, second = (np.searchsorted(np.sort(w.received), received, side="right") - 1 for w in (w1, w2))
        known = (first >= 0) & (second >= 0)
        wrench = np.hstack(
            [w.values[np.argsort(w.received, kind="stable")][k[known]] for w, k in ((w1, first), (w2, second))]
        )
        return Ticks(due[known], wrench, target[known], pose_stamp, pose, False, int((~known).sum()))
    pair, of_1, of_2 = np.intersect1d(w1.stamp, w2.stamp, assume_unique=True, return_indices=True)
    # the tick of stamp t_k was made when targets for t_(k+1) went out
    answered = np.searchsorted(due, pair, side="right")
    inside = answered < len(due)
    number = np.round(pair * (part.control_rate / NANO)).astype(np.int64)
    next_number = np.round(due[np.minimum(answered, len(due) - 1)] * (part.control_rate / NANO)).astype(np.int64)
    known = inside & (next_number == number + 1)
    # time goes on where a tick was answered, also where the answer is not in the bag
    taken = np.flatnonzero(known | np.isin(number + 1, number))
    wrench = np.hstack([w1.values[of_1[taken]], w2.values[of_2[taken]]])
    answer = np.where(known[taken, None], target[np.minimum(answered[taken], len(due) - 1)], np.nan)
    return Ticks(pair[taken], wrench, answer, pose_stamp, pose, True, len(due) - int(known.sum()))
