"""The parameter file of each package, given to its node, and what the node then says of its parameters."""

from __future__ import annotations

import importlib
import math
import re
from dataclasses import Field, fields
from pathlib import Path
from typing import Any

import pytest
import rclpy
import yaml
from rcl_interfaces.msg import ParameterDescriptor

pytestmark = pytest.mark.graph

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "reference" / "nodes.md"
NODES = {
    "machine": ("isf_sim.node", "MachineNode", "isf_sim.node.MachineParameters"),
    "force_ctrl": ("isf_force_ctrl.node", "ForceCtrlNode", "isf_force_ctrl.ros.parameters.ForceCtrlParameters"),
    "planner": ("isf_planner.node", "PlannerNode", "isf_planner.node.PlannerParameters"),
    "springback": ("isf_springback.node", "SpringbackNode", "isf_springback.node.SpringbackParameters"),
    "load_cell": ("isf_load_cell.node", "LoadCellNode", "isf_load_cell.node.LoadCellParameters"),
    "recorder": ("isf_analysis.recorder_node", "RecorderNode", "isf_analysis.recorder_node.RecorderParameters"),
    "dashboard": (
        "isf_dashboard.dashboard_node",
        "DashboardNode",
        "isf_dashboard.dashboard_node.DashboardParameters",
    ),
    "cell_state_publisher": (
        "isf_description.node",
        "CellStateNode",
        "isf_description.node.CellStateParameters",
    ),
    "executive": ("isf_cell.executive_node", "ExecutiveNode", "isf_cell.executive_node.ExecutiveParameters"),
}


def rows(node: str) -> dict[str, list[str]]:
    """Cells of the node's table in the reference page, by parameter."""
    section = PAGE.read_text(encoding="utf-8").split(f"### {node}\n")[1].split("<!-- end -->")[0]
    found = {}
    for line in re.findall(r"^\| (`.*) \|$", section, flags=re.MULTILINE):
        name, *cells = line.split(" | ")
        found[name.strip("`")] = cells
    return found


def told(descriptor: ParameterDescriptor, default: Any) -> list[str]:
    """Unit, range, when it may be set, and text, as the page writes them."""
    text, _, unit = descriptor.description.partition(" [")
    span = [*descriptor.floating_point_range, *descriptor.integer_range]
    shown = "-"
    if span:
        ends = [span[0].from_value, span[0].to_value]
        if any(abs(end) < 2**62 and not math.isinf(end) for end in ends):
            shown = " .. ".join("" if abs(end) >= 2**62 or math.isinf(end) else f"{end:.10g}" for end in ends).strip()
    elif descriptor.additional_constraints:
        names = descriptor.additional_constraints.removeprefix("one of ").split(", ")
        shown = ", ".join(f"`{name}`" for name in names)
    when = "at the start" if descriptor.read_only else "any time"
    return [unit.rstrip("]") or "-", shown, when, text]


def another(item: Field[Any]) -> Any:
    """A value that the parameter may have, and not its default."""
    default, said = item.default, item.metadata
    if isinstance(default, bool):
        return not default
    if isinstance(default, int | float):
        lowest, highest = said["minimum"], said["maximum"]
        up = default + 1 if math.isinf(highest) else default + 0.5 * (highest - default)
        down = default - 1 if math.isinf(lowest) else default - 0.5 * (default - lowest)
        if isinstance(default, float):
            return up if up != default else down
        return math.ceil(up) if up != default else math.floor(down)
    if isinstance(default, tuple):
        return [*default, "another"]
    return next((choice for choice in said["choices"] if choice != default), f"{default}another")


@pytest.mark.parametrize("name", NODES)
def test_a_node_takes_every_value_of_a_file(name: str, tmp_path: Path) -> None:
    module, attribute, parameters = NODES[name]
    kind = getattr(importlib.import_module(parameters.rpartition(".")[0]), parameters.rpartition(".")[2])
    changed = {item.name: another(item) for item in fields(kind)}
    file = tmp_path / "changed.yaml"
    file.write_text(yaml.safe_dump({"/**": {"ros__parameters": changed}}), encoding="utf-8")
    rclpy.init(args=["--ros-args", "--params-file", str(file)])
    try:
        node = getattr(importlib.import_module(module), attribute)()
        values = node.values()
        for item in fields(kind):
            value = getattr(values, item.name)
            assert (list(value) if isinstance(item.default, tuple) else value) == changed[item.name], item.name
            assert changed[item.name] != item.default
        node.destroy_node()
    finally:
        rclpy.try_shutdown()


@pytest.mark.parametrize("name", NODES)
def test_a_node_takes_the_file_of_its_package_and_tells_what_the_page_says(name: str) -> None:
    module, attribute, parameters = NODES[name]
    kind = getattr(importlib.import_module(parameters.rpartition(".")[0]), parameters.rpartition(".")[2])
    package = module.split(".")[0]
    file = ROOT / "ros_ws" / "src" / package / "config" / f"{name}.yaml"
    rclpy.init(args=["--ros-args", "--params-file", str(file), "-r", "__ns:=/cell_2"])
    try:
        node = getattr(importlib.import_module(module), attribute)()
        values, page = node.values(), rows(name)
        assert set(page) == {item.name for item in fields(kind)}
        for item in fields(kind):
            value = getattr(values, item.name)
            assert (list(value) if isinstance(item.default, tuple) else value) == (
                list(item.default) if isinstance(item.default, tuple) else item.default
            )
            assert page[item.name][1:] == told(node.describe_parameter(item.name), item.default)
            if isinstance(item.default, float):
                assert item.metadata["unit"], f"{item.name} has no unit"
                assert not math.isinf(item.metadata["minimum"]), f"{item.name} has no range"
            assert item.name in node.get_parameters_by_prefix("")
        node.destroy_node()
    finally:
        rclpy.try_shutdown()
