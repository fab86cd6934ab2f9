"""Node ``dashboard``: hears a cell and serves the page; passes pause and stop on to the nodes that carry them out.

Subscriptions are polled 20 times a second. Of streams the middleware keeps the newest message alone, best effort: what
the page does not show is never taken apart, and a page cannot hold up the cell.
"""

from __future__ import annotations

import asyncio
import os
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, WrenchStamped
from isf_analysis.bag.text_log import LogFile, pose_angles
from isf_analysis.measures import scan_cloud
from isf_analysis.measures.events import HARMLESS, event_of_message
from isf_core.errors import ErrorCode, IsfError, failure
from isf_core.types import Array
from isf_msgs.action import FormPart
from isf_msgs.msg import (
    Contour,
    ContourCorrection,
    ContourResult,
    ExecutiveState,
    ForceCtrlState,
    HandState,
    JobInfo,
    Jog,
    MachineEvent,
    MachineState,
)
from isf_msgs.srv import SetMode, SetZero, Stop
from isf_ros import process, qos, stamps
from isf_ros.conversion import (
    contour_from_message,
    correction_from_message,
    result_from_message,
    target_from_message,
    tip_of,
    wrench_array,
)
from isf_ros.lifecycle import CellNode
from isf_ros.parameters import parameter
from isf_ros.polled import Polled, polled_subscription, taken
from nav_msgs.msg import Path as PathMessage
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import PointCloud2
from std_srvs.srv import SetBool, Trigger

from isf_dashboard.cell_status import CellStatus, NodeStatus
from isf_dashboard.history import COLUMNS, LOGGED, History
from isf_dashboard.part_feed import MM, Job, PartFeed
from isf_dashboard.server import DEFAULT_PORT, RATE, TOKEN_VARIABLE, Command, DashboardServer, Site

STATUS_PERIOD = 0.25
"""s between two looks at what holds now."""

ANSWER, TRIES = 2.0, 3
"""s for an answer to a command, and how often it is asked: a middleware may drop an answer, and asking for a stop twice
does no harm."""

RATE_PERIOD, SILENT_TOPIC = 1.0, 3.0
"""s over which a rate is taken, and after which a topic of which nothing comes has none."""

NEWEST = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
"""Of streams."""

MODES = ("automatic", "manual", "set-up", "simulation")
"""By the constants of ``isf_msgs/ExecutiveState``."""

CHANGE = 120.0
"""s for an answer to a change of mode, which brings nodes up; asked once."""

EMERGENCY = "press the emergency stop of the machine"


T = TypeVar("T")


@dataclass(frozen=True)
class DashboardParameters:
    """Parameters of the dashboard."""

    port: int = parameter(
        DEFAULT_PORT, "port of the page on this computer; 0: any that is free", minimum=0, maximum=65535
    )
    log: str = parameter("", "text file of 12 columns that is written, a row per update; must not exist; empty: none")


@dataclass
class _Topic:
    """A topic, what is done with its messages, and the rate at which they come, for the page.

    Of a stream, which has one publisher, they are counted by its sequence numbers: most are not taken.
    """

    name: str
    subscription: Any
    take: Callable[[float, Any], None]
    is_stream: bool
    rate: float | None = None
    _count: int = 0
    _before: tuple[float, int] | None = None

    def poll(self, now: float) -> None:
        """Take what came."""
        heard = False
        for message, info in taken(self.subscription):
            heard = True
            number = info["publication_sequence_number"] if self.is_stream else None
            self._count = self._count + 1 if number is None else number
            self.take(now, message)
        since, count = self._before or (now, self._count)
        if self._count < count or (not heard and now - since > SILENT_TOPIC):  # another publisher, or nobody
            self.rate, self._before = None, None
        elif heard and self._before is None:
            self._before = (now, self._count)
        elif heard and now - since >= RATE_PERIOD:
            self.rate, self._before = (self._count - count) / (now - since), (now, self._count)


@dataclass
class _Newest:
    """What was heard last of tools and force control, and when (s; -inf: never)."""

    row: Array = field(default_factory=lambda: np.full(len(COLUMNS), np.nan))
    heard: float = -np.inf


class DashboardNode(CellNode[DashboardParameters]):
    """Serves while active."""

    def __init__(self) -> None:
        super().__init__("dashboard", DashboardParameters, autostart=True)
        self._server: DashboardServer | None = None
        self._log: LogFile | None = None
        self._began = time.monotonic()

    def configure(self) -> None:
        self._history = History("live")
        self._feed = PartFeed(self._history)
        self._status = CellStatus()
        self._newest = _Newest()
        self._target: Any = None
        self._status_due = 0.0
        self._stop_machine = self.create_client(Stop, "machine/stop")
        self._stop_force_control = self.create_client(Trigger, "force_ctrl/stop")
        self._pause = self.create_client(SetBool, "executive/pause")
        self._set_mode = self.create_client(SetMode, "executive/set_mode")
        self._zero = self.create_client(SetZero, "executive/zero")
        self._jog = self.create_publisher(Jog, "jog", qos.STREAM)

    def activate(self) -> None:
        values = self.values()
        commands: dict[str, Command] = {"stop": self._on_stop, "pause": self._on_pause, "resume": self._on_resume}
        for number, word in enumerate(MODES):
            commands[f"mode_{word.replace('-', '_')}"] = partial(self._on_mode, number)
        for system in (54, 55, 56, 57):
            for tool in (1, 2):
                commands[f"zero_{system}_{tool}"] = partial(self._on_zero, system, tool)
        server = DashboardServer(
            Site(self._history, commands, self._on_jog), values.port, os.environ.get(TOKEN_VARIABLE, "")
        )
        try:
            self._log = LogFile(Path(values.log).absolute()) if values.log else None
        except IsfError:
            server.stop()
            raise
        self._group = Polled()
        self._topics = self._subscriptions_of_the_cell()
        self._timer = self.create_timer(1.0 / RATE, self._poll, clock=self.steady_clock)
        server.start()
        self._server = server
        if TOKEN_VARIABLE not in os.environ:  # else who started it has told it; to the terminal alone, not to the graph
            print(f"dashboard  {server.url}", flush=True)

    def deactivate(self) -> None:
        self.close()
        self.destroy_timer(self._timer)
        for topic in self._topics:
            self.destroy_subscription(topic.subscription)
        self._topics = []

    def close(self) -> None:
        if self._server is not None:
            self._server.stop()
            self._server = None
        if self._log is not None:
            try:
                self._log.close()
            except IsfError as error:
                print(error, file=sys.stderr)
            self._log = None

    def health_values(self) -> dict[str, object]:
        return {"browsers": self._server.browsers if self._server is not None else 0}

    # -- what is heard -------------------------------------------------------------------------------

    def _subscriptions_of_the_cell(self) -> list[_Topic]:
        """In the order in which they are to be taken: a job before its contours."""
        table: list[tuple[Any, str, QoSProfile, Callable[[float, Any], None]]] = [
            (PointCloud2, "part/target", qos.LATCHED, self._on_target),
            (JobInfo, "part/info", qos.LATCHED, self._on_job),
            (PathMessage, "tool_1/path", qos.LATCHED, partial(self._on_path, 1)),
            (PathMessage, "tool_2/path", qos.LATCHED, partial(self._on_path, 2)),
            (Contour, "contour/nominal", _several(qos.LATCHED), self._on_nominal),
            (ContourCorrection, "contour/correction", _several(qos.EVENT), self._on_correction),
            (ContourResult, "contour/result", _several(qos.EVENT), self._on_result),
            (PointCloud2, "scan", _several(qos.LATCHED), self._on_scan),
            (MachineEvent, "machine/event", _several(qos.EVENT), self._on_event),
            (MachineState, "machine/state", NEWEST, self._on_machine_state),
            (ForceCtrlState, "force_ctrl/state", NEWEST, self._on_force_state),
            (WrenchStamped, "tool_1/wrench", NEWEST, partial(self._on_wrench, 1)),
            (WrenchStamped, "tool_2/wrench", NEWEST, partial(self._on_wrench, 2)),
            (PoseStamped, "tool_1/pose", NEWEST, partial(self._on_pose, 1)),
            (PoseStamped, "tool_2/pose", NEWEST, partial(self._on_pose, 2)),
            (ExecutiveState, "executive/state", _several(qos.CHANGES), self._on_executive),
            (HandState, "force_ctrl/hand", _several(qos.CHANGES), self._on_hand),
            (DiagnosticArray, "/diagnostics", _several(qos.EVENT), self._on_diagnostics),
            (FormPart.Impl.FeedbackMessage, "form_part/_action/feedback", _several(qos.EVENT), self._on_feedback),
        ]
        return [
            _Topic(
                name,
                polled_subscription(self, kind, name, profile, self._group),
                self.guard(take, f"topic {name}"),
                profile is NEWEST,
            )
            for kind, name, profile, take in table
        ]

    def _poll(self) -> None:
        now = time.monotonic() - self._began
        for topic in self._topics:
            topic.poll(now)
        if now - self._newest.heard < 1.0:
            row = self._newest.row
            row[0] = now
            self._history.sample(row)
            self._write_log(row)
        if now >= self._status_due:
            self._status_due = now + STATUS_PERIOD
            self._tell_status(now)

    def _write_log(self, row: Array) -> None:
        """Append a sample; where the disk is full the page goes on without the log."""
        if self._log is None:
            return
        try:
            self._log.add(row[LOGGED])
        except IsfError as error:
            self._log = None
            self.report(error)

    def _on_target(self, now: float, message: PointCloud2) -> None:
        try:
            self._target, preforms = target_from_message(message)
        except ValueError as error:
            self._feed.fault(now, "part/target", int(ErrorCode.BAG_INCOMPLETE), str(error))
            return
        self._feed.target(now, self._target, preforms)

    def _on_job(self, now: float, message: JobInfo) -> None:
        job = Job(
            message.job_name,
            message.job_text,
            message.plan_id,
            message.process,
            message.correction,
            message.support_force,
            message.world,
            message.lockstep,
            message.software,
            message.base_folder,
            message.first_index,
            stamps.to_seconds(message.header.stamp),
            tuple(message.plan_warnings),
        )
        self._feed.job(now, job)

    def _on_path(self, tool: int, now: float, message: PathMessage) -> None:
        tips = np.array([tip_of(pose) for pose in message.poses], dtype=np.float64).reshape(-1, 3)
        self._feed.path(now, tool, tips)

    def _on_nominal(self, now: float, message: Contour) -> None:
        self._convert(now, contour_from_message, message, self._feed.nominal)

    def _on_correction(self, now: float, message: ContourCorrection) -> None:
        self._convert(now, correction_from_message, message, self._feed.correction)

    def _on_result(self, now: float, message: ContourResult) -> None:
        self._convert(now, result_from_message, message, self._feed.result)

    def _convert(self, now: float, convert: Callable[[Any], T], message: Any, show: Callable[[float, T], None]) -> None:
        """Show what a message says; a malformed one is told as a fault."""
        try:
            found = convert(message)
        except ValueError as error:
            what = f"{type(message).__name__} {message.index} of {message.plan_id or '(no plan)'} is malformed: {error}"
            self._feed.fault(now, "contour", int(ErrorCode.CONTOUR_REJECTED), what)
        else:
            show(now, found)

    def _on_scan(self, now: float, message: PointCloud2) -> None:
        try:
            points, shape = scan_cloud.points_of(message), scan_cloud.height_map_of(message, self._target)
        except IsfError as error:
            self._feed.fault(now, "scan", int(error.code), error.message)
            return
        self._feed.scan(now, points, shape)

    def _on_event(self, now: float, message: MachineEvent) -> None:
        event = event_of_message(message)
        self._feed.event(now, event, harmless=event.kind in HARMLESS)

    def _on_machine_state(self, now: float, message: MachineState) -> None:
        self._newest.heard = now
        faults = list(zip(message.fault_codes, message.fault_messages, strict=False))
        self._status.machine(int(message.mode), faults, tared=message.tared, limits=int(message.limits))
        for code, text in faults:
            self._feed.fault(now, f"machine fault {code}", int(code), text)
        if not faults:
            self._feed.well("machine fault")

    def _on_force_state(self, now: float, message: ForceCtrlState) -> None:
        self._newest.heard = now
        values = {
            "set_point": message.set_point,
            "normal_force": message.normal_force_filtered,
            "feed": MM * message.feed,
            "contour": message.index,
            "mode": message.mode,
            "flags": message.flags,
        }
        for name, value in values.items():
            self._newest.row[COLUMNS.index(name)] = value

    def _on_wrench(self, tool: int, now: float, message: WrenchStamped) -> None:
        self._newest.heard = now
        first = COLUMNS.index(f"fx{tool}")
        self._newest.row[first : first + 3] = wrench_array(message)[:3]

    def _on_pose(self, tool: int, now: float, message: PoseStamped) -> None:
        self._newest.heard = now
        first = COLUMNS.index(f"x{tool}")
        self._newest.row[first : first + 3] = MM * np.array(tip_of(message))
        first, turned = COLUMNS.index(f"phi{tool}"), message.pose.orientation
        self._newest.row[first : first + 3] = pose_angles(turned.x, turned.y, turned.z, turned.w)

    def _on_diagnostics(self, now: float, message: DiagnosticArray) -> None:
        own = self.get_namespace().rstrip("/") + "/"
        for status in message.status:
            name = status.name.removeprefix(own)
            if not status.name.startswith(own) or name == self.get_name():
                continue
            values = {item.key: item.value for item in status.values}
            level = int.from_bytes(status.level, "little") if isinstance(status.level, bytes) else int(status.level)
            self._status.node(now, name, NodeStatus(level, values.pop("state", ""), status.message, values))
            if level >= 2:
                self._feed.fault(now, name, int(ErrorCode.INTERNAL), status.message)
            else:
                self._feed.well(name)

    def _on_executive(self, now: float, message: ExecutiveState) -> None:
        known = 0 <= message.mode < len(MODES)
        self._status.mode = {
            "word": MODES[message.mode] if known else f"mode {message.mode}",
            "changing": message.changing,
            "job": message.job,
            "text": message.message,
        }

    def _on_hand(self, now: float, message: HandState) -> None:
        self._status.hand = {
            "armed": message.armed,
            "moving": message.moving,
            "client": message.client,
            "code": message.code,
            "text": message.message,
            "tips": [[MM * p.x, MM * p.y, MM * p.z] for p in (message.tip_1, message.tip_2)],
        }

    def _on_feedback(self, now: float, message: Any) -> None:
        self._status.phase = message.feedback.phase

    def _tell_status(self, now: float) -> None:
        ready = {
            "stop": self._stop_machine.service_is_ready() or self._stop_force_control.service_is_ready(),
            "pause": self._pause.service_is_ready(),
        }
        rates = {topic.name: topic.rate for topic in self._topics if topic.rate is not None}
        self._history.set_status(self._status.told(now, ready, rates, heard=now - self._newest.heard < 2.0))

    # -- what is asked for (thread of the server) ----------------------------------------------------

    async def _on_stop(self) -> str:
        """Protective stop of the machine, and hold of force control, both at once: either one stops the tools."""
        reason = Stop.Request(reason="stopped at the dashboard")
        failures = await asyncio.gather(
            self._failure_of(self._stop_machine, reason),
            self._failure_of(self._stop_force_control, Trigger.Request()),
        )
        words = ("protective stop of the machine", "force control holds")
        done = [text for text, error in zip(words, failures, strict=True) if error is None]
        failed = [error for error in failures if error is not None]
        why = "; ".join(error.what for error in failed)
        if not done:
            raise IsfError(failed[0].code, why, advice=EMERGENCY)
        return f"Stopped: {', '.join(done)}" + (f" ({why})" if why else "")

    async def _on_pause(self) -> str:
        return await self._set_pause(wanted=True)

    async def _on_resume(self) -> str:
        return await self._set_pause(wanted=False)

    async def _set_pause(self, *, wanted: bool) -> str:
        answer = await self._asked(self._pause, SetBool.Request(data=wanted))
        if not answer.success:
            raise IsfError(ErrorCode.NOT_ARMED, answer.message, where="executive", advice="form a part first")
        return str(answer.message)

    async def _on_mode(self, number: int) -> str:
        await self._done(self._set_mode, SetMode.Request(mode=number), CHANGE)
        return f"Mode: {MODES[number]}"

    async def _on_zero(self, system: int, tool: int) -> str:
        found = await self._done(self._zero, SetZero.Request(system=system, tool=tool), ANSWER * TRIES)
        x, y, z = (MM * value for value in (found.offset.x, found.offset.y, found.offset.z))
        return f"G{system} at {x:.3f} {y:.3f} {z:.3f} mm, in {found.file}"

    async def _done(self, client: Any, request: Any, patience: float) -> Any:
        """Answer of a service that is asked once; raises its code, NODE_MISSING, SERVICE_TIMEOUT."""
        answer = await self._asked(client, request, patience=patience, tries=1)
        if answer.code:
            raise failure(answer.code, answer.message)
        return answer

    def _on_jog(self, page: str, asked: Mapping[str, Any]) -> None:
        """A button of a page is held, or was let go; raises ValueError, TypeError, KeyError for what is none."""
        x, y, z = (float(value) for value in asked["way"])
        message = Jog(client=page, enable=bool(asked["enable"]), tool=int(asked["tool"]) & 3)
        message.increment = float(asked["increment"]) / MM
        message.direction.x, message.direction.y, message.direction.z = x, y, z
        message.header.stamp = self.get_clock().now().to_msg()
        self._jog.publish(message)

    async def _failure_of(self, client: Any, request: Any) -> IsfError | None:
        """Why a service did not do what it was asked for; None: it did."""
        try:
            answer = await self._asked(client, request)
        except IsfError as error:
            return error
        code = getattr(answer, "code", 0) or int(not getattr(answer, "success", True))
        return failure(code, answer.message) if code else None

    async def _asked(self, client: Any, request: Any, *, patience: float = ANSWER, tries: int = TRIES) -> Any:
        """Answer of a service; raises IsfError NODE_MISSING, SERVICE_TIMEOUT."""
        name = client.srv_name
        if not client.service_is_ready():
            raise IsfError(ErrorCode.NODE_MISSING, f"nobody serves {name}", advice="start the node, or bring it up")
        loop, answered = asyncio.get_running_loop(), asyncio.Event()
        asked = []
        for _ in range(tries):
            asked.append(client.call_async(request))
            asked[-1].add_done_callback(lambda _: loop.call_soon_threadsafe(answered.set))
            try:
                await asyncio.wait_for(answered.wait(), patience)
            except asyncio.TimeoutError:  # until Python 3.11 another one than TimeoutError
                continue
            break
        for future in asked:
            if future.done():
                return future.result()
            future.cancel()
        raise IsfError(ErrorCode.SERVICE_TIMEOUT, f"no answer of {name} within {patience * tries:g} s")


def _several(profile: QoSProfile) -> QoSProfile:
    """``profile`` for more messages than one between two looks."""
    return QoSProfile(depth=100, reliability=profile.reliability, durability=profile.durability)


def main(args: list[str] | None = None) -> None:
    """Entry point of ``ros2 run isf_dashboard dashboard``."""
    sys.exit(process.run(DashboardNode, args))


if __name__ == "__main__":
    main()
