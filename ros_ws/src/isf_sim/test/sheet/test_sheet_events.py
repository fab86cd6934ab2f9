"""Base following and bulge overlay on shapes with known answers."""

from __future__ import annotations

import numpy as np
import pytest
from isf_core.files.material import load_material
from isf_sim.sheet.base_following import follow
from isf_sim.sheet.bulge import bulge_overlay
from isf_sim.sheet.surface import bilinear, empty_track, flat_surface, sample

SIZE = (0.1, 0.1)


def test_base_inside_a_level_track_comes_down_to_it() -> None:
    """lap B = 0 with B = -5 mm on the track: the base is level; outside nothing moves."""
    surface, track = flat_surface(SIZE, 0.5e-3), empty_track(SIZE, 2e-3)
    radius, depth = 20e-3, -5e-3
    for angle in np.linspace(0.0, 2 * np.pi, 400):
        i = round((radius * np.cos(angle) - track.x0) / track.h)
        j = round((radius * np.sin(angle) - track.y0) / track.h)
        track.tip[j, i], track.visited[j, i] = depth, radius * angle
    loop = 2 * np.pi * radius
    follow(surface, track, loop, loop, 0.0, 5e-3)
    x = surface.x0 + surface.h * np.arange(surface.height.shape[1])
    r = np.hypot(x[None, :], x[:, None])
    assert surface.height[r < 16e-3] == pytest.approx(depth, abs=2e-6)  # the relaxation ends at steps of 0.1 um
    assert (surface.height[r > 25e-3] == 0.0).all()


def test_base_under_a_pillow_bulges_by_its_height() -> None:
    """lap B = -q with q = 4 h / r^2 has the height h over a circle."""
    surface, track = flat_surface(SIZE, 0.5e-3), empty_track(SIZE, 2e-3)
    loop = 2 * np.pi * 30e-3
    for angle in np.linspace(0.0, 2 * np.pi, 800):
        i = round((30e-3 * np.cos(angle) - track.x0) / track.h)
        j = round((30e-3 * np.sin(angle) - track.y0) / track.h)
        track.tip[j, i], track.visited[j, i] = -5e-3, 30e-3 * angle
    for _ in range(3):
        follow(surface, track, loop, loop, 0.3e-3, 5e-3)
    middle = track.base[track.base.shape[0] // 2, track.base.shape[1] // 2]
    assert middle + 5e-3 == pytest.approx(0.3e-3, rel=0.08)  # the circle is made of squares of 2 mm


def test_open_track_moves_nothing() -> None:
    surface, track = flat_surface(SIZE, 0.5e-3), empty_track(SIZE, 2e-3)
    track.tip[20, 10:40], track.visited[20, 10:40] = -5e-3, 0.1
    follow(surface, track, 0.1, 0.1, 0.0, 5e-3)
    assert (surface.height == 0.0).all()


def test_flat_formed_area_bulges_as_a_membrane_would() -> None:
    """Without curvature lap b = -k: height 0.0737 k a^2 in the middle of a square of side a (Timoshenko's torsion)."""
    surface = flat_surface(SIZE, 0.5e-3)
    material = load_material("AA5754-O")
    x = surface.x0 + surface.h * np.arange(surface.height.shape[1])
    side = 60e-3
    surface.formed[(np.abs(x) < side / 2)[:, None] & (np.abs(x) < side / 2)[None, :]] = 1
    overlay = bulge_overlay(surface, 4, 0.5, 1e-3, material)
    curvature = 0.5 * 3 * 215e6 / (70e9 * 1e-3)
    # 7 %: the edge of the area lies between nodes of 2 mm
    assert overlay.max() == pytest.approx(0.0737 * curvature * side**2, rel=0.07)
    assert overlay[0, 0] == 0.0


def test_grids_exchange_linear_fields_exactly() -> None:
    surface = flat_surface((0.1, 0.08), 0.5e-3)
    rows, columns = surface.height.shape
    x, y = surface.x0 + surface.h * np.arange(columns), surface.y0 + surface.h * np.arange(rows)
    field = 2.0 * x - 3.0 * y[:, None]
    surface.height[:] = field
    assert bilinear(field, surface.x0, surface.y0, surface.h, 0.013, -0.021) == pytest.approx(0.026 + 0.063)
    x, y = np.array([-0.03, 0.01, 0.02]), np.array([0.005, 0.01, 0.02])
    assert sample(surface, x, y)[0] == pytest.approx(2.0 * x - 3.0 * y[:, None], abs=1e-12)
