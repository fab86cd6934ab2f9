"""What the middleware prints never gets among the results: ``--json`` is one object on standard output.

That of a formed part: test_own_packages_formed.py of tests/recipes.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from noisy_middleware import COMPLAINT, noise
from quick_cone import quick_cone_file

pytestmark = pytest.mark.graph


@pytest.fixture
def environment(tmp_path: Path) -> dict[str, str]:
    return {**os.environ, **noise(tmp_path)}


def run(environment: dict[str, str], *command: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, *command], env=environment, capture_output=True, text=True, timeout=600, check=False
    )


def test_the_middleware_does_print_there(environment: dict[str, str]) -> None:
    code = "import rclpy; rclpy.init(); rclpy.create_node('noisy').get_logger().info('told')"
    printed = run(environment, "-c", code).stdout
    assert COMPLAINT in printed
    assert "told" in printed


def test_results_of_commands_that_use_the_middleware_parse(environment: dict[str, str], tmp_path: Path) -> None:
    isf = ("-m", "isf_cell.cli")
    doctor = run(environment, *isf, "doctor", "--json")
    assert json.loads(doctor.stdout)
    job = str(quick_cone_file(tmp_path))
    lonely = run(environment, *isf, "identify", job, "-p", "signs", "--cell", "--json")
    assert lonely.returncode != 0
    assert json.loads(lonely.stdout)["error"]["code"]


@pytest.mark.parametrize("command", [("mode", "--json"), ("doctor", "--json")])
def test_a_domain_that_ends_the_middleware_is_told(command: tuple[str, ...]) -> None:
    """Fast DDS ends the process without an exception beyond 232."""
    done = run({**os.environ, "ROS_DOMAIN_ID": "240"}, "-m", "isf_cell.cli", *command)
    assert done.returncode not in (0, 1)
    assert "domains go up to 232" in json.dumps(json.loads(done.stdout))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("-o", "there"), "a recording never overwrites"),
        (("-o", "new", "--log", "there/log.txt"), "choose another --log"),
        (("-o", "new", "--storage", "foo"), "no storage 'foo'"),
        (("-o", "new", "--storage", "sqlite3", "--compression", "zstd"), "SQLite has no compression"),
    ],
)
def test_a_recording_that_cannot_begin_ends_at_once(options: tuple[str, ...], words: str, tmp_path: Path) -> None:
    (tmp_path / "there").mkdir()
    (tmp_path / "there" / "log.txt").touch()
    done = subprocess.run(
        [sys.executable, "-m", "isf_cell.cli", "record", *options],
        capture_output=True, text=True, timeout=600, check=False, cwd=tmp_path,
    )  # fmt: skip
    assert done.returncode not in (0, 1)
    assert words in done.stderr
    assert not (tmp_path / "new").exists()
