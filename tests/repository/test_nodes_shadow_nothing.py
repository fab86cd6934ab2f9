"""No attribute and no method of a node hides one that rclpy's own nodes have, but for overrides that are meant."""

from __future__ import annotations

import ast
import importlib
import inspect
import textwrap
from collections.abc import Iterator
from pathlib import Path

import pytest
import rclpy
from isf_ros.lifecycle import OVERRIDES, CellNode
from rclpy.lifecycle import LifecycleNode

NODES = {
    "isf_sim.node": "MachineNode",
    "isf_force_ctrl.node": "ForceCtrlNode",
    "isf_planner.node": "PlannerNode",
    "isf_load_cell.node": "LoadCellNode",
    "isf_springback.node": "SpringbackNode",
    "isf_analysis.recorder_node": "RecorderNode",
    "isf_dashboard.dashboard_node": "DashboardNode",
    "isf_description.node": "CellStateNode",
    "isf_cell.executive_node": "ExecutiveNode",
}


SOURCES = Path(__file__).resolve().parents[2] / "ros_ws" / "src"


@pytest.fixture(scope="module")
def taken() -> Iterator[set[str]]:
    """Every name that a bare node of rclpy has, as attribute or method."""
    rclpy.init()
    node = LifecycleNode("bare")
    yield {name for name in (*dir(node), *vars(node)) if not name.startswith("__")}
    node.destroy_node()
    rclpy.try_shutdown()


def own_names(*kinds: type) -> set[str]:
    """Names that classes of this project bring: methods, class attributes, and what is set on self."""
    names: set[str] = set()
    for base in kinds:
        names |= {name for name in vars(base) if not name.startswith("__")}
        for item in ast.walk(ast.parse(textwrap.dedent(inspect.getsource(base)))):
            if (
                isinstance(item, ast.Attribute)
                and isinstance(item.ctx, ast.Store)
                and isinstance(item.value, ast.Name)
                and item.value.id == "self"
            ):
                names.add(item.attr)
    return names


@pytest.mark.parametrize("module", NODES)
def test_a_node_hides_nothing_of_rclpy(module: str, taken: set[str]) -> None:
    kind = getattr(importlib.import_module(module), NODES[module])
    assert issubclass(kind, CellNode)
    base, own = own_names(CellNode), own_names(kind)
    assert {"_heartbeat", "configure"} <= base  # the search finds attributes and methods
    assert base & taken - set(OVERRIDES) - _generic() == set()
    assert own & taken - _generic() == set()
    assert {name for name in own & base if name.startswith("_")} - _generic() == set()


def test_every_node_of_the_cell_is_looked_at() -> None:
    for module in NODES:
        importlib.import_module(module)
    ours = {kind.__name__ for kind in CellNode.__subclasses__() if kind.__module__.startswith("isf_")}
    assert ours == set(NODES.values())


def test_a_program_is_all_there_when_it_is_run_as_a_module() -> None:
    """What stands below ``if __name__ == "__main__"`` does not exist while ``python -m`` runs the module."""
    programs = [path for path in SOURCES.glob("*/isf_*/**/*.py") if 'if __name__ == "__main__":' in path.read_text()]
    assert len(programs) >= len(NODES)
    for path in programs:
        last = ast.parse(path.read_text(encoding="utf-8")).body[-1]
        assert isinstance(last, ast.If), path
        assert "__main__" in ast.unparse(last.test), path


def _generic() -> set[str]:
    """What typing puts on every generic class."""
    return {"_is_protocol"} | {name for name in vars(CellNode) if name.startswith("__") or name == "_abc_impl"}
