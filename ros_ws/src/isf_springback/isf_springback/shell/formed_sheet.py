"""The sheet as it stands when contour k is formed, as a shell mesh: flange, walls down to the contour, flat floor.

This is the truncated target of Ren 2018, 4.2.3, told by the contact loops of the contours up to k. What lies below is
not formed yet: the floor is flat at the depth of the loop. In a further stage (a finishing pass is one) the shape of
the stage before is there below the level that the new one has reached. Frame ``sheet``, lengths in m.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from isf_core.contour import Contour, contour_label
from isf_core.errors import ErrorCode, IsfError
from isf_core.geometry.loops import inside_loops, reach_to_loops
from isf_core.types import Array
from scipy.interpolate import LinearNDInterpolator
from scipy.spatial import cKDTree

from isf_springback.shell.plan_mesh import SizeField, mesh_in_plan, place_along, rectangle
from isf_springback.shell.sheet_model import SheetMesh

_LOOP_SPACING = 2.5e-3
"""m, spacing of the loop points that tell the height: finer than any facet of the wall."""

_LOOP_DROP = 1.2e-3
"""m, drop or run from loop to loop below which a loop is left out."""

_FLATTEST = np.radians(10.0)
"""rad, wall angle with which the first loop is continued to the flange at least: a fillet begins at zero."""

_EDGE_ROOM = 2e-3
"""m, no rim nearer to the edge of the free sheet: facets between them would be slivers."""

_LONGEST_CONTINUATION = 6e-3
"""m; a first loop further below the flange than this begins inside another feature and is not continued."""


@dataclass(frozen=True)
class FacetSize:
    """Wanted size of facets, m.

    Attributes
    ----------
    at_load, wall, flange : size at the loaded points, in walls, far from both
    growth_from_load, growth_from_wall : m of size per m of distance
    """

    at_load: float = 3e-3
    wall: float = 6e-3
    flange: float = 14e-3
    growth_from_load: float = 0.25
    growth_from_wall: float = 0.3

    @staticmethod
    def coarse() -> FacetSize:
        """For previews and for corrections without a database; the deflection errs by up to 0.1 mm."""
        return FacetSize(4e-3, 8e-3, 16e-3, 0.3, 0.3)


@dataclass(frozen=True)
class FormedSheet:
    """Shape in plan view.

    Attributes
    ----------
    rims : loops (N, 2) m where the wall of a feature begins
    floors : loops (N, 3) m where the wall of a feature ends now
    places : (N, 3) m, points all over the walls, with rims and floors
    clamp : (4, 2) m, corners of the sheet in its clamp, counter-clockwise
    plates : loops (P, 2) m, edges of the openings of a backing plate, counter-clockwise
    """

    rims: tuple[Array, ...]
    floors: tuple[Array, ...]
    places: Array
    clamp: Array
    plates: tuple[Array, ...] = ()

    def height(self, points: Array) -> Array:
        """(N,) m, height at ``points`` (N, 2) m, linear between the places."""
        flat = np.vstack([self.clamp, *self.plates])
        known = np.vstack([self.places[:, :2], flat])
        surface = LinearNDInterpolator(known, np.concatenate([self.places[:, 2], np.zeros(len(flat))]))
        return np.nan_to_num(surface(points))


def formed_sheet(
    contours: Sequence[Contour], clamp_size: tuple[float, float], plates: tuple[Array, ...] = ()
) -> FormedSheet:
    """Shape after ``contours`` (0 to k, in their order) in a clamp of ``clamp_size`` m, over a backing plate with the
    openings ``plates`` (P, 2) m, counter-clockwise.

    Raises
    ------
    IsfError : SHEET_MESH_FAILED, no contours, or one outside the clamp or the opening
    """
    clamp = rectangle(clamp_size)
    outline = plates or (clamp,)
    if not contours:
        raise IsfError(ErrorCode.SHEET_MESH_FAILED, "no contour is formed yet", where="shell mesh")
    features: dict[tuple[int, int], list[Contour]] = {}
    for contour in contours:
        features.setdefault((contour.feature, contour.stage), []).append(contour)
    rims, floors, loops = [], [], []
    for feature in dict.fromkeys(contour.feature for contour in contours):
        *before, latest = sorted(stage for other, stage in features if other == feature)
        members = features[feature, latest]
        kept = _spaced(members)
        rim = _rim(kept[0], float(np.median(members[0].wall_angle)), outline)
        if before:
            kept += _spaced(_below(members, features[feature, before[-1]]))
        rims.append(rim[:, :2])
        floors.append(kept[-1])
        loops += [rim, *kept]
    places = np.vstack(loops)
    room = inside_loops(outline, places[:, 0], places[:, 1])
    if (room <= 1e-4).any():
        raise IsfError(
            ErrorCode.SHEET_MESH_FAILED,
            f"the contours reach within {1e3 * float(room.min()):.1f} mm of the edge of clamp or backing plate",
            where=contour_label(contours[-1].index),
            advice="check the clamp size of the rig, the opening of the plate and the unit of the part",
        )
    return FormedSheet(tuple(rims), tuple(floors), places, clamp, plates)


def mesh_of(sheet: FormedSheet, control_points: Array, size: FacetSize) -> SheetMesh:
    """Shell mesh with a node on every one of ``control_points`` (M, 2) m.

    Raises
    ------
    IsfError : SHEET_MESH_FAILED
    """
    walls = cKDTree(sheet.places[:, :2])
    loads = cKDTree(control_points)

    def wanted(places: Array) -> Array:
        from_load, _ = loads.query(places)
        from_wall, _ = walls.query(places)
        near = size.at_load + size.growth_from_load * from_load
        return np.minimum(np.minimum(near, size.wall + size.growth_from_wall * from_wall), size.flange)

    fixed = control_points
    for edge in sheet.plates:
        props = place_along(edge, wanted)  # close to the clamp, that holds the sheet as well
        fixed = _with_room(fixed, props[inside_loops([sheet.clamp], *props.T) > _EDGE_ROOM], wanted)
    propped = np.arange(len(control_points), len(fixed), dtype=np.int64)
    loops = [floor[:, :2] for floor in sheet.floors] + list(sheet.rims)
    for loop in loops:
        start = int(np.argmin(loads.query(loop)[0]))
        fixed = _with_room(fixed, place_along(loop, wanted, start=start), wanted)
    points, triangles, clamped = mesh_in_plan(sheet.clamp, fixed, wanted)
    height = sheet.height(points)
    height[clamped] = 0.0
    height[propped] = 0.0
    loaded = np.arange(len(control_points), dtype=np.int64)
    return SheetMesh(np.column_stack([points, height]), triangles, clamped, loaded, propped)


def _below(reached: list[Contour], before: list[Contour]) -> list[Contour]:
    """Those of the stage ``before`` that lie deeper along the push than the ones that the new stage has ``reached``."""
    deepest = max(_depth(contour) for contour in reached)
    return [contour for contour in before if _depth(contour) > deepest]


def _depth(contour: Contour) -> float:
    """m, mean depth of the contact along the push."""
    return contour.push_sign * float(contour.contact[:, 2].mean())


def _spaced(contours: list[Contour]) -> list[Array]:
    """Contact loops (N, 3) m, first and last kept, those between where they add shape."""
    if not contours:
        return []
    kept = [_thinned(contours[0])]
    for contour in contours[1:-1]:
        loop = _thinned(contour)
        drop = abs(float(loop[:, 2].mean() - kept[-1][:, 2].mean()))
        if drop >= _LOOP_DROP:
            kept.append(loop)
    if len(contours) > 1:
        kept.append(_thinned(contours[-1]))
    return kept


def _thinned(contour: Contour) -> Array:
    """(N, 3) m, contact loop at about even spacing."""
    loop = contour.contact
    step = np.linalg.norm(np.diff(np.vstack([loop, loop[:1]]), axis=0), axis=1)
    position = np.concatenate([[0.0], np.cumsum(step)])
    count = max(24, round(float(position[-1]) / _LOOP_SPACING))
    at = np.arange(count) * position[-1] / count
    closed = np.vstack([loop, loop[:1]])
    return np.column_stack([np.interp(at, position, closed[:, axis]) for axis in range(3)])


def _rim(loop: Array, wall_angle: float, outline: Sequence[Array]) -> Array:
    """(N, 3) m, the loop continued outwards to the flange at ``wall_angle`` rad; the loop itself when too deep.

    Where the flange would begin beyond :data:`_EDGE_ROOM` from the edge of the free sheet, the wall begins at the edge:
    the rim then lies between, at the height of the straight line.
    """
    reach = abs(float(loop[:, 2].mean())) / np.tan(max(wall_angle, _FLATTEST))
    if reach > _LONGEST_CONTINUATION:
        return loop
    ahead = np.roll(loop[:, :2], -1, axis=0) - np.roll(loop[:, :2], 1, axis=0)
    outward = np.column_stack([ahead[:, 1], -ahead[:, 0]])
    outward /= np.maximum(np.linalg.norm(outward, axis=1), 1e-12)[:, None]
    x, y = loop[:, 0], loop[:, 1]
    if float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1))) < 0.0:
        outward = -outward
    to_edge = reach_to_loops(outline, loop[:, :2], outward)
    near = reach > to_edge - _EDGE_ROOM
    run = np.where(near, np.clip(to_edge - _EDGE_ROOM, 0.0, None), reach)
    height = np.where(near, loop[:, 2] * (1.0 - run / np.maximum(to_edge, 1e-12)), 0.0)
    return np.column_stack([loop[:, :2] + run[:, None] * outward, height])


def _with_room(kept: Array, added: Array, wanted: SizeField) -> Array:
    """``kept`` and those of ``added`` that are at least 0.55 of the local size away from them."""
    distance, _ = cKDTree(kept).query(added)
    return np.vstack([kept, added[distance > 0.55 * wanted(added)]])
