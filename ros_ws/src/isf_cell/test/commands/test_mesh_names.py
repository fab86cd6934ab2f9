"""A file may have any name: ``isf plan`` makes a job of a mesh, and a node takes the path as its parameter."""

from __future__ import annotations

import os
import shutil
from itertools import pairwise
from pathlib import Path

import pytest
import yaml
from isf_cell import cli
from isf_cell.commands.plan import Wanted, _job_of, plan_part
from isf_cell.processes import executables
from typer.testing import CliRunner

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


@pytest.mark.parametrize("name", ["bag", "bag #1", "a: b", "it's", 'a "b"', "[x]", "{x}", "Schüssel", "- a"])
def test_the_recorder_gets_the_paths_as_they_are(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The system of parameters reads them as YAML."""
    started: list[list[str]] = []
    monkeypatch.setattr(executables, "find", lambda *_: Path("recorder"))
    monkeypatch.setattr(os, "execv", lambda _, arguments: started.append(arguments))
    monkeypatch.chdir(tmp_path)
    CliRunner().invoke(cli.app, ["record", "-o", name, "--log", f"{name}.txt", "--split-size", "3"])
    (arguments,) = started
    given = dict(text.split(":=", 1) for before, text in pairwise(arguments) if before == "-p")
    values = {key: yaml.safe_load(text) for key, text in given.items()}
    assert values["output"] == str(tmp_path / name)
    assert values["text_log"] == str(tmp_path / f"{name}.txt")
    assert (values["autostart"], values["split_size"], values["storage"]) == (True, 3.0, "mcap")
