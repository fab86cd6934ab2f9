"""An option that has no effect beside the others is refused: who gave it meant something by it."""

from __future__ import annotations

from pathlib import Path

import pytest
from isf_cell.cli import app
from isf_core.errors import ErrorCode, IsfError
from typer.testing import CliRunner

JOB = str(Path(__file__).resolve().parents[5] / "examples" / "jobs" / "mini_cone.yaml")


@pytest.mark.parametrize(
    ("arguments", "where", "words"),
    [
        (("gcode", "part.nc", "--job", JOB, "--rig", "ren2018"), "--rig", "a job names its own rig, sheet and tools"),
        (("gcode", "part.nc", "--job", JOB, "--material", "NOSUCH"), "--material", "leave it out, or --job"),
        (
            ("gcode", "part.nc", "--job", JOB, "--thickness", "1 mm", "--radius", "1 mm"),
            "--thickness, --radius",
            "a job names its own",
        ),
        (("plan", JOB, "--unit", "in"), "--unit", "is no mesh"),
        (("plan", "part.npz", "--unit", "mm", "--show", "part.html"), "--unit", "is no mesh"),
        (("plan", "part.npz", "--show", "part.html", "-o", "run"), "--output", "nothing but --export and --show"),
        (("plan", JOB, "--format", "krl"), "--format", "add --export FILE"),
        (("plan", JOB, "--export", "part.nc", "--colour", "nonsense"), "--colour", "add --show FILE"),
        (("learn", "run", "-o", "known.npz", "--surfaces", "--base", "."), "--base", "leave it out"),
        (("tune", JOB, "--legs", "--gain", "30"), "--gain", "the force loop"),
        (
            ("tune", JOB, "--legs", "--stiffness", "1", "--delay", "0", "--noise", "1"),
            "--stiffness, --delay, --noise",
            "the force loop",
        ),
        (("play", "run", "--param", "loop_gain:=36.0"), "--param", "--into NODE"),
        (("play", "run", "--base", "."), "--base", "--into NODE"),
    ],
    ids=str,
)
def test_it_is_named_with_what_to_do(
    arguments: tuple[str, ...], where: str, words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    done = CliRunner().invoke(app, list(arguments))
    assert isinstance(done.exception, IsfError), done.output
    assert done.exception.code is ErrorCode.FILE_FIELD
    assert done.exception.where == where
    assert words in str(done.exception)
    assert not list(tmp_path.iterdir())


def test_one_that_has_an_effect_is_not_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A unit is held against that of a CAD file, and the features that --colour asks for are told without a view."""
    monkeypatch.chdir(tmp_path)
    for arguments in (("part.step", "--unit", "mm"), ("nowhere.yaml", "--colour", "features")):
        done = CliRunner().invoke(app, ["plan", *arguments])
        assert isinstance(done.exception, IsfError)
        assert done.exception.code in (ErrorCode.FILE_NOT_FOUND, ErrorCode.MESH_UNREADABLE)
