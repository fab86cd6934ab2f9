"""A bag file open for writing, and the repair of one whose writer was killed: MCAP in a rosbag2 folder.

Written through rosbags with the message definitions inside, so that it works without ROS and its files open in
``ros2 bag`` and Foxglove alike, and with a checksum for every chunk.

An MCAP file is a magic number, records (one byte of opcode, eight of length, content), an index, a footer and the
magic number again. A killed writer leaves the first two, the last record possibly cut. The readable copy ends after the
last whole record and gets a footer that says "no index"; readers then scan the records. Source: MCAP format
specification 0, sections "Records", "Footer".
"""

from __future__ import annotations

import os
import shutil
import time
from pathlib import Path
from typing import BinaryIO
from zlib import crc32

from isf_core.errors import ErrorCode, IsfError
from rosbags.interfaces import Connection, Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag2 import CompressionMode, StoragePlugin, Writer, WriterError
from rosbags.rosbag2.enums import CompressionFormat
from rosbags.rosbag2.storage_mcap import McapWriter

from isf_analysis.bag.topics import Delivery, Topic, cell_types

COMPRESSIONS = ("none", "zstd")

_UNLIMITED = QosTime(9223372036, 854775807)

_CHECKSUM = 33
"""Bytes from the begin of a chunk to its checksum: opcode, length, first and last time, size."""

_DEPTHS: dict[Delivery, int] = {"STREAM": 10, "SENSOR": 5, "LATCHED": 1, "EVENT": 50, "DEFAULT": 10}


def check_free(path: Path) -> None:
    """Raise IsfError BAG_NOT_WRITABLE when ``path`` exists: a bag is never overwritten."""
    if path.exists():
        raise IsfError(
            ErrorCode.BAG_NOT_WRITABLE,
            "exists already; a recording never overwrites",
            where=str(path),
            advice="choose another output folder, or move this one away",
        )


class _CheckedMcap(McapWriter):
    """Chunks with the checksum of their content, which the library leaves at zero: "not known"."""

    def close_chunk(self) -> None:
        """As of the library; what was changed on the disk is noticed by every reader from then on."""
        checksum, start = crc32(self.chunk.bio.getbuffer()), self.bio.tell()
        super().close_chunk()
        end = self.bio.tell()
        self.bio.seek(start + _CHECKSUM)
        self.bio.write(checksum.to_bytes(4, "little"))
        self.bio.seek(end)


class _CheckedWriter(Writer):
    """Writes MCAP with checksums."""

    STORAGE_PLUGINS = {**Writer.STORAGE_PLUGINS, StoragePlugin.MCAP: _CheckedMcap}  # noqa: RUF012, as in the library


class BagFile:
    """A bag being written; not thread safe.

    Raises
    ------
    IsfError : BAG_NOT_WRITABLE from every method when the disk refuses or the folder exists
    """

    def __init__(self, path: Path, *, compression: str = "none") -> None:
        self.path = path
        if compression not in COMPRESSIONS:
            raise IsfError(
                ErrorCode.BAG_NOT_WRITABLE,
                f"no compression '{compression}'",
                where=str(path),
                advice=f"known: {', '.join(COMPRESSIONS)}",
            )
        check_free(path)
        try:
            self._writer = _CheckedWriter(path, version=9, storage_plugin=StoragePlugin.MCAP)
            if compression == "zstd":
                self._writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
            self._writer.open()
        except (OSError, WriterError) as error:
            raise self._refused(error) from error

    def add(self, topic: Topic, name: str | None = None) -> Connection:
        """Add a topic, under its absolute ``name`` when it differs from the topic's own; before the first write."""
        absolute = name or (topic.name if topic.name.startswith("/") else f"/{topic.name}")
        return self._writer.add_connection(
            absolute, topic.type, typestore=cell_types(), offered_qos_profiles=[_qos(topic.delivery)]
        )

    def write(self, connection: Connection, timestamp: int, data: bytes | memoryview) -> None:
        """Append one serialised message received at ``timestamp`` (ns since 1970)."""
        try:
            self._writer.write(connection, timestamp, data)
        except OSError as error:
            raise self._refused(error) from error

    def flush(self) -> None:
        """Hand everything written so far to the operating system, so that a killed process loses nothing of it.

        MCAP keeps up to 1 MB in memory; the chunk is closed early. Does nothing when the library gives no access.
        """
        storage = self._writer.storage
        close_chunk = getattr(storage, "close_chunk", None)
        chunk = getattr(storage, "chunk", None)
        stream = getattr(storage, "bio", None)
        try:
            if close_chunk is not None and chunk is not None and chunk.msgs:
                close_chunk()
            if stream is not None:
                stream.flush()
        except OSError as error:
            raise self._refused(error) from error

    def close(self) -> None:
        """Write index and metadata; an empty bag becomes one with zero messages."""
        if not self._writer.storage:
            return
        if self._writer.max_timestamp == 0:  # nothing was written: rosbags would store an absurd start time
            self._writer.min_timestamp = self._writer.max_timestamp = time.time_ns()
        try:
            self._writer.close()
        except (OSError, WriterError) as error:
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
    latched, sensor = delivery == "LATCHED", delivery == "SENSOR"
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


MAGIC = b"\x89MCAP0\r\n"
_HEADER, _FOOTER, _DATA_END = 0x01, 0x02, 0x0F
_PREFIX = 9  # opcode and length


def repair(damaged: Path, repaired: Path) -> bool:
    """Copy the whole records of ``damaged`` to the new file ``repaired``; False when there is none to copy."""
    with damaged.open("rb") as source:
        end = _end_of_whole_records(source)
        if end is None:
            return False
        source.seek(0)
        with repaired.open("xb") as target:
            shutil.copyfileobj(source, target)
            target.truncate(end)
            target.seek(end)
            target.write(_record(_DATA_END, bytes(4)))  # no checksum
            target.write(_record(_FOOTER, bytes(20)))  # no summary, no checksum
            target.write(MAGIC)
    return True


def _end_of_whole_records(source: BinaryIO) -> int | None:
    """Position after the last whole data record; None when not even the header of the file is whole."""
    size = os.fstat(source.fileno()).st_size
    if source.read(len(MAGIC)) != MAGIC:
        return None
    end: int | None = None
    position = len(MAGIC)
    while position + _PREFIX <= size:
        source.seek(position)
        prefix = source.read(_PREFIX)
        opcode, length = prefix[0], int.from_bytes(prefix[1:], "little")
        following = position + _PREFIX + length
        if end is None and opcode != _HEADER:
            return None
        if opcode in (_DATA_END, _FOOTER) or following > size:
            break
        end = position = following
    return end


def _record(opcode: int, content: bytes) -> bytes:
    return bytes([opcode]) + len(content).to_bytes(8, "little") + content
