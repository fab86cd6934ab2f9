"""Events, remarks, outlook and contact in summary and report."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from isf_analysis.bag.bag_reader import read_bag
from isf_analysis.bag.bag_writer import write_bag
from isf_analysis.figures import process_figures, shape_figures, style
from isf_analysis.figures.cuts import cuts
from isf_analysis.measures.deviation import compare, directions
from isf_analysis.measures.remarks import grouped, spans
from isf_analysis.measures.summary import summary
from isf_analysis.report import finding_tables, result_tables
from isf_analysis.report.page import write_report
from isf_core.contour import ContourCorrection
from isf_core.events import Event, EventKind
from isf_core.geometry.height_map import HeightMap
from synthetic_part import Cone, in_stages, make_events, make_part

PLAIN = make_part(contours=6, spacing=2.5e-3)


def correction(index: int, *remarks: str, code: int = 0, message: str = "", limited: int = 0) -> ContourCorrection:
    points = 20
    return ContourCorrection(
        "cone-plan",
        index,
        "fused",
        np.zeros((points, 3)),
        np.full(points, 1e-3),
        saturated=np.arange(points) < limited,
        code=code,
        message=message,
        residual=np.full(points, 1e-4 * (index + 1)),
        uncertainty=np.full(points, 2e-4),
        remarks=remarks,
    )


CORRECTIONS = (
    correction(0, "the rim lies 0.6 mm below the plan", "the scan shows <little>"),
    correction(1, "the rim lies 1.4 mm below the plan"),
    correction(2, "the rim lies 0.9 mm below the plan", limited=5),
    correction(4, "30 % of the part were not seen", code=1321, message="the scan is empty"),
)
PART = replace(PLAIN, corrections=CORRECTIONS, correction="fused", events=make_events(PLAIN))


@pytest.fixture(autouse=True)
def _coarse_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(style, "DPI", 34)


def test_remarks_are_grouped_and_the_most_severe_comes_first() -> None:
    found = grouped(CORRECTIONS)
    assert found[0].failed
    assert found[0].text == "1321: the scan is empty"
    assert found[1].text == "the rim lies 1.4 mm below the plan"
    assert found[1].contours == (0, 1, 2)
    assert found[1].size == 1.4
    assert {remark.text for remark in found[2:]} == {
        "the scan shows <little>",
        "a limit of the correction was reached at 25 % of the points",
        "30 % of the part were not seen",
    }
    assert grouped(()) == ()
    assert spans([5, 0, 1, 2, 8, 9]) == "0-2, 5, 8-9"


def test_the_summary_holds_what_happened_and_survives_a_bag(tmp_path: Path) -> None:
    numbers = summary(PART)
    assert json.loads(json.dumps(numbers, allow_nan=False)) == numbers
    assert [(event["kind"], event["count"]) for event in numbers["events"]] == [
        ("galling", 1),
        ("contact lost", 2),
        ("die contact", 1),
    ]
    assert numbers["events"][0]["first"]["contour"] == 2
    assert numbers["outlook"]["residual_last_mean_mm"] == pytest.approx(0.5)
    assert numbers["outlook"]["residual_max_abs_mm"] == pytest.approx(0.5)
    assert numbers["outlook"]["uncertainty_mean_mm"] == pytest.approx(0.2)
    assert numbers["force_regions"]["all"]["points"] == 6 * 120
    again = summary(read_bag(write_bag(PART, tmp_path / "bag")))
    for key in ("remarks", "outlook", "force_regions", "contact_losses", "backoffs"):
        assert again[key] == numbers[key], key
    assert [event["text"] for event in again["events"]] == [event["text"] for event in numbers["events"]]


def test_expected_and_reached_are_those_of_the_last_stage() -> None:
    """The first stage expects much to remain, which the last one forms."""
    part = in_stages(replace(PLAIN, corrections=tuple(_expecting(1e-4, item) for item in PLAIN.corrections)))
    earlier = len(PLAIN.nominal)
    corrections = [_expecting(9e-3, item) for item in part.corrections[:earlier]] + [*part.corrections[earlier:]]
    outlook = summary(replace(part, corrections=tuple(corrections)))["outlook"]
    assert outlook["residual_mean_mm"] == pytest.approx(0.1)
    alone = replace(PLAIN, corrections=tuple(_expecting(1e-4, item) for item in PLAIN.corrections))
    for key in ("reached_mean_mm", "reached_max_abs_mm"):
        assert outlook[key] == pytest.approx(summary(alone)["outlook"][key])


def _expecting(error: float, item: ContourCorrection) -> ContourCorrection:
    return replace(item, residual=np.full(len(item.offset), error))


def test_a_part_that_reports_nothing_has_empty_entries() -> None:
    numbers = summary(make_part(contours=3, spacing=10e-3, process="SPIF", support_force=0.0, correction="none"))
    assert numbers["events"] == numbers["remarks"] == []
    assert numbers["outlook"] is None
    assert numbers["force_regions"] is None
    assert numbers["contact_losses"] is None
    for make in (
        finding_tables.event_table,
        finding_tables.remark_table,
        finding_tables.outlook_table,
        finding_tables.force_region_table,
        finding_tables.contact_loss_table,
    ):
        assert make(numbers) == ""


def test_the_report_reports_it_all_and_escapes_what_others_wrote(tmp_path: Path) -> None:
    report = write_report(PART, tmp_path)
    html = report.html.read_text(encoding="utf-8")
    assert "What the machine noticed" in html
    assert html.index("<b>galling</b>") < html.index("<b>contact lost</b>") < html.index("<th>die contact</th>")
    assert "<little>" not in html
    assert "the scan shows &lt;little&gt;" in html
    assert html.index("1321: the scan is empty") < html.index("the rim lies 1.4 mm")
    assert "1-3 (3 of 6)" in html
    assert "Support force by region" in html
    assert (tmp_path / "contact.png").is_file()
    assert "Event: " not in html  # nothing that makes the part scrap
    torn = Event(int(EventKind.FRACTURE), 3.0, (0.02, 0.0, -0.01), 1.2, 1.0, "the sheet tears")
    banners = result_tables.banners(summary(replace(PART, events=(torn,))), has_reference=True)
    assert "Event: fracture</strong>the sheet tears." in banners


def test_a_part_without_support_tool_has_no_figure_of_its_force() -> None:
    part = make_part(contours=3, spacing=10e-3, process="SPIF", support_force=0.0)
    idle = tuple(
        replace(result, tick_normal_force=np.full(len(result.tick_time), 0.7)) for result in part.results
    )  # the noise of a load cell that nothing touches
    assert not process_figures.has_support_force(replace(part, results=idle))
    assert process_figures.has_support_force(PLAIN)


def test_corrections_of_what_is_formed_from_below_count_upwards() -> None:
    offset = np.zeros((120, 3))
    offset[:, 2] = 1e-3
    raised = tuple(replace(item, offset=offset, springback=np.full(120, 1e-3)) for item in PLAIN.corrections)
    below = replace(
        PLAIN, corrections=raised, nominal=tuple(replace(contour, forming_tool=2) for contour in PLAIN.nominal)
    )
    with style.applied():
        curve = process_figures.corrections(below).axes[0].get_lines()[0]
    np.testing.assert_allclose(curve.get_ydata(), 1.0)


# -- shapes that stand up or have several features ---------------------------------------------------


def two_features(*, first: float = -4e-3, second: float = 4e-3) -> HeightMap:
    """Round features with slopes of 45 deg at x = -23 and 23 mm, their heights in m."""
    x, y = np.linspace(-70e-3, 70e-3, 141), np.linspace(-50e-3, 50e-3, 101)
    gx, gy = np.meshgrid(x, y)
    z = np.zeros_like(gx)
    for centre, height in ((-23e-3, first), (23e-3, second)):
        z += np.sign(height) * np.clip(15e-3 - np.hypot(gx - centre, gy), 0.0, abs(height))
    return HeightMap(x, y, z)


def test_directions_of_the_target() -> None:
    assert directions(two_features()) == (True, True)
    assert directions(two_features(first=4e-3)) == (False, True)
    assert directions(two_features(second=-4e-3)) == (True, False)
    sunk = two_features(first=4e-3)
    assert directions(HeightMap(sunk.x, sunk.y, sunk.z - 6e-3)) == (False, True)  # from its flange, not from zero


def test_sections_go_through_every_feature() -> None:
    target = two_features()
    deviation = compare(target, target)
    found = cuts(deviation)
    assert [cut.name for cut in found] == ["section_x", "section_feature_0", "section_feature_1"]
    assert found[0].angle == pytest.approx(0.0, abs=1e-6)
    assert sorted(cut.centre[0] for cut in found[1:]) == pytest.approx([-23e-3, 23e-3], abs=1e-3)
    assert all(cut.angle == pytest.approx(np.pi / 2, abs=1e-6) for cut in found[1:])
    for cut in found:
        s = np.linspace(cut.begin, cut.end, 400)
        height = target.at(np.array(cut.centre) + s[:, None] * [np.cos(cut.angle), np.sin(cut.angle)])
        assert np.nanmax(np.abs(height)) == pytest.approx(4e-3, abs=0.1e-3)


def test_one_part_at_the_origin_is_cut_along_x_and_y() -> None:
    assert PLAIN.target is not None
    found = cuts(compare(PLAIN.target, PLAIN.target))
    assert [(cut.name, cut.centre, cut.angle) for cut in found] == [
        ("section_x", (0.0, 0.0), 0.0),
        ("section_y", (0.0, 0.0), np.pi / 2),
    ]
    assert found[0].end > Cone().opening_radius
    z = PLAIN.target.z.copy()
    row, column = len(PLAIN.target.y) // 2 + 5, len(PLAIN.target.x) // 2 - 5
    z[row, column] += 1e-3
    (worst,) = cuts(compare(HeightMap(PLAIN.target.x, PLAIN.target.y, z), PLAIN.target))[2:]
    assert (worst.name, worst.centre, worst.angle) == ("section_worst", (0.0, 0.0), pytest.approx(0.75 * np.pi))


def test_a_standing_part_is_called_too_low_not_too_deep(tmp_path: Path) -> None:
    target = two_features(first=4e-3)
    scan = HeightMap(target.x, target.y, 0.9 * target.z)
    part = replace(PLAIN, target=target, scan=scan)
    assert compare(scan, target).whole.worst[2] == pytest.approx(-0.4e-3, abs=1e-6)
    html = write_report(part, tmp_path).html.read_text(encoding="utf-8")
    assert "blue too low" in html
    assert "deep enough" not in html
    with style.applied():
        figure = shape_figures.deviation_map(compare(scan, target), target, 1.0, part.events)
    assert any("too low" in axes.get_ylabel() + axes.get_xlabel() for axes in figure.axes)
    drawn = [axes for axes in figure.axes if axes.get_xlabel() == "x [mm]"]
    outline = max(drawn[0].collections, key=lambda item: float(np.max(item.get_linewidths())))
    edge = np.concatenate([path.vertices for path in outline.get_paths()])
    # 0.1 mm off the flange on a slope of 45 deg
    assert np.abs(np.hypot(np.abs(edge[:, 0]) - 23.0, edge[:, 1]) - 14.9).max() < 0.5
