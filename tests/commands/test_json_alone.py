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
