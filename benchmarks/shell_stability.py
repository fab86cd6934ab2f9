"""Largest eigenvalues of the elasto-plastic sheet against its time step, from the forces of its own kernels.

Nodes are moved and turned a little, many that do not see each other at once, and what changes of the forces gives the
tangent: elements with their present stress, hourglass and drilling stiffness, and contact. Yielding is left out, which
makes a sheet softer. Central differences are stable below 4.

usage: ./isf python benchmarks/shell_stability.py [--cells 2.5,1,0.3] [--largest MM] [--pressed N]
"""

from __future__ import annotations

import argparse
import copy

import numpy as np
from isf_core.types import Array
from isf_sim.explicit_shell.grid import graded_lines
from isf_sim.explicit_shell.library import LANES
from isf_sim.explicit_shell.shell import Ball, Edge, ExplicitShell, Freedom, Sheet
from scipy.sparse import csr_matrix, diags
from scipy.sparse.linalg import eigs

SEES = 3
"""Nodes in each direction that a node can act on: the smooth surface of contact takes four in a row."""

SHIFT, TURN = 1e-8, 1e-5
"""m and rad by which nodes are moved and turned."""


def make_shell(cell: float, largest: float) -> ExplicitShell:
    """A clamped sheet 1 mm thick, 20 cells even in the middle, a ball of 5 mm above it; ``cell``, ``largest`` m."""
    half = 10.0 * cell
    edge = half + 4.0 * largest
    lines = graded_lines(-edge, edge, (-half, half), cell, largest, LANES)
    strain = np.linspace(0.0, 1.0, 2001)
    sheet = Sheet(70e9, 0.33, 1e-3, strain, 1e6 * (110.0 + 148.0 * (1.0 - np.exp(-strain / 0.06))))
    shell = ExplicitShell(lines, lines, sheet, Edge(1e6), tool_speed=20.0)
    shell.set_tool(0, Ball(5e-3), np.array([0.0, 0.0, 0.5e-3]))
    return shell


def press(shell: ExplicitShell, force: float) -> None:
    """Press the ball into the middle until it bears ``force`` N."""
    tip, found = 0.5e-3, 0.0
    while found < force:
        tip -= 0.04e-3
        found = float(shell.move(np.array([[0.0, 0.0, tip], np.zeros(3)]))[0, 2])


def largest_eigenvalues(shell: ExplicitShell, count: int = 2) -> Array:
    """(count,), complex, of tangent over masses, times the square of the time step."""
    tangent = _tangent(copy.deepcopy(shell))
    free = np.flatnonzero([shell._fixed & (1 << d) == 0 for d in range(6)])
    root = diags(np.sqrt(np.concatenate([shell._per_mass] * 3 + [shell._per_inertia] * 3)[free]))
    scaled = root @ tangent[free][:, free] @ root * shell.step**2
    return np.asarray(eigs(scaled, k=count, which="LM", tol=1e-6, return_eigenvectors=False))


def _tangent(shell: ExplicitShell) -> csr_matrix:
    """(6 n, 6 n) N/m, N, N m: what forces and moments fall by per shift and turn of each node."""
    shell.hold(np.ones(shell.z.shape, dtype=bool), Freedom.ALL)  # what is held keeps the velocity it is given
    shell._flow = 1e4 * shell._flow
    shell._built = None
    start = {name: array.copy() for name, array in vars(shell.state).items()}
    ny, nx = shell.z.shape
    row, column = np.divmod(np.arange(nx * ny), nx)

    def forces(moved: Array) -> Array:
        for name, array in start.items():
            getattr(shell.state, name)[...] = array
        shell.state.velocity[:], shell.state.spin[:] = moved[:3] / shell.step, moved[3:] / shell.step
        shell.advance(1)
        shell.state.velocity[:], shell.state.spin[:] = 0.0, 0.0
        shell.advance(1)
        return np.concatenate([shell.force.ravel(), shell.moment.ravel()])

    apart = 2 * SEES + 1
    rows, columns, values = [], [], []
    for colour in range(apart**2):
        chosen = np.flatnonzero((row % apart == colour // apart) & (column % apart == colour % apart))
        for d in range(6):
            moved = np.zeros((6, nx * ny))
            moved[d, chosen] = SHIFT if d < 3 else TURN
            fall = (forces(-moved) - forces(moved)) / (2.0 * (SHIFT if d < 3 else TURN))
            for node in chosen:
                j, i = row[node], column[node]
                near = np.arange(max(0, j - SEES), min(ny, j + SEES + 1))[:, None] * nx + np.arange(
                    max(0, i - SEES), min(nx, i + SEES + 1)
                )
                place = (np.arange(6)[:, None] * nx * ny + near.ravel()).ravel()
                rows.append(place)
                columns.append(np.full(place.size, d * nx * ny + node))
                values.append(fall[place])
    size = 6 * nx * ny
    return csr_matrix((np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))), shape=(size, size))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cells", default="2.5,1,0.3", help="mm, with commas")
    parser.add_argument("--largest", type=float, default=0.0, help="mm, cells outside the middle; 0: twice as large")
    parser.add_argument("--pressed", type=float, default=0.0, help="N on the ball")
    options = parser.parse_args()
    print("| cells [mm] | nodes | largest eigenvalue (limit 4) | imaginary part |\n|---|---|---|---|")
    for cell in (1e-3 * float(text) for text in options.cells.split(",")):
        shell = make_shell(cell, 1e-3 * options.largest or 2.0 * cell)
        if options.pressed > 0.0:
            press(shell, options.pressed)
        found = largest_eigenvalues(shell)
        largest = found[np.argmax(np.abs(found))]
        print(f"| {1e3 * cell:g} | {shell.z.size} | {largest.real:.3f} | {abs(largest.imag):.1g} |", flush=True)


if __name__ == "__main__":
    main()
