"""Limits of a correction, as properties over random requests and paths."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from isf_springback.loop_path import Limits, LoopPath, limit, limit_slope, moving_average, nearest_points

LIMITS = Limits(slope=0.05, average=10e-3, change=1e-3, largest=6e-3, smallest=0.0)
ROUNDING = 1e-12
"""m, sums of double precision numbers of a few mm."""


@st.composite
def paths(draw):
    """A loop of 5 to 120 points with uneven spacing, 20 to 400 mm long, closed or open."""
    steps = np.array(draw(st.lists(st.floats(0.2, 5.0), min_size=5, max_size=120)))
    length = draw(st.floats(0.02, 0.4))
    position = np.concatenate([[0.0], np.cumsum(steps)[:-1]]) * (length / steps.sum())
    closed = draw(st.booleans())
    return LoopPath(position, length if closed else float(position[-1]), closed)


@st.composite
def requests(draw):
    """A path with a request and a previous correction, mm steps and spikes included."""
    path = draw(paths())
    seed = draw(st.integers(0, 2**32 - 1))
    rng = np.random.default_rng(seed)
    level = draw(st.floats(-2e-3, 9e-3))
    rough = draw(st.sampled_from([0.0, 1e-4, 3e-3]))
    request = level + rough * rng.standard_normal(len(path))
    previous = draw(st.sampled_from([0.0, 2e-3, 5e-3]))
    previous = previous + rough * rng.standard_normal(len(path))
    return path, request, previous


def slopes(path, values):
    """|slope| between neighbours, the seam of a closed loop included."""
    steps = np.diff(path.position)
    rise = np.diff(values)
    if path.closed:
        steps = np.append(steps, path.length - path.position[-1])
        rise = np.append(rise, values[0] - values[-1])
    return np.abs(rise) / steps


@settings(max_examples=80, deadline=None)
@given(requests())
def test_all_limits_hold_at_once(case):
    path, request, previous = case
    value, _limited = limit(request, path, LIMITS, previous)
    assert np.isfinite(value).all()
    assert (value >= -ROUNDING).all()
    assert (value <= LIMITS.largest + ROUNDING).all()
    # slopes divide by steps down to about 10 um: rounding of 1e-12 m gives 1e-7
    assert (slopes(path, value) <= LIMITS.slope + 1e-6).all()
    base = np.clip(previous, 0.0, LIMITS.largest)
    smooth_base = limit_slope(path, base, LIMITS.slope)
    assert (np.abs(value - smooth_base) <= LIMITS.change + ROUNDING).all()


@settings(max_examples=80, deadline=None)
@given(requests())
def test_slope_limit_is_the_identity_on_admissible_functions(case):
    path, request, _ = case
    once = limit_slope(path, request, LIMITS.slope)
    assert (slopes(path, once) <= LIMITS.slope + 1e-6).all()
    assert limit_slope(path, once, LIMITS.slope) == pytest.approx(once, abs=ROUNDING)
    assert once.min() >= request.min() - ROUNDING
    assert once.max() <= request.max() + ROUNDING


@settings(max_examples=40, deadline=None)
@given(requests(), st.integers(1, 50))
def test_slope_limit_does_not_depend_on_the_start_of_a_closed_loop(case, turn):
    path, request, _ = case
    if not path.closed:
        return
    turn %= len(path)
    position = np.mod(path.position - path.position[turn], path.length)
    turned = LoopPath(np.roll(position, -turn), path.length, True)
    found = limit_slope(turned, np.roll(request, -turn), LIMITS.slope)
    assert np.roll(found, turn) == pytest.approx(limit_slope(path, request, LIMITS.slope), abs=1e-9)


def even_loop(count=400, length=0.2, closed=True):
    step = length / count if closed else length / (count - 1)
    return LoopPath(step * np.arange(count), length, closed)


def test_a_constant_within_the_limits_passes_unchanged():
    path = even_loop()
    value, limited = limit(np.full(400, 3e-3), path, LIMITS, np.full(400, 2.5e-3))
    assert value == pytest.approx(np.full(400, 3e-3), abs=ROUNDING)
    assert not limited.any()


def test_change_limit_ramps_a_step_over_contours():
    path = even_loop()
    previous = np.zeros(400)
    levels = []
    for _ in range(6):
        value, _limited = limit(np.full(400, 4.5e-3), path, LIMITS, previous)
        previous = value
        levels.append(value[0])
    # 1 mm per contour until 4.5 mm are reached
    assert np.array(levels) == pytest.approx([1e-3, 2e-3, 3e-3, 4e-3, 4.5e-3, 4.5e-3], abs=ROUNDING)


def test_saturation_is_reported_where_it_happens():
    path = even_loop()
    request = np.full(400, 2e-3)
    request[180:220] = 4e-3  # a step of 2 mm needs 40 mm of path at 50 um/mm
    _value, limited = limit(request, path, LIMITS, np.full(400, 2e-3))
    assert limited[200]
    # untouched beyond these 40 mm (80 points) and half the window of the average (10 points)
    assert not limited[: 180 - 91].any()


def test_magnitude_limit_is_reported():
    value, limited = limit(np.full(400, 20e-3), even_loop(), LIMITS, np.full(400, 5.9e-3))
    assert limited.all()
    assert value.max() == pytest.approx(LIMITS.largest, abs=ROUNDING)


def test_an_open_path_starts_where_the_last_one_ended():
    path = even_loop(closed=False)
    value, _limited = limit(np.full(400, 3e-3), path, LIMITS, np.full(400, 2.4e-3), start=2.4e-3)
    assert value[0] == pytest.approx(2.4e-3, abs=ROUNDING)
    # 0.6 mm at 50 um/mm are reached after 12 mm of path
    assert value[path.position > 12e-3] == pytest.approx(3e-3, abs=ROUNDING)


def test_moving_average_of_a_wave():
    # a window w on cos(k s) gives the factor sinc: sin(k w / 2) / (k w / 2)
    path = even_loop()
    wave = 2 * np.pi * 3 / path.length
    found = moving_average(path, np.cos(wave * path.position), 10e-3)
    factor = np.sin(wave * 5e-3) / (wave * 5e-3)
    # the window is rounded to the grid, 16 points or more: 1 %
    assert found == pytest.approx(factor * np.cos(wave * path.position), abs=0.01)


def test_moving_average_does_not_weigh_dense_points():
    dense = np.concatenate([np.linspace(0, 0.01, 200, endpoint=False), np.linspace(0.01, 0.1, 50, endpoint=False)])
    path = LoopPath(dense, 0.1, True)
    values = (dense < 0.01).astype(float)
    # over the whole loop: the share of length (10 %), not of points (80 %); interpolated edges add about 1 %
    assert moving_average(path, values, 0.1) == pytest.approx(np.full(250, 0.1), abs=0.02)


def test_nearest_points():
    others = np.array([[0.0, 0.0], [1.0, 0.0]])
    assert nearest_points(np.array([[0.9, 0.2], [0.1, -3.0]]), others).tolist() == [1, 0]
