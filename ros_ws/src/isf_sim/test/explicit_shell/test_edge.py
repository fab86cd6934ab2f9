"""The edge of a rig's clamp: the law itself, and that both sheets take it from the rig."""

from __future__ import annotations

import numpy as np
import pytest
from isf_core.files.material import load_material
from isf_core.files.rig import Clamp, load_rig
from isf_sim.explicit_shell.formed_sheet import edge_of
from isf_sim.explicit_shell.shell import Edge, ExplicitShell, Sheet
from isf_sim.plant_constants import PlantConstants
from isf_sim.sheet.sheet_plant import SheetPlant
from isf_sim.variant import Variant

SPRING, FRICTION = 45e6, 20e3  # N/m^2, N/m
LAW = Clamp(size=(0.1, 0.08), edge_spring=SPRING, edge_friction=FRICTION)
AROUND = 0.36  # m


def shift(shell: ExplicitShell) -> float:
    """m along x, mean over all nodes."""
    grid = np.meshgrid(shell.x, shell.y)[0].ravel()
    return float((shell.state.position[0] - grid).mean())


def pushed(shell: ExplicitShell, force: float, steps: int = 8000) -> float:
    """m, shift after ``force`` N along x on all nodes alike."""
    shell.load = np.zeros_like(shell.state.position)
    shell.load[0] = force / shell.load.shape[1]
    shell.advance(steps, 1e5)  # beyond critical: it does not slide by its swing
    return shift(shell)


def test_the_edge_is_a_spring_until_it_slides_in_the_clamp() -> None:
    curve = np.array([0.0, 1.0]), np.array([1e12, 1e12])
    lines = [np.linspace(-0.5, 0.5, 7) * length for length in LAW.size]
    shell = ExplicitShell(*lines, Sheet(70e9, 0.33, 1e-3, *curve), edge_of(LAW, PlantConstants(), Variant()))
    limit = FRICTION * AROUND
    assert pushed(shell, 0.8 * limit) == pytest.approx(0.8 * limit / (SPRING * AROUND), rel=0.03)
    assert pushed(shell, 0.0) == pytest.approx(0.0, abs=5e-6)
    assert pushed(shell, 1.3 * limit) > 2.0 * FRICTION / SPRING
    slid = shift(shell) - FRICTION / SPRING
    assert pushed(shell, 0.0) > 0.8 * slid > 0.3e-3  # it does not come back, but for the spring


def test_both_sheets_take_the_spring_of_the_rig_and_what_a_variant_adds() -> None:
    constants, variant = PlantConstants(), Variant(edge_spring=20e6)
    assert edge_of(LAW, constants, variant) == Edge(65e6, FRICTION)
    material = load_material("AA5754-O")
    plant = SheetPlant(LAW, material, 1e-3, 5e-3, 0.5e-3, (1e-6,) * 3, variant=variant)
    assert plant.shell.edge_stiffness.sum() == pytest.approx(65e6 * AROUND)


def test_rigs_without_a_law_keep_what_they_had() -> None:
    constants, variant = PlantConstants(), Variant()
    assert edge_of(load_rig("ren2018").clamp, constants, variant) == Edge(1e6, np.inf)
    assert edge_of(load_rig("praveen2020").clamp, constants, variant) == Edge(np.inf, np.inf)
    free = Clamp(size=(0.1, 0.08))
    plant = SheetPlant(free, load_material("AA5754-O"), 1e-3, 5e-3, 0.5e-3, (1e-6,) * 3)
    assert plant.shell.edge_stiffness.sum() == pytest.approx(1e6 * AROUND)
