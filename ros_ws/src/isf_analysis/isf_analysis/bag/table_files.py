"""Tables of a bag as files, written in parts as they are read, so that a bag may be larger than memory.

CSV holds of an array of variable length its length alone, as ``NAME.count``; NPZ and Parquet hold all. In NPZ the
arrays of a column stand one after the other, with ``NAME.count`` beside them; texts are UTF-8 (dtype S). Parquet needs
pyarrow.
"""

from __future__ import annotations

import csv
import shutil
import tempfile
import zipfile
from array import array
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any, Protocol

import numpy as np
from isf_core.errors import ErrorCode, IsfError
from numpy.typing import NDArray

from isf_analysis.bag.cdr_columns import Columns
from isf_analysis.bag.tables import Bag, not_installed, read_tables

FORMATS = ("csv", "npz", "parquet")

PART_TABLES = ("contours", "points", "ticks")
"""Tables of the part; those of topics are named by the topic."""


class TableFile(Protocol):
    """A file that takes a table in parts."""

    def add(self, columns: Columns) -> None: ...

    def close(self) -> None: ...


def write_tables(
    bag: Bag, folder: Path, formats: Sequence[str] | None = None, topics: Sequence[str] | None = None
) -> dict[str, int]:
    """Files of the part's tables and of ``topics`` (None: all) of ``bag`` in ``folder``; rows per table.

    ``formats`` of :data:`FORMATS`; None: CSV, NPZ, and Parquet where pyarrow is installed. What cannot be shown is left
    out, with a note in ``bag.notes``.

    Raises
    ------
    IsfError : FILE_FIELD (no such format or topic), FILE_NOT_FOUND (pyarrow is not installed), FILE_NOT_WRITABLE
    """
    kinds = _formats(formats)
    wanted = {name: bag.connections[name] for name in (_topic(bag, topic) for topic in topics or bag)}
    names = _file_names(wanted)
    rows: dict[str, int] = {}
    try:
        with ExitStack() as stack:
            files: dict[str, list[TableFile]] = {}
            for name, columns in _all_tables(bag, wanted):
                if name not in files:
                    files[name] = [_opened(stack, kind, folder / f"{names.get(name, name)}.{kind}") for kind in kinds]
                for file in files[name]:
                    file.add(columns)
                rows[name] = rows.get(name, 0) + len(next(iter(columns.values())))
    except OSError as error:
        raise IsfError(
            ErrorCode.FILE_NOT_WRITABLE, str(error), where=str(folder), advice="choose a writable --output"
        ) from error
    return rows


def write_table(columns: Columns, folder: Path, name: str) -> list[Path]:
    """Files NAME.csv, and NAME.parquet where pyarrow is installed, each replaced as a whole; raises IsfError
    FILE_NOT_WRITABLE."""
    paths = []
    try:
        for kind in _formats(None):
            if kind != "npz":
                path = folder / f"{name}.{kind}"
                partial = path.with_name(f"{path.name}.partial")
                with ExitStack() as stack:
                    _opened(stack, kind, partial).add(columns)
                partial.replace(path)
                paths.append(path)
    except OSError as error:
        raise IsfError(
            ErrorCode.FILE_NOT_WRITABLE, str(error), where=str(folder), advice="choose a writable --output"
        ) from error
    return paths


def _formats(formats: Sequence[str] | None) -> list[str]:
    if formats is None:
        return [kind for kind in FORMATS if kind != "parquet" or _pyarrow() is not None]
    for kind in formats:
        if kind not in FORMATS:
            raise IsfError(
                ErrorCode.FILE_FIELD, f"no format '{kind}'", where="--format", advice=f"known: {', '.join(FORMATS)}"
            )
    if "parquet" in formats and _pyarrow() is None:
        raise not_installed("pyarrow", "CSV and NPZ need nothing")
    return list(dict.fromkeys(formats))


def _topic(bag: Bag, topic: str) -> str:
    try:
        return bag[topic].name
    except KeyError as error:
        raise IsfError(
            ErrorCode.FILE_FIELD, str(error.args[0]), where="--topic", advice="isf bag info lists the topics"
        ) from error


def _file_names(topics: Iterable[str]) -> dict[str, str]:
    """Name of a file per topic: slashes as underscores; never that of a table of the part, nor one twice."""
    names: dict[str, str] = {}
    for topic in topics:
        name = topic.strip("/").replace("/", "_") or "root"
        while name in names.values() or name in PART_TABLES:
            name += "_"
        names[topic] = name
    return names


def _all_tables(bag: Bag, wanted: dict[str, Any]) -> Iterator[tuple[str, Columns]]:
    try:
        for table in (bag.contours, bag.points, bag.ticks):
            yield from ((table.name, columns) for columns in table.blocks())
    except IsfError as error:  # not a bag of a cell, or nothing was formed: its topics are shown
        bag.raw.note(f"no tables of contours: {error.message}")
    yield from read_tables(bag.raw, wanted)


def _opened(stack: ExitStack, kind: str, path: Path) -> TableFile:
    kinds: dict[str, Callable[[Path], TableFile]] = {"csv": CsvFile, "npz": NpzFile, "parquet": ParquetFile}
    file = kinds[kind](path)
    stack.callback(file.close)
    return file


class CsvFile:
    """Comma separated, a line of names first; numbers as Python writes them, none where unknown."""

    def __init__(self, path: Path) -> None:
        self._file = path.open("w", encoding="utf-8", newline="")
        self._writer = csv.writer(self._file, lineterminator="\n")
        self._names: list[str] = []

    def add(self, columns: Columns) -> None:
        """Write the rows of ``columns``."""
        arrays = {name: values.dtype == object and _is_ragged(values) for name, values in columns.items()}
        if not self._names:
            self._names = list(columns)
            self._writer.writerow([f"{name}.count" if arrays[name] else name for name in self._names])
        cells = [_lengths(columns[name]) if arrays[name] else columns[name].tolist() for name in self._names]
        self._writer.writerows(zip(*cells, strict=True))

    def close(self) -> None:
        """The file is complete."""
        self._file.close()


class NpzFile:
    """As of numpy.savez; the columns wait in files until all is known."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._folder = tempfile.TemporaryDirectory(prefix="isf_table_", dir=path.parent)
        self._columns: dict[str, _Waiting] = {}

    def add(self, columns: Columns) -> None:
        """Keep the rows of ``columns``."""
        for name, values in columns.items():
            if values.dtype != object:
                self._append(name, values)
            elif _is_ragged(values):
                self._append(name, np.concatenate(list(values)))
                self._append(f"{name}.count", np.array(_lengths(values), dtype=np.int64))
            else:
                texts = [text.encode() for text in values]
                column = self._append(name, np.frombuffer(b"".join(texts), dtype=np.uint8))
                column.lengths.extend(map(len, texts))

    def close(self) -> None:
        """Write the file."""
        with self._folder, zipfile.ZipFile(self._path, "w", zipfile.ZIP_STORED, allowZip64=True) as archive:
            for name, column in self._columns.items():
                with column.file, archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                    column.write(member)

    def _append(self, name: str, values: NDArray[Any]) -> _Waiting:
        if name not in self._columns:
            file = (Path(self._folder.name) / str(len(self._columns))).open("w+b")
            self._columns[name] = _Waiting(file, values.dtype)
        column = self._columns[name]
        column.file.write(np.ascontiguousarray(values, dtype=column.kind).data)
        return column


@dataclass
class _Waiting:
    """A column in a file; ``lengths`` of texts, in bytes."""

    file: IO[bytes]
    kind: np.dtype[Any]
    lengths: array[int] = field(default_factory=lambda: array("L"))

    def write(self, member: IO[bytes]) -> None:
        """The column as an .npy file."""
        size = self.file.tell() // self.kind.itemsize
        self.file.seek(0)
        if not self.lengths:
            _npy_header(member, self.kind, size)
            shutil.copyfileobj(self.file, member, 1 << 20)
            return
        kind = np.dtype(f"S{max(1, *self.lengths)}")
        _npy_header(member, kind, len(self.lengths))
        for begin in range(0, len(self.lengths), _ROWS):
            texts = [self.file.read(length) for length in self.lengths[begin : begin + _ROWS]]
            member.write(np.array(texts, dtype=kind).tobytes())


_ROWS = 4096


def _npy_header(member: IO[bytes], kind: np.dtype[Any], size: int) -> None:
    header = {"descr": np.lib.format.dtype_to_descr(kind), "fortran_order": False, "shape": (size,)}
    np.lib.format.write_array_header_1_0(member, header)


class ParquetFile:
    """A row group per part; arrays as lists."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._writer: Any = None

    def add(self, columns: Columns) -> None:
        """Write the rows of ``columns``."""
        import pyarrow
        from pyarrow import parquet

        table = pyarrow.table({name: _arrow(values) for name, values in columns.items()})
        if self._writer is None:
            self._writer = parquet.ParquetWriter(self._path, table.schema, compression="zstd")
        self._writer.write_table(table.cast(self._writer.schema))

    def close(self) -> None:
        """The file is complete."""
        if self._writer is not None:
            self._writer.close()


def _arrow(values: NDArray[Any]) -> Any:
    import pyarrow

    return pyarrow.array(list(values) if values.dtype == object else values)


def _is_ragged(values: NDArray[Any]) -> bool:
    """True for a column of arrays, False for one of texts."""
    return len(values) > 0 and isinstance(values[0], np.ndarray)


def _lengths(values: NDArray[Any]) -> list[int]:
    return [len(item) for item in values]


def _pyarrow() -> Any:
    """The package, None where it is not installed."""
    try:
        import pyarrow.parquet
    except ImportError:
        return None
    return pyarrow
