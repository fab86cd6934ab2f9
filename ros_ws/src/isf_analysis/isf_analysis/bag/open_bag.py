"""A bag open for reading, of the recorder, of ``ros2 bag record`` (MCAP or SQLite) or of another tool.

A bag whose recorder was killed is read as far as it was written. Messages come in blocks as they lie in the file, one
block per topic and chunk, so that what is read stays small and what has a fixed layout is never taken apart in Python.
What is damaged inside is left out and told in :attr:`OpenBag.notes`.
"""

from __future__ import annotations

import struct
import tempfile
from collections.abc import Collection, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from io import BufferedReader
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from isf_core.errors import ErrorCode, IsfError
from isf_core.types import Indices
from numpy.typing import NDArray
from rosbags.interfaces import Connection, MessageDefinitionFormat
from rosbags.rosbag2 import Reader
from rosbags.rosbag2.storage_mcap import McapReader, decompress
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from isf_analysis.bag import repair
from isf_analysis.bag.topics import cell_types

ENDED_BY_FORCE = (
    "the bag is not closed: its recorder was ended by force, or still records; it is read as far as it goes"
)

RECORD_WITH = "record the run with the cell's recorder: ./isf record, ./isf form"

ROWS = 4096
"""Messages of a block where the file has no chunks."""

_PREFIX = struct.Struct("<BQ")  # opcode and length of a record
_CHUNK = struct.Struct("<QQQII")  # first and last time, size, checksum, length of the name of the compression
_MESSAGE = struct.Struct("<HIQQ")  # channel, sequence number, times of receipt and of publication
_LENGTH = struct.Struct("<Q")
_RECORD = np.dtype(
    [
        ("opcode", "u1"),
        ("length", "<u8"),
        ("channel", "<u2"),
        ("sequence", "<u4"),
        ("time", "<u8"),
        ("published", "<u8"),
    ]
)  # the head of a message
_MESSAGE_RECORD, _CHUNK_RECORD = 0x05, 0x06


@dataclass(frozen=True)
class Block:
    """Messages of one topic that lie together.

    Attributes
    ----------
    connection : the topic
    times : (n,) ns since 1970, when they were received
    data : (bytes,) uint8, memory that holds them
    begin, end : (n,) where in ``data`` each begins and ends
    since : ns since 1970, earliest message of all that were read with these, of other topics too
    """

    connection: Connection
    times: Indices
    data: NDArray[np.uint8]
    begin: Indices
    end: Indices
    since: int = 0

    def __len__(self) -> int:
        return len(self.times)

    def message(self, number: int) -> NDArray[np.uint8]:
        """(bytes,) uint8, one serialised message."""
        return self.data[self.begin[number] : self.end[number]]


@dataclass
class OpenBag:
    """Use as a context, or :meth:`close` it.

    Attributes
    ----------
    path : as it was asked for
    readers : of the bag, and of those in which a resumed part goes on
    types : of the messages, by the definitions in the bag
    notes : what had to be done, and what is damaged, for people
    """

    path: Path
    readers: tuple[Reader, ...]
    types: Typestore
    notes: list[str] = field(default_factory=list)
    _stack: ExitStack = field(default_factory=ExitStack)

    def __enter__(self) -> OpenBag:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None) -> None:
        self.close()

    def close(self) -> None:
        """Close the file."""
        self._stack.close()

    @property
    def connections(self) -> list[Connection]:
        """Topics with their types and the messages of all readers; numbered anew, since each reader counts from 0."""
        found: dict[tuple[str, str], Connection] = {}
        for item in (connection for reader in self.readers for connection in reader.connections):
            first = found.get((item.topic, item.msgtype))
            found[item.topic, item.msgtype] = item if first is None else _with_messages_of(first, item)
        return [item._replace(id=number) for number, item in enumerate(found.values())]

    @property
    def message_count(self) -> int:
        """Messages by the index of the bag."""
        return sum(reader.message_count for reader in self.readers)

    @property
    def start_time(self) -> int:
        """ns since 1970, when the first message was received."""
        return min(reader.start_time for reader in self.readers)

    @property
    def duration(self) -> int:
        """ns from the first message to after the last one."""
        return max(reader.end_time for reader in self.readers) - self.start_time if self.message_count else 0

    def blocks(self, connections: Collection[Connection]) -> Iterator[Block]:
        """Messages of ``connections`` in the order of the file."""
        for reader in self.readers:
            directory: Any = reader.storage
            storages = getattr(directory, "storages", [directory])
            if directory.metadata.compression_mode != "message" and all(
                isinstance(item, McapReader) for item in storages
            ):
                for storage in storages:
                    yield from self._chunks(storage, connections)
            else:
                yield from self._rows(reader, connections)

    def messages(self, connections: Collection[Connection]) -> Iterator[tuple[int, Any]]:
        """(time of receipt in ns, message) in the order of receipt; for topics of few messages.

        Raises whatever a damaged message causes.
        """
        found = [
            (time, block.connection.msgtype, block.message(k).tobytes())  # a copy: the rest of the block is let go
            for block in self.blocks(connections)
            for k, time in enumerate(block.times.tolist())
        ]
        for time, kind, data in sorted(found, key=lambda item: item[0]):
            yield time, self.types.deserialize_cdr(data, kind)

    def note(self, text: str) -> None:
        """Keep a note, once."""
        if text not in self.notes:
            self.notes.append(text)

    # -- inside ----------------------------------------------------------------------------------

    def _rows(self, reader: Reader, connections: Collection[Connection]) -> Iterator[Block]:
        """Of files without chunks: message by message, put together again."""
        wanted = _of_storage(reader, connections)
        own = [item for item in reader.connections if item.id in wanted]
        waiting: dict[int, list[tuple[int, bytes]]] = {number: [] for number in wanted}
        held = 0
        with _left_out(self):
            # the reader of the folder undoes the compression of single messages, that of one file has none
            for connection, time, data in reader.messages(own):
                waiting[connection.id].append((time, bytes(data)))
                held += 1
                if held == ROWS:
                    yield from _together(waiting, wanted)
                    waiting, held = {number: [] for number in wanted}, 0
        yield from _together(waiting, wanted)

    def _chunks(self, storage: McapReader, connections: Collection[Connection]) -> Iterator[Block]:
        wanted = _of_storage(storage, connections)
        if not wanted:
            return
        loose: dict[int, _Found] = {}
        with Path(str(storage.path)).open("rb") as file:
            places = [chunk.chunk_start_offset for chunk in storage.chunks if _may_hold(chunk.channel_count, wanted)]
            for place in places if storage.chunks else _walk(file, storage.data_start, storage.data_end, loose, wanted):
                with _left_out(self):
                    yield from _of_chunk(_chunk(file, place), wanted)
            for number, found in loose.items():
                yield found.block(wanted[number], np.frombuffer(b"".join(found.loose), dtype=np.uint8))


@dataclass
class _Found:
    """Messages of one channel."""

    times: list[int] = field(default_factory=list)
    begin: list[int] = field(default_factory=list)
    end: list[int] = field(default_factory=list)
    loose: list[bytes] = field(default_factory=list)

    def block(self, connection: Connection, data: NDArray[np.uint8]) -> Block:
        times, begin, end = (np.array(item, dtype=np.int64) for item in (self.times, self.begin, self.end))
        return Block(connection, times, data, begin, end)


@contextmanager
def _left_out(bag: OpenBag) -> Iterator[None]:
    """What is damaged is left out and told: it shows in as many ways as there are bytes."""
    try:
        yield
    except Exception as error:
        bag.note(f"a part of the bag is damaged and left out: {error}")


def _of_storage(storage: Any, connections: Collection[Connection]) -> dict[int, Connection]:
    """Number of a channel in this file to the connection that was asked for."""
    by_name = {(connection.topic, connection.msgtype): connection for connection in connections}
    names = {own.id: (own.topic, own.msgtype) for own in storage.connections}
    return {number: by_name[name] for number, name in names.items() if name in by_name}


def _may_hold(counts: dict[int, int], wanted: Collection[int]) -> bool:
    """False for a chunk whose index names none of the channels ``wanted``; one without an index may hold all."""
    return not counts or any(counts.get(number, 0) for number in wanted)


def _walk(
    file: BufferedReader, begin: int, end: int, loose: dict[int, _Found], wanted: dict[int, Connection]
) -> Iterator[int]:
    """Places of the chunks of a file without an index; messages outside of chunks go to ``loose``."""
    position = begin
    while position + _PREFIX.size <= end:
        file.seek(position)
        opcode, length = _PREFIX.unpack(file.read(_PREFIX.size))
        if position + _PREFIX.size + length > end:
            return
        if opcode == _CHUNK_RECORD:
            yield position
        elif opcode == _MESSAGE_RECORD and length >= _MESSAGE.size:
            record = file.read(length)
            number, _, time, _ = _MESSAGE.unpack_from(record)
            if number in wanted:
                found = loose.setdefault(number, _Found())
                at = found.end[-1] if found.end else 0
                found.times.append(time)
                found.begin.append(at)
                found.end.append(at + length - _MESSAGE.size)
                found.loose.append(record[_MESSAGE.size :])
        position += _PREFIX.size + length


def _chunk(file: BufferedReader, place: int) -> bytes:
    """Content of the chunk at ``place``; raises what is wrong with it."""
    file.seek(place)
    opcode, length = _PREFIX.unpack(file.read(_PREFIX.size))
    if opcode != _CHUNK_RECORD or length < _CHUNK.size + 8:
        raise ValueError("the index points beside a chunk")
    record = file.read(length)
    if len(record) < length:
        raise ValueError("a chunk is cut off")
    _, _, size, checksum, name_length = _CHUNK.unpack_from(record)
    content = _CHUNK.size + name_length + 8
    name = record[_CHUNK.size : _CHUNK.size + name_length].decode()
    (compressed,) = struct.unpack_from("<Q", record, _CHUNK.size + name_length)
    if content + compressed > length:
        raise ValueError("a chunk is cut off")
    return bytes(decompress(record[content : content + compressed], name, size, checksum))


def _of_chunk(content: bytes, wanted: dict[int, Connection]) -> Iterator[Block]:
    size, length_at, position, records = len(content), _LENGTH.unpack_from, 0, []
    while position + _PREFIX.size <= size:
        records.append(position)
        position += _PREFIX.size + length_at(content, position + 1)[0]
    damaged = position > size
    places = np.array(records[:-1] if damaged else records, dtype=np.int64)
    places = places[places <= size - _RECORD.itemsize]
    data = np.frombuffer(content, dtype=np.uint8)
    heads = gathered(data, places, _RECORD)
    whole = (heads["opcode"] == _MESSAGE_RECORD) & (heads["length"] >= _MESSAGE.size) & (heads["time"] < 1 << 63)
    since = int(heads["time"][whole].min(initial=(1 << 63) - 1))
    for number, connection in wanted.items():
        chosen = np.flatnonzero(whole & (heads["channel"] == number))
        if len(chosen):
            begin = places[chosen] + _RECORD.itemsize
            end = places[chosen] + _PREFIX.size + heads["length"][chosen].astype(np.int64)
            yield Block(connection, heads["time"][chosen].astype(np.int64), data, begin, end, since)
    if damaged:
        raise ValueError("a record reaches beyond its chunk")


def gathered(data: NDArray[np.uint8], places: Indices, kind: np.dtype[Any]) -> NDArray[Any]:
    """(n,) of ``kind``, what lies in the memory ``data`` at ``places`` (n,), which are all inside."""
    if not len(places):
        return np.empty(0, dtype=kind)
    everywhere = np.ndarray((len(data) - kind.itemsize + 1,), dtype=kind, buffer=data.data, strides=(1,))
    return everywhere[places]


def _together(waiting: dict[int, list[tuple[int, bytes]]], wanted: dict[int, Connection]) -> Iterator[Block]:
    since = min((time for rows in waiting.values() for time, _ in rows), default=0)
    for number, rows in waiting.items():
        if rows:
            yield _block(wanted[number], rows, since)


def _block(connection: Connection, rows: list[tuple[int, bytes]], since: int) -> Block:
    ends = np.cumsum([len(data) for _, data in rows])
    data = np.frombuffer(b"".join(data for _, data in rows), dtype=np.uint8)
    times = np.array([time for time, _ in rows], dtype=np.int64)
    return Block(connection, times, data, np.concatenate([[0], ends[:-1]]), ends, since)


# -- opening -----------------------------------------------------------------------------------------


def open_bag(path: Path | str) -> OpenBag:
    """The bag folder, MCAP file or SQLite file at ``path``, or the bag of the run folder ``path``.

    Raises
    ------
    IsfError : BAG_UNREADABLE (no such bag, damaged beyond reading)
    """
    path, stack = bag_of(Path(path)), ExitStack()
    try:
        readers, notes = _open(path, stack)
        for continued in continued_in(path):
            try:
                more, told = _open(continued, stack)
            except IsfError as error:  # ended before anything was recorded
                notes.append(f"left out: {error.message}")
                continue
            readers += more
            notes += [text for text in told if text not in notes]
        types = _types_of([connection for reader in readers for connection in reader.connections])
        return OpenBag(path, tuple(readers), types, notes, stack)
    except IsfError:
        stack.close()
        raise
    except Exception as error:  # a damaged file shows in as many ways as there are bytes
        stack.close()
        raise unreadable(path, f"is damaged: {error}") from error


def bag_of(run: Path) -> Path:
    """Bag of a run: ``run/bag`` when there is one, else ``run`` itself."""
    return run / "bag" if (run / "bag").exists() else run


_CONTINUED = "bag_resumed_"
"""Begin of the names of the bags beside ``bag`` in which the same part goes on; a number follows."""


def continued_in(bag: Path) -> list[Path]:
    """Bags of a run in which the part of its ``bag`` goes on, in their order."""
    if bag.name != "bag":
        return []
    found = [path for path in bag.parent.glob(f"{_CONTINUED}*") if path.name.removeprefix(_CONTINUED).isdecimal()]
    return sorted(found, key=lambda path: int(path.name.removeprefix(_CONTINUED)))


def next_bag(bag: Path) -> Path:
    """Where the part of a run's ``bag`` is recorded when it goes on."""
    known = continued_in(bag)
    number = int(known[-1].name.removeprefix(_CONTINUED)) + 1 if known else 1
    return bag.with_name(f"{_CONTINUED}{number}")


def _with_messages_of(first: Connection, other: Connection) -> Connection:
    return first._replace(msgcount=first.msgcount + other.msgcount)


def unreadable(path: Path, what: str, advice: str = "") -> IsfError:
    """BAG_UNREADABLE of the bag at ``path``."""
    return IsfError(ErrorCode.BAG_UNREADABLE, what, where=str(path), advice=advice or RECORD_WITH)


def _types_of(connections: list[Connection]) -> Typestore:
    """Types by the definitions inside the bag; those it lacks are taken from the installed messages."""
    store = get_typestore(Stores.ROS2_JAZZY)
    for connection in connections:
        text = connection.msgdef.data
        if connection.msgdef.format == MessageDefinitionFormat.NONE or not text:
            continue
        parse = get_types_from_idl if connection.msgdef.format == MessageDefinitionFormat.IDL else None
        types = parse(text) if parse else get_types_from_msg(text, connection.msgtype)
        store.register({name: definition for name, definition in types.items() if name not in store.fielddefs})
    if any(connection.msgtype not in store.fielddefs for connection in connections):
        known = cell_types().fielddefs
        store.register({name: known[name] for name in known if name not in store.fielddefs})
    return store


def _open(path: Path, stack: ExitStack) -> tuple[list[Reader], list[str]]:
    """Open readers, one where the bag is whole, else one per file; and notes on what had to be done for it."""
    if not path.exists():
        raise unreadable(path, "no such bag", advice="check the path; it is relative to here")
    try:
        if (path.is_file() and not repair.in_transaction(path)) or (path / "metadata.yaml").is_file():
            return [_reader(path, stack)], []
    except Exception as error:  # as above: whatever a damaged file causes
        if path.is_file() and path.suffix != ".mcap":
            raise unreadable(path, f"cannot be read: {error}") from error
    files = [path] if path.is_file() else files_of(path)
    if not files:
        raise unreadable(path, "holds no bag: neither metadata.yaml nor an .mcap or .db3 file")
    readers: list[Reader] = []
    notes: list[str] = []
    for file in files:
        try:
            readers.append(_reader_of_part(path, file, stack, notes))
        except IsfError as error:
            if file == files[-1] and readers:  # begun, and ended before anything was written
                notes.append(f"left out: {error.message}")
                continue
            raise
    return readers, notes


def files_of(bag: Path) -> list[Path]:
    """Files of the folder ``bag`` in the order in which they were written."""

    def number(file: Path) -> tuple[int, str]:
        digits = file.stem.rpartition("_")[2]
        return (int(digits) if digits.isdecimal() else 0, file.name)

    return sorted([*bag.glob("*.mcap"), *bag.glob("*.db3")], key=number)


def _reader(path: Path, stack: ExitStack) -> Reader:
    reader = Reader(path)
    reader.open()
    stack.callback(reader.close)
    return reader


def _reader_of_part(bag: Path, file: Path, stack: ExitStack, notes: list[str]) -> Reader:
    """Of one file of a bag that was not closed: only its last file is not whole."""
    cut = repair.in_transaction(file)
    try:
        if not cut:
            return _reader(file, stack)
    except Exception as error:
        if file.suffix != ".mcap":
            raise unreadable(bag, f"{file.name} cannot be read: {error}") from error
    notes.append(ENDED_BY_FORCE)
    folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="isf_bag_")))
    whole = folder / file.name
    try:
        if cut:
            repair.rolled_back(file, whole)
        elif not repair.whole_records(file, whole):
            raise unreadable(bag, f"{file.name} is not an MCAP file or is empty")
        return _reader(whole, stack)
    except IsfError:
        raise
    except Exception as error:
        raise unreadable(bag, f"cannot be read: {error}") from error
