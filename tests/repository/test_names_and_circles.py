"""No class or module uses what another one keeps to itself, and no modules import each other in a circle."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import grimp
import pytest

SOURCES = Path(__file__).resolve().parents[2] / "ros_ws" / "src"
PACKAGES = sorted(path.name for path in SOURCES.iterdir() if (path / path.name / "__init__.py").is_file())


def _modules() -> Iterator[tuple[Path, ast.Module]]:
    for package in PACKAGES:
        for path in sorted((SOURCES / package / package).rglob("*.py")):
            yield path, ast.parse(path.read_text(encoding="utf-8"))


def _private(name: str) -> bool:
    return name.startswith("_") and not name.startswith("__") and name != "_"


def _own(tree: ast.Module) -> set[str]:
    """Private names that a module gives: functions, classes, variables, and attributes assigned on anything."""
    names = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            names.add(node.name)
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            names.add(node.id)
        elif isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store):
            names.add(node.attr)
        elif isinstance(node, ast.arg):
            names.add(node.arg)
    return {name for name in names if _private(name)}


def test_no_private_name_is_used_outside_the_module_that_gives_it() -> None:
    """A base class in another file included."""
    public = {"_replace", "_asdict", "_fields", "_make", "_exit"}  # of named tuples, and of os
    kept = {"_state_machine"}  # rclpy's: without it a destroyed node stays in the ROS graph
    found = []
    for path, tree in _modules():
        own = _own(tree) | public | kept
        where = path.relative_to(SOURCES)
        for node in ast.walk(tree):
            if isinstance(node, ast.Attribute) and _private(node.attr) and node.attr not in own:
                found.append(f"{where}:{node.lineno} {node.attr}")
            elif isinstance(node, ast.ImportFrom) and any(_private(alias.name) for alias in node.names):
                found.append(f"{where}:{node.lineno} imports {', '.join(alias.name for alias in node.names)}")
    assert found == []


@pytest.mark.parametrize("package", PACKAGES)
def test_no_modules_import_each_other_in_a_circle(package: str) -> None:
    """Imports for type checking alone count: they tie two files together as any other."""
    graph = grimp.build_graph(package, exclude_type_checking_imports=False, cache_dir=None)
    names = {module: graph.find_modules_directly_imported_by(module) for module in graph.modules}
    while leaves := [module for module, imported in names.items() if not imported & set(names)]:
        for module in leaves:
            del names[module]
    while roots := [module for module in names if not any(module in imported for imported in names.values())]:
        for module in roots:
            del names[module]
    assert sorted(names) == []
