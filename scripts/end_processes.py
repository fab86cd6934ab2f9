"""End what a test run left behind: every process whose environment holds ISF_TEST_RUN=<mark>.

usage: end_processes.py MARK [SECONDS]. Exit code 1 when something had to be ended: a test that leaves a node running is
wrong. A node that is just ending has SECONDS (15) for it.
"""

from __future__ import annotations

import os
import select
import signal
import sys
import time
from pathlib import Path

PATIENCE = {signal.SIGINT: 5.0, signal.SIGTERM: 2.0, signal.SIGKILL: 2.0}
"""s to wait after each signal."""


def marked(mark: str) -> dict[int, str]:
    """Process id to command line of every live process with the mark, except this one and its ancestors."""
    found = {}
    entry = f"ISF_TEST_RUN={mark}".encode()
    own = _ancestors()
    for folder in Path("/proc").iterdir():
        if not folder.name.isdigit() or int(folder.name) in own:
            continue
        try:
            environment = (folder / "environ").read_bytes().split(b"\0")
            command = (folder / "cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace").strip()
        except OSError:
            continue
        if entry in environment and command:
            found[int(folder.name)] = command
    return found


def wait_until_gone(mark: str, patience: float) -> dict[int, str]:
    """The processes still there after at most ``patience`` s."""
    end = time.monotonic() + patience
    left = marked(mark)
    while left and (seconds := end - time.monotonic()) > 0.0:
        wait_for_end(next(iter(left)), seconds)
        left = marked(mark)  # others may have ended meanwhile, or begun
    return left


def wait_for_end(process: int, patience: float) -> None:
    """Wait until ``process``, which need not be a child, has ended, at most ``patience`` s."""
    try:
        descriptor = os.pidfd_open(process)
    except ProcessLookupError:
        return
    try:
        select.select([descriptor], [], [], patience)
    finally:
        os.close(descriptor)


def main(mark: str, patience: float = 15.0) -> int:
    """End all marked processes; 0 when there were none after ``patience`` s."""
    left = wait_until_gone(mark, patience)
    for command in left.values():
        print(f"left running by a test, ended now: {command}", file=sys.stderr)
    blame = bool(left)
    for number, seconds in PATIENCE.items():
        for process in left:
            try:
                os.kill(process, number)
            except ProcessLookupError:
                continue
        left = wait_until_gone(mark, seconds) if left else left
    return 1 if blame else 0


def _ancestors() -> set[int]:
    own, process = set(), os.getpid()
    while process > 0:
        own.add(process)
        try:
            status = Path(f"/proc/{process}/stat").read_text()
        except OSError:
            break
        process = int(status.rsplit(")", 1)[1].split()[1])
    return own


if __name__ == "__main__":
    sys.exit(main(sys.argv[1], *map(float, sys.argv[2:])))
