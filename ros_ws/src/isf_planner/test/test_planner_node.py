"""The node ``planner`` in a process of its own: action, cancelling, service, and what it publishes."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import forked_process
import numpy as np
import pytest
import rclpy
from isf_core.errors import ErrorCode
from isf_core.files.job import JobFile, load_job
from isf_msgs.action import PlanPart
from isf_msgs.srv import GetContour
from isf_planner import Plan, plan
from isf_ros import qos
from isf_ros.conversion import contour_from_message, target_from_message
from nav_msgs.msg import Path as PathMessage
from planner_parts import EXAMPLES
from rclpy.action import ActionClient
from rclpy.action.client import ClientGoalHandle
from rclpy.node import Node
from sensor_msgs.msg import PointCloud2
from visualization_msgs.msg import Marker, MarkerArray

pytestmark = pytest.mark.graph

LIMIT = 120.0
"""s; only to end a test that hangs: a process may take long to start."""

JOBS = EXAMPLES / "jobs"
MINI = (JOBS / "mini_cone.yaml").read_text()
ADSIF = re.sub(r"method: \w+", "method: none", re.sub(r"support_force: \S+ N", "support_force: 0 N", MINI)).replace(
    "process: DSIF", "process: ADSIF"
)
LONG = MINI.replace("incremental_depth: 0.5 mm", "incremental_depth: 0.011 mm").replace("name: mini", "name: long")
"""454 contours: many seconds of planning, of which a test waits for the first feedback only."""


class Cell:
    """A planner process and a client of it."""

    def __init__(self, node: Node) -> None:
        self.node = node
        self.plan_part = ActionClient(node, PlanPart, "plan_part")
        self.get_contour = node.create_client(GetContour, "planner/get_contour")
        self.feedback: list[Any] = []

    def spin_until(self, condition: Callable[[], Any], timeout: float = LIMIT) -> None:
        deadline = time.monotonic() + timeout
        while not condition():
            assert time.monotonic() < deadline, "nothing came"
            rclpy.spin_once(self.node, timeout_sec=0.1)

    def done(self, future: Any) -> Any:
        self.spin_until(future.done)
        return future.result()

    def send(self, text: str, folder: Path = JOBS) -> ClientGoalHandle:
        goal = PlanPart.Goal(job_text=text, base_folder=str(folder))
        return self.done(self.plan_part.send_goal_async(goal, lambda message: self.feedback.append(message.feedback)))

    def plan(self, text: str, folder: Path = JOBS) -> PlanPart.Result:
        handle = self.send(text, folder)
        assert handle.accepted
        return self.done(handle.get_result_async()).result

    def contour(self, plan_id: str, index: int) -> GetContour.Response:
        return self.done(self.get_contour.call_async(GetContour.Request(plan_id=plan_id, index=index)))


@pytest.fixture(scope="module")
def cell() -> Iterator[Cell]:
    with forked_process.node("-m", "isf_planner.node", autostart=True, plans_kept=2):
        rclpy.init()
        node = rclpy.create_node("test_planner")
        client = Cell(node)
        try:
            assert client.plan_part.wait_for_server(LIMIT)
            assert client.get_contour.wait_for_service(LIMIT)
            yield client
        finally:
            client.plan_part.destroy()
            node.destroy_node()
            rclpy.try_shutdown()


@pytest.fixture(scope="module")
def core() -> Plan:
    return plan(load_job(JOBS / "mini_cone.yaml"))


def test_contours_over_the_graph_are_those_of_the_core(cell: Cell, core: Plan) -> None:
    result = cell.plan(MINI)
    assert (result.code, result.message, result.count) == (0, "", len(core.contours))
    assert result.plan_id == core.plan_id
    assert tuple(result.warnings) == core.warnings
    for expected in core.contours:
        response = cell.contour(result.plan_id, expected.index)
        assert response.code == 0
        assert response.contour.header.frame_id == "sheet"
        contour = contour_from_message(response.contour)
        for name, value in vars(expected).items():
            np.testing.assert_array_equal(getattr(contour, name), value, err_msg=name)
    cell.spin_until(lambda: cell.feedback)  # it may come after the result
    shares = [item.progress for item in cell.feedback]
    assert shares == sorted(shares)


def test_the_shapes_of_the_stages_come_with_the_target(cell: Cell) -> None:
    staged = MINI.replace("  incremental_depth", "  stages: [30 deg]\n  incremental_depth", 1)
    core = plan(JobFile(staged, JOBS))
    (preform,) = core.preforms
    assert cell.plan(staged).plan_id == core.plan_id
    got: list[PointCloud2] = []
    cell.node.create_subscription(PointCloud2, "part/target", got.append, qos.LATCHED)
    cell.spin_until(lambda: got)
    target, preforms = target_from_message(got[-1])
    np.testing.assert_array_equal(target.z, core.target.z)
    np.testing.assert_array_equal(preforms[0].z, preform.z)


def test_views_are_latched(cell: Cell, core: Plan) -> None:
    cell.plan(MINI)
    got: dict[str, Any] = {}
    for kind, name in (
        (PathMessage, "tool_1/path"),
        (PathMessage, "tool_2/path"),
        (PointCloud2, "part/target"),
        (MarkerArray, "part/markers"),
    ):
        cell.node.create_subscription(kind, name, lambda message, name=name: got.update({name: message}), qos.LATCHED)
    cell.spin_until(lambda: len(got) == 4)
    count = sum(len(contour) for contour in core.contours)
    for name, start in (
        ("tool_1/path", core.contours[0].forming_tip[0]),
        ("tool_2/path", core.contours[0].support_tip[0]),
    ):
        poses = got[name].poses
        assert 0.4 * count <= len(poses) <= 2000
        first = poses[0].pose.position
        assert [first.x, first.y, first.z] == start.tolist()
    target, preforms = target_from_message(got["part/target"])
    np.testing.assert_array_equal(target.z, core.target.z)
    assert preforms == ()
    markers = got["part/markers"].markers
    assert markers[0].action == Marker.DELETEALL
    assert len(markers) == 1 + len(core.contours)
    assert all(marker.type == Marker.LINE_STRIP for marker in markers[1:])
    assert markers[1].points[0] == markers[1].points[-1]


def test_unknown_plan_and_contour(cell: Cell, core: Plan) -> None:
    response = cell.contour("nothing", 0)
    assert response.code == ErrorCode.PLAN_UNKNOWN
    assert "nothing" in response.message
    plan_id = cell.plan(MINI).plan_id
    assert cell.contour(plan_id, len(core.contours)).code == ErrorCode.PLAN_UNKNOWN


@pytest.mark.parametrize(
    ("text", "code"),
    [
        ("name: [", ErrorCode.FILE_SYNTAX),
        (MINI.replace("incremental_depth", "incremental_dept"), ErrorCode.FILE_FIELD),
        (MINI.replace("radius: 5 mm", "radius: 5"), ErrorCode.FILE_UNIT),
        (MINI.replace("mini_cone.stl", "none.stl"), ErrorCode.MESH_UNREADABLE),
        (MINI.replace("process: DSIF", "process: ADSIF"), ErrorCode.FILE_FIELD),
        (ADSIF, ErrorCode.ADSIF_NOT_REACHABLE),
        (MINI.replace("unit: mm", "unit: m"), ErrorCode.MESH_UNIT_SUSPECT),
    ],
)
def test_failures_have_their_code(text: str, code: ErrorCode, cell: Cell) -> None:
    result = cell.plan(text)
    assert result.code == code
    assert result.message
    assert not result.plan_id


def test_cancelling(cell: Cell) -> None:
    cell.feedback.clear()
    handle = cell.send(LONG)
    assert handle.accepted
    cell.spin_until(lambda: any("contour" in item.phase for item in cell.feedback))
    # while it works, a second goal is refused, and the service answers
    assert not cell.send(MINI).accepted
    assert cell.contour("nothing", 0).code == ErrorCode.PLAN_UNKNOWN
    assert cell.done(handle.cancel_goal_async()).goals_canceling
    assert cell.done(handle.get_result_async()).result.code == ErrorCode.PLAN_CANCELLED
    assert cell.plan(MINI).code == 0


def test_the_oldest_plan_is_dropped(cell: Cell) -> None:
    """The node was started with plans_kept = 2."""
    ids = [cell.plan(MINI.replace("name: mini_cone", f"name: part_{k}")).plan_id for k in range(3)]
    assert len(set(ids)) == 3
    assert [cell.contour(plan_id, 0).code for plan_id in ids] == [ErrorCode.PLAN_UNKNOWN, 0, 0]
