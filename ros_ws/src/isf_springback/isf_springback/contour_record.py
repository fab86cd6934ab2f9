"""What became of one contour, kept in a file: from these a correction is taken up where it was.

A numpy archive for each contour: planned contour, correction, corrected contour, result, tool lift and scan.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from isf_core.contour import Contour, ContourCorrection, ContourResult, Process
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.archive import read_archive, write_archive
from isf_core.geometry.height_map import HeightMap
from isf_core.types import Array

TARGET = "target.npz"
_NAME = re.compile(r"contour_(\d{6})\.\d{3,}\.npz")

T = TypeVar("T", Contour, ContourCorrection, ContourResult, HeightMap)


@dataclass
class ContourRecord:
    """A contour that was corrected, and what was measured since.

    Attributes
    ----------
    nominal, corrected : as planned, and as it was to be formed
    result : None until it has come
    lift : (K, 4) rows of the tool lift after it, None: none
    scan : (P, 3) m, points of the scan after it, None: none
    written : nothing has come since it was written to its file
    revision : number of its file; each time it is written it gets another one, since a checkpoint may name the last
    """

    nominal: Contour
    correction: ContourCorrection
    corrected: Contour
    result: ContourResult | None = None
    lift: Array | None = None
    scan: Array | None = None
    written: bool = False
    revision: int = 0

    @property
    def file_name(self) -> str:
        """Name of its file."""
        return f"contour_{self.nominal.index:06d}.{self.revision:03d}.npz"

    def write(self, folder: Path) -> None:
        """Write it to a new file in ``folder``; raises IsfError FILE_NOT_WRITABLE."""
        self.revision += 1
        arrays = _arrays("nominal", self.nominal) | _arrays("correction", self.correction)
        arrays |= _arrays("corrected", self.corrected)
        if self.result is not None:
            arrays |= _arrays("result", self.result)
        arrays |= {name: value for name in ("lift", "scan") if (value := getattr(self, name)) is not None}
        write_archive(folder / self.file_name, arrays, make_folder=True)
        self.written = True


def read_records(folder: Path) -> list[ContourRecord]:
    """The last record of every contour in ``folder``, in the order of their contours.

    Raises
    ------
    IsfError : FILE_NOT_FOUND, there is none; CHECKPOINT_UNUSABLE, a file is damaged or of another version
    """
    newest = {found[1]: path for path in sorted(folder.glob("contour_*.npz")) if (found := _NAME.fullmatch(path.name))}
    if not newest:
        raise IsfError(ErrorCode.FILE_NOT_FOUND, "no contours are kept here", where=str(folder))
    return [_record(path) for path in newest.values()]


def write_target(target: HeightMap, preforms: Sequence[HeightMap], folder: Path) -> None:
    """Replace the file of the wanted shape, and of those of the stages before it, in ``folder``; raises IsfError
    FILE_NOT_WRITABLE."""
    arrays = _arrays("target", target)
    if preforms:
        arrays["preforms"] = np.stack([preform.z for preform in preforms])
    write_archive(folder / TARGET, arrays, make_folder=True)


def read_target(folder: Path) -> tuple[HeightMap, tuple[HeightMap, ...]] | None:
    """The wanted shape and those of the stages before it, None where there is no file of them; raises IsfError
    CHECKPOINT_UNUSABLE."""
    path = folder / TARGET
    if not path.exists():
        return None
    arrays = _read(path)
    target = _decoded(HeightMap, "target", arrays, path)
    return target, tuple(HeightMap(target.x, target.y, z) for z in arrays.get("preforms", ()))


def _record(path: Path) -> ContourRecord:
    arrays = _read(path)
    return ContourRecord(
        nominal=_decoded(Contour, "nominal", arrays, path),
        correction=_decoded(ContourCorrection, "correction", arrays, path),
        corrected=_decoded(Contour, "corrected", arrays, path),
        result=_decoded(ContourResult, "result", arrays, path) if "result.index" in arrays else None,
        lift=arrays.get("lift"),
        scan=arrays.get("scan"),
        written=True,
        revision=int(path.name.split(".")[1]),
    )


def _arrays(prefix: str, item: Any) -> dict[str, Any]:
    return {f"{prefix}.{one.name}": np.asarray(getattr(item, one.name)) for one in fields(item)}


def _decoded(kind: type[T], prefix: str, arrays: Mapping[str, Any], path: Path) -> T:
    try:
        values = {one.name: _value(one.name, arrays[f"{prefix}.{one.name}"]) for one in fields(kind)}
        return kind(**values)
    except (KeyError, TypeError, ValueError) as error:
        raise _unusable(path, f"lacks {error}") from error


def _value(name: str, array: Any) -> Any:
    if name == "process":
        return Process(int(array))
    if name == "remarks":
        return tuple(str(text) for text in array)
    return array.item() if array.ndim == 0 else array


def _read(path: Path) -> dict[str, Any]:
    try:
        return read_archive(path)
    except OSError as error:
        raise _unusable(path, f"is damaged: {error.strerror}") from error


def _unusable(path: Path, what: str) -> IsfError:
    return IsfError(
        ErrorCode.CHECKPOINT_UNUSABLE, what, where=str(path), advice="form the part again, on a fresh blank"
    )
