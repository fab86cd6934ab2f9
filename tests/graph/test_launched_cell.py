"""What the launch file starts, started: a part on nine voltages each in a namespace, watched as viewers watch it.

The layouts of isf_description are held against this cell and its bag: every topic and field that they name is there.
"""

from __future__ import annotations

import json
import math
import os
import signal
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import forked_process
import launch_standin
import numpy as np
import pytest
import rclpy
import yaml
from geometry_msgs.msg import PoseStamped, WrenchStamped
from isf_core.files.yaml_file import find_named
from isf_msgs.action import FormPart
from isf_ros import qos
from isf_ros.stamps import to_nanoseconds
from quick_cone import quick_cone
from rclpy.action import ActionClient
from rosbags.highlevel import AnyReader
from rosbags.interfaces import Nodetype
from rosbags.typesys.store import Typestore
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from tf2_msgs.msg import TFMessage
from waiting import LIMIT, Waiting

sys.path.append(str(Path(__file__).resolve().parents[2] / "ros_ws" / "src" / "isf_description" / "test"))
from urdf_reading import Urdf

pytestmark = pytest.mark.graph

SOURCES = Path(__file__).resolve().parents[2] / "ros_ws" / "src"
LAYOUTS = SOURCES / "isf_description" / "layouts"
CELL = "/cell_1"


@dataclass
class Seen:
    """What came while the part was formed, by topic; and the graph as it was."""

    poses: dict[int, dict[int, tuple[float, float, float]]] = field(default_factory=lambda: {1: {}, 2: {}})
    states: list[JointState] = field(default_factory=list)
    frames: set[tuple[str, int]] = field(default_factory=set)
    urdf: str = ""
    wrenches: int = 0
    topics: dict[str, list[str]] = field(default_factory=dict)
    bag: Path = Path()
    result: Any = None
    codes: dict[str, int] = field(default_factory=dict)


def job_of(folder: Path) -> Path:
    """The quick cone on a rig whose tools hang on three tri-axial cells each."""
    cells = yaml.safe_load(find_named("rigs", "torrao2013").read_text())["tool_1"]["spindle_cells"]
    below = {**cells, "rotation": ["180 deg", "0 deg", "0 deg"]}
    rig = {
        "based_on": "ren2018",
        "name": "spindle_cells",
        "tool_1": {"spindle_cells": cells},
        "tool_2": {"spindle_cells": below},
    }
    (folder / "rig.yaml").write_text(yaml.safe_dump(rig))
    text = quick_cone().text.replace("rig: ren2018", "rig: rig.yaml")
    path = folder / "cone.yaml"
    path.write_text(text.replace("../parts", str(SOURCES.parents[1] / "examples" / "parts")))
    return path


@pytest.fixture(scope="module")
def seen(tmp_path_factory: pytest.TempPathFactory) -> Seen:
    folder = tmp_path_factory.mktemp("launched")
    job = job_of(folder)
    found = Seen(bag=folder / "bag")
    with pytest.MonkeyPatch.context() as patch:
        names = launch_standin.load(SOURCES / "isf_cell" / "launch" / "cell.launch.py", patch)
        actions, context = launch_standin.perform(
            names, job=str(job), namespace=CELL, record=str(found.bag), log_level="warn"
        )
    lines = {
        name: launch_standin.command(node, context, folder) for name, node in launch_standin.nodes(actions).items()
    }
    assert {"load_cell_1", "load_cell_2"} <= set(lines)
    goal = yaml.safe_load(actions[-1].keywords["cmd"][-1])
    rclpy.init()
    node = rclpy.create_node("viewer", namespace=CELL)
    waiting = Waiting(node)
    processes: dict[str, forked_process.Process] = {}
    try:
        listen(node, found)
        for name, line in lines.items():
            processes[name] = forked_process.start([sys.executable, *line], start_new_session=True)
        client = ActionClient(node, FormPart, "form_part")
        assert waiting.until(client.server_is_ready)
        assert waiting.until(lambda: node.count_subscribers("joint_states") == 2)  # the recorder, too
        sent = client.send_goal_async(FormPart.Goal(**goal))
        assert waiting.until(sent.done)
        result = sent.result().get_result_async()
        assert waiting.until(result.done, 3 * LIMIT)
        found.result = result.result().result
        found.topics = dict(node.get_topic_names_and_types())
        client.destroy()
    finally:
        for process in processes.values():
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGINT)
        found.codes = {name: process.wait(LIMIT) for name, process in processes.items()}
        waiting.close()
        node.destroy_node()
        rclpy.try_shutdown()
    return found


def listen(node: Any, found: Seen) -> None:
    def on_pose(k: int, message: PoseStamped) -> None:
        here = message.pose.position
        found.poses[k][to_nanoseconds(message.header.stamp)] = (here.x, here.y, here.z)

    def on_tf(message: TFMessage) -> None:
        found.frames |= {(item.child_frame_id, to_nanoseconds(item.header.stamp)) for item in message.transforms}

    def on_wrench(_: WrenchStamped) -> None:
        found.wrenches += 1

    for k in (1, 2):
        node.create_subscription(PoseStamped, f"tool_{k}/pose", lambda m, k=k: on_pose(k, m), qos.SENSOR)
    node.create_subscription(TFMessage, "tf", on_tf, qos.TF)
    node.create_subscription(JointState, "joint_states", found.states.append, 10_000)
    node.create_subscription(String, "robot_description", lambda m: setattr(found, "urdf", m.data), qos.LATCHED)
    node.create_subscription(WrenchStamped, "tool_1/tip_wrench", on_wrench, qos.SENSOR)


def test_the_part_is_formed_and_every_node_ends_well(seen: Seen) -> None:
    assert (seen.result.code, seen.result.message) == (0, "")
    assert set(seen.codes.values()) == {0}, seen.codes


def test_the_description_follows_the_tools_over_the_part(seen: Seen) -> None:
    """Joint states put the tips of the URDF where the poses of the same stamp are; frames have these stamps."""
    urdf = Urdf(seen.urdf)
    worst, compared = 0.0, 0
    for state in seen.states:
        stamp = to_nanoseconds(state.header.stamp)
        positions = dict(zip(state.name, state.position, strict=True))
        for k in {int(name[5]) for name in positions}:
            if stamp not in seen.poses[k]:
                continue
            placed = urdf.transform("sheet", f"tool_{k}", positions)[:3, 3]
            worst = max(worst, float(np.abs(placed - seen.poses[k][stamp]).max()))
            compared += 1
    assert compared > 50
    assert worst < 1e-6
    assert {name for name, _ in seen.frames} >= {"tool_1_ram", "tool_2_ram"}
    assert {stamp for _, stamp in seen.frames} <= {to_nanoseconds(state.header.stamp) for state in seen.states}
    assert seen.wrenches > 0


def test_rviz_finds_every_topic_of_its_layout(seen: Seen) -> None:
    layout = yaml.safe_load((LAYOUTS / "cell.rviz").read_text())["Visualization Manager"]
    kinds = {
        "Path": "nav_msgs/msg/Path",
        "Marker": "visualization_msgs/msg/Marker",
        "MarkerArray": "visualization_msgs/msg/MarkerArray",
        "Wrench": "geometry_msgs/msg/WrenchStamped",
        "RobotModel": "std_msgs/msg/String",
    }
    asked = 0
    for display in layout["Displays"]:
        topic = display.get("Topic", display.get("Description Topic"))
        if topic is not None:
            kind = kinds[display["Class"].removeprefix("rviz_default_plugins/")]
            assert seen.topics[f"{CELL}/{topic['Value']}"] == [kind], topic["Value"]
            asked += 1
    assert asked == 8
    urdf = Urdf(seen.urdf)
    assert layout["Global Options"]["Fixed Frame"] in urdf.links
    (frames,) = [display["Frames"] for display in layout["Displays"] if display["Class"].endswith("/TF")]
    assert set(frames) - {"All Enabled"} <= set(urdf.links)


@dataclass
class Recorded:
    """Topics of a bag, without the namespace, to their types; and these as the bag itself defines them."""

    kinds: dict[str, str]
    types: Typestore

    def follows(self, kind: str, fields: list[str]) -> bool:
        """Whether messages of type ``kind`` have the field that ``fields`` lead to."""
        for name in fields:
            below = dict(self.types.fielddefs[kind][1]).get(name)
            if below is None:
                return False
            kind = str(below[1]) if below[0] == Nodetype.NAME else ""
        return True


@pytest.fixture(scope="module")
def bag(seen: Seen) -> Recorded:
    with AnyReader([seen.bag]) as reader:
        kinds = {item.topic.removeprefix(CELL): item.msgtype for item in reader.connections}
        return Recorded(kinds, reader.typestore)


def test_foxglove_finds_every_topic_and_field_in_the_bag(seen: Seen, bag: Recorded) -> None:
    panels = json.loads((LAYOUTS / "cell_foxglove.json").read_text())["configById"]
    paths = [path["value"] for panel in panels.values() for path in panel.get("paths", [])]
    paths += [panel["topicPath"] for panel in panels.values() if "topicPath" in panel]
    paths += [panel["topicToRender"] for panel in panels.values() if "topicToRender" in panel]
    assert len(paths) > 15
    for path in paths:
        topic, *fields = path.split(".")
        assert bag.follows(bag.kinds[topic], fields), path
    scene = panels["3D!cell"]
    shown = {topic for topic, settings in scene["topics"].items() if settings["visible"]}
    assert shown <= set(bag.kinds)  # who opens the bag sees what a viewer of the running cell sees
    assert {"/tf", "/tf_static"} <= set(bag.kinds)
    assert set(scene["topics"]) <= {topic.removeprefix(CELL) for topic in seen.topics}
    assert {scene["followTf"], scene["layers"]["floor"]["frameId"]} <= set(Urdf(seen.urdf).links)


def test_plotjuggler_finds_every_curve_in_the_bag(bag: Recorded) -> None:
    curves = [item.attrib["name"] for item in ElementTree.parse(LAYOUTS / "cell_plotjuggler.xml").iter("curve")]
    assert len(curves) > 20
    for curve in curves:
        topic = next(name for name in bag.kinds if curve.startswith(f"{name}/"))
        assert bag.follows(bag.kinds[topic], curve.removeprefix(f"{topic}/").split("/")), curve


def test_forces_of_the_nine_voltages_hold_the_set_point(seen: Seen) -> None:
    assert not math.isnan(seen.result.sim_time)
    assert seen.result.contours == 3
