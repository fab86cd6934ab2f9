"""A bag open for writing: files of MCAP or SQLite in a rosbag2 folder.

Written through rosbags with the message definitions inside, so that it works without ROS and its files open in
``ros2 bag`` and Foxglove alike; MCAP with a checksum for every chunk. A bag is one file, or several where it is split:
each is whole in itself, and ``metadata.yaml`` names them in their order, as those of ``ros2 bag record`` do.
"""

from __future__ import annotations

import os
import sqlite3
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any
from zlib import crc32

import yaml
from isf_core.errors import ErrorCode, IsfError
from rosbags.interfaces import (
    Connection,
    ConnectionExtRosbag2,
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.rosbag2 import CompressionMode, StoragePlugin, Writer, WriterError
from rosbags.rosbag2.enums import CompressionFormat
from rosbags.rosbag2.metadata import dump_qos_v9
from rosbags.rosbag2.storage_mcap import McapWriter
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Writer
from rosbags.typesys.store import Typestore

from isf_analysis.bag.topics import Delivery, Topic, cell_types, definition

COMPRESSIONS = ("none", "zstd")
STORAGES = ("mcap", "sqlite3")
NANO = 1_000_000_000


@dataclass(frozen=True)
class Storage:
    """How a bag lies on the disk.

    Attributes
    ----------
    storage : one of STORAGES; a killed writer leaves MCAP as far as it was flushed, SQLite as well
    compression : one of COMPRESSIONS; MCAP alone
    split_size : bytes of messages after which the next file begins; 0: never
    split_time : s of messages after which the next file begins; 0: never

    Raises IsfError BAG_NOT_WRITABLE for what cannot be.
    """

    storage: str = "mcap"
    compression: str = "none"
    split_size: int = 0
    split_time: float = 0.0

    def __post_init__(self) -> None:
        for what, value, known in (
            ("storage", self.storage, STORAGES),
            ("compression", self.compression, COMPRESSIONS),
        ):
            if value not in known:
                raise _not_so(f"no {what} '{value}'", f"known: {', '.join(known)}")
        if self.storage == "sqlite3" and self.compression != "none":
            raise _not_so("SQLite has no compression here", "take storage mcap, or compression none")
        if self.split_size < 0 or not 0.0 <= self.split_time < float("inf"):
            raise _not_so("a bag is split after a positive size and time", "0: one file")


def _not_so(what: str, advice: str) -> IsfError:
    return IsfError(ErrorCode.BAG_NOT_WRITABLE, what, where="storage of the bag", advice=advice)


_UNLIMITED = QosTime(9223372036, 854775807)

_CHECKSUM = 33
"""Bytes from the begin of a chunk to its checksum: opcode, length, first and last time, size."""

_LENGTH = 4
"""Bytes before each record of a chunk, that say how long it is."""

_REFUSALS = (OSError, WriterError, sqlite3.Error)
"""What a disk that refuses shows as."""

_DEPTHS: dict[Delivery, int] = {"STREAM": 10, "SENSOR": 5, "LATCHED": 1, "EVENT": 50, "CHANGES": 20, "DEFAULT": 10}


def check_free(path: Path) -> None:
    """Raise IsfError BAG_NOT_WRITABLE when ``path`` exists: a bag is never overwritten."""
    if path.exists():
        raise IsfError(
            ErrorCode.BAG_NOT_WRITABLE,
            "exists already; a recording never overwrites",
            where=str(path),
            advice="choose another output folder, or move this one away",
        )


class _ChunkIndex:
    """What the end of a file says of each of its chunks, which the library takes for a list.

    Until then it lies on the disk, in a file without a name in ``folder``: a recording may go on for weeks. What the
    disk does not take stays in memory; that the disk is full is for the bag itself to tell.
    """

    def __init__(self, folder: Path) -> None:
        self._file = TemporaryFile(dir=folder, buffering=0)  # noqa: SIM115, until close
        self._count = self._end = 0
        self._waiting = bytearray()

    def append(self, record: BytesIO) -> None:
        self._waiting += record.tell().to_bytes(_LENGTH, "little") + record.getvalue()
        self._count += 1
        with suppress(OSError):
            taken = os.pwrite(self._file.fileno(), self._waiting, self._end)
            self._end += taken
            del self._waiting[:taken]

    def __len__(self) -> int:
        return self._count

    def __iter__(self) -> Iterator[BytesIO]:
        """The records as the library made them, which measures them by where their next byte would go."""
        place = 0
        for _ in range(self._count):
            size = int.from_bytes(self._bytes(place, _LENGTH), "little")
            record = BytesIO()
            record.write(self._bytes(place + _LENGTH, size))
            place += _LENGTH + size
            yield record

    def _bytes(self, place: int, size: int) -> bytes:
        kept = os.pread(self._file.fileno(), size, place)
        begin = place + len(kept) - self._end
        return kept + self._waiting[begin : begin + size - len(kept)] if len(kept) < size else kept

    def close(self) -> None:
        self._file.close()


class _CheckedMcap(McapWriter):
    """Chunks with the checksum of their content, which the library leaves at zero: "not known"."""

    def __init__(self, path: Path, compression: CompressionMode) -> None:
        super().__init__(path, compression)
        self.chunks: _ChunkIndex = _ChunkIndex(self.path.parent)  # type: ignore[assignment]

    def close(self, version: int, metadata: str) -> None:
        """As of the library."""
        try:
            super().close(version, metadata)
        finally:
            self.chunks.close()

    def abort(self) -> None:
        """As of the library."""
        super().abort()
        self.chunks.close()

    def close_chunk(self) -> None:
        """As of the library; what was changed on the disk is noticed by every reader from then on."""
        checksum, start = crc32(self.chunk.bio.getbuffer()), self.bio.tell()
        super().close_chunk()
        end = self.bio.tell()
        self.bio.seek(start + _CHECKSUM)
        self.bio.write(checksum.to_bytes(4, "little"))
        self.bio.seek(end)

    def flush(self) -> None:
        """Hand everything written so far to the operating system; up to 1 MB waits in memory for its chunk."""
        if self.chunk.msgs:
            self.close_chunk()
        self.bio.flush()


class _Database(Sqlite3Writer):
    """SQLite, which the library keeps in one transaction from the first message to the last, and to one thread."""

    def __init__(self, path: Path, compression: CompressionMode) -> None:
        super().__init__(path, compression)
        self.conn.close()
        self.conn: sqlite3.Connection = sqlite3.connect(
            self.path, check_same_thread=False
        )  # made by one thread, filled by another
        self.cursor = self.conn.cursor()
        # to the file with a commit alone: readers of rosbag2 and rosbags do not look into the journal of a transaction
        self.cursor.execute("PRAGMA cache_spill = OFF")

    def flush(self) -> None:
        """Hand everything written so far to the operating system."""
        self.conn.commit()


@dataclass
class _File:
    """One file of a bag and what is in it."""

    name: str
    counts: Counter[int] = field(default_factory=Counter)
    size: int = 0
    begin: int = 2**63 - 1
    end: int = 0

    def metadata(self, writer: Writer) -> dict[str, Any]:
        """Entry of ``files`` in metadata.yaml."""
        begin, end = (self.begin, self.end) if self.counts else (writer.min_timestamp, writer.min_timestamp)
        return {
            "path": self.name,
            "starting_time": {"nanoseconds_since_epoch": begin},
            "duration": {"nanoseconds": end - begin},
            "message_count": self.counts.total(),
        }


class _Place:
    """Where the library makes its file: named after the folder, unless there are several in it."""

    def __init__(self, folder: Path, name: str) -> None:
        self.name = name
        self._folder = folder

    def __truediv__(self, name: str) -> Path:
        return self._folder / name


class _Files:
    """The storage of a bag: a file, and where it is split the next one when that is full. Each is whole in itself."""

    def __init__(self, writer: _SplitWriter, folder: Path, compression: CompressionMode) -> None:
        self._writer, self._folder, self._compression = writer, folder, compression
        self._topics: list[tuple[Connection, str]] = []
        self.files: list[_File] = []
        self._begin()

    def _begin(self) -> None:
        options = self._writer.options
        split = options.split_size or options.split_time
        name = f"{self._folder.name}_{len(self.files)}" if split else self._folder.name
        place: Any = _Place(self._folder, name)
        kind: Any = _STORAGES[options.storage]
        self._file: _CheckedMcap | _Database = kind(place, self._compression)
        self.path = self._file.path
        self.files.append(_File(self.path.name))
        types: set[str] = set()
        for connection, profiles in self._topics:
            if connection.msgtype not in types:
                types.add(connection.msgtype)
                self._file.add_msgtype(connection)
            self._file.add_connection(connection, profiles)

    def add_msgtype(self, connection: Connection) -> None:
        self._file.add_msgtype(connection)

    def add_connection(self, connection: Connection, offered_qos_profiles: str) -> None:
        self._topics.append((connection, offered_qos_profiles))
        self._file.add_connection(connection, offered_qos_profiles)

    def write(self, connection: Connection, timestamp: int, data: bytes | memoryview) -> None:
        if self._full(timestamp):
            full, text = self._file, self._writer.metadata(self.files[-1:])
            self._begin()  # where that fails the present one stays open, and whole when it is closed
            full.close(self._writer.version, text)
        self._file.write(connection, timestamp, data)
        file = self.files[-1]
        file.counts[connection.id] += 1
        file.size += len(data)
        file.begin, file.end = min(file.begin, timestamp), max(file.end, timestamp)

    def _full(self, timestamp: int) -> bool:
        file, options = self.files[-1], self._writer.options
        if not file.size:
            return False
        return bool(
            (options.split_size and file.size >= options.split_size)
            or (options.split_time and timestamp - file.begin >= options.split_time * NANO)
        )

    def flush(self) -> None:
        self._file.flush()

    def close(self, version: int, metadata: str) -> None:
        """The text of the library speaks of one file."""
        self._file.close(self._writer.version, self._writer.metadata(self.files[-1:]))

    def abort(self) -> None:
        self._file.abort()


_STORAGES = {"mcap": _CheckedMcap, "sqlite3": _Database}


class _SplitWriter(Writer):
    """Writes a folder of several files, whose metadata the library knows for one alone."""

    def __init__(self, path: Path, options: Storage) -> None:
        self.options = options
        plugin = StoragePlugin[options.storage.upper()]
        super().__init__(path, version=9, storage_plugin=plugin)
        self.STORAGE_PLUGINS = {plugin: partial(_Files, self)}  # type: ignore[dict-item]

    def metadata(self, files: Sequence[_File]) -> str:
        """Text of what metadata.yaml says of ``files``."""
        return _yaml(self.information(files))

    def information(self, files: Sequence[_File]) -> dict[str, Any]:
        """What metadata.yaml says of ``files``."""
        counts: Counter[int] = sum((file.counts for file in files), Counter())
        begin = min((file.begin for file in files if file.counts), default=self.min_timestamp)
        end = max((file.end for file in files), default=0)
        return {
            "version": self.version,
            "storage_identifier": self.storage_plugin.name.lower(),
            "relative_file_paths": [file.name for file in files],
            "duration": {"nanoseconds": max(0, end - begin)},
            "starting_time": {"nanoseconds_since_epoch": begin},
            "message_count": counts.total(),
            "topics_with_message_count": [
                {
                    "topic_metadata": {
                        "name": item.topic,
                        "type": item.msgtype,
                        "serialization_format": item.ext.serialization_format,
                        "offered_qos_profiles": dump_qos_v9(item.ext.offered_qos_profiles),
                        "type_description_hash": item.digest,
                    },
                    "message_count": counts[item.id],
                }
                for item in self.connections
                if isinstance(item.ext, ConnectionExtRosbag2)
            ],
            "compression_format": "",
            "compression_mode": "",
            "files": [file.metadata(self) for file in files],
            "custom_data": None,
            "ros_distro": "rosbags",
        }

    def close(self) -> None:
        """End the last file, then name all in metadata.yaml: from then on the folder is a whole bag."""
        storage: Any = self.storage
        self.storage: Any = None
        storage.close(self.version, "")
        text = _yaml({"rosbag2_bagfile_information": self.information(storage.files)})
        written = self.metapath.with_suffix(".yaml.tmp")
        written.write_text(text, encoding="utf-8")
        written.replace(self.metapath)


def _yaml(content: dict[str, Any]) -> str:
    return str(yaml.safe_dump(content, sort_keys=False))


class BagFile:
    """A bag being written; not thread safe.

    Raises
    ------
    IsfError : BAG_NOT_WRITABLE from every method when the disk refuses or the folder exists
    """

    def __init__(self, path: Path, storage: Storage | None = None) -> None:
        self.path = path
        options = storage or Storage()
        check_free(path)
        try:
            self._writer = _SplitWriter(path, options)
            if options.compression == "zstd":
                self._writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
            self._writer.open()
        except _REFUSALS as error:
            raise self._refused(error) from error

    def add(self, topic: Topic, name: str | None = None) -> Connection:
        """Add a topic, under its absolute ``name`` when it differs from the topic's own; before the first write."""
        absolute = name or (topic.name if topic.name.startswith("/") else f"/{topic.name}")
        return self._writer.add_connection(
            absolute,
            topic.type,
            msgdef=definition(topic.type),
            rihs01=cell_types().hash_rihs01(topic.type),
            offered_qos_profiles=[_qos(topic.delivery)],
        )

    def add_like(self, connection: Connection, types: Typestore) -> Connection:
        """Add a topic as it is in another bag, whose message ``types`` are given; before the first write."""
        profiles = connection.ext.offered_qos_profiles if isinstance(connection.ext, ConnectionExtRosbag2) else ()
        return self._writer.add_connection(
            connection.topic,
            connection.msgtype,
            typestore=types,
            msgdef=connection.msgdef.data or None,
            rihs01=types.hash_rihs01(connection.msgtype),
            offered_qos_profiles=profiles,
        )

    def write(self, connection: Connection, timestamp: int, data: bytes | memoryview) -> None:
        """Append one serialised message received at ``timestamp`` (ns since 1970)."""
        try:
            self._writer.write(connection, timestamp, data)
        except _REFUSALS as error:
            raise self._refused(error) from error

    def flush(self) -> None:
        """Hand everything written so far to the operating system, so that a killed process loses nothing of it."""
        storage = self._writer.storage
        if not isinstance(storage, _Files):
            return
        try:
            storage.flush()
        except _REFUSALS as error:
            raise self._refused(error) from error

    def close(self) -> None:
        """Write index and metadata; an empty bag becomes one with zero messages."""
        if not self._writer.storage:
            return
        if self._writer.max_timestamp == 0:  # nothing was written: rosbags would store an absurd start time
            self._writer.min_timestamp = self._writer.max_timestamp = time.time_ns()
        try:
            self._writer.close()
        except _REFUSALS as error:
            raise self._refused(error) from error

    def _refused(self, error: Exception) -> IsfError:
        return IsfError(
            ErrorCode.BAG_NOT_WRITABLE,
            f"cannot be written: {error}",
            where=str(self.path),
            advice="check the free space and the rights of the folder",
        )


def _qos(delivery: Delivery) -> Qos:
    """The publisher's profile, so that a replayed topic behaves as the recorded one."""
    latched, sensor = delivery in ("LATCHED", "CHANGES"), delivery == "SENSOR"
    return Qos(
        history=QosHistory.KEEP_LAST,
        depth=_DEPTHS[delivery],
        reliability=QosReliability.BEST_EFFORT if sensor else QosReliability.RELIABLE,
        durability=QosDurability.TRANSIENT_LOCAL if latched else QosDurability.VOLATILE,
        deadline=_UNLIMITED,
        lifespan=_UNLIMITED,
        liveliness=QosLiveliness.AUTOMATIC,
        liveliness_lease_duration=_UNLIMITED,
        avoid_ros_namespace_conventions=False,
    )
