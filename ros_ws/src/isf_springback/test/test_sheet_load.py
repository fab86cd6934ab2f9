"""Which part of the measured forces bends the sheet."""

from dataclasses import replace

import numpy as np
import pytest
from isf_core.errors import ErrorCode, IsfError
from isf_springback.estimators.sheet_model import axial_sheet_load
from springback_parts import cone_contour, result_of


@pytest.mark.parametrize("tool", [1, 2])
def test_the_squeezing_pair_does_not_bend_the_sheet(tool):
    contour = cone_contour(10, tool=tool)
    load = axial_sheet_load(contour, result_of(contour, 500.0, squeeze=150.0))
    # exact up to rounding of forces of a few hundred N
    assert load == pytest.approx(np.full(len(contour), 500.0), abs=1e-9)


@pytest.mark.parametrize("tool", [1, 2])
def test_without_support_reading_the_share_follows_from_the_set_point(tool):
    # F_nz = F_nxy cot(phi) (Ren 2018, 2.3); the set-point of the contour is 120 N
    contour = cone_contour(10, tool=tool)
    result = replace(result_of(contour, 500.0, squeeze=120.0), support_force=np.empty((0, 3)))
    assert axial_sheet_load(contour, result) == pytest.approx(np.full(len(contour), 500.0), abs=1e-9)


def test_single_point_forming_has_no_squeeze():
    contour = replace(cone_contour(10), support_tip=np.empty((0, 3)), support_force=np.empty(0))
    result = replace(result_of(contour, 400.0, squeeze=0.0), support_force=np.empty((0, 3)))
    assert axial_sheet_load(contour, result) == pytest.approx(np.full(len(contour), 400.0))


def test_not_finite_forces_are_named():
    contour = cone_contour(3)
    result = result_of(contour, 400.0)
    result.forming_force[7, 2] = np.nan
    with pytest.raises(IsfError, match="contour 4 point 7") as caught:
        axial_sheet_load(contour, result)
    assert caught.value.code == ErrorCode.CORRECTION_FAILED


def test_forces_of_another_path_are_refused():
    with pytest.raises(IsfError) as caught:
        axial_sheet_load(cone_contour(3), result_of(cone_contour(30), 400.0))
    assert caught.value.code == ErrorCode.NO_FORCE_HISTORY
