"""Speed of the spindle at which the tool rolls along the wall, and the words of it in programs of every format."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from functools import cache
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from isf_core.contour import Contour
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import Job, JobFile, load_job
from isf_core.files.tooling import ToolSpec
from isf_planner import Plan, plan
from isf_planner.exports import export, load_plan, post_names
from isf_planner.gcode.reader import read_program
from isf_planner.paths.spindle import slip, spindle_speeds
from isf_planner.replanning import PlanBase
from planner_contours import circle
from planner_parts import EXAMPLES

RPM = 30.0 / np.pi
FEED = 2.0 / 60.0
"""m/s: 2 m/min."""


@cache
def job(options: str = ", spindle: rolling", tool: str = "radius: 5 mm", process: str = "SPIF") -> Job:
    text = f"""
name: part
part: {{mesh: part.stl, unit: mm}}
process: {process}
rig: ren2018
sheet: {{material: AA5754-O, thickness: 1 mm}}
tool_1: {{{tool}}}
tool_2: {{radius: 5 mm}}
path: {{incremental_depth: 0.5 mm, feed: 30 mm/s{options}}}
"""
    return JobFile(text, Path()).job


def wall(angle: float, **changes: object) -> Contour:
    """A pocket's contour at 2 m/min with a wall of ``angle`` deg."""
    return replace(circle(angle=np.radians(angle)), feed=FEED, **changes)


@pytest.mark.parametrize(("angle", "rpm"), [(10, 367), (30, 127), (45, 90), (60, 73.5), (80, 64.6)])
def test_published_conditions(angle: float, rpm: float) -> None:
    """Feed and tool of Behera 2015, Case studies; the table of the formula, to its digits."""
    (speed,) = spindle_speeds([wall(angle)], job())
    assert RPM * speed == pytest.approx(rpm, rel=0.005)


@settings(max_examples=50, deadline=None)
@given(st.floats(5.0, 89.0), st.floats(1e-3, 0.1), st.booleans())
def test_the_contact_stands_still_on_the_sheet(angle: float, feed: float, clockwise: bool) -> None:
    """Rigid body: velocity of the tool's axis and of its turn, added at the contact."""
    contour = replace(circle(angle=np.radians(angle)), feed=feed)
    if clockwise:
        turned = {name: getattr(contour, name)[::-1] for name in ("contact", "normal", "forming_tip")}
        contour = replace(contour, **turned)
    (speed,) = spindle_speeds([contour], job(", spindle: rolling, spindle_limit: 49000 rpm"))
    assert (speed > 0.0) is (not clockwise)
    tip = contour.forming_tip
    along = np.roll(tip, -1, axis=0) - np.roll(tip, 1, axis=0)
    travel = feed * along / np.linalg.norm(along, axis=1)[:, None]
    centre = tip + [0.0, 0.0, 5e-3]
    turn = np.cross([0.0, 0.0, -speed], contour.contact - centre)  # clockwise from above: about -z
    assert np.abs(travel + turn).max() < 1e-6 * feed
    assert slip(contour, speed, job().tool_1) < 1e-9
    assert slip(contour, 0.0, job().tool_1) == pytest.approx(1.0)


def test_a_flat_tip_touches_farther_from_its_axis() -> None:
    """3 mm of flat and 5 mm of edge at 30 deg: 3 + 5 sin(30 deg) = 5.5 mm."""
    (speed,) = spindle_speeds([wall(30)], job(tool="radius: 8 mm, corner_radius: 5 mm"))
    assert RPM * speed == pytest.approx(2000.0 / (2 * np.pi * 5.5), rel=1e-3)


def test_a_tilted_tool_touches_nearer_to_its_axis() -> None:
    """Leaning by 30 deg away from a wall of 60 deg, it touches 5 sin(30 deg) mm from its axis."""
    upright = wall(60)
    lean = upright.normal * [1.0, 1.0, 0.0]
    lean /= np.linalg.norm(lean, axis=1)[:, None]
    axis = lean * np.sin(np.radians(30)) + [0.0, 0.0, np.cos(np.radians(30))]
    (speed,) = spindle_speeds([replace(upright, forming_axis=axis)], job())
    assert RPM * speed == pytest.approx(2000.0 / (2 * np.pi * 2.5), rel=1e-3)


def test_one_speed_for_walls_of_two_angles_slips_least() -> None:
    """Half of the way at 60, half at 30 deg: no other speed has a smaller mean square of slip."""
    steep, shallow = circle(angle=np.radians(60)), circle(angle=np.radians(30))
    half = np.arange(len(steep)) < 90
    names = ("normal", "wall_angle", "thickness")
    mixed = {
        name: np.where(
            half if getattr(steep, name).ndim == 1 else half[:, None], getattr(steep, name), getattr(shallow, name)
        )
        for name in names
    }
    contour = replace(steep, **mixed, feed=FEED)
    (speed,) = spindle_speeds([contour], job())
    sines = np.sin(np.radians([60.0, 30.0]))

    def squares(rpm: float) -> float:
        return float(((1.0 - rpm / RPM * 5e-3 * sines / FEED) ** 2).sum())

    assert 73.5 < RPM * speed < 127.0
    assert squares(RPM * speed) < min(squares(RPM * speed * 0.97), squares(RPM * speed * 1.03))
    assert 0.1 < slip(contour, speed, job().tool_1) < 0.4


def test_shallow_walls_are_held_at_the_limit_and_floors_at_the_speed_before() -> None:
    contours = [wall(60), wall(0.0), wall(2.0), replace(wall(30), forming_tool=2)]
    speeds = RPM * np.array(spindle_speeds(contours, job()))
    np.testing.assert_allclose(speeds, [73.5, 73.5, 73.5, 0.0], rtol=0.005)
    island = [wall(60), replace(wall(30), forming_tool=2), wall(0.0)]
    np.testing.assert_allclose(RPM * np.array(spindle_speeds(island, job())), [73.5, 0.0, 73.5], rtol=0.005)
    np.testing.assert_allclose(RPM * np.array(spindle_speeds([wall(2.0), wall(60)], job())), [73.5, 73.5], rtol=0.005)
    (first,) = spindle_speeds([wall(2.0)], job())
    assert RPM * first == pytest.approx(1000.0)
    (own,) = spindle_speeds([wall(6.0)], job(", spindle: rolling, spindle_limit: 300 rpm"))
    assert RPM * own == pytest.approx(300.0)


def test_a_speed_of_its_own_and_none() -> None:
    assert RPM * np.array(spindle_speeds([wall(60), wall(10)], job(", spindle: -80 rpm"))) == pytest.approx([-80, -80])
    assert spindle_speeds([wall(60)], job("")) == ()


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (", spindle: 80", "has no unit"),
        (", spindle: 0 rpm", "spindle 0 rpm does not turn"),
        (", spindle: 80 mm", "not a quantity in rad/s"),
        (", spindle: nan rpm", "spindle"),
        (", spindle: 1e9 rpm", "spindle"),
        (", spindle_limit: 300 rpm", "spindle_limit has no effect without spindle rolling"),
        (", spindle: 80 rpm, spindle_limit: 300 rpm", "spindle_limit has no effect without spindle rolling"),
        (", program: part.nc, spindle: rolling", "has no effect beside program"),
    ],
)
def test_what_is_no_speed_is_refused(options: str, said: str) -> None:
    with pytest.raises(IsfError, match=re.escape(said)) as caught:
        job(options)
    assert caught.value.code in (ErrorCode.FILE_FIELD, ErrorCode.FILE_UNIT)


def test_accumulative_forming_has_no_wall_to_roll_on() -> None:
    with pytest.raises(IsfError, match="spindle rolling needs process SPIF, DSIF or TPIF"):
        job(", spindle: rolling}\nadsif: {surface: AA5754-O_1mm_R5", process="ADSIF")


@pytest.fixture(scope="module")
def rolling() -> Plan:
    """Small cone formed by one tool with the spindle rolling; its fillets make every contour another speed."""
    text = (EXAMPLES / "jobs" / "mini_cone.yaml").read_text(encoding="utf-8").replace("DSIF", "SPIF")
    lines = [line for line in text.splitlines() if not line.strip().startswith(("support_force", "engage_depth"))]
    text = "\n".join(lines).replace("path:\n", "path:\n  spindle: rolling\n")
    return plan(JobFile(text, EXAMPLES / "jobs"))


def test_a_plan_has_a_speed_for_every_contour_and_the_file_keeps_it(rolling: Plan, tmp_path: Path) -> None:
    assert len(rolling.spindle) == len(rolling.contours)
    steepest = max(range(len(rolling.contours)), key=lambda k: rolling.contours[k].wall_angle.mean())
    contour = rolling.contours[steepest]
    expected = contour.feed / (5e-3 * np.sin(contour.wall_angle.mean()))
    assert rolling.spindle[steepest] == pytest.approx(expected, rel=0.01)
    (file,) = export(rolling, tmp_path / "part.npz")
    assert load_plan(file).spindle == rolling.spindle
    with np.load(file) as data:
        head = json.loads(str(data["head"]))
        others = {name: data[name] for name in data.files if name != "head"}
    assert head["version"] == 3  # older software would leave the words of the spindle out of its programs
    for wrong in ([1.0], ["fast"] * len(rolling.contours), [float("nan")] * len(rolling.contours), 5):
        np.savez(tmp_path / "wrong.npz", head=np.array(json.dumps(head | {"spindle": wrong})), **others)
        with pytest.raises(IsfError, match="not a complete plan file"):
            load_plan(tmp_path / "wrong.npz")


def test_a_plan_without_it_is_what_it_was() -> None:
    job_file = load_job(EXAMPLES / "jobs" / "mini_cone.yaml")
    assert job_file.job.path.spindle == "none"
    made = plan(job_file)
    assert made.spindle == ()
    assert isinstance(made.base, PlanBase)


def words(file: Path) -> list[str]:
    return [line for line in file.read_text().splitlines() if re.match(r"S\d|M[345]\b", line)]


def test_s_words_where_the_speed_changes_by_more_than_a_twentieth(rolling: Plan, tmp_path: Path) -> None:
    (file,) = export(rolling, tmp_path / "part.nc")
    found = words(file)
    assert found[-1] == "M5"
    written = [int(re.fullmatch(r"S(\d+) M3", line)[1]) for line in found[:-1]]  # type: ignore[index]
    assert 2 <= len(written) < len(rolling.contours)
    for before, after in pairwise(written):
        assert abs(after - before) > 0.045 * before
    in_force, number = 0.0, -1
    for line in file.read_text().splitlines():
        if match := re.fullmatch(r"S(\d+) M3", line):
            in_force = float(match[1])
        if match := re.match(r"\(contour (\d+) of", line):
            number = int(match[1]) - 1
        if line.startswith("G1 "):
            assert in_force == pytest.approx(RPM * rolling.spindle[number], rel=0.055)


def test_the_spindle_turns_before_the_tool_comes_down_and_stops_after_it_is_up(rolling: Plan, tmp_path: Path) -> None:
    (file,) = export(rolling, tmp_path / "part.nc")
    lines = file.read_text().splitlines()
    starts = next(k for k, line in enumerate(lines) if re.match(r"S\d", line))
    assert starts < next(k for k, line in enumerate(lines) if line.startswith("G0"))
    assert lines.index("M5") > max(k for k, line in enumerate(lines) if line.startswith(("G0", "G1")))


def test_programs_with_s_words_are_read_back(rolling: Plan, tmp_path: Path) -> None:
    """And S alone, with decimals, on a line with coordinates, and M3, M4, M5 beside others."""
    (file,) = export(rolling, tmp_path / "part.nc")
    found = read_program(file.read_text())
    assert found.unknown == ()
    assert found.findings == ()
    moves = [number for number, line in enumerate(file.read_text().splitlines(), 1) if line.startswith("G1 ")]
    tips = found.tips[found.given & np.isin(found.line, moves), :3]
    planned = np.vstack([np.vstack([one.forming_tip, one.forming_tip[:1]]) for one in rolling.contours])
    np.testing.assert_allclose(tips, planned, atol=1e-7)
    text = "G21 G90\nS64.6\nM3\nG0 X0 Y0 Z5 S100\nG1 Z-1 F500 S80 M4\nX10 M5\nM30\n"
    read = read_program(text)
    assert (read.unknown, read.findings) == ((), ())
    assert len(read) > 2


@pytest.mark.parametrize(
    ("form", "on", "off"),
    [
        ("iso", r"S(\d+) M3", "M5"),
        ("iso_two_channels", r"S([\d.]+) M3", "M5"),
        ("pmac", r"S([\d.]+) M3", "M5"),
        ("krl", r"isf_spindle\(([\d.]+)\)", "isf_spindle(0.0)"),
        ("rapid", r"    isfSpindle ([\d.]+);", "    isfSpindle 0;"),
    ],
)
def test_every_dialect_says_it_once_at_the_start_and_stops_it(
    form: str, on: str, off: str, rolling: Plan, tmp_path: Path
) -> None:
    (file,) = export(rolling, tmp_path / "part", form)
    lines = file.read_text().splitlines()
    first = next(match for line in lines if (match := re.fullmatch(on, line)))
    assert float(first[1]) == pytest.approx(RPM * rolling.spindle[0], rel=0.005)
    assert lines.count(off) == 1


def test_alternating_sense_turns_the_other_way(rolling: Plan, tmp_path: Path) -> None:
    other = tuple(speed * (-1) ** k for k, speed in enumerate(rolling.spindle))
    (file,) = export(replace(rolling, spindle=other), tmp_path / "part.nc")
    found = words(file)
    assert len(found) == len(rolling.contours) + 1
    assert [line[-2:] for line in found[:4]] == ["M3", "M4", "M3", "M4"]


def test_the_lower_tool_of_two_programs_has_no_spindle(tmp_path: Path) -> None:
    made = plan(load_job(EXAMPLES / "jobs" / "mini_cone.yaml"))
    turning = replace(made, spindle=(7.0,) * len(made.contours))
    upper, lower = export(turning, tmp_path / "part.mpf")
    assert words(upper) == ["S66.8 M3", "M5"]
    assert words(lower) == []


def test_without_a_spindle_no_format_says_a_word(rolling: Plan, tmp_path: Path) -> None:
    still = replace(rolling, spindle=())
    for form in sorted(set(post_names()) - {"joints", "krl_roboteam"}):
        for file in export(still, tmp_path / f"{form}_part", form):
            assert not re.search(r"^\s*(S\d|M[345]\b|isf_?spindle)", file.read_text(), re.MULTILINE | re.IGNORECASE)


OWN = """\
name: own
description: one line per point
extension: .txt
{more}
channels:
  - plans: one tool
    {lines}
    point: "X{{x1:.4f}} Y{{y1:.4f}} Z{{z1:.4f}}"
"""


def test_a_format_that_says_nothing_of_it_is_refused(rolling: Plan, tmp_path: Path) -> None:
    own = tmp_path / "own.yaml"
    own.write_text(OWN.format(more="", lines="contour: []"))
    with pytest.raises(IsfError, match="format own says nothing of the spindle") as caught:
        export(rolling, tmp_path / "part.txt", str(own))
    assert caught.value.code == ErrorCode.EXPORT_FORMAT_UNKNOWN
    assert not (tmp_path / "part.txt").exists()


@pytest.mark.parametrize(("change", "count"), [(0.0, None), (0.99, 1)])
def test_a_format_may_have_another_threshold(change: float, count: int | None, rolling: Plan, tmp_path: Path) -> None:
    own = tmp_path / "own.yaml"
    lines = 'spindle: ["S{{rpm:.3f}}"]\n    spindle_stop: [M5]'.replace("{{", "{").replace("}}", "}")
    own.write_text(OWN.format(more=f"spindle_change: {change}", lines=lines))
    (file,) = export(rolling, tmp_path / "part.txt", str(own))
    differing = 1 + sum(a != b for a, b in pairwise(rolling.spindle))
    assert len(words(file)) - 1 == (count or differing)


def test_what_starts_to_turn_has_to_stop(tmp_path: Path) -> None:
    own = tmp_path / "own.yaml"
    own.write_text(OWN.format(more="", lines="spindle: [M3]"))
    with pytest.raises(IsfError, match="spindle and spindle_stop need each other"):
        export(plan(load_job(EXAMPLES / "jobs" / "mini_cone.yaml")), tmp_path / "part.txt", str(own))


def test_the_tool_that_a_slip_is_told_of_is_the_jobs() -> None:
    (speed,) = spindle_speeds([wall(60)], job())
    larger = ToolSpec(radius=10e-3)
    assert slip(wall(60), speed, larger) == pytest.approx(1.0, rel=1e-6)  # twice the lever: it slips forwards as fast
