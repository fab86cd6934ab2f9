"""Several nodes in one process: a part is formed by them as by one process each, and they end together."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import forked_process
import launch_standin
import numpy as np
import pytest
import rclpy
import yaml
from isf_analysis.bag.bag_reader import read_bag
from isf_analysis.bag.open_bag import bag_of, open_bag
from isf_cell import in_process
from isf_cell.processes import executables
from isf_msgs.action import FormPart
from isf_msgs.msg import ContourResult
from isf_ros import qos
from isf_ros.conversion import result_from_message
from parameter_rounds import ParameterRounds
from quick_cone import quick_cone, quick_cone_file
from rcl_interfaces.srv import GetParameters
from rclpy.action import ActionClient
from rclpy.node import Node
from rclpy.parameter import parameter_value_to_python
from waiting import LIMIT, Waiting

pytestmark = pytest.mark.graph

LAUNCH = Path(__file__).resolve().parents[2] / "ros_ws" / "src" / "isf_cell" / "launch" / "cell.launch.py"
CELL = "/cell_1"
CELLS = ("/cell_1", "/cell_2")
TOGETHER = "recorder machine force_ctrl planner springback executive cell_state_publisher"


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
    assert set(lines) == {"together"}
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
    assert there >= set(TOGETHER.split())
    assert codes == [0] * len(lines)
    here, record = in_process.form(quick_cone()), read_bag(tmp_path / "bag")
    for mine, theirs in zip(here.results, record.results, strict=True):
        np.testing.assert_allclose(theirs.forming_target, mine.forming_target, atol=1e-6)
    with open_bag(bag_of(tmp_path / "bag")) as bag:  # what cell_state_publisher tells, brought up by its parameter
        counts = {connection.topic: connection.msgcount for connection in bag.connections}
    assert counts[f"{CELL}/joint_states"] > 10


def test_two_cells_in_one_process_form_the_same_part_at_once(tmp_path: Path) -> None:
    """Bit for bit, though all parameters of one cell are read and set to what they are again and again meanwhile.

    benchmarks/parameters_while_forming.py does that 1,000 times in a part.
    """
    nodes = ("machine", "force_ctrl", "planner", "springback", "executive")
    names = [f"{cell}/{name}" for cell in CELLS for name in nodes]
    command = [sys.executable, str(executables.find("isf_cell", "together")), *names]
    command += ["--ros-args", "-r", "/clock:=clock"]
    for cell in CELLS:  # one parameter for all of a name, one for the node of one cell
        command += ["-p", f"{cell}/springback:state_folder:={tmp_path}{cell}"]
    command += ["-p", "force_ctrl:state_decimation:=7"]
    job = quick_cone()
    goal = FormPart.Goal(job_text=job.text, base_folder=str(job.base))
    results: dict[str, list[ContourResult]] = {cell: [] for cell in CELLS}
    rounds = ParameterRounds([f"{CELLS[0]}/{name}" for name in nodes], 1000)
    rclpy.init()
    node = rclpy.create_node("client")
    waiting = Waiting(node)
    process = forked_process.start(command, start_new_session=True)
    try:
        clients = [ActionClient(node, FormPart, f"{cell}/form_part") for cell in CELLS]
        for cell in CELLS:
            node.create_subscription(ContourResult, f"{cell}/contour/result", results[cell].append, qos.EVENT)
        for client in clients:
            assert waiting.until(client.server_is_ready)
        sent = [client.send_goal_async(goal) for client in clients]
        assert waiting.until(lambda: all(one.done() for one in sent))
        formed = [one.result().get_result_async() for one in sent]
        assert waiting.until(lambda: results[CELLS[0]])
        rounds.start()
        assert waiting.until(lambda: all(one.done() for one in formed), 4 * LIMIT)
        rounds.stop()
        asked = {
            name: parameter_of(node, waiting, f"{CELLS[1]}/{name}", parameter)
            for name, parameter in (("force_ctrl", "state_decimation"), ("springback", "state_folder"))
        }
        for client in clients:
            client.destroy()
    finally:
        rounds.stop()
        os.killpg(process.pid, signal.SIGINT)
        code = process.wait(LIMIT)
        waiting.close()
        node.destroy_node()
        rclpy.try_shutdown()
    assert [(one.result().result.code, one.result().result.message) for one in formed] == [(0, ""), (0, "")]
    assert code == 0
    assert rounds.failure == ""
    assert rounds.done >= 3
    assert rounds.parameters > 80
    assert asked == {"force_ctrl": 7, "springback": f"{tmp_path}{CELLS[1]}"}
    here = in_process.form(job).results
    one, other = ([result_from_message(message) for message in results[cell]] for cell in CELLS)
    for mine, theirs, others in zip(here, one, other, strict=True):
        np.testing.assert_allclose(theirs.forming_target, mine.forming_target, atol=1e-6)
        np.testing.assert_array_equal(theirs.forming_target, others.forming_target)  # bit for bit
        np.testing.assert_array_equal(theirs.forming_force, others.forming_force)


def parameter_of(node: Node, waiting: Waiting, name: str, parameter: str) -> Any:
    client = node.create_client(GetParameters, f"{name}/get_parameters")
    assert waiting.until(client.service_is_ready)
    asked = client.call_async(GetParameters.Request(names=[parameter]))
    assert waiting.until(asked.done)
    return parameter_value_to_python(asked.result().values[0])


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["planner", "gripper"], "[1501 NODE_MISSING] together: gripper: no node to run together"),
        (["planner", "planner"], "[1501 NODE_MISSING] together: planner: no node to run together"),
        ([], "[1501 NODE_MISSING] together: no node is named"),
        (
            ["planner", "--ros-args", "-p", "springback:autostart:=true"],
            "[1501 NODE_MISSING] together: springback: no node to run together",
        ),
        (
            ["/cell_1/machine", "/cell_1/planner", "--ros-args", "-p", "machine:lockstep:=false"],
            "[1003 FILE_FIELD] together: /cell_1/machine ticks by the clock",
        ),
    ],
    ids=["another", "twice", "none", "parameter of another", "by the clock"],
)
def test_what_cannot_run_together_is_told(words: list[str], said: str) -> None:
    command = [sys.executable, str(executables.find("isf_cell", "together")), *words]
    ended = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (ended.returncode, "Traceback" in ended.stderr) == (2, False)
    assert said in ended.stderr


def test_nodes_that_are_not_started_are_not_put_together(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(RuntimeError, match="nothing starts gripper"):
        lines_of(tmp_path, monkeypatch, "planner gripper")
