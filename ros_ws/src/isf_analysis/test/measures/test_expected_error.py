"""What corrections expect of themselves, beside what was reached; nothing known is never told as 0."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from isf_analysis.bag.bag_reader import read_bag
from isf_analysis.bag.bag_writer import write_bag
from isf_analysis.figures import style
from isf_analysis.measures.contour_scan import ScanError
from isf_analysis.measures.expected_error import expected_error, overconfident, sizes
from isf_analysis.measures.part_tables import contour_table
from isf_analysis.measures.record import PartRecord
from isf_analysis.measures.summary import summary
from isf_analysis.report import finding_tables, result_tables
from isf_analysis.report.page import write_report
from isf_core.geometry.height_map import HeightMap
from synthetic_part import make_part

PLAIN = make_part(contours=6, spacing=2.5e-3)  # its largest error is 2.0 mm


def expecting(left: float, deviation: float | None, *, part: PartRecord = PLAIN) -> PartRecord:
    """``part`` whose corrections foresee ``left`` m with a standard ``deviation`` m, None: untold."""
    corrections = [
        replace(
            item,
            residual=np.full(len(item.offset), left),
            uncertainty=np.empty(0) if deviation is None else np.full(len(item.offset), deviation),
        )
        for item in part.corrections
    ]
    return replace(part, corrections=tuple(corrections))


def test_an_unbiased_prediction_expects_the_mean_of_a_folded_normal() -> None:
    """0.798 standard deviations; the largest is that of the least certain place."""
    largest, mean = sizes(np.zeros(4), np.array([0.1, 0.1, 0.2, 0.4]))
    assert largest == pytest.approx(0.4 * 0.7979, rel=0.01)
    assert mean == pytest.approx(0.2 * 0.7979, rel=0.01)
    assert sizes(np.array([-0.5, 0.2]), np.zeros(2)) == pytest.approx((0.5, 0.35))
    assert np.isnan(sizes(np.empty(0), np.empty(0))).all()


lengths = st.floats(-5e-3, 5e-3)


@given(st.lists(st.tuples(lengths, st.floats(0.0, 3e-3)), min_size=1, max_size=20), st.floats(1.0, 3.0))
def test_more_uncertain_is_never_expected_to_be_better(places: list[tuple[float, float]], factor: float) -> None:
    left, deviation = np.array(places).T
    largest, mean = sizes(left, deviation)
    assert largest >= mean - 1e-12
    assert largest >= np.abs(left).max() - 1e-9  # the largest of means is at most the mean of the largest
    wider = sizes(left, factor * deviation)
    assert wider[0] >= largest - 1e-9
    assert wider[1] >= mean - 1e-9


def test_what_no_limit_cuts_off_is_not_expected_to_be_right() -> None:
    """A method that foresees nothing and is good to 1 mm expects 0.8 mm, with the 0.2 mm that no two parts are alike
    by a little more."""
    found = expected_error(expecting(0.0, 1e-3))
    assert found.largest == pytest.approx(0.7979 * np.hypot(1.0, 0.2) * 1e-3, rel=0.01)
    assert found.mean == pytest.approx(found.largest)
    assert expected_error(expecting(0.0, 1e-6)).largest == pytest.approx(0.7979 * 0.2e-3, rel=0.01)
    assert "analytic" in found.stands_on


@pytest.mark.parametrize(
    ("part", "why"),
    [
        (make_part(contours=3, spacing=10e-3, correction="none"), "springback is not corrected"),
        (PLAIN, "does not tell how uncertain"),
        (expecting(0.0, None), "does not tell how uncertain"),
        (expecting(0.0, 0.0), "does not tell how uncertain"),  # springback that is taken for 0 without a force
        (expecting(0.0, float("nan")), "does not tell how uncertain"),
        (replace(expecting(0.0, 1e-3), target=None), "not recorded"),
        (replace(expecting(0.0, 1e-3), corrections=()), "does not tell how uncertain"),
    ],
)
def test_nothing_known_is_not_known_and_never_zero(part: PartRecord, why: str) -> None:
    found = summary(part)["expected_error"]
    assert found["largest_mm"] is found["mean_mm"] is found["reached_over_expected"] is found["overconfident"] is None
    assert why in found["not_known"]
    assert "not known" in result_tables.cards(summary(part))
    assert "not known" in finding_tables.expected_table(summary(part)) or part.correction == "none"


def scan(part: PartRecord, index: int, error: float, seen_from: float) -> ScanError:
    """``error`` m wherever the target lies higher than ``seen_from`` m."""
    assert part.target is not None
    z = np.where(part.target.z > seen_from, error, np.nan)
    return ScanError(index, HeightMap(part.target.x, part.target.y, z), 1.0, abs(error), abs(error), error)


def test_a_scan_stands_for_what_it_saw_and_makes_the_rest_as_doubtful() -> None:
    part = expecting(0.0, 0.1e-3)
    all_seen = expected_error(part, [scan(part, 4, 0.7e-3, -1.0)])
    # one scan tells nothing of what moves on: 0.1 mm by the method and 0.2 mm from part to part, as without it
    assert all_seen.largest == pytest.approx(0.7e-3, rel=0.01)
    assert all_seen.mean == pytest.approx(0.7e-3, rel=0.01)
    assert "the scan after contour 5 of 6" in all_seen.stands_on
    half = expected_error(part, [scan(part, 2, 0.7e-3, -10e-3)])
    # the places still to come are off by as much as the scan was off what was expected of it: 0.8 of 0.7 mm
    assert half.largest == pytest.approx(
        np.mean(np.maximum(np.abs(0.7 + 0.2236 * normal()), 0.7 * np.abs(normal()))) * 1e-3, rel=0.02
    )
    assert half.mean < 0.7e-3


def test_one_scan_of_a_part_that_was_right_then_promises_no_perfect_part() -> None:
    part = expecting(0.0, 0.4e-3)
    without = expected_error(part)
    scanned = expected_error(part, [scan(part, 2, 0.0, -1.0)])
    assert scanned.largest == pytest.approx(without.largest)
    assert overconfident(1e3 * scanned.largest, 3.0)


def normal() -> np.ndarray:
    return np.random.default_rng(1).standard_normal(200_000)


def test_what_moved_from_scan_to_scan_moves_on() -> None:
    part = expecting(0.0, 0.1e-3)
    still = expected_error(part, [scan(part, 1, 0.5e-3, -1.0), scan(part, 3, 0.5e-3, -1.0)])
    assert still.largest == pytest.approx(0.5e-3, rel=0.01)  # 0.2 mm from part to part
    # 0.4 mm in two contours, two are left: a standard deviation of 0.4 mm, and those 0.2 mm
    moving = expected_error(part, [scan(part, 1, 0.1e-3, -1.0), scan(part, 3, 0.5e-3, -1.0)])
    assert moving.largest == pytest.approx(np.mean(np.abs(0.5 + 0.4472 * normal())) * 1e-3, rel=0.02)


def test_a_scan_tells_the_uncertainty_of_a_method_that_does_not() -> None:
    part = expecting(0.0, None)
    found = expected_error(part, [scan(part, 4, 0.7e-3, -15e-3)])
    assert 0.7e-3 <= found.largest < 0.9e-3
    assert found.stands_on == "the scan after contour 5 of 6"


def test_the_scan_of_the_finished_part_is_not_used() -> None:
    """Nor one that was made after the last contour: it would tell what is to be predicted."""
    part = expecting(0.0, 1e-3)
    assert expected_error(part, [scan(part, 5, 3e-3, -1.0)]) == expected_error(part)
    assert part.scan is not None
    worse = replace(part, scan=HeightMap(part.scan.x, part.scan.y, part.scan.z + 4e-3))
    assert expected_error(worse) == expected_error(part)


def test_overconfident_is_more_than_one_and_a_half_times_as_much() -> None:
    assert overconfident(1.0, 1.5) is False
    assert overconfident(1.0, 1.501) is True
    assert overconfident(None, 1.0) is overconfident(1.0, None) is overconfident(0.0, 1.0) is None


def test_report_and_bag_tell_expected_beside_reached(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(style, "DPI", 34)
    part = expecting(0.0, 0.4e-3)
    numbers = summary(part)["expected_error"]
    reached = summary(part)["deviation"]["max_mm"]
    assert numbers["largest_mm"] == pytest.approx(0.7979 * np.hypot(0.4, 0.2), rel=0.01)
    assert numbers["reached_over_expected"] == pytest.approx(reached / numbers["largest_mm"])
    assert numbers["overconfident"] is True
    again = read_bag(write_bag(part, tmp_path / "bag"))
    assert summary(again)["expected_error"] == numbers
    html = write_report(again, tmp_path).html.read_text(encoding="utf-8")
    assert "Worse than expected" in html
    assert "Expected beside reached error. Stands on: the standard deviation that analytic gives" in html
    calm = write_report(expecting(0.0, 2e-3), tmp_path).html.read_text(encoding="utf-8")
    assert "Worse than expected" not in calm
    assert "Expected largest error" in calm


def test_the_table_of_contours_tells_sizes_with_the_uncertainty() -> None:
    rows = contour_table(expecting(0.1e-3, 0.5e-3))
    assert rows["expected_error_mean_m"] == pytest.approx(0.1e-3)
    expected = np.mean(np.abs(0.1 + np.hypot(0.5, 0.2) * normal())) * 1e-3
    assert rows["expected_error_max_m"] == pytest.approx(expected, rel=0.02)
    untold = contour_table(expecting(0.0, None))
    assert np.isnan(untold["expected_error_mean_abs_m"]).all()
    assert np.isnan(untold["expected_error_max_m"]).all()


def test_a_part_that_ended_early_is_not_held_against_what_was_expected() -> None:
    part = expecting(0.0, 0.1e-3, part=make_part(contours=6, spacing=2.5e-3, stop_after=3))
    found = summary(part)["expected_error"]
    assert found["reached_largest_mm"] is found["overconfident"] is None
