"""Another tool on the same contacts: the same as a new plan where the contacts are the same, refused where it cuts."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from ball_gap import tool_gap
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile
from isf_planner import Plan, plan, replan
from isf_planner.surface.target_surface import fine_surface
from isf_planner.surface.tip_surface import drop_tool
from planner_parts import Cone, job_for, write

CONE = Cone()


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Plan, JobFile]:
    job_file = job_for(write(CONE.mesh(), tmp_path_factory.mktemp("replan") / "cone.stl"))
    return plan(job_file), job_file


def changed(job_file: JobFile, old: str, new: str) -> JobFile:
    assert old in job_file.text
    return JobFile(job_file.text.replace(old, new), job_file.base)


def test_contacts_and_normals_stay_and_tips_follow(made: tuple[Plan, JobFile]) -> None:
    before, job_file = made
    after = replan(before, changed(job_file, "tool_1: {radius: 5 mm}", "tool_1: {radius: 6 mm}"))
    assert after.plan_id != before.plan_id
    assert after.warnings == before.warnings
    assert any(text.startswith("the sheet is free for") for text in after.warnings)
    for a, b in zip(before.contours, after.contours, strict=True):
        np.testing.assert_allclose(b.normal, a.normal, atol=1e-12)
        # where the ball was moved out of facets it cuts a little, its contact moves with it
        np.testing.assert_allclose(b.contact, a.contact, atol=20e-6)
        np.testing.assert_allclose(b.forming_tip - b.contact, 6e-3 * (b.normal - [0, 0, 1]), atol=1e-9)
        np.testing.assert_allclose(tool_gap(b.forming_tip, b.support_tip, 6e-3, 5e-3), b.thickness, atol=1e-9)


def test_new_tips_do_not_cut_into_the_part(made: tuple[Plan, JobFile]) -> None:
    before, job_file = made
    after = replan(before, changed(job_file, "tool_1: {radius: 5 mm}", "tool_1: {radius: 7 mm}"))
    surface = fine_surface(CONE.mesh(), 5e-3)
    for contour in after.contours:
        height, _ = drop_tool(surface, contour.forming_tip[:, :2], 7e-3)
        assert (height - contour.forming_tip[:, 2]).max() < 20e-6


def test_a_ball_larger_than_the_floor_fillet_is_refused_with_the_place(made: tuple[Plan, JobFile]) -> None:
    before, job_file = made
    with pytest.raises(IsfError) as caught:
        replan(before, changed(job_file, "tool_1: {radius: 5 mm}", "tool_1: {radius: 11 mm}"))
    assert caught.value.code is ErrorCode.PART_TOO_SMALL_FOR_TOOL
    z = float(caught.value.where.split("z = ")[1].split()[0]) * 1e-3
    assert z < CONE.floor_begin + 0.1e-3
    assert caught.value.advice


def test_the_support_tool_alone_leaves_the_forming_tips(made: tuple[Plan, JobFile]) -> None:
    before, job_file = made
    after = replan(before, changed(job_file, "tool_2: {radius: 5 mm}", "tool_2: {radius: 4 mm}"))
    for a, b in zip(before.contours, after.contours, strict=True):
        np.testing.assert_array_equal(b.forming_tip, a.forming_tip)
        np.testing.assert_allclose(tool_gap(b.forming_tip, b.support_tip, 5e-3, 4e-3), b.thickness, atol=1e-9)


def test_other_levels_need_a_new_plan(made: tuple[Plan, JobFile]) -> None:
    before, job_file = made
    coarse = changed(job_file, "incremental_depth: 0.5 mm", "incremental_depth: 2 mm")
    after = replan(before, coarse)
    assert len(after.contours) == len(plan(coarse).contours) < len(before.contours)


@pytest.mark.parametrize(("limit", "refused"), [("", True), ("wall_angle_limit: 80 deg", False)])
def test_a_material_that_bears_less_refuses_walls_that_the_one_before_bore(
    limit: str, refused: bool, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """65 deg: AA5754-O bears 66, AISI-304 63; a limit of the job holds for both."""
    steep = Cone(angle=np.radians(65.0))
    job_file = job_for(write(steep.mesh(), tmp_path_factory.mktemp("steep") / "cone.stl"), depth="1 mm")
    job_file = changed(job_file, "wall_angle_limit: 80 deg", limit)
    before, other = plan(job_file), changed(job_file, "AA5754-O", "AISI-304")
    if not refused:
        assert len(replan(before, other).contours) == len(before.contours)
        return
    with pytest.raises(IsfError) as caught:
        replan(before, other)
    assert caught.value.code is ErrorCode.WALL_TOO_STEEP
    assert "63.0 deg may be planned" in caught.value.what


@pytest.mark.parametrize(
    ("floor", "path"), [(1e-3, ""), (4.5e-3, ""), (8e-3, "spacing: scallop, scallop_height: 0.02 mm, ")]
)
def test_a_smaller_tool_forms_what_the_one_before_could_not(floor: float, path: str, tmp_path: Path) -> None:
    """Fillets of the floor smaller than the ball before, of 5 mm, and scallops whose height follows from the radius."""
    job_file = job_for(write(Cone(floor=floor).mesh(20e-6), tmp_path / "cone.stl"), process="SPIF", depth="1 mm")
    job_file = changed(job_file, "path: {", f"path: {{{path}")
    before, other = plan(job_file), changed(job_file, "tool_1: {radius: 5 mm}", "tool_1: {radius: 2 mm}")
    after, anew = replan(before, other), plan(other)
    assert after.warnings == anew.warnings
    assert not any("of material remain" in text and "5.00 mm" in text for text in after.warnings)
    for a, b in zip(after.contours, anew.contours, strict=True):
        np.testing.assert_array_equal(a.forming_tip, b.forming_tip)
    # it comes down to the floor all around, where the contacts of the ball before would have kept it above
    np.testing.assert_allclose(after.contours[-1].forming_tip[:, 2], -12e-3, atol=20e-6)


def test_a_smaller_tool_keeps_the_contacts_where_all_was_formed(made: tuple[Plan, JobFile]) -> None:
    before, job_file = made
    after = replan(before, changed(job_file, "tool_1: {radius: 5 mm}", "tool_1: {radius: 4 mm}"))
    for a, b in zip(before.contours, after.contours, strict=True):
        np.testing.assert_allclose(b.contact, a.contact, atol=20e-6)
    surface = fine_surface(CONE.mesh(), 4e-3)
    for contour in after.contours:
        height, _ = drop_tool(surface, contour.forming_tip[:, :2], 4e-3)
        assert np.abs(height - contour.forming_tip[:, 2]).max() < 30e-6
