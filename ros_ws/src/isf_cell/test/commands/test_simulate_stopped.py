"""``isf simulate`` stopped: by Ctrl-C, or killed."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import forked_process
import pytest
from isf_analysis.bag.bag_reader import read_bag
from isf_cell.commands.exit_codes import Exit
from isf_cell.commands.run_folder import run_folder
from isf_cell.options import RunOptions
from isf_cell.processes.reference_run import ReferenceRun
from isf_core.errors import ErrorCode, IsfError

JOB = Path(__file__).resolve().parents[5] / "examples" / "jobs" / "mini_cone.yaml"


def start(folder: Path, *arguments: str) -> forked_process.ForkedProcess:
    command = [sys.executable, "-m", "isf_cell.cli", "simulate", str(JOB), "-o", "run", *arguments]
    return forked_process.start(command, cwd=folder, stderr=subprocess.PIPE, text=True, start_new_session=True)


def await_line(process: forked_process.ForkedProcess, words: str) -> None:
    assert process.stderr is not None
    assert any(words in line for line in process.stderr)


def reported_after_ctrl_c(folder: Path, words: str) -> str:
    """What a simulation says when Ctrl-C comes after a line with ``words``."""
    process = start(folder, "--correction", "analytic")
    await_line(process, words)
    process.send_signal(signal.SIGINT)
    assert process.stderr is not None
    reported = process.stderr.read()
    assert process.wait(300) == Exit.CANCELLED, reported
    return reported


def test_ctrl_c_keeps_and_reports_what_was_formed(tmp_path: Path) -> None:
    reported = reported_after_ctrl_c(tmp_path, "contour 2/10")
    number = re.search(r"stopped by the operator after contour (\d+) of 10", reported)
    assert number, reported
    assert 2 <= int(number[1]) < 10
    record = read_bag(tmp_path / "run" / "bag")
    assert record.formed == int(number[1])
    assert (tmp_path / "run" / "report.html").is_file()
    assert not list((tmp_path / "run").glob("uncorrected*"))


def test_ctrl_c_before_the_first_contour_leaves_no_folder(tmp_path: Path) -> None:
    reported = reported_after_ctrl_c(tmp_path, "planning")
    assert "nothing of the part is kept" in reported
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_the_uncorrected_part_ends_with_its_owner(number: signal.Signals, tmp_path: Path) -> None:
    owner = (
        "import sys, signal; from pathlib import Path\n"
        "from isf_cell.options import RunOptions\nfrom isf_cell.processes.reference_run import ReferenceRun\n"
        f"run = ReferenceRun(Path({str(JOB)!r}), RunOptions(), Path('uncorrected'))\n"
        "print(run._popen.pid, flush=True)\nsignal.pause()"
    )
    process = subprocess.Popen([sys.executable, "-c", owner], cwd=tmp_path, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    child = os.pidfd_open(int(process.stdout.readline()))
    process.send_signal(number)
    process.wait(120)
    try:
        assert ended(child)
    finally:
        os.close(child)
    assert not (tmp_path / "uncorrected" / "bag" / "metadata.yaml").exists()


def ended(pidfd: int) -> bool:
    """Whether a process ends, within 2 minutes; its descriptor is readable then."""
    import select

    return bool(select.select([pidfd], [], [], 120.0)[0])


def test_an_unfinished_reference_is_removed(tmp_path: Path) -> None:
    with ReferenceRun(JOB, RunOptions(), tmp_path / "uncorrected"):
        assert (tmp_path / "uncorrected.log").exists()
    assert not list(tmp_path.iterdir())


def test_a_new_run_folder_goes_again_when_nothing_came_of_the_run(tmp_path: Path) -> None:
    with run_folder(tmp_path / "empty", "cone"):
        pass
    assert not (tmp_path / "empty").exists()
    with run_folder(tmp_path / "used", "cone") as folder:
        (folder / "bag").touch()
    assert (tmp_path / "used" / "bag").exists()
    (tmp_path / "mine").mkdir()
    with run_folder(tmp_path / "mine", "cone"):
        pass
    assert (tmp_path / "mine").is_dir()
    with pytest.raises(IsfError) as refused, run_folder(Path("/proc/rep"), "cone"):
        pass
    assert refused.value.code == ErrorCode.FILE_NOT_WRITABLE
