"""What figures show, read back from their axes."""

from __future__ import annotations

import numpy as np
import pytest
from isf_analysis.figures import process_figures, shape_figures, style
from isf_analysis.figures.cuts import Cut
from isf_analysis.measures.deviation import compare
from matplotlib.figure import Figure
from synthetic_part import Cone, formed_map, make_events, make_part, target_map

CONE = Cone()
TARGET = target_map(CONE)
CORRECTED = formed_map(TARGET, CONE, 1.3e-3, 1)
UNCORRECTED = formed_map(TARGET, CONE, 5.4e-3, 1)
AFTER, BEFORE = compare(CORRECTED, TARGET), compare(UNCORRECTED, TARGET)
PART = make_part(contours=6)


def limits_of_images(figure: Figure) -> list[tuple[float, float]]:
    return [image.get_clim() for axes in figure.axes for image in axes.get_images()]


def test_both_maps_have_the_same_symmetric_scale() -> None:
    limit = shape_figures.map_limit(AFTER, BEFORE)
    with style.applied():
        figure = shape_figures.deviation_pair(BEFORE, TARGET, AFTER, TARGET, limit, "this part")
    assert limits_of_images(figure) == [(-limit, limit)] * 2
    assert limit >= 1e3 * BEFORE.whole.max_abs


def test_a_map_shows_the_error_in_millimetres_with_y_upwards() -> None:
    with style.applied():
        figure = shape_figures.deviation_map(AFTER, TARGET, 2.0)
    image = figure.axes[0].get_images()[0]
    np.testing.assert_array_equal(np.asarray(image.get_array()), 1e3 * AFTER.error.z)
    left, right, bottom, top = image.get_extent()
    assert left == pytest.approx(-125.5)  # cells of 1 mm around points at -125 ... 125 mm
    assert (right, bottom, top) == pytest.approx((125.5, -125.5, 125.5))


def test_a_section_is_to_scale_and_its_error_is_the_difference() -> None:
    cut = Cut("section", "", (0.0, 0.0), np.pi / 4, -60e-3, 60e-3, "distance")
    with style.applied():
        figure = shape_figures.section(cut, TARGET, CORRECTED, UNCORRECTED)
    profile, error = figure.axes
    assert profile.get_aspect() == 1.0
    lines = {str(line.get_label()): line.get_ydata() for line in profile.get_lines()}
    shown = error.get_lines()[1].get_ydata()
    np.testing.assert_allclose(shown, lines["this part"] - lines["target"], atol=1e-12)
    s = profile.get_lines()[0].get_xdata()
    # bilinear interpolation over 1 mm cells of a 5 mm fillet: 2 h^2 / 8 R times the slope's secant, below 0.1 mm
    np.testing.assert_allclose(lines["target"], 1e3 * CONE.profile(np.abs(s) * 1e-3), atol=0.1)


def test_corrections_are_positive_downwards() -> None:
    with style.applied():
        axes = process_figures.corrections(PART).axes[0]
    mean = next(line for line in axes.get_lines() if line.get_label() == "correction, mean")
    expected = [-1e3 * item.offset[:, 2].mean() for item in PART.corrections]
    np.testing.assert_allclose(mean.get_ydata(), expected)
    np.testing.assert_array_equal(mean.get_xdata(), np.arange(1, 7))  # as a person counts
    assert min(expected) > 0


def test_forming_force_is_the_mean_of_each_contour() -> None:
    with style.applied():
        axes = process_figures.forming_force(PART).axes[0]
    mean = next(line for line in axes.get_lines() if line.get_label() == "axial, mean")
    np.testing.assert_allclose(mean.get_ydata(), [result.forming_force[:, 2].mean() for result in PART.results])


def test_the_force_envelope_hides_no_outlier() -> None:
    spike = PART.results[2].tick_normal_force
    spike[len(spike) // 2] = 300.0
    with style.applied():
        whole = process_figures.support_force(PART).axes[0]
    highest = max(path.vertices[:, 1].max() for fill in whole.collections for path in fill.get_paths() if len(path))
    assert highest == pytest.approx(300.0)


@pytest.mark.parametrize(
    ("largest", "limit"),
    [(0.0, 1.0), (float("nan"), 1.0), (0.9, 1.0), (1.0, 1.0), (1.01, 1.5), (5.69, 6.0), (0.032, 0.04), (9.1, 10.0)],
)
def test_limits_are_round(largest: float, limit: float) -> None:
    assert style.rounded_limit(largest) == pytest.approx(limit)


@pytest.mark.parametrize("pair", [False, True])
def test_a_legend_below_has_room_of_its_own(pair: bool) -> None:
    """Without what matplotlib has for it from 3.7 on: Ubuntu 24.04 comes with 3.6.3."""
    with style.applied():
        if pair:
            figure = shape_figures.region_errors(AFTER, BEFORE)
        else:
            events = [event for event in make_events(PART) if event.has_place]
            figure = shape_figures.deviation_map(AFTER, TARGET, 2.0, events)
        figure.draw_without_rendering()
        (legend,) = figure.legends
        assert getattr(legend, "_outside_loc", None) is None
        box = legend.get_window_extent()
        assert 0.0 <= box.y0 < box.y1 < 0.2 * figure.bbox.height
        assert all(axes.get_tightbbox().y0 >= box.y1 for axes in figure.axes)
