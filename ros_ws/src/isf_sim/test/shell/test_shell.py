"""Coarse shell against plate theory, the published push on a flat sheet, and its own energy."""

from __future__ import annotations

import numpy as np
import pytest
from isf_sim.shell.shell import Elastic, Shell
from isf_sim.shell.shell_equilibrium import out_of_balance
from numpy.typing import NDArray
from scipy.sparse import csc_matrix

ALUMINIUM = Elastic(70e9, 0.33)
SIZE = (0.25, 0.25)


def dome(shell: Shell, depth: float) -> NDArray[np.float64]:
    """(N,) m, a smooth bowl of ``depth`` m that is flat at the clamp."""
    return np.asarray(
        -depth * np.cos(np.pi * shell.node_x / SIZE[0]) ** 2 * np.cos(np.pi * shell.node_y / SIZE[1]) ** 2
    )


def test_small_load_agrees_with_clamped_plate_theory() -> None:
    """w = 0.0056 F L^2 / D for a clamped square plate under a central point load (Timoshenko, table 37)."""
    shell = Shell(SIZE, SIZE[0] / 32, ALUMINIUM, 1e-3, edge="fixed")
    patch = shell.load_patch(0.0, 0.0, 0.0)
    rigidity = 70e9 * 1e-9 / 12 / (1 - 0.33**2)
    force = 0.1  # deflection 0.005 t: no membrane stiffening yet
    w = -shell.solve(patch, np.array([0.0, 0.0, -force])).state[:, 2].min()
    # 3 %: the load is spread over a patch of 14 mm radius
    assert w == pytest.approx(0.0056 * force * SIZE[0] ** 2 / rigidity, rel=0.03)


@pytest.mark.parametrize(("edge", "sag"), [("free", 5.08e-3), ("fixed", 3.65e-3)])
def test_flat_sheet_under_400_newton(edge: str, sag: float) -> None:
    """Ren 2018, 4.3.2 measured 5.0 mm in the centre (in-plane free edge); values of the converged mesh within 2 %."""
    shell = Shell(SIZE, SIZE[0] / 32, ALUMINIUM, 1e-3, edge=edge)  # type: ignore[arg-type]
    result = shell.solve(shell.load_patch(0.0, 0.0, 0.0), np.array([0.0, 0.0, -400.0]))
    assert result.converged
    assert -result.displacement[2] == pytest.approx(sag, rel=0.02)


def test_force_is_the_gradient_of_energy_and_the_matrix_its_slope() -> None:
    """Central differences of the inner force in a random direction give the tangent (to their truncation, 1e-6)."""
    shell = Shell(SIZE, SIZE[0] / 8, ALUMINIUM, 1e-3)
    shell.set_shape(dome(shell, 0.02), np.full(shell.count, 1e-3))
    problem, room = shell.problem(), shell._room.arrays
    count = len(problem.place)
    random = np.random.default_rng(0)
    q, direction, nothing = 1e-4 * random.standard_normal(count), random.standard_normal(count), np.zeros(count)

    def outward(state: NDArray[np.float64], *, tangent: bool = False) -> NDArray[np.float64]:
        out = np.empty(count)
        out_of_balance(state, nothing, problem, tangent, room, out)
        return out

    step = 1e-7
    difference = (outward(q - step * direction) - outward(q + step * direction)) / (2 * step)
    outward(q, tangent=True)
    matrix = csc_matrix((room.values[:-1], problem.form.rows, problem.form.starts), shape=(count, count))
    predicted = matrix @ direction
    assert difference == pytest.approx(predicted, abs=1e-6 * np.abs(predicted).max())
    assert abs(matrix - matrix.T).max() < 1e-9 * abs(matrix).max()


def test_axial_compliance_is_the_slope_of_the_deflection() -> None:
    """Two solutions 2 % apart in force; their secant agrees with the tangent between them to second order."""
    shell = Shell(SIZE, SIZE[0] / 16, ALUMINIUM, 1e-3)
    shell.set_shape(dome(shell, 0.015), np.full(shell.count, 0.8e-3))
    patch = shell.load_patch(0.02, 0.01, 5e-3)
    low, middle, high = (shell.solve(patch, np.array([0.0, 0.0, -f])) for f in (396.0, 400.0, 404.0))
    secant = -(high.displacement[2] - low.displacement[2]) / 8.0
    # 2 %: both ends are converged to 1e-3 of the load
    assert middle.axial_compliance == pytest.approx(secant, rel=0.02)


def test_start_from_a_near_state_saves_factorisations() -> None:
    shell = Shell(SIZE, SIZE[0] / 16, ALUMINIUM, 1e-3)
    shell.set_shape(dome(shell, 0.015), np.full(shell.count, 0.8e-3))
    cold = shell.solve(shell.load_patch(0.02, 0.0, 5e-3), np.array([0.0, 0.0, -400.0]))
    warm = shell.solve(shell.load_patch(0.02, 0.0, 5e-3), np.array([0.0, 0.0, -420.0]), cold.state)
    again = shell.solve(shell.load_patch(0.02, 0.0, 5e-3), np.array([0.0, 0.0, -420.0]))
    assert warm.factorisations < cold.factorisations
    # both meet the residual tolerance of 1e-3 of the load
    assert warm.displacement == pytest.approx(again.displacement, rel=2e-3, abs=2e-6)
