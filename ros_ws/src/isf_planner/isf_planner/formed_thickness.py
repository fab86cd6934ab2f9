"""Predicted thickness along the paths of a feature: sine law, or the overlap method section by section."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from isf_core import thickness
from isf_core.job import Job
from numpy.typing import NDArray
from scipy.spatial import KDTree

from isf_planner.joined_paths import TipPath
from isf_planner.loop_family import family
from isf_planner.mesh_checks import place_text
from isf_planner.sides import Side
from isf_planner.tip_loops import TipLoop

Array = NDArray[np.float64]

SECTIONS = 16
"""Vertical sections around a feature in which the overlap method is run."""


def along(chain: Sequence[TipLoop], paths: Sequence[TipPath], job: Job) -> list[Array | None]:
    """Thickness (N,) m of every path; None where the sine law of its own wall angle holds.

    ``job`` with the forming tool as tool_1, loops and paths as that tool sees them.
    """
    if job.path.thickness == "sine_law" or not sectioned(chain):
        return [None] * len(paths)
    points, formed = by_overlap(chain, job.tool_1.ball_radius, job.sheet.thickness)
    tree = KDTree(points)
    result: list[Array | None] = []
    for path in paths:
        distance, nearest = tree.query(path.points, k=4)
        weight = 1.0 / np.maximum(distance, 1e-6) ** 2
        result.append(np.asarray((formed[nearest] * weight).sum(axis=1) / weight.sum(axis=1)))
    return result


def sectioned(chain: Sequence[TipLoop]) -> bool:
    """Whether the overlap method says anything about a feature: passes follow each other inwards from an opening."""
    return len(chain) >= 3 and not chain[0].island


def left_to_sine_law(sides: Sequence[Side], job: Job) -> tuple[str, ...]:
    """Warning for the features that the overlap method leaves to the sine law, with their place."""
    if job.path.thickness == "sine_law":
        return ()
    chains = [(side, [side.tree.loops[k] for k in feature.loops]) for side in sides for feature in side.tree.features]
    left = [(side, chain[0]) for side, chain in chains if chain and not sectioned(chain)]
    if not left:
        return ()
    place = left[0][0].in_sheet(left[0][1].tip.mean(axis=0))
    return (
        f"thickness overlap: at {place_text(place)} and {len(left) - 1} more features the passes "
        f"do not follow each other inwards (an island, or fewer than three contours): sine law there",
    )


def by_overlap(chain: Sequence[TipLoop], radius: float, initial: float) -> tuple[Array, Array]:
    """Tips (K * M, 3) m of K loops at M phases around, and the thickness (K * M,) m at their contacts."""
    tips = family([loop.tip for loop in chain], 1e-3).points
    contacts, angles = [], []
    for loop, row in zip(chain, tips, strict=True):
        nearest = KDTree(loop.tip).query(row)[1]
        contacts.append(row + np.array([0.0, 0.0, radius]) - radius * loop.normal[nearest])
        angles.append(np.arccos(np.clip(np.abs(loop.normal[nearest, 2]), 0.0, 1.0)))
    contact, angle = np.array(contacts), np.array(angles)
    count = tips.shape[1]
    columns = np.unique(np.linspace(0, count, SECTIONS, endpoint=False).astype(np.int64))
    formed = np.empty((len(chain), len(columns)))
    for s, column in enumerate(columns):
        step = np.linalg.norm(np.diff(contact[:, column, :2], axis=0), axis=1)
        x = np.concatenate([[0.0], np.cumsum(step)])
        z = -np.maximum.accumulate(np.abs(contact[:, column, 2]))
        formed[:, s] = thickness.overlap(x, z, angle[:, column], radius, initial)
    around = np.arange(count)
    everywhere = np.array([np.interp(around, columns, row, period=count) for row in formed])
    return tips.reshape(-1, 3), everywhere.ravel()
