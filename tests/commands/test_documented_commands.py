"""The commands of README.md, run as a user runs them."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import typer
from isf_cell.cli import app
from isf_cell.commands.exit_codes import Exit
from quick_cone import quick_cone_file

ROOT = Path(__file__).resolve().parents[2]
JOB = ROOT / "examples" / "jobs" / "mini_cone.yaml"
MESH = ROOT / "examples" / "parts" / "mini_cone.stl"


def command(*arguments: str) -> list[str]:
    return [sys.executable, "-m", "isf_cell.cli", *arguments]


def isf(*arguments: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(command(*arguments), cwd=cwd, capture_output=True, text=True, timeout=300, check=False)


def test_the_readme_tells_every_command_and_no_other() -> None:
    table = re.findall(r"^\| `\./isf ([a-z-]+)", (ROOT / "README.md").read_text(encoding="utf-8"), flags=re.MULTILINE)
    assert set(table) | {"version"} == set(typer.main.get_command(app).commands)


def test_plan_draws_a_job_and_a_bare_mesh(tmp_path: Path) -> None:
    for folder, arguments in (("job", [str(JOB)]), ("mesh", [str(MESH), "--unit", "mm"])):
        done = isf("plan", *arguments, "--json", "-o", folder, cwd=tmp_path)
        assert done.returncode == Exit.OK, done.stderr
        data = json.loads(done.stdout)
        assert data["contours"] == 10
        assert data["depth_mm"] == pytest.approx(5.0, abs=0.02)
        assert Path(data["picture"]).stat().st_size > 10_000
        rows = Path(data["table"]).read_text().splitlines()
        assert len(rows) == data["points"] + 1


def test_a_report_is_made_again_from_bags_alone(tmp_path: Path) -> None:
    job = str(quick_cone_file(tmp_path))
    for name, correction in (("corrected", "analytic"), ("plain", "none")):
        done = isf("simulate", job, "--correction", correction, "--no-compare", "-o", name, cwd=tmp_path)
        assert done.returncode == Exit.OK, done.stderr
    done = isf("report", "corrected/bag", "--reference", "plain/bag", "-o", "again", "--json", cwd=tmp_path)
    assert done.returncode == Exit.OK, done.stderr
    data = json.loads(done.stdout)
    assert data["improvement"]["mean_abs"] > 1.0
    assert Path(data["report"]).parent == tmp_path / "again"
    assert Path(data["report"]).is_file()
    done = isf("report", "corrected", "--reference", "plain", "--json", cwd=tmp_path)
    assert done.returncode == Exit.OK, done.stderr
    assert Path(json.loads(done.stdout)["report"]).parent == tmp_path / "corrected"


@pytest.mark.graph
def test_doctor_finds_this_installation_sound(tmp_path: Path) -> None:
    done = isf("doctor", "--json", cwd=tmp_path)
    assert done.returncode == Exit.OK, done.stdout + done.stderr
    data = json.loads(done.stdout)
    assert data["ok"]
    assert {check["name"] for check in data["checks"]} >= {"Python", "ROS 2", "rclpy", "nodes", "DDS"}


@pytest.mark.graph
@pytest.mark.parametrize(
    "arguments",
    [("run", "isf_planner", "planner", "--ros-args", "-p", "autostart:=true"), ("record", "-o", "my_bag")],
    ids=["run", "record"],
)
def test_a_single_node_runs_until_ctrl_c(arguments: tuple[str, ...], tmp_path: Path) -> None:
    import rclpy
    from diagnostic_msgs.msg import DiagnosticArray

    name = "planner" if "planner" in arguments else "recorder"
    rclpy.init()
    node = rclpy.create_node("listener")
    states: list[str] = []

    def hear(message: DiagnosticArray) -> None:
        states.extend(item.value for s in message.status if s.name == f"/{name}" for item in s.values[:1])

    node.create_subscription(DiagnosticArray, "/diagnostics", hear, 10)
    process = subprocess.Popen(command(*arguments), cwd=tmp_path, start_new_session=True)
    try:
        deadline = time.monotonic() + 180
        while "active" not in states and time.monotonic() < deadline:
            rclpy.spin_once(node, timeout_sec=0.1)
        assert "active" in states
    finally:
        os.killpg(process.pid, signal.SIGINT)
        code = process.wait(120)
        node.destroy_node()
        rclpy.try_shutdown()
    assert code == 0
    if name == "recorder":
        assert list((tmp_path / "my_bag").glob("*.mcap"))
