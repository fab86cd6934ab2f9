"""Which scan is of the finished part, also where the recorder was busy."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest
from isf_analysis.measures.scan_cloud import final_scans

SECOND = 1_000_000_000


def scan(stamp: float) -> Any:
    return SimpleNamespace(header=SimpleNamespace(stamp=SimpleNamespace(sec=int(stamp), nanosec=0)))


@pytest.mark.parametrize("late", [0.0, 0.05, 3.0])
def test_a_result_that_is_received_late_does_not_take_the_scan_away(late: float) -> None:
    """The last contour is formed at 50 s; its result is received ``late`` s after the scan."""
    between, last = scan(40.0), scan(51.0)
    received = [(100 * SECOND, between), (120 * SECOND, last)]
    nominal, results = [90 * SECOND, 110 * SECOND], [95 * SECOND, int((120 + late) * SECOND)]
    assert final_scans(received, nominal, results, 50.0) == [last]


def test_a_scan_before_the_last_contour_is_not_final() -> None:
    received = [(100 * SECOND, scan(40.0)), (115 * SECOND, scan(45.0))]
    assert final_scans(received, [110 * SECOND], [120 * SECOND], 50.0) == []
