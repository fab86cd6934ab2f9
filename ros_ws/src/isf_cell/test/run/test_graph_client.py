"""Questions and goals to a node in another process, whose answers come early, late or never."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

import pytest
import rclpy
import rclpy.action.client
from asking_client import client_of, no_watch
from isf_cell.run.graph_client import ASK_AGAIN, GraphClient
from isf_core.errors import ErrorCode, IsfError
from isf_msgs.action import LiftTool
from lifecycle_msgs.msg import State
from lifecycle_msgs.srv import GetState
from rclpy.task import Future

pytestmark = pytest.mark.graph

SERVER = """
import rclpy, sys
from isf_msgs.action import LiftTool
from lifecycle_msgs.srv import GetState
from rclpy.action import ActionServer
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.task import Future

lost, asked = int(sys.argv[1]), 0

async def answer(request, response):
    global asked
    asked += 1
    if asked <= lost:
        await Future()  # never done: as an answer that the middleware dropped
    response.current_state.id = 3
    response.current_state.label = str(asked)
    return response

def lift(handle):
    handle.succeed()
    return LiftTool.Result(force=handle.request.speed)

rclpy.init()
node = rclpy.create_node("forgetful")
server = ActionServer(node, LiftTool, "lift_tool", lift)
node.create_service(GetState, "forgetful/get_state", answer, callback_group=ReentrantCallbackGroup())
try:
    rclpy.spin(node)
except KeyboardInterrupt:
    pass
"""


@pytest.fixture
def client(request: pytest.FixtureRequest) -> Iterator[GraphClient]:
    """Of a server that loses as many answers as the parameter says."""
    with client_of(SERVER, request.param, timeout=3.0 * ASK_AGAIN if request.param > 1 else 60.0) as made:
        yield made


@pytest.mark.parametrize("client", [1], indirect=True)
def test_a_question_without_an_answer_is_asked_again(client: GraphClient) -> None:
    assert client.state_of("forgetful", no_watch) == State.PRIMARY_STATE_ACTIVE


@pytest.mark.parametrize("client", [1000], indirect=True)
def test_a_server_that_never_answers_is_named(client: GraphClient) -> None:
    # its process may take longer to come up than an answer is waited for
    assert client.within(60.0, lambda: client.offers(GetState, "forgetful/get_state"), no_watch)
    with pytest.raises(IsfError) as silent:
        client.state_of("forgetful", no_watch)
    assert silent.value.code == ErrorCode.SERVICE_TIMEOUT
    assert "'forgetful/get_state' did not answer within 6 s" in str(silent.value)


@pytest.mark.parametrize("client", [0], indirect=True)
def test_answers_of_an_action_that_come_before_they_are_expected_are_taken(
    client: GraphClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    """rclpy makes its note of a request after it has sent it; here it takes its time."""

    def slow(*options: Any) -> Future:
        time.sleep(0.3)  # the fault itself: the answer comes between sending and note
        return Future(*options)

    monkeypatch.setattr(rclpy.action.client, "Future", slow)
    result = client.run_action(LiftTool, "lift_tool", LiftTool.Goal(speed=0.25), no_watch, lambda _: None, timeout=60.0)
    assert result.force == 0.25
