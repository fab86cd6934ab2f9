"""Calls to a driver in another process."""

from __future__ import annotations

import subprocess
import sys
import threading
from collections.abc import Iterator

import pytest
import rclpy
from isf_cell.run.graph_client import ASK_AGAIN, GraphClient
from isf_cell.run.machine_client import HARMLESS, MachineClient
from isf_core.errors import ErrorCode, IsfError
from isf_msgs.srv import Tare
from rclpy.executors import SingleThreadedExecutor

pytestmark = pytest.mark.graph

DRIVER = """
import sys
import rclpy
from isf_msgs.srv import Tare
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.task import Future

rclpy.init()
node = rclpy.create_node("machine")
asked, slow = 0, Future()

async def tare(request, response):
    global asked
    asked += 1
    if asked == 1:
        node.create_timer(float(sys.argv[1]), lambda: slow.done() or slow.set_result(None))
    await slow  # takes its time, whoever else asks meanwhile
    response.code, response.message = 1405, f"asked {asked} times"
    return response

node.create_service(Tare, "machine/tare", tare, callback_group=ReentrantCallbackGroup())
try:
    rclpy.spin(node)
except KeyboardInterrupt:
    pass
"""


@pytest.fixture
def client() -> Iterator[GraphClient]:
    """Of a driver whose tare takes longer than a question is waited for before it is asked again."""
    rclpy.init()
    node, executor = rclpy.create_node("asking"), SingleThreadedExecutor()
    executor.add_node(node)
    spinning = threading.Thread(target=executor.spin, daemon=True)
    spinning.start()
    driver = subprocess.Popen([sys.executable, "-c", DRIVER, str(3.0 * ASK_AGAIN)])
    made = GraphClient(node, timeout=60.0)
    try:
        yield made
    finally:
        driver.kill()  # SIGTERM that comes between two waits of rclpy.spin() may not end it
        driver.wait(60)
        executor.shutdown()
        spinning.join(60)
        made.close()
        node.destroy_node()
        rclpy.try_shutdown()


def no_watch() -> None:
    """Nothing else ends a wait."""


def test_a_slow_driver_is_asked_to_tare_once(client: GraphClient) -> None:
    """A second tare would run on when the tools move already."""
    client.prepare([(Tare, "machine/tare"), HARMLESS])
    assert client.within(60.0, lambda: client.offers(*HARMLESS), no_watch)
    machine = MachineClient(client, lockstep=False, report=lambda _: None)
    with pytest.raises(IsfError) as refused:
        machine.tare(no_watch)
    assert refused.value.code == ErrorCode.FORCE_LIMIT
    assert "asked 1 times" in str(refused.value)
