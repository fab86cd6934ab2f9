"""A shape from what a user has: the scan of a run or bag, CAD, the CAD of a job, a mesh, a cloud of points."""

from __future__ import annotations

import csv
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from isf_analysis.bag.bag_reader import read_cell
from isf_analysis.measures.surface_distance import Surface
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.archive import read_archive
from isf_core.files.bounded import LARGEST_TABLE, read_content, read_lines, reason
from isf_core.files.job import METRES, load_job
from isf_core.files.mesh_parser import LARGEST, parse_mesh
from isf_core.geometry.height_map import HeightMap
from isf_core.types import Array
from isf_planner.part import meshes
from isf_planner.planning import plan
from numpy.typing import NDArray
from scipy.spatial import Delaunay, QhullError

SAMPLES = 50_000
"""Points taken of a mesh, evenly over its area."""

LONGEST = 6.0
"""Edges of facets between the points of a cloud, in median edges; longer ones span a hole."""

TIMES = ("received", "header.stamp")
"""Columns of a table of clouds, ns, by which the last cloud is told from those before it."""


@dataclass(frozen=True)
class Shape:
    """A shape in m: ``points`` (N, 3), the areas m^2 that they stand for, and its ``surface``; ``kind`` for people.

    ``target`` of the run or job that the shape is of.
    """

    kind: str
    points: Array
    surface: Surface
    area: Array
    target: HeightMap | None = None


def load_shape(path: Path, unit: str | None, namespace: str | None = None, samples: int = SAMPLES) -> Shape:
    """The scan of a run or bag, the CAD of a job at its place, a mesh or STEP file, or a cloud of points.

    ``namespace`` of the cell, where a bag holds several; ``unit`` of meshes and PLY clouds; clouds in NPZ and CSV are
    in m, as ``isf bag tables`` writes them. ``samples``: points that are taken of a mesh.

    Raises
    ------
    IsfError : what cannot be read or holds no shape
    """
    kind = path.suffix.lower().lstrip(".")
    if path.is_dir() or kind in ("mcap", "db3"):
        return _of_bag(path, namespace)
    if kind in ("yaml", "yml"):
        return _of_job(path)
    if kind in ("npz", "csv"):
        return _of_points(_table_points(path, kind), "cloud of points", path)
    if kind == "ply" and path.is_file() and not _has_facets(data := _ply(path)):
        return _of_points(_ply_points(data, path, unit), "cloud of points", path)
    if kind not in meshes.KNOWN:
        known = ", ".join(("a run or bag", "a job (.yaml)", ".npz", ".csv", *(f".{name}" for name in meshes.KNOWN)))
        raise IsfError(ErrorCode.MESH_UNREADABLE, "is no shape", where=str(path), advice=f"known: {known}")
    mesh = meshes.load_mesh(path, unit)
    return _of_mesh("mesh", mesh.vertices, mesh.faces, samples)


def _of_bag(path: Path, namespace: str | None) -> Shape:
    record = read_cell(path, namespace)
    scan = record.scan
    if scan is None:
        raise IsfError(
            ErrorCode.BAG_INCOMPLETE,
            "holds no scan of the finished part",
            where=str(path),
            advice="record the topic scan; the executive has the part measured at its end",
        )
    points = scan.points()
    if np.isfinite(points[:, 2]).sum() < 3:
        raise IsfError(
            ErrorCode.SCAN_INCOMPLETE, "the scan holds no heights", where=str(path), advice="scan the part again"
        )
    known, surface = np.isfinite(points).all(axis=1), Surface.of_height_map(scan)
    return Shape("scan of a run", points[known], surface, surface.area_by_vertex()[known], record.target)


def _of_job(path: Path) -> Shape:
    # the plan says where the part lies: over a die, and of a part from both sides, the outline alone does not
    made = plan(load_job(path))
    return replace(_of_mesh("CAD of a job", *made.mesh), target=made.target)


def _of_mesh(kind: str, vertices: Array, faces: Any, samples: int = SAMPLES) -> Shape:
    surface = Surface(vertices, np.asarray(faces, dtype=np.int64))
    return Shape(kind, evenly(surface, samples), surface, np.full(samples, surface.area.sum() / samples))


def evenly(surface: Surface, count: int) -> Array:
    """(count, 3) m, points evenly over the area of ``surface``; always the same."""
    rng = np.random.default_rng(0)
    along = np.cumsum(surface.area)
    facet = np.searchsorted(along, (np.arange(count) + 0.5) / count * along[-1])
    a, b = rng.random(count), rng.random(count)
    folded = a + b > 1.0
    a, b = np.where(folded, 1.0 - a, a)[:, None], np.where(folded, 1.0 - b, b)[:, None]
    first, second, third = surface.corners[facet].transpose(1, 0, 2)
    return np.asarray(first + a * (second - first) + b * (third - first))


def _of_points(points: Array, kind: str, path: Path) -> Shape:
    """A cloud: its surface is a height field through all points."""
    points = points[np.isfinite(points).all(axis=1)]
    if np.abs(points).max(initial=0.0) > meshes.LARGEST:
        raise IsfError(
            ErrorCode.MESH_UNIT_SUSPECT,
            f"coordinates go beyond {meshes.LARGEST:g} m",
            where=str(path),
            advice="coordinates in NPZ and CSV are in m; --unit of PLY clouds",
        )
    _, single = np.unique(points[:, :2], axis=0, return_index=True)
    if len(single) < 4 or np.linalg.matrix_rank(points[single, :2] - points[single, :2].mean(axis=0)) < 2:
        raise IsfError(
            ErrorCode.SCAN_INCOMPLETE, f"has {len(points)} points", where=str(path), advice="three in a plane at least"
        )
    points = points[np.sort(single)]
    try:
        faces = Delaunay(points[:, :2]).simplices.astype(np.int64)
    except QhullError as error:  # all but in one line
        raise IsfError(
            ErrorCode.SCAN_INCOMPLETE, "its points make no surface", where=str(path), advice="scan the whole part"
        ) from error
    edges = points[faces, :2] - points[np.roll(faces, 1, axis=1), :2]
    longest = np.linalg.norm(edges, axis=2).max(axis=1)
    surface = Surface(points, faces[longest <= LONGEST * np.median(longest)])
    return Shape(kind, points, surface, surface.area_by_vertex())


def _table_points(path: Path, kind: str) -> Array:
    """(N, 3) m of a table; of one that holds several clouds, as of a topic with scans between contours, the last."""
    try:
        if kind == "npz":
            data = read_archive(path)
            if "points" in data:
                return _numbers(data["points"]).reshape(-1, 3)
            names = [*"xyz", *(name for name in TIMES if name in data)]
            return _newest(np.column_stack([_numbers(data[name]) for name in names]))
        lines = [line for line in read_lines(path, LARGEST_TABLE) if line.strip()]
        header = next(csv.reader(lines[:1]), [])
        columns = [header.index(name) for name in (*"xyz", *(name for name in TIMES if name in header))]
        if len(lines) < 2:
            return np.empty((0, 3))
        return _newest(np.loadtxt(lines[1:], delimiter=",", usecols=columns, ndmin=2))
    except FileNotFoundError as error:
        raise IsfError(ErrorCode.FILE_NOT_FOUND, "no such file", where=str(path), advice="check the path") from error
    except (OSError, ValueError, KeyError, csv.Error) as error:  # no such file, no such column, not numbers
        raise IsfError(
            ErrorCode.FILE_SYNTAX,
            f"holds no points: {reason(error)}",
            where=str(path),
            advice="x, y and z in m, as isf bag tables writes the topic scan; or points (N, 3)",
        ) from error


def _numbers(array: NDArray[Any]) -> Array:
    if array.dtype.kind not in "fiu":
        raise ValueError(f"{array.dtype} are no numbers")
    return array.astype(np.float64)


def _newest(table: Array) -> Array:
    """(N, 3) points of ``table`` (R, 3 + T): those whose T times are the last."""
    for column in range(3, table.shape[1]):
        table = table[table[:, column] == table[:, column].max(initial=-np.inf)]
    return table[:, :3]


def _ply(path: Path) -> bytes:
    try:
        return read_content(path, LARGEST["ply"])
    except OSError as error:
        what = f"cannot be read: {error.strerror}"
        raise IsfError(ErrorCode.MESH_UNREADABLE, what, where=str(path), advice="export a coarser cloud") from error


def _has_facets(data: bytes) -> bool:
    head = data[:4000].split(b"end_header")[0]
    return any(line.split()[:2] == [b"element", b"face"] and line.split()[2:] != [b"0"] for line in head.splitlines())


def _ply_points(data: bytes, path: Path, unit: str | None) -> Array:
    if unit not in METRES:
        raise IsfError(
            ErrorCode.MESH_UNIT_UNKNOWN, "PLY files carry no unit", where=str(path), advice="--unit mm (or m, cm, in)"
        )
    try:
        vertices = np.asarray(parse_mesh(data, "ply").vertices, dtype=np.float64)
        return vertices.reshape(-1, 3) * METRES[unit]
    except (ValueError, TypeError, AttributeError) as error:  # no vertices, or no numbers
        raise IsfError(
            ErrorCode.MESH_UNREADABLE, f"cannot be read: {error}", where=str(path), advice="export the cloud again"
        ) from error
