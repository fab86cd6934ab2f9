"""A process that stands in for ros2_control's controller_manager, where C++ of ROS cannot be built.

It does with the same description and parameter file what the real ones do by their sources:
controller_manager (ros2_control 4, Jazzy): takes ``robot_description`` from the topic, runs read, update and write
``update_rate`` times a second. joint_state_topic_hardware_interface 1.0: states from a best-effort subscription, the
commands of all joints in one message of which nothing is sent while they differ from the states by no more than
``trigger_joint_command_threshold`` in sum. joint_trajectory_controller 4.40: trajectories on ``~/joint_trajectory``,
refused and sampled as there, one update period ahead. joint_state_broadcaster: states on ``~/joint_states``.

Parameter ``controllers``: the parameter file.
"""

from __future__ import annotations

import math
import sys
from typing import Any
from xml.etree import ElementTree

import rclpy
import yaml
from isf_ros import process
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from trajectory_msgs.msg import JointTrajectory


class Component:
    """JointStateTopicSystem: joints on two topics."""

    def __init__(self, node: Node, robot: ElementTree.Element) -> None:
        system = robot.find("ros2_control")
        assert system is not None
        hardware = system.find("hardware")
        assert hardware is not None
        assert hardware.findtext("plugin") == "joint_state_topic_hardware_interface/JointStateTopicSystem"
        known = {item.get("name"): item.text or "" for item in hardware.iter("param")}
        self.threshold = float(known.get("trigger_joint_command_threshold", "1e-5"))
        self.node = node
        self.command: dict[str, float] = {}
        self.position: dict[str, float] = {}
        self.velocity: dict[str, float] = {}
        self.limits: dict[str, tuple[float, float]] = {}
        for joint in system.iter("joint"):
            name = joint.get("name", "")
            assert [item.get("name") for item in joint.iter("command_interface")] == ["position"]
            self.command[name] = math.nan  # until a controller is active
            for state in joint.iter("state_interface"):
                first = next(
                    (float(p.text or "") for p in state.iter("param") if p.get("name") == "initial_value"), 0.0
                )
                getattr(self, state.get("name", ""))[name] = first
        self._latest: JointState | None = None
        self._publisher = node.create_publisher(
            JointState, known.get("joint_commands_topic", "/robot_joint_commands"), QoSProfile(depth=1)
        )
        topic = known.get("joint_states_topic", "/robot_joint_states")
        node.create_subscription(JointState, topic, self._on_state, qos_profile_sensor_data)

    def _on_state(self, message: JointState) -> None:
        self._latest = message

    def read(self) -> None:
        latest = self._latest
        if latest is None:
            return
        for k, name in enumerate(latest.name):
            if name in self.command:
                self.position[name] = latest.position[k]
                if latest.velocity:
                    self.velocity[name] = latest.velocity[k]

    def write(self) -> None:
        apart = sum(abs(self.position[name] - value) for name, value in self.command.items())
        if apart <= self.threshold:
            return
        message = JointState(name=list(self.command), position=list(self.command.values()))
        message.header.stamp = self.node.get_clock().now().to_msg()
        self._publisher.publish(message)


class TrajectoryController:
    """joint_trajectory_controller/JointTrajectoryController with a position command."""

    def __init__(self, name: str, known: dict[str, Any], component: Component, period: float) -> None:
        assert known["command_interfaces"] == ["position"]
        self.joints: list[str] = known["joints"]
        self.from_desired = known.get("interpolate_from_desired_state", False)
        self.may_move_at_end = known.get("allow_nonzero_velocity_at_trajectory_end", False)
        self.component, self.period = component, period
        self.refused: list[str] = []
        # activation: the command interfaces, where they are numbers, else the states; then it holds that
        start = [component.command[joint] for joint in self.joints]
        if not all(math.isfinite(value) for value in start):
            start = [component.position[joint] for joint in self.joints]
        self.last = (start, [0.0] * len(start))
        self.last_time: float | None = None
        self.before: tuple[float, list[float], list[float]] | None = None
        self.point: tuple[float, list[float], list[float]] | None = None  # time from start, positions, velocities
        self.start: float | None = None
        self.traj_time = 0.0
        self.component.command.update(zip(self.joints, start, strict=True))
        node = rclpy.create_node(name)  # as a controller is a node of its own
        node.create_subscription(JointTrajectory, "~/joint_trajectory", self._on_trajectory, QoSProfile(depth=1))
        self.node = node

    def _on_trajectory(self, message: JointTrajectory) -> None:
        point = message.points[-1]
        if sorted(message.joint_names) != sorted(self.joints):
            self.refused.append(f"joints {message.joint_names}")
        elif not self.may_move_at_end and any(abs(value) > 1e-9 for value in point.velocities):
            self.refused.append("velocity at the end")
        elif len(message.points) == 1 and (message.header.stamp.sec or message.header.stamp.nanosec) == 0:
            order = [message.joint_names.index(joint) for joint in self.joints]
            after = point.time_from_start.sec + 1e-9 * point.time_from_start.nanosec
            velocities = [point.velocities[k] for k in order] if point.velocities else []
            self.point, self.start = (after, [point.positions[k] for k in order], velocities), None
        else:
            self.refused.append("not what this stand-in samples")

    def update(self, now: float) -> None:
        if self.point is None:
            return
        if self.start is None:  # first sample of this trajectory
            if self.from_desired:
                self.before = (now if self.last_time is None else self.last_time, *self.last)
            else:
                states = self.component
                held = [states.position[joint] for joint in self.joints]
                self.before = (now, held, [states.velocity[joint] for joint in self.joints])
            self.traj_time = self.start = now
        else:
            self.traj_time += self.period
        self.last, self.last_time = self._sample(self.traj_time + self.period), now
        self.component.command.update(zip(self.joints, self.last[0], strict=True))

    def _sample(self, when: float) -> tuple[list[float], list[float]]:
        assert self.point is not None
        assert self.start is not None
        assert self.before is not None
        after, positions, velocities = self.point
        began, first, speeds = self.before
        until = self.start + after
        if when >= until - 1e-9:  # ns in the source, floats here
            return positions, velocities or [0.0] * len(positions)
        share, whole = when - began, until - began
        found = []
        for a, b, va, vb in zip(first, positions, speeds, velocities or speeds, strict=True):
            if not velocities:
                found.append((a + (b - a) * share / whole, (b - a) / whole))
                continue
            c2 = (-3.0 * a + 3.0 * b - 2.0 * va * whole - vb * whole) / whole**2
            c3 = (2.0 * a - 2.0 * b + va * whole + vb * whole) / whole**3
            found.append((a + va * share + c2 * share**2 + c3 * share**3, va + 2 * c2 * share + 3 * c3 * share**2))
        return [x for x, _ in found], [v for _, v in found]


class ControllerManager(Node):
    """The manager, which begins when the description has come."""

    def __init__(self) -> None:
        super().__init__("controller_manager")
        path = str(self.declare_parameter("controllers", "").value)
        with open(path, encoding="utf-8") as file:
            found = yaml.safe_load(file)
        self.known = {key.removeprefix("/**/"): item["ros__parameters"] for key, item in found.items()}
        self.component: Component | None = None
        self.controllers: list[TrajectoryController] = []
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.create_subscription(String, "robot_description", self._on_description, latched)

    def _on_description(self, message: String) -> None:
        if self.component is not None:
            return  # one is loaded; others are left
        self.component = Component(self, ElementTree.fromstring(message.data))
        own = self.known["controller_manager"]
        rate = own["update_rate"]
        broadcaster = self.known["joint_state_broadcaster"]
        topic = "joint_state_broadcaster/joint_states" if broadcaster.get("use_local_topics") else "joint_states"
        self._broadcast = self.create_publisher(JointState, topic, 10)
        for name, about in own.items():
            if isinstance(about, dict) and about["type"] == "joint_trajectory_controller/JointTrajectoryController":
                self.controllers.append(TrajectoryController(name, self.known[name], self.component, 1.0 / rate))
                assert self.executor is not None
                self.executor.add_node(self.controllers[-1].node)
        self.create_timer(1.0 / rate, self._cycle, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def _cycle(self) -> None:
        component = self.component
        assert component is not None
        component.read()
        now = 1e-9 * self.get_clock().now().nanoseconds
        for controller in self.controllers:
            controller.update(now)
            if controller.refused:
                self.get_logger().error(f"refused: {controller.refused.pop()}")
        state = JointState(name=list(component.position), position=list(component.position.values()))
        state.velocity, state.header.stamp = list(component.velocity.values()), self.get_clock().now().to_msg()
        self._broadcast.publish(state)
        component.write()


if __name__ == "__main__":
    ending = process.Ending()
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    sys.exit(process.spin(ControllerManager(), ending))
