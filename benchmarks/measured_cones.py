"""Twelve cones that were formed and scanned in a laboratory, formed anew on the elasto-plastic sheet.

benchmarks/data/spif_cones_measured.csv holds the profiles: single-point incremental forming, opening radius 50 mm,
walls of 40 to 70 deg, tools of 12 and 16 mm, depth steps of 0.3 and 0.7 mm (M. F. Gralha, master's thesis on geometric
compensation of SPIF, Lisbon; median over 4 scans of 8 half-sections each, zero at the flange). Material, thickness, and
the openings of backing plate and clamp are not known: they are chosen on the cones FITTED and frozen for the others.

usage: ./isf python benchmarks/measured_cones.py [--parts III,XXI] [--cell MM] [--speed M/S] [--jobs N] [--json]
       ./isf python benchmarks/measured_cones.py --parts III,XXI --set plate=58 --set thickness=2   (other unknowns)

A cone takes 1 to 10 minutes of one core.
"""

from __future__ import annotations

import argparse
import csv
import json
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from isf_core.types import Array
from isf_sim.explicit_shell.grid import graded_lines
from isf_sim.explicit_shell.library import LANES
from isf_sim.explicit_shell.shell import Ball, Edge, ExplicitShell, Sheet, Support

HERE = Path(__file__).resolve().parent
FITTED = ("III", "XXI")
"""Cones on which what is not known was chosen."""

OPENING, HALF, EVEN = 50e-3, 80e-3, 58e-3
"""m: radius of the cones, half of the sheet, half of the region of even cells."""

OUTERMOST = 70.0
"""mm, radius up to which profiles are compared."""


@dataclass(frozen=True)
class Unknowns:
    """What is not printed, mm and MPa; aluminium with Swift's curve through yield and tensile strength."""

    plate: float = 57.5
    clamp: float = 62.0
    thickness: float = 2.0
    yield_strength: float = 60.0
    tensile_strength: float = 110.0
    exponent: float = 0.2


@dataclass
class Cone:
    """A measured cone: wall angle deg, height, step and tool diameter mm; profile (n, 3): radius, depth, scatter mm."""

    name: str
    angle: float
    height: float
    step: float
    tool: float
    rows: list[tuple[float, float, float]] = field(default_factory=list)

    @property
    def profile(self) -> Array:
        return np.array([row for row in self.rows if row[0] < OUTERMOST])


def load_cones() -> dict[str, Cone]:
    """Cones of the file by name."""
    cones: dict[str, Cone] = {}
    with (HERE / "data" / "spif_cones_measured.csv").open(encoding="utf-8") as file:
        for row in csv.DictReader(file):
            cone = cones.setdefault(
                row["part"],
                Cone(
                    row["part"],
                    float(row["wall_angle_deg"]),
                    float(row["height_mm"]),
                    float(row["step_mm"]),
                    float(row["tool_diameter_mm"]),
                ),
            )
            cone.rows.append((float(row["r_mm"]), float(row["depth_mm"]), float(row["sd_mm"])))
    return cones


def make_shell(unknowns: Unknowns, cone: Cone, cell: float, speed: float) -> ExplicitShell:
    """The blank in its clamp over the backing plate, the tool above its middle."""
    exponent, thickness = unknowns.exponent, 1e-3 * unknowns.thickness
    coefficient = 1e6 * unknowns.tensile_strength * np.exp(exponent) / exponent**exponent
    before = (1e6 * unknowns.yield_strength / coefficient) ** (1.0 / exponent)
    strain = np.concatenate([[0.0], np.geomspace(1e-4, 4.0, 400)])
    sheet = Sheet(70e9, 0.33, thickness, strain, coefficient * (strain + before) ** exponent)
    lines = graded_lines(-HALF, HALF, (-EVEN, EVEN), cell, 1.5 * cell, LANES)
    shell = ExplicitShell(lines, lines, sheet, Edge(), friction=0.05, tool_speed=speed, damping=600.0)
    grid = np.arange(-HALF, HALF + 1e-9, 1e-3)
    plate = np.hypot(*np.meshgrid(grid, grid)) >= 1e-3 * unknowns.plate
    shell.set_support(Support(np.where(plate, -0.5 * thickness, -np.inf), grid[0], grid[0], 1e-3))
    shell.hold(np.hypot(*np.meshgrid(lines, lines)) > 1e-3 * unknowns.clamp)
    shell.set_tool(0, Ball(0.5e-3 * cone.tool), np.array([0.0, 0.0, 20e-3]))
    return shell


def form(shell: ExplicitShell, cone: Cone) -> tuple[float, float]:
    """Contour by contour to the height of the cone, then lift the tool.

    Returns the mean axial force of the last contours, N, and the largest kinetic energy over the plastic work.
    """
    thickness, angle, radius = shell.sheet.thickness, np.radians(cone.angle), 0.5e-3 * cone.tool
    away, forces, kinetic = np.zeros(3), [], 0.0
    contours = round(cone.height / cone.step)
    tip = np.zeros(3)
    for k in range(1, contours + 1):
        depth = 1e-3 * cone.step * k
        around = OPENING - (depth - radius) / np.tan(angle) - radius / np.sin(angle)
        count = max(60, int(2.0 * np.pi * around / 1e-3))
        turn = np.linspace(0.0, 2.0 * np.pi, count) + 0.3 * k
        points = np.column_stack(
            [around * np.cos(turn), around * np.sin(turn), np.full(count, 0.5 * thickness - depth)]
        )
        if k == 1:
            shell.place_tools(np.array([points[0] + [0.0, 0.0, depth + 1e-3], away]))
            for part in np.linspace(1.0, 0.0, 20)[1:]:
                shell.move(np.array([points[0] + [0.0, 0.0, part * (depth + 1e-3)], away]))
        force = [shell.move(np.array([point, away]))[0, 2] for point in points]
        forces.append(float(np.mean(force)))
        kinetic = max(kinetic, shell.kinetic_energy)
        tip = points[-1]
    for height in np.linspace(0.0, 12e-3, 30):
        shell.move(np.array([tip + [0.0, 0.0, height], away]))
    if (away := shell.settle()) > 0.05e-3:  # m; as for a scan of a formed part
        sys.exit(f"the sheet does not come to rest: {1e3 * away:.2g} mm away from equilibrium")
    return float(np.mean(forces[-5:])), kinetic / shell.plastic_work


def depths(shell: ExplicitShell, radii: Array) -> Array:
    """(n,) mm, mean depth of the upper face at ``radii`` mm: a parabola through what lies around each."""
    x, y, z = shell.upper_face()
    radius, depth = 1e3 * np.hypot(x, y), 1e3 * (0.5 * shell.sheet.thickness - z)
    found = []
    for at in radii:
        reach = max(3.0, float(np.sort(np.abs(radius - at))[12]))
        near = np.abs(radius - at) <= reach
        away, weight = radius[near] - at, np.exp(-(((radius[near] - at) / 2.0) ** 2))
        terms = np.column_stack([np.ones_like(away), away, away**2]) * weight[:, None]
        found.append(np.linalg.lstsq(terms, depth[near] * weight, rcond=None)[0][0])
    return np.array(found)


def compared(cone: Cone, unknowns: Unknowns, cell: float, speed: float) -> dict[str, Any]:
    """Differences of the profile, mm: model minus measured."""
    started = time.process_time()
    shell = make_shell(unknowns, cone, cell, speed)
    force, kinetic = form(shell, cone)
    profile = cone.profile
    model = depths(shell, profile[:, 0])
    off = model - profile[:, 1]

    def at(radius: float) -> float:
        return round(float(np.interp(radius, profile[:, 0], off)), 2)

    return {
        "part": cone.name,
        "rms": round(float(np.sqrt(np.mean(off**2))), 3),
        "opening": at(50.5),
        "wall": round(float(np.mean(off[(profile[:, 0] > 26.0) & (profile[:, 0] < 44.0)])), 2),
        "base": round(float(np.mean(off[profile[:, 0] < 16.0])), 2),
        "flange": at(58.5),
        "force": round(force),
        "elements": int(shell.state.thickness.size),
        "kinetic_over_plastic": kinetic,
        "cpu_s": round(time.process_time() - started),
        "radius": [float(value) for value in profile[:, 0]],
        "measured": [float(value) for value in profile[:, 1]],
        "model": [round(float(value), 3) for value in model],
    }


COLUMNS = ("rms", "opening", "wall", "base", "flange", "force", "cpu_s")


def line_of(cone: Cone, row: dict[str, Any]) -> str:
    """A line of the table."""
    given = f"{cone.name:7}{cone.angle:5.0f}{cone.tool:6.0f}{cone.step:6.1f}"
    return given + "".join(f"{row[name]:9}" for name in COLUMNS) + ("  fitted" if cone.name in FITTED else "")


def main() -> int:
    """Form the cones and print how far each is off."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--parts", help="names with commas; default all")
    parser.add_argument("--cell", type=float, default=3.0, help="mm")
    parser.add_argument("--speed", type=float, default=40.0, help="m/s of the tool along the sheet")
    parser.add_argument("--set", action="append", default=[], metavar="NAME=VALUE", help="another value of an unknown")
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--save", type=Path, help="file for all rows with their profiles, JSON lines")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    options = parser.parse_args()
    changed = dict(item.split("=", 1) for item in options.set)
    if unknown := set(changed) - set(vars(Unknowns())):
        parser.error(f"no unknown is called {', '.join(sorted(unknown))}; there are {', '.join(vars(Unknowns()))}")
    unknowns = replace(Unknowns(), **{name: float(value) for name, value in changed.items()})
    cones = load_cones()
    names = options.parts.split(",") if options.parts else list(cones)
    if missing := [name for name in names if name not in cones]:
        parser.error(f"no cone is called {', '.join(missing)}; there are {', '.join(cones)}")
    if not options.json:
        print("cone    angle  tool  step" + "".join(f"{name:>9}" for name in COLUMNS), flush=True)
    rows = []
    with ProcessPoolExecutor(options.jobs) as pool:
        futures = [pool.submit(compared, cones[name], unknowns, 1e-3 * options.cell, options.speed) for name in names]
        for name, future in zip(names, futures, strict=True):
            rows.append(future.result())
            if not options.json:
                print(line_of(cones[name], rows[-1]), flush=True)
            if options.save:
                with options.save.open("a", encoding="utf-8") as file:
                    file.write(json.dumps({**rows[-1], "unknowns": vars(unknowns), "cell": options.cell,
                                           "speed": options.speed}) + "\n")  # fmt: skip
    if options.json:
        print(json.dumps(rows))
    return 0


if __name__ == "__main__":
    sys.exit(main())
