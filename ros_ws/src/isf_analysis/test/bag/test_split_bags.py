"""Bags in several files, in SQLite, cut off by a kill, written anew; read back by rosbags and by our own reader."""

from __future__ import annotations

import shutil
import sqlite3
import threading
from contextlib import closing
from pathlib import Path

import pytest
from isf_analysis.bag import playback, topics
from isf_analysis.bag.bag_file import BagFile, Storage
from isf_analysis.bag.copy import copy_bag
from isf_analysis.bag.open_bag import ENDED_BY_FORCE, open_bag
from isf_analysis.bag.recording import Recording
from isf_analysis.bag.topics import cell_types, make_message
from isf_core.errors import ErrorCode, IsfError
from rosbags.rosbag2 import Reader

WRENCH = next(topic for topic in topics.CELL if topic.name == "tool_1/wrench")
SECOND = 1_000_000_000


def message(number: int) -> bytes:
    header = make_message("std_msgs/msg/Header", frame_id=f"frame {number:04d}")
    return bytes(cell_types().serialize_cdr(make_message(WRENCH.type, header=header), WRENCH.type))


SENT = [(number * SECOND // 10, message(number)) for number in range(1, 101)]
"""10 s of wrenches, ten a second."""


def recorded(path: Path, storage: Storage, *, closed: bool = True) -> Path:
    """The bag of SENT; not ``closed``: what a killed recorder leaves after it was flushed."""
    bag = BagFile(path, storage)
    wrench, job = bag.add(WRENCH), bag.add(topics.JOB)
    bag.write(job, 1, bytes(cell_types().serialize_cdr(make_message(topics.JOB.type), topics.JOB.type)))
    for time, data in SENT:
        bag.write(wrench, time, data)
    bag.flush()
    if closed:
        bag.close()
        return path
    left = path.with_name("killed")
    shutil.copytree(path, left)
    bag.close()
    return left


def wrenches(path: Path) -> list[tuple[int, bytes]]:
    with open_bag(path) as bag:
        found = [item for item in bag.connections if item.topic == "/tool_1/wrench"]
        return [
            (time, block.message(k).tobytes())
            for block in bag.blocks(found)
            for k, time in enumerate(block.times.tolist())
        ]


@pytest.mark.parametrize("kind", ["mcap", "sqlite3"])
@pytest.mark.parametrize(
    ("split", "files"),
    [({}, 1), ({"split_time": 2.5}, 4), ({"split_size": 10 * len(SENT[0][1])}, 11)],
    ids=["one file", "by time", "by size"],
)
def test_everything_comes_back_and_every_file_is_whole(
    tmp_path: Path, kind: str, split: dict[str, float], files: int
) -> None:
    path = recorded(tmp_path / "bag", Storage(storage=kind, **split))  # type: ignore[arg-type]
    names = sorted(item.name for item in path.iterdir() if item.suffix != ".yaml")
    assert len(names) == files
    with Reader(path) as reader:  # an independent reader
        assert [(time, bytes(data)) for _, time, data in reader.messages()][1:] == SENT
        assert reader.message_count == 101
        assert (reader.start_time, reader.end_time) == (1, SENT[-1][0] + 1)
    assert wrenches(path) == SENT
    singly = 0
    for name in names:
        with Reader(path / name) as reader:
            singly += reader.message_count
    assert singly == 101


@pytest.mark.parametrize("kind", ["mcap", "sqlite3"])
@pytest.mark.parametrize("split_time", [0.0, 2.5])
def test_a_killed_recorder_leaves_all_that_it_had_flushed(tmp_path: Path, kind: str, split_time: float) -> None:
    left = recorded(tmp_path / "bag", Storage(storage=kind, split_time=split_time), closed=False)
    assert not (left / "metadata.yaml").exists()
    assert wrenches(left) == SENT


def test_a_file_begun_and_not_written_costs_nothing_of_the_others(tmp_path: Path) -> None:
    left = recorded(tmp_path / "bag", Storage(split_time=2.5), closed=False)
    (left / "bag_4.mcap").write_bytes(b"")
    with open_bag(left) as bag:
        assert any("bag_4.mcap" in note for note in bag.notes)
    assert wrenches(left) == SENT


def test_files_with_topics_of_their_own_are_one_bag(tmp_path: Path) -> None:
    """Each file counts its topics from its own begin; ros2 bag record names in a file only what came into it."""
    left = tmp_path / "killed"
    left.mkdir()
    for number, both in enumerate([(topics.JOB, WRENCH), (topics.NOMINAL, topics.JOB)]):
        bag = BagFile(tmp_path / f"one_{number}")
        for item in [bag.add(topic) for topic in both]:
            bag.write(item, number + 1, f"{number}{item.topic}".encode())
        bag.close()
        shutil.copy(tmp_path / f"one_{number}" / f"one_{number}.mcap", left)
    with open_bag(left) as bag:
        found = bag.connections
        assert [item.topic for item in found] == ["/part/info", "/tool_1/wrench", "/contour/nominal"]
        assert len({item.id for item in found}) == 3
        assert [item.msgcount for item in found] == [2, 1, 1]
        known = {item.id: item.topic for item in found}
        for message in playback.in_order(bag, found):
            assert message.data.decode()[1:] == message.connection.topic == known[message.connection.id]
        before = playback.latched_before(bag, found, begin=3)
        assert {item.data.decode() for item in before} == {"1/part/info", "1/contour/nominal"}


def test_a_transaction_that_a_kill_cut_is_taken_back(tmp_path: Path) -> None:
    left = recorded(tmp_path / "bag", Storage(storage="sqlite3"), closed=False)
    with closing(sqlite3.connect(left / "bag.db3")) as writer:
        writer.execute("PRAGMA cache_size = 1")
        writer.execute("PRAGMA cache_spill = 1")
        writer.execute("UPDATE messages SET timestamp = 7, data = zeroblob(3000)")
        cut = tmp_path / "cut"
        shutil.copytree(left, cut)
    assert (cut / "bag.db3").read_bytes().count(bytes(2000)) > 10  # what is in the file is half of a transaction
    assert wrenches(cut) == wrenches(cut / "bag.db3") == SENT
    with open_bag(cut) as bag:
        assert bag.notes == [ENDED_BY_FORCE]
    assert (cut / "bag.db3-journal").exists()  # the bag itself is left as it is


def test_an_sqlite_file_is_whole_between_two_commits(tmp_path: Path) -> None:
    """The independent reader does not look into the journal, and may come at any time."""
    bag = BagFile(tmp_path / "bag", Storage(storage="sqlite3"))
    wrench = bag.add(WRENCH)
    bag.write(wrench, *SENT[0])
    bag.flush()
    for time, _ in SENT[1:]:
        bag.write(wrench, time, bytes(100_000))  # more than SQLite holds in memory of itself
    with Reader(tmp_path / "bag" / "bag.db3") as reader:
        assert [(time, bytes(data)) for _, time, data in reader.messages()] == SENT[:1]
    bag.close()
    assert len(wrenches(tmp_path / "bag")) == len(SENT)


def test_more_than_ten_files_stay_in_order(tmp_path: Path) -> None:
    left = recorded(tmp_path / "bag", Storage(split_size=8 * len(SENT[0][1])), closed=False)
    assert len(list(left.glob("*.mcap"))) == 13
    assert wrenches(left) == SENT


def test_a_cut_bag_is_written_anew(tmp_path: Path) -> None:
    left = recorded(tmp_path / "bag", Storage(split_time=2.5), closed=False)
    last = left / "bag_3.mcap"
    last.write_bytes(last.read_bytes()[: last.stat().st_size * 6 // 10])
    copied = copy_bag(left, tmp_path / "whole")
    with Reader(tmp_path / "whole") as reader:
        again = [(time, bytes(data)) for _, time, data in reader.messages()][1:]
        assert len(reader.connections) == copied.topics == 2
        assert {item.digest for item in reader.connections} == {
            cell_types().hash_rihs01(t.type) for t in (WRENCH, topics.JOB)
        }
    assert again == SENT[: len(again)]
    assert len(again) == copied.messages - 1 == 75  # the last chunk is cut
    assert ENDED_BY_FORCE in copied.notes
    with pytest.raises(IsfError) as caught:
        copy_bag(left, tmp_path / "whole")
    assert caught.value.code == ErrorCode.BAG_NOT_WRITABLE


@pytest.mark.parametrize(
    "wrong",
    [
        {"storage": "tape"},
        {"compression": "rar"},
        {"storage": "sqlite3", "compression": "zstd"},
        {"split_size": -1},
        {"split_time": float("nan")},
    ],
)
def test_a_storage_that_cannot_be_is_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(IsfError) as caught:
        Storage(**wrong)  # type: ignore[arg-type]
    assert caught.value.code == ErrorCode.BAG_NOT_WRITABLE


def test_what_was_before_the_recording_is_written_whatever_its_size(tmp_path: Path) -> None:
    size = len(SENT[0][1])
    before = [(0, time, data) for time, data in SENT[:80]]
    recording = Recording(tmp_path / "bag", [(WRENCH, "/tool_1/wrench")], queue_size=20 * size, before=before)
    recording.add([(0, time, data) for time, data in SENT[80:]])  # as much as may wait
    recording.close()
    assert not recording.left_out
    assert wrenches(tmp_path / "bag") == SENT


def test_what_the_disk_does_not_follow_is_counted_and_never_a_result(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    go_on = threading.Event()
    write = BagFile.write

    def slow(self: BagFile, *arguments: object) -> None:
        go_on.wait(60)
        write(self, *arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(BagFile, "write", slow)
    recording = Recording(
        tmp_path / "bag", [(WRENCH, "/tool_1/wrench"), (topics.RESULT, "/contour/result")], queue_size=5000
    )
    for time, data in SENT:
        recording.add([(0, time, data)])
    recording.add([(1, SENT[-1][0], bytes(4000))])
    out = recording.left_out[0]
    go_on.set()
    recording.close()
    size = len(SENT[0][1])
    assert out == 100 - 5000 // size
    assert recording.left_out[1] == 0
    with Reader(tmp_path / "bag") as reader:
        kept = {item.topic: item.msgcount for item in reader.connections}
    assert kept == {"/tool_1/wrench": 5000 // size, "/contour/result": 1}


@pytest.mark.parametrize("kind", ["mcap", "sqlite3"])
def test_a_next_file_that_cannot_be_begun_is_told_every_time_and_the_present_one_stays(
    tmp_path: Path, kind: str
) -> None:
    path, away = tmp_path / "bag", tmp_path / "away"
    bag = BagFile(path, Storage(storage=kind, split_time=1.0))  # type: ignore[arg-type]
    wrench = bag.add(WRENCH)
    bag.write(wrench, 1 * SECOND, message(1))
    path.rename(away)  # as a folder that was deleted, or a disk that is full
    for second in (3, 5):
        with pytest.raises(IsfError) as caught:
            bag.write(wrench, second * SECOND, message(second))
        assert caught.value.code == 1603
    away.rename(path)
    bag.write(wrench, 7 * SECOND, message(7))
    bag.close()
    assert wrenches(path) == [(1 * SECOND, message(1)), (7 * SECOND, message(7))]
