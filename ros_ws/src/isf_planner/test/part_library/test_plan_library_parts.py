"""Planned contacts and normals of every part of the library against its exact surface."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from isf_core.types import Array
from isf_planner import plan
from isf_planner.part_library import PARTS, Part, part_mesh
from planner_parts import EXAMPLES, job_for, write


@pytest.mark.parametrize("name", PARTS)
def test_contacts_lie_on_the_exact_surface(name: str, tmp_path: Path) -> None:
    part = PARTS[name]()
    path = write(part_mesh(part, 2e-6), tmp_path / f"{name}.ply")
    rig = str(EXAMPLES / "rigs" / "torrao2013_1000.yaml") if name == "bonnet" else "ren2018"  # of 0.9 m
    contours = plan(job_for(path, depth="2 mm", force="0 N", limit="80 deg", rig=rig)).contours
    contact = np.vstack([contour.contact for contour in contours])
    normal = np.vstack([contour.normal for contour in contours])
    assert np.abs(part.distance(contact)).max() < (12e-6 if name == "bonnet" else 5e-6)
    off = np.degrees(np.arccos(np.clip((normal * part.normal(contact[:, :2])).sum(axis=1), -1.0, 1.0)))
    # the few worst stand where a floor fillet ends beside a corner, and the ball touches both
    assert np.percentile(off, 99) < (0.35 if name == "mask" else 0.21)  # with the fillets of eyes and nose on its floor
    assert off.max() < (0.7 if name == "ribbed_pyramid" else 0.5)  # twelve such places
    assert np.median(off) < 0.12


def cuts(part: Part, tips: Array, radius: float) -> Array:
    """(N,) m, how deep balls at ``tips`` (N, 3) cut into the part, from 4,000 points of the lower half of each."""
    height = (np.arange(40) + 0.5) / 40
    around = 2.0 * np.pi * np.arange(100) / 100
    level = np.sqrt(1.0 - height**2)[:, None]
    ball = np.stack(np.broadcast_arrays(level * np.cos(around), level * np.sin(around), -height[:, None]), axis=-1)
    ball = radius * (ball.reshape(-1, 3) + [0.0, 0.0, 1.0])
    return np.array([-part.distance(tip + ball).min() for tip in tips])


def test_no_tip_cuts_the_ribs_of_a_steep_part(tmp_path: Path) -> None:
    """80 deg, then 25 deg, as in examples/jobs/behera_80_25.yaml: at its ribs the contact jumps from wall to wall."""
    radii = {"rib": 6e-3, "entry": 3e-3, "transition": 6e-3, "floor": 5e-3}
    part = PARTS["ribbed_pyramid"](75e-3, np.radians(80), 35e-3, np.radians(25), 25e-3, **radii)
    path = write(part_mesh(part, 10e-6), tmp_path / "steep.ply")
    contours = plan(job_for(path, depth="1 mm", force="0 N", limit="82 deg")).contours
    for level in (-34e-3, -36e-3):
        tips = next(contour.forming_tip for contour in contours if abs(contour.forming_tip[0, 2] - level) < 1e-6)
        # 20 um along the normal are allowed; the facets lie up to 10 um below the part
        assert cuts(part, tips, 5e-3).max() < 30e-6
