"""Programs as plans: what our own export writes comes back, and checks tell line and place."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile, load_job
from isf_core.files.rig import load_rig
from isf_core.files.tooling import ToolSpec
from isf_planner import exports, plan
from isf_planner.checks import part_checks
from isf_planner.exports.programs import path_points
from isf_planner.gcode.program_plan import (
    check_program,
    check_tools,
    check_work_offsets,
    lines_of,
    program_plan,
    surface_normals,
)
from isf_planner.gcode.reader import read_program
from isf_planner.gcode.set_up import MountedTool, SetUp
from isf_planner.view.reach_figure import axes_use, draw_reach, hexapod_of

JOBS = Path(__file__).resolve().parents[5] / "examples" / "jobs"
ROUNDING = 0.5e-7 * 1.001
"""m: the export writes four decimals of a millimetre."""

SLOW = {
    "behera_60_25",
    "behera_60_30_sequenced",
    "behera_80_25",
    "behera_80_25_ordinary",
    "behera_cone_65",
    "behera_cone_80",
    "behera_pyramid_60",
    "behera_pyramid_76",
    "behera_pyramid_80",
    "ren_cone",
    "ren_cone_on_blank",
    "ren_cone_plate",
    "ren_cone_plate_dsif",
    "ren_funnel",
    "free_form",
    "lu_asymmetric",
    "lu_cone",
    "lu_pyramid",
    "praveen_cone_150",
    "praveen_cone_250",
    "praveen_cone_610",
    "praveen_free_form",
    "ren_pyramid",
    "adsif_cone",
    "spif_cone",
    "torrao_cone_45",
    "torrao_cone_70",
    "torrao_cone_dps780",
    "torrao_implant",
    "torrao_bonnet",
}
NAMES = [
    pytest.param(path.stem, marks=pytest.mark.slow) if path.stem in SLOW else path.stem
    for path in sorted(JOBS.glob("*.yaml"))
    if "process: TPIF" not in path.read_text(encoding="utf-8")
]
"""Every job that is shipped and that a program can say, which has no place for the blank holder of a part over a die;
those that take long to plan are left to the slow tests."""

SHEET = """
name: rings
part: {mesh: part.stl, unit: mm}
process: SPIF
rig: torrao2013
sheet: {material: AA5754-O, thickness: 1 mm}
tool_1: {radius: 5 mm}
path: {incremental_depth: 0.5 mm, point_spacing: 0.5 mm, feed: 20 mm/s}
"""


def sheet_job(text: str = SHEET) -> JobFile:
    return JobFile(text, Path())


def rings(count: int, overlap: str = "") -> str:
    """A cone of 45 deg in full circles, 1 mm steps, opening radius 30 mm."""
    lines = ["G90 G21 G54", "G0 Z20", "X30 Y0", "F900"]
    for k in range(1, count + 1):
        lines += [f"G1 X{30 - k} Y0 Z{-k}", f"G3 X{30 - k} Y0 I{k - 30}", overlap]
    return "\n".join([*lines, "G0 Z20", "M30"])


@pytest.mark.parametrize("name", NAMES)
def test_what_we_export_is_read_back_to_the_same_tips(name: str, tmp_path: Path) -> None:
    """One tool, two tools, separate contours, spirals, parts formed from both sides, a tilted tool."""
    made = plan(load_job(JOBS / f"{name}.yaml"))
    (file,) = exports.export(made, tmp_path / "part.nc")
    program = read_program(file.read_text(), step=5e-3).with_ball(made.ball_radius)
    assert not program.unknown
    assert not program.findings
    points = path_points(made.contours)
    found = program.tips[program.given & np.isfinite(program.speed)]
    written = np.hstack([points.tool_1, points.tool_2])
    assert len(found) == len(written)
    there = np.isfinite(written[0])
    assert program.two_tools == there.all()
    assert np.abs(found[:, there] - written[:, there]).max() <= ROUNDING
    assert program.speed[program.given & np.isfinite(program.speed)] == pytest.approx(points.speed, rel=1e-2)


def without_floor(path: Path) -> str:
    """Text of the job at ``path`` without passes over the floor, which are plane loops: no wall is known by them."""
    return re.sub(r"  floor_step:.*\n", "  floor_step: none\n", path.read_text(encoding="utf-8"))


def test_contours_of_an_exported_plan_come_back(tmp_path: Path) -> None:
    """The same loops, closed, with the planner's wall angles and target where loops lie on both sides."""
    path = JOBS / "spif_cone.yaml"
    job_file = JobFile(without_floor(path), path.parent, str(path))
    made = plan(job_file)
    (file,) = exports.export(made, tmp_path / "part.nc")
    again = program_plan(read_program(file.read_text()), job_file)
    assert [(len(one), one.closed) for one in again.contours] == [(len(one), one.closed) for one in made.contours]
    for ours, theirs in zip(made.contours[8:24], again.contours[8:24], strict=True):
        assert np.abs(ours.forming_tip - theirs.forming_tip).max() <= ROUNDING
        assert np.degrees(np.abs(ours.wall_angle - theirs.wall_angle)).max() < 1.5
        assert np.abs(ours.contact - theirs.contact).max() < 0.1e-3
    assert np.abs(again.target.z - made.target.z).max() < 0.3e-3


def test_every_pass_of_a_staged_plan_has_its_own_wall(tmp_path: Path) -> None:
    """Two passes, of 30 and 45 deg, over one part: in the middle of each its own wall is known."""
    path = JOBS / "spif_cone.yaml"
    text = without_floor(path).replace("path:\n", "path:\n  stages: [30 deg]\n")
    made = plan(JobFile(text, path.parent, str(path)))
    (file,) = exports.export(made, tmp_path / "part.nc")
    again = program_plan(read_program(file.read_text()), JobFile(text, path.parent, str(path)))
    for stage in (0, 1):
        contours = [contour.index for contour in made.contours if contour.stage == stage]
        for k in contours[len(contours) // 3 : -len(contours) // 3]:
            off = np.abs(made.contours[k].wall_angle - again.contours[k].wall_angle)
            assert np.degrees(off).max() < 1.5
    assert np.abs(again.target.z - made.target.z).max() < 0.5e-3


@pytest.mark.parametrize("before", [0, 12])
def test_an_inverse_pass_has_the_walls_of_the_cone_that_it_forms(before: int) -> None:
    """Torrao 2013, 2.2.2: from full depth upwards, on a flat blank, or over a cone that was formed downwards."""
    levels = [*range(1, before + 1), *range(12 - (before > 0), 0, -1)]
    lines = ["G90 G21 G54", "G0 Z20", f"X{30 - levels[0]} Y0", "F900"]
    for k in levels:
        lines += [f"G1 X{30 - k} Y0 Z{-k}", f"G3 X{30 - k} Y0 I{k - 30}"]
    made = program_plan(read_program("\n".join([*lines, "G0 Z20", "M30"])), sheet_job())
    assert [round(-1e3 * contour.forming_tip[:, 2].mean()) for contour in made.contours] == levels
    assert all(contour.closed for contour in made.contours)
    upwards = made.contours[before:]
    for contour in upwards[1:-1]:
        assert np.degrees(contour.wall_angle) == pytest.approx(45.0, abs=1.5)
        outward = contour.forming_tip[:, :2] / np.hypot(*contour.forming_tip[:, :2].T)[:, None]
        assert (outward * contour.normal[:, :2]).sum(axis=1) == pytest.approx(-np.sqrt(0.5), abs=0.03)
    direct = program_plan(read_program(rings(12)), sheet_job())
    assert np.abs(made.target.z - direct.target.z).max() < 20e-6


def test_loops_with_long_edges_come_back_as_loops(tmp_path: Path) -> None:
    """Each of the pyramid's contours begins in mid-edge, so that more than 30 points follow its fourth corner."""
    job_file = load_job(JOBS / "ren_pyramid.yaml")
    made = plan(job_file)
    (file,) = exports.export(made, tmp_path / "part.nc")
    again = program_plan(read_program(file.read_text(), step=5e-3), job_file)
    assert [(len(one), one.closed) for one in again.contours] == [(len(one), one.closed) for one in made.contours]
    for ours, theirs in zip(made.contours, again.contours, strict=True):
        assert np.abs(ours.forming_tip - theirs.forming_tip).max() <= ROUNDING


@pytest.mark.parametrize("seed", range(6))
def test_a_square_of_rounded_points_is_one_loop(seed: int) -> None:
    """Sides of 90 mm from mid-edge, points off by up to 0.1 um: the corners turn by a little more or less than 2 pi."""
    rng = np.random.default_rng(seed)
    corners = np.array([[45, 0], [45, 45], [-45, 45], [-45, -45], [45, -45], [45, 0]], dtype=float)
    side = np.linspace(corners[:-1], corners[1:], 90, endpoint=False).swapaxes(0, 1).reshape(-1, 2)
    lines = ["G90 G21 G0 Z5", "X45 Y0", "F900"]
    for depth in (1, 2):
        loop = np.vstack([side, side[:1]]) * [1 - 0.02 * depth, 1.0] + rng.uniform(-1e-4, 1e-4, (len(side) + 1, 2))
        lines += [f"G1 X{x:.4f} Y{y:.4f} Z-{depth}" for x, y in loop]
    made = program_plan(read_program("\n".join([*lines, "G0 Z5", "M30"]), step=5e-3), sheet_job())
    assert [(len(contour), contour.closed) for contour in made.contours] == [(450, True)] * 2


def test_rings_become_closed_contours_of_the_cone() -> None:
    """The cone's wall, known without any planner: 45 deg, contacts r (1 - cos 45 deg) over the tips, sine law."""
    program = read_program(rings(8))
    made = program_plan(program, sheet_job())
    assert [contour.closed for contour in made.contours] == [True] * 8
    assert [contour.retract for contour in made.contours] == [True] + [False] * 7
    middle = made.contours[4]
    assert np.degrees(middle.wall_angle) == pytest.approx(np.full(len(middle), 45.0), abs=0.3)
    assert middle.contact[:, 2] == pytest.approx(-5e-3 + 5e-3 * (1 - np.sqrt(0.5)), abs=20e-6)
    assert np.hypot(*middle.contact[:, :2].T) == pytest.approx(25e-3 + 5e-3 * np.sqrt(0.5), abs=20e-6)
    assert middle.thickness == pytest.approx(1e-3 * np.sqrt(0.5), abs=10e-6)
    assert middle.feed == pytest.approx(15e-3)
    assert made.target.z.min() == pytest.approx(-8e-3 + 5e-3 * (1 - np.sqrt(0.5)), abs=50e-6)
    assert lines_of(program, made)["contour 2"] == (8, 9)


def test_normals_of_a_plane_and_of_a_line() -> None:
    rng = np.random.default_rng(2)
    tips = np.column_stack([rng.uniform(0, 1, (60, 2)), np.zeros(60)])
    tips[:, 2] = 0.75 * tips[:, 0]
    assert surface_normals(tips, np.arange(60)) == pytest.approx(np.tile([-0.6, 0.0, 0.8], (60, 1)), abs=1e-9)
    assert surface_normals(tips[:, :1] * [1.0, 0.0, 0.0], np.arange(60)) == pytest.approx(np.tile([0, 0, 1], (60, 1)))


def test_a_spiral_is_cut_into_turns_that_join() -> None:
    angle = np.linspace(0.0, 10.0 * np.pi, 600)
    radius = 30.0 - 4.0 * angle / angle[-1]
    points = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), -0.2 - 4.0 * angle / angle[-1]])
    lines = [f"X{x:.4f} Y{y:.4f} Z{z:.4f}" for x, y, z in points]
    made = program_plan(read_program("G0 Z5\nG0 X30 Y0\nG1 F900 " + "\n".join(lines) + "\nM30", step=5e-3), sheet_job())
    assert 4 <= len(made.contours) <= 6
    assert not any(contour.closed for contour in made.contours)
    assert sum(len(contour) for contour in made.contours) == 600


def test_a_seam_overlap_stays_in_the_path() -> None:
    """Torrao 2013, 7.1.2: a loop that runs on past its start; the piece belongs to the next contour."""
    program = read_program(rings(4, "G91 G3 X-.5 Y2 R25\nG90"))
    made = program_plan(program, sheet_job())
    forming = np.unique(np.vstack([contour.forming_tip for contour in made.contours]), axis=0)
    engaged = np.unique(program.tips[np.isfinite(program.speed) & (program.tips[:, 2] < -0.9e-3), :3], axis=0)
    assert len(forming) == len(engaged)
    assert min(len(contour) for contour in made.contours) >= 3


def test_points_and_offsets_out_of_reach_are_told_with_their_lines() -> None:
    rig = load_rig("torrao2013")
    text = "G54 G0 Z20\nG1 X0 Y0 Z-1\nG55 X0 Y0\nX130\nX50\nM30"
    program = read_program(text)
    found = check_program(program, rig)
    assert [(finding.line, finding.error.code) for finding in found] == [
        (4, ErrorCode.PROGRAM_OUT_OF_REACH),
        (5, ErrorCode.PROGRAM_OUT_OF_REACH),
    ]
    assert "program:4 at x = 116" in found[0].error.where
    (offset,) = check_work_offsets(program, rig, {54: (0.0, 0.0, 0.0), 55: (0.0, 0.2, 0.0)})
    assert (offset.line, offset.error.code) == (3, ErrorCode.PROGRAM_OUT_OF_REACH)
    assert "G55" in offset.error.what


def test_rapid_moves_through_the_sheet_are_told_with_their_line() -> None:
    """Across between two rings, down into the sheet, up and aside at once; straight up is the way to leave."""
    rig = load_rig("torrao2013")
    text = rings(1).replace("G0 Z20\nM30", "G0 X-29 Y0 Z-6\nG0 X29\nG1 X28 Y0 Z-2\nG3 X28 Y0 I-28\nG0 Z20\nM30")
    found = check_program(read_program(text), rig)
    assert [(finding.line, finding.error.code) for finding in found] == [
        (8, ErrorCode.PROGRAM_OUT_OF_REACH),
        (9, ErrorCode.PROGRAM_OUT_OF_REACH),
    ]
    assert "a rapid move takes the upper tool through the sheet" in found[0].error.what
    assert [finding.line for finding in check_program(read_program("G0 X0 Y0 Z-3\nG1 X5\nG0 X9 Z9\nM30"), rig)] == [
        1,
        3,
    ]
    assert not check_program(read_program(rings(3)), rig)
    lower = read_program("G0 Z20 W-20\nX0 Y0 U0 V0\nW4\nU9\nW-20\nM30")
    assert [finding.line for finding in check_program(lower, rig)] == [3, 4]


def test_the_tips_are_the_programs_whatever_the_job_compensates() -> None:
    program = read_program(rings(4))
    plain = program_plan(program, sheet_job())
    bending = SHEET.replace("radius: 5 mm", "radius: 5 mm, stick_out: 80 mm").replace(
        "feed: 20 mm/s", "feed: 20 mm/s, compensation: [tool]"
    )
    made = program_plan(program, sheet_job(bending + "control: {compliance_compensation: 0.0}\n"))
    for ours, theirs in zip(plain.contours, made.contours, strict=True):
        assert np.array_equal(ours.forming_tip, theirs.forming_tip)


def test_runs_too_short_for_a_contour_are_told() -> None:
    """A poke and a groove of 0.9 mm: alone they make no plan, beside rings they are left out with a warning."""
    short = "G0 Z5\nX3 Y0\nG1 F900 Z-1\nG0 Z5\nX5\nG1 Z-1\nX5.9\nG0 Z5\nM30"
    with pytest.raises(IsfError, match="fewer than three points") as caught:
        program_plan(read_program(short), sheet_job())
    assert caught.value.code == ErrorCode.PROGRAM_UNREADABLE
    assert "program:3" in caught.value.where
    made = program_plan(read_program(rings(3).replace("M30", short)), sheet_job())
    assert len(made.contours) == 3
    assert any("left out: 2 move(s) into the sheet" in warning for warning in made.warnings)
    assert not any("left out" in warning for warning in program_plan(read_program(rings(3)), sheet_job()).warnings)


def test_another_feed_is_another_plan() -> None:
    slow = program_plan(read_program(rings(3)), sheet_job())
    fast = program_plan(read_program(rings(3).replace("F900", "F1800")), sheet_job())
    assert slow.plan_id != fast.plan_id


def test_tools_of_different_radius_are_told_with_their_line() -> None:
    """Four rings with one tool and four with another: a plan has one radius for all contacts and forces."""
    tools = {number: MountedTool(length=0.05) for number in (1, 2, 3)}
    text = "T3 M6\n" + rings(8).replace("G1 X25", "G0 Z20\nT1 M6\nX25\nG1 X25", 1)
    program = read_program(text, SetUp(tools=tools))
    small, middle, large = (ToolSpec(radius=radius) for radius in (2.5e-3, 5e-3, 7.5e-3))
    tips = {1: small, 3: large}
    (finding,) = check_tools(program, tips, middle)
    assert finding.line == text.split("\n").index("G1 X25 Y0 Z-5") + 1
    assert "tool 1 (2.5 mm radius) forms after one of 7.5 mm" in finding.error.what
    assert not check_tools(program, {1: large, 3: large}, middle)
    assert check_tools(program, {3: large}, middle)
    assert not check_tools(program, {3: middle}, middle)
    (finding,) = check_tools(program, {1: ToolSpec(radius=7.5e-3, corner_radius=2e-3), 3: large}, middle)
    assert "tool 1 (7.5 mm radius, flat with an edge of 2 mm) forms after one of 7.5 mm radius" in finding.error.what
    above = read_program("T3\nG1 X0 Y0 Z5\nT1\nX9 Z-1\nX0\nM30", SetUp(tools=tools))
    assert not check_tools(above, tips, middle)


def test_a_lower_tool_without_a_place_is_told() -> None:
    """Before U, V and W it would stand in the sheet at the origin of frame sheet, in the way of the upper one."""
    rig = load_rig("torrao2013")
    late = "G0 X0 Y0 Z5\nG1 Z-1\nX5\nW-5 U0\nX6\nG91 V0 X1\nG90 V0\nX8\nM30"
    (finding,) = check_program(read_program(late), rig)
    assert (finding.line, "where the lower tool is" in finding.error.what) == (2, True)
    assert not check_program(read_program("G0 X0 Y0 Z5 U0 V0 W-9\nG1 Z-1\nX5 U5\nM30"), rig)
    assert read_program(late).lower_from == len(read_program(late)) - 2


def test_cylinders_out_of_stroke_are_told_with_their_line() -> None:
    """A rig whose travel allows more than its cylinders: the hexapod's strokes end before z = 245 mm."""
    rig = load_rig("torrao2013")
    wide = rig.model_copy(update={"limits": rig.limits.model_copy(update={"travel": (0.5, 0.5, 0.5)})})
    (finding,) = check_program(read_program("G0 X0 Y0 Z20\nZ245\nM30"), wide)
    assert finding.line == 2
    assert "cylinder" in finding.error.what


@pytest.mark.parametrize(
    ("text", "code"),
    [
        ("G0 Z5\nG1 X0 Y0 Z1\nX5\nM30", ErrorCode.PROGRAM_UNREADABLE),
        ("G0 Z5 W-5\nG1 X0 Y0 Z-1 U0 V0 W-2\nX5 U5\nX6 U6\nM30", ErrorCode.PROCESS_NOT_SUPPORTED),
    ],
)
def test_programs_that_make_no_plan(text: str, code: ErrorCode) -> None:
    with pytest.raises(IsfError) as caught:
        program_plan(read_program(text), sheet_job())
    assert caught.value.code == code


def test_a_lower_tool_that_forms_is_refused_with_its_line(tmp_path: Path) -> None:
    job_file = load_job(JOBS / "two_features.yaml")
    (file,) = exports.export(plan(job_file), tmp_path / "part.nc")
    with pytest.raises(IsfError, match="the lower tool forms here") as caught:
        program_plan(read_program(file.read_text()), job_file)
    assert caught.value.code == ErrorCode.PROCESS_NOT_SUPPORTED


def test_cylinders_of_a_part_before_it_is_formed(tmp_path: Path) -> None:
    """Strokes are those of the poses one by one; the cylinders' vertical forces carry the axial force."""
    job_file = sheet_job()
    made = program_plan(read_program(rings(5)), job_file)
    hexapod = hexapod_of(job_file.rig)
    assert hexapod is not None
    use = axes_use(hexapod, made.contours)
    assert use.strokes[0] == pytest.approx(hexapod.positions(made.contours[0].forming_tip[0]), abs=1e-12)
    assert use.margin == pytest.approx(min(use.strokes.min(), 0.4 - use.strokes.max()))
    largest = max(float(contour.predicted_force.max()) for contour in made.contours)
    assert largest / 6.0 < use.force < largest
    assert use.joint_angle < np.radians(20.0)
    assert draw_reach(hexapod, made.contours, job_file.rig, tmp_path / "reach.png").stat().st_size > 20_000
    with pytest.raises(IsfError) as caught:
        draw_reach(hexapod, made.contours, job_file.rig, tmp_path / "no" / "reach.png")
    assert caught.value.code == ErrorCode.FILE_NOT_WRITABLE
    assert hexapod_of(load_rig("ren2018")) is None


def test_a_plan_is_refused_where_the_cylinders_end() -> None:
    """A table 300 mm lower than it is: before only the machine told, in mid-part."""
    made = program_plan(read_program(rings(3)), sheet_job())
    deep = [contour.shifted(np.tile([0.0, 0.0, -0.3], (len(contour), 1))) for contour in made.contours]
    with pytest.raises(IsfError, match=r"cylinder \d would have a stroke of") as caught:
        part_checks.check_axes(deep, load_rig("torrao2013"), 5e-3)
    assert caught.value.code == ErrorCode.PART_DOES_NOT_FIT


def test_a_backing_plate_in_the_way_is_told_as_for_every_plan() -> None:
    plate = "backing_plate: {shape: circle, size: [50 mm, 50 mm]}\n"
    with pytest.raises(IsfError, match="into the backing plate") as caught:
        program_plan(read_program(rings(4)), sheet_job(SHEET + plate))
    assert caught.value.code == ErrorCode.PART_DOES_NOT_FIT
