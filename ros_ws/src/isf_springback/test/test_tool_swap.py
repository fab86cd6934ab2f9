"""The first contours after the tools have swapped their roles: pushed by the expected force, not from zero."""

from dataclasses import replace

import numpy as np
import pytest
from isf_core.geometry.height_map import HeightMap
from isf_springback.corrector import apply
from isf_springback.estimators.analytic import AnalyticModel, AnalyticOptions
from isf_springback.estimators.estimator import NoCorrection
from isf_springback.estimators.fused import FROM_BELOW, FusedEstimator
from springback_parts import cone_contour, corrector_of, job_file, result_of

PREDICTED = 571.0
CHANGE = 1e-3
"""m, two incremental depths."""


def second_feature(index, **changes):
    """Contour of a feature formed from below after the eight contours of a pocket."""
    contour = replace(cone_contour(index, tool=2, radius=18e-3), feature=1, retract=index == 8)
    return replace(contour, **{"predicted_force": np.full(len(contour), PREDICTED)} | changes)


def formed_pocket(options=None):
    """The method after eight contours formed from above under 500 N."""
    method = corrector_of(AnalyticModel, job_file(), options)
    for index in range(8):
        contour = cone_contour(index)
        method.add_result(apply(contour, method.correct(contour)), result_of(contour, 500.0))
    return method


def steady(force):
    """m, push of the second feature on which ``force`` N was measured all along."""
    method = formed_pocket()
    for index in range(8, 20):
        contour = second_feature(index)
        correction = method.correct(contour)
        method.add_result(apply(contour, correction), result_of(contour, force))
    return float(correction.offset[:, 2].mean())


def test_the_first_contour_is_pushed_by_the_predicted_force():
    first = formed_pocket().correct(second_feature(8))
    assert first.code == 0
    assert first.control_point_force == pytest.approx(np.full(24, PREDICTED))
    # the push that a feature measured at this force would have, at once: the lifted tools jump nowhere
    assert first.offset[:, 2].mean() == pytest.approx(steady(PREDICTED), rel=1e-6)
    assert first.offset[:, 2].min() > 2 * CHANGE
    assert not first.saturated.any()


def test_without_a_predicted_force_aerens_regression_stands_in():
    first = formed_pocket().correct(second_feature(8, predicted_force=np.empty(0)))
    always = corrector_of(AnalyticModel, job_file(), AnalyticOptions(first_contour="estimate")).correct(cone_contour(0))
    assert first.control_point_force == pytest.approx(always.control_point_force)


def test_from_the_second_contour_on_changes_are_limited():
    method = formed_pocket()
    contour = second_feature(8)
    first = method.correct(contour)
    method.add_result(apply(contour, first), result_of(contour, 30.0))
    second = method.correct(second_feature(9))
    # 30 N ask for much less; the change limit holds
    assert second.saturated.all()
    assert first.offset[:, 2].mean() - second.offset[:, 2].mean() == pytest.approx(CHANGE, rel=1e-6)


@pytest.mark.parametrize("load", [-26.0, 0.0])
def test_a_contour_that_the_support_tool_pressed_is_no_history(load):
    method = formed_pocket()
    contour = second_feature(8)
    method.add_result(apply(contour, method.correct(contour)), result_of(contour, load))
    second = method.correct(second_feature(9))
    assert second.code == 0
    assert second.control_point_force == pytest.approx(np.full(24, PREDICTED))


def test_asking_again_and_changing_the_method_give_the_same():
    method = formed_pocket()
    first = method.correct(second_feature(8))
    assert np.array_equal(method.correct(second_feature(8)).offset, first.offset)
    other = corrector_of(AnalyticModel, job_file())
    for index in range(8):
        contour = cone_contour(index)
        other.follow(contour, corrector_of(NoCorrection, job_file()).correct(contour))
        other.add_result(contour, result_of(contour, 500.0))
    assert np.array_equal(other.correct(second_feature(8)).offset, first.offset)


def test_zero_can_be_had():
    method = formed_pocket(AnalyticOptions(first_contour="zero"))
    contour = second_feature(8)
    first = method.correct(contour)
    assert not first.offset.any()
    method.add_result(apply(contour, first), result_of(contour, -26.0))
    assert not method.correct(second_feature(9)).offset.any()


@pytest.mark.parametrize("retract", [True, False])
def test_a_feature_on_the_same_side_begins_with_its_own_force(retract):
    """Lifted tools go where the predicted force asks for; tools that stay down change by the limit."""
    method = formed_pocket()
    before = method.history.current.push.mean()
    contour = cone_contour(8)
    predicted = np.full(len(contour), 150.0)
    first = method.correct(replace(contour, feature=1, retract=retract, predicted_force=predicted))
    wanted = first.springback.mean()
    assert 0.0 < wanted < before - 1.5 * CHANGE
    applied = -first.offset[:, 2].mean()
    assert applied == pytest.approx(wanted if retract else before - CHANGE, abs=20e-6)


def test_a_new_plan_of_the_other_side_is_no_swap():
    method = formed_pocket()
    contour = replace(cone_contour(0, tool=2, plan_id="another"), predicted_force=np.empty(0))
    assert not method.correct(contour).offset.any()


def test_fused_uses_no_scan_of_a_feature_formed_from_below():
    """A scan 2 mm off, believed, would move the tool; the correction stays that of the model, and tells so."""
    eyes, blind = (corrector_of(FusedEstimator, job_file()) for _ in range(2))
    grid = np.linspace(-0.1, 0.1, 81)
    eyes.set_target(HeightMap(grid, grid, np.zeros((81, 81))))
    far_off = np.column_stack([*(g.ravel() for g in np.meshgrid(grid, grid)), np.full(81 * 81, -2e-3)])
    for index in range(12):
        contour = cone_contour(index) if index < 8 else second_feature(index)
        seen, unseen = eyes.correct(contour), blind.correct(contour)
        assert np.array_equal(seen.offset, unseen.offset)
        assert (FROM_BELOW in seen.remarks) == (index > 8)
        assert seen.code == 0
        for method in (eyes, blind):
            method.add_result(apply(contour, seen), result_of(contour, 500.0))
        if index >= 8:
            eyes.add_scan(far_off, index)
    assert seen.offset[:, 2].mean() > 2 * CHANGE


def test_fused_pushes_at_once_when_the_tools_swap():
    method = corrector_of(FusedEstimator, job_file())
    for index in range(9):
        contour = cone_contour(index) if index < 8 else second_feature(index)
        correction = method.correct(contour)
        method.add_result(apply(contour, correction), result_of(contour, 500.0))
    assert correction.offset[:, 2].min() > 2 * CHANGE
    assert correction.code == 0
