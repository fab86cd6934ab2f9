"""How far a formed shape is from the target: vertical deviation map and its numbers by region.

``e = z_measured - z_target`` at every cell of the target's grid, in the frame ``sheet`` of the machine: nothing is
aligned or fitted, so a shift of the whole part counts as error. For a part that opens towards +z, e > 0 means too
shallow (under-formed, springback) and e < 0 too deep (over-formed), the sign of Ren 2018, section 4.3. For a part
that stands up (TPIF, a feature formed from below) it is the other way round.

Regions are those of the *target*, so that parts formed in different ways are compared over the same cells:

=============  =========================================================================================
opening        the target lies more than ``OPENING_DEPTH`` off the flange, up or down (holes filled), formed cells
base           in the opening, slope below 5 deg and deeper than half the largest depth
wall           in the opening, slope above 15 deg
wall_and_base  the whole opening: base, wall and the fillets between flange, wall and base
rim            outside, within ``rim_width`` of the opening: where global bending shows
flange         the rest of the sheet
=============  =========================================================================================
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from isf_core.errors import ErrorCode, IsfError
from isf_core.geometry.height_map import HeightMap
from isf_core.types import Array, Mask
from scipy import ndimage

OPENING_DEPTH = 0.1e-3
"""m off the flange at which the opening begins: above scan noise and facets of the target, below any fillet."""

RIM_WIDTH = 10e-3
"""m around the opening that count as rim."""

BANDS = (0.1e-3, 0.2e-3, 0.3e-3)
"""m, of which the shares of points are told; Lu 2016, 4.4 tells that of the last."""

BASE_SLOPE = np.radians(5.0)
WALL_SLOPE = np.radians(15.0)

REGIONS = ("wall_and_base", "wall", "base", "rim", "flange")


@dataclass(frozen=True)
class RegionError:
    """Deviation in one region; lengths in m, NaN when the region has no measured cell.

    Attributes
    ----------
    cells : number of measured cells ; coverage : measured fraction of the region's cells in which the target is known
    max_abs, mean_abs, rms : of the vertical deviation e ; mean : signed mean of e
    worst : (x, y, e) m, the place of the largest |e|
    max_abs_normal, mean_abs_normal : of e cos(slope of the target), the distance along the surface normal
    """

    cells: int
    coverage: float
    max_abs: float
    mean_abs: float
    rms: float
    mean: float
    worst: tuple[float, float, float]
    max_abs_normal: float
    mean_abs_normal: float


@dataclass(frozen=True)
class SignedStatistics:
    """Distances along the surface normal, m, of a region: the six numbers of Behera 2015, Table 2.

    Positive is under-formed in a part that opens upwards. NaN where there is no such distance.

    Attributes
    ----------
    mean_positive, mean_negative : of the distances of one sign
    largest, smallest, mean, deviation : of all; the last is their standard deviation
    """

    mean_positive: float
    mean_negative: float
    largest: float
    smallest: float
    mean: float
    deviation: float

    def table2(self) -> dict[str, float | None]:
        """The six numbers in mm, as files and programs get them; None where there is none."""
        values = {
            "mean_positive_mm": self.mean_positive,
            "mean_negative_mm": self.mean_negative,
            "max_mm": self.largest,
            "min_mm": self.smallest,
            "mean_mm": self.mean,
            "std_mm": self.deviation,
        }
        return {key: 1e3 * value if np.isfinite(value) else None for key, value in values.items()}


@dataclass(frozen=True)
class Deviation:
    """Deviation of one shape.

    Attributes
    ----------
    error : height map of e, m, on the grid of the target; NaN where either shape is unknown
    masks : (ny, nx) bool per region of :data:`REGIONS`
    regions : RegionError per region
    signed : of the points of each region
    """

    error: HeightMap
    masks: dict[str, Mask]
    regions: dict[str, RegionError]
    signed: dict[str, SignedStatistics]

    @property
    def whole(self) -> RegionError:
        """Numbers of the formed part: region ``wall_and_base``."""
        return self.regions["wall_and_base"]

    def errors(self, region: str = "wall_and_base") -> Array:
        """(n,) m, vertical errors of the measured points of ``region``."""
        error = self.error.z[self.masks[region]]
        return np.asarray(error[np.isfinite(error)])

    def within(self, band: float, region: str = "wall_and_base") -> float | None:
        """Fraction of the measured points of ``region`` at most ``band`` m off, vertically; None: none was measured."""
        error = self.errors(region)
        return float(np.mean(np.abs(error) <= band)) if len(error) else None


def compare(measured: HeightMap, target: HeightMap, *, rim_width: float = RIM_WIDTH) -> Deviation:
    """Deviation of ``measured`` from ``target``; the measured shape is read bilinearly at the target's cells.

    Raises
    ------
    IsfError : BAG_INCOMPLETE when the target forms nothing or the shapes have no cell in common
    """
    masks = regions_of(target, rim_width=rim_width)
    on_grid = measured.at(target.points()[:, :2]).reshape(target.z.shape)
    error = on_grid - target.z
    if not np.isfinite(error).any():
        raise IsfError(
            ErrorCode.BAG_INCOMPLETE,
            "scan and target have no point in common",
            advice="check that both are in frame 'sheet' and in metres",
        )
    slope_x, slope_y = target.gradient()
    to_normal = 1.0 / np.sqrt(1.0 + slope_x**2 + slope_y**2)
    error_map = HeightMap(target.x, target.y, error)
    wanted = np.isfinite(target.z)  # an opening without its holes: of those nothing can be measured
    regions = {name: _numbers(error_map, to_normal, mask & wanted) for name, mask in masks.items()}
    signed = {name: signed_statistics((error * to_normal)[mask]) for name, mask in masks.items()}
    return Deviation(error_map, masks, regions, signed)


def regions_of(target: HeightMap, *, rim_width: float = RIM_WIDTH) -> dict[str, Mask]:
    """(ny, nx) bool masks of the regions, from the target alone.

    Raises
    ------
    IsfError : BAG_INCOMPLETE when the target is flat
    """
    depth = np.abs(flange_level(target) - target.z)
    opening = ndimage.binary_fill_holes(np.nan_to_num(depth, nan=0.0) > OPENING_DEPTH)
    if not opening.any():
        raise IsfError(
            ErrorCode.BAG_INCOMPLETE,
            "the target is flat: there is no formed region to compare",
            advice="check the unit and the orientation of the part",
        )
    slope_x, slope_y = target.gradient()
    slope = np.arctan(np.hypot(slope_x, slope_y))
    spacing = (_spacing(target.y), _spacing(target.x))
    distance = ndimage.distance_transform_edt(~opening, sampling=spacing)
    with np.errstate(invalid="ignore"):  # unknown cells compare as False
        base = opening & (slope < BASE_SLOPE) & (depth > 0.5 * np.nanmax(depth))
        wall = opening & (slope > WALL_SLOPE)
    rim = ~opening & (distance <= rim_width)
    return {"wall_and_base": opening, "wall": wall, "base": base, "rim": rim, "flange": ~opening & ~rim}


def directions(target: HeightMap) -> tuple[bool, bool]:
    """Whether the target goes down from the flange, and whether it stands up from it, by more than a hem.

    Less than a twentieth of the whole height counts as nothing.
    """
    height = target.z - flange_level(target)
    known = height[np.isfinite(height)]
    if not len(known):
        return False, False
    low, high = float(-known.min()), float(known.max())
    least = max(OPENING_DEPTH, 0.05 * (max(low, 0.0) + max(high, 0.0)))
    return low > least, high > least


def flange_level(target: HeightMap) -> float:
    """m, height of the unformed sheet: the median over the border of the grid (0 when the border is unknown)."""
    z = target.z
    border = np.concatenate([z[0], z[-1], z[:, 0], z[:, -1]])
    known = border[np.isfinite(border)]
    return float(np.median(known)) if len(known) else 0.0


def _numbers(error: HeightMap, to_normal: Array, mask: Mask) -> RegionError:
    known = mask & np.isfinite(error.z)
    cells = int(known.sum())
    nan = float("nan")
    if not cells:
        return RegionError(0, 0.0 if mask.any() else nan, nan, nan, nan, nan, (nan, nan, nan), nan, nan)
    e = error.z[known]
    rows, columns = np.nonzero(known)
    worst = int(np.argmax(np.abs(e)))
    # beside an unknown cell the slope is unknown: such cells count vertically only
    normal = np.abs(e * to_normal[known])
    normal = normal[np.isfinite(normal)]
    return RegionError(
        cells=cells,
        coverage=cells / int(mask.sum()),
        max_abs=float(np.abs(e[worst])),
        mean_abs=float(np.abs(e).mean()),
        rms=float(np.sqrt(np.mean(e**2))),
        mean=float(e.mean()),
        worst=(float(error.x[columns[worst]]), float(error.y[rows[worst]]), float(e[worst])),
        max_abs_normal=float(normal.max()) if len(normal) else nan,
        mean_abs_normal=float(normal.mean()) if len(normal) else nan,
    )


def signed_statistics(distance: Array, weight: Array | None = None) -> SignedStatistics:
    """Of the known ``distance`` (N,) m; ``weight`` (N,) that each counts with in the means, None: all alike."""
    weight = np.ones(len(distance)) if weight is None else weight
    counts = np.isfinite(distance) & (weight > 0.0)
    known, share = distance[counts], weight[counts]
    nan = float("nan")
    if not len(known):
        return SignedStatistics(nan, nan, nan, nan, nan, nan)
    mean = float(np.average(known, weights=share))
    above, below = (
        float(np.average(known[one], weights=share[one])) if one.any() else nan for one in (known > 0.0, known < 0.0)
    )
    return SignedStatistics(
        mean_positive=above,
        mean_negative=below,
        largest=float(known.max()),
        smallest=float(known.min()),
        mean=mean,
        deviation=float(np.sqrt(np.average((known - mean) ** 2, weights=share))),
    )


def _spacing(axis: Array) -> float:
    return float(np.mean(np.diff(axis)))
