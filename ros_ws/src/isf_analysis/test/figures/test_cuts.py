"""Sections that a reader asks for: what they are called, where they go, what they show, and what is refused."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from isf_analysis.figures import shape_figures, style
from isf_analysis.figures.cuts import asked_cuts, cuts, planes_of
from isf_analysis.measures.deviation import compare
from isf_analysis.report.page import write_report
from isf_core.errors import ErrorCode, IsfError
from isf_core.geometry.height_map import HeightMap
from isf_core.types import Array
from synthetic_part import Cone, formed_map, make_part, target_map

CONE = Cone()
TARGET = target_map(CONE)
FORMED = formed_map(TARGET, CONE, 1.3e-3, 1)
DEVIATION = compare(FORMED, TARGET)
REACH = 1e3 * CONE.radius_at(0.1e-3) + 25.0
"""mm from the origin that the map of the cone shows, to a cell: 25 mm beyond where it is 0.1 mm deep."""


@pytest.mark.parametrize(
    ("text", "name", "words", "axis", "along"),
    [
        # at s mm along the section: x and y in mm, as the words on the command line say
        ("y=12.5", "section_at_y_12.5mm", "along x at y = 12.5 mm", "x", lambda s: (s, 0 * s + 12.5)),
        (" x = -7 mm", "section_at_x_-7mm", "along y at x = \N{MINUS SIGN}7 mm", "y", lambda s: (0 * s - 7.0, s)),
        (
            "30deg",
            "section_30deg",
            "at 30° from x, through (0, 0) mm",
            "distance from (0, 0)",
            lambda s: (s * 0.75**0.5, s * 0.5),
        ),
        (
            "30 deg @ 10, -5",
            "section_30deg_at_10_-5mm",
            "at 30° from x, through (10, \N{MINUS SIGN}5) mm",
            "distance from (10, \N{MINUS SIGN}5)",
            lambda s: (10 + s * 0.75**0.5, -5 + s * 0.5),
        ),
    ],
)
def test_a_section_of_a_cone_is_that_of_its_formula(
    text: str, name: str, words: str, axis: str, along: Callable[[Array], tuple[Array, Array]]
) -> None:
    """The target along the section is z(r) of the closed formula at the places that the text names; the part is what
    was added to it, before the noise: 20 um."""
    (cut,) = asked_cuts(planes_of([text]), DEVIATION)
    assert (cut.name, cut.words, cut.axis) == (name, words, axis)
    with style.applied():
        figure = shape_figures.section(cut, TARGET, FORMED, None)
    profile, error = figure.axes
    assert error.get_xlabel() == f"{axis} [mm]"
    lines = {str(line.get_label()): line for line in profile.get_lines()}
    s = np.asarray(lines["target"].get_xdata())
    x, y = along(s)
    radius = np.hypot(x, y) * 1e-3
    # bilinear interpolation over 1 mm cells of a 5 mm fillet
    np.testing.assert_allclose(lines["target"].get_ydata(), 1e3 * CONE.profile(radius), atol=0.1)
    pillow = 0.25 * np.clip(1 - (radius / CONE.base_radius) ** 2, 0.0, 1.0)
    ratio = radius / CONE.opening_radius
    lift = 1.3 * np.clip(1.15 - ratio**2, 0.0, 1.0) * (1 + 0.06 * 1e-3 * x / CONE.opening_radius)
    bending = -0.22 * 1.3 * np.exp(-(((radius - CONE.opening_radius) / 14e-3) ** 2))
    np.testing.assert_allclose(error.get_lines()[0].get_ydata(), lift + bending + pillow, atol=0.1)
    # to the frame of the map, and no farther
    assert max(np.abs(x).max(), np.abs(y).max()) == pytest.approx(REACH, abs=1.1)
    assert np.hypot(x[0] - x[-1], y[0] - y[-1]) > 1.7 * REACH


def test_a_section_beside_the_origin_goes_through_the_middle_of_its_part() -> None:
    """A cone 40 mm to the side, and a section whose zero stays that of the frame."""
    x, y = np.meshgrid(TARGET.x, TARGET.y)
    target = HeightMap(TARGET.x, TARGET.y, CONE.profile(np.hypot(x - 40e-3, y + 60e-3)))
    turned, along = asked_cuts(planes_of(["45deg", "y=-60"]), compare(target, target))
    assert turned.centre == pytest.approx((40e-3, -60e-3), abs=1e-9)
    assert along.begin == pytest.approx(40e-3 - 1e-3 * REACH, abs=1.1e-3)
    assert along.end == pytest.approx(40e-3 + 1e-3 * REACH, abs=1.1e-3)
    s = along.distances()
    np.testing.assert_allclose(target.at(along.points(s)), CONE.profile(np.abs(s - 40e-3)), atol=0.1e-3)


def test_a_section_is_drawn_once_and_told_apart_from_those_of_every_report() -> None:
    planes = planes_of(["y=0", "y=0.0 mm", "y=-0", "x=0", "0deg", "180deg", "0deg@0,0", "0deg@0,1"])
    names = [cut.name for cut in asked_cuts(planes, DEVIATION)]
    assert names == [
        "section_at_y_0mm",
        "section_at_x_0mm",
        "section_0deg",
        "section_180deg",
        "section_0deg_at_0_0mm",
        "section_0deg_at_0_1mm",
    ]
    assert not set(names) & {cut.name for cut in cuts(DEVIATION)}


@pytest.mark.parametrize(
    "text",
    ["", "12.5", "z=3", "y=", "y=nan", "y=1e3", "y=12 in", "y=3deg", "30", "400deg", "30deg@1", "x=" + 400 * "9"],
)
def test_what_is_no_section_is_refused(text: str) -> None:
    with pytest.raises(IsfError) as caught:
        planes_of(["x=0", text])
    assert caught.value.code == ErrorCode.FILE_FIELD
    assert "--section" in str(caught.value)
    assert "y=12.5" in caught.value.advice


@pytest.mark.parametrize("text", ["y=80", "x=-1000", "0deg@0,80", "45deg@0,-400"])
def test_a_section_that_misses_the_part_is_refused_with_where_the_part_is(text: str) -> None:
    with pytest.raises(IsfError, match="misses the part") as caught:
        asked_cuts(planes_of([text]), DEVIATION)
    assert caught.value.code == ErrorCode.FILE_FIELD
    x = TARGET.x[DEVIATION.masks["wall_and_base"].any(axis=0)]
    assert f"x = {1e3 * x[0] - 25:.0f} to {1e3 * x[-1] + 25:.0f} mm" in caught.value.advice


def test_a_section_of_the_flange_says_so_and_one_that_was_not_measured_is_refused() -> None:
    (beside,) = asked_cuts(planes_of([f"y={1e3 * CONE.opening_radius + 5:.1f}"]), DEVIATION)
    assert beside.words.endswith("on the flange only")
    z = FORMED.z.copy()
    z[FORMED.y > 5.5e-3] = np.nan
    half = compare(HeightMap(FORMED.x, FORMED.y, z), TARGET)
    assert len(asked_cuts(planes_of(["x=0", "y=4"]), half)) == 2
    with pytest.raises(IsfError, match="nothing was measured") as caught:
        asked_cuts(planes_of(["y=6"]), half)
    assert caught.value.code == ErrorCode.FILE_FIELD


def test_a_report_has_the_sections_that_were_asked_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(style, "DPI", 34)
    part = make_part(spacing=2.5e-3, contours=2)
    plain = write_report(part, tmp_path / "plain")
    report = write_report(part, tmp_path / "report", sections=planes_of(["x=12.5", "60deg"]))
    added = {path.name for path in report.pictures} - {path.name for path in plain.pictures}
    assert added == {"section_at_x_12.5mm.png", "section_60deg.png"}
    html = report.html.read_text(encoding="utf-8")
    assert "Section along y at x = 12.5 mm" in html
    assert "Dashed: the sections" in html
    assert "Dashed: the sections" not in plain.html.read_text(encoding="utf-8")
    for refused, code in ((part, ErrorCode.FILE_FIELD), (replace(part, scan=None), ErrorCode.BAG_INCOMPLETE)):
        with pytest.raises(IsfError) as caught:
            write_report(refused, tmp_path / "none", sections=planes_of(["y=200"]))
        assert caught.value.code == code
    assert not (tmp_path / "none").exists()


def test_the_map_shows_where_the_sections_go() -> None:
    asked = asked_cuts(planes_of(["x=10", "150deg"]), DEVIATION)
    with style.applied():
        axes = shape_figures.deviation_map(DEVIATION, TARGET, 2.0, cuts=asked).axes[0]
    dashed = [line for line in axes.get_lines() if line.get_linestyle() == "--"]
    np.testing.assert_allclose(dashed[0].get_xdata(), [10.0, 10.0], atol=1e-9)
    turned = np.diff(np.column_stack([dashed[1].get_xdata(), dashed[1].get_ydata()]), axis=0)[0]
    assert np.degrees(np.arctan2(turned[1], turned[0])) == pytest.approx(150.0)
    words = {text.get_text(): text.get_rotation() for text in axes.texts}
    assert words["x = 10"] == pytest.approx(90.0)
    assert words["150 deg"] == pytest.approx(330.0)
