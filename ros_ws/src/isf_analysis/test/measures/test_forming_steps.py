"""The sheet step by step: what a ball leaves by hand, scans as they were, and what cannot be told."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from isf_analysis.measures.contour_scan import kept_scan
from isf_analysis.measures.forming_steps import (
    MOST_NODES,
    MOST_STEPS,
    REACHED,
    SCANNED,
    SWEPT,
    FormingSteps,
    ball_of,
    forming_steps,
    gridded,
)
from isf_analysis.measures.record import PartRecord
from isf_core.contour import Contour, Process
from isf_core.types import Array
from synthetic_part import make_part

PART = make_part(contours=6, spacing=2.5e-3, correction="none")
RADIUS, BALL, DEEP = 30e-3, 5e-3, 2e-3


def steps_of(part: PartRecord) -> FormingSteps:
    found = forming_steps(part)
    assert found is not None
    return found


def one_circle(side: int) -> PartRecord:
    """PART with one circle of the tip, 2 mm deep; ``side`` -1: the same from below by the lower tool, 2 mm high.

    The wall is of 60 deg; a ball with its lowest point at z touches it R (1 - cos 60) higher.
    """
    first = PART.nominal[0]
    turn = np.linspace(0.0, 2.0 * np.pi, 400, endpoint=False)
    outward = np.column_stack([np.cos(turn), np.sin(turn), np.zeros(len(turn))])
    tip = RADIUS * outward - [0.0, 0.0, side * DEEP]
    if side < 0:
        tip[:, 2] -= 1e-3  # the lower face of a sheet of 1 mm
    angle = np.full(len(turn), math.radians(60.0))
    normal = -math.sin(angle[0]) * outward + [0.0, 0.0, side * math.cos(angle[0])]
    contour = replace(
        first,
        count=1,
        contact=tip + BALL * (np.array([0.0, 0.0, side]) - normal),
        normal=normal,
        wall_angle=angle,
        thickness=np.full(len(turn), 1e-3),
        forming_tip=tip,
        support_tip=np.empty((0, 3)),
        support_force=np.empty(0),
        forming_tool=1 if side > 0 else 2,
        process=Process.SPIF,
    )
    result = replace(PART.results[0], forming_measured=np.empty((0, 3)), support_measured=np.empty((0, 3)))
    return replace(PART, nominal=(contour,), corrected=(contour,), results=(result,), scan=None, process="SPIF")


def heights(found: FormingSteps, distance: float) -> Array:
    """m, of the first step at the nodes 0.3 mm or less from ``distance`` m from the middle."""
    return heights_of(found, found.steps[0].sheet, distance)


def heights_of(found: FormingSteps, sheet: Array, distance: float) -> Array:
    x, y = np.meshgrid(found.x, found.y)
    here = np.abs(np.hypot(x, y) - distance) < 0.3e-3
    assert here.any()
    return sheet[here]


def test_the_ball_leaves_its_own_shape_then_the_wall_then_the_flange() -> None:
    """Profile by hand beside a circle of 30 mm: floor, ball up to 60 deg, straight wall, flat."""
    found = steps_of(one_circle(1))
    assert heights(found, 10e-3) == pytest.approx(-DEEP, abs=1e-6)
    assert heights(found, RADIUS) == pytest.approx(-DEEP, abs=0.03e-3)
    assert heights(found, RADIUS + 3e-3) == pytest.approx(-DEEP + BALL - math.sqrt(BALL**2 - 3e-3**2), abs=0.3e-3)
    assert heights(found, RADIUS + 6e-3) == pytest.approx(0.0, abs=1e-9)
    edge, rise = BALL * math.sin(math.radians(60.0)), BALL * (1.0 - math.cos(math.radians(60.0)))
    deeper = one_circle(1)
    contour = deeper.nominal[0]
    lower = replace(contour, forming_tip=contour.forming_tip - [0.0, 0.0, 4e-3])
    wall = heights(steps_of(replace(deeper, nominal=(lower,), corrected=(lower,))), RADIUS + edge + 1e-3)
    assert wall == pytest.approx(-6e-3 + rise + 1e-3 * math.tan(math.radians(60.0)), abs=0.7e-3)


def test_from_below_it_is_the_same_upside_down() -> None:
    down, up = steps_of(one_circle(1)), steps_of(one_circle(-1))
    np.testing.assert_allclose(up.steps[0].sheet, -down.steps[0].sheet, atol=1e-12)
    assert len(up.steps[0].lower) == 400
    assert len(up.steps[0].upper) == 0


def test_the_ball_follows_from_the_plan_where_the_job_cannot_be_read() -> None:
    for side in (1, -1):
        assert ball_of(one_circle(side).nominal[0]) == pytest.approx(BALL, rel=1e-9)
    blind = steps_of(replace(one_circle(1), job_text="name: ["))
    assert blind.radii == (0.0, 0.0)
    np.testing.assert_allclose(blind.steps[0].sheet, steps_of(one_circle(1)).steps[0].sheet, atol=1e-9)


def test_every_contour_is_a_step_and_the_scan_the_last_one() -> None:
    found = steps_of(PART)
    assert [step.index for step in found.steps] == [0, 1, 2, 3, 4, 5, 5]
    assert [step.source for step in found.steps] == [SWEPT] * 6 + [SCANNED]
    assert found.radii == (5e-3, 5e-3)
    last = found.steps[-1]
    assert (len(last.upper), len(last.lower)) == (0, 0)
    assert PART.scan is not None
    middle = found.steps[-1].sheet[len(found.y) // 2, len(found.x) // 2]
    place = np.array([[found.x[len(found.x) // 2], found.y[len(found.y) // 2]]])
    assert middle == pytest.approx(float(PART.scan.at(place)[0]), abs=1e-9)
    for before, after in zip(found.steps, found.steps[1:-1], strict=False):
        assert (after.sheet <= before.sheet + 1e-12).all()
        assert after.sheet.min() < before.sheet.min()


def test_without_scan_and_cad_it_is_what_the_tools_swept() -> None:
    found = steps_of(replace(PART, scan=None, target=None))
    assert [step.source for step in found.steps] == [SWEPT] * 6
    assert found.steps[-1].sheet.min() == pytest.approx(PART.corrected[-1].forming_tip[:, 2].min(), abs=1e-4)


def test_scans_between_contours_are_the_sheet_of_the_steps() -> None:
    """A plane that sinks, seen at places in no order; between the scans after contours 2 and 4 there are two paths."""
    places = np.random.default_rng(4).uniform(-0.065, 0.065, (60_000, 2))

    def scan(index: int) -> Array:
        return np.column_stack([places, 0.5 * places[:, 0] - 0.25 * places[:, 1] - 1e-3 * index])

    part = replace(PART, scans=tuple(kept_scan(k, float(k), scan(k)) for k in (1, 3)))
    found = steps_of(part)
    assert [step.index for step in found.steps] == [1, 3, 5]
    assert {step.source for step in found.steps} == {SCANNED}
    x, y = np.meshgrid(found.x, found.y)
    for step in found.steps[:2]:
        assert step.sheet == pytest.approx(0.5 * x - 0.25 * y - 1e-3 * step.index, abs=0.02e-3)
    assert len(found.steps[1].upper) == len(PART.nominal[2]) + len(PART.nominal[3])


def test_points_in_no_order_with_a_hole_are_read_on_the_grid() -> None:
    places = np.random.default_rng(5).uniform(-0.05, 0.05, (20_000, 2))
    points = np.column_stack([places, 2.0 * places[:, 0]])[np.hypot(*places.T) > 6e-3]
    line = np.linspace(-0.04, 0.04, 41)
    found = gridded(points, line, line)
    assert np.isfinite(found).all()
    seen = np.hypot(*np.meshgrid(line, line)) > 10e-3
    assert found[seen] == pytest.approx((2.0 * np.meshgrid(line, line)[0])[seen], abs=1e-9)
    assert np.isnan(gridded(np.empty((0, 3)), line, line)).all()


def test_noise_of_a_scanner_makes_no_spikes() -> None:
    """Flat sheet, a point somewhere in most square millimetres, 0.05 mm of noise, and nodes closer than the points."""
    rng = np.random.default_rng(6)
    middles = np.stack(np.meshgrid(*2 * [np.arange(-0.07, 0.07, 1e-3)]), axis=-1).reshape(-1, 2)
    places = middles + rng.uniform(-0.5e-3, 0.5e-3, middles.shape)
    points = np.column_stack([places, rng.normal(0.0, 17e-6, len(places)).clip(-50e-6, 50e-6)])
    points = points[rng.uniform(size=len(points)) < 0.7]  # some are not seen
    line = np.arange(-0.06, 0.06, 0.7e-3)
    assert np.abs(gridded(points, line, line)).max() < 0.3e-3


def test_a_part_of_many_contours_is_thinned_out() -> None:
    found = steps_of(make_part(contours=150, spacing=5e-3, points=30))
    assert len(found.steps) == MOST_STEPS + 1
    assert found.steps[-1].index == found.steps[-2].index == 149
    assert 0.8 * MOST_NODES < len(found.x) * len(found.y) <= MOST_NODES


def of_process(process: Process, holder: Array) -> PartRecord:
    def changed(contour: Contour) -> Contour:
        return replace(contour, process=process, holder_height=float(holder[contour.index]))

    contours = tuple(map(changed, PART.nominal))
    return replace(PART, nominal=contours, corrected=contours, process=process.name, scan=None)


def test_over_a_die_the_top_of_the_part_comes_up_as_far_as_the_holder_went_down() -> None:
    holder = -np.linspace(1e-3, 21e-3, 6)
    target = PART.target
    assert target is not None
    part = replace(of_process(Process.TPIF, holder), target=replace(target, z=-target.z))
    found = steps_of(part)
    assert found.over_die
    assert [step.source for step in found.steps] == [REACHED] * 6
    for step, height in zip(found.steps, -holder, strict=True):
        assert step.sheet.max() == pytest.approx(height, abs=0.1e-3)
        assert step.sheet.min() == 0.0
        assert step.level == -height
    assert forming_steps(replace(part, target=None)) is None


def test_accumulative_forming_carries_down_what_is_inside_the_ring() -> None:
    """Rings of 20 and 30 mm, tools 2 mm deep: inside is the wanted part, from the ring on 2 mm down; outside flat."""
    target, first = PART.target, PART.nominal[0]
    assert target is not None
    rings = []
    for index, radius in enumerate((20e-3, 30e-3)):
        way = first.contact[:, :2] * radius / np.hypot(*first.contact[0, :2])
        contact = np.column_stack([way, np.full(len(way), -2e-3)])
        rings.append(replace(first, index=index, count=2, contact=contact, process=Process.ADSIF))
    part = replace(PART, nominal=tuple(rings), corrected=tuple(rings), results=PART.results[:2], scan=None)
    found = steps_of(replace(part, process="ADSIF"))
    assert [step.source for step in found.steps] == [REACHED, REACHED]
    for step, radius in zip(found.steps, (20e-3, 30e-3), strict=True):
        ring = float(target.at(np.array([[radius, 0.0]]))[0])
        assert heights_of(found, step.sheet, 5e-3) == pytest.approx(-21e-3 - ring - 2e-3, abs=0.3e-3)
        assert heights_of(found, step.sheet, radius + 5e-3) == pytest.approx(0.0, abs=0.05e-3)
    assert forming_steps(replace(part, process="ADSIF", target=None)) is None


def test_nothing_formed_has_no_steps() -> None:
    assert forming_steps(replace(PART, results=())) is None
