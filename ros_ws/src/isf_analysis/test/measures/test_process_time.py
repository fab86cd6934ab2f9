"""Planned beside actual time: the parts add up, and each is what it says."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from isf_analysis.measures.process_time import process_time
from isf_analysis.measures.summary import summary
from isf_analysis.report.finding_tables import time_table
from synthetic_part import make_part

PART = make_part(contours=4, spacing=4e-3)


def test_the_difference_is_accounted_for() -> None:
    found = process_time(PART)
    assert found is not None
    assert found.contours == 4
    # circles at 30 mm/s, of polygons with 120 corners: the chord is 0.011 % shorter than the arc
    lengths = [2 * np.pi * np.hypot(*contour.forming_tip[0, :2]) for contour in PART.nominal]
    assert found.planned == pytest.approx(sum(lengths) / 30e-3, rel=2e-4)
    assert found.actual == pytest.approx(sum(result.end - result.start for result in PART.results))
    assert found.slowed == 0.0
    # the ramp of 50 ticks at 500 Hz, 4 times
    assert found.force_ramps == pytest.approx(4 * 50 / 500.0)
    assert found.rest == 0.0  # all contours are under force control
    parts = (found.planned, found.slowed, found.force_ramps, found.force_control)
    assert sum(parts) == pytest.approx(found.actual)


def test_under_position_control_all_else_is_the_rest() -> None:
    found = process_time(make_part(contours=3, spacing=4e-3, support_force=0.0))
    assert found is not None
    assert found.force_ramps == found.force_control == 0.0
    assert found.rest == pytest.approx(found.actual - found.planned)


def test_lower_speeds_of_the_plan_are_told_apart() -> None:
    half = [replace(contour, speed=np.full(len(contour), 15e-3)) for contour in PART.nominal]
    before, found = process_time(PART), process_time(replace(PART, nominal=tuple(half)))
    assert before is not None
    assert found is not None
    assert found.slowed == pytest.approx(found.planned)
    assert found.force_control == pytest.approx(before.force_control - found.slowed)


def test_the_contour_that_waited_is_named_and_time_between_counts_apart() -> None:
    results = list(PART.results)
    results[2] = replace(results[2], end=results[2].end + 7.0)
    results[3] = replace(results[3], start=results[3].start + 12.0, end=results[3].end + 12.0)
    before, found = process_time(PART), process_time(replace(PART, results=tuple(results)))
    assert before is not None
    assert found is not None
    assert found.slowest == 2
    assert found.actual - before.actual == pytest.approx(7.0)
    assert found.between - before.between == pytest.approx(5.0)


def test_of_a_part_that_went_on_after_a_crash_time_between_leaves_the_new_beginning_out() -> None:
    """Contours 3 and 4 ran on a clock that began anew, beside the times of contours 1 and 2."""
    results = list(PART.results)
    shift = results[2].start - results[0].start
    for k in (2, 3):
        results[k] = replace(results[k], start=results[k].start - shift, end=results[k].end - shift)
    found = process_time(replace(PART, results=tuple(results)))
    assert found is not None
    assert found.between == pytest.approx(2 * 0.4)  # 1 to 2, 3 to 4


@pytest.mark.parametrize("rate", [0.0, -1.0])
def test_without_a_control_rate_what_needs_it_is_not_told(rate: float) -> None:
    numbers = summary(replace(PART, scan=None, control_rate=rate))
    time = numbers["time"]
    assert time["force_ramps_s"] is time["force_control_s"] is numbers["force"]["engaged_s"] is None
    assert time["actual_s"] == pytest.approx(summary(replace(PART, scan=None))["time"]["actual_s"])
    assert "full force control than planned</th><td>–" in time_table(numbers)


def test_without_a_formed_contour_nothing_is_told() -> None:
    assert process_time(replace(PART, results=())) is None
    stopped = make_part(contours=4, spacing=4e-3, stop_after=2)
    found = process_time(stopped)
    assert found is not None
    assert found.contours == stopped.formed
