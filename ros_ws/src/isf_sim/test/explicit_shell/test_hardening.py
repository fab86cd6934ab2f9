"""A share of kinematic hardening after Prager against closed forms of linear hardening."""

from __future__ import annotations

import copy

import numpy as np
import pytest
from isf_sim.explicit_shell.shell import Ball, Edge, ExplicitShell, Freedom, Sheet

YOUNG, POISSON, YIELD, SLOPE = 70e9, 0.33, 100e6, 2e9
CURVE = np.array([0.0, 1.0]), np.array([YIELD, YIELD + SLOPE])


def element(kinematic: float) -> ExplicitShell:
    line = np.array([0.0, 0.01])
    shell = ExplicitShell(line, line, Sheet(YOUNG, POISSON, 1e-3, *CURVE, kinematic=kinematic), Edge(0.0))
    shell.open_clamp()
    shell.hold(np.ones((2, 2), dtype=bool), Freedom.ALL)
    return shell


def stretched(shell: ExplicitShell, strain: float, both: bool, steps: int = 1500) -> float:
    """Pa, stress along x after ``strain`` more, in x and y alike, or in x with no stress in y."""
    rate = strain / (steps * shell.step)
    across = rate
    state, middle = shell.state, 0.005
    for k in range(steps):
        if not both:  # the strain across follows from the stress there
            across = (
                -0.5 * rate if k == 0 else across - 0.5 * state.stress[1, 0] * (1 - POISSON**2) / YOUNG / shell.step
            )
        state.velocity[0] = rate * (state.position[0] - middle)
        state.velocity[1] = across * (state.position[1] - middle)
        shell.advance(1)
    return float(state.stress[0, 0])


@pytest.mark.parametrize("both", [True, False], ids=["in both directions", "in one"])
@pytest.mark.parametrize("share", [0.0, 0.5, 0.9])
def test_pulled_and_pushed_back_it_yields_earlier_by_the_share_that_is_kinematic(share: float, both: bool) -> None:
    """Pulled to the strain e, the stress is Y + H p; back again it yields at that less 2 (Y + (1 - share) H p), and
    both branches have the slope of a hardening H."""
    young, slope = (YOUNG / (1.0 - POISSON), 2.0 * SLOPE) if both else (YOUNG, SLOPE)
    plastic_slope = young * slope / (young + slope)
    pulled = 0.02
    shell = element(share)
    top = YIELD + plastic_slope * (pulled - YIELD / young)
    assert stretched(shell, pulled, both) == pytest.approx(top, rel=2e-3)
    plastic = (pulled - top / young) * (2.0 if both else 1.0)  # equivalent
    assert shell.state.plastic_strain[0, 0] == pytest.approx(plastic, rel=2e-3)
    size = 2.0 * (YIELD + (1.0 - share) * SLOPE * plastic)
    # just before it yields, and well beyond
    before = 0.9 * size / young
    assert stretched(shell, -before, both) == pytest.approx(top - 0.9 * size, abs=0.005 * top)
    assert shell.state.plastic_strain[0, 0] == pytest.approx(plastic, rel=2e-3)
    beyond = 0.01
    wanted = top - size - plastic_slope * (before + beyond - size / young)
    assert stretched(shell, -beyond, both) == pytest.approx(wanted, rel=5e-3)


def new_sheet(kinematic: float) -> ExplicitShell:
    lines = np.linspace(-0.02, 0.02, 9)
    shell = ExplicitShell(lines, lines, Sheet(YOUNG, POISSON, 1e-3, *CURVE, kinematic=kinematic))
    shell.set_tool(0, Ball(5e-3), np.array([0.0, 0.0, 0.5e-3]))
    return shell


def pressed(kinematic: float) -> ExplicitShell:
    shell = new_sheet(kinematic)
    for depth in np.linspace(0.5e-3, -0.5e-3, 10):
        shell.move(np.array([[0.0, 0.0, depth], np.zeros(3)]))
    return shell


def test_without_a_share_it_is_isotropic_bit_for_bit() -> None:
    """A share too small to change any number goes through the kernel of mixed hardening."""
    plain, mixed = pressed(0.0), pressed(1e-300)
    assert plain.plastic_work > 0.01
    assert plain.state.back_stress.shape == (0, 64)
    assert mixed.state.back_stress.shape == (15, 64)
    for name, values in vars(plain.state).items():
        if name != "back_stress":
            assert np.array_equal(values, getattr(mixed.state, name)), name


def test_a_restored_sheet_keeps_its_back_stress() -> None:
    shell = pressed(0.5)
    state, tools = copy.deepcopy(shell.state), shell.tools.copy()
    assert np.abs(state.back_stress).max() > 1e6
    aside = np.array([[2e-3, 0.0, -0.5e-3], np.zeros(3)])
    shell.move(aside)
    assert not np.array_equal(shell.state.back_stress, state.back_stress)
    restored, forgetful = new_sheet(0.5), new_sheet(0.5)
    for sheet in (restored, forgetful):
        sheet.state, sheet.tools = copy.deepcopy(state), tools.copy()
    forgetful.state.back_stress[:] = 0.0
    for sheet in (restored, forgetful):
        sheet.move(aside)
    assert all(
        np.array_equal(a, b) for a, b in zip(vars(restored.state).values(), vars(shell.state).values(), strict=True)
    )
    assert not np.array_equal(forgetful.state.stress, shell.state.stress)
