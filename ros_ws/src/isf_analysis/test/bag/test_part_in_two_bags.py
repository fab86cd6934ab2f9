"""A part in two bags: formed, killed, and gone on with; read as one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from isf_analysis.bag.bag_reader import read_bag
from isf_analysis.bag.bag_writer import write_bag
from isf_analysis.bag.open_bag import next_bag, open_bag
from isf_analysis.bag.playback import begin_of_contour
from isf_analysis.bag.topics import cell_types
from isf_analysis.measures.process_time import process_time
from isf_analysis.measures.record import PartRecord
from rosbags.rosbag2 import Reader, StoragePlugin, Writer
from synthetic_part import make_part

CONTOURS, AT = 6, 3
SECOND = 1_000_000_000


def part_of(contours: slice, depth: float) -> PartRecord:
    """Some contours of the part; the first result is marked by a force of ``depth`` N."""
    whole = make_part(contours=CONTOURS, spacing=10e-3, points=12)
    results = tuple(replace(item, forming_force=np.full((12, 3), depth)) for item in whole.results[contours])
    return replace(
        whole,
        nominal=whole.nominal[contours],
        corrected=whole.corrected[contours],
        corrections=whole.corrections[contours],
        results=results,
    )


def changed_bag(
    source: Path, target: Path, first_index: int, *, second: int = 0, before: Sequence[tuple[str, bytes]] = ()
) -> Path:
    """The bag as that of a part that begins at contour ``first_index``, announced at ``second`` s; ``before`` its
    messages others, of a topic and data, a second earlier."""
    types = cell_types()
    with Writer(target, version=9, storage_plugin=StoragePlugin.MCAP) as writer, Reader(source) as reader:
        added = {c.topic: writer.add_connection(c.topic, c.msgtype, typestore=types) for c in reader.connections}
        for topic, data in before:
            writer.write(added[topic], reader.start_time - SECOND, data)
        for connection, time, data in reader.messages():
            kept: Any = data
            if connection.topic == "/part/info":
                message = types.deserialize_cdr(data, connection.msgtype)
                message.header.stamp.sec = second
                kept = types.serialize_cdr(replace(message, first_index=first_index), connection.msgtype)
            writer.write(added[connection.topic], time, kept)
    return target


def run_in_two_bags(folder: Path) -> Path:
    """Contours 0 to 4, then again 3 to 5: the second one was killed after its last checkpoint, before contour 3."""
    write_bag(part_of(slice(0, 5), 100.0), folder / "bag", end=200 * SECOND)
    source = write_bag(part_of(slice(AT, CONTOURS), 300.0), folder / "later", end=900 * SECOND)
    changed_bag(source, next_bag(folder / "bag"), AT)
    return folder


def test_two_bags_are_one_part(tmp_path: Path) -> None:
    record = read_bag(run_in_two_bags(tmp_path))
    assert record.failure() is None
    assert [result.index for result in record.results] == list(range(CONTOURS))
    forces = [float(result.forming_force[0, 2]) for result in record.results]
    assert forces == [100.0] * AT + [300.0] * (CONTOURS - AT)
    assert record.formed == record.planned == CONTOURS
    assert not any("not in the bag" in note for note in record.notes)


def test_the_time_in_which_nobody_formed_is_not_counted(tmp_path: Path) -> None:
    assert read_bag(run_in_two_bags(tmp_path)).wall_time < 600.0


@pytest.mark.parametrize("first_index", [0, AT])
def test_a_rest_that_was_refused_leaves_the_part_as_it_was(tmp_path: Path, first_index: int) -> None:
    """The cell that is up formed another part meanwhile, of which the recorder got what is latched, and more."""
    write_bag(part_of(slice(0, 5), 100.0), tmp_path / "bag", end=200 * SECOND)
    alone = read_bag(tmp_path / "bag")
    other = part_of(slice(0, CONTOURS), 300.0)
    other = replace(
        other,
        plan_id="other",
        job_name="other",
        target=None,
        ticks=77,
        nominal=tuple(replace(item, plan_id="other") for item in other.nominal),
        corrected=(),
        corrections=(),
        results=tuple(replace(item, plan_id="other") for item in other.results),
    )
    source = write_bag(other, tmp_path / "other", end=900 * SECOND)
    changed_bag(source, next_bag(tmp_path / "bag"), first_index, second=400)
    record = read_bag(tmp_path / "bag")
    assert (record.job_name, record.plan_id) == ("cone", "cone-plan")
    assert [float(item.forming_force[0, 2]) for item in record.results] == [100.0] * 5
    assert record.target is not None
    assert record.ticks == alone.ticks
    assert record.wall_time == alone.wall_time
    assert [len(record.events), len(record.scans)] == [len(alone.events), len(alone.scans)]


def test_a_rest_goes_on_after_one_that_was_refused(tmp_path: Path) -> None:
    write_bag(part_of(slice(0, 5), 100.0), tmp_path / "bag", end=200 * SECOND)
    other = replace(part_of(slice(0, 1), 200.0), plan_id="other")
    changed_bag(write_bag(other, tmp_path / "other", end=500 * SECOND), next_bag(tmp_path / "bag"), 0, second=400)
    source = write_bag(part_of(slice(AT, CONTOURS), 300.0), tmp_path / "later", end=900 * SECOND)
    changed_bag(source, next_bag(tmp_path / "bag"), AT, second=800)
    record = read_bag(tmp_path)
    assert record.failure() is None
    assert [float(item.forming_force[0, 2]) for item in record.results] == [100.0] * AT + [300.0] * (CONTOURS - AT)


def test_by_the_clock_the_time_in_which_nobody_formed_is_no_time_of_the_process(tmp_path: Path) -> None:
    """Contours 0 to 2 at 100 s and 3 to 5 at 800 s by the clock: nobody formed from 200 s on."""

    def clocked(contours: slice, begin: float) -> PartRecord:
        part = part_of(contours, begin)
        moved = tuple(
            replace(item, start=item.start + begin, end=item.end + begin, tick_time=item.tick_time + begin)
            for item in part.results
        )
        return replace(part, lockstep=False, results=moved)

    write_bag(clocked(slice(0, AT), 100.0), tmp_path / "bag", end=200 * SECOND)
    rest = replace(clocked(slice(AT, CONTOURS), 800.0), sim_time=900.0, wall_time=100.0)
    changed_bag(write_bag(rest, tmp_path / "later", end=900 * SECOND), next_bag(tmp_path / "bag"), AT, second=800)
    record = read_bag(tmp_path)
    assert record.sim_time == pytest.approx(900.0 - 600.0)  # by the stamps of its states it began at 0 s
    whole = make_part(contours=CONTOURS, spacing=10e-3, points=12)
    assert record.formed == CONTOURS
    found = process_time(record)
    assert found is not None
    assert found.between == pytest.approx(4 * 0.4, abs=1e-6)
    assert record.results[-1].end == pytest.approx(whole.results[-1].end - 0.4, abs=1e-6)


def test_a_contour_is_played_from_where_it_was_formed_for_good(tmp_path: Path) -> None:
    run = run_in_two_bags(tmp_path)
    with open_bag(run) as bag:
        assert begin_of_contour(bag, 2) < 300 * SECOND < begin_of_contour(bag, 4)
        with Reader(run / "bag") as first, Reader(run / "bag_resumed_1") as second:
            assert bag.message_count == first.message_count + second.message_count
            assert bag.duration == second.end_time - first.start_time
            names = {connection.topic for connection in first.connections}
        assert sorted(connection.topic for connection in bag.connections) == sorted(names)


def test_a_bag_that_holds_nothing_is_left_out(tmp_path: Path) -> None:
    """Killed once more before the recorder wrote anything."""
    run = run_in_two_bags(tmp_path)
    next_bag(run / "bag").mkdir()
    record = read_bag(run)
    assert record.formed == CONTOURS
    assert any("left out" in note for note in record.notes)
    assert next_bag(run / "bag").name == "bag_resumed_3"


@pytest.mark.parametrize("between", [False, True])
def test_what_is_latched_in_a_cell_that_stayed_up_is_left_out(tmp_path: Path, between: bool) -> None:
    """The second recorder receives the last announcement and contour of the first once more, or, ``between`` the two,
    those of the same job formed in another folder."""
    one = write_bag(part_of(slice(0, AT), 100.0), tmp_path / "one", end=200 * SECOND)
    other = write_bag(part_of(slice(AT, CONTOURS), 300.0), tmp_path / "other", end=900 * SECOND)
    bag = changed_bag(one, tmp_path / "bag", 0, second=100)
    said = changed_bag(one, tmp_path / "between", 0, second=400) if between else bag
    topics = ("/part/info", "/contour/nominal", "/contour/corrected")
    with Reader(said) as first:
        latched = {connection.topic: data for connection, _, data in first.messages() if connection.topic in topics}
    assert set(latched) == set(topics)
    changed_bag(other, next_bag(bag), AT, second=800, before=list(latched.items()))
    record = read_bag(bag)
    assert record.failure() is None
    assert [float(item.forming_force[0, 2]) for item in record.results] == [100.0] * AT + [300.0] * (CONTOURS - AT)
