"""Events found with and without looking at every tick: the same ones at the same ticks."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from isf_core.events import EventKind
from isf_core.files.material import FormingLimit, load_material
from isf_core.files.rig import load_rig
from isf_sim.machine.axes import make_axis_errors
from isf_sim.machine.events import NEVER, EventWatch, conditions, event_bounds, event_limits, settled
from isf_sim.machine.load_cells import CellState
from isf_sim.machine.tick import parked_axes
from isf_sim.plant_constants import PlantConstants
from isf_sim.sheet.sheet_plant import SheetPlant
from isf_sim.sheet.sheet_point import TRAVELLED
from isf_sim.sheet.squeeze import no_squeeze

RATE, RADIUS, BLANK = 500.0, 5e-3, 1e-3
RIG, MATERIAL = load_rig("ren2018"), load_material("AA5754-O")
LIMITS = event_limits(MATERIAL.tensile_strength, FormingLimit(0.990, 1.0, 0.15), RADIUS, BLANK, RATE)
PLANT = SheetPlant(
    RIG.clamp,
    MATERIAL,
    BLANK,
    RADIUS,
    0.5e-3,
    RIG.tool_1.compliance,
    constants=PlantConstants(coarse_cell=250e-3 / 16, fine_cell=2e-3),
)


class Stretch(NamedTuple):
    """What holds for ``ticks`` ticks."""

    ticks: int
    force: float
    axial: float
    gap: float
    strain: float
    on_die: float
    clipped: int
    saturated: int
    stands: bool


STRETCHES = st.builds(
    Stretch,
    ticks=st.integers(1, 320),
    force=st.sampled_from([0.0, 5.0, 10.0, 10.5, 80.0, 0.999 * LIMITS.galling, LIMITS.galling, 1.2 * LIMITS.galling]),
    axial=st.sampled_from([0.0, 50.0, 51.0, 600.0]),
    gap=st.sampled_from([0.9e-3, 3e-3 - 1e-12, 3e-3, 3e-3 + 1e-12, 20e-3]),
    strain=st.sampled_from(
        [0.0, 0.5, LIMITS.forming.strain, 1.01 * LIMITS.forming.strain, 1.3 * LIMITS.forming.strain]
    ),
    on_die=st.sampled_from([0.0, 1.0, 1.1]),
    clipped=st.sampled_from([0, 0, 0, 1]),
    saturated=st.sampled_from([0, 0, 0, 4]),
    stands=st.sampled_from([False, False, True]),
)


@settings(max_examples=25, deadline=None)
@given(stretches=st.lists(STRETCHES, min_size=1, max_size=7), way=st.sampled_from([0.06e-3, 0.4e-3]))
def test_a_watch_that_looks_only_when_something_changes_finds_the_same(stretches: list[Stretch], way: float) -> None:
    always, seldom = EventWatch(LIMITS), EventWatch(LIMITS)
    found: tuple[list[tuple[int, EventKind]], list[tuple[int, EventKind]]] = ([], [])
    bounds = event_bounds(LIMITS, (RADIUS, RADIUS), BLANK)
    axes = parked_axes(np.zeros(3), np.zeros(3), make_axis_errors(RIG))
    squeeze, contact = no_squeeze(), PLANT.contact
    cell = CellState(np.zeros(3), np.zeros(6), np.zeros(6), np.zeros(6), np.zeros(1, dtype=np.int64))
    known, looks, tick, x = NEVER, 0, 0, 0.0
    contact.path[TRAVELLED] = 0.0
    for stretch in stretches:
        axes.tips[1] = 0.0, 0.0, 4.0 * RADIUS + stretch.gap
        axes.force_1[2], axes.force_2[2] = stretch.axial, -stretch.force
        axes.saturated[0], cell.clipped[0] = stretch.saturated, stretch.clipped
        contact.axial[0], contact.on_die[0] = stretch.axial, stretch.on_die
        squeeze.thickness[0] = BLANK * math.exp(-stretch.strain)
        for _ in range(stretch.ticks):
            tick += 1
            contact.path[TRAVELLED] += way
            travelled = contact.path[TRAVELLED]
            x += 0.0 if stretch.stands else way
            bits = conditions(False, RADIUS, axes, PLANT.surface, contact, squeeze, cell, cell, bounds)
            found[0].extend((tick, kind) for kind in always.update(bits, travelled, x, 0.0))
            if bits != known:
                looks += 1
                found[1].extend((tick, kind) for kind in seldom.update(bits, travelled, x, 0.0))
                known = bits if settled(seldom, bits) else NEVER
    assert found[0] == found[1]
    assert always.broken == seldom.broken
    if not any(stretch.clipped or stretch.stands for stretch in stretches):
        quiet = [item for item in stretches if item.strain < 0.9 * LIMITS.forming.strain]
        # nothing is counted longer than half a second: 250 ticks
        assert looks <= tick - sum(max(item.ticks - 260, 0) for item in quiet)
