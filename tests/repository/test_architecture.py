"""The code keeps to the package table of docs/reference/architecture.md (layers between packages: import-linter)."""

from __future__ import annotations

import ast
import re
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
SOURCES = ROOT / "ros_ws" / "src"
PAGE = ROOT / "docs" / "reference" / "architecture.md"

ROS = re.compile(
    r"rclpy|\w+_msgs|builtin_interfaces|rcl_interfaces|\w+_srvs|ament_index_python|launch|launch_ros|rosidl\w*"
)
TERMINAL = {"typer", "rich", "click"}
"""What only the isf command needs: the table gives isf_cell "all"."""


def _table() -> dict[str, set[str]]:
    """Package to what it may import, as the page says it; short names ("core") stand for packages."""
    rows = re.findall(r"^\| `(isf_\w+)` \| .* \| (.+) \|$", PAGE.read_text(encoding="utf-8"), flags=re.MULTILINE)
    packages = {name for name, _ in rows}
    table = {}
    for name, cell in rows:
        words = {word.strip() for word in cell.split(",")} - {"-"}
        table[name] = {f"isf_{word}" if f"isf_{word}" in packages else word for word in words}
    return table


TABLE = _table()


def _may_import(package: str) -> set[str]:
    """Everything the row allows, rows of the packages it names included."""
    if "all" in TABLE[package]:
        return set(TABLE) | set().union(*TABLE.values()) | TERMINAL
    allowed = set(TABLE[package])
    for name in TABLE[package] & set(TABLE):
        allowed |= _may_import(name)
    return allowed | {package}


def _modules() -> list[Path]:
    return sorted(path for package in TABLE for path in (SOURCES / package / package).rglob("*.py"))


def _imports(path: Path) -> dict[str, int]:
    """Top-level package to the line of its first import, wherever in the file it stands."""
    found: dict[str, int] = {}
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        names = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            names = [node.module or ""]
        for name in names:
            found.setdefault(name.split(".")[0], node.lineno)
    return {name: line for name, line in found.items() if name not in sys.stdlib_module_names}


def _is_node(path: Path) -> bool:
    """ROS is known in a package's ``node.py``, ``*_node.py`` and ``node_*.py``, and in its folder ``ros``."""
    named = path.name == "node.py" or path.name.endswith("_node.py") or path.name.startswith("node_")
    return named or path.parent.name == "ros"


def _package(path: Path) -> str:
    return path.relative_to(SOURCES).parts[0]


def test_the_table_names_every_package() -> None:
    assert set(TABLE) == {path.parent.name for path in SOURCES.glob("*/package.xml")}


@pytest.mark.parametrize("path", _modules(), ids=lambda path: str(path.relative_to(SOURCES)))
def test_module_imports_only_what_its_package_may(path: Path) -> None:
    package = _package(path)
    allowed = _may_import(package)
    ros_allowed = "rclpy" in allowed
    for name, line in _imports(path).items():
        if ROS.fullmatch(name):
            assert ros_allowed, f"{path}:{line} imports {name}: {package} is free of ROS"
        else:
            # pydantic_core comes with pydantic
            assert {name, name.removesuffix("_core")} & allowed, f"{path}:{line} imports {name}"


def test_only_nodes_and_the_plumbing_know_ros() -> None:
    """isf_cell is left out: it holds the clients of the graph; its in-process cell has the next test."""
    cores = [path for path in _modules() if not _is_node(path) and _package(path) not in ("isf_ros", "isf_cell")]
    known = [
        f"{path}:{line} imports {name}"
        for path in cores
        for name, line in _imports(path).items()
        if ROS.fullmatch(name)
    ]
    assert not known


def test_in_process_cell_runs_without_ros() -> None:
    """The in-process cell and all that it imports, followed through the packages' sources, never reach rclpy."""
    waiting, seen = [SOURCES / "isf_cell" / "isf_cell" / "in_process.py"], set()
    while waiting:
        path = waiting.pop()
        if path in seen or not path.exists():
            continue
        seen.add(path)
        known = [name for name in _imports(path) if ROS.fullmatch(name) and name not in TABLE]
        assert not known, f"{path} imports {known}"
        waiting += [target for name in _full_imports(path) for target in _files_of(name)]
    assert len(seen) > 1


def _full_imports(path: Path) -> set[str]:
    """Dotted names of the imports of our own packages at the top level of a module."""
    names = set()
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            names |= {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}
    return {name for name in names if name.split(".")[0] in TABLE}


def _files_of(name: str) -> list[Path]:
    """Files that importing ``name`` runs: the package's ``__init__`` and the module."""
    package, *rest = name.split(".")
    folder = SOURCES / package / package
    module = folder.joinpath(*rest)
    return [folder / "__init__.py", module.with_suffix(".py") if rest else folder / "__init__.py"]


def test_core_modules_of_a_package_do_not_import_its_nodes() -> None:
    for path in _modules():
        if _is_node(path):
            continue
        text = path.read_text(encoding="utf-8")
        assert not re.search(rf"(from|import) {_package(path)}\.((\w+_)?node\b|ros\b)", text), f"{path} imports a node"


def test_test_files_have_unique_names() -> None:
    names = [path.name for path in [*SOURCES.glob("*/test/**/test_*.py"), *ROOT.glob("tests/**/test_*.py")]]
    assert sorted(names) == sorted(set(names))
