"""The edge of the sheet that is free to deflect: the clamp, or the opening of the backing plate around the path.

Over a backing plate the sheet deflects inside the opening. The closed-form law takes the opening in place of the
clamp; for the shell the plate holds the sheet up along the edge of its opening, and the clamp holds it further out.
"""

from __future__ import annotations

import numpy as np
from isf_core.contour import Contour
from isf_core.files.job import JobFile
from isf_core.geometry.opening import SMALLEST_GAP, ClampRadius, Opening, clamp_radius
from isf_core.types import Array

from isf_springback.loop_path import forming_radius
from isf_springback.shell.formed_sheet import NO_PLATE
from isf_springback.shell.plan_mesh import rectangle

CLOSE = 3.0
"""Radii of the forming tool within which a backing plate holds the sheet where it is formed (assumed). On
praveen_cone_150, whose plate is four radii away, the sheet beside the opening bends down with each of the first
contours as in a bare clamp: the opening came out 0.43 mm too deep where it was taken for held, else 0.32 mm."""

ROUND_CORNERS = 48
"""Corners of the polygon for a round opening: its area is 0.3 % smaller than that of the circle."""


def free_size(job_file: JobFile) -> tuple[float, float]:
    """m, extent in x and y of the sheet that is free to deflect, centred at 0.

    Of a round plate the diameters.
    """
    plate = job_file.job.backing_plate
    return job_file.rig.clamp.size if plate is None else plate.size


def holding_size(job_file: JobFile) -> tuple[float, float]:
    """m, extent in x and y of what holds the sheet of the shell, with equal sides where those of clamp and plate are
    equal: it tells by which turns the sheet stays the same."""
    clamp, plate = job_file.rig.clamp.size, job_file.job.backing_plate
    return clamp if plate is None or clamp[0] != clamp[1] else plate.size


def plate_edge(job_file: JobFile) -> Array:
    """(P, 2) m, edge of the opening of the backing plate, counter-clockwise, a round one as a polygon inside the circle
    and a rectangle with sharp corners; (0, 2) without a plate."""
    plate = job_file.job.backing_plate
    if plate is None:
        return NO_PLATE
    if plate.shape == "rectangle":
        return rectangle(plate.size)
    angle = 2.0 * np.pi * np.arange(ROUND_CORNERS) / ROUND_CORNERS
    return 0.5 * plate.size[0] * np.column_stack([np.cos(angle), np.sin(angle)])


def edge_radius(job_file: JobFile, opening: Opening, points: Array, kind: ClampRadius) -> Array:
    """(M,) m, radius of the free sheet that belongs to ``points`` (M, 2) m, as
    :func:`isf_core.geometry.opening.clamp_radius` says.

    A round plate has its own radius, whatever ``kind``.
    """
    plate = job_file.job.backing_plate
    if plate is None or plate.shape == "rectangle":
        return clamp_radius(opening, points, free_size(job_file), kind)
    radius = np.full(len(points), 0.5 * plate.size[0])
    return np.asarray(np.maximum(radius, opening.radius_towards(points) / (1.0 - SMALLEST_GAP)))


def free_ring(job_file: JobFile, opening: Opening, points: Array, kind: ClampRadius) -> tuple[Array, Array]:
    """(M,), (M,) m, radius of the free sheet and of the opening that belong to ``points`` (M, 2) m."""
    return edge_radius(job_file, opening, points, kind), opening.radius_towards(points)


def held_by_plate(contour: Contour, job_file: JobFile) -> bool:
    """True where the edge of a backing plate lies in the mean within :data:`CLOSE` tool radii around ``contour``."""
    plate = job_file.job.backing_plate
    if plate is None:
        return False
    away = plate.inside(contour.contact[:, 0], contour.contact[:, 1])
    return float(away.mean()) <= CLOSE * forming_radius(job_file, contour.forming_tool)
