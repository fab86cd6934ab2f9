"""What a backing plate is to the models of the sheet."""

from pathlib import Path

import numpy as np
import pytest
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile
from isf_core.geometry.opening import Opening
from isf_springback.corrector import apply
from isf_springback.database.control_points import part_symmetries
from isf_springback.database.database import cached_path
from isf_springback.database.elastic_samples import depth_task, solve_depth
from isf_springback.methods import make_corrector
from isf_springback.sheet_edge import edge_radius, free_size, held_by_plate, holding_size, plate_edge
from isf_springback.shell.formed_sheet import FacetSize
from isf_springback.shell.load_path import follow_loads
from isf_springback.shell.plan_mesh import mesh_in_plan, place_along
from isf_springback.shell.sheet_model import EdgeCondition, SheetMesh, ShellModel
from scanned_sheet import COUNT, TARGET, Sheet
from springback_parts import JOB_TEXT, cone_contour, result_of

ROUND = "backing_plate: {shape: circle, size: [88 mm, 88 mm]}\n"
SQUARE = "backing_plate: {shape: rectangle, size: [90 mm, 80 mm]}\n"


def job(plate=""):
    return JobFile(JOB_TEXT + plate, Path("."))


def predicted(method, plate, contours=3):
    """m, mean springback predicted for the last of a few contours under 500 N, along the push."""
    chosen = make_corrector(method, job(plate))
    for index in range(contours):
        contour = cone_contour(index)
        correction = chosen.correct(contour)
        assert correction.code == 0
        chosen.add_result(apply(contour, correction), result_of(contour, 500.0))
    return float(correction.springback.mean())


def test_free_sheet_is_the_clamp_or_the_opening_of_the_plate():
    opening = Opening.of(cone_contour(0).contact[:, :2])
    place = cone_contour(0).contact[::40, :2]
    assert free_size(job()) == (0.25, 0.25)
    assert free_size(job(SQUARE)) == (0.09, 0.08)
    np.testing.assert_allclose(edge_radius(job(), opening, place, "equivalent"), np.sqrt(0.25**2 / np.pi))
    np.testing.assert_allclose(edge_radius(job(SQUARE), opening, place, "equivalent"), np.sqrt(0.09 * 0.08 / np.pi))
    for kind in ("equivalent", "local"):
        np.testing.assert_allclose(edge_radius(job(ROUND), opening, place, kind), 0.044)


def test_the_law_stays_defined_where_the_plate_is_as_narrow_as_the_part():
    opening = Opening.of(0.044 * np.column_stack([np.cos(np.arange(90)), np.sin(np.arange(90))]))
    radius = edge_radius(job(ROUND), opening, opening.centre + [[0.04, 0.0]], "equivalent")
    assert radius[0] > 1.03 * opening.radius_towards(np.array([[0.04, 0.0]]))[0]


@pytest.mark.parametrize("method", ["analytic", "elastic"])
@pytest.mark.parametrize("plate", [ROUND, SQUARE])
def test_a_plate_takes_most_of_the_springback(method, plate):
    free, backed = predicted(method, ""), predicted(method, plate)
    assert 2e-3 < free < 7e-3
    assert 0.05 * free < backed < 0.5 * free


def test_the_plate_holds_the_sheet_up_and_lets_it_turn():
    """Between a clamp with the opening for its edge (no turn there) and no plate at all."""

    def pushed(one):
        task = depth_task(
            [cone_contour(0)], cone_contour(0).contact[:1], one, size=FacetSize.coarse(), loads=np.array([50.0])
        )
        return float(solve_depth(task)[0, 0])

    narrow = job()
    narrow.rig = narrow.rig.model_copy(update={"clamp": narrow.rig.clamp.model_copy(update={"size": (0.09, 0.08)})})
    assert pushed(narrow) < pushed(job(SQUARE)) < 0.5 * pushed(job())


def test_a_part_wider_than_its_plate_is_reported():
    narrow = job("backing_plate: {shape: circle, size: [60 mm, 60 mm]}\n")
    with pytest.raises(IsfError) as caught:
        depth_task([cone_contour(0)], cone_contour(0).contact[:1], narrow)
    assert caught.value.code == ErrorCode.SHEET_MESH_FAILED


@pytest.mark.parametrize("diameter", [72.5, 73.0, 74.0, 76.0, 80.0, 100.0])
def test_a_plate_close_to_the_opening_is_where_the_wall_begins(diameter):
    """The cone opens with 72 mm; the wall reaches the flange, or the plate, and the sheet stays inside its edge."""
    plate = job(f"backing_plate: {{shape: circle, size: [{diameter} mm, {diameter} mm]}}\n")
    contours = [cone_contour(index, opening=36e-3 + 0.5e-3 / np.tan(np.radians(50.0))) for index in range(4)]
    sheet = depth_task(contours, contours[-1].contact[:1], plate).sheet
    rim = np.hypot(*sheet.rims[0].T)
    first = np.hypot(*contours[0].contact[:, :2].T)
    assert (rim >= first.mean() - 1e-6).all()
    assert (rim <= max(0.5e-3 * diameter - 2e-3, first.mean()) + 1e-6).all()
    down = np.linspace(first.mean() - 3e-3, 0.5e-3 * diameter, 50)
    height = sheet.height(np.column_stack([down, np.zeros(50)]))
    assert (np.diff(height) > -1e-5).all()  # loops and polygon are chords, 10 um off at most
    assert height[0] < -1.4e-3
    assert abs(height[-1]) < 1e-5


def test_a_plate_as_wide_as_the_clamp_adds_nothing():
    wide = job("backing_plate: {shape: rectangle, size: [250 mm, 250 mm]}\n")
    contours = [cone_contour(0)]
    found = [
        solve_depth(depth_task(contours, contours[0].contact[:1], one, size=FacetSize.coarse(), loads=np.array([50.0])))
        for one in (job(), wide)
    ]
    np.testing.assert_allclose(found[0], found[1], rtol=1e-9)


@pytest.mark.parametrize(
    ("clamp", "plate", "alike"), [((0.25, 0.25), ROUND, 7), ((0.25, 0.2), ROUND, 3), ((0.25, 0.25), SQUARE, 3)]
)
def test_points_are_computed_once_only_where_clamp_and_plate_are_alike(clamp, plate, alike):
    """A round plate in a clamp of 250 x 200 mm: the sheet runs on to the clamp, and a quarter turn is another sheet."""
    one = job(plate)
    one.rig = one.rig.model_copy(update={"clamp": one.rig.clamp.model_copy(update={"size": clamp})})
    assert len(part_symmetries([cone_contour(3)], holding_size(one), 0.2e-3)) == alike


def test_elastic_corrects_a_part_that_begins_at_its_plate():
    narrow = "backing_plate: {shape: circle, size: [74 mm, 74 mm]}\n"
    assert 3e-5 < predicted("elastic", narrow) < predicted("elastic", ROUND)


def test_a_round_opening_bends_as_a_round_plate_that_runs_on_to_its_clamp():
    """A load at the centre of a flat sheet, by the theory of round plates (Timoshenko).

    Inside the opening of radius a: w = F a^2 / (16 pi D) with its edge clamped, and M a^2 / (2 D (1 + nu)) by an edge
    moment M. The ring from a to the clamp at b takes the turn: M = k turn, with k from w = A + B r^2 + C ln r there.
    """
    young, poisson, thickness, a, b = 70e9, 0.33, 1e-3, 44e-3, 150e-3
    stiff = young * thickness**3 / (12.0 * (1.0 - poisson**2))
    # ring: w(a) = w(b) = w'(b) = 0 with w = A + B r^2 + C ln r + E r^2 ln r, w'(a) = 1 gives its moment at a
    rows = [
        [1.0, a**2, np.log(a), a**2 * np.log(a)],
        [1.0, b**2, np.log(b), b**2 * np.log(b)],
        [0.0, 2.0 * b, 1.0 / b, b * (2.0 * np.log(b) + 1.0)],
        [0.0, 2.0 * a, 1.0 / a, a * (2.0 * np.log(a) + 1.0)],
    ]
    _, square, log, both = np.linalg.solve(rows, [0.0, 0.0, 0.0, 1.0])
    curved = 2.0 * square - log / a**2 + both * (2.0 * np.log(a) + 3.0)
    moment = abs(stiff * (curved + poisson / a))
    held = moment / (moment + stiff * (1.0 + poisson) / a)  # share of the clamping moment that the ring takes
    clamped = a**2 / (16.0 * np.pi * stiff)
    free = clamped * (3.0 + poisson) / (1.0 + poisson)
    expected = free - held * (free - clamped)
    disc = 150e-3 * np.column_stack([np.cos(np.arange(64) * np.pi / 32), np.sin(np.arange(64) * np.pi / 32)])
    (plate,) = plate_edge(job(ROUND))

    def size(places):
        return np.minimum(1e-3 + 0.2 * np.linalg.norm(places, axis=1), 6e-3)

    fixed = np.vstack([np.zeros((1, 2)), place_along(plate, size)])
    points, triangles, edge = mesh_in_plan(disc, fixed, size)
    propped = np.arange(1, len(fixed))
    mesh = SheetMesh(np.column_stack([points, np.zeros(len(points))]), triangles, edge, np.array([0]), propped)
    model = ShellModel(mesh, np.full(len(triangles), thickness), young, poisson, EdgeCondition("clamped", np.inf))
    moved = follow_loads(model, [0], np.array([0.0, 0.0, -1.0]), np.array([1.0]), model.factor())
    assert -moved[0, 0, 2] == pytest.approx(expected, rel=0.02)


def test_databases_with_and_without_plate_have_other_names():
    names = {cached_path(one) for one in (job(), job(ROUND), job(SQUARE))}
    assert len(names) == 3


def test_a_plate_holds_the_sheet_only_where_it_is_close():
    for plate, held in (("", False), (ROUND, True), (SQUARE, True), (ROUND.replace("88", "150"), False)):
        assert held_by_plate(cone_contour(2), job(plate)) is held


@pytest.mark.parametrize(("plate", "believed"), [(ROUND, True), (ROUND.replace("88", "150"), False)])
def test_the_edge_of_the_opening_is_not_pressed_deeper_while_it_bends_down(plate, believed):
    """Scans that show the first contours too high: followed from the third on only where a plate holds the edge."""

    def asked(*, looks):
        fused = make_corrector(
            "fused", JobFile(JOB_TEXT.replace("method: analytic", "method: fused, scan_every: 1") + plate, Path("."))
        )
        fused.set_target(TARGET)
        sheet = Sheet(lambda depth, around: 12e-3)
        for index in range(4):
            nominal = cone_contour(index, count=COUNT)
            correction = fused.correct(nominal)
            corrected = apply(nominal, correction)
            sheet.form(corrected)
            fused.add_result(corrected, result_of(corrected, 500.0))
            if looks:
                fused.add_scan(sheet.points(), index)
        return float(correction.springback.mean())

    more = asked(looks=True) - asked(looks=False)
    assert (more > 0.2e-3) is believed
