"""Scans between contours: what is kept of them, their way through a bag, and the errors of the part so far."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from isf_analysis.bag.bag_reader import read_bag
from isf_analysis.bag.bag_writer import write_bag
from isf_analysis.figures import scan_figures, style
from isf_analysis.measures.contour_scan import MAXIMUM_POINTS, QUANTUM, ContourScan, kept_scan, scan_errors
from isf_analysis.measures.record import PartRecord
from isf_analysis.measures.summary import summary
from isf_analysis.report.page import write_report
from isf_core.contour import Contour, Process
from isf_core.geometry.height_map import HeightMap
from isf_core.types import Array
from synthetic_part import Cone, make_part, target_map

PART = make_part(contours=6)
CONE, TARGET = Cone(), target_map(Cone())


def cloud(shape: HeightMap, seed: int = 0, tilt: float = 0.0, noise: float = 15e-6) -> Array:
    """(P, 3) m in no order, 1 mm apart, tilted about y by ``tilt`` rad."""
    random = np.random.default_rng(seed)
    place = shape.points()[:, :2] + random.uniform(-0.5e-3, 0.5e-3, (shape.z.size, 2))
    z = shape.at(place) + tilt * place[:, 0] + random.normal(0.0, noise, len(place))
    return random.permutation(np.column_stack([place, z])[np.isfinite(z)])


def so_far(contour: Contour, high: float) -> HeightMap:
    """The cone down to the contact of ``contour`` and ``high`` m too high there; the rest hangs below as a flat."""
    level = float(contour.contact[:, 2].mean())
    z = np.maximum(TARGET.z, level - 1e-3)
    return HeightMap(TARGET.x, TARGET.y, np.where(TARGET.z < -1e-9, z + high, z))


def scanned(high: tuple[float, ...] = (0.1e-3, 0.2e-3, 0.3e-3), **options: float) -> PartRecord:
    """The part with a scan after every second contour, the part so far ``high`` m too high."""
    indices = range(0, 2 * len(high), 2)
    scans = tuple(
        kept_scan(k, PART.results[k].end + 0.1, cloud(so_far(PART.nominal[k], error), seed=k, **options))
        for k, error in zip(indices, high, strict=True)
    )
    return replace(PART, scans=scans)


def test_a_scan_between_stages_is_held_against_the_shape_of_its_stage() -> None:
    """A preform half as deep, 0.1 mm too high, then the part, 0.2 mm too high."""
    preform, count = HeightMap(TARGET.x, TARGET.y, 0.5 * TARGET.z), len(PART.nominal)
    first = [replace(contour, contact=contour.contact * [1.0, 1.0, 0.5], count=2 * count) for contour in PART.nominal]
    last = [replace(contour, index=count + contour.index, count=2 * count, stage=1) for contour in PART.nominal]
    shapes = [
        (4, HeightMap(TARGET.x, TARGET.y, 0.5 * so_far(PART.nominal[4], 0.2e-3).z)),
        (count + 4, so_far(PART.nominal[4], 0.2e-3)),
    ]
    scans = tuple(kept_scan(index, float(index), cloud(shape)) for index, shape in shapes)
    found = scan_errors(scans, (*first, *last), TARGET, (preform,))
    assert [(error.index, error.stage) for error in found] == [(4, 0), (count + 4, 1)]
    assert [error.mean for error in found] == pytest.approx([0.1e-3, 0.2e-3], abs=0.02e-3)
    against_the_part = scan_errors(scans, (*first, *last), TARGET)
    assert against_the_part[0].mean > 0.5e-3


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 300), st.integers(0, 5))
def test_points_come_back_to_the_resolution_that_is_kept(count: int, seed: int) -> None:
    """Every point within half a quantum, none twice and none lost; bad ones are dropped."""
    random = np.random.default_rng(seed)
    points = random.uniform(-0.4, 0.4, (count, 3)) * [1.0, 1.0, 0.1]
    scan = kept_scan(3, 1.0, np.vstack([points, [[np.nan, 0.0, 0.0]]]))
    assert scan.count == count
    back = scan.points()
    one, other = np.rint(points / QUANTUM).astype(int), np.rint(back / QUANTUM).astype(int)
    assert sorted(map(tuple, one)) == sorted(map(tuple, other))


def test_a_scan_is_kept_small() -> None:
    """Points of a scanner 1 mm apart with its noise: less than a fifth of their 24 bytes."""
    points = cloud(PART.target or TARGET)
    scan = kept_scan(0, 0.0, points)
    assert scan.count == len(points)
    assert len(scan.packed) < 24 * len(points) / 5


def test_a_large_scan_is_thinned_evenly() -> None:
    points = np.column_stack([np.linspace(-0.3, 0.3, 300_000), np.zeros(300_000), np.zeros(300_000)])
    scan = kept_scan(0, 0.0, points)
    assert MAXIMUM_POINTS / 2 < scan.count <= MAXIMUM_POINTS
    gaps = np.diff(np.sort(scan.points()[:, 0]))
    assert gaps.max() <= 2e-5 + 1e-9


def test_scans_go_through_a_bag_with_their_contours(tmp_path: Path) -> None:
    part = scanned()
    back = read_bag(write_bag(part, tmp_path / "bag"))
    assert [scan.index for scan in back.scans] == [0, 2, 4]
    for mine, theirs in zip(part.scans, back.scans, strict=True):
        assert theirs.packed == mine.packed
        assert theirs.time == pytest.approx(mine.time, abs=2e-9)
    assert back.scan is not None
    assert PART.scan is not None
    np.testing.assert_array_equal(back.scan.z, PART.scan.z)  # the final scan is still the one of the finished part


def test_a_run_of_no_duration_keeps_its_scans_apart(tmp_path: Path) -> None:
    part = replace(scanned(), wall_time=0.0)
    back = read_bag(write_bag(part, tmp_path / "bag"))
    assert [scan.index for scan in back.scans] == [0, 2, 4]
    assert back.scan is not None


def test_a_part_that_ended_after_a_scan_has_that_one_alone(tmp_path: Path) -> None:
    """The scan after the last contour that was formed is the shape of what there is."""
    part = scanned()
    ended = replace(
        part, scan=None, nominal=part.nominal[:3], corrected=part.corrected[:3], corrections=part.corrections[:3],
        results=part.results[:3], scans=part.scans[:1],
    )  # fmt: skip
    back = read_bag(write_bag(ended, tmp_path / "bag"))
    assert back.scan is None
    assert [scan.index for scan in back.scans] == [0]


@pytest.mark.parametrize("tilt", [0.0, 2e-3])
def test_error_of_the_part_so_far(tilt: float) -> None:
    """Only what contours have reached counts; a tilt of the scanner is seen beside the clamp and taken out."""
    part = scanned(tilt=tilt)
    errors = scan_errors(part.scans, part.nominal, TARGET)
    assert [error.index for error in errors] == [0, 2, 4]
    for error, high in zip(errors, (0.1e-3, 0.2e-3, 0.3e-3), strict=True):
        level = float(part.nominal[error.index].contact[:, 2].mean())
        formed = np.isfinite(error.error.z)
        assert TARGET.z[formed].min() >= level
        assert TARGET.z[formed].min() < level + 2.5e-3  # two cells on the wall of 50 deg
        assert error.mean == pytest.approx(high, abs=20e-6)
        assert error.coverage > 0.99
    assert np.all(np.diff([np.isfinite(error.error.z).sum() for error in errors]) > 0)


def test_a_hole_in_the_scan_is_reported_as_coverage() -> None:
    points = cloud(so_far(PART.nominal[4], 0.2e-3))
    points = points[points[:, 0] < 0.0]
    (error,) = scan_errors((kept_scan(4, 1.0, points),), PART.nominal, TARGET)
    assert error.coverage == pytest.approx(0.5, abs=0.1)
    assert error.mean == pytest.approx(0.2e-3, abs=30e-6)


def test_over_a_die_the_top_is_formed_first() -> None:
    """The target stands up; with the holder 4 mm down the top 4 mm stand over the flange."""
    standing = HeightMap(TARGET.x, TARGET.y, -TARGET.z)
    contour = replace(PART.nominal[2], process=Process.TPIF, holder_height=-4e-3)
    top = float(np.nanmax(standing.z))
    shape = HeightMap(TARGET.x, TARGET.y, np.maximum(standing.z - (top - 4e-3), 0.0))
    high = HeightMap(TARGET.x, TARGET.y, np.where(shape.z > 0.0, shape.z + 0.15e-3, 0.0))
    (error,) = scan_errors((kept_scan(2, 1.0, cloud(high)),), (contour,), standing)
    formed = np.isfinite(error.error.z)
    assert standing.z[formed].min() >= top - 4e-3
    assert error.mean == pytest.approx(0.15e-3, abs=20e-6)


def test_scans_of_unknown_contours_and_beside_the_part_are_left_out() -> None:
    far = cloud(TARGET)[:2000] + [1.0, 0.0, 0.0]
    scans: tuple[ContourScan, ...] = (kept_scan(77, 1.0, cloud(TARGET)), kept_scan(2, 1.0, far))
    assert scan_errors(scans, PART.nominal, TARGET) == ()


def test_scans_that_say_nothing_are_left_out_with_a_note(tmp_path: Path) -> None:
    good = cloud(so_far(PART.nominal[4], 0.2e-3))
    bad = {0: np.full((50, 3), np.nan), 1: 1e-3 * good, 2: 1e3 * good, 3: 1e9 * good}
    scans = tuple(kept_scan(k, PART.results[k].end + 0.1, points) for k, points in sorted({**bad, 4: good}.items()))
    part = read_bag(write_bag(replace(PART, scans=scans), tmp_path / "bag"))
    numbers = write_report(part, tmp_path).numbers
    assert [row["contour"] for row in numbers["scans"]] == [4]
    notes = [note for note in numbers["notes"] if "left out" in note]
    assert len(notes) == 2
    assert notes[0].startswith("1 scan left out")
    assert "not one finite point (after contour 1)" in notes[0]
    assert notes[1].startswith("3 scans left out")
    assert "wrong unit? (after contour 2-4)" in notes[1]
    assert "wrong unit?" in (tmp_path / "report.html").read_text(encoding="utf-8")


def test_report_shows_the_error_after_each_scan(tmp_path: Path) -> None:
    part = scanned()
    report = write_report(part, tmp_path)
    names = {path.stem for path in report.pictures}
    assert {"scan_errors", "scan_maps"} <= names
    assert [row["contour"] for row in report.numbers["scans"]] == [0, 2, 4]
    assert [row["mean_mm"] for row in report.numbers["scans"]] == pytest.approx([0.1, 0.2, 0.3], abs=0.02)


def test_without_scans_the_summary_has_an_empty_list() -> None:
    assert summary(PART)["scans"] == []


def test_curves_and_maps_show_the_errors() -> None:
    part = scanned()
    errors = scan_errors(part.scans, part.nominal, TARGET)
    with style.applied():
        curves, maps = scan_figures.scan_curves(errors), scan_figures.scan_maps(errors, TARGET)
    shown = {str(line.get_label()): line for line in curves.axes[0].get_lines()}
    np.testing.assert_allclose(shown["mean"].get_ydata(), [1e3 * error.mean_abs for error in errors])
    np.testing.assert_array_equal(shown["largest"].get_xdata(), [1, 3, 5])
    images = [image for axes in maps.axes for image in axes.get_images()]
    assert len(images) == 3
    assert len({image.get_clim() for image in images}) == 1
