"""Finishing passes: the part's own contours once more, after all that was formed before; and what asks for them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile
from isf_planner import plan, replan
from isf_planner.exports import load_plan, save_plan
from isf_planner.part_library import PARTS, part_mesh
from isf_planner.part_library.catalogue import ribbed_pyramid
from planner_parts import job_for, write

MESH = part_mesh(PARTS["cone"](radius=24e-3, angle=np.radians(60), depth=9e-3), 20e-6)


def with_path(job_file: JobFile, fields: str) -> JobFile:
    """``job_file`` with more fields of its path."""
    return JobFile(job_file.text.replace("incremental_depth", f"{fields}, incremental_depth", 1), job_file.base)


@pytest.fixture(name="job_file")
def _job_file(tmp_path: Path) -> JobFile:
    return job_for(write(MESH, tmp_path / "cone.ply"), depth="1 mm", force="0 N", limit="80 deg")


@pytest.mark.parametrize("before", ["", "stages: [45 deg], "])
def test_the_last_stage_is_repeated_point_for_point(before: str, job_file: JobFile) -> None:
    once = plan(with_path(job_file, f"{before}floor_step: 2 mm")).contours
    whole = plan(with_path(job_file, f"{before}floor_step: 2 mm, finishing_passes: 2"))
    made = whole.contours
    assert len(whole.stages) == made[-1].stage + 1
    assert [stage.fold_over.ratio for stage in whole.stages[-2:] if stage.fold_over] == [0.0, 0.0]
    part = [contour for contour in once if contour.stage == once[-1].stage]
    assert len(made) == len(once) + 2 * len(part)
    assert [contour.index for contour in made] == list(range(len(made)))
    assert {contour.count for contour in made} == {len(made)}
    for number in (1, 2):
        again = [contour for contour in made if contour.stage == once[-1].stage + number]
        assert [contour.retract for contour in again] == [True, *(contour.retract for contour in part[1:])]
        for mine, other in zip(again, part, strict=True):
            np.testing.assert_array_equal(mine.forming_tip, other.forming_tip)
            np.testing.assert_array_equal(mine.support_tip, other.support_tip)
            assert mine.closed == other.closed


def test_the_shapes_before_the_part_stand_on_its_grid(job_file: JobFile, tmp_path: Path) -> None:
    made = plan(with_path(job_file, "stages: [45 deg], finishing_passes: 1"))
    (preform,) = made.preforms
    np.testing.assert_array_equal(preform.x, made.target.x)
    np.testing.assert_array_equal(preform.y, made.target.y)
    above = preform.z - made.target.z
    assert above.min() > -0.1e-3
    assert above.max() == pytest.approx(1.5e-3, abs=0.1e-3)  # inside the wall of 60 deg, between two fillets
    assert preform.z.min() == pytest.approx(-9e-3, abs=0.05e-3)
    assert np.degrees(np.arctan(np.hypot(*preform.gradient()))).max() == pytest.approx(45.0, abs=1.0)
    (again,) = load_plan(save_plan(made, tmp_path / "plan.npz")).preforms
    np.testing.assert_array_equal(again.z, preform.z)
    assert plan(with_path(job_file, "finishing_passes: 1")).preforms == ()


def test_a_changed_number_of_passes_is_planned_anew(job_file: JobFile) -> None:
    two = with_path(job_file, "finishing_passes: 1")
    alone, both = plan(job_file), plan(two)
    assert len(both.contours) == 2 * len(alone.contours)
    assert len(replan(alone, two).contours) == len(both.contours)
    assert len(replan(both, job_file).contours) == len(alone.contours)


@pytest.mark.parametrize(("number", "told"), [("-1", "greater than or equal to 0"), ("6", "less than or equal to 5")])
def test_a_number_that_cannot_be_is_refused(number: str, told: str, job_file: JobFile) -> None:
    with pytest.raises(IsfError) as caught:
        with_path(job_file, f"finishing_passes: {number}")
    assert caught.value.code is ErrorCode.FILE_FIELD
    assert "path.finishing_passes" in str(caught.value)
    assert told in str(caught.value)


def test_islands_formed_from_below_refuse_them(job_file: JobFile) -> None:
    with pytest.raises(IsfError, match="finishing_passes needs islands around"):
        with_path(job_file, "finishing_passes: 1, islands: swap")


def test_a_process_that_forms_in_one_pass_refuses_them() -> None:
    jobs = Path(__file__).resolve().parents[5] / "examples" / "jobs"
    for name in ("tpif_cone", "adsif_cone"):
        text = (jobs / f"{name}.yaml").read_text(encoding="utf-8")
        with pytest.raises(IsfError, match="finishing_passes needs process SPIF or DSIF") as caught:
            JobFile(text.replace("path:\n", "path:\n  finishing_passes: 1\n"), jobs)
        assert caught.value.code is ErrorCode.FILE_FIELD


@pytest.mark.parametrize(
    ("lower", "fields", "told"),
    [
        (25.0, "", True),
        (25.0, "partial_paths: true", True),
        (50.0, "", False),
        (25.0, "finishing_passes: 1", False),
    ],
)
def test_a_shallow_wall_below_a_steep_one_is_warned_of(lower: float, fields: str, told: bool, tmp_path: Path) -> None:
    radii = {"rib": 6e-3, "entry": 3e-3, "transition": 6e-3, "floor": 5e-3}
    slopes = {"upper_angle": np.radians(60.0), "upper_depth": 18e-3, "lower_angle": np.radians(lower)}
    mesh = part_mesh(ribbed_pyramid(50e-3, **slopes, lower_depth=12e-3, **radii), 20e-6)
    job_file = job_for(write(mesh, tmp_path / "part.ply"), depth="1 mm", process="SPIF")
    texts = [text for text in plan(with_path(job_file, fields) if fields else job_file).warnings if "tent" in text]
    assert len(texts) == told
    for text in texts:
        assert text.startswith("a wall of 25 deg is formed below one of 60 deg, from 1")
        assert "path.finishing_passes: 1" in text
