"""Calls to a driver in another process."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from asking_client import client_of, no_watch
from isf_cell.run.graph_client import ASK_AGAIN, GraphClient
from isf_cell.run.machine_client import HARMLESS, MachineClient
from isf_core.errors import ErrorCode, IsfError
from isf_msgs.srv import Tare

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
    with client_of(DRIVER, 3.0 * ASK_AGAIN) as made:
        yield made


def test_a_slow_driver_is_asked_to_tare_once(client: GraphClient) -> None:
    """A second tare would run on when the tools move already."""
    client.prepare([(Tare, "machine/tare"), HARMLESS])
    assert client.within(60.0, lambda: client.offers(*HARMLESS), no_watch)
    machine = MachineClient(client, lockstep=False, report=lambda _: None)
    with pytest.raises(IsfError) as refused:
        machine.tare(no_watch)
    assert refused.value.code == ErrorCode.FORCE_LIMIT
    assert "asked 1 times" in str(refused.value)
