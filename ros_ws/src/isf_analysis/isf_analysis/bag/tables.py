"""Tables of a bag: one per topic and three of the part, read when they are asked for, without ROS.

::

    bag = isf_analysis.open("runs/ren_cone")
    wrench = bag["tool_1/wrench"]
    wrench["wrench.force.z"]            # (n,) N
    bag.contours.to_pandas()            # a row per contour
    for part in wrench.blocks():        # of a bag larger than memory
        ...
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import cached_property
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from isf_core.errors import ErrorCode, IsfError
from numpy.typing import NDArray
from rosbags.interfaces import Connection

from isf_analysis.bag.bag_reader import part_of
from isf_analysis.bag.cdr_columns import ColumnReader, Columns, nothing
from isf_analysis.bag.open_bag import OpenBag, open_bag
from isf_analysis.measures import part_tables
from isf_analysis.measures.record import PartRecord


class Table:
    """Columns of the same length by name, loaded at the first use.

    Attributes
    ----------
    name : of the table
    """

    def __init__(self, name: str, blocks: Callable[[], Iterator[Columns]]) -> None:
        self.name = name
        self._blocks = blocks

    def __getitem__(self, column: str) -> NDArray[Any]:
        """(n,) a column; raises KeyError with the names that exist."""
        try:
            return self.columns[column]
        except KeyError:
            raise KeyError(f"{self.name} has no column {column!r}; it has {', '.join(self.columns)}") from None

    def __len__(self) -> int:
        return len(next(iter(self.columns.values()))) if self.columns else 0

    def blocks(self) -> Iterator[Columns]:
        """The table in parts below each other, as they are read; nothing is kept."""
        return self._blocks()

    @cached_property
    def columns(self) -> Columns:
        """The whole table."""
        parts = list(self._blocks())
        if not parts:
            return {}
        return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}

    def to_numpy(self) -> NDArray[Any]:
        """(n,) structured array."""
        kind = np.dtype([(name, values.dtype) for name, values in self.columns.items()])
        table = np.empty(len(self), dtype=kind)
        for name, values in self.columns.items():
            table[name] = values
        return table

    def to_pandas(self) -> Any:
        """``pandas.DataFrame``.

        Raises
        ------
        IsfError : FILE_NOT_FOUND, pandas is not installed
        """
        try:
            import pandas
        except ImportError as error:
            raise not_installed("pandas", "to_numpy() and the columns need nothing") from error
        return pandas.DataFrame(self.columns)


class TopicTable(Table):
    """Messages of a topic; of point clouds their points.

    Attributes
    ----------
    type : ``package/msg/Type``
    messages : recorded, by the index of the bag
    """

    def __init__(self, bag: OpenBag, name: str, connections: list[Connection]) -> None:
        super().__init__(name, self._read)
        self.type = connections[0].msgtype
        self.messages = sum(connection.msgcount for connection in connections)
        self._bag, self._connections = bag, connections

    def _read(self) -> Iterator[Columns]:
        for _, columns in read_tables(self._bag, {self.name: self._connections}):
            yield columns


def read_tables(bag: OpenBag, connections: Mapping[str, list[Connection]]) -> Iterator[tuple[str, Columns]]:
    """Names of topics and parts of their tables, of all topics in one pass through the file.

    All parts of a topic have the same columns; what one lacks (clouds may differ) is NaN.
    """
    names = {item.topic: name for name, items in connections.items() for item in items}
    readers = {name: ColumnReader(bag.types, items[0].msgtype) for name, items in connections.items()}
    kinds: dict[str, dict[str, NDArray[Any]]] = {}
    wanted = [item for name, items in connections.items() for item in items if item.msgtype == items[0].msgtype]
    for block in bag.blocks(wanted):
        name = names[block.connection.topic]
        columns = readers[name].columns(block)
        if not columns:
            continue
        first = kinds.setdefault(name, {column: values[:0] for column, values in columns.items()})
        n = len(next(iter(columns.values())))
        yield name, {column: columns.get(column, nothing(kind, n)) for column, kind in first.items()}
    for name, reader in readers.items():
        if reader.damaged:
            bag.note(f"{reader.damaged} damaged message(s) of {name} left out")
    for name, items in connections.items():
        if any(item.msgtype != items[0].msgtype for item in items):
            bag.note(f"{name} has messages of several types: only those of {items[0].msgtype} are in its table")


class Bag(Mapping[str, TopicTable]):
    """A bag as tables: a mapping from topics, as they were recorded, to their tables.

    A topic may be named without its leading slash and the namespace of the cell. ``namespace`` : cell that is meant,
    where the bag holds several. Close it, or use it as a context.

    Attributes
    ----------
    path : bag or run folder ; namespace : cell that is meant, None: the only one
    """

    def __init__(self, path: Path | str, namespace: str | None = None) -> None:
        """Raises IsfError BAG_UNREADABLE."""
        self.path, self.namespace = Path(path), namespace
        self._bag = open_bag(self.path)
        topics: dict[str, list[Connection]] = {}
        for connection in sorted(self._bag.connections, key=lambda item: item.topic):
            topics.setdefault(connection.topic, []).append(connection)
        self.connections: Mapping[str, list[Connection]] = topics
        """Connections of every topic."""
        self._tables = {name: TopicTable(self._bag, name, found) for name, found in topics.items()}

    def __enter__(self) -> Bag:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None) -> None:
        self.close()

    def close(self) -> None:
        """Close the file."""
        self._bag.close()

    def __getitem__(self, topic: str) -> TopicTable:
        """Table of ``topic``; raises KeyError with the names that exist."""
        wanted = topic if topic.startswith("/") else f"/{topic}"
        if wanted in self._tables:
            return self._tables[wanted]
        own = f"/{(self.namespace or '').strip('/')}{wanted}"
        if own in self._tables:
            return self._tables[own]
        ending = [name for name in self._tables if name.endswith(wanted)]
        if len(ending) == 1:
            return self._tables[ending[0]]
        raise KeyError(
            f"no topic {topic!r}" + (": say which of " if ending else "; there is ") + ", ".join(ending or self)
        )

    def __iter__(self) -> Iterator[str]:
        return iter(self._tables)

    def __len__(self) -> int:
        return len(self._tables)

    @property
    def notes(self) -> tuple[str, ...]:
        """What is to be said of the file as far as it was read, for people."""
        return tuple(self._bag.notes)

    @property
    def raw(self) -> OpenBag:
        """The file itself, for messages as they were recorded."""
        return self._bag

    @cached_property
    def part(self) -> PartRecord:
        """What was formed (the last part of the bag).

        Raises
        ------
        IsfError : BAG_INCOMPLETE, not a bag of a cell, or nothing was formed; FILE_FIELD, it holds several cells, or
            none of that name
        """
        return part_of(self._bag, self.namespace)

    @cached_property
    def contours(self) -> Table:
        """A row per contour: :func:`isf_analysis.measures.part_tables.contour_table`; raises as :attr:`part`."""
        return self._of_part("contours", part_tables.contour_table)

    @cached_property
    def points(self) -> Table:
        """A row per contour point: :func:`isf_analysis.measures.part_tables.point_table`; raises as :attr:`part`."""
        return self._of_part("points", part_tables.point_table)

    @cached_property
    def ticks(self) -> Table:
        """A row per control tick: :func:`isf_analysis.measures.part_tables.tick_table`; raises as :attr:`part`."""
        return self._of_part("ticks", part_tables.tick_table)

    def _of_part(self, name: str, table: Callable[[PartRecord], Columns]) -> Table:
        part = self.part
        return Table(name, lambda: iter([columns] if (columns := table(part)) else []))


def not_installed(package: str, otherwise: str) -> IsfError:
    """FILE_NOT_FOUND of an optional package."""
    return IsfError(
        ErrorCode.FILE_NOT_FOUND,
        f"{package} is not installed",
        where=package,
        advice=f"pip install {package}; {otherwise}",
    )
