"""A part from a bag, without ROS: the message definitions are read from the bag itself.

Reads bags of the recorder, of ``ros2 bag record`` (MCAP or SQLite) and of :mod:`isf_analysis.bag.bag_writer`, in any
namespace. When a bag holds several parts, the last one is read.
"""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator
from dataclasses import MISSING, dataclass
from dataclasses import fields as dataclass_fields
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from isf_core import __version__
from isf_core.contour import Contour, ContourCorrection, ContourResult, contour_label, with_floor_passes
from isf_core.errors import ErrorCode, IsfError
from isf_core.files import yaml_file
from isf_core.files.job import Job
from isf_core.files.rig import load_rig
from isf_core.files.yaml_file import find_shipped
from isf_core.geometry.height_map import HeightMap
from isf_core.thinned_sheet import ThinnedSheet
from isf_core.types import Array
from isf_ros import fields
from rosbags.interfaces import Connection

from isf_analysis.bag import gaps, sheet_health, topics
from isf_analysis.bag.open_bag import RECORD_WITH, OpenBag, open_bag, unreadable
from isf_analysis.bag.sheet_health import KINETIC
from isf_analysis.bag.topics import Topic
from isf_analysis.measures import scan_cloud
from isf_analysis.measures.contour_scan import ContourScan, kept_scan
from isf_analysis.measures.events import event_of_message
from isf_analysis.measures.part_time import from_beginning
from isf_analysis.measures.record import PartRecord, Vector

NANO = 1_000_000_000

AFTER_LAST_RESULT = 2 * NANO
"""ns after the last result in which the machine has told of its sheet, once a second."""

_FIELDS = {
    topics.NOMINAL: (fields.CONTOUR, Contour),
    topics.CORRECTED: (fields.CONTOUR, Contour),
    topics.CORRECTION: (fields.CORRECTION, ContourCorrection),
    topics.RESULT: (fields.RESULT, ContourResult),
}
"""Fields of a message and the class that is made of them."""

Item = TypeVar("Item", Contour, ContourCorrection, ContourResult)


def read_bag(path: Path | str, namespace: str | None = None) -> PartRecord:
    """Record of the (last) part in the bag folder or MCAP file ``path``; of the cell ``namespace``, None: the only one.

    A bag whose recorder was killed is read as far as it was written; ``notes`` of the record tells so. Times count from
    the beginning of the part.

    Raises
    ------
    IsfError : BAG_UNREADABLE (no such bag, damaged beyond reading),
        BAG_INCOMPLETE (not a bag of a cell, or nothing was formed; names what is missing),
        FILE_FIELD (it holds several cells, or none of that name)
    """
    with open_bag(path) as bag:
        return from_beginning(*_part_and_rests(bag, namespace))


def read_cell(path: Path | str, namespace: str | None) -> PartRecord:
    """As :func:`read_bag`, where ``namespace`` chooses among several cells: a bag of one is read whatever its name."""
    with open_bag(path) as bag:
        return from_beginning(*_part_and_rests(bag, namespace if len(_cells_of(bag)) > 1 else None))


@dataclass(frozen=True)
class PartSpan:
    """What belongs to a part.

    Attributes
    ----------
    plan_id : of its plan
    start : ns since 1970, messages received before are of another part
    announced : ns since 1970, when its job was announced, last
    begun : ns since 1970, when its job was announced, first: a part that was resumed is announced again
    dropped : (after, before) ns since 1970: what was formed beyond the checkpoint with which the part went on
    went_on : contours with which it did
    until : ns since 1970, messages received from then on are of another part
    copies : how often the bag holds what was recorded of it; the last one counts
    """

    plan_id: str
    start: int
    announced: int
    begun: int
    dropped: tuple[tuple[int, int], ...] = ()
    went_on: tuple[int, ...] = ()
    until: float = math.inf
    copies: int = 1

    def holds(self, time: int) -> bool:
        """True for a message received at ``time`` (ns since 1970)."""
        return self.start <= time < self.until and not any(begin < time < end for begin, end in self.dropped)


def last_part(bag: OpenBag, namespace: str | None = None) -> PartSpan:
    """The last part in ``bag``; raises IsfError as :func:`read_bag`."""
    try:
        return _last_span(_Messages(bag, namespace))
    except IsfError:
        raise
    except Exception as error:  # a damaged file shows in as many ways as there are bytes
        raise unreadable(bag.path, f"is damaged: {error}") from error


def _last_span(messages: _Messages) -> PartSpan:
    jobs = list(_first_heard(messages.of(topics.JOB)))
    # a bag beside the first is that of a rest: what else is announced in it is of another part of the cell, latched
    later = sorted(reader.start_time for reader in messages.bag.readers[1:])
    goes_on = min(later, default=math.inf)
    plans = {job.plan_id for time, job in jobs if time < goes_on}
    jobs = [(time, job) for time, job in jobs if time < goes_on or _is_rest(job, plans)]
    if not jobs:
        raise _incomplete(messages.bag.path, f"holds no job: nothing was received on {topics.JOB.name}")
    announced, job = jobs[-1]
    first = len(jobs) - 1
    until = min((time for time in later if time > announced), default=math.inf)
    dropped, went_on = [], []
    while first > 0 and _goes_on(jobs[first][1], jobs[first - 1][1]):
        (again, resumed), since = jobs[first], jobs[first - 1][0]
        beyond = [
            time
            for time, contour in messages.of(topics.NOMINAL)
            if contour.plan_id == job.plan_id and contour.index >= resumed.first_index and since <= time < again
        ]
        if not beyond:  # nothing to be left out but the time in which nobody formed the part
            news = (topics.NOMINAL, topics.RESULT, topics.SCAN)
            heard = (
                time
                for topic in news
                for time, item in _first_heard(messages.of(topic))
                if time < again and getattr(item, "plan_id", job.plan_id) == job.plan_id
            )
            beyond = [max(heard, default=again)]
        dropped.append((min(beyond), again))
        went_on.append(int(resumed.first_index))
        first -= 1
    begun = jobs[first][0]
    if not went_on and (copies := _copied(messages, job)):
        return PartSpan(job.plan_id, copies[-1], copies[-1], copies[-1], until=until, copies=1 + len(copies))
    # a recorder that joined late may get the latched contour before the latched job; of a single part all is wanted
    start = begun if first > 0 else 0
    return PartSpan(job.plan_id, start, announced, begun, tuple(dropped), tuple(went_on), until)


def _copied(messages: _Messages, job: Any) -> list[int]:
    """Receive times (ns) of the announcements of ``job`` with which the bag holds the same recording once more: the
    same results, which are not latched, were received before and after it."""
    stamp = _stamp(job)
    if not any(stamp):  # made by write_bag
        return []
    told = list(messages.of(topics.JOB))
    again = [time for time, other in told if (_stamp(other), other.plan_id) == (stamp, job.plan_id)][1:]
    results = [(time, _result_key(item)) for time, item in messages.of(topics.RESULT) if item.plan_id == job.plan_id]

    def both_sides(begin: int) -> bool:
        before, after = ({key for time, key in results if (time < begin) is side} for side in (True, False))
        return bool(before & after)

    return [begin for begin in again if both_sides(begin)]


def _stamp(message: Any) -> tuple[int, int]:
    return message.header.stamp.sec, message.header.stamp.nanosec


def _result_key(result: Any) -> tuple[int, int, int]:
    return (result.index, *_stamp(result))


def _is_rest(job: Any, plans: Collection[str]) -> bool:
    """True when ``job`` may announce the rest of a part of one of the ``plans``, of which none may be known."""
    return getattr(job, "first_index", 0) > 0 and (not plans or job.plan_id in plans)


def _first_heard(received: Iterable[tuple[int, Any]]) -> Iterator[tuple[int, Any]]:
    """Without the latched messages that the recorder of a part that goes on in the same cell received once more."""
    seen = set()
    for time, message in received:
        names = (getattr(message, name, None) for name in ("plan_id", "index", "first_index"))
        key = (*_stamp(message), *names)
        if key not in seen or not any(key[:2]):  # a bag that was made by write_bag has none
            seen.add(key)
            yield time, message


def _goes_on(job: Any, before: Any) -> bool:
    """True when ``job`` announces the rest of the part of the one ``before``."""
    return getattr(job, "first_index", 0) > 0 and (job.plan_id, job.correction) == (before.plan_id, before.correction)


def part_of(bag: OpenBag, namespace: str | None = None) -> PartRecord:
    """As :func:`read_bag`, of a bag that is open; times are those of the stamps of its messages."""
    return _part_and_rests(bag, namespace)[0]


def _part_and_rests(bag: OpenBag, namespace: str | None) -> tuple[PartRecord, tuple[int, ...]]:
    """Record of the part, and by the clock, which goes on meanwhile, the contours with which the part went on."""
    try:
        messages = _Messages(bag, namespace)
        span = _last_span(messages)
        record = _read_part(messages, span, bag.path)
        return record, () if record.lockstep else span.went_on
    except IsfError as error:
        if not bag.notes:
            raise
        what = f"{error.what} ({'; '.join(bag.notes)})"  # it may be in the part that was left out
        raise IsfError(error.code, what, where=error.where, advice=error.advice) from error
    except Exception as error:  # a damaged file shows in as many ways as there are bytes
        raise unreadable(bag.path, f"is damaged: {error}") from error


def _read_part(messages: _Messages, span: PartSpan, path: Path) -> PartRecord:
    job = [job for time, job in messages.of(topics.JOB) if (time, job.plan_id) == (span.announced, span.plan_id)][-1]
    part = _Part(messages, span)
    notes = messages.missing_fields()
    nominal = with_floor_passes(part.by_index(topics.NOMINAL, fields.contour_of))
    corrected = part.by_index(topics.CORRECTED, fields.contour_of)
    corrections = part.by_index(topics.CORRECTION, fields.correction_of)
    results = part.by_index(topics.RESULT, fields.result_of)
    if not nominal and not results:
        raise _incomplete(path, f"holds the job '{job.job_name}', but no contour: nothing was formed")
    received = part.received()
    jumps, news = gaps.jumps_back(received), received[-1][1]
    # a scan that was received before is of another part, unless the clock was set back meanwhile
    start = min(time for _, time in received) if jumps else span.begun
    # the target is latched when the part is planned, before the job is announced; the scan comes after it
    target_message = _last(item for item in messages.of(topics.TARGET) if item[0] < span.until)
    target, preforms = (None, ()) if target_message is None else fields.target_of(target_message[1])
    scans = [item for item in messages.of(topics.SCAN) if item[0] >= start and span.holds(item[0])]
    formed = max((result.end for result in results), default=math.inf)
    final = scan_cloud.final_scans(scans, formed, part.unfinished_since(results), news)
    last = final[-1:]
    scan, scan_notes = _scan(last, target)
    missing = ([] if target else [topics.TARGET.name]) + ([] if last else [_no_scan(len(scans))])
    missing += gaps.contours_missing(nominal, corrected, corrections, results)
    if any(_stamp(job)):  # by the nodes of a cell: a run in one process has no streams
        missing += [topic.name for topic in gaps.needed_streams(nominal) if not messages.heard(topic, span)]
    end = scans[-1][0] if last else part.last_result()
    told = [item for item in messages.of(topics.FORMED_SHEET) if item[0] >= start and span.holds(item[0])]
    formed_sheet, sheet_notes = _formed_sheet(
        scan_cloud.final_scans(told, formed, part.unfinished_since(results), news)
    )
    told = [item for item in messages.of(topics.RELEASED_PART) if item[0] >= start and span.holds(item[0])]
    released, released_notes = _released(scan_cloud.final_scans(told, formed, part.unfinished_since(results), news))
    before, after = messages.states(span)
    return PartRecord(
        job_name=job.job_name,
        job_text=job.job_text,
        plan_id=job.plan_id,
        process=job.process,
        correction=job.correction,
        support_force=job.support_force,
        variant=job.world,
        seed=job.seed,
        control_rate=job.control_rate,
        lockstep=job.lockstep,
        software=job.software,
        nominal=nominal,
        corrected=corrected,
        corrections=corrections,
        results=results,
        target=target,
        preforms=preforms,
        scan=scan,
        ticks=_counted(before, after, "tick"),
        late_ticks=_counted(before, after, "late_ticks") + sum(result.late_ticks for result in results),
        lost_messages=_counted(before, after, "targets_lost") + sum(result.lost_messages for result in results),
        sim_time=_process_time(before, after, results) - (0.0 if job.lockstep else _passed(span) / NANO),
        wall_time=(end - span.begun - _passed(span, end) + sum(back for _, back in jumps)) / NANO,
        faults=_faults(after),
        notes=(
            *messages.bag.notes,
            *notes,
            *_of_version(job.software),
            *part.copied(),
            *_jumped(jumps),
            *scan_notes,
            *sheet_notes,
            *released_notes,
            *(f"not in the bag: {what}" for what in missing),
        ),
        events=tuple(event_of_message(event) for time, event in messages.of(topics.EVENT) if span.holds(time)),
        scans=_between(scans[: len(scans) - len(final)], results),
        sheet=_sheet(job, messages.kinetic_over_plastic(span)),
        base_folder=getattr(job, "base_folder", ""),
        plan_warnings=tuple(getattr(job, "plan_warnings", ())),
        axis_error=_axis_error(after),
        tool_compliance=_tool_compliance(messages, job),
        formed_sheet=formed_sheet,
        released=released,
    )


@dataclass(frozen=True)
class _Part:
    """The messages of one part."""

    messages: _Messages
    span: PartSpan

    def by_index(self, topic: Topic, convert: Callable[[Any], Item]) -> tuple[Item, ...]:
        """Items in the order of their contours; of an index that came twice the last counts."""
        found = {message.index: convert(message) for _, message in self._own(topic)}
        return tuple(found[index] for index in sorted(found))

    def unfinished_since(self, results: tuple[ContourResult, ...]) -> int:
        """Receive time (ns since 1970) of the first contour after the last of the ``results``; 0 when there is none."""
        last = max((result.index for result in results), default=-1)
        return min((time for time, item in self._own(topics.NOMINAL) if item.index > last), default=0)

    def received(self) -> list[tuple[str, int]]:
        """(where, receive time in ns since 1970) of job, contours and results, in the order in which they were sent."""
        times: dict[str, dict[int, int]] = {
            topic.name: {item.index: time for time, item in self._own(topic)}
            for topic in (topics.NOMINAL, topics.RESULT)
        }
        begun, ended = times[topics.NOMINAL.name], times[topics.RESULT.name]
        found = [("the job", self.span.begun)]
        for index in sorted({*begun, *ended}):
            label = contour_label(index)
            # a contour is latched: one that came after its result was received once more
            if index in begun and begun[index] <= ended.get(index, math.inf):
                found.append((f"the beginning of {label}", begun[index]))
            if index in ended:
                found.append((f"the result of {label}", ended[index]))
        return found

    def last_result(self) -> int:
        """Receive time (ns since 1970) of the result of the last contour; of the job when there is none."""
        ended = {item.index: time for time, item in self._own(topics.RESULT)}
        return ended[max(ended)] if ended else self.span.begun

    def copied(self) -> tuple[str, ...]:
        """A note where the bag holds the same recording of the part more than once."""
        keys = [_result_key(item) for _, item in self._own(topics.RESULT) if any(_stamp(item))]
        times = max(self.span.copies, *Counter(keys).values(), 1)
        return (f"the bag holds this recording of the part {times} times: the last one is read",) if times > 1 else ()

    def _own(self, topic: Topic) -> Iterator[tuple[int, Any]]:
        """(receive time in ns, message) of a contour of this part."""
        for time, item in self.messages.of(topic):
            if item.plan_id == self.span.plan_id and self.span.holds(time):
                yield time, item


def _passed(span: PartSpan, until: float = math.inf) -> int:
    """ns up to ``until`` of what does not belong to the part, the time in which nobody formed it included."""
    return sum(int(min(end, until)) - int(min(begin, until)) for begin, end in span.dropped)


def _jumped(jumps: list[tuple[str, int]]) -> tuple[str, ...]:
    """A note on times of receipt that jump back."""
    if not jumps:
        return ()
    told = ", ".join(f"{back / NANO:.1f} s or more after {where}" for where, back in jumps)
    return (
        f"the times of receipt jump back by {told} (a clock that was set, or bags put together): the wall time leaves "
        "that out, and is too small by what passed meanwhile",
    )


def _between(scans: list[tuple[int, Any]], results: tuple[ContourResult, ...]) -> tuple[ContourScan, ...]:
    """Scans made between contours; of a contour the last one. Those before the end of the first one are left out."""
    found: dict[int, ContourScan] = {}
    for _, message in scans:
        time = scan_cloud.stamp_of(message)
        formed = [result.index for result in results if result.end <= time + scan_cloud.SCAN_TOLERANCE]
        if formed:
            found[formed[-1]] = kept_scan(formed[-1], time, scan_cloud.points_of(message))
    return tuple(found[index] for index in sorted(found))


def _scan(last: list[Any], target: HeightMap | None) -> tuple[HeightMap | None, tuple[str, ...]]:
    """The shape by the ``last`` of the scans of the finished part, if any, and why it is left out if so."""
    if not last:
        return None, ()
    try:
        return scan_cloud.height_map_of(last[0], target), ()
    except IsfError as error:
        code = f"{error.code.value} {error.code.name}"
        return None, (f"the scan of the finished part is left out: {error.what} ({code}; {error.advice})",)


def _formed_sheet(told: list[Any]) -> tuple[ThinnedSheet | None, tuple[str, ...]]:
    """The last of the sheets ``told`` after the part was formed, and why it is left out if so."""
    if not told:
        return None, ()
    try:
        return fields.thinned_sheet_of(told[-1]), ()
    except ValueError as error:
        return None, (f"{topics.FORMED_SHEET.name} is left out: {error}",)


def _released(told: list[Any]) -> tuple[Array | None, tuple[str, ...]]:
    """Points of the last of the parts out of the clamp that were ``told``, and why they are left out if so."""
    if not told:
        return None, ()
    try:
        return scan_cloud.points_of(told[-1]), ()
    except IsfError as error:
        return None, (f"{topics.RELEASED_PART.name} is left out: {error.what}",)


def _of_version(software: str) -> tuple[str, ...]:
    """A note when another version of the software formed the part."""
    if software in ("", __version__):
        return ()
    return (f"the part was formed with version {software} of the software, this report is made with {__version__}",)


def _no_scan(between: int) -> str:
    words = f", only {between} made before the last contour" if between else ""
    return f"{topics.SCAN.name}{words}"


def _sheet(job: Any, kinetic: float | None) -> dict[str, object]:
    """Model of the simulated sheet, and its kinetic energy where it was told; empty for a real machine and for bags
    that do not name it yet."""
    model = getattr(job, "sheet", "")
    proof = {} if kinetic is None or model == "fast" else {KINETIC: kinetic}
    return {"model": model, **proof} if model else {}


def _counted(before: Any, after: Any, name: str) -> int:
    return max(0, int(getattr(after, name)) - int(getattr(before, name))) if after is not None else 0


def _process_time(before: Any, after: Any, results: tuple[ContourResult, ...]) -> float:
    """s from the first to the last state of the machine, or over the contours when it published none, or one."""
    if after is not before:
        first, last = before.header.stamp, after.header.stamp
        return float((last.sec - first.sec) + (last.nanosec - first.nanosec) / NANO)
    return results[-1].end - results[0].start if results else 0.0


def _faults(state: Any) -> tuple[tuple[int, str], ...]:
    if state is None:
        return ()
    texts = (*state.fault_messages, *("without a text" for _ in state.fault_codes))  # a driver may leave them out
    return tuple((int(code), text) for code, text in zip(state.fault_codes, texts, strict=False))


def _axis_error(state: Any) -> tuple[float, float] | None:
    """None where the machine does not tell it, as in older bags."""
    largest = float(getattr(state, "axis_error_largest", 0.0))
    return (float(state.axis_error_rms), largest) if state is not None and largest > 0.0 else None


def _tool_compliance(messages: _Messages, job: Any) -> tuple[Vector, Vector] | None:
    """As force control was armed with; of a part formed in one process, which arms no node, that of the rig by name."""
    try:
        armed = [message for _, message in messages.of(topics.ARMED) if message.plan_id == job.plan_id]
        if not armed:
            name = yaml_file.parse(job.job_text, Job, "job").rig
            rig = load_rig(str(find_shipped("rigs", name)))  # never a file that a bag names
            return rig.tool_1.compliance, rig.tool_2.compliance
        settings = json.loads(armed[-1].settings)
        plane = settings["forming_compliance"], settings["support_compliance"]
        first, second = (
            (float(x), float(y), float(z)) for (x, y), z in zip(plane, settings["axial_compliance"], strict=True)
        )
    except (IsfError, OSError, ValueError, TypeError, KeyError):
        return None
    return first, second


def _last(items: Iterable[tuple[int, Any]]) -> tuple[int, Any] | None:
    found = None
    for item in items:
        found = item
    return found


class _Messages:
    """The messages of an open bag by topic."""

    def __init__(self, bag: OpenBag, namespace: str | None) -> None:
        self.bag = bag
        self._namespace = namespace_of(bag, namespace)
        self._read: dict[str, list[tuple[int, Any]]] = {}

    def of(self, topic: Topic) -> Iterator[tuple[int, Any]]:
        """(receive time in ns, message) in the order of receipt."""
        if topic.name not in self._read:
            self._read[topic.name] = list(self._load(topic))
        return iter(self._read[topic.name])

    def heard(self, topic: Topic, span: PartSpan) -> bool:
        """True when anything was received on ``topic`` during the part; no message is looked into."""
        return any(
            span.holds(time) for block in self.bag.blocks(self._connections(topic)) for time in block.times.tolist()
        )

    def states(self, span: PartSpan) -> tuple[Any, Any]:
        """State of the machine when the part began, and its last one; both None when there is none.

        At 50 states per second a long part has hundreds of thousands: all but those two are never looked into.
        """
        found: list[tuple[int, int, bytes]] = []
        for number, block in enumerate(self.bag.blocks(self._connections(topics.MACHINE_STATE))):
            order = np.argsort(block.times, kind="stable")
            order = order[block.times[order] < span.until]
            begun = int(np.searchsorted(block.times[order], span.begun, side="right"))
            # first, the two last ones until the part began, and the last: as below, of the block
            for k in {*order[:1].tolist(), *order[max(0, begun - 2) : begun].tolist(), *order[-1:].tolist()}:
                found.append((int(block.times[k]), (number << 32) + k, block.message(k).tobytes()))
        found.sort()
        if not found:
            return None, None
        # the state at the start of the part, not the last one: a run of no duration has all its messages at one time
        until_begun = [item for item in found[:-1] if item[0] <= span.begun]
        first = (until_begun or found)[-1 if until_begun else 0]
        last = self.bag.types.deserialize_cdr(found[-1][2], topics.MACHINE_STATE.type)
        if first is found[-1]:
            return last, last
        return self.bag.types.deserialize_cdr(first[2], topics.MACHINE_STATE.type), last

    def kinetic_over_plastic(self, span: PartSpan) -> float | None:
        """What the simulated machine told last of its sheet during the part, and of this blank: in the second after
        the last result it has told it, and a new blank begins at 0."""
        ended = max((time for time, _ in self.of(topics.RESULT) if time < span.until), default=span.begun)
        return sheet_health.kinetic_over_plastic(
            self.bag, self._namespace, span.begun, min(span.until, ended + AFTER_LAST_RESULT)
        )

    def _load(self, topic: Topic) -> Iterator[tuple[int, Any]]:
        for connection in self._connections(topic):
            yield from self.bag.messages([connection])

    def _connections(self, topic: Topic) -> list[Connection]:
        name = f"{self._namespace}/{topic.name}"
        found = [connection for connection in self.bag.connections if connection.topic == name]
        for connection in found:
            if connection.msgtype != topic.type:
                what = f"{topic.name} is of type {connection.msgtype}, expected {topic.type}"
                raise _incomplete(self.bag.path, what)
        return found

    def missing_fields(self) -> tuple[str, ...]:
        """Notes on fields that messages of an older version do not have; raises IsfError when one is needed."""
        notes = []
        for topic, (names, kind) in _FIELDS.items():
            name = f"{self._namespace}/{topic.name}"
            known = next((c.msgtype for c in self.bag.connections if c.topic == name), None)
            if known != topic.type:
                continue
            there = {field for field, _ in self.bag.types.fielddefs[known][1]}
            needed = {item.name for item in dataclass_fields(kind) if item.default is item.default_factory is MISSING}
            lacking = [field for field in names if field not in there]
            if any(field in needed for field in lacking):
                what = f"{topic.name} has no {', '.join(lacking)}"
                raise _incomplete(self.bag.path, f"was recorded with another version of the software: {what}")
            if lacking:
                notes.append(
                    f"recorded with an older version of the software: {topic.name} without {', '.join(lacking)}"
                )
        return tuple(notes)


def namespace_of(bag: OpenBag, wanted: str | None = None) -> str:
    """Namespace of the cell ``wanted``, or of the only one, from the topic that carries the job.

    Raises
    ------
    IsfError : BAG_INCOMPLETE, not a bag of a cell; FILE_FIELD, it holds several cells, or none of that name
    """
    cells = _cells_of(bag)
    if not cells:
        known = sorted({item.topic for item in bag.connections})
        listed = ", ".join(known[:6]) + (" ..." if len(known) > 6 else "")
        raise _incomplete(
            bag.path,
            f"is not a bag of a forming cell: no topic {topics.JOB.name} (needed with {topics.NOMINAL.name} and "
            f"{topics.RESULT.name}); it holds {listed or 'nothing'}",
        )
    listed = ", ".join(cell or "/" for cell in cells)
    if wanted is not None:
        asked = "/" + wanted.strip("/") if wanted.strip("/") else ""
        if asked not in cells:
            raise IsfError(
                ErrorCode.FILE_FIELD, f"holds no cell '{wanted}'", where=str(bag.path), advice=f"it holds {listed}"
            )
        return asked
    if len(cells) > 1:
        raise IsfError(
            ErrorCode.FILE_FIELD,
            f"holds {len(cells)} cells: {listed}",
            where=str(bag.path),
            advice=f"choose one: --namespace {cells[-1]}",
        )
    return cells[0]


def _cells_of(bag: OpenBag) -> list[str]:
    """Namespaces of the cells in ``bag``, from the topics that carry jobs."""
    ending = f"/{topics.JOB.name}"
    return sorted({item.topic.removesuffix(ending) for item in bag.connections if item.topic.endswith(ending)})


def _incomplete(path: Path, what: str) -> IsfError:
    return IsfError(ErrorCode.BAG_INCOMPLETE, what, where=str(path), advice=RECORD_WITH)
