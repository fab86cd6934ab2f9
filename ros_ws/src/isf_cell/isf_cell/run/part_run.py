"""One part through the node graph: the sequence of docs/reference/architecture.md, its faults and its end.

Runs in a worker thread of the executive; messages reach it through the ``on_...`` methods, which the node's
executor calls.

How far a part is, written atomically after every contour, so that it can be resumed after a crash.
"""

from __future__ import annotations

import json
import os
import threading
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from isf_core import __version__
from isf_core.contour import ContourCorrection, ContourResult, contour_label
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile
from isf_msgs.action import FormPart, PlanPart
from isf_msgs.msg import Contour, JobInfo, MachineState
from isf_msgs.srv import Arm, GetContour, Reset, Scan, Stop, Tare
from isf_ros.conversion import contour_from_message
from isf_ros.lifecycle import failure
from isf_ros.watchdog import RegularLook
from isf_springback.lift_feedback import lift_due
from isf_springback.methods import check_method
from isf_springback.scan.feedback import scan_due
from sensor_msgs.msg import PointCloud2
from std_srvs.srv import Trigger

from isf_cell.options import RunOptions
from isf_cell.processes.reference_run import UNCORRECTED
from isf_cell.run.graph_cell import GraphClient, lift_in_graph, scan_in_graph
from isf_cell.run.heartbeat_monitor import HeartbeatMonitor
from isf_cell.run.part_step import PartStep

MANAGED = ("machine", "planner", "springback", "force_ctrl")
"""Nodes brought up in this order, down in reverse."""

_SYMPTOMS = (ErrorCode.TARGET_LOST, ErrorCode.WRENCH_LOST, ErrorCode.MACHINE_FAULTED, ErrorCode.SERVICE_TIMEOUT)
"""Failures that may only be the consequence of a node that died; the death is then the thing to tell."""

_NOT_HEARD_YET = (ErrorCode.WRENCH_LOST, ErrorCode.POSE_LOST, ErrorCode.NO_TARE)
"""What force_ctrl refuses to arm with until it has heard the machine."""


class Outlet(Protocol):
    """What the run needs of the executive node."""

    def publish_nominal(self, contour: Contour) -> None: ...

    def publish_info(self, info: JobInfo) -> None: ...

    def publish_lift(self, cloud: PointCloud2) -> None: ...

    def publish_feedback(self, feedback: FormPart.Feedback) -> None: ...

    def cancel_requested(self) -> bool: ...

    def paused(self) -> bool: ...


@dataclass(frozen=True)
class RunSettings:
    """Times (s, wall) and places of a run; see the executive's parameters."""

    lockstep: bool
    service_timeout: float
    plan_timeout: float
    contour_timeout: float
    silence_timeout: float
    checkpoint: Path | None


class PartRun:
    """State of one run; :meth:`run` does the work and returns the action's result."""

    def __init__(
        self, goal: FormPart.Goal, client: GraphClient, monitor: HeartbeatMonitor, outlet: Outlet, settings: RunSettings
    ) -> None:
        self._goal = goal
        self._client = client
        self._monitor = monitor
        self._outlet = outlet
        self._settings = settings
        self._look = RegularLook(0.5 * settings.silence_timeout)
        self._news = threading.Condition()
        self._results: dict[int, ContourResult] = {}
        self._corrections: dict[int, ContourCorrection] = {}
        self._machine: MachineState | None = None
        self._machine_at_start = (0, 0, 0)
        self._plan_id = ""
        self._done = 0
        self._begin: float | None = None
        self._sim_time = 0.0
        self._force_late = 0
        self._force_lost = 0

    # -- news from the graph (executor thread) -------------------------------------------------

    def on_result(self, result: ContourResult) -> None:
        """A contour ended."""
        if result.plan_id == self._plan_id:
            with self._news:
                self._results[result.index] = result
                self._news.notify_all()

    def on_correction(self, correction: ContourCorrection) -> None:
        """A contour was corrected."""
        if correction.plan_id == self._plan_id:
            self._corrections[correction.index] = correction

    def on_machine_state(self, state: MachineState) -> None:
        """The machine told its state."""
        self._machine = state

    # -- the sequence (worker thread) --------------------------------------------------------------

    def run(self) -> FormPart.Result:
        """Form the part; never raises IsfError: the result carries its code."""
        started = time.monotonic()
        error: IsfError | None = None
        try:
            self._form()
        except IsfError as caught:
            error = self._explain(caught)
            self._secure(error)
        self._finish()
        return self._result(error, time.monotonic() - started)

    def _form(self) -> None:
        goal = self._goal
        job_file = JobFile(goal.job_text, Path(goal.base_folder), "job")
        options = RunOptions(
            goal.correction or None, None if np.isnan(goal.support_force) else goal.support_force, goal.world, goal.seed
        )
        options.check(job_file)
        if goal.first_index > 0 and options.method(job_file) != UNCORRECTED:
            raise IsfError(
                ErrorCode.CORRECTION_FAILED,
                f"a part corrected by '{options.method(job_file)}' cannot start at first_index {goal.first_index}",
                advice="its corrections would start from zero under a formed sheet; resume with correction 'none'",
            )
        self._tell("bringing up the nodes")
        self._monitor.forget_states()
        for name in MANAGED:
            # a node may compile or load for long and be silent meanwhile; its answer is a sign of life
            self._client.bring_up(name, self._watch_operator)
            self._monitor.hear(name, "")
        check_method(options.method(job_file), job_file)  # before the plan, which takes its time
        self._prepare_machine()
        self._tell("planning")
        count = self._plan()
        self._client.set_parameter("springback", "base_folder", goal.base_folder, self._watch)
        self._client.set_parameter("springback", "method", options.method(job_file), self._watch)
        self._outlet.publish_info(self._info(job_file, options))
        self._arm(count)
        for index in range(goal.first_index, count):
            self._pause_here(index, count)
            closed = self._form_contour(index)
            self._done += 1
            if lift_due(job_file, index, count):
                result, patience = self._results[index], self._settings.contour_timeout
                self._outlet.publish_lift(lift_in_graph(self._client, self._watch, result, patience, self._tell))
            if scan_due(job_file, index, count):
                patience = self._settings.contour_timeout
                scan_in_graph(self._client, self._watch, job_file, index, patience, self._tell, closed=closed)
            if self._settings.checkpoint:
                Checkpoint(
                    job_file.job.name, self._plan_id, index + 1, count, options.method(job_file), goal.world, goal.seed
                ).write(self._settings.checkpoint)

    def _prepare_machine(self) -> None:
        goal = self._goal
        fresh = goal.first_index == 0
        request = Reset.Request(
            new_blank=fresh,
            job_text=goal.job_text,
            base_folder=goal.base_folder,
            world=goal.world,
            seed=goal.seed,
        )
        self._tell("clamping a fresh blank" if fresh else "resetting the machine")
        self._machine = None
        self._client.checked_call(
            Reset, "machine/reset", request, self._watch_nodes, timeout=6 * self._settings.service_timeout
        )
        self._client.checked_call(Tare, "machine/tare", Tare.Request(), self._watch_nodes)
        self._client.wait_until(
            lambda: self._machine is not None and not self._machine.fault_codes and self._machine.tared,
            self._watch_nodes,
            "the machine does not tell its state",
            ErrorCode.SERVICE_TIMEOUT,
        )
        state = self._machine
        assert state is not None
        self._machine_at_start = (state.tick, state.late_ticks, state.targets_lost)

    def _plan(self) -> int:
        result = self._client.run_action(
            PlanPart,
            "plan_part",
            PlanPart.Goal(job_text=self._goal.job_text, base_folder=self._goal.base_folder),
            self._watch,
            lambda feedback: self._tell(f"planning: {feedback.phase}"),
            timeout=self._settings.plan_timeout,
        )
        if result.code:
            raise IsfError(ErrorCode(result.code), result.message)
        self._plan_id = result.plan_id
        return int(result.count)

    def _arm(self, count: int) -> None:
        """Arm the force controller; it may first have to hear the machine, which takes a moment after activation."""
        goal = self._goal
        request = Arm.Request(
            plan_id=self._plan_id,
            first_index=goal.first_index,
            count=count,
            job_text=goal.job_text,
            base_folder=goal.base_folder,
            support_force=goal.support_force,
        )
        deadline = time.monotonic() + self._settings.service_timeout
        pause = threading.Event()
        while True:
            response = self._client.call(Arm, "force_ctrl/arm", request, self._watch)
            if not response.code:
                return
            error = failure(response.code, response.message)
            if error.code not in _NOT_HEARD_YET or time.monotonic() > deadline:
                raise error
            pause.wait(0.2)

    def _form_contour(self, index: int) -> bool:
        """Have contour ``index`` formed; True when it is closed."""
        response = self._client.checked_call(
            GetContour, "planner/get_contour", GetContour.Request(plan_id=self._plan_id, index=index), self._watch
        )
        self._outlet.publish_nominal(response.contour)
        result = self._wait_for_result(index)
        self._begin = result.start if self._begin is None else self._begin
        self._sim_time = result.end - self._begin
        self._force_late += result.late_ticks
        self._force_lost += result.lost_messages
        if not result.completed:
            raise IsfError(ErrorCode(result.code), result.message, where=contour_label(index))
        self._tell_contour(response.contour, result)
        return bool(response.contour.closed)

    def _wait_for_result(self, index: int, *, watch: Callable[[], None] | None = None) -> ContourResult:
        deadline = time.monotonic() + self._settings.contour_timeout
        with self._news:
            while index not in self._results:
                (watch or self._watch)()
                if time.monotonic() > deadline:
                    raise IsfError(
                        ErrorCode.CONTOUR_TIMEOUT,
                        f"no result within {self._settings.contour_timeout:g} s",
                        where=contour_label(index),
                    )
                self._news.wait(0.1)
            return self._results[index]

    def _pause_here(self, index: int, count: int) -> None:
        if self._outlet.paused():
            self._tell("paused", index, count)
            pause = threading.Event()
            while self._outlet.paused():
                self._watch()
                pause.wait(0.1)

    # -- watching, faults, end ------------------------------------------------------------------------

    def _watch_operator(self) -> None:
        if self._outlet.cancel_requested():
            raise IsfError(ErrorCode.CANCELLED, "cancelled by the operator")

    def _watch(self) -> None:
        self._watch_nodes()
        self._watch_operator()
        self._watch_states()
        state = self._machine
        if state is not None and state.fault_codes:
            raise IsfError(ErrorCode(state.fault_codes[0]), state.fault_messages[0], where="machine")
        for correction in list(self._corrections.values()):
            if correction.code and not len(correction.offset):  # refused: no corrected contour will follow
                where = f"springback, {contour_label(correction.index)}"
                raise IsfError(ErrorCode(correction.code), correction.message, where=where)

    def _watch_states(self) -> None:
        for name, state in self._monitor.deactivated().items():
            raise IsfError(
                ErrorCode.NODE_INACTIVE,
                f"node '{name}' is {state} in the middle of the part",
                advice="another program deactivated it, or it was started anew; form the part again",
            )

    def _watch_nodes(self) -> None:
        if self._look.late():
            self._monitor.not_served()
        for name in self._monitor.silent():
            words = self._monitor.last_words(name)
            told = f"; its last words: {words}" if words not in ("", "ok") else ""
            raise IsfError(
                ErrorCode.NODE_DIED,
                f"node '{name}' gives no sign of life{told}",
                advice="the machine holds and releases contact; see the log of the node, restart it",
            )

    def _explain(self, error: IsfError) -> IsfError:
        """The cause behind a symptom: a fault that a dead node explains is told as its death."""
        if error.code not in _SYMPTOMS:
            return error
        try:
            self._client.wait_until(
                lambda: False, self._watch_nodes, "", error.code, timeout=self._settings.silence_timeout + 1.0
            )
        except IsfError as cause:
            if cause.code == ErrorCode.NODE_DIED:
                return IsfError(ErrorCode.NODE_DIED, cause.what, where=cause.where, advice=error.message)
        return error

    def _secure(self, error: IsfError) -> None:
        """Bring the process to rest after a failure; each step may fail without stopping the next."""
        no_watch: Callable[[], None] = lambda: None  # noqa: E731 - the part has failed already, only time limits count
        if error.code == ErrorCode.CANCELLED:
            self._attempt(lambda: self._client.call(Trigger, "force_ctrl/stop", Trigger.Request(), no_watch))
            self._attempt(
                lambda: self._client.call(Arm, "force_ctrl/arm", Arm.Request(plan_id=""), no_watch, timeout=60.0)
            )
        else:
            reason = f"part ended with {error.code.name}"
            self._attempt(lambda: self._client.call(Stop, "machine/stop", Stop.Request(reason=reason), no_watch))

    def _finish(self) -> None:
        dead = set(self._monitor.silent())
        no_watch: Callable[[], None] = lambda: None  # noqa: E731 - as above
        if self._plan_id and "machine" not in dead:
            self._attempt(lambda: self._client.call(Scan, "machine/scan", Scan.Request(clamped=True), no_watch))
        for name in reversed(MANAGED):
            if name not in dead and self._monitor.heard(name):
                self._attempt(lambda name=name: self._client.bring_down(name, no_watch))  # type: ignore[misc]

    def _attempt(self, action: Callable[[], Any]) -> None:
        try:
            action()
        except IsfError as error:
            self._tell(f"while ending the part: {error}")

    # -- telling ---------------------------------------------------------------------------------------

    def _tell(self, phase: str, index: int = 0, count: int = 0) -> None:
        nan = float("nan")
        self._outlet.publish_feedback(
            FormPart.Feedback(
                phase=phase, index=index, count=count, support_force=nan, predicted_springback=nan, correction=nan
            )
        )

    def _tell_contour(self, message: Contour, result: ContourResult) -> None:
        step = PartStep.of(contour_from_message(message), self._corrections.get(message.index), result)
        self._outlet.publish_feedback(
            FormPart.Feedback(
                phase="forming",
                index=step.index,
                count=step.count,
                depth=step.depth,
                forming_force=step.forming_force,
                support_force=step.support_force,
                predicted_springback=step.springback,
                correction=step.correction,
            )
        )

    def _info(self, job_file: JobFile, options: RunOptions) -> JobInfo:
        return JobInfo(
            job_name=job_file.job.name,
            job_text=job_file.text,
            plan_id=self._plan_id,
            process=job_file.job.process,
            correction=options.method(job_file),
            support_force=float(options.set_point(job_file)),
            world=options.world,
            seed=options.seed,
            control_rate=float(job_file.job.control.rate),
            lockstep=self._settings.lockstep,
            software=__version__,
        )

    def _result(self, error: IsfError | None, wall_time: float) -> FormPart.Result:
        state = self._machine
        tick, late, lost = self._machine_at_start
        return FormPart.Result(
            code=int(error.code) if error else 0,
            message=error.message if error else "",
            plan_id=self._plan_id,
            contours=self._done,
            ticks=max(0, state.tick - tick) if state else 0,
            late_ticks=self._force_late + (max(0, state.late_ticks - late) if state else 0),
            lost_messages=self._force_lost + (max(0, state.targets_lost - lost) if state else 0),
            sim_time=self._sim_time,
            wall_time=wall_time,
        )


@dataclass(frozen=True)
class Checkpoint:
    """Progress of one part: the next contour to form is ``next_index`` of ``count``."""

    job_name: str
    plan_id: str
    next_index: int
    count: int
    correction: str
    world: int
    seed: int

    def write(self, path: Path) -> None:
        """Replace the file in one step: after a crash it holds either the old or the new state."""
        temporary = path.with_suffix(".part")
        temporary.write_text(json.dumps(asdict(self)), encoding="utf-8")
        with temporary.open() as stream:
            os.fsync(stream.fileno())
        temporary.replace(path)
