"""``isf plan --export`` of runs, bags and try-outs, run as a user runs it (docs/methods/plan_outputs.md)."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import forked_process
import numpy as np
import pytest
from isf_analysis.bag.bag_reader import read_bag
from isf_analysis.bag.bag_writer import write_bag
from isf_cell import in_process
from isf_cell.commands.exit_codes import Exit
from isf_cell.commands.learn import learn_record
from isf_cell.options import RunOptions
from isf_core.events import Event, EventKind
from isf_planner.gcode.reader import read_program
from isf_springback.estimators import learning
from quick_cone import CONTOURS, FOLDER, quick_cone, quick_cone_file


def isf(*arguments: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    return forked_process.run([sys.executable, "-m", "isf_cell.cli", *arguments], cwd=cwd)


def formed_lines(program: Path) -> np.ndarray:
    """(N, 6) m, tips of the program where it forms."""
    read = read_program(program.read_text(encoding="ascii"), name=program.name, step=1.0)
    return np.asarray(read.tips[np.isfinite(read.speed)])


@pytest.fixture(scope="module")
def base(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run; the bag of a part with a rig of its own, alone; one that tore; try-outs that ended and that did not."""
    folder = tmp_path_factory.mktemp("exports")
    part = in_process.form(quick_cone(), RunOptions(variant=2))
    write_bag(part, folder / "run" / "bag")
    own_rig = part.job_text.replace("rig: ren2018", "rig: my_rig.yaml")
    write_bag(replace(part, job_text=own_rig, base_folder="/nowhere"), folder / "alone")
    tore = Event(int(EventKind.FRACTURE), 1.0, (0.01, 0.0, -0.004), 1.2, 1.0, "the sheet tore")
    write_bag(replace(part, events=(tore,)), folder / "torn")
    (folder / "unfinished").mkdir()
    (folder / "unfinished" / "tryout.json").write_text("{}", encoding="utf-8")
    ended = folder / "tryout"
    shutil.copytree(folder / "unfinished", ended)
    learning.save(learn_record(part, FOLDER), ended / "plan.npz")
    text = quick_cone_file(ended).read_text(encoding="utf-8")
    assert "method: analytic" in text
    learned = text.replace("method: analytic", "method: learned\n  learning: plan.npz")
    (ended / "job.yaml").write_text(learned, encoding="utf-8")
    return folder


def test_a_program_of_a_run_of_its_bag_and_of_its_plan_file(base: Path) -> None:
    done = isf("plan", "run", "--export", "run.nc", "--export", "run.npz", "--show", "run.png", "--json", cwd=base)
    assert done.returncode == Exit.OK, done.stderr
    told = json.loads(done.stdout)
    assert told["files"] == ["run.nc", "run.npz", "run.png"]
    assert told["exported"]["corrected"] is True
    assert told["exported"]["method"] == "analytic"
    assert told["exported"]["largest_correction_mm"] > 1.0
    assert told["contours"] == CONTOURS
    tips = np.vstack([np.vstack([c.forming_tip, c.forming_tip[:1]]) for c in read_bag(base / "run").corrected])
    assert np.abs(formed_lines(base / "run.nc")[:, :3] - tips).max() <= 1e-6
    for number, source in enumerate(("run/bag", "run.npz")):
        done = isf("plan", source, "--export", f"other_{number}.nc", cwd=base)
        assert done.returncode == Exit.OK, done.stderr
        assert (base / f"other_{number}.nc").read_text() == (base / "run.nc").read_text()


def test_only_programs_for_robots_need_the_rig_of_a_bag(base: Path) -> None:
    done = isf("plan", "alone", "--export", "alone.nc", cwd=base)
    assert done.returncode == Exit.OK, done.stderr
    assert "largest correction" in done.stderr
    done = isf("plan", "alone", "--export", "alone.src", cwd=base)
    assert done.returncode == Exit.INPUT
    assert "--base" in done.stderr
    assert not list(base.glob("alone*.src"))


def test_a_torn_part_needs_to_be_asked_for(base: Path) -> None:
    done = isf("plan", "torn", "--export", "torn.nc", "--json", cwd=base)
    assert done.returncode == Exit.PROCESS
    assert json.loads(done.stdout)["error"]["name"] == "SHEET_TORN"
    assert not (base / "torn.nc").exists()
    done = isf("plan", "torn", "--export", "torn.nc", "--incomplete", cwd=base)
    assert done.returncode == Exit.OK, done.stderr
    assert "tore" in done.stderr
    assert "(INCOMPLETE: " in (base / "torn.nc").read_text()


def test_what_a_try_out_found_becomes_a_program(base: Path) -> None:
    done = isf("plan", "tryout", "--export", "found.nc", "-o", "planned", "--json", cwd=base)
    assert done.returncode == Exit.OK, done.stderr
    told = json.loads(done.stdout)["exported"]
    assert told["corrected"] is True
    assert told["method"] == "learned"
    assert told["remarks"] == []
    done = isf("plan", "tryout/job.yaml", "--export", "nominal.nc", "--as-planned", "-o", "nominal", cwd=base)
    assert done.returncode == Exit.OK, done.stderr
    moved = formed_lines(base / "found.nc") - formed_lines(base / "nominal.nc")
    assert 1e3 * np.linalg.norm(moved[:, :3], axis=1).max() == pytest.approx(told["largest_correction_mm"], abs=2e-4)
    assert np.abs(moved[:, :3] - moved[:, 3:]).max() <= 0.2e-6  # both tools alike, to the last digit of each
    assert "NOT CORRECTED" in (base / "nominal.nc").read_text()
    done = isf("plan", "unfinished", "--export", "x.nc", cwd=base)
    assert done.returncode == Exit.INPUT
    assert "isf tryout JOB -o" in done.stderr


def test_a_job_that_measures_is_exported_with_a_warning(base: Path) -> None:
    job = quick_cone_file(base)
    done = isf("plan", job.name, "--export", "open.nc", "-o", "open", cwd=base)
    assert done.returncode == Exit.OK, done.stderr
    assert "NOT corrected for springback: method analytic" in " ".join(done.stderr.split())
    assert "NOT CORRECTED" in (base / "open.nc").read_text()
    done = isf("plan", job.name, "--export", "target.stl", "-o", "target", cwd=base)
    assert done.returncode == Exit.OK, done.stderr
    assert "corrected" not in done.stderr.lower()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("run",), "--export FILE"),
        (("run", "--export", "x.stl"), "export that from the job"),
        (("run", "--export", "x.unknown"), "--format NAME"),
        (("run", "--export", "x.nc", "-o", "folder"), "--output"),
        (("run", "--export", "nowhere/x.nc"), "no such folder"),
        (("run", "--show", "x.html", "--colour", "features"), "recorded part"),
        (("run", "--export", "x.nc", "--unit", "mm"), "--unit"),
        (("run", "--export", "x.nc", "--namespace", "other"), "holds no cell"),
        (("tryout", "--export", "x.nc", "--incomplete"), "is no run"),
        (("tryout", "--as-planned"), "add --export"),
        (("planned", "--export", "x.nc"), "holds no bag"),
    ],
    ids=lambda value: "_".join(value) if isinstance(value, tuple) else None,
)
def test_wrong_use_is_told_and_writes_nothing(arguments: tuple[str, ...], words: str, base: Path) -> None:
    (base / "planned").mkdir(exist_ok=True)
    done = isf("plan", *arguments, cwd=base)
    assert done.returncode in (Exit.INPUT, Exit.ANALYSIS), done.stderr
    assert words in " ".join(done.stderr.split())
    assert not list(base.glob("x.*"))
