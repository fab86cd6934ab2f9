"""A process that stands in for the machine: the contact sandbox behind the topics of the architecture page.

Parameters: ``nan_at``, ``silent_at`` (tick at which a wrench turns NaN or the wrenches stop, -1 never),
``silent`` (1: no wrench of tool_1, 2: none of tool_2, 3: none at all, 0: both),
``saturated_at`` (tick from which the load cells are at the end of their range), ``lost_share`` (share of the wrenches
that never arrive; real time), ``frozen_at`` (tick from which the wrenches repeat), ``frame`` (frame_id of the
wrenches), ``sign`` (factor on the forces), ``tared``, ``lockstep`` (false: ticks by the clock on the newest targets),
``late_at`` (tick from which the wrenches come 50 ms late; real time), ``scattered_share`` (share of the wrenches that
come 50 ms late, after newer ones; real time), ``jump_at``, ``jump`` (tick from which the stamps are off by ``jump`` s),
``gap`` (m by which the tools stand too far apart), ``twist`` (true: integrates twists instead of following poses, and
publishes poses; real time), ``drift`` (m/s in x that it adds to the twists), ``cell_drift`` (N by which the cell of
tool_2 is off in z), ``poses_until``, ``states_until`` (ticks after which it publishes no poses, no machine/state),
``best_effort`` (wrenches and states are published so), ``last_targets`` (a file: when it is there, targets are
answered 1 s late, and it is removed before; lockstep), ``turned`` (axes of the load cells: x, y, z are y, z, x of the
sheet), ``spin`` (rad/s with which they turn about z of the sheet besides, told on /tf every 20 ms until tick
``told_until``, -1 always), ``taken_off`` (1, 2: somebody takes this tool 3 mm off the sheet at the machine's panel).
``silent``, ``saturated_at``, ``late_at``, ``scattered_share``, ``jump_at``, ``jump``, ``gap`` and ``taken_off`` may
change at run time.
"""

import copy
import math
import time
from collections import deque
from pathlib import Path

import numpy as np
import rclpy
from contact_sandbox import Sandbox, planned_distance, ring
from geometry_msgs.msg import PoseStamped, TransformStamped, TwistStamped, WrenchStamped
from isf_msgs.msg import MachineState
from isf_ros import conversion, process, qos, stamps
from rcl_interfaces.msg import SetParametersResult
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions
from tf2_msgs.msg import TFMessage

RATE = 500.0
START = 50_000
"""Tick of the first stamp in lockstep."""

PARKED, FAR = 0.025, 0.1
"""m, where the tools begin: park height of the near rig of node_cell.py, which is for lockstep, and of ren2018."""

LATE = 25
"""Ticks that a late wrench is late."""

TOO_OLD = 200_000_000
"""ns behind the newest wrench, at which one that comes late would be taken for a clock that was set back."""


class StandInMachine(Node):
    def __init__(self) -> None:
        super().__init__("machine")
        self.nan_at, self.silent_at = (self.declare_parameter(n, -1).value for n in ("nan_at", "silent_at"))
        self.silent = self.declare_parameter("silent", 0).value
        self.saturated_at = self.declare_parameter("saturated_at", -1).value
        self.lost_share = self.declare_parameter("lost_share", 0.0).value
        self.frozen_at, self.sign = (
            self.declare_parameter("frozen_at", -1).value,
            self.declare_parameter("sign", 1.0).value,
        )
        frame = self.declare_parameter("frame", conversion.FRAME).value
        self.random = np.random.default_rng(0)
        self.late_at, self.jump_at = (self.declare_parameter(n, -1).value for n in ("late_at", "jump_at"))
        self.jump, self.scattered_share = (
            self.declare_parameter("jump", 0.0).value,
            self.declare_parameter("scattered_share", 0.0).value,
        )
        self.gap = self.declare_parameter("gap", 0.0).value
        self.delayed: deque[tuple[int, int, WrenchStamped]] = deque()
        self.tared = self.declare_parameter("tared", True).value
        self.lockstep = self.declare_parameter("lockstep", True).value
        height = PARKED if self.lockstep else FAR
        parked = ((0.0, 0.0, height), (0.0, 0.0, -height))
        self.sandbox = Sandbox(*map(np.array, parked), planned_distance(ring()))
        self.twist, self.drift, self.poses_until = (
            self.declare_parameter("twist", False).value,
            self.declare_parameter("drift", 0.0).value,
            self.declare_parameter("poses_until", -1).value,
        )
        self.states_until = self.declare_parameter("states_until", -1).value
        self.cell_drift = self.declare_parameter("cell_drift", 0.0).value
        self.last_targets = self.declare_parameter("last_targets", "").value
        self.turned, self.spin = (
            self.declare_parameter("turned", False).value,
            self.declare_parameter("spin", 0.0).value,
        )
        self.told_until = self.declare_parameter("told_until", -1).value
        self.taken_off = self.declare_parameter("taken_off", 0).value
        self.frame = frame
        self.tf = self.create_publisher(TFMessage, "/tf", 100) if self.spin else None
        self.velocity = [(0.0, 0.0, 0.0), (0.0, 0.0, 0.0)]
        self.poses = [self.create_publisher(PoseStamped, f"tool_{k}/pose", qos.SENSOR) for k in (1, 2)]
        self.sandbox.gap = lambda time, angle: self.gap
        self.add_on_set_parameters_callback(self.on_parameters)
        self.stamp = [-1, -1]
        self.targets = list(parked)
        self.wrench = [conversion.make_wrench(), conversion.make_wrench()]
        for message in self.wrench:
            message.header.frame_id = frame
        delivery = qos.SENSOR if self.declare_parameter("best_effort", False).value else qos.STREAM
        self.out = [self.create_publisher(WrenchStamped, f"tool_{k}/wrench", delivery) for k in (1, 2)]
        self.state = self.create_publisher(MachineState, "machine/state", delivery)
        for k in (0, 1):
            tool = f"tool_{k + 1}"
            if self.twist:
                topic = f"{tool}/target_twist"
                self.create_subscription(TwistStamped, topic, lambda m, k=k: self.on_twist(k, m), qos.STREAM)
            else:
                self.create_subscription(PoseStamped, f"{tool}/target", lambda m, k=k: self.on_target(k, m), qos.STREAM)
        self.last, self.offset = 0.0, 0
        self.measure()
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(0.1, self.on_timer, clock=steady)
        if not self.lockstep:
            self.create_timer(1.0 / RATE, self.on_clock, clock=steady)

    def on_parameters(self, parameters: list[Parameter]) -> SetParametersResult:
        for parameter in parameters:
            setattr(self, parameter.name, parameter.value)
            if parameter.name == "taken_off":
                self.sandbox.position[3 * self.taken_off - 1] += 3e-3 if self.taken_off == 1 else -3e-3
        return SetParametersResult(successful=True)

    def measure(self) -> None:
        tick = self.sandbox.tick
        # from one tick to the next only: targets that are on their way are still of the old time
        self.offset = round(self.jump * stamps.NANO) if 0 <= self.jump_at <= tick else 0
        for message, wrench in zip(self.wrench, self.sandbox.wrenches(), strict=True):
            if tick == self.nan_at:
                wrench[1] = math.nan
            if 0 <= self.saturated_at <= tick:
                wrench[2] = 1e4
            if not 0 <= self.frozen_at <= tick:
                values = [self.sign * value for value in wrench]
                values[2] += self.cell_drift if message is self.wrench[1] else 0.0
                conversion.set_wrench(message, [*self.in_cell(values[:3]), *self.in_cell(values[3:])])
            message.header.stamp = stamps.to_stamp(self.now())
        self.tell_spin()
        self.send()

    def in_cell(self, vector: list[float]) -> list[float]:
        """A vector (3,) in axes of the sheet as the load cells read it."""
        x, y, z = vector
        if self.spin:
            angle = self.spin * self.sandbox.tick / RATE
            x, y = math.cos(angle) * x + math.sin(angle) * y, math.cos(angle) * y - math.sin(angle) * x
        return [y, z, x] if self.turned else [x, y, z]

    def tell_spin(self) -> None:
        """How the load cells stand, as a robot tells it: 50 times a second, and between the wrenches."""
        tick = self.sandbox.tick
        if self.tf is None or tick % 10 or 0 <= self.told_until < tick:
            return
        half = 0.5 * self.spin * tick / RATE
        transform = TransformStamped(child_frame_id=self.frame)
        transform.header.frame_id, transform.header.stamp = conversion.FRAME, stamps.to_stamp(self.now())
        transform.transform.rotation.z, transform.transform.rotation.w = math.sin(half), math.cos(half)
        self.tf.publish(TFMessage(transforms=[transform]))

    def now(self, ahead: int = 0) -> int:
        """ns: time of the tick, or of one ``ahead``, in lockstep, else of the clock."""
        tick = self.sandbox.tick
        now = stamps.tick_nanoseconds(START + tick + ahead, RATE) if self.lockstep else time.time_ns()
        return now + self.offset

    def send(self) -> None:
        if 0 <= self.silent_at <= self.sandbox.tick:
            return
        self.last = time.monotonic()
        tick = self.sandbox.tick
        for index, message in enumerate(self.wrench):
            if self.silent >> index & 1 or self.random.random() < self.lost_share:
                continue
            if 0 <= self.late_at <= tick or self.random.random() < self.scattered_share:
                self.delayed.append((tick + LATE, index, copy.deepcopy(message)))
            else:
                self.out[index].publish(message)
        while self.delayed and self.delayed[0][0] <= tick:
            _, index, message = self.delayed.popleft()
            newest, stamp = (stamps.to_nanoseconds(m.header.stamp) for m in (self.wrench[index], message))
            if newest - stamp < TOO_OLD:  # else this process itself stood still meanwhile
                self.out[index].publish(message)

    def on_timer(self) -> None:
        if self.states_until < 0 or self.sandbox.tick <= self.states_until:
            self.state.publish(MachineState(tared=self.tared, tick=self.sandbox.tick, lockstep=self.lockstep))
        if not self.twist:
            self.publish_poses()
        if self.lockstep and time.monotonic() - self.last > 0.15:
            self.tell_spin()
            self.send()

    def on_clock(self) -> None:
        if self.twist:
            self.integrate()
        self.sandbox.advance(*self.targets)
        self.measure()

    def integrate(self) -> None:
        """As a driver does that is sent velocities: by its own clock, and never quite exactly."""
        now = time.monotonic()
        passed, self.integrated = now - getattr(self, "integrated", now), now
        for k, (x, y, z) in enumerate(self.velocity):
            a, b, c = self.targets[k]
            moving = self.drift if (x, y, z) != (0.0, 0.0, 0.0) else 0.0
            self.targets[k] = (a + passed * (x + moving), b + passed * y, c + passed * z)
        self.publish_poses()

    def publish_poses(self) -> None:
        if 0 <= self.poses_until < self.sandbox.tick:
            return
        for k in (0, 1):
            pose = conversion.make_pose()
            pose.header.stamp = stamps.to_stamp(self.now())
            conversion.set_tip(pose, self.sandbox.position[3 * k : 3 * k + 3])
            self.poses[k].publish(pose)

    def on_twist(self, tool: int, message: TwistStamped) -> None:
        if message.header.frame_id == conversion.FRAME:
            linear = message.twist.linear
            self.velocity[tool] = (linear.x, linear.y, linear.z)

    def on_target(self, tool: int, message: PoseStamped) -> None:
        if message.header.frame_id != conversion.FRAME:
            return
        self.targets[tool] = conversion.tip_of(message)
        self.stamp[tool] = stamps.to_nanoseconds(message.header.stamp)
        due = self.now(1)
        if self.lockstep and self.stamp == [due, due]:
            if self.last_targets and Path(self.last_targets).exists():
                time.sleep(1.0)  # the fault itself: a machine that does the last targets a second late
                Path(self.last_targets).unlink()
            self.sandbox.advance(*self.targets)
            self.measure()


def main() -> None:
    ending = process.Ending()
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node = StandInMachine()
    try:
        process.spin(node, ending, streams=True)
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
