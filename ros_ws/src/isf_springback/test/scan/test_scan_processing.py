"""Scans of a cone with known springback, through what scanners do to them: noise, holes, tilt, shift, wrong units."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile, load_job
from isf_core.geometry.height_map import HeightMap
from isf_springback.scan import ScanExpectation, process_scan, sections
from isf_springback.scan.feedback import ScanMemory, plausible_dome
from isf_springback.scan.formed_shape import floor_under, regions
from springback_parts import JOB_TEXT, cone_contour

CLAMP = (0.25, 0.25)
GRID = np.arange(-125, 126) * 1e-3


def cone(depth=15e-3, opening=36e-3, angle=50.0, centre=(0.0, 0.0), square=False):
    """Height map of a cone (or a square pyramid) without fillets."""
    x, y = np.meshgrid(GRID - centre[0], GRID - centre[1])
    r = np.maximum(np.abs(x), np.abs(y)) if square else np.hypot(x, y)
    z = np.clip((r - opening) * np.tan(np.radians(angle)), -depth, 0.0)
    return HeightMap(GRID, GRID, z)


def formed(springback=1.0e-3, **shape):
    """The cone after springback in proportion to its depth."""
    target = cone(**shape)
    return HeightMap(target.x, target.y, target.z * (1.0 - springback / 15e-3))


EXPECTED = ScanExpectation(cone(), CLAMP, -15e-3)


def code_of(points, expected=EXPECTED):
    with pytest.raises(IsfError) as caught:
        process_scan(points, expected)
    assert caught.value.what
    assert caught.value.where
    return caught.value.code


def test_an_exact_grid_comes_back_unchanged():
    shape = process_scan(formed().points(), EXPECTED)
    interior = np.hypot(*np.meshgrid(GRID, GRID)) < 20e-3
    assert shape.surface.z[interior] == pytest.approx(formed().z[interior], abs=2e-6)
    assert shape.coverage == 1.0
    assert shape.remarks == ()


def test_noise_tilt_height_and_outliers_are_undone():
    """The published scanner: +-0.05 mm (Lu 2016, 3.5.2), registration a few tenths of a degree."""
    rng = np.random.default_rng(7)
    points = formed().points()
    points = points + rng.normal(0.0, 25e-6, points.shape)
    wild = rng.random(len(points)) < 0.02
    points[wild, 2] += rng.normal(0.0, 8e-3, wild.sum())
    tilt = np.array([[1.0, 0.0, 4e-3], [0.0, 1.0, -3e-3], [-4e-3, 3e-3, 1.0]])
    points = points @ tilt.T + [0.0, 0.0, 0.8e-3]
    shape = process_scan(points[rng.permutation(len(points))], EXPECTED)
    error = shape.surface.z - formed().z
    # away from the sharp edges of the cone the mean per cell is as good as the noise of a point
    smooth = regions(cone())["base"] & (np.hypot(*np.meshgrid(GRID, GRID)) < 20e-3)
    assert np.nanstd(error[smooth]) < 60e-6
    assert abs(np.nanmean(error[smooth])) < 40e-6
    assert shape.outliers > 0.5 * wild.sum()
    assert shape.plane.height == pytest.approx(0.8e-3, abs=30e-6)
    assert shape.plane.tilt_x == pytest.approx(-4e-3, abs=3e-4)


def test_forty_percent_holes_are_reported_and_left_unknown():
    rng = np.random.default_rng(3)
    points = formed().points()
    keep = np.ones(len(points), dtype=bool)
    inside = np.hypot(points[:, 0], points[:, 1]) < 36e-3
    while keep[inside].mean() > 0.6:
        hole = rng.uniform(-36e-3, 36e-3, 2)
        keep &= np.linalg.norm(points[:, :2] - hole, axis=1) > rng.uniform(3e-3, 9e-3)
    shape = process_scan(points[keep], EXPECTED)
    assert 0.5 < shape.coverage < 0.75
    assert "not seen" in shape.remarks[0]
    known = np.isfinite(shape.surface.z)
    assert not known.all()
    flat = known & regions(cone())["base"]
    assert shape.surface.z[flat] == pytest.approx(formed().z[flat], abs=0.4e-3)


@pytest.mark.parametrize(
    ("change", "code"),
    [
        (lambda p: p + [5e-3, 0.0, 0.0], ErrorCode.SCAN_SHIFTED),
        (lambda p: p + [3.5e-3, -3.5e-3, 0.0], ErrorCode.SCAN_SHIFTED),
        (lambda p: p + [0.0, 0.0, 5e-3], ErrorCode.SCAN_SHIFTED),
        (lambda p: p * 1e3, ErrorCode.SCAN_UNIT_SUSPECT),
        (lambda p: p / 25.4e-3, ErrorCode.SCAN_UNIT_SUSPECT),
        (lambda p: np.where([False, False, True], np.nan, p), ErrorCode.SCAN_NOT_FINITE),
        (lambda p: p[np.hypot(p[:, 0], p[:, 1]) > 32e-3], ErrorCode.SCAN_INCOMPLETE),
        (lambda p: p[:100], ErrorCode.SCAN_INCOMPLETE),
        (lambda p: p[:, :2], ErrorCode.SCAN_INCOMPLETE),
        (lambda p: p * [1.0, 1.0, -1.0], ErrorCode.SCAN_OF_ANOTHER_PART),
    ],
)
def test_scans_that_must_not_steer_tools_are_refused(change, code):
    assert code_of(change(formed().points())) == code


@pytest.mark.parametrize("other", [{"square": True, "opening": 45e-3}, {"opening": 22e-3}, {"centre": (20e-3, 0.0)}])
@pytest.mark.parametrize("dome", [0.0, 2.6e-3])
def test_a_scan_of_another_part_is_refused(other, dome):
    """Also with the dome that is plausible for an opening of 36 mm, 15 mm deep, in a clamp of 250 mm."""
    code = code_of(formed(**other).points(), ScanExpectation(cone(), CLAMP, -15e-3, dome=dome))
    assert code in (ErrorCode.SCAN_OF_ANOTHER_PART, ErrorCode.SCAN_SHIFTED)


@pytest.mark.parametrize("springback", [0.0, 2e-3, 5e-3])
def test_springback_alone_is_never_taken_for_another_part(springback):
    assert process_scan(formed(springback).points(), EXPECTED).coverage == 1.0


def test_a_sheet_that_has_yielded_around_an_opening_without_a_plate_is_believed():
    """As ren_cone on the elasto-plastic sheet: base 5 mm too high, opening 4 mm too deep, flat at the clamp."""
    away = np.hypot(*np.meshgrid(GRID, GRID))
    dish = -4.5e-3 * np.clip(1.0 - (away / 112e-3) ** 2, 0.0, None) ** 2
    sagged = HeightMap(GRID, GRID, 0.56 * cone().z + dish)
    shape = process_scan(sagged.points(), EXPECTED)
    assert np.nanmin(shape.surface.z) == pytest.approx(float(sagged.z.min()), abs=50e-6)


def test_a_sheet_that_sags_around_a_shallow_contour_is_believed():
    """A wide cone at 3.5 mm of depth that sprang back to a third of it and sags by 2.2 mm as a dish (0.6 mm rms)."""
    target = cone(depth=15e-3, opening=100e-3)
    away = np.hypot(*np.meshgrid(GRID, GRID))
    dish = -2.2e-3 * np.clip(1.0 - (away / 112e-3) ** 2, 0.0, None) ** 2
    shallow = HeightMap(GRID, GRID, np.maximum(target.z, -3.5e-3) / 3.0 + dish)
    shape = process_scan(shallow.points(), ScanExpectation(target, CLAMP, -3.5e-3))
    assert np.nanmin(shape.surface.z) == pytest.approx(float(shallow.z.min()), abs=20e-6)


WIDE = np.arange(-175, 176) * 1e-3


def wide_cone(level):
    """The rim of a cone of 304 mm, 25 deg, formed to ``level`` m."""
    x, y = np.meshgrid(WIDE, WIDE)
    return HeightMap(WIDE, WIDE, np.clip((np.hypot(x, y) - 152e-3) * np.tan(np.radians(25.0)), level, 0.0))


def domed(level, height):
    """Points of that part, sprung back to 0.6 of its depth, its floor up by ``height`` m in the middle."""
    part = wide_cone(level)
    x, y = np.meshgrid(WIDE, WIDE)
    bowl = height * np.clip(1.0 - (np.hypot(x, y) / 145e-3) ** 2, 0.0, None)
    return HeightMap(WIDE, WIDE, 0.6 * part.z + bowl).points()


def wide(level, dome):
    return ScanExpectation(wide_cone(-50e-3), (0.35, 0.35), level, dome=dome)


def test_the_floor_of_a_wide_thin_sheet_that_stands_up_is_believed():
    """13 mm at 4 mm of depth, as on the simulated cone of 610 mm in its clamp of 700 mm; here both half as wide."""
    level = -4.1e-3
    points = domed(level, 13e-3)
    assert code_of(points, wide(level, 0.0)) == ErrorCode.SCAN_OF_ANOTHER_PART
    shape = process_scan(points, wide(level, 14e-3))
    assert np.nanmax(shape.surface.z) == pytest.approx(float(points[:, 2].max()), abs=50e-6)
    assert code_of(points, wide(level, 6e-3)) == ErrorCode.SCAN_OF_ANOTHER_PART


@pytest.mark.parametrize(("job", "low", "high"), [("praveen_cone_610", 10e-3, 16e-3), ("ren_cone", 0.0, 1.0e-3)])
def test_what_dome_is_plausible_follows_from_the_opening(job, low, high):
    """4 mm deep: a sheet of 0.8 mm 45 mm inside its edge turns, one far inside its clamp hardly does."""
    root = Path(__file__).resolve().parents[5]
    job_file = load_job(root / "examples" / "jobs" / f"{job}.yaml")
    x = np.arange(-349, 350, 2) * 1e-3
    away = np.hypot(*np.meshgrid(x, x))
    opening = 305e-3 if job.startswith("praveen") else 36e-3
    target = HeightMap(x, x, np.clip((away - opening) * np.tan(np.radians(25.0)), -20e-3, 0.0))
    contour = cone_contour(7, angle=25.0 if job.startswith("praveen") else 50.0)
    assert low < plausible_dome(job_file, contour, target) < high


def pockets(*parts):
    """Height map of cones of 50 deg at x m, depth m each, 35 mm in radius."""
    return HeightMap(GRID, GRID, np.min([cone(depth, 35e-3, centre=(x, 0.0)).z for x, depth in parts], axis=0))


def memory_of(target):
    memory = ScanMemory(JobFile(JOB_TEXT, Path(".")))
    memory.set_target(target)
    return memory


@pytest.mark.parametrize(("first", "place"), [(None, -50e-3), (-50e-3, 50e-3)])
@pytest.mark.parametrize("index", [5, 9, 19, 35])
def test_of_pockets_formed_one_after_the_other_the_one_in_work_must_be_the_expected_one(first, place, index):
    """Beside it a finished one, or none as yet."""
    depth = 0.5e-3 * (index + 1)
    contour = cone_contour(index, opening=35e-3).shifted(np.array([place, 0.0, 0.0]))
    level = -float(contour.forming_tip[:, 2].min())
    memory = memory_of(pockets((-50e-3, 20e-3), (50e-3, 20e-3)))
    before = [] if first is None else [(first, 20e-3)]
    shape = memory.take(pockets(*before, (place, level)).points(), contour, index)
    assert memory.fault is None, memory.fault
    assert shape.coverage == 1.0
    assert np.linalg.norm(shape.shift) < 0.1e-3
    if depth > 4e-3:  # a shallow one may have sprung back altogether
        other = cone(level, 35e-3, centre=(place + 8e-3, 0.0), square=True)
        assert memory.take(other.points(), contour, index) is None
        assert memory.fault.code in (ErrorCode.SCAN_OF_ANOTHER_PART, ErrorCode.SCAN_SHIFTED)


@pytest.mark.parametrize(("place", "floor"), [(-50e-3, -14e-3), (50e-3, -8e-3)])
def test_every_pocket_has_a_floor_of_its_own(place, floor):
    target = pockets((-50e-3, 14e-3), (50e-3, 8e-3))
    contour = cone_contour(3, opening=35e-3).shifted(np.array([place, 0.0, 0.0]))
    assert floor_under(target, contour) == pytest.approx(floor)


def test_a_finished_part_is_no_blank():
    """While a part is formed it may spring back altogether; one that was corrected has most of its depth."""
    finished = replace(EXPECTED, least_scale=0.3)
    blank = HeightMap(GRID, GRID, 0.0 * cone().z).points()
    assert code_of(blank, finished) == ErrorCode.SCAN_OF_ANOTHER_PART
    assert code_of(formed(12e-3).points(), finished) == ErrorCode.SCAN_OF_ANOTHER_PART
    for points, expected in ((blank, EXPECTED), (formed(8e-3).points(), finished)):
        assert process_scan(points, expected).coverage == 1.0


def test_a_bump_that_is_still_to_come_is_not_missed():
    target = HeightMap(GRID, GRID, pockets((-50e-3, 20e-3)).z - pockets((50e-3, 20e-3)).z)
    contour = cone_contour(19, opening=35e-3).shifted(np.array([-50e-3, 0.0, 0.0]))
    memory = memory_of(target)
    shape = memory.take(pockets((-50e-3, -float(contour.forming_tip[:, 2].min()))).points(), contour, 19)
    assert memory.fault is None
    assert np.linalg.norm(shape.shift) < 0.1e-3


def test_an_unclamped_part_keeps_its_flange():
    points = formed().points() + [0.0, 0.0, 1e-3]
    shape = process_scan(points, ScanExpectation(cone(), CLAMP, -15e-3, clamped=False))
    assert shape.plane is None
    assert np.nanmax(shape.surface.z) == pytest.approx(1e-3, abs=1e-5)
    assert "not clamped" in shape.remarks[0]


def scanned(shift=(0.0, 0.0), turn=0.0, seed=3, half=125e-3):
    """Unordered points with a spacing of 1 mm, with holes as shine makes them, of a scanner that is registered off."""
    rng = np.random.default_rng(seed)
    x, y = np.meshgrid(np.arange(-half, half, 1e-3), np.arange(-half, half, 1e-3))
    plan = np.column_stack([x.ravel(), y.ravel()]) + rng.uniform(0.0, 1e-3, (x.size, 2))
    points = np.column_stack([plan, np.nan_to_num(formed().at(plan))])
    for place in [[124e-3, 30e-3], [-60e-3, -124e-3], *rng.uniform(-0.1, 0.1, (4, 2))]:
        points = points[np.hypot(*(points[:, :2] - place).T) > 4e-3]
    c, s = np.cos(turn), np.sin(turn)
    points[:, :2] = points[:, :2] @ np.array([[c, s], [-s, c]]) + shift
    return rng.permutation(points + rng.normal(0.0, 15e-6, points.shape))


def test_the_registration_of_the_scanner_is_found_at_the_clamp_and_undone():
    """Walls of 50 deg: 0.2 mm in plan are 0.24 mm of height. Deviation told: of 20 scans most within two of it."""
    departures = []
    for seed in range(20):
        shape = process_scan(scanned((0.2e-3, -0.18e-3), 2e-3, seed), EXPECTED)
        assert shape.edges is not None
        departures.append([*(shape.edges.shift - [0.2e-3, -0.18e-3]), 0.06 * (shape.edges.turn - 2e-3)])
        assert shape.edges.deviation < 40e-6
    departures = np.array(departures)
    assert np.abs(departures).max() < 80e-6
    assert (np.abs(departures[:, :2]) < 2.0 * shape.edges.deviation).mean() > 0.8
    wall = np.isfinite(shape.surface.z) & (formed().z < -2e-3) & (formed().z > -12e-3)
    assert np.sqrt(np.mean((shape.surface.z - formed().z)[wall] ** 2)) < 60e-6


def framed(noise, wider, spacing=1e-3, seed=3):
    """A scan registered off by 0.2 mm and 0.3 mm high, of a sheet ``wider`` m than the clamp on every side, with 30 mm
    of the frame of the clamp, 10 mm over the sheet."""
    rng = np.random.default_rng(seed)
    half = 125e-3 + wider
    inside = scanned((0.0, 0.0), seed=seed, half=half)
    lines = np.arange(-half - 30e-3, half + 30e-3, spacing)
    x, y = (grid.ravel() for grid in np.meshgrid(lines, lines))
    beside = np.maximum(np.abs(x), np.abs(y)) > half
    frame = np.column_stack([x[beside], y[beside], np.full(beside.sum(), 10e-3)])
    points = np.vstack([inside, frame])
    return points + rng.normal(0.0, noise, points.shape) + [0.2e-3, -0.18e-3, 0.3e-3]


@pytest.mark.parametrize("spacing", [1e-3, 2e-3])
@pytest.mark.parametrize(("noise", "wider"), [(50e-6, 0.0), (0.25e-3, 0.0), (0.25e-3, 1.5e-3), (0.1e-3, 3e-3)])
def test_a_frame_of_the_clamp_in_the_cloud_moves_nothing(noise, wider, spacing):
    """Neither up, as it would if it counted as sheet, nor in plan: the sheet is seen to end at it."""
    shape = process_scan(framed(noise, wider, spacing), EXPECTED)
    assert shape.plane.height == pytest.approx(0.3e-3, abs=20e-6)
    assert shape.edges is not None
    assert shape.edges.shift == pytest.approx([0.2e-3, -0.18e-3], abs=0.08e-3)
    base = regions(cone())["base"] & (np.hypot(*np.meshgrid(GRID, GRID)) < 20e-3)
    assert np.nanmean((shape.surface.z - formed().z)[base]) == pytest.approx(0.0, abs=25e-6)


def test_a_frame_on_three_sides_is_no_edge_of_the_sheet():
    """A scanner that does not see the fourth: where the sheet of another size ends is not known."""
    points = framed(50e-6, 3e-3)
    assert process_scan(points[points[:, 0] < 122e-3], EXPECTED).edges is None


@pytest.mark.parametrize("half", [100e-3, 135e-3])
def test_points_that_do_not_end_at_the_clamp_report_nothing_of_it(half):
    shape = process_scan(scanned((0.2e-3, 0.0), half=half), EXPECTED)
    assert shape.edges is None
    assert shape.shift == pytest.approx([0.2e-3, 0.0], abs=0.1e-3)


def test_a_scan_that_does_not_show_the_clamp_is_registered_as_the_one_before():
    known = process_scan(scanned((0.2e-3, -0.18e-3), 2e-3), EXPECTED).edges
    points = scanned((0.2e-3, -0.18e-3), 2e-3, seed=8)
    points = points[points[:, 0] < 0.10]
    assert process_scan(points, EXPECTED).edges is None
    shape = process_scan(points, ScanExpectation(cone(), CLAMP, -15e-3, edges=known))
    wall = np.isfinite(shape.surface.z) & (formed().z < -2e-3) & (formed().z > -12e-3)
    assert np.sqrt(np.mean((shape.surface.z - formed().z)[wall] ** 2)) < 60e-6


def test_a_scanner_that_is_registered_far_off_is_refused_on_any_depth():
    for level in (-1e-3, -15e-3):
        expected = ScanExpectation(cone(), CLAMP, level)
        assert code_of(scanned((3.0e-3, 0.0)), expected) == ErrorCode.SCAN_SHIFTED


def test_a_shift_is_measured_and_left():
    shape = process_scan(formed(centre=(0.7e-3, -0.4e-3)).points(), EXPECTED)
    assert shape.shift == pytest.approx([0.7e-3, -0.4e-3], abs=0.15e-3)


def test_sections_find_wall_contact_and_ball():
    contour = cone_contour(19)  # 10 mm deep, contact at r = 36 - 10 / tan 50
    path_length = 2 * np.pi * np.hypot(*contour.forming_tip[0, :2])
    directions = sections.directions_of(contour, path_length * np.arange(8) / 8)
    assert np.linalg.norm(directions.outward, axis=1) == pytest.approx(1.0)
    assert (np.sum(directions.outward * directions.origin, axis=1) > 0).all()
    reach = sections.STEP * np.arange(-80, 81)
    profile = sections.vertical_sections(cone(depth=21e-3), directions, reach)
    at_contact = sections.crossing(profile, reach, np.full(8, -10e-3))
    assert at_contact == pytest.approx(0.0, abs=0.1e-3)
    # a ball dropped on the straight wall touches R sin(alpha) outwards of its tip, R (1 - cos(alpha)) above it
    tip, touch = sections.dropped_ball(profile, 5e-3)
    place = 80
    assert reach[place] - reach[touch[0, place]] == pytest.approx(5e-3 * np.sin(np.radians(50)), abs=0.3e-3)
    height = profile[0, touch[0, place]] - tip[0, place]
    assert height == pytest.approx(5e-3 * (1 - np.cos(np.radians(50))), abs=0.15e-3)


def test_the_contact_is_where_the_wall_ends():
    """Wall, ball of 10 mm, flat bottom: the tangency is known."""
    reach = sections.STEP * np.arange(-80, 81)
    wall, radius = np.radians(50.0), 10e-3
    lever = radius * np.sin(wall)
    ball = -12e-3 + radius - np.sqrt(np.maximum(radius**2 - np.clip(reach - lever, -radius, 0.0) ** 2, 0.0))
    start = -12e-3 + radius * (1 - np.cos(wall))
    profile = np.where(reach < 0, start - reach * np.tan(wall), ball)[None, :]
    found = sections.contact_reach(profile, reach, np.array([wall]))
    # the slope stays above 85 % of the wall's for 0.8 mm of arc
    assert found[0] == pytest.approx(0.4e-3, abs=0.6e-3)
