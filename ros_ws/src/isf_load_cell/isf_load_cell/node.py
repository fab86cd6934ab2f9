"""Node ``load_cell``: raw readings of a load cell in, the wrench in frame ``sheet`` that force control uses out.

How a cell that turns stands is told by drivers: a message of its own, or the robot's frames on ``/tf``.
"""

from __future__ import annotations

import math
import sys
import time
from dataclasses import dataclass
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped, Quaternion, TransformStamped, WrenchStamped
from isf_core.errors import ErrorCode, IsfError
from isf_core.events import cell_event
from isf_core.files import quantity
from isf_core.geometry.frame_tree import FrameTree, Turn
from isf_core.types import Array
from isf_msgs.msg import MachineEvent
from isf_ros import conversion, process, qos, stamps
from isf_ros.lifecycle import CellNode
from isf_ros.parameters import parameter
from isf_ros.watchdog import ReceiveWatchdog
from nav_msgs.msg import Odometry
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from isf_load_cell.cell_file import load_cell_set_up
from isf_load_cell.stream import CellStream
from isf_load_cell.three_cells import ThreeCellReading

POSE_TYPES = ("pose", "transform", "odometry", "tf")
"""PoseStamped, TransformStamped or Odometry on topic ``pose``; TFMessage on ``/tf`` and ``/tf_static``."""

_UNNAMED = "the tool"
"""Frame of what comes on ``pose`` where no other name was asked for."""


class PoseInlet:
    """Subscriptions of ``node`` and the present rotation that follows.

    ``kind`` is one of :data:`POSE_TYPES`, ``frame`` the one whose axes are told ("", but for "tf": whatever comes),
    ``base`` the one in whose axes, ``timeout`` s after which they are lost.

    Raises
    ------
    IsfError : FILE_FIELD when ``kind`` "tf" names no frame, or tf2_msgs is not installed
    """

    def __init__(self, node: Node, kind: str, frame: str, base: str, timeout: float) -> None:
        self._kind, self._frame, self._base, self._timeout = kind, frame or _UNNAMED, base, timeout
        self._any_child = not frame
        self._tree = FrameTree(timeout)
        self._turn: Turn | None = None
        self._parent: str | None = None
        self._grace = -math.inf
        if kind == "tf":
            message = _tf_message(frame)
            node.create_subscription(message, "/tf", self._on_tf, qos.TF)
            node.create_subscription(message, "/tf_static", self._on_tf_static, qos.TF_STATIC)
        else:
            types = {"pose": (PoseStamped, self._on_pose), "transform": (TransformStamped, self._on_transform)}
            message, handler = types.get(kind, (Odometry, self._on_odometry))
            node.create_subscription(message, "pose", handler, qos.SENSOR)

    def restart(self) -> None:
        """From now on a pose has to come, within the timeout."""
        self._grace = time.monotonic() + self._timeout

    def rotation(self) -> Array | None:
        """(3, 3) from axes of the frame to axes of the base; None when it is not known, or no longer."""
        turn = self._turn
        return turn.matrix if turn is not None and time.monotonic() <= turn.until else None

    def lost(self) -> IsfError | None:
        """Why there is no rotation, and has not been for the timeout; None otherwise."""
        if self.rotation() is not None or time.monotonic() <= self._grace:
            return None
        topic = "/tf" if self._kind == "tf" else "pose"
        what = f"nothing usable on {topic} for {self._timeout:g} s: weight and axes unknown"
        if self._kind != "tf" and self._parent not in (None, self._base):
            advice = "pose_base, where only the name differs; pose_type:=tf joins frames"
            return IsfError(
                ErrorCode.POSE_LOST, f"{what}; it comes in frame '{self._parent}', not '{self._base}'", advice=advice
            )
        try:
            self._tree.rotation(self._base, self._frame)
        except IsfError as error:
            return IsfError(error.code, f"{what}; {error.what}", advice=error.advice)
        return None

    def _on_pose(self, message: PoseStamped) -> None:
        self._put(message.header.frame_id, self._frame, message.pose.orientation)

    def _on_transform(self, message: TransformStamped) -> None:
        self._put(message.header.frame_id, message.child_frame_id, message.transform.rotation)

    def _on_odometry(self, message: Odometry) -> None:
        self._put(message.header.frame_id, message.child_frame_id, message.pose.pose.orientation)

    def _put(self, parent: str, child: str, turn: Quaternion) -> None:
        self._parent = parent
        child = self._frame if self._any_child else child
        if self._tree.add(parent, child, (turn.x, turn.y, turn.z, turn.w)):
            self._update({child})

    def _on_tf(self, message: Any) -> None:
        self._put_all(message, fixed=False)

    def _on_tf_static(self, message: Any) -> None:
        self._put_all(message, fixed=True)

    def _put_all(self, message: Any, *, fixed: bool) -> None:
        for item in message.transforms:
            turn = item.transform.rotation
            self._tree.add(item.header.frame_id, item.child_frame_id, (turn.x, turn.y, turn.z, turn.w), fixed=fixed)
        self._update({item.child_frame_id for item in message.transforms})

    def _update(self, changed: set[str]) -> None:
        if self._turn is not None and not self._turn.links & changed:
            return  # other robots, wheels, cameras: most of what comes on /tf
        try:
            self._turn = self._tree.rotation(self._base, self._frame)
        except IsfError:
            self._turn = None  # told by lost(), after a moment


def _tf_message(frame: str) -> Any:
    """Type of the messages on ``/tf``; ``frame`` has to be named."""
    if not frame:
        what = "pose_type is tf, and no frame is named"
        raise IsfError(ErrorCode.FILE_FIELD, what, where="parameter pose_frame", advice="e.g. pose_frame:=tool0")
    try:
        from tf2_msgs.msg import TFMessage  # type: ignore[import-not-found]
    except ImportError as error:
        raise IsfError(
            ErrorCode.FILE_FIELD,
            "tf cannot be read here: the package tf2_msgs is not installed",
            where="parameter pose_type",
            advice="sudo apt install ros-jazzy-tf2-msgs; or pose_type:=pose, transform or odometry",
        ) from error
    return TFMessage


LOOK = 0.1
"""s of wall time between two looks at what has stopped."""


@dataclass(frozen=True)
class LoadCellParameters:
    """Parameters of the node; the cell's own numbers stand in its file."""

    file: str = parameter("", "file of the cell: what isf calibrate-cell writes, with range, rotation, ... added")
    rig: str = parameter("", "rig (name or path) whose load_cell gives what the file does not")
    tool: int = parameter(
        1,
        "1 or 2: the tool of this cell, named in events; whose weight and spindle cells the rig file gives",
        minimum=1,
        maximum=2,
    )
    frame: str = parameter(conversion.FRAME, "frame_id of the wrench")
    with_pose: bool = parameter(False, "the cell turns: weight and axes by its orientation, see pose_type")
    pose_type: str = parameter(
        "pose",
        "source of the orientation: PoseStamped, TransformStamped, Odometry on pose, or the robot's tf",
        choices=POSE_TYPES,
    )
    pose_frame: str = parameter("", "frame whose axes the rotation of the file is against; needed with tf")
    pose_base: str = parameter(conversion.FRAME, "frame in whose axes the orientation is given: sheet, or one like it")
    tare_readings: int = parameter(250, "number of newest readings averaged as the zero", minimum=1, maximum=100_000)
    timeout: float = parameter(
        0.5, "time without a reading, or a pose, after which this is reported", unit="s", minimum=0.01, maximum=60.0
    )
    best_effort: bool = parameter(False, "the driver publishes its readings best effort")


class LoadCellNode(CellNode[LoadCellParameters]):
    """ROS side of :class:`isf_load_cell.stream.CellStream`."""

    def __init__(self) -> None:
        super().__init__("load_cell", LoadCellParameters)
        self._stream: CellStream | None = None
        self._reported, self._heard = "", False
        self._readings = self._wrenches = 0

    # -- lifecycle -----------------------------------------------------------------------------

    def configure(self) -> None:
        self._settings = p = self.values()
        if not p.with_pose and (p.pose_type, p.pose_frame) != ("pose", ""):
            what = "pose_type and pose_frame mean nothing without it"
            raise IsfError(ErrorCode.FILE_FIELD, what, where="parameter with_pose", advice="with_pose:=true")
        set_up = load_cell_set_up(p.file, p.rig, p.tool)
        self._reading = set_up.reading
        self._stream = CellStream(self._reading, p.tare_readings, p.timeout)
        if isinstance(self._reading, ThreeCellReading) and (needed := self._reading.indispensable()):
            self.get_logger().warning(
                f"load-cell channels {', '.join(needed)} cannot be spared: height is many times the radius"
            )
        self._mounting = set_up.rotation
        self._names = set_up.channels or ()
        self._order: tuple[tuple[str, ...], tuple[int, ...]] = ((), ())
        self._raw = ReceiveWatchdog(p.timeout)
        self._pose = PoseInlet(self, p.pose_type, p.pose_frame, p.pose_base, p.timeout) if p.with_pose else None
        self._wrench = conversion.make_wrench()
        self._wrench.header.frame_id = p.frame
        self._publisher = self.create_publisher(WrenchStamped, "wrench", qos.STREAM_SOURCE)
        self._events = self.create_publisher(MachineEvent, "machine/event", qos.EVENT)
        profile = qos.SENSOR if p.best_effort else qos.READINGS
        if set_up.channels:
            self.create_subscription(JointState, "raw_cells", self._on_channels, profile)
        else:
            self.create_subscription(WrenchStamped, "raw", self._on_raw, profile)
        self.create_service(Trigger, "~/tare", self._on_tare)
        self.create_service(Trigger, "~/check_drift", self._on_check_drift)
        self.create_timer(LOOK, self._look, clock=self.steady_clock)

    def activate(self) -> None:
        p = self._settings
        self._stream = CellStream(self._reading, p.tare_readings, p.timeout)  # no zero of the part before
        self._reported, self._heard = "", False
        self._raw.feed()  # from now on something has to come
        if self._pose is not None:
            self._pose.restart()

    def cleanup(self) -> None:
        self._stream = None

    def health_values(self) -> dict[str, object]:
        if self._stream is None:
            return {}
        publishing = self.is_active and self._stream.fault is None and self._lost() is None
        return {
            "publishing": publishing,
            "faults": self._stream.faults,
            "readings": self._readings,
            "wrenches": self._wrenches,
        }

    # -- readings, hot path --------------------------------------------------------------------

    def _on_raw(self, message: WrenchStamped) -> None:
        self._take(message.header.stamp, np.array(conversion.wrench_array(message)))

    def _on_channels(self, message: JointState) -> None:
        effort, names = message.effort, tuple(message.name)
        if self._order[0] != names:
            self._order = (names, tuple(names.index(name) if name in names else -1 for name in self._names))
        reading = [effort[k] if 0 <= k < len(effort) else np.nan for k in self._order[1]]
        self._take(message.header.stamp, np.array(reading))

    def _take(self, stamp: Any, reading: Array) -> None:
        stream = self._stream
        if not self.is_active or stream is None:
            return
        self._raw.feed()
        self._heard = True
        self._readings += 1
        rotation = None
        if self._pose is not None:
            turn = self._pose.rotation()
            if turn is None:
                return  # told by _look, after a moment
            rotation = turn @ self._mounting
        before = stream.fault
        wrench = stream.add(stamps.to_nanoseconds(stamp), reading, rotation)
        news = stream.take_news()
        for error in news:
            self._publish_event(error, stamp, lost=False)
        if stream.fault is not None and stream.fault is not before:
            self._publish_event(stream.fault, stamp, lost=True)
            self._look()
        if wrench is not None:
            self._wrench.header.stamp = stamp
            conversion.set_wrench(self._wrench, wrench)
            self._publisher.publish(self._wrench)
            self._wrenches += 1
        if news:
            self._look()

    def _publish_event(self, error: IsfError, stamp: Any, *, lost: bool) -> None:
        """What happened to the cell belongs to the record of the part."""
        event = cell_event(error, self._settings.tool, 0.0, lost=lost)
        message = MachineEvent(kind=int(event.kind), value=event.value, limit=event.limit, text=event.text)
        message.header.frame_id, message.header.stamp = self._settings.frame, stamp
        message.position.x, message.position.y, message.position.z = event.position
        self._events.publish(message)

    # -- what is told --------------------------------------------------------------------------

    def _look(self) -> None:
        """Show the present fault or warning in ``/diagnostics``, and log it once."""
        stream = self._stream
        if stream is None or not self.is_active:
            return
        fault = stream.fault if stream.faults and stream.fault is not None else self._lost() or stream.fault
        if fault is not None:
            self._notify(fault, DiagnosticStatus.ERROR)
        elif warning := stream.warning():
            self._notify(warning, DiagnosticStatus.WARN)
        elif self._reported:
            self._reported = ""
            self.report_ok()
            self.publish_health()
            self.get_logger().info("wrenches are published")

    def _notify(self, error: IsfError, level: bytes) -> None:
        if str(error) == self._reported:
            return
        self._reported = str(error)
        self.report_ok()
        if level == DiagnosticStatus.ERROR:
            self.report(error)
        else:
            self.warn(error)

    def _lost(self) -> IsfError | None:
        """What has stopped coming, or has never come."""
        if self._raw.expired():
            return self._nothing(f"for {self._settings.timeout:g} s")
        return None if self._pose is None else self._pose.lost()

    def _nothing(self, since: str) -> IsfError:
        return IsfError(
            ErrorCode.WRENCH_LOST,
            f"nothing on {'raw_cells' if self._names else 'raw'} {since}",
            advice="check the load cell's driver and the remapping; best_effort, if it publishes so",
        )

    # -- services ------------------------------------------------------------------------------

    def _on_tare(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        return self._answer(response, lambda stream: f"zero from {stream.tare()} readings")

    def _on_check_drift(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        return self._answer(response, lambda stream: f"drift {stream.check_drift():.2f} N since the tare")

    def _answer(self, response: Trigger.Response, ask: Any) -> Trigger.Response:
        try:
            if not self.is_active or self._stream is None:
                raise IsfError(ErrorCode.NO_TARE, "the node is not active", advice="activate it first")
            if lost := self._lost() or (None if self._heard else self._nothing("yet")):
                raise lost
            response.message, response.success = ask(self._stream), True
        except IsfError as error:
            response.message = str(error)
            self.get_logger().warning(response.message)
        self._look()
        return response


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    quantity.parse("1 mm", "m")  # loads the units before the node exists: when configured it would look dead
    return process.run(LoadCellNode, args, streams=True)


if __name__ == "__main__":
    sys.exit(main())
