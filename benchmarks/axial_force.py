"""Axial force on a formed wall of the elasto-plastic sheet, by the size of its cells, beside the published regression.

One tool forms a truncated cone in steps of constant depth over a backing plate. The force of a contour is its mean
without the first quarter, where the tool goes down; that of the wall is the mean of the contours from two thirds of the
depth on, without the last one, where it ends. With two sizes of cells or more a straight line is fitted to force over
size; its value at no size is an extrapolation.

usage: ./isf python benchmarks/axial_force.py [--cells 3.5,2.5,1.65] [--speed M/S] [--radius MM] [--angle DEG] [--json]

3.5 / 2.5 / 1.65 / 1 mm take 0.5 / 1.5 / 5 / 20 minutes of one core.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
from typing import Any

import numpy as np
from isf_core.files.material import load_material
from isf_core.process.forming_force import aerens_axial_force
from isf_core.types import Array
from isf_sim.explicit_shell.formed_sheet import sheet_of
from isf_sim.explicit_shell.grid import graded_lines
from isf_sim.explicit_shell.library import LANES
from isf_sim.explicit_shell.shell import Ball, Edge, ExplicitShell, Support
from isf_sim.variant import Variant

ENTRY, FRAME, ROOM = 2e-3, 21e-3, 18e-3
"""m: from the cone to the opening of the plate, from there to the clamp, of even cells outside the cone."""

POINTS = 1e-3
"""m between two points of the path."""

FEWEST = 4
"""Contours with which one lies on the wall: past two thirds of the depth and not the last."""


def make_shell(options: argparse.Namespace, cell: float) -> ExplicitShell:
    """The blank clamped over the plate, the tool above it."""
    radius, opening = 1e-3 * options.radius, 1e-3 * options.radius + ENTRY
    sheet = sheet_of(load_material(options.material), 1e-3 * options.thickness, Variant())
    half = opening + FRAME
    lines = graded_lines(-half, half, (-radius - ROOM, radius + ROOM), cell, max(cell, 9e-3), LANES)
    shell = ExplicitShell(lines, lines, sheet, Edge(), friction=0.08, tool_speed=options.speed, damping=2000.0)
    grid = np.arange(-half, half + 1e-9, 1e-3)
    plate = np.hypot(*np.meshgrid(grid, grid)) >= opening
    shell.set_support(Support(np.where(plate, -0.5 * sheet.thickness, -np.inf), grid[0], grid[0], 1e-3))
    shell.set_tool(0, Ball(1e-3 * options.tool), np.array([0.0, 0.0, 20e-3]))
    return shell


def contour_forces(shell: ExplicitShell, options: argparse.Namespace) -> Array:
    """(contours, 2) N, mean and standard deviation of the axial force around each contour, first quarter left out."""
    tool, angle, away = 1e-3 * options.tool, math.radians(options.angle), np.zeros(3)
    forces = []
    for k in range(1, round(options.depth / options.step) + 1):
        depth = 1e-3 * options.step * k
        around = 1e-3 * options.radius - (depth - tool) / math.tan(angle) - tool / math.sin(angle)
        around = min(around, 1e-3 * options.radius - tool)  # the entry is a rounding of the tool's own radius
        count = max(60, int(2.0 * math.pi * around / POINTS))
        turn = np.linspace(0.0, 2.0 * math.pi, count) + 0.3 * k
        height = np.full(count, 0.5 * shell.sheet.thickness - depth)
        points = np.column_stack([around * np.cos(turn), around * np.sin(turn), height])
        if k == 1:
            shell.place_tools(np.array([points[0] + [0.0, 0.0, depth + 1e-3], away]))
        shell.move(np.array([points[0], away]))
        force = np.array([shell.move(np.array([point, away]))[0, 2] for point in points])
        forces.append((force[count // 4 :].mean(), force[count // 4 :].std()))
    return np.array(forces)


def row(options: argparse.Namespace, cell: float) -> dict[str, Any]:
    """What is printed of a size of cells, ``cell`` m."""
    started = time.process_time()
    shell = make_shell(options, cell)
    forces = contour_forces(shell, options)
    wall = forces[2 * len(forces) // 3 : -1]
    material = load_material(options.material)
    regression = float(
        aerens_axial_force(
            material.tensile_strength,
            1e-3 * options.thickness,
            1e-3 * options.tool,
            1e-3 * options.step,
            math.radians(options.angle),
        )
    )
    return {
        "cell_mm": 1e3 * cell,
        "elements": int(shell.state.thickness.size),
        "force_n": round(float(wall[:, 0].mean())),
        "deviation_n": round(float(wall[:, 1].mean())),
        "regression_n": round(regression),
        "by_contour_n": [round(float(value)) for value in forces[:, 0]],
        "kinetic_over_plastic": shell.kinetic_energy / shell.plastic_work,
        "cpu_s": round(time.process_time() - started),
    }


def main() -> int:
    """Form the cone with each size of cells and print the forces."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cells", default="3.5,2.5,1.65", help="mm, with commas")
    for name, value, unit in (
        ("radius", 22.0, "mm of the cone at the sheet"),
        ("angle", 45.0, "deg of the wall"),
        ("depth", 11.0, "mm"),
        ("tool", 5.0, "mm, radius"),
        ("step", 0.5, "mm of depth"),
        ("thickness", 1.0, "mm"),
        ("speed", 20.0, "m/s of the tool along the sheet"),
    ):
        parser.add_argument(f"--{name}", type=float, default=value, help=f"{unit} (default {value:g})")
    parser.add_argument("--material", default="AA5754-O")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    if round(options.depth / options.step) < FEWEST:
        parser.error(f"the wall needs {FEWEST} contours or more: a larger --depth, or a smaller --step")
    rows = []
    if not options.json:
        print("| cells [mm] | elements | axial force on the wall [N] | regression [N] | ratio | CPU [s] |")
        print("|---|---|---|---|---|---|")
    for cell in options.cells.split(","):
        rows.append(found := row(options, 1e-3 * float(cell)))
        if not options.json:
            print(
                f"| {found['cell_mm']:g} | {found['elements']} | {found['force_n']} +- {found['deviation_n']} "
                f"| {found['regression_n']} | {found['force_n'] / found['regression_n']:.2f} | {found['cpu_s']} |",
                flush=True,
            )
    sizes = [found["cell_mm"] for found in rows]
    line = np.polyfit(sizes, [found["force_n"] for found in rows], 1) if len(set(sizes)) > 1 else None
    none = None if line is None else round(float(line[1]))
    if options.json:
        print(json.dumps({"cells": rows, "force_at_no_size_n": none}))
    elif none is not None:
        ratio = none / rows[0]["regression_n"]
        print(f"| none, along the line | | {none} | {rows[0]['regression_n']} | {ratio:.2f} | |")
    return 0


if __name__ == "__main__":
    sys.exit(main())
