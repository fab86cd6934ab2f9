"""What a bag lacks of a part: scans that say nothing, streams, contours, and times of receipt that can be trusted."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from isf_analysis.bag import topics
from isf_analysis.bag.bag_reader import read_bag
from isf_analysis.bag.bag_writer import write_bag
from isf_analysis.bag.topics import cell_types, make_message
from isf_analysis.measures.record import PartRecord
from isf_analysis.measures.summary import summary
from isf_core.geometry.height_map import HeightMap
from rosbags.rosbag2 import Reader, StoragePlugin, Writer
from synthetic_part import make_part

PART = make_part(contours=6, spacing=5e-3)
SECOND = 1_000_000_000
END = 1_000 * SECOND
STREAMS = (*topics.WRENCHES, *topics.POSES, topics.ARMED)
Change = Callable[[str, int, Any], list[tuple[int, Any]]]
"""What is written in place of a message: topic, time of receipt and message to times and messages."""


def recorded(part: PartRecord, path: Path, change: Change = lambda topic, time, message: [(time, message)]) -> Path:
    """A bag as of a cell of nodes: the job has a stamp, and there are wrenches and poses of both tools."""
    types = cell_types()
    source = write_bag(part, path.with_name(f"{path.name}_source"), end=END)
    with Reader(source) as reader, Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        kinds = {c.topic.lstrip("/"): c.msgtype for c in reader.connections} | {
            item.name: item.type for item in STREAMS
        }
        added = {name: writer.add_connection(f"/{name}", kind, typestore=types) for name, kind in kinds.items()}

        def write(name: str, time: int, message: Any) -> None:
            for when, what in change(name, time, message):
                writer.write(added[name], when, types.serialize_cdr(what, kinds[name]))

        for connection, time, data in reader.messages():
            name = connection.topic.lstrip("/")
            message: Any = types.deserialize_cdr(data, connection.msgtype)
            if name == topics.JOB.name:
                message.header.stamp.sec = 1_700_000_000
            write(name, time, message)
            if name == topics.NOMINAL.name:
                for stream in STREAMS:
                    write(stream.name, time + 1, make_message(stream.type))
    return path


def without(*names: str, contour: int | None = None) -> Change:
    """Without these topics, or on them without one ``contour``."""

    def change(topic: str, time: int, message: Any) -> list[tuple[int, Any]]:
        lost = topic in names and (contour is None or message.index == contour)
        return [] if lost else [(time, message)]

    return change


def test_a_whole_bag_of_a_cell_has_no_notes(tmp_path: Path) -> None:
    record = read_bag(recorded(PART, tmp_path / "bag"))
    assert record.notes == ()
    assert record.wall_time == pytest.approx(PART.wall_time, abs=1e-6)


# -- streams -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", [item.name for item in STREAMS] + ["contour/correction", "contour/corrected"])
def test_a_topic_that_is_missing_is_named(name: str, tmp_path: Path) -> None:
    record = read_bag(recorded(PART, tmp_path / "bag", without(name)))
    assert record.notes == (f"not in the bag: {name}",)
    assert f"not in the bag: {name}" in summary(record)["notes"]


@pytest.mark.parametrize("name", ["contour/correction", "contour/corrected"])
def test_a_contour_whose_correction_is_missing_is_named(name: str, tmp_path: Path) -> None:
    record = read_bag(recorded(PART, tmp_path / "bag", without(name, contour=3)))
    assert record.notes == (f"not in the bag: {name} of 1 contour(s), first contour 4",)


def test_a_tool_that_the_part_does_not_need_is_not_missed(tmp_path: Path) -> None:
    """SPIF from above has no support tool; from below the upper one is none."""
    part = make_part(contours=3, spacing=10e-3, process="SPIF", support_force=0.0)
    lower = {"tool_2/wrench", "tool_2/pose"}
    assert read_bag(recorded(part, tmp_path / "above", without(*lower))).notes == ()
    below = replace(part, nominal=tuple(replace(item, forming_tool=2) for item in part.nominal))
    notes = read_bag(recorded(below, tmp_path / "below", without(*lower))).notes
    assert set(notes) == {f"not in the bag: {name}" for name in lower}


def test_streams_of_another_part_are_none_of_this_one(tmp_path: Path) -> None:
    """The bag begins with another part, and its wrenches are of that."""

    def after_another(topic: str, time: int, message: Any) -> list[tuple[int, Any]]:
        if topic == "tool_1/wrench":
            return [(time - 500 * SECOND, message)]
        if topic == topics.JOB.name:
            stamp = replace(message.header.stamp, sec=1_600_000_000)
            other = replace(message, plan_id="before", header=replace(message.header, stamp=stamp))
            return [(time - 501 * SECOND, other), (time, message)]
        return [(time, message)]

    record = read_bag(recorded(PART, tmp_path / "bag", after_another))
    assert record.plan_id == PART.plan_id
    assert record.notes == ("not in the bag: tool_1/wrench",)


# -- scans of the finished part ------------------------------------------------------------------------


def scanned(change: Callable[[HeightMap], HeightMap], path: Path) -> PartRecord:
    assert PART.scan is not None
    return read_bag(write_bag(replace(PART, scan=change(PART.scan)), path))


@pytest.mark.parametrize("coordinate", ["z", "all"])
def test_a_scan_without_a_finite_point_is_left_out_and_the_rest_read(coordinate: str, tmp_path: Path) -> None:
    def unknown(topic: str, time: int, message: Any) -> list[tuple[int, Any]]:
        if topic == topics.SCAN.name:
            points = np.frombuffer(message.data.tobytes(), dtype="<f8").reshape(-1, 3).copy()
            points[:, 2 if coordinate == "z" else slice(None)] = np.nan
            message.data = np.frombuffer(points.tobytes(), dtype=np.uint8)
        return [(time, message)]

    record = read_bag(recorded(PART, tmp_path / "bag", unknown))
    assert record.scan is None
    assert len(record.results) == 6
    (note,) = record.notes
    assert note.startswith("the scan of the finished part is left out: of its 2601 points none is finite (1321 SCAN_N")
    assert summary(record)["verdict"]["short_of"][0] == "the shape was not measured"


@pytest.mark.parametrize("factor", [1e3, 100.0, 1 / 25.4e-3, 1e-3])
def test_a_scan_in_another_unit_is_left_out_with_its_code(factor: float, tmp_path: Path) -> None:
    record = scanned(lambda scan: HeightMap(factor * scan.x, factor * scan.y, factor * scan.z), tmp_path / "bag")
    assert record.scan is None
    (note,) = record.notes
    assert "1322 SCAN_UNIT_SUSPECT; coordinates must be in metres" in note
    assert f"its points span {240e-3 * factor:.4g}" in note
    assert summary(record)["deviation"] is None


def test_a_scan_of_the_part_alone_is_of_the_right_size(tmp_path: Path) -> None:
    """83 mm of the 250 mm of the sheet, and 30 mm of the floor: the second shows too little, and says so."""

    def within(half: float) -> Callable[[HeightMap], HeightMap]:
        def cut(scan: HeightMap) -> HeightMap:
            x, y = (axis[np.abs(axis) <= half + 1e-9] for axis in (scan.x, scan.y))
            columns, rows = np.abs(scan.x) <= half + 1e-9, np.abs(scan.y) <= half + 1e-9
            return HeightMap(x, y, scan.z[np.ix_(rows, columns)])

        return cut

    assert scanned(within(50e-3), tmp_path / "part").notes == ()
    floor = scanned(within(15e-3), tmp_path / "floor")
    assert floor.scan is not None
    assert any("not enough measured" in text for text in summary(floor)["verdict"]["short_of"])


# -- times of receipt ----------------------------------------------------------------------------------


@pytest.mark.parametrize("back", [40, 400])
def test_a_clock_that_was_set_back_is_told_and_the_wall_time_is_not_short_by_it(back: int, tmp_path: Path) -> None:
    """After the result of the third contour; the scan may then have come before the job, and is of this part."""
    ended: list[int] = []

    def set_back(topic: str, time: int, message: Any) -> list[tuple[int, Any]]:
        later = len(ended) == 3
        if topic == topics.RESULT.name and len(ended) < 3:
            ended.append(time)
        return [(time - back * SECOND if later else time, message)]

    record = read_bag(recorded(PART, tmp_path / "bag", set_back))
    (note,) = record.notes
    assert note.startswith(f"the times of receipt jump back by {back}.0 s or more after the result of contour 3 (")
    assert record.wall_time == pytest.approx(PART.wall_time, abs=1e-6)
    assert [result.index for result in record.results] == list(range(6))
    assert record.scan is not None


def test_a_recording_that_the_bag_holds_twice_is_told_and_counted_once(tmp_path: Path) -> None:
    def twice(topic: str, time: int, message: Any) -> list[tuple[int, Any]]:
        return [(time, message), (time + 600 * SECOND, message)]

    record = read_bag(recorded(PART, tmp_path / "bag", twice))
    assert record.notes == ("the bag holds this recording of the part 2 times: the last one is read",)
    assert record.wall_time == pytest.approx(PART.wall_time, abs=1e-6)
    assert record.ticks == PART.ticks


def test_messages_that_are_there_twice_at_the_same_time_are_told(tmp_path: Path) -> None:
    record = read_bag(recorded(PART, tmp_path / "bag", lambda topic, time, message: 2 * [(time, message)]))
    assert record.notes == ("the bag holds this recording of the part 2 times: the last one is read",)
    assert record.wall_time == pytest.approx(PART.wall_time, abs=1e-6)


def test_two_parts_of_one_plan_are_no_copies(tmp_path: Path) -> None:
    """In lockstep the second one has the results of the first, bit by bit, and a job of its own."""

    def again(topic: str, time: int, message: Any) -> list[tuple[int, Any]]:
        found = [(time, message), (time + 600 * SECOND, message)]
        if topic == topics.JOB.name:
            stamp = replace(message.header.stamp, sec=1_700_000_600)
            found[1] = (found[1][0], replace(message, header=replace(message.header, stamp=stamp)))
        return found

    record = read_bag(recorded(PART, tmp_path / "bag", again))
    assert record.notes == ()
    assert record.wall_time == pytest.approx(PART.wall_time, abs=1e-6)


def test_a_job_that_is_heard_once_more_is_no_copy(tmp_path: Path) -> None:
    """Job and contours are latched: a second recorder of a part gets them again."""

    def latched(topic: str, time: int, message: Any) -> list[tuple[int, Any]]:
        late = topic == topics.JOB.name or (topic == topics.NOMINAL.name and message.index == 2)
        return [(time, message), *([(END - SECOND, message)] if late else [])]

    record = read_bag(recorded(PART, tmp_path / "bag", latched))
    assert record.notes == ()
    assert record.wall_time == pytest.approx(PART.wall_time, abs=1e-6)
