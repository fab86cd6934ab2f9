"""A part whose record ends before the part does is no success: recorder killed, disk full."""

from __future__ import annotations

import json
import os
import resource
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from isf_cell.commands.exit_codes import Exit
from quick_cone import quick_cone_file


def command(name: str, folder: Path) -> list[str]:
    job, output = str(quick_cone_file(folder)), str(folder / "run")
    return [sys.executable, "-m", "isf_cell.cli", name, job, "--json", "--no-compare", "-o", output]


def ends_early(code: int, out: str, err: str) -> dict[str, Any]:
    """The JSON of a command that tells so."""
    assert code == Exit.ANALYSIS, out + err
    data: dict[str, Any] = json.loads(out)
    return data


@pytest.mark.graph
def test_a_recorder_that_dies_in_the_part_is_reported_at_its_end(tmp_path: Path) -> None:
    form = subprocess.Popen(
        command("form", tmp_path), cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert form.stderr is not None
    for line in form.stderr:
        if "contour 2/" in line:
            break
    bag = tmp_path / "run" / "bag"
    found = subprocess.run(["pgrep", "-f", f"output:='?{bag}"], capture_output=True, text=True, check=True).stdout
    for process in found.split():
        os.kill(int(process), signal.SIGKILL)
    out, err = form.communicate(timeout=300)  # a bound against hanging
    data = ends_early(form.returncode, out, err)
    assert data["error"]["name"] == "BAG_INCOMPLETE"
    assert "free space" in data["error"]["message"]
    page = Path(data["report"]).read_text(encoding="utf-8")
    assert "Record not complete" in page
    assert "Part complete" not in page


def test_a_disk_without_room_for_the_bag_fails_the_simulation(tmp_path: Path) -> None:
    def full_disk() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000))

    done = subprocess.run(
        command("simulate", tmp_path),
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
        preexec_fn=full_disk,
    )
    assert ends_early(done.returncode, done.stdout, done.stderr)["error"]["name"] == "BAG_NOT_WRITABLE"
