"""A recorded part given to a live node over the middleware, and what it answers set beside what was recorded.

The node may be the installed one, started for it, or one that somebody runs: a build of their own, under another
middleware, with other parameters. It gets what it listens to, in the order of cause and effect: the next wrenches after
its targets, the result of a contour after its correction. Time is that of the stamps; nothing depends on the speed of
the computer, and the same node gives the same numbers to the last bit.
"""

from __future__ import annotations

import json
import math
import os
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import rclpy
from geometry_msgs.msg import PoseStamped, WrenchStamped
from isf_analysis.bag.bag_writer import job_fields
from isf_core.contour import Contour, ContourCorrection, ContourResult, contour_label
from isf_core.errors import ErrorCode, IsfError, failure
from isf_core.files.job import JobFile
from isf_core.types import Array
from isf_msgs import msg as isf
from isf_msgs.action import LiftTool, MoveAside
from isf_msgs.srv import Arm
from isf_ros import conversion, qos, stamps
from isf_ros.process import join_graph
from isf_springback.scan.feedback import scan_due
from lifecycle_msgs.srv import GetState
from rclpy.duration import Duration
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from sensor_msgs.msg import PointCloud2

from isf_cell.processes.cell_nodes import operator_arguments
from isf_cell.processes.process_group import NodeProcess, ProcessGroup
from isf_cell.replay.correction_replay import lift_after, lifted_after, scan_after
from isf_cell.replay.differences import Difference, difference
from isf_cell.replay.recorded_run import Armed, RecordedRun, Ticks
from isf_cell.run.graph_cell import NOT_HEARD_YET
from isf_cell.run.graph_client import GraphClient
from isf_cell.run.tool_lift import SETTINGS

T = TypeVar("T")
Progress = Callable[[int, int], None]

PACKAGES = {"force_ctrl": "isf_force_ctrl", "springback": "isf_springback"}
"""Nodes that decide, and where each is installed."""

ANSWER = 20.0
"""s of wall time in which force control answers a pair of wrenches, or a service."""

CORRECTION = 600.0
"""s of wall time for one correction; the first one may compute a database."""

ARRIVES = 10.0
"""s of wall time for the target of a part to be with the node."""

THERE = 2.0
"""s in which a node that is running is discovered; participants find one another in less on one computer."""


@dataclass(frozen=True)
class LiveAnswer:
    """What the node answered.

    Attributes
    ----------
    node : its name ; started : it was started for this
    targets : pairs of targets compared, of springback 0 ; differing : of them ; largest : m, largest difference
    unfed : recorded ticks that were fed to nothing, since the node had ended or gone on elsewhere
    results : of force control, corrections : of springback; beside the recorded ones
    notes : what kept it from going on, and other parameters than the recorded ones
    """

    node: str
    started: bool
    targets: int = 0
    differing: int = 0
    unfed: int = 0
    largest: float = 0.0
    results: Difference | None = None
    corrections: Difference | None = None
    notes: tuple[str, ...] = ()

    @property
    def identical(self) -> bool:
        """Every answer is the recorded one to the last bit, and there are as many."""
        compared = [item for item in (self.results, self.corrections) if item is not None]
        return not (self.differing or self.unfed) and bool(compared) and all(item.identical for item in compared)


def check(run: RecordedRun, name: str) -> None:
    """Raises IsfError BAG_INCOMPLETE or FILE_FIELD for a record that the node ``name`` cannot be given."""
    if name not in PACKAGES:
        raise IsfError(
            ErrorCode.FILE_FIELD, f"no node '{name}' to play into", where="--into", advice=" or ".join(PACKAGES)
        )
    if name == "springback":
        return
    why = ""
    if run.armed is None or run.ticks is None:
        why = "it has no wrenches, targets or arming: isf form, or a recorder in a cell, records them"
    elif not run.ticks.exact:
        why = "it is by the clock: which wrenches a tick used is not in it (isf replay tells how far off it is)"
    if why:
        raise IsfError(ErrorCode.BAG_INCOMPLETE, f"cannot be played into force_ctrl: {why}", where=str(run.path))


def play_into(
    run: RecordedRun,
    name: str,
    job_file: JobFile,
    log_folder: Path,
    parameters: Mapping[str, object],
    progress: Progress = lambda *_: None,
) -> LiveAnswer:
    """Give ``run`` to the node ``name`` that runs in this ROS domain, else to one started with ``parameters``.

    ``job_file`` : of the run, with the folder that its paths refer to; ``progress`` : contours formed, of how many

    Raises
    ------
    IsfError : as :func:`check`; FILE_FIELD, parameters for a node that runs already; NODE_DIED, NODE_MISSING,
        TRANSITION_FAILED, SERVICE_TIMEOUT of the node; what it refuses to be armed with
    """
    check(run, name)
    with ExitStack() as stack:
        live = stack.enter_context(_Live(name))
        started = live.find_or_start(stack, log_folder, parameters)
        if name == "springback":
            return replace(_play_into_springback(live, run, job_file, progress), started=started)
        assert run.armed is not None
        assert run.ticks is not None
        feed = _ForceControlFeed(live, run, run.armed, run.ticks, job_file)
        return replace(feed.play(progress), started=started)


class _Live:
    """Our side of the graph, and the node; a context that leaves both as they were."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.process: NodeProcess | None = None
        self.news = threading.Condition()
        join_graph(operator_arguments())
        self.node = Node(f"isf_play_{os.getpid()}")
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self.node)
        self.client = GraphClient(self.node, ANSWER)
        self._thread = threading.Thread(target=self._executor.spin, name="player", daemon=True)

    def __enter__(self) -> _Live:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._executor.shutdown()
        self._thread.join()
        self.client.close()
        self.node.destroy_node()
        rclpy.try_shutdown()

    def find_or_start(self, stack: ExitStack, log_folder: Path, parameters: Mapping[str, object]) -> bool:
        """Bring the node up, started where none of its name runs; True when it was."""
        running = self.client.within(THERE, lambda: self.client.offers(GetState, f"{self.name}/get_state"), self.watch)
        if running and parameters:
            raise IsfError(
                ErrorCode.FILE_FIELD,
                f"'{self.name}' runs already and has its own parameters",
                where="--param",
                advice=f"ros2 param set /{self.name} NAME VALUE, or end it: one is started here then",
            )
        if not running:
            group = stack.enter_context(ProcessGroup(log_folder))
            given = {"lockstep": True} if self.name == "force_ctrl" else {}
            self.process = group.start(PACKAGES[self.name], self.name, {**given, **parameters})
        elif self.name == "force_ctrl" and not self.client.get_parameter(self.name, "lockstep", self.watch):
            raise IsfError(
                ErrorCode.FILE_FIELD,
                "force_ctrl runs by the clock",
                where="--into",
                advice="start it with -p lockstep:=true: a record has its own time",
            )
        self.client.wait_until(
            lambda: self.client.offers(GetState, f"{self.name}/get_state"),
            self.watch,
            f"node '{self.name}' is not up",
            ErrorCode.NODE_MISSING,
            timeout=180.0,
        )
        for name in parameters:
            if self.client.get_parameter(self.name, name, self.watch) is None:
                raise IsfError(
                    ErrorCode.FILE_FIELD,
                    f"'{self.name}' has no parameter '{name}'",
                    where="--param",
                    advice="docs/reference/nodes.md lists them",
                )
        self.client.bring_up(self.name, self.watch)
        return not running

    def watch(self) -> None:
        """Raises IsfError NODE_DIED when the node that was started has ended."""
        if self.process is not None and not self.process.alive:
            raise IsfError(
                ErrorCode.NODE_DIED,
                f"node '{self.name}' {self.process.end}",
                advice=f"its output is in {self.process.log}",
            )

    def heard(self, store: Callable[[Any], None]) -> Callable[[Any], None]:
        """A callback that has ``store`` take a message, and wakes who waits for it."""

        def on_message(message: Any) -> None:
            with self.news:
                store(message)
                self.news.notify_all()

        return on_message

    def wait(self, answer: Callable[[], T | None], seconds: float, what: str) -> T:
        """The first ``answer`` that is not None; raises IsfError SERVICE_TIMEOUT that names ``what`` is missing."""
        deadline = time.monotonic() + seconds
        while True:
            with self.news:
                found = answer()
                if found is None:
                    self.news.wait(0.1)  # a node that dies tells nothing: it is looked for ten times a second
                    found = answer()
            if found is not None:
                return found
            self.watch()
            if time.monotonic() > deadline:
                advice = f"its output is in {self.process.log}" if self.process else "see its log and /diagnostics"
                raise IsfError(ErrorCode.SERVICE_TIMEOUT, f"'{self.name}' did not answer {what}", advice=advice)

    def settled(self) -> None:
        """When this returns the node has taken what was published before: a service is served after topics."""
        self.client.state_of(self.name, self.watch)

    def matched(self, *publishers: Any) -> None:
        """Wait until the node listens to all ``publishers``."""
        for publisher in publishers:
            self.client.wait_until(
                partial(_heard, publisher),
                self.watch,
                f"'{self.name}' does not listen to {publisher.topic_name}",
                ErrorCode.NODE_MISSING,
            )


def _heard(publisher: Any) -> bool:
    return bool(publisher.get_subscription_count() > 0)


# -- force control -------------------------------------------------------------------------------


@dataclass
class _Activity:
    """One thing that force control does: a contour, a tool lift or moving aside."""

    label: str
    index: int
    begin: Callable[[], None]
    ended: threading.Event = field(default_factory=threading.Event)


class _ForceControlFeed:
    """The machine and the executive of the record, for the node force_ctrl in lockstep."""

    def __init__(self, live: _Live, run: RecordedRun, armed: Armed, ticks: Ticks, job_file: JobFile) -> None:
        self._live, self._run, self._armed, self._ticks, self._job_file = live, run, armed, ticks, job_file
        node = live.node
        tools = (1, 2)
        self._wrenches = [node.create_publisher(WrenchStamped, f"tool_{k}/wrench", qos.STREAM) for k in tools]
        self._poses = [node.create_publisher(PoseStamped, f"tool_{k}/pose", qos.SENSOR) for k in tools]
        self._machine = node.create_publisher(isf.MachineState, "machine/state", qos.STREAM)
        self._contours = node.create_publisher(isf.Contour, "contour/corrected", qos.LATCHED)
        self._targets: list[dict[int, tuple[float, float, float]]] = [{}, {}]
        self._results: dict[int, ContourResult] = {}
        self._settings = ""
        for tool in tools:
            take = live.heard(partial(self._on_target, tool))
            node.create_subscription(PoseStamped, f"tool_{tool}/target", take, qos.STREAM)
        node.create_subscription(isf.ContourResult, "contour/result", live.heard(self._on_result), qos.EVENT)
        node.create_subscription(isf.ForceCtrlArmed, "force_ctrl/armed", live.heard(self._on_armed), qos.LATCHED)
        self._pose = 0
        self._forming: _Activity | None = None
        self._answers: list[tuple[Array, Array]] = []

    def play(self, progress: Progress) -> LiveAnswer:
        """Feed all ticks."""
        self._live.matched(*self._wrenches, *self._poses, self._machine, self._contours)
        notes = [*self._arm()]
        last = len(self._ticks.stamp)
        position = 0
        for activity in self._activities():
            if position == last:
                break
            self._publish_pair(position)
            self._live.settled()
            activity.begin()
            position, ended = self._follow(activity, position)
            if not ended:
                notes.append(f"{activity.label}: goes on where the recorded one had ended")
                break
            if (result := self._results.get(activity.index)) is not None and not result.completed:
                notes.append(f"{activity.label}: {result.message}")
                break
            progress(len(self._results), len(self._run.part.corrected))
        answered = np.array([answer for answer, _ in self._answers]).reshape(-1, 6)
        recorded = np.array([target for _, target in self._answers]).reshape(-1, 6)
        known = np.isfinite(recorded).all(axis=1)
        off = np.abs(answered - recorded)[known].max(axis=1, initial=0.0)
        return LiveAnswer(
            "force_ctrl",
            True,
            targets=int(known.sum()),
            differing=int(np.count_nonzero(off)),
            unfed=last - position,
            largest=float(off.max(initial=0.0)),
            results=difference(self._run.part.results, list(self._results.values())),
            notes=tuple(notes),
        )

    def _arm(self) -> Iterator[str]:
        """Arm with what the record was armed with; what was other is told."""
        armed, part = self._armed, self._run.part
        request = Arm.Request(
            plan_id=part.plan_id,
            first_index=armed.first_index,
            count=armed.count,
            job_text=self._job_file.text,
            base_folder=str(self._job_file.base),
            support_force=math.nan if armed.support_force is None else armed.support_force,
            sheet=str(part.sheet.get("model", "")),
        )
        deadline = time.monotonic() + ANSWER
        while True:
            self._machine.publish(isf.MachineState(mode=isf.MachineState.IDLE, tared=True, lockstep=True))
            for publisher, tip in zip(self._poses, (armed.tip_1, armed.tip_2), strict=True):
                pose = _pose(tip, int(self._ticks.stamp[0]))
                if publisher is self._poses[0]:
                    conversion.set_axis(pose, armed.axis)
                publisher.publish(pose)
            self._publish_pair(0)
            self._live.settled()
            response = self._live.client.call(Arm, "force_ctrl/arm", request, self._live.watch)
            if not response.code:
                break
            error = failure(response.code, response.message)
            if error.code not in NOT_HEARD_YET or time.monotonic() > deadline:
                raise error
        text = self._live.wait(lambda: self._settings or None, ANSWER, "with what it is armed")
        now, then = json.loads(text), json.loads(armed.config.to_json())
        other = [f"{name} {now.get(name)} (recorded {then[name]})" for name in then if now.get(name) != then[name]]
        if other:
            yield f"armed with other parameters than recorded: {', '.join(other)}; --param NAME:=VALUE sets them"

    def _activities(self) -> Iterator[_Activity]:
        """What the executive had done."""
        lifted = lifted_after(self._run)
        formed = {result.index for result in self._run.part.results if len(result.tick_time)}
        for contour in self._run.part.corrected:
            if contour.index not in formed:
                return
            index, count, label = contour.index, contour.count, contour_label(contour.index)
            yield self._contour(contour, label)
            if index in lifted:
                goal = LiftTool.Goal(speed=SETTINGS.speed, zero_force=SETTINGS.zero_force, max_lift=SETTINGS.max_lift)
                yield self._action(LiftTool, "lift_tool", goal, index, f"tool lift after {label}")
            if scan_due(self._job_file, index, count) and self._job_file.job.springback.scan_clear and contour.closed:
                yield self._action(MoveAside, "move_aside", MoveAside.Goal(), index, f"moving aside after {label}")

    def _contour(self, contour: Contour, label: str) -> _Activity:
        message = conversion.contour_to_message(contour, stamps.from_seconds(0.0))
        activity = _Activity(label, contour.index, lambda: self._contours.publish(message))
        self._forming = activity
        return activity

    def _action(self, kind: Any, name: str, goal: Any, index: int, label: str) -> _Activity:
        client, watch = self._live.client, self._live.watch

        def run() -> None:
            with suppress(IsfError):  # the tools are not on the sheet, as between two features: the part goes on, too
                client.run_action(kind, name, goal, watch, lambda _: None, timeout=CORRECTION)
            with self._live.news:
                activity.ended.set()
                self._live.news.notify_all()

        activity = _Activity(label, index, lambda: threading.Thread(target=run, name=name, daemon=True).start())
        return activity

    def _follow(self, activity: _Activity, position: int) -> tuple[int, bool]:
        """Feed wrenches until the ``activity`` has ended: the first recorded tick that it did not take, and False where
        it goes on when the recorded one had ended."""
        ticks, last = self._ticks, len(self._ticks.stamp)
        while True:
            due = _next_stamp(int(ticks.stamp[position]), self._run.part.control_rate)
            what = f"the wrenches of {ticks.stamp[position] * 1e-9:.3f} s ({activity.label})"
            if self._live.wait(partial(self._outcome, activity, due), ANSWER, what) is activity:
                return position, True
            answer = np.hstack([targets.pop(due) for targets in self._targets])
            self._answers.append((answer, ticks.target[position]))
            position += 1
            if position < last and int(ticks.stamp[position]) == due:
                self._publish_pair(position)
                continue
            # here the machine has done the last targets: time stands, or goes on elsewhere
            self._publish(due, ticks.wrench[position - 1])
            what = f"the end of its targets ({activity.label})"
            end = _next_stamp(due, self._run.part.control_rate)
            return position, self._live.wait(partial(self._outcome, activity, end), ANSWER, what) is activity

    def _outcome(self, activity: _Activity, due: int) -> object | None:
        """The ``activity`` when it has ended, targets when both have come for ``due`` ns; else None."""
        if all(due in targets for targets in self._targets):
            return due
        return activity if activity.ended.is_set() else None

    def _publish_pair(self, position: int) -> None:
        ticks, stamp = self._ticks, int(self._ticks.stamp[position])
        while self._pose < len(ticks.pose_stamp) and ticks.pose_stamp[self._pose] <= stamp:
            tool, *tip = ticks.pose[self._pose].tolist()
            self._poses[int(tool) - 1].publish(_pose(tip, int(ticks.pose_stamp[self._pose])))
            self._pose += 1
        self._publish(stamp, ticks.wrench[position])

    def _publish(self, stamp: int, wrench: Array) -> None:
        for publisher, values in zip(self._wrenches, (wrench[:6], wrench[6:]), strict=True):
            message = conversion.make_wrench()
            message.header.stamp = stamps.to_stamp(stamp)
            conversion.set_wrench(message, values)
            publisher.publish(message)

    def _on_target(self, tool: int, message: PoseStamped) -> None:
        self._targets[tool - 1].setdefault(stamps.to_nanoseconds(message.header.stamp), conversion.tip_of(message))

    def _on_result(self, message: isf.ContourResult) -> None:
        result = conversion.result_from_message(message)
        self._results[result.index] = result
        if self._forming is not None and result.index == self._forming.index:
            self._forming.ended.set()

    def _on_armed(self, message: isf.ForceCtrlArmed) -> None:
        if message.plan_id == self._run.part.plan_id:
            self._settings = message.settings


def _next_stamp(stamp: int, rate: float) -> int:
    """ns, of the tick after that of ``stamp``."""
    return stamps.tick_nanoseconds(round(stamp * rate / stamps.NANO) + 1, rate)


def _pose(tip: Any, stamp: int) -> PoseStamped:
    message = conversion.make_pose()
    message.header.stamp = stamps.to_stamp(stamp)
    conversion.set_tip(message, tip)
    return message


# -- springback ----------------------------------------------------------------------------------


def _play_into_springback(live: _Live, run: RecordedRun, job_file: JobFile, progress: Progress) -> LiveAnswer:
    part, node = run.part, live.node
    info = node.create_publisher(isf.JobInfo, "part/info", qos.LATCHED)
    target = node.create_publisher(PointCloud2, "part/target", qos.LATCHED)
    nominal = node.create_publisher(isf.Contour, "contour/nominal", qos.LATCHED)
    results = node.create_publisher(isf.ContourResult, "contour/result", qos.EVENT)
    lifts = node.create_publisher(PointCloud2, "tool_lift", qos.LATCHED)
    scans = node.create_publisher(PointCloud2, "scan", qos.LATCHED)
    found: dict[int, ContourCorrection] = {}

    def on_correction(message: isf.ContourCorrection) -> None:
        found[message.index] = conversion.correction_from_message(message)

    node.create_subscription(isf.ContourCorrection, "contour/correction", live.heard(on_correction), qos.EVENT)
    live.matched(info, target, nominal, results, lifts, scans)
    live.client.wait_until(
        lambda: node.count_publishers(node.resolve_topic_name("contour/correction")) > 0,
        live.watch,
        "'springback' does not publish contour/correction",
        ErrorCode.NODE_MISSING,
    )
    live.client.set_parameter("springback", "base_folder", str(job_file.base), live.watch)
    if part.target is not None:
        target.publish(conversion.target_to_message(part.target, part.preforms, stamps.from_seconds(0.0)))
        target.wait_for_all_acked(Duration(seconds=ARRIVES))  # a service that is asked may be faster than some MB
    own = replace(part, job_text=job_file.text, base_folder=str(job_file.base))  # the job may lie elsewhere by now
    info.publish(isf.JobInfo(**job_fields(own)))
    live.settled()
    count, notes = len(part.nominal), []
    formed = {result.index: result for result in part.results}
    for k, contour in enumerate(part.nominal):
        nominal.publish(conversion.contour_to_message(contour, stamps.from_seconds(0.0)))
        correction = live.wait(partial(found.get, contour.index), CORRECTION, contour_label(contour.index))
        if correction.code:
            notes.append(f"{contour_label(contour.index)}: {correction.message}")
        result = formed.get(contour.index)
        if result is None:
            break
        results.publish(conversion.result_to_message(result, stamps.from_seconds(result.end)))
        lift, scan = lift_after(run, k), scan_after(run, job_file, k)
        if lift is not None:
            lifts.publish(conversion.lift_to_cloud(lift[1], stamps.from_seconds(lift[0])))
        if scan is not None:
            scans.publish(conversion.points_to_cloud(scan[1], stamps.from_seconds(scan[0])))
        progress(k + 1, count)
    compared = difference(part.corrections, list(found.values()))
    return LiveAnswer("springback", True, corrections=compared, notes=tuple(notes))
