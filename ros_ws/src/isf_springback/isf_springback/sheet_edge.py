"""The edge of the sheet that is free to deflect: the clamp, or the opening of the backing plate around the path.

Over a backing plate the sheet deflects inside the opening. The closed-form law takes the opening in place of the
clamp; for the shell the plate holds the sheet up along the edge of its opening, and the clamp holds it further out.
"""

from __future__ import annotations

import numpy as np
from isf_core.contour import Contour, Process
from isf_core.files.job import JobFile
from isf_core.geometry.opening import SMALLEST_GAP, ClampRadius, Opening, clamp_radius
from isf_core.process import free_sheet
from isf_core.types import Array

from isf_springback.loop_path import forming_radius
from isf_springback.shell.plan_mesh import rectangle

CLOSE = 3.0
"""Radii of the forming tool within which a backing plate holds the sheet where it is formed (assumed). On
praveen_cone_150, whose plate is four radii away, the sheet beside the opening bends down with each of the first
contours as in a bare clamp: the opening came out 0.43 mm too deep where it was taken for held, else 0.32 mm."""

OPENING_STEPS = 2.0
"""Incremental depths below the flange within which the first contour of a feature begins an opening; deeper ones begin
inside another feature (assumed)."""

ROUND_CORNERS = 48
"""Corners of the polygon for a round opening: its area is 0.3 % smaller than that of the circle."""


def free_size(job_file: JobFile) -> tuple[float, float]:
    """m, extent in x and y of the sheet that is free to deflect, centred at 0.

    Of a round plate the diameters.
    """
    plate = job_file.job.backing_plate
    return job_file.rig.clamp.size if plate is None else plate.extent


def holding_size(job_file: JobFile) -> tuple[float, float]:
    """m, extent in x and y of what holds the sheet of the shell, with equal sides where those of clamp and plate are
    equal: it tells by which turns the sheet stays the same. An opening along an outline is as the part's."""
    clamp, plate = job_file.rig.clamp.size, job_file.job.backing_plate
    return clamp if plate is None or clamp[0] != clamp[1] else plate.extent


def plate_edge(job_file: JobFile) -> tuple[Array, ...]:
    """(P, 2) m, edges of the openings of the backing plate, counter-clockwise, a round one as a polygon inside the
    circle and a rectangle with sharp corners; none without a plate."""
    plate = job_file.job.backing_plate
    if plate is None:
        return ()
    if plate.shape == "outline":
        return plate.loops
    if plate.shape == "rectangle":
        return (rectangle(plate.extent),)
    angle = 2.0 * np.pi * np.arange(ROUND_CORNERS) / ROUND_CORNERS
    return (plate.round_radius * np.column_stack([np.cos(angle), np.sin(angle)]),)


def edge_radius(job_file: JobFile, opening: Opening, points: Array, kind: ClampRadius) -> Array:
    """(M,) m, radius of the free sheet that belongs to ``points`` (M, 2) m, as
    :func:`isf_core.geometry.opening.clamp_radius` says.

    A round plate has its own radius, whatever ``kind``; one along an outline lies as far beyond the opening as beside
    it there.
    """
    plate = job_file.job.backing_plate
    if plate is None or plate.shape == "rectangle":
        return clamp_radius(opening, points, free_size(job_file), kind)
    if plate.shape == "outline":
        edge = opening.place_towards(points)
        radius = opening.radius_towards(points) + plate.inside(edge[:, 0], edge[:, 1])
    else:
        radius = np.full(len(points), plate.round_radius)
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


def opening_sag(contour: Contour, job_file: JobFile) -> float:
    """m, how far the opening that begins with ``contour`` is expected to sink below it, whatever the correction of
    springback: the sheet yields between there and what holds it (:mod:`isf_core.process.free_sheet`).

    0 over a die, in ADSIF, for a contour inside another feature, and with the support tool under the blank. The part is
    taken to be as deep as its contours could reach.
    """
    job, step = job_file.job, job_file.job.path.incremental_depth
    begins = abs(float(contour.contact[:, 2].mean())) <= OPENING_STEPS * step
    if contour.process not in (Process.SPIF, Process.DSIF) or job.support_stays or not begins:
        return 0.0
    x, y = contour.contact[:, 0], contour.contact[:, 1]
    half = 0.5 * np.asarray(job_file.rig.clamp.size)
    clamp = np.minimum(half[0] - np.abs(x), half[1] - np.abs(y))
    free = clamp if job.backing_plate is None else np.minimum(clamp, job.backing_plate.inside(x, y))
    beside = contour.has_support and not contour.support_waits
    return free_sheet.opening_sag(float(free.max()), contour.count * step, two_tools=beside)
