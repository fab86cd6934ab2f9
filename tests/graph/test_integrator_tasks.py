"""The commands of docs/own_cell/integrator_tasks.md, one after the other, against the nodes that they start.

``ros2 run`` starts the installed program. What other tools of ros2 do is done here by the services, actions and topics
that they use, since the tools need not be installed.
"""

from __future__ import annotations

import importlib
import os
import re
import shlex
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import forked_process
import pytest
import rclpy
import yaml
from isf_cell.processes import executables
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.srv import DescribeParameters, GetParameters, ListParameters, SetParameters
from rclpy.action import ActionClient
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from waiting import LIMIT, Waiting

pytestmark = [pytest.mark.graph, pytest.mark.clock]

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "own_cell" / "integrator_tasks.md"
TRANSITIONS = {
    "configure": Transition.TRANSITION_CONFIGURE,
    "activate": Transition.TRANSITION_ACTIVATE,
    "deactivate": Transition.TRANSITION_DEACTIVATE,
    "cleanup": Transition.TRANSITION_CLEANUP,
}


def tasks() -> list[str]:
    blocks = re.findall(r"^```sh\n(.*?)^```", PAGE.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    return [re.sub(r"\s+# .*$", "", line) for line in "".join(blocks).splitlines() if line.strip()]


class Tools:
    """What ``ros2 VERB WORD ...`` does, and whether it does what a person wants of it."""

    def __init__(self, folder: Path) -> None:
        self.node = rclpy.create_node("tools")
        self._waiting = Waiting(self.node)
        self.folder = folder
        self.processes: list[forked_process.Process] = []

    def close(self) -> None:
        for process in self.processes:
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGINT)
        self.codes = [process.wait(LIMIT) for process in self.processes]
        self._waiting.close()
        self.node.destroy_node()

    def wait(self, condition: Callable[[], Any]) -> Any:
        assert self._waiting.until(condition)
        return condition()

    def ask(self, kind: Any, name: str, **fields: Any) -> Any:
        client = self.node.create_client(kind, name)
        self.wait(client.service_is_ready)
        future = client.call_async(kind.Request(**fields))
        self.wait(future.done)
        self.node.destroy_client(client)
        return future.result()

    # -- ros2 ------------------------------------------------------------------------------------

    def run(self, package: str, program: str, *options: str) -> None:
        command = [sys.executable, str(executables.find(package, program)), *options]
        self.processes.append(forked_process.start(command, cwd=self.folder, start_new_session=True))

    def lifecycle_get(self, node: str) -> str:
        return str(self.ask(GetState, f"{node}/get_state").current_state.label)

    def lifecycle_set(self, node: str, label: str) -> None:
        assert self.ask(ChangeState, f"{node}/change_state", transition=Transition(id=TRANSITIONS[label])).success

    def node_list(self) -> None:
        self.wait(lambda: {"/cell_1/force_ctrl", "/cell_1/machine", "/planner"} <= set(self._nodes()))

    def topic_list(self) -> None:
        names = {name for name, _ in self.node.get_topic_names_and_types()}
        assert {"/cell_1/tool_1/wrench", "/cell_1/tool_1/target", "/cell_1/contour/corrected"} <= names

    def topic_hz(self, topic: str) -> None:
        self._heard(topic, 20)

    def topic_echo(self, _: str, topic: str) -> None:
        self._heard(topic, 1)

    def param_list(self, node: str) -> list[str]:
        return list(self.ask(ListParameters, f"{node}/list_parameters").result.names)

    def param_describe(self, node: str, name: str) -> None:
        (found,) = self.ask(DescribeParameters, f"{node}/describe_parameters", names=[name]).descriptors
        assert found.description == "K_i K_c of the force loop [1/s]"
        assert (found.floating_point_range[0].from_value, found.floating_point_range[0].to_value) == (0.1, 500.0)

    def param_get(self, node: str, name: str) -> Any:
        return parameter_value_to_python(self.ask(GetParameters, f"{node}/get_parameters", names=[name]).values[0])

    def param_set(self, node: str, name: str, text: str) -> None:
        value = Parameter(name, value=yaml.safe_load(text)).to_parameter_msg()
        (result,) = self.ask(SetParameters, f"{node}/set_parameters", parameters=[value]).results
        assert result.successful, result.reason
        assert self.param_get(node, name) == yaml.safe_load(text)

    def param_dump(self, node: str, _: str, file: str) -> None:
        """As ros2cli does: the file is for the node of that full name, and no other one takes it."""
        values = {name: self.param_get(node, name) for name in self.param_list(node)}
        (self.folder / file).write_text(yaml.safe_dump({node: {"ros__parameters": values}}), encoding="utf-8")

    def param_load(self, node: str, file: str) -> None:
        values = yaml.safe_load((self.folder / file).read_text(encoding="utf-8"))[node]["ros__parameters"]
        messages: list[ParameterMessage] = [Parameter(k, value=v).to_parameter_msg() for k, v in values.items()]
        for result in self.ask(SetParameters, f"{node}/set_parameters", parameters=messages).results:
            assert result.successful, result.reason

    def service_call(self, name: str, kind: str, text: str = "{}") -> None:
        answer = self.ask(_type(kind), name, **yaml.safe_load(text))
        assert getattr(answer, "code", 0) == 0, answer.message
        assert getattr(answer, "success", True)

    def action_send_goal(self, _: str, name: str, kind: str, text: str) -> None:
        feedback: list[Any] = []
        client = ActionClient(self.node, _type(kind), name)
        self.wait(client.server_is_ready)
        sent = client.send_goal_async(_type(kind).Goal(**yaml.safe_load(text)), feedback_callback=feedback.append)
        self.wait(sent.done)
        result = sent.result().get_result_async()
        self.wait(result.done)
        client.destroy()
        assert (result.result().result.code, result.result().result.message) == (0, "")
        assert feedback

    # -- inside ----------------------------------------------------------------------------------

    def _nodes(self) -> list[str]:
        found = self.node.get_node_names_and_namespaces()
        return [f"{namespace.rstrip('/')}/{name}" for name, namespace in found]

    def _heard(self, topic: str, count: int) -> None:
        heard: list[Any] = []
        (kind,) = self.wait(lambda: dict(self.node.get_topic_names_and_types()).get(topic))
        infos = self.wait(lambda: self.node.get_publishers_info_by_topic(topic))
        latched = all(info.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL for info in infos)
        profile = QoSProfile(
            depth=50,
            reliability=ReliabilityPolicy.BEST_EFFORT,
            durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
        )
        subscription = self.node.create_subscription(_type(kind), topic, heard.append, profile)
        self.wait(lambda: len(heard) >= count)
        self.node.destroy_subscription(subscription)


def _type(name: str) -> Any:
    package, folder, kind = name.split("/")
    return getattr(importlib.import_module(f"{package}.{folder}"), kind)


@pytest.fixture
def tools(tmp_path: Path) -> Iterator[Tools]:
    rclpy.init()
    found = Tools(tmp_path)
    try:
        yield found
    finally:
        found.close()
        rclpy.try_shutdown()
    assert set(found.codes) == {0}  # every node ends by itself, and well


def test_the_tasks_are_done_as_written(tools: Tools) -> None:
    (tools.folder / "examples").symlink_to(ROOT / "examples")  # where the nodes are started
    lines = tasks()
    assert len(lines) >= 20
    for line in lines:
        tool, verb, *words = shlex.split(line)
        if tool == "sed":
            subprocess.run([tool, verb, *words], cwd=tools.folder, check=True)
            continue
        assert tool == "ros2"
        method = tools.run if verb == "run" else getattr(tools, f"{verb}_{words.pop(0)}")
        try:
            method(*words)
        except AssertionError as error:
            raise AssertionError(f"{line}: {error}") from error
    assert tools.lifecycle_get("/cell_1/force_ctrl") == "unconfigured"
    tools.wait(lambda: "/cell_2/force_ctrl" in tools._nodes())
    assert tools.param_get("/cell_2/force_ctrl", "loop_gain") == 20.0  # as it was dumped
