"""Passes over the floor: rings one step apart at the level of the floor, only where it is flat and empty."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from isf_core.contour import Contour
from isf_core.errors import IsfError
from isf_core.files.job import JobFile
from isf_planner import plan
from planner_parts import Cone, grid_mesh, job_for, revolve, write

STEP = 3e-3


def with_floor(job_file: JobFile, options: str) -> JobFile:
    return JobFile(job_file.text.replace("path: {", f"path: {{{options}, ", 1), job_file.base)


def radii(contours: tuple[Contour, ...]) -> list[float]:
    return [float(np.hypot(*contour.forming_tip[:, :2].T).mean()) for contour in contours]


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
    with pytest.raises(IsfError, match="floor_rounds has no effect without floor_step"):
        plan(with_floor(job_file, "floor_rounds: 3"))
