"""Node ``force_ctrl``: forms corrected contours by streaming targets in answer to wrenches.

In lockstep a pair of wrenches with stamp t_k is answered by a pair of targets with stamp t_(k+1); in real time ticks
are due by the clock, and a pair of wrenches is answered when it comes (real_time.py). See
docs/reference/architecture.md for topics, lockstep and watchdogs.
"""

from __future__ import annotations

import math
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, WrenchStamped
from isf_core.contour import contour_label
from isf_core.errors import ErrorCode, IsfError
from isf_core.files import quantity
from isf_core.files.job import JobFile
from isf_core.files.own_folder import path_below
from isf_core.geometry.tool_axis import UPRIGHT
from isf_core.simulated_sheet import sheet_kind, with_raised_force_limit
from isf_msgs import msg as isf
from isf_msgs.srv import Arm, StateFile
from isf_ros import conversion, process, qos, stamps
from isf_ros.executive_watch import ExecutiveWatch
from isf_ros.lifecycle import CellNode
from isf_ros.thread_priority import RealTimeSettings
from isf_ros.watchdog import RegularLook
from isf_ros.wrench_axes import WrenchAxes
from rcl_interfaces.msg import SetParametersResult
from rclpy.parameter import Parameter
from std_srvs.srv import Trigger

from isf_force_ctrl.control_state import Mode, Vector
from isf_force_ctrl.controller import ForceController
from isf_force_ctrl.hand.hand_space import HandSpace
from isf_force_ctrl.kept_state import load_controller, save_controller
from isf_force_ctrl.ros.control_clock import PeriodicLoop
from isf_force_ctrl.ros.hand_motion import HandMotion
from isf_force_ctrl.ros.identify_action import IdentifyAction
from isf_force_ctrl.ros.measurement_actions import MeasurementActions
from isf_force_ctrl.ros.parameters import ForceCtrlParameters
from isf_force_ctrl.ros.publishers import ForceCtrlPublishers
from isf_force_ctrl.ros.readiness import Readiness, control_config, tools_with_load_cell
from isf_force_ctrl.supervision.attendance import EXECUTIVE_SILENCE, Attendance
from isf_force_ctrl.supervision.contour_warnings import ChipWatch, offset_warning, with_overload
from isf_force_ctrl.supervision.latency import LatencyMeter
from isf_force_ctrl.supervision.wrench_receiver import Fault, Reading, WrenchReceiver

HEARTBEAT = 0.2
"""s of wall time after which the last targets are repeated."""

LOCKSTEP_TIMEOUT, REAL_TIME_TIMEOUT = 20.0, 3.0
"""s without a wrench after which a contour ends, unless the parameter wrench_timeout says otherwise. In lockstep time
stands still meanwhile; by the clock the tools stand after the parameter wrench_pause and go on when the wrenches do."""

BLIND = 0.25
"""s by the clock without a wrench, or with nothing but late ones, after which a measurement ends, and without a pose,
after which twists do."""

STEADY = 0.25
"""s by the clock that the tools stand after the wrenches are back, so that they are where they should be."""

MADE_GOOD = 1.0
"""s without wrenches that one s with them makes good: where they are missing for more than half of the time, they have
before long been missing for the whole of wrench_timeout, and the contour ends (assumed)."""

STANDING = 0.2
"""s of targets as joints that stand after arming, from when their controllers have been found: one that hears the first
of them in mid-motion would make up for what it missed in one step."""

STOPPED_FOR = 2.0
"""s of wall time that the machine is in a protective stop, after which what is done in lockstep ends with its fault: no
tick comes any more. An executive has ended the part long before."""

TARE_LOST = "the load cells are no longer tared, says the machine: it was started anew, or was tared wrongly"

SAME_PLACE = 1e-3
"""m, within which a tool still stands where the plan before had left it on the sheet (assumed: servo and rounding)."""

BY_HAND = "by hand"
"""In place of a plan, where tools are moved by move_to and jog."""

LOOK = 0.02
"""s between two looks at who else is there: tools that form stand within 50 ms of the end of the executive."""


class ForceCtrlNode(CellNode[ForceCtrlParameters]):
    """ROS side of :class:`isf_force_ctrl.controller.ForceController`."""

    def __init__(self) -> None:
        super().__init__("force_ctrl", ForceCtrlParameters)
        self._controller: ForceController | None = None
        self._loop: PeriodicLoop | None = None
        self._lock = threading.RLock()
        self._latency = LatencyMeter()
        self._refused = self._late_ended = 0
        self.add_on_set_parameters_callback(self._check_parameters)
        self.add_post_set_parameters_callback(self.guard(self._use_parameters, "parameters"))

    # -- lifecycle -----------------------------------------------------------------------------

    def configure(self) -> None:
        self._settings = p = self.values()
        self._timeout = p.wrench_timeout or (LOCKSTEP_TIMEOUT if p.lockstep else REAL_TIME_TIMEOUT)
        self._axes = WrenchAxes(self, p.frame_prefix + p.wrench_frame, p.transform_age)
        most_delay = math.inf if p.lockstep else p.wrench_delay
        self._receiver = WrenchReceiver(p.wrench_frame, self._axes.turned, most_delay, self._timeout)
        self._pair = self._receiver.pair
        blind = min(self._timeout, BLIND)
        self._ready = Readiness(self._timeout, blind, self._receiver.frames)
        self._grace = self._timeout if p.lockstep else blind
        self._delayed, self._patient_until = False, 0.0
        self._look = RegularLook(0.5 * min(self._timeout, EXECUTIVE_SILENCE))
        self._ticks = self._late_before = self._pauses = self._repeating = 0
        self._paused_until = self._seek_until = self._without = 0.0
        self._ticks_to_stand = 0
        self._kept: Path | None = None
        self._leaving = self._unanswered = False
        self._ticked = RegularLook(0.5 * p.wrench_pause)
        self._awaited: int | None = None
        self._last_mode = Mode.IDLE

        if p.output == "twist" and p.lockstep:
            raise IsfError(ErrorCode.FILE_FIELD, "twists are velocities by the clock, not in lockstep", where="output")
        joints = p.output == "joint_trajectory"
        self._output = ForceCtrlPublishers(self, twist=p.output == "twist", joints=joints, described=p.described_joints)
        self.create_subscription(WrenchStamped, "tool_1/wrench", self._on_wrench_1, qos.STREAM)
        self.create_subscription(WrenchStamped, "tool_2/wrench", self._on_wrench_2, qos.STREAM)
        self.create_subscription(PoseStamped, "tool_1/pose", lambda m: self._on_pose(1, m), qos.SENSOR)
        self.create_subscription(PoseStamped, "tool_2/pose", lambda m: self._on_pose(2, m), qos.SENSOR)
        self.create_subscription(isf.MachineState, "machine/state", self._on_machine, qos.STREAM)
        self.create_subscription(isf.Contour, "contour/corrected", self._on_contour, qos.LATCHED)
        self.create_service(Arm, "force_ctrl/arm", self._on_arm)
        self.create_service(Trigger, "force_ctrl/stop", self._on_stop)
        self.create_service(StateFile, "force_ctrl/save", self._on_save)
        self.create_service(StateFile, "force_ctrl/load", self._on_load)
        self._attended = Attendance(ExecutiveWatch(self, EXECUTIVE_SILENCE), p.contour_wait)
        heard = self._attended.executive.on_diagnostics
        self.create_subscription(DiagnosticArray, "/diagnostics", heard, 50)
        self.create_timer(LOOK, self._on_timer, clock=self.steady_clock)
        MeasurementActions(self, self._lock, lambda: self._controller, self._step_in_lockstep, self._moving)
        IdentifyAction(self, self._lock, self._ready, self._armed_job, self._step_in_lockstep)
        self._hand = HandMotion(
            self, self._lock, self._ready, lambda: self._controller, self._step_in_lockstep, self._moving
        )

    def deactivate(self) -> None:
        """End the stream where it is; the machine releases contact if tools are loaded."""
        self._stop_loop()
        with self._lock:
            if self._controller is not None:
                self._controller.fail(ErrorCode.STOPPED, "the node was deactivated")
                self._end()
            self._controller = self._kept = None
            self._hand.disarm()

    def cleanup(self) -> None:
        self._axes.close()

    def make_safe(self, error: IsfError) -> None:
        """End the contour and hold; where that was done already or fails, end the stream: the machine lifts then."""
        with self._lock:
            controller = self._controller
            if controller is None or not (controller.busy or self._loop is not None):
                return
            if controller.fault is None:
                controller.fail(error.code, error.message, ticking=self._loop is not None)
                self._publish_state(controller, self.get_clock().now().nanoseconds)
                self._end()
            else:
                try:  # the ticks that should have braked failed, too
                    controller.fail(error.code, error.message)
                    self._end()
                finally:
                    self._controller = None

    def close(self) -> None:
        self._stop_loop()

    def health_values(self) -> dict[str, object]:
        controller = self._controller
        values: dict[str, object] = {
            "mode": "IDLE",
            "refused_contours": self._refused,
            "late_ticks": self._late_ticks(),
            "pauses": self._pauses if self.is_configured else 0,
        }
        if controller is not None:
            values |= {"mode": controller.mode.name, "contour": controller.state().index, "ticks": controller.ticks}
            values |= controller.drift.values()
        values |= self._receiver.values() if self.is_configured else {}
        values |= self._latency.values()
        values |= self._loop.values() if self._loop is not None else {}
        return values

    # -- parameters ----------------------------------------------------------------------------

    def _check_parameters(self, changes: list[Parameter]) -> SetParametersResult:
        """All that is set together is valid together, on the job that is armed."""
        try:
            settings = self.values({change.name: change.value for change in changes})
            if (armed := self._armed_job()) is not None:
                control_config(armed[1], settings)
        except IsfError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _use_parameters(self, changes: list[Parameter]) -> None:
        """From the next tick on."""
        if not self.is_configured:
            return
        self._settings = settings = self.values()
        if (armed := self._armed_job()) is not None:
            config = control_config(armed[1], settings)
            with self._lock:
                armed[0].retune(config)
            self.get_logger().info("set: " + ", ".join(f"{change.name} {change.value}" for change in changes))

    # -- wrenches, hot path --------------------------------------------------------------------

    def _on_wrench_1(self, message: WrenchStamped) -> None:
        self._on_wrench(1, message)

    def _on_wrench_2(self, message: WrenchStamped) -> None:
        self._on_wrench(2, message)

    def _on_wrench(self, tool: int, message: WrenchStamped) -> None:
        self._latency.wrench()
        header = message.header
        stamp = header.stamp.sec * stamps.NANO + header.stamp.nanosec
        reading = (tool, header.frame_id, stamp, conversion.wrench_array(message))
        alive, fault = self._receiver.add(*reading)
        if alive:
            self._ready.wrench(tool)
        if fault:
            self._on_bad_wrench(reading, fault)
        elif self._loop is None:
            self._step_in_lockstep()
        elif self._pair.fresh(self._ready.needed):
            self._loop.offer()

    def _on_bad_wrench(self, reading: Reading, fault: Fault) -> None:
        """A wrench in other axes, or of a clock that cannot be followed, is not used; the contour ends with it.

        Between contours time may have gone on, as a scan takes its time: then it is the first of a new time. So it is
        when the plan is left: whatever the wrenches' time is now, the tools are lifted by it. A machine in a protective
        stop, which moves the tools clear by itself in lockstep, tells of the time after that: its fault is the cause.
        """
        controller, tool = self._controller, reading[0]
        by_clock = self._loop is not None
        lifts = self._leaving and fault[0] in (ErrorCode.WRENCH_CLOCK, ErrorCode.WRENCH_LATE)
        if controller is None or tool not in self._ready.needed or lifts or not (controller.busy or by_clock):
            self._receiver.restart()
            self._receiver.add(*reading)
        elif controller.fault is None:
            with self._lock:
                controller.fail(*(self._ready.machine_fault(0.0) or fault), ticking=by_clock)
                if not by_clock:  # else the next tick tells it
                    self._publish_state(controller, self.get_clock().now().nanoseconds)
                    self._end()

    def _step_in_lockstep(self) -> None:
        """Answer a complete pair of wrenches, when there is something to do."""
        controller = self._controller
        if controller is None or self._loop is not None:
            return
        if not controller.busy:
            if self._awaited is not None and self._pair.reached(self._awaited):
                self._end()
            return
        stamp = self._pair.take()
        if stamp is None:
            return
        rate = controller.config.rate
        tick = round(stamp * rate / stamps.NANO)
        self._awaited = due = stamps.tick_nanoseconds(tick + 1, rate)  # before it may come to its end in the tick
        self._unanswered = True
        # not by the stamp, which is a whole number of ns: the same time as in one process, at every rate
        targets = controller.tick(tick, tick / rate, *self._pair.wrench)
        self._output.targets(targets, due)
        self._unanswered = False
        self._after_tick(controller, stamp)

    def _end(self) -> None:
        """Report what came to its end, in lockstep when the machine has done the last targets: who asks it for a scan
        then finds it where the contour ended, and the same part gives the same numbers every time."""
        self._awaited = None
        self._publish_result()

    def _moving(self, controller: ForceController) -> bool:
        """True until what ``controller`` does has ended, in lockstep on the machine too."""
        return controller.busy or (controller is self._controller and self._awaited is not None)

    def _step_in_real_time(self) -> None:
        """One tick by the clock on the newest wrenches."""
        now = self._clock_offset + time.monotonic_ns()  # a clock that is set meanwhile does not make stamps jump
        controller = self._controller
        resting = self._delayed and controller is not None and not controller.busy
        if not self._lock.acquire(blocking=not resting):
            if self._output.has_targets:
                self._output.repeat(now)  # a contour is being planned
            self._latency.targets()
            return
        try:
            if controller is None or controller.mode is Mode.IDLE:
                self._output.rest()
                return
            if self._ticked.late():  # the wrenches of that time are still to be taken
                self._patient_until = max(self._patient_until, time.monotonic() + self._settings.wrench_pause)
            waiting = self._delayed or time.monotonic() < self._patient_until
            lost = [] if waiting else self._ready.lost()
            if lost and controller.fault is None:
                fault = self._ready.lost_fault(lost, self._timeout)
                if not controller.busy:  # no result will tell it
                    self.report(IsfError(*fault, where="between two contours"))
                controller.fail(*fault, ticking=True)
            if controller.busy and controller.fault is None:
                if stopped := self._ready.machine_fault(0.0):
                    controller.fail(*stopped, ticking=True)
                elif self._tare_lost():
                    controller.fail(ErrorCode.NO_TARE, TARE_LOST, ticking=True)
            self._pause(controller, waiting=waiting)
            blind = self._settings.output == "twist" and not waiting and controller.fault is None
            if blind and (text := self._ready.pose_lost_text()):
                controller.fail(ErrorCode.POSE_LOST, text, ticking=True)
            self._tick_number += 1 if self._pair.fresh(self._ready.needed) else 2  # a gap: its wrenches were lost
            self._pair.use()
            targets = controller.tick(self._tick_number, now / stamps.NANO, *self._pair.wrench)
            self._output.targets(targets, now)
            self._after_tick(controller, now)
        finally:
            self._lock.release()

    def _unknown(self, seconds: float) -> Fault | None:
        """Why the forces have not been known for ``seconds``; None: they were."""
        if missing := self._ready.missing(seconds):
            return self._ready.lost_fault(missing, seconds)
        if self._receiver.late_for(self._ready.needed) > seconds:
            return ErrorCode.WRENCH_LATE, f"the wrenches have come too late for {seconds:g} s"
        return None

    def _pause(self, controller: ForceController, *, waiting: bool) -> None:
        """A driver that is slow, on a busy computer, is waited for: the tools stand while nothing is known, and for
        STEADY more. A measurement, which moves by the force, ends. After a fault nothing is waited for: what lifts the
        tools then goes on. ``waiting``: this node itself was kept waiting, what came meanwhile has to be taken."""
        now = time.monotonic()
        measuring = controller.measuring and controller.fault is None
        self._seek_controllers(controller, now)
        unknown = None if waiting else self._unknown(BLIND if measuring else self._settings.wrench_pause)
        if unknown:
            self._paused_until = now + STEADY
        if unknown and measuring:
            controller.fail(*unknown, ticking=True)
        if not waiting:
            self._count_without(controller, unknown)
        paused = (now < self._paused_until or self._ticks_to_stand > 0) and controller.fault is None
        if paused == controller.paused:
            return
        controller.paused = paused
        if paused and unknown:
            self._pauses += 1
            self.get_logger().warning(f"{unknown[1]}: the tools stand")
        elif controller.fault is None and now >= self._paused_until > 0.0:
            self.get_logger().warning("the wrenches are back: the tools go on")

    def _count_without(self, controller: ForceController, unknown: Fault | None) -> None:
        """Wrenches that come now and then, or late but for one now and then, are as good as none: tools that mostly
        stand for want of them are on the sheet for nothing."""
        period = 1.0 / controller.config.rate
        self._without = self._without + period if unknown else max(0.0, self._without - MADE_GOOD * period)
        if unknown and self._without > self._timeout and controller.busy and controller.fault is None:
            code, text = unknown
            controller.fail(
                code, f"{text}, again and again: the tools hardly moved for {self._timeout:g} s", ticking=True
            )

    def _tare_lost(self) -> bool:
        """Whether wrenches that the driver has to tare no longer are."""
        return not (self._settings.wrenches_tared or self._leaving) and self._ready.tare_lost()

    def _seek_controllers(self, controller: ForceController, now: float) -> None:
        """The tools stand until those who move them by joints have been found, and for STANDING more."""
        if self._ticks_to_stand == 0:
            return
        unheard = self._output.unheard(self._ready.needed)
        if not unheard:
            self._ticks_to_stand -= 1
        elif now > self._seek_until:
            self._ticks_to_stand = 0
            text = f"nobody takes {' and '.join(unheard)} (is a joint_trajectory_controller active, of that name?)"
            if controller.fault is None:
                controller.fail(ErrorCode.NODE_MISSING, text, ticking=True)

    def _after_tick(self, controller: ForceController, stamp: int) -> None:
        self._latency.targets()
        if controller.repeating != self._repeating:
            self._repeating = controller.repeating
            if self._repeating:
                self._pauses += 1
                self.get_logger().warning(f"tool_{self._repeating}/wrench repeats itself under load: the tools stand")
        self._ticks += 1
        if self._ticks % self._settings.state_decimation == 0 or controller.mode is not self._last_mode:
            self._publish_state(controller, stamp)
        if not controller.busy and self._loop is not None:
            self._publish_result()

    # -- results and states --------------------------------------------------------------------

    def _publish_state(self, controller: ForceController, stamp: int) -> None:
        self._last_mode = controller.mode
        self._output.state(controller.state(), stamp, self._latency.last)

    def _publish_result(self) -> None:
        controller = self._controller
        result = controller.take_result() if controller is not None else None
        if controller is None or result is None:
            return
        late = self._late_ticks() - self._late_before
        result = with_overload(result, self._job_file)
        if not result.completed:
            self.report(IsfError(ErrorCode(result.code), result.message, where=contour_label(result.index)))
        elif warning := offset_warning(result, controller.config.offset_limit):
            self.warn(warning)
        self._output.result(replace(result, late_ticks=late))

    def _late_ticks(self) -> int:
        return self._loop.late_ticks if self._loop is not None else self._late_ended

    # -- watchdog and heartbeat ----------------------------------------------------------------

    def _on_timer(self) -> None:
        late = self._look.late()
        with self._lock:
            controller = self._controller
            if controller is not None and (drifted := controller.drift.untold()):
                self.warn(drifted)
            if late:
                self._attended.not_served()
            self._hand.watch()
            if controller is not None:
                forming = controller.busy and not controller.measuring
                on_sheet = controller.on_sheet and not controller.clear_of_contour
                on_sheet &= not self._hand.armed  # by hand somebody is there
                if alone := self._attended.judge(on_sheet=on_sheet, forming=forming):
                    self._lift_unattended(controller, alone)
            if controller is None or self._loop is not None:
                return
            if controller.mode is Mode.IDLE and self._awaited is None:
                return
            if late:
                self._patient_until = time.monotonic() + self._timeout
            lost = self._ready.lost() if time.monotonic() > self._patient_until else []
            ends = self._ready.lost_fault(lost, self._timeout) if lost else self._ready.machine_fault(STOPPED_FOR)
            if ends and (controller.busy or self._awaited is not None):
                if controller.busy:
                    controller.fail(*ends)
                    self._publish_state(controller, self.get_clock().now().nanoseconds)
                self._end()
            if self._output.has_targets and time.monotonic() - self._output.last_publish >= HEARTBEAT:
                self._output.repeat()

    def _lift_unattended(self, controller: ForceController, alone: IsfError) -> None:
        """Nobody is there to go on with the part: take the tools off the sheet; this or the next contour ends with
        why."""
        self.report(alone)
        if controller.busy:
            controller.fail(alone.code, alone.message, ticking=True)
        elif controller.fault is None:
            waiting = isf.Contour(plan_id=controller.plan_id, index=controller.state().index + 1)
            self._output.refusal(waiting, int(alone.code), alone.message)
        self._disarm()

    @contextmanager
    def _own_delay(self) -> Iterator[None]:
        """A long callback of this node: wrenches wait in its queue meanwhile, they are not lost."""
        self._delayed = True
        try:
            yield
        finally:
            self._patient_until = time.monotonic() + self._grace
            self._delayed = False
            self._attended.not_served()

    # -- other messages ------------------------------------------------------------------------

    def _on_pose(self, tool: int, message: PoseStamped) -> None:
        tip = conversion.tip_of(message)
        self._ready.pose(tool, tip)
        if tool == 1:
            self._ready.axis = conversion.axis_of(message)
        self._output.measured(tool, tip)
        if self._controller is not None:
            self._controller.add_measured(tool, stamps.to_seconds(message.header.stamp), tip)

    def _on_machine(self, message: isf.MachineState) -> None:
        self._ready.machine(message)

    def _on_contour(self, message: isf.Contour) -> None:
        with self._own_delay(), self._lock:
            controller = self._controller
            try:
                if not self.is_active or controller is None:
                    what, advice = ("no plan is armed", "arm the plan first")
                    if not self.is_active:
                        what, advice = ("force_ctrl is not active", "activate it, then arm the plan")
                    raise IsfError(ErrorCode.NOT_ARMED, what, where=contour_label(message.index), advice=advice)
                if self._hand.armed:
                    raise IsfError(
                        ErrorCode.NOT_ARMED,
                        "the tools are moved by hand",
                        where=contour_label(message.index),
                        advice="arm the plan first",
                    )
                try:
                    contour = conversion.contour_from_message(message)
                except ValueError as fault:  # of lengths that do not go together, of no process
                    raise IsfError(
                        ErrorCode.CONTOUR_REJECTED,
                        f"malformed: {fault}",
                        where=contour_label(message.index),
                        advice="look at the node that publishes contour/corrected",
                    ) from fault
                self._ready.check_forming(contour.forming_tool)
                if self._tare_lost():
                    raise IsfError(
                        ErrorCode.NO_TARE, TARE_LOST, advice="call machine/tare with free tools, and arm again"
                    )
                if not controller.busy:
                    self._end()
                controller.start(contour)
                self._receiver.begin_contour()
                if warning := self._chips.check(contour):
                    self.get_logger().warning(warning)
            except Exception as fault:
                error = fault if isinstance(fault, IsfError) else self.fault(fault, contour_label(message.index))
                self._refused += 1
                self.get_logger().warning(f"contour refused: {error}")
                self._publish_refusal(message, error)
                return
            self._late_before = self._late_ticks()
            self._step_in_lockstep()

    def _publish_refusal(self, message: isf.Contour, error: IsfError) -> None:
        """A result that says why, so that nobody waits for the contour; not for one that is being formed already."""
        controller = self._controller
        if controller is not None and controller.busy and controller.started(message.plan_id, message.index):
            return
        self._output.refusal(message, int(error.code), error.message)

    # -- services ------------------------------------------------------------------------------

    def _on_arm(self, request: Arm.Request, response: Arm.Response) -> Arm.Response:
        try:
            if request.plan_id or request.by_hand:
                with self._own_delay():
                    self._arm(request)
            else:
                self._disarm()
        except IsfError as error:
            response.code, response.message = int(error.code), error.message
            self.report(error)
        else:
            self.report_ok()
        return response

    def _arm(self, request: Arm.Request) -> None:
        if not self.is_active:
            raise IsfError(ErrorCode.NOT_ARMED, "force_ctrl is not active", advice="activate it first")
        if self._controller is not None and self._controller.busy:
            raise IsfError(ErrorCode.NOT_ARMED, "the tools are moving", advice="stop or disarm first")
        job_file = JobFile(request.job_text, Path(request.base_folder), "job")
        job_file = with_raised_force_limit(job_file, self._simulated_sheet(request))
        override = conversion.set_point_of(request.support_force)
        job_file.job.check_set_point(
            override,
            where="support_force",
            advice="leave it out (-1), or use a job of process DSIF with a support tool",
        )
        self._ready.needed = tools_with_load_cell(job_file.job)
        self._ready.check(tared=self._settings.wrenches_tared)
        here_1, here_2 = self._ready.tip(1), self._ready.tip(2)
        controller = ForceController(control_config(job_file, self._settings))
        if not self._settings.lockstep:
            self._ready.keep_rates(controller.config.rate)
        park = controller.config.park_height
        tip_1, tip_2 = here_1 or (0.0, 0.0, park), here_2 or (0.0, 0.0, -park)  # one that is elsewhere faults
        self._awaited, resting = None, self._resting_at(tip_1, tip_2)
        # where no tool is tilted a driver may give out whatever orientation it likes
        axis = self._ready.axis if controller.config.largest_tilt > 0.0 else UPRIGHT
        space = None
        if request.by_hand:
            space = HandSpace.of_job(job_file, max(0.0, request.sheet_depth), axis)
            controller.arm(BY_HAND, 0, 1, tip_1, tip_2, override, axis)
        else:
            controller.arm(request.plan_id, request.first_index, request.count, tip_1, tip_2, override, axis)
            kept, self._kept = self._kept, None
            if kept is not None and request.first_index > 0:
                # now: once this is armed, it may hear the contour of before a kill, and take it
                load_controller(controller, kept)
                resting = None
        if resting is not None:
            controller.rests_as(resting)
        self._chips = ChipWatch(job_file, override)
        self._stop_loop()  # from here on no other thread sees the controller
        self._late_ended, self._leaving, self._unanswered = 0, False, False
        self._receiver.restart()
        self._latency = LatencyMeter()
        self._output.aim(job_file, controller.config.rate)
        if space is None:
            self._output.armed(request, tip_1, tip_2, axis, controller.config)
        self._output.start(tip_1, tip_2, controller.config.rate, axis)
        self._output.with_holder = job_file.job.process == "TPIF"
        self._controller, self._job_file = controller, job_file
        self._hand.disarm()
        if space is not None:
            self._hand.arm(space)
        self._attended.begin()
        self._publish_state(controller, self.get_clock().now().nanoseconds)
        if not self._settings.lockstep:
            self._tick_number, self._paused_until, self._without = -1, 0.0, 0.0
            by_joints = self._settings.output == "joint_trajectory"
            self._ticks_to_stand = round(STANDING * controller.config.rate) if by_joints else 0
            self._seek_until = time.monotonic() + self._timeout
            self._clock_offset = self.get_clock().now().nanoseconds - time.monotonic_ns()
            settings = RealTimeSettings(self._settings.real_time_priority, self._settings.lock_memory)
            step = self.guard(self._step_in_real_time, "control tick")
            self._loop = PeriodicLoop(controller.config.rate, step, settings)
            self._loop.start()
            if refused := self._loop.privileges.reason:
                self.get_logger().warning(
                    f"ticks by the clock without the real-time settings that the system refused: {refused}", once=True
                )
        what = f"plan {request.plan_id}, contours {request.first_index + 1} to {request.count}"
        self.get_logger().info(f"armed: {BY_HAND if request.by_hand else what}")

    def _resting_at(self, tip_1: Vector, tip_2: Vector) -> ForceController | None:
        """The controller of the plan before, where it left the tools on the sheet and they, at ``tip_1``, ``tip_2``
        (3,) m, still are there."""
        before = self._controller
        if before is None or not before.on_sheet:
            return None
        moved = [math.dist(tip, target) for tip, target in zip((tip_1, tip_2), before.targets[:2], strict=True)]
        return before if max(moved) < SAME_PLACE else None

    def _simulated_sheet(self, request: Arm.Request) -> str:
        """Its kind, empty for a real one; raises IsfError FILE_FIELD where the machine cannot have it. Limits that are
        too high for a real machine are the danger."""
        kind = sheet_kind(request.sheet) or ""
        if kind not in ("", "fast") and not self._settings.lockstep:
            raise IsfError(
                ErrorCode.FILE_FIELD,
                f"the sheet '{kind}' is simulated, and slower than the wall clock",
                where="sheet",
                advice="leave it empty for a real machine, which keeps the limits of its rig",
            )
        return kind

    def _armed_job(self) -> tuple[ForceController, JobFile] | None:
        return (self._controller, self._job_file) if self._controller is not None else None

    def _disarm(self) -> None:
        with self._lock:
            self._kept = None
            self._hand.disarm()
            if self._controller is not None:
                self._leaving = True
                if self._unanswered:  # a tick that failed; the machine waits for what follows from its wrenches
                    self._pair.take_again()
                self._controller.disarm()
                self._publish_state(self._controller, self.get_clock().now().nanoseconds)
                self._step_in_lockstep()

    def _on_stop(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        with self._lock:
            if self._controller is not None:
                self._controller.stop("force_ctrl/stop was called")
                self._publish_state(self._controller, self.get_clock().now().nanoseconds)
                if not self._controller.busy:
                    self._end()
                self._step_in_lockstep()
        response.success = True
        return response

    def _on_save(self, request: StateFile.Request, response: StateFile.Response) -> StateFile.Response:
        with self._answering(response), self._lock:
            save_controller(self._in_lockstep(), self._path_of(request))
        return response

    def _on_load(self, request: StateFile.Request, response: StateFile.Response) -> StateFile.Response:
        with self._answering(response), self._lock:
            path = self._path_of(request)
            if not self._settings.lockstep:
                raise _kept_in_lockstep()
            if self._controller is not None and self._controller.busy:
                raise IsfError(ErrorCode.NOT_ARMED, "the tools are moving", advice="stop or disarm first")
            if not path.is_file():
                raise IsfError(
                    ErrorCode.FILE_NOT_FOUND, "no such file", where=str(path), advice="force_ctrl/save first"
                )
            self._kept = path
        return response

    def _in_lockstep(self) -> ForceController:
        """The armed controller, where time stands still between contours: by the clock the tools of a part that goes on
        are off the sheet. Raises IsfError NOT_ARMED."""
        if not self._settings.lockstep:
            raise _kept_in_lockstep()
        if self._controller is None:
            raise IsfError(ErrorCode.NOT_ARMED, "nothing is armed", advice="arm the plan")
        return self._controller

    def _path_of(self, request: StateFile.Request) -> Path:
        return path_below(Path(self._settings.state_folder).absolute(), request.path)

    @contextmanager
    def _answering(self, response: StateFile.Response) -> Iterator[None]:
        """An expected failure becomes code and message."""
        try:
            yield
        except IsfError as error:
            response.code, response.message = int(error.code), error.message
            self.get_logger().warning(str(error))

    def _stop_loop(self) -> None:
        if self._loop is not None:
            self._loop.stop()
            self._late_ended = self._loop.late_ticks  # of the contour that ends with it, too
            self._loop = None
            self._output.rest(last=True)


def _kept_in_lockstep() -> IsfError:
    return IsfError(ErrorCode.NOT_ARMED, "the state is kept in lockstep only", advice="arm the plan, in lockstep")


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    quantity.parse("1 mm", "m")  # loads the units, before the node exists: at arming that would make it look dead
    return process.run(ForceCtrlNode, args, streams=True)


if __name__ == "__main__":
    sys.exit(main())
