"""The linear axes that put a tool where it is, with the limits of the rig."""

from __future__ import annotations

from isf_core.files.rig import Rig

from isf_description.tree import ORIGIN, Joint, Limits, Vector

ALONG: tuple[Vector, Vector, Vector] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
"""x, y, z"""


def linear_axis(rig: Rig, tool: str, axis: int, parent: str, child: str, place: Vector = ORIGIN) -> Joint:
    """Joint ``tool_k_x`` (``axis`` 0), ``_y`` (1) or ``_z`` (2); its position is that coordinate of the tip, m."""
    limits, travel = rig.limits, rig.limits.travel[axis]
    bounds = Limits(-travel, travel, limits.speed, limits.force[axis])
    return Joint(f"{tool}_{'xyz'[axis]}", parent, child, "prismatic", place, axis=ALONG[axis], limits=bounds)
