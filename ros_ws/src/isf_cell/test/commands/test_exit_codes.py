"""Every error code has an exit code, and the command uses it."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import forked_process
import pytest
from isf_cell.commands.exit_codes import Exit, exit_for
from isf_cell.commands.run_folder import make_run_folder
from isf_cell.options import RunOptions
from isf_core.errors import ErrorCode, IsfError

JOB = str(Path(__file__).resolve().parents[5] / "examples" / "jobs" / "mini_cone.yaml")
SPIF = str(Path(JOB).with_name("spif_cone.yaml"))


def test_every_code_has_an_exit_code() -> None:
    for code in ErrorCode:
        assert (exit_for(code) == Exit.OK) == (code == ErrorCode.OK)
    assert exit_for(ErrorCode.MESH_OPEN) == Exit.INPUT
    assert exit_for(ErrorCode.WRENCH_LOST) == Exit.PROCESS
    assert exit_for(ErrorCode.NODE_DIED) == Exit.CELL
    assert exit_for(ErrorCode.BAG_UNREADABLE) == Exit.ANALYSIS
    assert exit_for(ErrorCode.CANCELLED) == Exit.CANCELLED


def isf(*arguments: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "isf_cell.cli", *arguments]
    return forked_process.run(command, cwd=cwd)


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (("simulate", "nowhere.yaml"), Exit.INPUT, "no such file"),
        (("form", "nowhere.yaml"), Exit.INPUT, "no such file"),
        (("plan", "part.stl"), Exit.INPUT, "--unit mm"),
        (("report", "nowhere"), Exit.ANALYSIS, "nowhere"),
        (("run", "isf_planner", "dancer"), Exit.CELL, "it offers: planner"),
        (("simulate", JOB, "--support-force", "nan"), Exit.INPUT, "between 0 N and 1500 N, is nan N"),
        (("simulate", JOB, "--correction", "autp"), Exit.PROCESS, "--correction: there is no springback method 'autp'"),
        (("form", JOB, "--support-force", "-5"), Exit.INPUT, "--support-force"),
        (("simulate", SPIF, "--support-force", "120"), Exit.INPUT, "process SPIF has no support tool: 120 N cannot"),
        (("form", SPIF, "--support-force", "120"), Exit.INPUT, "--support-force"),
        (("simulate", JOB, "--world", "99999999999999999999"), Exit.USAGE, "2147483647"),
        (("simulate", JOB, "--seed", "-1"), Exit.USAGE, "--seed"),
        (("springback", "compare", JOB, "--seed", "-1"), Exit.USAGE, "--seed"),
        (("report", "nowhere", "-o", "/proc/rep"), Exit.INPUT, "choose a writable"),
        (("bag", "repair", "nowhere", "-o", "new"), Exit.ANALYSIS, "no such bag"),
        (("record", "-o", "bag", "-r", "tool_1/raw=left"), Exit.INPUT, "'tool_1/raw=left' is not FROM:=TO"),
        (("simulate",), Exit.USAGE, "JOB"),
        (("fly",), Exit.USAGE, "fly"),
    ],
)
def test_wrong_use_ends_with_a_sentence_and_a_code(
    arguments: tuple[str, ...], code: Exit, words: str, tmp_path: Path
) -> None:
    done = isf(*arguments, cwd=tmp_path)
    assert done.returncode == code, done.stderr
    assert words in done.stderr
    assert "Traceback" not in done.stderr + done.stdout


def test_with_json_an_error_is_one_object(tmp_path: Path) -> None:
    done = isf("simulate", "nowhere.yaml", "--json", cwd=tmp_path)
    assert done.returncode == Exit.INPUT
    assert json.loads(done.stdout)["error"]["name"] == "FILE_NOT_FOUND"


@pytest.mark.parametrize("force", [-5.0, 1e6, float("inf"), float("nan")])
def test_a_support_force_out_of_bounds_is_refused(force: float) -> None:
    with pytest.raises(IsfError) as refused:
        RunOptions(support_force=force)
    assert refused.value.code == ErrorCode.FILE_FIELD
    assert RunOptions(support_force=1500.0).support_force == 1500.0


def test_the_output_folder_must_be_empty(tmp_path: Path) -> None:
    (tmp_path / "old").mkdir()
    (tmp_path / "old" / "bag").touch()
    with pytest.raises(IsfError, match="not empty"):
        make_run_folder(tmp_path / "old", "cone")
    assert make_run_folder(tmp_path / "new", "cone").is_dir()
