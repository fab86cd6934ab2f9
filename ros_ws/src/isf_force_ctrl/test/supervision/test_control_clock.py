"""Ticks by the clock in step with the wrenches, distribution of times, and stamps that are old, late or jump."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from isf_core.errors import ErrorCode, IsfError
from isf_force_ctrl.ros.control_clock import PATIENCE, PeriodicLoop
from isf_force_ctrl.supervision.latency import Durations
from isf_force_ctrl.supervision.wrench_receiver import StampWatch, WrenchReceiver
from isf_ros.thread_priority import RealTimeSettings

PERIOD = 0.002


def not_asked(frame: str, stamp: int, wrench: Sequence[float]) -> Sequence[float]:
    """Axes of wrenches that are in those of the sheet."""
    raise IsfError(ErrorCode.WRENCH_FRAME, f"{frame} at {stamp}")


class Time:
    """A clock that stands where it is put."""

    def __init__(self) -> None:
        self.now = 0.0

    def __call__(self) -> float:
        return self.now


def run(arrivals: np.ndarray, period: float = PERIOD, until: float = 4.0, work: float = 0.0) -> tuple:
    """A loop with the pairs of wrenches at ``arrivals`` s; ticks last ``work`` s. Returns loop and times of ticks."""
    clock, times = Time(), []

    def step() -> None:
        times.append(clock.now)
        clock.now += work

    loop = PeriodicLoop(1.0 / period, step, clock=clock)
    waiting = sorted(arrivals.tolist(), reverse=True)
    while clock.now < until:
        look = clock.now + max(loop.tick_if_overdue(), 0.0)
        if waiting and waiting[-1] <= look:
            clock.now = max(clock.now, waiting.pop())
            loop.offer()
        else:
            clock.now = max(look, clock.now + 1e-9)
    return loop, np.array(times)


def test_every_pair_is_answered_at_once() -> None:
    arrivals = 0.0007 + PERIOD * np.arange(2000)
    loop, times = run(arrivals)
    assert loop.answered >= 1995
    assert loop.late_ticks == 0
    settled = times[(times > 0.1) & (times < 3.9)]
    assert np.isin(np.round(settled, 7), np.round(arrivals, 7)).all()


def test_a_sensor_whose_clock_drifts_is_followed() -> None:
    arrivals = 1.0008 * PERIOD * np.arange(1999)  # 800 ppm: far more than quartz
    _, times = run(arrivals)
    assert np.mean(np.isin(np.round(times, 7), np.round(arrivals, 7))) > 0.99
    assert np.diff(times).mean() == pytest.approx(1.0008 * PERIOD, rel=1e-4)


@pytest.mark.parametrize("rate", [100.0, 440.0, 1000.0, 2000.0])
def test_another_sensor_rate_leaves_the_tick_rate(rate: float) -> None:
    _, times = run(np.arange(0.0003, 4.0, 1.0 / rate))
    assert len(times) == pytest.approx(4.0 / PERIOD, rel=0.011)
    assert np.diff(times[10:]).max() < 1.6 * PERIOD


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(0.0, 0.3), st.floats(0.0, 0.3))
def test_lost_and_scattered_wrenches_never_stop_the_ticks(seed: int, lost: float, jitter: float) -> None:
    random = np.random.default_rng(seed)
    arrivals = PERIOD * np.arange(1000) + random.uniform(0.0, jitter * PERIOD, 1000)
    loop, times = run(arrivals[random.random(1000) >= lost], until=2.0)
    assert len(times) == pytest.approx(1000, abs=15)
    # a tick waits for its wrenches for a part of a period only
    assert np.diff(times[5:]).max() <= (1.0 + PATIENCE + 0.3 + 0.02) * PERIOD
    assert loop.late_ticks == 0


def test_ticks_that_take_too_long_are_counted_and_dropped() -> None:
    loop, times = run(np.empty(0), until=1.0, work=1.5 * PERIOD)
    # each is late; those that cannot be caught up are counted as well
    assert loop.late_ticks >= len(times)
    assert loop.late_ticks + 51 >= round(1.0 / PERIOD) - len(times)


def test_the_collector_rests_while_the_loop_runs() -> None:
    import gc

    loop = PeriodicLoop(1000.0, lambda: None, RealTimeSettings(0, False))
    loop.start()
    try:
        assert not gc.isenabled()
    finally:
        loop.stop()
    assert gc.isenabled()


@settings(max_examples=50, deadline=None)
@given(st.lists(st.floats(2e-6, 5.0), min_size=1, max_size=200), st.sampled_from([0.5, 0.9, 0.99]))
def test_percentiles_are_within_one_per_cent(values: list[float], share: float) -> None:
    durations = Durations()
    for value in values:
        durations.add(value)
    true = sorted(values)[max(0, math.ceil(share * len(values)) - 1)]
    assert true * (1 - 1e-9) <= durations.percentile(share) <= 1.0101 * true
    assert durations.largest == max(values)


def test_nothing_measured_has_no_percentiles() -> None:
    assert Durations().values("latency") == {}
    assert math.isnan(Durations().percentile(0.5))


# -- stamps --------------------------------------------------------------------------------------


def stream(watch: StampWatch, stamps: np.ndarray, received: np.ndarray) -> list:
    """What the watch says to each stamp (s)."""
    return [watch.check(round(stamp * 1e9), now) for stamp, now in zip(stamps, received, strict=True)]


def test_a_steady_stream_is_used_whatever_the_clocks_say() -> None:
    now = PERIOD * np.arange(5000)
    watch = StampWatch(1, 0.03, 0.1)
    assert set(stream(watch, 1e9 + now * (1 + 2e-4), now)) == {(True, None)}  # 200 ppm drift, other epoch
    assert (watch.old, watch.late) == (0, 0)


def test_old_messages_are_counted_and_not_used() -> None:
    now = PERIOD * np.arange(1000)
    stamps = 5.0 + now
    stamps[100::100] -= 0.05
    found = stream(watch := StampWatch(2, 0.03, 0.1), stamps, now)
    assert watch.old == 9
    assert [use for use, _ in found].count(False) == 9
    assert all(fault is None for _, fault in found)


def test_a_stream_that_becomes_late_is_a_fault() -> None:
    stamps = PERIOD * np.arange(1000)
    now = stamps + 0.0003
    now[500:] += 0.05
    found = stream(watch := StampWatch(2, 0.03, 0.1), stamps, now)
    first = next(k for k, (_, fault) in enumerate(found) if fault)
    assert found[first][1][0] == ErrorCode.WRENCH_LATE
    assert "50 ms later" in found[first][1][1]
    assert 0.1 <= stamps[first] - stamps[500] <= 0.11
    assert watch.late == 500


def test_a_moment_of_lateness_is_counted_only() -> None:
    stamps = PERIOD * np.arange(1000)
    now = np.maximum(stamps, np.where((stamps > 1.0) & (stamps < 1.06), 1.06, 0.0))  # 60 ms come at once
    found = stream(watch := StampWatch(1, 0.03, 0.1), stamps, now)
    assert all(use and fault is None for use, fault in found)
    assert 0 < watch.late < 20


def test_a_receiver_that_stood_still_blames_no_clock() -> None:
    """Its queue is short: it holds the message after which it stood still, and then those of the present."""
    before = PERIOD * np.arange(500)
    stamps = np.concatenate([before, [1.0], 3.0 + before])
    received = np.concatenate([before, [3.0], 3.0 + before]) + 0.0003
    found = stream(watch := StampWatch(1, 0.03, 0.1), stamps, received)
    assert set(found) == {(True, None)}
    assert watch.late == 1


@pytest.mark.parametrize("jump", [-3600.0, -1.0, 1.0, 3600.0])
@pytest.mark.parametrize("most_delay", [0.03, math.inf])
def test_a_clock_that_jumps_is_a_fault(jump: float, most_delay: float) -> None:
    now = PERIOD * np.arange(200)
    stamps = 1e4 + now + np.where(now > 0.2, jump, 0.0)
    found = stream(watch := StampWatch(1, most_delay, 0.1), stamps, now)
    use, fault = next(item for item in found if item[1])
    assert not use
    assert fault[0] == ErrorCode.WRENCH_CLOCK
    assert f"{jump:+.2f} s" in fault[1] or f"{jump + PERIOD:+.2f} s" in fault[1]
    watch.restart()
    assert stream(watch, stamps[150:], now[150:])[0] == (True, None)


def test_lockstep_time_may_stand_still() -> None:
    stamps = PERIOD * np.arange(100)
    now = stamps + np.where(stamps > 0.1, 600.0, 0.0)
    assert set(stream(StampWatch(1, math.inf, 0.1), stamps, now)) == {(True, None)}


@pytest.mark.parametrize(
    ("times", "codes"),
    [((130, 131), (None, ErrorCode.WRENCH_CLOCK)), ((95,), (ErrorCode.WRENCH_CLOCK,))],
    ids=["on, once", "back"],
)
def test_before_a_contour_in_lockstep_time_may_go_on_but_not_back(
    times: tuple[int, ...], codes: tuple[ErrorCode | None, ...]
) -> None:
    """As a scan takes its time. s."""
    receiver = WrenchReceiver("sheet", not_asked, math.inf, 0.1)

    def code(time: int) -> ErrorCode | None:
        _, fault = receiver.add(1, "sheet", time * 1_000_000_000, [0.0] * 6)
        return fault[0] if fault else None

    assert code(100) is None
    receiver.begin_contour()
    assert tuple(code(time) for time in times) == codes


def test_unstamped_wrenches_are_taken_as_they_come() -> None:
    receiver = WrenchReceiver("sheet", not_asked, 0.03, 0.1)
    for value in (1.0, 2.0):
        for tool in (1, 2):
            assert receiver.add(tool, "sheet", 0, [value] * 6) == (True, None)
        assert receiver.pair.fresh([1, 2])
        receiver.pair.use()
    assert receiver.pair.wrench == [[2.0] * 6] * 2
    assert receiver.add(1, "tool0", 0, [0.0] * 6)[1][0] == ErrorCode.WRENCH_FRAME
