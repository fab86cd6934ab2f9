"""Deviation by region on height maps whose numbers follow from a formula."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from isf_analysis.measures.deviation import OPENING_DEPTH, REGIONS, compare, flange_level, regions_of
from isf_core.errors import ErrorCode, IsfError
from isf_core.geometry.height_map import HeightMap
from synthetic_part import Cone, grid, target_map

CONE = Cone()
TARGET = target_map(CONE)
ROUNDING = 1e-12
"""m: sums and interpolation in float64 of values below 1 m."""


def radius_of(height_map: HeightMap) -> np.ndarray:
    return np.hypot(*np.meshgrid(height_map.x, height_map.y))


def lifted(by: float | np.ndarray) -> HeightMap:
    return replace(TARGET, z=TARGET.z + by)


def test_the_target_has_no_deviation_from_itself() -> None:
    deviation = compare(TARGET, TARGET)
    for region in deviation.regions.values():
        assert region.max_abs == pytest.approx(0.0, abs=ROUNDING)
        assert region.coverage == 1.0


def test_a_lift_is_positive_and_the_same_in_every_region() -> None:
    deviation = compare(lifted(0.4e-3), TARGET)
    for name, region in deviation.regions.items():
        for value in (region.max_abs, region.mean_abs, region.rms, region.mean):
            assert value == pytest.approx(0.4e-3, abs=ROUNDING), name


def test_a_part_that_is_too_deep_has_a_negative_mean() -> None:
    assert compare(lifted(-0.4e-3), TARGET).whole.mean == pytest.approx(-0.4e-3, abs=ROUNDING)


def test_wall_errors_seen_along_the_normal_are_cosine_smaller() -> None:
    # on the straight wall the slope is the wall angle of the cone; central differences of a circle's wall on a
    # 1 mm grid are off by less than 1 % there, and fillets flatter than the wall set the largest value
    wall = compare(lifted(1e-3), TARGET).regions["wall"]
    assert wall.max_abs_normal == pytest.approx(1e-3 * np.cos(np.radians(15.0)), rel=0.01)
    straight = regions_of(TARGET)["wall"] & (np.abs(radius_of(TARGET) - 29e-3) < 3e-3)
    slope_x, slope_y = TARGET.gradient()
    cosine = 1 / np.sqrt(1 + slope_x**2 + slope_y**2)
    assert cosine[straight] == pytest.approx(np.cos(CONE.wall_angle), rel=0.01)


def test_six_numbers_of_both_signs_along_the_normal() -> None:
    left = np.meshgrid(TARGET.x, TARGET.y)[0] < -0.5e-3
    signed = compare(lifted(np.where(left, 1e-3, -0.5e-3)), TARGET).signed["wall_and_base"]
    slope_x, slope_y = TARGET.gradient()
    cosine = 1 / np.sqrt(1 + slope_x**2 + slope_y**2)
    opening = regions_of(TARGET)["wall_and_base"]
    above, below = 1e-3 * cosine[opening & left], -0.5e-3 * cosine[opening & ~left]
    both = np.concatenate([above, below])
    assert signed.mean_positive == pytest.approx(above.mean(), abs=ROUNDING)
    assert signed.mean_negative == pytest.approx(below.mean(), abs=ROUNDING)
    assert (signed.largest, signed.smallest) == pytest.approx((both.max(), both.min()), abs=ROUNDING)
    assert (signed.mean, signed.deviation) == pytest.approx((both.mean(), both.std()), abs=ROUNDING)
    assert np.isnan(compare(lifted(1e-3), TARGET).signed["wall_and_base"].mean_negative)


def test_regions_are_where_the_cone_has_its_base_wall_and_rim() -> None:
    masks = regions_of(TARGET)
    r = radius_of(TARGET)
    cell = 1e-3
    opening = np.interp(OPENING_DEPTH, -CONE.profile(np.linspace(45e-3, 18e-3, 5000)), np.linspace(45e-3, 18e-3, 5000))
    assert np.array_equal(masks["wall_and_base"], r < opening)
    assert masks["base"][r < CONE.base_radius - cell].all()
    assert not masks["base"][r > CONE.base_radius + cell].any()  # the fillet is steeper than 5 deg after 0.44 mm
    assert masks["wall"][(r > 23e-3) & (r < 34e-3)].all()
    assert not masks["wall"][r > CONE.opening_radius].any()
    # the distance transform measures between cell centres
    assert masks["rim"][(r > opening + cell) & (r < opening + 9e-3)].all()
    assert not masks["rim"][r > opening + 11e-3].any()
    total = masks["wall_and_base"].astype(int) + masks["rim"] + masks["flange"]
    assert (total == 1).all()


def test_rms_and_mean_of_a_linear_error_on_the_base() -> None:
    gx, _ = np.meshgrid(TARGET.x, TARGET.y)
    base = compare(lifted(0.01 * gx), TARGET).regions["base"]
    x = gx[regions_of(TARGET)["base"]]
    assert base.rms == pytest.approx(0.01 * np.sqrt(np.mean(x**2)), rel=1e-9)
    assert base.mean_abs == pytest.approx(0.01 * np.mean(np.abs(x)), rel=1e-9)
    assert base.mean == pytest.approx(0.0, abs=1e-9)  # the base is symmetric to within rounding of the cells
    assert base.max_abs == pytest.approx(0.01 * np.abs(x).max(), rel=1e-9)


def test_the_worst_place_is_named_with_its_sign() -> None:
    z = TARGET.z.copy()
    row, column = 130, 120  # (-5, 5) mm, on the base
    z[row, column] -= 2e-3
    worst = compare(HeightMap(TARGET.x, TARGET.y, z), TARGET).whole.worst
    assert worst == pytest.approx((-5e-3, 5e-3, -2e-3), abs=1e-9)


def test_unknown_cells_are_left_out_and_lower_the_coverage() -> None:
    z = lifted(0.3e-3).z.copy()
    z[:, TARGET.x > 0] = np.nan
    whole = compare(HeightMap(TARGET.x, TARGET.y, z), TARGET).whole
    assert whole.max_abs == pytest.approx(0.3e-3, abs=ROUNDING)
    assert 0.48 < whole.coverage < 0.53  # the half with its middle column


def test_a_region_without_measurement_has_no_numbers() -> None:
    z = TARGET.z.copy()
    z[regions_of(TARGET)["base"]] = np.nan
    base = compare(HeightMap(TARGET.x, TARGET.y, z), TARGET).regions["base"]
    assert (base.cells, base.coverage) == (0, 0.0)
    assert np.isnan(base.max_abs)


def test_a_scan_on_another_grid_is_interpolated() -> None:
    x, y = grid(half_width=80e-3, spacing=0.8e-3)
    plane = HeightMap(x, y, CONE.profile(np.hypot(*np.meshgrid(x, y))) + 0.25e-3)
    whole = compare(plane, TARGET).whole
    # bilinear interpolation over 0.8 mm cells cuts a fillet of 5 mm by at most h^2 / (8 R) = 16 um in each direction
    assert whole.mean == pytest.approx(0.25e-3, abs=16e-6)
    assert whole.max_abs == pytest.approx(0.25e-3, abs=2 * 16e-6 * 1.6)  # both directions, on the sloped part of it


def test_the_flange_level_is_that_of_the_border() -> None:
    raised = replace(TARGET, z=TARGET.z + 5e-3)
    assert flange_level(raised) == pytest.approx(5e-3)
    assert np.array_equal(regions_of(raised)["wall_and_base"], regions_of(TARGET)["wall_and_base"])


def test_an_island_at_flange_height_belongs_to_the_part() -> None:
    z = TARGET.z.copy()
    z[radius_of(TARGET) < 5e-3] = 0.0
    masks = regions_of(HeightMap(TARGET.x, TARGET.y, z))
    assert np.array_equal(masks["wall_and_base"], regions_of(TARGET)["wall_and_base"])


def test_a_part_that_stands_up_has_the_same_regions() -> None:
    standing = replace(TARGET, z=-TARGET.z)
    hanging = regions_of(TARGET)
    for name, mask in regions_of(standing).items():
        np.testing.assert_array_equal(mask, hanging[name], err_msg=name)


def test_a_flat_target_is_refused() -> None:
    flat = replace(TARGET, z=np.zeros_like(TARGET.z))
    with pytest.raises(IsfError, match="flat") as caught:
        compare(TARGET, flat)
    assert caught.value.code == ErrorCode.BAG_INCOMPLETE


def test_shapes_that_do_not_overlap_are_refused() -> None:
    in_millimetres = HeightMap(TARGET.x + 1.0, TARGET.y, TARGET.z)
    with pytest.raises(IsfError, match="no point in common"):
        compare(in_millimetres, TARGET)


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), scale=st.floats(1e-6, 5e-3), shift=st.floats(-3e-3, 3e-3))
def test_the_numbers_of_any_error_are_ordered(seed: int, scale: float, shift: float) -> None:
    noise = np.random.default_rng(seed).normal(shift, scale, TARGET.z.shape)
    deviation = compare(lifted(noise), TARGET)
    assert set(deviation.regions) == set(REGIONS)
    for region in deviation.regions.values():
        assert abs(region.mean) <= region.mean_abs * (1 + 1e-9)
        assert region.mean_abs <= region.rms * (1 + 1e-9)
        assert region.rms <= region.max_abs * (1 + 1e-9)
        assert abs(region.worst[2]) == region.max_abs
        assert region.max_abs_normal <= region.max_abs * (1 + 1e-9)
    parts = [deviation.regions[name].max_abs for name in ("wall", "base")]
    assert deviation.whole.max_abs >= max(parts)
