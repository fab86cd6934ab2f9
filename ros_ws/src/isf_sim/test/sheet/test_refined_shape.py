"""Finer meshes, solutions and points change the shape of a part by less than 3 %; single nodes by less than 6 %."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from isf_core.files.material import load_material
from isf_core.files.rig import load_rig
from isf_core.types import Array
from isf_sim.plant_constants import PlantConstants
from isf_sim.sheet import sheet_plant
from isf_sim.sheet.sheet_plant import SheetPlant

RIG, MATERIAL = load_rig("ren2018"), load_material("AA5754-O")
DEPTH = 10e-3
POINTS = 1e-3
"""m, spacing of the points on a circle."""
FINER = 1.5
"""Lines of the finer shell over the usual ones, along either side."""


def formed_cone(spacing: float = POINTS, **finer: float) -> tuple[Array, SheetPlant]:
    """(ny, nx) m, shape of a cone of 50 deg, circles every 0.5 mm, on a grid of 1 mm; and its plant."""
    constants = dataclasses.replace(PlantConstants(), **finer)
    plant = SheetPlant(RIG.clamp, MATERIAL, 1e-3, 5e-3, 0.5e-3, RIG.tool_1.compliance, constants=constants)
    for depth in np.arange(0.5e-3, DEPTH + 1e-9, 0.5e-3):
        r = 34e-3 - depth / np.tan(np.radians(50.0))
        for turn in np.arange(0.0, 2.0 * np.pi, spacing / r):
            plant.move(np.array([r * np.cos(turn), r * np.sin(turn), -depth]), np.zeros(2))
    return plant.measured_shape().z, plant


@pytest.fixture(scope="module")
def usual() -> tuple[Array, SheetPlant]:
    return formed_cone()


def check(shape: Array, usual: Array) -> None:
    """Depth and root mean square over what was formed within 1 % of the depth, every node within 6 %.

    The largest differences, 4.5 %, are those of single nodes beside the last circle, where the edge of the base, on its
    grid of 2 mm, meets the wall.
    """
    depth = -float(usual.min())
    formed = usual < -0.05 * depth
    assert depth > 3e-3  # the rest of 10 mm springs back
    assert not np.array_equal(shape, usual)
    assert -shape.min() == pytest.approx(depth, rel=0.01)
    assert np.sqrt(np.mean((shape - usual)[formed] ** 2)) < 0.01 * depth
    assert np.abs(shape - usual).max() < 0.06 * depth


@pytest.mark.parametrize(
    "finer",
    [
        {"fresh_depth": 0.5e-3, "fresh_distance": 8e-3},
        {"fine_cell": 0.25e-3},
        {"track_cell": 1e-3},
        {"spacing": 0.5 * POINTS},
    ],
    ids=["solutions", "surface", "base", "points"],
)
@pytest.mark.slow
def test_refinement_keeps_the_shape(finer: dict[str, float], usual: tuple[Array, SheetPlant]) -> None:
    check(formed_cone(**finer)[0], usual[0])


@pytest.mark.slow
def test_finer_shell_keeps_the_shape(usual: tuple[Array, SheetPlant], monkeypatch: pytest.MonkeyPatch) -> None:
    """The number of lines is bounded by a constant of the plant, so that a smaller cell alone refines nothing."""
    of = PlantConstants()
    monkeypatch.setattr(sheet_plant, "MAXIMUM_CELLS", round(FINER * sheet_plant.MAXIMUM_CELLS))
    cells = {name: getattr(of, name) / FINER for name in ("coarse_cell", "forming_cell", "flange_cell")}
    shape, plant = formed_cone(**cells)
    finest = [float(np.diff(each.shell.x).min()) for each in (usual[1], plant)]
    assert finest[1] == pytest.approx(finest[0] / FINER, rel=0.05)
    check(shape, usual[0])
