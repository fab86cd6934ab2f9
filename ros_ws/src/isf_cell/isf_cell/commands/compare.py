"""``isf compare``: how far one shape is from another; of CAD, scan, run or bag."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from isf_analysis.bag.bag_reader import read_cell
from isf_analysis.figures import distance_figures, style
from isf_analysis.measures.deviation import BANDS
from isf_analysis.measures.percent import percent
from isf_analysis.measures.plan_mask import PlanMask, region_of, shapes_of
from isf_analysis.measures.surface_distance import (
    NO_MOTION,
    Distances,
    Motion,
    Surface,
    apart,
    best_fit,
    best_fit_of,
    statistics,
)
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.archive import read_archive
from isf_core.files.bounded import LARGEST_TABLE, read_content, read_lines, reason
from isf_core.files.job import METRES, load_job
from isf_core.files.mesh_parser import LARGEST, parse_mesh
from isf_core.geometry.height_map import HeightMap
from isf_core.types import Array, Mask
from isf_planner.part import meshes
from isf_planner.planning import plan
from numpy.typing import NDArray
from scipy.spatial import Delaunay, QhullError

from isf_cell.commands import terminal
from isf_cell.commands.run_folder import make_run_folder

SAMPLES = 50_000
"""Points taken of a mesh, evenly over its area."""

LONGEST = 6.0
"""Edges of facets between the points of a cloud, in median edges; longer ones span a hole."""

APART = {"clamp": 0.1, "fit": 1.0}
"""Alignments, and what may be between the boxes of both shapes, in sizes of the second one."""

TIMES = ("received", "header.stamp")
"""Columns of a table of clouds, ns, by which the last cloud is told from those before it."""

LEAST = 3
"""Points that numbers and a picture are made of."""

MM = 1e3


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


@dataclass(frozen=True)
class Masks:
    """What counts, as it was written: shapes ``inside`` and ``outside`` in plan, ``regions`` of the target."""

    inside: tuple[str, ...] = ()
    outside: tuple[str, ...] = ()
    regions: tuple[str, ...] = ()

    def __bool__(self) -> bool:
        return bool(self.inside or self.outside or self.regions)


def compare_shapes(
    first: Path,
    second: Path,
    unit: str | None,
    align: str,
    tolerances: Sequence[float] | None,
    output: Path | None,
    masks: Masks = Masks(),
    *,
    namespace: str | None = None,
    as_json: bool,
) -> None:
    """Distance of the points of ``first`` from the surface of ``second``; ``tolerances`` mm (None: of the
    report), ``align`` clamp or fit.

    ``masks`` : which points count, where they lie once the shapes are aligned, in the frame of ``second``; a fit is
    made of them alone. ``namespace`` : cell that is meant, of bags that hold several.

    Raises IsfError of either file; FILE_FIELD for values that make no sense and masks that leave nothing;
    SCAN_INCOMPLETE: nothing in common.
    """
    tolerances = [MM * band for band in BANDS] if tolerances is None else tolerances
    if align not in APART:
        raise IsfError(ErrorCode.FILE_FIELD, f"no alignment '{align}'", where="--align", advice="clamp or fit")
    if not tolerances or not all(0.0 < value < 1e3 for value in tolerances):
        raise IsfError(ErrorCode.FILE_FIELD, "a tolerance is a length in mm", where="--tolerance", advice="such as 0.3")
    inside, outside = shapes_of(masks.inside, "--inside"), shapes_of(masks.outside, "--outside")
    measured, wanted = load_shape(first, unit, namespace), load_shape(second, unit, namespace)
    region = _region(wanted, masks.regions, second) if masks.regions else None
    mask = PlanMask(inside, outside, wanted.target, region)
    what = apart(measured.points, wanted.surface, APART[align])
    if what:
        raise IsfError(
            ErrorCode.SCAN_INCOMPLETE,
            f"{what}: are they in another frame or unit?",
            where=f"{first}, {second}",
            advice="--unit of meshes and PLY clouds; clouds in NPZ and CSV are in m; --align fit for shapes near by",
        )
    motion = _motion(measured.points, wanted.surface, mask if masks else None) if align == "fit" else NO_MOTION
    moved = motion.of(measured.points)
    counts = mask.counts(moved)
    if masks and counts.sum() < LEAST:
        raise _left(int(counts.sum()), masks, moved)
    points, area = moved[counts], measured.area[counts]
    found = wanted.surface.distances(points)
    numbers = statistics(points, found, area, [value / MM for value in tolerances])
    if masks and (numbers is None or numbers.points < LEAST):
        raise _left(0 if numbers is None else numbers.points, masks, moved)
    if numbers is None:
        raise IsfError(
            ErrorCode.SCAN_INCOMPLETE,
            "no point of the first shape lies over the second one",
            where=f"{first}, {second}",
            advice="check that both are in the same frame and unit; --align fit moves the first one",
        )
    folder = make_run_folder(output, f"compare-{first.stem or 'shape'}")
    data = {
        "first": {"path": str(first), "kind": measured.kind},
        "second": {"path": str(second), "kind": wanted.kind},
        "align": align,
        "moved": _moved(motion),
        "mask": {"inside": masks.inside, "outside": masks.outside, "regions": masks.regions},
        "masked_fraction": 1.0 - float(area.sum() / measured.area.sum()),
        "points": numbers.points,
        "beside_fraction": numbers.beside,
        "mean_mm": MM * numbers.mean,
        "mean_abs_mm": MM * numbers.mean_abs,
        "rms_mm": MM * numbers.rms,
        "p95_abs_mm": MM * numbers.p95_abs,
        "max_abs_mm": MM * numbers.max_abs,
        "worst_mm": [MM * value for value in numbers.worst],
        "within_fraction": {f"{MM * band:g}": share for band, share in numbers.within.items()},
        "picture": str(folder / "compare.png"),
        "table": str(folder / "distances.csv"),
    }
    with style.applied():
        title = f"{first.name} against {second.name}{', masked' if masks else ''}"
        over = ~found.beside
        figure = distance_figures.compared(points[over], found.signed[over], tolerances, title, mask)
        Path(str(data["picture"])).write_bytes(style.png(figure))
    _write_points(Path(str(data["table"])), points, found)
    if as_json:
        terminal.print_json(data)
    _show(data)


def _motion(points: Array, surface: Surface, mask: PlanMask | None) -> Motion:
    return best_fit(points, surface) if mask is None else best_fit_of(points, surface, mask.counts)


def _region(wanted: Shape, names: Sequence[str], path: Path) -> Mask:
    if wanted.target is None:
        raise IsfError(
            ErrorCode.FILE_FIELD,
            f"{path} has no regions: it is a {wanted.kind}, without a target",
            where="--region",
            advice="compare with a job or with a run, or choose what counts by --inside and --outside",
        )
    return region_of(wanted.target, names)


def _left(count: int, masks: Masks, points: Array) -> IsfError:
    """``masks`` leave ``count`` of the first shape, which lies at ``points`` (N, 3) m."""
    given = (("--inside", masks.inside), ("--outside", masks.outside), ("--region", masks.regions))
    low, high = (MM * end(points, axis=0) for end in (np.min, np.max))
    return IsfError(
        ErrorCode.FILE_FIELD,
        f"the mask leaves {count} points over the second shape",
        where=", ".join(option for option, values in given if values),
        advice=f"coordinates are in mm, in the frame of the second shape; the first one lies from x = {low[0]:.0f} to "
        f"{high[0]:.0f} and from y = {low[1]:.0f} to {high[1]:.0f}",
    )


def load_shape(path: Path, unit: str | None, namespace: str | None = None) -> Shape:
    """The scan of a run or bag, the CAD of a job at its place, a mesh or STEP file, or a cloud of points.

    ``namespace`` of the cell, where a bag holds several; ``unit`` of meshes and PLY clouds; clouds in NPZ and CSV are
    in m, as ``isf bag tables`` writes them.

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
    return _of_mesh("mesh", mesh.vertices, mesh.faces)


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


def _of_mesh(kind: str, vertices: Array, faces: Any) -> Shape:
    surface = Surface(vertices, np.asarray(faces, dtype=np.int64))
    return Shape(kind, evenly(surface, SAMPLES), surface, np.full(SAMPLES, surface.area.sum() / SAMPLES))


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


def _moved(motion: Motion) -> dict[str, Any] | None:
    if motion is NO_MOTION:
        return None
    return {
        "rotation": motion.rotation.tolist(),
        "angle_deg": float(np.degrees(motion.angle)),
        "shift_mm": (MM * motion.shift).tolist(),
    }


def _write_points(path: Path, points: Array, found: Distances) -> None:
    with path.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(["x_mm", "y_mm", "z_mm", "distance_mm", "beside"])
        rows = np.column_stack([MM * points, MM * found.signed]).round(6).tolist()
        writer.writerows([*row, int(beside)] for row, beside in zip(rows, found.beside.tolist(), strict=True))


def _show(data: dict[str, Any]) -> None:
    table = terminal.table_of("", "", "distance")
    for label, key in (
        ("mean distance", "mean_mm"),
        ("mean size", "mean_abs_mm"),
        ("rms", "rms_mm"),
        ("95 % within", "p95_abs_mm"),
        ("largest", "max_abs_mm"),
    ):
        table.add_row(label, f"{data[key]:.3f} mm")
    for band, share in data["within_fraction"].items():
        table.add_row(f"within {band} mm", percent(share, 1))
    if any(data["mask"].values()):
        table.add_row("masked, left out", f"{100 * data['masked_fraction']:.1f} %")
    table.add_row("beside, left out", f"{100 * data['beside_fraction']:.1f} %")
    terminal.say(
        f"{data['first']['kind']} {data['first']['path']}, distance from {data['second']['kind']} "
        f"{data['second']['path']} (positive above it)"
    )
    terminal.console.print(table)
    x, y, z = data["worst_mm"]
    terminal.say(f"largest at ({x:.1f}, {y:.1f}, {z:.1f}) mm")
    if data["moved"]:
        shift = ", ".join(f"{value:.3f}" for value in data["moved"]["shift_mm"])
        terminal.say(f"moved by ({shift}) mm and turned by {data['moved']['angle_deg']:.3f} deg to fit best")
    terminal.say(f"picture {data['picture']}\ntable   {data['table']}")
