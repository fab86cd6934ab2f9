"""Numbers of a golden run: what is kept of them in a file, and how a run is compared with what was kept.

Of every array a file keeps the digest of all its bits, mean and largest size of each column, and some of its rows, in
a unit in which differences of 1 do not matter. So a difference is told with its place and size, while files stay small.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Entry = dict[str, Any]


class Quantity(Enum):
    """Kind of number: unit in files, SI value of that unit, largest difference in that unit."""

    LENGTH = ("nm", 1e-9, 1.0)  # feeds and speeds too, nm/s
    SCAN = ("nm", 1e-9, 100.0)  # means of points kept in steps of 10 um and 1 um
    FORCE = ("mN", 1e-3, 1.0)
    ANGLE = ("nrad", 1e-9, 10.0)
    RATIO = ("ppb", 1e-9, 10.0)
    TIME = ("ns", 1e-9, 1.0)
    COUNT = ("", 1.0, 0.0)
    COMPLIANCE = ("pm/N", 1e-12, 1.0)
    STIFFNESS = ("N/m", 1.0, 1.0)
    FREQUENCY = ("mHz", 1e-3, 1.0)
    RELATIVE = ("", 1.0, 1e-9)  # numbers of several kinds: relative to each

    def __init__(self, unit: str, scale: float, bound: float) -> None:
        self.unit, self.scale, self.bound = unit, scale, bound


@dataclass(frozen=True)
class Series:
    """``blocks``: one array (N,) or (N, C) per contour, SI; ``points``: rows kept of each."""

    quantity: Quantity
    blocks: list[NDArray[Any]]
    points: int = 2

    def entry(self) -> Entry:
        """What a file keeps."""
        blocks = [np.asarray(block, dtype=float) for block in self.blocks]
        return {
            "quantity": self.quantity.name,
            "points": self.points,
            "shapes": [list(block.shape) for block in blocks],
            "digests": [hashlib.sha256(np.ascontiguousarray(block).tobytes()).hexdigest()[:8] for block in blocks],
            "mean": [self._kept(_columns(np.mean, block)) for block in blocks],
            "largest": [self._kept(_columns(lambda values: np.abs(values).max(), block)) for block in blocks],
            "rows": [self._kept(block[_places(len(block), self.points)]) for block in blocks],
        }

    def _kept(self, values: Array) -> Any:
        """In the unit of the file with one digit more than matters; NaN as null."""
        if self.quantity is Quantity.RELATIVE:
            return [float(f"{value:.12g}") for value in values.ravel()]
        rounded = np.round(values / self.quantity.scale, 1) + 0.0  # no negative zeros
        flat = [None if np.isnan(value) else int(value) if value == int(value) else value for value in rounded.ravel()]
        return flat


def _columns(reduce: Any, block: Array) -> Array:
    """``reduce`` over the finite values of each column; NaN where there is none."""
    columns = block.T if block.ndim > 1 else block[None]
    found = (column[np.isfinite(column)] for column in columns)
    return np.array([reduce(column) if len(column) else np.nan for column in found])


def _places(rows: int, points: int) -> NDArray[np.int64]:
    """``points`` indices spread over ``rows``, neither first nor last, all when there are no more."""
    if rows <= points:
        return np.arange(rows)
    return (rows * (2 * np.arange(points) + 1)) // (2 * points)


def write(path: Path, provenance: dict[str, str], series: dict[str, Series]) -> None:
    """Write a file with one line per series, so that a change can be read in a diff."""
    lines = [f"{json.dumps(name)}: {json.dumps(item.entry(), separators=(',', ':'))}" for name, item in series.items()]
    head = json.dumps(provenance, indent=1)
    path.write_text(f'{{"provenance": {head},\n"series": {{\n' + ",\n".join(lines) + "\n}}\n", encoding="utf-8")


def read(path: Path) -> dict[str, Entry]:
    """Entries of a file by the name of the series."""
    entries: dict[str, Entry] = json.loads(path.read_text(encoding="utf-8"))["series"]
    return entries


def differences(
    recorded: dict[str, Entry],
    series: dict[str, Series],
    *,
    exact: bool = False,
    factor: dict[Quantity, float] | None = None,
) -> list[str]:
    """What differs between a recorded run and ``series``, one line each, the largest differences of a series alone.

    ``exact`` : bit for bit; ``factor`` : bounds are so many times wider
    """
    found = [f"{name}: recorded, but not there any more" for name in recorded if name not in series]
    for name, item in series.items():
        if name not in recorded:
            found.append(f"{name}: not recorded")
        else:
            bound = item.quantity.bound * (factor or {}).get(item.quantity, 1.0)
            # Through text as the file went, so that both are rounded alike.
            found += _of_series(name, recorded[name], json.loads(json.dumps(item.entry())), item.quantity, bound, exact)
    return found


def _of_series(name: str, old: Entry, new: Entry, quantity: Quantity, bound: float, exact: bool) -> list[str]:
    if old["quantity"] != new["quantity"] or old["points"] != new["points"]:
        return [f"{name}: is kept in another way; record it anew"]
    if len(old["shapes"]) != len(new["shapes"]):
        return [f"{name}: {len(new['shapes'])} contours, {len(old['shapes'])} recorded"]
    for k, (was, now) in enumerate(zip(old["shapes"], new["shapes"], strict=True)):
        if was != now:
            return [f"{name}: {_contour(k, old)}has the shape {now}, recorded {was}"]
    worst, text = 0.0, ""
    for kind in ("rows", "mean", "largest"):
        for k, (was, now) in enumerate(zip(old[kind], new[kind], strict=True)):
            a, b = np.array(was, dtype=float), np.array(now, dtype=float)
            off = np.abs(b - a) / (np.maximum(np.abs(a), 1e-300) if quantity is Quantity.RELATIVE else 1.0)
            off = np.where(np.isnan(a) & np.isnan(b), 0.0, np.where(np.isnan(off), np.inf, off))
            if len(off) and off.max() > max(worst, bound + 0.051 * (quantity is not Quantity.RELATIVE and bound > 0)):
                place = int(off.argmax())
                worst = float(off.max())
                text = f"{_value(kind, place, old['shapes'][k])} {b[place]:.10g} {quantity.unit}, "
                text += f"recorded {a[place]:.10g}, differs by {worst:.4g} (bound {bound:g})"
                text = f"{name}: {_contour(k, old)}{text}"
    if text:
        return [text]
    changed = [k for k, (was, now) in enumerate(zip(old["digests"], new["digests"], strict=True)) if was != now]
    if exact and changed:
        where = f"{name}: {_contour(changed[0], old)}"
        return [f"{where}is not the same bit for bit, within the bound of {bound:g} {quantity.unit}"]
    return []


def _contour(k: int, entry: Entry) -> str:
    return f"contour {k + 1} of {len(entry['shapes'])}: " if len(entry["shapes"]) > 1 else ""


def _value(kind: str, place: int, shape: list[int]) -> str:
    columns = shape[1] if len(shape) > 1 else 1
    column = f"[{place % columns}]" if columns > 1 else ""
    return f"kept row {place // columns}{column}" if kind == "rows" else f"{kind}{column}"
