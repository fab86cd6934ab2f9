"""Answers that the middleware drops because it has not discovered the client yet are sent again; goals wait for it."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Iterator

import pytest
import rclpy
from isf_ros.answers import answers_reach_all, client_discovered, sent_until_taken
from rclpy.exceptions import InvalidHandle
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from std_srvs.srv import Trigger

# as rclpy 7.1 words it, seen on a loaded computer
DROPPED = (
    "failed to send response (timeout): client will not receive response, at /project/src/rmw_response.cpp:153, at "
    "/project/src/rcl/service.c:400"
)


class Server:
    """A service whose first ``drops`` answers are dropped; what is to be done later is done by the test."""

    def __init__(self, drops: int) -> None:
        self.drops = drops
        self.sent: list[tuple[object, object]] = []
        self.waiting: list[Callable[[], None]] = []
        self.send = sent_until_taken(self._send, self.waiting.append)

    def _send(self, response: object, header: object) -> None:
        if self.drops:
            self.drops -= 1
            warnings.warn(DROPPED, RuntimeWarning, stacklevel=1)
        else:
            self.sent.append((response, header))

    def do_waiting(self) -> int:
        """Until nothing waits; returns how often something did."""
        count = 0
        while self.waiting:
            self.waiting.pop()()
            count += 1
        return count


@pytest.mark.parametrize("drops", [0, 1, 7, 19])
def test_an_answer_is_sent_until_it_is_taken(drops: int, recwarn: pytest.WarningsRecorder) -> None:
    server = Server(drops)
    server.send("answer", "header")
    assert server.do_waiting() == drops
    assert server.sent == [("answer", "header")]
    assert not recwarn.list


def test_a_client_that_never_takes_it_is_given_up_with_the_warning() -> None:
    server = Server(1000)
    server.send("answer", "header")
    while server.drops > 981:
        server.waiting.pop()()
    with pytest.warns(RuntimeWarning, match="will not receive") as given:
        server.waiting.pop()()
    assert len(given) == 1
    assert not server.waiting
    assert not server.sent


def test_other_warnings_are_given_at_once() -> None:
    send = sent_until_taken(lambda *_: warnings.warn("of another kind", UserWarning, stacklevel=1), lambda _: None)
    with pytest.warns(UserWarning, match="another kind"):
        send("answer", "header")


def test_a_service_that_was_destroyed_meanwhile_is_left_alone() -> None:
    waiting: list[Callable[[], None]] = []
    calls = 0

    def send(*_: object) -> None:
        nonlocal calls
        calls += 1
        if calls > 1:
            raise InvalidHandle
        warnings.warn(DROPPED, RuntimeWarning, stacklevel=1)

    sent_until_taken(send, waiting.append)("answer", "header")
    waiting.pop()()
    assert calls == 2
    assert not waiting


class Graph(Node):
    """A node that tells of a graph in which one client of every service asks, whose place for answers is discovered at
    the look number ``discovered_at``."""

    def __init__(self, discovered_at: int) -> None:
        super().__init__("serving")
        self.looks: list[str] = []
        self._discovered_at = discovered_at

    def get_publishers_info_by_topic(self, topic_name: str, no_mangle: bool = False) -> list[object]:
        assert no_mangle
        self.looks.append(topic_name)
        return [object()]

    def get_subscriptions_info_by_topic(self, topic_name: str, no_mangle: bool = False) -> list[object]:
        assert no_mangle
        return [object()] * (len(self.looks) >= self._discovered_at)


@pytest.fixture
def context() -> Iterator[None]:
    rclpy.init()
    yield
    rclpy.try_shutdown()


@pytest.mark.graph
@pytest.mark.parametrize("discovered_at", [1, 9])
def test_a_goal_waits_until_every_answer_of_its_action_can_be_taken(context: None, discovered_at: int) -> None:
    node = Graph(discovered_at)
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    waiting = executor.create_task(client_discovered(node, "cell/plan"))
    executor.spin_until_future_complete(waiting, timeout_sec=60.0)
    assert waiting.done()
    assert waiting.exception() is None
    assert len(node.looks) == discovered_at + 2
    assert node.looks[-3:] == [
        "rq/cell/plan/_action/send_goalRequest",
        "rq/cell/plan/_action/cancel_goalRequest",
        "rq/cell/plan/_action/get_resultRequest",
    ]
    node.destroy_node()


@pytest.mark.graph
def test_clients_of_a_service_are_known_by_the_names_that_dds_has(context: None) -> None:
    serving, asking = rclpy.create_node("serving", namespace="cell"), rclpy.create_node("asking", namespace="cell")
    serving.create_service(Trigger, "ask", lambda _, response: response)

    def count() -> tuple[int, int]:
        requests = serving.get_publishers_info_by_topic("rq/cell/askRequest", no_mangle=True)
        answers = serving.get_subscriptions_info_by_topic("rr/cell/askReply", no_mangle=True)
        return len(requests), len(answers)

    def becomes(expected: tuple[int, int]) -> bool:
        deadline = time.monotonic() + 60.0
        while count() != expected and time.monotonic() < deadline:
            rclpy.spin_once(serving, timeout_sec=0.05)
        return count() == expected and answers_reach_all(serving, "ask")

    assert becomes((0, 0))
    clients = [asking.create_client(Trigger, "ask") for _ in range(2)]
    assert becomes((2, 2))
    asking.destroy_client(clients[0])
    assert becomes((1, 1))
    serving.destroy_node()
    asking.destroy_node()
