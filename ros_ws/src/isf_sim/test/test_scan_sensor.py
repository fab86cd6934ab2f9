"""The scanner: noise within its published bound, registration, patches that are missing, trimming."""

from __future__ import annotations

import numpy as np
import pytest
from isf_core.geometry.height_map import HeightMap
from isf_sim.scanner import NOISE, TRIM_MARGIN, measured_points
from isf_sim.sheet.surface import Surface, flat_surface
from isf_sim.variant import STANDARD_VARIANTS, Variant, make_variant

AWAY = np.array([[0.0, 0.0, 0.3], [0.0, 0.0, -0.3]])
RADII = np.array([5e-3, 5e-3])
SLOPE = np.tan(np.radians(50.0))


def cone(angle: float = SLOPE, tilt: float = 0.0) -> tuple[HeightMap, Surface]:
    """Cone of 30 mm opening radius, 15 mm deep, in a blank of 160 mm; ``tilt`` as a slope of the whole blank."""
    surface = flat_surface((0.16, 0.16), 0.5e-3)
    x = surface.x0 + surface.h * np.arange(surface.height.shape[1])
    gx, gy = np.meshgrid(x, x)
    r = np.hypot(gx, gy)
    z = -np.clip((30e-3 - r) * angle, 0.0, 15e-3)
    surface.height[...] = z
    surface.formed[(z < 0.0) & (z > -15e-3)] = 1
    return HeightMap(x[::2], x[::2], (z + tilt * gx)[::2, ::2]), surface


def scan(
    variant: Variant | None = None, seed: int = 1, clamped: bool = True, **shape: float
) -> tuple[HeightMap, np.ndarray]:
    true, surface = cone(**shape)
    points = measured_points(true, surface, AWAY, RADII, variant or Variant(), np.random.default_rng(seed), clamped)
    return true, points


def test_noise_stays_within_its_bound_where_the_sheet_is_flat() -> None:
    """Lu 2016, 3.5.2: within +-0.05 mm; on top of it comes the registration of this scan, 0.02 mm and 0.2 mrad."""
    _, points = scan()
    flat = points[np.hypot(points[:, 0], points[:, 1]) > 40e-3]
    assert len(flat) > 10_000
    height = flat[:, 2] - flat[:, 2].mean()
    assert np.abs(height).max() <= 1.02 * NOISE  # the mean itself is known to a hundredth
    assert height.std() == pytest.approx(NOISE / 3.0, rel=0.05)


def test_the_points_end_where_the_sheet_ends() -> None:
    """On all four sides alike, within the spacing: the clamp is what a scan is registered by."""
    _, points = scan()
    for axis in (0, 1):
        assert points[:, axis].max() == pytest.approx(80e-3, abs=0.15e-3)
        assert points[:, axis].min() == pytest.approx(-80e-3, abs=0.15e-3)


def test_points_are_unordered_and_some_are_missing() -> None:
    true, points = scan()
    assert not (np.diff(points[:, 1]) >= 0).all()
    nominal = (len(true.x) - 1) * (len(true.y) - 1)
    assert 0.93 * nominal < len(points) < 0.999 * nominal


def test_steep_walls_away_from_the_scanner_are_not_seen() -> None:
    """80 deg: the wall whose normal leans away from the line of sight is lost, the opposite one is seen."""
    _, points = scan(angle=float(np.tan(np.radians(80.0))))
    wall = points[(points[:, 2] < -1e-3) & (points[:, 2] > -14e-3) & (np.abs(points[:, 0]) < 10e-3)]
    assert (wall[:, 1] > 0).sum() > 5 * max((wall[:, 1] < 0).sum(), 1)


def test_a_tool_over_the_sheet_hides_what_is_behind_it() -> None:
    true, surface = cone()
    tips = np.array([[20e-3, 0.0, -10e-3], AWAY[1]])
    points = measured_points(true, surface, tips, RADII, Variant(), np.random.default_rng(1), True)
    assert (np.hypot(points[:, 0] - 20e-3, points[:, 1]) < 4e-3).sum() == 0
    _, free = scan()
    assert len(points) < len(free) - 100


def test_a_raised_tool_hides_a_strip_further_behind_and_one_aside_nothing() -> None:
    """15 deg off the vertical: 100 mm above the sheet, the strip begins 100 mm tan(15 deg) behind the tool."""
    true, surface = cone()

    def seen(tip: list[float]) -> np.ndarray:
        tips = np.array([tip, AWAY[1]])
        return measured_points(true, surface, tips, RADII, Variant(), np.random.default_rng(1), True)

    raised = seen([0.0, 0.0, 0.1])
    strip = raised[np.abs(raised[:, 0]) < 4e-3]
    assert len(strip[strip[:, 1] > 35e-3]) == 0
    assert len(strip[np.abs(strip[:, 1]) < 15e-3]) > 200  # under the tool itself
    aside = seen([0.0, 0.08, 0.1])
    assert len(aside[(np.abs(aside[:, 0]) < 4e-3) & (aside[:, 1] > 35e-3)]) > 200


def test_registration_of_a_world_shifts_and_turns_the_cloud() -> None:
    """Fit of shift and turn on the known cone: within 0.05 mm of the variant's, the scatter of single scans."""
    variant = Variant(registration_x=0.3e-3, registration_y=-0.2e-3, registration_z=0.1e-3)
    _, points = scan(variant)
    wall = points[(points[:, 2] < -3e-3) & (points[:, 2] > -12e-3)]
    # on the wall r = 30 mm - depth / tan(50 deg); least squares for the centre
    radius = 30e-3 + (wall[:, 2] - 0.1e-3) / SLOPE
    unit = wall[:, :2] / np.hypot(wall[:, 0], wall[:, 1])[:, None]
    shift = np.linalg.lstsq(unit, np.hypot(wall[:, 0], wall[:, 1]) - radius, rcond=None)[0]
    assert shift == pytest.approx([0.3e-3, -0.2e-3], abs=0.06e-3)


def test_trimmed_part_is_cut_near_the_formed_region_and_levelled() -> None:
    _, points = scan(clamped=False, tilt=0.01)
    r = np.hypot(points[:, 0], points[:, 1])
    assert 30e-3 + 0.5 * TRIM_MARGIN < r.max() < 30e-3 + TRIM_MARGIN + 2e-3
    rim = points[r > 33e-3]
    assert np.abs(rim[:, 2]).max() < 0.15e-3
    assert points[r < 10e-3][:, 2].mean() == pytest.approx(-15e-3, abs=0.1e-3)


def test_same_generator_same_cloud() -> None:
    assert np.array_equal(scan(seed=4)[1], scan(seed=4)[1])
    assert not np.array_equal(scan(seed=4)[1][:100], scan(seed=5)[1][:100])


def test_standard_worlds_are_twenty_different_ones() -> None:
    variants = [make_variant(number) for number in STANDARD_VARIANTS]
    assert len(set(variants)) == 20
    assert all(variant != Variant() for variant in variants)


def test_a_part_that_stands_up_is_levelled_on_its_rim() -> None:
    """A frustum 15 mm high, its flat top 3.5 times as large as the rim of 8 mm would be seen by height alone."""
    surface = flat_surface((0.16, 0.16), 0.5e-3)
    x = surface.x0 + surface.h * np.arange(surface.height.shape[1])
    gx, gy = np.meshgrid(x, x)
    z = np.clip((45e-3 - np.hypot(gx, gy)) * SLOPE, 0.0, 15e-3)
    surface.height[...] = z
    surface.formed[(z > 0.0) & (z < 15e-3)] = 1
    true = HeightMap(x[::2], x[::2], (z + 0.01 * gx)[::2, ::2])
    points = measured_points(true, surface, AWAY, RADII, Variant(), np.random.default_rng(1), False)
    r = np.hypot(points[:, 0], points[:, 1])
    assert np.abs(points[r > 48e-3][:, 2]).max() < 0.15e-3
    assert points[r < 25e-3][:, 2].mean() == pytest.approx(15e-3, abs=0.1e-3)
