"""Receive watchdog on a clock that the test moves."""

import math

from isf_node.watchdog import ReceiveWatchdog


def test_it_expires_only_after_something_came_and_then_nothing() -> None:
    now = 0.0
    watchdog = ReceiveWatchdog(0.1, clock=lambda: now)
    assert not watchdog.fed
    assert watchdog.age() == math.inf
    now = 5.0
    assert not watchdog.expired()
    watchdog.feed()
    now = 5.09
    assert not watchdog.expired()
    now = 5.11
    assert watchdog.expired()
    watchdog.feed()
    assert not watchdog.expired()
    now = 9.0
    watchdog.clear()
    assert not watchdog.expired()
