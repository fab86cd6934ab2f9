"""A recorded part as the page gets it: a synthetic cone of 42 contours whose shape is known exactly."""

from __future__ import annotations

import asyncio
import base64
import json
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from isf_analysis.bag.bag_reader import read_bag
from isf_analysis.bag.bag_writer import write_bag
from isf_analysis.measures.record import PartRecord
from isf_analysis.measures.summary import deviation_of
from isf_core.contour import Process
from isf_core.errors import ErrorCode, IsfError
from isf_core.geometry.height_map import HeightMap
from isf_core.types import Array
from isf_dashboard.history import COLUMNS, Cursor, History
from isf_dashboard.part_feed import Job, PartFeed
from isf_dashboard.run_source import history_of
from synthetic_part import make_events, make_part


@cache
def part() -> PartRecord:
    made = make_part()
    return replace(made, events=make_events(made))


def items_of(history: History) -> dict[str, list[dict[str, Any]]]:
    """All that is told, by kind."""
    found: dict[str, list[dict[str, Any]]] = {}
    cursor = Cursor()
    while (text := history.news(cursor)) is not None:
        for item in json.loads(text).get("items", []):
            found.setdefault(item["kind"], []).append(item)
    return found


def unpacked(value: dict[str, Any]) -> Array:
    kind = np.uint8 if value["kind"] == "u1" else np.dtype("<f4")
    return np.frombuffer(base64.b64decode(value["data"]), dtype=kind).reshape(value["shape"])


def test_a_run_is_told_whole() -> None:
    record = part()
    history = history_of(record)
    items = items_of(history)
    count = len(record.nominal)
    assert count == 42
    assert {kind: len(found) for kind, found in items.items() if kind != "event"} == {
        "job": 1,
        "target": 1,
        "contour": count,
        "correction": count,
        "result": count,
        "scan": 1,
    }
    assert [item["index"] for item in items["contour"]] == list(range(count))
    assert len(items["event"]) >= len(record.events)
    table = history.table()
    assert (np.diff(table[:, 0]) >= 0.0).all()
    assert history.status["end"] == pytest.approx(items["result"][-1]["t"])
    # a tool is where the contour was formed
    tips = table[:, [COLUMNS.index(name) for name in ("x1", "y1", "z1")]]
    of_last = tips[table[:, COLUMNS.index("contour")] == count - 1]
    distance = np.linalg.norm(of_last[:, None] - 1e3 * record.results[-1].forming_target[None], axis=2).min(axis=1)
    assert distance.max() < 1.5  # mm, between two points 2 mm apart


def test_the_deviation_is_that_of_the_report() -> None:
    """Of the nodes that are drawn; the largest of wall and base."""
    record = part()
    deviation = deviation_of(record)
    assert deviation is not None
    items = items_of(history_of(record))
    (scan,), (target,) = items["scan"], items["target"]
    assert scan["final"]
    assert scan["largest"] == pytest.approx(1e3 * deviation.whole.max_abs)
    assert scan["mean"] == pytest.approx(1e3 * deviation.whole.mean_abs)
    drawn = unpacked(scan["deviation"])
    assert drawn.shape == unpacked(target["z"]).shape == unpacked(target["opening"]).shape
    assert drawn.size <= 20_000
    assert record.target is not None
    columns = np.abs(1e3 * record.target.x[None] - unpacked(target["x"])[:, None]).argmin(axis=1)
    rows = np.abs(1e3 * record.target.y[None] - unpacked(target["y"])[:, None]).argmin(axis=1)
    np.testing.assert_allclose(drawn, 1e3 * deviation.error.z[np.ix_(rows, columns)], atol=1e-5)


def test_the_part_grows_downwards_contour_by_contour() -> None:
    items = items_of(history_of(part()))
    levels = [item["levels"]["1"] for item in items["contour"]]
    assert (np.diff(levels) < 0.0).all()
    lowest = unpacked(items["target"][0]["z"]).min()
    assert lowest == pytest.approx(-21.0, abs=1e-3)
    assert levels[0] > -1.5
    assert levels[-1] < 0.9 * lowest


@pytest.mark.parametrize(("process", "levelled"), [(Process.ADSIF, False), (Process.TPIF, True)])
def test_other_processes_grow_in_their_own_way(process: Process, levelled: bool) -> None:
    """Accumulative forming has no level; over a die it is that of the holder."""
    record = part()
    nominal = tuple(replace(contour, process=process, holder_height=-0.01) for contour in record.nominal)
    items = items_of(history_of(replace(record, nominal=nominal)))
    assert all(bool(item["levels"]) == levelled for item in items["contour"])
    if levelled:
        assert items["contour"][0]["levels"]["1"] == pytest.approx(-10.0)


def test_a_part_that_broke_off_and_lacks_much_is_told_as_far_as_it_goes() -> None:
    record = part()
    broken = replace(record.results[3], completed=False, code=int(ErrorCode.STOPPED), message="stopped")
    cut = replace(
        record,
        results=(*record.results[:3], broken),
        nominal=record.nominal[:5],
        target=None,
        scan=None,
        corrections=(),
        faults=((int(ErrorCode.STOP_REQUESTED), "stopped at the dashboard"),),
        notes=("not in the bag: scan",),
        plan_warnings=("steep",),
        job_text="not a job",
    )
    items = items_of(history_of(cut))
    assert len(items["contour"]) == 5
    assert "target" not in items
    assert items["job"][0]["force_limits"] is None
    told = {(item["severity"], item.get("code")) for item in items["event"]}
    assert {("fault", 1207), ("fault", 1406), ("note", None)} <= told
    assert "the plan warned: steep" in [item["text"] for item in items["event"]]


def test_time_that_began_anew_goes_on() -> None:
    """A part that went on after a crash, by the clock of another run."""
    record = part()
    back = record.results[20].start
    moved = tuple(
        replace(result, start=result.start - back, end=result.end - back, tick_time=result.tick_time - back)
        for result in record.results[20:]
    )
    table = history_of(replace(record, results=(*record.results[:20], *moved))).table()
    assert (np.diff(table[:, 0]) >= 0.0).all()


def test_a_fault_that_several_tell_is_told_once_and_again_when_it_comes_back() -> None:
    history = History("live")
    feed = PartFeed(history)
    text = "[1402 TARGET_JUMP] machine: target jumps"
    feed.fault(1.0, "machine", 1, text)
    feed.fault(1.1, "machine fault 1402", 1402, "target jumps")
    feed.fault(5.0, "machine", 1, text)
    feed.well("machine")
    feed.fault(9.0, "machine", 1, text)
    told = items_of(history)["event"]
    assert [(item["t"], item["code"], item["name"]) for item in told] == [
        (1.0, 1402, "TARGET_JUMP"),
        (9.0, 1402, "TARGET_JUMP"),
    ]


def test_contours_of_another_plan_are_not_of_this_part() -> None:
    record, history = part(), History("live")
    feed = PartFeed(history)
    job = Job("cone", "", "another plan", "DSIF", "none", 0.0, 0, True, "", "")
    feed.job(0.0, job)
    feed.nominal(0.0, record.nominal[0])
    feed.result(0.0, record.results[0])
    feed.job(1.0, replace(job, plan_id=record.plan_id))
    feed.nominal(1.0, record.nominal[0])
    feed.job(2.0, replace(job, plan_id=record.plan_id, first_index=1, began=5.0))  # the same part goes on
    items = items_of(history)
    assert [item["t"] for item in items["contour"]] == [1.0]
    assert "result" not in items


def test_paths_that_came_before_their_job_are_told_with_it_whether_the_target_has_come_or_not() -> None:
    history = History("live")
    feed = PartFeed(history)
    feed.path(0.0, 1, np.zeros((2, 3)))
    feed.path(0.0, 2, np.ones((2, 3)))
    feed.job(1.0, Job("cone", "", "plan", "DSIF", "none", 0.0, 0, True, "", ""))
    assert [(item["t"], item["tool"]) for item in items_of(history)["path"]] == [(1.0, 1), (1.0, 2)]


def test_a_flood_of_events_has_an_end() -> None:
    history = History("live")
    feed = PartFeed(history)
    for number in range(3000):
        feed.event(float(number), make_events(part())[0])
    told = items_of(history)["event"]
    assert len(told) == 1001
    assert "more events" in told[-1]["text"]


def test_a_run_by_the_clock_counts_from_its_beginning(tmp_path: Path) -> None:
    """Its stamps are s since 1970: as float32, as the page gets them, they are 128 s apart."""
    record = part()
    began = 1_760_000_000.0
    moved = tuple(
        replace(item, start=item.start + began, end=item.end + began, tick_time=item.tick_time + began)
        for item in record.results
    )
    bag = write_bag(replace(record, lockstep=False, results=moved), tmp_path / "bag")
    history = history_of(read_bag(bag))
    seconds = history.table()[:, 0].astype(np.float32)
    assert seconds[0] == 0.0
    assert len(np.unique(seconds)) > 0.99 * len(seconds)
    assert history.status["end"] == pytest.approx(record.results[-1].end, abs=1e-3)


def test_a_flat_target_does_not_leave_the_shape_of_the_part_before() -> None:
    record, history = part(), History("live")
    assert record.target is not None
    flat = HeightMap(record.target.x, record.target.y, np.zeros_like(record.target.z))
    feed = PartFeed(history)
    feed.target(0.0, record.target)
    feed.job(0.0, Job("cone", "", "plan", "DSIF", "none", 0.0, 0, True, "", ""))
    assert "target" in items_of(history)
    feed.target(1.0, flat)
    feed.job(1.0, Job("flat", "", "another plan", "DSIF", "none", 0.0, 0, True, "", ""))
    feed.nominal(1.0, replace(record.nominal[0], plan_id="another plan"))
    items = items_of(history)
    assert "target" not in items
    assert items["contour"][0]["levels"] == {}


@pytest.mark.parametrize("answers", [True, False])
def test_a_service_without_an_answer_is_told_on_python_3_10(answers: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """There the error of asyncio is none of Python's own."""
    node = pytest.importorskip("isf_dashboard.dashboard_node")

    class OwnError(Exception):
        pass

    async def wait_for(waiting: Any, _: float) -> None:
        waiting.close()
        if not answers:
            raise OwnError

    monkeypatch.setattr("asyncio.TimeoutError", OwnError)
    monkeypatch.setattr("asyncio.wait_for", wait_for)
    answer = SimpleNamespace(
        add_done_callback=lambda _: None, done=lambda: answers, cancel=lambda: None, result=lambda: 7
    )
    client = SimpleNamespace(srv_name="/stop", service_is_ready=lambda: True, call_async=lambda _: answer)
    asked = node.DashboardNode._asked(None, client, None, patience=0.1)
    if answers:
        assert asyncio.run(asked) == 7
        return
    with pytest.raises(IsfError) as caught:
        asyncio.run(asked)
    assert caught.value.code is ErrorCode.SERVICE_TIMEOUT
