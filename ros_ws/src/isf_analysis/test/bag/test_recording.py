"""The writer thread of a recording: order, loss, failure of the disk."""

from __future__ import annotations

import errno
import os
import re
import tracemalloc
from pathlib import Path

import pytest
from isf_analysis.bag import repair, topics
from isf_analysis.bag.bag_file import BagFile, Storage
from isf_analysis.bag.copy import copy_bag
from isf_analysis.bag.recording import Recording
from isf_analysis.bag.topics import cell_types, make_message
from isf_core.errors import ErrorCode, IsfError
from rosbags.rosbag2 import Reader
from rosbags.typesys import get_types_from_msg

WRENCH = next(topic for topic in topics.CELL if topic.name == "tool_1/wrench")
DATA = bytes(cell_types().serialize_cdr(make_message(WRENCH.type), WRENCH.type))


def test_every_topic_of_the_cell_has_a_type_the_bags_know() -> None:
    for topic in topics.CELL:
        assert topic.type in cell_types().fielddefs, topic.name
        make_message(topic.type)


def test_messages_come_back_in_order_and_are_counted(tmp_path: Path) -> None:
    recording = Recording(tmp_path / "bag", [(WRENCH, "/left/tool_1/wrench")])
    for start in range(0, 1000, 10):
        recording.add([(0, start + k + 1, DATA) for k in range(10)])
    recording.close()
    assert recording.written == 1000
    assert 10 <= recording.longest_queue <= 1000
    with Reader(tmp_path / "bag") as reader:
        assert [stamp for _, stamp, _ in reader.messages()] == list(range(1, 1001))
        assert reader.connections[0].topic == "/left/tool_1/wrench"


def test_an_empty_recording_is_a_bag_without_messages(tmp_path: Path) -> None:
    Recording(tmp_path / "bag", [(WRENCH, "/tool_1/wrench")]).close()
    with Reader(tmp_path / "bag") as reader:
        assert reader.message_count == 0


def test_a_disk_that_refuses_is_reported_on_closing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise IsfError(ErrorCode.BAG_NOT_WRITABLE, "no space left on device")

    monkeypatch.setattr(BagFile, "write", refuse)
    recording = Recording(tmp_path / "bag", [(WRENCH, "/tool_1/wrench")])
    recording.add([(0, 1, DATA)])
    recording.add([(0, 2, DATA)])
    with pytest.raises(IsfError, match="no space left") as caught:
        recording.close()
    assert caught.value.code == ErrorCode.BAG_NOT_WRITABLE
    assert recording.written == 0


def test_a_flushed_bag_survives_without_being_closed(tmp_path: Path) -> None:
    bag = BagFile(tmp_path / "bag")
    connection = bag.add(WRENCH)
    bag.write(connection, 1, DATA)
    bag.flush()
    bag.write(connection, 2, DATA)  # still in memory
    assert repair.whole_records(tmp_path / "bag" / "bag.mcap", tmp_path / "repaired.mcap")
    with Reader(tmp_path / "repaired.mcap") as reader:
        assert [stamp for _, stamp, _ in reader.messages()] == [1]
    bag.close()
    with Reader(tmp_path / "bag") as reader:
        assert reader.message_count == 2


def filled(bag: BagFile, chunks: range) -> None:
    """A chunk of one wrench for each of the numbers, which is its time."""
    wrench = bag._writer.connections[0] if bag._writer.connections else bag.add(WRENCH)
    for number in chunks:
        bag.write(wrench, number, DATA)
        bag.flush()


def test_a_bag_takes_no_more_memory_the_longer_it_is(tmp_path: Path) -> None:
    bag = BagFile(tmp_path / "bag")
    filled(bag, range(1, 501))
    tracemalloc.start()
    filled(bag, range(501, 3001))
    grown, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    bag.close()
    assert grown < 50_000  # bytes, of 2500 chunks: an index in memory has 530,000
    with Reader(tmp_path / "bag") as reader:
        assert [stamp for _, stamp, _ in reader.messages()] == list(range(1, 3001))
    assert [item.name for item in sorted((tmp_path / "bag").iterdir())] == ["bag.mcap", "metadata.yaml"]


def test_an_index_that_the_disk_takes_in_part_is_whole_in_the_bag(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    room = 1000
    take = os.pwrite

    def full(file: int, data: bytearray, place: int) -> int:
        if place >= room:
            raise OSError(errno.ENOSPC, "No space left on device")
        return take(file, bytes(data[: room - place]), place)

    monkeypatch.setattr(os, "pwrite", full)
    bag = BagFile(tmp_path / "bag")
    filled(bag, range(1, 101))
    bag.close()
    with Reader(tmp_path / "bag") as reader:
        assert [stamp for _, stamp, _ in reader.messages()] == list(range(1, 101))


def test_an_unknown_compression_is_refused(tmp_path: Path) -> None:
    with pytest.raises(IsfError, match="known: none, zstd"):
        BagFile(tmp_path / "bag", Storage(compression="rar"))
    assert not (tmp_path / "bag").exists()


def test_a_bag_defines_messages_as_they_are_written(tmp_path: Path) -> None:
    """With units, and with constants right before their field: Foxglove takes the names of modes from there."""
    state = next(topic for topic in topics.CELL if topic.name == "force_ctrl/state")
    Recording(tmp_path / "bag", [(state, "/force_ctrl/state"), (WRENCH, "/tool_1/wrench")]).close()
    copy_bag(tmp_path / "bag", tmp_path / "again")
    for folder in ("bag", "again"):
        with Reader(tmp_path / folder) as reader:
            of = {connection.topic: connection for connection in reader.connections}
        text = of["/force_ctrl/state"].msgdef.data
        assert re.search(r"^uint8 HOLD=8 .*\nuint8 mode ", text, re.MULTILINE)
        assert "float64 feed                       " in text
        assert "# m/s, present speed along the path" in text
        for connection in of.values():
            for name, read in get_types_from_msg(connection.msgdef.data, connection.msgtype).items():
                assert read[1] == cell_types().fielddefs[name][1]
