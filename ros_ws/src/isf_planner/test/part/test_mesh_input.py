"""Reading mesh files: formats, units, and every kind of damaged file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from isf_core.errors import ErrorCode, IsfError
from isf_planner.part.meshes import FORMATS, load_mesh
from planner_parts import Cone, write

CONE = Cone().mesh(50e-6)


def code_of(path: Path, unit: str = "mm") -> ErrorCode:
    with pytest.raises(IsfError) as caught:
        load_mesh(path, unit)
    assert str(path) in caught.value.where
    return caught.value.code


@pytest.mark.parametrize("kind", FORMATS)
def test_every_format_gives_the_same_surface(kind: str, tmp_path: Path) -> None:
    mesh = load_mesh(write(CONE, tmp_path / f"cone.{kind}"), "mm")
    assert mesh.faces.shape == CONE.faces.shape
    # single precision of mm coordinates (2e-6 mm), and merged vertices rounded to 1e-7 m in some versions
    np.testing.assert_allclose(np.sort(mesh.vertices[:, 2]), np.sort(CONE.vertices[:, 2]), atol=2e-7)
    volume = np.einsum("fd,fd->", *_areas_and_heights(mesh)), np.einsum("fd,fd->", *_areas_and_heights(CONE))
    assert volume[0] == pytest.approx(volume[1], rel=1e-4)


def _areas_and_heights(mesh: object) -> tuple[np.ndarray, np.ndarray]:
    corners = mesh.corners()  # type: ignore[attr-defined]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return cross[:, 2:], corners[:, :, 2].mean(axis=1, keepdims=True)


@pytest.mark.parametrize(("unit", "per_metre"), [("m", 1.0), ("cm", 100.0), ("mm", 1000.0), ("in", 1 / 0.0254)])
def test_the_declared_unit_is_applied(unit: str, per_metre: float, tmp_path: Path) -> None:
    mesh = load_mesh(write(CONE, tmp_path / "cone.stl", per_metre), unit)
    # single precision: 6e-8 of the largest coordinate, and merging within 1e-7 m
    assert np.ptp(mesh.vertices, axis=0) == pytest.approx(np.ptp(CONE.vertices, axis=0), abs=2e-7)


def test_missing_file(tmp_path: Path) -> None:
    assert code_of(tmp_path / "none.stl") is ErrorCode.MESH_UNREADABLE


def test_folder_instead_of_a_file(tmp_path: Path) -> None:
    (tmp_path / "folder.stl").mkdir()
    assert code_of(tmp_path / "folder.stl") is ErrorCode.MESH_UNREADABLE


def test_format_that_is_not_a_mesh(tmp_path: Path) -> None:
    path = tmp_path / "part.pdf"
    path.write_text("%PDF")
    assert code_of(path) is ErrorCode.MESH_UNREADABLE


@pytest.mark.parametrize("kind", FORMATS)
def test_empty_file(kind: str, tmp_path: Path) -> None:
    path = tmp_path / f"part.{kind}"
    path.write_bytes(b"")
    assert code_of(path) is ErrorCode.MESH_EMPTY


@pytest.mark.parametrize("kind", FORMATS)
def test_text_that_is_not_a_mesh(kind: str, tmp_path: Path) -> None:
    path = tmp_path / f"part.{kind}"
    path.write_text("dear customer, please find attached the part\n" * 20)
    assert code_of(path) in (ErrorCode.MESH_UNREADABLE, ErrorCode.MESH_EMPTY)


@pytest.mark.parametrize("kind", FORMATS)
def test_random_bytes(kind: str, tmp_path: Path) -> None:
    path = tmp_path / f"part.{kind}"
    path.write_bytes(np.random.default_rng(1).bytes(5000))
    assert code_of(path) in (ErrorCode.MESH_UNREADABLE, ErrorCode.MESH_EMPTY, ErrorCode.MESH_NOT_FINITE)


@pytest.mark.parametrize("kept", [60, 100, 5000])
def test_truncated_binary_stl(kept: int, tmp_path: Path) -> None:
    path = write(CONE, tmp_path / "part.stl")
    path.write_bytes(path.read_bytes()[:kept])
    assert code_of(path) in (ErrorCode.MESH_UNREADABLE, ErrorCode.MESH_EMPTY)


def test_truncation_is_reported_with_the_number_of_facets(tmp_path: Path) -> None:
    path = write(CONE, tmp_path / "part.stl")
    path.write_bytes(path.read_bytes()[: 84 + 10 * 50])
    with pytest.raises(IsfError, match=f"10 of {len(CONE.faces)} facets"):
        load_mesh(path, "mm")


def test_stl_without_facets(tmp_path: Path) -> None:
    path = tmp_path / "part.stl"
    path.write_text("solid nothing\nendsolid nothing\n")
    assert code_of(path) is ErrorCode.MESH_EMPTY


def test_point_cloud(tmp_path: Path) -> None:
    path = tmp_path / "part.ply"
    header = (
        "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\nend_header\n"
    )
    path.write_text(header + "0 0 0\n1 0 0\n0 1 0\n")
    assert code_of(path) in (ErrorCode.MESH_EMPTY, ErrorCode.MESH_UNREADABLE)


@pytest.mark.filterwarnings("ignore:invalid value:RuntimeWarning")  # trimesh computes normals when it writes
@pytest.mark.parametrize("value", [np.nan, np.inf])
@pytest.mark.parametrize("kind", ["stl", "ply"])
def test_vertex_that_is_not_a_number(value: float, kind: str, tmp_path: Path) -> None:
    vertices = CONE.vertices.copy()
    vertices[7, 1] = value
    path = write(type(CONE)(vertices, CONE.faces), tmp_path / f"part.{kind}")
    assert code_of(path) is ErrorCode.MESH_NOT_FINITE


def test_facets_without_area(tmp_path: Path) -> None:
    path = write(type(CONE)(np.zeros((3, 3)), np.array([[0, 1, 2]])), tmp_path / "part.stl")
    assert code_of(path) is ErrorCode.MESH_EMPTY
