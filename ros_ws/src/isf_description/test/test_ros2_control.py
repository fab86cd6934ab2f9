"""What ros2_control reads of a cell: tags and keys against its sources, positions against another reader of URDF.

The lists below are from the sources, not from a running controller_manager: hardware_interface's component_parser,
joint_state_topic_hardware_interface 1.0.0, and the parameter files of ros2_controllers 4.40 (Jazzy).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import load_job
from isf_core.files.rig import load_rig
from isf_core.geometry.tool_joints import ToolJoints
from isf_description.cell import describe
from isf_description.joints import tool_positions
from isf_description.ros2_control import ControlBlock, controllers
from isf_description.urdf import to_urdf
from urdf_reading import Urdf

EXAMPLES = Path(__file__).resolve().parents[4] / "examples" / "jobs"
RIGS = ("ren2018", "kr210_arm", "kr210_pair", "torrao2013")
BALL = 5e-3

SYSTEM = {"hardware", "joint", "sensor", "gpio", "transmission"}
COMPONENT = {
    "joint_commands_topic",
    "joint_states_topic",
    "trigger_joint_command_threshold",
    "sum_wrapped_joint_states",
}
COMMAND, STATE = {"min", "max", "initial_value"}, {"initial_value"}
TRAJECTORY = {
    "joints", "command_joints", "command_interfaces", "state_interfaces", "allow_partial_joints_goal",
    "interpolate_from_desired_state", "allow_integration_in_goal_trajectories", "action_monitor_rate",
    "set_last_command_interface_value_as_state_on_activation", "interpolation_method",
    "allow_nonzero_velocity_at_trajectory_end", "cmd_timeout", "gains", "constraints", "speed_scaling",
}  # fmt: skip
CONSTRAINTS = {"stopped_velocity_tolerance", "goal_time", "decelerate_on_cancel"}
BROADCASTER = {
    "use_local_topics", "joints", "extra_joints", "interfaces", "map_interface_to_joint_state", "use_urdf_to_filter",
}  # fmt: skip
TYPES = {"joint_state_broadcaster/JointStateBroadcaster", "joint_trajectory_controller/JointTrajectoryController"}


def block_of(name: str, namespace: str = "/") -> tuple[Urdf, ControlBlock]:
    rig = load_rig(name)
    made = describe(rig)
    block = ControlBlock.of(rig, made, BALL, namespace)
    return Urdf(to_urdf(made, block)), block


@pytest.mark.parametrize("name", RIGS)
def test_the_block_has_the_tags_and_parameters_of_the_component(name: str) -> None:
    urdf, block = block_of(name, "/cell_1")
    (system,) = urdf.robot.findall("ros2_control")
    assert system.attrib == {"name": "isf_machine", "type": "system"}
    assert {child.tag for child in system} <= SYSTEM
    (hardware,) = system.findall("hardware")
    assert hardware.findtext("plugin") == "joint_state_topic_hardware_interface/JointStateTopicSystem"
    known = {item.attrib["name"]: item.text or "" for item in hardware.findall("param")}
    assert set(known) <= COMPONENT
    assert known["joint_commands_topic"] == "/cell_1/machine/joint_commands"
    assert known["joint_states_topic"] == "/cell_1/machine/joint_states"
    assert float(known["trigger_joint_command_threshold"]) < 0.0
    names = []
    for joint in system.findall("joint"):
        names.append(joint.attrib["name"])
        (command,) = joint.findall(
            "command_interface"
        )  # every joint has one: names and positions are lists of one size
        assert command.attrib["name"] == "position"
        bounds = {item.attrib["name"]: float(item.text or "nan") for item in command.findall("param")}
        assert set(bounds) <= COMMAND
        position, velocity = joint.findall("state_interface")
        assert (position.attrib["name"], velocity.attrib["name"]) == ("position", "velocity")
        first = {item.attrib["name"]: float(item.text or "nan") for item in position.findall("param")}
        assert set(first) == STATE
        assert bounds["min"] < first["initial_value"] < bounds["max"]
        assert (bounds["min"], bounds["max"]) == urdf.limits(names[-1])
    assert names == [joint for joints in block.tools.values() for joint in joints]


@pytest.mark.parametrize("name", RIGS)
def test_the_parameter_file_has_the_keys_of_the_controllers(name: str) -> None:
    urdf, block = block_of(name)
    found: dict[str, Any] = yaml.safe_load(controllers(block.tools, 440.0))
    nodes = {key.removeprefix("/**/"): value["ros__parameters"] for key, value in found.items()}
    manager = nodes.pop("controller_manager")
    assert manager.pop("update_rate") == 440
    assert set(manager) == set(nodes) == {"joint_state_broadcaster", "tool_1", "tool_2"}
    assert {about["type"] for about in manager.values()} == TYPES
    assert set(nodes.pop("joint_state_broadcaster")) <= BROADCASTER
    for values in nodes.values():
        assert set(values) <= TRAJECTORY
        assert set(values["constraints"]) <= CONSTRAINTS | set(values["joints"])
        assert values["command_interfaces"] == ["position"]
        assert values["state_interfaces"] == ["position", "velocity"]
        assert values["allow_nonzero_velocity_at_trajectory_end"] is True
        assert values["interpolate_from_desired_state"] is True
        assert set(values["joints"]) <= set(urdf.joints)


def test_what_ros2_control_cannot_do_is_refused() -> None:
    job = load_job(EXAMPLES / "tpif_cone.yaml")
    with pytest.raises(IsfError, match="blank holder") as caught:
        ControlBlock.of(job.rig, describe(job.rig, job), BALL)
    assert caught.value.code == ErrorCode.FILE_FIELD
    with pytest.raises(IsfError, match=r"whole numbers of Hz, not at 312\.5"):
        controllers({1: ("tool_1_x",)}, 312.5)
    spif = load_job(EXAMPLES / "spif_cone.yaml")
    assert set(ControlBlock.of(spif.rig, describe(spif.rig, spif), BALL).tools) == {1}


@pytest.mark.parametrize("name", RIGS)
def test_joints_put_the_tool_where_it_is_to_be(name: str) -> None:
    """By the URDF, read by other code: the tip of an upright tool, and the axis of one that is tilted."""
    rig = load_rig(name)
    urdf, _ = block_of(name)
    random = np.random.default_rng(1)
    for number in (1, 2):
        joints = ToolJoints.of(rig, number, BALL)
        tiltable = number == 1 and rig.largest_tilt > 0.0
        for _ in range(10):
            tip = random.uniform(-0.04, 0.04, 3)
            axis = np.array([*random.uniform(-0.12, 0.12, 2), 1.0]) if tiltable else np.array([0.0, 0.0, 1.0])
            axis /= np.linalg.norm(axis)
            positions = dict(zip(joints.names, joints.positions(tip, tuple(axis)).tolist(), strict=True))
            back, leaning = joints.pose(list(positions.values()))
            np.testing.assert_allclose(back, tip, atol=1e-9)
            np.testing.assert_allclose(leaning, axis, atol=1e-9)
            if name == "torrao2013" and number == 1:  # the description has the pose itself, and the legs beside it
                x, y, z = axis
                turn = np.array([-y, x, 0.0, 1.0 + z]) / np.sqrt(2.0 + 2.0 * z)  # from z to the axis, shortest
                described = tool_positions(rig, 1, BALL)(tuple(tip), tuple(turn))
                np.testing.assert_allclose([described[k] for k in positions], list(positions.values()), atol=1e-9)
                continue
            where = urdf.transform("sheet", f"tool_{number}", positions)
            np.testing.assert_allclose(where[:3, 2], axis, atol=1e-9)
            centre = where[:3, 3] + (BALL if number == 1 else -BALL) * where[:3, 2]
            lowest = centre - np.array([0.0, 0.0, BALL if number == 1 else -BALL])
            np.testing.assert_allclose(lowest, tip, atol=1e-9)
