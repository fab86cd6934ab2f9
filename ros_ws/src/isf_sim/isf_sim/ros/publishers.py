"""What the machine publishes: wrenches or raw voltages every tick; poses, state and clock decimated."""

from __future__ import annotations

from typing import Any

from geometry_msgs.msg import PoseStamped, WrenchStamped
from isf_core.events import Event
from isf_core.files.spindle_cells import CHANNELS
from isf_core.geometry.tool_axis import UPRIGHT
from isf_msgs.msg import MachineEvent as EventMessage
from isf_msgs.msg import MachineState
from isf_ros import conversion, fields, qos, stamps
from isf_ros.lifecycle import CellNode
from rclpy.duration import Duration
from rclpy.publisher import Publisher
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState, PointCloud2

from isf_sim.legs.legs import Legs
from isf_sim.machine.simulated_machine import MachineSample, SimulatedMachine

SCAN_PATIENCE = 5.0
"""s of wall time for the subscribers of a scan to take it, in lockstep."""

WRENCH_PATIENCE, STATE_PATIENCE = 2.0, 0.5
"""s of wall time for the subscribers of the wrenches, of the state, to take those that a service call has changed."""


class MachinePublishers:
    """The node's publishers and their messages, which are filled anew for every tick.

    In ``lockstep`` the clock is published, too. ``raw_cells``: of a tool with spindle cells the voltages are published,
    and no wrench.
    """

    def __init__(self, node: CellNode[Any], *, lockstep: bool, raw_cells: bool) -> None:
        self._node = node
        self._lockstep = lockstep
        self._raw_cells: list[Publisher[Any]] = []
        if raw_cells:
            self._raw_cells = [self._publisher(JointState, f"tool_{k}/raw_cells", qos.STREAM_SOURCE) for k in (1, 2)]
        self._wrenches = [self._publisher(WrenchStamped, f"tool_{k}/wrench", qos.STREAM_SOURCE) for k in (1, 2)]
        self._poses = [self._publisher(PoseStamped, f"tool_{k}/pose", qos.SENSOR) for k in (1, 2)]
        self._legs = self._publisher(JointState, "machine/legs", qos.SENSOR)
        self._state = self._publisher(MachineState, "machine/state", qos.STREAM_SOURCE)
        self._event = self._publisher(EventMessage, "machine/event", qos.EVENT)
        self._scan = self._publisher(PointCloud2, "scan", qos.LATCHED)
        self._formed_sheet = self._publisher(PointCloud2, "machine/formed_sheet", qos.LATCHED)
        self._released_part = self._publisher(PointCloud2, "machine/released_part", qos.LATCHED)
        self._clock = self._publisher(Clock, "/clock", qos.SENSOR) if lockstep else None
        self._wrench_messages = [conversion.make_wrench() for _ in (1, 2)]
        self._pose_messages = [conversion.make_pose() for _ in (1, 2)]
        self._axis = UPRIGHT

    def wrenches(self, sample: MachineSample, nanoseconds: int) -> None:
        """Both wrenches, or what stands for them, with the stamp ``nanoseconds``."""
        stamp = stamps.to_stamp(nanoseconds)
        readings, volts = (sample.wrench_1, sample.wrench_2), (sample.volts_1, sample.volts_2)
        for k, (publisher, message, reading) in enumerate(
            zip(self._wrenches, self._wrench_messages, readings, strict=True)
        ):
            if self._raw_cells and (raw := volts[k]) is not None:
                cells = JointState(name=CHANNELS, effort=raw.tolist())
                cells.header.stamp = stamp
                self._raw_cells[k].publish(cells)
                continue
            message.header.stamp = stamp
            conversion.set_wrench(message, reading)
            publisher.publish(message)

    def wrenches_received(self) -> None:
        """Returns when every reliable subscriber has the last wrenches: the middleware may deliver one a second late,
        and force control would answer an older one."""
        for publisher in (*self._wrenches, *self._raw_cells):
            publisher.wait_for_all_acked(Duration(seconds=WRENCH_PATIENCE))

    def state_received(self) -> None:
        """Returns when every reliable subscriber has the last state: who asked for a tare arms force control next."""
        self._state.wait_for_all_acked(Duration(seconds=STATE_PATIENCE))

    def poses(self, sample: MachineSample, nanoseconds: int) -> None:
        """Both tips and the axis of tool 1 by the encoders, and the clock in lockstep."""
        stamp = stamps.to_stamp(nanoseconds)
        if sample.axis_1 != self._axis:
            self._axis = sample.axis_1
            conversion.set_axis(self._pose_messages[0], sample.axis_1)
        for publisher, message, tip in zip(self._poses, self._pose_messages, (sample.tip_1, sample.tip_2), strict=True):
            message.header.stamp = stamp
            conversion.set_tip(message, tip)
            publisher.publish(message)
        if self._clock is not None:
            self._clock.publish(Clock(clock=stamp))

    def legs(self, legs: Legs, nanoseconds: int) -> None:
        """Strokes, speeds and forces of the legs, by name."""
        strokes, speeds, pushes = legs.motion()
        joints = JointState(name=legs.names)
        joints.position, joints.velocity, joints.effort = strokes.tolist(), speeds.tolist(), pushes.tolist()
        joints.header.stamp = stamps.to_stamp(nanoseconds)
        self._legs.publish(joints)

    def state(self, message: MachineState, nanoseconds: int) -> None:
        """The machine's state."""
        message.header.frame_id = conversion.FRAME
        message.header.stamp = stamps.to_stamp(nanoseconds)
        self._state.publish(message)

    def event(self, event: Event, nanoseconds: int) -> None:
        """One event of the part."""
        message = EventMessage(kind=int(event.kind), value=event.value, limit=event.limit, text=event.text)
        message.header.frame_id = conversion.FRAME
        message.header.stamp = stamps.to_stamp(nanoseconds)
        message.position.x, message.position.y, message.position.z = event.position
        self._event.publish(message)

    def scan(self, cloud: PointCloud2) -> None:
        """A measured shape; in lockstep returns when every reliable subscriber has it, so that all that happens after a
        scan is answered happens in the same order again."""
        self._publish_cloud(self._scan, cloud)

    def formed_sheet(self, cloud: PointCloud2) -> None:
        """Thickness and strain margin of the sheet; returns as :meth:`scan`."""
        self._publish_cloud(self._formed_sheet, cloud)

    def released_part(self, cloud: PointCloud2) -> None:
        """The part out of the clamp, in no frame of the cell; returns as :meth:`scan`."""
        cloud.header.frame_id = fields.PART_FRAME
        self._publish_cloud(self._released_part, cloud)

    def _publish_cloud(self, publisher: Publisher[Any], cloud: PointCloud2) -> None:
        """By the clock nobody is waited for: a subscriber that is out of reach would keep the tools where they are, on
        the sheet. What is on its way when the node ends is handed over then."""
        publisher.publish(cloud)
        if self._lockstep:
            publisher.wait_for_all_acked(Duration(seconds=SCAN_PATIENCE))

    def _publisher(self, kind: Any, topic: str, profile: Any) -> Publisher[Any]:
        return self._node.create_publisher(kind, topic, profile)


def state_message(
    machine: SimulatedMachine, *, mode: int, tick: int, received: int, lost: int, late: int, lockstep: bool
) -> MachineState:
    """State of ``machine`` with what the node counts: ticks, pairs of targets received and lost, late ticks."""
    rms, largest = machine.legs.following() if machine.legs is not None else (0.0, 0.0)
    return MachineState(
        mode=mode,
        fault_codes=[int(code) for code, _ in machine.faults],
        fault_messages=[text for _, text in machine.faults],
        limits=machine.limits,
        tick=tick,
        targets_received=received,
        targets_lost=lost,
        late_ticks=late,
        lockstep=lockstep,
        tared=machine.tared,
        holder_height=machine.holder_height,
        solve_time=machine.solve_time,
        axis_error_rms=rms,
        axis_error_largest=largest,
    )
