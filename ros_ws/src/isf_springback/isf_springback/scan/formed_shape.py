"""The formed shape from a scan: checked, in the frame of the clamp, on a grid, with what is known to be wrong with it.

``process_scan`` refuses what must not steer tools (codes 1321-1325) and tells the rest in ``remarks``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from isf_core.contour import Contour
from isf_core.errors import ErrorCode, IsfError
from isf_core.geometry.height_map import HeightMap
from isf_core.types import Array, Mask
from scipy import ndimage

from isf_springback.scan import point_cloud, registration
from isf_springback.scan.registration import ClampEdges, find_edges, undone

PITCH = 1e-3
"""m, grid of the formed shape."""
HEIGHT_RANGE = (-9e-3, 9e-3)
"""m, even height of the formed over the expected shape; more springback than published, or as much sag of a sheet that
has yielded around an opening without a plate, is not believed (assumed; the elasto-plastic sheet of ren_cone sags by 4
mm without a correction and by 7 mm with one that goes too deep)."""
LARGEST_SCALE = 2.5
"""Depth of the formed over the expected shape."""
ANY_SCALE, FORMED_SCALE = -0.3, 0.3
"""Smallest depth of the formed over the expected shape: while a part is formed, and of one formed without a correction,
it may spring back altogether; else it is a blank, or another place, that was scanned (assumed: 0.96 to 1.04 of
parts of 6 to 21 mm corrected by a model, 0.0 of one of 6 mm without a correction and a plate)."""
SMALLEST_COVERAGE = 0.3
"""Share of the opening that must have been seen; 0.6 (40 % holes) is common."""
LARGEST_HEIGHT = 4e-3
"""m, offset of the scanner along z beyond which the registration is refused (assumed)."""
LARGEST_TILT = np.radians(2.0)
LARGEST_SHIFT = 2.5e-3
"""m, shift in plan beyond which the registration is refused: half of the 5 mm that must never pass (assumed)."""
SMALLEST_DEPTH = 2.5e-3
"""m; on a shallower part walls are too small to tell its identity or a shift."""
LARGEST_MISFIT = 0.16
"""rms of the formed minus the expected shape after the best scale and shift, over the depth (assumed: springback of
the published parts leaves 0.02-0.06, another part of the same size 0.2 and more)."""
LARGEST_SAG = 0.8e-3
"""m, rms of that misfit that is believed at any depth: the sheet around a shallow contour sags as a dish that has not
the shape of the part (assumed; 0.6 to 0.75 mm at the third and fourth contour of simulated parts of 250 mm)."""
OPENING_DEPTH = 0.1e-3
"""m below the flange at which the opening begins."""
RIM_WIDTH = 10e-3
BASE_SLOPE = np.radians(5.0)


@dataclass(frozen=True)
class ScanExpectation:
    """What the scan must be of.

    Attributes
    ----------
    target : the finished part, or what a stage before ends with ; clamp : (m, m), free sheet between the clamps
    level : m, tip height of the last contour formed (negative below the sheet); the finished part: its lowest z
    clamped : the part is in the clamp; else the sheet beside the clamp may have moved, and is not used
    dome : m, by which the middle of the unformed floor may stand over or under its edge beside springback
    edges : those of the clamp in an earlier scan, used where this one does not show them
    began : what the stage in work began with, on the grid of ``target``; None: the flat blank
    worked : (ny, nx) cells of ``target`` that ``level`` is of, beside which nothing is known of the shape; None: all
    least_scale : smallest depth of the formed over the expected shape, :data:`ANY_SCALE` or :data:`FORMED_SCALE`
    """

    target: HeightMap
    clamp: tuple[float, float]
    level: float
    clamped: bool = True
    dome: float = 0.0
    edges: ClampEdges | None = None
    worked: Mask | None = None
    began: HeightMap | None = None
    least_scale: float = ANY_SCALE

    def least_extent(self) -> tuple[float, float]:
        """(m, m) that is seen at least: the opening of a part out of the clamp, whose flange may be cut off."""
        opening = regions(self.target)["opening"]
        if self.clamped or not opening.any():
            return self.clamp
        x, y = (axis[opening.any(axis=k)] for k, axis in enumerate((self.target.x, self.target.y)))
        return float(np.ptp(x)), float(np.ptp(y))

    def shape(self) -> HeightMap:
        """Expected upper surface: the target, not deeper than the tool has been in this stage, or in one before it;
        flat beside ``worked``."""
        formed = np.maximum(self.target.z, self.level)
        if self.began is not None:
            formed = np.minimum(formed, self.began.z)
        if self.worked is not None:
            formed = np.where(self.worked, formed, 0.0)
        return HeightMap(self.target.x, self.target.y, formed)


@dataclass(frozen=True)
class FormedShape:
    """A formed part in frame ``sheet``.

    Attributes
    ----------
    surface : heights on a 1 mm grid, NaN where not seen
    coverage : seen share of the opening
    outliers : points dropped
    plane : the registration that was undone, None when the sheet beside the clamp was not seen
    edges : the registration in plan that was undone, None when the edges of the clamp were not seen
    shift : (2,) m, shift of the part that was measured and left; shift_deviation : m, its standard deviation
    noise : m, standard deviation of a height of the surface
    remarks : for people
    """

    surface: HeightMap
    coverage: float
    outliers: int
    plane: registration.FlangePlane | None
    edges: ClampEdges | None
    shift: Array
    shift_deviation: float
    noise: float
    remarks: tuple[str, ...] = ()


def process_scan(points: Array, expected: ScanExpectation) -> FormedShape:
    """Formed shape from the points (P, 3) m of a scan.

    Raises
    ------
    IsfError : SCAN_NOT_FINITE, SCAN_UNIT_SUSPECT, SCAN_INCOMPLETE, SCAN_SHIFTED, SCAN_OF_ANOTHER_PART
    """
    points = point_cloud.checked_points(points, expected.clamp, expected.least_extent())
    remarks: list[str] = []
    framed = False
    plane = registration.flange_plane(points, expected.clamp) if expected.clamped else None
    if not expected.clamped:
        remarks.append("the part is not clamped: its flange has moved, height and tilt of the scan are not corrected")
    elif plane is None:
        remarks.append("the sheet beside the clamp was not seen: height and tilt of the scan are not corrected")
    else:
        _check_plane(plane)
        points, framed = registration.without_frame(registration.levelled(points, plane), expected.clamp)
    found = find_edges(points, expected.clamp, framed=framed) if plane is not None else None
    edges = found or expected.edges if plane is not None else None
    if edges is not None:
        _check_shift(edges.shift, "the clamp")
        points = undone(points, edges)
    surface, outliers = point_cloud.grid_heights(points, expected.clamp, PITCH)
    surface = close_small_holes(surface)
    opening = regions(expected.target)["opening"]
    known = np.isfinite(surface.at(expected.target.points()[:, :2])).reshape(opening.shape)
    coverage = float(known[opening].mean()) if opening.any() else 0.0
    if coverage < SMALLEST_COVERAGE:
        raise IsfError(
            ErrorCode.SCAN_INCOMPLETE,
            f"only {100 * coverage:.0f} % of the part were seen, {100 * SMALLEST_COVERAGE:.0f} % are needed",
            where="scan",
            advice="move the tools clear and check the field of view of the scanner",
        )
    if coverage < 0.9:
        remarks.append(f"{100 * (1 - coverage):.0f} % of the part were not seen")
    shift, deviation = np.zeros(2), float("nan")
    shape = expected.shape()
    deepest = expected.level if expected.began is None else float(np.nanmin(shape.z))
    if -deepest > SMALLEST_DEPTH:
        shift, deviation = registration.plan_shift(surface, shape)
        worked = opening if expected.worked is None else expected.worked
        _check_identity(surface, shape, worked, shift, expected.dome, expected.least_scale)
    noise = plane.noise if plane is not None else 50e-6
    return FormedShape(surface, coverage, outliers, plane, edges, shift, deviation, noise, tuple(remarks))


def regions(target: HeightMap) -> dict[str, Mask]:
    """(ny, nx) masks "opening", "wall", "base" (flat floor) and "rim" (10 mm around the opening) of the target."""
    depth = -np.nan_to_num(target.z)
    opening = np.asarray(ndimage.binary_fill_holes(depth > OPENING_DEPTH))
    dz_dx, dz_dy = target.gradient()
    flat = np.arctan(np.hypot(dz_dx, dz_dy)) < BASE_SLOPE
    base = opening & flat & (depth > 0.5 * float(depth.max()))
    pitch = float(target.x[1] - target.x[0])
    near = ndimage.distance_transform_edt(~opening) * pitch <= RIM_WIDTH if opening.any() else np.zeros_like(opening)
    return {"opening": opening, "wall": opening & ~flat, "base": base, "rim": np.asarray(near & ~opening)}


def opening_around(target: HeightMap, places: Array) -> Mask | None:
    """(ny, nx) mask of the openings of the target that the places (P, 2) m lie in; None where that is all of the part,
    or none of the openings."""
    number, _ = ndimage.label(regions(target)["opening"], structure=np.ones((3, 3)))
    low, pitch = np.array([target.y[0], target.x[0]]), np.array([target.y[1] - target.y[0], target.x[1] - target.x[0]])
    cell = np.clip(np.rint((places[:, ::-1] - low) / pitch).astype(np.intp), 0, np.array(number.shape) - 1)
    here = np.unique(number[cell[:, 0], cell[:, 1]])
    mask = np.isin(number, here[here > 0])
    whole = not (~mask & (np.abs(np.nan_to_num(target.z)) > OPENING_DEPTH)).any()
    return None if whole or not mask.any() else mask


def floor_under(target: HeightMap, contour: Contour) -> float:
    """m, height of the floor that ``contour`` leads to: the lowest place of its own opening in ``target``, or the
    highest of all of what is formed from below."""
    if contour.forming_tool != 1:
        return float(np.nanmax(target.z))
    own = opening_around(target, contour.contact[:, :2])
    return float(np.nanmin(target.z if own is None else target.z[own]))


def close_small_holes(surface: HeightMap) -> HeightMap:
    """Cells missing at a distance of up to one and a half cells from known ones, by the mean of opposite neighbours."""
    z = surface.z.copy()
    missing = np.isnan(z)
    if not missing.any() or missing.all():
        return surface
    filled = np.where(missing, 0.0, z)
    weight = (~missing).astype(float)
    kernel = np.array([[1.0, 2.0, 1.0], [2.0, 0.0, 2.0], [1.0, 2.0, 1.0]])
    total = ndimage.convolve(filled, kernel, mode="constant")
    count = ndimage.convolve(weight, kernel, mode="constant")
    # only cells with neighbours all around: at the edge of a large hole the mean would lean to one side
    take = missing & (count >= 0.75 * kernel.sum())
    z[take] = total[take] / count[take]
    return HeightMap(surface.x, surface.y, z)


def _check_plane(plane: registration.FlangePlane) -> None:
    tilt = max(abs(plane.tilt_x), abs(plane.tilt_y))
    if abs(plane.height) > LARGEST_HEIGHT or tilt > LARGEST_TILT:
        raise IsfError(
            ErrorCode.SCAN_SHIFTED,
            f"the sheet beside the clamp lies {1e3 * plane.height:.1f} mm high, tilted by {np.degrees(tilt):.2f} deg",
            where="scan",
            advice="register the scanner to the clamp again",
        )


def _fit(base: Array, value: Array, place: Array, dome: float) -> tuple[float, float, float]:
    """Height m and scale on ``base`` (K,) m that best give ``value`` (K,) m at ``place`` (K, 2) m, and the rms rest, m.

    Besides, a paraboloid over the extent of the places of up to ``dome`` m is taken out, up or down.
    """
    matrix = np.column_stack([np.ones(len(base)), base])
    left = value
    if dome > 0.0:
        low, high = place.min(axis=0), place.max(axis=0)
        bowl = 1.0 - np.sum(((place - 0.5 * (low + high)) / (0.5 * (high - low))) ** 2, axis=1)
        found, *_ = np.linalg.lstsq(np.column_stack([matrix, bowl]), value, rcond=None)
        left = value - float(np.clip(found[2], -dome, dome)) * bowl
    found, *_ = np.linalg.lstsq(matrix, left, rcond=None)
    return float(found[0]), float(found[1]), float(np.sqrt(np.mean((left - matrix @ found) ** 2)))


def _check_identity(
    surface: HeightMap, shape: HeightMap, opening: Mask, shift: Array, dome: float, least_scale: float
) -> None:
    """Refuse a scan that is shifted, or whose shape is not the expected one up to scale, springback and ``dome`` m."""
    rows, columns = np.nonzero(opening)
    place = np.column_stack([shape.x[columns], shape.y[rows]])
    base = shape.z[opening]
    value = surface.at(place + np.clip(shift, -10e-3, 10e-3))
    known = np.isfinite(value)
    depth = float(-base.min())
    misfit = float("inf")
    scale = height = 0.0
    if known.sum() > 50:
        height, scale, rest = _fit(base[known], value[known], place[known], dome)
        misfit = rest / depth
    believable = HEIGHT_RANGE[0] < height < HEIGHT_RANGE[1] and ANY_SCALE < scale < LARGEST_SCALE
    if misfit > max(LARGEST_MISFIT, LARGEST_SAG / depth) or not believable:
        raise IsfError(
            ErrorCode.SCAN_OF_ANOTHER_PART,
            f"the shape departs from the expected one by {100 * misfit:.0f} % of its depth (scale {scale:.2f}, "
            f"height {1e3 * height:.1f} mm)",
            where="scan",
            advice="check that scan, job and contour belong together",
        )
    if scale < least_scale:
        raise IsfError(
            ErrorCode.SCAN_OF_ANOTHER_PART,
            f"it shows {max(0.0, 100 * scale):.0f} % of the depth of the part of {1e3 * depth:.1f} mm, "
            f"{100 * least_scale:.0f} % are needed: an unformed blank, or a place beside the part",
            where="scan",
            advice="scan the formed part, z up, where it lies in frame sheet; one that has sprung back altogether "
            "teaches nothing: form it with springback.method: elastic first",
        )
    _check_shift(shift, "the part")


def _check_shift(shift: Array, of: str) -> None:
    if float(np.linalg.norm(shift)) > LARGEST_SHIFT:
        raise IsfError(
            ErrorCode.SCAN_SHIFTED,
            f"{of} appears shifted by {1e3 * shift[0]:.1f}, {1e3 * shift[1]:.1f} mm in plan",
            where="scan",
            advice="register the scanner to the clamp again",
        )
