"""The JSON object of a part: complete, of the same numbers as the metrics, without NaN."""

from __future__ import annotations

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from isf_analysis.figures import process_figures, style
from isf_analysis.measures.deviation import compare, regions_of
from isf_analysis.measures.force_metrics import force_metrics
from isf_analysis.measures.record import PartRecord
from isf_analysis.measures.summary import summary
from isf_analysis.report.result_tables import cards, force_table, job_table
from isf_core.errors import ErrorCode
from isf_core.geometry.height_map import HeightMap
from synthetic_part import make_part

PART = make_part(contours=6)
REFERENCE = make_part(contours=6, correction="none")


def test_the_numbers_are_those_of_the_metrics_in_the_units_of_their_names() -> None:
    numbers = summary(PART, bag="runs/x/bag", report="runs/x/report.html")
    assert PART.scan is not None
    assert PART.target is not None
    deviation = compare(PART.scan, PART.target)
    metrics = force_metrics(PART.results, PART.control_rate)
    assert metrics is not None
    assert numbers["deviation"]["max_mm"] == pytest.approx(1e3 * deviation.whole.max_abs)
    assert numbers["deviation"]["mean_abs_mm"] == pytest.approx(1e3 * deviation.whole.mean_abs)
    assert numbers["deviation"]["rms_mm"] == pytest.approx(1e3 * deviation.whole.rms)
    assert numbers["deviation"]["regions"]["rim"]["mean_mm"] == pytest.approx(1e3 * deviation.regions["rim"].mean)
    assert numbers["force"]["set_N"] == 120.0
    assert numbers["force"]["p999_abs_error_N"] == metrics.p999_abs_error
    assert numbers["force"]["within_10N_fraction"] == metrics.within_band
    assert (numbers["contours"], numbers["contours_planned"]) == (6, 6)
    assert (numbers["ticks"], numbers["late_ticks"], numbers["lost_messages"]) == (PART.ticks, 3, 0)
    assert (numbers["sim_s"], numbers["wall_s"]) == (PART.sim_time, 71.25)
    assert (numbers["correction"], numbers["variant"], numbers["seed"]) == ("analytic", 0, 3)
    assert (numbers["bag"], numbers["report"]) == ("runs/x/bag", "runs/x/report.html")
    assert numbers["complete"]
    assert numbers["failure"] is numbers["reference"] is numbers["improvement"] is None
    assert numbers["torn"] is False


def test_points_within_the_published_band_are_counted_by_region() -> None:
    """An exact part whose base stands 0.29 mm up in one half, 0.31 mm in the other; nothing is seen of y > 0."""
    assert PART.target is not None
    target, base = PART.target, regions_of(PART.target)["base"]
    x, y = np.meshgrid(target.x, target.y)
    z = target.z + np.where(base, np.where(x < 0.0, 0.29e-3, 0.31e-3), 0.0)
    z[y > 0.0] = np.nan
    part = replace(PART, scan=HeightMap(target.x, target.y, z))
    regions = summary(part)["deviation"]["regions"]
    seen = base & (y < 0.0)
    assert regions["base"]["within_0_3mm_fraction"] == pytest.approx((seen & (x < 0.0)).sum() / seen.sum(), abs=0.01)
    assert regions["base"]["within_0_2mm_fraction"] == 0.0
    assert regions["wall"]["within_0_3mm_fraction"] == 1.0
    own = replace(part, job_text="tolerance: {shape: 0.32 mm, share: 1.0}\n")
    assert summary(own)["deviation"]["regions"]["base"]["within_tolerance_fraction"] == 1.0
    assert summary(own)["tolerance"] == {"shape_mm": pytest.approx(0.32), "share": 1.0}


@pytest.mark.parametrize(("shares", "kinds"), [((0.89, 2.0), ""), ((0.9, 2.0), " good"), ((0.89, 0.5), " bad")])
def test_an_error_is_green_in_tolerance_alone(shares: tuple[float, float], kinds: str) -> None:
    """However much better than uncorrected it is; red where it is worse."""
    numbers = summary(PART, REFERENCE)
    within, gain = shares
    numbers["deviation"]["regions"]["wall_and_base"]["within_tolerance_fraction"] = within
    numbers["improvement"] = {"max": gain, "mean_abs": gain}
    for label in ("Largest error", "Mean error"):
        (found,) = re.findall(f'<div class="card([a-z ]*)"><div class="label">{label}', cards(numbers))
        assert found == kinds


def test_set_points_that_differ_by_place_are_reported_as_such() -> None:
    """As force_rules give them: 100 and 200 N on halves of every contour, 120 N in the job."""
    part = _two_forces(PART)
    force = summary(part)["force"]
    assert (force["set_min_N"], force["set_max_N"]) == (100.0, 200.0)
    assert summary(PART)["force"]["set_min_N"] == summary(PART)["force"]["set_max_N"] == 120.0
    page = cards(summary(part)) + force_table(force) + job_table(part)
    assert "Within ± 10 N of 100 to 200 N" in page
    assert "120 N, by place 100 to 200 N" in page
    assert "by place" not in cards(summary(PART)) + job_table(PART)
    with style.applied():
        lines = process_figures.support_force(part).axes[0].get_lines()
        one = process_figures.support_force(PART).axes[0].get_lines()
    drawn = next(line for line in lines if "100 to 200 N" in str(line.get_label()))
    assert {100.0, 200.0} <= set(np.asarray(drawn.get_ydata()).tolist())
    assert any("set-point 120 N" in str(line.get_label()) for line in one)


def _two_forces(part: PartRecord) -> PartRecord:
    results = []
    for result in part.results:
        ticks = len(result.tick_set_point)
        more = np.where(np.arange(ticks) < ticks // 2, -20.0, 80.0) * result.tick_engaged
        results.append(
            replace(
                result, tick_set_point=result.tick_set_point + more, tick_normal_force=result.tick_normal_force + more
            )
        )
    return replace(part, results=tuple(results))


def test_improvement_is_the_errors_before_over_after() -> None:
    numbers = summary(PART, REFERENCE)
    before = summary(REFERENCE)["deviation"]
    assert numbers["reference"]["deviation"] == before
    assert numbers["improvement"]["max"] == pytest.approx(before["max_mm"] / numbers["deviation"]["max_mm"])
    assert numbers["improvement"]["mean_abs"] > 3  # 5.4 mm against 1.3 mm of springback in the synthetic part


def test_the_reference_is_judged_by_the_tolerance_of_the_part() -> None:
    """The reference's own job, with its own tolerance, was another one."""
    wide = replace(REFERENCE, job_text="tolerance: {shape: 50 mm}\n")
    numbers = summary(PART, wide)
    assert numbers["reference"]["deviation"] == summary(REFERENCE)["deviation"]
    assert numbers["reference"]["tolerance"] == numbers["tolerance"]


def test_everything_is_json_without_nan() -> None:
    assert PART.scan is not None
    blind = replace(PART, scan=replace(PART.scan, z=np.where(PART.scan.z < -20e-3, np.nan, PART.scan.z)))
    text = json.dumps(summary(blind, REFERENCE), allow_nan=False)
    assert json.loads(text)["job"] == "cone"


def test_a_part_that_ended_early_reports_its_code() -> None:
    numbers = summary(make_part(contours=6, stop_after=2))
    assert not numbers["complete"]
    assert numbers["contours"] == 2
    assert numbers["failure"]["code"] == ErrorCode.WRENCH_NOT_FINITE
    assert "contour 3" in numbers["failure"]["message"]


def test_a_contour_that_was_formed_with_a_warning_is_noted_once_per_kind() -> None:
    part = make_part(contours=6)
    drifted = [
        replace(result, code=int(ErrorCode.NO_TARE), message="the load cell of tool_2 has drifted by 15.0 N")
        for result in part.results[1:4]
    ]
    numbers = summary(replace(part, results=(part.results[0], *drifted, *part.results[4:])))
    assert numbers["complete"]
    (note,) = [note for note in numbers["notes"] if "drifted" in note]
    assert note.startswith("contour 2: the load cell of tool_2 has drifted by 15.0 N")
    assert "2 more contour(s)" in note


def test_contours_that_were_never_reported_make_a_part_incomplete() -> None:
    numbers = summary(replace(PART, results=PART.results[:3]))
    assert numbers["failure"]["code"] == 0
    assert "3 of 6" in numbers["failure"]["message"]


def test_a_fault_of_the_machine_is_the_failure_when_no_result_reports_one() -> None:
    faulted = replace(PART, results=PART.results[:3], faults=((1405, "force limit of tool_1"),))
    assert summary(faulted)["failure"] == {"code": 1405, "message": "force limit of tool_1"}


def test_without_scan_or_force_control_those_parts_are_null() -> None:
    numbers = summary(replace(make_part(process="SPIF", support_force=0.0, contours=3), scan=None), REFERENCE)
    assert numbers["deviation"] is numbers["force"] is numbers["improvement"] is None
    json.dumps(numbers, allow_nan=False)


def test_the_simulated_sheet_is_named_where_it_is_known() -> None:
    assert summary(replace(PART, sheet={"model": "shell"}))["sheet"] == {"model": "shell"}
    assert summary(replace(PART, sheet={}))["sheet"] is None  # a real machine


def test_a_run_of_a_sealed_variant_is_marked() -> None:
    """101 to 120 are sealed; the report says so, and the former name of the number is there as well."""
    for variant, sealed in ((0, False), (20, False), (40, False), (101, True), (120, True), (121, False)):
        record = replace(PART, variant=variant)
        numbers = summary(record)
        assert (numbers["variant"], numbers["world"], numbers["sealed"]) == (variant, variant, sealed)
        assert ("(sealed)" in job_table(record)) is sealed
