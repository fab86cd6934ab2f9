"""Over a die a correction never presses the sheet onto it: room of the tool, and the method that keeps to it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile, load_job
from isf_planner import Plan, plan
from isf_springback.die_room import BESIDE, DieRoom, die_room, free_of_die, within_room
from isf_springback.estimators.mpc import MpcTpif
from isf_springback.methods import make_corrector
from isf_springback.scan.feedback import contour_over_die
from scipy.spatial import KDTree
from springback_parts import cone_contour, corrector_of
from test_scan_over_die import scan, with_die_cut_off

ROOT = Path(__file__).resolve().parents[5]
FACETS = 20e-6
"""m, what faceting of part and die takes of the room on the planned path."""


@pytest.fixture(scope="module")
def job() -> JobFile:
    return load_job(ROOT / "examples" / "jobs" / "tpif_cone.yaml")


@pytest.fixture(scope="module")
def cone(job: JobFile) -> Plan:
    return plan(job)


def test_room_over_a_flat_die_is_height_less_sheet() -> None:
    """Ball of 5 mm on a horizontal sheet (normal up): contact height over the die less the thickness, to the spacing of
    the points (10 um)."""
    x = np.arange(-60e-3, 60.1e-3, 0.5e-3)
    gx, gy = np.meshgrid(x, x)
    flat = np.column_stack([gx.ravel(), gy.ravel(), np.full(gx.size, -20e-3)])
    contour = cone_contour(5)
    upright = replace(contour, normal=np.tile([0.0, 0.0, 1.0], (len(contour), 1)))
    room = DieRoom(KDTree(flat), 5e-3).of(upright)
    assert room == pytest.approx(upright.contact[:, 2] + 20e-3 - upright.thickness, abs=10e-6)


def test_the_plan_leaves_the_sheet_its_room(job: JobFile, cone: Plan) -> None:
    """The die of the cone carries all contours but the last, which works just beside it."""
    room = die_room(job)
    assert room is not None
    for contour in cone.contours:
        assert room.of(contour_over_die(contour)).min() > -FACETS
        assert not free_of_die(room, contour_over_die(contour)).any()


@pytest.mark.parametrize("direction", [(0.0, 0.0, -1.0), (-0.7, 0.0, -0.7)])
def test_a_correction_is_shortened_to_its_room(job: JobFile, cone: Plan, direction: tuple[float, ...]) -> None:
    room = die_room(job)
    assert room is not None
    contour = contour_over_die(cone.contours[6])
    wish = 0.5e-3 * np.tile(direction, (len(contour), 1))
    offset, pressed = within_room(room, contour, wish)
    assert pressed.any()
    least = np.minimum(room.of(contour), 0.0)
    assert (room.of(contour, wish) < least - 50e-6).any()  # it would have pressed
    assert (room.of(contour, offset) >= least - 2e-6).all()
    slope = np.linalg.norm(np.diff(offset, axis=0), axis=1) / np.linalg.norm(np.diff(contour.contact, axis=0), axis=1)
    assert slope.max() < 0.06  # 50 um per mm, on a path of chords
    lifted, free = within_room(room, contour, -wish)
    if direction[0] == 0.0:
        assert not free.any()
        np.testing.assert_array_equal(lifted, -wish)


@pytest.mark.parametrize("high", [0.3e-3, 1.0e-3])
def test_the_method_does_not_press_onto_the_die(job: JobFile, cone: Plan, high: float) -> None:
    """Scans that stand too high over the die: the tool keeps to the plan, within the facets."""
    method = corrector_of(MpcTpif, job)
    method.set_target(cone.target)
    for contour in cone.contours[:10]:
        correction = method.correct(contour)
        assert correction.code == 0, correction.message
        assert correction.offset[:, 2].min() > -FACETS
        method.add_scan(scan(cone.target, contour.holder_height, high), contour.index)


def test_beside_the_die_it_corrects(job: JobFile, cone: Plan, tmp_path: Path) -> None:
    cut = with_die_cut_off(job, tmp_path)
    room = die_room(cut)
    assert room is not None
    free = [bool(free_of_die(room, contour_over_die(contour)).all()) for contour in cone.contours]
    assert not free[0]
    assert free[-1]
    method = corrector_of(MpcTpif, cut)
    method.set_target(cone.target)
    for contour in cone.contours[:8]:
        correction = method.correct(contour)
        method.add_scan(scan(cone.target, contour.holder_height, 0.3e-3), contour.index)
    assert correction.offset[:, 2].max() < -0.2e-3
    assert room.of(contour_over_die(contour), correction.offset).min() > BESIDE


def test_a_die_that_is_not_there_is_reported(job: JobFile) -> None:
    assert job.job.die is not None
    lost = JobFile(job.text, job.base)
    lost.job = job.job.model_copy(update={"die": job.job.die.model_copy(update={"mesh": "nowhere.stl"})})
    springback = lost.job.springback.model_copy(update={"scan_every": 1})
    lost.job = lost.job.model_copy(update={"springback": springback})
    with pytest.raises(IsfError) as caught:
        make_corrector("mpc_tpif", lost)
    assert caught.value.code is ErrorCode.FILE_NOT_FOUND
