"""Node machine in a process of its own, and the client with which a test drives and watches it."""

from __future__ import annotations

import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import forked_process
import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped, WrenchStamped
from isf_msgs.msg import MachineEvent, MachineState
from isf_msgs.srv import Reset, Tare
from isf_ros import conversion, qos, stamps
from sensor_msgs.msg import PointCloud2
from waiting import LIMIT, Waiting

RATE = 500.0
JOB = """
name: node-test
part: {mesh: none.stl, unit: mm}
process: DSIF
rig: ren2018
sheet: {material: AA5754-O, thickness: 1 mm}
tool_1: {radius: 5 mm}
tool_2: {radius: 5 mm}
path: {incremental_depth: 0.5 mm, point_spacing: 0.5 mm, feed: 30 mm/s}
control: {rate: 500 Hz}
"""
PARKED = (np.array([0.0, 0.0, 0.1]), np.array([0.0, 0.0, -0.1]))


class Client:
    """Answers wrenches with targets, as force_ctrl does; ``process`` is the machine's, ``log`` its output."""

    process: forked_process.ForkedProcess
    log: Path
    lockstep = True

    def __init__(self) -> None:
        self.node = rclpy.create_node("client")
        self.waiting = Waiting(self.node)
        self.wait = self.waiting.until
        self.wrenches: tuple[dict[int, Any], dict[int, Any]] = ({}, {})
        self.received = 0
        self.last = np.zeros(6)
        self.states: list[MachineState] = []
        self.scans: list[PointCloud2] = []
        self.events: list[MachineEvent] = []
        self.health: list[DiagnosticStatus] = []
        for k in (0, 1):
            self.node.create_subscription(
                WrenchStamped, f"tool_{k + 1}/wrench", lambda m, k=k: self._on_wrench(k, m), qos.STREAM
            )
        self.node.create_subscription(MachineState, "machine/state", self.states.append, qos.STREAM)
        self.node.create_subscription(MachineEvent, "machine/event", self.events.append, qos.EVENT)
        self.node.create_subscription(PointCloud2, "scan", self.scans.append, qos.LATCHED)
        self.targets = [self.node.create_publisher(PoseStamped, f"tool_{k}/target", qos.STREAM) for k in (1, 2)]

    def _on_wrench(self, tool: int, message: WrenchStamped) -> None:
        self.received += 1
        wrench = conversion.wrench_array(message)
        self.wrenches[tool][stamps.to_nanoseconds(message.header.stamp)] = wrench
        if tool == 0:
            self.last = wrench

    def call(self, kind: Any, name: str, request: Any) -> Any:
        client = self.node.create_client(kind, name)
        assert client.wait_for_service(LIMIT), name
        for _ in range(4):
            future = client.call_async(request)
            if self.wait(future.done, 0.25 * LIMIT):
                return future.result()
            # the service knew its client too late: on a busy computer the middleware drops such an answer
        raise AssertionError(name)

    def send(self, stamp: int, tips: tuple[Any, Any]) -> None:
        for publisher, tip in zip(self.targets, tips, strict=True):
            message = conversion.make_pose()
            message.header.stamp = stamps.to_stamp(stamp)
            conversion.set_tip(message, tip)
            publisher.publish(message)

    def tick(self, number: int, tips: tuple[Any, Any]) -> bool:
        """Send the targets of tick ``number``; True when both wrenches of its stamp have come."""
        stamp = stamps.tick_nanoseconds(number, RATE)
        self.send(stamp, tips)
        return self.wait(lambda: stamp in self.wrenches[0] and stamp in self.wrenches[1])

    def newest(self) -> int:
        return max(self.wrenches[0], default=-1)

    def ready(self) -> None:
        """Fresh blank, tare, first wrenches, and the machine listens to the targets."""
        request = Reset.Request(new_blank=True, job_text=JOB, seed=3)
        assert self.call(Reset, "machine/reset", request).code == 0
        assert self.call(Tare, "machine/tare", Tare.Request()).code == 0
        assert self.wait(lambda: all(p.get_subscription_count() == 1 for p in self.targets))
        assert self.wait(lambda: 0 in self.wrenches[0] and 0 in self.wrenches[1])

    def force(self) -> float:
        """N, Fz of the forming tool as it came last."""
        return float(self.last[2])

    def follow_health(self) -> None:
        """Keep what nodes say in /diagnostics in ``health``."""
        self.node.create_subscription(DiagnosticArray, "/diagnostics", lambda m: self.health.extend(m.status), 50)

    def ticked_to(self, stamp: int) -> bool:
        """Wait for the wrenches of ``stamp``; False when the machine latches a fault before."""
        assert self.wait(lambda: self.newest() >= stamp or bool(self.fault_codes()))
        return not self.fault_codes()

    def fault_codes(self) -> list[int]:
        return list(self.states[-1].fault_codes) if self.states else []


@contextmanager
def served(program: list[str], folder: Path, parameters: list[str]) -> Iterator[Client]:
    """The node as ``program`` (arguments of Python) starts it, with its log and its saved states in ``folder``."""
    log = (folder / "machine.log").open("w")
    options = ["autostart:=true", f"state_folder:={folder / 'states'}", *parameters]
    arguments = [part for item in options for part in ("-p", item)]
    process = forked_process.start([sys.executable, *program, "--ros-args", *arguments], stdout=log, stderr=log)
    rclpy.init()
    client = Client()
    client.process, client.log = process, folder / "machine.log"
    try:
        yield client
    finally:
        client.waiting.close()
        client.node.destroy_node()
        rclpy.try_shutdown()
        process.send_signal(signal.SIGINT)
        code = process.wait(LIMIT)
        log.close()
        print((folder / "machine.log").read_text())
        assert code == 0


def press(client: Client, depth: float) -> int:
    """Bring the tool from its park position to ``depth`` m below the sheet at the speed limit; last tick."""
    ticks = int(np.ceil((0.1 + depth) / 0.0002))
    for number in range(1, ticks + 1):
        z = max(0.1 - 0.0002 * number, -depth)
        assert client.tick(number, (np.array([0.0, 0.0, z]), PARKED[1]))
    return ticks
