"""Node cell_state_publisher in a process of its own, and a driver that knows nothing of it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import forked_process
import numpy as np
import pytest
import rclpy
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, TransformStamped, WrenchStamped
from isf_core.geometry.height_map import HeightMap
from isf_msgs.msg import Contour, JobInfo, MachineState
from isf_ros import conversion, qos
from isf_ros.stamps import to_nanoseconds
from nav_msgs.msg import Path as PathMessage
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import JointState, PointCloud2
from std_msgs.msg import String
from tf2_msgs.msg import TFMessage
from urdf_reading import Urdf
from visualization_msgs.msg import Marker
from waiting import Waiting

pytestmark = pytest.mark.graph

EXAMPLES = Path(__file__).resolve().parents[4] / "examples" / "jobs"


class Viewer:
    """Driver, executive and viewer in one: publishes what they do and keeps what comes."""

    def __init__(self) -> None:
        self.node = rclpy.create_node("viewer")
        self.wait = Waiting(self.node).until
        self.frames: dict[tuple[str, int], Any] = {}
        self.fixed: dict[str, Any] = {}
        self.states: list[JointState] = []
        self.urdf: list[str] = []
        self.sheets: list[Marker] = []
        self.paths: list[PathMessage] = []
        self.wrenches: list[WrenchStamped] = []
        self.health: dict[str, str] = {}
        make = self.node.create_publisher
        self.poses = [make(PoseStamped, f"tool_{k}/pose", qos.SENSOR) for k in (1, 2)]
        self.force = make(WrenchStamped, "tool_1/wrench", qos.STREAM_SOURCE)
        self.info = make(JobInfo, "part/info", qos.LATCHED)
        self.state = make(MachineState, "machine/state", qos.STREAM)
        self.scan = make(PointCloud2, "scan", qos.LATCHED)
        self.contour = make(Contour, "contour/corrected", qos.LATCHED)
        hear = self.node.create_subscription
        hear(TFMessage, "/tf", self._on_tf, qos.TF)
        hear(TFMessage, "/tf_static", self._on_static, qos.TF_STATIC)
        hear(JointState, "joint_states", self.states.append, 10)
        hear(String, "robot_description", lambda message: self.urdf.append(message.data), qos.LATCHED)
        hear(Marker, "part/sheet", self.sheets.append, qos.LATCHED)
        hear(PathMessage, "contour/path", self.paths.append, qos.LATCHED)
        hear(DiagnosticArray, "/diagnostics", self._on_health, 10)

    def _on_tf(self, message: TFMessage) -> None:
        for item in message.transforms:
            self.frames[item.child_frame_id, to_nanoseconds(item.header.stamp)] = item

    def _on_static(self, message: TFMessage) -> None:
        self.fixed.update({item.child_frame_id: item for item in message.transforms})

    def _on_health(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name.endswith("cell_state_publisher"):
                self.health = {"text": status.message, **{item.key: item.value for item in status.values}}

    def job(self, name: str) -> None:
        path = EXAMPLES / f"{name}.yaml"
        self.info.publish(JobInfo(job_text=path.read_text(), base_folder=str(path.parent), job_name=name, plan_id=name))

    def pose(self, k: int, tip: tuple[float, float, float], stamp: Time, frame: str = "sheet") -> None:
        message = conversion.make_pose()
        conversion.set_tip(message, tip)
        message.header.frame_id, message.header.stamp = frame, stamp
        self.poses[k - 1].publish(message)

    def streamed(self, send: Callable[[], None], condition: Callable[[], Any]) -> bool:
        """As ``wait``, while ``send`` goes on: poses are sent best effort, and lost while the graph is being found."""
        return self.wait(lambda: condition() or send())

    def place(self, frame: str, stamp: Time, top: str) -> np.ndarray:
        """(4, 4) of ``frame`` in ``top``, from the transforms alone."""
        result = np.eye(4)
        while frame != top:
            item = self.fixed.get(frame) or self.frames[frame, to_nanoseconds(stamp)]
            moved, turned, step = item.transform.translation, item.transform.rotation, np.eye(4)
            step[:3, 3] = moved.x, moved.y, moved.z
            step[:3, :3] = Rotation.from_quat([turned.x, turned.y, turned.z, turned.w]).as_matrix()
            result, frame = step @ result, item.header.frame_id
        return result


@contextmanager
def publisher(**parameters: object) -> Iterator[Viewer]:
    rclpy.init()
    viewer = Viewer()
    try:
        with forked_process.node("-m", "isf_description.node", autostart=True, **parameters):
            assert viewer.wait(lambda: viewer.health.get("state") == "active")
            yield viewer
    finally:
        viewer.node.destroy_node()
        rclpy.try_shutdown()


def test_a_cell_under_any_driver_is_seen() -> None:
    with publisher(lockstep=False, frame_prefix="cell_1/") as viewer:
        assert not viewer.urdf  # nothing is known of the cell
        viewer.job("ren_cone")
        assert viewer.wait(lambda: viewer.urdf and viewer.sheets)
        urdf = Urdf(viewer.urdf[-1])
        assert viewer.sheets[-1].type == Marker.CUBE  # the flat blank
        assert viewer.sheets[-1].scale.x == 0.25

        # Frames: stamps of the poses, places to the last bit that the messages hold.
        stamp = Time(sec=7, nanosec=20_000_000)
        tips = ((0.031, -0.02, -0.0123456), (0.037, -0.021, -0.0141))
        ns = to_nanoseconds(stamp)

        def stream() -> None:
            for k, tip in zip((1, 2), tips, strict=True):
                viewer.pose(k, tip, stamp)

        assert viewer.streamed(stream, lambda: {(f"cell_1/tool_{k}_ram", ns) for k in (1, 2)} <= set(viewer.frames))
        positions: dict[str, float] = {}
        assert viewer.wait(lambda: sum(len(state.name) for state in viewer.states if state.header.stamp == stamp) == 6)
        for state in viewer.states:
            positions |= dict(zip(state.name, state.position, strict=True))
        for k, tip in zip((1, 2), tips, strict=True):
            placed = viewer.place(f"cell_1/tool_{k}", stamp, "cell_1/sheet")
            np.testing.assert_allclose(placed[:3, 3], tip, atol=1e-12)
            np.testing.assert_allclose(urdf.transform("sheet", f"tool_{k}", positions)[:3, 3], tip, atol=1e-9)
        np.testing.assert_allclose(viewer.place("cell_1/sheet", stamp, "cell_1/clamp")[:3, 3], [0.0, 0.0, 1e-3])
        assert all(name.startswith("cell_1/") for name in viewer.fixed)

        # Nothing moves any more, as after a part: who begins to look sees the cell all the same.
        late: list[TFMessage] = []
        looking = viewer.node.create_subscription(TFMessage, "/tf", late.append, qos.TF)
        assert viewer.wait(lambda: {"cell_1/tool_1_ram", "cell_1/tool_2_ram"} <= _children(late))
        viewer.node.destroy_subscription(looking)

        # A driver that leaves stamps at zero: the time of arrival. A pose that is no news is not sent again.
        before, sent = viewer.node.get_clock().now().nanoseconds, len(viewer.states)
        viewer.pose(1, tips[0], stamp)
        viewer.pose(2, tips[0], Time())
        assert viewer.wait(lambda: len(viewer.states) > sent)
        assert len(viewer.states) == sent + 1
        assert to_nanoseconds(viewer.states[-1].header.stamp) >= before

        # Another frame: told with its name, once, and over with the next good pose.
        viewer.pose(1, tips[0], Time(sec=8), frame="robot_base")
        assert viewer.wait(lambda: "'robot_base', not 'sheet'" in viewer.health["text"])
        viewer.pose(1, tips[0], Time(sec=9))
        assert viewer.wait(lambda: viewer.health["text"] == "ok")
        assert ("cell_1/tool_1_ram", 8_000_000_000) not in viewer.frames

        # Wrenches only while somebody looks, at the tip, thinned.
        assert viewer.node.count_subscribers("tool_1/wrench") == 0
        looking = viewer.node.create_subscription(
            WrenchStamped, "tool_1/tip_wrench", viewer.wrenches.append, qos.SENSOR
        )
        assert viewer.wait(lambda: viewer.node.count_subscribers("tool_1/wrench") == 1)
        wrench = conversion.make_wrench()
        wrench.wrench.force.z = 340.0

        def heard() -> bool:
            viewer.force.publish(wrench)
            return len(viewer.wrenches) > 1

        assert viewer.wait(heard)
        assert (viewer.wrenches[-1].header.frame_id, viewer.wrenches[-1].wrench.force.z) == ("cell_1/tool_1", 340.0)

        # In axes that are not those of the sheet: told, and not shown as if they were.
        wrench.header.frame_id, wrench.wrench.force.z = "ft_sensor", 1.0
        viewer.wrenches.clear()

        def refused() -> bool:
            viewer.force.publish(wrench)
            return "1211 WRENCH_FRAME" in viewer.health["text"] and "'ft_sensor'" in viewer.health["text"]

        assert viewer.wait(refused)
        assert viewer.wrenches == []

        # Until tf tells how the sensor stands: its z is -y of the sheet.
        told = viewer.node.create_publisher(TFMessage, "/tf_static", qos.TF_STATIC)
        stands = TransformStamped(child_frame_id="ft_sensor")
        stands.header.frame_id = "cell_1/sheet"
        stands.transform.rotation.x = stands.transform.rotation.w = math.sqrt(0.5)
        told.publish(TFMessage(transforms=[stands]))

        def turned() -> bool:
            viewer.force.publish(wrench)
            return bool(viewer.wrenches)

        assert viewer.wait(turned)
        force = viewer.wrenches[-1].wrench.force
        np.testing.assert_allclose([force.x, force.y, force.z], [0.0, -1.0, 0.0], atol=1e-12)
        viewer.wrenches.clear()
        wrench.header.frame_id, wrench.wrench.force.z = "sheet", 2.0
        assert viewer.wait(lambda: heard() and viewer.health["text"] == "ok")
        assert 1.0 not in {message.wrench.force.z for message in viewer.wrenches}
        viewer.node.destroy_subscription(looking)
        assert viewer.wait(lambda: viewer.node.count_subscribers("tool_1/wrench") == 0)

        # The scanned sheet, and the contour that is formed.
        axis = np.linspace(-0.1, 0.1, 61)
        heights = np.where(np.hypot(*np.meshgrid(axis, axis)) < 0.05, -0.02, 0.0)
        viewer.scan.publish(conversion.height_map_to_message(HeightMap(axis, axis, heights), stamp))
        tip_path = np.column_stack([np.linspace(0.0, 0.05, 1200), np.zeros(1200), np.full(1200, -0.005)])
        viewer.contour.publish(Contour(plan_id="p", process=1, forming_tool=1, **contour_fields(tip_path)))
        assert viewer.wait(lambda: viewer.paths and viewer.sheets[-1].type == Marker.TRIANGLE_LIST)
        sheet, path = viewer.sheets[-1], viewer.paths[-1]
        assert (sheet.header.frame_id, path.header.frame_id) == ("cell_1/sheet", "cell_1/sheet")
        assert 3 * 2000 < len(sheet.points) == len(sheet.colors) < 3 * 2 * 60**2
        assert {round(point.z, 6) for point in sheet.points} >= {-0.02, 0.0}
        assert 400 <= len(path.poses) <= 500
        assert path.poses[-1].pose.position.z == -0.005

        # A driver that knows of the prefix writes it itself.
        scan = conversion.height_map_to_message(HeightMap(axis, axis, heights), Time(sec=8))
        scan.header.frame_id = "cell_1/sheet"
        viewer.scan.publish(scan)
        assert viewer.wait(lambda: viewer.sheets[-1].header.stamp.sec == 8)
        assert viewer.sheets[-1].header.frame_id == "cell_1/sheet"

        # The next part is on another rig, with a blank holder that comes down.
        viewer.job("tpif_cone")
        assert viewer.wait(lambda: "tpif_cone" in viewer.urdf[-1] and viewer.sheets[-1].type == Marker.CUBE)
        stamp = Time(sec=20)

        def lowered() -> bool:
            stamp.sec += 1
            viewer.state.publish(MachineState(holder_height=-0.012))
            viewer.pose(1, tips[0], stamp)
            names = dict(zip(viewer.states[-1].name, viewer.states[-1].position, strict=True))
            return names.get("blank_holder") == -0.012

        assert viewer.wait(lowered)
        assert "tool_2_x" not in viewer.states[-1].name


def _children(messages: list[TFMessage]) -> set[str]:
    return {item.child_frame_id for message in messages for item in message.transforms}


def contour_fields(tips: np.ndarray) -> dict[str, Any]:
    count = len(tips)
    return {
        "contact": tips.ravel().tolist(),
        "normal": np.tile([0.0, 0.0, 1.0], count).tolist(),
        "wall_angle": [0.5] * count,
        "thickness": [1e-3] * count,
        "forming_tip": tips.ravel().tolist(),
        "feed": 0.03,
        "count": 1,
    }


def test_a_hexapod_without_tf_for_robot_state_publisher_and_a_job_that_is_none() -> None:
    """Tilted poses; the parameter rig; frames left to robot_state_publisher; what is no job is told."""
    with publisher(rig="torrao2013", publish_tf=False) as viewer:
        assert viewer.wait(lambda: viewer.urdf)
        message = conversion.make_pose()
        conversion.set_tip(message, (0.02, 0.01, -0.03))
        turn = Rotation.from_euler("xyz", [0.1, -0.2, 0.0])  # Ry Rx
        (
            message.pose.orientation.x,
            message.pose.orientation.y,
            message.pose.orientation.z,
            message.pose.orientation.w,
        ) = turn.as_quat().tolist()
        # stamp zero: the first tick in lockstep
        assert viewer.streamed(lambda: viewer.poses[0].publish(message), lambda: viewer.states)
        assert to_nanoseconds(viewer.states[0].header.stamp) == 0
        positions = dict(zip(viewer.states[0].name, viewer.states[0].position, strict=True))
        placed = Urdf(viewer.urdf[0]).transform("sheet", "tool_1", positions)
        np.testing.assert_allclose(placed[:3, :3], turn.as_matrix(), atol=1e-9)
        lowest = placed[:3, 3] + 5e-3 * (placed[:3, 2] - [0.0, 0.0, 1.0])  # of the ball
        np.testing.assert_allclose(lowest, [0.02, 0.01, -0.03], atol=1e-9)
        assert len(positions) == 5 + 6 * 3
        assert not viewer.frames
        assert not viewer.fixed
        viewer.info.publish(JobInfo(job_text="name: [", plan_id="broken"))
        assert viewer.wait(lambda: "1002 FILE_SYNTAX" in viewer.health["text"])
        assert viewer.health["state"] == "active"
