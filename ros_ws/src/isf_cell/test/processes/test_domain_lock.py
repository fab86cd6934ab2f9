"""Two commands that are started together on one ROS domain: the second one is told before it starts a node."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from isf_cell.processes import domain_lock
from isf_cell.processes.domain_lock import alone_in_domain
from isf_core.errors import ErrorCode, IsfError

HOLDER = """
import sys
from isf_cell.processes.domain_lock import alone_in_domain
with alone_in_domain():
    print("mine", flush=True)
    sys.stdin.read()
"""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr(domain_lock.tempfile, "tempdir", None)
    return tmp_path


def test_the_second_is_refused_until_the_first_is_gone_even_when_it_was_killed(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with subprocess.Popen(
        [sys.executable, "-c", HOLDER], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=os.environ
    ) as first:
        assert first.stdout is not None
        assert first.stdout.readline() == "mine\n"
        with pytest.raises(IsfError, match=rf"another cell is running .* \(process {first.pid}\)") as caught:
            alone_in_domain().__enter__()
        assert caught.value.code is ErrorCode.BUSY
        monkeypatch.setenv("ROS_DOMAIN_ID", "98" if os.environ.get("ROS_DOMAIN_ID") == "99" else "99")
        with alone_in_domain():  # another domain
            pass
        monkeypatch.undo()
        first.kill()
        first.wait()
    with alone_in_domain():
        pass


def test_without_a_place_for_the_lock_what_answers_in_the_domain_is_left_to_tell(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    domain = os.environ.get("ROS_DOMAIN_ID") or "0"
    (folder / f"isf_cell_domain_{domain}.lock").symlink_to(folder / "elsewhere")  # another user's trap
    with alone_in_domain():
        assert not (folder / "elsewhere").exists()


def test_a_file_that_may_only_be_read_is_locked_all_the_same(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As that of another user."""
    domain_lock.lock_file(os.environ.get("ROS_DOMAIN_ID") or "0").write_text("")
    opened = os.open

    def refusing(path: Path, flags: int, mode: int = 0o777) -> int:
        if flags & os.O_RDWR:
            raise PermissionError(13, "Permission denied")
        return opened(path, flags, mode)

    monkeypatch.setattr(domain_lock.os, "open", refusing)
    with alone_in_domain(), pytest.raises(IsfError) as caught:
        alone_in_domain().__enter__()
    assert caught.value.code is ErrorCode.BUSY
