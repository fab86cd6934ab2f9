"""Wrenches in axes of their own, over real DDS: names, stamps of zero, what tf does not tell, and who else listens."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
import rclpy
from geometry_msgs.msg import TransformStamped
from isf_core.errors import ErrorCode, IsfError
from isf_ros import qos, stamps
from isf_ros.wrench_axes import WrenchAxes
from tf2_msgs.msg import TFMessage
from waiting import Waiting

pytestmark = pytest.mark.graph

WRENCH = (1.0, 2.0, 3.0, 0.1, 0.2, 0.3)
SECOND = 1_000_000_000


@dataclass
class Bench:
    """The node whose wrenches are turned, and a robot beside it."""

    node: Any
    robot: Any
    waiting: Waiting

    def tell(self, parent: str, child: str, angle: float, stamp: float = 0.0, *, fixed: bool = False) -> None:
        """``child`` turned by ``angle`` rad about z."""
        name = "/tf_static" if fixed else "/tf"
        if not hasattr(self, name):
            setattr(self, name, self.robot.create_publisher(TFMessage, name, qos.TF_STATIC if fixed else qos.TF))
            assert self.waiting.until(lambda: fixed or getattr(self, name).get_subscription_count() > 0)
        transform = TransformStamped(child_frame_id=child)
        transform.header.frame_id, transform.header.stamp = parent, stamps.from_seconds(stamp)
        transform.transform.rotation.z, transform.transform.rotation.w = math.sin(0.5 * angle), math.cos(0.5 * angle)
        getattr(self, name).publish(TFMessage(transforms=[transform]))

    def refusal(self, axes: WrenchAxes, frame: str, stamp: int) -> tuple[ErrorCode, str] | None:
        try:
            axes.turned(frame, stamp, WRENCH)
        except IsfError as error:
            return ErrorCode(error.code), error.what
        return None

    def turns(self, axes: WrenchAxes, frame: str, stamp: int, expected: tuple[float, ...]) -> bool:
        """Wait until the wrench is that."""

        def found() -> bool:
            return self.refusal(axes, frame, stamp) is None and np.allclose(
                axes.turned(frame, stamp, WRENCH), expected, atol=1e-12
            )

        return self.waiting.until(found)


@pytest.fixture
def bench() -> Iterator[Bench]:
    rclpy.init()
    node, robot = rclpy.create_node("turner"), rclpy.create_node("robot")
    waiting = Waiting(node)
    try:
        yield Bench(node, robot, waiting)
    finally:
        waiting.close()
        robot.destroy_node()
        node.destroy_node()
        rclpy.try_shutdown()


QUARTER = (-2.0, 1.0, 3.0, -0.2, 0.1, 0.3)
"""The wrench in a cell that is turned by 90 degrees about z: its x points along y."""


def test_frames_of_a_cell_in_a_namespace_and_slashes_of_old(bench: Bench) -> None:
    axes = WrenchAxes(bench.node, "cell_1/sheet", 0.25)
    assert bench.node.count_subscribers("/tf") == 0  # nobody listens before a wrench asks for it
    code, text = bench.refusal(axes, "/cell_1/ft", SECOND) or (ErrorCode.OK, "")
    assert code is ErrorCode.WRENCH_FRAME
    assert "how frame 'cell_1/ft' stands in 'cell_1/sheet'" in text
    bench.tell("world", "cell_1/sheet", 0.0, fixed=True)
    bench.tell("/world", "/cell_1/ft", 0.5 * math.pi, fixed=True)
    assert bench.turns(axes, "/cell_1/ft", SECOND, QUARTER)
    assert bench.turns(axes, "cell_1/ft", 10_000 * SECOND, QUARTER)  # what is fixed does not grow old
    axes.close()
    assert bench.waiting.until(lambda: bench.node.count_subscribers("/tf") == 0)


def test_a_moving_frame_at_the_stamp_of_the_reading(bench: Bench) -> None:
    axes = WrenchAxes(bench.node, "sheet", 0.25)
    assert bench.refusal(axes, "ft", SECOND)
    bench.tell("sheet", "ft", 0.0, 10.0)
    bench.tell("sheet", "ft", math.pi, 10.2)
    assert bench.turns(axes, "ft", 10_100_000_000, QUARTER)  # halfway between
    assert bench.turns(axes, "ft", 10_400_000_000, (-1.0, -2.0, 3.0, -0.1, -0.2, 0.3))
    code, text = bench.refusal(axes, "ft", 10_460_000_000) or (ErrorCode.OK, "")
    assert code is ErrorCode.POSE_LOST
    assert "0.26 s older than the reading" in text
    bench.tell("sheet", "ft", 0.5 * math.pi, 10.4)
    assert bench.turns(axes, "ft", 10_460_000_000, QUARTER)


def test_stamps_of_zero_are_the_time_of_arrival(bench: Bench) -> None:
    axes = WrenchAxes(bench.node, "sheet", 5.0)
    assert bench.refusal(axes, "ft", 0)
    bench.tell("sheet", "ft", 0.5 * math.pi)
    assert bench.turns(axes, "ft", 0, QUARTER)
    assert bench.turns(axes, "ft", bench.node.get_clock().now().nanoseconds, QUARTER)
