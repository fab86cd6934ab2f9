"""Node ``machine`` by the clock at a real-time priority, in a process of its own: granted, or refused and told."""

from __future__ import annotations

import ctypes
import os
import re
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import WrenchStamped
from isf_msgs.srv import Reset
from isf_ros import qos
from rclpy.executors import SingleThreadedExecutor

pytestmark = [pytest.mark.graph, pytest.mark.clock]

PRIORITY = 5
LIMIT = 120.0
"""s; only to end a test that hangs: a process may take long to start."""
CAP_SYS_NICE, PR_CAPBSET_DROP, RLIMIT_RTPRIO = 23, 24, 14
JOB = """
name: priority-test
part: {mesh: none.stl, unit: mm}
process: DSIF
rig: ren2018
sheet: {material: AA5754-O, thickness: 1 mm}
tool_1: {radius: 5 mm}
tool_2: {radius: 5 mm}
path: {incremental_depth: 0.5 mm, point_spacing: 0.5 mm, feed: 30 mm/s}
"""


def forbid() -> None:
    """No real-time priority for the process that is started, whoever it belongs to."""
    resource.setrlimit(RLIMIT_RTPRIO, (0, 0))
    ctypes.CDLL(None).prctl(PR_CAPBSET_DROP, CAP_SYS_NICE)


def permitted() -> bool:
    """Whether the system lets a process of this user have SCHED_FIFO."""
    ask = f"import os; os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param({PRIORITY}))"
    return subprocess.run([sys.executable, "-c", ask], capture_output=True, timeout=120, check=False).returncode == 0


class Watcher:
    """What a machine tells in its diagnostics, and how many wrenches it has sent."""

    def __init__(self) -> None:
        self.node = rclpy.create_node("watcher")
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.node)
        self.values: dict[str, str] = {}
        self.reported = 0
        self.wrenches = 0
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 10)
        self.node.create_subscription(WrenchStamped, "tool_1/wrench", self._on_wrench, qos.STREAM)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name.endswith("machine"):
                self.values = {item.key: item.value for item in status.values}
                self.reported += 1

    def _on_wrench(self, message: WrenchStamped) -> None:
        self.wrenches += 1

    def wait(self, condition: Callable[[], bool], timeout: float = LIMIT) -> bool:
        deadline = time.monotonic() + timeout
        while not condition():
            if time.monotonic() > deadline:
                return False
            self.executor.spin_once(timeout_sec=0.05)
        return True

    def clamp(self) -> None:
        """A fresh blank: from then on the machine ticks by the clock."""
        client = self.node.create_client(Reset, "machine/reset")
        assert client.wait_for_service(LIMIT)
        future = client.call_async(Reset.Request(new_blank=True, job_text=JOB))
        assert self.wait(future.done)
        assert future.result().code == 0


@pytest.fixture
def machine(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[tuple[Watcher, int, Path]]:
    """Watcher, process id and log of a machine that asks for a priority; parameter: whether it is forbidden to it."""
    log = tmp_path / "machine.log"
    with log.open("w") as file:
        process = subprocess.Popen(
            [sys.executable, "-m", "isf_sim.node", "--ros-args", "-p", "autostart:=true", "-p", "lockstep:=false"]
            + ["-p", f"real_time_priority:={PRIORITY}"],
            stdout=file,
            stderr=file,
            env=os.environ,
            preexec_fn=forbid if request.param else None,
        )
    rclpy.init()
    watcher = Watcher()
    try:
        yield watcher, process.pid, log
    finally:
        watcher.executor.shutdown()
        watcher.node.destroy_node()
        rclpy.try_shutdown()
        process.send_signal(signal.SIGINT)
        code = process.wait(LIMIT)
        print(log.read_text())
        assert code == 0


def policies(process: int) -> list[tuple[int, int]]:
    """Scheduling policy and priority of every thread."""
    threads = [int(entry.name) for entry in Path(f"/proc/{process}/task").iterdir()]
    return [(os.sched_getscheduler(thread), os.sched_getparam(thread).sched_priority) for thread in threads]


@pytest.mark.parametrize("machine", [False], indirect=True)
def test_the_threads_have_the_priority_where_the_system_permits(machine: tuple[Watcher, int, Path]) -> None:
    watcher, process, _ = machine
    watcher.clamp()
    expected = PRIORITY if permitted() else 0
    assert watcher.wait(lambda: watcher.wrenches > 200)
    # said after the first ticks: before them no priority has been asked for
    reported = watcher.reported
    assert watcher.wait(lambda: watcher.reported > reported + 1)
    assert watcher.values["real_time_priority"] == str(expected)
    assert ("real_time_refused" in watcher.values) == (expected == 0)
    policy = os.SCHED_FIFO if expected else os.SCHED_OTHER
    assert policies(process).count((policy, expected)) >= 3  # receiving, ticking, serving


@pytest.mark.parametrize("machine", [True], indirect=True)
def test_a_refused_priority_is_reported_and_the_machine_ticks(machine: tuple[Watcher, int, Path]) -> None:
    watcher, process, log = machine
    watcher.clamp()
    assert watcher.wait(lambda: "real_time_refused" in watcher.values)
    assert watcher.values["real_time_priority"] == "0"
    assert re.search(rf"SCHED_FIFO {PRIORITY}: .+", watcher.values["real_time_refused"])
    assert watcher.wait(lambda: watcher.wrenches > 200)
    assert {policy for policy, _ in policies(process)} == {os.SCHED_OTHER}
    assert f"SCHED_FIFO {PRIORITY}" in log.read_text()
