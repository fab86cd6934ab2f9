"""Node ``cell_state_publisher``: what viewers need of a running cell, from what any driver publishes.

Frames and joint states follow ``tool_k/pose``, ``rate`` times a second at most, with the stamps of the poses; the
description, the scanned sheet and the path that is being formed are latched. Wrenches come at the control rate: they
are taken only while somebody looks at them. The node sends nothing that a machine listens to.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from geometry_msgs.msg import PoseStamped, WrenchStamped
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile, load_job
from isf_core.files.rig import Rig, load_rig
from isf_msgs.msg import Contour, JobInfo, MachineState
from isf_ros import process, qos, stamps
from isf_ros.conversion import (
    FRAME,
    cloud_points,
    contour_from_message,
    path_to_message,
    set_wrench,
    wrench_array,
)
from isf_ros.lifecycle import CellNode
from isf_ros.parameters import parameter
from isf_ros.wrench_axes import WrenchAxes
from nav_msgs.msg import Path as PathMessage
from sensor_msgs.msg import JointState, PointCloud2
from std_msgs.msg import String
from tf2_msgs.msg import TFMessage
from visualization_msgs.msg import Marker

from isf_description.cell import HOLDER, ball_radius, describe, tip_frame
from isf_description.joints import Positions, tool_positions
from isf_description.node_messages import blank_marker, sheet_marker, transform_message
from isf_description.ros2_control import ControlBlock
from isf_description.surface import surface
from isf_description.tree import Joint, Quaternion, Vector
from isf_description.urdf import to_urdf

PATH_POSES = 500
"""Largest number of poses of the path that is being formed."""

OLDEST = 0.25
"""s, largest age of a transform that turns a wrench for the eye."""


@dataclass(frozen=True)
class CellStateParameters:
    """Parameters of the node."""

    job: str = parameter("", "job file that says tools and rig, where no executive publishes part/info")
    rig: str = parameter("", "rig (name or path) to describe before a job is known")
    base_folder: str = parameter("", "folder that relative paths of the job in part/info refer to, instead of its own")
    wrench_frame: str = parameter(FRAME, "frame with the axes of the sheet, as of force_ctrl; others are turned by tf")
    lockstep: bool = parameter(True, "stamps are taken as they are; false: one left at zero is the time of arrival")
    frame_prefix: str = parameter("", "before the name of every frame, such as cell_1/, where cells share /tf")
    ros2_control: bool = parameter(False, "robot_description has the block of a cell under ros2_control")
    publish_tf: bool = parameter(True, "false: robot_state_publisher makes the frames from joint_states")
    rate: float = parameter(50.0, "frames and joint states per second, at most", unit="Hz", minimum=1.0, maximum=500.0)
    sheet_points: int = parameter(
        50, "points across the formed place of the scanned sheet, as part/sheet shows it", minimum=10, maximum=300
    )


class Tool:
    """What is known of one tool."""

    def __init__(self, number: int) -> None:
        self.number = number
        self.pose: PoseStamped | None = None  # that is not published yet
        self.stamp: Any = None  # of the pose that was published last
        self.wrench: WrenchStamped | None = None
        self.wrenches: Any = None  # subscription


class CellStateNode(CellNode[CellStateParameters]):
    """ROS side of :mod:`isf_description.cell` and :mod:`isf_description.joints`."""

    def __init__(self) -> None:
        super().__init__("cell_state_publisher", CellStateParameters)
        self._tools = (Tool(1), Tool(2))
        self._rig: Rig | None = None
        self._joints: dict[str, Joint] = {}
        self._positions: Positions = {}
        self._states: Any = None  # subscription
        self._wrong: dict[str, str] = {}  # by topic, what is wrong with its messages
        self._viewers = 0
        self._published = 0

    def configure(self) -> None:
        """Raises IsfError of the job or rig file."""
        self._settings = p = self.values()
        self._plan = ""
        self._scanned = False
        self._wrong = {}
        self._tools = (Tool(1), Tool(2))
        self._description = self.create_publisher(String, "robot_description", qos.LATCHED)
        self._joint_states = self.create_publisher(JointState, "joint_states", qos.STREAM)
        self._sheet = self.create_publisher(Marker, "part/sheet", qos.LATCHED)
        self._path = self.create_publisher(PathMessage, "contour/path", qos.LATCHED)
        self._tf = self.create_publisher(TFMessage, "/tf", qos.TF) if p.publish_tf else None
        self._tf_static = self.create_publisher(TFMessage, "/tf_static", qos.LATCHED) if p.publish_tf else None
        self._tip_wrenches = [self.create_publisher(WrenchStamped, f"tool_{k}/tip_wrench", qos.SENSOR) for k in (1, 2)]
        self._axes = WrenchAxes(self, self._frame(p.wrench_frame), OLDEST)
        self._describe()
        for tool in self._tools:
            self.create_subscription(PoseStamped, f"tool_{tool.number}/pose", partial(self._on_pose, tool), qos.SENSOR)
        self.create_subscription(JobInfo, "part/info", self._on_info, qos.LATCHED)
        self.create_subscription(PointCloud2, "scan", self._on_scan, qos.LATCHED)
        self.create_subscription(Contour, "contour/corrected", self._on_contour, qos.LATCHED)
        self.create_timer(1.0 / p.rate, self._publish, clock=self.steady_clock)

    def cleanup(self) -> None:
        self._rig, self._joints, self._positions = None, {}, {}
        self._axes.close()
        self._drop(self._states)
        self._states = None
        for tool in self._tools:
            self._drop(tool.wrenches)
            tool.wrenches = None

    def _drop(self, subscription: Any) -> None:
        """One that was made on the way does not end with the transition."""
        if subscription is not None:
            self.destroy_subscription(subscription)

    def health_values(self) -> dict[str, object]:
        return {"rig": "" if self._rig is None else self._rig.name, "published": self._published}

    # -- what the cell is --------------------------------------------------------------------------

    def _describe(self) -> None:
        p = self._settings
        if p.job:
            job_file = load_job(p.job)
            self._take(job_file.rig, job_file)
        elif p.rig:
            self._take(load_rig(p.rig), None)

    def _on_info(self, message: JobInfo) -> None:
        if not self.is_configured or message.plan_id == self._plan:
            return
        base = Path(self._settings.base_folder or message.base_folder or ".")
        try:
            job_file = JobFile(message.job_text, base, message.job_name or "job")
        except IsfError as error:
            self.warn(error)
            return
        if self._plan:  # else the scan that is latched is of this part
            self._scanned = False
        self._plan = message.plan_id
        self._take(job_file.rig, job_file)

    def _take(self, rig: Rig, job_file: JobFile | None) -> None:
        """Describe another cell; poses that are known stay."""
        made = describe(rig, job_file)
        self._rig = rig
        self._joints = {joint.name: joint for joint in made.movable}
        self._reach = [tool_positions(rig, tool.number, ball_radius(job_file, tool.number)) for tool in self._tools]
        self._positions = {name: value for name, value in self._positions.items() if name in self._joints}
        if HOLDER not in self._joints:
            self._drop(self._states)
            self._states = None
        elif self._states is None:
            self._positions.setdefault(HOLDER, 0.0)
            self._states = self.create_subscription(MachineState, "machine/state", self._on_state, qos.SENSOR)
        block = None
        if self._settings.ros2_control:
            block = ControlBlock.of(rig, made, ball_radius(job_file, 1), self.get_namespace())
        self._description.publish(String(data=to_urdf(made, block)))
        if self._tf_static is not None:
            stamp, prefix = self.get_clock().now().to_msg(), self._settings.frame_prefix
            self._tf_static.publish(
                TFMessage(transforms=[transform_message(joint, 0.0, stamp, prefix) for joint in made.fixed])
            )
        if not self._scanned:
            thickness = 1e-3 if job_file is None else job_file.job.sheet.thickness
            self._sheet.publish(blank_marker(rig.clamp.size, thickness, self._frame(FRAME), self._now()))

    # -- what moves --------------------------------------------------------------------------------

    def _on_pose(self, tool: Tool, message: PoseStamped) -> None:
        tool.pose = message

    def _on_state(self, message: MachineState) -> None:
        if HOLDER in self._joints:
            self._positions[HOLDER] = message.holder_height

    def _publish(self) -> None:
        """Everything that has changed since the last time."""
        if not self.is_active or self._rig is None:
            return
        self._follow_wrenches(self._rig)
        news: dict[int, Positions] = {}  # by stamp, ns: the poses of both tools need not have the same
        for tool, reach in zip(self._tools, self._reach, strict=True):
            pose, tool.pose = tool.pose, None
            if pose is not None and (found := self._found(tool, pose, reach)):
                news.setdefault(stamps.to_nanoseconds(tool.stamp), {}).update(found)
        viewers = 0 if self._tf is None else self._tf.get_subscription_count()
        if not news and viewers > self._viewers:  # who comes while nothing moves, as after a part, sees the cell too
            for tool in self._tools:
                if tool.stamp is not None:
                    names = (name for name in self._positions if name.startswith(_own(tool)))
                    known = {name: self._positions[name] for name in names}
                    news.setdefault(stamps.to_nanoseconds(tool.stamp), {}).update(known)
        self._viewers = viewers
        if news:
            self._send(news)

    def _found(self, tool: Tool, pose: PoseStamped, reach: Callable[[Vector, Quaternion], Positions]) -> Positions:
        """Positions of the joints of ``tool``; none when its pose is no news, or unusable, which is told once."""
        stamp = pose.header.stamp
        if not (stamp.sec or stamp.nanosec) and not self._settings.lockstep:
            pose.header.stamp = stamp = self._now()
        if stamp == tool.stamp:
            return {}  # tf2 complains of what it has got already
        topic = f"tool_{tool.number}/pose"
        try:
            self._check_frame(pose, topic)
            here, turn = pose.pose.position, pose.pose.orientation
            found = reach((here.x, here.y, here.z), (turn.x, turn.y, turn.z, turn.w))
        except IsfError as error:
            self._tell_wrong(topic, error)
            return {}
        self._tell_well(topic)
        tool.stamp = stamp
        found = {name: value for name, value in found.items() if name in self._joints}
        self._positions.update(found)
        return found

    def _send(self, news: dict[int, Positions]) -> None:
        if HOLDER in self._joints:
            news[max(news)][HOLDER] = self._positions[HOLDER]
        transforms = []
        for nanoseconds, positions in news.items():
            stamp = stamps.to_stamp(nanoseconds)
            state = JointState(name=list(positions), position=list(positions.values()))
            state.header.stamp = stamp
            self._joint_states.publish(state)
            if self._tf is not None:
                prefix = self._settings.frame_prefix
                transforms += [
                    transform_message(self._joints[name], value, stamp, prefix) for name, value in positions.items()
                ]
        if self._tf is not None:
            self._tf.publish(TFMessage(transforms=transforms))
        self._published += 1

    def _check_frame(self, pose: PoseStamped, topic: str) -> None:
        frame = pose.header.frame_id
        if frame not in (FRAME, self._frame(FRAME)):
            raise IsfError(
                ErrorCode.POSE_LOST,
                f"a pose is in frame '{frame}', not '{FRAME}'",
                where=topic,
                advice="the driver has to give the tip in frame sheet",
            )

    def _tell_wrong(self, topic: str, error: IsfError) -> None:
        """Warn of messages that are left out; once, until they are well."""
        if self._wrong.get(topic) != str(error):
            self._wrong[topic] = str(error)
            self.warn(error)

    def _tell_well(self, topic: str) -> None:
        if self._wrong.pop(topic, None) is not None and not self._wrong:
            self.report_ok()

    # -- wrenches, only while somebody looks -------------------------------------------------------

    def _follow_wrenches(self, rig: Rig) -> None:
        for tool, publisher in zip(self._tools, self._tip_wrenches, strict=True):
            topic = f"tool_{tool.number}/wrench"
            wanted = publisher.get_subscription_count() > 0
            if wanted and tool.wrenches is None:
                tool.wrenches = self.create_subscription(
                    WrenchStamped, topic, partial(self._on_wrench, tool), qos.SENSOR
                )
            elif not wanted:
                self._drop(tool.wrenches)
                tool.wrenches = None
                self._tell_well(topic)
            wrench, tool.wrench = tool.wrench, None
            if wrench is None:
                continue
            frame, expected = wrench.header.frame_id, self._settings.wrench_frame
            if frame not in (expected, self._frame(expected)):  # its axes are others: the arrow would point elsewhere
                stamp = stamps.to_nanoseconds(wrench.header.stamp)
                try:
                    set_wrench(wrench, self._axes.turned(frame, stamp, wrench_array(wrench)))
                except IsfError as error:
                    advice = "have its transform published, or set wrench_frame where only the name differs"
                    self._tell_wrong(topic, IsfError(error.code, error.what, where=topic, advice=advice))
                    continue
            self._tell_well(topic)
            wrench.header.frame_id = self._frame(tip_frame(rig, tool.number))
            publisher.publish(wrench)

    def _on_wrench(self, tool: Tool, message: WrenchStamped) -> None:
        tool.wrench = message

    # -- what is formed ----------------------------------------------------------------------------

    def _on_scan(self, message: PointCloud2) -> None:
        try:
            points = cloud_points(message)
        except ValueError as error:
            self.warn(IsfError(ErrorCode.SCAN_INCOMPLETE, str(error), where="scan"))
            return
        vertices, triangles = surface(points, self._settings.sheet_points)
        self._scanned = True
        given = message.header.frame_id or FRAME
        frame = self._frame(FRAME) if given == FRAME else given
        self._sheet.publish(sheet_marker(vertices, triangles, frame, message.header.stamp))

    def _on_contour(self, message: Contour) -> None:
        try:
            tips = contour_from_message(message).forming_tip
        except ValueError as error:
            self.warn(IsfError(ErrorCode.CONTOUR_REJECTED, f"malformed: {error}", where="contour/corrected"))
            return
        path = path_to_message(tips, message.header.stamp, PATH_POSES)
        path.header.frame_id = self._frame(FRAME)
        self._path.publish(path)

    def _frame(self, name: str) -> str:
        return self._settings.frame_prefix + name

    def _now(self) -> Any:
        return self.get_clock().now().to_msg()


def _own(tool: Tool) -> tuple[str, ...]:
    """How the names of the joints that move with a tool begin; the legs are those of the upper one."""
    return (f"tool_{tool.number}_", "leg_") if tool.number == 1 else (f"tool_{tool.number}_",)


def main(args: list[str] | None = None) -> None:
    """Entry point of ``ros2 run isf_description cell_state_publisher``."""
    sys.exit(process.run(CellStateNode, args, streams=True))


if __name__ == "__main__":
    main()
