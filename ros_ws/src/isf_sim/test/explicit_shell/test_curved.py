"""Curved shells against published results of MacNeal 1985; a curved sheet is where normals of neighbours differ."""

from __future__ import annotations

import numpy as np
import pytest
from isf_sim.explicit_shell.shell import Edge, ExplicitShell, Freedom, Sheet

ELASTIC = (np.array([0.0, 1.0]), np.array([1e12, 1e12]))


def cylinder(cells: int, length: float, radius: float, angle: float, sheet: Sheet) -> ExplicitShell:
    """Half the ``length`` of a panel with the axis x, from the crown round by ``angle`` rad; a diaphragm at x = 0,
    planes of symmetry in the middle of the length and at the crown."""
    x, around = np.linspace(0.0, 0.5 * length, cells + 1), np.linspace(0.0, angle * radius, cells + 1)
    shell = ExplicitShell(x, around, sheet, Edge(0.0))
    shell.open_clamp()
    grid_x, grid_around = np.meshgrid(x, around)
    place = (grid_around / radius).ravel()
    shell.state.position[:] = [grid_x.ravel(), radius * np.sin(place), radius * np.cos(place)]
    shell.hold(grid_x == 0.0, Freedom.Y | Freedom.Z)
    shell.hold(grid_x == x[-1], Freedom.X | Freedom.TURN_Y | Freedom.TURN_Z)
    shell.hold(grid_around == 0.0, Freedom.Y | Freedom.TURN_X | Freedom.TURN_Z)
    return shell


@pytest.mark.parametrize(("cells", "within"), [(16, 0.05), (32, 0.015)])
def test_pinched_cylinder_with_end_diaphragms(cells: int, within: float) -> None:
    """An eighth of it; deflection 1.8248e-5 under a load of 1."""
    shell = cylinder(cells, 600.0, 300.0, 0.5 * np.pi, Sheet(3e6, 0.3, 3.0, *ELASTIC, density=1.0))
    side = np.repeat(np.arange(cells + 1) == cells, cells + 1).reshape(cells + 1, cells + 1)
    shell.hold(side, Freedom.Z | Freedom.TURN_X | Freedom.TURN_Y)
    shell.load = np.zeros_like(shell.state.position)
    shell.load[2, cells] = -0.25
    shell.settle(1e-10)
    assert 300.0 - shell.state.position[2, cells] == pytest.approx(1.8248e-5, rel=within)


@pytest.mark.parametrize(("cells", "within"), [(8, 0.05), (16, 0.01)])
def test_roof_under_its_weight(cells: int, within: float) -> None:
    """Scordelis and Lo 1964: a quarter of a roof of 80 deg; deflection of the free edge 0.3024 under 90 per area."""
    angle, radius, small = np.radians(40.0), 25.0, 1e-3  # linear theory
    shell = cylinder(cells, 50.0, radius, angle, Sheet(4.32e8, 0.0, 0.25, *ELASTIC, density=1.0))
    share = np.ones((cells + 1, cells + 1))
    share[[0, -1], :] *= 0.5
    share[:, [0, -1]] *= 0.5
    shell.load = np.zeros_like(shell.state.position)
    shell.load[2] = -small * 90.0 * 25.0 * angle * radius / cells**2 * share.ravel()
    before = shell.state.position[2, -1]
    shell.settle(1e-8)
    assert (before - shell.state.position[2, -1]) / small == pytest.approx(0.3024, rel=within)
