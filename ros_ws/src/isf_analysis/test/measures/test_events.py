"""Events and scans of a part: from the machine, through a bag, and put in order."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from isf_analysis.bag import topics
from isf_analysis.bag.bag_file import BagFile
from isf_analysis.bag.bag_reader import read_bag
from isf_analysis.bag.bag_writer import write_bag
from isf_analysis.bag.topics import cell_types, make_message
from isf_analysis.measures import scan_cloud
from isf_analysis.measures.events import contour_at, groups
from isf_analysis.measures.summary import summary
from isf_analysis.report.finding_tables import event_table
from isf_core.errors import ErrorCode, IsfError
from isf_core.events import EventKind, cell_event, force_unknown, kind_name
from isf_core.geometry.height_map import HeightMap
from rosbags.rosbag2 import Reader
from synthetic_part import make_events, make_part

PART = make_part(contours=5, spacing=5e-3)
EVENTS = make_events(PART)
SECOND = 1_000_000_000


def test_kinds_are_those_of_the_message() -> None:
    text = (topics_folder() / "MachineEvent.msg").read_text(encoding="utf-8")
    for kind in EventKind:
        assert f"uint8 {kind.name}={kind.value} " in text
    assert text.count("uint8 ") == len(EventKind) + 1


def topics_folder() -> Path:
    from isf_analysis.bag.topics import message_folder

    return message_folder()


def test_events_come_back_from_a_bag(tmp_path: Path) -> None:
    part = replace(PART, events=EVENTS)
    again = read_bag(write_bag(part, tmp_path / "bag")).events
    assert [replace(event, time=0.0) for event in again] == [replace(event, time=0.0) for event in EVENTS]
    assert [event.time for event in again] == pytest.approx([event.time for event in EVENTS], abs=2e-9)


def test_a_bag_without_the_topic_still_reads(tmp_path: Path) -> None:
    source, old = write_bag(replace(PART, events=EVENTS), tmp_path / "new"), tmp_path / "old"
    copied = {topic.name: topic for topic in topics.CELL if topic is not topics.EVENT}
    bag = BagFile(old)
    with Reader(source) as reader:
        connections = {name: bag.add(topic) for name, topic in copied.items()}
        for connection, time, data in reader.messages():
            if connection.topic.lstrip("/") in copied:
                bag.write(connections[connection.topic.lstrip("/")], time, data)
    bag.close()
    record = read_bag(old)
    assert record.events == ()
    assert record.formed == PART.formed
    assert not record.notes


def test_groups_are_ordered_by_what_they_cost() -> None:
    found = groups(EVENTS)
    assert [group.kind for group in found] == [EventKind.GALLING, EventKind.CONTACT_LOST, EventKind.DIE_CONTACT]
    lost = found[1]
    assert (lost.count, lost.first, lost.value, lost.text) == (2, EVENTS[1], EVENTS[3].value, EVENTS[3].text)
    assert [group.harmless for group in found] == [False, False, True]
    fracture, unknown = replace(EVENTS[0], kind=1), replace(EVENTS[0], kind=77)
    assert [group.kind for group in groups((*EVENTS, fracture, unknown))][:2] == [77, EventKind.FRACTURE]
    assert kind_name(77) == "kind 77"
    assert groups(()) == ()


def test_chips_are_told_with_the_force_they_came_to() -> None:
    """The event is told where the force passes the limit; what the part bears is what came after."""
    (chips,) = (event for event in EVENTS if event.kind == EventKind.GALLING)
    force = np.full((100, 3), [0.0, 0.0, -100.0])
    force[20:45], force[60:70] = [300.0, 0.0, -400.0], np.nan  # 500 N at 25 of 90 points
    results = [replace(PART.results[0], support_force=force), replace(PART.results[1], support_force=np.empty((0, 3)))]
    (told,) = groups([chips], results)
    assert (told.value, told.limit) == (500.0, 155.0)
    assert told.text == "the support tool sheds chips: up to 500 N, limit 155 N, passed at 27 % of the points"
    gentle = [replace(result, support_force=np.full((10, 3), 5.0)) for result in PART.results]
    assert groups([chips], gentle)[0].text == chips.text  # between the points, as on the way to a contour
    assert groups([chips])[0].value == 210.0


def test_lost_channels_of_load_cells_are_all_told_and_stand_at_no_place(tmp_path: Path) -> None:
    lost = [IsfError(ErrorCode.WRENCH_NOT_FINITE, f"channel {name} gives no reading") for name in ("z2", "x1")]
    found = [cell_event(error, 1, 2.0 + k, lost=False) for k, error in enumerate(lost)]
    part = replace(PART, events=(*EVENTS, *found, cell_event(lost[1], 1, 3.0, lost=True)))
    unknown, cells = groups(part.events)[:2]
    assert (unknown.kind, cells.kind, cells.count) == (EventKind.FORCE_UNKNOWN, EventKind.LOAD_CELL, 2)
    assert "[1201 WRENCH_NOT_FINITE] channel z2 gives" in cells.text
    assert "channel x1 gives" in cells.text
    again = read_bag(write_bag(part, tmp_path / "bag"))
    error = force_unknown(again.events)
    assert error is not None
    assert (error.code, error.what) == (ErrorCode.WRENCH_NOT_FINITE, "tool 1: channel x1 gives no reading")
    assert force_unknown(EVENTS) is None
    html = event_table(summary(again))
    assert "<b>load cell</b>" in html
    assert "nan" not in html
    assert [event.has_place for event in found] == [False, False]


def test_the_contour_of_an_event_is_found_by_its_time() -> None:
    assert [contour_at(PART.results, event.time) for event in EVENTS] == [0, 1, 2, 3]
    assert contour_at(PART.results, PART.results[0].start - 0.1) is None
    assert contour_at(PART.results, 0.5 * (PART.results[0].end + PART.results[1].start)) is None


# -- scans ---------------------------------------------------------------------------------------------


def cloud(points: np.ndarray, kind: str = "<f4", extra: int = 4) -> Any:
    """Unordered cloud as scanners publish it: float32 with an intensity behind the coordinates."""
    width = np.dtype(kind).itemsize
    table = np.zeros(
        len(points),
        dtype={
            "names": list("xyz"),
            "formats": [kind] * 3,
            "itemsize": 3 * width + extra,
            "offsets": [0, width, 2 * width],
        },
    )
    for k, name in enumerate("xyz"):
        table[name] = points[:, k]
    return make_message(
        "sensor_msgs/msg/PointCloud2",
        height=1,
        width=len(points),
        fields=[
            make_message(
                "sensor_msgs/msg/PointField", name=n, offset=k * width, datatype=7 if width == 4 else 8, count=1
            )
            for k, n in enumerate("xyz")
        ],
        point_step=3 * width + extra,
        row_step=len(points) * (3 * width + extra),
        data=np.frombuffer(table.tobytes(), dtype=np.uint8),
    )


def bag_with_scans(folder: Path, times: list[tuple[float, Any]]) -> Path:
    """The part's bag with more scans; their times are s after the part's first message."""
    source = write_bag(replace(PART, scan=None), folder / "source", end=1000 * SECOND)
    start = 1000 * SECOND - round(PART.wall_time * SECOND)
    bag = BagFile(folder / "bag")
    with Reader(source) as reader:
        connections = {connection.topic: bag.add(topic_of(connection.topic)) for connection in reader.connections}
        for connection, time, data in reader.messages():
            bag.write(connections[connection.topic], time, data)
    for seconds, message in times:
        data = cell_types().serialize_cdr(message, topics.SCAN.type)
        bag.write(connections["/scan"], start + round(seconds * SECOND), data)
    bag.close()
    return folder / "bag"


def topic_of(name: str) -> topics.Topic:
    return next(topic for topic in topics.CELL if topic.name == name.lstrip("/"))


def scattered(shape: HeightMap, count: int, seed: int, lift: float = 0.0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    x, y = (rng.uniform(axis[0], axis[-1], count) for axis in (shape.x, shape.y))
    return np.column_stack([x, y, shape.at(np.column_stack([x, y])) + lift])


def test_a_scan_between_contours_is_not_the_scan_of_the_part(tmp_path: Path) -> None:
    assert PART.scan is not None
    between, last = scattered(PART.scan, 4000, 1, lift=3e-3), scattered(PART.scan, 30000, 2)
    path = bag_with_scans(tmp_path, [(0.2 * PART.wall_time, cloud(between)), (PART.wall_time, cloud(last))])
    record = read_bag(path)
    assert record.scan is not None
    assert not record.notes
    # the points were drawn 5 mm cells apart from a curved lift: its median within a cell is not that of the middle
    np.testing.assert_allclose(record.scan.z, PART.scan.z, atol=0.3e-3)


def test_without_a_last_scan_no_earlier_one_takes_its_place(tmp_path: Path) -> None:
    assert PART.scan is not None
    record = read_bag(bag_with_scans(tmp_path, [(0.2 * PART.wall_time, cloud(scattered(PART.scan, 4000, 1)))]))
    assert record.scan is None
    assert record.notes == ("not in the bag: scan, only 1 made before the last contour",)


@pytest.mark.parametrize("kind", ["<f4", "<f8"])
def test_an_unordered_cloud_is_read_at_the_targets_cells(kind: str) -> None:
    x, y = np.linspace(-0.05, 0.05, 51), np.linspace(-0.04, 0.04, 41)
    gx, gy = np.meshgrid(x, y)
    target = HeightMap(x, y, 1.2 * gx - 0.5 * gy)  # a wall of 52 deg
    formed = HeightMap(x, y, target.z + 1e-3 + 0.01 * gx)
    points = scattered(formed, 40000, 3)
    points[::50, 2] += 0.02  # outliers
    seen = scan_cloud.height_map_of(cloud(points, kind), target)
    # the deviation changes by 0.01 mm from the middle of a cell of 2 mm to its edge
    np.testing.assert_allclose(seen.z, formed.z, atol=0.01e-3)
    hole = points[np.hypot(points[:, 0], points[:, 1]) > 0.015]
    assert np.isnan(scan_cloud.height_map_of(cloud(hole, kind), target).z[20, 25])


@pytest.mark.parametrize("fault", ["no target", "no coordinates", "cut off", "elsewhere"])
def test_a_scan_that_cannot_be_used_is_reported(fault: str) -> None:
    assert PART.target is not None
    message, target = cloud(scattered(PART.target, 500, 1)), PART.target
    if fault == "no coordinates":
        message.fields = message.fields[:2]
    if fault == "cut off":
        message.data = message.data[:-5]
    if fault == "elsewhere":
        message = cloud(scattered(PART.target, 500, 1) + [10.0, 0.0, 0.0])
    with pytest.raises(IsfError) as raised:
        scan_cloud.height_map_of(message, None if fault == "no target" else target)
    assert raised.value.code == ErrorCode.BAG_INCOMPLETE
