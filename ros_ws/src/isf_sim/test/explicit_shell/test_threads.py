"""One thread and two compute the same numbers."""

from __future__ import annotations

import os
from typing import Any

import numpy as np
import pytest
from isf_sim.explicit_shell import library
from isf_sim.explicit_shell.shell import Ball, Edge, ExplicitShell, Sheet, Support


def pressed(threads: int) -> ExplicitShell:
    """Two tools press and travel over the edge of a backing plate, the clamp gives way: all that forces come from."""
    strain = np.linspace(0.0, 1.0, 200)
    curve = 1e6 * (110.0 + 148.0 * (1.0 - np.exp(-strain / 0.06)))
    lines = np.linspace(-0.03, 0.03, 20)  # an odd number of rows
    shell = ExplicitShell(lines, lines, Sheet(70e9, 0.33, 1e-3, strain, curve, kinematic=0.3), Edge(1e8, 5e4))
    shell.threads = threads
    grid = np.arange(-0.03, 0.031, 1e-3)
    plate = np.hypot(*np.meshgrid(grid, grid)) >= 0.017
    shell.set_support(Support(np.where(plate, -0.5e-3, -np.inf), grid[0], grid[0], 1e-3))
    for number, side in ((0, 1), (1, -1)):
        shell.set_tool(number, Ball(5e-3, side, compliance=(1e-7, 1e-7, 1e-7)), np.array([0.0, 0.0, side * 0.6e-3]))
    shell.move(np.array([[0.0, 0.0, -1.5e-3], [0.008, 0.0, -1.5e-3]]))
    shell.move(np.array([[0.012, 0.004, -1.5e-3], [0.008, 0.004, -1.5e-3]]))
    shell.settle()
    return shell


def test_two_threads_give_every_bit_of_one() -> None:
    one, two = pressed(1), pressed(2)
    assert one.beside == 0.0
    assert two.beside > 0.0
    assert one.plastic_work > 0.0
    for name, value in vars(one.state).items():
        assert np.array_equal(value, getattr(two.state, name)), name
    assert np.array_equal(one.force, two.force)
    assert np.array_equal(one.tools, two.tools)


def test_a_user_may_ask_for_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ISF_SHELL_THREADS", "1")
    assert library.threads() == 1


def test_where_the_processors_are_wanted_by_others_one_thread_goes_on(monkeypatch: pytest.MonkeyPatch) -> None:
    """Until many calls later, also in the next ones."""
    asked: list[int] = []

    def crowded(_shell: Any, _tools: int, _steps: int, _smoothing: float, threads: int, _cpu: Any) -> int:
        asked.append(threads)
        return int(threads == 2)

    monkeypatch.setattr(library, "advance", lambda: crowded)
    lines = np.linspace(-0.03, 0.03, 20)
    shell = ExplicitShell(lines, lines, Sheet(70e9, 0.33, 1e-3, np.array([0.0, 1.0]), np.array([1e8, 2e8])))
    shell.threads = 2
    for _ in range(3):
        shell.advance(1000)
    assert asked == [2, 1, 1]


def test_a_crowded_processor_changes_no_bit() -> None:
    """Both threads on one processor wait for each other from the first step on, so that one goes on alone."""
    everywhere = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(everywhere)})
    try:
        crowded = pressed(2)
    finally:
        os.sched_setaffinity(0, everywhere)
    alone = pressed(1)
    assert crowded.beside > 0.0
    for name, value in vars(alone.state).items():
        assert np.array_equal(value, getattr(crowded.state, name)), name
