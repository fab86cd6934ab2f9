"""Plans whose stages are morphed from the part: what a job asks for, and what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile
from isf_planner import plan
from isf_planner.part_library import PARTS, part_mesh
from planner_parts import job_for, write

STEEP = PARTS["cone"](radius=26e-3, angle=np.radians(70), depth=14e-3, entry=5e-3, floor=6e-3)
MORPH = "failure_angle: 66 deg, shapes: 2"


def morph_job(folder: Path, options: str, limit: str = "80 deg") -> JobFile:
    job_file = job_for(write(part_mesh(STEEP, 30e-6), folder / "cone.ply"), depth="2 mm", force="0 N", limit=limit)
    text = job_file.text.replace("incremental_depth", f"morph: {{{options}}}, incremental_depth", 1)
    return JobFile(text, job_file.base)


def test_shapes_get_deeper_and_steeper_and_the_last_stage_is_the_part(tmp_path: Path) -> None:
    found = plan(morph_job(tmp_path, MORPH))
    depths = [stage.depth for stage in found.stages]
    assert len(depths) == 3
    assert depths == sorted(depths)
    assert depths[-1] == pytest.approx(14e-3, abs=1e-6)
    assert np.degrees(found.stages[0].wall_angle) == pytest.approx(44.0, abs=3.0)  # two thirds of 66 deg
    assert np.degrees(found.stages[-1].wall_angle) == pytest.approx(70.0, abs=1.0)
    for stage in found.stages:
        here = stage.heights
        target = STEEP.height(here.points()[:, :2]).reshape(here.z.shape)
        assert (here.z >= target - 0.1e-3).all()  # between two nodes an edge is cut by as much
    stages = [contour.stage for contour in found.contours]
    assert sorted(set(stages)) == [0, 1, 2]
    assert stages == sorted(stages)
    for number, depth in enumerate(depths):
        tips = np.vstack([c.forming_tip for c in found.contours if c.stage == number])
        assert -tips[:, 2].min() == pytest.approx(depth, abs=0.15e-3)
    lifted = [contour.index for contour in found.contours if contour.retract]
    assert lifted == [stages.index(1), stages.index(2)]


def test_gap_is_reported_and_warned_of(tmp_path: Path) -> None:
    found = plan(morph_job(tmp_path, "failure_angle: 66 deg, shapes: 1"))
    worst = max(stage.fold_over.ratio for stage in found.stages[1:])
    assert worst > 1.0
    assert sum("the sheet may fold over at" in text for text in found.warnings) == 1


def test_limit_is_kept_or_the_plan_refused(tmp_path: Path) -> None:
    kept = plan(morph_job(tmp_path, "failure_angle: 66 deg, fold_over: enforce"))
    assert max(stage.fold_over.ratio for stage in kept.stages[1:]) <= 1.0
    with pytest.raises(IsfError) as caught:
        plan(morph_job(tmp_path, "failure_angle: 66 deg, shapes: 1, fold_over: enforce"))
    assert caught.value.code == ErrorCode.MORPH_NOT_REACHED
    assert "mm" in caught.value.where
    assert "allow more shapes" in caught.value.advice


def test_part_that_one_pass_forms_gets_no_shapes(tmp_path: Path) -> None:
    found = plan(morph_job(tmp_path, "failure_angle: 75 deg, first_angle: 72 deg"))
    assert found.stages == ()
    assert {contour.stage for contour in found.contours} == {0}
    assert any("no steeper than 72 deg" in text for text in found.warnings)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ("chi: 0.1", "chi has no effect"),
        ("shapes: 2, most_shapes: 3", "most_shapes has no effect"),
        ("shapes: 0", "greater than or equal to 1"),
    ],
)
def test_options_without_effect_are_refused(options: str, said: str, tmp_path: Path) -> None:
    with pytest.raises(IsfError, match=said):
        morph_job(tmp_path, options)


def test_angles_and_morph_exclude_each_other(tmp_path: Path) -> None:
    text = morph_job(tmp_path, MORPH).text.replace("morph:", "stages: [40 deg], morph:", 1)
    with pytest.raises(IsfError, match="use one of them"):
        JobFile(text, tmp_path)
