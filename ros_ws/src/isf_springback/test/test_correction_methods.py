"""Methods by name, application of a correction, change of method."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile
from isf_springback import apply, make_corrector, method_names
from isf_springback.estimators import learning
from isf_springback.estimators.fused import MODEL_ALONE
from isf_springback.estimators.learning import Learned, features
from springback_parts import JOB_TEXT, cone_contour, job_file, result_of


@pytest.fixture(scope="module")
def job_that_learned(tmp_path_factory):
    """Job of the cone with a file of parts formed before, which the learned methods need; 1 mm everywhere."""
    folder = tmp_path_factory.mktemp("methods")
    contours = [cone_contour(index) for index in range(42)]
    floor = min(float(contour.forming_tip[:, 2].min()) for contour in contours)
    feature = np.vstack([features(contour, floor)[::8] for contour in contours])
    place = np.vstack([contour.contact[::8, :2] for contour in contours])
    index = np.repeat([contour.index for contour in contours], [len(c.contact[::8]) for c in contours])
    push = np.full(len(place), 1e-3)
    nothing = np.zeros(len(place))
    known = Learned(
        "cone", 42, 1, index, place, push, nothing, nothing, nothing + 0.7, feature, np.full(len(feature), 1e-3),
        np.array([[1e-3, 2e-3]]),
    )  # fmt: skip
    learning.save(known, folder / "known.npz")
    return JobFile(JOB_TEXT.replace("method: analytic", "method: analytic, scan_every: 1, learning: known.npz"), folder)


@pytest.mark.parametrize("name", sorted(method_names()))
def test_every_method_answers_every_contour(name, job_that_learned):
    method = make_corrector(name, job_that_learned)
    for index in range(5):
        contour = cone_contour(index)
        correction = method.correct(contour)
        assert (correction.method, correction.plan_id, correction.index) == (name, "plan", index)
        assert correction.offset.shape == (len(contour), 3)
        assert correction.saturated.shape == (len(contour),)
        method.add_result(apply(contour, correction), result_of(contour, 400.0))


def test_none_passes_through():
    contour = cone_contour(0)
    found = apply(contour, make_corrector("none", job_file()).correct(contour))
    assert np.array_equal(found.forming_tip, contour.forming_tip)
    assert np.array_equal(found.support_tip, contour.support_tip)


def test_unknown_method_lists_the_known_ones():
    with pytest.raises(IsfError, match=r"auto, analytic.*, none") as caught:
        make_corrector("analitic", job_file())
    assert caught.value.code == ErrorCode.METHOD_UNKNOWN


@pytest.mark.parametrize("name", ["mpc_vertical", "mpc_two_directional", "mpc_tpif"])
def test_a_method_that_lives_on_scans_wants_a_job_that_makes_them(name):
    with pytest.raises(IsfError, match="scan_every: 1") as caught:
        make_corrector(name, job_file())
    assert caught.value.code == ErrorCode.FILE_FIELD


def test_fused_reports_once_that_nothing_is_measured():
    for more, times in (("", 1), ("scan_every: 1, ", 0), ("lift_every: 2, ", 0)):
        method = make_corrector("fused", JobFile(JOB_TEXT.replace("method: analytic", f"{more}method: fused"), Path()))
        reported = []
        for index in range(3):
            contour = cone_contour(index)
            correction = method.correct(contour)
            reported += [text for text in correction.remarks if text == MODEL_ALONE]
            method.add_result(apply(contour, correction), result_of(contour, 400.0))
            if index == 0:
                assert len(reported) == times
        assert len(reported) == times


def test_correction_of_another_contour_is_refused():
    correction = make_corrector("none", job_file()).correct(cone_contour(1))
    with pytest.raises(IsfError) as caught:
        apply(cone_contour(2), correction)
    assert caught.value.code == ErrorCode.CONTOUR_OUT_OF_ORDER


@pytest.mark.parametrize("offset", [np.zeros((3, 3)), None])
def test_unusable_offset_is_refused(offset):
    contour = cone_contour(1)
    if offset is None:
        offset = np.full((len(contour), 3), np.nan)
    correction = replace(make_corrector("none", job_file()).correct(contour), offset=offset)
    with pytest.raises(IsfError) as caught:
        apply(contour, correction)
    assert caught.value.code == ErrorCode.CORRECTION_FAILED


@pytest.mark.parametrize("name", ["learned", "learned_map"])
def test_learned_methods_want_a_file(name):
    with pytest.raises(IsfError) as caught:
        make_corrector(name, job_file())
    assert caught.value.code == ErrorCode.LEARNING_UNUSABLE


def test_malformed_contour_is_refused(job_that_learned):
    contour = cone_contour(1)
    contour.contact[4] = np.nan
    for name in method_names():
        with pytest.raises(IsfError) as caught:
            make_corrector(name, job_that_learned).correct(contour)
        assert caught.value.code == ErrorCode.CONTOUR_REJECTED


def test_change_of_method_never_jumps():
    job = job_file()
    analytic, off = make_corrector("analytic", job), make_corrector("none", job)
    level = 0.0
    for index in range(30):
        contour = cone_contour(index)
        active, other = (analytic, off) if not 10 <= index < 20 else (off, analytic)
        correction = active.correct(contour)
        corrected = apply(contour, correction)
        other.follow(contour, correction)
        for method in (analytic, off):
            method.add_result(corrected, result_of(contour, 600.0))
        present = -correction.offset[:, 2].mean()
        # two incremental depths per contour
        assert abs(present - level) <= 1e-3 + 1e-9
        assert correction.code == 0
        level = present
        if index in (9, 29):
            assert level > 4.5e-3
        if index == 19:
            assert level == pytest.approx(0.0, abs=1e-9)
