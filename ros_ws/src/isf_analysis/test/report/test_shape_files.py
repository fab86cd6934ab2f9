"""The formed shape in files of other programs, read back by the layout of each format, not by what has written them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from isf_analysis.report.shape_files import write_shape
from isf_core.errors import ErrorCode, IsfError
from isf_core.geometry.height_map import HeightMap
from isf_core.types import Array
from synthetic_part import in_stages, make_part

PART = make_part(contours=5, spacing=2.5e-3)
MICROMETRE = 1e-3  # mm


def holed() -> HeightMap:
    """The scan with a corner that was not seen."""
    scan = PART.scan
    assert scan is not None
    z = scan.z.copy()
    z[:7, :9] = np.nan
    return HeightMap(scan.x, scan.y, z)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    found = tmp_path_factory.mktemp("shape") / "new"
    names = [path.name for path in write_shape(replace(PART, scan=holed()), found)]
    assert names == ["formed.stl", "formed.ply", "formed.vtk"]
    return found


def wanted() -> Array:
    """(N, 3) mm, points of the scan in its own order."""
    points = 1e3 * holed().points()
    return np.asarray(points[np.isfinite(points[:, 2])])


def test_stl_has_the_facets_of_the_scan_in_mm(folder: Path) -> None:
    data = (folder / "formed.stl").read_bytes()
    (count,) = np.frombuffer(data, "<u4", 1, offset=80)
    facets = np.frombuffer(data, [("normal", "<f4", 3), ("corner", "<f4", (3, 3)), ("rest", "<u2")], offset=84)
    ny, nx = holed().z.shape
    assert count == len(facets) == 2 * ((ny - 1) * (nx - 1) - 7 * 9)
    assert (facets["normal"][:, 2] > 0.0).all()
    found = np.unique(np.round(facets["corner"].reshape(-1, 3).astype(float), 4), axis=0)
    expected = wanted()[np.lexsort(wanted().T[::-1])]
    assert np.abs(found[np.lexsort(found.T[::-1])] - expected).max() < MICROMETRE


def test_ply_has_points_and_numbers(folder: Path) -> None:
    data = (folder / "formed.ply").read_bytes()
    head, body = data.split(b"end_header\n", 1)
    lines = head.decode("ascii").splitlines()
    assert "format binary_little_endian 1.0" in lines
    assert f"element vertex {len(wanted())}" in lines
    kinds = {"float": "<f4", "double": "<f8"}
    names = [line.split() for line in lines if line.startswith("property ") and "list" not in line]
    rows = np.frombuffer(body, [(name, kinds[kind]) for _, kind, name in names], count=len(wanted()))
    found = np.column_stack([rows[axis] for axis in "xyz"])
    assert np.abs(found - wanted()).max() < MICROMETRE
    target = PART.target
    assert target is not None
    error = wanted()[:, 2] - 1e3 * target.at(1e-3 * wanted()[:, :2])
    assert np.nanmax(np.abs(rows["deviation_mm"] - error)) < MICROMETRE
    assert np.nanmin(rows["planned_thickness_mm"]) > 0.3
    assert np.isnan(rows["planned_thickness_mm"]).any()  # the flange


def test_vtk_has_points_triangles_and_numbers(folder: Path) -> None:
    data = (folder / "formed.vtk").read_bytes()
    n = len(wanted())
    assert data.startswith(b"# vtk DataFile Version 3.0\ncone, formed shape, mm\nBINARY\nDATASET UNSTRUCTURED_GRID\n")
    at = data.index(b"POINTS")
    head, _ = data[at:].split(b"\n", 1)
    assert head.decode() == f"POINTS {n} double"
    points = np.frombuffer(data, ">f8", 3 * n, offset=at + len(head) + 1).reshape(n, 3)
    assert np.abs(points - wanted()).max() < MICROMETRE
    at = data.index(b"CELLS", at + len(head) + 1 + 24 * n)
    head, _ = data[at:].split(b"\n", 1)
    count, size = (int(word) for word in head.split()[1:])
    cells = np.frombuffer(data, ">i4", size, offset=at + len(head) + 1).reshape(count, 4)
    assert (cells[:, 0] == 3).all()
    assert np.array_equal(np.unique(cells[:, 1:]), np.arange(n))
    mark = b"SCALARS deviation_mm float 1\nLOOKUP_TABLE default\n"
    error = np.frombuffer(data, ">f4", n, offset=data.index(mark) + len(mark))
    target = PART.target
    assert target is not None
    expected = wanted()[:, 2] - 1e3 * target.at(1e-3 * wanted()[:, :2])
    assert np.nanmax(np.abs(error - expected)) < MICROMETRE


def test_without_target_and_plan_the_shape_alone_is_written(tmp_path: Path) -> None:
    bare = replace(PART, target=None, nominal=())
    _, ply, vtk = write_shape(bare, tmp_path)
    assert b"deviation" not in ply.read_bytes()
    assert b"POINT_DATA" not in vtk.read_bytes()


def test_a_shape_that_is_not_compared_has_no_deviation(tmp_path: Path) -> None:
    """The target is flat: the report refuses the comparison."""
    target = PART.target
    assert target is not None
    flat = replace(PART, target=HeightMap(target.x, target.y, np.zeros(target.z.shape)))
    _, ply, _ = write_shape(flat, tmp_path)
    assert b"deviation_mm" not in ply.read_bytes()
    assert b"planned_thickness_mm" in ply.read_bytes()


def test_thickness_of_a_part_formed_in_stages_is_that_of_the_last(tmp_path: Path) -> None:
    one, stages = (write_shape(part, tmp_path / name)[1] for name, part in (("a", PART), ("b", in_stages(PART))))
    assert one.read_bytes() == stages.read_bytes()


def test_what_cannot_be_exported_is_told(tmp_path: Path) -> None:
    scan = PART.scan
    assert scan is not None
    unseen = replace(PART, scan=HeightMap(scan.x, scan.y, np.full(scan.z.shape, np.nan)))
    (tmp_path / "file").write_text("")
    for part, folder, code in (
        (replace(PART, scan=None), tmp_path / "none", ErrorCode.BAG_INCOMPLETE),
        (unseen, tmp_path / "none", ErrorCode.BAG_INCOMPLETE),
        (PART, tmp_path / "file" / "below", ErrorCode.FILE_NOT_WRITABLE),
    ):
        with pytest.raises(IsfError) as caught:
            write_shape(part, folder)
        assert caught.value.code is code
    assert not (tmp_path / "none").exists()
