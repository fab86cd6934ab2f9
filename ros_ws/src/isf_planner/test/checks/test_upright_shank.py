"""Shank and holder of an upright tool against walls, clamp and what stands up: refused where all sizes are told."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile
from isf_planner import Plan, plan, replan
from planner_parts import EXAMPLES, Cone, job_for, write

RIG = Path(__file__).resolve().parents[3] / "isf_core" / "rigs" / "ren2018.yaml"
STEEP = Cone(angle=np.radians(75.0), depth=14e-3)
HOLDER = "holder: [{length: 50 mm, radius: 20 mm}]"


def job(folder: Path, tool: str, *, dome: bool = False, cone: Cone = STEEP) -> JobFile:
    """The cone with the forming tool's ``tool`` besides its radius of 5 mm; a ``dome`` is formed by the lower one."""
    mesh = cone.mesh(50e-6)
    write(mesh.with_vertices(mesh.vertices * [1.0, 1.0, -1.0 if dome else 1.0]), folder / "cone.ply")
    made = job_for(folder / "cone.ply", process="DSIF" if dome else "SPIF", depth="2 mm")
    name = "tool_2" if dome else "tool_1"
    return JobFile(made.text.replace(f"{name}: {{radius: 5 mm", f"{name}: {{radius: 5 mm{tool}"), folder)


def of_holder(made: Plan) -> list[str]:
    return [text for text in made.warnings if "holder" in text or "shank" in text]


@pytest.mark.parametrize("dome", [False, True])
@pytest.mark.parametrize("more", ["", f", stick_out: 60 mm, {HOLDER}"])
def test_a_shank_wider_than_the_tip_is_warned_of_at_a_steep_wall(more: str, dome: bool, tmp_path: Path) -> None:
    """It may have a neck above the ball, which no field tells of."""
    (told,) = of_holder(plan(job(tmp_path, f", shank_radius: 8 mm{more}", dome=dome)))
    assert f"the shank of the upright tool_{2 if dome else 1} would run" in told
    assert "into the sheet" in told
    assert re.search(r"contour \d+ with the tip at", told)
    assert told.endswith("if the shank is that wide down to the ball")
    # by hand: the wall is 5 / sin 75 = 5.18 mm aside of the ball's centre, and further out by 0.27 h at a height h
    deep = float(re.search(r"run ([0-9.]+) mm", told)[1])  # type: ignore[index]
    assert 1.5 < deep < 2.3
    place = [float(value) for value in re.findall(r"= (-?[0-9.]+)", told)][:3]
    assert np.hypot(*place[:2]) == pytest.approx(28.0, abs=4.0)
    assert place[2] * (1.0 if dome else -1.0) > 0.0


@pytest.mark.parametrize("dome", [False, True])
@pytest.mark.parametrize("tool", ["", ", shank_radius: 5 mm", ", shank_radius: 3 mm, stick_out: 60 mm"])
def test_a_shank_no_wider_than_the_tip_meets_nothing(dome: bool, tool: str, tmp_path: Path) -> None:
    assert of_holder(plan(job(tmp_path, tool, dome=dome))) == []


def test_a_wide_shank_clears_a_flat_wall(tmp_path: Path) -> None:
    """At 30 deg the wall is 10 mm aside of the ball's centre."""
    assert of_holder(plan(job(tmp_path, ", shank_radius: 8 mm", cone=Cone(angle=np.radians(30.0))))) == []


def test_a_holder_that_comes_down_to_the_flange(tmp_path: Path) -> None:
    """14 mm deep with 12 mm of tool: 2 mm into the flange with a holder of 20 mm beside an opening of 30 mm."""
    with pytest.raises(IsfError) as caught:
        plan(job(tmp_path, f", stick_out: 12 mm, {HOLDER}"))
    assert caught.value.code is ErrorCode.SHANK_COLLISION
    assert "the holder of the upright tool_1 would run" in caught.value.what
    assert "stick_out" in caught.value.advice
    assert of_holder(plan(job(tmp_path, f", stick_out: 15 mm, {HOLDER}"))) == []


def test_a_holder_behind_a_shank_that_is_warned_of_is_refused(tmp_path: Path) -> None:
    """The wide shank runs in deeper: without it the holder does still."""
    with pytest.raises(IsfError) as caught:
        plan(job(tmp_path, f", shank_radius: 10 mm, stick_out: 12 mm, {HOLDER}"))
    assert caught.value.code is ErrorCode.SHANK_COLLISION
    assert "the holder of the upright tool_1 would run 2." in caught.value.what


def test_a_holder_that_is_assumed_is_warned_of(tmp_path: Path) -> None:
    (told,) = of_holder(plan(job(tmp_path, ", stick_out: 12 mm")))
    assert "the holder of the upright tool_1 would run 2." in told
    assert "if the holder is 60 mm long with a radius of 25 mm; that is assumed" in told
    assert "tool_1.holder" in told
    assert "stick_out" not in told


def test_a_length_that_is_assumed_is_warned_of(tmp_path: Path) -> None:
    """With the 70 mm of a tool whose job does not tell, a part that deep is needed."""
    deep = Cone(angle=np.radians(75.0), depth=75e-3, opening=60e-3)
    (told,) = of_holder(plan(job(tmp_path, ", holder: [{length: 50 mm, radius: 40 mm}]", cone=deep)))
    assert "the holder of the upright tool_1 would run 5." in told
    assert "if the holder begins 70 mm above the tip; that is assumed" in told
    assert told.endswith("tool_1.stick_out")


def test_a_frame_of_the_clamp_whose_height_is_assumed_is_warned_of(tmp_path: Path) -> None:
    """The tip comes within 28 mm of the clamp, beside a holder of 35 mm that stays 2 mm above the sheet."""

    def made(height: str) -> Plan:
        size = "size: [110 mm, 110 mm]"
        (tmp_path / "rig.yaml").write_text(RIG.read_text().replace("size: [250 mm, 250 mm]", f"{size}{height}", 1))
        upright = job(tmp_path, ", stick_out: 16 mm, holder: [{length: 50 mm, radius: 35 mm}]")
        return plan(JobFile(upright.text.replace("rig: ren2018", "rig: rig.yaml"), tmp_path))

    (told,) = of_holder(made(""))
    assert "the holder of the upright tool_1 would run" in told
    assert "into the frame of the clamp" in told
    assert "if the frame of the clamp is 20 mm high; that is assumed" in told
    assert told.endswith("clamp.height of the rig")
    assert of_holder(made("\n  height: 1 mm")) == []
    with pytest.raises(IsfError) as caught:
        made("\n  height: 20 mm")
    assert caught.value.code is ErrorCode.SHANK_COLLISION
    assert "into the frame of the clamp" in caught.value.what


def test_a_boss_over_a_die_stands_beside_the_holder(tmp_path: Path) -> None:
    text = (EXAMPLES / "jobs" / "tpif_cone.yaml").read_text().replace("../parts", str(EXAMPLES / "parts"))
    short, long = (
        JobFile(text.replace("  radius: 5 mm", f"  radius: 5 mm\n  stick_out: {length} mm\n  {HOLDER}"), tmp_path)
        for length in (5.2, 6.5)
    )
    with pytest.raises(IsfError) as caught:
        plan(short)
    assert caught.value.code is ErrorCode.SHANK_COLLISION
    assert "holder of the upright tool_1 would run 0.8" in caught.value.what
    assert of_holder(plan(long)) == []


def test_another_tool_on_a_finished_plan_is_looked_at_too(tmp_path: Path) -> None:
    before = plan(job(tmp_path, ""))
    assert len(of_holder(replan(before, job(tmp_path, ", shank_radius: 8 mm")))) == 1
    with pytest.raises(IsfError) as caught:
        replan(before, job(tmp_path, f", stick_out: 12 mm, {HOLDER}"))
    assert caught.value.code is ErrorCode.SHANK_COLLISION
