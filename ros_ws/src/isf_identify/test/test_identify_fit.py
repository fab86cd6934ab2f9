"""The fit of the identification on synthetic readings: outliers are left out, what is not linear is refused."""

from __future__ import annotations

import numpy as np
import pytest
from isf_core.errors import ErrorCode, IsfError
from isf_core.types import Array
from isf_identify.fits import MAXIMUM_RESIDUAL, fit_linear
from numpy.typing import NDArray

COMPLIANCE = np.array([1.4e-6, 0.2e-6])
NOISE = 0.3e-6


def readings(visits: int = 6, count: int = 8) -> tuple[Array, Array, NDArray[np.int64]]:
    """Forces (R, 2) N, deflections (R,) m with noise and one constant per visit, number of the visit (R,)."""
    random = np.random.default_rng(7)
    forces = np.column_stack([np.tile(np.linspace(20.0, 300.0, count), visits), random.uniform(0, 200, visits * count)])
    visit = np.repeat(np.arange(visits), count)
    moved = forces @ COMPLIANCE + 30e-6 * random.standard_normal(visits)[visit]
    return forces, moved + NOISE * random.standard_normal(len(moved)), visit


def test_outliers_are_left_out_and_change_nothing() -> None:
    forces, moved, visit = readings()
    wrong = [5, 17, 40]
    moved[wrong] += [60e-6, -40e-6, 200e-6]
    fit = fit_linear(forces, moved, visit, "compliance")
    assert np.flatnonzero(~fit.used).tolist() == wrong
    assert np.abs(fit.value - COMPLIANCE).max() < 4 * fit.deviation.max() < 0.02e-6
    assert fit.residual == pytest.approx(NOISE, rel=0.3)


def test_too_many_outliers_are_refused() -> None:
    forces, moved, visit = readings()
    moved[::4] += 1e-3 * np.array([1.0, -1.0, 2.0, -2.0] * 3)
    with pytest.raises(IsfError) as caught:
        fit_linear(forces, moved, visit, "compliance")
    assert caught.value.code is ErrorCode.MEASUREMENT_FAILED


@pytest.mark.parametrize(("share", "refused"), [(0.0, False), (1.0, False), (4.0, True)])
def test_a_contact_that_softens_is_refused(share: float, refused: bool) -> None:
    """A deflection with a part that goes with the square of the force, ``share`` of the linear one at 300 N.

    The best line leaves 0.0745 share / (1 + share) of the deflection, rms: over 5 % from twice the linear part on.
    """
    forces, moved, visit = readings()
    moved += share * COMPLIANCE[0] * forces[:, 0] ** 2 / 300.0
    if not refused:
        fit = fit_linear(forces, moved, visit, "compliance")
        assert fit.residual < MAXIMUM_RESIDUAL * fit.span
        return
    with pytest.raises(IsfError, match="not linear") as caught:
        fit_linear(forces, moved, visit, "compliance")
    assert caught.value.code is ErrorCode.MEASUREMENT_FAILED
