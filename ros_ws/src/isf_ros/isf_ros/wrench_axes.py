"""Wrenches of sensors with axes of their own, turned into the axes of the sheet by what robots tell on ``/tf``.

Nobody waits for a transform: what has come by the time of a wrench is used, or the wrench is not. tf is listened to
from the first wrench on that needs it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from isf_core.errors import ErrorCode, IsfError
from isf_core.geometry.frame_tree import FrameTree, Turn
from rclpy.node import Node
from tf2_msgs.msg import TFMessage

from isf_ros import qos, stamps

Wrench = Sequence[float]
"""(6,) N and N m."""


class WrenchAxes:
    """Turns wrenches into axes of ``frame``, for ``node``; transforms on ``/tf`` may be ``oldest`` s older than a
    wrench, or newer, by their stamps. A stamp of zero is the time of arrival."""

    def __init__(self, node: Node, frame: str, oldest: float) -> None:
        self._node, self._frame = node, _plain(frame)
        self._tree = FrameTree(oldest)
        self._turns: dict[str, Turn] = {}
        self._heard: list[Any] = []

    def turned(self, frame: str, stamp: int, wrench: Wrench) -> tuple[float, ...]:
        """``wrench`` (6,) in axes of ``frame``, read at ``stamp`` ns, as (6,) in axes of the sheet. Its moment is still
        that about the origin of ``frame``.

        Raises
        ------
        IsfError : WRENCH_FRAME when the two frames do not hang together; POSE_LOST when a transform is too old
        """
        if _plain(frame) == self._frame:
            return tuple(wrench)
        if not self._heard:
            listen = self._node.create_subscription
            self._heard = [
                listen(TFMessage, "/tf_static", self._on_tf_static, qos.TF_STATIC),
                listen(TFMessage, "/tf", self._on_tf, qos.TF),
            ]
        seconds = stamp / stamps.NANO if stamp else self._now()
        turn = self._turns.get(frame)
        if turn is None or not turn.since <= seconds <= turn.until:
            turn = self._turns[frame] = self._turn(_plain(frame), seconds)
        forces, moments = turn.matrix @ wrench[:3], turn.matrix @ wrench[3:]
        return (*forces.tolist(), *moments.tolist())

    def close(self) -> None:
        """Listen no longer."""
        for subscription in self._heard:
            self._node.destroy_subscription(subscription)
        self._heard = []

    def _turn(self, frame: str, seconds: float) -> Turn:
        try:
            self._tree.way(self._frame, frame)
        except IsfError as error:
            what = f"/tf does not tell how frame '{frame}' stands in '{self._frame}': {error.what}"
            raise IsfError(ErrorCode.WRENCH_FRAME, what) from error
        return self._tree.rotation_at(self._frame, frame, seconds)

    def _on_tf(self, message: Any) -> None:
        self._take(message, fixed=False)

    def _on_tf_static(self, message: Any) -> None:
        self._take(message, fixed=True)

    def _take(self, message: Any, *, fixed: bool) -> None:
        changed = set()
        for item in message.transforms:
            parent, child, turn = item.header.frame_id, item.child_frame_id, item.transform.rotation
            stamp = stamps.to_seconds(item.header.stamp) or self._now()
            self._tree.add(_plain(parent), _plain(child), (turn.x, turn.y, turn.z, turn.w), fixed=fixed, stamp=stamp)
            changed.add(_plain(child))
        self._turns = {frame: turn for frame, turn in self._turns.items() if not turn.links & changed}

    def _now(self) -> float:
        return float(self._node.get_clock().now().nanoseconds) / stamps.NANO


def _plain(frame: str) -> str:
    """Without the slash that names had before tf2."""
    return frame.lstrip("/")
