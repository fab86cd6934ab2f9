"""Serialised messages of one type as columns, thousands at a time.

A message of a fixed layout is a row of a table as it lies in memory. Texts and arrays of variable length move what
comes after them, so the layout is found from one message, and holds for all messages of the same size whose lengths
stand at the same places. Of a stream of wrenches that is all of them. Types with lists of other messages go through the
deserialiser of rosbags, one by one; there are few of them in a bag.

Columns are named by the fields, with dots ("wrench.force.x"). Times are int64 ns. Texts, and arrays of variable length
(a numpy array per row), are columns of objects. Arrays of fixed length are a column per element ("covariance[3]"). A
list of messages, or of texts, is one text in JSON. Source of the layout: OMG Common Data Representation, plain CDR 1:
numbers are aligned to their size, counted after the four bytes of the header.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from isf_core.types import Mask
from numpy.typing import NDArray
from rosbags.interfaces import Nodetype
from rosbags.typesys.store import Typestore

from isf_analysis.bag.open_bag import Block, gathered

Columns = dict[str, NDArray[Any]]
"""Column by name, all of the same length."""

RECEIVED = "received"
"""Column with the time of receipt, ns since 1970, in every table of a topic."""

TIMES = ("builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration")

CLOUD = "sensor_msgs/msg/PointCloud2"
"""A table of it has a row per point."""

_NUMBERS = {"octet": "u1", "byte": "u1", "char": "u1", "bool": "u1"}
_POINT_KINDS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}  # sensor_msgs/PointField
_HEADER = 4


class DamagedMessageError(ValueError):
    """A message that does not hold what its type says."""


@dataclass(frozen=True)
class _Leaf:
    """A field: ``kind`` number, flag, time, numbers, text or texts; ``count`` numbers of ``dtype``, or bytes.

    ``texts`` : where each of several begins and ends
    """

    name: str
    kind: str
    dtype: str
    offset: int
    count: int = 1
    texts: tuple[tuple[int, int], ...] = ()


@dataclass
class _Layout:
    """Where the fields of a message lie, and the lengths (``offset``: value) on which that depends."""

    leaves: list[_Leaf] = field(default_factory=list)
    lengths: dict[int, int] = field(default_factory=dict)


class ColumnReader:
    """Columns of the messages of type ``kind`` (``package/msg/Type``) from blocks.

    Attributes
    ----------
    damaged : messages that were left out since they do not hold what their type says
    """

    def __init__(self, types: Typestore, kind: str) -> None:
        self._types = types
        self._kind = kind
        self._flat = kind != CLOUD and _is_flat(types, kind)
        self._layouts: dict[int, _Layout] = {}
        self.damaged = 0

    def columns(self, block: Block) -> Columns:
        """Of all messages of ``block`` that are whole; of a cloud, of all their points."""
        rows = list(self._groups(block)) if self._flat else list(self._one_by_one(block))
        if not rows:
            self.damaged += len(block)
            return {}
        order = np.concatenate([numbers for numbers, _ in rows])
        self.damaged += len(block) - (len(order) if self._flat else len(rows))
        kinds: Columns = {}
        for _, part in rows:  # clouds may differ in their fields
            kinds |= {name: values[:0] for name, values in part.items() if name not in kinds}
        whole = {
            name: np.concatenate([part.get(name, nothing(kind, len(numbers))) for numbers, part in rows])
            for name, kind in kinds.items()
        }
        whole = {RECEIVED: block.times[order], **whole}
        if len(rows) == 1:
            return whole
        sorting = np.argsort(order, kind="stable")
        return {name: values[sorting] for name, values in whole.items()}

    # -- messages of the same layout ---------------------------------------------------------------

    def _groups(self, block: Block) -> Iterator[tuple[NDArray[np.int64], Columns]]:
        """Numbers of the messages that have one layout, and their columns."""
        sizes = block.end - block.begin
        for size in np.unique(sizes).tolist():
            waiting = np.flatnonzero(sizes == size)
            table = _rows(block, waiting, size)
            while len(waiting):
                first = table[0]
                try:
                    layout = self._layout(first)
                except DamagedMessageError:
                    waiting, table = waiting[1:], table[1:]
                    continue
                alike = _alike(table, layout, bytes(first[:_HEADER]))
                yield waiting[alike], _columns(table[alike] if not alike.all() else table, layout, _order(first))
                waiting, table = waiting[~alike], table[~alike]

    def _layout(self, message: NDArray[np.uint8]) -> _Layout:
        known = self._layouts.get(len(message))
        if known is not None and _alike(message[None], known, bytes(message[:_HEADER]))[0]:
            return known
        layout = _Walk(self._types, message).of(self._kind)
        self._layouts[len(message)] = layout
        return layout

    # -- messages that hold lists of messages ----------------------------------------------------------

    def _one_by_one(self, block: Block) -> Iterator[tuple[NDArray[np.int64], Columns]]:
        for number in range(len(block)):
            try:
                message = self._types.deserialize_cdr(block.message(number).tobytes(), self._kind)
                columns = _cloud_columns(message) if self._kind == CLOUD else self._flattened(message)
            except Exception:  # a damaged message shows in as many ways as there are bytes
                continue
            count = len(next(iter(columns.values()))) if columns else 0
            yield np.full(count, number, dtype=np.int64), columns

    def _flattened(self, message: Any) -> Columns:
        found: dict[str, Any] = {}
        self._flatten(message, self._kind, "", found)
        columns: Columns = {}
        for name, value in found.items():
            if isinstance(value, str) or (isinstance(value, np.ndarray) and value.ndim):
                columns[name] = _objects([value])
            else:
                columns[name] = np.array([value])
        return columns

    def _flatten(self, message: Any, kind: str, before: str, found: dict[str, Any]) -> None:
        for name, description in self._types.fielddefs[kind][1]:
            value, what = getattr(message, name), before + name
            node, detail = description
            if node == Nodetype.NAME and detail in TIMES:
                found[what] = np.int64(value.sec) * 1_000_000_000 + np.int64(value.nanosec)
            elif node == Nodetype.NAME:
                self._flatten(value, detail, f"{what}.", found)
            elif isinstance(value, np.ndarray) and node == Nodetype.ARRAY:
                found |= {f"{what}[{k}]": item for k, item in enumerate(value)}
            elif isinstance(value, list):
                found[what] = json.dumps(value, default=_plain)
            else:
                found[what] = value


class _Walk:
    """Goes through one message field by field."""

    def __init__(self, types: Typestore, message: NDArray[np.uint8]) -> None:
        if len(message) < _HEADER or message[0] != 0 or message[1] > 1:
            raise DamagedMessageError("not plain CDR")
        self._types, self._message, self._order = types, message, _order(message)
        self._at = _HEADER
        self._layout = _Layout()

    def of(self, kind: str) -> _Layout:
        """Layout of the message, which is of type ``kind``."""
        self._message_of(kind, "")
        return self._layout

    def _message_of(self, kind: str, before: str) -> None:
        for name, description in self._types.fielddefs[kind][1]:
            self._field(before + name, description)

    def _field(self, name: str, description: Any) -> None:
        node, detail = description
        if node == Nodetype.NAME and detail in TIMES:
            self._add(name, "time", "u4", 2)
        elif node == Nodetype.NAME:
            self._message_of(detail, f"{name}.")
        elif node == Nodetype.BASE:
            self._base(name, detail[0])
        elif node == Nodetype.ARRAY:
            inner, length = detail
            for k in range(length):
                self._field(f"{name}[{k}]", inner)
        else:
            inner, _ = detail
            count = self._length()
            if inner[1][0] == "string":
                texts = tuple(self._skip_text() for _ in range(count))
                self._layout.leaves.append(_Leaf(name, "texts", "u1", 0, texts=texts))
            else:
                self._add(name, "numbers", _NUMBERS.get(inner[1][0]) or np.dtype(inner[1][0]).str[1:], count)

    def _base(self, name: str, base: str) -> None:
        if base == "string":
            begin, end = self._skip_text()
            self._layout.leaves.append(_Leaf(name, "text", "u1", begin, max(0, end - begin - 1)))
        else:
            self._add(name, "flag" if base == "bool" else "number", _NUMBERS.get(base) or np.dtype(base).str[1:], 1)

    def _add(self, name: str, kind: str, dtype: str, count: int) -> None:
        size = int(dtype[1:])
        if count:
            self._align(size)
        offset = self._at
        self._advance(count * size)
        self._layout.leaves.append(_Leaf(name, kind, dtype, offset, count))

    def _skip_text(self) -> tuple[int, int]:
        """Where the next text begins and ends, its final zero included."""
        length = self._length()
        begin = self._at
        self._advance(length)
        return begin, self._at

    def _length(self) -> int:
        self._align(4)
        at = self._at
        self._advance(4)
        value = int(self._message[at : at + 4].view(f"{self._order}u4")[0])
        self._layout.lengths[at] = value
        return value

    def _align(self, size: int) -> None:
        self._at = _HEADER + ((self._at - _HEADER + size - 1) & -size)

    def _advance(self, size: int) -> None:
        self._at += size
        if self._at > len(self._message):
            raise DamagedMessageError("shorter than its type says")


def _is_flat(types: Typestore, kind: str) -> bool:
    """True unless the type holds a list of messages of any number."""
    for _, (node, detail) in types.fielddefs[kind][1]:
        if node == Nodetype.SEQUENCE and detail[0][0] != Nodetype.BASE:
            return False
        inner = detail[0] if node in (Nodetype.ARRAY, Nodetype.SEQUENCE) else (node, detail)
        if inner[0] == Nodetype.NAME and inner[1] not in TIMES and not _is_flat(types, inner[1]):
            return False
    return True


def _order(message: NDArray[np.uint8]) -> str:
    return "<" if message[1] else ">"


def _rows(block: Block, numbers: NDArray[np.int64], size: int) -> NDArray[np.uint8]:
    """(n, size) uint8, messages of the same size below each other."""
    if not size:
        return np.empty((len(numbers), 0), dtype=np.uint8)
    rows = gathered(block.data, block.begin[numbers], np.dtype((np.void, size)))
    return rows.view(np.uint8).reshape(len(numbers), size)


def _alike(table: NDArray[np.uint8], layout: _Layout, header: bytes) -> Mask:
    """(n,) messages (n, size) with the byte order and the lengths of ``layout``."""
    order = "<" if header[1] else ">"
    alike = (table[:, :_HEADER].view("u4") == np.frombuffer(header, dtype="u4")).ravel()
    for offset, value in layout.lengths.items():
        alike &= _field(table, offset, f"{order}u4") == value
    return np.asarray(alike)


def _field(table: NDArray[np.uint8], offset: int, dtype: str) -> NDArray[Any]:
    """(n,) view of one number of every message."""
    kind = np.dtype({"names": ["value"], "formats": [dtype], "offsets": [offset], "itemsize": table.shape[1]})
    return table.view(kind)["value"].ravel()


def _columns(table: NDArray[np.uint8], layout: _Layout, order: str) -> Columns:
    columns: Columns = {}
    for leaf in layout.leaves:
        if leaf.kind == "text":
            columns[leaf.name] = _texts(table[:, leaf.offset : leaf.offset + leaf.count])
        elif leaf.kind == "texts":
            texts = [[_text(row[begin : end - 1]) for begin, end in leaf.texts] for row in table]
            columns[leaf.name] = _objects([json.dumps(row) for row in texts])
        elif leaf.kind == "numbers":
            part = table[:, leaf.offset : leaf.offset + leaf.count * int(leaf.dtype[1:])]
            numbers = np.ascontiguousarray(part).view(f"{order}{leaf.dtype}") if leaf.count else part
            columns[leaf.name] = _objects(list(numbers.astype(leaf.dtype)))
        elif leaf.kind == "time":
            seconds = _field(table, leaf.offset, f"{order}i4").astype(np.int64)
            columns[leaf.name] = seconds * 1_000_000_000 + _field(table, leaf.offset + 4, f"{order}u4")
        else:
            numbers = _field(table, leaf.offset, f"{order}{leaf.dtype}").astype(leaf.dtype)
            columns[leaf.name] = numbers != 0 if leaf.kind == "flag" else numbers
    return columns


def _texts(part: NDArray[np.uint8]) -> NDArray[Any]:
    """(n,) str from (n, bytes); most often all are the same."""
    if (part == part[0]).all():
        return np.full(len(part), _text(part[0]), dtype=object)
    return _objects([_text(row) for row in part])


def _text(row: NDArray[np.uint8]) -> str:
    return row.tobytes().decode(errors="replace")


def _cloud_columns(message: Any) -> Columns:
    """A row per point: stamp of the cloud and the fields of the points."""
    order = ">" if message.is_bigendian else "<"
    kind = np.dtype(
        {
            "names": [item.name for item in message.fields],
            "formats": [(f"{order}{_POINT_KINDS[item.datatype]}", (item.count,)) for item in message.fields],
            "offsets": [item.offset for item in message.fields],
            "itemsize": message.point_step,
        }
    )
    points = np.frombuffer(message.data.tobytes(), dtype=kind)
    if len(points) != message.width * message.height:
        raise DamagedMessageError("the cloud is cut off")
    stamp = message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec
    columns: Columns = {"header.stamp": np.full(len(points), stamp, dtype=np.int64)}
    for item in message.fields:
        values = points[item.name].astype(_POINT_KINDS[item.datatype])
        single = item.count == 1
        columns |= {item.name if single else f"{item.name}[{k}]": values[:, k] for k in range(item.count)}
    return columns


def nothing(kind: NDArray[Any], n: int) -> NDArray[Any]:
    """(n,) of the type of the column ``kind``, for what has no such field: NaN, of what is no float 0."""
    return np.full(n, np.nan if kind.dtype.kind == "f" else 0, dtype=kind.dtype)


def _objects(values: list[Any]) -> NDArray[Any]:
    return np.fromiter(values, dtype=object, count=len(values))


def _plain(value: Any) -> Any:
    """Of a message or an array what JSON can hold."""
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, np.generic):
        return value.item()
    return {name: item for name, item in vars(value).items() if not name.startswith("__")}
