"""A shape scanner over the clamp: what it sees of a sheet, and what is wrong with what it sees.

Light-stripe triangulation from above (Lu 2016, 3.5.2: within +-0.05 mm, about 2.5 s per scan). Points are unordered and
in the frame in which the scanner believes the sheet to be. Left out are points on walls that it sees too flatly, in
the shadow of a tool, and in patches of shine. All sizes other than noise and duration are assumed.

After release and trimming: everything further from the formed region than the trimming margin is cut off, and the part
is levelled on its rim. The elasto-plastic sheet finds its shape without clamp and cut-off flange by equilibrium; the
fast sheet cannot be released.
"""

from __future__ import annotations

import numpy as np
from isf_core.geometry.height_map import HeightMap
from isf_core.types import Array
from numpy.typing import NDArray
from scipy.ndimage import binary_fill_holes, distance_transform_edt

from isf_sim.sheet.surface import Surface
from isf_sim.variant import Variant

SCAN_TIME = 2.5
"""s, published."""
NOISE = 0.05e-3
"""m, published bound of the error of a point; a third of it is the standard deviation."""
SPACING = 1.0e-3
"""m between points, with as much disorder."""
FLATTEST_VIEW = np.radians(75.0)
"""Between a surface normal and the line of sight."""
VIEW = np.array([0.0, -np.sin(np.radians(15.0)), np.cos(np.radians(15.0))])
"""Towards the scanner."""
SHINE_PATCHES, SHINE_RADIUS = 6, 4.0e-3
CLAMP_HEIGHT, CLAMP_SPACING = 10.0e-3, 2.0e-3
"""m, of a clamp's frame over the sheet, and between points of it (assumed)."""
REPEATED_SHIFT, REPEATED_TURN = 0.02e-3, 2.0e-4
"""m and rad, registration that differs from scan to scan (standard deviation)."""
TRIM_MARGIN = 8.0e-3
"""m, rim that trimming leaves around the formed region."""


def measured_points(
    shape: HeightMap,
    surface: Surface,
    tips: Array,
    radii: Array,
    variant: Variant,
    generator: np.random.Generator,
    clamped: bool,
) -> Array:
    """(N, 3) m, unordered points of ``shape`` as the scanner reports them.

    ``surface`` tells what was formed; ``tips`` (2, 3) m and ``radii`` (2,) m of the tools; ``variant`` what is wrong
    with the scanner.
    """
    margin = 0.5 * SPACING
    gx, gy = np.meshgrid(_middles(shape.x), _middles(shape.y))
    plan = np.column_stack([gx.ravel(), gy.ravel()]) + generator.uniform(-margin, margin, (gx.size, 2))
    dz_dx, dz_dy = shape.gradient()
    slopes = np.column_stack([HeightMap(shape.x, shape.y, g).at(plan) for g in (dz_dx, dz_dy)])
    points = np.column_stack([plan, shape.at(plan)])
    seen = np.isfinite(points).all(axis=1) & _facing(slopes, variant.scan_flattest or FLATTEST_VIEW)
    if clamped:
        seen &= ~_behind_tool(points, tips[0], float(radii[0]))
    else:
        seen &= kept_by_trimming(plan, surface)
    seen &= ~_shining(points, slopes, generator, round(SHINE_PATCHES * variant.scan_shine))
    points, slopes = points[seen], slopes[seen]
    if not clamped:
        points = _levelled(points, slopes, _from_formed(points[:, :2], surface) > 0.0)
    else:
        points = np.vstack([points, _clamp_beside(shape, variant.scan_beyond)])
    largest = 3.0 * variant.scan_noise or NOISE
    points = points + np.clip(generator.normal(0.0, largest / 3.0, points.shape), -largest, largest)
    points[:, 2] += _bow(points, shape, variant.scan_bow)
    points = _registered(points, variant, generator)
    return np.asarray(generator.permutation(points, axis=0))


def _middles(line: Array) -> Array:
    """(K,) m, middles of cells of SPACING over the sheet of which ``line`` m are coordinates, evenly over the rest."""
    count = int(2.0 * _half(line) / SPACING + 1e-6)
    return np.asarray(SPACING * (np.arange(count) - 0.5 * (count - 1)))


def _half(line: Array) -> float:
    """m from the middle of the clamp to the edge of the sheet; ``line`` m may reach beyond it on one side."""
    return float(min(-line[0], line[-1]))


def _clamp_beside(shape: HeightMap, width: float) -> Array:
    """(N, 3) m, points of the clamp that a scanner sees ``width`` m beyond the free sheet, without disorder."""
    if width <= 0.0:
        return np.zeros((0, 3))
    half = [_half(line) for line in (shape.x, shape.y)]
    lines = [np.arange(-edge - width, edge + width, CLAMP_SPACING) for edge in half]
    x, y = (grid.ravel() for grid in np.meshgrid(*lines))
    beside = (np.abs(x) > half[0]) | (np.abs(y) > half[1])
    return np.column_stack([x[beside], y[beside], np.full(np.count_nonzero(beside), CLAMP_HEIGHT)])


def _bow(points: Array, shape: HeightMap, bow: float) -> Array:
    """(N,) m, systematic error of height: a bowl from 0 in the middle to ``bow`` m in the corners of the sheet."""
    if bow == 0.0:
        return np.zeros(len(points))
    return np.asarray(bow * (points[:, :2] ** 2).sum(axis=1) / (shape.x[-1] ** 2 + shape.y[-1] ** 2))


def _facing(slopes: Array, flattest: float) -> NDArray[np.bool_]:
    """Surface seen steeply enough; normals are (-dz/dx, -dz/dy, 1)."""
    cosine = (VIEW[2] - slopes @ VIEW[:2]) / np.sqrt(1.0 + (slopes**2).sum(axis=1))
    return np.asarray(cosine > np.cos(flattest))


def _behind_tool(points: Array, tip: Array, radius: float) -> NDArray[np.bool_]:
    """Points whose line of sight passes the upper tool, a cylinder from its ball upwards."""
    # from the height of the tip on the line of sight goes on in front of the tool, or into it
    rise = np.maximum(tip[2] - points[:, 2], 0.0) / VIEW[2]
    at = points[:, :2] + rise[:, None] * VIEW[:2]
    chord = np.sqrt(np.maximum(radius**2 - (at[:, 0] - tip[0]) ** 2, 0.0))
    return np.asarray((chord > 0.0) & (at[:, 1] > tip[1] - chord))


def _shining(points: Array, slopes: Array, generator: np.random.Generator, patches: int) -> NDArray[np.bool_]:
    """Patches that mirror the light past the sensor, more likely where the surface is steep."""
    if len(points) == 0:
        return np.zeros(0, dtype=bool)
    steep = (slopes**2).sum(axis=1)
    weight = np.where(np.isfinite(steep), steep, 0.0) + 0.01
    centres = generator.choice(len(points), patches, p=weight / weight.sum())
    radii = generator.uniform(0.3, 1.0, patches) * SHINE_RADIUS
    hit = np.zeros(len(points), dtype=bool)
    for centre, radius in zip(centres, radii, strict=True):
        hit |= np.hypot(points[:, 0] - points[centre, 0], points[:, 1] - points[centre, 1]) < radius
    return hit


def kept_by_trimming(plan: Array, surface: Surface) -> NDArray[np.bool_]:
    """Points in the formed region, what it encloses, and a rim around it."""
    return np.asarray(_from_formed(plan, surface) <= TRIM_MARGIN)


def _from_formed(plan: Array, surface: Surface) -> Array:
    """(N,) m from the points (N, 2) m to the formed region and what it encloses, 0 in it; TRIM_MARGIN without one."""
    formed = surface.formed != 0
    if not formed.any():
        return np.full(len(plan), TRIM_MARGIN)
    distance = distance_transform_edt(~binary_fill_holes(formed)) * surface.h
    i = np.clip(np.round((plan[:, 0] - surface.x0) / surface.h).astype(int), 0, formed.shape[1] - 1)
    j = np.clip(np.round((plan[:, 1] - surface.y0) / surface.h).astype(int), 0, formed.shape[0] - 1)
    return np.asarray(distance[j, i])


def _levelled(points: Array, slopes: Array, beside: NDArray[np.bool_]) -> Array:
    """Shifted and tilted so that the nearly flat rim lies on z = 0, as a trimmed part lies on a table.

    ``beside`` (N,): points beside the formed region. The rim is what is highest; where most of what is flat beside the
    region is lower, the part stands up from it (over a die, or formed from below), and that is the rim.
    """
    if len(points) == 0:
        return points
    flat = (slopes**2).sum(axis=1) < 0.1
    top = flat & (points[:, 2] > np.quantile(points[:, 2], 0.9) - 0.5e-3)
    stands_up = np.count_nonzero(top & beside) < 0.5 * np.count_nonzero(flat & beside)
    rim = points[flat & beside if stands_up else top]
    if len(rim) < 30:
        return points
    design = np.column_stack([np.ones(len(rim)), rim[:, :2]])
    plane = np.linalg.lstsq(design, rim[:, 2], rcond=None)[0]
    out = points.copy()
    out[:, 2] -= plane[0] + points[:, :2] @ plane[1:]
    return out


def _registered(points: Array, variant: Variant, generator: np.random.Generator) -> Array:
    """Turned about z and shifted by the variant's registration and by what differs from scan to scan."""
    turn = variant.registration_turn + generator.normal(0.0, REPEATED_TURN)
    shift = np.array([variant.registration_x, variant.registration_y, variant.registration_z])
    shift = shift + generator.normal(0.0, REPEATED_SHIFT, 3)
    c, s = np.cos(turn), np.sin(turn)
    turned = points[:, :2] @ np.array([[c, s], [-s, c]])
    return np.column_stack([turned, points[:, 2]]) + shift
