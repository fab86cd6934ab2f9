"""A cell for ros2_control: the block in its URDF, and the parameters of controller_manager and its controllers.

The block names a hardware component of ros-controls that maps joints on two topics of ``sensor_msgs/JointState``; its
tags and parameters, and the keys of the controllers, are those of the sources of topic_based_hardware_interfaces 1.0
and ros2_controllers 4.40 (Jazzy). Who follows the commands is the simulated machine, or a driver.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any
from xml.etree.ElementTree import Element, SubElement

import yaml
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.rig import Rig
from isf_core.geometry.tool_joints import ToolJoints

from isf_description.tree import Description

PLUGIN = "joint_state_topic_hardware_interface/JointStateTopicSystem"
"""apt: ros-jazzy-joint-state-topic-hardware-interface. Its forerunner topic_based_ros2_control/TopicBasedSystem has the
same parameters."""

COMMANDS, STATES = "machine/joint_commands", "machine/joint_states"
"""Topics of the machine, in the namespace of the cell."""

ALWAYS = -1.0
"""``trigger_joint_command_threshold`` with which every command is published. With 0 the component is silent while
all joints stand exactly where they should, which for the machine is a controller that is gone."""

BROADCASTER = "joint_state_broadcaster"


@dataclass(frozen=True)
class ControlBlock:
    """What ros2_control is told of a cell.

    Attributes
    ----------
    tools : joints of each tool, by its number
    parked : position of every joint, m or rad, where the machine begins
    commands, states : full names of the topics
    plugin : class of the hardware component
    """

    tools: dict[int, tuple[str, ...]]
    parked: dict[str, float]
    commands: str = f"/{COMMANDS}"
    states: str = f"/{STATES}"
    plugin: str = PLUGIN

    @staticmethod
    def of(rig: Rig, description: Description, ball: float, namespace: str = "/") -> ControlBlock:
        """For the tools of ``rig`` that ``description`` has, parked; their balls have the radius ``ball`` m.

        Raises IsfError FILE_FIELD of a cell whose sheet is moved as well.
        """
        moved = {joint.name for joint in description.movable}
        if "blank_holder" in moved:
            raise IsfError(
                ErrorCode.FILE_FIELD,
                "the blank holder of TPIF has no joint under ros2_control",
                where="process",
                advice="form the part without ros2_control",
            )
        tools: dict[int, tuple[str, ...]] = {}
        parked: dict[str, float] = {}
        for number, height in ((1, rig.park_height), (2, -rig.park_height)):
            joints = ToolJoints.of(rig, number, ball)
            if not set(joints.names) <= moved:
                continue
            tools[number] = joints.names
            parked |= dict(zip(joints.names, joints.positions((0.0, 0.0, height)).tolist(), strict=True))
        stem = namespace.rstrip("/")
        return ControlBlock(tools, parked, f"{stem}/{COMMANDS}", f"{stem}/{STATES}")

    def add_to(self, robot: Element, description: Description) -> None:
        """Append the tag ``ros2_control`` to a ``robot``.

        It names joints with a command alone: the component sends names and positions as two lists, which a joint
        without a command would shift against each other.
        """
        system = SubElement(robot, "ros2_control", name="isf_machine", type="system")
        hardware = SubElement(system, "hardware")
        SubElement(hardware, "plugin").text = self.plugin
        parameters = {
            "joint_commands_topic": self.commands,
            "joint_states_topic": self.states,
            "trigger_joint_command_threshold": f"{ALWAYS:g}",
            "sum_wrapped_joint_states": "false",
        }
        for name, value in parameters.items():
            SubElement(hardware, "param", name=name).text = value
        limits = {joint.name: joint.limits for joint in description.movable}
        for name in (name for names in self.tools.values() for name in names):
            joint = SubElement(system, "joint", name=name)
            command = SubElement(joint, "command_interface", name="position")
            SubElement(command, "param", name="min").text = f"{limits[name].lowest:.12g}"
            SubElement(command, "param", name="max").text = f"{limits[name].highest:.12g}"
            state = SubElement(joint, "state_interface", name="position")
            SubElement(state, "param", name="initial_value").text = f"{self.parked[name]:.12g}"
            SubElement(joint, "state_interface", name="velocity")


def controllers(tools: dict[int, tuple[str, ...]], rate: float) -> str:
    """Parameter file (YAML) of controller_manager at ``rate`` Hz: a broadcaster of the joints' states, and for every
    tool a joint_trajectory_controller of its name, whose topic is then that of ``force_ctrl``.

    Raises IsfError FILE_FIELD for a rate that is no whole number, which the parameter ``update_rate`` has to be.
    """
    if rate != round(rate):
        raise IsfError(
            ErrorCode.FILE_FIELD,
            f"controller_manager runs at whole numbers of Hz, not at {rate:g}",
            where="control.rate",
            advice="e.g. 500 Hz",
        )
    manager: dict[str, Any] = {"update_rate": round(rate)}
    manager[BROADCASTER] = {"type": "joint_state_broadcaster/JointStateBroadcaster"}
    manager |= {f"tool_{k}": {"type": "joint_trajectory_controller/JointTrajectoryController"} for k in tools}
    nodes = {"controller_manager": manager, BROADCASTER: {"use_local_topics": True}}
    nodes |= {f"tool_{k}": _trajectory_controller(names) for k, names in tools.items()}
    made = {f"/**/{name}": {"ros__parameters": values} for name, values in nodes.items()}
    return HEAD + yaml.safe_dump(made, sort_keys=False, default_flow_style=None, width=110)


HEAD = """\
# Parameters of controller_manager and its controllers, made by `isf describe --ros2-control`.
# Every trajectory of force_ctrl has one point, one period ahead, and a velocity there: it follows on the one before
# (interpolate_from_desired_state) and does not end at rest (allow_nonzero_velocity_at_trajectory_end).
"""


def _trajectory_controller(names: Sequence[str]) -> dict[str, Any]:
    return {
        "joints": list(names),
        "command_interfaces": ["position"],
        "state_interfaces": ["position", "velocity"],
        "interpolate_from_desired_state": True,
        "allow_nonzero_velocity_at_trajectory_end": True,
        "constraints": {"goal_time": 0.0, "stopped_velocity_tolerance": 0.0},
    }
