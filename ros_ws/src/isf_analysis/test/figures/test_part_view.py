"""The part in three dimensions: what its page holds is what the record says, at the right places."""

from __future__ import annotations

import base64
import re
import sys
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from isf_analysis.figures import style
from isf_analysis.figures.part_view import LARGEST_GRID, MAXIMUM_POINTS, part_view
from isf_analysis.measures.deviation import regions_of
from isf_analysis.measures.record import PartRecord
from isf_analysis.measures.summary import deviation_of
from isf_analysis.report.page import write_report
from isf_core.geometry.height_map import HeightMap
from isf_core.thinned_sheet import ThinnedSheet
from isf_core.types import Array
from packed_page import unpacked
from synthetic_part import in_stages, make_part

PART = make_part(contours=5, spacing=2.5e-3)
FORCES = ["forming force", "support force", "correction"]
NUMBERS = {"f4": "<f4", "f8": "<f8", "u1": "u1"}


def shown(part: PartRecord) -> dict[str, Any]:
    """What the page of ``part`` holds; without plotly there is none."""
    pytest.importorskip("plotly")
    return unpacked(part_view(part, deviation_of(part)).html)


def array(value: Any) -> Array:
    """Numbers of a trace, as plotly writes them: base64 with type and shape, or a list."""
    if not isinstance(value, dict):
        return np.array(value, dtype=float)
    flat = np.frombuffer(base64.b64decode(value["bdata"]), dtype=NUMBERS[value["dtype"]]).astype(float)
    return flat.reshape([int(n) for n in str(value.get("shape", len(flat))).split(",")])


def test_every_quantity_of_the_record_is_a_view_with_its_unit() -> None:
    content = shown(PART)
    thicknesses = ["thickness (estimate)", "thickness (plan)"]
    assert list(content["views"]) == ["deviation", *thicknesses, *FORCES, "forming"]
    bars = []
    for name, view in content["views"].items():
        if name == "forming":
            continue
        (last,) = view["traces"][-1:]
        trace = content["data"][last]
        bars.append((trace.get("colorbar") or trace["line"]["colorbar"])["title"]["text"])
        assert len(view["annotations"]) == 1
    assert [re.findall(r"\[(N|mm)\]", bar)[0] for bar in bars] == ["mm", "mm", "mm", "N", "N", "mm"]
    assert sorted(k for view in content["views"].values() for k in view["traces"]) == list(range(len(content["data"])))


def test_the_worst_spot_is_labelled_where_it_is() -> None:
    target = PART.target
    assert target is not None
    z = target.z.copy()
    row, column = len(target.y) // 2 + 2, len(target.x) // 2 - 3
    z[row, column] += 0.777e-3
    content = shown(replace(PART, scan=HeightMap(target.x, target.y, z)))
    (label,) = content["views"]["deviation"]["annotations"]
    assert label["text"] == "+0.78 mm"
    place = [1e3 * target.x[column], 1e3 * target.y[row], 1e3 * z[row, column]]
    assert [label[axis] for axis in "xyz"] == pytest.approx(place, abs=1e-3)
    surface = content["data"][content["views"]["deviation"]["traces"][0]]
    assert np.nanmax(array(surface["surfacecolor"])) == pytest.approx(0.777, abs=1e-3)
    assert surface["cmax"] == -surface["cmin"] == 0.8


def test_a_part_of_which_only_the_flange_was_measured_has_a_report_and_no_label(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(style, "DPI", 34)
    target = PART.target
    assert target is not None
    z = target.z.copy()
    z[regions_of(target)["wall_and_base"]] = np.nan
    part = replace(PART, scan=HeightMap(target.x, target.y, z))
    assert shown(part)["views"]["deviation"]["annotations"] == []
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert write_report(part, tmp_path).numbers["deviation"]["max_mm"] is None


def test_the_worst_spot_is_labelled_beside_unknown_nodes_of_a_thinned_shape() -> None:
    """Every second node is drawn; of a cell that is known among unknown ones, the corner that lies beside them."""
    target = make_part(contours=1, spacing=0.4e-3).target
    assert target is not None
    for row in (len(target.y) // 2, len(target.y) // 2 + 1):
        z = target.z.copy()
        column = row
        z[row - 4 : row + 5, column - 4 : column + 5] = np.nan
        cell = slice(row, row + 2), slice(column, column + 2)
        z[cell] = target.z[cell]
        z[row, column] += 3e-3
        part = replace(PART, target=target, scan=HeightMap(target.x, target.y, z))
        (label,) = shown(part)["views"]["deviation"]["annotations"]
        assert label["text"] == "+3.00 mm"
        assert label["z"] == pytest.approx(1e3 * z[row, column], abs=1e-3)


def test_of_a_part_formed_in_stages_the_last_one_is_shown() -> None:
    """The first stage lies above it in plan, and the sheet was thicker then."""
    content = shown(in_stages(PART))
    (label,) = content["views"]["thickness (plan)"]["annotations"]
    assert label["text"] == f"{1e3 * PART.nominal[0].thickness.min():.2f} mm"
    surface = content["data"][content["views"]["thickness (plan)"]["traces"][-1]]
    assert np.nanmax(array(surface["surfacecolor"])) == pytest.approx(1e3 * PART.nominal[0].thickness.max(), abs=1e-3)
    line = content["data"][content["views"]["forming force"]["traces"][-1]]
    assert np.isnan(array(line["x"])).sum() == len(PART.results)


def formed_sheet(target: HeightMap) -> ThinnedSheet:
    """The target, half as thick again 10 mm right of the middle, and torn on its left."""
    x, y = np.meshgrid(target.x, target.y)
    thickness = 1e-3 - 0.5e-3 * np.exp(-((x - 10e-3) ** 2 + y**2) / (8e-3) ** 2)
    margin = 1.3 - 1.4 * np.exp(-((x + 10e-3) ** 2 + y**2) / (8e-3) ** 2)
    return ThinnedSheet(np.stack([x, y, target.z], axis=-1), thickness, margin)


def test_the_simulated_sheet_is_shown_where_it_lies_in_place_of_an_estimate() -> None:
    target = PART.target
    assert target is not None
    sheet = formed_sheet(target)
    content = shown(replace(PART, formed_sheet=sheet))
    assert list(content["views"])[:4] == ["deviation", "thickness (as formed)", "strain margin", "thickness (plan)"]
    x = (10.0, -10.0)
    for name, place, text, least in zip(
        ("thickness (as formed)", "strain margin"), x, ("0.50 mm", "-0.10"), (0.5, -0.1), strict=True
    ):
        view = content["views"][name]
        (trace,) = (content["data"][k] for k in view["traces"])
        colour = array(trace["surfacecolor"])
        assert colour.min() == pytest.approx(least, abs=1e-3)
        node = np.unravel_index(int(np.argmin(colour)), colour.shape)
        assert [array(trace["x"])[node], array(trace["y"])[node]] == pytest.approx([place, 0.0], abs=1e-3)
        (label,) = view["annotations"]
        assert (label["text"], label["x"], label["y"]) == (text, pytest.approx(place), pytest.approx(0.0))
    unknown = ThinnedSheet(sheet.points, sheet.thickness, np.full(sheet.thickness.shape, np.nan))
    assert "strain margin" not in shown(replace(PART, formed_sheet=unknown))["views"]


def test_the_estimate_is_the_sine_law_of_the_scan_that_the_plan_is_not(tmp_path: Path) -> None:
    """The wall of 50 deg was formed 0.8 times as deep, 43.6 deg: 0.724 mm where the plan says 0.643 mm."""
    target = PART.target
    assert target is not None
    noise = np.random.default_rng(1).normal(0.0, 17e-6, target.z.shape)
    part = replace(PART, scan=HeightMap(target.x, target.y, 0.8 * target.z + noise))
    content = shown(part)
    trace = content["data"][content["views"]["thickness (estimate)"]["traces"][-1]]
    colour, z = array(trace["surfacecolor"]), array(trace["z"])
    on_wall = (z > -0.8 * 15.0) & (z < -0.8 * 6.0)
    assert np.median(colour[on_wall]) == pytest.approx(0.724, abs=0.02)
    flange = z > -0.1
    assert np.median(colour[flange]) == pytest.approx(1.0, abs=0.002)
    numbers = write_report(part, tmp_path).numbers["sheet_thickness"]
    assert numbers["source"] == "estimate from the scan"
    assert numbers["thinnest"]["thickness_mm"] == pytest.approx(0.72, abs=0.04)
    no_blank = replace(part, job_text=part.job_text.replace("thickness: 1 mm", "thickness: much"))
    assert "thickness (estimate)" not in shown(no_blank)["views"]


def test_paths_carry_the_forces_and_corrections_of_the_record() -> None:
    content = shown(PART)
    for name, values in (
        ("forming force", [np.abs(result.forming_force[:, 2]) for result in PART.results]),
        ("correction", [-1e3 * item.offset[:, 2] for item in PART.corrections]),
    ):
        line = content["data"][content["views"][name]["traces"][-1]]
        colour, x = array(line["line"]["color"]), array(line["x"])
        whole = np.concatenate([np.append(one, one[0]) for one in values])  # closed contours
        np.testing.assert_allclose(colour[np.isfinite(x)], whole, atol=0.06 if "force" in name else 6e-4)
        assert np.isnan(x).sum() == len(PART.results)
        (label,) = content["views"][name]["annotations"]
        assert float(label["text"].split()[0]) == pytest.approx(max(v.max() for v in values), abs=0.51)


LESS = {
    "no scan": (replace(PART, scan=None), "deviation"),
    "no target": (replace(PART, scan=None, target=None), "thickness (plan)"),
    "no results": (replace(PART, results=()), "forming force"),
    "one tool": (make_part(contours=3, spacing=4e-3, process="SPIF", support_force=0.0), "support force"),
    "not corrected": (replace(PART, correction="none"), "correction"),
}


@pytest.mark.parametrize("case", LESS)
def test_a_record_of_less_shows_the_rest(case: str) -> None:
    part, missing = LESS[case]
    views = shown(part)["views"]
    assert missing not in views
    assert views


def test_nothing_to_show_is_no_picture() -> None:
    pytest.importorskip("plotly")
    nothing = replace(PART, scan=None, target=None, results=(), corrections=(), nominal=(), corrected=())
    assert part_view(nothing, None) == ("", False)


def test_unknown_values_leave_gaps_and_no_nan_in_the_page() -> None:
    target = PART.target
    assert target is not None
    z = target.z.copy()
    z[: len(target.y) // 2] = np.nan
    forces = [replace(result, forming_force=result.forming_force * np.nan) for result in PART.results[:1]]
    part = replace(PART, scan=HeightMap(target.x, target.y, z), results=(*forces, *PART.results[1:]))
    content = shown(part)
    line = content["data"][content["views"]["forming force"]["traces"][-1]]
    count = len(PART.nominal[0])
    assert np.isnan(array(line["x"])[:count]).all()
    assert np.isfinite(array(line["line"]["color"])).all()


def test_a_large_part_is_thinned_out() -> None:
    part = make_part(contours=30, spacing=0.6e-3, points=1000)
    content = shown(part)
    assert 0.2 * LARGEST_GRID < array(content["data"][0]["z"]).size <= LARGEST_GRID
    line = content["data"][content["views"]["forming force"]["traces"][-1]]
    assert 0.4 * MAXIMUM_POINTS < array(line["x"]).size <= MAXIMUM_POINTS + 3 * 30


def test_without_plotly_the_report_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "plotly.graph_objects", None)
    part = replace(make_part(contours=2, spacing=4e-3), scan=None, results=())
    html = write_report(part, tmp_path).html.read_text(encoding="utf-8")
    assert "The part cannot be turned here: views in HTML need the package plotly" in html
    assert "<script" not in html
