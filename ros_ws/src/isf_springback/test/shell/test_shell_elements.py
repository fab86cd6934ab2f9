"""The corotational facets: energy gradient, rigid motions, patch test, zero modes."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from isf_springback.shell.corotation import turn_nodes
from isf_springback.shell.elements import make_facets
from isf_springback.shell.sheet_model import LEVER, EdgeCondition, SheetMesh, ShellModel

POINTS = np.array([[0.0, 0.0, 0.0], [10.0, 1.0, 0.5], [3.0, 8.0, 1.0], [12.0, 9.0, -0.4]]) * 1e-3
TRIANGLES = np.array([[0, 1, 2], [1, 3, 2]])
NOBODY = EdgeCondition("supported", 1e-30)
"""An edge that holds nothing: no node stands on it."""


def free_sheet(points=POINTS, triangles=TRIANGLES):
    mesh = SheetMesh(points, triangles, np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64))
    return ShellModel(mesh, np.full(len(triangles), 1e-3), 70e9, 0.33, NOBODY)


def rotation(vector):
    matrix = np.eye(3)[None].copy()
    turn_nodes(matrix, np.asarray(vector, dtype=float)[None])
    return matrix[0]


def deform(model, rng, amount, turn):
    model.moved[:] = amount * 1e-3 * rng.normal(size=model.moved.shape)
    model.rotation[:] = np.eye(3)
    turn_nodes(model.rotation, amount * rng.normal(size=model.moved.shape))
    whole = rotation(turn)
    model.moved[:] = (model.mesh.points + model.moved) @ whole.T - model.mesh.points
    model.rotation[:] = whole @ model.rotation


def internal_work(model, change):
    """Difference of energy for a small change of the free unknowns, by central differences."""
    state = model.moved.copy(), model.rotation.copy()
    energies = []
    for sign in (1.0, -1.0):
        model.moved[:], model.rotation[:] = state
        model.step(sign * change)
        energies.append(model.evaluate())
    model.moved[:], model.rotation[:] = state
    return 0.5 * (energies[0] - energies[1])


@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 1000), turn=st.tuples(*[st.floats(-1.2, 1.2)] * 3))
def test_internal_force_is_the_gradient_of_the_energy(seed, turn):
    rng = np.random.default_rng(seed)
    model = free_sheet()
    deform(model, rng, 0.05, turn)
    model.evaluate()
    force = model.internal[model.free] * np.where(model.free % 6 < 3, 1.0, 1.0 / LEVER)
    difference = np.array([internal_work(model, 1e-8 * row) / 1e-8 for row in np.eye(len(model.free))])
    assert np.abs(difference - force).max() < 2e-7 * np.abs(force).max()


@settings(max_examples=20, deadline=None)
@given(turn=st.tuples(*[st.floats(-1.5, 1.5)] * 3), shift=st.tuples(*[st.floats(-1.0, 1.0)] * 3))
def test_rigid_motion_strains_nothing(turn, shift):
    model = free_sheet()
    whole = rotation(turn)
    model.moved[:] = POINTS @ whole.T - POINTS + np.array(shift)
    model.rotation[:] = whole
    model.evaluate()
    model_stiffness = 70e9 * 1e-3 * 10e-3  # N per unit strain
    assert np.abs(model.internal).max() < 1e-9 * model_stiffness


def test_tangent_steers_and_has_six_zero_modes():
    model = free_sheet()
    model.evaluate(tangent=True)
    tangent = model.tangent().toarray()
    assert np.abs(tangent - tangent.T).max() < 1e-12 * np.abs(tangent).max()
    values = np.linalg.eigvalsh(tangent)
    assert (np.abs(values) < 1e-9 * values[-1]).sum() == 6
    assert values[6] > 1e-7 * values[-1]


def test_tangent_is_close_to_the_differences_of_the_force():
    model = free_sheet()
    deform(model, np.random.default_rng(1), 0.01, (0.4, 0.3, -0.2))
    unit = np.where(model.free % 6 < 3, 1.0, 1.0 / LEVER)
    model.evaluate(tangent=True)
    tangent = model.tangent().toarray()
    state = model.moved.copy(), model.rotation.copy()
    columns = []
    for row in np.eye(len(model.free)):
        forces = []
        for sign in (1.0, -1.0):
            model.moved[:], model.rotation[:] = state
            model.step(sign * 1e-8 * row)
            model.evaluate()
            forces.append(model.internal[model.free] * unit)
        columns.append((forces[0] - forces[1]) / 2e-8)
    difference = np.array(columns)
    symmetric = 0.5 * (difference + difference.T)
    # the derivative of the rotation vector's Jacobian is left out: an error of the order of the strain
    assert np.abs(tangent - symmetric).max() < 2e-3 * np.abs(symmetric).max()


def test_constant_strain_and_constant_curvature_are_met_exactly():
    """Patch tests: u = (e x, -nu e y) needs no side forces; curvature k about y gives the plate's energy."""
    strain, curvature, thickness = 1e-6, 1e-3, 1e-3
    points = np.array([[0, 0, 0], [9, 0, 0], [10, 8, 0], [0, 7, 0], [4, 3, 0]]) * 1e-3
    triangles = np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]])
    model = free_sheet(points, triangles)
    model.moved[:, 0] = strain * points[:, 0]
    model.moved[:, 1] = -0.33 * strain * points[:, 1]
    x, y = points[:4, 0], points[:4, 1]
    area = 0.5 * float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))
    assert model.evaluate() == pytest.approx(0.5 * 70e9 * strain**2 * area * thickness, rel=1e-4)
    assert np.abs(model.internal.reshape(-1, 6)[4]).max() < 1e-4 * np.abs(model.internal).max()

    model.moved[:] = 0.0
    model.moved[:, 2] = 0.5 * curvature * points[:, 0] ** 2
    turn_nodes(model.rotation, np.column_stack([np.zeros(5), -curvature * points[:, 0], np.zeros(5)]))
    stiffness = 70e9 * thickness**3 / (12 * (1 - 0.33**2))
    assert model.evaluate() == pytest.approx(0.5 * stiffness * curvature**2 * area, rel=1e-3)


def test_drilling_is_resisted_and_thickness_scales_stiffness():
    thin = make_facets(POINTS, TRIANGLES, np.full(2, 1e-3), 70e9, 0.33)
    thick = make_facets(POINTS, TRIANGLES, np.full(2, 2e-3), 70e9, 0.33)
    assert np.allclose(thick.membrane, 2 * thin.membrane)
    assert np.allclose(thick.bending, 8 * thin.bending)
    assert (np.linalg.eigvalsh(thin.membrane) > 0).all()
    assert (np.linalg.eigvalsh(thin.bending) > 0).all()
