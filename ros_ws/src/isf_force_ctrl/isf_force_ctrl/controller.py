"""The force controller: streams targets for both tools, one pair per tick of the load cells.

Holds what an armed plan allows, when a contour may start, how fast it is travelled, the tick-by-tick log with the
result made from it, and the feed-forward learned from the contour before. Between contours it plays measurements
(:mod:`isf_force_ctrl.measurements.measurement`). Frame ``sheet``, SI units.
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from isf_core.contour import Contour, ContourResult, contour_label
from isf_core.errors import ErrorCode, IsfError
from isf_core.geometry.tool_axis import UNIT_TOLERANCE, UPRIGHT
from isf_core.types import Array
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from isf_force_ctrl.control_config import ControlConfig
from isf_force_ctrl.control_laws import TRACKING, ControlLaws
from isf_force_ctrl.control_state import ControlState, Flag, Mode, Targets
from isf_force_ctrl.measurements.measurement import AtRest, Measurement, Stand
from isf_force_ctrl.motion.contour_path import contour_path
from isf_force_ctrl.motion.segments import (
    RESTING,
    Column,
    Playback,
    Present,
    Row,
    Segment,
    aside_segments,
    axis_of_row,
    braking,
    continues,
    contour_segments,
    lift_segments,
    posture_of,
)
from isf_force_ctrl.motion.tool_moves import Tools
from isf_force_ctrl.motion.trajectory import ToolPath
from isf_force_ctrl.supervision.wrench_watch import DriftWatch, WrenchWatch, fault_of, plausible

CLEAR_OF_SHEET = 10e-3
"""m along the push from the highest place of a contour, beyond which a tool touches nothing (assumed: more than a sheet
springs back)."""

NAN = float("nan")

M = TypeVar("M", bound=Measurement)


class ForceController:
    """Contact-force and compliance control of one job; see the module."""

    def __init__(self, config: ControlConfig) -> None:
        config.check()
        self.config = config
        self.fault: tuple[ErrorCode, str] | None = None
        """Why the controller is in HOLD; None when it is not."""
        self.paused = False
        """Set from outside while the wrenches are not to be believed: the tools are brought to a stand, the offsets are
        held, and both go on when it is taken back. Measurements go on, and so does what takes the tools off the sheet
        after :meth:`disarm`: nobody waits for the wrenches then."""
        self._mode = Mode.IDLE
        self._playback = Playback(RESTING, config.acceleration, config.rate)
        self._log: ContourLog | None = None
        self._result: ContourResult | None = None
        self._plan = ArmedPlan()
        self._ticks = 0
        self._formed: Contour | None = None
        self._measurement: Measurement | None = None
        self._mode_before = Mode.IDLE
        self._fault_before: tuple[ErrorCode, str] | None = None
        self.drift = DriftWatch(config)
        """Drift of both load cells."""

    # -- commands ------------------------------------------------------------------------------

    def arm(
        self,
        plan_id: str,
        first_index: int,
        count: int,
        tip_1: Sequence[float],
        tip_2: Sequence[float],
        contour_support_force_override: float | None = None,
        axis: Sequence[float] = UPRIGHT,
    ) -> None:
        """Accept the contours ``first_index`` .. ``count`` - 1 of ``plan_id``, in order.

        ``tip_1``, ``tip_2`` (3,) m are where the tools are now, ``axis`` (3,) is that of tool 1; the override (N)
        replaces the contours' set-points, None leaves them (or the configuration's). Clears a fault.

        Raises IsfError NOT_ARMED.
        """
        if self.busy:
            raise IsfError(ErrorCode.NOT_ARMED, "the tools are moving", advice="stop or disarm first")
        tips, override = tips_of(tip_1, tip_2), contour_support_force_override
        if not abs(math.hypot(*axis) - 1.0) <= UNIT_TOLERANCE:
            raise IsfError(
                ErrorCode.NOT_ARMED,
                "the axis of tool_1 is not known",
                advice="the driver gives the orientation of the tool on tool_1/pose, the identity for an upright one",
            )
        if override is not None and override > self.config.largest_set_point:
            raise IsfError(
                ErrorCode.NOT_ARMED,
                f"support force of {override:g} N is more than the rig bears ({self.config.largest_set_point:g} N)",
                where="support_force",
                advice="a smaller one; -1 leaves it to the contours",
            )
        self._plan = armed_plan(plan_id, first_index, count, tips, override)
        config = self.config
        self._laws, self._watch = ControlLaws(config), WrenchWatch(config)
        self.drift = DriftWatch(config)
        self._engagement = Engagement(config)
        self._support_force = config.support_force if override is None else override
        row = [*tips[0].tolist(), *tips[1].tolist(), *RESTING[6:]]
        if tuple(axis) != UPRIGHT:
            row += map(float, axis)
        self._playback = Playback(row, config.acceleration, config.rate)
        self._log = self._result = self.fault = self._fault_before = None
        self.paused = False
        self._index = first_index
        self._previous: tuple[np.ndarray, np.ndarray] | None = None
        self._lift_normal = np.array([0.0, 0.0, 1.0])
        self._clear, self._engaged, self._open_end = True, False, False
        self._before: ToolPath | None = None
        self._tools = Tools(forming=1, with_support=False)
        self._stopping: tuple[ErrorCode, str] | None = None
        self._lift_after_stop = self._idle_after = False
        self._ticks, self._last_tick = 0, -1
        self._used: tuple[Sequence[float], Sequence[float]] = ((), ())
        self._targets = Targets(
            (tips[0, 0], tips[0, 1], tips[0, 2]), (tips[1, 0], tips[1, 1], tips[1, 2]), 0.0, axis_of_row(row)
        )
        self._mode = Mode.ARMED

    def rests_as(self, before: ForceController) -> None:
        """The tools, armed anew where they are, rest on the sheet as ``before`` left them: whatever comes next lifts
        them first, a contour and the end of the plan too."""
        self._clear, self._tools, self._lift_normal = before._clear, before._tools, before._lift_normal

    def start(self, contour: Contour) -> None:
        """Form ``contour`` (already corrected); targets follow from the next ticks on.

        Raises IsfError NOT_ARMED, CONTOUR_REJECTED; the code of the fault for which the tools are held.
        """
        where = contour_name(contour)
        if self._mode is Mode.HOLD and self.fault is not None:
            code, text = self.fault
            held = ErrorCode.NOT_ARMED if code is ErrorCode.STOPPED else code
            raise IsfError(held, f"held: {text}", where=where, advice="arm again")
        if self._mode is Mode.IDLE:
            raise IsfError(ErrorCode.NOT_ARMED, "no plan is armed", where=where, advice="arm the plan first")
        self._plan.check(contour, busy=self.busy)
        here = posture_of(self._playback.row)
        path = contour_path(contour, self.config, (here.tip_1, here.tip_2), self._support_force)
        forced = bool(np.isfinite(path.set_point[0]))
        present = self._present()
        last = contour.index == self._plan.count - 1
        segments = contour_segments(
            self.config,
            path,
            contour.feed,
            present,
            retract=contour.retract,
            continues=self._open_end and continues(contour, path, present, self.config.link_length),
            runs_on=self._runs_on(contour) and not last,
        )
        if forced and self.config.learning > 0.0 and self._previous is not None:
            width = round(self.config.learning_width * self.config.rate)
            feed_forward(segments[-1].rows, path.forming, *self._previous, width)
        self._lift_normal = contour.normal[0] if contour.closed else contour.normal[-1]
        kept = path.forming == self._tools.forming and self._tools.with_support
        self._tools = Tools(path.forming, contour.has_support or kept)
        self._open_end = not contour.closed
        self._before = path
        if last:
            end = posture_of(segments[-1].rows[-1])
            segments += lift_segments(self.config, end, self._lift_normal, self._tools)
        elif contour.lift_after:
            end = posture_of(segments[-1].rows[-1])
            segments += lift_segments(self.config, end, self._lift_normal, self._tools, then="stay")
        self._log = ContourLog(contour, forced, self._laws.backoffs)
        self._last_tick = -1  # what passed between contours, as during a scan, was not lost
        self._laws.assign(path.forming, forced=forced)
        self._index = contour.index
        self._plan.take(contour)
        self._clear = False
        self._formed = contour
        self._play(segments)

    def retune(self, config: ControlConfig) -> None:
        """Go on with other gains, set-point, limits and filters; rate, rig and job are as before. In mid-contour too:
        offsets go on from where they are, the set-point is ramped."""
        self.config = config
        self.drift.retune(config)
        if self._mode is not Mode.IDLE:
            self._laws.retune(config)
            self._watch.retune(config)
            self._engagement.retune(config)

    def measure(self, make: Callable[[AtRest], M], *, on_sheet: bool = False) -> M:
        """Begin the measurement made by ``make``; targets follow from the next ticks on.

        Raises IsfError NOT_ARMED (also when the tools must be ``on_sheet`` and are not), and what ``make`` raises.
        """
        self._check_at_rest(on_sheet=on_sheet)
        normal = np.array([0.0, 0.0, 1.0]) if self._clear else self._lift_normal
        stand = Stand(self._tools, normal, self._clear)
        measurement = make(AtRest(self.config, self._playback.row, stand, self._formed))
        self._measurement, self._mode_before, self._mode = measurement, self._mode, Mode.FREEZE
        # what moves after a stop is watched like all that moves: a fault that is there already would hide another one
        self._fault_before, self.fault = self.fault, None
        return measurement

    def move_aside(self) -> None:
        """Lift both tools clear of the sheet and move them aside; the next contour approaches again.

        Raises IsfError NOT_ARMED.
        """
        self._check_at_rest()
        if self.fault is not None:
            raise IsfError(ErrorCode.NOT_ARMED, f"held: {self.fault[1]}", advice="arm again")
        here = posture_of(self._playback.row)
        if not self._clear:
            self._play(lift_segments(self.config, here, self._lift_normal, self._tools, then="aside"))
        elif way := aside_segments(self.config, here, self._tools):
            self._play(way)

    def cancel(self) -> None:
        """End a measurement early: the tools return to where it began, or are lifted and parked."""
        if self._measurement is not None:
            self._measurement.give_up(ErrorCode.STOPPED, "the measurement was cancelled", stay=False)

    def stop(self, reason: str) -> None:
        """Decelerate smoothly and hold; the contour's result, or the measurement, carries STOPPED."""
        if self._measurement is not None:
            self._fail_measurement(self._measurement, ErrorCode.STOPPED, f"stopped: {reason}")
        elif self._mode is not Mode.IDLE:
            self._stop(ErrorCode.STOPPED, f"stopped: {reason}")
            self._brake()
            if not self._playback and self._stopping is not None:
                self._hold()

    def fail(self, code: ErrorCode, text: str, *, ticking: bool = False) -> None:
        """End contour or measurement with ``code`` and hold: after braking when ticks go on, at once when none will."""
        if self._measurement is not None:
            self._fail_measurement(self._measurement, code, text)
            if not ticking:
                self._end_measurement(self._measurement)
        elif self._mode is not Mode.IDLE:
            self._stop(code, text)
            if self._stopping is not None and not (ticking and self._playback):
                self._hold()

    def disarm(self) -> None:
        """Stop if moving, freeze the offset, lift and park the tools, then IDLE."""
        if self._mode is Mode.IDLE:
            return
        self._idle_after = True
        if self._measurement is not None:
            self._lift_after_stop = True
            self._fail_measurement(self._measurement, ErrorCode.STOPPED, "stopped: disarmed")
            return
        if self._playback and self._stopping is None:
            self._stop(ErrorCode.STOPPED, "stopped: disarmed")
        if self._stopping is not None:
            self._lift_after_stop = True
        else:
            self._lift()

    # -- what is going on ----------------------------------------------------------------------

    @property
    def mode(self) -> Mode:
        """Present mode."""
        return self._mode

    @property
    def plan_id(self) -> str:
        """Plan that was armed last; empty: none."""
        return self._plan.plan_id

    @property
    def ticks(self) -> int:
        """Ticks since it was armed."""
        return self._ticks

    @property
    def busy(self) -> bool:
        """True while targets change: from start of contour or measurement to its end (of the last: until parked)."""
        stopping = self._mode is not Mode.IDLE and self._stopping is not None
        return self._measurement is not None or bool(self._playback) or stopping

    @property
    def measuring(self) -> bool:
        """True from the begin of a measurement to its end."""
        return self._measurement is not None

    def started(self, plan_id: str, index: int) -> bool:
        """True for the contour that was started last."""
        return (plan_id, index + 1) == (self._plan.plan_id, self._plan.next)

    @property
    def on_sheet(self) -> bool:
        """True when the tools rest on the sheet: after a contour, or held after a stop or a fault."""
        return self._mode is not Mode.IDLE and not self.busy and not self._clear

    @property
    def clear_of_contour(self) -> bool:
        """True when both tools are still, or again, well away from where they touch the sheet on the contour that was
        started last. They may all the same stand in a pocket, out of which they have to be lifted."""
        contour = self._formed
        if contour is None:
            return False
        up = -contour.push_sign
        forming, support = self._targets.tip_1, self._targets.tip_2
        if contour.forming_tool == 2:
            forming, support = support, forming
        away = [up * forming[2] - float((up * contour.forming_tip[:, 2]).max())]
        if contour.has_support:
            away.append(-up * support[2] - float((-up * contour.support_tip[:, 2]).max()))
        return min(away) > CLEAR_OF_SHEET

    @property
    def targets(self) -> Targets:
        """Last targets."""
        return self._targets

    def add_measured(self, tool: int, time: float, tip: Sequence[float]) -> None:
        """Keep the tip (3,) m of ``tool`` (1, 2) that the machine reported for ``time`` (s)."""
        if self._log is not None:
            self._log.add_measured(tool, time, tip)
        if self._measurement is not None:
            self._measurement.add_measured(tool, time, tip)

    def take_result(self) -> ContourResult | None:
        """Result of the contour that ended, once; None when there is none."""
        if self._result is None or (self._playback and self.fault is None):
            return None
        result, self._result = self._result, None
        return result

    def state(self) -> ControlState:
        """Snapshot after the last tick."""
        if self._mode is Mode.IDLE:
            nothing = (0.0, 0.0, 0.0)
            stiffness = self.config.contact_stiffness
            return ControlState("", 0, 0, Mode.IDLE, NAN, 0.0, 0.0, NAN, nothing, nothing, stiffness, 0.0, 0)
        laws, forced = self._laws, self._mode in TRACKING
        return ControlState(
            plan_id=self._plan.plan_id,
            index=self._index,
            tick=self._ticks,
            mode=self._mode,
            set_point=laws.set_point if forced else NAN,
            normal_force=laws.normal_force,
            normal_force_filtered=laws.filtered,
            error=laws.error if forced else NAN,
            forming_offset=laws.forming_offset,
            support_offset=laws.support_offset(self._playback.row),
            contact_stiffness=laws.contact_stiffness,
            feed=self._playback.feed,
            flags=laws.flags
            | (int(Flag.DRIFT) if self.drift.warning else 0)
            | (int(Flag.PAUSED) if self._standing else 0),
        )

    # -- one tick ------------------------------------------------------------------------------

    def tick(self, tick: int, time: float, wrench_1: Sequence[float], wrench_2: Sequence[float]) -> Targets:
        """Targets for the next tick from the wrenches (6,) of this one.

        ``tick`` counts the machine's ticks (gaps within a contour count as lost messages), ``time`` s is that of the
        wrenches.
        A wrench that is not finite or beyond the rig's limits ends in HOLD and :attr:`fault`, not in an exception.
        """
        if self._mode is Mode.IDLE:
            raise IsfError(ErrorCode.NOT_ARMED, "tick without a plan", advice="arm the plan first")
        if self._measurement is not None:
            return self._tick_measuring(self._measurement, tick, time, wrench_1, wrench_2)
        if self._log is not None and self._last_tick >= 0 and tick > self._last_tick + 1:
            self._log.lost_messages += tick - self._last_tick - 1
        self._last_tick = tick
        self._ticks += 1
        forces = (*map(float, wrench_1[:3]), *map(float, wrench_2[:3]))
        # one cell may be silent and the other one tell of an overload; no sign is judged by a force that is not known
        judged, row = Mode.HOLD if self._blind else self._mode, self._playback.row
        found = self._watch.check(wrench_1, wrench_2, self._tools.forming, judged, self._laws.normal_force, row)
        if self._blind:
            self.drift.restart()
        else:
            fresh = (wrench_1 is not self._used[0], wrench_2 is not self._used[1])
            found = found or self.drift.check(row, self._tools, self._mode, forces, fresh)
        if found and self.fault is None:
            self._stop(*found)
        self._used = (wrench_1, wrench_2)
        blind = self._blind or self.fault is not None
        laws = self._laws
        if not blind:
            laws.sense(row, forces)
        if self._log is not None:
            targets = self._targets
            self._log.add(
                (
                    time,
                    Mode.HOLD if self._standing else self._mode,
                    laws.flags,
                    laws.set_point,
                    laws.normal_force,
                    row[9],
                    laws.offset,
                ),
                laws.forming_offset,
                forces,
                (*targets.tip_1, *targets.tip_2),
            )
        mode = self._mode
        self._advance()
        if not self._playback.moving:
            mode = self._mode
        mode = Mode.HOLD if self._standing else mode
        self._targets = laws.step(mode, self._playback.row, row, None if blind else forces)
        return self._targets

    def _advance(self) -> None:
        """Move on by one tick along the present segment, or to the next one."""
        playback, stopping = self._playback, self._stopping is not None
        if not playback:
            if playback.moving:
                self._brake()
            elif stopping:
                self._hold()
            return
        if playback.segment.waits:
            if stopping:
                self._hold()
            elif not self._blind and self._engagement.over(
                self._laws.wanted(self._mode, playback.segment.rows[0]), self._laws.set_point, self._laws.filtered
            ):
                self._leave()
            return
        ended = playback.advance(self._wanted_pace())
        if stopping and (ended or playback.pace <= 0.0):
            if ended and playback.segment.runs_on:
                playback.clear(in_motion=True)
                self._brake()
            else:
                self._hold()
        elif ended:
            self._leave()

    @property
    def repeating(self) -> int:
        """Tool whose readings repeat exactly, for which the tools stand before that is a fault; 0: none."""
        return self._watch.repeating if self.fault is None else 0

    @property
    def _blind(self) -> bool:
        """The forces are not known."""
        return self.paused or self._watch.repeating > 0

    @property
    def _standing(self) -> bool:
        """Waits for the wrenches. Disarmed, the tools leave the sheet without them: who does that may have nothing else
        left, and away from the sheet no force is needed."""
        return self._blind and not self._idle_after

    def _wanted_pace(self) -> float:
        if self._stopping is not None:
            return 1.0 if self._playback.segment.mode is Mode.HOLD else 0.0
        if self._standing:
            return 0.0
        if self._mode is not Mode.CONTROL:
            return 1.0
        return pace(self.config, self._laws.set_point - self._laws.filtered)

    def _play(self, segments: list[Segment]) -> None:
        self._playback.load(segments)
        self._enter()

    def _enter(self) -> None:
        """Take up the mode of the present segment."""
        mode = self._playback.segment.mode
        if mode in TRACKING and self._mode not in (*TRACKING, Mode.FREEZE):
            self._laws.engage()
        self._mode = mode
        self._engagement.restart()

    def _leave(self) -> None:
        """End the present segment: on to the next, or rest."""
        done = self._playback.leave()
        if done.mode is Mode.CONTROL and self._log is not None:
            self._previous = self._log.profile()
        if self._playback:
            self._enter()
            return
        self._engaged = done.mode is Mode.CONTROL
        self._mode = Mode.FREEZE if self._engaged else Mode.ARMED
        if done.mode is Mode.LIFT:
            self._clear = True
            if self._idle_after or self._plan.done:
                self._mode = Mode.IDLE
        if self._log is not None:
            code, text = self.drift.news()
            self._result, self._log = self._log.result(True, code, text, backoffs=self._laws.backoffs), None

    # -- measurements --------------------------------------------------------------------------

    def _check_at_rest(self, *, on_sheet: bool = False) -> None:
        stopped = self._mode is Mode.HOLD and self.fault is not None and self.fault[0] is ErrorCode.STOPPED
        if self.busy or self._playback.moving:
            raise IsfError(ErrorCode.NOT_ARMED, "the tools are moving", advice="wait for the contour, or stop it")
        if self._mode not in (Mode.ARMED, Mode.FREEZE) and not stopped:
            raise IsfError(ErrorCode.NOT_ARMED, f"not possible in {self._mode.name}", advice="arm a plan first")
        if on_sheet and self._clear:
            raise IsfError(ErrorCode.NOT_ARMED, "the tools are not on the sheet", advice="form a contour first")

    def _tick_measuring(
        self, measurement: Measurement, tick: int, time: float, wrench_1: Sequence[float], wrench_2: Sequence[float]
    ) -> Targets:
        self._last_tick = tick
        self._ticks += 1
        forces = (*map(float, wrench_1[:3]), *map(float, wrench_2[:3]))
        if plausible(wrench_1, wrench_2, self.config.force_limit):
            self._laws.sense(self._playback.row, forces)
        elif measurement.code is ErrorCode.OK:
            self._fail_measurement(measurement, *fault_of(wrench_1, wrench_2, self.config.force_limit))
        row = self._playback.row = measurement.step(time, self._targets, forces)
        stand = measurement.stand
        self._tools, self._lift_normal, self._clear = stand.tools, stand.lift_normal, stand.clear
        if measurement.keeps_offsets:
            self._targets = self._laws.step(Mode.FREEZE, row, row, None)
        else:
            self._targets = self._laws.step(Mode.LIFT, row, row, (0.0,) * 6)
        if measurement.ended:
            self._end_measurement(measurement)
        return self._targets

    def _fail_measurement(self, measurement: Measurement, code: ErrorCode, text: str) -> None:
        """Come to rest where the tools are, and hold."""
        if self.fault is None:
            self.fault = (code, text)
        self._mode_before = Mode.HOLD
        measurement.give_up(code, text, stay=True)

    def _end_measurement(self, measurement: Measurement) -> None:
        if not measurement.keeps_offsets:
            self._engaged = False
            if self._clear and self._mode_before is not Mode.HOLD:
                self._mode_before = Mode.ARMED
        self._measurement, self._mode = None, self._mode_before
        self.fault, self._fault_before = self.fault or self._fault_before, None
        if self._lift_after_stop:
            self._lift_after_stop = False
            self._lift()

    # -- stopping ------------------------------------------------------------------------------

    def _stop(self, code: ErrorCode, text: str) -> None:
        if self.fault is None:
            self.fault = (code, text)
        if self._stopping is None and self._mode is not Mode.HOLD:
            self._stopping = self.fault
            self._mode = Mode.HOLD

    def _hold(self) -> None:
        """At rest after a stop: drop the rest of the path and hand out what was done."""
        self._playback.clear()
        self._stopping = None
        self._mode = Mode.HOLD
        if self._log is not None and self.fault is not None:
            code, text = self.fault
            self._result = self._log.result(False, int(code), text, backoffs=self._laws.backoffs)
            self._log = None
        if self._lift_after_stop:
            self._lift_after_stop = False
            self._lift()

    def _lift(self) -> None:
        if self._clear:
            self._mode = Mode.IDLE
            return
        self._brake()
        here = posture_of(self._playback.last_row)
        self._play(lift_segments(self.config, here, self._lift_normal, self._tools))

    # -- spirals -------------------------------------------------------------------------------

    def _runs_on(self, contour: Contour) -> bool:
        """Is the contour left in motion, to be continued by the next one?"""
        return self.config.runs_on and not (contour.closed or contour.lift_after)

    def _present(self) -> Present:
        return Present(
            posture_of(self._playback.row),
            self._tools,
            self._engaged,
            self._clear,
            self._lift_normal,
            self._playback.velocity(self.config.rate) if self._playback.moving else None,
            self._before,
        )

    def _brake(self) -> None:
        """Come to rest straight on, when the contour before was left in motion."""
        if self._playback.moving:
            segment = braking(self.config, self._present(), Mode.HOLD if self._stopping else Mode.FREEZE)
            self._playback.load([segment])


@dataclass
class ArmedPlan:
    """Contours ``next`` .. ``count`` - 1 of plan ``plan_id`` are accepted, in order; empty plan_id: nothing armed."""

    plan_id: str = ""
    next: int = 0
    count: int = 0

    @property
    def done(self) -> bool:
        """True when the last contour was accepted."""
        return self.next >= self.count

    def take(self, contour: Contour) -> None:
        """``contour`` is formed: the one after it is the next."""
        self.next = contour.index + 1

    def check(self, contour: Contour, *, busy: bool) -> None:
        """Raise IsfError CONTOUR_REJECTED unless ``contour`` is the one expected now."""
        where = contour_name(contour)
        if contour.plan_id != self.plan_id:
            raise IsfError(
                ErrorCode.CONTOUR_REJECTED,
                f"plan '{self.plan_id}' is armed",
                where=where,
                advice="arm the plan of this contour first",
            )
        if busy:
            raise IsfError(
                ErrorCode.CONTOUR_REJECTED,
                "too early, the tools are still moving",
                where=where,
                advice="send a contour when the result of the one before, or of the measurement, has come",
            )
        if contour.index != self.next:
            raise IsfError(
                ErrorCode.CONTOUR_REJECTED, f"out of order, {contour_label(self.next)} is expected", where=where
            )
        if contour.count != self.count:
            raise IsfError(
                ErrorCode.CONTOUR_REJECTED,
                f"is one of {contour.count}, {self.count} were armed",
                where=where,
                advice="arm with the number of contours of the plan",
            )


def armed_plan(
    plan_id: str, first_index: int, count: int, tips: NDArray[np.float64], support_force: float | None
) -> ArmedPlan:
    """A plan to be armed with the tools at ``tips`` (2, 3) m and the set-point ``support_force`` N (None: the plan's).

    Raises IsfError NOT_ARMED.
    """
    if not plan_id or not 0 <= first_index < count:
        raise IsfError(ErrorCode.NOT_ARMED, f"no contours to form: plan '{plan_id}', {first_index} of {count}")
    if tips.shape != (2, 3) or not np.isfinite(tips).all():
        raise IsfError(ErrorCode.NOT_ARMED, "the positions of the tools are not known")
    if support_force is not None and not support_force >= 0.0:
        raise IsfError(ErrorCode.NOT_ARMED, f"support force of {support_force} N is not possible")
    return ArmedPlan(plan_id, first_index, count)


def contour_name(contour: Contour) -> str:
    """What a contour is called in messages."""
    return f"{contour_label(contour.index)} of {contour.plan_id or '(no plan)'}"


def tips_of(tip_1: Sequence[float], tip_2: Sequence[float]) -> NDArray[np.float64]:
    """(2, 3) m from both tips."""
    return np.array([tip_1, tip_2], dtype=float)


class Engagement:
    """Waits at the begin of a contour until the force has settled; one call per tick."""

    def __init__(self, config: ControlConfig) -> None:
        self._config = config
        self._waited = self._settled = 0

    def retune(self, config: ControlConfig) -> None:
        """Other times and errors."""
        self._config = config

    def restart(self) -> None:
        """A new segment begins."""
        self._waited = self._settled = 0

    def over(self, wanted: float, set_point: float, force: float) -> bool:
        """True when the contour may start: ``wanted`` set-point, the present one and the filtered ``force``, N."""
        self._waited += 1
        config = self._config
        near = set_point == wanted and abs(wanted - force) <= config.settled_error
        self._settled = self._settled + 1 if near else 0
        ramp_ticks = abs(wanted) / config.set_point_rate * config.rate
        return (
            self._settled >= config.settled_time * config.rate
            or self._waited >= ramp_ticks + config.engage_timeout * config.rate
        )


def pace(config: ControlConfig, error: float) -> float:
    """Share of the planned feed, feed_floor..1, at the filtered force ``error`` (N)."""
    if config.feed_error == math.inf:
        return 1.0
    excess = (abs(error) - config.feed_error) / config.feed_error
    return max(config.feed_floor, min(1.0, 1.0 - excess))


_FORCE_LOOP = int(Flag.SATURATED_ERROR | Flag.SATURATED_RATE | Flag.SATURATED_OFFSET)
_WIDTH = 22
"""Numbers per tick."""

_LOOP_MODES = (int(Mode.ENGAGE), int(Mode.CONTROL))


class ContourLog:
    """Ticks since a contour was started.

    A row belongs to the time of a wrench: the wrench, and the targets that were valid at that time.
    """

    def __init__(self, contour: Contour, forced: bool, backoffs: int = 0) -> None:
        self.contour = contour
        self._backoffs_before = backoffs
        self.forced = forced
        self.lost_messages = 0
        # Flat numbers, not tuples: making a table of ten thousand tuples would hold up a tick for 20 ms.
        self._numbers = array("d")
        self._measured: tuple[list[tuple[float, ...]], list[tuple[float, ...]]] = ([], [])

    def __len__(self) -> int:
        return len(self._numbers) // _WIDTH

    def add(
        self,
        state: tuple[float, int, int, float, float, float, float],
        compliance: tuple[float, float, float],
        forces: tuple[float, ...],
        tips: tuple[float, ...],
    ) -> None:
        """Keep one tick.

        ``state``: time, mode, flags, set-point, normal force, contour coordinate, force offset. ``forces`` and ``tips``
        are (6,): tool 1, then tool 2.
        """
        self._numbers.extend((*state, *compliance, *forces, *tips))

    def add_measured(self, tool: int, time: float, tip: Sequence[float]) -> None:
        """Keep a tip (3,) m reported by the machine."""
        self._measured[tool - 1].append((time, *tip))

    def result(self, completed: bool, code: int = 0, message: str = "", *, backoffs: int = 0) -> ContourResult:
        """Everything that happened; values at points that were not reached are NaN.

        ``backoffs``: oscillations found since arming.
        """
        table = self._table()
        time, mode, flags, set_point, normal_force = table[:, :5].T
        at_points = _point_times(table[:, 5], time, len(self.contour), completed=completed)
        values = _interpolated(at_points, time, table[:, 6:22])
        contour = self.contour
        forming, support = (slice(4, 7), slice(7, 10)) if contour.forming_tool == 1 else (slice(7, 10), slice(4, 7))
        forming_tip, support_tip = (slice(10, 13), slice(13, 16))
        if contour.forming_tool == 2:
            forming_tip, support_tip = support_tip, forming_tip
        engaged = mode == Mode.CONTROL
        contact = (flags.astype(int) & Flag.CONTACT_LOST) == 0
        looped = np.isin(mode, _LOOP_MODES)
        none3 = np.empty((0, 3))
        return ContourResult(
            plan_id=contour.plan_id,
            index=contour.index,
            start=float(time[0]) if len(time) else 0.0,
            end=float(time[-1]) if len(time) else 0.0,
            completed=completed,
            forming_force=values[:, forming],
            support_force=values[:, support] if contour.has_support else none3,
            forming_target=values[:, forming_tip],
            support_target=values[:, support_tip] if contour.has_support else none3,
            force_offset=values[:, 0] if self.forced else np.empty(0),
            compliance_offset=np.ascontiguousarray(values[:, 1:4]),
            tick_time=time,
            tick_set_point=np.nan_to_num(set_point) if self.forced else np.empty(0),
            tick_normal_force=normal_force,
            tick_engaged=engaged,
            forming_measured=self._measured_at(contour.forming_tool - 1, at_points),
            support_measured=self._measured_at(2 - contour.forming_tool, at_points) if contour.has_support else none3,
            contact_fraction=float(contact[engaged].mean()) if engaged.any() else 0.0,
            saturations=int(np.count_nonzero(looped & ((flags.astype(int) & _FORCE_LOOP) != 0))),
            backoffs=backoffs - self._backoffs_before,
            lost_messages=self.lost_messages,
            code=code,
            message=message,
        )

    def profile(self) -> tuple[Array, Array]:
        """(K, 2) m of the forming tip in the plane and (K,) m offset of the force loop, along the contour."""
        table = self._table()
        table = table[table[:, 1] == Mode.CONTROL]
        if not len(table):
            return np.empty((0, 2)), np.empty(0)
        tip = 16 if self.contour.forming_tool == 1 else 19
        return table[:, tip : tip + 2] - table[:, 7:9], table[:, 6]

    def _table(self) -> Array:
        """(T, 22), one row per tick."""
        return np.array(self._numbers, dtype=float).reshape(-1, _WIDTH)

    def _measured_at(self, tool: int, at_points: Array) -> Array:
        if not self._measured[tool]:
            return np.empty((0, 3))
        rows = np.array(self._measured[tool])
        return _interpolated(at_points, rows[:, 0], rows[:, 1:])


def _point_times(coordinate: Array, time: Array, count: int, *, completed: bool) -> Array:
    """(N,) s, when each contour point was passed; NaN where it was not reached.

    A path that runs on is at its last point in the tick after the last one of the log.
    """
    on_path = np.isfinite(coordinate)
    if not on_path.any():
        return np.full(count, np.nan)
    passed = np.maximum.accumulate(coordinate[on_path])
    points = np.arange(count, dtype=float)
    times = np.interp(points, passed, time[on_path])
    return times if completed else np.where(points <= passed[-1] + 1e-6, times, np.nan)


def _interpolated(at: Array, time: Array, columns: Array) -> Array:
    """(N, C), columns interpolated at ``at``; NaN where ``at`` is NaN."""
    if not len(time):
        return np.full((len(at), columns.shape[1]), np.nan)
    known = np.isfinite(at)
    values = np.full((len(at), columns.shape[1]), np.nan)
    values[known] = np.column_stack([np.interp(at[known], time, c) for c in columns.T])
    return values


def expected_offset(places: Array, previous_places: Array, previous_offset: Array, width: int) -> Array:
    """(T,) m, change of the offset expected on the way along ``places`` (T, 2) m; 0 at the first.

    ``previous_places`` (K, 2) m and ``previous_offset`` (K,) m are the profile of the contour before, ``width`` the
    ticks of each of the two averages that smooth it.
    """
    nearest = np.asarray(cKDTree(previous_places).query(places)[1])
    smooth = _averaged(_averaged(previous_offset[nearest], width), width)
    return np.asarray(smooth - smooth[0])


def feed_forward(rows: list[Row], forming_tool: int, places: Array, offset: Array, width: int) -> None:
    """Fill the column LEARNED of a contour's ``rows`` from the profile of the contour before; see above."""
    if not len(offset):
        return
    tip = Column.TIP_1 if forming_tool == 1 else Column.TIP_2
    at = np.array([row[tip : tip + 2] for row in rows])
    for row, value in zip(rows, expected_offset(at, places, offset, width).tolist(), strict=True):
        row[Column.LEARNED] = value


def _averaged(profile: Array, width: int) -> Array:
    half = max(width // 2, 1)
    padded = np.concatenate([np.full(half, profile[0]), profile, np.full(half, profile[-1])])
    return np.asarray(np.convolve(padded, np.ones(2 * half + 1) / (2 * half + 1), mode="valid"))
