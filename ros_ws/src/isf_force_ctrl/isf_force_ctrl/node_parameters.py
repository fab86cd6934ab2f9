"""Parameters of the node ``force_ctrl``."""

from __future__ import annotations

from dataclasses import dataclass

from isf_node.parameters import parameter

from isf_force_ctrl.control_config import ControlConfig


@dataclass(frozen=True)
class ForceCtrlParameters:
    """Parameters of the node; the part's own choices come with the job."""

    lockstep: bool = parameter(True, "one tick per pair of wrenches; false: by the wall clock")
    wrench_timeout: float = parameter(0.0, "s without a wrench that end a contour; 0: 5 s in lockstep, 0.25 s else")
    wrench_frame: str = parameter("sheet", "frame_id that wrenches must have")
    state_decimation: int = parameter(10, "publish force_ctrl/state every n-th tick")
    loop_gain: float = parameter(ControlConfig.loop_gain, "1/s, K_i K_c of the force loop")
    dead_zone: float = parameter(ControlConfig.dead_zone, "N, force error that is left alone")
    filter_cutoff: float = parameter(ControlConfig.filter_cutoff, "Hz, low-pass on force error and forming force")
    error_clamp: float = parameter(ControlConfig.error_clamp, "N, largest force error that acts")
    set_point_rate: float = parameter(ControlConfig.set_point_rate, "N/s, ramp of the set-point while engaging")
    learning: float = parameter(ControlConfig.learning, "0..1, share of the previous contour's offsets fed forward")
    feed_error: float = parameter(ControlConfig.feed_error, "N, force error from which the feed is reduced")
    feed_floor: float = parameter(ControlConfig.feed_floor, "0..1, smallest fraction of the feed")
    seam_speed: float = parameter(ControlConfig.seam_speed, "m/s, feed at both ends of a closed contour")
    adapt_stiffness: bool = parameter(ControlConfig.adapt_stiffness, "estimate the contact stiffness on line")
    oscillation_swing: float = parameter(ControlConfig.oscillation_swing, "N, swing that counts as oscillation")
    compliance_time: float = parameter(ControlConfig.compliance_time, "s, time constant of the compliance compensation")
    contact_threshold: float = parameter(ControlConfig.contact_threshold, "N, support force that counts as contact")
    acceleration: float = parameter(ControlConfig.acceleration, "m/s^2 of a tool tip")
