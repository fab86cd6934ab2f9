"""The wheels of ``scripts/wheels.sh`` in a Python of their own, in which there is no ROS."""

from __future__ import annotations

import ast
import json
import subprocess
import sys
import venv
from pathlib import Path

from isf_analysis.bag.bag_writer import write_bag
from synthetic_part import make_part

ROOT = Path(__file__).resolve().parents[2]

NO_ROS = """
import sys


class NoRos:
    def find_spec(self, name, path=None, target=None):
        top = name.partition(".")[0]
        if top == "rclpy" or top.endswith(("_msgs", "_srvs", "_interfaces")):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)


sys.meta_path.insert(0, NoRos())
"""


def alone(folder: Path) -> Path:
    """A virtual environment with the wheels. Third-party libraries are those of this Python, ROS excepted."""
    subprocess.run([ROOT / "scripts" / "wheels.sh", folder / "dist"], check=True, stdout=subprocess.DEVNULL)
    venv.create(folder / "venv", symlinks=True)
    python = folder / "venv" / "bin" / "python"
    site = next((folder / "venv" / "lib").glob("python*/site-packages"))
    others = [path for path in sys.path if path.endswith(("site-packages", "dist-packages"))]
    (site / "libraries.pth").write_text("".join(f"{path}\n" for path in others))
    (site / "no_ros.pth").write_text("import no_ros\n")
    (site / "no_ros.py").write_text(NO_ROS)
    wheels = sorted((folder / "dist").glob("*.whl"))
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "--python", python]
    subprocess.run([*pip, "install", "--quiet", "--no-deps", "--no-index", *wheels], check=True)
    return folder


def isf(home: Path, *arguments: object) -> subprocess.CompletedProcess[str]:
    """The command, with nothing of the workspace around it."""
    command = [home / "venv" / "bin" / "isf", *map(str, arguments), "--json"]
    around = {"HOME": str(home), "PATH": "/usr/bin:/bin"}
    return subprocess.run(command, cwd=home, env=around, capture_output=True, text=True, check=False)


def test_wheels_do_without_ros_what_needs_none(tmp_path: Path) -> None:
    """A bag read and reported; rigs and materials found; what needs ROS says so. One test: it has one environment."""
    home = alone(tmp_path)
    bag = write_bag(make_part(contours=4, spacing=2.5e-3, points=20), home / "bag", end=200_000_000_000)
    tables = isf(home, "bag", "tables", bag, "-o", home / "tables")
    assert tables.returncode == 0, tables.stderr
    assert (home / "tables" / "contours.csv").is_file()
    report = isf(home, "report", bag, "-o", home / "report")
    assert report.returncode == 0, report.stderr
    assert json.loads(report.stdout)["contours"] == 4
    assert (home / "report" / "report.html").stat().st_size > 100_000
    described = isf(home, "describe", ROOT / "examples" / "jobs" / "mini_cone.yaml", "-o", home / "cell.urdf")
    assert described.returncode == 0, described.stderr
    refused = isf(home, "form", ROOT / "examples" / "jobs" / "mini_cone.yaml")
    assert refused.returncode == 5, refused.stderr
    assert json.loads(refused.stdout)["error"]["code"] == 1501
    assert "needs ROS 2" in refused.stdout
    examined = isf(home, "doctor")
    assert examined.returncode == 0, examined.stdout
    warned = {
        check["name"]: check["advice"] for check in json.loads(examined.stdout)["checks"] if check["state"] != "ok"
    }
    assert "needed for form, play and nodes" in warned["ROS 2"]


def test_wheels_ask_for_the_libraries_that_the_workspace_installs() -> None:
    """Library and versions by the one list, requirements/runtime.in; the packages themselves besides."""
    listed = {line.partition("#")[0].strip().lower() for line in (ROOT / "requirements" / "runtime.in").open()}
    asked = {}
    for path in sorted((ROOT / "ros_ws" / "src").glob("isf_*/setup.py")):
        call = next(
            node
            for node in ast.walk(ast.parse(path.read_text()))
            if isinstance(node, ast.keyword) and node.arg == "install_requires"
        )
        asked[path.parent.name] = {str(name).lower() for name in ast.literal_eval(call.value)}
    packages = {name.replace("_", "-") for name in asked}
    assert {name: wanted - listed - packages for name, wanted in asked.items() if wanted - listed - packages} == {
        "isf_driver_example": {"setuptools"}  # no wheel is made of it
    }
