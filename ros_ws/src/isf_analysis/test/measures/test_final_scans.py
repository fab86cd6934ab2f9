"""Which scan is of the finished part, also where the recorder was busy."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import pytest
from isf_analysis.measures.scan_cloud import final_scans

SECOND = 1_000_000_000


def scan(stamp: float) -> Any:
    return SimpleNamespace(header=SimpleNamespace(stamp=SimpleNamespace(sec=int(stamp), nanosec=0)))


@pytest.mark.parametrize("late", [-3.0, 0.0, 3.0])
def test_the_order_of_receipt_does_not_matter(late: float) -> None:
    """The last contour is formed at 50 s; the scan after it is received early or late."""
    between, last = scan(40.0), scan(51.0)
    assert final_scans([(100 * SECOND, between), (int((120 + late) * SECOND), last)], 50.0) == [last]


def test_a_scan_before_the_last_contour_is_not_final_however_late_it_is_received() -> None:
    assert final_scans([(100 * SECOND, scan(40.0)), (1150 * SECOND, scan(45.0))], 50.0) == []


def test_a_scan_in_lockstep_has_the_stamp_of_the_end_of_the_contour() -> None:
    last = scan(50.0)
    assert final_scans([(1, last)], 50.0) == [last]


def test_without_the_end_of_the_last_contour_the_time_of_receipt_decides() -> None:
    """A contour was begun at 110 s and no result of it came."""
    before, after = scan(52.0), scan(60.0)
    received = [(100 * SECOND, before), (115 * SECOND, after)]
    assert final_scans(received, 50.0, 110 * SECOND) == [after]
    assert final_scans(received, math.inf, 110 * SECOND) == [after]


def test_a_scan_without_a_stamp_is_judged_by_its_receipt() -> None:
    early, late = scan(0.0), scan(0.0)
    received = [(100 * SECOND, early), (115 * SECOND, late)]
    assert final_scans(received, 50.0, ended=110 * SECOND) == [late]
