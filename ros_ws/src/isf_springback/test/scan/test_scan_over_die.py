"""Scans over a die: the blank holder moves from contour to contour, shapes and levels meet in the frame of the die."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
from isf_core.contour import ContourCorrection
from isf_core.errors import ErrorCode
from isf_core.files.job import JobFile, load_job
from isf_core.geometry.height_map import HeightMap
from isf_core.types import Array
from isf_planner import Plan, plan
from isf_springback.estimators import learning
from isf_springback.estimators.learning import learn_part
from isf_springback.estimators.mpc import MpcTpif, MpcVertical
from isf_springback.methods import make_corrector
from isf_springback.scan.feedback import shape_over_die, target_over_die
from springback_parts import corrector_of

ROOT = Path(__file__).resolve().parents[5]
CLAMP = (250e-3, 250e-3)


@pytest.fixture(scope="module")
def job() -> JobFile:
    return load_job(ROOT / "examples" / "jobs" / "tpif_cone.yaml")


@pytest.fixture(scope="module")
def cone(job: JobFile) -> Plan:
    return plan(job)


def with_die_cut_off(job: JobFile, folder: Path) -> JobFile:
    """The job with 0.3 mm of its die, in mm, left: it carries the top alone."""
    assert job.job.die is not None
    die = trimesh.load(job.base / job.job.die.mesh, force="mesh")
    cut = trimesh.intersections.slice_mesh_plane(die, [0.0, 0.0, 1.0], [0.0, 0.0, die.vertices[:, 2].max() - 0.3])
    cut.export(folder / "cut.stl")
    job_file = JobFile(job.text, job.base)
    job_file.job = job.job.model_copy(update={"die": job.job.die.model_copy(update={"mesh": str(folder / "cut.stl")})})
    return job_file


def scan(target: HeightMap, holder: float, high: float) -> Array:
    """(P, 3) m in frame ``sheet``: what stands over the flange, ``high`` m too high but for the top and the clamp."""
    x = np.arange(-120e-3, 120.1e-3, 0.5e-3)
    gx, gy = np.meshgrid(x, x)
    place = np.column_stack([gx.ravel(), gy.ravel()])
    stands = np.maximum(target_over_die(target).at(place) - holder, 0.0)
    stands[np.isnan(stands)] = 0.0
    return np.column_stack([place, stands + too_high(place, high)])


def too_high(place: Array, high: float) -> Array:
    """(P,) m at ``place`` (P, 2) m: ``high``, less near the clamp, nothing on the top."""
    away = np.hypot(*place.T)
    return np.asarray(high * np.clip((105e-3 - away) / 60e-3, 0.0, 1.0) * np.clip((away - 15e-3) / 3e-3, 0.0, 1.0))


@pytest.mark.parametrize("holder", [-0.5e-3, -3e-3, -6e-3])
def test_shape_lies_in_the_frame_of_the_die(cone: Plan, holder: float) -> None:
    """However far the holder has moved, the top stays at z = 0 and the flange lies at the holder."""
    contour = next(c for c in cone.contours if abs(c.holder_height - holder) < 1e-6)
    shape = shape_over_die(scan(cone.target, holder, 0.0), cone.target, CLAMP, contour)
    assert shape.surface.at(np.zeros((1, 2)))[0] == pytest.approx(0.0, abs=20e-6)
    assert shape.surface.at(np.array([[60e-3, 0.0]]))[0] == pytest.approx(holder, abs=20e-6)
    middle = np.column_stack([np.linspace(-30e-3, 30e-3, 61), np.zeros(61)])
    expected = np.maximum(target_over_die(cone.target).at(middle), holder)
    assert np.nanmax(np.abs(shape.surface.at(middle) - expected)) < 0.15e-3  # cells of 1 mm on a wall and its edges


@pytest.mark.parametrize("high", [0.0, 0.2e-3])
def test_step_makes_good_what_the_bottom_stands_too_high(job: JobFile, cone: Plan, high: float, tmp_path: Path) -> None:
    """First move of the published weights: 0.8541 of the error (lambda 0.2, horizon 6), within 10 %; none without."""
    method = corrector_of(MpcTpif, with_die_cut_off(job, tmp_path))
    method.set_target(cone.target)
    for contour in cone.contours[:9]:
        correction = method.correct(contour)
        assert correction.code == 0, correction.message
        if contour.index < 8:
            assert correction.offset[:, 2] == pytest.approx(0.0, abs=15e-6)
            # scans that show nothing wrong
            method.add_scan(
                scan(cone.target, contour.holder_height, high if contour.index == 7 else 0.0), contour.index
            )
    assert correction.offset[:, 2] == pytest.approx(-0.8541 * high, abs=0.1 * high + 15e-6)


def test_a_method_without_a_die_says_that_it_cannot_read_the_scan(job: JobFile, cone: Plan) -> None:
    method = corrector_of(MpcVertical, job)
    method.set_target(cone.target)
    for contour in cone.contours[:2]:
        correction = method.correct(contour)
        method.add_scan(scan(cone.target, contour.holder_height, 0.2e-3), contour.index)
    assert correction.code == ErrorCode.CORRECTION_FAILED
    assert "mpc_tpif" in correction.message
    assert not correction.offset.any()


@pytest.mark.parametrize("high", [0.0, 0.3e-3])
def test_what_stands_too_high_over_the_die_is_pushed_deeper_on_the_next_part(cone: Plan, high: float) -> None:
    """Push of the next part: 0.7 of the error at every contour on the wall; none where nothing was wrong."""
    nothing = [
        ContourCorrection(contour.plan_id, contour.index, "none", np.zeros((len(contour), 3)), np.zeros(len(contour)))
        for contour in cone.contours
    ]
    points = scan(cone.target, cone.contours[-1].holder_height, high)
    known = learn_part(cone.contours, nothing, points, cone.target, CLAMP, 5e-3, "tpif_cone")
    assert known.error == pytest.approx(too_high(known.place, high), abs=60e-6)
    assert known.push == pytest.approx(0.7 * too_high(known.place, high), abs=45e-6)
    # depth counts from the top of the die
    assert known.feature[:, 2].max() == pytest.approx(-cone.contours[-1].holder_height, abs=0.1e-3)


def test_the_map_reads_a_contour_over_a_die_in_the_frame_it_was_learned_in(
    job: JobFile, cone: Plan, tmp_path: Path
) -> None:
    """What stood 0.1 to 0.3 mm too high by depth is predicted at every depth; nothing lies outside of what is known."""
    nothing = [
        ContourCorrection(contour.plan_id, contour.index, "none", np.zeros((len(contour), 3)), np.zeros(len(contour)))
        for contour in cone.contours
    ]
    points = scan(cone.target, cone.contours[-1].holder_height, 0.3e-3)
    known = learn_part(cone.contours, nothing, points, cone.target, CLAMP, 5e-3, "tpif_cone")
    learning.save(known, tmp_path / "known.npz")
    springback = job.job.springback.model_copy(update={"learning": str(tmp_path / "known.npz")})
    job_file = JobFile(job.text, job.base)
    job_file.job = job.job.model_copy(update={"springback": springback})
    method = make_corrector("learned_map", job_file)
    method.set_target(cone.target)
    for contour in cone.contours:
        correction = method.correct(contour)
        assert not correction.remarks
        wanted = too_high(contour.contact[:, :2], 0.3e-3)
        assert np.asarray(correction.springback) == pytest.approx(wanted, abs=50e-6)
