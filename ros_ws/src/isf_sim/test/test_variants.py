"""Variants: what they are drawn from, that those of before stay, and that every difference acts where it should."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from isf_core.files.job import JobFile
from isf_core.files.material import load_material
from isf_core.files.rig import load_rig
from isf_core.geometry.height_map import HeightMap
from isf_core.simulated_sheet import SEALED_VARIANTS, STRUCTURAL_VARIANTS, SheetKind
from isf_core.types import Array
from isf_sim.machine import simulated_machine
from isf_sim.machine.simulated_machine import SimulatedMachine
from isf_sim.plant_constants import PlantConstants
from isf_sim.scanner import measured_points
from isf_sim.sheet.surface import flat_surface
from isf_sim.variant import STANDARD_VARIANTS, Variant, make_variant

JOB = """
name: variants
part: {mesh: none.stl, unit: mm}
process: DSIF
rig: RIG
sheet: {material: AA5754-O, thickness: 1 mm}
tool_1: {radius: 5 mm}
tool_2: {radius: 5 mm}
path: {incremental_depth: 0.5 mm, point_spacing: 0.5 mm, feed: 30 mm/s}
control: {rate: 500 Hz}
"""
SMALL = str(Path(__file__).resolve().parents[4] / "examples" / "rigs" / "clamp_120.yaml")
COARSE = PlantConstants(
    coarse_cell=250e-3 / 16, fine_cell=1e-3, shell_cell_radii=1.2, shell_flange_cell=16e-3, shell_speed=20.0
)


@cache
def job_file(rig: str = SMALL) -> JobFile:
    return JobFile(JOB.replace("RIG", rig), Path())


@cache
def pressed(variant: Variant, sheet: SheetKind = "fast", rig: str = SMALL) -> dict[str, Array]:
    """Forces (3,) N on both tools, lag of the upper tip (3,) m and the shape left (4,) m, after a stroke along x; on
    the fast sheet ten of them, deeper and deeper, and the lower tool beside the upper one at the end."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(simulated_machine, "make_variant", lambda *_: variant)
        machine = SimulatedMachine(job_file(rig), constants=COARSE, sheet=sheet)
    assert machine.variant == variant
    park = machine.job_file.rig.park_height
    strokes = 10 if sheet == "fast" else 1
    places = [(-10e-3, 0.0, 1e-3)]
    for stroke in range(strokes):
        end = 10e-3 if stroke % 2 == 0 else -10e-3
        places += [(-end, 0.0, -1e-3 * (stroke + 3)), (end, 0.0, -1e-3 * (stroke + 3))]
    now, aside = np.array([0.0, 0.0, park]), np.array([0.0, 0.0, -park])
    for goal in np.array(places):
        count = max(1, round(np.linalg.norm(goal - now) * 500.0 / 0.06))
        for point in np.linspace(now, goal, count + 1)[1:]:
            sample = machine.tick(point, aside)
        now = goal
    found = {"upper": sample.true_force_1, "lag": sample.tip_1 - now}
    if sheet == "fast":
        beside = now + np.array([3e-3, 0.0, 0.2e-3])  # the wall is 0.45 mm thick there
        for point in np.linspace(aside, beside, 600):
            sample = machine.tick(now, point)
        for _ in range(50):
            sample = machine.tick(now, beside)
        found["lower"] = sample.true_force_2
        assert np.abs(found["lower"]).max() > 20.0
    assert not machine.faults
    found["shape"] = machine.measured_shape().at(np.array([[0.0, 0.0], [12e-3, 0.0], [-12e-3, 0.0], [0.0, 4e-3]]))
    return found


def changed(variant: Variant, what: str, sheet: SheetKind = "fast") -> float:
    """Relative change of ``what`` by ``variant``."""
    nominal, other = (pressed(item, sheet)[what] for item in (Variant(), variant))
    return float(np.abs(other - nominal).max() / np.abs(nominal).max())


def test_variants_of_before_are_what_they_were() -> None:
    """Documented results refer to them: numbers of docs/results/validation.md, and the same objects reach the plant."""
    second = make_variant(2)
    assert second.young_modulus == pytest.approx(0.952, abs=5e-4)
    assert second.edge_spring == pytest.approx(11.3e6, abs=5e4)
    assert second.registration_turn == pytest.approx(np.radians(-0.140), abs=1e-5)
    for number in STANDARD_VARIANTS:
        variant = make_variant(number)
        assert variant.plant_file(job_file()) is job_file()
        assert variant.constants(COARSE) == COARSE
        assert make_variant(number, blank=1) == variant


def test_sealed_variants_are_others_than_the_open_ones() -> None:
    assert not set(SEALED_VARIANTS) & {0, *STANDARD_VARIANTS, *STRUCTURAL_VARIANTS}
    assert len({make_variant(number) for number in (*SEALED_VARIANTS, *STRUCTURAL_VARIANTS)}) == 40


@pytest.mark.parametrize("numbers", [STRUCTURAL_VARIANTS, SEALED_VARIANTS], ids=["open", "sealed"])
def test_structural_variants_cover_their_ranges(numbers: tuple[int, ...]) -> None:
    variants = [make_variant(number) for number in numbers]
    for name, low, high in (
        ("step_exponent", 0.6, 1.6),
        ("edge_stiffness", 5e6, 200e6),
        ("edge_limit", 20e3, 150e3),
        ("hardening", 0.6, 1.4),
        ("scan_noise", 50e-6, 250e-6),
        ("clamp_x", -0.5e-3, 0.5e-3),
    ):
        values = [getattr(variant, name) for variant in variants]
        assert low <= min(values) < max(values) <= high
        assert max(values) - min(values) > 0.5 * (high - low)
    assert {variant.flow_law for variant in variants} == {"power", "voce"}


def test_another_blank_is_pushed_than_the_part_is_formed_of() -> None:
    part, pushed = make_variant(21), make_variant(21, blank=1)
    assert part.blank_thickness != pushed.blank_thickness
    assert part.blank_yield != pushed.blank_yield
    assert replace(pushed, blank_thickness=part.blank_thickness, blank_yield=part.blank_yield) == part
    sheets = [SimulatedMachine(job_file(), variant=21, blank=blank, constants=COARSE).plant for blank in (0, 1)]
    assert sheets[0].thickness != sheets[1].thickness


@pytest.mark.parametrize(
    ("variant", "what", "least"),
    [
        (Variant(step_exponent=1.6), "upper", 0.02),
        (Variant(ploughing=2.0), "upper", 0.01),
        (Variant(wrap_exponent=1.6), "upper", 0.002),
        (Variant(edge_stiffness=200e6), "upper", 0.01),
        (Variant(flange=3e-3), "upper", 0.001),
        (Variant(tool_radius_1=0.9), "upper", 0.005),
        (Variant(tool_radius_2=0.95), "lower", 0.02),
        (Variant(tool_offset_x=-0.1e-3), "lower", 0.02),
        (Variant(tool_offset_z=0.05e-3), "lower", 0.02),
        (Variant(clamp_x=0.5e-3), "shape", 0.005),
        (Variant(clamp_y=0.5e-3), "shape", 0.001),
        (Variant(servo_bandwidth=0.6), "lag", 0.2),
        (Variant(servo_damping=1.2), "lag", 0.01),
        (Variant(blank_thickness=1.01), "upper", 0.005),
        (Variant(blank_yield=1.03), "lower", 0.001),
    ],
    ids=lambda value: (
        next((n for n, v in vars(value).items() if v != getattr(Variant(), n)), "")
        if isinstance(value, Variant)
        else None
    ),
)
def test_every_difference_acts_on_the_fast_sheet(variant: Variant, what: str, least: float) -> None:
    assert changed(variant, what) > least


@pytest.mark.parametrize(
    ("variant", "what", "least"),
    [
        (Variant(edge_stiffness=200e6), "upper", 0.01),
        (Variant(flow_law="voce"), "upper", 0.002),
        (Variant(hardening=0.6), "upper", 0.002),
        (Variant(flange=3e-3), "upper", 0.001),
        (Variant(tool_radius_1=0.9), "upper", 0.005),
        (Variant(clamp_x=0.5e-3), "shape", 0.002),
        (Variant(servo_bandwidth=0.6), "lag", 0.2),
        (Variant(blank_thickness=1.01), "upper", 0.005),
        (Variant(blank_yield=1.03), "upper", 0.001),
    ],
    ids=lambda value: (
        next((n for n, v in vars(value).items() if v != getattr(Variant(), n)), "")
        if isinstance(value, Variant)
        else None
    ),
)
def test_differences_act_on_the_elasto_plastic_sheet(variant: Variant, what: str, least: float) -> None:
    assert changed(variant, what, "shell") > least


def test_the_sheet_slips_in_its_clamp_beyond_the_limit() -> None:
    """On the elasto-plastic sheet alone; the fast one has the spring without a limit."""
    held = Variant(edge_stiffness=200e6)
    slips = replace(held, edge_limit=200.0)
    assert pressed(slips, "shell")["upper"][2] < 0.99 * pressed(held, "shell")["upper"][2]
    assert (pressed(slips)["upper"] == pressed(held)["upper"]).all()


def test_a_rig_with_a_fixed_edge_has_a_spring_as_well() -> None:
    rig = load_rig("lu2016")
    assert rig.clamp.edge == "fixed"
    plant = Variant(edge_stiffness=20e6).plant_file(job_file("lu2016"))
    assert plant.rig.clamp.edge == "free"
    assert job_file("lu2016").rig.clamp.edge == "fixed"
    assert Variant(edge_stiffness=20e6).edge(plant.rig.clamp, 1e6) == (20e6, np.inf)


def test_flow_curves_meet_at_a_strain_of_a_tenth() -> None:
    material = load_material("AA5754-O")
    strain = np.array([0.0, 0.1, 2.0])
    power = Variant().flow_stress(material, strain)
    voce = Variant(flow_law="voce").flow_stress(material, strain)
    assert voce[:2] == pytest.approx(power[:2], rel=1e-6)
    assert voce[2] < 0.93 * power[2]
    plant = Variant(hardening=0.6).plant_file(job_file())
    softer = Variant().flow_stress(plant.material, strain)
    assert softer[1] == pytest.approx(power[1], rel=0.01)
    assert softer[2] < 0.95 * power[2]
    law = material.model_copy(update={"saturation_stress": 258e6, "saturation_strain": 0.06})
    own = job_file()
    own.material = law
    other = Variant().flow_stress(Variant(hardening=0.6).plant_file(own).material, strain)
    before = Variant().flow_stress(law, strain)
    assert other[1] == pytest.approx(before[1], rel=1e-3)
    assert other[0] > 1.05 * before[0]
    assert other[2] < 0.97 * before[2]


def scanned(variant: Variant) -> Array:
    """Cloud of a dish of 60 deg in a sheet of 120 mm, with what is wrong with the scanner alone."""
    x = np.arange(-0.06, 0.0601, 1e-3)
    r = np.hypot(*np.meshgrid(x, x))
    heights = -np.clip((30e-3 - r) * np.tan(np.radians(60.0)), 0.0, 20e-3)
    away = np.array([[0.0, 0.0, 0.1], [0.0, 0.0, -0.1]])
    surface = flat_surface((0.12, 0.12), 1e-3)
    generator = np.random.default_rng(1)
    return measured_points(HeightMap(x, x, heights), surface, away, np.full(2, 5e-3), variant, generator, True)


def test_what_is_wrong_with_a_scanner() -> None:
    nominal = scanned(Variant())

    def rim(points: Array) -> Array:
        flat = np.abs(points[:, :2]).max(axis=1)
        return points[(flat > 40e-3) & (flat < 58e-3)]

    assert rim(nominal)[:, 2].std() < 0.03e-3
    assert rim(scanned(Variant(scan_noise=0.25e-3)))[:, 2].std() == pytest.approx(0.25e-3, rel=0.1)
    bowed = rim(scanned(Variant(scan_bow=0.2e-3)))
    corner = np.abs(bowed[:, :2]).min(axis=1) > 50e-3
    assert bowed[corner, 2].mean() - rim(nominal)[:, 2].mean() == pytest.approx(0.16e-3, abs=0.03e-3)

    def on_wall(points: Array) -> int:
        r = np.hypot(points[:, 0], points[:, 1])
        return int(np.count_nonzero((r > 20e-3) & (r < 29e-3)))

    assert on_wall(scanned(Variant(scan_flattest=0.85))) < 0.8 * on_wall(nominal)
    assert len(scanned(Variant(scan_shine=4.0))) < len(nominal) - 100
    beyond = scanned(Variant(scan_beyond=20e-3))
    outside = beyond[np.abs(beyond[:, :2]).max(axis=1) > 62e-3]
    assert len(outside) > 1000
    assert outside[:, 2].mean() == pytest.approx(10e-3, abs=0.1e-3)
    assert np.abs(nominal[:, :2]).max() < 62e-3


def test_a_scan_is_of_the_whole_sheet_wherever_its_heights_are_known() -> None:
    """The grid of heights of a sheet of any width begins at one edge; the sheet ends at both alike."""
    x = np.arange(-60.3e-3, 60.8e-3, 1e-3)
    away = np.array([[0.0, 0.0, 0.1], [0.0, 0.0, -0.1]])
    surface, generator = flat_surface((0.12, 0.12), 1e-3), np.random.default_rng(1)
    flat = HeightMap(x, x, np.zeros((len(x), len(x))))
    points = measured_points(flat, surface, away, np.full(2, 5e-3), Variant(scan_beyond=20e-3), generator, True)
    sheet, frame = points[points[:, 2] < 5e-3, :2], points[points[:, 2] > 5e-3, :2]
    assert sheet.max(axis=0) + sheet.min(axis=0) == pytest.approx([0.0, 0.0], abs=0.1e-3)
    assert np.abs(frame).max(axis=1).min() == pytest.approx(60.3e-3, abs=2.1e-3)


def test_the_yield_strength_acts_on_the_flow_curve_of_every_law() -> None:
    """1.1 times 1.03 at the begin, half as much more at half the matched strain, nothing beyond it."""
    material = load_material("AA5754-O")
    strain, variant = np.array([0.0, 0.05, 0.1, 2.0]), Variant(yield_strength=1.1, blank_yield=1.03)
    for law in (
        {"strength_coefficient": 400e6, "hardening_exponent": 0.3},
        {"strength_coefficient": 400e6, "hardening_exponent": 0.3, "pre_strain": 0.005},
        {"flow_curve": ((0.0, 100e6), (0.05, 150e6), (0.1, 200e6), (2.0, 300e6))},
    ):
        own = material.model_copy(update=law)
        factor = variant.flow_stress(own, strain) / Variant().flow_stress(own, strain)
        assert factor == pytest.approx([1.133, 1.0665, 1.0, 1.0], abs=1e-9)


def test_a_yield_strength_beyond_the_hardening_makes_no_sheet_that_softens() -> None:
    material = load_material("AA5754-O")
    strain, variant = np.linspace(0.0, 0.3, 301), Variant(yield_strength=1.1, blank_yield=1.03)
    stiff = material.model_copy(update={"strength_coefficient": 144e6, "hardening_exponent": 0.02})  # as Al8011
    stress = variant.flow_stress(stiff, strain)
    assert np.diff(stress).min() >= 0.0
    assert stress[0] == pytest.approx(137.57e6, abs=0.02e6)
    saturated = {"saturation_stress": 115e6, "saturation_strain": 0.06, "yield_strength": 1.133 * 110e6}
    stress = variant.flow_stress(material.model_copy(update=saturated), strain)
    assert stress == pytest.approx(np.full(301, 115e6))


def test_a_blank_of_a_variant_that_hardens_has_its_yield_strength() -> None:
    """The hardening is of the material; the yield strength of the blank comes on top, as without it."""
    variant = Variant(hardening=0.6, blank_yield=1.03)
    plant = variant.plant_file(job_file())
    other = Variant(hardening=0.6).plant_file(job_file())
    strain = np.array([0.0, 0.1])
    factor = variant.flow_stress(plant.material, strain) / Variant().flow_stress(other.material, strain)
    assert factor == pytest.approx([1.03, 1.0], abs=1e-9)
    assert plant.material.yield_strength == pytest.approx(1.03 * 110e6)
