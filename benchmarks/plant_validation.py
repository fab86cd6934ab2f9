"""How the simulated machine compares with published measurements, and how fast it runs.

    ./isf python benchmarks/plant_validation.py [flat] [cone] [lift] [support] [speed]

Prints published value, plant, and what kind of agreement it is: P predicted, A depends on a dimension that the source
does not print and that had to be assumed, C calibrated on that number. Sources: Ren 2018 (flat sheet 4.3.2, cone 4.3.4,
lifting 4.3.1, support force 2.4). Assumed: cone with opening radius 36 mm at 50 deg; 40 mm at 65 deg for the support
force. About three minutes in all.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np
from isf_core.job import JobFile
from isf_core.material import load_material
from isf_core.rig import load_rig
from isf_sim.machine import SimulatedMachine
from isf_sim.sheet_plant import SheetPlant
from isf_sim.shell import Elastic, Shell
from numpy.typing import NDArray

Array = NDArray[np.float64]

JOB = """
name: validation
part: {{mesh: none.stl, unit: mm}}
process: DSIF
rig: ren2018
sheet: {{material: {material}, thickness: 1 mm}}
tool_1: {{radius: {radius} mm}}
tool_2: {{radius: {radius} mm}}
path: {{incremental_depth: 0.5 mm, point_spacing: 0.5 mm, feed: 30 mm/s}}
control: {{rate: 500 Hz}}
"""
RATE, FEED = 500.0, 30.0e-3


def row(quantity: str, published: str, plant: str, tag: str) -> None:
    """One line of the table."""
    print(f"{quantity:<52} {published:<24} {plant:<34} {tag}", flush=True)


def tool_circle(depth: Array | float, opening: float, angle: float, radius: float) -> Array:
    """(N,) m, radius of the circle of a ball tip at ``depth`` m that touches a cone's wall (SI, rad)."""
    centre = radius - np.asarray(depth)
    return np.asarray(opening - (radius - centre * np.cos(angle)) / np.sin(angle))


def spiral(opening: float, angle: float, height: float, pitch: float, radius: float, spacing: float) -> Array:
    """(N, 3) m, tips of a spiral down a cone with a flat last loop."""
    points, depth, turn = [], 0.0, 0.0
    while depth < height:
        r = float(tool_circle(depth, opening, angle, radius))
        points.append((r * np.cos(turn), r * np.sin(turn), -depth))
        step = spacing / max(r, 1e-3)
        turn += step
        depth += pitch * step / (2 * np.pi)
    r = float(tool_circle(height, opening, angle, radius))
    for _ in range(int(2 * np.pi * r / spacing) + 1):
        points.append((r * np.cos(turn), r * np.sin(turn), -height))
        turn += spacing / r
    return np.array(points)


def contours(opening: float, angle: float, height: float, step: float, radius: float) -> list[Array]:
    """Closed circles of tips, one point per tick at FEED."""
    out = []
    for depth in np.arange(1, round(height / step) + 1) * step:
        r = float(tool_circle(depth, opening, angle, radius))
        turn = np.arange(0.0, 2 * np.pi, FEED / RATE / r)
        out.append(np.column_stack([r * np.cos(turn), r * np.sin(turn), np.full(len(turn), -depth)]))
    return out


def line(start: Array, end: Array, step: float) -> Array:
    """(N, 3) m, points from after ``start`` to ``end``."""
    n = max(1, int(np.ceil(np.linalg.norm(end - start) / step)))
    return start + np.linspace(0.0, 1.0, n + 1)[1:, None] * (end - start)


def flat_sheet() -> None:
    """Deflection of the blank under 400 N in its centre."""
    for edge, published in (("free", "5.0"), ("fixed", "-")):
        shell = Shell((0.25, 0.25), 0.25 / 40, Elastic(70e9, 0.33), 1e-3, edge=edge)  # type: ignore[arg-type]
        patch = shell.load_patch(0.0, 0.0, 0.0)
        sag = -1e3 * shell.solve(patch, np.array([0.0, 0.0, -400.0])).displacement[2]
        row(f"flat sheet, 400 N in the centre, edge {edge} [mm]", published, f"{sag:.2f}", "P")


def formed_cone() -> tuple[SheetPlant, float]:
    """The cone of Ren 2018, 4.3.4 without correction, and the wall time, s."""
    rig = load_rig("ren2018")
    plant = SheetPlant(rig.clamp, load_material("AA5754-O"), 1e-3, 5e-3, 0.2e-3, rig.tool_1.compliance)
    started = time.perf_counter()
    for tip in spiral(36e-3, np.radians(50), 21e-3, 0.2e-3, 5e-3, 0.5e-3):
        plant.move(tip, np.zeros(2))
    return plant, time.perf_counter() - started


def cone() -> None:
    """Form error of the uncorrected cone and the axial force."""
    plant, wall = formed_cone()
    shape = plant.measured_shape()
    r = np.linspace(0.0, 0.11, 251)
    target = -np.clip((36e-3 - r) * np.tan(np.radians(50)), 0.0, 21e-3)
    error = 1e3 * (shape.at(np.column_stack([r, 0 * r])) - target)
    inner = np.abs(error[r < 60e-3]).mean()
    row("cone uncorrected, max / mean error [mm]", "5.7 / 3.1", f"{error.max():.2f} / {inner:.2f}", "A, fy: C")
    row("  axial force at the end [N]", "-", f"{plant.contact.axial[0]:.0f}", "")
    row("  wall time, coarse solutions", "-", f"{wall:.1f} s, {plant.solutions}", "")


def lift() -> None:
    """Springback while the tool lifts off at the end of the cone: S = a F^b."""
    plant, _ = formed_cone()
    tip = plant.contact.last.copy()
    forces, rises = [], []
    for rise in np.arange(0.0, 8e-3, 0.05e-3):
        plant.move(tip + np.array([0.0, 0.0, rise]), np.zeros(2))
        forces.append(float(plant.contact.axial[0]))
        rises.append(rise)
        if forces[-1] == 0.0:
            break
    sag = rises[-1] - np.array(rises)
    loaded = (np.array(forces) > 0.05 * forces[0]) & (sag > 0)
    b = np.polyfit(np.log(np.array(forces)[loaded]), np.log(sag[loaded]), 1)[0]
    row("lifting at the end: springback [mm], exponent", "5.76, about 0.57", f"{1e3 * rises[-1]:.2f}, {b:.2f}", "A")


def support() -> None:
    """Force on the support tool, 65 deg cone of AA1100-O with 9 mm tools and 120 N asked for."""
    opening, angle, radius = 40e-3, np.radians(65.0), 4.5e-3
    published = {"position": "contact lost", "compensated": "lost later, higher force", "force": "held"}
    for mode in ("position", "compensated", "force"):
        machine = SimulatedMachine(JobFile(JOB.format(material="AA1100-O", radius=4.5), Path()))
        machine.tare()
        depths, forces = _form_with_support(machine, mode, opening, angle, radius)
        bands = [f"{forces[(depths >= a) & (depths < a + 2)].mean():.0f}" for a in range(4, 16, 2)]
        spread = forces[depths > 6].std()
        row(f"support force, {mode}, depth 4-16 mm [N]", published[mode], " ".join(bands) + f" +-{spread:.1f}", "P")
        if machine.faults:
            print("  faults:", machine.faults)


def _form_with_support(
    machine: SimulatedMachine, mode: str, opening: float, angle: float, radius: float
) -> tuple[Array, Array]:
    """Depth mm and measured normal force N of every tick of the contours."""
    thickness = 1e-3 * np.cos(angle)
    reach = 2 * radius + thickness
    offset, lateral = 0.0, np.zeros(2)
    depths, forces = [], []
    circles = contours(opening, angle, 16e-3, 0.5e-3, radius)
    above = circles[0][0] + np.array([0.0, 0.0, 1e-3])
    low = above + reach * np.array([np.sin(angle), 0.0, -np.cos(angle)]) + np.array([0.0, 0.0, 2 * radius])
    tip, parked = np.array([above[0], 0.0, 0.1]), np.array([low[0], 0.0, -0.1])
    drive(machine, (np.array([0.0, 0.0, 0.1]), np.array([0.0, 0.0, -0.1])), (tip, parked))
    drive(machine, (tip, parked), (above, low))
    tip = above
    for circle in circles:
        for point in np.vstack([line(tip, circle[0], 0.06e-3), circle[1:]]):
            outward = np.array([point[0], point[1], 0.0]) / np.hypot(point[0], point[1])
            normal = np.sin(angle) * outward + np.array([0.0, 0.0, -np.cos(angle)])
            low = point + reach * normal + np.array([0.0, 0.0, 2 * radius]) - offset * outward
            target = point - np.append(1e-6 * lateral, 0.0) if mode == "compensated" else point
            sample = machine.tick(target, low)
            lateral += 0.05 * (sample.wrench_1[:2] - lateral)
            normal_force = float(sample.wrench_2[:2] @ outward[:2])
            if mode == "force" and point[2] < -4e-3:
                offset = float(np.clip(offset + 24.0 / RATE * (120.0 - normal_force) / 0.45e6, -3e-3, 3e-3))
            depths.append(-1e3 * point[2])
            forces.append(normal_force)
        tip = circle[-1]
    return np.array(depths), np.array(forces)


def drive(machine: SimulatedMachine, start: tuple[Array, Array], goal: tuple[Array, Array]) -> None:
    """Straight move of both tips, 75 mm/s of the faster one."""
    longest = max(float(np.linalg.norm(g - s)) for s, g in zip(start, goal, strict=True))
    for share in np.linspace(0.0, 1.0, int(np.ceil(longest / 0.15e-3)) + 1)[1:]:
        machine.tick(*(s + share * (g - s) for s, g in zip(start, goal, strict=True)))


def speed() -> None:
    """A 21 mm cone in 0.5 mm steps, 30 mm/s at 500 Hz, through the whole machine."""
    machine = SimulatedMachine(JobFile(JOB.format(material="AA5754-O", radius=5), Path()))
    machine.tare()
    tip, low = np.array([0.0, 0.0, 0.1]), np.array([0.0, 0.0, -0.1])
    started = time.perf_counter()
    for circle in contours(36e-3, np.radians(50), 21e-3, 0.5e-3, 5e-3):
        for point in np.vstack([line(tip, circle[0], 0.15e-3), circle[1:]]):
            machine.tick(point, low)
        tip = circle[-1]
    wall = time.perf_counter() - started
    ticks, solutions = machine.tick_count, machine.plant.solutions
    row(f"21 mm cone, {ticks} ticks: wall time [s]", "-", f"{wall:.1f}", "")
    row("  coarse solutions, each [ms]", "-", f"{solutions}, {1e3 * machine.solve_time / solutions:.0f}", "")
    row("  everything else per tick [us]", "-", f"{1e6 * (wall - machine.solve_time) / ticks:.0f}", "")


PARTS = {"flat": flat_sheet, "cone": cone, "lift": lift, "support": support, "speed": speed}


def main() -> None:
    """Print the chosen lines of the table, all by default."""
    row("quantity", "published", "plant", "agreement")
    for name in sys.argv[1:] or PARTS:
        PARTS[name]()


if __name__ == "__main__":
    main()
