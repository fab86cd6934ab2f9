"""The force controller: streams targets for both tools, one pair per tick of the load cells.

It moves the tools to a contour, forms it under force or position control, links contour to contour and lifts the
tools after the last one. Per tick it does plain scalar arithmetic; everything else is computed when a contour
starts. Offsets and their rates never jump: every change of mode goes through the same limiters.

Frame ``sheet``, SI. Tool 1 (upper) forms, tool 2 supports. Wrenches are those of the sheet on the tool.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from isf_core.contour import Contour, ContourResult
from isf_core.errors import ErrorCode, IsfError

from isf_force_ctrl.compliance import ComplianceCompensation
from isf_force_ctrl.contact_force import ContactForceLoop
from isf_force_ctrl.contour_log import ContourLog
from isf_force_ctrl.contour_path import contour_path
from isf_force_ctrl.control_config import ControlConfig
from isf_force_ctrl.control_state import ControlState, Flag, Mode, Targets
from isf_force_ctrl.learned_offset import expected_offset
from isf_force_ctrl.load_cell_filter import Fir
from isf_force_ctrl.playback import Playback
from isf_force_ctrl.segments import Row, Segment, contour_segments, lift_segments, posture_of
from isf_force_ctrl.wrench_check import fault_of, plausible

NAN = float("nan")
_TRACKING = (Mode.ENGAGE, Mode.CONTROL)


class ForceController:
    """Contact-force and compliance control of one job; see the module."""

    def __init__(self, config: ControlConfig) -> None:
        config.check()
        self.config = config
        self.fault: tuple[ErrorCode, str] | None = None
        """Why the controller is in HOLD; None when it is not."""
        self._mode = Mode.IDLE
        self._playback = Playback([0.0] * 12, config.acceleration, config.rate)
        self._log: ContourLog | None = None
        self._result: ContourResult | None = None
        self._plan_id = ""
        self._ticks = 0

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
        tips = np.array([tip_1, tip_2], dtype=float)
        if self.busy:
            raise IsfError(ErrorCode.NOT_ARMED, "the tools are moving", advice="stop or disarm first")
        if not plan_id or not 0 <= first_index < count:
            raise IsfError(ErrorCode.NOT_ARMED, f"no contours to form: plan '{plan_id}', {first_index} of {count}")
        if tips.shape != (2, 3) or not np.isfinite(tips).all():
            raise IsfError(ErrorCode.NOT_ARMED, "the positions of the tools are not known")
        if contour_support_force_override is not None and not contour_support_force_override >= 0.0:
            raise IsfError(ErrorCode.NOT_ARMED, f"support force of {contour_support_force_override} N is not possible")
        config = self.config
        self._loop = ContactForceLoop(config.contact_force())
        self._compliance = ComplianceCompensation(config.compliance())
        self._normal_filter = Fir(config.coefficients())
        self._plan_id, self._next, self._count = plan_id, first_index, count
        override = contour_support_force_override
        self._support_force = config.support_force if override is None else override
        row = [*tips[0].tolist(), *tips[1].tolist(), 1.0, 0.0, NAN, NAN, 0.0, 0.0]
        self._playback = Playback(row, config.acceleration, config.rate)
        self._log = self._result = self.fault = None
        self._index = first_index
        self._previous: tuple[np.ndarray, np.ndarray] | None = None
        self._lift_normal = np.array([0.0, 0.0, 1.0])
        self._clear, self._support_used, self._engaged = True, False, False
        self._stopping: tuple[ErrorCode, str] | None = None
        self._lift_after_stop = self._idle_after = False
        self._set_point = self._error = NAN
        self._normal_force = self._filtered = 0.0
        self._settled = self._waited = 0
        self._flags = 0
        self._ticks, self._last_tick = 0, -1
        self._targets = Targets((tips[0, 0], tips[0, 1], tips[0, 2]), (tips[1, 0], tips[1, 1], tips[1, 2]))
        self._mode = Mode.ARMED

    def start(self, contour: Contour) -> None:
        """Form ``contour`` (already corrected); targets follow from the next ticks on.

        Raises IsfError NOT_ARMED, CONTOUR_REJECTED.
        """
        where = f"contour {contour.index} of {contour.plan_id or '(no plan)'}"
        if self._mode is Mode.HOLD and self.fault is not None:
            raise IsfError(ErrorCode.NOT_ARMED, f"held: {self.fault[1]}", where=where, advice="arm again")
        if self._mode not in (Mode.ARMED, Mode.FREEZE):
            raise IsfError(ErrorCode.NOT_ARMED, "no plan is armed", where=where, advice="arm the plan first")
        if contour.plan_id != self._plan_id:
            raise IsfError(ErrorCode.CONTOUR_REJECTED, f"plan '{self._plan_id}' is armed", where=where)
        if self.busy or contour.index != self._next:
            raise IsfError(ErrorCode.CONTOUR_REJECTED, f"out of order, contour {self._next} is expected", where=where)
        path = contour_path(contour, self.config, np.array(self._playback.row[3:6]), self._support_force)
        forced = bool(np.isfinite(path.set_point[0]))
        segments = contour_segments(
            self.config,
            path,
            contour.feed,
            posture_of(self._playback.row),
            engaged=self._engaged,
            clear=self._clear,
            normal=self._lift_normal,
        )
        if forced and self.config.learning > 0.0 and self._previous is not None:
            self._feed_forward(segments[-1].rows)
        self._lift_normal = contour.normal[0] if contour.closed else contour.normal[-1]
        self._support_used |= contour.has_support
        if contour.index == self._count - 1:
            end = posture_of(segments[-1].rows[-1])
            segments += lift_segments(self.config, end, self._lift_normal, with_support=self._support_used)
        self._log = ContourLog(contour, forced)
        self._index, self._next = contour.index, contour.index + 1
        self._clear = False
        self._play(segments)

    def stop(self, reason: str) -> None:
        """Decelerate smoothly and hold; the contour's result carries STOPPED."""
        if self._mode is not Mode.IDLE:
            self._stop(ErrorCode.STOPPED, f"stopped: {reason}")
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
        return self._plan_id

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
        forced = self._mode in _TRACKING
        row, offset = self._playback.row, self._loop.offset if self._mode is not Mode.IDLE else 0.0
        compliance = (self._compliance.x, self._compliance.y, 0.0) if self._mode is not Mode.IDLE else (0.0, 0.0, 0.0)
        idle = self._mode is Mode.IDLE
        return ControlState(
            plan_id="" if idle else self._plan_id,
            index=0 if idle else self._index,
            tick=0 if idle else self._ticks,
            mode=self._mode,
            set_point=self._set_point if forced else NAN,
            normal_force=0.0 if idle else self._normal_force,
            normal_force_filtered=0.0 if idle else self._filtered,
            error=self._error if forced else NAN,
            forming_offset=compliance,
            support_offset=(-offset * row[6], -offset * row[7], 0.0),
            contact_stiffness=self.config.contact_stiffness,
            feed=0.0 if idle else self._playback.feed,
            flags=0 if idle else self._flags,
        )

    # -- one tick ------------------------------------------------------------------------------

    def tick(self, tick: int, time: float, wrench_1: Sequence[float], wrench_2: Sequence[float]) -> Targets:
        """Targets for the next tick from the wrenches (6,) of this one.

        ``tick`` counts the machine's ticks (gaps count as lost messages), ``time`` s is the time of the wrenches.
        A wrench that is not finite or beyond the rig's limits ends in HOLD and :attr:`fault`, not in an exception.
        """
        if self._mode is Mode.IDLE:
            raise IsfError(ErrorCode.NOT_ARMED, "tick without a plan", advice="arm the plan first")
        if self._log is not None and self._last_tick >= 0 and tick > self._last_tick + 1:
            self._log.lost_messages += tick - self._last_tick - 1
        self._last_tick = tick
        self._ticks += 1
        f1x, f1y, f1z = float(wrench_1[0]), float(wrench_1[1]), float(wrench_1[2])
        f2x, f2y, f2z = float(wrench_2[0]), float(wrench_2[1]), float(wrench_2[2])
        if self.fault is None and not plausible(wrench_1, wrench_2, self.config.force_limit):
            self._stop(*fault_of(wrench_1, wrench_2, self.config.force_limit))
        blind = self.fault is not None
        row = self._playback.row
        if not blind:
            self._normal_force = row[6] * f2x + row[7] * f2y
            self._filtered = self._normal_filter.step(self._normal_force)
        if self._log is not None:
            targets, compliance = self._targets, self._compliance
            self._log.add(
                time,
                self._mode,
                self._flags,
                self._set_point,
                self._normal_force,
                row[9],
                self._loop.offset,
                (compliance.x, compliance.y),
                (f1x, f1y, f1z, f2x, f2y, f2z),
                (*targets.tip_1, *targets.tip_2),
            )
        self._advance()
        self._control(row)
        row = self._playback.row
        if blind:
            self._compliance.freeze()
        else:
            self._compliance.step(f1x, f1y)
        offset = self._loop.offset
        self._flags |= self._loop.flags | self._compliance.flags
        self._targets = Targets(
            (row[0] + self._compliance.x, row[1] + self._compliance.y, row[2]),
            (row[3] - offset * row[6], row[4] - offset * row[7], row[5]),
        )
        return self._targets

    def _control(self, last_row: Row) -> None:
        """Force loop of one tick, by mode."""
        mode, row, loop = self._mode, self._playback.row, self._loop
        self._flags = 0
        if mode in _TRACKING:
            ramp = self.config.set_point_rate / self.config.rate
            self._set_point += min(max(row[8] - self._set_point, -ramp), ramp)
            self._error = self._set_point - self._normal_force
            loop.control(self._error, self.config.learning * (row[11] - last_row[11]))
            if mode is Mode.CONTROL and self._normal_force < self.config.contact_threshold:
                self._flags = int(Flag.CONTACT_LOST)
        elif mode in (Mode.LIFT, Mode.APPROACH, Mode.POSITION):
            loop.ramp_back()
        else:
            loop.freeze()

    def _advance(self) -> None:
        """Move on by one tick along the present segment, or to the next one."""
        playback, stopping = self._playback, self._stopping is not None
        if not playback:
            if stopping:
                self._hold()
            return
        if playback.segment.waits:
            if stopping:
                self._hold()
            elif self._engagement_over(playback.segment.rows[0][8]):
                self._leave()
            return
        ended = playback.advance(self._wanted_pace())
        if stopping and (ended or playback.pace <= 0.0):
            self._hold()
        elif ended:
            self._leave()

    def _wanted_pace(self) -> float:
        if self._stopping is not None:
            return 0.0
        config = self.config
        if self._mode is not Mode.CONTROL or config.feed_error == math.inf:
            return 1.0
        excess = (abs(self._set_point - self._filtered) - config.feed_error) / config.feed_error
        return max(config.feed_floor, min(1.0, 1.0 - excess))

    def _engagement_over(self, wanted: float) -> bool:
        self._waited += 1
        config = self.config
        ramped = self._set_point == wanted
        near = ramped and abs(wanted - self._filtered) <= config.settled_error
        self._settled = self._settled + 1 if near else 0
        ramp_ticks = abs(wanted) / config.set_point_rate * config.rate
        return (
            self._settled >= config.settled_time * config.rate
            or self._waited >= ramp_ticks + config.engage_timeout * config.rate
        )

    def _play(self, segments: list[Segment]) -> None:
        self._playback.load(segments)
        self._enter()

    def _enter(self) -> None:
        """Take up the mode of the present segment."""
        mode = self._playback.segment.mode
        if mode is Mode.ENGAGE and self._mode not in (Mode.ENGAGE, Mode.FREEZE):
            self._set_point = max(0.0, self._filtered)
        self._mode = mode
        self._waited = self._settled = 0

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
            if self._idle_after or self._next >= self._count:
                self._mode = Mode.IDLE
        if self._log is not None:
            self._result, self._log = self._log.result(True), None

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
            self._result = self._log.result(False, int(self.fault[0]), self.fault[1])
            self._log = None
        if self._lift_after_stop:
            self._lift_after_stop = False
            self._lift()

    def _lift(self) -> None:
        if self._clear:
            self._mode = Mode.IDLE
            return
        here = posture_of(self._playback.row)
        self._play(lift_segments(self.config, here, self._lift_normal, with_support=self._support_used))

    # -- helpers -------------------------------------------------------------------------------

    def _feed_forward(self, rows: list[Row]) -> None:
        """Fill the LEARNED column of a contour's rows from the contour before."""
        if self._previous is None or not len(self._previous[1]):
            return
        width = round(self.config.learning_width * self.config.rate)
        profile = expected_offset(np.array([row[0:2] for row in rows]), *self._previous, width)
        for row, value in zip(rows, profile.tolist(), strict=True):
            row[11] = value
