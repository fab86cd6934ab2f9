"""Every package has a README that names its folders, nodes and commands, and what it may import."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
SOURCES = ROOT / "ros_ws" / "src"
PACKAGES = sorted(path.parent for path in SOURCES.glob("*/package.xml"))
UNNAMED = {"test", "resource", "__pycache__", ".hypothesis"}


def _folders(package: Path) -> list[str]:
    """Folders with content, those inside the Python package by their path below it."""
    inside = package / package.name
    tops = [path.name for path in package.iterdir() if path.is_dir() and not path.name.endswith(".egg-info")]
    rooms = [str(path.relative_to(inside)) for path in inside.rglob("*") if path.is_dir()]
    named = [name for name in tops if name != package.name] + rooms
    return [name for name in named if not UNNAMED & set(Path(name).parts)]


def _nodes(package: Path) -> list[str]:
    """Programs that the package installs."""
    setup = package / "setup.py"
    if not setup.is_file():
        return []
    texts = [node.value for node in ast.walk(ast.parse(setup.read_text())) if isinstance(node, ast.Constant)]
    return [match[1] for text in texts if (match := re.fullmatch(r"(\w+) = [\w.]+:main", str(text)))]


@pytest.mark.parametrize("package", PACKAGES, ids=lambda path: path.name)
def test_the_readme_names_what_the_package_holds(package: Path) -> None:
    text = (package / "README.md").read_text(encoding="utf-8")
    assert text.startswith(f"# {package.name}\n")
    assert 10 <= len(text.splitlines()) <= 36
    missing = [name for name in [*_folders(package), *_nodes(package)] if not re.search(rf"`[^`]*\b{name}`", text)]
    assert not missing
    assert f"./test.sh {SOURCES.relative_to(ROOT)}/" in text


@pytest.mark.parametrize("package", PACKAGES, ids=lambda path: path.name)
def test_the_readme_names_no_folder_or_module_that_is_gone(package: Path) -> None:
    text = (package / "README.md").read_text(encoding="utf-8")
    first = re.findall(r"^\| (`[^|]+) \|", text, flags=re.MULTILINE)
    folders = [name for cell in first for name in re.findall(r"`([^`]+)`", cell)]
    modules = re.findall(r"`(\w+\.py)`", text)
    inside = package / package.name
    gone = [name for name in folders if not (inside / name).is_dir() and not (package / name).is_dir()]
    gone += [name for name in modules if not list(package.rglob(name))]
    assert not gone


@pytest.mark.parametrize("package", PACKAGES, ids=lambda path: path.name)
def test_the_readme_allows_the_imports_of_the_architecture_page(package: Path) -> None:
    page = (ROOT / "docs" / "reference" / "architecture.md").read_text(encoding="utf-8")
    rows = dict(re.findall(r"^\| `(isf_\w+)` \| .* \| (.+) \|$", page, flags=re.MULTILINE))
    allowed = {f"isf_{word}" if f"isf_{word}" in rows else word for word in rows[package.name].split(", ")}
    said = re.search(r"\*\*May import\*\*: (.+?)\.\n", (package / "README.md").read_text(encoding="utf-8"), re.DOTALL)
    assert said is not None
    if allowed not in ({"all"}, {"-"}):
        assert set(said[1].replace("\n", " ").split(", ")) == allowed
