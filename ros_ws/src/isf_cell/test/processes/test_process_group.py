"""Processes of a cell: found as ros2 run finds them, always ended."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import pytest
from isf_cell.processes import executables
from isf_cell.processes.process_group import ProcessGroup
from isf_core.errors import ErrorCode, IsfError

STUBBORN = """#!/bin/sh
trap '' INT TERM
echo "started with $*"
while :; do :; done
"""

WAITING = "#!/bin/sh\nexec sleep 1000  # ended by the test\n"
OWNER = """
import signal, sys
from pathlib import Path
from isf_cell.processes.process_group import ProcessGroup
node = ProcessGroup(Path(sys.argv[1])).start("some_package", "waiting", {})
print(node.popen.pid, flush=True)
signal.pause()
"""


@pytest.fixture
def prefix(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    folder = tmp_path / "lib" / "some_package"
    folder.mkdir(parents=True)
    for name, text in (("stubborn", STUBBORN), ("brief", "#!/bin/sh\necho gone; exit 3\n"), ("waiting", WAITING)):
        path = folder / name
        path.write_text(text)
        path.chmod(0o755)
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path))
    return tmp_path


def test_an_unknown_node_names_what_there_is(prefix: Path) -> None:
    with pytest.raises(IsfError, match="it offers: brief, stubborn, waiting") as caught:
        executables.find("some_package", "other")
    assert caught.value.code == ErrorCode.NODE_MISSING
    with pytest.raises(IsfError, match="no package 'no_package'"):
        executables.find("no_package", "other")


def test_even_a_process_that_ignores_signals_is_ended(prefix: Path) -> None:
    group = ProcessGroup(prefix / "logs")
    node = group.start("some_package", "stubborn", {"speed": 0.5, "text": "it's", "flag": True})
    deadline = time.monotonic() + 120
    while "started" not in node.last_lines() and time.monotonic() < deadline:
        os.sched_yield()
    assert "speed:=0.5 -p text:='it''s' -p flag:=true" in node.last_lines()
    group.stop(patience=0.1)
    assert not node.alive


def test_a_process_that_outlives_the_others_hears_of_the_end_after_them(prefix: Path) -> None:
    group = ProcessGroup(prefix / "logs")
    last, first = (group.start("some_package", "waiting", {}, outlives=outlives) for outlives in (True, False))
    ended: list[bool] = []
    wait = last.popen.wait

    def watched(timeout: float | None = None) -> int:
        ended.append(first.alive)
        return wait(timeout)

    last.popen.wait = watched  # type: ignore[method-assign]
    group.stop()
    assert ended == [False]
    assert not last.alive


def test_processes_end_with_their_owner_s_failure(prefix: Path) -> None:
    group = ProcessGroup(prefix / "logs")

    def fail() -> None:
        with group:
            group.start("some_package", "stubborn", {})
            group.stop(patience=0.1)
            raise RuntimeError("a fault")

    with pytest.raises(RuntimeError, match="a fault"):
        fail()
    assert all(not node.alive for node in group.nodes)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_processes_end_with_an_owner_that_is_killed(number: signal.Signals, prefix: Path) -> None:
    owner = subprocess.Popen([sys.executable, "-c", OWNER, str(prefix)], stdout=subprocess.PIPE, text=True)
    assert owner.stdout is not None
    node = int(owner.stdout.readline())
    assert _runs(node)
    owner.send_signal(number)
    owner.communicate()
    deadline = time.monotonic() + 120
    try:
        while _runs(node) and time.monotonic() < deadline:
            os.sched_yield()
        assert not _runs(node)
    finally:
        with suppress(ProcessLookupError):
            os.kill(node, signal.SIGKILL)


def _runs(pid: int) -> bool:
    """True while there is such a process that has not ended; nobody may wait for one whose owner is gone."""
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0]
    except (FileNotFoundError, ProcessLookupError):
        return False
    return state != "Z"


def test_a_process_that_ended_is_reported_with_its_output(prefix: Path) -> None:
    with ProcessGroup(prefix / "logs") as group:
        node = group.start("some_package", "brief", {})
        assert node.popen.wait(120) == 3
        assert group.dead() == [node]
        assert node.last_lines() == "gone"
