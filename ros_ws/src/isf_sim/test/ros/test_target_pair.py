"""Pairing of targets by stamps, and periods that a machine in real time missed."""

from __future__ import annotations

import gc
import sys
import threading

from isf_sim.real_time import PeriodicThread
from isf_sim.ros.targets import TargetPair

A, B = (0.0, 0.0, 0.1), (0.0, 0.0, -0.1)


def test_lockstep_takes_a_pair_of_exactly_the_stamp_due_once() -> None:
    pair = TargetPair()
    pair.add(1, 200, A)
    assert pair.take_at(200) is None  # tool 2 is missing
    pair.add(2, 100, B)
    assert pair.take_at(200) is None  # of another tick
    pair.add(2, 200, B)
    assert pair.take_at(200) == (A, B)
    assert pair.take_at(200) is None  # taken already
    assert pair.received == 1


def test_real_time_takes_the_newest_and_reports_the_time_between() -> None:
    pair = TargetPair()
    for stamp in (1000, 5000):
        pair.add(1, stamp - 500, B)
        pair.add(1, stamp, A)
        pair.add(2, stamp, B)
        assert pair.take_newest() == (A, B)
        assert pair.take_newest() is None
    assert pair.elapsed == 4000
    pair.add(1, 6000, A)
    pair.add(2, 6000, B)
    pair.clear()
    assert pair.take_newest() is None
    for tool, tip in ((1, A), (2, B)):
        pair.add(tool, 9000, tip)
    assert pair.take_newest() == (A, B)
    assert pair.elapsed == 0  # a stream that begins, not one that was late


def test_a_step_that_takes_long_makes_the_thread_skip_and_count() -> None:
    """The third step waits until five periods have certainly gone by; their numbers are missing and counted."""
    seen: list[int] = []
    done = threading.Event()

    def step(period: int) -> None:
        seen.append(period)
        if len(seen) == 3:
            threading.Event().wait(5 / 200.0)
        if len(seen) == 6:
            done.set()

    thread = PeriodicThread(200.0, step)
    thread.start()
    assert done.wait(120.0)
    thread.stop()
    assert seen == sorted(set(seen))
    assert seen[3] - seen[2] >= 5
    assert thread.late >= seen[-1] + 1 - len(seen) >= 4  # more, when the last step was followed by a gap


def test_the_interpreter_is_as_before_after_the_thread() -> None:
    interval, frozen = sys.getswitchinterval(), gc.get_freeze_count()
    thread = PeriodicThread(200.0, lambda period: None)
    assert sys.getswitchinterval() < interval
    assert gc.get_freeze_count() > frozen
    assert gc.isenabled()  # what is made from now on is collected
    thread.start()
    thread.stop()
    assert sys.getswitchinterval() == interval
    assert gc.get_freeze_count() == 0


def test_with_a_blank_holder_three_targets_make_a_pair() -> None:
    pair = TargetPair()
    pair.expect_holder(True)
    pair.add(1, 2000, A)
    pair.add(2, 2000, B)
    assert pair.take_at(2000) is None
    pair.add_holder(1000, -1e-3)
    assert pair.take_at(2000) is None
    pair.add_holder(2000, -2e-3)
    assert pair.take_at(2000) == (A, B)
    assert pair.holder == -2e-3
    pair.expect_holder(False)
    pair.add(1, 4000, A)
    pair.add(2, 4000, B)
    assert pair.take_at(4000) == (A, B)
    assert pair.holder == 0.0
