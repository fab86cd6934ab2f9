"""Quadratic programs of the model-predictive controllers against small problems solved by hand (Lu 2016, 3.2 to 3.4).

The vectors follow from the published equations by hand (weights 0.2 and 0.7, horizon 6); lengths in mm.
"""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import MpcSpec
from isf_springback.estimators.mpc_problem import (
    BoxProblem,
    horizontal_problem,
    scalar_vertical_problem,
    solve,
    solve_coupled,
    vertical_problem,
    zone_coefficients,
)
from isf_springback.estimators.mpc_state import distribute
from scipy.optimize import lsq_linear

FREE = 100.0


def test_zones_rise_from_the_contact_to_the_next():
    reach = np.arange(8.0, 17.0)
    assert zone_coefficients(reach, 10.0, 14.0) == pytest.approx([0, 0, 0, 0.25, 0.5, 0.75, 1, 1, 1])
    assert zone_coefficients(reach, 10.0, 10.0) == pytest.approx((reach >= 10.0).astype(float))


def test_profile_vector():
    """n = 5, horizon 2: Hessian, gradient, minimiser with and without a bound."""
    b = np.array([[0, 0.5, 1, 1, 1], [0, 0, 0.5, 1, 1]])
    y = np.array([0, -0.8, -1.6, -1.6, -1.6])
    w = np.array([[0, -1, -2, -3, -3], [0, -1, -2, -4, -4]], dtype=float)
    problem = vertical_problem(b, y, w, 0.2, -FREE, FREE)
    assert problem.hessian == pytest.approx(np.array([[13.4, 5.0], [5.0, 4.9]]))
    assert problem.gradient[0] == pytest.approx([17.2, 10.0])
    assert solve(problem)[0] == pytest.approx([-0.843089, -1.180521], abs=1e-6)
    assert solve(vertical_problem(b, y, w, 0.2, -1.0, FREE))[0] == pytest.approx([-0.910448, -1.0], abs=1e-6)


def test_unknown_profile_points_do_not_count():
    b = np.array([[0, 0.5, 1, 1, 1, 1.0], [0, 0, 0.5, 1, 1, 1.0]])
    y = np.array([0, -0.8, -1.6, -1.6, -1.6, np.nan])
    w = np.array([[0, -1, -2, -3, -3, -9], [0, -1, -2, -4, -4, -9]], dtype=float)
    assert solve(vertical_problem(b, y, w, 0.2, -FREE, FREE))[0] == pytest.approx([-0.843089, -1.180521], abs=1e-6)


@pytest.mark.parametrize(
    ("level", "first"), [(-10.0, -0.999989), (-9.5, -1.427040), (-9.0, -1.854091), (-10.3, -0.743758), (-7.0, -2.0)]
)
def test_bottom_point_vector(level, first):
    targets = -np.arange(11.0, 17.0)[None, :]
    inputs = solve(scalar_vertical_problem(np.array([level]), targets, 0.2, -2.0, -0.5))[0]
    assert inputs[0] == pytest.approx(first, abs=1e-5)
    if level == -7.0:
        assert inputs == pytest.approx([-2, -2, -1.853583, -1.121495, -0.996885, -0.856698], abs=1e-5)


@pytest.mark.parametrize(("error", "move"), [(0.3, 0.203434), (0.5, 0.339056), (0.7, 0.474679), (0.8, 0.5), (3.0, 0.5)])
def test_horizontal_first_move(error, move):
    found = solve(horizontal_problem(np.full((1, 6), -error), 0.7, 0.5))[0]
    assert found[0] == pytest.approx(move, abs=1e-6)
    if error == 3.0:
        assert found == pytest.approx([0.5] * 5 + [0.294118], abs=1e-6)


def test_accumulated_corrections_vanish_and_forgotten_ones_do_not():
    """Springback of 1.5 mm, |departure| <= 0.5 mm."""
    residual, total = [], 0.0
    for _ in range(4):
        error = -1.5 + total
        total += solve(horizontal_problem(np.full((1, 6), error), 0.7, 0.5))[0, 0]
        residual.append(1.5 - total)
    assert residual == pytest.approx([1.0, 0.5, 0.161, 0.052], abs=1e-3)


def test_the_reference_cone_settles_as_computed():
    """Cone of 50 deg, 30 mm, 15 steps of 2 mm, springback 3 (1 - exp(-depth / 2.5)), three contours open loop.

    The bottom alone as state with a weight that is small against its points reproduces the published narrative: the
    error shrinks from step 3 to 7 and stays within 0.2 mm.
    """
    count, points, step = 15, 40, 2.0
    z, errors = 0.0, []
    for k in range(count):
        if k < 3:
            z -= step
        else:
            horizon = min(6, count - k)
            b = np.ones((horizon, points))
            y = np.full(points, errors[-1] - step * k)
            targets = np.repeat(-step * (k + 1 + np.arange(horizon))[:, None], points, axis=1)
            z += solve(vertical_problem(b, y, targets, 0.2, -2.7, -0.5))[0, 0]
        errors.append(z + 3.0 * (1 - np.exp(z / 2.5)) + step * (k + 1))
    assert errors[:3] == pytest.approx([1.652, 2.394, 2.728], abs=2e-3)
    assert errors[3:7] == pytest.approx([2.208, 1.569, 0.889, 0.196], abs=0.02)
    assert np.abs(errors[6:]).max() < 0.2
    assert np.abs(errors[8:]).max() < 0.02


@given(st.integers(0, 10_000))
@settings(max_examples=25, deadline=None)
def test_many_directions_at_once_equal_one_by_one(seed):
    rng = np.random.default_rng(seed)
    problem = horizontal_problem(rng.normal(0, 1.5, (12, 6)), 0.7, 0.5)
    together = solve(problem)
    root = np.linalg.cholesky(problem.hessian).T
    for m in range(12):
        one = lsq_linear(root, -np.linalg.solve(root.T, problem.gradient[m]), bounds=(-0.5, 0.5), method="bvls").x
        assert together[m] == pytest.approx(one, abs=1e-6)
    assert (np.abs(together) <= 0.5 + 1e-12).all()


def test_piqp_gives_the_same():
    pytest.importorskip("piqp")
    problem = horizontal_problem(np.random.default_rng(0).normal(0, 1e-3, (5, 6)), 0.7, 0.5e-3)
    assert solve(problem, "piqp") == pytest.approx(solve(problem), abs=5e-7)


@pytest.mark.parametrize("fault", ["nan", "bounds", "singular"])
def test_a_problem_without_solution_is_refused(fault):
    problem = horizontal_problem(np.ones((2, 3)), 0.7, 0.5)
    hessian, gradient, lower = problem.hessian.copy(), problem.gradient.copy(), problem.lower.copy()
    if fault == "nan":
        gradient[0, 0] = np.nan
    elif fault == "bounds":
        lower[1, 1] = 1.0
    else:
        hessian[:] = 0.0
    with pytest.raises(IsfError) as caught:
        solve(BoxProblem(hessian, gradient, lower, problem.upper))
    assert caught.value.code == ErrorCode.QP_INFEASIBLE
    assert caught.value.advice


def square(count=720, half=50.0):
    angle = 2 * np.pi * np.arange(count) / count
    return angle, half / np.maximum(np.abs(np.cos(angle)), np.abs(np.sin(angle)))


@pytest.mark.parametrize(
    ("kind", "weights"),
    [
        ("uniform", [0.7071, 0.7180, 0.7525, 0.8165, 0.9231, 1.0]),
        ("interpolated", [0.0, 0.0267, 0.1166, 0.3049, 0.6806, 1.0]),
    ],
)
def test_distributions_on_a_square_pyramid(kind, weights):
    """Part of the corner's correction that other directions get (eq. 25 and 30)."""
    angle, radius = square()
    spread = distribute(np.array([1.0]), np.radians([45.0]), angle, radius, kind)
    found = np.interp(np.radians([0, 10, 20, 30, 40, 45]), angle, spread)
    assert found == pytest.approx(weights, abs=2e-3)


def test_several_directions_keep_their_values_and_never_overshoot():
    angle = 2 * np.pi * np.arange(360) / 360
    radius = 60.0 + 8.0 * np.cos(angle)  # an eccentric opening: not monotone between 90 and 270 deg
    directions = np.radians([0.0, 45.0, 90.0, 180.0, 270.0])
    departure = np.array([0.5, 0.3, 0.1, 0.4, 0.1])
    spread = distribute(departure, directions, angle, radius, "interpolated")
    assert np.interp(directions, angle, spread) == pytest.approx(departure, abs=5e-3)
    assert spread.max() < 0.55
    assert spread.min() > 0.05


@pytest.mark.parametrize("solver", ["scipy", "piqp"])
def test_coupled_moves_keep_slope_and_offset(solver):
    if solver == "piqp":
        pytest.importorskip("piqp")
    options = MpcSpec(coupled=True, solver=solver)
    steps, angle = np.full(6, -1e-3), np.radians([50.0, 50.0])
    error = np.array([np.full(6, -0.4e-3), np.full(6, 0.4e-3)])
    move = solve_coupled(error, angle, steps, np.zeros(7), options)
    # under-formed: outwards; over-formed: inwards; never more than the bound
    assert 0.05e-3 < move[0] <= 0.5e-3
    assert -0.5e-3 <= move[1] < -0.05e-3


def test_both_solvers_agree_on_the_coupled_problem():
    pytest.importorskip("piqp")
    rng = np.random.default_rng(4)
    error, angle = rng.normal(0, 1e-3, (6, 6)), np.radians(rng.uniform(35, 60, 6))
    vertical = np.linspace(0.3e-3, 0.0, 7)
    moves = [
        solve_coupled(error, angle, np.full(6, -1e-3), vertical, MpcSpec(coupled=True, solver=s))
        for s in ("scipy", "piqp")
    ]
    assert moves[0] == pytest.approx(moves[1], abs=2e-6)
