"""Where the material of the blank goes from stage to stage, and what of its forming limit each stage leaves.

The sine law knows the last wall alone: by it a wall of 80 deg is as thin after four passes as after one. Here the nodes
of the blank are carried along. While the tool forms a stage level by level, material in its way moves along the normal
of the sheet as it is until it lies on the new surface: formed wall, ball of the tool, and inside it the floor at the
height of the tip. That is the motion of the overlap method (Praveen 2020, 2.1; the detail is reconstructed) and of the
fast simulated sheet, here with all points of a level at once and in three dimensions. What an earlier stage formed
already stays where it is, and what lies on it is stretched further by a later one. Thickness follows from the area now
and on the blank (volume constancy).

Strains count as the forming limit of the material does (:class:`isf_core.files.material.FormingLimit`): ln(t0/t), the
minor strain by its slope, and a bend to the radius of the tool and back for each level at which the ball moves a place.

A stage is judged where its contours touch the sheet, by what holds over four tool radii of path, as an event of the
simulated machine does (assumed; the same number, so that both say the same of a wall). So of ribs narrower than that it
says nothing: there material that moves along its normal is stretched sideways at every pass, by more than a sheet that
redistributes it.

Limits: springback, what hangs down between passes, the squeeze of a support tool and friction are not in it; a
finishing pass changes nothing. Walls of one pass come out thinner than by the sine law by 2 to 5 % (in ln(t0/t)), on
the simulated sheet by 5 to 17 %: near the limit of one pass the margin is too large by 0.1 to 0.3.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from isf_core.contour import Contour
from isf_core.files.material import FormingLimit
from isf_core.geometry.height_map import HeightMap
from isf_core.types import Array, Indices
from scipy.ndimage import distance_transform_edt, minimum_filter1d
from scipy.spatial import KDTree

from isf_planner.jit import kernel
from isf_planner.surface import height_grid, surface_kernels, tip_surface

NODE_PITCH = 0.2
"""Distance of the nodes of the blank over the tool radius."""

MOST_NODES = 240
"""Of them along one side, at most."""

MOST_LEVELS = 60
"""Of a stage: of more, several are formed at once."""

WAY = 4.0
"""Tool radii of path over which a strain must hold to count."""

AROUND = 2.0
"""Tool radii of flange around the formed region that are carried along."""

SAME_LEVEL = 10e-6
"""m"""

STEEP_NORMAL = 0.15
"""Smallest upward part of a normal that material is taken to move along: what is steeper moves with the next level."""

TOUCHED = 1e-6
"""m, motion of a level from which on the ball has bent a place, and its height above the tip of the ball."""

BISECTIONS = 20

THINNEST = 0.05
"""Smallest thickness over the blank's that is told; a sheet has broken long before."""


@dataclass(frozen=True)
class CarriedSheet:
    """The sheet at the end of a stage, N nodes of the blank.

    Attributes
    ----------
    points : (N, 3) m, where they are now ; thickness : (N,) m there
    margin : (N,) true strain that is left before the forming limit, negative beyond it
    thinnest, least_margin : m and true strain where the contours of the stage touch the sheet, over four radii of path
    place : (3,) m, of the least margin
    """

    points: Array
    thickness: Array
    margin: Array
    thinnest: float
    least_margin: float
    place: Array


def carried(
    shapes: Sequence[HeightMap], contours: Sequence[Contour], radius: float, blank: float, limit: FormingLimit
) -> tuple[CarriedSheet, ...]:
    """The sheet after every stage.

    Parameters
    ----------
    shapes : what the stages end with, m, on one grid, flange at z = 0, in the order of forming
    contours : of all stages, ``Contour.stage`` counting the shapes
    radius : m, of the ball ; blank : m, its thickness
    """
    shapes = _around_formed(shapes, AROUND * radius)
    x, y = shapes[0].x, shapes[0].y
    sheet = _Blank.over(x, y, radius)
    found: list[CarriedSheet] = []
    before: HeightMap | None = None
    for stage, shape in enumerate(shapes):
        mine = [contour for contour in contours if contour.stage == stage]
        if before is None or not np.array_equal(shape.z, before.z):
            surface = _Surface.of(shape, radius)
            for level, passes in levels(mine):
                sheet.form(surface.down_to(level), x, y, level, passes / radius)
            sheet.form(surface.closed, x, y, np.inf, 0.0)
        before = shape
        found.append(_judged(sheet, mine, radius, blank, limit))
    return tuple(found)


def levels(contours: Sequence[Contour]) -> list[tuple[float, float]]:
    """Heights (m) of the tip at which a stage is formed, falling, and how many passes each stands for.

    Contours at one height are one pass. Passes that do not close, of partial paths whose walls have levels of their
    own, count by their share of the closed contours beside them.
    """
    if not contours:
        return []
    lowest = np.array([float(contour.forming_tip[:, 2].min()) for contour in contours])
    heights = -np.unique(np.round(-lowest / SAME_LEVEL)) * SAME_LEVEL
    passes = float(len(heights))
    closed = np.array([contour.closed for contour in contours])
    if closed.any() and not closed.all():
        length = np.array([contour.length for contour in contours])
        order = np.argsort(lowest[closed])
        whole = np.interp(lowest, lowest[closed][order], length[closed][order])
        passes = min(passes, float((length / np.maximum(whole, 1e-9)).sum()))
    if len(heights) > MOST_LEVELS:
        heights = heights[np.linspace(0, len(heights) - 1, MOST_LEVELS + 1).round().astype(int)[1:]]
    return [(float(height), passes / len(heights)) for height in heights]


def _around_formed(shapes: Sequence[HeightMap], margin: float) -> list[HeightMap]:
    """``shapes`` over what is formed of any of them, and ``margin`` m around it."""
    first = shapes[0]
    formed = np.min([shape.z for shape in shapes], axis=0) < -SAME_LEVEL
    around = int(np.ceil(margin / height_grid.pitch_of(first)))
    rows, columns = (slice(max(0, int(one.min()) - around), int(one.max()) + around + 1) for one in np.nonzero(formed))
    return [HeightMap(one.x[columns], one.y[rows], np.ascontiguousarray(one.z[rows, columns])) for one in shapes]


@dataclass(frozen=True)
class _Surface:
    """A stage's surface as the ball leaves it: ``closed`` (ny, nx) m, tip of the ball over every node m, height of the
    tip m when it touches a node, and the grid's ``pitch`` m."""

    closed: Array
    tip: Array
    touching: Array
    pitch: float
    radius: float

    @classmethod
    def of(cls, shape: HeightMap, radius: float) -> _Surface:
        pitch = height_grid.pitch_of(shape)
        ball = tip_surface.ball_nodes(radius, pitch)
        tip = surface_kernels.dilate(shape.z, *ball)
        closed = np.maximum(-surface_kernels.dilate(-tip, *ball), shape.z)
        along_x, along_y = HeightMap(shape.x, shape.y, closed).gradient()
        rise = 1.0 - 1.0 / np.sqrt(1.0 + along_x**2 + along_y**2)
        return cls(closed, tip, closed - radius * rise, pitch, radius)

    def down_to(self, level: float) -> Array:
        """(ny, nx) m, the sheet when the tip has been everywhere down to ``level`` m: a floor at that height inside."""
        above = self.tip > level + TOUCHED
        if above.all():
            return np.where(self.touching >= level, self.closed, np.inf)
        away = np.minimum(self.pitch * distance_transform_edt(above), self.radius)
        ball = level + self.radius - np.sqrt(self.radius**2 - away**2)
        ball[away >= self.radius] = np.inf
        return np.where(self.touching >= level, self.closed, np.maximum(ball, self.closed))


@dataclass
class _Blank:
    """Nodes of the blank on a grid of ``shape`` rows and columns, ``pitch`` m apart: where they are (N, 3) m, and the
    curvatures 1/m that each was bent to, summed up; ``faces`` (F, 3) between them."""

    points: Array
    faces: Indices
    shape: tuple[int, int]
    pitch: float
    bent: Array

    @classmethod
    def over(cls, x: Array, y: Array, radius: float) -> _Blank:
        size = max(float(np.ptp(x)), float(np.ptp(y)))
        pitch = max(NODE_PITCH * radius, size / MOST_NODES)
        columns, rows = (line[0] + pitch * np.arange(int(float(np.ptp(line)) / pitch) + 1) for line in (x, y))
        shape = len(rows), len(columns)
        mesh = height_grid.as_mesh(HeightMap(columns, rows, np.zeros(shape)))
        return cls(mesh.vertices.copy(), mesh.faces, shape, pitch, np.zeros(len(mesh.vertices)))

    def form(self, surface: Array, x: Array, y: Array, level: float, bend: float) -> None:
        """Move what lies above ``surface`` (ny, nx) m onto it; what does so above ``level`` m is bent by ``bend`` 1/m
        more."""
        rows = self.points.reshape(*self.shape, 3)
        normal = np.cross(np.gradient(rows, axis=1), np.gradient(rows, axis=0)).reshape(-1, 3)
        normal /= np.maximum(np.linalg.norm(normal, axis=1), 1e-12)[:, None]
        high = np.where(np.isfinite(surface), surface, 1.0)
        push(self.points, normal, high, np.array([x[0], y[0]]), float(x[1] - x[0]), level, bend, self.bent)

    def strains(self) -> tuple[Array, Array]:
        """(N,) ln(t0 / t) and (N,) minor true strain: means over the facets around each node."""
        a, b, c = (self.points[self.faces[:, k]] for k in range(3))
        half = len(self.faces) // 2
        # facets of height_grid.as_mesh: a-b along x and b-c along y, then a-c along y with the corner between
        along_x = np.vstack([(b - a)[:half], (b - c)[half:]]) / self.pitch
        along_y = np.vstack([(c - b)[:half], (c - a)[half:]]) / self.pitch
        xx, yy, xy = ((one * other).sum(axis=1) for one, other in ((along_x,) * 2, (along_y,) * 2, (along_x, along_y)))
        area = np.sqrt(np.maximum(xx * yy - xy**2, 1e-12))
        mean = 0.5 * (xx + yy)
        largest = mean + np.sqrt(np.maximum(mean**2 - area**2, 0.0))
        minor = 0.5 * np.log(area**2 / largest)
        ring = np.bincount(self.faces.ravel(), minlength=len(self.points))
        stretched, least = (
            np.bincount(self.faces.ravel(), np.repeat(value, 3), len(self.points)) / ring for value in (area, minor)
        )
        return np.log(np.minimum(stretched, 1.0 / THINNEST)), least


@kernel
def push(
    points: Array, normal: Array, z: Array, origin: Array, pitch: float, level: float, bend: float, bent: Array
) -> None:
    """Move ``points`` (N, 3) m above the surface ``z`` (ny, nx) m against their ``normal`` (N, 3) until they lie on it;
    those that do so above ``level`` m get ``bend`` 1/m more in ``bent`` (N,)."""
    for k in range(len(points)):
        u, v = (points[k, 0] - origin[0]) / pitch, (points[k, 1] - origin[1]) / pitch
        gap = points[k, 2] - height_of(z, u, v)
        if gap <= 1e-9:
            continue
        low, high = 0.0, gap / max(normal[k, 2], STEEP_NORMAL)
        du, dv = normal[k, 0] / pitch, normal[k, 1] / pitch
        for _ in range(BISECTIONS):
            middle = 0.5 * (low + high)
            if points[k, 2] - middle * normal[k, 2] > height_of(z, u - middle * du, v - middle * dv):
                low = middle
            else:
                high = middle
        for axis in range(3):
            points[k, axis] -= low * normal[k, axis]
        if low > TOUCHED and points[k, 2] > level + TOUCHED:
            bent[k] += bend


@kernel
def height_of(z: Array, u: float, v: float) -> float:
    """Bilinear height of ``z`` (ny, nx) at column ``u`` and row ``v``."""
    u, v = min(max(u, 0.0), z.shape[1] - 1.001), min(max(v, 0.0), z.shape[0] - 1.001)
    i, j = int(u), int(v)
    a, b = u - i, v - j
    lower = z[j, i] * (1.0 - a) + z[j, i + 1] * a
    upper = z[j + 1, i] * (1.0 - a) + z[j + 1, i + 1] * a
    return float(lower * (1.0 - b) + upper * b)


def _judged(
    sheet: _Blank, contours: Sequence[Contour], radius: float, blank: float, limit: FormingLimit
) -> CarriedSheet:
    thinned, minor = sheet.strains()
    used = thinned + (limit.slope - 1.0) * minor + 0.5 * blank * limit.bending_share * sheet.bent
    tree = KDTree(sheet.points)
    thinnest, worst, place = 0.0, -np.inf, np.zeros(3)
    for contour in contours:
        node = tree.query(contour.contact)[1]
        spacing = contour.length / max(len(contour), 1)
        held = _over_way(used[node], WAY * radius, spacing, closed=contour.closed)
        thinnest = max(thinnest, float(_over_way(thinned[node], WAY * radius, spacing, closed=contour.closed).max()))
        at = int(np.argmax(held))
        if held[at] > worst:
            worst, place = float(held[at]), contour.contact[at]
    thickness = blank * np.exp(-thinned)
    return CarriedSheet(
        sheet.points.copy(),
        thickness,
        limit.strain - used,
        blank * float(np.exp(-thinnest)),
        limit.strain - worst,
        place,
    )


def _over_way(values: Array, way: float, spacing: float, *, closed: bool) -> Array:
    """(N,) least of the ``values`` (N,) over ``way`` m around each point; ``spacing`` m apart."""
    size = int(np.clip(round(way / max(spacing, 1e-9)), 1, len(values)))
    return np.asarray(minimum_filter1d(values, size, mode="wrap" if closed else "nearest"))
