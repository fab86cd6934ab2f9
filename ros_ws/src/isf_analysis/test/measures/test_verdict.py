"""A part is good only when it is; else the headline says what it falls short of."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from isf_analysis.measures.record import PartRecord
from isf_analysis.measures.summary import summary
from isf_analysis.report.result_tables import banners
from isf_core.contour import ContourCorrection
from isf_core.errors import ErrorCode
from isf_core.events import Event, EventKind
from isf_core.geometry.height_map import HeightMap
from synthetic_part import make_part

PART = make_part(contours=6, spacing=2.5e-3)
assert PART.target is not None
EXACT = replace(PART, scan=PART.target)


def off_by(error: float, part: PartRecord = EXACT) -> PartRecord:
    """``part`` with all of its shape ``error`` m too high."""
    target = part.target
    assert target is not None
    return replace(part, scan=HeightMap(target.x, target.y, target.z + error))


def without_contact() -> PartRecord:
    """Exact, position controlled, and the support tool without a force at every second point."""
    part = make_part(spacing=2.5e-3, contours=3, support_force=0.0)
    results = []
    for result in part.results:
        force = result.support_force.copy()
        force[::2] = 0.0
        results.append(replace(result, support_force=force))
    return replace(part, results=tuple(results), scan=part.target)


def reported(part: PartRecord) -> list[str]:
    numbers = summary(part)
    assert numbers["verdict"]["good"] == (not numbers["verdict"]["short_of"])
    return list(numbers["verdict"]["short_of"])


def test_a_part_without_a_flaw_is_good_and_its_headline_green() -> None:
    assert reported(EXACT) == []
    assert 'class="banner good"' in banners(summary(EXACT), has_reference=True)
    assert reported(off_by(0.29e-3)) == []


FLAWS = {
    "tolerance": (off_by(0.31e-3), "error out of tolerance: 0 % of the points"),
    "not corrected": (
        off_by(0.31e-3, replace(EXACT, correction="none", corrections=())),
        "springback was not corrected",
    ),
    "no scan": (replace(EXACT, scan=None), "the shape was not measured"),
    "torn": (
        replace(EXACT, events=(Event(EventKind.GALLING, 1.0, (0.0, 0.0, 0.0), 2.0, 1.0, "the tool galls"),)),
        "galling, 1 times: the tool galls",
    ),
    "no contact": (without_contact(), "contact lost: the support tool is under position control"),
}


@pytest.mark.parametrize("flaw", FLAWS)
def test_a_flaw_takes_the_green_away_and_is_named(flaw: str) -> None:
    part, words = FLAWS[flaw]
    assert any(text.startswith(words) for text in reported(part)), reported(part)
    page = banners(summary(part), has_reference=True)
    assert 'class="banner good"' not in page
    assert "Part complete, but not good" in page


def test_a_correction_that_failed_is_reported_even_of_a_part_in_tolerance() -> None:
    failed = ContourCorrection(
        EXACT.plan_id,
        2,
        "fused",
        np.zeros((4, 3)),
        np.zeros(4),
        code=int(ErrorCode.SCAN_MISSING),
        message="no scan came",
    )
    assert reported(replace(EXACT, corrections=(failed,))) == ["not corrected: 1320: no scan came"]


def test_a_part_that_ended_early_is_not_good() -> None:
    numbers = summary(make_part(spacing=2.5e-3, contours=5, stop_after=3))
    assert not numbers["verdict"]["good"]
    assert numbers["verdict"]["short_of"] == [numbers["failure"]["message"]]
