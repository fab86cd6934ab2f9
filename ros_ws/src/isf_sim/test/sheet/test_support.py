"""A rigid one-sided support under the sheet, in the coarse shell and under the tool."""

from __future__ import annotations

import numpy as np
import pytest
from isf_core.files.material import load_material
from isf_core.files.rig import load_rig
from isf_core.types import Array
from isf_sim.sheet.sheet_plant import SheetPlant
from isf_sim.sheet.support import sample_under, support_points

RIG, MATERIAL = load_rig("ren2018"), load_material("AA5754-O")
RADIUS = 5e-3


def blank() -> SheetPlant:
    return SheetPlant(RIG.clamp, MATERIAL, 1e-3, RADIUS, 0.5e-3, RIG.tool_1.compliance)


def distance(plant: SheetPlant) -> Array:
    """(ny, nx) m from the middle of the fine grid."""
    n = plant.surface.height.shape[0]
    x = plant.surface.x0 + plant.surface.h * np.arange(n)
    return np.asarray(np.hypot(x[None, :], x[:, None]))


def plate(plant: SheetPlant, opening: float) -> Array:
    """A backing plate flush with the clamp round an opening of radius ``opening`` m."""
    return np.where(distance(plant) > opening, -plant.thickness, -np.inf)


def press(plant: SheetPlant, depth: float, x: float = 0.0) -> float:
    """N, axial force after moving straight down to ``depth`` m at (x, 0)."""
    for z in np.arange(0.0, -depth - 1e-9, -0.1e-3):
        plant.move(np.array([x, 0.0, z]), np.zeros(2))
    return -float(plant.contact.force[2])


def test_backing_plate_carries_the_sheet() -> None:
    """Under the same force the sheet sags less inside the plate, and lies on it outside."""
    plant = blank()
    shell = plant.shell
    patch, force = shell.load_patch(0.0, 0.0, 0.0), np.array([0.0, 0.0, -300.0])
    alone = shell.solve(patch, force)
    plant.set_support(plate(plant, 0.05))
    shell.set_support(support_points(shell, sample_under(plant.surface, shell.x, shell.y)))
    backed = shell.solve(patch, force)
    assert backed.converged
    assert backed.displacement[2] > 0.7 * alone.displacement[2]
    outside = np.hypot(shell.node_x, shell.node_y) > 0.055
    # the penalty gives way by less than 0.1 mm at the edge of the opening
    assert backed.state[outside, 2].min() > -0.1e-3
    assert alone.state[outside, 2].min() < -1e-3


def test_support_far_below_changes_nothing() -> None:
    free, over = blank(), blank()
    over.set_support(np.full(over.surface.height.shape, -0.05))
    assert press(free, 3e-3) == press(over, 3e-3)
    assert (free.surface.height == over.surface.height).all()


def test_sheet_on_a_die_takes_its_height_and_the_force_rises() -> None:
    """A flat die 2 mm below the blank: pressed 2.3 mm deep, the sheet stops at the die."""
    free, over = blank(), blank()
    height = np.where(distance(over) < 0.03, -2e-3 - over.thickness, -np.inf)
    over.set_support(height)
    alone, pressed = press(free, 2.3e-3), press(over, 2.3e-3)
    # 0.3 mm of overlap meet the series of indentation and machine, 1 / (1/k + C_z)
    series = 1.0 / (1.0 / over.point_constants.die_stiffness + RIG.tool_1.compliance[2])
    assert pressed == pytest.approx(0.3e-3 * series, rel=0.1)
    assert pressed > 3.0 * alone
    loaded = over.surface.height.min() - over.contact.sag[0]
    assert loaded > -2e-3 - 0.02e-3  # the grid of 0.5 mm sees the tip of the ball to 6 um


def test_rising_die_presses_the_sheet() -> None:
    """TPIF: with the tool at rest, a die that rises by 1 mm is felt as much as a tool that goes down."""
    over = blank()
    height = np.where(distance(over) < 0.03, -3e-3 - over.thickness, -np.inf)
    over.set_support(height)
    before = press(over, 2.5e-3)
    over.set_support(height, 1e-3)
    over.move(np.array([0.0, 0.0, -2.5e-3]), np.zeros(2))
    assert -float(over.contact.force[2]) > 3.0 * before


@pytest.mark.parametrize("bad", [np.zeros((3, 3)), np.nan, np.inf])
def test_unusable_support_is_refused(bad: Array | float) -> None:
    plant = blank()
    height = bad if isinstance(bad, np.ndarray) else np.full(plant.surface.height.shape, bad)
    with pytest.raises(ValueError, match="support"):
        plant.set_support(height)
