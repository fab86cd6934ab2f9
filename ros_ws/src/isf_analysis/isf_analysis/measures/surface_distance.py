"""Signed distance of points from a triangulated surface, the rigid motion that fits them best, and their statistics.

The distance is that of the nearest point of the surface, not along z. It is positive above a surface that can be seen
from above everywhere, as that of a formed sheet; of any other on the side that the normal of the nearest facet points
to. Points beside the surface, nearest to its open border, tell nothing of it and are left out. Lengths in m.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from isf_core.errors import ErrorCode, IsfError
from isf_core.geometry.height_map import HeightMap
from isf_core.types import Array, Indices, Mask
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation
from trimesh.triangles import closest_point, points_to_barycentric

from isf_analysis.measures.deviation import BANDS, SignedStatistics, signed_statistics

CHUNK = 20_000
"""Points at a time."""

NEAREST = (8, 32)
"""Facets with the nearest centres that are tried first, all at once; of points for which others may be nearer all those
that may be are looked up, one list for each."""

HELD = 500_000
"""Pairs of a point and a facet that may be near it, at a time; 0.5 kB each."""

LARGE, ALIKE = 0.97, 3.0
"""Share of the facets, smallest first, that are looked up by their centres, and besides those up to so many times as
large as the one in the middle; the others are tried one by one."""

TOUCH = 1e-6
"""Of a facet, from an edge or a corner of it, in shares of its size; and m off the border's normal plane."""


@dataclass(frozen=True)
class Distances:
    """Of N points.

    Attributes
    ----------
    signed : (N,) m ; closest : (N, 3) m, nearest points of the surface ; facet : (N,) that they lie on
    beside : (N,) bool, nearest to the open border and not over it
    """

    signed: Array
    closest: Array
    facet: Indices
    beside: Mask


class Surface:
    """A triangle mesh that distances are measured to.

    ``vertices`` (V, 3) m, ``faces`` (F, 3); facets without an area do not count. Raises IsfError MESH_EMPTY when none
    has one.

    Attributes
    ----------
    normals : (F, 3) unit, upwards where most of them are
    height_field : True when all of them are
    """

    def __init__(self, vertices: Array, faces: Indices) -> None:
        corners = vertices[faces]
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        size = np.linalg.norm(normal, axis=1)
        kept = size > 0.0
        if not kept.any():
            raise IsfError(
                ErrorCode.MESH_EMPTY,
                "has no facet with an area",
                where="surface that distances are measured to",
                advice="check that the shape was seen, and exported, as a whole",
            )
        self.vertices, self.faces, self.corners = vertices, faces[kept], corners[kept]
        self.area = 0.5 * size[kept]
        normals = normal[kept] / size[kept][:, None]
        up = np.sum(self.area * normals[:, 2])
        self.normals = -normals if up < 0.0 else normals
        self.height_field = bool((self.normals[:, 2] > 0.0).all())
        self.centres = self.corners.mean(axis=1)
        radius = np.linalg.norm(self.corners - self.centres[:, None], axis=2).max(axis=1)
        middle, most = np.quantile(radius, [0.5, LARGE])
        limit = max(float(most), ALIKE * float(middle)) * (1 + 1e-9)
        self._small, self._large = np.flatnonzero(radius <= limit), np.flatnonzero(radius > limit)
        self._radius, self._limit = radius, float(radius[self._small].max())
        self._tree = cKDTree(self.centres[self._small])
        self._open_edge, self._open_corner = _border(self.faces)

    @staticmethod
    def of_height_map(shape: HeightMap) -> Surface:
        """Two facets per cell; none where a height is unknown."""
        ny, nx = shape.z.shape
        number = np.arange(ny * nx).reshape(ny, nx)
        a, b, c, d = (part.ravel() for part in (number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1]))
        faces = np.vstack([np.column_stack([a, b, c]), np.column_stack([a, c, d])])
        points = shape.points()
        known = np.isfinite(points[:, 2])
        return Surface(np.nan_to_num(points), faces[known[faces].all(axis=1)])

    def distances(self, points: Array) -> Distances:
        """Of ``points`` (N, 3) m, all finite."""
        facets = np.empty(len(points), dtype=np.int64)
        closest = np.empty((len(points), 3))
        for begin in range(0, len(points), CHUNK):
            part = slice(begin, begin + CHUNK)
            facets[part], closest[part] = self._nearest(points[part])
        away = points - closest
        size = np.linalg.norm(away, axis=1)
        side = away[:, 2] if self.height_field else np.sum(away * self.normals[facets], axis=1)
        signed = np.where(side < 0.0, -size, size)
        return Distances(signed, closest, facets, self._beside(away, closest, facets))

    def area_by_vertex(self) -> Array:
        """(V,) m^2 that each vertex stands for: a third of every facet around it."""
        share = np.repeat(self.area / 3.0, 3)
        return np.bincount(self.faces.ravel(), weights=share, minlength=len(self.vertices))

    # -- inside ----------------------------------------------------------------------------------

    def _nearest(self, points: Array) -> tuple[Indices, Array]:
        """Facet and nearest point: a first guess, then all facets that may be nearer than it."""
        guess = self._small[self._tree.query(points)[1]]
        closest = _on_facets(self.corners[guess], points)
        best, facet = np.linalg.norm(points - closest, axis=1), guess.copy()
        open_ends = np.arange(len(points))
        for count in NEAREST:
            open_ends = self._try_nearest(points, open_ends, min(count, len(self._small)), best, facet, closest)
        # of points far above a sheet almost every facet may be the nearest: they are tried in parts that fit in memory
        reach = best[open_ends] + self._limit
        counts = np.asarray(self._tree.query_ball_point(points[open_ends], reach, return_length=True))
        for part in np.split(np.arange(len(open_ends)), _begins(counts)):
            if not len(part):
                continue
            near = self._tree.query_ball_point(points[open_ends[part]], reach[part], return_sorted=False)
            owner = np.repeat(open_ends[part], counts[part])
            candidate = self._small[np.concatenate([np.asarray(item, dtype=np.int64) for item in near])]
            apart = np.linalg.norm(points[owner] - self.centres[candidate], axis=1)
            may = apart - self._radius[candidate] < best[owner]
            self._improve(points, owner[may], candidate[may], best, facet, closest)
        for number in self._large.tolist():
            low, high = self.corners[number].min(axis=0), self.corners[number].max(axis=0)
            outside = np.maximum(np.maximum(low - points, points - high), 0.0)
            owner = np.flatnonzero(np.einsum("ij,ij->i", outside, outside) < best**2)
            self._improve(points, owner, np.full(len(owner), number), best, facet, closest)
        return facet, closest

    def _try_nearest(
        self, points: Array, numbers: Indices, count: int, best: Array, facet: Indices, closest: Array
    ) -> Indices:
        """Take for the points ``numbers`` the nearest of the ``count`` facets with the nearest centres; returns those
        for which others may be nearer."""
        if not len(numbers):
            return numbers
        apart, order = (found.reshape(len(numbers), -1) for found in self._tree.query(points[numbers], k=count))
        candidate = self._small[order]
        row, column = np.nonzero(apart - self._radius[candidate] < best[numbers, None])
        self._improve(points, numbers[row], candidate[row, column], best, facet, closest)
        return np.asarray(numbers[apart[:, -1] - self._limit < best[numbers]])

    def _improve(
        self, points: Array, owner: Indices, candidate: Indices, best: Array, facet: Indices, closest: Array
    ) -> None:
        """Take for points ``owner``, in order, the facets ``candidate`` that are nearer than the ``best`` known."""
        if not len(owner):
            return
        place = _on_facets(self.corners[candidate], points[owner])
        distance = np.linalg.norm(points[owner] - place, axis=1)
        begins = np.flatnonzero(np.r_[True, owner[1:] != owner[:-1]])
        least = np.minimum.reduceat(distance, begins)
        among = np.flatnonzero(distance == np.repeat(least, np.diff(np.r_[begins, len(owner)])))
        chosen = among[np.r_[True, owner[among[1:]] != owner[among[:-1]]]]
        chosen = chosen[distance[chosen] < best[owner[chosen]]]
        winner = owner[chosen]
        best[winner], facet[winner], closest[winner] = distance[chosen], candidate[chosen], place[chosen]

    def _beside(self, away: Array, closest: Array, facets: Indices) -> Mask:
        share = points_to_barycentric(self.corners[facets], closest)
        zero = share < TOUCH
        corner = zero.sum(axis=1) >= 2
        at = np.argmax(share, axis=1)
        on_border = np.where(
            corner,
            self._open_corner[self.faces[facets, at]],
            (zero & self._open_edge[facets]).any(axis=1),
        )
        normal = self.normals[facets]
        sideways = away - np.sum(away * normal, axis=1)[:, None] * normal
        return np.asarray(on_border & (np.linalg.norm(sideways, axis=1) > TOUCH))


def _begins(counts: Indices) -> list[int]:
    """Where parts begin, the first one left out, of points with ``counts`` candidates: none holds more than
    :data:`HELD`, unless a point alone does."""
    begins: list[int] = []
    held = 0
    for k, count in enumerate(counts.tolist()):
        held += count
        if held > HELD and k > (begins[-1] if begins else 0):
            begins.append(k)
            held = count
    return begins


def _on_facets(corners: Array, points: Array) -> Array:
    """(N, 3) m, nearest point of each facet (N, 3, 3) to each point (N, 3)."""
    # trimesh counts what is smaller than fixed numbers as zero: of facets in m that is up to 0.1 mm, in um nothing
    return np.asarray(closest_point(_MICRO * corners, _MICRO * points) / _MICRO)


_MICRO = 1e6


def _border(faces: Indices) -> tuple[Mask, Mask]:
    """(F, 3) edges opposite to each corner that no other facet has, and (V,) corners on such edges."""
    edges = np.sort(np.stack([faces[:, [1, 2]], faces[:, [2, 0]], faces[:, [0, 1]]], axis=1).reshape(-1, 2), axis=1)
    _, number, count = np.unique(edges, axis=0, return_inverse=True, return_counts=True)
    alone = count[number.ravel()] == 1
    corner = np.zeros(int(faces.max(initial=-1)) + 1, dtype=bool)
    corner[edges[alone]] = True
    return alone.reshape(-1, 3), corner


def apart(points: Array, surface: Surface, share: float) -> str:
    """Why ``points`` (N, 3) m cannot be meant to lie on ``surface``; empty when they can.

    One shape is :data:`UNLIKE` times as large as the other, or there is more than ``share`` of the size of the surface
    between the boxes of both.
    """
    low, high = surface.corners.min(axis=(0, 1)), surface.corners.max(axis=(0, 1))
    size, other = (float(np.linalg.norm(box)) for box in (high - low, np.ptp(points, axis=0)))
    if not size / UNLIKE < other < size * UNLIKE:
        return f"the first shape is {_mm(other)} large, the second one {_mm(size)}"
    gap = float(np.linalg.norm(np.maximum(np.maximum(low - points.max(axis=0), points.min(axis=0) - high), 0.0)))
    return f"there are {_mm(gap)} between the two shapes" if gap > share * size else ""


def _mm(length: float) -> str:
    return f"{1e3 * length:.3g} mm"


UNLIKE = 20.0
"""Sizes of shapes that are compared, at most; an inch is 25 mm."""


@dataclass(frozen=True)
class Motion:
    """Rigid motion x -> R x + t: ``rotation`` (3, 3), ``shift`` (3,) m."""

    rotation: Array
    shift: Array

    def of(self, points: Array) -> Array:
        """(N, 3) m, ``points`` moved."""
        return np.asarray(points @ self.rotation.T + self.shift)

    def after(self, first: Motion) -> Motion:
        """``first``, then this one."""
        return Motion(self.rotation @ first.rotation, self.rotation @ first.shift + self.shift)

    @property
    def angle(self) -> float:
        """rad, of the rotation."""
        return float(Rotation.from_matrix(self.rotation).magnitude())


NO_MOTION = Motion(np.eye(3), np.zeros(3))

_FIT_POINTS = 4000
_FIT_STEPS = 60
_FIT_TRIM = 3.0
_FIT_NOISE = 1e-9
_FIT_FLIPS = 1e-6
"""m, deviation of shapes without noise; what a fit goes to and fro by where points change their facets."""
_FIT_EXACT, _FIT_UNTOLD = 1e-12, 0.03
"""Of the motion that the points tell best, what they tell of one that is made: of shapes that fit but for noise, and of
others. Facets and noise tell 0.02 of the turn of a cone about its axis, or the slide of its base (mini_cone)."""
_FIT_STILL = 1e-3
_FIT_FAILED = 0.1
"""What a step moves the points along their normals, in shares of the limit: it is the last one, it came to no rest."""


def best_fit(points: Array, surface: Surface) -> Motion:
    """Motion of ``points`` (N, 3) m that brings them nearest to ``surface``: least squares of the distances.

    Iterated closest points with distances to the tangent plane (Chen 1992); points beside the surface, or more than
    three robust standard deviations off, do not count. What is off is told only once the shapes lie on each other: on
    a part that is mostly flange the robust deviation is that of the flange, and a shift to the side leaves every point
    of the wall outside of it. So all count at first, and the limit falls by half with every step. Where that comes to
    no rest, motions that the points hardly tell, such as the turn of a cone about its axis, are not made.

    Raises
    ------
    IsfError : SCAN_INCOMPLETE, too few points lie over the surface, or no motion is found
    """
    try:
        return _fitted(points, surface, _FIT_EXACT)
    except IsfError:
        return _fitted(points, surface, _FIT_UNTOLD)


def _fitted(points: Array, surface: Surface, untold: float) -> Motion:
    """As :func:`best_fit`; motions that the points tell less than ``untold``, of the one they tell best, not made."""
    chosen = points[np.linspace(0, len(points) - 1, min(len(points), _FIT_POINTS)).astype(np.int64)]
    motion, moves, limit = NO_MOTION, np.inf, np.inf
    for number in range(_FIT_STEPS):
        moved = motion.of(chosen)
        found = surface.distances(moved)
        over = ~found.beside
        if over.sum() < 6:
            raise _not_fitted(f"{over.sum()} points lie over the second shape")
        normal = surface.normals[found.facet]
        error = np.sum((moved - found.closest) * normal, axis=1)
        away = np.abs(error - np.median(error[over]))
        least = _FIT_TRIM * (1.4826 * float(np.median(away[over])) + _FIT_NOISE)
        limit = max(least, 0.5**number * float(away[over].max()))
        used = over & (away <= limit)
        about = moved[used].mean(axis=0)
        arm = moved[used] - about
        size = float(np.sqrt(np.mean(np.sum(arm**2, axis=1))))  # turns and shifts move the points alike
        matrix = np.hstack([np.cross(arm / size, normal[used]), normal[used]])
        step = np.linalg.lstsq(matrix, -error[used], rcond=untold)[0]
        rotation = Rotation.from_rotvec(step[:3] / size).as_matrix()
        motion = Motion(rotation @ motion.rotation, rotation @ (motion.shift - about) + about + step[3:])
        moves = float(np.abs(matrix @ step).max())
        if limit <= least and moves < _FIT_STILL * limit:
            break
    if moves > max(_FIT_FAILED * limit, _FIT_FLIPS):
        raise _not_fitted(f"step {_FIT_STEPS} still moves the first shape by {1e6 * moves:.1f} um")
    return motion


_MASK_ROUNDS = 10
_MASK_FREE = 3
"""Rounds after which a point that the mask has left out once stays out: else rows of a scan go to and fro over the
border for ever."""
_MASK_SETTLED = 1e-3
_MASK_FAILED = 0.05
"""Of the points that a fit is made of: what crosses the border of the mask in a round that is the last one, and what
may go to and fro over it when the rounds are over."""


def best_fit_of(points: Array, surface: Surface, counts: Callable[[Array], Mask]) -> Motion:
    """As :func:`best_fit`, of those ``points`` (N, 3) m alone of which ``counts``, given where they lie, says so.

    Which points those are depends on the motion: they are chosen as the shapes lie, fitted, and chosen again until the
    same ones are chosen, but for a few at the border of the mask. What is left of a part often does not tell some
    motion, as a flat base its slide: such a motion is not made.

    Raises
    ------
    IsfError : SCAN_INCOMPLETE, as :func:`best_fit`, or no choice of points stays the same
    """
    motion, before = NO_MOTION, counts(points)
    for number in range(_MASK_ROUNDS):
        if before.sum() < 6:
            raise _not_fitted(f"{before.sum()} points are left by the mask")
        motion = _fitted(motion.of(points[before]), surface, _FIT_UNTOLD).after(motion)
        chosen = counts(motion.of(points))
        if number >= _MASK_FREE:
            chosen &= before
        changed = int((chosen != before).sum())
        if changed <= _MASK_SETTLED * before.sum():
            return motion
        before = chosen
    if changed > _MASK_FAILED * before.sum():
        raise _not_fitted(f"round {_MASK_ROUNDS} still moves {changed} points over the border of the mask")
    return motion


def _not_fitted(what: str) -> IsfError:
    return IsfError(
        ErrorCode.SCAN_INCOMPLETE,
        f"the first shape cannot be fitted to the second one: {what}",
        where="--align fit",
        advice="bring both nearly onto each other, or compare them as they lie: --align clamp",
    )


@dataclass(frozen=True)
class DistanceStatistics:
    """Of signed distances, m; shares of the area that the points stand for.

    Attributes
    ----------
    points : number of points that count ; beside : share of the area that lies beside the surface
    signed : the six numbers of Behera 2015, Table 2
    mean_abs, rms, p95_abs, max_abs : of the size of the distance ; worst : (3,) m, place of the largest
    within : share within each tolerance, by m
    """

    points: int
    beside: float
    signed: SignedStatistics
    mean_abs: float
    rms: float
    p95_abs: float
    max_abs: float
    worst: tuple[float, float, float]
    within: dict[float, float]


def statistics(
    points: Array, found: Distances, weight: Array, bands: Sequence[float] = BANDS
) -> DistanceStatistics | None:
    """Of ``points`` (N, 3) m, which stand for areas ``weight`` (N,); None when all lie beside the surface."""
    counts = ~found.beside
    if not counts.any() or weight[counts].sum() <= 0.0:
        return None
    distance, share = found.signed[counts], weight[counts] / weight[counts].sum()
    size = np.abs(distance)
    order = np.argsort(size)
    p95 = size[order][min(int(np.searchsorted(np.cumsum(share[order]), 0.95)), len(size) - 1)]
    x, y, z = points[counts][int(np.argmax(size))].tolist()
    return DistanceStatistics(
        points=int(counts.sum()),
        beside=float(weight[~counts].sum() / weight.sum()),
        signed=signed_statistics(distance, share),
        mean_abs=float(share @ size),
        rms=float(np.sqrt(share @ distance**2)),
        p95_abs=float(p95),
        max_abs=float(size.max()),
        worst=(x, y, z),
        within={float(band): 1.0 - float(share[size > band].sum()) for band in bands},
    )
