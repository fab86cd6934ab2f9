"""Parameters of the node ``force_ctrl``."""

from __future__ import annotations

from dataclasses import dataclass

from isf_ros.parameters import parameter
from isf_ros.thread_priority import MAXIMUM_PRIORITY

from isf_force_ctrl.control_config import ControlConfig


@dataclass(frozen=True)
class ForceCtrlParameters:
    """Parameters of the node; the part's own choices come with the job."""

    lockstep: bool = parameter(True, "one tick per pair of wrenches; false: by the wall clock")
    wrench_timeout: float = parameter(
        0.0, "s without a wrench after which a contour ends; 0: 5 s in lockstep, 0.25 s else", minimum=0.0, maximum=60.0
    )
    contour_wait: float = parameter(
        10.0,
        "s of wall time in contact without a next contour after which the tools are lifted, where no executive has the "
        "part formed",
        minimum=0.5,
        maximum=3600.0,
    )
    wrench_frame: str = parameter("sheet", "frame_id that wrenches must have")
    wrench_delay: float = parameter(
        0.03, "s, in real time: longest delay of wrenches beyond that of the first ones", minimum=1e-3, maximum=10.0
    )
    real_time_priority: int = parameter(
        60, "SCHED_FIFO priority requested while ticking by the clock; 0: none", minimum=0, maximum=MAXIMUM_PRIORITY
    )
    lock_memory: bool = parameter(True, "request memory that is never paged out while ticking by the clock")
    output: str = parameter(
        "pose",
        "pose: PoseStamped on tool_k/target; twist: TwistStamped on tool_k/target_twist (not in lockstep)",
        choices=("pose", "twist"),
    )
    state_decimation: int = parameter(10, "publish force_ctrl/state every n-th tick", minimum=1, maximum=100_000)
    loop_gain: float = parameter(ControlConfig.loop_gain, "1/s, K_i K_c of the force loop", minimum=0.1, maximum=500.0)
    dead_zone: float = parameter(
        ControlConfig.dead_zone, "N, force error that is left alone", minimum=0.0, maximum=100.0
    )
    filter_cutoff: float = parameter(
        ControlConfig.filter_cutoff, "Hz, low-pass on force error and forming force", minimum=1.0, maximum=1000.0
    )
    error_clamp: float = parameter(
        ControlConfig.error_clamp, "N, largest force error that acts", minimum=1.0, maximum=1000.0
    )
    set_point_rate: float = parameter(
        ControlConfig.set_point_rate, "N/s, ramp of the set-point while engaging", minimum=1.0, maximum=1e5
    )
    learning: float = parameter(
        ControlConfig.learning, "0..1, share of the previous contour's offsets fed forward", minimum=0.0, maximum=1.0
    )
    feed_error: float = parameter(
        ControlConfig.feed_error, "N, force error from which the feed is reduced", minimum=0.1
    )
    feed_floor: float = parameter(
        ControlConfig.feed_floor, "0..1, smallest fraction of the feed", minimum=0.01, maximum=1.0
    )
    seam_speed: float = parameter(ControlConfig.seam_speed, "m/s, feed at both ends of a closed contour", minimum=1e-4)
    adapt_stiffness: bool = parameter(ControlConfig.adapt_stiffness, "estimate the contact stiffness on line")
    oscillation_swing: float = parameter(
        ControlConfig.oscillation_swing, "N, swing that counts as oscillation", minimum=0.1
    )
    compliance_time: float = parameter(
        ControlConfig.compliance_time, "s, time constant of the compliance compensation", minimum=0.0, maximum=10.0
    )
    contact_threshold: float = parameter(
        ControlConfig.contact_threshold, "N, support force that counts as contact", minimum=0.1, maximum=1000.0
    )
    drift_limit: float = parameter(
        ControlConfig.drift_limit,
        "N, reading of a tool off the sheet above which a warning is given",
        minimum=0.1,
        maximum=1e5,
    )
    drift_stop: float = parameter(
        ControlConfig.drift_stop, "N, the same, above which no contact is made", minimum=0.1, maximum=1e5
    )
    acceleration: float = parameter(ControlConfig.acceleration, "m/s^2 of a tool tip", minimum=1e-3, maximum=20.0)
