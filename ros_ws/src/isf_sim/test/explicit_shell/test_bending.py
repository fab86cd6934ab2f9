"""A strip in plane strain against closed forms of an elastic, perfectly plastic plate: springback and limit load.

Poisson's ratio is 0.499, so that elastic and plastic plane strain have the same share of stress across the strip, as
the closed forms assume. Five points through the thickness bear 94.5 % of the moment of a section that is
plastic throughout (the sum of their weights times |z| in place of the integral): the limits leave room for that.
"""

from __future__ import annotations

import numpy as np
import pytest
from isf_sim.explicit_shell.shell import Edge, ExplicitShell, Freedom, Sheet

THICK, CELL, YOUNG, YIELD = 1e-3, 1e-3, 70e9, 100e6
PLANE_MODULUS, PLANE_YIELD = YOUNG / (1.0 - 0.499**2), 2.0 / np.sqrt(3.0) * YIELD
FLAT_CURVE = np.array([0.0, 1.0]), np.array([YIELD, YIELD])


def strip(cells: int) -> ExplicitShell:
    """``cells`` of 1 mm along x, one across; free but for plane strain."""
    x, y = CELL * np.arange(cells + 1), np.array([0.0, CELL])
    shell = ExplicitShell(x, y, Sheet(YOUNG, 0.499, THICK, *FLAT_CURVE), Edge(0.0))
    shell.open_clamp()
    shell.hold(np.ones((2, cells + 1), dtype=bool), Freedom.Y | Freedom.TURN_X | Freedom.TURN_Z)
    return shell


def column(shell: ExplicitShell, number: int) -> np.ndarray:
    """The nodes of one line across the strip, (2, cells + 1)."""
    chosen = np.zeros((2, len(shell.x)), dtype=bool)
    chosen[:, number] = True
    return chosen


def curvature(shell: ExplicitShell) -> float:
    """1/m, of the circle through both ends and the middle."""
    x, _, z = shell.state.position.reshape(3, 2, -1).mean(axis=1)
    ends, middle = np.array([x[-1] - x[0], z[-1] - z[0]]), len(x) // 2
    chord = np.hypot(*ends)
    across = (ends[0] * (z[middle] - z[0]) - ends[1] * (x[middle] - x[0])) / chord
    return float(8.0 * across / (chord**2 + 4.0 * across**2))


@pytest.mark.parametrize("ratio", [2.0, 5.0, 12.0])
def test_springback_of_a_strip_bent_to_a_radius(ratio: float) -> None:
    """Gardiner 1957, 1 - R / R_f = 3 s - 4 s^3 with s = R Y' / (E' t), with Y' and E' of plane strain."""
    shell = strip(16)
    everything = np.ones((2, 17), dtype=bool)
    shell.hold(column(shell, 0), Freedom.ALL)
    shell.hold(everything, Freedom.TURN_Y)
    bent = ratio * 2.0 * PLANE_YIELD / (PLANE_MODULUS * THICK)  # 1/m, in curvatures at which it begins to yield
    steps = 20_000
    shell.state.spin[1] = bent * shell.state.position[0] / (steps * shell.step)
    shell.advance(steps, 4000.0)
    assert curvature(shell) == pytest.approx(bent, rel=0.01)
    loaded, end = curvature(shell), column(shell, -1).ravel()
    shell.state.spin *= -0.5
    while shell.moment[1, end].sum() * shell.state.spin[1, end].sum() > 0.0:  # until it does not want back any more
        shell.advance(100, 4000.0)
    shell.open_clamp()
    shell.hold(everything, Freedom.Y | Freedom.TURN_X | Freedom.TURN_Z)
    shell.hold(column(shell, 0), Freedom.ALL)
    shell.settle(1e-8)
    s = PLANE_YIELD / (bent * PLANE_MODULUS * THICK)
    assert 1.0 - curvature(shell) / loaded == pytest.approx(3.0 * s - 4.0 * s**3, rel=0.07)


def test_strip_on_two_supports_to_its_limit_load() -> None:
    """Prager 1951: deflection of the middle, d / d_e = (P_e / P)^2 (5 - (3 + P / P_e) sqrt(3 - 2 P / P_e)) beyond first
    yield at P_e, and no more than P = 1.5 P_e."""
    cells, half = 40, 40 * CELL
    shell = strip(cells)
    shell.hold(column(shell, 0), Freedom.X | Freedom.Z | Freedom.TURN_Y)  # the middle, which a die presses down
    shell.hold(column(shell, -1), Freedom.Z)
    first_load = PLANE_YIELD * THICK**2 / 6.0 * 2.0 / half * CELL  # N, on both halves of this width
    first = PLANE_YIELD * 2.0 * half**2 / (3.0 * PLANE_MODULUS * THICK)
    steps = 20_000  # per quarter of the deflection at first yield
    shell.state.velocity[2, column(shell, 0).ravel()] = -0.25 * first / (steps * shell.step)
    found = []
    for _ in range(12):
        shell.advance(steps, 2000.0)
        found.append(2.0 * float(shell.force[2, column(shell, 0).ravel()].sum()) / first_load)
    deflection, load = 0.25 * np.arange(1, 13), np.linspace(1.0, 1.5, 1000)
    beyond = (5.0 - (3.0 + load) * np.sqrt(3.0 - 2.0 * load)) / load**2
    wanted = np.where(deflection < 1.0, deflection, np.interp(deflection, beyond, load))
    # the first two still swing from the start
    assert found[2:] == pytest.approx(wanted[2:].tolist(), rel=0.05)
    assert found[-4:] == pytest.approx([1.5] * 4, rel=0.035)
