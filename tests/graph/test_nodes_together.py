"""Several nodes in one process: a part is formed by them as by one process each, and they end together."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import forked_process
import launch_standin
import numpy as np
import pytest
import rclpy
import yaml
from isf_analysis.bag.bag_reader import read_bag
from isf_cell import in_process
from isf_cell.processes import executables
from isf_msgs.action import FormPart
from quick_cone import quick_cone, quick_cone_file
from rclpy.action import ActionClient
from waiting import LIMIT, Waiting

pytestmark = pytest.mark.graph

LAUNCH = Path(__file__).resolve().parents[2] / "ros_ws" / "src" / "isf_cell" / "launch" / "cell.launch.py"
CELL = "/cell_1"
TOGETHER = "planner springback executive cell_state_publisher"


def lines_of(folder: Path, patch: pytest.MonkeyPatch, together: str) -> tuple[dict[str, list[str]], dict[str, object]]:
    """Command lines of the launched nodes, and the goal that is sent."""
    names = launch_standin.load(LAUNCH, patch)
    arguments = {"job": str(quick_cone_file(folder)), "namespace": CELL, "record": str(folder / "bag")}
    actions, context = launch_standin.perform(names, **arguments, together=together, log_level="warn")
    found = launch_standin.nodes(actions).items()
    goal: dict[str, object] = yaml.safe_load(actions[-1].keywords["cmd"][-1])
    return {name: launch_standin.command(node, context, folder) for name, node in found}, goal


def test_a_part_is_formed_by_nodes_in_one_process(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    lines, goal = lines_of(tmp_path, monkeypatch, TOGETHER)
    assert set(lines) == {"together", "recorder", "machine", "force_ctrl"}
    rclpy.init()
    node = rclpy.create_node("client", namespace=CELL)
    waiting = Waiting(node)
    processes = [forked_process.start([sys.executable, *line], start_new_session=True) for line in lines.values()]
    try:
        client = ActionClient(node, FormPart, "form_part")
        assert waiting.until(client.server_is_ready)
        assert waiting.until(lambda: node.count_subscribers("joint_states") == 1)  # the recorder
        sent = client.send_goal_async(FormPart.Goal(**goal))
        assert waiting.until(sent.done)
        formed = sent.result().get_result_async()
        assert waiting.until(formed.done, 3 * LIMIT)
        result = formed.result().result
        there = {name for name in node.get_node_names() if not name.startswith("_")}
        client.destroy()
    finally:
        for process in processes:
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGINT)
        codes = [process.wait(LIMIT) for process in processes]
        waiting.close()
        node.destroy_node()
        rclpy.try_shutdown()
    assert (result.code, result.message) == (0, "")
    assert there >= {*TOGETHER.split(), "machine", "force_ctrl", "recorder"}
    assert codes == [0] * len(lines)
    here, record = in_process.form(quick_cone()), read_bag(tmp_path / "bag")
    for mine, theirs in zip(here.results, record.results, strict=True):
        np.testing.assert_allclose(theirs.forming_target, mine.forming_target, atol=1e-6)


@pytest.mark.parametrize(
    ("names", "said"),
    [
        (["planner", "machine"], "machine: no node to run together"),
        (["planner", "planner"], "planner: no node to run together"),
        ([], "no node is named"),
    ],
    ids=["another", "twice", "none"],
)
def test_what_cannot_run_together_is_told(names: list[str], said: str) -> None:
    command = [sys.executable, str(executables.find("isf_cell", "together")), *names]
    ended = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (ended.returncode, "Traceback" in ended.stderr) == (2, False)
    assert f"[1501 NODE_MISSING] together: {said}" in ended.stderr


def test_nodes_that_are_not_started_are_not_put_together(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(RuntimeError, match="nothing starts gripper"):
        lines_of(tmp_path, monkeypatch, "planner gripper")
