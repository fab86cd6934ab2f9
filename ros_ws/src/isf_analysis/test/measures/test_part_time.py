"""The time of a part counts from its beginning, whatever the clock; who waited for it to go on is left out."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from isf_analysis.bag.bag_reader import read_bag
from isf_analysis.bag.bag_writer import write_bag
from isf_analysis.measures.part_time import from_beginning
from isf_analysis.measures.record import PartRecord
from isf_analysis.measures.summary import summary
from isf_core.events import Event, EventKind
from synthetic_part import make_part

EPOCH = 1_760_000_000.0
"""s since 1970, at the start of the first contour."""


def torn_part() -> PartRecord:
    """Four contours from 0 s on; the sheet tears at 3.5 s."""
    part = make_part(contours=4, spacing=4e-3)
    tear = Event(int(EventKind.FRACTURE), 3.5, (0.01, 0.0, -0.01), 1.1, 1.0, "the sheet tears")
    return replace(part, events=(tear,))


def by_clock(part: PartRecord, begin: float = EPOCH, first: int = 0) -> PartRecord:
    """``part`` formed in real time: its contours from ``first`` on, and its events, ``begin`` s later."""
    return replace(
        part,
        lockstep=False,
        results=(
            *part.results[:first],
            *(
                replace(item, start=item.start + begin, end=item.end + begin, tick_time=item.tick_time + begin)
                for item in part.results[first:]
            ),
        ),
        events=tuple(replace(item, time=item.time + begin) for item in part.events),
    )


@pytest.mark.parametrize("begin", [EPOCH, 400.0])
def test_what_is_read_counts_from_the_first_contour(tmp_path: Path, begin: float) -> None:
    """By the clock, and of a later part in a simulated cell that stayed up for 400 s."""
    part = torn_part()
    record = read_bag(write_bag(by_clock(part, begin), tmp_path / "bag"))
    assert record.results[0].start == 0.0
    for read, result in zip(record.results, part.results, strict=True):
        assert read.start == pytest.approx(result.start, abs=1e-5)
        assert read.end == pytest.approx(result.end, abs=1e-5)
        np.testing.assert_allclose(read.tick_time, result.tick_time, atol=1e-5)
    failure = record.failure()
    assert failure is not None
    assert "after 3.5 s" in failure[1]
    numbers = json.loads(json.dumps(summary(record)))
    assert numbers["events"][0]["first"]["time_s"] == pytest.approx(3.5, abs=1e-5)
    assert numbers["events"][0]["first"]["contour"] == 0


def test_a_part_that_begins_at_zero_is_left_as_it_is() -> None:
    part = torn_part()
    assert from_beginning(part) is part
    nothing = replace(part, results=())
    assert from_beginning(nothing) is nothing


def test_the_time_in_which_nobody_formed_is_left_out() -> None:
    """Contours 3 and 4 twelve hours later: nothing passes between the end of contour 2 and the start of contour 3."""
    part = replace(torn_part(), events=())
    record = from_beginning(by_clock(by_clock(part), 43_200.0, first=2), (2,))
    first, second, third, last = record.results
    assert first.start == 0.0
    assert second.start - first.end == pytest.approx(0.4, abs=1e-5)
    assert third.start == pytest.approx(second.end, abs=1e-5)
    assert third.tick_time[0] == pytest.approx(third.start, abs=1e-5)
    assert last.start - third.end == pytest.approx(0.4, abs=1e-5)
    assert summary(record)["time"]["between_s"] == pytest.approx(0.8, abs=1e-4)


def test_what_happened_in_the_meantime_happened_when_the_part_stood_still() -> None:
    part = torn_part()
    late = by_clock(part, 1000.0, first=2)
    record = from_beginning(replace(late, events=(replace(late.events[0], time=500.0),)), (2,))
    assert record.events[0].time == pytest.approx(part.results[1].end)
