"""Node ``recorder``: writes the topics of a cell to a bag as they are, without looking into a message.

Subscriptions are raw and polled: a timer takes everything that has arrived, in batches. Waking the executor for each
message costs ten times as much as storing it; the times of receipt are those the middleware took, not the timer's.
Lost messages are counted by gaps in the middleware's sequence numbers; the "message lost" event of the subscription
would wake the executor for every message and cost most of a processor core at 3000 messages a second.

With a ring it keeps the last seconds in memory and writes a bag of them when a node reports a fault, or is asked to.
"""

from __future__ import annotations

import importlib
import math
import sys
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from struct import unpack_from
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped, WrenchStamped
from isf_core.errors import ErrorCode, IsfError
from isf_ros import process, qos
from isf_ros.lifecycle import CellNode
from isf_ros.parameters import parameter
from isf_ros.polled import Polled, polled_subscription, taken
from isf_ros.qos_match import best_effort, kept_apart, nothing_comes, taken_best_effort
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message
from rclpy.subscription import Subscription
from std_srvs.srv import Trigger

from isf_analysis.bag.bag_file import COMPRESSIONS, NANO, STORAGES, Storage, check_free
from isf_analysis.bag.recording import Message, Recording
from isf_analysis.bag.ring import Ring
from isf_analysis.bag.text_log import LogFile, pose_angles
from isf_analysis.bag.topics import CELL, TRANSFORMS, Topic

EXIT_INCOMPLETE = 6
"""Exit code of a recorder whose bag does not hold what it was to record: that of ``isf`` for a bag."""

POLL_PERIOD = 0.02
"""s between two looks at the subscriptions."""

DELIVERY_PERIOD = 0.5
"""s between two looks at who publishes what did not come yet."""

QUEUE_DEPTHS = {"STREAM": 4000, "SENSOR": 2000, "LATCHED": 100, "EVENT": 500, "CHANGES": 500, "DEFAULT": 500}
"""Messages a subscription holds between two looks: 4 s of a stream at 1 kHz, should this process be held up."""

MEGABYTE = 1_000_000

ERROR = int.from_bytes(DiagnosticStatus.ERROR, "little")

DIAGNOSTICS = "/diagnostics"

NODE_OF_A_CELL = "isf"
"""``hardware_id`` of the cells' own nodes, whose names in ``/diagnostics`` begin with the namespace of their cell."""

_COUNTED = ("STREAM", "LATCHED", "EVENT")
"""Kinds of delivery that are reliable and have one publisher: there a gap means a loss."""


@dataclass(frozen=True)
class RecorderParameters:
    """Parameters of the recorder."""

    output: str = parameter(
        "", "folder of the bag; must not exist; empty: recording-DATE-TIME here; the next of this process: NAME-2"
    )
    topics: tuple[str, ...] = parameter(tuple(topic.name for topic in CELL), "topics to record, as in topics.CELL")
    storage: str = parameter(
        "mcap", "kind of the files: mcap, or sqlite3 for tools that read nothing else", choices=STORAGES
    )
    compression: str = parameter(
        "none", "none or zstd (a fifth of the size, more processor time); mcap alone", choices=COMPRESSIONS
    )
    split_size: float = parameter(
        0.0, "messages after which the bag goes on in its next file; 0: one file", unit="MB", minimum=0.0
    )
    split_time: float = parameter(
        0.0, "time after which the bag goes on in its next file; 0: one file", unit="s", minimum=0.0
    )
    queue_size: float = parameter(
        256.0, "what may wait for a slow disk before messages of streams are left out", unit="MB", minimum=1.0
    )
    text_log: str = parameter(
        "", "also a text file of 12 columns, 20 rows per second of the machine's time; must not exist; empty: none"
    )
    ring: float = parameter(
        0.0,
        "keep the last time in memory, and write it when a node reports a fault or snapshot is called; 0: write all",
        unit="s",
        minimum=0.0,
    )
    ring_after: float = parameter(5.0, "time after the last fault that belongs to the same bag", unit="s", minimum=0.0)
    ring_size: float = parameter(512.0, "memory of the ring; what is older goes", unit="MB", minimum=1.0)


class RecorderNode(CellNode[RecorderParameters]):
    """Records while active; the bag is closed on deactivation and at the end of the process."""

    def __init__(self) -> None:
        super().__init__("recorder", RecorderParameters)
        self._topics: list[Topic] = []
        self._output = self._first = Path()
        self._recordings = 0
        self._recording: Recording | None = None
        self._storage = Storage()
        self._ring: Ring | None = None
        self._faulty: set[str] = set()
        self._ends_at = 0.0
        self._told_left_out = False
        self._subscriptions_polled: list[Subscription] = []
        self._timer: Any = None
        self._received: dict[str, int] = {}
        self._lost: dict[str, int] = {}
        self._sequence: dict[str, int] = {}
        self._not_delivered: set[str] = set()
        self._not_installed: list[str] = []
        self._log: TextSamples | None = None
        self.failure: IsfError | None = None
        """What first kept it from recording all that came."""
        self.create_service(Trigger, "recorder/snapshot", self._snapshot)

    @property
    def exit_code(self) -> int:
        return EXIT_INCOMPLETE if self.failure else process.EXIT_OK

    def report(self, error: IsfError) -> None:
        """As every node; the exit code tells it too."""
        super().report(error)
        self.failure = self.failure or error

    def configure(self) -> None:
        values = self.values()
        wanted = [_topic(name) for name in values.topics]
        self._topics = [topic for topic in wanted if _message_class(topic.type) is not None]
        self._not_installed = [topic.name for topic in wanted if topic not in self._topics]
        asked_for = tuple(values.topics) != RecorderParameters.topics
        if self._not_installed and asked_for:
            raise IsfError(
                ErrorCode.BAG_NOT_WRITABLE,
                f"the messages of {', '.join(self._not_installed)} are not installed",
                where="parameter topics",
                advice="install their package, or leave these topics out",
            )
        self._storage = Storage(
            values.storage, values.compression, round(values.split_size * MEGABYTE), values.split_time
        )
        output = Path(values.output or time.strftime("recording-%Y%m%d-%H%M%S")).absolute()
        if output != self._first:
            check_free(output)
            self._first, self._recordings = output, 0

    def activate(self) -> None:
        self._received = {topic.name: 0 for topic in self._topics}
        self._lost = {}
        self._sequence = {}
        self._not_delivered = set()
        values = self.values()
        self._ring = None
        if values.ring:
            latched = {number for number, topic in enumerate(self._topics) if topic.delivery == "LATCHED"}
            joint = {number for number in latched if self._topics[number].type == TRANSFORMS}
            self._ring = Ring(round(values.ring * NANO), round(values.ring_size * MEGABYTE), latched, joint)
            self._faulty = set()
        else:
            self._recording = self._begin()
        try:
            self._begin_log()
        except IsfError:  # the transition fails, and nobody would end the bag
            if self._recording is not None:
                self._close_recording()
            raise
        self._group = Polled()
        self._subscriptions_polled = [self._subscribe(topic, _profile(topic)) for topic in self._topics]
        self._delivery = self.create_timer(DELIVERY_PERIOD, self._check_delivery, clock=self.steady_clock)
        self._timer = self.create_timer(POLL_PERIOD, self._poll, clock=self.steady_clock)

    def _begin_log(self) -> None:
        """The log of text, where one is wanted; raises IsfError."""
        if text_log := self.values().text_log:
            numbers = {topic.name: number for number, topic in enumerate(self._topics)}
            path = Path(text_log).absolute()
            if self._recordings > 1:  # activated once more, as the bag
                path = path.with_stem(f"{path.stem}-{self._recordings}")
            self._log = TextSamples(LogFile(path), [numbers.get(name) for name in LOGGED_TOPICS])

    def _begin(self) -> Recording:
        """A new bag, named after the first one."""
        values = self.values()
        names = [self.resolve_topic_name(topic.name) for topic in self._topics]
        self._recordings += 1
        self._output = self._first
        while self._recordings > 1:  # activated once more, or the next fault: beside the one before
            self._output = self._first.with_name(f"{self._first.name}-{self._recordings}")
            if not self._output.exists():
                break
            self._recordings += 1  # of an earlier process: a fault is not lost for its name
        self._told_left_out = False
        return Recording(
            self._output,
            list(zip(self._topics, names, strict=True)),
            self._storage,
            queue_size=round(values.queue_size * MEGABYTE),
            before=() if self._ring is None else self._ring.messages(),
        )

    def deactivate(self) -> None:
        try:
            self._finish()
        finally:
            self.destroy_timer(self._delivery)
            for subscription in self._subscriptions_polled:
                self.destroy_subscription(subscription)
            self._subscriptions_polled = []

    def close(self) -> None:
        try:
            self._finish()
        except IsfError as error:
            self.failure = self.failure or error
            print(error, file=sys.stderr)

    def health_values(self) -> dict[str, object]:
        recording = self._recording
        silent = [name for name, count in self._received.items() if not count]
        values: dict[str, object] = {
            "output": self._output,
            "received": sum(self._received.values()),
            "lost": sum(self._lost.values()),
            "silent": ", ".join(silent),
        }
        if self._not_installed:
            values["not_installed"] = ", ".join(self._not_installed)
        if self._ring is not None:
            values["ring_s"] = self._ring.held / NANO
        if recording is not None:
            values["written"] = recording.written
            values["longest_queue"] = recording.longest_queue
            values["left_out"] = recording.left_out.total()
        return values

    # -- recording -------------------------------------------------------------------------------

    def _subscribe(self, topic: Topic, profile: QoSProfile) -> Any:
        kind = _message_class(topic.type)
        return polled_subscription(self, kind, topic.name, profile, self._group, raw=True)

    def _check_delivery(self) -> None:
        """Topics of which nothing comes since they are published best effort are taken so; others are reported once."""
        for number, (topic, subscription) in enumerate(zip(self._topics, self._subscriptions_polled, strict=True)):
            asked = subscription.qos_profile
            if (
                self._received[topic.name]
                or topic.name in self._not_delivered
                or not kept_apart(self, topic.name, asked)
            ):
                continue
            looser = best_effort(asked)
            if looser is None:
                self._not_delivered.add(topic.name)
                # at once, since it may end before it knows whose topic it is
                self.failure = self.failure or nothing_comes(self, topic.name, asked)
                self.report_delivery(topic.name, self.report, partial(nothing_comes, self, topic.name, asked))
                continue
            self.report_delivery(topic.name, self.warn, partial(taken_best_effort, self, topic.name, asked))
            self.destroy_subscription(subscription)
            self._subscriptions_polled[number] = self._subscribe(topic, looser)

    def _poll(self) -> None:
        if self._recording is None and self._ring is None:
            return
        batch = self._take()
        self._write_log(batch)
        written = self._recording
        if self._ring is not None:
            self._ring.add(batch)
            self._look_for_faults(batch)  # a bag that begins with it has this batch from the ring
        recording = self._recording
        if recording is None:
            return
        if batch and recording is written:
            recording.add(batch)
        if recording.left_out and not self._told_left_out:
            self._told_left_out = True
            self.report(
                IsfError(
                    ErrorCode.BAG_INCOMPLETE,
                    "the disk does not follow: messages of streams are left out",
                    where=str(recording.path),
                    advice="record fewer topics or to a faster disk, or let more wait (parameter queue_size)",
                )
            )
        if recording.error is not None:
            self._recording = None
            self.report(recording.error)
            with suppress(IsfError):  # the same again: what the disk took is closed as far as it goes
                recording.close()
        elif self._ring is not None and time.monotonic() > self._ends_at:
            self._close_recording()

    def _take(self) -> list[Message]:
        """What has arrived, in the order of its receipt."""
        batch: list[Message] = []
        for number, (topic, subscription) in enumerate(zip(self._topics, self._subscriptions_polled, strict=True)):
            for data, info in taken(subscription):
                batch.append((number, info["received_timestamp"] or time.time_ns(), data))
                self._received[topic.name] += 1
                if topic.delivery in _COUNTED:
                    self._count_gap(topic.name, info["publication_sequence_number"])
        batch.sort(key=_received_at)
        return batch

    def _write_log(self, batch: list[Message]) -> None:
        """Where the disk is full the bag is what counts: it goes on without the log."""
        if self._log is None:
            return
        try:
            for number, _, data in batch:
                self._log.take(number, data)
        except IsfError as error:
            self._log = None
            self.warn(error)

    def _look_for_faults(self, batch: list[Message]) -> None:
        """A node that begins to report an error makes the ring a bag; not one of another cell, nor this one."""
        own, cell = self.get_fully_qualified_name(), self.get_namespace().rstrip("/") + "/"
        for number, _, data in batch:
            if self._topics[number].name != DIAGNOSTICS:
                continue
            for status in deserialize_message(data, DiagnosticArray).status:
                if status.name == own or (status.hardware_id == NODE_OF_A_CELL and not status.name.startswith(cell)):
                    continue
                if int.from_bytes(status.level, "little") < ERROR:
                    self._faulty.discard(status.name)
                elif status.name not in self._faulty:
                    self._faulty.add(status.name)
                    self._keep(f"{status.name}: {status.message}")

    def _keep(self, why: str) -> None:
        """Write the ring and what follows for a while; a fault meanwhile makes it longer."""
        assert self._ring is not None
        self._ends_at = time.monotonic() + self.values().ring_after
        if self._recording is not None:
            return
        try:
            self._recording = self._begin()
        except IsfError as error:
            self.report(error)
            return
        self.get_logger().warning(f"the last {self._ring.held / NANO:.1f} s go to {self._output}: {why}")

    def _snapshot(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """The ring as a bag now, because somebody wants it."""
        if self._ring is None or self._timer is None:
            advice = "set parameter ring to the seconds to keep, then configure and activate"
            refused = IsfError(ErrorCode.FILE_FIELD, "there is no ring", where="recorder/snapshot", advice=advice)
            response.message = str(refused)
            return response
        self._poll()
        self._keep("asked for")
        response.success = self._recording is not None
        refused = IsfError(ErrorCode.BAG_NOT_WRITABLE, "the bag cannot be written", where=str(self._output))
        response.message = str(self._output) if response.success else str(refused)
        return response

    def _finish(self) -> None:
        """Take what has arrived, then close the bag; does nothing when none is open."""
        if self._timer is not None:
            self._timer.cancel()
            self.destroy_timer(self._timer)
            self._timer = None
            self._poll()
        self._ring = None
        self._close_log()
        self._close_recording()

    def _close_log(self) -> None:
        log, self._log = self._log, None
        if log is None:
            return
        try:
            log.close()
        except IsfError as error:
            self.warn(error)

    def _close_recording(self) -> None:
        recording, self._recording = self._recording, None
        if recording is None:
            return
        recording.close()
        lost = "".join(f", {count} of {topic} lost" for topic, count in self._lost.items())
        out = recording.left_out.total()
        left_out = f", {out} left out" if out else ""
        print(f"recorded {recording.written} messages{lost}{left_out} in {recording.path}", file=sys.stderr)

    def _count_gap(self, topic: str, number: int | None) -> None:
        """Count the messages between this one and the one before; a lower number is of a new publisher."""
        if number is None:
            return
        last = self._sequence.get(topic)
        if last is not None and number > last + 1:
            self._lost[topic] = self._lost.get(topic, 0) + number - last - 1
        self._sequence[topic] = number


LOGGED_TOPICS = ("tool_1/pose", "tool_1/wrench", "tool_2/wrench")
LOG_PERIOD = round(0.05 * NANO)
"""ns between two rows of the text log, by the stamps of the wrenches of tool 1."""


class TextSamples:
    """Rows of the text log from messages as they come; only those that a row is made of are looked into.

    ``numbers`` of LOGGED_TOPICS in the recording, None for one that is not recorded. Time begins with the first row,
    the first wrench after the first pose: which of the two a recorder hears first is chance.
    """

    def __init__(self, file: LogFile, numbers: Sequence[int | None]) -> None:
        self._file = file
        self._pose, self._wrench, self._lower = numbers
        self._newest: dict[int, bytes] = {}
        self._first: int | None = None
        self._due = 0

    def take(self, number: int, data: bytes) -> None:
        """Take the message ``data`` of topic ``number``; raises IsfError FILE_NOT_WRITABLE."""
        if number not in (self._pose, self._wrench, self._lower):
            return
        self._newest[number] = data
        if number != self._wrench or (self._pose is not None and self._pose not in self._newest):
            return
        seconds, fraction = unpack_from("<iI", data, 4)  # the stamp is what a message with a header begins with
        stamp = seconds * NANO + fraction
        if stamp < self._due:
            return
        self._first = stamp if self._first is None else self._first
        self._due = stamp + LOG_PERIOD
        self._file.add(np.array([(stamp - self._first) / NANO, *self._tip(), *self._force(number)[:3], *self._below()]))

    def close(self) -> None:
        """End the file; raises IsfError FILE_NOT_WRITABLE."""
        self._file.close()

    def _tip(self) -> list[float]:
        """mm and deg."""
        data = None if self._pose is None else self._newest.get(self._pose)
        if data is None:
            return [math.nan] * 6
        pose = deserialize_message(data, PoseStamped).pose
        place, turned = pose.position, pose.orientation
        angles = pose_angles(turned.x, turned.y, turned.z, turned.w).tolist()
        return [1e3 * place.x, 1e3 * place.y, 1e3 * place.z, *angles]

    def _below(self) -> list[float]:
        if self._lower is None or self._lower not in self._newest:
            return [math.nan] * 2
        return self._force(self._lower)[:2]

    def _force(self, number: int) -> list[float]:
        force = deserialize_message(self._newest[number], WrenchStamped).wrench.force
        return [force.x, force.y, force.z]


def _topic(name: str) -> Topic:
    for topic in CELL:
        if topic.name == name:
            return topic
    raise IsfError(
        ErrorCode.BAG_NOT_WRITABLE,
        f"'{name}' is not a topic of the cell",
        where="parameter topics",
        advice=f"known: {', '.join(topic.name for topic in CELL)}",
    )


def _message_class(name: str) -> Any:
    """None where the package of the message is not installed, as tf2_msgs may be."""
    package, folder, kind = name.split("/")
    try:
        return getattr(importlib.import_module(f"{package}.{folder}"), kind)
    except ModuleNotFoundError:
        return None


def _profile(topic: Topic) -> QoSProfile:
    """The cell's profile for the topic, with a queue that lasts from one look to the next."""
    like = qos.STREAM if topic.delivery == "DEFAULT" else getattr(qos, topic.delivery)
    return QoSProfile(
        history=like.history,
        depth=QUEUE_DEPTHS[topic.delivery],
        reliability=like.reliability,
        durability=like.durability,
    )


def _received_at(message: Message) -> int:
    return message[1]


def main() -> int:
    """Entry point of ``ros2 run isf_analysis recorder``."""
    return process.run(RecorderNode)


if __name__ == "__main__":
    sys.exit(main())
