"""``isf learn``: rig and material files of one's own are those of the recorded job, wherever the command is given."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from isf_analysis.bag.bag_writer import write_bag
from isf_cell import in_process
from isf_cell.cli import app
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile
from isf_springback.estimators import learning
from quick_cone import FOLDER, quick_cone
from typer.testing import CliRunner


def test_the_files_of_a_recorded_job_are_looked_for_in_its_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    own = tmp_path / "own"
    own.mkdir()
    (own / "mine.yaml").write_text("name: mine\nbased_on: ren2018\n")
    text = quick_cone().text.replace("rig: ren2018", "rig: mine.yaml").replace("../parts", str(FOLDER.parent / "parts"))
    write_bag(in_process.form(JobFile(text, own)), tmp_path / "run" / "bag")
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    monkeypatch.chdir(elsewhere)
    learn = ["learn", str(tmp_path / "run"), "-o", "known.npz"]

    done = CliRunner().invoke(app, learn)
    assert done.exit_code == 0, done.exception
    assert learning.load(Path("known.npz")).parts == 1

    moved = shutil.move(own, tmp_path / "moved")
    done = CliRunner().invoke(app, learn)
    assert isinstance(done.exception, IsfError)
    assert done.exception.code is ErrorCode.FILE_NOT_FOUND
    assert "--base DIR" in done.exception.advice
    done = CliRunner().invoke(app, [*learn, "--base", str(moved)])
    assert done.exit_code == 0, done.exception
    assert learning.load(Path("known.npz")).parts == 2
