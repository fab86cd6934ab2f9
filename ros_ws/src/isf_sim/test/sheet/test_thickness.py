"""Thickness by volume constancy on shapes that an undeflected ball leaves."""

from __future__ import annotations

import math

import numpy as np
import pytest
from isf_core.files.material import OWN_THINNING, FormingLimit
from isf_core.process.thickness_and_tips import overlap
from isf_core.types import Array
from isf_sim.sheet.contact_kernels import envelope
from isf_sim.sheet.surface import LONG_AGO, Surface, flat_surface, sample
from isf_sim.sheet.thickness import coarse_area, limit_margin, minor_strain, strain_up_the_wall, thickness_map

BLANK, RADIUS, OPENING, STEP = 1e-3, 5e-3, 30e-3, 0.5e-3


def form_cone(surface: Surface, angle: float, depth: float, step: float = STEP) -> None:
    """Level circles of a ball that touches the wall; the enclosed base goes down with each."""
    n = surface.height.shape[0]
    x = surface.x0 + surface.h * np.arange(n)
    distance = np.hypot(x[None, :], x[:, None])
    path = 0.0
    for tip in np.arange(-step, -depth - 1e-9, -step):
        circle = OPENING - (RADIUS - (tip + RADIUS) * math.cos(angle)) / math.sin(angle)
        for turn in np.arange(0.0, 2.0 * math.pi, 0.5e-3 / circle):
            path += 0.5e-3
            envelope(
                surface,
                path,
                15e-3,
                circle * math.cos(turn),
                circle * math.sin(turn),
                float(tip),
                RADIUS,
            )
        base = distance < circle
        surface.height[base] = np.minimum(surface.height[base], tip)


def walls(surface: Surface) -> tuple[Array, Array]:
    """Thickness m and cosine of the slope on the developed wall, by a flank between 40 and 75 % of the depth."""
    n = surface.height.shape[0]
    x = surface.x0 + surface.h * np.arange(n)
    distance = np.hypot(x[None, :], x[:, None])
    zy, zx = np.gradient(surface.height, surface.h)
    cosine = 1.0 / np.sqrt(1.0 + zx**2 + zy**2)
    depth = -surface.height.min()
    wall = (surface.height < -0.4 * depth) & (surface.height > -0.75 * depth) & (distance < OPENING)
    return thickness_map(surface, BLANK)[wall], cosine[wall]


@pytest.mark.parametrize(("degrees", "tolerance"), [(30.0, 0.01), (45.0, 0.03), (60.0, 0.07)])
def test_single_pass_follows_the_sine_law(degrees: float, tolerance: float) -> None:
    """Overlap method against the sine law: 0.3, 2 and 3-7 % at 30, 45 and 60 deg (Praveen 2020, 2.1).

    The grid of 0.5 mm adds to it: at 60 deg the material carried along the wall is smeared, 5 % too thin.
    """
    surface = flat_surface((0.08, 0.08), 0.5e-3)
    form_cone(surface, math.radians(degrees), 15e-3)
    thickness, _ = walls(surface)
    assert thickness.mean() == pytest.approx(BLANK * math.cos(math.radians(degrees)), rel=tolerance)


def overlap_wall(angle: float, depth: float) -> float:
    """m, mean over the same stretch of the wall by the overlap method, contacts of the same circles."""
    tip = -np.arange(STEP, depth + 1e-9, STEP)
    on_wall = tip + RADIUS * (1.0 - math.cos(angle))
    z = np.minimum(on_wall, 0.0)
    at_edge = np.arccos(np.clip(1.0 + tip / RADIUS, -1.0, 1.0))  # before that the ball rolls over the edge
    formed = overlap(-z / math.tan(angle), z, np.where(on_wall < 0.0, angle, at_edge), RADIUS, BLANK)
    return float(formed[(z < -0.4 * depth) & (z > -0.75 * depth)].mean())


@pytest.mark.parametrize(("degrees", "tolerance"), [(30.0, 0.01), (45.0, 0.03), (60.0, 0.07)])
def test_single_pass_follows_the_overlap_method(degrees: float, tolerance: float) -> None:
    """Praveen 2020, 2.1, on the same circles: the source tells less than 4 % against measurements.

    At 60 deg the plant is 5 % away, too thin, as it is from the sine law.
    """
    surface, angle = flat_surface((0.08, 0.08), 0.5e-3), math.radians(degrees)
    form_cone(surface, angle, 15e-3)
    assert walls(surface)[0].mean() == pytest.approx(overlap_wall(angle, 15e-3), rel=tolerance)


def test_volume_is_kept() -> None:
    surface = flat_surface((0.08, 0.08), 0.5e-3)
    form_cone(surface, math.radians(55.0), 15e-3)
    zy, zx = np.gradient(surface.height, surface.h)
    volume = (thickness_map(surface, BLANK) * np.sqrt(1.0 + zx**2 + zy**2)).sum() * surface.h**2
    blank = BLANK * surface.height.size * surface.h**2
    # half of this sheet is formed; carrying the material upwind does not keep its volume exactly
    assert volume == pytest.approx(blank, rel=0.015)


def test_a_wall_is_as_thick_all_round() -> None:
    """The order in which nodes are visited does not show: the four sides of a cone, but for the seam of the circles.

    The tool runs round, so sides differ by their distance from the seam, where it steps down; 3 % is what is left.
    """
    surface = flat_surface((0.08, 0.08), 0.5e-3)
    form_cone(surface, math.radians(60.0), 15e-3)
    thickness, middle = thickness_map(surface, BLANK), surface.height.shape[0] // 2
    i = round(25e-3 / surface.h)
    sides = np.array(
        [thickness[middle + i, middle], thickness[middle - i, middle], thickness[middle, middle - i]]
    )  # the side at +x is the seam
    assert sides == pytest.approx(np.full(3, sides.mean()), rel=0.03)


def test_second_steeper_pass_leaves_more_than_a_single_one() -> None:
    """40 deg, then 65 deg: the wall turns and stretches by 1 / cos(25 deg) at most, it is not drawn anew."""
    once, twice = flat_surface((0.08, 0.08), 0.5e-3), flat_surface((0.08, 0.08), 0.5e-3)
    form_cone(once, math.radians(65.0), 15e-3)
    form_cone(twice, math.radians(40.0), 15e-3)
    form_cone(twice, math.radians(65.0), 15e-3)
    single, double = walls(once)[0].mean(), walls(twice)[0].mean()
    assert double > 1.05 * single


@pytest.mark.parametrize("degrees", [45.0, 60.0])
def test_thinning_beside_the_tool_is_that_of_the_wall(degrees: float) -> None:
    """Beside the tool on its last circle: the sine law times OWN_THINNING, within 10 %, at a place on the wall."""
    surface, angle, place = flat_surface((0.08, 0.08), 0.5e-3), math.radians(degrees), np.empty(3)
    form_cone(surface, angle, 15e-3)
    circle = OPENING - (RADIUS - (RADIUS - 15e-3) * math.cos(angle)) / math.sin(angle)
    for turn in (2.0, 3.0, 4.0):
        outward = np.array([0.0, math.cos(turn), math.sin(turn), 1.0])
        x, y = circle * outward[1], circle * outward[2]
        strain = strain_up_the_wall(surface, x, y, outward, RADIUS, 1.0, 0.0, place)
        assert strain == pytest.approx(-OWN_THINNING * math.log(math.cos(angle)), rel=0.10)
        assert circle < math.hypot(place[0], place[1]) < OPENING
        assert -15e-3 < place[2] < 0.0
    assert strain_up_the_wall(surface, 0.0, 0.0, np.zeros(4), RADIUS, 1.0, 0.0, place) == 0.0


def test_wall_of_several_passes_is_reported_thicker_than_that_of_one() -> None:
    """67 deg in one pass, or after one of 50 deg: the event looks at the material, not at the slope."""
    once, twice, place = flat_surface((0.08, 0.08), 0.5e-3), flat_surface((0.08, 0.08), 0.5e-3), np.empty(3)
    angle = math.radians(67.0)
    form_cone(once, angle, 15e-3)
    form_cone(twice, math.radians(50.0), 15e-3)
    form_cone(twice, angle, 15e-3)
    circle = OPENING - (RADIUS - (RADIUS - 15e-3) * math.cos(angle)) / math.sin(angle)
    outward = np.array([0.0, 0.0, 1.0, 1.0])
    single, double = (strain_up_the_wall(s, 0.0, circle, outward, RADIUS, 1.0, 0.0, place) for s in (once, twice))
    assert 0.4 < double < single - 0.05


def test_coarse_area_of_a_flat_sheet_is_one() -> None:
    surface = flat_surface((0.08, 0.08), 0.5e-3)
    nodes = np.linspace(-0.04, 0.04, 11)
    assert (coarse_area(sample(surface, nodes, nodes)[1], nodes, nodes) == 1.0).all()


def test_minor_strain_is_the_one_across_of_a_wall_and_of_a_stretched_sheet() -> None:
    """Material drawn down a wall of 60 deg along x, flat sheet stretched by 1.5 and 1.2 at 30 deg to the axes."""
    down = minor_strain(np.zeros(2), np.zeros(2), np.array([math.tan(math.radians(60.0)), 0.0]))
    assert down == pytest.approx(0.0, abs=1e-12)
    c, s = math.cos(math.radians(30.0)), math.sin(math.radians(30.0))
    turn = np.array([[c, -s], [s, c]])
    back = turn @ np.diag([1 / 1.5, 1 / 1.2]) @ turn.T - np.eye(2)  # blank minus now, per length now
    assert minor_strain(back[0], back[1], np.zeros(2)) == pytest.approx(math.log(1.2), abs=1e-12)


def test_the_slope_of_the_fracture_line_counts_where_the_sheet_is_stretched_both_ways() -> None:
    """Stretched to 1 / 0.8 along x alone, then along y too; k = 0.5 lets it bear more than the thickness says."""
    surface, place, along_x = flat_surface((0.08, 0.08), 0.5e-3), np.empty(3), np.array([0.0, 1.0, 0.0, 1.0])
    x = surface.x0 + surface.h * np.arange(surface.height.shape[0])
    surface.origin[:, :, 0] = -0.2 * x[None, :]
    one_way = [strain_up_the_wall(surface, 0.0, 0.0, along_x, RADIUS, slope, 0.0, place) for slope in (1.0, 0.5)]
    assert one_way == pytest.approx([math.log(1.25), math.log(1.25)], abs=1e-7)
    surface.origin[:, :, 1] = -0.2 * x[:, None]
    both_ways = [strain_up_the_wall(surface, 0.0, 0.0, along_x, RADIUS, slope, 0.0, place) for slope in (1.0, 0.5)]
    assert both_ways == pytest.approx([2.0 * math.log(1.25), 1.5 * math.log(1.25)], abs=1e-7)
    surface.bending[...] = 40.0
    bent = strain_up_the_wall(surface, 0.0, 0.0, along_x, RADIUS, 1.0, 0.15 * 0.5 * BLANK, place)
    assert bent == pytest.approx(2.0 * math.log(1.25) + 0.003, abs=1e-7)


def test_every_pass_bends_the_wall_and_small_steps_more_often() -> None:
    """R sin a of the wall is under the tool in plan, step / tan a between two loops: 9 bends at 50 deg and 0.5 mm; the
    material, which moves with the wall, meets up to 1.6 times as many."""
    n = round(0.04 / 0.5e-3)
    wall = slice(n + round(22e-3 / 0.5e-3), n + round(25e-3 / 0.5e-3))
    bends = []
    for step in (0.5e-3, 0.25e-3):
        surface = flat_surface((0.08, 0.08), 0.5e-3)
        form_cone(surface, math.radians(50.0), 12e-3, step)
        bends.append(surface.bending[n, wall].mean() * RADIUS)
    assert 9.0 < bends[0] < 14.6
    assert bends[1] == pytest.approx(2.0 * bends[0], rel=0.15)
    higher = slice(n + round(25e-3 / 0.5e-3), n + round(28e-3 / 0.5e-3))
    before = surface.bending[n, higher].mean() * RADIUS
    surface.touched[...] = LONG_AGO  # form_cone begins its path at 0 again
    form_cone(surface, math.radians(60.0), 12e-3)  # another pass comes on top
    assert surface.bending[n, higher].mean() * RADIUS > before + 4.0


def test_margin_is_what_is_left_of_thinning_bends_and_minor_strain() -> None:
    """Stretched evenly to 1 / 0.8 along x and y, bent twice to 5 mm; a wall down x has no minor strain."""
    surface = flat_surface((0.02, 0.02), 0.5e-3)
    line = surface.x0 + surface.h * np.arange(surface.height.shape[0])
    surface.origin[:, :, 0], surface.origin[:, :, 1] = -0.2 * line[None, :], -0.2 * line[:, None]
    surface.bending[...] = 2.0 / 5e-3
    thickness = thickness_map(surface, BLANK)
    middle = (slice(15, 26), slice(15, 26))
    assert thickness[middle] == pytest.approx(0.64 * BLANK, rel=1e-6)
    used, bends = 2.0 * math.log(1.25), 0.15 * 2.0 * 0.5 * BLANK / 5e-3
    for slope, strain in ((1.0, used), (0.5, 0.75 * used)):
        margin = limit_margin(surface, BLANK, FormingLimit(1.1, slope, 0.15))
        assert margin[middle] == pytest.approx(1.1 - strain - bends, abs=1e-6)
    assert limit_margin(surface, BLANK, FormingLimit(0.2, 1.0, 0.0))[20, 20] < 0.0
