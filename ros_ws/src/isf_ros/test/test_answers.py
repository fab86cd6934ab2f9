"""Answers that the middleware drops because it has not discovered the client yet are sent again."""

from __future__ import annotations

import warnings
from collections.abc import Callable

import pytest
from isf_ros.answers import sent_until_taken
from rclpy.exceptions import InvalidHandle

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
