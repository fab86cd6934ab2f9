"""What the middleware prints never gets among the results: ``--json`` is one object on standard output."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from quick_cone import quick_cone_file

pytestmark = pytest.mark.graph

PROFILES = "<profiles><nonsense/></profiles>"
"""A file of profiles that Fast DDS complains about on its standard output, whenever a process starts it."""


@pytest.fixture
def environment(tmp_path: Path) -> dict[str, str]:
    """Fast DDS and the logging of ROS both print to standard output."""
    file = tmp_path / "profiles.xml"
    file.write_text(PROFILES)
    variables = ("FASTDDS_DEFAULT_PROFILES_FILE", "FASTRTPS_DEFAULT_PROFILES_FILE")
    return {**os.environ, **dict.fromkeys(variables, str(file)), "RCUTILS_LOGGING_USE_STDOUT": "1"}


def run(environment: dict[str, str], *command: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, *command], env=environment, capture_output=True, text=True, timeout=600, check=False
    )


def test_the_middleware_does_print_there(environment: dict[str, str]) -> None:
    code = "import rclpy; rclpy.init(); rclpy.create_node('noisy').get_logger().info('told')"
    printed = run(environment, "-c", code).stdout
    assert "nonsense" in printed
    assert "told" in printed


def test_results_of_commands_that_use_the_middleware_parse(environment: dict[str, str], tmp_path: Path) -> None:
    isf = ("-m", "isf_cell.cli")
    job = str(quick_cone_file(tmp_path))
    doctor = run(environment, *isf, "doctor", "--json")
    assert json.loads(doctor.stdout)
    form = run(environment, *isf, "form", job, "--no-compare", "--json", "-o", str(tmp_path / "run"))
    assert form.returncode == 0, form.stderr[-2000:]
    assert json.loads(form.stdout)["complete"] is True
    assert "nonsense" in form.stderr  # it is not lost either
    lonely = run(environment, *isf, "identify", job, "-p", "signs", "--cell", "--json")
    assert lonely.returncode != 0
    assert json.loads(lonely.stdout)["error"]["code"]
