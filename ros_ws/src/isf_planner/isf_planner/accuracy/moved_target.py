"""The target of a part moved against its expected deviation: what is planned, so that what comes out is the part.

Every vertex p of the mesh goes to p - d n (mirror correction, Behera 2015, introduction): d is the deviation that the
accuracy surfaces expect there, positive too shallow, n the unit normal upwards, averaged over some tool radii so that
edges do not tear the field apart. The flange stays. The map from target to moved target is one to one: no facet may
shrink or turn below :data:`SMALLEST_JACOBIAN`, seen from above and along its own normal; where one would, the move is
eased off around the place.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile
from isf_core.geometry.height_map import HeightMap
from isf_core.types import Array, Indices, Mask
from scipy import ndimage

from isf_planner.accuracy import formed_parts
from isf_planner.accuracy.places import PREDICTORS, Places, find_places
from isf_planner.accuracy.surfaces import Expected, fit
from isf_planner.features.surface_features import Kind
from isf_planner.part.mesh_checks import place_text
from isf_planner.part.meshes import Mesh
from isf_planner.surface import height_grid, target_surface

EDGE = 0.25
"""Longest edge of the moved mesh, over the tool radius."""

LARGEST_MESH = 250
"""Most edges along one side of it."""

SMOOTHING = 0.3
"""Length over which the move is smoothed, over the tool radius: features end abruptly, a sheet bends (assumed)."""

RIM = 0.5
"""Way from the flange over which the move sets in, over the tool radius (assumed)."""

LARGEST_MOVE = 2e-3
"""m; no vertex moves farther (assumed: as much as a displacement adjustment changes from part to part)."""

DEPTH_SHARE = 0.5
"""A vertex moves by no more than this share of its depth below the flange, so that nothing rises above that."""

SMALLEST_JACOBIAN = 0.2
"""Area of a moved facet over that before, with the sign of its side: 1 nothing changes, 0 it folds (assumed)."""

TOLD = 0.005
"""Share of the part outside of what was learned from which it is told."""

EASED = 0.6
"""Factor on the move where a facet would shrink below that, and how often it is tried."""
TRIALS = 25


@dataclass(frozen=True)
class MovedTarget:
    """A target that is moved against its expected deviation; V vertices.

    Attributes
    ----------
    nominal, moved : the target in frame ``sheet``, its long edges divided, and the same facets moved
    move : (V,) m along the normal, positive downwards
    outside : share of the formed surface that lies outside of what was learned; nothing moves there
    smallest_jacobian : of all facets, seen from above or along the normal
    expected : deviation that the part would have unmoved, m, over x and y; NaN beside the part
    uncertainty : m, root mean square error on parts that were held out of learning
    warnings : what to look at
    """

    nominal: Mesh
    moved: Mesh
    move: Array
    outside: float
    smallest_jacobian: float
    expected: HeightMap
    uncertainty: float
    warnings: tuple[str, ...]


def compensated(mesh: Mesh, job_file: JobFile) -> MovedTarget:
    """The target ``mesh``, placed in frame ``sheet``, moved by the accuracy surfaces that the job names.

    Raises
    ------
    IsfError : LEARNING_UNUSABLE (file, or conditions that were not learned), FEATURES_MIXED (the part rises above its
        flange), TARGET_FOLDS
    """
    job = job_file.job
    assert job.accuracy_surfaces is not None  # the job asks for it
    path = job_file.base / job.accuracy_surfaces
    formed = formed_parts.load(path)
    formed.check(job, str(path))
    radius, thickness = job.tool_1.ball_radius, job.sheet.thickness
    target = target_surface.target_map(mesh, job_file.rig.clamp.size)
    places = None if formed_parts.rises(target) else find_places(target, radius, thickness)
    if places is None:
        raise IsfError(
            ErrorCode.FEATURES_MIXED,
            "accuracy surfaces are for parts that lie below their flange alone",
            where="part.accuracy_surfaces",
            advice="leave it out, or give the features as parts of their own",
        )
    return move_target(mesh, places, fit(formed.parts).expect(places), radius, formed.uncertainty)


def move_target(mesh: Mesh, places: Places, expected: Expected, radius: float, uncertainty: float) -> MovedTarget:
    """``mesh`` (m, flange at z = 0) moved against the ``expected`` deviation of its ``places``.

    ``radius`` m of the tool ; ``uncertainty`` m of the expected deviation

    Raises
    ------
    IsfError : TARGET_FOLDS where even a small move would fold the mesh
    """
    heights = places.heights
    shape = heights.z.shape
    pitch = height_grid.pitch_of(heights)
    formed = places.formed
    rim = ndimage.distance_transform_edt(formed, sampling=pitch) / (RIM * radius)
    wanted = (expected.deviation * expected.trust).reshape(shape) * _smooth_step(rim)
    wanted = _level_floors(wanted, places)
    wanted = _smoothed(np.where(formed, wanted, 0.0), formed, SMOOTHING * radius / pitch)
    most = np.minimum(LARGEST_MOVE, DEPTH_SHARE * np.maximum(-heights.z, 0.0))
    limited = np.clip(wanted, -most, most)
    remarks = list(expected.remarks)
    if (over := np.abs(wanted) > LARGEST_MOVE).any():
        share = over.sum() / formed.sum()
        remarks.append(f"{share:.0%} of the part would move by more than {1e3 * LARGEST_MOVE:g} mm, and moves so far")
    nominal = divided(mesh, max(EDGE * radius, float(np.ptp(mesh.vertices[:, :2], axis=0).max()) / LARGEST_MESH))
    xy = nominal.vertices[:, :2]
    normal = np.column_stack([_on_grid(heights, places.normal[:, k].reshape(shape), xy) for k in range(3)])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    ease = np.ones(shape)
    for trial in range(TRIALS + 1):
        move = _on_grid(heights, limited * ease, xy)
        vertices = nominal.vertices - move[:, None] * normal
        # between a node of the part and one of the flange the move is not quite bounded by the depth
        vertices[:, 2] = np.minimum(vertices[:, 2], np.maximum(nominal.vertices[:, 2], 0.0))
        moved = nominal.with_vertices(vertices)
        jacobian = jacobians(nominal, moved)
        bad = np.flatnonzero(jacobian < SMALLEST_JACOBIAN)
        if not len(bad):
            break
        middle = nominal.corners()[bad].mean(axis=1)
        if trial == TRIALS:
            raise IsfError(
                ErrorCode.TARGET_FOLDS,
                "the target would fold when it is moved against its expected deviation",
                where=f"mesh at {place_text(middle[int(np.argmin(jacobian[bad]))])}",
                advice="round the edge there, or leave part.accuracy_surfaces out",
            )
        here = np.zeros(shape, dtype=np.bool_)
        here[height_grid.nearest_node(heights, middle)] = True
        near = ndimage.binary_dilation(here, iterations=2)
        ease = np.minimum(ease, ndimage.gaussian_filter(np.where(near, EASED * ease, ease), 1.0))
        ease = np.where(near, np.minimum(ease, EASED ** (trial + 1)), ease)
    if (eased := ease < 0.99).any():
        remarks.append(
            f"the move is eased off on {(eased & formed).sum() / formed.sum():.1%} of the part, where facets would fold"
        )
    outside = float(np.average(1.0 - expected.trust[formed.ravel()], weights=_areas(places)[formed.ravel()]))
    if outside > TOLD:
        remarks.insert(
            0, f"accuracy surfaces: {outside:.0%} of the part lies outside of what was learned and is not compensated"
        )
    map_ = HeightMap(heights.x, heights.y, np.where(formed, expected.deviation.reshape(shape), np.nan))
    return MovedTarget(nominal, moved, move, outside, float(jacobian.min()), map_, uncertainty, tuple(remarks))


def jacobians(before: Mesh, after: Mesh) -> Array:
    """(F,) smaller one of two ratios of facet areas, after over before: seen from above, and along the old normal.

    A facet that stands upright before, which a height field does not have, counts along its normal alone.
    """
    old, new = (_across(mesh) for mesh in (before, after))
    size = np.linalg.norm(old, axis=1)
    along = (new * old).sum(axis=1) / np.maximum(size**2, 1e-30)
    level = old[:, 2] > 1e-3 * size
    above = np.where(level, new[:, 2] / np.where(level, old[:, 2], 1.0), np.inf)
    return np.minimum(along, above)


def divided(mesh: Mesh, longest: float) -> Mesh:
    """The same surface with every edge longer than ``longest`` m halved until none is; no vertex lies on an edge."""
    vertices, faces = mesh.vertices, mesh.faces
    while True:
        sides = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
        edges, of_side = np.unique(sides, axis=0, return_inverse=True)
        long = np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1) > longest
        if not long.any():
            return Mesh(vertices, faces)
        middle = np.full(len(edges), -1)
        middle[long] = len(vertices) + np.arange(int(long.sum()))
        vertices = np.vstack([vertices, vertices[edges[long]].mean(axis=1)])
        faces = _split(faces, middle[of_side.reshape(-1, 3)], vertices)


def _split(faces: Indices, middle: Indices, vertices: Array) -> Indices:
    """Facets cut at the ``middle`` (F, 3) of their sides 0-1, 1-2, 2-0; -1: not cut."""
    cut = middle >= 0
    # turned so that the first cut side is side 0 and a single uncut one is side 2
    count = cut.sum(axis=1)
    turn = np.where(count == 2, (np.argmin(cut, axis=1) + 1) % 3, np.argmax(cut, axis=1))
    order = (turn[:, None] + np.arange(3)) % 3
    rows = np.arange(len(faces))[:, None]
    (a, b, c), (p, q, r) = faces[rows, order].T, middle[rows, order].T
    one, two, three = count == 1, count == 2, count == 3
    pieces = [faces[count == 0]]
    pieces += [np.column_stack(corners)[one] for corners in ((a, p, c), (p, b, c))]
    pieces += [np.column_stack([p, b, q])[two]]
    # the quadrangle a p q c is cut along its shorter diagonal
    first = np.linalg.norm(vertices[a] - vertices[q], axis=1) < np.linalg.norm(vertices[p] - vertices[c], axis=1)
    pieces += [np.column_stack(corners)[two & first] for corners in ((a, p, q), (a, q, c))]
    pieces += [np.column_stack(corners)[two & ~first] for corners in ((a, p, c), (p, q, c))]
    pieces += [np.column_stack(corners)[three] for corners in ((a, p, r), (p, b, q), (r, q, c), (p, q, r))]
    return np.vstack(pieces)


def _level_floors(wanted: Array, places: Places) -> Array:
    """``wanted`` (ny, nx) m with its mean on every floor: contours at levels cannot form a floor that is not level."""
    on = places.values[:, PREDICTORS.index(Kind.FLOOR.value)].reshape(wanted.shape) > 0.5
    pieces, count = ndimage.label(on & places.formed)
    if not count:
        return wanted
    mean = np.concatenate([[0.0], ndimage.mean(wanted, pieces, np.arange(1, count + 1))])
    return np.where(pieces > 0, mean[pieces], wanted)


def _across(mesh: Mesh) -> Array:
    corners = mesh.corners()
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def _areas(places: Places) -> Array:
    """(N,) surface of the nodes over that seen from above."""
    return np.asarray(1.0 / np.maximum(places.normal[:, 2], 0.05))


def _on_grid(heights: HeightMap, values: Array, points: Array) -> Array:
    """(N,) ``values`` (ny, nx) at ``points`` (N, 2) m, the border's beyond the grid."""
    low, high = (np.array([axis[end] for axis in (heights.x, heights.y)]) for end in (0, -1))
    return HeightMap(heights.x, heights.y, values).at(np.clip(points, low, high))


def _smooth_step(x: Array) -> Array:
    """0 up to 0, 1 from 1 on, without a kink in between."""
    t = np.clip(x, 0.0, 1.0)
    return np.asarray(t * t * (3.0 - 2.0 * t))


def _smoothed(values: Array, inside: Mask, sigma: float) -> Array:
    """``values`` smoothed over ``sigma`` cells among themselves; 0 outside."""
    weight = ndimage.gaussian_filter(inside.astype(float), sigma)
    smooth = ndimage.gaussian_filter(np.where(inside, values, 0.0), sigma) / np.maximum(weight, 1e-9)
    return np.where(inside, smooth, 0.0)
