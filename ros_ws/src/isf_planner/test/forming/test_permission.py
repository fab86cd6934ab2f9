"""How steep a wall may be planned in one pass and from pass to pass, and what is advised where it is too steep."""

from __future__ import annotations

import re
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile
from isf_planner import plan
from isf_planner.forming import permission
from isf_planner.part.meshes import Mesh
from isf_planner.part_library import PARTS, part_mesh
from isf_planner.part_library.part import Feature, Part, RoundedSquare
from isf_planner.part_library.wall_profile import straight_wall
from planner_parts import Cone, job_for, write

EXAMPLES = Path(__file__).resolve().parents[5] / "examples" / "jobs"


def pyramid(degrees: float, depth: float = 14e-3) -> Mesh:
    wall = straight_wall(np.radians(degrees), depth, 4e-3, 6e-3)
    return part_mesh(Part("pyramid", (Feature(RoundedSquare(34e-3, 8e-3), wall),), 8e-3), 20e-6)


def cone(degrees: float, depth: float = 14e-3) -> Mesh:
    return part_mesh(PARTS["cone"](radius=28e-3, angle=np.radians(degrees), depth=depth, entry=4e-3, floor=6e-3), 20e-6)


def job(mesh: Mesh, folder: Path, options: str = "", limit: str | None = None) -> JobFile:
    """AA5754-O, which bears 66 deg in one pass, with ``options`` of its path and its own ``limit``."""
    made = job_for(write(mesh, folder / "part.ply"), process="SPIF", depth="3.5 mm", spacing="2 mm")
    text = made.text.replace("wall_angle_limit: 80 deg\n", f"wall_angle_limit: {limit}\n" if limit else "")
    if options:
        text = text.replace("incremental_depth", f"{options}, incremental_depth", 1)
    return JobFile(text, folder)


def refusal(job_file: JobFile) -> IsfError:
    with pytest.raises(IsfError) as caught:
        plan(job_file)
    return caught.value


def pasted(text: str) -> str:
    """The line that an advice gives, as it stands in the section path."""
    return re.findall(r"path\.(stages: \[[^]]*\])", text)[0]


@pytest.mark.parametrize(
    ("before", "single", "degrees"), [(None, 66.0, 66.0), (50.0, 66.0, 66.0), (60.0, 66.0, 67.0), (74.0, 70.0, 81.0)]
)
def test_a_later_pass_may_be_7_deg_steeper_or_as_steep_as_one_pass(
    before: float | None, single: float, degrees: float
) -> None:
    found = permission.largest(None if before is None else np.radians(before), np.radians(single))
    assert np.degrees(found) == pytest.approx(degrees)


@pytest.mark.parametrize(
    ("angles", "single", "refused"),
    [
        ([60, 67, 74, 80], 70.0, None),  # the published pyramid of four passes
        ([80], 76.0, 0),  # fails in one pass (published)
        ([50, 57, 64, 71, 78], 66.0, None),
        ([60, 68, 76], 70.0, 2),
        ([71, 76], 70.0, 0),
        ([20, 69.9], 70.0, None),
    ],
)
def test_the_first_step_that_is_too_large(angles: list[float], single: float, refused: int | None) -> None:
    assert permission.first_refused(np.radians(angles), np.radians(single)) == refused


@given(st.floats(20.0, 80.0), st.floats(0.05, 60.0))
def test_suggested_stages_keep_the_rule(single: float, beyond: float) -> None:
    angle = min(single + beyond, 89.5)
    stages = permission.suggested(np.radians(angle), np.radians(single))
    assert stages
    assert list(stages) == sorted(set(stages))
    steps = np.diff([*stages, angle])
    assert steps.min() > 0.0
    assert stages[0] <= single
    assert steps.max() <= 7.1
    assert permission.suggested(np.radians(single - 0.1), np.radians(single)) == ()


def test_suggested_are_the_published_stages() -> None:
    """80 deg in four passes from 60 deg on, 76 deg in three (Behera 2015, Table 1)."""
    assert permission.suggested(np.radians(80.0), np.radians(70.0)) == (60, 67, 74)
    assert len(permission.suggested(np.radians(76.0), np.radians(70.0))) == 2


@pytest.mark.parametrize("shape", [pyramid, cone])
def test_what_a_steep_part_is_advised_plans_when_it_is_pasted(shape: type, tmp_path: Path) -> None:
    mesh = shape(75.0)
    error = refusal(job(mesh, tmp_path))
    assert error.code is ErrorCode.WALL_TOO_STEEP
    assert "75.0 deg steep, 66.0 deg may be planned in one pass" in error.what
    assert error.where.startswith("mesh at x = ")
    options = pasted(error.advice)
    assert options == "stages: [57 deg, 63 deg, 69 deg]"
    staged = plan(job(mesh, tmp_path, options))
    assert len(staged.stages) == 4
    # what the user had to write before, is the same plan but for its name
    overruled = plan(job(mesh, tmp_path, options, "85 deg"))
    for one, other in zip(staged.contours, overruled.contours, strict=True):
        np.testing.assert_array_equal(one.forming_tip, other.forming_tip)
        np.testing.assert_array_equal(one.thickness, other.thickness)
    assert "path.morph: {}" in error.advice
    morphed = plan(job(mesh, tmp_path, "morph: {}"))
    assert len(morphed.stages) >= 3
    # a shape is known to a degree on its grid, and another on that of the plan
    angles = np.degrees([stage.wall_angle for stage in morphed.stages])
    assert angles[0] < 67.0
    assert all(after <= max(66.0, before + 7.0) + 2.0 for before, after in pairwise(angles))


def test_a_first_stage_steeper_than_one_pass_forms_is_refused(tmp_path: Path) -> None:
    mesh = cone(80.0)
    error = refusal(job(mesh, tmp_path, "stages: [75 deg]"))
    assert error.code is ErrorCode.WALL_TOO_STEEP
    assert error.what.startswith("stage 1 of 2, a shape before the part: the wall is 75.0 deg steep, 66.0 deg may be ")
    found = re.fullmatch(r"shape at x = (\S+), y = (\S+), z = (\S+) mm", error.where)
    assert found is not None
    x, y, z = (float(value) for value in found.groups())
    assert 15.0 < np.hypot(x, y) < 30.0
    assert -14.0 < z < 0.0
    assert len(plan(job(mesh, tmp_path, pasted(error.advice))).stages) == 4


def test_a_step_that_is_too_large_is_refused_with_its_stage(tmp_path: Path) -> None:
    error = refusal(job(pyramid(75.0), tmp_path, "stages: [60 deg]"))
    assert error.code is ErrorCode.WALL_TOO_STEEP
    assert error.what == "stage 2 of 2: the wall is 75.0 deg steep, 67.0 deg may be planned after walls of 60.0 deg"
    assert error.where.startswith("mesh at x = ")
    assert "stages: [57 deg, 63 deg, 69 deg]" in error.advice


def test_stages_that_are_left_out_do_not_count(tmp_path: Path) -> None:
    """A part of 70 deg with a stage of 75 is formed in one pass."""
    error = refusal(job(cone(70.0), tmp_path, "stages: [75 deg]"))
    assert "stage 1 of 1: the wall is 70.0 deg steep, 66.0 deg may be planned in one pass" in error.what


def test_a_morph_takes_more_shapes_or_is_refused(tmp_path: Path) -> None:
    mesh = cone(78.0, 20e-3)
    few = refusal(job(mesh, tmp_path, "morph: {shapes: 1}"))
    assert few.code is ErrorCode.WALL_TOO_STEEP
    assert few.what.startswith("stage 2 of 2: the wall is 78.0 deg steep, 66.0 deg may be planned after walls of ")
    assert few.advice.startswith("more shapes (path.morph.shapes, or leave it out)")
    most = refusal(job(mesh, tmp_path, "morph: {most_shapes: 1}"))
    assert most.code is ErrorCode.MORPH_NOT_REACHED
    assert "with 1 shapes before the part walls get steeper from 66 deg" in most.what
    assert most.where.startswith("shape at x = ")
    assert "path.morph.most_shapes" in most.advice


def test_a_limit_of_the_job_overrules_and_is_told(tmp_path: Path) -> None:
    staged = plan(job(cone(75.0), tmp_path, "stages: [60 deg]", "80 deg"))
    (text,) = [one for one in staged.warnings if "overrules" in one]
    assert text.startswith("stage 2 of 2: the wall is 75.0 deg steep, 67.0 deg may be planned after walls of 60.0 deg")
    assert " at x = " in text
    (text,) = [one for one in plan(job(cone(70.0), tmp_path, "", "80 deg")).warnings if "permits" in one]
    assert "70.0 deg steep, which wall_angle_limit permits: AA5754-O bears 66.0 deg in one pass" in text
    error = refusal(job(cone(75.0), tmp_path, "stages: [60 deg, 67 deg]", "70 deg"))
    assert error.code is ErrorCode.WALL_TOO_STEEP
    assert "leave wall_angle_limit out" in error.advice


def test_stages_are_not_advised_where_they_cannot_be(tmp_path: Path) -> None:
    """What the lower tool forms, and what is formed over a die, has one stage."""
    dome = Cone(angle=np.radians(70.0)).mesh(20e-6)
    turned = Mesh(dome.vertices * np.array([1.0, 1.0, -1.0]), dome.faces)
    made = job_for(write(turned, tmp_path / "dome.ply"), depth="2 mm")
    below = refusal(JobFile(made.text.replace("wall_angle_limit: 80 deg\n", ""), tmp_path))
    text = (EXAMPLES / "tpif_cone.yaml").read_text(encoding="utf-8")
    text = text.replace("../parts", str(EXAMPLES.parent / "parts"))
    over_die = refusal(JobFile(f"{text}\nwall_angle_limit: 20 deg\n", tmp_path))
    for error in (below, over_die):
        assert error.code is ErrorCode.WALL_TOO_STEEP
        assert "stages" not in error.advice
        assert "wall_angle_limit" in error.advice
