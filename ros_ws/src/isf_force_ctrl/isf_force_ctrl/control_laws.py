"""The laws that act every tick: force loop in all its components, compliance, gain by the estimated stiffness.

On-line estimate of the contact stiffness K_c: Ren 2018 eq. 2-8, gain K_i = loop_gain / K_c. An oscillation lowers the
gain, and calm lets it rise again. N, m, frame ``sheet``.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np
from isf_core.geometry.tool_axis import UPRIGHT
from isf_core.types import Array

from isf_force_ctrl.control_config import ControlConfig
from isf_force_ctrl.control_state import Flag, Mode, Targets
from isf_force_ctrl.laws.arm_compensation import ArmCompensation
from isf_force_ctrl.laws.force_and_compliance import ComplianceCompensation, ContactForceLoop, Fir
from isf_force_ctrl.motion.segments import Row, axis_of_row

NAN = float("nan")
TRACKING = (Mode.ENGAGE, Mode.CONTROL)
"""Modes in which the force loop follows a set-point."""

_TAKEN_BACK = (Mode.LIFT, Mode.APPROACH, Mode.POSITION)
_NEGLIGIBLE = 1e-10
"""m, offset that is dropped."""


class ControlLaws:
    """Offsets of both tools; see the module. Indices 0 and 1 stand for tool 1 and tool 2."""

    def __init__(self, config: ControlConfig) -> None:
        self._config = config
        self._loops = (ContactForceLoop(config.contact_force()), ContactForceLoop(config.contact_force()))
        self._compliances = (_compensation(config, 1), _compensation(config, 2))
        self._components: tuple[ForceComponents, ...] = ()
        if config.vertical or config.tangential:
            self._components = (ForceComponents(config, 1), ForceComponents(config, 2))
        self._filter = Fir(config.coefficients())
        self._monitor = OscillationMonitor(config.rate, config.oscillation_swing)
        self._estimate = StiffnessEstimate(
            config.contact_stiffness, config.rate, config.servo_bandwidth, Fir(config.coefficients())
        )
        self._ramp = config.set_point_rate / config.rate
        self._forming, self._support = 0, 1
        self._support_compensated = False
        self._used_loop, self._used_compliance = [False, False], [False, False]
        self.set_point = self.error = NAN
        self.normal_force = self.filtered = 0.0
        self.flags = 0

    def retune(self, config: ControlConfig) -> None:
        """Other gains, set-point, limits and filters at the same rate; every offset goes on from where it is."""
        self._config = config
        for loop in self._loops:
            loop.retune(config.contact_force())
            loop.set_gain(self._monitor.scale * config.loop_gain / self.contact_stiffness)
        for index, compliance in enumerate(self._compliances):
            if isinstance(compliance, ArmCompensation):
                compliance.retune(config.compliance(index + 1), *config.of_arm(index + 1))
            else:
                compliance.retune(config.compliance(index + 1))
        for components in self._components:
            components.retune(config)
        self._filter.retune(config.coefficients())
        self._estimate.retune(config.coefficients())
        self._ramp = config.set_point_rate / config.rate

    # -- roles ---------------------------------------------------------------------------------

    def assign(self, forming_tool: int, *, forced: bool) -> None:
        """Roles for the next contour: ``forming_tool`` (1, 2), support tool under force control or not."""
        self._forming, self._support = forming_tool - 1, 2 - forming_tool
        self._support_compensated = self._config.support_compensation > 0.0 and not forced
        self._used_compliance[self._forming] = True
        if self._support_compensated:
            self._used_compliance[self._support] = True
        if forced:
            self._used_loop[self._support] = True

    def wanted(self, mode: Mode, row: Row) -> float:
        """N, set-point of ``row``, or the one that was set in its place: while engaging no larger than that of the row,
        which spares the spot that is squeezed standing."""
        if self._config.set_point is None:
            return row[8]
        return min(row[8], self._config.set_point) if mode is Mode.ENGAGE else self._config.set_point

    def engage(self) -> None:
        """The set-point begins at the present force."""
        self.set_point = max(0.0, self.filtered)

    # -- what is going on ----------------------------------------------------------------------

    @property
    def offset(self) -> float:
        """m, force offset of the support tool along d_n, positive towards the forming tool."""
        return self._loops[self._support].offset

    def support_offset(self, row: Row) -> tuple[float, float, float]:
        """(3,) m, offset of the support tool by all its force loops."""
        offset = -self.offset if self._support else self.offset
        x, y, z = self._components[self._support].offset if self._components else (0.0, 0.0, 0.0)
        return offset * row[6] + x, offset * row[7] + y, z

    @property
    def forming_offset(self) -> tuple[float, float, float]:
        """(3,) m, compliance offset of the forming tool."""
        compliance = self._compliances[self._forming]
        return compliance.x, compliance.y, compliance.z

    @property
    def contact_stiffness(self) -> float:
        """N/m, value the gain is computed from."""
        return self._estimate.value if self._config.adapt_stiffness else self._config.contact_stiffness

    @property
    def backoffs(self) -> int:
        """Oscillations found since arming."""
        return self._monitor.found

    # -- every tick ----------------------------------------------------------------------------

    def sense(self, row: Row, forces: tuple[float, ...]) -> None:
        """Take in the ``forces`` (6,) N of the sheet on tool 1 and tool 2, at the time of the targets of ``row``."""
        if self._support:
            self.normal_force = row[6] * forces[3] + row[7] * forces[4]
        else:
            self.normal_force = -row[6] * forces[0] - row[7] * forces[1]
        self.filtered = self._filter.step(self.normal_force)

    def step(self, mode: Mode, row: Row, last_row: Row, forces: tuple[float, ...] | None) -> Targets:
        """Targets for ``row``; ``forces`` as in :meth:`sense`, None when they are not to be believed."""
        loop = self._loops[self._support]
        flags = 0
        if mode in TRACKING:
            before = self.set_point
            self.set_point += min(max(self.wanted(mode, row) - before, -self._ramp), self._ramp)
            self.error = self.set_point - self.normal_force
            self._tune(loop, moving=self.set_point != before)
            loop.control(self.error, self._config.learning * (row[11] - last_row[11]))
            if mode is Mode.CONTROL and self.normal_force < self._config.contact_threshold:
                flags = int(Flag.CONTACT_LOST)
            if self._monitor.scale < 1.0:
                flags |= int(Flag.OSCILLATION)
        elif mode in _TAKEN_BACK:
            loop.ramp_back()
        else:
            loop.freeze()
        self._compensate(row, forces)
        if self._components:
            flags |= self._control_components(mode, row, forces)
        self.flags = flags | loop.flags | self._compliances[self._forming].flags
        return self._targets(row)

    def _tune(self, loop: ContactForceLoop, *, moving: bool) -> None:
        """Gain of the loop from the estimated stiffness and the watch over oscillation."""
        config, before = self._config, self._monitor.scale
        scale = self._monitor.step(self.set_point - self.filtered)
        if config.adapt_stiffness:
            moving = moving and self.normal_force > config.contact_threshold
            stiffness = self._estimate.step(loop.offset, self.filtered, moving=moving)
            loop.set_gain(scale * config.loop_gain / stiffness)
        elif scale != before:
            loop.set_gain(scale * config.loop_gain / config.contact_stiffness)

    def _compensate(self, row: Row, forces: tuple[float, ...] | None) -> None:
        """Compliance compensation of both tools, and the force loop of the forming tool on its way to zero."""
        for index in (0, 1):
            if not self._used_compliance[index]:
                continue
            compliance = self._compliances[index]
            acts = index == self._forming or self._support_compensated
            if forces is None:
                compliance.freeze()
            elif isinstance(compliance, ArmCompensation):
                felt = forces[3 * index : 3 * index + 3] if acts else (0.0, 0.0, 0.0)
                self._compensate_arm(compliance, index, row, felt)
                self._used_compliance[index] = (
                    acts or max(map(abs, (compliance.x, compliance.y, compliance.z))) > _NEGLIGIBLE
                )
            elif acts:
                compliance.step(forces[3 * index], forces[3 * index + 1], row[6], row[7])
            else:
                compliance.step(0.0, 0.0, row[6], row[7])
                self._used_compliance[index] = max(abs(compliance.x), abs(compliance.y)) > _NEGLIGIBLE
        if self._used_loop[self._forming]:
            loop = self._loops[self._forming]
            loop.ramp_back()
            self._used_loop[self._forming] = abs(loop.offset) > _NEGLIGIBLE

    @staticmethod
    def _compensate_arm(compliance: ArmCompensation, index: int, row: Row, felt: tuple[float, ...]) -> None:
        """One tick of an arm with the force (3,) N that it feels."""
        x, y, z = axis_of_row(row) if index == 0 else UPRIGHT
        tilt = (math.atan2(-y, math.hypot(x, z)), math.atan2(x, z)) if x or y else (0.0, 0.0)
        force, tip = (felt[0], felt[1], felt[2]), (row[3 * index], row[3 * index + 1], row[3 * index + 2])
        compliance.step(force, (row[6], row[7]), tip, tilt)

    def _control_components(self, mode: Mode, row: Row, forces: tuple[float, ...] | None) -> int:
        """Vertical and tangential force of the support tool; the forming tool's offsets go to zero. Returns flags."""
        components, other = self._components[self._support], self._components[self._forming]
        if mode is Mode.CONTROL and forces is not None:
            x, y, z = forces[3 * self._support : 3 * self._support + 3]
            components.control(row, (x, y, z), self.set_point)
        elif mode in _TAKEN_BACK:
            components.ramp_back(row)
        else:
            components.freeze(row)
        if not other.at_rest:
            other.ramp_back(row)
        return components.flags

    def _targets(self, row: Row) -> Targets:
        one, two = self._compliances
        offset_1, offset_2 = self._loops[0].offset, self._loops[1].offset
        x_1, y_1, z_1, z_2 = row[0] + one.x, row[1] + one.y, row[2], row[5]
        x_2, y_2 = row[3] - offset_2 * row[6], row[4] - offset_2 * row[7]
        if offset_1:
            x_1, y_1 = x_1 + offset_1 * row[6], y_1 + offset_1 * row[7]
        if one.z:
            z_1 += one.z
        if self._used_compliance[1]:
            x_2, y_2, z_2 = x_2 + two.x, y_2 + two.y, z_2 + two.z
        if self._components:
            (a, b, c), (d, e, f) = self._components[0].offset, self._components[1].offset
            return Targets((x_1 + a, y_1 + b, z_1 + c), (x_2 + d, y_2 + e, z_2 + f), row[12], axis_of_row(row))
        return Targets((x_1, y_1, z_1), (x_2, y_2, z_2), row[12], axis_of_row(row))


def _compensation(config: ControlConfig, tool: int) -> ComplianceCompensation | ArmCompensation:
    """Of ``tool`` (1, 2), by what carries it."""
    settings, arm = config.compliance(tool), config.of_arm(tool)
    return ArmCompensation(settings, *arm) if arm[0] else ComplianceCompensation(settings)


MINIMUM_FORCE = 20.0
"""N, smaller set-points of the normal force count as this one in the gains."""
NEGLIGIBLE = 1e-10
"""m, offset that is dropped."""
MINIMUM_DISTANCE = 0.5e-3
"""m, smaller horizontal distances of the ball centres count as this one."""


class ForceComponents:
    """Offset of one tool, while it supports, for the vertical and the tangential force; one call per tick.

    ``tool``: 1 or 2. :attr:`offset` is (3,) m in frame ``sheet``.
    """

    def __init__(self, config: ControlConfig, tool: int) -> None:
        self._vertical = ContactForceLoop(config.component_force()) if config.vertical else None
        self._tangential = ContactForceLoop(config.component_force()) if config.tangential else None
        self._loops = [loop for loop in (self._vertical, self._tangential) if loop is not None]
        self._config = config
        self._sign = 1.0 if tool == 2 else -1.0
        self.offset = (0.0, 0.0, 0.0)
        """m, present offset."""

    def retune(self, config: ControlConfig) -> None:
        """As :meth:`ControlLaws.retune`; the gains follow set-point and path in every tick."""
        self._config = config
        for loop in self._loops:
            loop.retune(config.component_force())

    @property
    def flags(self) -> int:
        """Limits that were active in the last tick, a sum of Flag."""
        flags = 0
        for loop in self._loops:
            flags |= loop.flags
        return flags

    @property
    def at_rest(self) -> bool:
        """True when nothing is left of the offsets."""
        return all(abs(loop.offset) < NEGLIGIBLE for loop in self._loops)

    def control(self, row: Row, force: tuple[float, float, float], normal_force: float) -> None:
        """One tick towards both set-points with the ``force`` of the sheet on the tool, N.

        ``normal_force`` N: set-point of the horizontal normal loop.
        """
        config, sign = self._config, self._sign
        flat, sine, cosine = self._line(row)
        pressed = max(normal_force, MINIMUM_FORCE)
        if self._vertical is not None:
            wanted = normal_force * cosine / sine if config.vertical_force is None else config.vertical_force
            self._vertical.set_gain(config.component_gain * flat * sine / pressed)
            self._vertical.control(wanted + sign * force[2])
        if self._tangential is not None:
            self._tangential.set_gain(config.component_gain * flat / pressed)
            self._tangential.control(config.tangential_force + sign * (row[7] * force[0] - row[6] * force[1]))
        self._place(row, sine, cosine)

    def freeze(self, row: Row) -> None:
        """Bring the offsets to rest."""
        for loop in self._loops:
            loop.freeze()
        self._place(row, *self._line(row)[1:])

    def ramp_back(self, row: Row) -> None:
        """One tick of taking the offsets back to zero."""
        for loop in self._loops:
            loop.ramp_back()
        self._place(row, *self._line(row)[1:])

    def _line(self, row: Row) -> tuple[float, float, float]:
        """Horizontal distance of the commanded ball centres, m; sine and cosine of the line's angle from the z axis."""
        flat = max(math.hypot(row[3] - row[0], row[4] - row[1]), MINIMUM_DISTANCE)
        height = row[2] - row[5] + self._config.ball_reach
        apart = math.hypot(flat, height)
        return flat, flat / apart, height / apart

    def _place(self, row: Row, sine: float, cosine: float) -> None:
        sign = self._sign
        out_x, out_y = sign * row[6], sign * row[7]
        turned = 0.0 if self._vertical is None else self._vertical.offset
        along = 0.0 if self._tangential is None else self._tangential.offset
        inward = -cosine * turned
        self.offset = (inward * out_x - along * out_y, inward * out_y + along * out_x, -sign * sine * turned)


WINDOW = 0.04
"""s over which changes are taken."""

MEMORY = 0.5
"""s of excited ticks that are remembered."""

MINIMUM_EXCITATION = 20.0e-6
"""m, change of the offset over the window (root of the sum of squares) that the start value is worth."""

BOUNDS = (0.3, 3.0)
"""Bounds of the estimate, as factors on the rig's contact stiffness."""


class StiffnessEstimate:
    """Contact stiffness (N/m); one call per tick. ``nominal`` N/m, ``rate`` and ``bandwidth`` Hz."""

    def __init__(self, nominal: float, rate: float, bandwidth: float, fir: Fir) -> None:
        corner = 2 * np.pi * bandwidth
        from scipy.signal import cont2discrete  # late: 0.3 s that nodes need not pay at their start

        continuous = ([corner**3], [1.0, 2 * corner, 2 * corner**2, corner**3])
        numerator, denominator, _ = cont2discrete(continuous, 1.0 / rate, method="foh")
        self._b: list[float] = np.ravel(numerator).tolist()
        self._a: list[float] = np.ravel(denominator).tolist()[1:]
        self._inputs = deque([0.0] * len(self._b), maxlen=len(self._b))
        self._outputs = deque([0.0] * 3, maxlen=3)
        self._fir = fir
        ticks = max(2, round(WINDOW * rate))
        self._history: deque[tuple[float, float]] = deque(maxlen=ticks + 1)
        self._forget = 1.0 - 1.0 / (MEMORY * rate)
        self._nominal = nominal
        self._low, self._high = BOUNDS[0] * nominal, BOUNDS[1] * nominal
        self._den = MINIMUM_EXCITATION**2
        self._num = nominal * self._den
        self._still = ticks
        self._ticks = ticks
        self.value = nominal
        """N/m, present estimate."""

    def retune(self, coefficients: Array) -> None:
        """Another filter, that of the force."""
        self._fir.retune(coefficients)

    def step(self, offset: float, force: float, *, moving: bool) -> float:
        """Estimate after one tick with ``offset`` (m, towards the forming tool) and filtered normal ``force`` (N).

        ``moving``: the set-point is being changed, with contact.
        """
        self._inputs.appendleft(offset)
        position = sum(b * u for b, u in zip(self._b, self._inputs, strict=True))
        position -= sum(a * y for a, y in zip(self._a, self._outputs, strict=True))
        self._outputs.appendleft(position)
        self._history.append((self._fir.step(position), force))
        self._still = 0 if moving else self._still + 1
        if self._still >= self._ticks or len(self._history) <= self._ticks:
            return self.value
        moved = self._history[-1][0] - self._history[0][0]
        pressed = self._history[-1][1] - self._history[0][1]
        self._den = self._forget * self._den + moved * moved
        self._num = self._forget * self._num + moved * pressed
        if self._den > 0.25 * MINIMUM_EXCITATION**2:
            self.value = min(max(self._num / self._den, self._low), self._high)
        return self.value


BACKOFF = 0.6
"""Factor on the gain each time an oscillation is found."""

MINIMUM_SCALE = 0.15
"""Smallest factor on the gain."""

SWINGS = 6
"""Half periods in a row that make an oscillation."""

LONGEST_PERIOD = 0.2
"""s, longest period that counts: the loop's own are 0.05-0.1 s."""

QUIET_TIME = 2.0
"""s without oscillation before the gain rises again."""

CEILING = 0.8
"""Share of the factor that oscillated up to which the gain rises soon."""

CEILING_TIME = 60.0
"""s in which that ceiling rises by a factor of e: the contact may have changed."""

RECOVERY_TIME = 2.0
"""s in which the gain rises by a factor of e."""


class OscillationMonitor:
    """Factor on the gain of one force loop; one call per tick.

    ``swing`` N is the least size of a half period, peak to peak.
    """

    __slots__ = (
        "_age",
        "_ceiling",
        "_count",
        "_extreme",
        "_half",
        "_quiet",
        "_rate",
        "_rising",
        "_since",
        "_swing",
        "found",
        "scale",
    )

    def __init__(self, rate: float, swing: float) -> None:
        self._rate = rate
        self._swing = swing
        self._half = 0.5 * LONGEST_PERIOD * rate
        self._rising = True
        self._extreme = 0.0
        self._age = 0
        self._count = 0
        self._since = 0
        self._quiet = QUIET_TIME * rate
        self._ceiling = 1.0
        self.scale = 1.0
        """Factor on the gain, MINIMUM_SCALE..1."""
        self.found = 0
        """Oscillations so far."""

    def step(self, error: float) -> float:
        """Factor after one tick with the filtered force ``error`` (N)."""
        self._age += 1
        beyond = error > self._extreme if self._rising else error < self._extreme
        if beyond:
            self._extreme = error
        elif abs(error - self._extreme) > self._swing:
            self._turn(error)
        if self.scale < 1.0:
            self._since += 1
            if self._since > self._quiet:
                self._ceiling = min(1.0, self._ceiling * (1.0 + 1.0 / (CEILING_TIME * self._rate)))
                self.scale = min(self._ceiling, self.scale * (1.0 + 1.0 / (RECOVERY_TIME * self._rate)))
        return self.scale

    def _turn(self, error: float) -> None:
        """A half period is over."""
        self._count = self._count + 1 if self._age <= self._half else 1
        self._rising, self._extreme, self._age = not self._rising, error, 0
        if self._count < SWINGS:
            return
        self._count = 0
        self.found += 1
        self._ceiling = CEILING * self.scale
        self._since = 0
        self.scale = max(MINIMUM_SCALE, BACKOFF * self.scale)
