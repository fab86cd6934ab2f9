"""Contours made by hand for the planner's tests: circles with a constant wall angle. Lengths in m, angles in rad."""

from __future__ import annotations

import numpy as np
from isf_core.contour import Contour, Process
from isf_core.process.thickness_and_tips import forming_tip, support_tip


def circle(
    radius: float = 30e-3,
    z: float = -5e-3,
    angle: float = np.radians(45),
    sheet: float = 1e-3,
    count: int = 180,
    feature: int = 0,
    tools: int = 1,
) -> Contour:
    """A pocket's contour with its contacts on a circle; tools of 5 mm radius."""
    turn = 2 * np.pi * np.arange(count) / count
    contact = np.column_stack([radius * np.cos(turn), radius * np.sin(turn), np.full(count, z)])
    normal = np.column_stack(
        [-np.sin(angle) * np.cos(turn), -np.sin(angle) * np.sin(turn), np.full(count, np.cos(angle))]
    )
    thickness = np.full(count, sheet * np.cos(angle))
    return Contour(
        plan_id="hand-0",
        index=0,
        count=1,
        process=Process.DSIF if tools == 2 else Process.SPIF,
        feed=30e-3,
        contact=contact,
        normal=normal,
        wall_angle=np.full(count, angle),
        thickness=thickness,
        forming_tip=forming_tip(contact, normal, 5e-3),
        support_tip=support_tip(contact, normal, 5e-3, thickness) if tools == 2 else np.empty((0, 3)),
        feature=feature,
    ).validate()
