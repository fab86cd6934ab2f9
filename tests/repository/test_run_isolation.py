"""What keeps test runs apart: a ROS domain nobody uses, and no process that outlives its run."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import uuid
from pathlib import Path

SCRIPTS = Path(__file__).resolve().parents[2] / "scripts"


def _free_domain() -> int:
    done = subprocess.run(
        [sys.executable, str(SCRIPTS / "free_domain.py")], capture_output=True, text=True, timeout=120, check=True
    )
    return int(done.stdout)


def test_domain_is_in_the_range_that_linux_leaves_free() -> None:
    assert 1 <= _free_domain() <= 101


def test_domain_with_a_bound_port_is_not_chosen() -> None:
    """Ports of all domains but some are taken (first discovery port 7400 + 250 d, DDSI-RTPS 2.2, 9.6.1.1)."""
    spared = range(40, 70)  # not one: another run on this computer may begin to use it meanwhile
    sockets = []
    try:
        for domain in range(1, 102):
            if domain in spared:
                continue
            sockets.append(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
            sockets[-1].setsockopt(socket.SOL_SOCKET, socket.SO_REUSEPORT, 1)  # real participants may be there
            sockets[-1].bind(("127.0.0.1", 7400 + 250 * domain + 200))
        assert _free_domain() in spared
    finally:
        for item in sockets:
            item.close()


def _end_processes(mark: str, patience: float) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(SCRIPTS / "end_processes.py"), mark, str(patience)]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)


def test_process_left_by_a_run_is_ended_and_reported() -> None:
    mark = uuid.uuid4().hex
    # a session of its own and deaf to SIGINT, as a node in the background of a script is
    deaf = "import signal; signal.signal(signal.SIGINT, signal.SIG_IGN); print('up', flush=True); signal.pause()"
    node = subprocess.Popen(
        [sys.executable, "-c", deaf],
        env={**os.environ, "ISF_TEST_RUN": mark},
        stdout=subprocess.PIPE,
        start_new_session=True,
    )
    try:
        assert node.stdout is not None
        assert node.stdout.readline() == b"up\n"
        done = _end_processes(mark, 0.5)
        assert done.returncode == 1
        assert "left running by a test" in done.stderr
        assert node.wait(120) != 0
    finally:
        node.kill()
        node.wait()
        if node.stdout:
            node.stdout.close()


def test_run_without_leftovers_passes_and_others_are_untouched() -> None:
    bystander = subprocess.Popen(["sleep", "30"], env={**os.environ, "ISF_TEST_RUN": uuid.uuid4().hex})
    try:
        assert _end_processes(uuid.uuid4().hex, 0.5).returncode == 0
        assert bystander.poll() is None
    finally:
        bystander.kill()
        bystander.wait()
