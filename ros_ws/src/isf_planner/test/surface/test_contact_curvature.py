"""Principal curvatures at the contacts, and what the plan says of them, against surfaces of known curvature."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from isf_planner import plan
from isf_planner.surface.target_surface import fine_surface, principal
from planner_parts import Cone, job_for, revolve, write

R = 5e-3


def test_spherical_bowl() -> None:
    bowl = 20e-3
    turn = np.radians(np.linspace(60, 0.5, 120))
    profile = np.column_stack([bowl * np.sin(turn), -bowl * (np.cos(turn) - np.cos(turn[0]))])
    surface = fine_surface(revolve(profile, 360), R)
    angle = np.linspace(0, 2 * np.pi, 40)
    for distance in (3e-3, 8e-3, 12e-3):
        found = principal(surface, distance * np.column_stack([np.cos(angle), np.sin(angle)]), R)
        # facets of 0.5 deg by 1 deg: normals over 1 mm are right to a few per cent of 1 / 20 mm
        np.testing.assert_allclose(found, 1 / bowl, rtol=0.06)


def test_cone_and_its_fillets(tmp_path: Path) -> None:
    """Seen along the wall 0, entry -1/6 mm, floor 1/8 mm; around the axis sin(a) / r by Meusnier."""
    cone = Cone()
    tree = plan(job_for(write(cone.mesh(), tmp_path / "cone.stl"))).tree
    assert tree is not None
    seen = set()
    for loop in tree.loops:
        contact = loop.contact(R)
        around = np.sin(np.arccos(loop.normal[0, 2])) / np.hypot(*contact[0, :2])
        z = contact[:, 2].mean()
        if cone.floor_begin + 1e-3 < z < cone.entry_end - 1e-3:
            along, where = 0.0, "wall"
        elif -5e-4 > z > cone.entry_end + 5e-4:
            along, where = -1 / cone.entry, "entry"
        elif -cone.depth + 5e-4 < z < cone.floor_begin - 5e-4:
            along, where = 1 / cone.floor, "floor"
        else:
            continue
        seen.add(where)
        expected = sorted([along, around], reverse=True)
        np.testing.assert_allclose(loop.curvature, np.tile(expected, (len(contact), 1)), atol=0.12 / 6e-3)
    assert seen == {"wall", "entry", "floor"}
