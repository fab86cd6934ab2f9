"""What a reader of CONTRIBUTING.md does: one file of a package of their own, one entry that names it, and commands."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import forked_process
from quick_cone import quick_cone_file

GUIDE = Path(__file__).resolve().parents[2] / "CONTRIBUTING.md"

Environment = dict[str, str]


def recipe(file: str) -> str:
    """The listing of ``file`` in CONTRIBUTING.md: the fenced block after the line that names it; at most ten lines."""
    found = re.search(rf"`{re.escape(file)}`[^\n]*\n\n```\w*\n(.*?)```", GUIDE.read_text(encoding="utf-8"), re.DOTALL)
    assert found, f"CONTRIBUTING.md has no listing of {file}"
    lines = found.group(1).splitlines()
    assert len([line for line in lines if line.strip()]) <= 10
    return found.group(1)


def install(folder: Path, source: str, group: str, name: str, made_by: str, *, module: str = "mine") -> Environment:
    """A package with one module and one entry point, as pip leaves it; the environment that finds it."""
    site = folder / "site"
    info = site / f"{module}-1.0.dist-info"
    info.mkdir(parents=True)
    (site / f"{module}.py").write_text(source, encoding="utf-8")
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {module}\nVersion: 1.0\n", encoding="utf-8")
    (info / "entry_points.txt").write_text(f"[{group}]\n{name} = {module}:{made_by}\n", encoding="utf-8")
    return {**os.environ, "PYTHONPATH": os.pathsep.join([str(site), os.environ.get("PYTHONPATH", "")])}


def own_method(folder: Path, *, module: str = "mine") -> Environment:
    """The recipe's springback method ``constant``, installed."""
    return install(folder, recipe("my_method.py"), "isf.springback_methods", "constant", "Constant", module=module)


def own_process(folder: Path, *, module: str = "mine") -> Environment:
    """The recipe's process ``DSIF_FLOOR_TWICE``, which plans a contour more than DSIF, installed."""
    return install(folder, recipe("my_process.py"), "isf.processes", "DSIF_FLOOR_TWICE", "FloorTwice", module=module)


def job_with_own_process(folder: Path) -> Path:
    """The quick cone in that process."""
    path = quick_cone_file(folder)
    text = path.read_text(encoding="utf-8")
    assert "process: DSIF\n" in text
    path.write_text(text.replace("process: DSIF\n", "process: DSIF_FLOOR_TWICE\n"), encoding="utf-8")
    return path


def isf(environment: Environment, *arguments: object) -> subprocess.CompletedProcess[str]:
    """The ``isf`` command."""
    command = [sys.executable, "-m", "isf_cell.cli", *map(str, arguments)]
    return forked_process.run(command, env=environment)
