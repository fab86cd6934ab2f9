"""Forming force against the reference values of Praveen 2020."""

import numpy as np
import pytest
from isf_core.process.forming_force import aerens_axial_force, contact_patch, equilibrium_force, groove_angle

RADIUS, STEP, SHEET = 6.35e-3, 0.5e-3, 0.8e-3


def test_groove_angle() -> None:
    assert np.degrees(groove_angle(STEP, RADIUS)) == pytest.approx(22.89, abs=0.005)


def test_contact_area_at_the_reference_point() -> None:
    """Praveen 2020 eq. 2: 21.67 mm^2 at 60 deg, printed with four digits."""
    assert contact_patch(np.radians(60), RADIUS, STEP).area == pytest.approx(21.67e-6, abs=5e-9)


def test_contact_area_is_continuous_where_wall_and_groove_agree() -> None:
    groove = float(groove_angle(STEP, RADIUS))
    around = contact_patch(np.array([groove - 1e-4, groove, groove + 1e-4]), RADIUS, STEP).area
    assert around[1] == pytest.approx(0.5 * (around[0] + around[2]), rel=1e-6)


@pytest.mark.parametrize(("angle", "axial"), [(25, 351.2), (30, 384.9), (45, 452.5), (60, 433.1)])
def test_axial_force_of_the_reference_table(angle: float, axial: float) -> None:
    """Praveen 2020 eq. 1-3 with the flow curve 144 strain^0.02 MPa; 0.1 % for the table's rounding of the groove
    angle."""
    wall = np.radians(angle)
    strain = 2 / np.sqrt(3) * np.log(1 / np.cos(wall))
    force = equilibrium_force(144e6 * strain**0.02, SHEET * np.cos(wall), wall, RADIUS, STEP)
    assert force.axial == pytest.approx(axial, rel=1e-3)


def test_radial_force_is_never_negative() -> None:
    force = equilibrium_force(144e6, SHEET, np.radians(np.arange(5, 65)), RADIUS, STEP)
    assert (force.radial >= 0).all()


@pytest.mark.parametrize(("angle", "axial"), [(25, 338), (30, 376), (45, 432), (60, 393)])
def test_regression_agrees_with_the_values_quoted_for_it(angle: float, axial: float) -> None:
    """Praveen 2020 eq. 1-3, as whole newtons."""
    assert aerens_axial_force(144e6, SHEET, RADIUS, STEP, np.radians(angle)) == pytest.approx(axial, abs=1.0)
