"""How a load cell that turns stands, as drivers tell it: a message of its own, or the robot's frames on ``/tf``.

Whatever it comes as, it is a transform between two frames and goes into one frame_tree.FrameTree. Of tf2 only the
messages are needed, tf2_msgs, which a ROS made of wheels lacks; its buffer would keep ten seconds of translations and
rotations of all frames, where the newest rotation of a few is asked for.
"""

from __future__ import annotations

import math
import time
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseStamped, Quaternion, TransformStamped
from isf_core.errors import ErrorCode, IsfError
from isf_node import qos
from nav_msgs.msg import Odometry
from numpy.typing import NDArray
from rclpy.node import Node

from isf_force_ctrl.frame_tree import FrameTree, Turn

Array = NDArray[np.float64]

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
            self.subscriptions: list[Any] = [
                node.create_subscription(message, "/tf", self._on_tf, qos.TF),
                node.create_subscription(message, "/tf_static", self._on_tf_static, qos.TF_STATIC),
            ]
        else:
            types = {"pose": (PoseStamped, self._on_pose), "transform": (TransformStamped, self._on_transform)}
            message, handler = types.get(kind, (Odometry, self._on_odometry))
            self.subscriptions = [node.create_subscription(message, "pose", handler, qos.SENSOR)]

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
        if self._tree.put(parent, child, (turn.x, turn.y, turn.z, turn.w)):
            self._update({child})

    def _on_tf(self, message: Any) -> None:
        self._put_all(message, fixed=False)

    def _on_tf_static(self, message: Any) -> None:
        self._put_all(message, fixed=True)

    def _put_all(self, message: Any, *, fixed: bool) -> None:
        for item in message.transforms:
            turn = item.transform.rotation
            self._tree.put(item.header.frame_id, item.child_frame_id, (turn.x, turn.y, turn.z, turn.w), fixed=fixed)
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
