"""The example jobs: planned without a warning, as documented; and the parts are what the script makes."""

from __future__ import annotations

import importlib.util
import itertools
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import trimesh
from isf_core.contour import over_floor
from isf_core.files.job import JobFile, load_job
from isf_planner import plan
from isf_planner.checks.backing_plate import nearer_plate, plate_file
from isf_planner.part.meshes import Mesh
from isf_planner.part_library.catalogue import PARTS
from isf_planner.part_library.part_mesh import part_mesh
from planner_parts import EXAMPLES, told, write
from scipy.spatial import cKDTree

NAMES = (
    *("ren_cone", "ren_pyramid", "spif_cone", "mini_cone", "torrao_cone_45"),
    *("adsif_cone", "tpif_cone", "tpif_cone_die", "two_features", "free_form", "ren_funnel"),
    *("torrao_cone_70", "torrao_marker", "torrao_mask", "torrao_implant"),
)


@pytest.fixture(scope="module")
def make_parts() -> ModuleType:
    spec = importlib.util.spec_from_file_location("make_parts", EXAMPLES / "make_parts.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["make_parts"] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("name", NAMES)
def test_the_parts_in_the_repository_are_those_of_the_script(name: str, make_parts: ModuleType) -> None:
    path = EXAMPLES / "parts" / f"{name}.stl"
    assert path.stat().st_size < 400_000
    stored = trimesh.load_mesh(path, process=False)
    made = make_parts.all_parts()[name]
    # single precision of the file: 1e-7 of up to 57 mm; which diagonal splits four corners depends on the library
    corners = [mesh.triangles.reshape(-1, 3) for mesh in (stored, made)]
    assert len(corners[0]) == len(corners[1])
    for points, others in (corners, corners[::-1]):
        assert cKDTree(others).query(points)[0].max() < 2e-5
    assert stored.area == pytest.approx(made.area, rel=1e-4)


def changed_example(name: str, changed: dict[str, str], begin: str) -> tuple[str, list[str]]:
    """Text of the example job with pieces of it ``changed``, and the warnings of its plan that ``begin`` so."""
    path = EXAMPLES / "jobs" / f"{name}.yaml"
    text = path.read_text()
    for old, new in changed.items():
        assert old in text
        text = text.replace(old, new)
    return text, [one for one in plan(JobFile(text, path.parent)).warnings if one.startswith(begin)]


@pytest.mark.parametrize(
    ("name", "changed", "free"),
    [
        ("spif_cone", {}, "93 mm between the part and the clamp"),
        ("ren_cone", {}, "99 mm between the part and the clamp"),
        ("ren_cone_on_blank", {}, ""),
        ("ren_cone_plate", {}, ""),
        ("ren_cone_plate_dsif", {}, ""),
        ("ren_cone_plate", {"[76 mm, 76 mm]": "[90 mm, 90 mm]"}, ""),
        ("ren_cone_plate", {"[76 mm, 76 mm]": "[120 mm, 120 mm]"}, "23 mm between the part and the backing plate"),
        # 6 mm away beside the plate's long sides, 37 mm beside the short ones
        (
            "ren_cone_plate",
            {"[76 mm, 76 mm]": "[146 mm, 86 mm]", "shape: circle": "shape: rectangle"},
            "37 mm between the part and the backing plate",
        ),
        ("tpif_cone", {}, ""),
        ("adsif_cone", {}, ""),
    ],
)
def test_a_sheet_that_nothing_holds_near_the_part_is_warned_of(name: str, changed: dict[str, str], free: str) -> None:
    """The cone begins at r = 37 mm; its clamp is a square of 250 mm, farthest away in the directions of the corners."""
    text, warned = changed_example(name, changed, "the sheet is free for")
    assert len(warned) == bool(free)
    assert not free or free in warned[0]
    sinks = {"99": 6.0, "93": 5.8, "23": 2.9, "37": 3.6}  # mm: 0.6 times the root
    assert not free or f"sinks by about {sinks[free[:2]]} mm" in warned[0]
    assert not free or ("path.support: on_blank" in warned[0]) == ("process: DSIF" in text)
    if free:
        opening = 94 if name == "spif_cone" else 76  # r = 45.71 and 37.02 mm, 0.9 mm beside it, whole mm
        assert f"closer to the opening ({{shape: circle, size: [{opening} mm, {opening} mm]}})" in warned[0]


def test_a_plate_stays_outside_the_rounding_of_the_opening_whatever_the_steps() -> None:
    """The rounding of 6 mm ends at r = 47.5 mm and is 0.1 mm deep at 46.45 mm (2 x 6 mm x 0.1 mm, rooted, further in);
    contours in steps of 2.5 mm begin at 43.7 mm."""
    for step, opening in (("0.5 mm", 94), ("2.5 mm", 93)):
        changed = {"incremental_depth: 0.5 mm": f"incremental_depth: {step}", "floor_step": "# floor_step"}
        _, warned = changed_example("spif_cone", changed, "the sheet is free for")
        assert f"{{shape: circle, size: [{opening} mm, {opening} mm]}}" in warned[0]


def test_the_plate_that_is_advised_holds_the_sheet() -> None:
    """A pyramid with sharp corners asks for a rectangle; over it nothing is warned of."""
    bare = load_job(EXAMPLES / "jobs" / "behera_pyramid_60.yaml").changed({"backing_plate": None})
    (warned,) = [one for one in plan(bare).warnings if one.startswith("the sheet is free for")]
    assert "{shape: rectangle, size: [153 mm, 153 mm]}" in warned
    held = plan(bare.changed({"backing_plate": {"shape": "rectangle", "size": ["153 mm", "153 mm"]}}))
    assert told(held) == held.warnings == ()


@pytest.mark.parametrize(
    ("shape", "openings"), [("l_shape", 1), ("two_pockets", 2), ("asymmetric_cone", 1), ("pyramid", 1)]
)
def test_a_part_that_no_round_plate_follows_gets_one_along_its_outline(
    shape: str, openings: int, tmp_path: Path
) -> None:
    """0.9 mm around the first contours; the file holds it, the part is formed over it, and nothing is warned of. The
    opening of the asymmetric cone is round, but 5 mm off the middle of the clamp; the pyramid's corners are round."""
    write(part_mesh(PARTS[shape]()), tmp_path / "part.stl")
    text = (EXAMPLES / "jobs" / "spif_cone.yaml").read_text().replace("../parts/spif_cone.stl", "part.stl")
    job = JobFile(text, tmp_path)
    bare = plan(job)
    (warned,) = [one for one in bare.warnings if one.startswith("the sheet is free for")]
    assert "cut along the part" in warned
    plate = nearer_plate(bare.contours, Mesh(*bare.mesh), job.job, job.rig)
    assert plate is not None
    assert len(plate.openings) == openings
    firsts = [next(one for one in bare.contours if one.feature == k) for k in range(openings)]
    for first in firsts:
        away = plate.inside(first.contact[:, 0], first.contact[:, 1])
        assert away.min() > 0.88e-3
        assert away.max() < 3.0e-3
    (tmp_path / "plate.yaml").write_text(plate_file(plate, "part"), encoding="utf-8")
    held = plan(JobFile(f"{text}backing_plate: plate.yaml\n", tmp_path))
    assert [one for one in held.warnings if "free" in one] == []


@pytest.mark.parametrize(
    ("changed", "force"),
    [
        ({}, "about 415 N; it sheds chips from 220 N"),  # 0.42 R_m R t0 of AA3103: 105 MPa, 5 mm, 1 mm
        ({"  support: on_blank\n": ""}, ""),
    ],
)
def test_a_support_tool_under_the_blank_that_sheds_chips_is_warned_of(changed: dict[str, str], force: str) -> None:
    _, warned = changed_example("ren_cone_on_blank", changed, "the support tool under the blank")
    assert len(warned) == bool(force)
    assert not force or force in warned[0]


@pytest.mark.parametrize(
    ("name", "angle", "depth", "contours"),
    [
        ("ren_cone", 50, 21, 42),
        ("ren_pyramid", 50, 20, 40),
        ("spif_cone", 45, 15, 30),
        ("mini_cone", 45, 5, 10),
        ("ren_cone_on_blank", 50, 21, 42),
        ("ren_cone_plate", 50, 21, 42),
        ("ren_cone_plate_dsif", 50, 21, 42),
    ],
)
def test_examples_are_planned_without_a_warning(name: str, angle: float, depth: float, contours: int) -> None:
    result = plan(load_job(EXAMPLES / "jobs" / f"{name}.yaml"))
    assert told(result) == ()
    made = result.contours
    walls = [made[0], *(one for before, one in itertools.pairwise(made) if not over_floor(one, before))]
    assert len(walls) == contours
    assert walls[-1].forming_tip[:, 2] == pytest.approx(-depth * 1e-3, abs=1e-9)
    assert np.degrees(result.largest_wall_angle) == pytest.approx(angle, abs=0.5)
    for contour in result.contours:
        step = np.linalg.norm(np.roll(contour.forming_tip, -1, axis=0) - contour.forming_tip, axis=1)
        assert np.abs(step / step.mean() - 1).max() < 0.02


def test_straight_walls_of_the_pyramid() -> None:
    """Plane wall of 50 deg: the tip of a ball whose centre is at z runs (R - z cos) / sin inside the opening line."""
    radius, half, angle = 5e-3, 40e-3, np.radians(50)
    for contour in plan(load_job(EXAMPLES / "jobs" / "ren_pyramid.yaml")).contours[10:34]:
        tip = contour.forming_tip
        side = (tip[:, 0] > 0) & (np.abs(tip[:, 1]) < 10e-3)  # the straight part is 36 mm long
        z = tip[0, 2] + radius
        inside = (radius - z * np.cos(angle)) / np.sin(angle)
        # planes have no chord error; the drop errs by up to 2 um, single precision of the file by 0.01 um
        np.testing.assert_allclose(tip[side, 0], half - inside, atol=4e-6)
        np.testing.assert_allclose(contour.wall_angle[side], angle, atol=np.radians(0.5))
