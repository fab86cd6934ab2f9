"""Parameters of the node ``force_ctrl``."""

from __future__ import annotations

from dataclasses import dataclass

from isf_core.files.job import LARGEST_SUPPORT_FORCE
from isf_ros.parameters import parameter
from isf_ros.thread_priority import MAXIMUM_PRIORITY

from isf_force_ctrl.control_config import ControlConfig

OF_THE_JOB = -1.0
"""Value of ``set_point`` that leaves it to the contours: a number, which every tool can write (NaN is none in YAML)."""


@dataclass(frozen=True)
class ForceCtrlParameters:
    """Parameters of the node; the part's own choices come with the job."""

    lockstep: bool = parameter(True, "one tick per pair of wrenches; false: by the wall clock")
    wrench_timeout: float = parameter(
        0.0,
        "time without a wrench after which a contour ends; 0: 20 s in lockstep, 3 s else",
        unit="s",
        minimum=0.0,
        maximum=60.0,
    )
    wrench_pause: float = parameter(
        0.03,
        "by the clock: time without a wrench, or with nothing but late ones, after which the tools stand until they "
        "come again; at least three of their usual distances",
        unit="s",
        minimum=5e-3,
        maximum=1.0,
    )
    wrenches_tared: bool = parameter(
        False, "the wrenches come tared: machine/tare and machine/state are not needed to arm", read_only=False
    )
    state_folder: str = parameter(
        "force_ctrl_states",
        "folder below which force_ctrl/save writes and force_ctrl/load reads; relative to the working directory",
    )
    contour_wait: float = parameter(
        10.0,
        "wall time in contact without a next contour after which the tools are lifted, where no executive has the part "
        "formed",
        unit="s",
        minimum=0.5,
        maximum=3600.0,
    )
    wrench_frame: str = parameter(
        "sheet",
        "frame with the axes of the sheet: wrenches in it are taken as they are, others are turned into it by tf",
    )
    frame_prefix: str = parameter(
        "", "before the names of the cell's own frames on /tf, such as cell_1/, as of cell_state_publisher"
    )
    transform_age: float = parameter(
        0.25,
        "largest age of a transform on /tf that turns a wrench, by the stamps of the two",
        unit="s",
        minimum=1e-3,
        maximum=10.0,
    )
    wrench_delay: float = parameter(
        0.03,
        "by the clock: longest delay of wrenches beyond that of the first ones",
        unit="s",
        minimum=1e-3,
        maximum=10.0,
    )
    real_time_priority: int = parameter(
        60, "SCHED_FIFO priority requested while ticking by the clock; 0: none", minimum=0, maximum=MAXIMUM_PRIORITY
    )
    lock_memory: bool = parameter(True, "request memory that is never paged out while ticking by the clock")
    output: str = parameter(
        "pose",
        "pose: PoseStamped on tool_k/target; twist: TwistStamped on tool_k/target_twist (not in lockstep); "
        "joint_trajectory: poses, and JointTrajectory on tool_k/joint_trajectory",
        choices=("pose", "twist", "joint_trajectory"),
    )
    described_joints: bool = parameter(
        False,
        "joints of trajectories have the names of isf describe (tool_1_A1); false: those of an arm in the rig (A1)",
    )
    hand_force: float = parameter(
        25.0, "by hand: force on a tool at which its movement stops", unit="N", minimum=1.0, maximum=10_000.0
    )
    joy_axes: str = parameter("-1 -0 4", "axes of joy for x, y and z of a tool, - before one that is turned round")
    joy_enable: int = parameter(4, "dead-man's button of joy", minimum=0, maximum=63)
    joy_tool: int = parameter(0, "button of joy for the other tool", minimum=0, maximum=63)
    joy_smaller: int = parameter(2, "button of joy for the smaller increment", minimum=0, maximum=63)
    joy_larger: int = parameter(1, "button of joy for the larger increment", minimum=0, maximum=63)
    state_decimation: int = parameter(10, "publish force_ctrl/state every n-th tick", minimum=1, maximum=100_000)
    set_point: float = parameter(
        OF_THE_JOB,
        "support force instead of that of the contours under force control, at least contact_threshold; -1: as in the "
        "contours",
        unit="N",
        read_only=False,
        minimum=OF_THE_JOB,
        maximum=LARGEST_SUPPORT_FORCE,
    )
    loop_gain: float = parameter(
        ControlConfig.loop_gain, "K_i K_c of the force loop", unit="1/s", read_only=False, minimum=0.1, maximum=500.0
    )
    dead_zone: float = parameter(
        ControlConfig.dead_zone,
        "force error that is left alone",
        unit="N",
        read_only=False,
        minimum=0.0,
        maximum=100.0,
    )
    filter_cutoff: float = parameter(
        ControlConfig.filter_cutoff,
        "low-pass on force error and forming force",
        unit="Hz",
        read_only=False,
        minimum=1.0,
        maximum=1000.0,
    )
    error_clamp: float = parameter(
        ControlConfig.error_clamp,
        "largest force error that acts",
        unit="N",
        read_only=False,
        minimum=1.0,
        maximum=1000.0,
    )
    set_point_rate: float = parameter(
        ControlConfig.set_point_rate,
        "ramp of the set-point",
        unit="N/s",
        read_only=False,
        minimum=1.0,
        maximum=1e5,
    )
    learning: float = parameter(
        ControlConfig.learning,
        "share of the previous contour's offsets fed forward",
        unit="1",
        minimum=0.0,
        maximum=1.0,
    )
    feed_error: float = parameter(
        ControlConfig.feed_error,
        "force error from which the feed is reduced",
        unit="N",
        read_only=False,
        minimum=0.1,
    )
    feed_floor: float = parameter(
        ControlConfig.feed_floor,
        "smallest fraction of the feed",
        unit="1",
        read_only=False,
        minimum=0.01,
        maximum=1.0,
    )
    seam_speed: float = parameter(
        ControlConfig.seam_speed, "feed at both ends of a closed contour", unit="m/s", minimum=1e-4
    )
    adapt_stiffness: bool = parameter(ControlConfig.adapt_stiffness, "estimate the contact stiffness on line")
    oscillation_swing: float = parameter(
        ControlConfig.oscillation_swing, "swing that counts as oscillation", unit="N", minimum=0.1
    )
    compliance_time: float = parameter(
        ControlConfig.compliance_time,
        "time constant of the compliance compensation",
        unit="s",
        read_only=False,
        minimum=0.0,
        maximum=10.0,
    )
    contact_threshold: float = parameter(
        ControlConfig.contact_threshold,
        "support force that counts as contact",
        unit="N",
        read_only=False,
        minimum=0.1,
        maximum=1000.0,
    )
    drift_limit: float = parameter(
        ControlConfig.drift_limit,
        "reading of a tool off the sheet above which a warning is given",
        unit="N",
        read_only=False,
        minimum=0.1,
        maximum=1e5,
    )
    drift_stop: float = parameter(
        ControlConfig.drift_stop,
        "the same, above which no contact is made",
        unit="N",
        read_only=False,
        minimum=0.1,
        maximum=1e5,
    )
    acceleration: float = parameter(
        ControlConfig.acceleration, "of a tool tip", unit="m/s^2", minimum=1e-3, maximum=20.0
    )
