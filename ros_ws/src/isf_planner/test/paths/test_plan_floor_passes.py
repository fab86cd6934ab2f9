"""Passes over the floor: rings one step apart at the level of the floor, only where it is flat and empty.

Where the floor has a neck, part by part, and never through the wall.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import shapely
from isf_core.contour import Contour, over_floor, with_floor_passes
from isf_core.errors import IsfError
from isf_core.files.job import JobFile
from isf_core.types import Array
from isf_planner import plan
from isf_planner.exports import load_plan, programs, save_plan
from isf_planner.part.meshes import Mesh
from isf_planner.part_library import catalogue
from isf_planner.part_library.part_mesh import part_mesh
from isf_planner.surface import tip_surface
from isf_planner.surface.target_surface import fine_surface
from planner_parts import NO_PASSES, Cone, grid_mesh, job_for, revolve, write

STEP = 3e-3


def with_floor(job_file: JobFile, options: str) -> JobFile:
    """The job with ``options`` of its path; empty: what it does by itself."""
    text = job_file.text.replace(NO_PASSES, "")
    return JobFile(text.replace("path: {", f"path: {{{options}, ", 1) if options else text, job_file.base)


def radii(contours: tuple[Contour, ...]) -> list[float]:
    return [float(np.hypot(*contour.forming_tip[:, :2].T).mean()) for contour in contours]


@pytest.mark.parametrize("shape", ["cone", "l"])
def test_a_flat_tip_passes_where_its_flat_fits(shape: str, tmp_path: Path) -> None:
    """Rings narrower than the flat, 3 mm to each side here, are left out: the flat has been there."""
    mesh = part_mesh(catalogue.l_shape()) if shape == "l" else Cone().mesh()
    job_file = job_for(write(mesh, tmp_path / "part.ply"), process="SPIF", depth="1 mm")
    text = job_file.text.replace("tool_1: {radius: 5 mm}", "tool_1: {radius: 8 mm, corner_radius: 5 mm}")
    assert text != job_file.text
    made = plan(with_floor(JobFile(text, job_file.base), "floor_step: 2 mm"))
    rings = [one for before, one in pairwise(made.contours) if over_floor(one, before)]
    assert len(rings) > 1
    for ring in rings:
        outside = shapely.Polygon(ring.contact[:, :2]).buffer(20e-6)
        assert outside.covers(shapely.LinearRing(ring.forming_tip[:, :2]).buffer(2.9e-3))


def test_ramps_take_no_pass_away(tmp_path: Path) -> None:
    """The last contour of the wall has the ramp down to it: its mean height is not that of the floor."""
    job_file = job_for(write(Cone().mesh(), tmp_path / "cone.ply"), process="SPIF", depth="0.5 mm")
    steps, ramps = (
        plan(with_floor(job_file, f"floor_step: 3 mm{transition}"))
        for transition in ("", ", transition: ramp, ramp_length: 10 mm")
    )
    passes = [sum(over_floor(one, before) for before, one in pairwise(made.contours)) for made in (steps, ramps)]
    assert min(passes) > 1
    assert not [warning for warning in ramps.warnings if "floor_step" in warning]


@pytest.mark.parametrize("process", ["SPIF", "DSIF"])
def test_the_floor_is_passed_over_in_rings_inwards_and_outwards(process: str, tmp_path: Path) -> None:
    job_file = job_for(write(Cone().mesh(), tmp_path / "cone.ply"), process=process, depth="1 mm")
    wall = plan(job_file).contours
    whole = plan(with_floor(job_file, "floor_step: 3 mm, floor_rounds: 3")).contours
    for before, after in zip(wall, whole, strict=False):
        assert np.array_equal(before.forming_tip, after.forming_tip)
    assert [(contour.index, contour.count) for contour in whole] == [(k, len(whole)) for k in range(len(whole))]
    assert not any("floor_step" in text for text in plan(with_floor(job_file, "floor_step: 3 mm")).warnings)
    passes = whole[len(wall) :]
    last = radii(wall)[-1]
    inwards = [last - number * STEP for number in range(1, len(passes) // 3 + 1)]
    assert radii(passes) == pytest.approx([*inwards, *inwards[::-1], *inwards], abs=30e-6)
    assert 0.5 * STEP <= inwards[-1] < 1.5 * STEP
    for contour in passes:
        assert contour.forming_tip[:, 2] == pytest.approx(wall[-1].forming_tip[:, 2].mean(), abs=1e-6)
        assert contour.wall_angle == pytest.approx(0.0)
        assert contour.contact == pytest.approx(contour.forming_tip)
        assert contour.has_support == (process == "DSIF")
        if contour.has_support:  # the lower tool is under the pass, one thickness away
            assert contour.support_tip == pytest.approx(contour.forming_tip - [0.0, 0.0, 1e-3], abs=1e-9)


def test_nothing_is_planned_on_a_dome(tmp_path: Path) -> None:
    angle = np.radians(np.linspace(40.0, 2.0, 39))
    cap = np.column_stack([40e-3 * np.sin(angle), 40e-3 * (np.cos(angle[0]) - np.cos(angle))])
    mesh = revolve(np.vstack([[cap[0, 0] + 6e-3, 0.0], cap]), 200)
    job_file = job_for(write(mesh, tmp_path / "cap.ply"), process="SPIF")
    asked = plan(with_floor(job_file, "floor_step: 1 mm"))
    assert len(asked.contours) == len(plan(job_file).contours)
    assert any("path.floor_step 1 mm: no floor is passed over" in text for text in asked.warnings)


def test_a_floor_that_holds_an_island_is_left_alone(tmp_path: Path) -> None:
    cone, x = Cone(opening=45e-3), np.linspace(-60e-3, 60e-3, 241)
    far = np.hypot(*np.meshgrid(x, x))
    pocket = np.interp(far, *cone.profile(5e-6)[::-1].T)
    island = -cone.depth + np.clip((16e-3 - far), 0.0, 6e-3)
    job_file = job_for(write(grid_mesh(x, x, np.maximum(pocket, island)), tmp_path / "island.ply"), process="SPIF")
    contours = plan(job_file).contours
    assert len({contour.feature for contour in contours}) == 2
    assert len(plan(with_floor(job_file, "floor_step: 3 mm")).contours) == len(contours)


def test_rounds_without_a_step_and_a_process_without_floors_are_refused(tmp_path: Path) -> None:
    job_file = job_for(write(Cone().mesh(), tmp_path / "cone.ply"))
    for options in ("floor_rounds: 3", "floor_step: none, floor_rounds: 3"):
        with pytest.raises(IsfError, match="floor_rounds has no effect without floor_step"):
            plan(with_floor(job_file, options))


@pytest.mark.parametrize(
    ("process", "more", "step"),
    [
        ("SPIF", "", 2e-3),
        ("SPIF", "springback: {method: fused}", 2e-3),
        ("SPIF", "springback: {method: none}", None),
        ("DSIF", "", None),
    ],
)
def test_one_tool_passes_over_the_floor_of_a_part_that_is_corrected(
    process: str, more: str, step: float | None, tmp_path: Path
) -> None:
    """Of a ball of 5 mm; uncorrected, and with a second tool, the plan is that of the walls."""
    job_file = job_for(write(Cone().mesh(), tmp_path / "cone.ply"), process=process, depth="1 mm")
    wall = plan(job_file).contours
    assert not any(contour.floor_passes for contour in wall)
    by_itself = with_floor(job_file, "")
    whole = plan(JobFile(f"{by_itself.text}\n{more}", by_itself.base)).contours
    if step is None:
        assert len(whole) == len(wall)
        assert not any(contour.floor_passes for contour in whole)
        return
    assert radii(whole[len(wall) : len(wall) + 2]) == pytest.approx(
        [radii(wall)[-1] - step, radii(wall)[-1] - 2.0 * step], abs=30e-6
    )
    assert all(contour.floor_passes for contour in whole)


def test_rings_by_themselves_follow_the_radius_of_a_flat_tip_not_of_its_edge(tmp_path: Path) -> None:
    job_file = job_for(write(Cone().mesh(), tmp_path / "cone.ply"), process="SPIF", depth="1 mm")
    text = with_floor(job_file, "").text.replace("{radius: 5 mm}", "{radius: 5 mm, corner_radius: 2 mm}")
    whole = plan(JobFile(text, job_file.base)).contours
    rings = [contour for before, contour in pairwise(whole) if over_floor(contour, before)]
    assert len(rings) > 2
    assert radii(tuple(rings[:2]))[0] - radii(tuple(rings[:2]))[1] == pytest.approx(2e-3, abs=30e-6)


def test_what_is_passed_over_comes_back_from_a_plan_file_and_is_told_of_one_that_does_not_say_it(
    tmp_path: Path,
) -> None:
    job_file = job_for(write(Cone().mesh(), tmp_path / "cone.ply"), process="SPIF", depth="2 mm")
    made = plan(with_floor(job_file, ""))
    assert all(contour.floor_passes for contour in load_plan(save_plan(made, tmp_path / "plan.npz")).contours)
    silent = [replace(contour, floor_passes=False) for contour in made.contours]
    assert all(contour.floor_passes for contour in with_floor_passes(silent))


def test_preforms_have_passes_where_the_job_says_so_alone(tmp_path: Path) -> None:
    job_file = job_for(write(Cone().mesh(), tmp_path / "cone.ply"), process="SPIF", depth="1 mm")
    stages = "stages: [30 deg]"
    by_itself, asked = (plan(with_floor(job_file, f"{stages}{step}")).contours for step in ("", ", floor_step: 2 mm"))
    assert {contour.stage for contour in by_itself if contour.floor_passes} == {1}
    assert {contour.stage for contour in asked if contour.floor_passes} == {0, 1}
    assert not plan(with_floor(job_file, f"{stages}, floor_step: none")).contours[-1].floor_passes


def test_a_pocket_without_a_flat_floor_has_no_passes_beside_one_that_has_them(tmp_path: Path) -> None:
    """Corrections go by what the plan passes over, floor by floor."""
    x, y = np.linspace(-70e-3, 70e-3, 281), np.linspace(-40e-3, 40e-3, 161)
    gx, gy = np.meshgrid(x, y)
    flat = np.clip(np.hypot(gx + 35e-3, gy) - 25e-3, -8e-3, 0.0)
    bowl = np.minimum(np.hypot(gx - 35e-3, gy) ** 2 / 60e-3 - 9e-3, 0.0)
    job_file = job_for(write(grid_mesh(x, y, flat + bowl), tmp_path / "two.ply"), process="SPIF", depth="1 mm")
    contours = plan(with_floor(job_file, "")).contours
    passed = {contour.feature: contour.floor_passes for contour in contours}
    assert sorted(passed.values()) == [False, True]
    assert all(contour.floor_passes == passed[contour.feature] for contour in contours)
    assert any(over_floor(one, before) for before, one in pairwise(contours))


def u_pocket(depth: float = 6e-3) -> Mesh:
    """Walls of 45 deg; the bridge between the arms is narrower than they are, so that rings split there."""
    outline = shapely.box(-60e-3, -50e-3, 60e-3, 50e-3).difference(shapely.box(-15e-3, -22e-3, 15e-3, 60e-3))
    x, y = np.arange(-66e-3, 66.5e-3, 1e-3), np.arange(-56e-3, 56.5e-3, 1e-3)
    gx, gy = np.meshgrid(x, y)
    inside = shapely.contains_xy(outline, gx, gy)
    z = np.where(inside, shapely.distance(outline.exterior, shapely.points(gx, gy)), 0.0)
    return grid_mesh(x, y, -np.minimum(z, depth))


def links(contours: tuple[Contour, ...]) -> list[tuple[Contour, Array]]:
    """Every pass over a floor with the straight way (200, 3) m to it."""
    found = []
    for before, contour in pairwise(contours):
        end = before.forming_tip[0 if before.closed else -1]
        if over_floor(contour, before):
            found.append((contour, end + np.linspace(0.0, 1.0, 200)[:, None] * (contour.forming_tip[0] - end)))
    return found


@pytest.fixture(scope="module", params=["", "partial_paths: true, ", "stagger: 3 mm, "])
def necked(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[Contour, ...]:
    folder = tmp_path_factory.mktemp("necked")
    job_file = job_for(write(u_pocket(), folder / "u.ply"), process="SPIF", depth="1 mm", spacing="1 mm")
    return plan(with_floor(job_file, f"{request.param}floor_step: 2.5 mm, floor_rounds: 2")).contours


def test_no_pass_over_a_floor_with_a_neck_is_reached_through_the_wall(necked: tuple[Contour, ...]) -> None:
    surface = fine_surface(u_pocket(), 5e-3)
    found = links(necked)
    assert len(found) == 16
    for contour, way in found:
        height, _ = tip_surface.drop_tool(surface, np.ascontiguousarray(way[:, :2]), 5e-3)
        cuts = float((height - way[:, 2]).max()) > 20e-6
        assert contour.retract == cuts
    # into each arm and, outwards, back into the other one and to the rings around both
    assert sum(contour.retract for contour, _ in found) == 4


def test_one_arm_is_passed_over_after_the_other_and_its_rings_are_linked(necked: tuple[Contour, ...]) -> None:
    found = links(necked)
    sides = "".join("=" if abs(x) < 5e-3 else "<>"[int(x > 0)] for x in (c.forming_tip[:, 0].mean() for c, _ in found))
    assert sides in ("==<<<>>>>>><<<==", "==>>><<<<<<>>>==")
    ways = [float(np.linalg.norm(way[-1] - way[0])) for contour, way in found if not contour.retract]
    assert max(ways) < 8e-3  # one step, and what the start is moved on by


def test_a_program_lifts_the_tool_between_the_arms(tmp_path: Path) -> None:
    job_file = job_for(write(u_pocket(), tmp_path / "u.ply"), process="SPIF", depth="2 mm", spacing="1 mm")
    points = programs.path_points(plan(with_floor(job_file, "floor_step: 2.5 mm, floor_rounds: 1")).contours)
    apart = np.linalg.norm(np.diff(points.tool_1, axis=0), axis=1) > 40e-3
    assert apart.sum() == 2
    assert points.lift[1:][apart].all()


def test_a_floor_keeps_the_thickness_of_the_blank_with_the_overlap_method(tmp_path: Path) -> None:
    """It is pushed down as it is; the wall beside it gets thinner."""
    job_file = job_for(write(Cone().mesh(), tmp_path / "cone.ply"), depth="1 mm")
    made = plan(with_floor(job_file, "thickness: overlap, floor_step: 3 mm, floor_rounds: 1")).contours
    passes = [one for before, one in pairwise(made) if over_floor(one, before)]
    assert len(passes) > 1
    assert min(contour.thickness.mean() for contour in made) < 0.78e-3
    for contour in passes:
        assert contour.thickness == pytest.approx(1e-3, abs=1e-9)
        assert contour.support_tip == pytest.approx(contour.forming_tip - [0.0, 0.0, 1e-3], abs=1e-9)
