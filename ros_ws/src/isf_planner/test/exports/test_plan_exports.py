"""Plans to files and back: whole plans, AMPL tables, machine programs of every format, and damaged files."""

from __future__ import annotations

import json
import re
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from isf_core.contour import Contour
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile, load_job
from isf_core.geometry.tool_axis import angle_between
from isf_planner import Plan, plan
from isf_planner.exports import FORMATS, export, load_plan, load_post, post_names, read_programs, save_plan
from isf_planner.exports.post_processor import pattern
from isf_planner.exports.programs import path_points
from isf_planner.gcode.reader import read_program
from planner_parts import EXAMPLES
from scipy.spatial.transform import Rotation

MICROMETRE = 1e-6


@pytest.fixture(scope="module")
def job_file() -> JobFile:
    return load_job(EXAMPLES / "jobs" / "mini_cone.yaml")


@pytest.fixture(scope="module")
def made(job_file: JobFile) -> Plan:
    return plan(job_file)


@pytest.fixture(scope="module")
def one_tool(made: Plan) -> Plan:
    """The same path without a support tool, lifted once on the way, the speed changing from point to point."""
    contours = [
        replace(
            contour,
            support_tip=np.empty((0, 3)),
            support_force=np.empty(0),
            retract=contour.index == 4,
            speed=np.linspace(1e-3, 30e-3, len(contour)),
        )
        for contour in made.contours
    ]
    return replace(made, contours=tuple(contours))


def same(contour: Contour, other: Contour) -> None:
    for item in fields(Contour):
        np.testing.assert_array_equal(getattr(contour, item.name), getattr(other, item.name), err_msg=item.name)


def test_plan_file_keeps_everything(made: Plan, one_tool: Plan, tmp_path: Path) -> None:
    for original in (made, one_tool, replace(made, warnings=("one", "zwei µ"))):
        copy = load_plan(save_plan(original, tmp_path / "plan.npz"))
        assert copy.plan_id == original.plan_id
        assert copy.warnings == original.warnings
        assert len(copy.contours) == len(original.contours)
        for contour, other in zip(original.contours, copy.contours, strict=True):
            same(contour, other)
        for axis in "xyz":
            np.testing.assert_array_equal(getattr(copy.target, axis), getattr(original.target, axis))
        for array, other_array in zip(original.mesh, copy.mesh, strict=True):
            np.testing.assert_array_equal(array, other_array)


def leaning(plan_: Plan, tilt: float = np.radians(20.0)) -> Plan:
    """The plan with its forming tool tilted towards the normals, not on the first contour."""
    contours = []
    for contour in plan_.contours:
        level = contour.normal[:, :2] / np.maximum(np.hypot(*contour.normal[:, :2].T), 1e-9)[:, None]
        axis = np.column_stack([np.sin(tilt) * level, np.full(len(contour), np.cos(tilt))])
        contours.append(replace(contour, forming_axis=axis if contour.index else np.empty((0, 3))).validate())
    return replace(plan_, contours=tuple(contours))


def test_plan_file_of_a_tilted_tool_has_a_version_of_its_own(one_tool: Plan, tmp_path: Path) -> None:
    """An older version refuses it, and would not form it upright; a file without axes is upright."""
    tilted = leaning(one_tool)
    for original, version in ((tilted, 2), (one_tool, 1)):
        path = save_plan(original, tmp_path / "plan.npz")
        with np.load(path) as data:
            assert json.loads(str(data["head"]))["version"] == version
            old = {name: data[name] for name in data.files if name != "contour_forming_axis"}
        for contour, other in zip(original.contours, load_plan(path).contours, strict=True):
            same(contour, other)
        if version == 1:
            np.savez_compressed(path, **old)
            assert not any(contour.tilted for contour in load_plan(path).contours)


@pytest.mark.parametrize("form", ["iso", "iso_two_channels"])
def test_g_code_of_a_tilted_tool_comes_back_by_the_reader(form: str, one_tool: Plan, tmp_path: Path) -> None:
    """Tips to 0.05 um and axes to 1e-6 rad: angles A, B and vectors A3= B3= C3=, both of a point on the axis."""
    tilted = replace(leaning(one_tool), ball_radius=4e-3)
    (file,) = export(tilted, tmp_path / "part", form)
    program = read_program(file.read_text(encoding="ascii"), name=file.name, step=1.0)
    assert not program.unknown
    assert not program.findings
    wanted = path_points(tilted.contours)
    cut = np.isfinite(program.speed)
    assert np.abs(program.tips[cut, :3] - wanted.tool_1).max() > 0.1e-3  # the point on the axis is not the tip
    formed = program.with_ball(4e-3)
    assert np.abs(formed.tips[cut, :3] - wanted.tool_1).max() <= 0.05e-6
    assert angle_between(formed.axis[cut], wanted.axis).max() <= 1e-6


def test_robot_programs_hold_the_orientation_of_a_tilted_tool(one_tool: Plan, tmp_path: Path) -> None:
    """The z axis of the flange's tool points from the shank to the tip; scipy is the judge."""
    tilted = replace(leaning(one_tool), ball_radius=4e-3)
    wanted = path_points(tilted.contours).axis
    (krl,) = export(tilted, tmp_path / "part", "krl")
    angles = np.array(re.findall(r"A 0,B (\S+),C ([^}]+)}} C_DIS".replace("}}", "}"), krl.read_text()), dtype=float)
    of_krl = Rotation.from_euler("ZYX", np.column_stack([0.0 * angles[:, 0], angles]), degrees=True)
    (rapid,) = export(tilted, tmp_path / "part", "rapid")
    found = re.findall(r"\],\[([^]]+)\],\[0,0,0,0\].*z0,isfTool", rapid.read_text())
    of_rapid = Rotation.from_quat(np.array([line.split(",") for line in found], dtype=float)[:, [1, 2, 3, 0]])
    for turn in (of_krl, of_rapid):
        assert angle_between(turn.apply([0.0, 0.0, -1.0]), wanted).max() <= 1e-6


@pytest.mark.parametrize("form", ["pmac", "csv"])
def test_a_format_that_cannot_hold_the_axis_says_so(form: str, one_tool: Plan, tmp_path: Path) -> None:
    with pytest.raises(IsfError, match="tilted tool") as caught:
        export(replace(leaning(one_tool), ball_radius=4e-3), tmp_path / "part.x", form)
    assert caught.value.code == ErrorCode.EXPORT_FORMAT_UNKNOWN
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("form", ["csv", *post_names()])
def test_a_moving_blank_holder_is_in_a_plan_file_alone(form: str, one_tool: Plan, tmp_path: Path) -> None:
    """Without its travel a program of a part over a die would go around at one height."""
    over_die = [replace(one, holder_height=-0.5e-3 * one.index) for one in one_tool.contours]
    plan_ = replace(one_tool, contours=tuple(over_die))
    with pytest.raises(IsfError, match="blank holder") as caught:
        export(plan_, tmp_path / "part.x", form)
    assert caught.value.code == ErrorCode.EXPORT_FORMAT_UNKNOWN
    assert not list(tmp_path.iterdir())
    assert load_plan(*export(plan_, tmp_path / "part.npz")).contours[-1].holder_height < 0.0


FOR_ROBOTS = {"joints", "krl_roboteam"}
"""Formats of rigs with arms, or of two robots alone: test_robot_programs.py."""


@pytest.mark.parametrize("form", sorted(set(post_names()) - FOR_ROBOTS))
@pytest.mark.parametrize("tools", [1, 2])
def test_programs_read_back_to_a_micrometre(form: str, tools: int, made: Plan, one_tool: Plan, tmp_path: Path) -> None:
    original = made if tools == 2 else one_tool
    post = load_post(form)
    files = export(original, tmp_path / "part", form)
    assert all(path.suffix == post.extension for path in files)
    found = [False, False]
    groups = {re.sub(r"_\d{3}$", "", path.stem) for path in files}
    for group in groups:
        mine = [path for path in files if re.sub(r"_\d{3}$", "", path.stem) == group]
        contours = read_programs(mine, post)
        assert len(contours) == len(original.contours)
        for contour, tips in zip(original.contours, contours, strict=True):
            for k, (expected, got) in enumerate(zip((contour.forming_tip, contour.support_tip), tips, strict=True)):
                if np.isfinite(got).all():
                    found[k] = True
                    assert np.abs(got - expected).max() < MICROMETRE
    assert found == [True, tools == 2]


def test_long_pmac_program_is_split_at_4000_lines(made: Plan, tmp_path: Path) -> None:
    count = sum(len(contour) for contour in made.contours)
    long = replace(made, contours=made.contours * (9000 // count + 1))
    long = replace(long, contours=tuple(replace(c, index=k) for k, c in enumerate(long.contours)))
    files = export(long, tmp_path / "part.pmc")
    assert [path.name for path in files] == ["part_001.pmc", "part_002.pmc", "part_003.pmc"]
    lines = [path.read_text().splitlines() for path in files]
    assert [len(part) for part in lines[:-1]] == [4000, 4000]
    assert all(part[1] == f"OPEN PROG {k} CLEAR" and part[-1] == "CLOSE" for k, part in enumerate(lines, start=1))
    assert sum(len(tips[0]) for tips in read_programs(files, load_post("pmac"))) == sum(len(c) for c in long.contours)


def test_pmac_line_has_tips_force_and_feed(made: Plan, tmp_path: Path) -> None:
    """Columns of the motion program of Ren 2018, Appendix C: X Y Z U V W A F, mm, N, mm/s."""
    (file,) = export(made, tmp_path / "part.pmc")
    deepest = made.contours[-2]
    tip, support = deepest.forming_tip[0] * 1e3, deepest.support_tip[0] * 1e3
    line = (
        f"X{tip[0]:.4f} Y{tip[1]:.4f} Z{tip[2]:.4f} U{support[0]:.4f} V{support[1]:.4f} W{support[2]:.4f} "
        f"A{deepest.support_force[0]:.1f} F{deepest.feed * 1e3:.4f}"
    )
    assert line in file.read_text().splitlines()


def test_tools_are_lifted_where_the_plan_says_so(one_tool: Plan, tmp_path: Path) -> None:
    (file,) = export(one_tool, tmp_path / "part.nc")
    lifts = [line for line in file.read_text().splitlines() if line.startswith("G0 Z")]
    # to the first point, away from contour 4 and to it again, away at the end
    assert len(lifts) == 4
    assert set(lifts) == {"G0 Z20.0000"}


@pytest.mark.parametrize("form", sorted(set(post_names()) - FOR_ROBOTS))
@pytest.mark.parametrize("shift", [-25e-3, 0.0, 30e-3])
def test_lifted_tools_are_clear_of_the_formed_sheet(form: str, shift: float, made: Plan, tmp_path: Path) -> None:
    """In a deep part the lower tool goes down, never up into the sheet; over a high one the upper tool goes up."""
    moved = [
        replace(one, forming_tip=one.forming_tip + [0.0, 0.0, shift], support_tip=one.support_tip + [0.0, 0.0, shift])
        for one in made.contours
    ]
    points = path_points(moved)
    wanted = {
        "z1": 20.0 + 1e3 * max(0.0, points.tool_1[:, 2].max()),
        "z2": -20.0 + 1e3 * min(0.0, points.tool_2[:, 2].min()),
    }
    channels = [channel for channel in load_post(form).channels if channel.plans == "two tools"]
    files = export(replace(made, contours=tuple(moved)), tmp_path / "part", form)
    for file, channel in zip(files, channels, strict=True):
        lifts = [pattern(line) for line in channel.lift]
        lines = file.read_text(encoding="ascii").splitlines()
        matches = [match.groupdict() for line in lines for lift in lifts if (match := lift.fullmatch(line))]
        for tool in channel.tools:
            heights = [float(match[f"z{tool}"]) for match in matches if f"z{tool}" in match]
            assert len(heights) >= 2
            assert heights == pytest.approx([wanted[f"z{tool}"]] * len(heights), abs=1e-3)


def test_ampl_tables(made: Plan, tmp_path: Path) -> None:
    def read(file: Path) -> np.ndarray:
        return np.loadtxt(file, delimiter=",", skiprows=1)

    files = export(made, tmp_path / "part.csv")
    assert [path.name for path in files] == [
        "part_topContactPnts.csv",
        "part_topToolTipPnts.csv",
        "part_botToolTipPnts.csv",
    ]
    assert len(files[0].read_text().splitlines()[0].split(",")) == 17
    table = read(files[0])
    assert np.diff(np.flatnonzero(table[:, 16]), prepend=-1).tolist() == [len(contour) for contour in made.contours]
    assert np.abs(table[:, :3] * 1e-3 - np.vstack([contour.contact for contour in made.contours])).max() < MICROMETRE
    assert np.abs(table[:, 3:6] - np.vstack([contour.normal for contour in made.contours])).max() < 1e-6
    for file, tips in ((files[1], "forming_tip"), (files[2], "support_tip")):
        expected = np.vstack([getattr(contour, tips) for contour in made.contours])
        assert np.abs(read(file) * 1e-3 - expected).max() < MICROMETRE


def test_curvatures_of_the_cone(made: Plan, tmp_path: Path) -> None:
    """On the straight wall one principal curvature is sin(angle) / radius around, the other 0 down the wall."""
    table = np.loadtxt(export(made, tmp_path / "part.csv")[0], delimiter=",", skiprows=1)
    wall = (table[:, 2] < -2.2) & (table[:, 2] > -2.8)
    assert wall.any()
    around = np.sin(np.radians(45)) / np.hypot(*table[wall, :2].T)
    np.testing.assert_allclose(table[wall, 6], around, rtol=0.05)
    assert np.abs(table[wall, 10]).max() < 0.1 * around.min()


USER_POST = """\
name: mine
description: a user's table
extension: .txt
channels:
  - plans: two tools
    contour: ["# {contour}"]
    point: "{{P {n} {x1:.5f} {y1:.5f} {z1:.5f} {x2:.5f} {y2:.5f} {z2:.5f}}}"
"""


def test_user_adds_a_format_as_a_file(made: Plan, tmp_path: Path) -> None:
    (tmp_path / "mine.yaml").write_text(USER_POST)
    form = str(tmp_path / "mine.yaml")
    (file,) = export(made, tmp_path / "part.txt", form)
    contours = read_programs([file], load_post(form))
    for contour, (upper, lower) in zip(made.contours, contours, strict=True):
        assert np.abs(contour.forming_tip - upper).max() < MICROMETRE
        assert np.abs(contour.support_tip - lower).max() < MICROMETRE


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("{x1:.5f}", "{q:.5f}"), "unknown field q"),
        (("{{P", "{P"), "template"),
        (("plans: two tools", "plans: three"), "plans"),
        (("point:", "pont:"), "pont"),
        (('"{{P {n} {x1:.5f} {y1:.5f} {z1:.5f} {x2:.5f} {y2:.5f} {z2:.5f}}}"', '"{n}"'), "position of a tool"),
    ],
)
def test_faults_in_a_users_format_are_reported(change: tuple[str, str], words: str, tmp_path: Path) -> None:
    (tmp_path / "mine.yaml").write_text(USER_POST.replace(*change))
    with pytest.raises(IsfError) as caught:
        load_post(str(tmp_path / "mine.yaml"))
    assert caught.value.code is ErrorCode.FILE_FIELD
    assert words in str(caught.value)


def test_unknown_formats(made: Plan, one_tool: Plan, tmp_path: Path) -> None:
    for path, form in ((tmp_path / "part.xyz", None), (tmp_path / "part.nc", "heidenhain")):
        with pytest.raises(IsfError) as caught:
            export(made, path, form)
        assert caught.value.code is ErrorCode.EXPORT_FORMAT_UNKNOWN
        assert "pmac" in str(caught.value)
    (tmp_path / "mine.yaml").write_text(USER_POST)
    with pytest.raises(IsfError, match="no program for one tool"):
        export(one_tool, tmp_path / "part.txt", str(tmp_path / "mine.yaml"))
    with pytest.raises(IsfError) as caught:
        export(made, tmp_path / "none" / "part.nc")
    assert caught.value.code is ErrorCode.FILE_NOT_WRITABLE


def test_every_ending_has_a_format() -> None:
    assert set(FORMATS.values()) | FOR_ROBOTS == {"plan", "csv", "stl", *post_names()}


def test_damaged_plan_files(made: Plan, tmp_path: Path) -> None:
    whole = save_plan(made, tmp_path / "plan.npz").read_bytes()
    damaged = {
        "cut": whole[: len(whole) // 2],
        "empty": b"",
        "text": b"not an archive",
        "flipped": whole[:3000] + bytes(255 - b for b in whole[3000:3400]) + whole[3400:],
    }
    for name, data in damaged.items():
        (tmp_path / name).write_bytes(data)
        with pytest.raises(IsfError) as caught:
            load_plan(tmp_path / name)
        assert caught.value.code is ErrorCode.PLAN_FILE_UNREADABLE
    with pytest.raises(IsfError) as caught:
        load_plan(tmp_path / "missing")
    assert caught.value.code is ErrorCode.FILE_NOT_FOUND
    np.savez(tmp_path / "newer.npz", head=np.array(json.dumps({"format": "isf plan", "version": 99})))
    with pytest.raises(IsfError, match="version 99"):
        load_plan(tmp_path / "newer.npz")


def test_program_of_another_format_is_refused(made: Plan, tmp_path: Path) -> None:
    files = export(made, tmp_path / "part.mod")
    with pytest.raises(IsfError) as caught:
        read_programs(files, load_post("pmac"))
    assert caught.value.code is ErrorCode.EXPORT_UNREADABLE


def test_pattern_reads_what_the_template_writes() -> None:
    template = "LIN {{X {x1:.4f},Y {y1:.4f},Z {z1:.4f}}}"
    match = pattern(template).fullmatch(template.format(x1=-0.5, y1=1e-9, z1=12345.6789))
    assert match is not None
    assert match.groupdict() == {"x1": "-0.5000", "y1": "0.0000", "z1": "12345.6789"}
