"""Press test of the elasto-plastic sheet: a ball pressed into the middle of a flat sheet and lifted off again.

The shape that is left is compared with CalculiX's: an axisymmetric disc of radius 125 mm with four quadratic elements
through its thickness, under a pressure on a patch of radius 3 mm. Slope and deflection are held at the edge, motion in
the plane is free; here the disc lies in a square grid, and its edge is the nodes beyond its radius.

usage: ./isf python benchmarks/press_test.py [--json] [--cell MM] [--speed M/S]
"""

from __future__ import annotations

import argparse
import json
import sys
import time

import numpy as np
from isf_sim.explicit_shell.grid import graded_lines
from isf_sim.explicit_shell.library import LANES
from isf_sim.explicit_shell.shell import Ball, Edge, ExplicitShell, Sheet

PLACES = (0.0, 15.0, 30.0)
"""mm from the tool."""

CALCULIX = {400: (1.152, 0.589, 0.342), 880: (2.781, 1.173, 0.666)}
"""N to mm left at PLACES."""

HALF, EVEN, LARGEST, RADIUS = 0.125, 0.03, 6.0e-3, 5.0e-3
"""m, half the sheet, half of its even region, largest cell, radius of the ball."""


def make_shell(cell: float, speed: float) -> ExplicitShell:
    """A flat sheet, 1 mm thick, with the hardening of the reference."""
    lines = graded_lines(-HALF, HALF, (-EVEN, EVEN), cell, max(cell, LARGEST), LANES)
    strain = np.linspace(0.0, 1.0, 2001)
    sheet = Sheet(70e9, 0.33, 1e-3, strain, 1e6 * (110.0 + 148.0 * (1.0 - np.exp(-strain / 0.06))))
    shell = ExplicitShell(lines, lines, sheet, Edge(1e6), friction=0.05, tool_speed=speed, damping=300.0)
    # held nodes begin half a cell inside the circle, so that the steps of the edge are as much inside as outside
    shell.hold(np.hypot(*np.meshgrid(lines, lines)) > HALF - 0.5 * (lines[1] - lines[0]))
    shell.set_tool(0, Ball(RADIUS), np.array([0.0, 0.0, 0.5e-3]))
    return shell


def pressed(force: float, cell: float, speed: float) -> tuple[float, list[float]]:
    """mm, depth of the middle under ``force`` N, and what is left at PLACES."""
    shell = make_shell(cell, speed)
    away = np.zeros(3)
    tip, found = 0.5e-3, 0.0
    while found < force:
        tip -= 0.02e-3
        found = float(shell.move(np.array([[0.0, 0.0, tip], away]))[0, 2])
    middle = len(shell.y) // 2
    depth = -1e3 * float(shell.z[middle, middle])
    for height in np.linspace(tip, tip + 12e-3, 200):
        shell.move(np.array([[0.0, 0.0, height], away]))
    if (away := shell.settle()) > 0.05e-3:  # m; as for a scan of a formed part
        sys.exit(f"the sheet does not come to rest: {1e3 * away:.2g} mm away from equilibrium")
    left = np.interp(PLACES, 1e3 * shell.x, -1e3 * shell.z[middle])
    return depth, [round(float(value), 3) for value in left]


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--cell", type=float, default=2.5, help="mm")
    parser.add_argument("--speed", type=float, default=5.0, help="m/s of a ball along the sheet, a fiftieth of it down")
    options = parser.parse_args()
    found = {}
    for force, reference in CALCULIX.items():
        started = time.process_time()
        depth, left = pressed(float(force), 1e-3 * options.cell, options.speed)
        found[str(force)] = left
        if not options.json:
            print(f"{force} N: {depth:.2f} mm deep; left at 0, 15, 30 mm: {left}, CalculiX {list(reference)}", end="")
            print(f" ({time.process_time() - started:.0f} s)", flush=True)
    if options.json:
        print(json.dumps(found))
    return 0


if __name__ == "__main__":
    sys.exit(main())
