"""Methods by name, application of a correction, change of method."""

from dataclasses import replace

import numpy as np
import pytest
from isf_core.errors import ErrorCode, IsfError
from isf_springback import METHODS, apply, make_method
from springback_parts import cone_contour, job_file, result_of


@pytest.mark.parametrize("name", sorted(METHODS))
def test_every_method_answers_every_contour(name):
    method = make_method(name, job_file())
    for index in range(5):
        contour = cone_contour(index)
        correction = method.correct(contour)
        assert (correction.method, correction.plan_id, correction.index) == (name, "plan", index)
        assert correction.offset.shape == (len(contour), 3)
        assert correction.saturated.shape == (len(contour),)
        method.learn(apply(contour, correction), result_of(contour, 400.0))


def test_none_passes_through():
    contour = cone_contour(0)
    found = apply(contour, make_method("none", job_file()).correct(contour))
    assert np.array_equal(found.forming_tip, contour.forming_tip)
    assert np.array_equal(found.support_tip, contour.support_tip)


def test_unknown_method_lists_the_known_ones():
    with pytest.raises(IsfError, match=r"analytic.*, none") as caught:
        make_method("analitic", job_file())
    assert caught.value.code == ErrorCode.METHOD_UNKNOWN


def test_correction_of_another_contour_is_refused():
    correction = make_method("none", job_file()).correct(cone_contour(1))
    with pytest.raises(IsfError) as caught:
        apply(cone_contour(2), correction)
    assert caught.value.code == ErrorCode.CONTOUR_OUT_OF_ORDER


@pytest.mark.parametrize("offset", [np.zeros((3, 3)), None])
def test_unusable_offset_is_refused(offset):
    contour = cone_contour(1)
    if offset is None:
        offset = np.full((len(contour), 3), np.nan)
    correction = replace(make_method("none", job_file()).correct(contour), offset=offset)
    with pytest.raises(IsfError) as caught:
        apply(contour, correction)
    assert caught.value.code == ErrorCode.CORRECTION_FAILED


def test_malformed_contour_is_refused():
    contour = cone_contour(1)
    contour.contact[4] = np.nan
    for name in METHODS:
        with pytest.raises(IsfError) as caught:
            make_method(name, job_file()).correct(contour)
        assert caught.value.code == ErrorCode.CONTOUR_REJECTED


def test_change_of_method_never_jumps():
    job = job_file()
    analytic, off = make_method("analytic", job), make_method("none", job)
    level = 0.0
    for index in range(30):
        contour = cone_contour(index)
        active, other = (analytic, off) if not 10 <= index < 20 else (off, analytic)
        correction = active.correct(contour)
        corrected = apply(contour, correction)
        other.follow(contour, correction)
        for method in (analytic, off):
            method.learn(corrected, result_of(contour, 600.0))
        present = -correction.offset[:, 2].mean()
        # two incremental depths per contour
        assert abs(present - level) <= 1e-3 + 1e-9
        assert correction.code == 0
        level = present
        if index in (9, 29):
            assert level > 4.5e-3
        if index == 19:
            assert level == pytest.approx(0.0, abs=1e-9)
