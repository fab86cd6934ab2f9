"""The machine's view of its stream of targets, by a clock that stands where the test puts it."""

from __future__ import annotations

import pytest
from isf_sim.ros.targets import TargetStream

PERIOD, TIMEOUT = 0.002, 0.25


class Machine:
    """Ticks by the clock, ``skips`` periods missed before every tick."""

    def __init__(self, skips: int) -> None:
        self.now = 0.0
        self.skips = skips
        self.stream = TargetStream(TIMEOUT, lambda: self.now)

    def run(self, seconds: float, *, targets: bool) -> float | None:
        """s after which the stream was seen to have ended, None when it was not."""
        until, begun = self.now + seconds, self.now
        while self.now < until:
            self.now += (1 + self.skips) * PERIOD
            if targets:
                self.stream.heard()
            self.stream.period(targets, self.skips * PERIOD, moving=True)
            if self.stream.ended():
                return self.now - begun
        return None


@pytest.mark.parametrize("skips", [0, 1, 4])
def test_the_end_of_a_stream_is_seen_however_late_the_machine_is(skips: int) -> None:
    machine = Machine(skips)
    assert machine.run(1.0, targets=True) is None
    ended = machine.run(10.0, targets=False)
    assert ended == pytest.approx(TIMEOUT * (1 + skips), abs=2.0 * (1 + skips) * PERIOD)


def test_a_gap_of_the_machine_itself_is_not_held_against_the_controller() -> None:
    """One tick comes after 0.4 s: the targets of that time are received only after it."""
    machine = Machine(0)
    machine.run(1.0, targets=True)
    machine.now += 0.4
    machine.stream.period(False, 0.4 - PERIOD, moving=True)
    assert not machine.stream.ended()
    assert machine.run(1.0, targets=True) is None


def test_missed_time_is_no_store_for_later() -> None:
    """What was missed before the last target came excuses nothing after it."""
    machine = Machine(0)
    machine.stream.heard()
    machine.stream.period(True, 5.0, moving=False)
    assert machine.run(1.0, targets=False) == pytest.approx(TIMEOUT, abs=2.0 * PERIOD)


def test_pairs_that_do_not_come_are_lost_only_in_motion_and_beyond_two() -> None:
    stream = TargetStream(TIMEOUT, lambda: 0.0)
    stream.period(True, 0.0, moving=True)
    for _ in range(2):
        stream.period(False, 0.0, moving=True)
    assert stream.lost == 0
    stream.period(False, 0.0, moving=False)
    assert stream.lost == 0
    stream.period(False, 0.0, moving=True)
    assert stream.lost == 1
