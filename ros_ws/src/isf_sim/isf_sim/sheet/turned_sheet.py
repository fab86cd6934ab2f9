"""The sheet turned over, so that the kernels for a tool from above serve the lower tool as well.

While the lower tool presses, the plant works in z' = -z - t0: the lower face of the sheet is the upper one there, and
the lower face of the flat blank lies at z' = 0. A sheet whose upper face is at Z has its lower face at Z - t0 (volume
constancy: t0 along z), so its height turns into -Z. A support stands below
the sheet only; while the lower tool presses, the sheet is taken to be off it.
"""

from __future__ import annotations

import numpy as np
from isf_core.types import Array

from isf_sim.jit import kernel
from isf_sim.sheet.sheet_plant import SheetPlant
from isf_sim.sheet.sheet_point import LAST_BASE, LOOP, PRESSED, TRAVELLED


@kernel
def turn_tip(tip: Array, thickness: float, out: Array) -> None:
    """``tip`` (3,) m in the other frame; turning twice gives it back."""
    out[0], out[1], out[2] = tip[0], tip[1], -tip[2] - thickness


def pressing_tip(tips: Array, tool: int, thickness: float) -> Array:
    """(3,) m, tip of ``tool`` (1, 2) out of ``tips`` (2, 3) m, in the frame that the plant has while it presses."""
    tip = tips[tool - 1].copy()
    if tool == 2:
        turn_tip(tip, thickness, tip)
    return tip


def turn_over(plant: SheetPlant, tip: Array) -> None:
    """Let the other tool, with its tip at (3,) m in the frame after the turn, press the sheet of ``plant``."""
    surface, contact = plant.surface, plant.contact
    plant.forget_solutions()  # one under way works on the shell
    plant.update_base()  # what this tool has walked round follows it before the tool leaves
    for values in (surface.height, surface.formed):
        np.negative(values, out=values)
    surface.before[...] = surface.height
    _exchange_tracks(plant)
    for state in (
        contact.lateral,
        contact.drift,
        contact.force,
        contact.axial,
        contact.on_die,
        contact.sag,
        contact.eased,
    ):
        state[:] = 0.0
    contact.wall[:] = 0.0
    contact.last[:] = tip
    contact.formed_tip[:] = tip
    surface.holder[0], plant.aside.holder[0] = plant.aside.holder[0], surface.holder[0]
    plant.shell.set_support(None)  # put back with the next shape, where it stands
    plant.role.pressing[0] = 3 - plant.role.pressing[0]


def _exchange_tracks(plant: SheetPlant) -> None:
    """Each tool has its own track and loop, for which time stands still while the other one presses."""
    path, aside = plant.contact.path, plant.aside
    plant.track, aside.track = aside.track, plant.track
    aside.path[LAST_BASE] += path[TRAVELLED] - aside.path[TRAVELLED]
    aside.path[TRAVELLED] = path[TRAVELLED]
    for own in (LAST_BASE, LOOP, PRESSED):
        path[own], aside.path[own] = aside.path[own], path[own]
