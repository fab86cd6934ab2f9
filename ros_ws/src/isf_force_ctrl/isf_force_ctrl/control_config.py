"""Everything the force controller needs to know about job and rig, as one frozen dataclass in SI units.

Defaults carry their source; those that the source states per update of its 440 Hz loop became rates per second.
"""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass, fields, replace
from functools import lru_cache
from typing import Any

from isf_core.contour import Process
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile
from isf_core.files.rig import Rig
from isf_core.geometry.serial_arm import TERMS, SerialArm, compliance_field
from numpy.typing import NDArray

from isf_force_ctrl.laws.force_and_compliance import ComplianceSettings, ContactForceSettings, group_delay, low_pass
from isf_force_ctrl.laws.stability import MARGIN, check_compliance_gain, check_force_gain, ultimate_loop_gain

Vector = tuple[float, float, float]

MAXIMUM_OF_BOTH = 0.8
"""Largest K_p K_c when both tools are compensated: their sum comes near to 1 / K_c, and what is over-estimated by a
quarter would run away (Ren 2018, section 2.3.3)."""

REFERENCE_FORCE = 100.0
"""N, normal force for which the time of taking a component's offset back is exact."""

SET_WHILE_FORMING = (
    "set_point",
    "loop_gain",
    "dead_zone",
    "filter_cutoff",
    "error_clamp",
    "set_point_rate",
    "feed_error",
    "feed_floor",
    "compliance_time",
    "contact_threshold",
    "drift_limit",
    "drift_stop",
)
"""Parameters that may be set in the middle of a part, as those of the node may."""


@dataclass(frozen=True)
class ControlConfig:
    """Parameters of one job on one rig.

    Attributes
    ----------
    rate : Hz, ticks per second
    park_height : m, tools wait at x = y = 0, z = +-park_height
    aside : (2,) m, x and y where they wait while the sheet is scanned
    travel, speed_limit, force_limit : limits of the rig (m per axis, m/s, N per axis)
    servo_bandwidth : Hz
    contact_stiffness : N/m, K_c
    forming_compliance, support_compliance : (2,) m/N, x and y of tool 1 and of tool 2
    forming_arm, support_arm : (90,) compliance m/N of the arms that carry tool 1 and tool 2, as polynomials
        (:func:`isf_core.geometry.serial_arm.compliance_field`); empty without an arm
    compensation : factor 0..1 on the compliance compensation of the forming tool
    support_compensation : the same of the support tool, on contours without force control
    support_force : N, replaces the set-points of force-controlled contours; None: as in the contours
    set_point : N, what force-controlled contours are ramped to instead, also in mid-contour; None: their own
    loop_gain : 1/s, K_i K_c (24 in Ren 2018, 2.3.3)
    filter_cutoff : Hz (40, 2.3.4)
    error_clamp : N (128 um at 2 um/N, Appendix B)
    error_slew : N/s (16 um per update at 440 Hz and 2 um/N)
    dead_zone : N (6 um at 2 um/N = 3 N in Appendix B, for 5 mm/s; 1 N here for higher feeds)
    offset_limit : m, of the force offset and of the compliance offset per axis
    compliance_slew : m/s (16 um per update at 440 Hz)
    compliance_time : s, time constant of the compliance compensation
    set_point_rate : N/s, ramp of the set-point while engaging
    engage_force : N, a contour is begun standing with at most this force, the rest is ramped on the way: a spot that
        was squeezed standing is thinner at once when the tools come round again
    settled_error : N, filtered error below which engaging is over
    settled_time : s, for so long
    engage_timeout : s, after the ramp; then the contour starts anyway
    contact_threshold : N, support force that counts as contact
    ramp_back_time : s, time constant of taking an offset back in free space
    learning : 0..1, share of the previous contour's offset profile that is fed forward; 0 = off
    learning_width : s, width of the averages over that profile
    feed_error : N, filtered force error from which the feed is reduced; infinite = constant feed
    feed_floor : smallest fraction of the feed
    acceleration : m/s^2, of either tool tip
    blend_time, jerk_time : s, widths of the two averages that round corners and limit the jerk
    rapid_speed : m/s in free space
    contact_speed : m/s, most, for the last ``clearance`` before contact
    clearance : m, distance kept from the sheet while traversing nearby
    link_length : m, longest move from contour to contour that stays in contact
    runs_on : turns of a spiral are joined in motion; only where the next contour comes without a delay (lockstep)
    adapt_stiffness : K_c is estimated on line while the set-point moves
    oscillation_swing : N, least swing of the force error that counts as oscillation; infinite = not watched
    seam_speed : m/s, feed at both ends of a closed contour under force control (published feed); infinite = off
    seam_length : m, so far from its begin; half as far from its end
    axial_compliance : (2,) m/N, z of tool 1 and of tool 2, for measurements
    frozen_time : s, loaded readings that repeat exactly for so long are a frozen signal
    vertical, tangential : these components of the force on the support tool are controlled as well
    vertical_force : N, positive in compression; None: that of a contact without friction
    tangential_force : N, along d_n turned by +90 deg about z
    component_gain : 1/s, of these two loops; 1 of 24 (chosen)
    component_limit : m, largest offset of each (published limit of an offset, Appendix B)
    process : of the contours; empty: any
    ball_reach : m, sum of the radii of both balls
    largest_tilt : rad, by which the machine can tilt tool 1; 0: it is always upright
    axis_rate : rad/s, largest rate of its axis
    tilt_lever : m, from its tip to the joints that turn the axis: there a turn is accelerated no more than a tip
    sign_force, sign_time : N and s, a force against its only possible sign beyond which a load cell's sign is wrong
    drift_limit : N, reading of a free tool from which a new tare is asked for; as in the file of a cell. The published
        bound of the force error (+-10 N): a zero that is off by as much uses it up alone
    drift_stop : N, the same from which the tools do not go on to the sheet. They engage with 30 N (``engage_force``)
        and a wrong sign is told from 30 N: with a zero off by more, neither can be told
    """

    rate: float
    park_height: float
    travel: Vector
    speed_limit: float
    force_limit: Vector
    servo_bandwidth: float
    contact_stiffness: float
    forming_compliance: tuple[float, float]
    compensation: float
    offset_limit: float
    support_force: float | None = None
    loop_gain: float = 24.0
    filter_cutoff: float = 40.0
    error_clamp: float = 64.0
    error_slew: float = 3520.0
    dead_zone: float = 1.0
    compliance_slew: float = 7.04e-3
    compliance_time: float = 0.2
    set_point_rate: float = 400.0
    engage_force: float = 30.0
    settled_error: float = 6.0
    settled_time: float = 0.05
    engage_timeout: float = 1.0
    contact_threshold: float = 5.0
    ramp_back_time: float = 0.1
    learning: float = 0.0
    learning_width: float = 0.06
    feed_error: float = 4.0
    feed_floor: float = 0.2
    acceleration: float = 0.5
    blend_time: float = 0.03
    jerk_time: float = 0.01
    rapid_speed: float = 0.06
    contact_speed: float = 0.02
    clearance: float = 8e-3
    link_length: float = 5e-3
    support_compliance: tuple[float, float] = (0.0, 0.0)
    support_compensation: float = 0.0
    runs_on: bool = True
    adapt_stiffness: bool = False
    oscillation_swing: float = 15.0
    seam_speed: float = 5e-3
    seam_length: float = 6e-3
    axial_compliance: tuple[float, float] = (0.0, 0.0)
    forming_arm: tuple[float, ...] = ()
    support_arm: tuple[float, ...] = ()
    frozen_time: float = 0.3
    sign_force: float = 30.0
    sign_time: float = 0.1
    drift_limit: float = 10.0
    drift_stop: float = 30.0
    vertical: bool = False
    tangential: bool = False
    vertical_force: float | None = None
    tangential_force: float = 0.0
    component_gain: float = 1.0
    component_limit: float = 1.024e-3
    ball_reach: float = 0.0
    aside: tuple[float, float] = (0.0, 0.0)
    set_point: float | None = None
    largest_tilt: float = 0.0
    axis_rate: float = math.radians(10.0)
    tilt_lever: float = 0.0
    process: str = ""

    @property
    def largest_set_point(self) -> float:
        """N, horizontal force that the rig bears."""
        return max(self.force_limit[:2])

    @staticmethod
    def from_job(job_file: JobFile, *, support_force: float | None = None) -> ControlConfig:
        """Parameters from a job and its rig, checked for stability.

        Raises IsfError UNSTABLE_GAIN, FILE_FIELD.
        """
        job, rig = job_file.job, job_file.rig
        config = ControlConfig(
            rate=job.control.rate,
            park_height=rig.park_height,
            aside=rig.aside,
            travel=rig.limits.travel,
            speed_limit=rig.limits.speed,
            force_limit=rig.limits.force,
            servo_bandwidth=rig.servo.bandwidth,
            contact_stiffness=rig.contact_stiffness,
            forming_compliance=(rig.tool_1.compliance[0], rig.tool_1.compliance[1]),
            compensation=_forming_compensation(job_file),
            offset_limit=rig.limits.offset,
            support_force=support_force,
            support_compliance=(rig.tool_2.compliance[0], rig.tool_2.compliance[1]),
            support_compensation=_support_compensation(job_file),
            axial_compliance=(
                rig.tool_1.compliance[2] + _largest(_arm_field(rig, 1), "z"),
                rig.tool_2.compliance[2] + _largest(_arm_field(rig, 2), "z"),
            ),
            forming_arm=_arm_field(rig, 1),
            support_arm=_arm_field(rig, 2),
            rapid_speed=min(ControlConfig.rapid_speed, 0.6 * rig.limits.speed),
            vertical="vertical" in job.control.components,
            tangential="tangential" in job.control.components,
            vertical_force=job.control.vertical_force,
            tangential_force=job.control.tangential_force,
            largest_tilt=rig.largest_tilt,
            tilt_lever=rig.tilt_lever,
            axis_rate=job.tool_axis.largest_rate,
            process=job.process if job.process in Process.__members__ else "",
            ball_reach=job.tool_1.ball_radius + (job.tool_2.ball_radius if job.tool_2 is not None else 0.0),
        )
        config.check()
        return config

    def to_json(self) -> str:
        """Every parameter by name; :meth:`from_json` gives the same numbers again."""
        return json.dumps(asdict(self))

    @staticmethod
    def from_json(text: str) -> ControlConfig:
        """Parameters from :meth:`to_json`; of another version: what it does not name has its default, others are left.

        Raises ValueError when they are none.
        """
        found = json.loads(text)
        if not isinstance(found, dict):
            raise ValueError("parameters of force control are not a mapping")
        names = {item.name for item in fields(ControlConfig)}
        values: dict[str, Any] = {
            name: tuple(v) if isinstance(v, list) else v for name, v in found.items() if name in names
        }
        try:
            return ControlConfig(**values)
        except TypeError as error:
            raise ValueError(f"parameters of force control: {error}") from error

    def check(self) -> None:
        """Raise IsfError UNSTABLE_GAIN when a loop would not be stable on this rig, FILE_FIELD for values that do not
        go together."""
        if self.set_point is not None and self.set_point < self.contact_threshold:
            raise IsfError(
                ErrorCode.FILE_FIELD,
                f"with {self.set_point:g} N nothing counts as contact (contact_threshold {self.contact_threshold:g} N)",
                where="parameter set_point",
                advice="a larger one; -1 leaves it to the contours",
            )
        if not self.drift_limit <= self.drift_stop:
            raise IsfError(
                ErrorCode.FILE_FIELD,
                f"drift_stop ({self.drift_stop:g} N) is below drift_limit ({self.drift_limit:g} N)",
                where="parameter drift_stop",
                advice="the warning comes before the refusal",
            )
        forming = max(self.forming_compliance) + _largest(self.forming_arm)
        support = max(self.support_compliance) + _largest(self.support_arm)
        gain = self.compensation * forming
        check_compliance_gain(gain, self.contact_stiffness)
        if self.support_compensation > 0.0:
            both = max(gain + self.support_compensation * support, self.compensation * support)
            check_compliance_gain(
                both, self.contact_stiffness, maximum=MAXIMUM_OF_BOTH, where="control.support_compensation"
            )
        coupling = gain * self.contact_stiffness
        loop = (self.servo_bandwidth, self._delay(), coupling, self.compliance_time)
        check_force_gain(self.loop_gain, *loop, faster=lambda: self._faster(coupling))

    def _delay(self) -> float:
        """s in the force loop: filter, transport and hold."""
        return group_delay(len(self.coefficients()), self.rate) + 1.5 / self.rate

    def _faster(self, coupling: float) -> str:
        """Advice: the lowest control rate at which the loop would be stable, in steps of 10 Hz."""
        for rate in range(10 * (int(self.rate / 10.0) + 1), 1001, 10):
            delay = replace(self, rate=float(rate))._delay()
            limit = ultimate_loop_gain(self.servo_bandwidth, delay, coupling, self.compliance_time)
            if self.loop_gain * MARGIN <= limit:
                return f"raise control.rate to {rate} Hz or more"
        return "no control.rate up to 1 kHz is enough"

    def coefficients(self) -> NDArray:  # type: ignore[type-arg]
        """FIR low-pass of both loops."""
        return low_pass(min(self.filter_cutoff, 0.45 * self.rate), self.rate)

    def contact_force(self) -> ContactForceSettings:
        """Settings of the support tool's force loop."""
        return ContactForceSettings(
            rate=self.rate,
            integral_gain=self.loop_gain / self.contact_stiffness,
            coefficients=self.coefficients(),
            error_clamp=self.error_clamp,
            error_slew=self.error_slew,
            dead_zone=self.dead_zone,
            offset_limit=self.offset_limit,
            ramp_back_time=self.ramp_back_time,
        )

    def component_force(self) -> ContactForceSettings:
        """Settings of the loops for the vertical and the tangential force; their gain follows set-point and path."""
        return replace(
            self.contact_force(),
            integral_gain=self.component_gain * max(self.ball_reach, 1e-3) / REFERENCE_FORCE,
            offset_limit=self.component_limit,
        )

    def of_arm(self, tool: int) -> tuple[tuple[float, ...], tuple[float, float, float], float]:
        """Compliance of the arm of ``tool`` (1, 2; empty: there is none), that of tool and holder (3,) m/N, factor."""
        field = self.forming_arm if tool == 1 else self.support_arm
        own = self.forming_compliance if tool == 1 else self.support_compliance
        axial = self.axial_compliance[tool - 1] - _largest(field, "z")
        factor = self.compensation if tool == 1 or not self.support_compensation else self.support_compensation
        return field, (own[0], own[1], axial), factor

    def compliance(self, tool: int = 1) -> ComplianceSettings:
        """Settings of the compliance compensation of ``tool`` (1, 2); the roles decide when it acts."""
        compliance = self.forming_compliance if tool == 1 else self.support_compliance
        factor = self.compensation if tool == 1 or not self.support_compensation else self.support_compensation
        return ComplianceSettings(
            rate=self.rate,
            gain=(factor * compliance[0], factor * compliance[1]),
            coefficients=self.coefficients(),
            offset_slew=self.compliance_slew,
            offset_limit=self.offset_limit,
            smoothing_time=self.compliance_time,
        )


def _arm_field(rig: Rig, tool: int) -> tuple[float, ...]:
    """(90,) m/N, of the arm of ``tool``; empty without one."""
    arm = rig.arm(tool)
    return () if arm is None else _field_of(arm, tuple(rig.limits.travel))


@lru_cache(maxsize=8)  # a configuration asks for it six times
def _field_of(arm: SerialArm, travel: tuple[float, ...]) -> tuple[float, ...]:
    return tuple(compliance_field(arm, travel).ravel().tolist())


def _largest(field: tuple[float, ...], axis: str = "xy") -> float:
    """m/N, largest compliance of an arm in ``axis`` x or y, or z, at the middle of the sheet; 0 without an arm."""
    return max((field["xyz".index(one) * TERMS] for one in axis), default=0.0) if field else 0.0


def _planned_for_compliance(job_file: JobFile) -> bool:
    """True when the gap of the planned path is already that of tools that give way (ADSIF, Ren 2018 eq. 3-12)."""
    job = job_file.job
    return job.process == "ADSIF" and (job.adsif is None or job.adsif.compensate_compliance)


def _forming_compensation(job_file: JobFile) -> float:
    """Factor on the compensation of the forming tool: the job's, but what the plan cancels is not cancelled twice.

    Raises IsfError FILE_FIELD when the job asks for both.
    """
    control = job_file.job.control
    if not _planned_for_compliance(job_file):
        return control.compliance_compensation
    asked = control.compliance_compensation if "compliance_compensation" in control.model_fields_set else 0.0
    if asked > 0.0 or (control.support_compensation or 0.0) > 0.0:
        raise IsfError(
            ErrorCode.FILE_FIELD,
            "adsif.compensate_compliance and the compensation of the tools cancel the same deflection",
            where="control.compliance_compensation, control.support_compensation",
            advice="leave them out, or set adsif.compensate_compliance: false",
        )
    return 0.0


def _support_compensation(job_file: JobFile) -> float:
    """Factor on the compensation of the support tool: the job's; else in ADSIF as much as both tools can bear."""
    if _planned_for_compliance(job_file):
        return 0.0
    control, rig = job_file.job.control, job_file.rig
    if control.support_compensation is not None:
        return control.support_compensation
    compliance = max(rig.tool_2.compliance[0], rig.tool_2.compliance[1]) + _largest(_arm_field(rig, 2))
    if job_file.job.process != "ADSIF" or compliance <= 0.0:
        return 0.0
    upper = max(rig.tool_1.compliance[0], rig.tool_1.compliance[1]) + _largest(_arm_field(rig, 1))
    first = control.compliance_compensation * upper
    left = (0.95 * MAXIMUM_OF_BOTH / rig.contact_stiffness - first) / compliance
    return max(0.0, min(control.compliance_compensation, left))
