"""STEP, IGES and 3MF: units they carry, chord error, and what is told about damaged ones.

The CAD files hold the cone of ``planner_parts.Cone`` as exact surfaces, drawn in mm or in inches.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
from isf_core.errors import ErrorCode, IsfError
from isf_planner.part import cad_input
from isf_planner.part.mesh_checks import repair
from isf_planner.part.meshes import Mesh, load_mesh, topology
from planner_parts import Cone

DATA = Path(__file__).parent / "data"
CONE = Cone()


def chord_errors(mesh: Mesh) -> np.ndarray:
    """Distance (F,) m of the middles of the facets from the cone, at most of the chords themselves."""
    radius, z = np.hypot(*mesh.vertices[mesh.faces].mean(axis=1)[:, :2].T), mesh.vertices[mesh.faces].mean(axis=1)[:, 2]
    profile = CONE.profile(1e-9)
    a, b = profile[:-1], profile[1:]
    point = np.column_stack([radius, z])
    best = np.full(len(point), np.inf)
    for p, q in zip([*a, profile[-1]], [*b, np.array([0.0, -CONE.depth])], strict=True):
        share = np.clip(((point - p) @ (q - p)) / ((q - p) @ (q - p)), 0, 1)
        best = np.minimum(best, np.linalg.norm(point - p - share[:, None] * (q - p), axis=1))
    return best


@pytest.mark.parametrize(("name", "unit"), [("cone_mm.step", "mm"), ("cone_inch.step", "in"), ("cone_inch.igs", "in")])
def test_cad_files_bring_their_unit_and_the_exact_surface(name: str, unit: str) -> None:
    pytest.importorskip("cascadio")
    mesh = load_mesh(DATA / name, None)
    # vertices lie on the surface: the middle of a facet is off by at most the chord error of 5 um
    assert chord_errors(mesh).max() < 5.5e-6
    assert mesh.vertices[:, 2].min() == pytest.approx(-CONE.depth, abs=1e-8)
    whole, _ = repair(mesh, 5e-3)
    assert len(topology(whole).free_loops()) == 1
    np.testing.assert_array_equal(load_mesh(DATA / name, unit).vertices, mesh.vertices)


@pytest.mark.parametrize("name", ["cone_mm.step", "cone_inch.igs"])
def test_a_unit_that_contradicts_the_file_is_refused(name: str) -> None:
    pytest.importorskip("cascadio")
    with pytest.raises(IsfError) as caught:
        load_mesh(DATA / name, "m")
    assert caught.value.code is ErrorCode.MESH_UNIT_UNKNOWN
    assert "the job declares m" in caught.value.what


@pytest.mark.parametrize("damage", ["cut", "text", "nothing in it"])
@pytest.mark.parametrize("kind", ["step", "igs"])
def test_damaged_cad_files(kind: str, damage: str, tmp_path: Path) -> None:
    pytest.importorskip("cascadio")
    source = (DATA / ("cone_mm.step" if kind == "step" else "cone_inch.igs")).read_bytes()
    data = {
        "cut": source[: len(source) // 2],
        "text": b"dear customer, please find attached the part\n" * 20,
        "nothing in it": b"ISO-10303-21;\nHEADER;\nENDSEC;\nDATA;\nENDSEC;\nEND-ISO-10303-21;\n",
    }[damage]
    path = tmp_path / f"part.{kind}"
    path.write_bytes(data)
    with pytest.raises(IsfError) as caught:
        load_mesh(path, None)
    assert caught.value.code in (ErrorCode.MESH_UNREADABLE, ErrorCode.MESH_EMPTY)
    assert str(path) in caught.value.where
    assert caught.value.advice


@pytest.mark.parametrize(
    ("program", "said"),
    [
        ("import os, signal; os.kill(os.getpid(), signal.SIGSEGV)", "the converter ended by SIGSEGV"),
        ("raise RuntimeError('no such entity')", "no such entity"),
        ("import time; time.sleep(60)", "could not be converted in 1 s"),  # the fault itself: a converter that hangs
    ],
)
def test_a_converter_that_ends_or_hangs_ends_nothing_else(
    program: str, said: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    pytest.importorskip("cascadio")
    (tmp_path / "converter.py").write_text(program)
    monkeypatch.setenv("PYTHONFAULTHANDLER", "1")  # some have it set: a traceback is then the last that is written
    monkeypatch.setattr(cad_input, "_CONVERTER", tmp_path / "converter.py")
    monkeypatch.setattr(cad_input, "LONGEST", 1.0 if "sleep" in program else 300.0)
    with pytest.raises(IsfError, match=said) as caught:
        load_mesh(DATA / "cone_mm.step", None)
    assert caught.value.code is ErrorCode.MESH_UNREADABLE


def test_without_the_converter_it_is_reported_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "cascadio", None)
    with pytest.raises(IsfError) as caught:
        load_mesh(DATA / "cone_mm.step", None)
    assert "pip install cascadio" in caught.value.advice


def test_3mf_brings_its_unit(tmp_path: Path) -> None:
    source = CONE.mesh(50e-6)
    path = tmp_path / "cone.3mf"
    trimesh.Trimesh(source.vertices * 1e3, source.faces, process=False).export(path)
    mesh = load_mesh(path, None)
    assert mesh.faces.shape == source.faces.shape
    np.testing.assert_allclose(np.ptp(mesh.vertices, axis=0), np.ptp(source.vertices, axis=0), atol=2e-7)
    with pytest.raises(IsfError) as caught:
        load_mesh(path, "in")
    assert caught.value.code is ErrorCode.MESH_UNIT_UNKNOWN


def test_a_mesh_without_unit_needs_one(tmp_path: Path) -> None:
    path = tmp_path / "cone.stl"
    path.write_bytes(b"")
    with pytest.raises(IsfError) as caught:
        load_mesh(path, None)
    assert caught.value.code is ErrorCode.MESH_UNIT_UNKNOWN
