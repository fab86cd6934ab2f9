"""The shell element against exact states and a published structure; none of it shares the element's own formulas."""

from __future__ import annotations

import numpy as np
import pytest
from isf_sim.explicit_shell.shell import Ball, Edge, ExplicitShell, Freedom, Sheet

ELASTIC = (np.array([0.0, 1.0]), np.array([1e12, 1e12]))
STEEL = Sheet(210e9, 0.3, 1e-3, *ELASTIC, density=7800.0)


def free_shell(lines_x: np.ndarray, lines_y: np.ndarray, sheet: Sheet) -> ExplicitShell:
    """Nothing is held."""
    shell = ExplicitShell(lines_x, lines_y, sheet, Edge(0.0), damping=0.0)
    shell.open_clamp()
    return shell


def distorted(shell: ExplicitShell) -> None:
    """Move the inner nodes in the plane by up to a tenth of a cell, with no stress."""
    shape = len(shell.y), len(shell.x)
    inner = np.zeros(shape, dtype=bool)
    inner[1:-1, 1:-1] = True
    random = np.random.default_rng(1)
    for axis, line in enumerate((shell.x, shell.y)):
        shift = 0.1 * np.diff(line).min() * random.uniform(-1.0, 1.0, shape)
        shell.state.position[axis] += np.where(inner, shift, 0.0).ravel()


def test_constant_strain_on_a_distorted_mesh_gives_constant_stress_in_equilibrium() -> None:
    shell = free_shell(np.linspace(0, 0.05, 6), np.linspace(0, 0.04, 5), STEEL)
    distorted(shell)
    gradient = np.array([[3.0, 1.0], [0.5, -2.0]])  # 1/s
    shell.state.velocity[:2] = gradient @ shell.state.position[:2]
    shell.advance(1)
    young, nu = 210e9, 0.3
    exx, eyy, gxy = (rate * shell.step for rate in (3.0, -2.0, 1.5))
    wanted = young / (1 - nu**2) * np.array([exx + nu * eyy, eyy + nu * exx, 0.5 * (1 - nu) * gxy])
    stress = shell.state.stress.reshape(5, 3, -1)
    # The frame of a distorted element is turned in the plane: compare invariants.
    assert stress[:, 0] + stress[:, 1] == pytest.approx(wanted[0] + wanted[1], rel=1e-9)
    radius = np.hypot(0.5 * (stress[:, 0] - stress[:, 1]), stress[:, 2])
    assert radius == pytest.approx(np.hypot(0.5 * (wanted[0] - wanted[1]), wanted[2]), rel=1e-9)
    inner = np.zeros((5, 6), dtype=bool)
    inner[1:-1, 1:-1] = True
    force = shell.force[:2]
    assert np.abs(force[:, inner.ravel()]).max() < 1e-9 * np.abs(force).max()


def test_turning_as_a_whole_gives_no_stress_even_when_warped() -> None:
    shell = free_shell(np.linspace(0, 0.05, 6), np.linspace(0, 0.04, 5), STEEL)
    x, y, z = shell.state.position
    z[:] = 30.0 * x * y
    spin = np.array([200.0, -300.0, 500.0])  # 1/s
    shell.state.velocity[:] = np.cross(spin, shell.state.position.T).T
    shell.state.spin[:] = spin[:, None]
    shell.advance(1)
    one_radian_per_second = 210e9 * shell.step  # stress of a strain rate as large as a spin of 1/s
    assert np.abs(shell.state.stress).max() < 1e-6 * 600.0 * one_radian_per_second


@pytest.mark.parametrize(("root", "published"), [(0.0, 1.754e-3), (-0.5 * np.pi, 5.424e-3)])
@pytest.mark.parametrize(("cells", "within"), [(2, 0.06), (4, 0.015)])
def test_twisted_beam(root: float, published: float, cells: int, within: float) -> None:
    """MacNeal 1985: a strip twisted by 90 deg, loaded by 1 at
    its tip across and along the tip's width."""
    length, width, thick, young = 12.0, 1.1, 0.32, 29e6
    x, y = np.linspace(0, length, 6 * cells + 1), np.linspace(-0.5 * width, 0.5 * width, cells + 1)
    shell = free_shell(x, y, Sheet(young, 0.22, thick, *ELASTIC, density=1.0))
    grid_x, grid_y = np.meshgrid(x, y)
    angle = root + 0.5 * np.pi * grid_x / length
    position = shell.state.position
    position[:] = [grid_x.ravel(), (grid_y * np.cos(angle)).ravel(), (grid_y * np.sin(angle)).ravel()]
    shell.hold(grid_x == 0.0, Freedom.ALL)
    share = np.ones(cells + 1)
    share[[0, -1]] = 0.5
    tip = np.arange(grid_x.size).reshape(grid_x.shape)[:, -1]
    shell.load = np.zeros_like(position)
    shell.load[1, tip] = share / share.sum()
    before = position[1][tip].mean()
    lowest = 3.516 * np.sqrt(young * thick**2 / 12.0 / length**4)
    shell.advance(round(12.0 / lowest / shell.step), 1.4 * lowest)
    assert position[1][tip].mean() - before == pytest.approx(published, rel=within)


def test_stretched_alike_in_both_directions_it_follows_the_flow_curve_and_keeps_its_volume() -> None:
    strain = np.linspace(0.0, 1.0, 500)
    curve = 1e6 * (110.0 + 148.0 * (1.0 - np.exp(-strain / 0.06)))
    shell = free_shell(np.linspace(0, 0.02, 3), np.linspace(0, 0.02, 3), Sheet(70e9, 0.33, 1e-3, strain, curve))
    middle = np.array([0.01, 0.01])[:, None]
    shell.hold(np.ones((3, 3), dtype=bool), Freedom.ALL)
    rate = 1e-4 / shell.step
    for _ in range(2000):
        shell.state.velocity[:2] = rate * (shell.state.position[:2] - middle)
        shell.advance(1)
    stress = shell.state.stress.reshape(5, 3, -1)
    stretch = np.ptp(shell.state.position[0]) / 0.02
    plastic = 2.0 * np.log(stretch) - 2.0 * 0.67 * stress[0, 0, 0] / 70e9  # equivalent: that of the thickness
    assert shell.state.plastic_strain == pytest.approx(plastic, rel=2e-3)
    wanted = 1e6 * (110.0 + 148.0 * (1.0 - np.exp(-plastic / 0.06)))
    assert stress[:, :2] == pytest.approx(wanted, rel=2e-3)
    elastic = np.exp(2.0 * (1.0 - 2.0 * 0.33) / 70e9 * stress[0, 0, 0])
    assert shell.state.thickness == pytest.approx(elastic * 1e-3 / stretch**2, rel=2e-3)


def test_the_same_again_bit_for_bit_also_from_a_copy() -> None:
    def pressed() -> ExplicitShell:
        lines = np.linspace(-0.02, 0.02, 11)
        shell = ExplicitShell(lines, lines, Sheet(70e9, 0.33, 1e-3, np.array([0.0, 1.0]), np.array([1e8, 2e8])))
        shell.set_tool(0, Ball(5e-3), np.array([0.0, 0.0, 0.5e-3]))
        return shell

    one, other = pressed(), pressed()
    far = np.zeros(3)
    for shell in (one, other):
        for depth in np.linspace(0.5e-3, -0.5e-3, 20):
            force = shell.move(np.array([[0.0, 0.0, depth], far]))
    assert force[0, 2] > 50.0
    saved = one.state.position.copy()
    for shell in (one, other):
        shell.move(np.array([[2e-3, 0.0, -0.5e-3], far]))
    assert all(np.array_equal(a, b) for a, b in zip(vars(one.state).values(), vars(other.state).values(), strict=True))
    assert not np.array_equal(saved, one.state.position)
