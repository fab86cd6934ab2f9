"""``isf compare``: how far one shape is from another; of CAD, scan, run or bag."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
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
from isf_core.types import Array, Mask

from isf_cell.commands import terminal
from isf_cell.commands.run_folder import make_run_folder
from isf_cell.shape_file import Shape, load_shape

APART = {"clamp": 0.1, "fit": 1.0}
"""Alignments, and what may be between the boxes of both shapes, in sizes of the second one."""

LEAST = 3
"""Points that numbers and a picture are made of."""

MM = 1e3


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
        "mean_mm": MM * numbers.signed.mean,
        "table2": numbers.signed.table2(),
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
        ("largest size", "max_abs_mm"),
    ):
        table.add_row(label, f"{data[key]:.3f} mm")
    for label, key in (
        ("mean of what lies above", "mean_positive_mm"),
        ("mean of what lies below", "mean_negative_mm"),
        ("largest, signed", "max_mm"),
        ("smallest, signed", "min_mm"),
        ("standard deviation", "std_mm"),
    ):
        value = data["table2"][key]
        table.add_row(label, "-" if value is None else f"{value:+.3f} mm")
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
