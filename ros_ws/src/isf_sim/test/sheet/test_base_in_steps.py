"""Base following and control points against the plainest way to work them out: not a bit differs."""

from __future__ import annotations

import math

import numpy as np
import pytest
from isf_sim.sheet import base_following
from isf_sim.sheet.base_following import ENCLOSED, OUTSIDE, TRACK
from isf_sim.sheet.control_points import CAPACITY, ControlPoints, add_point, nearest_point, no_control_points
from isf_sim.sheet.surface import Surface, TipTrack, bilinear, empty_track, flat_surface

SIZE = (0.07, 0.06)


def walked(seed: int) -> tuple[Surface, TipTrack, float]:
    """A wavy loop at uneven depth over a rough sheet, and its length m."""
    random = np.random.default_rng(seed)
    surface, track = flat_surface(SIZE, 0.5e-3), empty_track(SIZE, 2e-3)
    surface.height[...] = random.normal(-4e-3, 1e-3, surface.height.shape)
    wave, path = random.uniform(0.0, 3e-3), 0.0
    for angle in np.linspace(0.0, 2 * np.pi, 300):
        radius = 20e-3 + wave * math.cos(5.0 * angle)
        i = round((radius * math.cos(angle) - track.x0) / track.h)
        j = round((radius * math.sin(angle) - track.y0) / track.h)
        path += 20e-3 * 2 * np.pi / 300
        track.tip[j, i], track.visited[j, i] = -5e-3 + random.normal(0.0, 1e-4), path
    return surface, track, path


def row_by_row(surface: Surface, track: TipTrack, source: float) -> None:
    """The base relaxed node after node, and the sheet lowered node after node; ``source`` m."""
    base, region = track.base, track.region
    ny, nx = region.shape
    base[region == TRACK] = track.tip[region == TRACK]
    for _ in range(base_following.LARGEST_SWEEPS):
        largest = 0.0
        for j in range(1, ny - 1):
            for i in range(1, nx - 1):
                if region[j, i] == ENCLOSED:
                    mean = 0.25 * (base[j - 1, i] + base[j + 1, i] + base[j, i - 1] + base[j, i + 1] + source)
                    change = base_following.RELAXATION * (mean - base[j, i])
                    base[j, i] += change
                    largest = max(largest, abs(change))
        if largest < base_following.ACCURACY:
            break
    for row in range(surface.height.shape[0]):
        for column in range(surface.height.shape[1]):
            x, y = surface.x0 + column * surface.h, surface.y0 + row * surface.h
            a, b = int((x - track.x0) / track.h), int((y - track.y0) / track.h)
            if a + 1 < nx and b + 1 < ny and (region[b : b + 2, a : a + 2] != OUTSIDE).all():
                value = bilinear(track.base, track.x0, track.y0, track.h, x, y)
                surface.height[row, column] = min(surface.height[row, column], value)


@pytest.mark.parametrize("seed", range(3))
def test_relaxation_by_diagonals_is_row_by_row_to_the_last_bit(seed: int) -> None:
    surface, track, path = walked(seed)
    plain, plain_track, _ = walked(seed)
    pillow, radius = 0.2e-3, 5e-3
    base_following.follow(surface, track, path, path, pillow, radius)
    plain_track.region[...] = track.region  # which nodes are enclosed is found as before
    square = np.count_nonzero(track.region == ENCLOSED) * track.h**2 / math.pi
    height = pillow * min(1.0, square / (4.0 * radius) ** 2)
    row_by_row(plain, plain_track, 4.0 * height / square * track.h**2)
    assert np.array_equal(track.base, plain_track.base)
    assert np.array_equal(surface.height, plain.height)
    assert (surface.height < walked(seed)[0].height).any()


def some_points(random: np.random.Generator, count: int) -> ControlPoints:
    points = no_control_points()
    points.used[0] = count
    points.place[:count] = random.uniform(-20e-3, 20e-3, (count, 3))
    points.displacement[:count] = random.normal(0.0, 1e-3, (count, 3))
    points.force[:count] = random.uniform(30.0, 900.0, count)
    points.exponent[:count] = random.uniform(0.3, 1.0, count)
    return points


@pytest.mark.parametrize("count", [0, 1, 30, CAPACITY])
@pytest.mark.parametrize("near", [0.0, 9.6e-3])
def test_control_points_are_kept_as_arrays_would_be(count: int, near: float) -> None:
    random = np.random.default_rng(count)
    points, plain = (some_points(np.random.default_rng(count), count) for _ in range(2))
    tip, displacement = random.uniform(-20e-3, 20e-3, 3), random.normal(0.0, 1e-3, 3)
    force, compliance, give, tall = 400.0, 2e-6, 1e-7, 12e-3
    away = plain.place[:count] - tip
    square = ((away * [1.0, 1.0, 3.0]) ** 2).sum(axis=1)
    nearest, least = nearest_point(points, tip)
    assert (nearest, least) == ((int(np.argmin(square)), square.min()) if count else (-1, math.inf))
    keep = (away[:, 0] ** 2 + away[:, 1] ** 2 > near**2) & (np.abs(away[:, 2]) < tall)
    kept = np.flatnonzero(keep)[-(CAPACITY - 1) :]
    chosen = np.empty(CAPACITY, dtype=np.int64)
    n = add_point(points, tip, force, displacement, compliance, give, near**2, tall, chosen)
    assert chosen[:n].tolist() == kept.tolist()
    for name in ("place", "displacement", "force", "exponent"):
        assert np.array_equal(getattr(points, name)[:n], getattr(plain, name)[kept]), name
    moved = displacement - np.array([0.0, 0.0, give * force])
    assert np.array_equal(points.displacement[n], moved)
    assert points.exponent[n] == np.clip((compliance + give) * force / max(-moved[2], 1e-9), 0.3, 1.0)
    assert (points.used[0], points.force[n]) == (n + 1, force)
