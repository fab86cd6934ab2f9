"""The laws that act every tick: force loop of the support tool, compliance compensation, and who is watched.

Each tool has a force loop and a compliance compensation of its own. By its role one of them controls and the other is
taken back to zero, through the same limiters: tools change roles without a jump. The direction in a row points from
tool 1 to tool 2, so it does not turn with the roles; d_n of eq. 2-2 is the same, or its opposite when tool 1 supports.
"""

from __future__ import annotations

from isf_force_ctrl.compliance import ComplianceCompensation
from isf_force_ctrl.contact_force import ContactForceLoop
from isf_force_ctrl.control_config import ControlConfig
from isf_force_ctrl.control_state import Flag, Mode, Targets
from isf_force_ctrl.force_components import ForceComponents
from isf_force_ctrl.load_cell_filter import Fir
from isf_force_ctrl.oscillation import OscillationMonitor
from isf_force_ctrl.segments import Row
from isf_force_ctrl.stiffness_estimate import StiffnessEstimate

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
        self._compliances = (
            ComplianceCompensation(config.compliance(1)),
            ComplianceCompensation(config.compliance(2)),
        )
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
    def forming_offset(self) -> tuple[float, float]:
        """m, compliance offset of the forming tool in x and y."""
        compliance = self._compliances[self._forming]
        return compliance.x, compliance.y

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
            self.set_point += min(max(row[8] - before, -self._ramp), self._ramp)
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
            elif acts:
                compliance.step(forces[3 * index], forces[3 * index + 1], row[6], row[7])
            else:
                compliance.step(0.0, 0.0, row[6], row[7])
                self._used_compliance[index] = max(abs(compliance.x), abs(compliance.y)) > _NEGLIGIBLE
        if self._used_loop[self._forming]:
            loop = self._loops[self._forming]
            loop.ramp_back()
            self._used_loop[self._forming] = abs(loop.offset) > _NEGLIGIBLE

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
        x_1, y_1 = row[0] + one.x, row[1] + one.y
        x_2, y_2 = row[3] - offset_2 * row[6], row[4] - offset_2 * row[7]
        if offset_1:
            x_1, y_1 = x_1 + offset_1 * row[6], y_1 + offset_1 * row[7]
        if self._used_compliance[1]:
            x_2, y_2 = x_2 + two.x, y_2 + two.y
        if self._components:
            (a, b, c), (d, e, f) = self._components[0].offset, self._components[1].offset
            return Targets((x_1 + a, y_1 + b, row[2] + c), (x_2 + d, y_2 + e, row[5] + f), row[12])
        return Targets((x_1, y_1, row[2]), (x_2, y_2, row[5]), row[12])
