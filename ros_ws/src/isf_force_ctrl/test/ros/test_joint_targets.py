"""Targets as joint positions: they lead to the poses that go out beside them, of arms and of a gantry."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from isf_core.errors import ErrorCode
from isf_core.files.rig import load_rig
from isf_msgs.msg import ForceCtrlState
from isf_ros import conversion, qos
from node_cell import JOB, RIG, Cell, small_ring, watched
from trajectory_msgs.msg import JointTrajectory

ARMS = "based_on: kr210_pair\nname: near\npark_height: 25 mm\nprovenance: {park_height: 'assumed'}\n"


@pytest.fixture
def cell() -> Iterator[Cell]:
    with watched(Cell) as found:
        yield found


@pytest.mark.graph
def test_joints_lead_to_the_targets(cell: Cell, tmp_path: Path) -> None:
    (tmp_path / "arms.yaml").write_text(ARMS)
    poses: dict[int, list[tuple[float, float, float]]] = {1: [], 2: []}
    joints: dict[int, list[JointTrajectory]] = {1: [], 2: []}
    for k in (1, 2):

        def keep(message: PoseStamped, k: int = k) -> None:
            at = message.pose.position
            poses[k].append((at.x, at.y, at.z))

        def follow(message: JointTrajectory, k: int = k) -> None:
            if poses[k]:  # of the time before the targets were found nothing can be compared
                joints[k].append(message)

        cell.node.create_subscription(PoseStamped, f"tool_{k}/target", keep, qos.STREAM_SOURCE)
        cell.node.create_subscription(JointTrajectory, f"tool_{k}/joint_trajectory", follow, qos.STREAM_SOURCE)
    cell.start(output="joint_trajectory")
    cell.armed(job=JOB.replace(str(RIG), str(tmp_path / "arms.yaml")))
    result = conversion.result_from_message(cell.form(small_ring()))
    assert (result.completed, result.code) == (True, 0)
    rig = load_rig(str(tmp_path / "arms.yaml"))
    for k in (1, 2):
        arm = rig.arm(k)
        assert arm is not None
        assert len(joints[k]) > 100
        assert all(list(one.joint_names) == ["A1", "A2", "A3", "A4", "A5", "A6"] for one in joints[k])
        assert all(one.points[0].time_from_start.nanosec == 2_000_000 for one in joints[k])
        some = joints[k][:: len(joints[k]) // 50]
        tips, turned = arm.forward(np.array([one.points[0].positions for one in some]))

        def agree(k: int = k, arm: Any = arm) -> bool:
            """The latest of both topics: the tools may be on their way still when the result comes."""
            return bool(
                np.linalg.norm(arm.forward(np.array(joints[k][-1].points[0].positions))[0] - poses[k][-1]) < 1e-6
            )

        assert cell.wait(agree)
        known = np.array(poses[k])
        away = np.array([np.linalg.norm(known - tip, axis=1).min() for tip in tips])
        # a test that is kept waiting misses some poses: the joints beside these lie between their neighbours
        assert np.mean(away < 1e-6) > 0.8
        assert away.max() < 5e-3
        np.testing.assert_allclose(turned[:, 2, 0], -1.0 if k == 1 else 1.0, atol=1e-9)  # both tools point at the sheet
        fastest = np.abs([one.points[0].velocities for one in joints[k]]).max(axis=0)
        assert 0.0 < fastest.max() < np.radians(112)


@pytest.mark.graph
def test_joints_of_a_gantry_are_the_coordinates_of_its_tips(cell: Cell) -> None:
    targets: list[tuple[float, float, float]] = []
    joints: list[JointTrajectory] = []

    def keep(message: PoseStamped) -> None:
        at = message.pose.position
        targets.append((at.x, at.y, at.z))

    cell.node.create_subscription(PoseStamped, "tool_2/target", keep, qos.STREAM_SOURCE)
    cell.node.create_subscription(JointTrajectory, "tool_2/joint_trajectory", joints.append, qos.STREAM_SOURCE)
    cell.start(output="joint_trajectory")
    cell.armed()
    result = conversion.result_from_message(cell.form(small_ring()))
    assert (result.completed, result.code) == (True, 0)
    assert cell.wait(lambda: joints and tuple(joints[-1].points[0].positions) == targets[-1])
    assert list(joints[0].joint_names) == ["tool_2_x", "tool_2_y", "tool_2_z"]
    told = {tuple(one.points[0].positions) for one in joints}
    assert len(told & set(targets)) > 100


@pytest.mark.graph
@pytest.mark.clock
def test_by_the_clock_the_tools_stand_until_controllers_have_heard_where(cell: Cell) -> None:
    targets: list[tuple[float, float, float]] = []
    joints: list[JointTrajectory] = []
    cell.node.create_subscription(
        PoseStamped, "tool_1/target", lambda m: targets.append(conversion.tip_of(m)), qos.STREAM_SOURCE
    )
    cell.node.create_subscription(JointTrajectory, "tool_2/joint_trajectory", lambda _: None, qos.STREAM_SOURCE)
    cell.start({"lockstep": False}, lockstep=False, output="joint_trajectory")
    cell.armed()
    cell.publish(small_ring())
    assert cell.rests_in(ForceCtrlState.APPROACH)
    seen = len(targets)
    assert cell.wait(lambda: len(targets) > seen + 250)  # half a second, in which it would be on its way
    stood = targets[-1]
    np.testing.assert_allclose(targets, [stood] * len(targets), atol=10e-6)
    # the controller of the upper tool, late
    cell.node.create_subscription(JointTrajectory, "tool_1/joint_trajectory", joints.append, qos.STREAM_SOURCE)
    assert cell.wait(lambda: cell.results)
    assert cell.results[-1].code == 0
    assert tuple(joints[0].points[0].positions) == stood
    assert not np.any(joints[0].points[0].velocities)
    assert min(z for _, _, z in targets) < stood[2] - 50e-3


@pytest.mark.graph
@pytest.mark.clock
def test_joints_that_nobody_takes_end_the_contour_by_name(cell: Cell) -> None:
    cell.node.create_subscription(JointTrajectory, "tool_2/joint_trajectory", lambda _: None, qos.STREAM_SOURCE)
    cell.start({"lockstep": False}, lockstep=False, output="joint_trajectory", wrench_timeout=5.0)
    cell.armed()
    result = cell.form(small_ring())
    assert result.code == ErrorCode.NODE_MISSING
    assert "nobody takes tool_1/joint_trajectory" in result.message
