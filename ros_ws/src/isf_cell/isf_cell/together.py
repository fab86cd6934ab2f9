"""Several nodes of a cell, or of several cells, in one process: less memory and fewer participants of the middleware.

    ros2 run isf_cell together planner springback cell_state_publisher --ros-args -p springback:autostart:=true
    ros2 run isf_cell together /cell_1/machine /cell_1/force_ctrl /cell_2/machine /cell_2/force_ctrl

A name may begin with the namespace of its cell. ROS arguments for one of the nodes begin with its name, with or without
namespace (``-p NODE:NAME:=VALUE``, ``-r NODE:FROM:=TO``). Each node has a thread and an executor of its own, but they
share the interpreter, so nodes that tick by the clock are not among them; in lockstep nothing depends on how fast a
node is. They end together, too.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Sequence
from importlib.metadata import entry_points
from typing import Any

from isf_core.errors import ErrorCode, IsfError
from isf_ros import process
from isf_ros.lifecycle import CellNode
from rclpy.utilities import remove_ros_args

NODES = {
    "cell_state_publisher": "isf_description",
    "dashboard": "isf_dashboard",
    "executive": "isf_cell",
    "force_ctrl": "isf_force_ctrl",
    "load_cell": "isf_load_cell",
    "machine": "isf_sim",
    "planner": "isf_planner",
    "recorder": "isf_analysis",
    "springback": "isf_springback",
}
"""Name and package."""

_OF_NODE = re.compile(r"(?P<node>[\w/]+):(?P<rule>[^=].*:=.*)", re.DOTALL)
"""A rule for one node: with a name before it, and a colon that is not that of ``:=``."""


def wanted(names: list[str], rules: Sequence[tuple[str, str, str]] = ()) -> list[process.Wanted]:
    """The nodes of that ``names``; ``rules``: node, option (-p, -r) and rule. Raises IsfError NODE_MISSING."""
    found: list[process.Wanted] = []
    wrong = sorted({name for name in names if _base(name) not in NODES or names.count(name) > 1})
    wrong += sorted({node for node, _, _ in rules if not any(node in (name, _base(name)) for name in names)})
    if wrong or not names:
        raise IsfError(
            ErrorCode.NODE_MISSING,
            f"{', '.join(wrong)}: no node to run together with others, or named twice" if wrong else "no node is named",
            where="together",
            advice=f"name some of {', '.join(NODES)}, once each, or once in each namespace (/cell_1/planner)",
        )
    for name in names:
        base = _base(name)
        scripts = [item for item in entry_points(group="console_scripts", name=base) if item.module.startswith("isf_")]
        if not scripts:
            what = f"package '{NODES[base]}' is not installed"
            raise IsfError(ErrorCode.NODE_MISSING, what, where="together", advice="build the workspace")
        namespace = name.rpartition("/")[0]
        own = ["-r", f"__ns:={namespace}"] if namespace else []
        for node, option, rule in rules:
            own += [option, rule] if node in (name, base) else []
        found += process.wanted_by(scripts[0].load(), ["--ros-args", *own] if own else [])
    return found


def split(arguments: Sequence[str]) -> tuple[list[str], list[tuple[str, str, str]]]:
    """Arguments for all nodes, and the rules for one: rcl finds ``-p NODE:NAME:=VALUE`` in the root namespace alone."""
    left: list[str] = []
    rules: list[tuple[str, str, str]] = []
    for argument in arguments:
        found = _OF_NODE.fullmatch(argument)
        if found and left and left[-1] in ("-p", "--param", "-r", "--remap"):
            rules.append((found["node"], left.pop(), found["rule"]))
        else:
            left.append(argument)
    return left, rules


def check_clock(nodes: Sequence[CellNode[Any]]) -> None:
    """Raises IsfError FILE_FIELD for a node that would tick by the clock beside others."""
    for node in nodes:
        ticks = node.get_name() in ("machine", "force_ctrl") and not node.get_parameter("lockstep").value
        if ticks and len(nodes) > 1:
            raise IsfError(
                ErrorCode.FILE_FIELD,
                f"{node.get_fully_qualified_name()} ticks by the clock, and needs the interpreter for itself",
                where="together",
                advice="lockstep:=true, or start it alone: ros2 run",
            )


def _base(name: str) -> str:
    return name.rpartition("/")[2]


def main() -> int:
    """Entry point of ``ros2 run isf_cell together``."""
    arguments, rules = split(sys.argv)
    try:
        nodes = wanted(remove_ros_args(arguments)[1:], rules)
    except IsfError as error:
        print(error, file=sys.stderr)
        return process.EXIT_ERROR
    return process.run_together(nodes, arguments, check=check_clock)


if __name__ == "__main__":
    sys.exit(main())
