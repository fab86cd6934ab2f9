"""Cell nodes in a real process: heartbeat, autostart, failing transitions, parameters, orderly end."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import forked_process
import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from isf_core import __version__
from isf_ros.process_identity import running
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters
from rclpy.node import Node

pytestmark = pytest.mark.graph

LIMIT = 120.0
"""s; only to end a test that hangs: a process may take long to start."""


@pytest.fixture
def observer() -> Iterator[Node]:
    rclpy.init()
    node = rclpy.create_node("observer")
    yield node
    node.destroy_node()
    rclpy.try_shutdown()


def sample(**parameters: object) -> AbstractContextManager[forked_process.Process]:
    return forked_process.node(str(Path(__file__).with_name("lifecycle_node.py")), **parameters)


def spin_until(node: Node, condition: Callable[[], Any], timeout: float = LIMIT) -> bool:
    deadline = time.monotonic() + timeout
    while not condition() and time.monotonic() < deadline:
        rclpy.spin_once(node, timeout_sec=0.1)
    return bool(condition())


def listen(node: Node) -> list[DiagnosticStatus]:
    heard: list[DiagnosticStatus] = []
    node.create_subscription(DiagnosticArray, "/diagnostics", lambda message: heard.extend(message.status), 10)
    return heard


def values(status: DiagnosticStatus) -> dict[str, str]:
    return {item.key: item.value for item in status.values}


def call(node: Node, kind: Any, name: str, request: Any) -> Any:
    client = node.create_client(kind, name)
    assert client.wait_for_service(LIMIT)
    future = client.call_async(request)
    assert spin_until(node, future.done)
    return future.result()


def test_a_node_waits_unconfigured_and_ends_in_order(observer: Node, tmp_path: Path) -> None:
    heard = listen(observer)
    note = tmp_path / "note"
    with sample(closing_note=note) as process:
        assert spin_until(observer, lambda: len(heard) >= 2)
        assert heard[-1].name == "/sample"
        told = values(heard[-1])
        assert running(told.pop("process")) is True
        assert told == {"state": "unconfigured", "pid": str(process.pid), "version": __version__, "gain": "1.5"}
        os.killpg(process.pid, signal.SIGTERM)
        assert spin_until(observer, lambda: values(heard[-1])["state"] == "finalized")
        assert process.wait(LIMIT) == 0
    assert note.read_text() == "closed"


def test_autostart_brings_a_node_up(observer: Node) -> None:
    heard = listen(observer)
    with sample(autostart="true"):
        assert spin_until(observer, lambda: heard and values(heard[-1])["state"] == "active")
        assert heard[-1].level == DiagnosticStatus.OK


def test_a_failing_configuration_is_reported_and_the_node_stays_unconfigured(observer: Node) -> None:
    heard = listen(observer)
    with sample(broken="true"):
        request = ChangeState.Request(transition=Transition(id=Transition.TRANSITION_CONFIGURE))
        assert not call(observer, ChangeState, "sample/change_state", request).success
        assert spin_until(observer, lambda: heard and heard[-1].level == DiagnosticStatus.ERROR)
        assert "1003 FILE_FIELD" in heard[-1].message
        assert "correct it" in heard[-1].message
        assert values(heard[-1])["state"] == "unconfigured"


@pytest.mark.parametrize("before", ["unconfigured", "inactive", "active"])
def test_a_node_that_was_shut_down_says_so_and_cannot_be_brought_up(observer: Node, before: str) -> None:
    heard = listen(observer)
    way = {
        "unconfigured": [Transition.TRANSITION_UNCONFIGURED_SHUTDOWN],
        "inactive": [Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_INACTIVE_SHUTDOWN],
        "active": [
            Transition.TRANSITION_CONFIGURE,
            Transition.TRANSITION_ACTIVATE,
            Transition.TRANSITION_ACTIVE_SHUTDOWN,
        ],
    }[before]

    def changed(number: int) -> bool:
        request = ChangeState.Request(transition=Transition(id=number))
        return bool(call(observer, ChangeState, "sample/change_state", request).success)

    with sample():
        assert all(changed(number) for number in way)
        assert spin_until(observer, lambda: heard and values(heard[-1])["state"] == "finalized")
        assert not changed(Transition.TRANSITION_CONFIGURE)
        heard.clear()
        assert spin_until(observer, lambda: len(heard) >= 2)  # its process goes on, and goes on saying so
        assert {values(status)["state"] for status in heard} == {"finalized"}


def test_a_node_in_a_long_callback_says_so_and_one_that_hangs_falls_silent(observer: Node) -> None:
    heard = listen(observer)
    with sample(work=23.0):
        client = observer.create_client(ChangeState, "sample/change_state")
        assert client.wait_for_service(LIMIT)
        transition = Transition(id=Transition.TRANSITION_CONFIGURE)
        done = client.call_async(ChangeState.Request(transition=transition))
        busy = []
        while not done.done():
            rclpy.spin_once(observer, timeout_sec=0.1)
            busy += [float(v) for status in heard for k, v in values(status).items() if k == "in_one_callback_s"]
            heard.clear()
        assert len(busy) >= 10
        assert 15.0 < max(busy) <= 20.0  # 23 s of work: after 20 s it counts as one that hangs
        assert spin_until(observer, lambda: heard and values(heard[-1])["state"] == "inactive")
        assert "in_one_callback_s" not in values(heard[-1])


def test_read_only_parameters_cannot_change_and_others_can(observer: Node) -> None:
    heard = listen(observer)
    with sample():
        number = ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=2.5)
        flag = ParameterValue(type=ParameterType.PARAMETER_BOOL, bool_value=True)
        request = SetParameters.Request(
            parameters=[Parameter(name="gain", value=number), Parameter(name="broken", value=flag)]
        )
        results = call(observer, SetParameters, "sample/set_parameters", request).results
        assert [result.successful for result in results] == [True, False]
        assert spin_until(observer, lambda: heard and values(heard[-1])["gain"] == "2.5")


CYCLES = """
import gc, os
import rclpy
from lifecycle_node import SampleNode
gc.disable()
for _ in range(4):
    rclpy.init()
    node = SampleNode()
    node.destroy_node()
    rclpy.try_shutdown()
    print(len(os.listdir("/proc/self/task")))
"""


def test_a_destroyed_node_leaves_nothing_behind() -> None:
    # DDS participants that pile up in one process until a garbage collection can lock each other for ever.
    done = subprocess.run(
        [sys.executable, "-c", CYCLES],
        cwd=Path(__file__).parent,
        capture_output=True,
        text=True,
        timeout=LIMIT,
        check=True,
    )
    # the middleware writes its own warnings there, too, when other processes of the computer leave it waiting
    threads = [int(line) for line in done.stdout.splitlines() if line.isdecimal()]
    assert len(threads) == 4, done.stdout
    assert len(set(threads[1:])) == 1, threads
