"""``isf compare`` of what a user has: runs, CAD, jobs, clouds; and what it refuses."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import isf_analysis
import numpy as np
import pytest
from isf_analysis.bag.bag_writer import write_bag
from isf_analysis.bag.table_files import write_tables
from isf_analysis.figures import distance_figures, style
from isf_analysis.measures.contour_scan import kept_scan
from isf_analysis.measures.plan_mask import PlanMask, shapes_of
from isf_cell.commands.compare import Masks, compare_shapes
from isf_cell.shape_file import load_shape
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import load_job
from isf_planner.planning import plan
from synthetic_part import make_part

PARTS = Path(__file__).resolve().parents[5] / "examples" / "parts"
JOBS = PARTS.parent / "jobs"
PART = make_part(contours=2, spacing=5e-3, points=12)
LIFT = 0.25e-3


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two runs, the scan of the second one a quarter of a millimetre higher."""
    folder = tmp_path_factory.mktemp("runs")
    assert PART.scan is not None
    write_bag(PART, folder / "first")
    write_bag(replace(PART, scan=replace(PART.scan, z=PART.scan.z + LIFT)), folder / "second")
    return folder


def compared(capsys: pytest.CaptureFixture[str], *arguments: Any) -> dict[str, Any]:
    first, second, unit, align, output = arguments
    compare_shapes(first, second, unit, align, (0.1, 0.3), output, as_json=True)
    return dict(json.loads(capsys.readouterr().out))


def test_two_runs(runs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    data = compared(capsys, runs / "second", runs / "first", None, "clamp", tmp_path / "out")
    assert 0.6 * 1e3 * LIFT < data["mean_mm"] <= 1e3 * LIFT  # along the normal: less on the wall
    assert data["max_abs_mm"] == pytest.approx(1e3 * LIFT, rel=0.02)
    assert data["within_fraction"]["0.3"] == 1.0
    assert (tmp_path / "out" / "compare.png").stat().st_size > 20_000
    assert len((tmp_path / "out" / "distances.csv").read_text().splitlines()) == 1 + 51 * 51
    fitted = compared(capsys, runs / "second", runs / "first", None, "fit", tmp_path / "fit")
    assert fitted["max_abs_mm"] < 0.01
    assert fitted["moved"]["shift_mm"][2] == pytest.approx(-1e3 * LIFT, abs=0.005)


def test_the_six_numbers_of_a_step_up_and_down(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A plate 100 x 100 mm: a quarter of it 0.4 mm high, a quarter 0.1 mm low, half of it on the other one."""
    x, y = (part.ravel() / 1e3 for part in np.meshgrid(np.arange(-50, 51), np.arange(-50, 51)))
    np.savez(tmp_path / "flat.npz", points=np.column_stack([x, y, 0.0 * x]))
    z = np.where(x < 0.0, 0.0, np.where(y < 0.0, 0.4e-3, -0.1e-3))
    np.savez(tmp_path / "steps.npz", points=np.column_stack([x, y, z]))
    compare_shapes(tmp_path / "steps.npz", tmp_path / "flat.npz", None, "clamp", (0.2,), tmp_path / "out", as_json=True)
    shown = capsys.readouterr()
    table2 = json.loads(shown.out)["table2"]
    assert (table2["mean_positive_mm"], table2["mean_negative_mm"]) == pytest.approx((0.4, -0.1), abs=1e-9)
    assert (table2["max_mm"], table2["min_mm"]) == pytest.approx((0.4, -0.1), abs=1e-9)
    # rows on the border of the quarters: half a cell more or less
    assert table2["mean_mm"] == pytest.approx(0.25 * 0.4 - 0.25 * 0.1, abs=0.005)
    assert table2["std_mm"] == pytest.approx((0.25 * 0.4**2 + 0.25 * 0.1**2 - 0.075**2) ** 0.5, abs=0.005)
    for words in ("mean of what lies above", "mean of what lies below", "+0.400 mm", "-0.100 mm", "standard deviation"):
        assert words in shown.err
    compare_shapes(tmp_path / "flat.npz", tmp_path / "flat.npz", None, "clamp", (0.2,), tmp_path / "same", as_json=True)
    assert json.loads(capsys.readouterr().out)["table2"]["mean_negative_mm"] is None


def test_clouds_as_the_tables_of_a_bag_have_them(runs: Path, tmp_path: Path) -> None:
    assert PART.scan is not None
    points = PART.scan.points()
    np.savez(tmp_path / "scan.npz", **dict(zip("xyz", points.T, strict=True)))
    rows = "\n".join(",".join(map(repr, [0, *point])) for point in points.tolist())
    (tmp_path / "scan.csv").write_text(f"received,x,y,z\n{rows}\n")
    head = f"ply\nformat ascii 1.0\nelement vertex {len(points)}\n" + "".join(f"property float {a}\n" for a in "xyz")
    body = "\n".join(" ".join(f"{1e3 * value:.6f}" for value in point) for point in points.tolist())
    (tmp_path / "scan.ply").write_text(f"{head}end_header\n{body}\n")
    wanted = load_shape(runs / "first", None)
    for name in ("scan.npz", "scan.csv", "scan.ply"):
        cloud = load_shape(tmp_path / name, "mm")
        np.testing.assert_allclose(cloud.points, wanted.points, atol=1e-9)
        assert np.abs(wanted.surface.distances(cloud.points).signed).max() < 1e-8
        assert np.abs(cloud.surface.distances(wanted.points[::50]).signed).max() < 1e-8


def test_of_a_table_with_scans_between_contours_the_last_one_counts(runs: Path, tmp_path: Path) -> None:
    """Written by ``isf bag tables`` from a run that was scanned after a contour, all its messages at one time."""
    assert PART.scan is not None
    early = kept_scan(0, PART.results[0].end, PART.scan.points() + [0.0, 0.0, 10e-3])
    write_bag(replace(PART, scans=(early,)), tmp_path / "run")
    with isf_analysis.open(tmp_path / "run") as bag:
        assert bag["scan"].messages == 2
        write_tables(bag, tmp_path, ["npz", "csv"], ["scan"])
    wanted = load_shape(runs / "first", None)
    for name in ("scan.npz", "scan.csv"):
        cloud = load_shape(tmp_path / name, None)
        assert len(cloud.points) == len(wanted.points)
        assert np.abs(wanted.surface.distances(cloud.points).signed).max() < 1e-6


@pytest.mark.parametrize("name", ["tpif_cone", "two_features", "adsif_cone", "ren_pyramid"])
def test_the_cad_of_a_job_lies_where_it_is_formed(name: str) -> None:
    """Over a die, from both sides, from the centre outwards, and as usual: the target of the plan lies on it."""
    shape, target = load_shape(JOBS / f"{name}.yaml", None), plan(load_job(JOBS / f"{name}.yaml")).target
    points = target.points()[np.abs(target.points()[:, 2]) > 1e-3]
    found = shape.surface.distances(points)
    assert np.quantile(np.abs(found.signed[~found.beside]), 0.9) < 50e-6


def test_points_of_a_scan_stand_for_the_area_around_them(runs: Path, tmp_path: Path) -> None:
    """A grid seen from above has fewer points on a wall: one of 50 deg stands for 1 / cos 50 deg of a cell."""
    assert PART.scan is not None
    np.savez(tmp_path / "scan.npz", points=PART.scan.points())
    for shape in (load_shape(runs / "first", None), load_shape(tmp_path / "scan.npz", None)):
        x, y = shape.points[:, 0], shape.points[:, 1]
        cell = (x.max() - x.min()) ** 2 / 50**2
        inside, radius = np.maximum(abs(x), abs(y)) < 0.12, np.hypot(x, y)
        flange, wall = inside & (radius > 0.09), abs(radius - 0.03) < 5e-3
        assert shape.area[flange].mean() == pytest.approx(cell, rel=0.01)
        assert shape.area[wall].mean() == pytest.approx(cell / np.cos(np.radians(50.0)), rel=0.1)
        assert shape.area.sum() == pytest.approx(shape.surface.area.sum(), rel=1e-9)


def test_cad_and_the_job_that_places_it_are_the_same_shape() -> None:
    cad, placed = load_shape(PARTS / "mini_cone.stl", "mm"), load_shape(JOBS / "mini_cone.yaml", None)
    assert np.abs(placed.surface.distances(cad.points[::25]).signed).max() < 5e-6


@pytest.mark.parametrize(
    ("name", "content", "code"),
    [
        ("scan.npz", b"no archive", ErrorCode.FILE_SYNTAX),
        ("scan.csv", b"a,b\n1,2\n", ErrorCode.FILE_SYNTAX),
        ("flat.csv", b"x,y,z\n0,0,0\n1,1,1\n", ErrorCode.SCAN_INCOMPLETE),
        ("shape.txt", b"?", ErrorCode.MESH_UNREADABLE),
        ("cad.stl", b"", ErrorCode.MESH_EMPTY),
        ("cloud.ply", b"ply\nend_header\n", ErrorCode.MESH_UNREADABLE),
        ("facets.ply", b"ply\nformat ascii 1.0\nelement face\nend_header\n", ErrorCode.MESH_UNREADABLE),
    ],
)
def test_what_is_no_shape_is_refused_with_a_code(name: str, content: bytes, code: ErrorCode, tmp_path: Path) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(IsfError) as caught:
        load_shape(tmp_path / name, "mm")
    assert caught.value.code == code
    assert caught.value.advice


def test_a_scan_that_saw_nothing_is_refused(tmp_path: Path) -> None:
    assert PART.scan is not None
    write_bag(replace(PART, scan=replace(PART.scan, z=np.full_like(PART.scan.z, np.nan))), tmp_path / "run")
    with pytest.raises(IsfError) as caught:
        load_shape(tmp_path / "run", None)
    assert caught.value.code in (ErrorCode.SCAN_INCOMPLETE, ErrorCode.BAG_INCOMPLETE)


def test_shapes_in_another_frame_or_unit_are_refused(runs: Path, tmp_path: Path) -> None:
    assert PART.scan is not None
    for factor, offset in ((1e3, 0.0), (1.0, 0.5)):
        points = factor * PART.scan.points() + offset
        np.savez(tmp_path / "cloud.npz", points=points)
        with pytest.raises(IsfError, match="another frame or unit") as caught:
            compare_shapes(
                tmp_path / "cloud.npz", runs / "first", None, "clamp", (0.1,), tmp_path / "out", as_json=False
            )
        assert caught.value.code == ErrorCode.SCAN_INCOMPLETE


def test_what_makes_no_sense_is_refused(runs: Path, tmp_path: Path) -> None:
    first = runs / "first"
    for align, tolerances in (("best", (0.1,)), ("clamp", (-1.0,)), ("clamp", (float("nan"),))):
        with pytest.raises(IsfError) as caught:
            compare_shapes(first, first, None, align, tolerances, tmp_path / "out", as_json=False)
        assert caught.value.code == ErrorCode.FILE_FIELD
    with pytest.raises(IsfError) as caught:
        load_shape(PARTS / "mini_cone.stl", None)
    assert caught.value.code == ErrorCode.MESH_UNIT_UNKNOWN


@pytest.fixture(scope="module")
def step(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A flat plate of 100 x 80 mm, and one with a pad of 40 x 20 mm that is 0.5 mm higher; as clouds, m, 1 mm apart.

    The pad reaches from x = 10 to 50 and from y = -10 to 10 mm, the edge included.
    """
    folder = tmp_path_factory.mktemp("step")
    x, y = np.meshgrid(np.arange(-50, 51) / 1e3, np.arange(-40, 41) / 1e3)
    pad = (x > 9.5e-3) & (np.abs(y) < 10.5e-3)
    for name, z in (("flat", 0.0 * x), ("pad", 0.5e-3 * pad)):
        np.savez(folder / f"{name}.npz", x=x.ravel(), y=y.ravel(), z=z.ravel())
    return folder


@pytest.mark.parametrize(
    ("masks", "mean", "largest", "points"),
    [
        (Masks(inside=("box:12,-8,48,8",)), 0.5, 0.5, 37 * 17),
        (Masks(inside=("box:12,-8,48,8",), outside=("box:30,-20,60,20",)), 0.5, 0.5, 18 * 17),
        (Masks(outside=("box:8,-12,52,12",)), 0.0, 0.0, 101 * 81 - 43 * 25),
        (Masks(inside=("circle:-30,20,9.9", "circle:-30,-20,9.9")), 0.0, 0.0, 2 * 305),
    ],
)
def test_numbers_picture_and_table_are_those_of_the_masked_points(
    masks: Masks,
    mean: float,
    largest: float,
    points: int,
    step: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    compare_shapes(
        step / "pad.npz", step / "flat.npz", None, "clamp", (0.1, 0.6), tmp_path / "out", masks, as_json=True
    )
    data = json.loads(capsys.readouterr().out)
    assert data["points"] == points
    assert (data["mean_mm"], data["max_abs_mm"]) == pytest.approx((mean, largest), abs=1e-9)
    assert data["within_fraction"] == {"0.1": 0.0 if mean else 1.0, "0.6": 1.0}
    table = np.loadtxt(data["table"], delimiter=",", skiprows=1)
    assert len(table) == points
    np.testing.assert_allclose(table[:, 3], mean, atol=1e-6)
    assert data["mask"]["inside"] == list(masks.inside)
    assert Path(data["picture"]).stat().st_size > 10_000


def test_the_share_that_is_masked_is_one_of_the_area(
    step: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Half of the plate, with the points on the border and half of the cells around them; by numpy alone."""
    masks = Masks(outside=("box:0.5,-100,100,100",))
    compare_shapes(
        step / "flat.npz", step / "pad.npz", None, "clamp", (0.1, 0.6), tmp_path / "out", masks, as_json=True
    )
    data = json.loads(capsys.readouterr().out)
    assert data["masked_fraction"] == pytest.approx(49.5 / 100.0, abs=1e-6)
    assert data["points"] == 51 * 81
    compare_shapes(step / "flat.npz", step / "pad.npz", None, "clamp", (0.1, 0.6), tmp_path / "all", as_json=True)
    assert json.loads(capsys.readouterr().out)["masked_fraction"] == 0.0


def test_regions_are_those_of_the_run_that_is_compared_with(
    runs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A scan lifted by 0.25 mm: on the flat base all of it, on a wall of 50 deg 0.64 of it."""
    found = {}
    for name in ("base", "wall", "rim"):
        compare_shapes(
            runs / "second",
            runs / "first",
            None,
            "clamp",
            (0.3,),
            tmp_path / name,
            Masks(regions=(name,)),
            as_json=True,
        )
        found[name] = json.loads(capsys.readouterr().out)
    assert found["base"]["mean_mm"] == pytest.approx(1e3 * LIFT, rel=0.01)
    # 5 mm cells hold no wall that is not beside a fillet of 5 mm
    assert 0.6 * 1e3 * LIFT < found["wall"]["mean_mm"] < 0.9 * 1e3 * LIFT
    x, y = np.loadtxt(found["rim"]["table"], delimiter=",", skiprows=1)[:, :2].T
    radius = np.hypot(x, y)
    assert radius.min() > 35.0
    assert radius.max() < 55.0
    assert sum(data["points"] for data in found.values()) < 51 * 51


def test_a_masked_fit_by_the_command(step: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Without the pad the plates lie on each other as they are; with it the fit is at least not worse than it says."""
    masks = Masks(outside=("box:8,-12,52,12",))
    compare_shapes(step / "pad.npz", step / "flat.npz", None, "fit", (0.1,), tmp_path / "out", masks, as_json=True)
    data = json.loads(capsys.readouterr().out)
    assert data["max_abs_mm"] < 1e-6
    assert np.abs(data["moved"]["shift_mm"]).max() < 1e-6


def test_masks_that_make_no_sense_are_refused(step: Path, runs: Path, tmp_path: Path) -> None:
    cloud, run = step / "flat.npz", runs / "first"
    for second, masks, words in (
        (cloud, Masks(inside=("circle:500,0,10",)), "leaves 0 points"),
        (cloud, Masks(inside=("circle:0,0,0.5",)), "leaves 1 points"),
        (cloud, Masks(outside=("box:-100,-100,100,100",)), "--outside"),
        (cloud, Masks(regions=("wall",)), "has no regions"),
        (run, Masks(regions=("bottom",)), "no region 'bottom'"),
        (cloud, Masks(inside=("ring:0,0,5",)), "--inside"),
    ):
        with pytest.raises(IsfError, match=words) as caught:
            compare_shapes(
                cloud if second == cloud else run, second, None, "clamp", (0.1,), tmp_path / "out", masks, as_json=False
            )
        assert caught.value.code == ErrorCode.FILE_FIELD
        assert caught.value.advice
    assert not (tmp_path / "out").exists()


def test_the_map_is_empty_where_the_mask_is() -> None:
    """A hole of 5 mm in a plate of points 1 mm apart, which the map would close if it were one of the scan."""
    x, y = (part.ravel() / 1e3 for part in np.meshgrid(np.arange(-20, 21), np.arange(-20, 21)))
    points = np.column_stack([x, y, 0.0 * x])
    mask = PlanMask(outside=shapes_of(["circle:0,0,2.5"], "--outside"))
    points = points[mask.counts(points)]
    with style.applied():
        masked = distance_figures.compared(points, points[:, 2], (0.1,), "", mask).axes[0].get_images()[0].get_array()
        closed = distance_figures.compared(points, points[:, 2], (0.1,), "").axes[0].get_images()[0].get_array()
    assert masked is not None
    assert closed is not None
    assert np.isnan(np.ma.filled(masked, np.nan)).sum() > 8
    assert np.isnan(np.ma.filled(closed, np.nan)).sum() < 4
