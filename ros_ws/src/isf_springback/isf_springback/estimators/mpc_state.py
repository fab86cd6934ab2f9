"""States of the model-predictive controllers from a formed shape: sections, levels and contacts around a contour.

Sections are radial, through the middle of the contour (Lu 2016 uses polar coordinates); ``reach`` counts along the
direction in which forming proceeds: inwards for SPIF and DSIF, outwards over a die (TPIF).

Horizontal springback between the directions that were optimised (Lu 2016, 3.3.2, eq. 23-30).

Scale factors beta = 1 + D / r of the radius are taken as equal (uniform), or as linear in the radius between wall
middle and corner (interpolated). With several directions, neighbours a, b bound segments; where the radius does not
change evenly between them, the angle takes its place.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from isf_core.contour import Contour, contour_label
from isf_core.errors import ErrorCode, IsfError
from isf_core.geometry.height_map import HeightMap
from isf_core.types import Array
from numpy.typing import NDArray

from isf_springback.loop_path import LoopPath
from isf_springback.scan import sections
from isf_springback.scan.readings import WALL_REACH, median_of_rows
from isf_springback.scan.sections import STEP, Directions

OUTSIDE = 20e-3
"""m of section on the formed side of the contact: as far as a wall of one horizon and its rim."""


@dataclass(frozen=True)
class PolarContour:
    """A contour seen from its middle.

    Attributes
    ----------
    centre : (2,) m ; angle : (N,) rad ; radius : (N,) m ; radial : (N, 2) unit
    """

    centre: Array
    angle: Array
    radius: Array
    radial: Array

    @staticmethod
    def of(contour: Contour, centre: Array | None = None) -> PolarContour:
        """Polar coordinates of the contacts; raises CORRECTION_FAILED when they go back and forth in angle."""
        place = contour.contact[:, :2]
        middle = 0.5 * (place.min(axis=0) + place.max(axis=0)) if centre is None else centre
        offset = place - middle
        radius = np.linalg.norm(offset, axis=1)
        angle = np.arctan2(offset[:, 1], offset[:, 0])
        turn = np.diff(np.unwrap(angle))
        backwards = min(float((turn > 1e-9).mean()), float((turn < -1e-9).mean()))
        if radius.min() < 1e-4 or backwards > 0.02:
            raise IsfError(
                ErrorCode.CORRECTION_FAILED,
                "the contour cannot be described by one radius per direction",
                where=contour_label(contour.index),
                advice="use the method fused, which follows the contour itself",
            )
        return PolarContour(middle, angle, radius, offset / radius[:, None])


@dataclass(frozen=True)
class Sections:
    """M radial sections around the contour that was formed last.

    Attributes
    ----------
    directions : places and directions ; angle : (M,) rad
    reach : (n,) m ; formed, target : (M, n) m, heights ; radius : m, of the ball
    progress : +1 forming proceeds along the radius (TPIF), -1 against it
    wall_angle : (M,) rad of the contour
    """

    directions: Directions
    angle: Array
    reach: Array
    formed: Array
    target: Array
    radius: float
    progress: float
    wall_angle: Array

    def pick(self, rows: NDArray[np.intp]) -> Sections:
        """The sections ``rows`` alone."""
        d = self.directions
        chosen = Directions(d.position[rows], d.origin[rows], d.outward[rows], d.contact_level[rows], d.tip_level[rows])
        return Sections(
            chosen,
            self.angle[rows],
            self.reach,
            self.formed[rows],
            self.target[rows],
            self.radius,
            self.progress,
            self.wall_angle[rows],
        )


def radial_sections(
    contour: Contour, angles: Array, surface: HeightMap, target: HeightMap, radius: float, inside: float
) -> Sections:
    """Sections of ``surface`` and ``target`` through ``contour`` in the directions ``angles`` (M,) rad.

    ``inside`` : m of section on the unformed side.
    """
    polar = PolarContour.of(contour)
    lean = float(np.mean(np.sum(contour.normal[:, :2] * polar.radial, axis=1)))
    progress = 1.0 if lean > 0.05 else -1.0
    order = np.argsort(polar.angle)
    ring = polar.angle[order]

    def at(values: Array) -> Array:
        return np.asarray(np.interp(angles, ring, values[order], period=2.0 * np.pi))

    direction = np.column_stack([np.cos(angles), np.sin(angles)])
    path = LoopPath.of(contour)
    directions = Directions(
        at(path.position),
        polar.centre + at(polar.radius)[:, None] * direction,
        -progress * direction,
        at(contour.contact[:, 2]),
        at(contour.forming_tip[:, 2]),
    )
    reach = STEP * np.arange(-round(OUTSIDE / STEP), round(inside / STEP) + 1, dtype=np.float64)
    return Sections(
        directions,
        angles,
        reach,
        sections.vertical_sections(surface, directions, reach),
        sections.vertical_sections(target, directions, reach),
        radius,
        progress,
        at(contour.wall_angle),
    )


@dataclass(frozen=True)
class IntendedProfiles:
    """What a section is to look like after contours 0 (formed last) .. H.

    Attributes
    ----------
    level : (H + 1,) m, tip heights ; contact : (M, H + 1) m, reach of the contacts
    profile : (M, H + 1, n) m
    """

    level: Array
    contact: Array
    profile: Array


def intended_profiles(cut: Sections, level: Array) -> IntendedProfiles:
    """Wall down to the contact, ball under the tool, flat bottom at the level of the tip.

    The contacts ahead follow from dropping the ball on the section of the target: they are those of the plan on
    every part whose wall turns slowly.
    """
    tip, touch = sections.dropped_ball(cut.target, cut.radius)
    count, reach = len(cut.directions), cut.reach
    contact = np.empty((count, len(level)))
    profile = np.empty((count, len(level), len(reach)))
    near = np.abs(reach) <= max(4.0 * cut.radius, 40e-3)
    for j, height in enumerate(level):
        deep = (tip <= height + 1e-6) & near & (reach > -2.0 * cut.radius)
        lowest = np.argmin(np.where(near, tip, np.inf), axis=1)
        first = np.where(deep.any(axis=1), np.argmax(deep, axis=1), lowest)
        rows = np.arange(count)
        contact[:, j] = reach[touch[rows, first]]
        place = reach[first]
        under = np.clip(reach[None, :] - place[:, None], -cut.radius, 0.0)
        ball = height + cut.radius - np.sqrt(cut.radius**2 - under**2)
        wall = reach[None, :] <= contact[:, j, None]
        profile[:, j] = np.where(wall, cut.target, np.fmax(ball, cut.target))
    return IntendedProfiles(level, contact, profile)


def bottom_error(cut: Sections, contour_level: float, width: float = 1e-3, began: HeightMap | None = None) -> Array:
    """(M,) m, formed minus intended height under the tip of the contour formed last; NaN where not seen.

    Where the stage ``began`` with a sheet that was deeper there (None: the flat blank), it is that of the wall at the
    contact.
    """
    lever = cut.radius * np.sin(cut.wall_angle)
    away = np.abs(cut.reach[None, :] - lever[:, None])
    known = np.where(away <= width, cut.formed, np.nan)
    seen = np.isfinite(known).any(axis=1)
    level = np.full(len(known), np.nan)
    level[seen] = np.nanmedian(known[seen], axis=1)
    error = level - contour_level
    if began is not None:
        before = sections.vertical_sections(began, cut.directions, cut.reach)
        deeper = before.min(axis=1, initial=np.inf, where=away <= width) < contour_level
        contact = (cut.reach >= WALL_REACH[0]) & (cut.reach <= WALL_REACH[1])
        error = np.where(deeper, median_of_rows((cut.formed - cut.target)[:, contact]), error)
    return np.asarray(error)


def radius_errors(cut: Sections, contact_ahead: Array, vertical_ahead: Array) -> Array:
    """(M, H) m, predicted wall minus design radius (positive outwards of the formed side), planned increments only.

    Parameters
    ----------
    contact_ahead : (M, H + 1) m, planned contact levels of contours 0 .. H
    vertical_ahead : (M, H + 1) m, vertical error expected at each: the design is read at the plane that will be met
    """
    measured = sections.crossing(cut.formed, cut.reach, contact_ahead[:, 0] + vertical_ahead[:, 0])
    planned = sections.crossing(cut.target, cut.reach, contact_ahead[:, 0])
    errors = []
    for j in range(1, contact_ahead.shape[1]):
        ahead = sections.crossing(cut.target, cut.reach, contact_ahead[:, j])
        wanted = sections.crossing(cut.target, cut.reach, contact_ahead[:, j] + vertical_ahead[:, j])
        errors.append(wanted - (measured + ahead - planned))
    result = np.column_stack(errors)
    # at the floor a level has no wall to cross: the last error that could be read stands for the rest
    for j in range(1, result.shape[1]):
        result[:, j] = np.where(np.isfinite(result[:, j]), result[:, j], result[:, j - 1])
    return np.asarray(result)


Distribution = Literal["none", "uniform", "interpolated", "dense"]

SMALLEST_SPAN = 0.02
"""Difference of two radii, as part of them, below which their ratio says nothing."""


def distribute(
    departure: Array, directions: Array, angle: Array, radius: Array, kind: Distribution, neutral: bool = True
) -> Array:
    """(N,) m, departures at the points of a contour.

    Parameters
    ----------
    departure : (S,) m in the ``directions`` (S,) rad
    angle, radius : (N,) rad, m, points of the contour seen from its middle
    kind : see the module; "dense" interpolates in the angle between many directions
    neutral : one direction only, interpolated: the nearest radius of all (wall middle) gets none (eq. 30)
    """
    order = np.argsort(np.mod(directions, 2 * np.pi))
    departure, directions = departure[order], np.mod(directions, 2 * np.pi)[order]
    here = np.mod(angle, 2 * np.pi)
    if kind == "none":
        return np.zeros(len(angle))
    if kind == "dense":
        return np.asarray(np.interp(here, directions, departure, period=2 * np.pi))
    by_angle = np.argsort(here)
    at = np.interp(directions, here[by_angle], radius[by_angle], period=2 * np.pi)
    if kind == "uniform":
        scale = np.interp(here, directions, departure / at, period=2 * np.pi)
        return np.asarray(radius * scale)
    if len(departure) == 1:
        least = float(radius.min())
        span = float(at[0]) - least
        if not neutral or span < SMALLEST_SPAN * least:
            return np.asarray(departure[0] * radius / at[0])
        return np.asarray(departure[0] * radius * (radius - least) / (at[0] * span))
    return _between(departure / at, directions, at, here, radius)


def _between(factor: Array, directions: Array, at: Array, here: Array, radius: Array) -> Array:
    """Departures (N,) from beta - 1 = ``factor`` (S,) at several directions, segment by segment."""
    count = len(directions)
    segment = np.searchsorted(directions, here, side="right") - 1
    a, b = segment % count, (segment + 1) % count
    way = np.mod(directions[b] - directions[a], 2 * np.pi)
    by_angle = np.mod(here - directions[a], 2 * np.pi) / np.where(way > 0, way, 2 * np.pi)
    span = at[b] - at[a]
    usable = np.abs(span) > SMALLEST_SPAN * at[a]
    ratio = (radius - at[a]) / np.where(usable, span, 1.0)
    share = np.where(usable & (ratio >= 0.0) & (ratio <= 1.0), ratio, by_angle)
    return np.asarray(radius * (factor[a] + share * (factor[b] - factor[a])))
