"""Tables of a bag hold what the deserialiser of rosbags gives, message by message; damaged bags give what is whole."""

from __future__ import annotations

import csv
import shutil
from pathlib import Path
from typing import Any

import isf_analysis
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from isf_analysis.bag import table_files, topics
from isf_analysis.bag.bag_file import BagFile, Storage
from isf_analysis.bag.bag_writer import write_bag
from isf_analysis.bag.cdr_columns import ColumnReader
from isf_analysis.bag.open_bag import Block
from isf_analysis.bag.table_files import write_tables
from isf_analysis.bag.tables import Bag
from isf_analysis.bag.topics import CELL, cell_types, make_message
from isf_core.errors import ErrorCode, IsfError
from rosbags.rosbag2 import Reader, StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from synthetic_part import make_part

PART = make_part(contours=6, spacing=5e-3, points=40)
WRENCHES = 700
"""Of each tool; in several chunks with the rest."""


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A part with streams beside it, as a recorder writes them."""
    folder = tmp_path_factory.mktemp("tables")
    return with_streams(write_bag(PART, folder / "part", end=200_000_000_000), folder / "bag")


def with_streams(part: Path, path: Path, storage: StoragePlugin = StoragePlugin.MCAP) -> Path:
    rng, types = np.random.default_rng(5), cell_types()
    streams = {topic.name: topic for topic in CELL if topic.name.endswith("wrench")}
    with Writer(path, version=9, storage_plugin=storage) as writer, Reader(part) as reader:
        added = {c.topic: writer.add_connection(c.topic, c.msgtype, typestore=types) for c in reader.connections}
        for name, topic in streams.items():
            added[name] = writer.add_connection(f"/{name}", topic.type, typestore=types)
        for connection, time, data in reader.messages():
            writer.write(added[connection.topic], time, data)
        for k in range(WRENCHES):
            for name, topic in streams.items():
                message = make_message(topic.type)
                message.header.frame_id = "sheet"
                message.header.stamp.sec, message.header.stamp.nanosec = divmod(2_000_000 * k, 1_000_000_000)
                message.wrench.force.z = float(rng.normal())
                writer.write(added[name], 200_000_000_001 + 2_000_000 * k, types.serialize_cdr(message, topic.type))
    return path


def messages_of(path: Path, topic: str) -> list[tuple[int, Any]]:
    """(time, message) by the other reader."""
    with Reader(path) as reader:
        wanted = [connection for connection in reader.connections if connection.topic == topic]
        return [(time, cell_types().deserialize_cdr(data, c.msgtype)) for c, time, data in reader.messages(wanted)]


def test_a_stream_is_a_table_of_numbers(bag: Path) -> None:
    expected = messages_of(bag, "/tool_1/wrench")
    with isf_analysis.open(bag) as found:
        table = found["tool_1/wrench"]
        np.testing.assert_array_equal(table["wrench.force.z"], [m.wrench.force.z for _, m in expected])
        np.testing.assert_array_equal(table["received"], [time for time, _ in expected])
        stamps = [m.header.stamp.sec * 1_000_000_000 + m.header.stamp.nanosec for _, m in expected]
        np.testing.assert_array_equal(table["header.stamp"], stamps)
        assert set(table["header.frame_id"]) == {"sheet"}
        structured = table.to_numpy()
        assert structured["wrench.force.z"].dtype == np.float64
        assert len(structured) == len(table) == WRENCHES


def test_arrays_and_clouds_of_a_part(bag: Path) -> None:
    with isf_analysis.open(bag) as found:
        results = found["contour/result"]
        np.testing.assert_array_equal(results["index"], np.arange(6))
        for row, result in zip(results["tick_normal_force"], PART.results, strict=True):
            np.testing.assert_array_equal(row, result.tick_normal_force)
        assert results["completed"].all()
        scan, target = PART.scan, PART.target
        assert scan is not None
        assert target is not None
        np.testing.assert_array_equal(np.column_stack([found["scan"][axis] for axis in "xyz"]), scan.points())
        assert found["part/info"]["job_text"][0] == PART.job_text
        assert found["machine/state"]["fault_messages"][0] == "[]"


def test_clouds_with_different_fields_are_one_table(tmp_path: Path) -> None:
    """Two in one chunk: the second has a quality (float32) and a count (uint8) as well."""

    def cloud(names: dict[str, tuple[int, str]], rows: list[tuple[float, ...]]) -> Any:
        kind = np.dtype([(name, code) for name, (_, code) in names.items()])
        offsets = np.cumsum([0, *(kind[name].itemsize for name in names)])
        return make_message(
            "sensor_msgs/msg/PointCloud2",
            height=1,
            width=len(rows),
            fields=[
                make_message("sensor_msgs/msg/PointField", name=name, offset=int(offset), datatype=number, count=1)
                for (name, (number, _)), offset in zip(names.items(), offsets, strict=False)
            ],
            point_step=kind.itemsize,
            row_step=len(rows) * kind.itemsize,
            data=np.frombuffer(np.array(rows, dtype=kind).tobytes(), dtype=np.uint8),
        )

    x = {"x": (7, "<f4")}
    clouds = [cloud(x, [(1.0,), (2.0,)]), cloud({**x, "quality": (7, "<f4"), "count": (2, "u1")}, [(3.0, 0.5, 7)])]
    with Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection("/scan", "sensor_msgs/msg/PointCloud2", typestore=cell_types())
        for time, message in enumerate(clouds):
            writer.write(connection, time, cell_types().serialize_cdr(message, connection.msgtype))
    with isf_analysis.open(tmp_path / "bag") as found:
        table = found["scan"]
        np.testing.assert_array_equal(table["x"], [1.0, 2.0, 3.0])
        np.testing.assert_array_equal(table["quality"], [np.nan, np.nan, 0.5])
        np.testing.assert_array_equal(table["count"], [0, 0, 7])


def test_a_table_per_part_holds_what_was_planned_corrected_and_measured(bag: Path) -> None:
    with isf_analysis.open(bag) as found:
        contours, points, ticks = found.contours, found.points, found.ticks
    np.testing.assert_array_equal(contours["contour"], np.arange(6))
    for row, result in enumerate(PART.results):
        engaged = result.tick_engaged
        error = (result.tick_normal_force - result.tick_set_point)[engaged]
        assert contours["force_error_rms_N"][row] == pytest.approx(np.sqrt(np.mean(error**2)), rel=1e-12)
        assert contours["within_10N_fraction"][row] == np.mean(np.abs(error) <= 10.0)
        assert contours["duration_s"][row] == pytest.approx(result.end - result.start, abs=1e-8)
        assert contours["axial_force_mean_N"][row] == pytest.approx(result.forming_force[:, 2].mean(), rel=1e-12)
        largest = np.linalg.norm(PART.corrections[row].offset, axis=1).max()
        assert contours["correction_max_m"][row] == pytest.approx(largest, rel=1e-12)
    assert np.isnan(contours["predicted_force_mean_N"]).all()  # the plan of this part predicts none
    assert np.isfinite(contours["forecast_force_mean_N"]).all()
    assert len(points) == sum(len(contour) for contour in PART.nominal)
    np.testing.assert_array_equal(points["planned_tip_z_m"][:40], PART.nominal[0].forming_tip[:, 2])
    np.testing.assert_array_equal(points["correction_z_m"][-40:], PART.corrections[-1].offset[:, 2])
    assert len(ticks) == sum(len(result.tick_time) for result in PART.results)


def test_names_that_do_not_exist_are_told_with_those_that_do(bag: Path) -> None:
    with isf_analysis.open(bag) as found:
        with pytest.raises(KeyError, match="tool_1/wrench"):
            found["tool_3/wrench"]
        with pytest.raises(KeyError, match=r"wrench\.force\.x"):
            found["tool_1/wrench"]["force"]


def test_sqlite_and_compressed_bags_give_the_same_tables(bag: Path, tmp_path: Path) -> None:
    part = write_bag(PART, tmp_path / "part", end=200_000_000_000)
    other = with_streams(part, tmp_path / "db3", StoragePlugin.SQLITE3)
    zstd = BagFile(tmp_path / "zstd", Storage(compression="zstd"))
    with Reader(bag) as reader:
        by_name = {topic.name: topic for topic in CELL}
        added = {c.topic: zstd.add(by_name[c.topic.strip("/")]) for c in reader.connections}
        for connection, time, data in reader.messages():
            zstd.write(added[connection.topic], time, data)
    zstd.close()
    with isf_analysis.open(bag) as first:
        for path in (other, tmp_path / "zstd"):
            with isf_analysis.open(path) as second:
                assert set(first) == set(second)
                for topic in ("tool_2/wrench", "scan"):
                    for name, column in first[topic].columns.items():
                        np.testing.assert_array_equal(second[topic][name], column)


# -- any type ------------------------------------------------------------------------------------------

BASES = ("bool", "byte", "char", "int8", "uint16", "int32", "uint64", "float32", "float64", "string")
FIELD = st.tuples(st.sampled_from((*BASES, "Inner")), st.sampled_from(("", "", "[]", "[3]")))
INNER = "uint8 small\nfloat64 large\nstring name\nbuiltin_interfaces/Time at\n"


def value_of(base: str, data: st.DataObject) -> Any:
    if base == "string":
        return data.draw(st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=5))
    if base == "bool":
        return data.draw(st.booleans())
    if base.startswith("float"):
        return float(np.float32(data.draw(st.floats(-1e6, 1e6))))
    return data.draw(st.integers(0, 100))


@settings(max_examples=60, deadline=None)
@given(fields=st.lists(FIELD, min_size=1, max_size=6), data=st.data())
def test_any_type_is_read_as_by_rosbags(fields: list[tuple[str, str]], data: st.DataObject) -> None:
    """Numbers, texts, arrays and messages in messages, in any order: alignment is where such readers go wrong."""
    fields = [(base, "" if base == "Inner" and kind == "[3]" else kind) for base, kind in fields]
    types = get_typestore(Stores.ROS2_JAZZY)
    types.register(get_types_from_msg(INNER, "t/msg/Inner"))
    text = "".join(f"{base}{kind} f{k}\n" for k, (base, kind) in enumerate(fields))
    types.register(get_types_from_msg(text, "t/msg/Any"))
    messages = [types.types["t/msg/Any"](**row_of(fields, types, data)) for _ in range(3)]
    raw = [bytes(types.serialize_cdr(message, "t/msg/Any")) for message in messages]
    end = np.cumsum([len(item) for item in raw])
    joined = np.frombuffer(b"".join(raw), dtype=np.uint8)
    block = Block(None, np.arange(3), joined, end - [len(item) for item in raw], end)  # type: ignore[arg-type]
    reader = ColumnReader(types, "t/msg/Any")
    columns = reader.columns(block)
    assert reader.damaged == 0
    again = [types.deserialize_cdr(item, "t/msg/Any") for item in raw]
    for k, (base, kind) in enumerate(fields):
        for row, message in enumerate(again):
            value = getattr(message, f"f{k}")
            if base == "Inner":
                if not kind:
                    assert columns[f"f{k}.large"][row] == value.large
                    assert columns[f"f{k}.name"][row] == value.name
                    assert columns[f"f{k}.at"][row] == value.at.sec * 1_000_000_000 + value.at.nanosec
            elif kind == "[3]":
                assert [columns[f"f{k}[{n}]"][row] for n in range(3)] == list(value)
            elif kind == "[]" and base != "string":
                np.testing.assert_array_equal(columns[f"f{k}"][row], value)
            elif not kind:
                assert columns[f"f{k}"][row] == value


def row_of(fields: list[tuple[str, str]], types: Any, data: st.DataObject) -> dict[str, Any]:
    values: dict[str, Any] = {}
    for k, (base, kind) in enumerate(fields):
        count = {"": None, "[3]": 3}.get(kind, data.draw(st.integers(0, 3)))
        if base == "Inner":
            made = [inner(types, data) for _ in range(1 if count is None else count)]
        else:
            made = [value_of(base, data) for _ in range(1 if count is None else count)]
        if count is None:
            values[f"f{k}"] = made[0]
        elif base in ("string", "Inner"):
            values[f"f{k}"] = made
        else:
            kinds = {"byte": "uint8", "char": "uint8"}
            values[f"f{k}"] = np.array(made, dtype=kinds.get(base, base))
    return values


def inner(types: Any, data: st.DataObject) -> Any:
    at = types.types["builtin_interfaces/msg/Time"](
        sec=data.draw(st.integers(0, 9)), nanosec=data.draw(st.integers(0, 9))
    )
    name, large = value_of("string", data), value_of("float64", data)
    return types.types["t/msg/Inner"](small=3, large=large, name=name, at=at)


# -- files ---------------------------------------------------------------------------------------------


def test_files_hold_the_tables(bag: Path, tmp_path: Path) -> None:
    with isf_analysis.open(bag) as found:
        rows = write_tables(found, tmp_path, ["csv", "npz"])
        assert rows["/tool_1/wrench"] == WRENCHES
        assert rows["contours"] == 6
        with (tmp_path / "tool_1_wrench.csv").open() as stream:
            lines = list(csv.DictReader(stream))
        np.testing.assert_array_equal(
            [float(r["wrench.force.z"]) for r in lines], found["tool_1/wrench"]["wrench.force.z"]
        )
        with np.load(tmp_path / "tool_1_wrench.npz") as data:
            np.testing.assert_array_equal(data["wrench.force.z"], found["tool_1/wrench"]["wrench.force.z"])
            assert set(data["header.frame_id"]) == {b"sheet"}
        with np.load(tmp_path / "contour_result.npz") as data:
            parts = np.split(data["tick_normal_force"], np.cumsum(data["tick_normal_force.count"])[:-1])
            for part, result in zip(parts, PART.results, strict=True):
                np.testing.assert_array_equal(part, result.tick_normal_force)
        with (tmp_path / "contour_result.csv").open() as stream:
            counts = [int(row["tick_time.count"]) for row in csv.DictReader(stream)]
        assert counts == [len(result.tick_time) for result in PART.results]
        with (tmp_path / "contours.csv").open() as stream:
            assert [float(row["feed_m_s"]) for row in csv.DictReader(stream)] == [0.03] * 6
    assert not list(tmp_path.glob("isf_table_*"))


def test_formats_and_topics_that_do_not_exist_are_refused(bag: Path, tmp_path: Path, monkeypatch: Any) -> None:
    with isf_analysis.open(bag) as found:
        for arguments, named in ((["xls"], None), "csv"), ((["csv"], ["nothing"]), "tool_1/wrench"):
            with pytest.raises(IsfError, match=named) as caught:
                write_tables(found, tmp_path, *arguments)
            assert caught.value.code == ErrorCode.FILE_FIELD
        monkeypatch.setattr(table_files, "_pyarrow", lambda: None)
        with pytest.raises(IsfError, match="pyarrow is not installed") as caught:
            write_tables(found, tmp_path, ["parquet"])
        assert caught.value.code == ErrorCode.FILE_NOT_FOUND


# -- damaged and foreign bags ----------------------------------------------------------------------------


def test_200_mutated_bags_give_tables_or_a_code(bag: Path, tmp_path: Path) -> None:
    """Cut anywhere, bytes changed anywhere; what is left out is told."""
    rng = np.random.default_rng(7)
    file = next(bag.glob("*.mcap"))
    whole = file.read_bytes()
    changed = tmp_path / "changed.mcap"
    untold, codes = 0, set()
    for number in range(200):
        data = bytearray(whole)
        if number % 2:
            for position in rng.integers(0, len(data), 1 + number % 20):
                data[position] = int(rng.integers(256))
        changed.write_bytes(data[: int(rng.integers(1, len(data)))] if number % 4 < 2 else data)
        try:
            with Bag(changed) as found:
                sums = {name: len(found[name]) for name in ("/tool_1/wrench", "/contour/result") if name in list(found)}
                untold += sums.get("/tool_1/wrench", 0) < WRENCHES and not found.notes
        except IsfError as error:
            codes.add((error.code, bool(error.advice)))
    assert codes <= {(ErrorCode.BAG_UNREADABLE, True), (ErrorCode.BAG_INCOMPLETE, True)}
    assert untold <= 2  # a channel number that was flipped looks like another topic


def test_a_number_that_was_changed_on_the_disk_is_noticed(tmp_path: Path) -> None:
    """Any byte of what was recorded; the rest of the bag is read."""
    path = write_bag(PART, tmp_path / "bag")
    file = path / "bag.mcap"
    whole = file.read_bytes()
    place = whole.index(PART.results[3].tick_normal_force[100:110].tobytes())
    changed = bytearray(whole)
    changed[place + 3] ^= 0x10
    file.write_bytes(changed)
    with isf_analysis.open(path) as found:
        assert len(found["contour/result"]) < 6
        assert any("checksum" in note for note in found.notes)
    file.write_bytes(whole)
    with isf_analysis.open(path) as found:
        assert len(found["contour/result"]) == 6
        assert not found.notes


def test_a_foreign_bag_has_tables_of_its_topics_and_a_note(tmp_path: Path) -> None:
    with Writer(tmp_path / "robot", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection("/odom", "std_msgs/msg/String", typestore=cell_types())
        data = cell_types().serialize_cdr(make_message("std_msgs/msg/String", data="hello"), "std_msgs/msg/String")
        writer.write(connection, 1, data)
    with isf_analysis.open(tmp_path / "robot") as found:
        assert write_tables(found, tmp_path, ["csv"]) == {"/odom": 1}
        assert any("no tables of contours" in note for note in found.notes)
        with pytest.raises(IsfError) as caught:
            _ = found.contours
        assert caught.value.code == ErrorCode.BAG_INCOMPLETE


def test_a_run_folder_stands_for_its_bag(bag: Path, tmp_path: Path) -> None:
    shutil.copytree(bag, tmp_path / "run" / "bag")
    with isf_analysis.open(tmp_path / "run") as found:
        assert found.part.job_name == PART.job_name
    assert topics.JOB.name == "part/info"
