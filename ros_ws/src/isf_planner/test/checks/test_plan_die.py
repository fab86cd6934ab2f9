"""Over a die: levels by spacing, place on the blank, and dies that stand where they must not."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile, load_job
from isf_planner import Plan, plan
from isf_planner.checks import die_checks
from isf_planner.part.meshes import Mesh
from isf_planner.predict.predictions import step_depths
from planner_parts import EXAMPLES, grid_mesh, write

JOB = load_job(EXAMPLES / "jobs" / "tpif_cone.yaml")
DIE = EXAMPLES / "parts" / "tpif_cone_die.stl"


def changed(folder: Path, *, path: str = "", place: str = "", move: tuple[float, ...] = (0.0, 0.0, 0.0)) -> JobFile:
    """The example with more of the path and part sections, and a die moved by ``move`` mm."""
    trimesh.load_mesh(DIE, process=False).apply_translation(move).export(folder / "die.stl")
    text = JOB.text.replace("../parts/tpif_cone.stl", str(EXAMPLES / "parts" / "tpif_cone.stl"))
    text = text.replace("../parts/tpif_cone_die.stl", "die.stl").replace("  feed:", f"{path}  feed:")
    return JobFile(text.replace("  unit: mm\nprocess", f"  unit: mm\n{place}process"), folder)


@pytest.fixture(scope="module")
def made() -> Plan:
    return plan(JOB)


def test_levels_follow_the_spacing(tmp_path: Path) -> None:
    """On the straight wall of 40 deg contours 0.8 mm apart along the wall are 0.8 sin 40 deg deep."""
    options = "  spacing: arc\n  arc_step: 0.8 mm\n  largest_step: 1 mm\n"
    contours = plan(changed(tmp_path, path=options)).contours
    holders = np.array([contour.holder_height for contour in contours])
    assert holders[-1] == pytest.approx(-6e-3, abs=1e-9)
    wall = [abs(np.degrees(np.median(contour.wall_angle)) - 40.0) < 0.3 for contour in contours]
    steps = -np.diff(holders)[np.array(wall[1:]) & np.array(wall[:-1])]
    assert len(steps) > 3
    wanted = 0.8e-3 * np.sin(np.radians(40.0))
    # all are shortened alike so that the last one ends at the full height, by less than one part in their number
    assert steps.max() < 1.02 * wanted
    assert steps.min() > (0.98 - 1.0 / len(contours)) * wanted


def test_part_and_die_stand_where_the_part_is_placed(made: Plan, tmp_path: Path) -> None:
    moved = plan(changed(tmp_path, place="  place: [7 mm, -4 mm]\n", move=(7.0, -4.0, 0.0)))
    for one, other in zip(made.contours, moved.contours, strict=True):
        np.testing.assert_allclose(other.forming_tip.mean(axis=0)[:2], [7e-3, -4e-3], atol=0.1e-3)
        assert other.holder_height == one.holder_height


@pytest.mark.parametrize("unit", ["m", "in"])
def test_a_die_in_another_unit_is_refused_before_it_is_sampled(unit: str) -> None:
    """Points 0.7 mm apart on a die of 100 m would fill the memory."""
    part, die, rest = JOB.text.partition("die:")
    with pytest.raises(IsfError) as caught:
        plan(JobFile(part + die + rest.replace("unit: mm", f"unit: {unit}", 1), JOB.base))
    assert caught.value.code is ErrorCode.MESH_UNIT_SUSPECT
    assert caught.value.where == "die.mesh"
    assert "die.unit" in caught.value.advice


@pytest.mark.parametrize("move", [(1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, 1.0), (0.0, 0.0, -1.0)])
def test_a_die_one_millimetre_off_is_refused(move: tuple[float, ...], tmp_path: Path) -> None:
    with pytest.raises(IsfError) as caught:
        plan(changed(tmp_path, move=move))
    assert caught.value.code is ErrorCode.DIE_COLLISION
    assert "die at x" in caught.value.where
    assert caught.value.advice


@pytest.mark.parametrize("move", [(1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, 1.0)])
def test_no_room_between_tool_and_die(move: tuple[float, ...], made: Plan) -> None:
    """The second check alone, on the planned contours: the sheet would be squeezed between tool and die."""
    points = die_checks.load_die(JOB)
    assert made.base is not None
    surface = made.base.sides[0].surface
    die_checks.check_tool(made.contours, JOB.job, points, surface)
    with pytest.raises(IsfError) as caught:
        die_checks.check_tool(made.contours, JOB.job, points + 1e-3 * np.array(move), surface)
    assert caught.value.code is ErrorCode.DIE_COLLISION
    assert caught.value.where.startswith("contour ")
    assert "x = " in caught.value.where
    if move[0]:  # on the side that the die has come closer to
        assert float(caught.value.where.split("x = ")[1].split(",")[0]) > 0


def test_the_holder_counts_as_depth_of_a_step(made: Plan) -> None:
    """Predicted forces take the step from contour to contour, which over a die is the holder's."""
    coarse = [replace(contour, holder_height=2.0 * contour.holder_height) for contour in made.contours]
    np.testing.assert_allclose(step_depths(coarse, 9.0)[1:], 1e-3, atol=1e-9)


def test_a_notch_in_the_outline_is_flange_and_no_block(tmp_path: Path) -> None:
    """Beside the mesh there is the blank at the level of the flange, also where the outline runs in."""
    x = np.arange(-40e-3, 40.5e-3, 1e-3)
    gx, gy = np.meshgrid(x, x)
    whole = grid_mesh(x, x, np.clip(20e-3 - np.hypot(gx, gy), 0.0, 6e-3))
    middle = whole.corners().mean(axis=1)
    notch = (middle[:, 0] > 31e-3) & (np.abs(middle[:, 1]) < 8e-3)
    write(whole, tmp_path / "whole.ply")
    write(Mesh(whole.vertices, whole.faces[~notch]), tmp_path / "notched.ply")
    top = np.hypot(*middle[:, :2].T) < 15.5e-3  # a partial die: where the part has a sharp edge the sheet has none
    write(Mesh(whole.vertices - [0.0, 0.0, 7e-3], whole.faces[top]), tmp_path / "die.stl")
    plans = []
    for name in ("whole", "notched"):
        text = JOB.text.replace("../parts/tpif_cone.stl", f"{name}.ply")
        text = text.replace("../parts/tpif_cone_die.stl", "die.stl").replace(
            "incremental_depth: 0.5", "incremental_depth: 2"
        )
        plans.append(plan(JobFile(text, tmp_path)))
    assert len(plans[0].contours) == 3
    for one, other in zip(plans[0].contours, plans[1].contours, strict=True):
        np.testing.assert_allclose(other.forming_tip, one.forming_tip, atol=1e-9)


def test_a_part_is_told_to_be_moved_as_it_was(tmp_path: Path) -> None:
    """It is turned over for the checks: what was moved down was told to be moved up."""
    mesh = trimesh.load_mesh(EXAMPLES / "parts" / "tpif_cone.stl", process=False)
    mesh.apply_translation((3.0, -2.0, 7.0))
    mesh.export(tmp_path / "moved.stl")
    text = changed(tmp_path).text.replace(str(EXAMPLES / "parts" / "tpif_cone.stl"), "moved.stl")
    moved = [warning for warning in plan(JobFile(text, tmp_path)).warnings if "was moved" in warning]
    assert len(moved) == 1
    assert moved[0].startswith("the part was moved by (-3.000, 2.000, -7.000) mm")


FOOT = 6e-3
"""m, radius of the tool and of the fillet at the foot of the frustum."""


def frustum(folder: Path) -> JobFile:
    """A round frustum 8 mm high with walls of 42 deg, its foot rounded by the tool's radius, and a die that is exactly
    its lower face: the upper one less 1 mm."""
    wall, top, height = np.radians(42.0), 8e-3, 8e-3
    bend = np.linspace(0.0, wall, 30)
    run = (height - (top + FOOT) * (1.0 - np.cos(wall))) / np.tan(wall)
    far = 20e-3 + (top + FOOT) * np.sin(wall) + run
    radius = np.concatenate([20e-3 + top * np.sin(bend), far - FOOT * np.sin(bend[::-1])])
    z = np.concatenate([height - top * (1.0 - np.cos(bend)), FOOT * (1.0 - np.cos(bend[::-1]))])
    side = np.arange(-50e-3, 50.1e-3, 0.5e-3)
    gx, gy = np.meshgrid(side, side)
    part = grid_mesh(side, side, np.interp(np.hypot(gx, gy), radius, z))
    write(part, folder / "part.ply")
    write(part.moved(np.array([0.0, 0.0, -height - 1e-3])), folder / "die.stl")
    text = JOB.text.replace("../parts/tpif_cone.stl", "part.ply").replace("../parts/tpif_cone_die.stl", "die.stl")
    return JobFile(
        text.replace("radius: 5 mm", "radius: 6 mm").replace("incremental_depth: 0.5", "incremental_depth: 1"), folder
    )


def test_a_ball_that_meets_wall_and_flange_at_once(tmp_path: Path) -> None:
    """In a foot of its own radius the ball lies on wall and flange: 0.74 mm of sheet on the one, 1 mm on the other."""
    job_file = frustum(tmp_path)
    made = plan(job_file)
    assert made.largest_wall_angle == pytest.approx(np.radians(42.0), abs=np.radians(1.5))
    assert made.base is not None
    surface, points = made.base.sides[0].surface, die_checks.load_die(job_file)
    die_checks.check_tool(made.contours, job_file.job, points, surface)

    def refused(die: np.ndarray) -> str:
        with pytest.raises(IsfError) as caught:
            die_checks.check_tool(made.contours, job_file.job, die, surface)
        assert caught.value.code is ErrorCode.DIE_COLLISION
        return caught.value.what

    far = np.hypot(*points[:, :2].T)
    flange, wall = far > 34.0e-3, (far > 26e-3) & (far < 29e-3)
    # 0.2 mm too high under the flange, where 0.9 mm of the blank have to be left
    assert "0.80 mm are left between tool and die for a sheet of 1.00 mm" in refused(
        points + np.outer(flange, [0, 0, 0.2e-3])
    )
    # and under the wall, where 0.67 mm of 0.74 mm have to be
    assert "for a sheet of 0.7" in refused(points + np.outer(wall, [0, 0, 0.25e-3]))
