"""Bags: what is written is read back; damaged, foreign and incomplete ones are told from each other."""

from __future__ import annotations

import re
import shutil
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import isf_analysis
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from isf_analysis.bag import topics
from isf_analysis.bag.bag_reader import last_part, read_bag, read_cell
from isf_analysis.bag.bag_writer import write_bag
from isf_analysis.bag.open_bag import open_bag
from isf_analysis.bag.playback import begin_of_contour
from isf_analysis.bag.topics import cell_types, make_message, message_folder
from isf_analysis.measures.record import PartRecord
from isf_core.errors import ErrorCode, IsfError
from isf_core.thinned_sheet import ThinnedSheet
from rosbags.rosbag2 import Reader, StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from synthetic_part import make_part

PART = make_part(contours=8, spacing=5e-3)
NANO = 1e-9


def assert_same(first: Any, second: Any, where: str = "record") -> None:
    """Equal in every field; times to a nanosecond, which is what a message stamp holds."""
    if is_dataclass(first):
        assert type(first) is type(second), where
        for item in fields(first):
            assert_same(getattr(first, item.name), getattr(second, item.name), f"{where}.{item.name}")
    elif isinstance(first, tuple):
        assert len(first) == len(second), where
        for k, (one, other) in enumerate(zip(first, second, strict=True)):
            assert_same(one, other, f"{where}[{k}]")
    elif isinstance(first, np.ndarray):
        np.testing.assert_array_equal(first, second, err_msg=where)
    elif isinstance(first, float):
        assert second == pytest.approx(first, abs=2 * NANO, rel=0), where
    else:
        assert first == second, where


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_bag(PART, tmp_path_factory.mktemp("bags") / "part")


def test_a_record_comes_back_as_it_was(bag: Path) -> None:
    assert_same(PART, read_bag(bag))


@pytest.mark.parametrize(
    "changes",
    [
        {"process": "SPIF", "support_force": 0.0, "correction": "none"},
        {"support_force": 0.0},
        {"stop_after": 2},
    ],
    ids=["spif", "position control", "stopped"],
)
def test_other_kinds_of_parts_come_back_too(changes: dict[str, Any], tmp_path: Path) -> None:
    part = make_part(contours=4, spacing=10e-3, **changes)
    assert_same(part, read_bag(write_bag(part, tmp_path / "bag")))


def test_faults_of_the_machine_come_back(tmp_path: Path) -> None:
    part = replace(PART, faults=((1405, "force limit of tool_1"),))
    assert read_bag(write_bag(part, tmp_path / "bag")).faults == part.faults


def test_how_slowly_the_simulated_sheet_was_formed_comes_back(tmp_path: Path) -> None:
    """Of a sheet that has such a number: what the machine of the cell told last."""
    proven = replace(PART, sheet={"model": "shell_coarse", "kinetic_over_plastic": 0.0312})
    assert read_bag(write_bag(proven, tmp_path / "bag")).sheet == proven.sheet
    for k, sheet in enumerate(({"model": "shell"}, {"model": "fast"})):
        assert read_bag(write_bag(replace(PART, sheet=sheet), tmp_path / f"bag_{k}")).sheet == sheet


def test_what_the_plan_warned_of_comes_back(tmp_path: Path) -> None:
    part = replace(PART, plan_warnings=("a wall of 62 deg at x = 1.0 mm", "two lines\nof text"))
    assert read_bag(write_bag(part, tmp_path / "bag")).plan_warnings == part.plan_warnings


def test_the_shapes_of_the_stages_come_back(tmp_path: Path) -> None:
    assert PART.target is not None
    preforms = tuple(replace(PART.target, z=share * PART.target.z) for share in (0.3, 0.6))
    part = replace(PART, preforms=preforms)
    assert_same(part, read_bag(write_bag(part, tmp_path / "bag")))


def test_the_formed_sheet_comes_back_and_one_that_is_none_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Columns that bend, as of shell elements, and a margin that is not known."""
    points = np.random.default_rng(2).normal(size=(4, 3, 3))
    sheet = ThinnedSheet(points, points[..., 0] ** 2, np.where(points[..., 1] > 0.0, np.nan, points[..., 1]))
    part = replace(PART, formed_sheet=sheet)
    assert_same(part, read_bag(write_bag(part, tmp_path / "bag")))
    monkeypatch.setattr("isf_ros.fields.THINNED", ("x", "y", "z", "thinness", "margin"))
    foreign = write_bag(part, tmp_path / "foreign")
    monkeypatch.undo()
    back = read_bag(foreign)
    assert back.formed_sheet is None
    assert any("machine/formed_sheet is left out: needs floating-point" in note for note in back.notes)


def test_the_part_out_of_the_clamp_comes_back_and_is_not_taken_for_the_scan(tmp_path: Path) -> None:
    points = np.random.default_rng(3).normal(size=(50, 3))
    part = replace(PART, released=points)
    assert_same(part, read_bag(write_bag(part, tmp_path / "bag")))
    assert read_bag(write_bag(PART, tmp_path / "clamped")).released is None


def test_unknown_cells_come_back(tmp_path: Path) -> None:
    assert PART.scan is not None
    z = PART.scan.z.copy()
    z[3, 4] = np.nan
    part = replace(PART, scan=replace(PART.scan, z=z))
    assert_same(part, read_bag(write_bag(part, tmp_path / "bag")))


@settings(max_examples=8, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    name=st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=30),
    seed=st.integers(-(2**63), 2**63 - 1),
    variant=st.integers(-1, 20),
    force=st.floats(0, 1500),
    ticks=st.integers(0, 2**53),
    wall=st.floats(0, 1e5).map(lambda value: round(value, 9)),
)
def test_any_job_comes_back(
    name: str, seed: int, variant: int, force: float, ticks: int, wall: float, tmp_path: Path
) -> None:
    folder = tmp_path / "bag"
    shutil.rmtree(folder, ignore_errors=True)
    part = replace(
        make_part(contours=2, spacing=25e-3, points=12),
        job_name=name,
        seed=seed,
        variant=variant,
        support_force=force,
        ticks=ticks,
        wall_time=wall,
    )
    assert_same(part, read_bag(write_bag(part, folder)))


def test_the_bag_explains_its_types_itself(bag: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def not_installed() -> None:
        raise AssertionError("the installed messages must not be needed")

    monkeypatch.setattr("isf_analysis.bag.open_bag.cell_types", not_installed)
    assert read_bag(bag).job_name == PART.job_name


def test_hashes_are_those_of_the_installed_messages(bag: Path) -> None:
    # rosidl computes them when it builds isf_msgs; ros2 bag compares them on playing
    files = pytest.importorskip("ament_index_python").get_package_share_directory("isf_msgs")
    checked = 0
    with Reader(bag) as reader:
        for connection in reader.connections:
            if connection.msgtype.startswith("isf_msgs/"):
                text = (Path(files) / "msg" / f"{connection.msgtype.split('/')[-1]}.json").read_text()
                assert connection.digest in text
                checked += 1
    assert checked == 7


def test_a_bag_in_a_namespace_is_found(tmp_path: Path) -> None:
    assert_same(PART, read_bag(copy_bag(write_bag(PART, tmp_path / "plain"), tmp_path / "cell", prefix="/left/cell")))


def test_a_sqlite_bag_is_read(tmp_path: Path) -> None:
    source = write_bag(PART, tmp_path / "mcap")
    assert_same(PART, read_bag(copy_bag(source, tmp_path / "db3", storage=StoragePlugin.SQLITE3)))


def test_a_contour_that_the_last_part_has_not_is_not_taken_from_the_one_before(tmp_path: Path) -> None:
    """Six contours, then a part of the same plan with two."""
    first, second = (make_part(contours=6, spacing=10e-3, stop_after=stop) for stop in (None, 2))
    bags = [
        write_bag(first, tmp_path / "first", end=200_000_000_000),
        write_bag(second, tmp_path / "second", end=300_000_000_000),
    ]
    with open_bag(copy_bag(bags, tmp_path / "both")) as both:
        part = last_part(both)
        assert begin_of_contour(both, 1) >= part.start > 200_000_000_000
        with pytest.raises(IsfError, match="contours 1 to") as caught:
            begin_of_contour(both, 4)
        assert caught.value.code == ErrorCode.BAG_INCOMPLETE


def test_a_damaged_contour_is_told_from_a_fault(bag: Path, tmp_path: Path) -> None:
    """As in a bag without checksums."""
    with Writer(tmp_path / "cut", version=9, storage_plugin=StoragePlugin.MCAP) as writer, Reader(bag) as reader:
        added = {c.id: writer.add_connection(c.topic, c.msgtype, typestore=cell_types()) for c in reader.connections}
        for connection, time, data in reader.messages():
            cut = data[:40] if connection.topic == "/contour/nominal" else data
            writer.write(added[connection.id], time, cut)
    with open_bag(tmp_path / "cut") as cut, pytest.raises(IsfError) as caught:
        begin_of_contour(cut, 0)
    assert caught.value.code == ErrorCode.BAG_UNREADABLE


def test_of_the_states_of_the_machine_only_those_at_begin_and_end_are_looked_into(bag: Path, tmp_path: Path) -> None:
    """A long part has hundreds of thousands: here those between, and those long before it, are no messages at all."""
    name = "/machine/state"
    with Writer(tmp_path / "many", version=9, storage_plugin=StoragePlugin.MCAP) as writer, Reader(bag) as reader:
        added = {c.topic: writer.add_connection(c.topic, c.msgtype, typestore=cell_types()) for c in reader.connections}
        (first, begin), (_, end) = [
            (cell_types().deserialize_cdr(data, c.msgtype), time)
            for c, time, data in reader.messages()
            if c.topic == name
        ]
        for second in (5, 4):
            writer.write(added[name], begin - second * 1_000_000_000, b"nothing")
        started = cell_types().serialize_cdr(replace(first, tick=40), first.__msgtype__)
        writer.write(added[name], begin - 1_000_000, started)
        for connection, time, data in reader.messages():
            if connection.topic != name or time == end:
                writer.write(added[connection.topic], time, data)
            if connection.topic == "/contour/result":
                writer.write(added[name], time, b"nothing")
    assert read_bag(tmp_path / "many").ticks == PART.ticks - 40


def test_the_last_part_of_a_bag_is_read(tmp_path: Path) -> None:
    first = make_part(contours=5, spacing=10e-3)
    second = replace(make_part(contours=5, spacing=10e-3, stop_after=2, seed=9), variant=4)
    bags = [
        write_bag(first, tmp_path / "first", end=200_000_000_000),
        write_bag(second, tmp_path / "second", end=300_000_000_000),
    ]
    both = copy_bag(bags, tmp_path / "both")
    record = read_bag(both)
    assert (record.variant, record.seed) == (4, 9)
    assert len(record.results) == len(second.results)  # none of the first part, whose plan has the same name
    assert record.wall_time == pytest.approx(second.wall_time)


# -- killed recorder ---------------------------------------------------------------------------------


def killed(tmp_path: Path, keep: float, *, metadata: bool) -> Path:
    """A bag of which only the first ``keep`` (0..1) of the file reached the disk."""
    whole = write_bag(make_part(contours=40, spacing=2e-3), tmp_path / "whole")
    cut = tmp_path / "cut"
    shutil.copytree(whole, cut)
    (cut / "whole.mcap").rename(cut / "cut.mcap")
    with (cut / "cut.mcap").open("r+b") as stream:
        stream.truncate(int(keep * stream.seek(0, 2)))
    if not metadata:
        (cut / "metadata.yaml").unlink()
    else:
        text = (cut / "metadata.yaml").read_text()
        (cut / "metadata.yaml").write_text(text.replace("whole.mcap", "cut.mcap"))
    return cut


@pytest.mark.parametrize("metadata", [False, True])
def test_a_killed_recorder_leaves_what_it_wrote(tmp_path: Path, metadata: bool) -> None:
    record = read_bag(killed(tmp_path, 0.6, metadata=metadata))
    assert 0 < len(record.results) < 40
    assert record.failure() is not None
    assert any("by force" in note for note in record.notes)
    assert any("scan" in note for note in record.notes)
    whole = make_part(contours=40, spacing=2e-3)
    assert_same(whole.results[: len(record.results)], record.results)


def test_only_the_end_is_missing_without_metadata(tmp_path: Path) -> None:
    assert len(read_bag(killed(tmp_path, 1.0, metadata=False)).results) == 40


@settings(max_examples=20, deadline=None)
@given(keep=st.floats(0.0, 1.0), noise=st.integers(0, 2**32 - 1))
def test_no_damage_ends_in_a_traceback(keep: float, noise: int, tmp_path_factory: pytest.TempPathFactory) -> None:
    folder = tmp_path_factory.mktemp("damage")
    whole = write_bag(make_part(contours=3, spacing=25e-3, points=12), folder / "bag")
    file = whole / "bag.mcap"
    data = bytearray(file.read_bytes())
    random = np.random.default_rng(noise)
    for position in random.integers(0, len(data), 20):
        data[position] = int(random.integers(256))
    file.write_bytes(data[: int(keep * len(data))])
    outcome: PartRecord | IsfError
    try:
        outcome = read_bag(whole)
    except IsfError as error:
        outcome = error
    if isinstance(outcome, IsfError):
        assert outcome.code in (ErrorCode.BAG_UNREADABLE, ErrorCode.BAG_INCOMPLETE)
        assert outcome.advice
    else:
        assert outcome.plan_id is not None


# -- not a bag of a cell ---------------------------------------------------------------------------


def error_of(path: Path) -> IsfError:
    with pytest.raises(IsfError) as caught:
        read_bag(path)
    assert caught.value.advice
    return caught.value


def test_no_such_bag(tmp_path: Path) -> None:
    assert error_of(tmp_path / "nowhere").code == ErrorCode.BAG_UNREADABLE


def test_an_empty_folder_and_a_text_file(tmp_path: Path) -> None:
    assert error_of(tmp_path).code == ErrorCode.BAG_UNREADABLE
    note = tmp_path / "note.mcap"
    note.write_text("not a bag")
    assert error_of(note).code == ErrorCode.BAG_UNREADABLE
    other = tmp_path / "note.txt"
    other.write_text("not a bag")
    assert error_of(other).code == ErrorCode.BAG_UNREADABLE


def test_a_bag_of_something_else_names_what_it_holds(tmp_path: Path) -> None:
    with Writer(tmp_path / "robot", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection("/odom", "std_msgs/msg/String", typestore=cell_types())
        message = make_message("std_msgs/msg/String", data="hello")
        writer.write(connection, 1, cell_types().serialize_cdr(message, "std_msgs/msg/String"))
    error = error_of(tmp_path / "robot")
    assert error.code == ErrorCode.BAG_INCOMPLETE
    assert "/odom" in error.what
    assert "no topic part/info (needed with contour/nominal and contour/result)" in error.what


@pytest.mark.parametrize(
    ("missing", "named"),
    [({topics.JOB.name}, topics.JOB.name), ({topics.NOMINAL.name, topics.RESULT.name}, "no contour")],
)
def test_a_bag_without_what_is_needed_names_it(missing: set[str], named: str, bag: Path, tmp_path: Path) -> None:
    error = error_of(copy_bag(bag, tmp_path / "less", without=missing))
    assert error.code == ErrorCode.BAG_INCOMPLETE
    assert named in error.what


@pytest.mark.parametrize(
    ("topic", "field"), [(topics.SCAN, "scan"), (topics.TARGET, "target"), (topics.CORRECTION, "corrections")]
)
def test_a_bag_without_what_can_be_missed_is_read(topic: topics.Topic, field: str, bag: Path, tmp_path: Path) -> None:
    record = read_bag(copy_bag(bag, tmp_path / "less", without={topic.name}))
    assert not getattr(record, field)
    assert record.failure() is None
    if topic is not topics.CORRECTION:
        assert any(topic.name in note for note in record.notes)


def older(bag: Path, path: Path, fields: str, kind: str = topics.RESULT.type) -> Path:
    """The bag as a version wrote it whose messages ``kind`` had none of ``fields`` (a pattern): it explains its own
    types."""
    types = get_typestore(Stores.ROS2_JAZZY)
    for message in sorted(message_folder().glob("*.msg")):
        text = message.read_text(encoding="utf-8")
        if message.stem == kind.rpartition("/")[2]:
            text = re.sub(rf"^\S+ ({fields}) .*\n", "", text, flags=re.MULTILINE)
        types.register(get_types_from_msg(text, f"isf_msgs/msg/{message.stem}"))
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer, Reader(bag) as reader:
        added = {c.id: writer.add_connection(c.topic, c.msgtype, typestore=types) for c in reader.connections}
        for connection, time, data in reader.messages():
            written: Any = data
            if connection.msgtype == kind:
                new = cell_types().deserialize_cdr(data, kind)
                values = {name: getattr(new, name) for name, _ in types.fielddefs[kind][1]}
                written = types.serialize_cdr(types.types[kind](**values), kind)
            writer.write(added[connection.id], time, written)
    return path


def test_a_bag_of_an_older_version_names_what_it_lacks(bag: Path, tmp_path: Path) -> None:
    record = read_bag(older(bag, tmp_path / "old", "backoffs|late_ticks"))
    (note,) = record.notes
    assert "older version of the software: contour/result without backoffs, late_ticks" in note
    assert len(record.results) == len(PART.results)
    error = error_of(older(bag, tmp_path / "very old", "forming_force|tick_time|backoffs"))
    assert error.code == ErrorCode.BAG_INCOMPLETE
    assert "another version of the software: contour/result has no forming_force, tick_time, backoffs" in error.what


def test_a_bag_from_before_warnings_of_the_plan_were_kept_is_read(bag: Path, tmp_path: Path) -> None:
    assert_same(PART, read_bag(older(bag, tmp_path / "old", "plan_warnings", topics.JOB.type)))


def test_a_part_of_another_version_is_noted(tmp_path: Path) -> None:
    record = read_bag(write_bag(replace(PART, software="0.0.9"), tmp_path / "bag"))
    assert any("version 0.0.9 of the software" in note for note in record.notes)
    assert not any("version" in note for note in read_bag(write_bag(PART, tmp_path / "same")).notes)


def test_a_bag_of_two_cells_asks_which(bag: Path, tmp_path: Path) -> None:
    other = write_bag(replace(PART, job_name="other"), tmp_path / "other")
    cells = [copy_bag(item, tmp_path / f"cell_{k}", prefix=f"/cell_{k}") for k, item in enumerate((bag, other), 1)]
    both = copy_bag(cells, tmp_path / "both")
    error = error_of(both)
    assert error.code == ErrorCode.FILE_FIELD
    assert "2 cells: /cell_1, /cell_2" in error.message
    assert "--namespace" in error.advice
    assert_same(PART, read_bag(both, "cell_1"))
    assert read_bag(both, "/cell_2/").job_name == "other"
    with pytest.raises(IsfError, match="no cell 'cell_3'"):
        read_bag(both, "cell_3")
    assert read_cell(both, "cell_2").job_name == read_cell(other, "cell_2").job_name == "other"
    with isf_analysis.open(both, "cell_2") as found:
        assert found.part.job_name == "other"
        assert found["contour/nominal"].name == "/cell_2/contour/nominal"
        assert len(found.contours) == PART.planned
        assert found.contours is found.contours
        for name in ("cell_1", "cell_2"):
            assert begin_of_contour(found.raw, 0, name) > 0
        with pytest.raises(IsfError, match="--namespace"):
            begin_of_contour(found.raw, 0)


def test_raw_readings_in_a_bag_disturb_nobody(bag: Path, tmp_path: Path) -> None:
    with Writer(tmp_path / "raw", version=9, storage_plugin=StoragePlugin.MCAP) as writer, Reader(bag) as reader:
        added = {c.id: writer.add_connection(c.topic, c.msgtype, typestore=cell_types()) for c in reader.connections}
        for topic in (item for item in topics.CELL if "/raw" in item.name):
            connection = writer.add_connection(f"/{topic.name}", topic.type, typestore=cell_types())
            writer.write(connection, 1, cell_types().serialize_cdr(make_message(topic.type), topic.type))
        for connection, time, data in reader.messages():
            writer.write(added[connection.id], time, data)
    assert_same(PART, read_bag(tmp_path / "raw"))


def test_results_that_were_lost_are_reported(tmp_path: Path) -> None:
    lost = replace(PART, results=PART.results[:3] + PART.results[5:])
    record = read_bag(write_bag(lost, tmp_path / "bag"))
    assert any("contour/result of 2 contour(s), first contour 4" in note for note in record.notes)
    assert record.failure() is not None


def test_a_bag_is_never_overwritten(bag: Path) -> None:
    with pytest.raises(IsfError) as caught:
        write_bag(PART, bag)
    assert caught.value.code == ErrorCode.BAG_NOT_WRITABLE
    assert_same(PART, read_bag(bag))


def test_a_place_that_cannot_be_written(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(IsfError) as caught:
        write_bag(PART, tmp_path / "file" / "bag")
    assert caught.value.code == ErrorCode.BAG_NOT_WRITABLE


def copy_bag(
    source: Path | list[Path],
    target: Path,
    *,
    prefix: str = "",
    without: set[str] | None = None,
    storage: StoragePlugin = StoragePlugin.MCAP,
) -> Path:
    """Bags copied message by message into one, as another recorder would have written it."""
    with Writer(target, version=9, storage_plugin=storage) as writer:
        written: dict[str, Any] = {}
        for path in source if isinstance(source, list) else [source]:
            with Reader(path) as reader:
                for connection, time, data in reader.messages():
                    if without and connection.topic.lstrip("/") in without:
                        continue
                    if connection.topic not in written:
                        written[connection.topic] = writer.add_connection(
                            prefix + connection.topic, connection.msgtype, typestore=cell_types()
                        )
                    writer.write(written[connection.topic], time, data)
    return target
