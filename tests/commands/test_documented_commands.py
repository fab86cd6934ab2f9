"""The commands of the manual, run as a user runs them; those of all its pages are at least understood."""

from __future__ import annotations

import json
import os
import re
import shlex
import signal
import subprocess
import sys
import time
from pathlib import Path

import forked_process
import pytest
import typer
from isf_analysis.bag.bag_writer import write_bag
from isf_cell import in_process
from isf_cell.cli import app
from isf_cell.commands.exit_codes import Exit
from isf_cell.options import RunOptions
from isf_core.files.job import load_job
from quick_cone import quick_cone_file

ROOT = Path(__file__).resolve().parents[2]
COMMANDS = ROOT / "docs" / "reference" / "commands.md"
JOB = ROOT / "examples" / "jobs" / "mini_cone.yaml"
MESH = ROOT / "examples" / "parts" / "mini_cone.stl"


def command(*arguments: str) -> list[str]:
    return [sys.executable, "-m", "isf_cell.cli", *arguments]


def isf(*arguments: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    return forked_process.run(command(*arguments), cwd=cwd)


def test_the_page_names_every_command_and_no_other() -> None:
    table = re.findall(r"^\| `\./isf ([a-z-]+)", COMMANDS.read_text(encoding="utf-8"), flags=re.MULTILINE)
    assert set(table) == set(typer.main.get_command(app).commands)


def documented(page: Path) -> list[str]:
    """Command lines of the ``sh`` blocks of a page, without comments, joined where they are continued."""
    blocks = re.findall(r"^```sh\n(.*?)^```", page.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    lines = "".join(blocks).replace("\\\n", " ").splitlines()
    return [line.split(" #")[0].strip() for line in lines if line.strip() and not line.startswith("#")]


def shown() -> list[tuple[str, str]]:
    """Page and command line of everything that a page tells a reader to type for ``isf``."""
    pages = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
    lines = {(str(page.relative_to(ROOT)), line) for page in pages for line in documented(page)}
    return sorted(
        (page, line) for page, line in lines if line.startswith("./isf ") and not line.startswith("./isf python")
    )


@pytest.mark.parametrize(("page", "line"), shown())
def test_commands_of_the_pages_are_understood(page: str, line: str) -> None:
    """Every command, option and value is one that ``isf`` takes; examples named exist."""
    words = shlex.split(line)[1:]
    group = typer.main.get_command(app)
    context = group.make_context("isf", words, resilient_parsing=True)
    found, name, rest = group, words[0], words
    while hasattr(found, "commands"):
        name, rest = rest[0], rest[1:]
        found = found.commands[name]
    found.make_context(name, list(rest), parent=context)
    for word in rest:
        if word.startswith("examples/"):
            assert (ROOT / word).exists()


@pytest.mark.parametrize("line", sorted({line for page in (ROOT / "docs").rglob("*.md") for line in documented(page)}))
def test_benchmarks_and_scripts_that_pages_name_exist(line: str) -> None:
    for word in shlex.split(line):
        if word.startswith(("benchmarks/", "scripts/", "./demo", "./test", "./scripts")):
            assert (ROOT / word).is_file()


def test_the_first_own_part_is_made_as_its_page_says(tmp_path: Path) -> None:
    """Part, job and plan of the page, and its corrected simulation; the others differ by method and sheet."""
    page = ROOT / "docs" / "first_part.md"
    (job,) = re.findall(r"^```yaml\n(.*?)^```", page.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    (tmp_path / "my_part.yaml").write_text(job, encoding="utf-8")
    part, plan, *simulations, form = documented(page)
    assert form == "./isf form my_part.yaml"
    (corrected,) = (line for line in simulations if line.endswith("-o corrected"))
    for line in (part, plan, corrected):
        done = isf(*shlex.split(line)[1:], cwd=tmp_path)
        assert done.returncode == Exit.OK, done.stderr
        assert "warning" not in done.stdout + done.stderr
    assert (tmp_path / "plan" / "plan.png").is_file()
    summary = json.loads((tmp_path / "corrected" / "summary.json").read_text(encoding="utf-8"))
    assert summary["verdict"]["good"]
    assert summary["deviation"]["max_mm"] < 0.45


def test_plan_draws_a_job_and_a_bare_mesh(tmp_path: Path) -> None:
    for folder, arguments in (("job", [str(JOB)]), ("mesh", [str(MESH), "--unit", "mm"])):
        done = isf("plan", *arguments, "--json", "-o", folder, cwd=tmp_path)
        assert done.returncode == Exit.OK, done.stderr
        data = json.loads(done.stdout)
        assert data["contours"] - data["floor_passes"] == 10
        assert (data["floor_passes"] > 0) == (folder == "mesh")  # of one tool
        assert data["depth_mm"] == pytest.approx(5.0, abs=0.02)
        assert Path(data["picture"]).stat().st_size > 10_000
        rows = Path(data["table"]).read_text().splitlines()
        assert len(rows) == data["points"] + 1
        assert data["backing_plate"]  # near the opening, which nothing holds
    assert "$INSUNITS" in Path(data["backing_plate_drawing"]).read_text(encoding="ascii")
    text = f"name: held\npart: {{mesh: {MESH}, unit: mm}}\nprocess: SPIF\nrig: ren2018\ntool_1: {{radius: 5 mm}}\n"
    text += "sheet: {material: AA5754-O, thickness: 1 mm}\npath: {incremental_depth: 0.5 mm, feed: 30 mm/s}\n"
    (tmp_path / "with_plate.yaml").write_text(text + "backing_plate: mesh/backing_plate.yaml\n", encoding="utf-8")
    done = isf("plan", "with_plate.yaml", "--json", "-o", "with_plate", cwd=tmp_path)
    assert done.returncode == Exit.OK, done.stderr
    assert json.loads(done.stdout)["backing_plate"] is None  # it is there


def test_a_report_is_made_again_from_bags_alone(tmp_path: Path) -> None:
    job = load_job(quick_cone_file(tmp_path))
    for name, correction in (("corrected", "analytic"), ("plain", "none")):
        (tmp_path / name).mkdir()
        write_bag(in_process.form(job, RunOptions(correction=correction)), tmp_path / name / "bag")
    done = isf("report", "corrected/bag", "--reference", "plain/bag", "-o", "again", "--json", cwd=tmp_path)
    assert done.returncode == Exit.OK, done.stderr
    data = json.loads(done.stdout)
    assert data["improvement"]["mean_abs"] > 1.0
    assert Path(data["report"]).parent == tmp_path / "again"
    assert Path(data["report"]).is_file()
    done = isf("report", "corrected", "--reference", "plain", "--json", "--export", "shape", cwd=tmp_path)
    assert done.returncode == Exit.OK, done.stderr
    assert Path(json.loads(done.stdout)["report"]).parent == tmp_path / "corrected"
    assert sorted(path.name for path in (tmp_path / "shape").iterdir()) == ["formed.ply", "formed.stl", "formed.vtk"]


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
    [("run", "isf_planner", "planner", "--ros-args", "-p", "autostart:=true"), ("record", "-o", "my bag #1: a")],
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
        assert list((tmp_path / "my bag #1: a").glob("*.mcap"))
