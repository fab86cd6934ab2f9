"""``isf dashboard``: a recorded part is served until Ctrl-C; what cannot be served is refused with a code."""

from __future__ import annotations

import json
import signal
import socket
import subprocess
import sys
import urllib.request
from pathlib import Path

import forked_process
import numpy as np
import pytest
from isf_analysis.bag.bag_writer import write_bag
from isf_cell.commands.exit_codes import Exit
from synthetic_part import make_part


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a run."""
    folder = tmp_path_factory.mktemp("run")
    write_bag(make_part(), folder / "bag")
    return folder


def command(*arguments: str) -> list[str]:
    return [sys.executable, "-m", "isf_cell.cli", "dashboard", *arguments]


def test_a_run_is_served_until_ctrl_c_and_its_log_written(run: Path, tmp_path: Path) -> None:
    process = forked_process.start(
        command(str(run), "--port", "0", "--token", "of-the-test-and-long", "--log", "log.txt", "--json"),
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        cwd=tmp_path,
        text=True,
    )
    assert process.stdout is not None
    told = ""
    while "}" not in told:
        line = process.stdout.readline()
        assert line, "ended early"
        told += line
    url = json.loads(told)["url"]
    assert url.startswith("http://127.0.0.1:")
    assert url.endswith("/of-the-test-and-long/")
    with urllib.request.urlopen(url, timeout=30.0) as page:
        assert b"STOP" in page.read()
    assert np.loadtxt(tmp_path / "log.txt").shape[1] == 12
    process.send_signal(signal.SIGINT)
    assert process.wait(60.0) == Exit.OK


def test_a_port_in_use_and_a_bag_that_is_none_are_refused(run: Path, tmp_path: Path) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = str(other.getsockname()[1])
        for arguments in (("--port", port), (str(run), "--port", port)):
            done = forked_process.run(command(*arguments, "--json"), cwd=tmp_path)
            assert json.loads(done.stdout)["error"]["name"] == "PORT_UNAVAILABLE"
            assert "another port" in done.stderr
            assert done.returncode == Exit.ANALYSIS
    for arguments, name in (
        (("nothing",), "BAG_UNREADABLE"),
        ((str(run), "--token", "short"), "FILE_FIELD"),
        ((str(run), "--log", "/nowhere/log.txt"), "FILE_NOT_WRITABLE"),
    ):
        done = forked_process.run(command(*arguments, "--port", "0", "--json"), cwd=tmp_path)
        assert json.loads(done.stdout)["error"]["name"] == name
