"""A mesh file may have any name: ``isf plan`` makes a job of it."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from isf_cell.commands.plan import Wanted, _job_of, plan_part

MESH = Path(__file__).resolve().parents[5] / "examples" / "parts" / "mini_cone.stl"


@pytest.mark.parametrize(
    ("stem", "name"),
    [
        ("Schüssel 2", "Schussel_2"),
        ("деталь", "part"),
        ("零件_7", "___7"),
        ("été", "ete"),
        ('12" dish', "12__dish"),
        ("back\\slash: {x}", "back_slash___x_"),
        ("#%&", "part"),
        ("a" * 120, "a" * 80),
    ],
)
def test_the_job_names_the_mesh_as_it_is(stem: str, name: str, tmp_path: Path) -> None:
    mesh = tmp_path / f"{stem}.stl"
    job_file = _job_of(mesh, "mm")
    assert job_file.job.name == name
    assert job_file.mesh == mesh.resolve()


def test_a_mesh_with_such_a_name_is_planned(tmp_path: Path) -> None:
    mesh = tmp_path / "Schüssel “ä”.stl"
    shutil.copy(MESH, mesh)
    plan_part(mesh, "mm", tmp_path / "out", Wanted(), as_json=False)
    assert (tmp_path / "out" / "contours.csv").stat().st_size > 1000
