"""A load cell that turns: its orientation as a transform, an odometry, or from the robot's tf; real DDS."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any
from unittest.mock import patch

import forked_process
import numpy as np
import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped, TransformStamped
from isf_load_cell.node import LoadCellNode
from isf_ros import qos
from nav_msgs.msg import Odometry
from rclpy.lifecycle import TransitionCallbackReturn
from std_msgs.msg import Float64
from test_load_cell_node import NODE, Bench, bench, written  # noqa: F401 - bench is a fixture

pytestmark = pytest.mark.graph

CELL = "calibration_matrix: [[1, 0, 0], [0, 1, 0], [0, 0, 1]]\nrange: 1000\nweight: 40 N\n"
WEIGHT = np.array([0.0, 0.0, -40.0])
ABOUT_Y = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
"""From axes of the cell to those of the sheet when it has turned by 90 degrees about y."""


def reading(turn: np.ndarray, tick: int, load: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> np.ndarray:
    """What a cell reads whose axes stand in the sheet as ``turn`` (3, 3), under its weight and a ``load`` (3,) N."""
    noise = 1e-3 * np.random.default_rng(tick).standard_normal(6)
    return np.concatenate([turn.T @ (WEIGHT + load), np.zeros(3)]) + noise


def tared(bench: Bench, turn: np.ndarray) -> bool:  # noqa: F811
    for _ in range(10):
        bench.send(reading(turn, bench.tick))
    return bool(bench.ask("tare").success)


def felt(bench: Bench, turn: np.ndarray, load: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> np.ndarray:  # noqa: F811
    return np.array(bench.answer(reading(turn, bench.tick, load))[:3])


def turned(kind: str, frame: str, child: str, half_turn: bool) -> Any:
    """A message of ``kind``; ``half_turn``: 90 degrees about y, else none."""
    message: Any = {"pose": PoseStamped, "transform": TransformStamped, "odometry": Odometry}[kind]()
    message.header.frame_id = frame
    if kind != "pose":
        message.child_frame_id = child
    place = message.transform if kind == "transform" else message.pose
    turn = {"transform": "rotation", "pose": "orientation"}.get(kind)
    q = getattr(place, turn) if turn else place.pose.orientation
    q.y = math.sqrt(0.5) if half_turn else 0.0
    q.w = math.sqrt(0.5) if half_turn else 1.0
    return message


@pytest.mark.parametrize("kind", ["transform", "odometry"])
def test_the_weight_is_taken_out_by_the_message_of_a_driver(bench: Bench, tmp_path: Path, kind: str) -> None:  # noqa: F811
    driver = bench.node.create_publisher(type(turned(kind, "", "", half_turn=False)), "arm/state", qos.STREAM)
    options: dict[str, Any] = {"autostart": True, "tare_readings": 10, "timeout": 6.0, "with_pose": True}
    options |= {"pose_type": kind, "pose_frame": "left_flange", "file": written(tmp_path, CELL)}
    bench._stack.enter_context(forked_process.node(*NODE, remap={"pose": "arm/state"}, **options))
    bench.ready(bench.raw)

    def reported(half_turn: bool, frame: str = "sheet", child: str = "left_flange") -> None:
        driver.publish(turned(kind, frame, child, half_turn))
        bench.wait(lambda: False, 0.05)

    def tared_with(child: str) -> bool:
        reported(half_turn=False, child=child)
        return tared(bench, np.eye(3))

    assert not tared_with("right_flange")  # of the other arm
    lost = "nothing is known of frame 'left_flange'"
    assert bench.wait(lambda: bench.shows(reading(np.eye(3), bench.tick), DiagnosticStatus.ERROR, lost))
    assert bench.wait(lambda: tared_with("left_flange"))

    def error() -> float:
        reported(half_turn=True, child="left_flange")
        reported(half_turn=False, child="right_flange")  # not ours
        return float(np.abs(felt(bench, ABOUT_Y, (5.0, 6.0, 70.0)) - [5.0, 6.0, 70.0]).max())

    assert bench.wait(lambda: error() < 0.1)
    reported(half_turn=True, frame="base")
    assert bench.silent(reading(ABOUT_Y, bench.tick))
    other = "comes in frame 'base', not 'sheet'"
    assert bench.wait(lambda: bench.shows(reading(ABOUT_Y, bench.tick), DiagnosticStatus.ERROR, other))
    reported(half_turn=True)
    assert bench.wait(lambda: bench.shows(reading(ABOUT_Y, bench.tick), DiagnosticStatus.OK, "ok"))


def test_the_weight_is_taken_out_by_the_frames_of_a_robot(bench: Bench, tmp_path: Path) -> None:  # noqa: F811
    """Robot in one process, load cell in another: world - sheet, world - base - wrist - flange."""
    angle = bench.node.create_publisher(Float64, "angle", qos.LATCHED)
    options: dict[str, Any] = {"autostart": True, "tare_readings": 10, "timeout": 4.0, "with_pose": True}
    options |= {"pose_type": "tf", "pose_frame": "flange", "file": written(tmp_path, CELL)}
    bench._stack.enter_context(forked_process.node(*NODE, **options))
    bench.ready(bench.raw)
    assert bench.silent(reading(np.eye(3), 0))
    lost = "nothing is known of frame 'flange' and 'sheet'"
    assert bench.wait(lambda: bench.shows(reading(np.eye(3), bench.tick), DiagnosticStatus.ERROR, lost))
    bench._stack.enter_context(forked_process.node(str(Path(__file__).with_name("standin_robot.py"))))
    about_z = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    assert bench.wait(lambda: angle.get_subscription_count())

    def turned_to(radians: float) -> np.ndarray:
        angle.publish(Float64(data=radians))
        c, s = math.cos(radians), math.sin(radians)
        return about_z @ np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])

    start = turned_to(0.0)
    assert bench.wait(lambda: tared(bench, start))
    load = (5.0, 6.0, 70.0)
    for radians in (0.5 * math.pi, -0.7):
        turn = turned_to(radians)
        assert bench.wait(lambda turn=turn: np.abs(felt(bench, turn, load) - load).max() < 0.1)

    # The robot's driver stops: the last orientation counts no more, and which one is missing is told.
    angle.publish(Float64(data=math.nan))
    assert bench.wait(
        lambda: bench.shows(reading(turn, bench.tick), DiagnosticStatus.ERROR, "stands in 'wrist' is more than 4 s old")
    )
    assert bench.silent(reading(turn, bench.tick))
    turned_to(-0.7)
    assert bench.wait(lambda: bench.shows(reading(turn, bench.tick), DiagnosticStatus.OK, "ok"))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"pose_type": "tf", "with_pose": True}, ("parameter pose_frame", "no frame is named")),
        ({"pose_type": "vicon", "with_pose": True}, ("parameter pose_type", "none of pose, transform, odometry, tf")),
        ({"pose_type": "transform"}, ("parameter with_pose", "mean nothing without it")),
        ({"pose_frame": "tool0"}, ("parameter with_pose", "mean nothing without it")),
    ],
)
def test_what_cannot_be_used_is_reported(tmp_path: Path, options: dict[str, Any], words: tuple[str, ...]) -> None:
    assert all(word in refusal(tmp_path, options) for word in ("1003 FILE_FIELD", *words))


def test_a_ros_without_tf2_says_what_to_install(tmp_path: Path) -> None:
    with patch.dict("sys.modules", {"tf2_msgs": None, "tf2_msgs.msg": None}):
        text = refusal(tmp_path, {"pose_type": "tf", "pose_frame": "tool0", "with_pose": True})
    assert "tf2_msgs is not installed" in text
    assert "apt install ros-jazzy-tf2-msgs" in text


def refusal(folder: Path, options: dict[str, Any]) -> str:
    """What the node says when it cannot be configured with ``options``."""
    arguments = ["--ros-args", "-p", f"file:={written(folder, CELL)}"]
    for name, value in options.items():
        arguments += ["-p", f"{name}:={str(value).lower() if isinstance(value, bool) else value}"]
    rclpy.init(args=arguments)
    try:
        node = LoadCellNode()
        assert node.trigger_configure() == TransitionCallbackReturn.FAILURE
        text = node._text
        node.destroy_node()
    finally:
        rclpy.try_shutdown()
    return text
