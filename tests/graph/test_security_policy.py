"""The shipped security policy is what the nodes of a cell have while they form a part, and each has its enclave."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest

pytestmark = pytest.mark.graph

ROOT = Path(__file__).resolve().parents[2]
POLICY = ROOT / "ros_ws" / "src" / "isf_cell" / "config" / "security" / "policy.xml"


def test_every_node_has_what_the_policy_allows_and_no_more() -> None:
    """Security is on but not enforced: the middleware of the wheels cannot, and says so."""
    ended = subprocess.run(
        [sys.executable, str(ROOT / "scripts" / "security_policy.py"), "--check"],
        env={**os.environ, "ROS_SECURITY_ENABLE": "true", "ROS_SECURITY_STRATEGY": "Permissive"},
        stdout=subprocess.PIPE,
        text=True,
        check=False,
    )
    assert ended.returncode == 0, ended.stdout


def allowed(right: str, name: str) -> set[str]:
    """Nodes that may do it."""
    profiles = ElementTree.parse(POLICY).getroot().iter("profile")
    return {
        profile.attrib["node"]
        for profile in profiles
        if any(name == entry.text for group in profile if group.get(right) == "ALLOW" for entry in group)
    }


@pytest.mark.parametrize(
    ("right", "name", "nodes"),
    [
        ("publish", "tool_1/target", {"force_ctrl"}),
        ("publish", "contour/corrected", {"springback"}),
        ("publish", "tool_1/wrench", {"machine", "load_cell_1"}),
        ("request", "machine/reset", {"executive"}),
        ("request", "force_ctrl/arm", {"executive"}),
        ("publish", "*", set()),
        ("reply", "*", set()),
        ("execute", "*", set()),
        ("subscribe", "*", {"operator"}),
    ],
)
def test_what_moves_the_tools_comes_from_one_node(right: str, name: str, nodes: set[str]) -> None:
    assert allowed(right, name) == nodes
