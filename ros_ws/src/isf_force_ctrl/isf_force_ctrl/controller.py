"""The force controller: streams targets for both tools, one pair per tick of the load cells.

It moves the tools to a contour, forms it under force or position control, links contour to contour and lifts the
tools after the last one. Per tick it does plain scalar arithmetic; everything else is computed when a contour
starts. Offsets and their rates never jump: every change of mode goes through the same limiters.

Frame ``sheet``, SI. The contour tells which tool forms. Wrenches are those of the sheet on the tool.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from isf_core.contour import Contour, ContourResult
from isf_core.errors import ErrorCode, IsfError

from isf_force_ctrl.armed_plan import ArmedPlan, armed_plan, contour_name, tips_of
from isf_force_ctrl.contour_log import ContourLog
from isf_force_ctrl.contour_path import contour_path
from isf_force_ctrl.control_config import ControlConfig
from isf_force_ctrl.control_laws import TRACKING, ControlLaws
from isf_force_ctrl.control_state import ControlState, Flag, Mode, Targets
from isf_force_ctrl.drift_watch import DriftWatch
from isf_force_ctrl.engagement import Engagement, pace
from isf_force_ctrl.learned_offset import feed_forward
from isf_force_ctrl.playback import Playback
from isf_force_ctrl.segments import (
    RESTING,
    Present,
    Segment,
    braking,
    continues,
    contour_segments,
    lift_segments,
    posture_of,
)
from isf_force_ctrl.tool_moves import Tools
from isf_force_ctrl.trajectory import ToolPath
from isf_force_ctrl.wrench_check import WrenchWatch

NAN = float("nan")


class ForceController:
    """Contact-force and compliance control of one job; see the module."""

    def __init__(self, config: ControlConfig) -> None:
        config.check()
        self.config = config
        self.fault: tuple[ErrorCode, str] | None = None
        """Why the controller is in HOLD; None when it is not."""
        self._mode = Mode.IDLE
        self._playback = Playback(RESTING, config.acceleration, config.rate)
        self._log: ContourLog | None = None
        self._result: ContourResult | None = None
        self._plan = ArmedPlan()
        self._ticks = 0
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
    ) -> None:
        """Accept the contours ``first_index`` .. ``count`` - 1 of ``plan_id``, in order.

        ``tip_1``, ``tip_2`` (3,) m are where the tools are now; the override (N) replaces the contours' set-points,
        None leaves them (or the configuration's). Clears a fault.

        Raises IsfError NOT_ARMED.
        """
        if self.busy:
            raise IsfError(ErrorCode.NOT_ARMED, "the tools are moving", advice="stop or disarm first")
        tips, override = tips_of(tip_1, tip_2), contour_support_force_override
        self._plan = armed_plan(plan_id, first_index, count, tips, override)
        config = self.config
        self._laws, self._watch = ControlLaws(config), WrenchWatch(config)
        self.drift = DriftWatch(config)
        self._engagement = Engagement(config)
        self._support_force = config.support_force if override is None else override
        row = [*tips[0].tolist(), *tips[1].tolist(), *RESTING[6:]]
        self._playback = Playback(row, config.acceleration, config.rate)
        self._log = self._result = self.fault = None
        self._index = first_index
        self._previous: tuple[np.ndarray, np.ndarray] | None = None
        self._lift_normal = np.array([0.0, 0.0, 1.0])
        self._clear, self._engaged, self._open_end = True, False, False
        self._before: ToolPath | None = None
        self._tools = Tools(forming=1, with_support=False)
        self._stopping: tuple[ErrorCode, str] | None = None
        self._lift_after_stop = self._idle_after = False
        self._ticks, self._last_tick = 0, -1
        self._targets = Targets((tips[0, 0], tips[0, 1], tips[0, 2]), (tips[1, 0], tips[1, 1], tips[1, 2]))
        self._mode = Mode.ARMED

    def start(self, contour: Contour) -> None:
        """Form ``contour`` (already corrected); targets follow from the next ticks on.

        Raises IsfError NOT_ARMED, CONTOUR_REJECTED.
        """
        where = contour_name(contour)
        if self._mode is Mode.HOLD and self.fault is not None:
            raise IsfError(ErrorCode.NOT_ARMED, f"held: {self.fault[1]}", where=where, advice="arm again")
        if self._mode not in (Mode.ARMED, Mode.FREEZE):
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
        self._log = ContourLog(contour, forced, self._laws.backoffs)
        self._last_tick = -1  # what passed between contours, as during a scan, was not lost
        self._laws.assign(path.forming, forced=forced)
        self._index = contour.index
        self._plan.take(contour)
        self._clear = False
        self._play(segments)

    def stop(self, reason: str) -> None:
        """Decelerate smoothly and hold; the contour's result carries STOPPED."""
        if self._mode is not Mode.IDLE:
            self._stop(ErrorCode.STOPPED, f"stopped: {reason}")
            self._brake()
            if not self._playback and self._stopping is not None:
                self._hold()

    def fail(self, code: ErrorCode, text: str, *, ticking: bool = False) -> None:
        """End the contour with ``code`` and hold: after braking when ticks go on, at once when none will come."""
        if self._mode is not Mode.IDLE:
            self._stop(code, text)
            if self._stopping is not None and not (ticking and self._playback):
                self._hold()

    def disarm(self) -> None:
        """Stop if moving, freeze the offset, lift and park the tools, then IDLE."""
        if self._mode is Mode.IDLE:
            return
        self._idle_after = True
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
        """True while targets change: from start of a contour to its end (of the last: until parked)."""
        return bool(self._playback) or (self._mode is not Mode.IDLE and self._stopping is not None)

    @property
    def targets(self) -> Targets:
        """Last targets."""
        return self._targets

    def add_measured(self, tool: int, time: float, tip: Sequence[float]) -> None:
        """Keep the tip (3,) m of ``tool`` (1, 2) that the machine reported for ``time`` (s), for the result."""
        if self._log is not None:
            self._log.add_measured(tool, time, tip)

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
            forming_offset=(*laws.forming_offset, 0.0),
            support_offset=laws.support_offset(self._playback.row),
            contact_stiffness=laws.contact_stiffness,
            feed=self._playback.feed,
            flags=laws.flags | (int(Flag.DRIFT) if self.drift.warning else 0),
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
        if self._log is not None and self._last_tick >= 0 and tick > self._last_tick + 1:
            self._log.lost_messages += tick - self._last_tick - 1
        self._last_tick = tick
        self._ticks += 1
        forces = (*map(float, wrench_1[:3]), *map(float, wrench_2[:3]))
        found = self._watch.look(wrench_1, wrench_2, self._tools.forming, self._mode, self._laws.normal_force)
        found = found or self.drift.look(self._playback.row, self._tools, self._mode, forces)
        if found and self.fault is None:
            self._stop(*found)
        blind = self.fault is not None
        laws, row = self._laws, self._playback.row
        if not blind:
            laws.sense(row, forces)
        if self._log is not None:
            targets = self._targets
            self._log.add(
                (time, self._mode, laws.flags, laws.set_point, laws.normal_force, row[9], laws.offset),
                laws.forming_offset,
                forces,
                (*targets.tip_1, *targets.tip_2),
            )
        mode = self._mode
        self._advance()
        if not self._playback.moving:
            mode = self._mode
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
            elif self._engagement.over(playback.segment.rows[0][8], self._laws.set_point, self._laws.filtered):
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

    def _wanted_pace(self) -> float:
        if self._stopping is not None:
            return 1.0 if self._playback.segment.mode is Mode.HOLD else 0.0
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
        return self.config.runs_on and not contour.closed

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
