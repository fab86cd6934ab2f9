"""A robot's transforms without a robot, as robot_state_publisher gives them: fixed ones once, moving ones at 50 Hz.

world - sheet and world - base (turned by 90 degrees about z) are fixed, base - wrist - flange move: the wrist turns
about y by the angle in rad that was heard last on ``angle`` (NaN: silence). A cart that nobody asks for moves beside.
"""

from __future__ import annotations

import math

import rclpy
from geometry_msgs.msg import TransformStamped
from isf_ros import process
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import Float64
from tf2_msgs.msg import TFMessage


def transform(parent: str, child: str, axis: str = "z", angle: float = 0.0) -> TransformStamped:
    message = TransformStamped(child_frame_id=child)
    message.header.frame_id = parent
    setattr(message.transform.rotation, axis, math.sin(0.5 * angle))
    message.transform.rotation.w = math.cos(0.5 * angle)
    return message


class Robot(Node):
    def __init__(self) -> None:
        super().__init__("robot")
        fixed = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._angle = math.nan
        self._moving = self.create_publisher(TFMessage, "/tf", QoSProfile(depth=100))
        # two publishers that tell their part once, as a robot and the cell around it are
        self._fixed = [self.create_publisher(TFMessage, "/tf_static", fixed) for _ in range(2)]
        self._fixed[0].publish(TFMessage(transforms=[transform("world", "sheet")]))
        self._fixed[1].publish(TFMessage(transforms=[transform("world", "base", "z", 0.5 * math.pi)]))
        self.create_subscription(Float64, "angle", self._on_angle, 10)
        self.create_timer(0.02, self._notify)

    def _on_angle(self, message: Float64) -> None:
        self._angle = message.data

    def _notify(self) -> None:
        self._moving.publish(TFMessage(transforms=[transform("odom", "cart", "z", 0.1)]))
        if math.isfinite(self._angle):
            turn = transform("base", "wrist", "y", self._angle)
            self._moving.publish(TFMessage(transforms=[transform("wrist", "flange"), turn]))


if __name__ == "__main__":
    ending = process.Ending()
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    process.spin(Robot(), ending)
