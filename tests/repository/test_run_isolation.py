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


def test_colcon_gives_every_package_a_domain_and_leaves_slow_tests_out() -> None:
    """As colcon calls pytest in the folder of a package, in a shell that is in the domain of a cell."""
    asked = """
import sys, os, pytest
class Seen:
    def pytest_collection_finish(self, session):
        print("\\n", os.environ["ROS_DOMAIN_ID"], sorted(item.name for item in session.items))
sys.exit(pytest.main(["--collect-only", "-q", "test_controllers_in_graph.py"], plugins=[Seen()]))
"""
    done = subprocess.run(
        [sys.executable, "-c", asked],
        cwd=SCRIPTS.parent / "tests" / "graph",
        env={**os.environ, "COLCON": "1", "ROS_DOMAIN_ID": "0"},
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    (line,) = (line for line in done.stdout.splitlines() if "a_part_is_formed" in line and line.startswith(" "))
    domain, names = line.strip().split(" ", 1)
    assert 1 <= int(domain) <= 101
    assert "test_a_part_is_formed_through_the_controllers[ren2018]" in names
    assert "kr210_pair" not in names  # marked slow


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
