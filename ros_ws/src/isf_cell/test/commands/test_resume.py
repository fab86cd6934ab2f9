"""What ``isf form --resume`` takes and refuses, before it starts a node."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from isf_cell.cli import app
from isf_cell.commands import resume
from isf_cell.commands.resume import Request, alone, being_formed, resumed, with_advice
from isf_cell.run.checkpoint import CHECKPOINT, PART_FILE, Checkpoint, CheckpointFolder
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import load_job
from quick_cone import quick_cone_file
from typer.testing import CliRunner


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """A run whose part is killed in contour 2."""
    job = quick_cone_file(tmp_path)
    folder = tmp_path / "run"
    folder.mkdir()
    Request(job).write(folder)
    CheckpointFolder(folder / CHECKPOINT).write(_checkpoint(job))
    return folder


def _checkpoint(job: Path) -> Checkpoint:
    job_file = load_job(job)
    return Checkpoint(
        job_file.job.name, job_file.text, str(job_file.base), "analytic", None, 3, 7, "fast", "cone-1", 3, 1
    )


def refused(run: Path, **given: Any) -> IsfError:
    with pytest.raises(IsfError) as caught:
        resumed(run, {f"--{name.replace('_', '-')}": value for name, value in given.items()})
    return caught.value


def test_what_the_part_was_begun_with_is_taken_from_the_run(run: Path) -> None:
    found = resumed(run, {})
    assert found.checkpoint.lockstep
    assert found.job == run.parent / "quick_cone.yaml"
    options = found.checkpoint.options
    assert (options.correction, options.variant, options.seed, options.sheet) == ("analytic", 3, 7, "fast")
    assert found.checkpoint.job_file.job.name == "mini_cone"


def test_options_that_ask_for_the_same_are_taken(run: Path) -> None:
    given = {"JOB": run.parent / "quick_cone.yaml", "--variant": 3, "--correction": "analytic", "--output": run}
    assert resumed(run, given).checkpoint.next_index == 1


@pytest.mark.parametrize(
    "given",
    [
        {"variant": 0},
        {"seed": 1},
        {"correction": "none"},
        {"support_force": 90.0},
        {"real_time": True},
        {"sheet": "shell"},
    ],
)
def test_an_option_that_asks_for_something_else_is_refused(run: Path, given: dict[str, Any]) -> None:
    error = refused(run, **given)
    assert error.code is ErrorCode.FILE_FIELD
    assert error.where == "--" + next(iter(given)).replace("_", "-")


def test_another_job_is_refused_and_a_changed_one_is_not_compared_with(run: Path) -> None:
    job = run.parent / "quick_cone.yaml"
    job.write_text(job.read_text(encoding="utf-8") + "# changed\n", encoding="utf-8")
    with pytest.raises(IsfError, match="another job"):
        resumed(run, {"JOB": job})
    assert resumed(run, {}).job is None


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["--resume", "nothing"], ErrorCode.FILE_NOT_FOUND, "no such run"),
        (["--resume", "."], ErrorCode.FILE_NOT_FOUND, "no checkpoint"),
        (["--resume", "run", "--variant", "0"], ErrorCode.FILE_FIELD, "was begun with 3"),
        (["--resume", "run", "--variant", "0", "--attach"], ErrorCode.FILE_FIELD, "was begun with 3"),
    ],
)
def test_the_command_refuses(
    run: Path, arguments: list[str], code: ErrorCode, words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(run.parent)
    done = CliRunner().invoke(app, ["form", *arguments])
    assert isinstance(done.exception, IsfError)
    assert done.exception.code is code
    assert words in done.exception.message


def test_a_part_without_a_job_is_wrong_usage() -> None:
    done = CliRunner().invoke(app, ["form"])
    assert done.exit_code == 2
    assert "--resume" in done.output


def test_a_finished_part_and_a_damaged_checkpoint_are_refused(run: Path) -> None:
    folder = CheckpointFolder(run / CHECKPOINT)
    folder.write(replace(folder.read(), next_index=3))
    assert refused(run).code is ErrorCode.PART_FINISHED
    path = run / CHECKPOINT / PART_FILE
    path.write_bytes(path.read_bytes()[:-20])
    assert refused(run).code is ErrorCode.CHECKPOINT_UNUSABLE
    (run / CHECKPOINT / resume.REQUEST_FILE).write_text("{", encoding="utf-8")
    assert refused(run).code is ErrorCode.CHECKPOINT_UNUSABLE


def test_only_one_command_at_a_time_forms_a_part(run: Path) -> None:
    with alone(run), pytest.raises(IsfError) as caught, alone(run):
        pass
    assert caught.value.code is ErrorCode.BUSY
    with alone(run):
        pass


def test_a_command_that_ends_before_a_part_leaves_nothing(run: Path, tmp_path: Path) -> None:
    """So that the same command can be given again; what was begun stays."""
    for folder, left in ((tmp_path / "new", False), (run, True)):
        folder.mkdir(exist_ok=True)
        with alone(folder):
            Request(tmp_path / "quick_cone.yaml").write(folder)
        assert any(folder.iterdir()) is left
        assert (folder / CHECKPOINT / PART_FILE).exists() is left


def test_a_part_that_is_being_formed_is_not_said_to_go_on(run: Path) -> None:
    assert not being_formed(run)
    with alone(run):
        assert being_formed(run)
    assert not being_formed(run)
    assert not being_formed(run / "nothing")


def test_a_part_that_ended_early_names_the_command(run: Path) -> None:
    error = with_advice(IsfError(ErrorCode.NODE_DIED, "a node died", advice="see its log"), run)
    assert error.advice == f"see its log; the part can go on: ./isf form --resume {run}"
    Request(run.parent / "quick_cone.yaml", attach=True).write(run)
    error = with_advice(IsfError(ErrorCode.NODE_DIED, "a node died"), run)
    assert error.advice == f"the part can go on, in a cell that is up: ./isf form --resume {run} --attach"
    (run / CHECKPOINT / PART_FILE).unlink()
    assert with_advice(IsfError(ErrorCode.NODE_DIED, "a node died"), run).advice == ""
