"""A part formed in stages, one program and one shape for each (Behera 2015, Case studies: Morph 1 to N, the part)."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile
from isf_planner import Plan, plan
from isf_planner.exports import export, export_stages, load_plan, load_post, read_programs
from isf_planner.part_library import PARTS, part_mesh
from planner_parts import job_for, write
from scipy.interpolate import LinearNDInterpolator

STEEP = PARTS["cone"](radius=26e-3, angle=np.radians(70), depth=14e-3, entry=5e-3, floor=6e-3)
OPTIONS = "morph: {failure_angle: 66 deg, shapes: 2}, finishing_passes: 1, "


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Plan:
    """Two shapes before the part, the part, and a finishing pass."""
    folder = tmp_path_factory.mktemp("part")
    job_file = job_for(
        write(part_mesh(STEEP, 30e-6), folder / "cone.ply"), process="SPIF", depth="2 mm", force="0 N", limit="80 deg"
    )
    text = job_file.text.replace("incremental_depth", f"{OPTIONS}incremental_depth", 1)
    return plan(JobFile(text, job_file.base))


def test_a_program_for_every_stage_holds_its_contours_alone(made: Plan, tmp_path: Path) -> None:
    files = export_stages(made, tmp_path / "cone.nc")
    assert [file.name for file in files] == [f"cone_stage_{k}.nc" for k in (1, 2, 3, 4)]
    for stage, file in enumerate(files):
        wanted = [contour for contour in made.contours if contour.stage == stage]
        found = read_programs([file], load_post("iso"))
        assert len(found) == len(wanted)
        for (tips, _), contour in zip(found, wanted, strict=True):
            np.testing.assert_allclose(tips, contour.forming_tip, atol=1e-7)
        text = file.read_text()
        assert f"(contour 1 of {len(wanted)})" in text
        assert f"part_stage_{stage + 1}-{made.plan_id[-8:]}" in text
        assert re.findall(r"^G0 Z(\S+)$", text, re.MULTILINE)[0] == "20.0000"  # begins with a lifted tool
    assert sum(1 for file in files for _ in read_programs([file], load_post("iso"))) == len(made.contours)


def test_a_shape_for_every_stage_and_the_part_is_the_last(made: Plan, tmp_path: Path) -> None:
    """The finishing pass ends with the part's shape, which is written once."""
    files = export_stages(made, tmp_path / "cone.stl")
    assert [file.name for file in files] == [f"cone_stage_{k}.stl" for k in (1, 2, 3)]
    meshes = [trimesh.load_mesh(file) for file in files]
    depths = [-float(mesh.vertices[:, 2].min()) for mesh in meshes]
    assert depths == sorted(depths)
    assert depths[0] < 13.0
    assert depths[-1] == pytest.approx(14.0, abs=1e-3)
    for mesh, stage in zip(meshes, made.stages, strict=False):
        assert -mesh.vertices[:, 2].min() == pytest.approx(1e3 * stage.depth, abs=1e-3)
        steepest = np.degrees(np.arccos(np.abs(mesh.face_normals[:, 2]))).max()
        assert steepest == pytest.approx(np.degrees(stage.wall_angle), abs=3.0)
    for stage, mesh in enumerate(meshes[:2]):  # in the place where its contours are
        contact = 1e3 * np.vstack([contour.contact for contour in made.contours if contour.stage == stage])
        height = LinearNDInterpolator(mesh.vertices[:, :2], mesh.vertices[:, 2])(contact[:, :2])
        assert np.abs(height - contact[:, 2]).max() < 0.05


def test_a_plan_file_is_taken_apart_as_well(made: Plan, tmp_path: Path) -> None:
    (saved,) = export(made, tmp_path / "cone.npz")
    read = load_plan(saved)
    files = export_stages(read, tmp_path / "again.nc")
    first = export_stages(made, tmp_path / "cone.nc")
    assert [file.read_text() for file in files] == [file.read_text() for file in first]
    shapes = [trimesh.load_mesh(file) for file in export_stages(read, tmp_path / "again.stl")]
    for shape, stage in zip(shapes, made.stages, strict=False):
        assert -shape.vertices[:, 2].min() == pytest.approx(1e3 * stage.depth, abs=0.05)


def test_every_stage_keeps_the_speeds_of_its_spindle(made: Plan, tmp_path: Path) -> None:
    by_stage = (5.0, 6.0, 7.0, 8.0)
    turning = replace(made, spindle=tuple(by_stage[contour.stage] for contour in made.contours))
    files = export_stages(turning, tmp_path / "cone.nc")
    found = [re.findall(r"^S(\d+) M3$", file.read_text(), re.MULTILINE) for file in files]
    assert found == [["48"], ["57"], ["67"], ["76"]]


def test_programs_of_a_long_name_are_told_apart_by_the_controller(made: Plan, tmp_path: Path) -> None:
    long = "a_part_with_a_name_that_is_rather_long-12345678"
    named = replace(made, plan_id=long, contours=tuple(replace(one, plan_id=long) for one in made.contours))
    names = [re.search(r"DEF (\w+)\(\)", file.read_text()) for file in export_stages(named, tmp_path / "cone.src")]
    found = [name[1] for name in names if name]
    assert len(set(found)) == 4
    assert all(len(name) <= 24 and name.endswith(f"_stage_{k}") for k, name in enumerate(found, 1))


def test_what_has_no_stages_is_refused(made: Plan, tmp_path: Path) -> None:
    alone = replace(made, contours=tuple(replace(one, stage=0) for one in made.contours))
    for plan_, name, said in ((alone, "cone.nc", "formed in one stage"), (made, "cone.npz", "holds all stages")):
        with pytest.raises(IsfError, match=said) as caught:
            export_stages(plan_, tmp_path / name)
        assert caught.value.code == ErrorCode.EXPORT_FORMAT_UNKNOWN
    with pytest.raises(IsfError, match="not the ending of a known format"):
        export_stages(made, tmp_path / "cone.xyz")
    assert not list(tmp_path.iterdir())
