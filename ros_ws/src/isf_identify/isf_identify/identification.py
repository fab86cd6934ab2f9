"""Identification of the machine with its own tools (action ``identify``): which measurement, and what it found.

Ren 2018: 2.2.1 (compliance), eq. 2-8 (contact stiffness), 2.3.3 (servo); signs as in docs/reference/architecture.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import date

import numpy as np
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile
from isf_core.files.rig import Rig
from isf_core.types import Array
from isf_force_ctrl.control_config import ControlConfig
from isf_force_ctrl.measurements.measurement import AtRest, Probe

from isf_identify.fits import (
    ComplianceFit,
    SignFit,
    StiffnessFit,
    fit_compliance,
    fit_signs,
    fit_stiffness,
    without_arm,
)
from isf_identify.rig_piece import arm_part, compliance_piece, rig_reference, servo_piece, signs_piece, stiffness_piece
from isf_identify.servo_probe import ServoFit, ServoProbe, fit_servo
from isf_identify.settings import IdentifySettings, Property, ToolGeometry, places_for
from isf_identify.squeeze_probe import SqueezeProbe


@dataclass(frozen=True)
class Finding:
    """What an identification found.

    Attributes
    ----------
    code, message : OK and "", or why there is no result; LOAD_CELL_SIGN comes with a result
    value, uncertainty : as in ``isf_msgs/action/Identify``, SI; NaN where the measurement does not tell
    piece : YAML of a rig file based on the present one; comments when there is nothing to put into a rig
    notes : what is to be said about the values, for people
    fit : everything the fit found, None without a result
    """

    code: ErrorCode
    message: str
    value: Array = field(default_factory=lambda: np.empty(0))
    uncertainty: Array = field(default_factory=lambda: np.empty(0))
    piece: str = ""
    notes: tuple[str, ...] = ()
    fit: ComplianceFit | StiffnessFit | ServoFit | SignFit | None = None


class Identification:
    """The measurement ``identify`` of node ``force_ctrl``, found by its entry point; made of a job and a goal.

    Raises IsfError MEASUREMENT_REFUSED, as :meth:`IdentifySettings.of`.
    """

    def __init__(
        self, job_file: JobFile, property: int, tool: int, repeats: int, places: Sequence[float], max_force: float
    ) -> None:
        self._settings = IdentifySettings.of(property, tool, repeats, places, max_force)
        self._job_file = job_file

    def probe(self, rest: AtRest) -> Probe:
        """What the controller plays."""
        return make_probe(rest, self._settings, ToolGeometry.from_job(self._job_file))

    def finding(self, probe: Probe, config: ControlConfig) -> Finding:
        """What the ended ``probe`` found."""
        return finding(probe, config, self._job_file.rig, rig_reference(self._job_file), date.today().isoformat())


def check_job(settings: IdentifySettings, geometry: ToolGeometry) -> None:
    """Raise IsfError MEASUREMENT_REFUSED when ``settings.property`` cannot be measured with a job of ``geometry``.

    A squeeze begins with the planned thickness of sheet between the tools. In ADSIF both stand at one depth, their gap
    is another one by as much as they give way, and the wall behind them goes on to sink.
    """
    servo = settings.property is Property.SERVO_RESPONSE
    if not geometry.both_tools and (not servo or settings.tool == 2):
        what = "the job has no tool_2" if servo else "is measured by squeezing the sheet between both tools"
        advice = "use a job with tool_2 (DSIF); with one tool only the servo of tool 1 can be identified"
    elif geometry.accumulative and not servo:
        what = "is measured at a wall that stays where it was formed, and in ADSIF both tools stay at one depth"
        advice = "use a job of process DSIF with the same rig and tools, or --rig; with this one the servo alone"
    else:
        return
    raise IsfError(ErrorCode.MEASUREMENT_REFUSED, f"{settings.property.name}: {what}", where="identify", advice=advice)


def make_probe(rest: AtRest, settings: IdentifySettings, geometry: ToolGeometry) -> Probe:
    """The measurement that identifies ``settings.property``; raises IsfError MEASUREMENT_REFUSED."""
    settings.check_force(rest.config)
    check_job(settings, geometry)
    if settings.property is Property.SERVO_RESPONSE:
        return ServoProbe(rest, settings, both_tools=geometry.both_tools)
    return SqueezeProbe(rest, settings, geometry, places_for(settings, rest.config, geometry, rest.formed))


def finding(probe: Probe, config: ControlConfig, rig: Rig, rig_name: str, date: str) -> Finding:
    """What the ended ``probe`` found; ``rig``, ``rig_name`` of the job, ``date`` as it is to stand in the file."""
    if probe.code is not ErrorCode.OK:
        return Finding(probe.code, probe.message)
    try:
        if isinstance(probe, ServoProbe):
            return _servo(probe, config, rig_name, date)
        assert isinstance(probe, SqueezeProbe)
        if probe.settings.property is Property.TOOL_COMPLIANCE:
            return _compliance(probe, rig, rig_name, date)
        if probe.settings.property is Property.CONTACT_STIFFNESS:
            return _stiffness(probe, rig_name, date)
        return _signs(probe, rig_name, date)
    except IsfError as error:
        return Finding(error.code, error.message)


def _compliance(probe: SqueezeProbe, rig: Rig, rig_name: str, date: str) -> Finding:
    fit = fit_compliance(probe.readings, probe.places, probe.geometry)
    if not np.isfinite(fit.total).any():
        raise IsfError(
            ErrorCode.MEASUREMENT_FAILED,
            "no compliance could be determined from the readings",
            where="identify",
            advice="check the signs of the load cells first (property LOAD_CELL_SIGNS)",
        )
    tool = probe.settings.tool
    arms = arm_part(rig, 1), arm_part(rig, 2)
    whole = rig.tool_1.compliance + arms[0], rig.tool_2.compliance + arms[1]
    ratio = whole[1] / np.maximum(whole[0], 1e-12)
    value, deviation, how = fit.of_tool(tool, ratio)
    value, deviation, how = without_arm(arms[tool - 1], value, deviation, how)
    notes = [f"{axis}: {text}" for axis, text in zip("xyz", how, strict=True)]
    notes.append(
        "sum of both tools and the contact: "
        + ", ".join(f"{axis} {_microns(fit.total[k], fit.total_deviation[k])}" for k, axis in enumerate("xyz"))
    )
    give, give_deviation = fit.contact(float(ratio[2]))
    notes.append(f"contact alone, if tool 2 is to tool 1 in z as in the rig file: {_microns(give, give_deviation)}")
    notes.append(
        f"residual {1e6 * fit.residual:.2f} um of {1e6 * fit.span:.0f} um; {fit.rejected} of {len(fit.force)} readings "
        "rejected as outliers"
    )
    present = (rig.tool_1 if tool == 1 else rig.tool_2).compliance
    piece = compliance_piece(rig_name, date, probe, value, deviation, how, present)
    return Finding(ErrorCode.OK, "", value, deviation, piece, tuple(notes), fit)


def _stiffness(probe: SqueezeProbe, rig_name: str, date: str) -> Finding:
    fit = fit_stiffness(probe.readings, probe.places)
    angles = np.rad2deg(fit.wall_angle)
    notes = (
        f"horizontal force over horizontal way of tool 2, {len(fit.slopes)} visits, walls of {angles.min():.0f} to "
        f"{angles.max():.0f} deg; eq. 2-8 is the limit of an upright wall",
    )
    piece = stiffness_piece(rig_name, date, probe, fit)
    return Finding(ErrorCode.OK, "", np.array([fit.value]), np.array([fit.deviation]), piece, notes, fit)


def _servo(probe: ServoProbe, config: ControlConfig, rig_name: str, date: str) -> Finding:
    fit = fit_servo(probe, config.rate, config.servo_bandwidth)
    notes = (
        "bandwidth in x, y, z: " + ", ".join(f"{value:.2f}" for value in fit.per_axis) + " Hz",
        f"delay beyond the loop's own lag: {1e3 * fit.delay:.2f} +- {1e3 * fit.delay_deviation:.2f} ms",
        f"residual {100 * fit.residual:.2f} % of the motion",
    )
    piece = servo_piece(rig_name, date, probe, fit)
    value, deviation = np.array([fit.bandwidth]), np.array([fit.bandwidth_deviation])
    return Finding(ErrorCode.OK, "", value, deviation, piece, notes, fit)


def _signs(probe: SqueezeProbe, rig_name: str, date: str) -> Finding:
    fit = fit_signs(probe.readings, probe.places, probe.geometry)
    faults = fit.faults()
    unseen = [
        f"F{'xyz'[axis]} of tool_{tool + 1}" for tool in (0, 1) for axis in range(3) if np.isnan(fit.sign[tool, axis])
    ]
    notes = [f"crosstalk of tool_{k + 1} (largest): {100 * fit.crosstalk[k]:.1f} %" for k in (0, 1)]
    if unseen:
        notes.append("not observable without a wall along the axis: " + ", ".join(unseen))
    piece = signs_piece(rig_name, date, probe, fit, faults)
    message = "; ".join(faults) + " (correct the cell's driver; do not form)" if faults else ""
    code = ErrorCode.LOAD_CELL_SIGN if faults else ErrorCode.OK
    return Finding(code, message, fit.sign.ravel(), fit.deviation.ravel(), piece, tuple(notes), fit)


def _microns(value: float, deviation: float) -> str:
    return f"{1e6 * value:.3f} +- {1e6 * deviation:.3f} um/N" if np.isfinite(value) else "unknown"
