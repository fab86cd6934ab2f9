"""Published numbers of other sources, and of whole parts, for plant_validation.py."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from isf_cell.in_process import form
from isf_cell.options import RunOptions
from isf_core.files.job import JobFile, load_job
from isf_core.files.material import forming_limit, load_material
from isf_core.files.rig import load_rig
from isf_core.files.tooling import BackingPlateSpec
from isf_core.geometry.height_map import HeightMap
from isf_core.types import Array
from isf_sim.machine.events import event_limits
from isf_sim.sheet import adsif
from isf_sim.sheet.control_points import HEIGHT
from isf_sim.sheet.sheet_plant import SheetPlant
from isf_sim.sheet.thickness import strain_up_the_wall
from isf_sim.shell.shell import Elastic, Shell
from plant_validation import SECTIONS, row, tool_circle

JOBS = Path(__file__).resolve().parents[1] / "examples" / "jobs"

STABLE_ANGLES = {
    25: {0.7: 31.9, 0.8: 22.4, 0.9: 18.3, 1.0: 16.5},
    35: {0.6: 35.8, 0.7: 31.7, 0.8: 25.4, 0.9: 21.5, 1.0: 21.1},
    45: {0.6: 37.3, 0.7: 31.9, 0.8: 27.1, 0.9: 25.4, 1.0: 24.5},
    55: {0.6: 36.7, 0.7: 31.8, 0.8: 29.0, 0.9: 28.1, 1.0: 27.2},
}
"""deg over theta (deg) and gap / t0 (Ren 2018, 3.2.3)."""


def praveen_table() -> None:
    """Praveen 2020, Table 1: 381 N at r_l on a clamped plate of radius r_b, 0.8 mm Al8011; here squares."""
    for r_b, r_l, fea, measured in ((50, 42, 0.46, "0.49"), (350, 300, 4.18, "4.5"), (1000, 900, 7.2, "-")):
        values = []
        for edge in ("fixed", "free"):
            side = 2e-3 * r_b
            shell = Shell((side, side), side / 72, Elastic(70e9, 0.33), 0.8e-3, edge=edge)  # type: ignore[arg-type]
            patch = shell.load_patch(1e-3 * r_l, 0.0, 0.0)
            values.append(-1e3 * float(shell.solve(patch, np.array([0.0, 0.0, -381.0])).displacement[2]))
        text = f"{values[0]:.2f} (fixed), {values[1]:.2f} (free)"
        row(f"Praveen Table 1, r_b {r_b}: FEA / measured [mm]", f"{fea} / {measured}", text, "P", [(values[0], fea)])


def stable_angles() -> None:
    """ADSIF: 19 angles, and the gap that soft tools open to (Ren 2018, chapter 3)."""
    errors = [
        math.degrees(adsif.stable_angle(gap, math.radians(theta))) - angle
        for theta, line in STABLE_ANGLES.items()
        for gap, angle in line.items()
    ]
    text = f"rms {np.sqrt(np.mean(np.square(errors))):.2f}, largest {np.abs(errors).max():.1f}"
    row("ADSIF stable angles, 19 runs: error [deg]", "-", text, "C")
    soft = adsif.AdsifConstants(1e-3, 5e-3, 5e-3, 2e-6, 1.0, 0.3e-3)
    for theta in (45, 25):
        gap = adsif.opened_gap(0.5, math.radians(theta), soft)
        angle = math.degrees(adsif.stable_angle(gap, math.radians(theta)))
        row(
            f"  theta {theta} deg, gap 0.5 mm, soft tools: angle [deg]",
            "about 28",
            f"{angle:.1f}",
            "C",
            [(angle, 28.0)],
        )


def process_limits() -> None:
    """Chips, fracture: limits of the events."""
    soft = load_material("AA1100-O")
    limit = event_limits(soft.tensile_strength, forming_limit(soft), 4.5e-3, 1e-3, 500.0).galling
    for horizontal, reported in ((120.0, "none"), (200.0, "chips")):
        force = horizontal / math.sin(math.radians(65.0))
        found = "chips" if force > limit else "none"
        check = [(float(found == reported), 1.0)]
        row(f"AA1100-O, R 4.5 mm, support force {horizontal:.0f} N", reported, found, "C", check)
    for name, thickness, step, angles, reported, tag in (
        ("AA1050", 1e-3, 0.5e-3, (45.0,), "formed", "C"),
        ("AA1050", 1e-3, 0.5e-3, (70.0,), "torn", "C"),
        ("AA3103", 1.5e-3, 1e-3, (60.0,), "formed", "A"),
        ("AA3103", 1.5e-3, 1e-3, (65.0,), "formed", "A"),
        ("AA3103", 1.5e-3, 1e-3, (60.0, 68.0, 76.0), "formed", "C"),
        ("AA3103", 1.5e-3, 1e-3, (60.0, 67.0, 73.0, 80.0), "torn", "C"),
    ):
        borne = forming_limit(load_material(name)).strain
        thinning, strain = wall_strains(name, angles, thickness, 5e-3, step)
        found = "torn" if strain > borne else "formed"
        passes = {1: "one pass", 3: "three passes", 4: "four passes"}[len(angles)]
        text = f"{found}, strain {strain:.2f} of {borne:.2f}, ln(t0/t) {thinning:.2f}"
        row(f"{name}, wall of {angles[-1]:.0f} deg in {passes}", reported, text, tag, [(float(found == reported), 1.0)])


class RigidSheet(SheetPlant):
    """The conforming surface alone: a sheet that does not give way, for what follows from the shape only."""

    def _begin_solution(self, tip: Array) -> None:
        points = self.points
        points.used[0] = 1
        points.place[0] = tip[0], tip[1], points.pending[HEIGHT]
        points.displacement[0], points.force[0], points.exponent[0] = 0.0, 500.0, 1.0


def wall_strains(
    name: str, angles: tuple[float, ...], thickness: float, radius: float, step: float, opening: float = 40e-3
) -> tuple[float, float]:
    """Medians of ln(t0 / t) and of the strain with bends, as the forming limit counts it, beside a tool on the last
    circles of a cone, half as deep as its ``opening``, one pass per angle; m, deg."""
    clamp = load_rig("behera2015").clamp.model_copy(update={"size": (3.0 * opening, 3.0 * opening)})
    material = load_material(name)
    plant = RigidSheet(clamp, material, thickness, radius, step, (0.0, 0.0, 0.0))
    found, place, depth = [], np.empty(3), 0.5 * opening
    limit = forming_limit(material)
    bent = 0.5 * thickness * limit.bending_share
    for angle in angles:
        for z in np.arange(step, depth + 1e-6, step):
            r = float(tool_circle(z, opening, math.radians(angle), radius))
            for turn in np.arange(0.0, 2 * np.pi, 0.8e-3 / r):
                plant.move(np.array([r * np.cos(turn), r * np.sin(turn), -z]), np.zeros(2))
                tip, wall = plant.contact.formed_tip, plant.contact.wall
                if angle == angles[-1] and z > 0.75 * depth:
                    of_tool = plant.surface, tip[0], tip[1], wall, radius
                    found.append(
                        [strain_up_the_wall(*of_tool, *kind, place) for kind in ((1.0, 0.0), (limit.slope, bent))]
                    )
    thinning, strain = np.median(found, axis=0)
    return float(thinning), float(strain)


def as_published(name: str, method: str) -> JobFile:
    """A part as Ren 2018, 4.3 formed it: steps of 0.2 mm, both tools under position control, no compliance
    compensation; correction by elastic shell, half-step forecast, blocks of 1 mm, the first block not corrected."""
    file = load_job(JOBS / f"{name}.yaml")
    job = file.job
    elastic = job.springback.elastic.model_copy(update={"forecast": "half_step", "block": 5})
    file.job = job.model_copy(
        update={
            "path": job.path.model_copy(update={"incremental_depth": 0.2e-3, "feed": 30e-3}),
            "control": job.control.model_copy(update={"compliance_compensation": 0.0, "support_force": 0.0}),
            "springback": job.springback.model_copy(
                update={"method": method, "elastic": elastic, "first_contour": "zero"}
            ),
        }
    )
    return file


def section_errors(formed: HeightMap, target: HeightMap, reach: float) -> tuple[Array, Array]:
    """m, vertical errors within ``reach`` m of the axis along x and along 45 deg, the published cross-sections."""
    r = np.arange(0.0, reach, 0.5e-3)
    along = np.column_stack([r, 0.0 * r]), np.column_stack([r, r]) / math.sqrt(2.0)
    errors = [formed.at(line) - target.at(line) for line in along]
    return errors[0][np.isfinite(errors[0])], errors[1][np.isfinite(errors[1])]


def published_part(name: str, method: str, half_opening: float, reported: str, numbers: tuple[float, float]) -> None:
    """One part of Ren 2018, 4.3; errors out to 5/3 of the opening, as for the uncorrected cone (assumed)."""
    record = form(as_published(name, method), RunOptions(correction=method, support_force=0.0))
    errors = section_errors(record.scan, record.target, 5.0 / 3.0 * half_opening)
    both = 1e3 * np.concatenate(errors)
    worst, mean = float(both[np.argmax(np.abs(both))]), float(np.abs(both).mean())
    text = f"{worst:+.2f} / {mean:.2f}, mean {both.mean():+.2f}"
    quantity = f"{name}, {method}: max / mean error [mm]"
    row(quantity, reported, text, "A", list(zip((worst, mean), numbers, strict=True)))
    walls = ", ".join(f"{1e3 * part.max():+.2f} / {1e3 * part.min():+.2f}" for part in errors)
    row("  largest / smallest along x, along 45 deg [mm]", "-", walls, "-")
    force = float(np.mean(record.results[-1].forming_force[:, 2]))
    row("  axial force on the last contour [N]", "-", f"{force:.0f}", "-")


def corrected_cone() -> None:
    """Cone of Ren 2018 with the published correction."""
    published_part("ren_cone", "elastic", 36e-3, "1.5 / 0.8, under-formed", (1.5, 0.8))


def formed_pyramid(half: float, corner: float) -> tuple[Array, Array, list[Array], Array]:
    """Ren 2018, 4.3: pyramid of 50 deg, 20 mm deep in steps of 0.2 mm, the sheet alone; ``half`` opening and ``corner``
    radius m.

    Returns places r and target heights (n,) m along x; errors (n,), (n,) mm along x and along 45 deg, out to 5/3 of the
    opening as for the cone; of the last loop (2, N) the way to the nearest corner, deg, and the axial force, N.
    """
    rig, angle = load_rig("ren2018"), math.radians(50.0)
    plant = SheetPlant(rig.clamp, load_material("AA5754-O"), 1e-3, 5e-3, 0.2e-3, rig.tool_1.compliance)
    for depth in np.arange(0.2e-3, 20.1e-3, 0.2e-3):
        side = float(tool_circle(depth, half, angle, 5e-3))
        loop = rounded_square(side, min(max(corner - half + side, 3e-3), side), 1.0e-3)
        forces = []
        for point in loop:
            plant.move(np.array([point[0], point[1], -depth]), np.zeros(2))
            forces.append(float(plant.contact.axial[0]))
    away = np.abs(np.degrees(np.arctan2(loop[:, 1], loop[:, 0])) % 90.0 - 45.0)
    shape = plant.measured_shape()
    r = np.arange(0.0, 5.0 / 3.0 * half, 0.5e-3)
    errors, lines = [], []
    for place in (np.column_stack([r, 0.0 * r]), np.column_stack([r, r]) / math.sqrt(2.0)):
        beyond = np.maximum(place - (half - corner), 0.0)
        inside = corner - np.hypot(beyond[:, 0], beyond[:, 1])
        level = np.where(beyond.max(axis=1) > 0.0, inside, half - place.max(axis=1))
        lines.append(-np.clip(level * math.tan(angle), 0.0, 20e-3))
        errors.append(1e3 * (shape.at(place) - lines[-1]))
    return r, lines[0], errors, np.array([away, forces])


def pyramid() -> None:
    """The pyramid uncorrected: half opening 40 mm and corners of 22 mm are assumed; 40 x 40 mm is the one printed size
    (4.2.5, for a number of points; wall angle and corners of 8 mm assumed)."""
    r, target, errors, (away, force) = formed_pyramid(40e-3, 22e-3)
    SECTIONS["ren_pyramid"] = (r, target, target + 1e-3 * errors[0])
    both = np.concatenate(errors)
    check = [(float(both.max()), 4.8), (float(np.abs(both).mean()), 2.6)]
    text = f"{both.max():.2f} / {np.abs(both).mean():.2f}"
    row("Ren pyramid uncorrected, max / mean error [mm]", "4.8 / 2.6", text, "A", check)
    walls = ", ".join(f"{part.max():.2f} / {np.abs(part).mean():.2f}" for part in errors)
    row("  the same along x, along 45 deg [mm]", "-", walls, "-")
    row("  in the centre of the base [mm]", "5.27 (scan)", f"{errors[0][0]:.2f}", "A", [(float(errors[0][0]), 5.27)])
    text = f"{force.mean():.0f} ({force[away > 33.0].mean():.0f}, {force[away < 7.0].mean():.0f})"
    row("  axial force at 20 mm, mean (mid wall, corner) [N]", "-", text, "-")
    small = formed_pyramid(20e-3, 8e-3)[2]
    both = np.concatenate(small)
    text = f"{both.max():.2f} / {np.abs(both).mean():.2f}, base {small[0][0]:.2f}"
    row("  opening of 40 x 40 mm: max / mean error [mm]", "4.8 / 2.6 (size not stated)", text, "A")


def corrected_pyramid() -> None:
    """The same with the published correction."""
    published_part("ren_pyramid", "elastic", 40e-3, "1.1 / 0.2, corners under-formed", (1.1, 0.2))


def backed_plant(rig: str, material: str, thickness: float, radius: float, step: float, opening: float) -> SheetPlant:
    """Fresh blank over a backing plate with a square opening of ``opening`` m."""
    machine = load_rig(rig)
    plant = SheetPlant(machine.clamp, load_material(material), thickness, radius, step, machine.tool_1.compliance)
    surface = plant.surface
    x = surface.x0 + surface.h * np.arange(surface.height.shape[1])
    y = surface.y0 + surface.h * np.arange(surface.height.shape[0])
    plate = BackingPlateSpec(shape="rectangle", size=(opening, opening))
    plant.set_support(plate.height(*np.meshgrid(x, y)) - plant.thickness)
    return plant


def circle(plant: SheetPlant, r: float, depth: float, spacing: float = 0.8e-3) -> float:
    """Form one circle; mean axial force, N."""
    forces = []
    for turn in np.arange(0.0, 2 * np.pi, spacing / r):
        plant.move(np.array([r * np.cos(turn), r * np.sin(turn), -depth]), np.zeros(2))
        forces.append(float(plant.contact.axial[0]))
    return float(np.mean(forces))


def lu_cone() -> None:
    """Lu 2016, 4.2.1: 50 deg cone, 30 mm deep, 2 mm steps, tool of 30 mm, AA7075-O 1.6 mm; radius assumed 75 mm."""
    plant = backed_plant("lu2016", "AA7075-O", 1.6e-3, 15e-3, 2e-3, 0.2)
    errors = []
    for k in range(1, 16):
        depth = 2e-3 * k
        circle(plant, float(tool_circle(depth, 75e-3, np.radians(50.0), 15e-3)), depth, 1.2e-3)
        if k in (1, 2, 15):
            formed = float(plant.measured_shape().at(np.zeros((1, 2)))[0])
            errors.append(1e3 * (depth + formed))
    shape = plant.measured_shape()
    r = np.linspace(0.0, 0.12, 241)
    target = -np.clip((75e-3 - r) * np.tan(np.radians(50.0)), 0.0, 30e-3)
    SECTIONS["lu_cone"] = (r, target, shape.at(np.column_stack([r, 0 * r])))
    text = ", ".join(f"{e:.2f}" for e in errors)
    row("Lu cone: depth error after step 1, 2, 15 [mm]", ">2, >2, about 3", text, "A", [(errors[2], 3.0)])


def step_depth() -> None:
    """Lu 2016, 4.1.1 (accuracy falls with the step) and 4.1.3 (small steps tear at 60 deg)."""
    errors = []
    for step in (0.6e-3, 1.1e-3, 2.2e-3):
        plant = backed_plant("lu2016", "AA7075-O", 1.6e-3, 15e-3, step, 0.2)
        depth = 0.0
        while depth < 11e-3 - 1e-9:
            depth += step
            circle(plant, float(tool_circle(depth, 75e-3, np.radians(50.0), 15e-3)), depth, 1.5e-3)
        errors.append(1e3 * (depth + float(plant.measured_shape().at(np.zeros((1, 2)))[0])))
    ordered = errors[0] < errors[1] < errors[2]
    text = " < ".join(f"{e:.2f}" for e in errors) if ordered else ", ".join(f"{e:.2f}" for e in errors)
    row(
        "Lu cone, 11 mm: error at steps 0.6, 1.1, 2.2 mm [mm]",
        "rises with the step",
        text,
        "P",
        [(float(ordered), 1.0)],
    )
    borne = forming_limit(load_material("AA7075-O")).strain
    for step, reported, tag in ((0.2, "torn", "P"), (0.5, "torn", "C"), (0.7, "formed", "C"), (1.0, "formed", "P")):
        thinning, strain = wall_strains("AA7075-O", (60.0,), 1.6e-3, 15e-3, 1e-3 * step, 60e-3)
        found = "torn" if strain > borne else "formed"
        text = f"{found}, strain {strain:.2f} of {borne:.2f}, ln(t0/t) {thinning:.2f}"
        row(f"Lu, wall of 60 deg in steps of {step} mm", reported, text, tag, [(float(found == reported), 1.0)])


def behera_pyramid() -> None:
    """Behera 2015, Table 1: 60 deg pyramid, AA3103 1.5 mm, 35 mm deep, 1 mm steps, R 5 mm; half width assumed 75 mm."""
    plant = backed_plant("behera2015", "AA3103", 1.5e-3, 5e-3, 1e-3, 0.156)
    angle, corner = math.radians(60.0), 22e-3
    for k in range(1, 36):
        inset = 75e-3 - float(tool_circle(1e-3 * k, 75e-3, angle, 5e-3))
        half = 75e-3 - inset
        radius = max(corner - inset, 3e-3)
        for point in rounded_square(half, radius, 1.0e-3):
            plant.move(np.array([point[0], point[1], -1e-3 * k]), np.zeros(2))
    x = np.arange(-72e-3, 72.1e-3, 2e-3)
    gx, gy = np.meshgrid(x, x)
    shape = plant.measured_shape().at(np.column_stack([gx.ravel(), gy.ravel()])).reshape(gx.shape)
    ox, oy = np.abs(gx) - (75e-3 - corner), np.abs(gy) - (75e-3 - corner)
    inside = corner - np.hypot(np.maximum(ox, 0), np.maximum(oy, 0)) - np.minimum(np.maximum(ox, oy), 0)
    target = -np.clip(inside * math.tan(angle), 0.0, 35e-3)
    gradient = np.gradient(target, 2e-3)
    normal = (shape - target) / np.sqrt(1 + gradient[0] ** 2 + gradient[1] ** 2)
    values = 1e3 * normal[target < -0.5e-3]
    middle = len(x) // 2
    SECTIONS["behera_pyramid"] = (x[middle:], target[middle, middle:], shape[middle, middle:])
    found = (float(values.min()), float(values.max()), float(values.mean()))
    text = " / ".join(f"{v:.2f}" for v in found)
    check = list(zip(found, (-1.69, 2.44, 1.07), strict=True))
    row("Behera 60 deg pyramid, normal: min / max / mean [mm]", "-1.69 / 2.44 / 1.07", text, "C", check)


def rounded_square(half: float, radius: float, spacing: float) -> Array:
    """(N, 2) m, closed path along a square of half width ``half`` m with corners of ``radius`` m."""
    points: list[tuple[float, float]] = []
    flat = half - radius
    for quarter in range(4):
        c, s = math.cos(quarter * math.pi / 2), math.sin(quarter * math.pi / 2)
        along = [(half, v) for v in np.arange(-flat, flat, spacing)]
        bend = [
            (flat + radius * math.cos(a), flat + radius * math.sin(a))
            for a in np.arange(0.0, math.pi / 2, spacing / radius)
        ]
        points += [(c * x - s * y, s * x + c * y) for x, y in [*along, *bend]]
    return np.array(points)


def two_point() -> None:
    """Lu 2016, 4.4 in kind: base on the die within 0.3 mm, wall under-formed by up to 3 mm; other part and machine."""
    record = form(load_job(JOBS / "tpif_cone.yaml"), RunOptions(correction="none"))
    r = np.linspace(0.0, 60e-3, 121)
    line = np.column_stack([r, 0 * r])
    formed, target = record.scan.at(line), record.target.at(line)
    SECTIONS["tpif_cone"] = (r, target, formed)
    error = 1e3 * (formed - target)
    top = target > np.nanmax(target) - 0.1e-3
    wall = (target > 0.5e-3) & ~top
    base = float(np.nanmax(np.abs(error[top])))
    row("TPIF: base on the die, largest error [mm]", "within 0.3", f"{base:.2f}", "P", [(float(base <= 0.3), 1.0)])
    row("TPIF: wall, largest error [mm]", "up to 3 (other part)", f"{np.nanmax(np.abs(error[wall])):.2f}", "-")


def accumulative() -> None:
    """ADSIF cone planned with the published surface: depth of the part, gap compensated once."""
    job = load_job(JOBS / "adsif_cone.yaml")
    job.job = job.job.model_copy(
        update={"control": job.job.control.model_copy(update={"compliance_compensation": 0.0})}
    )
    record = form(job, RunOptions(correction="none"))
    r = np.linspace(0.0, 50e-3, 101)
    line = np.column_stack([r, 0 * r])
    formed, target = record.scan.at(line), record.target.at(line)
    SECTIONS["adsif_cone"] = (r, target, formed)
    worst = 1e3 * float(np.nanmax(np.abs(formed - target)))
    check = [(float(worst <= 0.8), 1.0)]
    row("ADSIF cone, gap compensated: largest error [mm]", "at most 0.8 (other part)", f"{worst:.2f}", "P", check)


def local_die() -> None:
    """The uncorrected cone of Ren 2018 by one tool and with a support force of 120 N, steps of 0.5 mm.

    Lu 2016, 2.3.1.1 and Ren 2018, 1.1 say that squeeze lessens springback and bending; numbers are not published.
    Axial force: on the sheet, so what both tools feel together, over the last quarter of the depth but the last loop.
    """
    found = []
    for process, force in (("SPIF", 0.0), ("DSIF", 120.0)):
        file = load_job(JOBS / "ren_cone.yaml")
        if process == "SPIF":
            file.job = file.job.model_copy(update={"process": process, "tool_2": None})
        record = form(file, RunOptions(correction="none", support_force=force))
        middle = np.zeros((1, 2))
        springback = 1e3 * float(record.scan.at(middle)[0] - record.target.at(middle)[0])
        deep = record.results[3 * len(record.results) // 4 : -2]
        axial = sum(
            part.forming_force[:, 2].mean() + np.sum(part.support_force[:, 2]) / len(part.forming_force)
            for part in deep
        )
        found.append((springback, float(axial) / len(deep)))
    (alone, force_alone), (held, force_held) = found
    less = [(float(held < alone), 1.0)]
    text = f"{alone:.2f} to {held:.2f}"
    row("Ren cone, one tool / 120 N on support tool: springback [mm]", "less with squeeze", text, "P", less)
    row("  axial force on the sheet, mean of 15-20 mm [N]", "-", f"{force_alone:.0f} to {force_held:.0f}", "-")


PARTS = {
    "praveen": praveen_table,
    "angles": stable_angles,
    "limits": process_limits,
    "local_die": local_die,
    "corrected_cone": corrected_cone,
    "pyramid": pyramid,
    "corrected_pyramid": corrected_pyramid,
    "lu": lu_cone,
    "steps": step_depth,
    "behera": behera_pyramid,
    "tpif": two_point,
    "adsif": accumulative,
}
