"""Accuracy of the support force on tick arrays whose numbers can be counted by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from isf_analysis.measures.force_metrics import BAND, force_metrics
from isf_core.contour import ContourResult
from synthetic_part import make_part

RATE = 500.0
EMPTY = np.empty((0, 3))


def result(
    error: np.ndarray, *, engaged: np.ndarray | None = None, set_point: float = 120.0, contact: float = 1.0
) -> ContourResult:
    ticks = len(error)
    return ContourResult(
        plan_id="p",
        index=0,
        start=0.0,
        end=ticks / RATE,
        completed=True,
        forming_force=EMPTY,
        support_force=EMPTY,
        forming_target=EMPTY,
        support_target=EMPTY,
        force_offset=np.empty(0),
        compliance_offset=EMPTY,
        tick_time=np.arange(ticks) / RATE,
        tick_set_point=np.full(ticks, set_point),
        tick_normal_force=set_point + error,
        tick_engaged=np.ones(ticks, dtype=bool) if engaged is None else engaged,
        contact_fraction=contact,
    )


def test_known_errors_give_known_numbers() -> None:
    error = np.array([0.0, 5.0, -5.0, 10.0, -10.0, 20.0, 0.0, 0.0, 0.0, 0.0])
    metrics = force_metrics([result(error)], RATE)
    assert metrics is not None
    assert metrics.set_point == 120.0
    assert metrics.mean_error == pytest.approx(2.0)
    assert metrics.rms_error == pytest.approx(np.sqrt(65.0))  # (25 + 25 + 100 + 100 + 400) / 10
    assert metrics.within_band == pytest.approx(0.9)  # +-10 N itself is inside
    assert metrics.max_abs_error == 20.0
    assert metrics.engaged_time == pytest.approx(10 / RATE)


def test_one_outlier_in_a_thousand_is_at_the_99_9_percent() -> None:
    error = np.zeros(10001)
    error[:10] = 50.0
    metrics = force_metrics([result(error)], RATE)
    assert metrics is not None
    assert metrics.p99_abs_error == 0.0
    assert metrics.p999_abs_error == 0.0  # position 9990 of 0..10000 is still a zero, the outliers begin at 9991
    error[10:12] = 50.0
    metrics = force_metrics([result(error)], RATE)
    assert metrics is not None
    assert metrics.p999_abs_error == 50.0


def test_ramps_do_not_count() -> None:
    error = np.concatenate([np.full(50, -100.0), np.full(150, 1.0)])
    engaged = np.arange(200) >= 50
    metrics = force_metrics([result(error, engaged=engaged)], RATE)
    assert metrics is not None
    assert metrics.max_abs_error == pytest.approx(1.0)
    assert metrics.engaged_fraction == pytest.approx(0.75)


def test_ticks_without_a_measurement_do_not_count() -> None:
    metrics = force_metrics([result(np.array([1.0, np.nan, 1.0]))], RATE)
    assert metrics is not None
    assert (metrics.engaged_ticks, metrics.max_abs_error) == (2, pytest.approx(1.0))


def test_contact_is_weighted_by_engaged_ticks() -> None:
    long, short = result(np.zeros(300), contact=1.0), result(np.zeros(100), contact=0.6)
    metrics = force_metrics([long, short], RATE)
    assert metrics is not None
    assert metrics.contact_fraction == pytest.approx(0.9)


def test_without_force_control_there_are_no_metrics() -> None:
    position = replace(result(np.zeros(10)), tick_set_point=np.empty(0))
    assert force_metrics([position], RATE) is None
    assert force_metrics([], RATE) is None
    assert force_metrics(make_part(process="SPIF", support_force=0.0, contours=3).results, RATE) is None


def test_control_that_never_engaged_is_unknown_not_perfect() -> None:
    metrics = force_metrics([result(np.zeros(10), engaged=np.zeros(10, dtype=bool))], RATE)
    assert metrics is not None
    assert metrics.engaged_ticks == 0
    assert np.isnan(metrics.within_band)


@settings(max_examples=60, deadline=None)
@given(error=arrays(float, st.integers(1, 400), elements=st.floats(-300, 300)), cut=st.integers(1, 399))
def test_metrics_do_not_depend_on_how_ticks_are_split(error: np.ndarray, cut: int) -> None:
    cut = min(cut, len(error))
    whole = force_metrics([result(error)], RATE)
    parts = force_metrics([result(error[:cut]), result(error[cut:])], RATE)
    assert whole is not None
    assert parts is not None
    assert parts.within_band == whole.within_band
    assert parts.p999_abs_error == whole.p999_abs_error
    assert parts.rms_error == pytest.approx(whole.rms_error, rel=1e-9)  # order of summation
    assert whole.p99_abs_error <= whole.p999_abs_error <= whole.max_abs_error
    assert (whole.max_abs_error <= BAND) == (whole.within_band == 1.0)
