"""Springback across the wall: the published compliance, direction and limits of the offset, and none without force."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from isf_core.files.job import JobFile
from isf_springback.corrector import apply
from isf_springback.database.control_points import control_loop
from isf_springback.estimators.estimator import Estimator, Horizontal, Prediction
from isf_springback.estimators.horizontal_springback import HorizontalSpringback, across_level, across_load, outward
from isf_springback.loop_path import HORIZONTAL_SLOPE
from isf_springback.methods import make_corrector
from springback_parts import JOB_TEXT, cone_contour, corrector_of, result_of

LOAD, ACROSS = 400.0, 130.0


def job(horizontal=True):
    options = f"elastic: {{loop_increment: 3 mm, horizontal: {str(horizontal).lower()}}}, method: elastic"
    return JobFile(JOB_TEXT.replace("method: analytic", options), Path("."))


def result_across(contour, across, *, friction=0.0):
    """The sheet pushes the forming tool inwards with ``across`` N, and back along the path with ``friction`` N."""
    out = outward(contour)
    result = result_of(contour, LOAD)
    force = result.forming_force.copy()
    force[:, :2] -= np.broadcast_to(across, len(contour))[:, None] * out
    force[:, :2] -= friction * np.column_stack([-out[:, 1], out[:, 0]])
    return replace(result, forming_force=force)


def test_the_load_is_across_the_path_and_without_the_squeeze():
    for tool in (1, 2):
        contour = cone_contour(8, tool=tool)
        place = contour.contact[:, :2] / np.linalg.norm(contour.contact[:, :2], axis=1)[:, None]
        np.testing.assert_allclose(outward(contour), place, atol=1e-9)
        result = result_across(contour, ACROSS, friction=60.0)
        squeeze = 120.0 * place
        both = np.column_stack([squeeze, np.zeros(len(contour))])
        squeezed = replace(result, forming_force=result.forming_force + both, support_force=result.support_force - both)
        np.testing.assert_allclose(across_load(contour, squeezed).load, ACROSS, rtol=1e-6)
    assert across_load(contour, replace(result, forming_force=result.forming_force * np.nan)) is None
    assert across_load(contour, replace(result, support_force=np.empty((0, 3)))) is None


def test_laws_across_the_wall_are_those_of_the_published_cone():
    """0.62 / 1.11 mm at 200 / 600 N in x (Ren 2018, Table 4.6); the shell's fine mesh has 0.56 / 1.10 mm."""
    job_file = job()
    contours = [cone_contour(index, opening=32e-3) for index in range(1, 42, 4)]
    loop = control_loop(contours[-1], 5e-3)
    points = loop.points[:, :2]
    level = across_level(contours, loop, points, np.arange(len(points)), job_file)
    for force, published in ((200.0, 0.62e-3), (600.0, 1.11e-3)):
        found = level.law.displacement(np.full(len(points), force))
        np.testing.assert_allclose(found, published, rtol=0.2)


def test_walls_are_moved_outwards_by_their_springback_and_no_more_than_asked():
    forward, plain = make_corrector("elastic", job()), make_corrector("elastic", job(False))
    sizes = []
    for index in range(14):
        nominal = cone_contour(index)
        with_across, without = forward.correct(nominal), plain.correct(nominal)
        assert with_across.code == without.code == 0
        np.testing.assert_array_equal(with_across.offset[:, 2], without.offset[:, 2])
        assert not without.offset[:, :2].any()
        size = (with_across.offset[:, :2] * outward(nominal)).sum(axis=1)
        np.testing.assert_allclose(with_across.offset[:, :2], size[:, None] * outward(nominal), atol=1e-12)
        corrected = apply(nominal, with_across)
        for before, after in ((nominal.forming_tip, corrected.forming_tip), (nominal.contact, corrected.contact)):
            np.testing.assert_allclose(after - before, with_across.offset, atol=1e-12)
        np.testing.assert_allclose(corrected.support_tip - nominal.support_tip, with_across.offset, atol=1e-12)
        sizes.append(float(size.mean()))
        forward.add_result(corrected, result_across(corrected, ACROSS))
        plain.add_result(apply(nominal, without), result_of(nominal, LOAD))
    assert sizes[0] == 0.0  # nothing measured yet
    # a flat sheet is stiff in its plane; walls give way the more the deeper they stand, 0.4 mm at 21 mm
    assert 0.02e-3 < sizes[-1] < 0.4e-3
    assert sizes[-1] > 2.0 * sizes[5] > 0.0


class Across(Estimator):
    """Nothing but springback across the wall."""

    name = "across"

    def __init__(self, job_file, across):
        super().__init__(job_file)
        self._across = across

    def begin(self, contour, history):
        self._across.begin(contour)

    def estimate(self, contour, history):
        return Prediction(np.zeros(len(contour)), horizontal=Horizontal(outward(contour), self._across.wanted(contour)))


def test_an_uneven_force_gives_an_offset_within_the_slope_limit_and_a_missing_one_the_last():
    across = HorizontalSpringback(job())
    corrector = corrector_of(Across, job(), across)
    contours = [cone_contour(index) for index in range(8, 13)]
    loop = control_loop(contours[0], 5e-3)
    places = contours[0].contact[:: len(contours[0]) // 8, :2]
    flat = replace(loop, points=np.column_stack([places, np.zeros(len(places))]))
    level = across_level(contours[:1], flat, places, np.arange(len(places)), job())
    offsets = []
    for k, contour in enumerate(contours):
        across.level = level
        offset = corrector.correct(contour).offset[:, :2]
        offsets.append((offset * outward(contour)).sum(axis=1))
        angle = np.arctan2(contour.contact[:, 1], contour.contact[:, 0])
        uneven = result_across(contour, 1500.0 * (np.abs(angle) < 0.5))
        across.add_result(contour, uneven if k < 2 else replace(uneven, forming_force=np.empty((0, 3))))
    spacing = np.linalg.norm(np.diff(contours[2].forming_tip[:, :2], axis=0), axis=1)
    assert np.ptp(offsets[2]) > 0.1e-3
    assert (np.abs(np.diff(offsets[2])) <= HORIZONTAL_SLOPE * spacing * 1.05).all()
    assert offsets[4].max() == pytest.approx(offsets[2].max(), rel=0.1)
    # a new part begins at its planned path
    fresh = cone_contour(0, plan_id="next")
    assert not corrector.correct(fresh).offset.any()
