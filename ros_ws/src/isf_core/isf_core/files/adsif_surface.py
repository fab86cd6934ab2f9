"""Response surface of accumulative DSIF: which wall angle two tools leave behind, and how to ask for one.

In ADSIF both tools stay at constant height and spiral outwards, so that the wall angle formed at a place depends only
on the tools' position angle theta and gap there (Ren 2018, chapter 3; where the tools stand for both: 3.1.1). theta is
the angle between the vertical and the line through both ball centres, in the plane across the path; the gap is the
free distance of the balls, here over the thickness of the blank. A surface holds for one material, one pitch and one
ratio of thickness to tool radius and is a file in ``share/isf_core/adsif``, each constant with its provenance.
"""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
from pydantic import Field, model_validator

from isf_core.errors import ErrorCode, IsfError
from isf_core.files import yaml_file
from isf_core.files.quantity import Angle, Force, Length
from isf_core.files.yaml_file import FileModel, find_named
from isf_core.types import Array

POLICIES = ("variation", "force", "trade_off", "continuity")
"""Which of the pairs (theta, gap) that give an angle is taken; see :func:`choose`."""

MATCH = 0.02
"""Largest relative difference of pitch and thickness-to-radius ratio at which a surface may be used."""

_CELL_DEGREES = 0.5
"""Spacing of the position angles at which level sets are looked for."""


class AdsifSurface(FileModel):
    """Stable wall angle, angle variation and force of one material, pitch and thickness-to-radius ratio.

    ``stable_angle`` has one row per ``gap`` and one column per ``position_angle``; None where the sheet buckles.
    """

    name: str
    material: str
    pitch: Length = Field(gt=0)
    thickness_to_radius: float = Field(gt=0)
    projection_distance: Length = Field(gt=0)
    position_angle: list[Angle] = Field(min_length=2)
    gap: list[float] = Field(min_length=2)
    stable_angle: list[list[Angle | None]]
    angle_variation: list[Angle]
    force_gap: list[float] = Field(min_length=2)
    forming_force: list[Force]
    support_share: list[float]
    provenance: dict[str, str]

    @model_validator(mode="after")
    def _shapes(self) -> AdsifSurface:
        rows, columns = len(self.gap), len(self.position_angle)
        if len(self.stable_angle) != rows or any(len(row) != columns for row in self.stable_angle):
            raise ValueError(f"stable_angle must have {rows} rows (gap) of {columns} values (position_angle)")
        if len(self.angle_variation) != columns or len(self.support_share) != columns:
            raise ValueError(f"angle_variation and support_share must have {columns} values (position_angle)")
        if len(self.forming_force) != len(self.force_gap):
            raise ValueError("forming_force must have as many values as force_gap")
        for name in ("position_angle", "gap", "force_gap"):
            if not (np.diff(getattr(self, name)) > 0).all():
                raise ValueError(f"{name} must ascend")
        if not np.isfinite(self.table()).any():
            raise ValueError("stable_angle has no valid value")
        return self

    def table(self) -> Array:
        """(gaps, position angles) rad, NaN where the sheet buckles."""
        return np.array([[np.nan if v is None else v for v in row] for row in self.stable_angle], dtype=float)

    @property
    def largest_angle(self) -> float:
        """rad, steepest stable wall of the table."""
        return float(np.nanmax(self.table()))

    @property
    def smallest_angle(self) -> float:
        """rad, flattest stable wall of the table."""
        return float(np.nanmin(self.table()))


def load_surface(name_or_path: str, base: Path | None = None) -> AdsifSurface:
    """Surface by name or by path relative to ``base``; raises IsfError naming file, line and field."""
    surface = yaml_file.load(find_named("adsif", name_or_path, base), AdsifSurface)
    reported = {"stable_angle", "pitch", "thickness_to_radius", "projection_distance", "angle_variation"}
    missing = (reported | {"forming_force", "support_share"}) - set(surface.provenance)
    if missing:
        raise IsfError(
            ErrorCode.FILE_FIELD,
            f"provenance is missing for {', '.join(sorted(missing))}",
            where=name_or_path,
            advice="write published, calibrated or assumed and the source",
        )
    return surface


def check_use(surface: AdsifSurface, material: str, pitch: float, thickness: float, radii: tuple[float, ...]) -> None:
    """Refuse a surface measured on something else (Ren 2018, 3.3.3); lengths in m.

    Raises
    ------
    IsfError : ADSIF_SURFACE_MISMATCH, with both values
    """
    pairs = [("pitch", pitch * 1e3, surface.pitch * 1e3, " mm")]
    pairs += [("thickness over tool radius", thickness / r, surface.thickness_to_radius, "") for r in radii]
    wrong = [
        f"{what} {is_:.4g}{unit} instead of {holds:.4g}{unit}"
        for what, is_, holds, unit in pairs
        if abs(is_ / holds - 1) > MATCH
    ]
    if material != surface.material:
        wrong.insert(0, f"material {material} instead of {surface.material}")
    if wrong:
        raise IsfError(
            ErrorCode.ADSIF_SURFACE_MISMATCH,
            f"the response surface {surface.name} does not hold for this job: {', '.join(wrong)}",
            where="adsif.surface",
            advice="use a surface made for this material, pitch and ratio, or change the job",
        )


def stable_angle(surface: AdsifSurface, theta: Array | float, gap: Array | float) -> Array:
    """rad, wall angle formed at position angle ``theta`` (rad) and ``gap`` (over thickness); NaN off the surface.

    Bilinear between the four runs around; where one of them buckled, the plane through the other three.
    """
    theta, gap = np.broadcast_arrays(np.asarray(theta, dtype=float), np.asarray(gap, dtype=float))
    values, x, y = surface.table(), np.asarray(surface.position_angle), np.asarray(surface.gap)
    i = np.clip(np.searchsorted(x, theta, side="right") - 1, 0, len(x) - 2)
    j = np.clip(np.searchsorted(y, gap, side="right") - 1, 0, len(y) - 2)
    u, v = (theta - x[i]) / (x[i + 1] - x[i]), (gap - y[j]) / (y[j + 1] - y[j])
    inside = (u >= -1e-9) & (u <= 1 + 1e-9) & (v >= -1e-9) & (v <= 1 + 1e-9)
    corners = (values[j, i], values[j, i + 1], values[j + 1, i], values[j + 1, i + 1])
    weights = ((1 - u) * (1 - v), u * (1 - v), (1 - u) * v, u * v)
    # a corner without weight has no say: the edges of a cell with a missing corner are known
    result = np.sum([np.where(w < 1e-12, 0.0, w * corner) for w, corner in zip(weights, corners, strict=True)], axis=0)
    a, b, c, d = corners
    planes = [
        (a, b + c - d + (d - c) * u + (d - b) * v, u + v >= 1 - 1e-9),
        (b, a + (d - c) * u + (c - a) * v, v >= u - 1e-9),
        (c, a + (b - a) * u + (d - b) * v, u >= v - 1e-9),
        (d, a + (b - a) * u + (c - a) * v, u + v <= 1 + 1e-9),
    ]
    for missing, plane, holds in planes:
        result = np.where(np.isnan(result) & np.isnan(missing) & holds, plane, result)
    return np.where(inside, result, np.nan)


def angle_variation(surface: AdsifSurface, theta: Array | float) -> Array:
    """rad, by how much the wall at the tools is steeper than the stable wall left behind."""
    return np.asarray(np.interp(theta, surface.position_angle, surface.angle_variation))


def tool_forces(surface: AdsifSurface, theta: Array | float, gap: Array | float) -> tuple[Array, Array]:
    """N, horizontal force on the forming and on the support tool at the gap that is really there."""
    forming = np.asarray(np.interp(gap, surface.force_gap, surface.forming_force))
    return forming, forming * np.interp(theta, surface.position_angle, surface.support_share)


def level_set(surface: AdsifSurface, angle: float) -> Array:
    """(K, 2) position angle (rad) and gap (over thickness) of the pairs that form ``angle`` (rad); may be empty.

    One pair per crossing at every half degree of position angle; at a fixed position angle the surface is linear
    between two gaps.
    """
    x = np.asarray(surface.position_angle)
    count = round(np.degrees(x[-1] - x[0]) / _CELL_DEGREES) + 1
    thetas = np.union1d(np.linspace(x[0], x[-1], count), x)
    # half cells begin within a cell: gaps between the nodes find where the surface starts
    gaps = np.unique(np.concatenate([np.linspace(a, b, 41) for a, b in pairwise(surface.gap)]))
    height = stable_angle(surface, thetas[:, None], gaps[None, :]) - angle
    lower, upper = height[:, :-1], height[:, 1:]
    exact = np.abs(height) < 1e-12
    crossing = (lower * upper < 0) & ~exact[:, :-1] & ~exact[:, 1:]
    row, column = np.nonzero(crossing)
    share = lower[crossing] / (lower[crossing] - upper[crossing])
    found = np.column_stack([thetas[row], gaps[column] + share * (gaps[column + 1] - gaps[column])])
    row, column = np.nonzero(exact)
    return np.vstack([found, np.column_stack([thetas[row], gaps[column]])])


def choose(
    surface: AdsifSurface, angles: Array, policy: str, largest_variation: float = np.radians(5.0)
) -> tuple[Array, Array]:
    """Position angle (N,) rad and gap (N,) over thickness that form ``angles`` (N,) rad.

    ``policy`` (Ren 2018, 3.2.5-3.3.3): ``variation`` smallest angle variation, of these the largest gap; ``force``
    smallest force; ``trade_off`` smallest force among the pairs of at most ``largest_variation`` (rad), the pair of
    smallest variation where none has so little; ``continuity`` smallest change from the point before.
    Angles flatter than the surface get its flattest pair.

    Raises
    ------
    IsfError : ADSIF_NOT_REACHABLE for an angle steeper than the surface
    """
    angles = np.asarray(angles, dtype=float)
    steepest = float(angles.max(initial=0.0))
    if steepest > surface.largest_angle + 1e-9:
        raise IsfError(
            ErrorCode.ADSIF_NOT_REACHABLE,
            f"a wall of {np.degrees(steepest):.1f} deg is required, ADSIF with {surface.name} forms "
            f"{np.degrees(surface.largest_angle):.1f} deg at most",
            where="part",
            advice="make the wall flatter, or form the part with process DSIF",
        )
    grid = np.linspace(surface.smallest_angle, surface.largest_angle, 417)  # 0.05 deg on the published surface
    sets = [level_set(surface, float(angle)) for angle in grid]
    if policy == "continuity":
        return _continuous(grid, sets, angles)
    pairs = np.array([_best(surface, pairs, policy, largest_variation) for pairs in sets])
    wanted = np.clip(angles, grid[0], grid[-1])
    theta = pairs[np.clip(np.searchsorted(grid, wanted, side="left"), 0, len(grid) - 1), 0]
    return theta, _gap_at(surface, theta, wanted)


def commanded_gap(gap: Array, deflection: Array, theta: Array, radius: float) -> Array:
    """m, gap to command so that ``gap`` (m) is left once the tools give way by ``deflection`` (m, both together).

    The exact inverse of :func:`opened_gap`, where Ren 2018 eq. 3-14 is right for small deflections.
    """
    reach = np.asarray(gap) + 2 * radius
    squared = reach**2 - (deflection * np.cos(theta)) ** 2
    return np.asarray(np.sqrt(squared) - deflection * np.sin(theta) - 2 * radius)


def opened_gap(commanded: Array | float, deflection: Array | float, theta: Array | float, radius: float) -> Array:
    """m, gap of balls of ``radius`` m ``commanded`` m apart once they gave way by ``deflection`` m in the plane.

    Exact, Ren 2018 eq. 3-12.
    """
    reach = np.asarray(commanded) + 2 * radius
    return np.asarray(
        np.sqrt(reach**2 + 2 * deflection * reach * np.sin(theta) + np.asarray(deflection) ** 2) - 2 * radius
    )


def _best(surface: AdsifSurface, pairs: Array, policy: str, largest_variation: float) -> Array:
    theta, gap = pairs.T
    forming, support = tool_forces(surface, theta, gap)
    force, variation = forming + support, angle_variation(surface, theta)
    if policy == "variation":
        order = np.lexsort((-gap, np.round(variation, 9)))
    elif policy == "force":
        order = np.lexsort((theta, np.round(force, 9)))
    elif policy == "trade_off":
        quiet = variation <= max(largest_variation, float(variation.min())) + 1e-9
        order = np.lexsort((theta, np.round(np.where(quiet, force, np.inf), 9)))
    else:
        raise ValueError(f"policy {policy!r}, known: {', '.join(POLICIES)}")
    return np.asarray(pairs[order[0]])


def _gap_at(surface: AdsifSurface, theta: Array, angle: Array) -> Array:
    """Gap at which ``theta`` (N,) forms ``angle`` (N,), the largest one; the nearest where the surface ends."""
    gap = np.empty(len(theta))
    nodes = np.linspace(surface.gap[-1], surface.gap[0], 401)
    for value in np.unique(theta):
        here = theta == value
        heights = stable_angle(surface, value, nodes)
        valid = np.isfinite(heights)
        ascending = np.maximum.accumulate(heights[valid])
        gap[here] = np.interp(angle[here], ascending, nodes[valid])
    return gap


def _continuous(grid: Array, sets: list[Array], angles: Array) -> tuple[Array, Array]:
    """The pair nearest to the last one, changes counted over 10 deg and 0.1 of gap; starts in the middle of the set."""
    scale = np.array([np.radians(10.0), 0.1])
    pairs = np.empty((len(angles), 2))
    last: Array | None = None
    step = np.clip(np.rint((angles - grid[0]) / (grid[1] - grid[0])), 0, len(grid) - 1).astype(int)
    for k, index in enumerate(step):
        found = sets[index]
        here = found[len(found) // 2] if last is None else found[np.argmin((((found - last) / scale) ** 2).sum(axis=1))]
        pairs[k] = last = here
    return pairs[:, 0], pairs[:, 1]


def support_tip(forming_tip: Array, away: Array, theta: Array, gap: Array, radii: tuple[float, float]) -> Array:
    """(N, 3) m, tip of the lower support ball.

    Parameters
    ----------
    forming_tip : (N, 3) m, of the upper forming ball
    away : (N, 3) unit, horizontally across the path, outwards
    theta : (N,) rad, between the vertical and the line through both centres
    gap : (N,) m, free distance of the balls
    radii : m, of the forming and the support ball
    """
    forming, support = radii
    line = np.sin(theta)[:, None] * away - np.cos(theta)[:, None] * np.array([0.0, 0.0, 1.0])
    centre = forming_tip + np.array([0.0, 0.0, forming]) + (forming + support + np.asarray(gap))[:, None] * line
    return np.asarray(centre + np.array([0.0, 0.0, support]))
