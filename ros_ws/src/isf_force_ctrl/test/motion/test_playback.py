"""How soon the tools stand when a path is to be played no further."""

import numpy as np
import pytest
from isf_force_ctrl.control_state import Mode
from isf_force_ctrl.motion.segments import Column, Playback, Segment

RATE, ACCELERATION = 100.0, 0.5
"""Hz, m/s^2; half of it is for braking: 2.5 mm/s in a tick."""


def path(slow: float, fast: float, count: int = 200) -> Segment:
    """Along x, at ``slow`` m/s in the first half and ``fast`` in the second."""
    speed = np.where(np.arange(count) < count // 2, slow, fast)
    rows = np.zeros((count, int(Column.AXIS)))
    rows[:, Column.SPEED] = speed
    rows[1:, Column.TIP_1] = np.cumsum(speed)[:-1] / RATE
    return Segment(Mode.CONTROL, rows.tolist())


@pytest.mark.parametrize(("begin", "ticks"), [(10, 2), (150, 8)])  # 5 mm/s in 0.02 s, 20 mm/s in 0.08 s
def test_slow_tools_stand_sooner(begin: int, ticks: int) -> None:
    segment = path(5e-3, 20e-3)
    playback = Playback(segment.rows[0], ACCELERATION, RATE)
    playback.load([segment])
    for _ in range(begin):
        playback.advance(1.0)
    feeds = [playback.feed]
    while feeds[-1] > 0.0:
        playback.advance(0.0)
        feeds.append(playback.feed)
    assert len(feeds) - 1 == ticks
    assert max(-np.diff(feeds)) <= 2.5e-3 + 1e-9
