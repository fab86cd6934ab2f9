"""A tool on a machine that gives way, against springs in series: the force is that of a stiff tool where it is."""

from __future__ import annotations

import numpy as np
from isf_sim.explicit_shell.shell import Ball, ExplicitShell, Sheet

GIVES_WAY = np.array([4e-6, 6e-6, 8e-6])
"""m/N; with the contact of this sheet more than an explicit step of the machine would bear."""


def pressed(compliance: np.ndarray, tip: np.ndarray) -> tuple[np.ndarray, float]:
    """N, mean force (3,) on the ball whose machine was brought to ``tip`` (3,) m, and J, largest kinetic energy of the
    sheet at rest; an elastic sheet without friction, so that the way there does not matter."""
    lines = np.linspace(-8e-3, 8e-3, 17)
    sheet = Sheet(70e9, 0.33, 1e-3, np.array([0.0, 1.0]), np.array([1e12, 1e12]))
    shell = ExplicitShell(lines, lines, sheet, friction=0.0, tool_speed=40.0, plunge_speed=20.0, damping=20_000.0)
    shell.set_tool(0, Ball(5e-3, compliance=tuple(compliance)), np.array([tip[0], tip[1], 0.6e-3]))
    away = np.zeros(3)
    for height in np.linspace(0.6e-3, tip[2], 10):
        shell.move(np.array([[tip[0], tip[1], height], away]))
    shell.advance(10_000, 20_000.0)
    forces, kinetic = [], 0.0
    for _ in range(200):
        shell.advance(1, 20_000.0)
        forces.append(shell.tools["mean"][0].copy())
        kinetic = max(kinetic, shell.kinetic_energy)
    assert np.ptp(forces, axis=0).max() < 0.01 * np.linalg.norm(forces, axis=1).max()
    return np.mean(forces, axis=0), kinetic


def test_force_on_a_soft_machine_is_that_of_springs_in_series_also_with_small_cells() -> None:
    tip = np.array([2.5e-3, -1.5e-3, 0.3e-3])
    stiff, _ = pressed(np.zeros(3), tip)
    assert np.abs(stiff).min() > 4.0  # across the sheet and along it
    soft, kinetic = pressed(GIVES_WAY, tip - GIVES_WAY * stiff)
    np.testing.assert_allclose(soft, stiff, rtol=1e-3, atol=1e-4 * np.linalg.norm(stiff))
    assert kinetic < 1e-6  # J
