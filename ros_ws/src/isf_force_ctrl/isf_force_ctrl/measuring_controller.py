"""The force controller with measurements between contours: see :mod:`isf_force_ctrl.measurements.measurement`."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from isf_core.contour import Contour
from isf_core.errors import ErrorCode, IsfError

from isf_force_ctrl.control_config import ControlConfig
from isf_force_ctrl.control_state import Mode, Targets
from isf_force_ctrl.controller import ForceController
from isf_force_ctrl.identify.identification import make_probe
from isf_force_ctrl.identify.settings import IdentifySettings, ToolGeometry
from isf_force_ctrl.measurements.measurement import Measurement, Probe
from isf_force_ctrl.measurements.tool_lift import LiftSettings, ToolLift
from isf_force_ctrl.motion.segments import lift_segments, posture_of
from isf_force_ctrl.supervision.wrench_watch import fault_of, plausible


class MeasuringController(ForceController):
    """Forms contours, and measures where the tools rest on the sheet."""

    def __init__(self, config: ControlConfig) -> None:
        super().__init__(config)
        self._measurement: Measurement | None = None
        self._mode_before = Mode.IDLE
        self._formed: Contour | None = None

    # -- commands ------------------------------------------------------------------------------

    def lift_tool(self, settings: LiftSettings) -> ToolLift:
        """Measure springback where the tools are; targets follow from the next ticks on.

        Raises IsfError NOT_ARMED.
        """
        self._check_at_rest()
        lift = ToolLift(self.config, settings, self._playback.row, self._tools, self._lift_normal)
        self._begin(lift)
        return lift

    def identify(self, settings: IdentifySettings, geometry: ToolGeometry) -> Probe:
        """Identify a property of the machine, from the sheet or from park; the tools are parked afterwards.

        Raises IsfError NOT_ARMED, MEASUREMENT_REFUSED.
        """
        self._check_at_rest(on_sheet=False)
        normal = self._lift_normal if not self._clear else np.array([0.0, 0.0, 1.0])
        probe = make_probe(
            self.config, settings, geometry, self._formed, self._playback.row, self._tools, normal, clear=self._clear
        )
        self._begin(probe)
        return probe

    def move_aside(self) -> None:
        """Lift both tools clear of the sheet and move them aside; the next contour approaches again.

        Raises IsfError NOT_ARMED.
        """
        self._check_at_rest(on_sheet=False)
        if self.fault is not None:
            raise IsfError(ErrorCode.NOT_ARMED, f"held: {self.fault[1]}", advice="arm again")
        if not self._clear:
            here = posture_of(self._playback.row)
            self._play(lift_segments(self.config, here, self._lift_normal, self._tools, aside=True))

    def start(self, contour: Contour) -> None:
        """As the base class."""
        super().start(contour)
        self._formed = contour

    def add_measured(self, tool: int, time: float, tip: Sequence[float]) -> None:
        """As the base class; a measurement may want it as well."""
        super().add_measured(tool, time, tip)
        if isinstance(self._measurement, Probe):
            self._measurement.add_measured(tool, time, tip)

    def cancel(self) -> None:
        """End a measurement early: the tools return to where it began, or are lifted and parked."""
        if self._measurement is not None:
            self._measurement.give_up(ErrorCode.STOPPED, "the measurement was cancelled", stay=False)

    def stop(self, reason: str) -> None:
        """As the base class; a measurement stops where it is and the controller holds."""
        if self._measurement is None:
            super().stop(reason)
        else:
            self._fail(ErrorCode.STOPPED, f"stopped: {reason}")

    def fail(self, code: ErrorCode, text: str, *, ticking: bool = False) -> None:
        """As the base class; a measurement ends with ``code``."""
        if self._measurement is None:
            super().fail(code, text, ticking=ticking)
            return
        self._fail(code, text)
        if not ticking:
            self._end()

    def disarm(self) -> None:
        """As the base class; a measurement stops first."""
        if self._measurement is None:
            super().disarm()
            return
        self._idle_after = self._lift_after_stop = True
        self._fail(ErrorCode.STOPPED, "stopped: disarmed")

    # -- what is going on ----------------------------------------------------------------------

    @property
    def measuring(self) -> bool:
        """True from the begin of a measurement to its end."""
        return self._measurement is not None

    @property
    def busy(self) -> bool:
        """True while targets change."""
        return self._measurement is not None or super().busy

    # -- one tick ------------------------------------------------------------------------------

    def tick(self, tick: int, time: float, wrench_1: Sequence[float], wrench_2: Sequence[float]) -> Targets:
        """As the base class."""
        measurement = self._measurement
        if measurement is None:
            return super().tick(tick, time, wrench_1, wrench_2)
        self._last_tick = tick
        self._ticks += 1
        if measurement.code is ErrorCode.OK and not plausible(wrench_1, wrench_2, self.config.force_limit):
            self._fail(*fault_of(wrench_1, wrench_2, self.config.force_limit))
        forces = (*map(float, wrench_1[:3]), *map(float, wrench_2[:3]))
        if plausible(wrench_1, wrench_2, self.config.force_limit):
            self._laws.sense(self._playback.row, forces)
        if isinstance(measurement, Probe):
            self._targets = self._probe(measurement, forces, time)
        else:
            row = self._playback.row = measurement.step(forces)
            self._targets = self._laws.step(Mode.FREEZE, row, row, None)
        if measurement.ended:
            self._end()
        return self._targets

    # -- inside --------------------------------------------------------------------------------

    def _probe(self, probe: Probe, forces: tuple[float, ...], time: float) -> Targets:
        """One tick of an identification: offsets are taken back and stay zero, so commands are what was planned."""
        probe.targets = [*self._targets.tip_1, *self._targets.tip_2]
        probe.time = time
        row = self._playback.row = probe.step(forces)
        self._tools, self._lift_normal, self._clear = probe.tools, probe.lift_normal, probe.clear
        return self._laws.step(Mode.LIFT, row, row, (0.0,) * 6)

    def _check_at_rest(self, *, on_sheet: bool = True) -> None:
        stopped = self._mode is Mode.HOLD and self.fault is not None and self.fault[0] is ErrorCode.STOPPED
        if self.busy or self._playback.moving:
            raise IsfError(ErrorCode.NOT_ARMED, "the tools are moving", advice="wait for the contour, or stop it")
        if self._mode not in (Mode.ARMED, Mode.FREEZE) and not stopped:
            raise IsfError(ErrorCode.NOT_ARMED, f"not possible in {self._mode.name}", advice="arm a plan first")
        if on_sheet and self._clear:
            raise IsfError(ErrorCode.NOT_ARMED, "the tools are not on the sheet", advice="form a contour first")

    def _begin(self, measurement: Measurement) -> None:
        self._measurement, self._mode_before, self._mode = measurement, self._mode, Mode.FREEZE

    def _fail(self, code: ErrorCode, text: str) -> None:
        """Come to rest where the tools are, and hold."""
        assert self._measurement is not None
        if self.fault is None:
            self.fault = (code, text)
        self._mode_before = Mode.HOLD
        self._measurement.give_up(code, text, stay=True)

    def _end(self) -> None:
        if isinstance(self._measurement, Probe):
            self._engaged = False
            if self._clear and self._mode_before is not Mode.HOLD:
                self._mode_before = Mode.ARMED
        self._measurement, self._mode = None, self._mode_before
        if self._lift_after_stop:
            self._lift_after_stop = False
            self._lift()
