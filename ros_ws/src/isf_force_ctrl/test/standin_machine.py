"""A process that stands in for the machine: the contact sandbox behind the topics of the architecture page.

Parameters: ``nan_at``, ``silent_at`` (tick at which a wrench turns NaN or the wrenches stop, -1 never),
``saturated_at`` (tick from which the load cells are at the end of their range), ``lost_share`` (share of the wrenches
that never arrive; real time), ``frozen_at`` (tick from which the wrenches repeat), ``frame`` (frame_id of the
wrenches), ``sign`` (factor on the forces), ``tared``, ``lockstep`` (false: ticks by the clock on the newest targets),
``late_at`` (tick from which the wrenches come 50 ms late; real time), ``scattered_share`` (share of the wrenches that
come 50 ms late, after newer ones; real time), ``jump_at``, ``jump`` (tick from which the stamps are off by ``jump`` s),
``twist`` (true: follows twists by integrating them instead of poses, and publishes poses).
"""

import copy
import math
import time
from collections import deque

import numpy as np
import rclpy
from contact_sandbox import Sandbox, planned_distance, ring
from geometry_msgs.msg import PoseStamped, WrenchStamped
from isf_msgs.msg import MachineState
from isf_node import conversion, qos, stamps
from rclpy.clock import Clock, ClockType
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node

RATE = 500.0
LATE = 25
"""Ticks that a late wrench is late."""


class StandInMachine(Node):
    def __init__(self) -> None:
        super().__init__("machine")
        self.nan_at, self.silent_at = (self.declare_parameter(n, -1).value for n in ("nan_at", "silent_at"))
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
        self.delayed: deque[tuple[int, int, WrenchStamped]] = deque()
        self.tared = self.declare_parameter("tared", True).value
        self.lockstep = self.declare_parameter("lockstep", True).value
        self.sandbox = Sandbox(np.array([0.0, 0.0, 0.1]), np.array([0.0, 0.0, -0.1]), planned_distance(ring()))
        self.stamp = [-1, -1]
        self.targets = [(0.0, 0.0, 0.1), (0.0, 0.0, -0.1)]
        self.wrench = [conversion.make_wrench(), conversion.make_wrench()]
        for message in self.wrench:
            message.header.frame_id = frame
        self.out = [self.create_publisher(WrenchStamped, f"tool_{k}/wrench", qos.STREAM) for k in (1, 2)]
        self.state = self.create_publisher(MachineState, "machine/state", qos.STREAM)
        self.create_subscription(PoseStamped, "tool_1/target", lambda m: self.on_target(0, m), qos.STREAM)
        self.create_subscription(PoseStamped, "tool_2/target", lambda m: self.on_target(1, m), qos.STREAM)
        self.last = 0.0
        self.measure()
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(0.1, self.on_timer, clock=steady)
        if not self.lockstep:
            self.create_timer(1.0 / RATE, self.on_clock, clock=steady)

    def measure(self) -> None:
        tick = self.sandbox.tick
        for message, wrench in zip(self.wrench, self.sandbox.wrenches(), strict=True):
            if tick == self.nan_at:
                wrench[1] = math.nan
            if 0 <= self.saturated_at <= tick:
                wrench[2] = 1e4
            if not 0 <= self.frozen_at <= tick:
                conversion.set_wrench(message, [self.sign * value for value in wrench])
            message.header.stamp = stamps.to_stamp(self.now())
        self.send()

    def now(self) -> int:
        """ns: time of the tick in lockstep, else of the clock."""
        tick = self.sandbox.tick
        now = stamps.tick_nanoseconds(tick, RATE) if self.lockstep else time.time_ns()
        return now + (round(self.jump * stamps.NANO) if 0 <= self.jump_at <= tick else 0)

    def send(self) -> None:
        if 0 <= self.silent_at <= self.sandbox.tick:
            return
        self.last = time.monotonic()
        tick = self.sandbox.tick
        for index, message in enumerate(self.wrench):
            if self.random.random() < self.lost_share:
                continue
            if 0 <= self.late_at <= tick or self.random.random() < self.scattered_share:
                self.delayed.append((tick + LATE, index, copy.deepcopy(message)))
            else:
                self.out[index].publish(message)
        while self.delayed and self.delayed[0][0] <= tick:
            _, index, message = self.delayed.popleft()
            self.out[index].publish(message)

    def on_timer(self) -> None:
        self.state.publish(MachineState(tared=self.tared, tick=self.sandbox.tick, lockstep=self.lockstep))
        if self.lockstep and time.monotonic() - self.last > 0.15:
            self.send()

    def on_clock(self) -> None:
        self.sandbox.advance(*self.targets)
        self.measure()

    def on_target(self, tool: int, message: PoseStamped) -> None:
        self.targets[tool] = conversion.tip_of(message)
        self.stamp[tool] = stamps.to_nanoseconds(message.header.stamp)
        due = stamps.tick_nanoseconds(self.sandbox.tick + 1, RATE)
        if self.lockstep and self.stamp == [due, due]:
            self.sandbox.advance(*self.targets)
            self.measure()


def main() -> None:
    rclpy.init()
    node = StandInMachine()
    try:
        rclpy.spin(node)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
