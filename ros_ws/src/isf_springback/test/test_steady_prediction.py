"""The prediction of a model whose force the correction itself raises: it swings when followed, and settles here."""

from dataclasses import replace

import numpy as np
import pytest
from isf_springback.steady_prediction import PLATEAU, SteadyPrediction
from springback_parts import cone_contour

TRUE = 5.5e-3
CONTOURS = [cone_contour(index) for index in range(40)]


def swing(a, *, steady):
    """(39,) m, mean correction minus the springback; a = k K as in the module text, disturbed once by 0.2 mm.

    The model says 5 mm + a (c - c_before) after a ramp over six contours; its bias is exactly measured every time.
    """
    prediction = SteadyPrediction()
    correction, bias = [0.0, 0.0], 0.0
    for index, contour in enumerate(CONTOURS[:-1]):
        step = 0.0 if index < 12 else correction[-1] - correction[-2] + (0.2e-3 if index == 12 else 0.0)
        raw = np.full(len(contour), min(index, 5) * 1e-3 + a * step)
        used = prediction.take(contour, raw, seen=index > 1) if steady else raw
        correction.append(float(used.mean()) + bias)
        bias = TRUE - float(used.mean())
    return np.array(correction[2:]) - TRUE


@pytest.mark.parametrize("a", [0.3, 1.0, 1.4])
def test_the_correction_settles(a):
    assert np.abs(swing(a, steady=True)[30:]).max() < 0.02e-3
    if a >= 1.0:
        assert np.abs(swing(a, steady=False)[30:]).max() > 1e-3


def test_a_rising_force_is_followed_without_lag_and_unseen_parts_altogether():
    rising, unseen = SteadyPrediction(), SteadyPrediction()
    for index, contour in enumerate(CONTOURS[:10]):
        raw = np.full(len(contour), 2.0 * PLATEAU * index)
        np.testing.assert_array_equal(rising.take(contour, raw, seen=True), raw)
        flat = np.full(len(contour), 3e-3 + 1e-4 * (-1) ** index)
        np.testing.assert_array_equal(unseen.take(contour, flat, seen=False), flat)


def test_asking_twice_gives_the_same_and_another_feature_begins_anew():
    prediction = SteadyPrediction()
    for index, contour in enumerate(CONTOURS[:6]):
        raw = np.full(len(contour), 3e-3 + 5e-4 * (-1) ** index)
        used = prediction.take(contour, raw, seen=True)
        np.testing.assert_array_equal(prediction.take(contour, raw, seen=True), used)
    assert abs(float(used.mean()) - 3e-3) < 2.5e-4
    other = replace(CONTOURS[6], feature=1)
    raw = np.full(len(other), 1e-3)
    np.testing.assert_array_equal(prediction.take(other, raw, seen=True), raw)
    assert [contour.index for contour, _ in prediction.steps] == [6]


def test_a_changed_model_scales_what_was_used():
    prediction = SteadyPrediction()
    for contour in CONTOURS[:3]:
        prediction.take(contour, np.full(len(contour), 3e-3), seen=True)
    prediction.scaled([np.full(len(contour), 1.2) for contour, _ in prediction.steps])
    for contour, value in prediction.steps:
        np.testing.assert_allclose(value, np.full(len(contour), 3.6e-3))
