"""Worlds: world 0 is the nominal plant; every other world is a seeded plant off its nominal constants.

Controllers are judged in several worlds, because a real cell never has the constants of its model.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.rig import Clamp

from isf_sim.plant_constants import PlantConstants

STANDARD_WORLDS = tuple(range(1, 21))
"""Numbers of the twenty off-nominal worlds, all of seed 0, that controllers are scored on; 0 is nominal."""


@dataclass(frozen=True)
class World:
    """Factors on the nominal constants, the in-plane edge spring (N/m^2) added to a free edge, and how far off a
    scanner believes the sheet to be: shift x, y, z m and turn about z rad (registration)."""

    young_modulus: float = 1.0
    thickness: float = 1.0
    force_level: float = 1.0
    friction: float = 1.0
    compliance: float = 1.0
    load_cell_gain: float = 1.0
    edge_spring: float = 0.0
    yield_strength: float = 1.0
    registration_x: float = 0.0
    registration_y: float = 0.0
    registration_z: float = 0.0
    registration_turn: float = 0.0

    def as_dict(self) -> dict[str, float]:
        """Name and value of every perturbation, for the record."""
        return {item.name: float(getattr(self, item.name)) for item in fields(self)}


def make_world(number: int, seed: int = 0) -> World:
    """World ``number`` of ``seed``: 0 is nominal; others draw each factor uniformly.

    Half widths: E 10 %, thickness 5 % (rolling tolerance), force level 15 %, friction 20 %, compliance 20 %,
    load-cell gain 3 % (calibration), edge spring 0-60 N/mm^2 (a fifth of the blank's own in-plane stiffness), yield
    strength 10 %, registration of a scan 0.2 mm in x and y, 0.1 mm in z, 0.2 deg. All of these widths are assumed.

    Raises
    ------
    IsfError : FILE_FIELD, a negative number
    """
    if number < 0:
        raise IsfError(ErrorCode.FILE_FIELD, f"world is {number}, must be 0 or positive", where="world")
    if number == 0:
        return World()
    draw = np.random.default_rng([number, seed % 2**63]).uniform
    return World(
        young_modulus=float(draw(0.9, 1.1)),
        thickness=float(draw(0.95, 1.05)),
        force_level=float(draw(0.85, 1.15)),
        friction=float(draw(0.8, 1.2)),
        compliance=float(draw(0.8, 1.2)),
        load_cell_gain=float(draw(0.97, 1.03)),
        edge_spring=float(draw(0.0, 60.0e6)),
        yield_strength=float(draw(0.9, 1.1)),
        registration_x=float(draw(-0.2e-3, 0.2e-3)),
        registration_y=float(draw(-0.2e-3, 0.2e-3)),
        registration_z=float(draw(-0.1e-3, 0.1e-3)),
        registration_turn=float(draw(-0.0035, 0.0035)),
    )


def in_plane_spring(clamp: Clamp, constants: PlantConstants, world: World) -> float:
    """N/m^2, in-plane spring of the free edge of ``clamp``: the rig's, else what keeps it from drifting; and what the
    ``world`` adds."""
    own = constants.edge_spring if clamp.edge_spring is None else clamp.edge_spring
    return own + world.edge_spring
