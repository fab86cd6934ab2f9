#!/usr/bin/env python3
"""Write the security policy of a cell: what each node may publish, hear, serve and ask for, and nothing else.

    ./isf python scripts/security_policy.py            # ros_ws/src/isf_cell/config/security/policy.xml, a minute
    ./isf python scripts/security_policy.py --check    # differences to that file; exit code 1 where there are any

A cell with all its nodes forms a small part in a namespace of its own; meanwhile the graph is asked again and again
what every node has, and with ROS_SECURITY_ENABLE=true whether it has its enclave. Names below the namespace are written
relative to it. The format is that of ``ros2 security`` (sros2, policy 0.2.0), see docs/own_cell/security.md.
"""

from __future__ import annotations

import argparse
import difflib
import math
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from copy import deepcopy
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import rclpy
import yaml
from isf_cell.processes.cell_nodes import (
    OPERATOR,
    OWN_CLOCK,
    CellChoice,
    CellNode,
    cell_nodes,
    enclave,
    enclave_arguments,
)
from isf_cell.processes.domain_lock import alone_in_domain
from isf_cell.processes.process_group import ProcessGroup
from isf_cell.run.graph_run import LISTENING
from isf_core.files.yaml_file import find_named
from isf_msgs.action import FormPart
from rclpy.action import ActionClient
from rclpy.node import Node

ROOT = Path(__file__).resolve().parents[1]
POLICY = ROOT / "ros_ws" / "src" / "isf_cell" / "config" / "security" / "policy.xml"
Rights = dict[str, set[str]]
"""What may be done (attribute of :data:`KINDS`) to names."""

JOB = ROOT / "examples" / "jobs" / "mini_cone.yaml"
QUICK = {
    "incremental_depth: 0.5 mm": "incremental_depth: 1.7 mm",
    "point_spacing: 0.5 mm": "point_spacing: 1 mm",
    "feed: 30 mm/s": "feed: 20 mm/s",
    "rate: 500 Hz": "rate: 100 Hz",
    "method: elastic": "method: fused",
}
"""Of the job: fewer and quicker contours, and a method that asks for scans."""
CELLS = "torrao2013"
"""Rig with the spindle cells that both tools get."""
ELSEWHERE: dict[str, Rights] = {
    "machine": {
        "publish": {"tool_1/wrench", "tool_2/wrench", "tool_1/raw", "tool_2/raw", "machine/joint_states"},
        "subscribe": {"machine/joint_commands"},
    },
    "load_cell_1": {"subscribe": {"tool_1/raw", "tool_1/pose"}},
    "load_cell_2": {"subscribe": {"tool_2/raw"}},
    "force_ctrl": {
        "publish": {f"tool_{k}/{kind}" for k in (1, 2) for kind in ("target_twist", "joint_trajectory")},
        "subscribe": {"/tf", "/tf_static"},
    },
    "cell_state_publisher": {"subscribe": {"/tf", "/tf_static"}},
}
"""What nodes have in other set-ups: a rig without spindle cells, an output other than poses, a tool that tilts, axes
under ros2_control, sensors with axes of their own."""

SPACE = "/cell"
LIMIT = 600.0
"""s, only to end a run that hangs."""

KINDS = (
    ("topics", "topic", "publish"),
    ("topics", "topic", "subscribe"),
    ("services", "service", "reply"),
    ("services", "service", "request"),
    ("actions", "action", "execute"),
    ("actions", "action", "call"),
)
"""Element, element of its entries, attribute."""

HEAD = """\
<?xml version="1.0" encoding="UTF-8"?>
<!-- What the nodes of a cell may do; made by scripts/security_policy.py. For a cell in a namespace change ns="/" to it.
     See docs/own_cell/security.md. -->
"""


def all_nodes(folder: Path, rig: Path) -> list[CellNode]:
    """Of a cell with everything that a cell may have."""
    choice = CellChoice(
        load_cells=(1, 2),
        rig=str(rig),
        bag=str(folder / "bag"),
        checkpoint=str(folder / "checkpoint"),
        viewers=True,
    )
    return [*cell_nodes(choice), CellNode("dashboard", "isf_dashboard", "dashboard", {"port": 0})]


@contextmanager
def running(folder: Path, rig: Path) -> Iterator[dict[str, Rights]]:
    """A cell at work; what its nodes have elsewhere, to be added to by :func:`look`."""
    nodes = all_nodes(folder, rig)
    with alone_in_domain(), ProcessGroup(folder / "logs") as group:
        for node in nodes:
            remap = [f"__ns:={SPACE}", *(f"{own}:={other}" for own, other in (OWN_CLOCK, *node.remap))]
            group.start(node.package, node.executable, node.parameters, name=node.name, remap=remap)
        yield {node.name: defaultdict(set, deepcopy(ELSEWHERE.get(node.name, {}))) for node in nodes}


def look(node: Node, seen: Mapping[str, Rights]) -> None:
    """Note what each node has now."""
    enclaves = {name: found for name, _, found in node.get_node_names_and_namespaces_with_enclaves()}
    for name, rights in seen.items():
        if name not in enclaves:
            continue
        if enclave_arguments(name) and enclaves[name] != enclave(name):
            raise SystemExit(f"{name} has the enclave {enclaves[name]}, not {enclave(name)}")
        found = {
            "publish": node.get_publisher_names_and_types_by_node(name, SPACE),
            "subscribe": node.get_subscriber_names_and_types_by_node(name, SPACE),
            "reply": node.get_service_names_and_types_by_node(name, SPACE),
            "request": node.get_client_names_and_types_by_node(name, SPACE),
        }
        for right, names in found.items():
            for topic, _ in names:
                action, hidden, _ = topic.partition("/_action/")
                does = {"publish": "execute", "reply": "execute"}.get(right, "call") if hidden else right
                rights[does].add(_relative(action, name))


def _relative(name: str, node: str) -> str:
    own = f"{SPACE}/{node}/"
    if name.startswith(own):
        return f"~/{name.removeprefix(own)}"
    return name.removeprefix(f"{SPACE}/") if name.startswith(f"{SPACE}/") else name


def observed() -> dict[str, Rights]:
    """What each node of a cell was seen to have while a part was formed."""
    text = JOB.read_text(encoding="utf-8")
    for old, new in QUICK.items():
        if old not in text:
            raise SystemExit(f"{JOB} has no '{old}' any more")
        text = text.replace(old, new)
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        rig = _rig_with_cells(folder)
        text = text.replace("rig: ren2018", f"rig: {rig}")
        goal = FormPart.Goal(job_text=text, base_folder=str(JOB.parent), support_force=math.nan)
        seen = stack.enter_context(running(folder, rig))
        rclpy.init()
        node = rclpy.create_node("observer")
        try:
            result = _formed(node, goal, seen)
        finally:
            node.destroy_node()
            rclpy.try_shutdown()
    if result.code:
        raise SystemExit(f"the part was not formed: {result.code} {result.message}")
    return seen


def _rig_with_cells(folder: Path) -> Path:
    cells = yaml.safe_load(find_named("rigs", CELLS).read_text(encoding="utf-8"))["tool_1"]["spindle_cells"]
    lower = {**cells, "rotation": ["180 deg", "0 deg", "0 deg"]}
    tools = {"tool_1": {"spindle_cells": cells}, "tool_2": {"spindle_cells": lower}}
    path = folder / "rig.yaml"
    path.write_text(yaml.safe_dump({"based_on": "ren2018", "name": "with_cells", **tools}), encoding="utf-8")
    return path


def _formed(node: Node, goal: Any, seen: Mapping[str, Rights]) -> Any:
    """Result of the part; the graph is looked at meanwhile."""
    client = ActionClient(node, FormPart, f"{SPACE}/form_part")
    until = time.monotonic() + LIMIT

    def wait(future: Any) -> Any:
        while not future.done():
            if time.monotonic() > until:
                raise SystemExit(f"nothing came for {LIMIT:g} s")
            rclpy.spin_once(node, timeout_sec=0.1)
            look(node, seen)
        return future.result()

    try:
        if not client.wait_for_server(LIMIT):
            raise SystemExit("there is no executive")
        # an executive that has not found this client yet would answer into the void
        listened = time.monotonic() + LISTENING
        while time.monotonic() < listened:
            rclpy.spin_once(node, timeout_sec=0.1)
            look(node, seen)
        return wait(wait(client.send_goal_async(goal)).get_result_async()).result
    finally:
        client.destroy()


def policy(seen: Mapping[str, Rights]) -> str:
    """The file's text."""
    everything = {
        "publish": {"/parameter_events", "/rosout", "jog", "joy"},
        "subscribe": {"*"},
        "request": {"*"},
        "call": {"*"},
    }
    root = ElementTree.Element("policy", version="0.2.0")
    enclaves = ElementTree.SubElement(root, "enclaves")
    for name, rights in sorted({**seen, OPERATOR: everything}.items()):
        path = ElementTree.SubElement(enclaves, "enclave", path=enclave(name))
        profile = ElementTree.SubElement(ElementTree.SubElement(path, "profiles"), "profile", ns="/", node=name)
        for element, entry, right in KINDS:
            if names := rights.get(right):
                under = ElementTree.SubElement(profile, element, {right: "ALLOW"})
                for each in sorted(names):
                    ElementTree.SubElement(under, entry).text = each
    ElementTree.indent(root)
    return HEAD + ElementTree.tostring(root, encoding="unicode") + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true", help="compare with the file")
    check = parser.parse_args().check
    made = policy(observed())
    if not check:
        POLICY.write_text(made, encoding="utf-8")
        return
    there = POLICY.read_text(encoding="utf-8")
    if made != there:
        sys.stdout.writelines(difflib.unified_diff(there.splitlines(True), made.splitlines(True), "file", "cell"))
        raise SystemExit("the policy is not that of the cell: run scripts/security_policy.py")


if __name__ == "__main__":
    main()
