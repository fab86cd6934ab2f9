"""The fit of the identification on synthetic readings: outliers are left out, what is not linear is refused."""

from __future__ import annotations

import numpy as np
import pytest
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.rig import load_rig
from isf_core.types import Array
from isf_identify.fits import MAXIMUM_RESIDUAL, fit_linear, without_arm
from isf_identify.rig_piece import arm_part
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


def test_the_arm_is_taken_off_what_is_measured_at_the_tip() -> None:
    """4.20, 2.84 and 0.45 um/N at the tip, of which the arm takes 4.15, 2.84 and nothing; z is of another kind."""
    value, deviation = np.array([4.20e-6, 2.84e-6, 0.45e-6]), np.array([0.01e-6, 0.02e-6, 0.5e-6])
    arm = np.array([4.15e-6, 2.84e-6, 0.0])
    alone, left, how = without_arm(arm, value, deviation, ["measured"] * 3)
    assert alone == pytest.approx([0.05e-6, np.nan, 0.45e-6], nan_ok=True)
    assert left == pytest.approx([0.01e-6, np.nan, 0.5e-6], nan_ok=True)
    assert how[0] == "measured; 4.1500 um/N of the arm taken off"
    assert how[1].startswith("not observable: 0.0000 +- 0.0200 um/N are left")
    assert how[2] == "measured"
    assert value[1] == 2.84e-6


def test_arms_of_a_rig_are_known_and_axes_have_none() -> None:
    """Levers and drives of the pair of robots by hand: 4.149, 2.840 and 0.391 um/N at the middle of the sheet."""
    assert arm_part(load_rig("kr210_pair"), 2) == pytest.approx([4.149e-6, 2.840e-6, 0.391e-6], abs=0.001e-6)
    assert arm_part(load_rig("kr210_arm"), 2).tolist() == [0.0, 0.0, 0.0]
