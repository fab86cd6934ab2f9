"""``isf learn --scan``: the scan of a part from a bench, in the clamp or out of it, becomes the correction of the next.

The part is formed on the fast sheet; out of the clamp it is that shape, cut and bent by a release that is known here.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from isf_analysis.bag.bag_writer import write_bag
from isf_analysis.measures.record import PartRecord
from isf_cell import in_process
from isf_cell.cli import app
from isf_cell.commands.learn import learn_record
from isf_core.errors import ErrorCode, IsfError
from isf_core.geometry.height_map import HeightMap
from isf_springback.estimators import learning
from numpy.typing import NDArray
from quick_cone import FOLDER, quick_cone
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

Array = NDArray[np.float64]

NOISE = 0.1e-3
MOTION = Rotation.from_euler("xyz", [1.5, -2.0, 2.0], degrees=True), np.array([4e-3, -3e-3, 12e-3])
RIM = 28e-3
"""m, radius at which the part is cut out of the sheet; its opening has 17 mm."""
CURL = 0.6e-3
"""m, by which the cut edge rises over the middle when the part is released."""


@pytest.fixture(scope="module")
def part() -> PartRecord:
    """Its shape is that of a corrected one, and it is said to have been formed without: nothing is left of others."""
    formed = in_process.form(quick_cone("method: analytic"))
    nothing = tuple(replace(step, offset=np.zeros_like(step.offset)) for step in formed.corrections)
    return replace(formed, corrections=nothing, correction="none", job_text=quick_cone("method: none").text)


@pytest.fixture(scope="module")
def released(part: PartRecord) -> Array:
    """(P, 3) m, the part out of the clamp."""
    assert part.scan is not None
    points = part.scan.points()
    radius = np.hypot(points[:, 0], points[:, 1])
    points[:, 2] += CURL * (radius / RIM) ** 2
    return np.asarray(points[radius < RIM])


@pytest.fixture(scope="module")
def run(part: PartRecord, released: Array, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("formed")
    write_bag(replace(part, released=released), folder / "bag")
    return folder


@pytest.fixture(scope="module")
def from_run(run: Path, tmp_path_factory: pytest.TempPathFactory) -> learning.Learned:
    """What is learned from the run itself."""
    return learned(tmp_path_factory.mktemp("known"), run)[0]


def learned(folder: Path, *arguments: object) -> tuple[learning.Learned, dict[str, Any]]:
    file = folder / "known.npz"
    done = CliRunner().invoke(app, ["learn", *map(str, arguments), "-o", str(file), "--json"])
    if done.exception is not None:
        raise done.exception
    return learning.load(file), json.loads(done.stdout)


def measured(points: Array, *, moved: bool = True) -> Array:
    """``points`` (P, 3) m as a bench measures them: in its own frame, with noise."""
    turn, shift = MOTION
    seen = points + np.random.default_rng(5).normal(0.0, NOISE, points.shape)
    return np.asarray(turn.apply(seen) + shift) if moved else seen


def as_ply(path: Path, points: Array, unit: float = 1e-3) -> Path:
    names = "".join(f"property double {axis}\n" for axis in "xyz")
    head = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(points)}\n{names}end_header\n"
    path.write_bytes(head.encode() + np.ascontiguousarray(points / unit, dtype="<f8").tobytes())
    return path


def difference(one: learning.Learned, other: learning.Learned) -> tuple[float, float]:
    """mm, root mean square and largest difference of the corrections of the next part."""
    assert np.array_equal(one.contour, other.contour)
    away = 1e3 * (one.push - other.push)
    return float(np.sqrt(np.mean(away**2))), float(np.abs(away).max())


def test_a_scan_in_the_clamp_teaches_what_the_run_teaches(
    part: PartRecord, run: Path, from_run: learning.Learned, tmp_path: Path
) -> None:
    """In another frame, and from a mesh in inches: 0.1 mm of noise are 0.04 mm of correction."""
    assert part.scan is not None
    points = part.scan.points()
    assert np.abs(from_run.push).mean() > 0.5e-3  # there is something to correct
    ply = as_ply(tmp_path / "bench.ply", measured(points))
    known, told = learned(tmp_path, run, "--scan", ply, "--unit", "mm", "--align", "fit")
    rms, largest = difference(known, from_run)
    assert rms < 0.06
    assert largest < 0.25
    assert (told["state"], told["release"], told["align"]) == ("clamped", None, "fit")
    assert told["moved"]["angle_deg"] == pytest.approx(np.degrees(MOTION[0].magnitude()), abs=0.1)

    rows, columns = part.scan.z.shape
    number = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = (x.ravel() for x in (number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1]))
    faces = np.vstack([np.column_stack([a, b, c]), np.column_stack([a, c, d])])
    (tmp_path / "bench.stl").write_bytes(
        trimesh.Trimesh(points / 25.4e-3, faces, process=False).export(file_type="stl")
    )
    (tmp_path / "known.npz").unlink()
    known, told = learned(tmp_path, run, "--scan", tmp_path / "bench.stl", "--unit", "in")
    assert difference(known, from_run)[0] < 0.03
    assert told["align"] == "clamp"


def test_without_a_run_the_contours_are_those_of_the_job(
    part: PartRecord, run: Path, from_run: learning.Learned, tmp_path: Path
) -> None:
    """As planned, and then as the file that was learned corrects them, which a program of the second part holds."""
    assert part.scan is not None
    np.savez(tmp_path / "bench.npz", points=part.scan.points())
    text = quick_cone("method: none").text.replace("../parts", str(FOLDER.parent / "parts"))
    (tmp_path / "first.yaml").write_text(text)
    known, told = learned(tmp_path, tmp_path / "first.yaml", "--scan", tmp_path / "bench.npz")
    assert difference(known, from_run)[1] < 1e-6
    assert "as it was planned" in told["contours"]
    assert told["remarks"] == []

    learning.save(known, tmp_path / "second.npz")
    (tmp_path / "second.yaml").write_text(text.replace("method: none", "method: learned\n  learning: second.npz"))
    again, told = learned(tmp_path, tmp_path / "second.yaml", "--scan", tmp_path / "bench.npz")
    assert "corrected by method learned" in told["contours"]
    assert again.parts == 2
    # the correction that was formed is the one that was asked for, but for its limits from point to point
    assert 1e3 * np.sqrt(np.mean((again.applied - known.push) ** 2)) < 0.1

    (tmp_path / "third.yaml").write_text(text.replace("method: none", "method: fused"))
    _, told = learned(tmp_path, tmp_path / "third.yaml", "--scan", tmp_path / "bench.npz")
    assert "name its run or bag" in told["remarks"][0]
    _, told = learned(tmp_path, tmp_path / "third.yaml", "--scan", tmp_path / "bench.npz", "--as-planned")
    assert told["remarks"] == []


def test_what_the_release_moved_is_taken_out_where_it_is_known(
    run: Path, released: Array, from_run: learning.Learned, tmp_path: Path
) -> None:
    """Else it is corrected: the middle lies lower than the rim that the part is laid onto its target with."""
    ply = as_ply(tmp_path / "bench.ply", measured(released))
    known, told = learned(tmp_path, run, "--scan", ply, "--unit", "mm", "--release-of", run)
    rms, largest = difference(known, from_run)
    assert rms < 0.06
    assert largest < 0.25
    assert (told["state"], told["release"]["treated"], told["align"]) == ("released", "taken out", "fit")

    (tmp_path / "known.npz").unlink()
    counted, told = learned(tmp_path, run, "--scan", ply, "--unit", "mm", "--released")
    assert told["release"] == {"treated": "corrected as springback"}
    assert difference(counted, from_run)[0] > 0.15
    # the curl alone, whatever the fit: from the inner contact to the outer one by 0.6 mm (16 mm / 28 mm)^2 at most
    last, first = (counted.contour == k for k in (counted.contour.max(), 0))
    error = {name: item.error for name, item in (("out", counted), ("in", from_run))}
    apart = {name: float(np.nanmean(item[last]) - np.nanmean(item[first])) for name, item in error.items()}
    assert -0.3e-3 < apart["out"] - apart["in"] < -0.05e-3


@pytest.mark.parametrize(
    ("name", "options", "code", "words"),
    [
        ("mm.ply", ("--unit", "m"), ErrorCode.SCAN_UNIT_SUSPECT, "--unit mm"),
        ("mm.ply", ("--unit", "cm"), ErrorCode.SCAN_UNIT_SUSPECT, "--unit mm"),
        ("mm.ply", ("--unit", "in"), ErrorCode.SCAN_UNIT_SUSPECT, "--unit mm"),
        ("mm.ply", (), ErrorCode.MESH_UNIT_UNKNOWN, "--unit mm"),
        ("mm.npz", (), ErrorCode.SCAN_UNIT_SUSPECT, "in m; these are in mm"),
        ("moved.ply", ("--unit", "mm"), ErrorCode.SCAN_SHIFTED, "--align fit"),
        ("nan.ply", ("--unit", "mm"), ErrorCode.SCAN_INCOMPLETE, "three in a plane"),
        ("none.ply", ("--unit", "mm"), ErrorCode.MESH_UNREADABLE, "no such file|cannot be read|check"),
        ("mm.ply", ("--unit", "mm", "--align", "best"), ErrorCode.FILE_FIELD, "clamp or fit"),
        ("flat.ply", ("--unit", "mm"), ErrorCode.SCAN_OF_ANOTHER_PART, "belong together"),
        ("blank.ply", ("--unit", "mm"), ErrorCode.SCAN_OF_ANOTHER_PART, "an unformed blank"),
        ("blank.ply", ("--unit", "mm", "--align", "fit"), ErrorCode.SCAN_OF_ANOTHER_PART, "an unformed blank"),
        ("upside_down.ply", ("--unit", "mm", "--align", "fit"), ErrorCode.SCAN_SHIFTED, "z up"),
        ("turned.ply", ("--unit", "mm", "--align", "fit"), ErrorCode.SCAN_SHIFTED, "10 mm and 10 deg"),
        ("aside.ply", ("--unit", "mm", "--align", "fit"), ErrorCode.SCAN_SHIFTED, "10 mm and 10 deg"),
    ],
)
def test_a_scan_that_cannot_be_meant_is_refused(
    name: str, options: tuple[str, ...], code: ErrorCode, words: str, part: PartRecord, run: Path, tmp_path: Path
) -> None:
    assert part.scan is not None
    points = part.scan.points()
    if name == "mm.npz":
        np.savez(tmp_path / name, points=1e3 * points)
    elif name != "none.ply":
        ball = points * [1.0, 1.0, 0.0] - np.column_stack([0 * points[:, :2], 8e-3 * (np.abs(points[:, 0]) < 5e-3)])
        shapes = {
            "moved.ply": measured(points),
            "nan.ply": np.full_like(points, np.nan),
            "flat.ply": ball,
            "blank.ply": points * [1.0, 1.0, 0.0],
            "upside_down.ply": points * [1.0, -1.0, -1.0],
            "turned.ply": Rotation.from_euler("x", 14.0, degrees=True).apply(points),
            "aside.ply": points + [13e-3, 0.0, 0.0],
        }
        as_ply(tmp_path / name, shapes.get(name, points))
    with pytest.raises(IsfError) as caught:
        learned(tmp_path, run, "--scan", tmp_path / name, *options)
    assert caught.value.code == code
    assert any(word in str(caught.value) for word in words.split("|"))
    assert not (tmp_path / "known.npz").exists()


def test_a_run_whose_own_scan_shows_a_blank_teaches_only_where_no_model_corrected_it(part: PartRecord) -> None:
    """Without a correction a shallow part may have sprung back altogether."""
    assert part.scan is not None
    blank = replace(part, scan=HeightMap(part.scan.x, part.scan.y, 0.0 * part.scan.z))
    assert np.abs(learn_record(blank, FOLDER).push).max() > 1e-3
    with pytest.raises(IsfError) as caught:
        learn_record(replace(blank, correction="elastic"), FOLDER)
    assert caught.value.code == ErrorCode.SCAN_OF_ANOTHER_PART


def test_options_that_do_not_go_together_are_refused(run: Path, part: PartRecord, tmp_path: Path) -> None:
    assert part.scan is not None
    np.savez(tmp_path / "bench.npz", points=part.scan.points())
    scan = ("--scan", tmp_path / "bench.npz")
    write_bag(part, tmp_path / "clamped" / "bag")
    for arguments, where in (
        ((run, "--released"), "--released"),
        ((run, "--unit", "mm"), "--unit"),
        ((run, run, *scan), "--scan"),
        ((run, *scan, "--as-planned"), "--as-planned"),
        ((run, *scan, "--surfaces"), "--scan"),
        ((run, *scan, "--release-of", tmp_path / "clamped"), "--release-of"),
        ((FOLDER / "mini_cone.yaml",), "mini_cone.yaml"),
    ):
        with pytest.raises(IsfError) as caught:
            learned(tmp_path, *arguments)
        assert where in caught.value.where
        assert caught.value.advice
