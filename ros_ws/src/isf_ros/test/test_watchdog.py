"""Receive watchdog on a clock that the test moves."""

import math

from isf_ros.watchdog import ReceiveWatchdog, RegularLook


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


def test_excused_time_does_not_count_and_is_no_store_for_later() -> None:
    now = 0.0
    watchdog = ReceiveWatchdog(0.1, clock=lambda: now)
    watchdog.excuse(1.0)  # nothing was received yet
    assert not watchdog.fed
    watchdog.feed()
    now = 0.3
    watchdog.excuse(0.25)
    assert not watchdog.expired()
    now = 0.36
    assert watchdog.expired()
    watchdog.feed()
    watchdog.excuse(5.0)
    assert watchdog.age() == 0.0
    now = 0.47
    assert watchdog.expired()


def test_a_look_is_late_once_after_the_process_stood_still() -> None:
    now = 0.0
    look = RegularLook(1.0, clock=lambda: now)
    assert not look.late()
    now = 0.9
    assert not look.late()
    now = 3.0
    assert look.late()
    assert not look.late()


def test_usual_distance_follows_the_mean_and_hardly_a_single_gap():
    now = 0.0
    watchdog = ReceiveWatchdog(0.1, clock=lambda: now)
    watchdog.feed()
    assert watchdog.distance == 0.0
    for k in range(1, 401):  # 100 a second, coming in pairs
        now = 0.01 * k - 0.005 * (k % 2)
        watchdog.feed()
    assert abs(watchdog.distance - 0.01) < 2e-4
    now += 0.1
    watchdog.feed()
    assert watchdog.distance < 0.0125
    watchdog.clear()
    assert watchdog.distance == 0.0


def test_silences_do_not_become_usual():
    now = 0.0
    watchdog = ReceiveWatchdog(0.1, clock=lambda: now)
    for _ in range(400):
        now += 0.01
        watchdog.feed()
    for _ in range(10):
        now += 2.5
        watchdog.feed()
    assert watchdog.distance < 0.016


def test_a_first_gap_is_soon_forgotten():
    now = 0.0
    watchdog = ReceiveWatchdog(0.1, clock=lambda: now)
    watchdog.feed()
    now = 0.5
    for _ in range(50):
        watchdog.feed()
        now += 0.01
    assert watchdog.distance < 0.021
