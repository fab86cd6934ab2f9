"""Every node of the cell, each in its own process: parameters in every state, transitions again and again, bad jobs."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
import rclpy
from isf_cell.processes.process_group import ProcessGroup
from isf_core.errors import ErrorCode
from isf_msgs.action import PlanPart
from isf_msgs.srv import Arm, Reset
from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState, GetState
from quick_cone import quick_cone
from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.msg import ParameterType
from rcl_interfaces.srv import (
    DescribeParameters,
    GetParameters,
    GetParameterTypes,
    ListParameters,
    SetParameters,
    SetParametersAtomically,
)
from rclpy.action import ActionClient
from rclpy.parameter import Parameter
from waiting import LIMIT, Waiting

pytestmark = pytest.mark.graph

NODES = {
    "machine": "isf_sim",
    "force_ctrl": "isf_force_ctrl",
    "planner": "isf_planner",
    "springback": "isf_springback",
    "load_cell": "isf_load_cell",
    "recorder": "isf_analysis",
    "dashboard": "isf_dashboard",
    "cell_state_publisher": "isf_description",
    "executive": "isf_cell",
}
UP = (Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_ACTIVATE)
DOWN = (Transition.TRANSITION_DEACTIVATE, Transition.TRANSITION_CLEANUP)


class Cell:
    """All nodes, unconfigured, and one that talks to them."""

    def __init__(self, group: ProcessGroup) -> None:
        self.group = group
        self.node = rclpy.create_node("observer")
        self.waiting = Waiting(self.node)
        self.wait = self.waiting.until
        self._clients: dict[str, Any] = {}

    def call(self, kind: Any, name: str, **fields: Any) -> Any:
        client = self._clients.get(name) or self._clients.setdefault(name, self.node.create_client(kind, name))
        assert client.wait_for_service(LIMIT), name
        future = client.call_async(kind.Request(**fields))
        assert self.wait(future.done), name
        return future.result()

    def change(self, name: str, transition: int) -> bool:
        change = Transition(id=transition)
        return bool(self.call(ChangeState, f"{name}/change_state", transition=change).success)

    def state(self, name: str) -> int:
        return int(self.call(GetState, f"{name}/get_state").current_state.id)

    def wake(self, name: str) -> None:
        for transition in UP:
            assert self.change(name, transition), (name, transition)
        assert self.state(name) == State.PRIMARY_STATE_ACTIVE

    def plan(self, job_text: str) -> Any:
        """Result of the planner's action."""
        client = ActionClient(self.node, PlanPart, "plan_part")
        assert client.wait_for_server(LIMIT)
        sent = client.send_goal_async(PlanPart.Goal(job_text=job_text))
        assert self.wait(sent.done)
        result = sent.result().get_result_async()
        assert self.wait(result.done)
        client.destroy()
        return result.result().result


@pytest.fixture(scope="module")
def cell(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cell]:
    folder = tmp_path_factory.mktemp("cell")
    file = folder / "cell.yaml"
    file.write_text("calibration_matrix: [[2, 0.1, 0], [0, -3, 0], [0, 0.2, 4]]\nrange: 1000\n", encoding="utf-8")
    options: dict[str, dict[str, object]] = {
        "load_cell": {"file": str(file)},
        "recorder": {"output": str(folder / "bag")},
        "dashboard": {"port": 0},
    }
    rclpy.init()
    with ProcessGroup(folder) as group:
        for name, package in NODES.items():
            group.start(package, name, {"autostart": False, **options.get(name, {})})
        found = Cell(group)
        yield found
        assert [node.name for node in group.dead()] == []  # after all that
        found.waiting.close()
        found.node.destroy_node()
    rclpy.try_shutdown()


def parameters_answer(cell: Cell, name: str) -> None:
    """Every parameter service of the node answers with what is asked for."""
    listed = cell.call(ListParameters, f"{name}/list_parameters").result.names
    assert {"autostart", "use_sim_time"} <= set(listed)
    values = cell.call(GetParameters, f"{name}/get_parameters", names=listed).values
    types = cell.call(GetParameterTypes, f"{name}/get_parameter_types", names=listed).types
    assert [value.type for value in values] == list(types)
    assert ParameterType.PARAMETER_NOT_SET not in types
    described = cell.call(DescribeParameters, f"{name}/describe_parameters", names=listed).descriptors
    assert [item.name for item in described] == listed
    # its own dump, as "ros2 param load" sets it: read-only ones too, to what they are
    dumped = [ParameterMessage(name=key, value=value) for key, value in zip(listed, values, strict=True)]
    loaded = cell.call(SetParameters, f"{name}/set_parameters", parameters=dumped).results
    assert [(key, item.reason) for key, item in zip(listed, loaded, strict=True) if not item.successful] == []
    other = not values[listed.index("autostart")].bool_value
    read_only = [Parameter("autostart", value=other).to_parameter_msg()]
    (refused,) = cell.call(SetParameters, f"{name}/set_parameters", parameters=read_only).results
    assert (refused.successful, "read-only" in refused.reason) == (False, True)
    both = [*read_only, Parameter("no_such_parameter", value=1).to_parameter_msg()]
    atomic = cell.call(SetParametersAtomically, f"{name}/set_parameters_atomically", parameters=both).result
    assert not atomic.successful
    same = [Parameter("use_sim_time", value=False).to_parameter_msg()]
    (taken,) = cell.call(SetParameters, f"{name}/set_parameters", parameters=same).results
    assert taken.successful


@pytest.mark.parametrize("name", NODES)
def test_a_node_comes_up_twice_and_answers_in_every_state(cell: Cell, name: str) -> None:
    assert cell.state(name) == State.PRIMARY_STATE_UNCONFIGURED
    assert not cell.change(name, Transition.TRANSITION_ACTIVATE)  # not from here
    before = {names for names, _ in cell.node.get_service_names_and_types_by_node(name, "/")}
    for _ in range(3):
        parameters_answer(cell, name)
        for transition in (*UP, *DOWN):
            assert cell.change(name, transition), transition
            parameters_answer(cell, name)
    assert cell.state(name) == State.PRIMARY_STATE_UNCONFIGURED
    after = lambda: {names for names, _ in cell.node.get_service_names_and_types_by_node(name, "/")}  # noqa: E731
    assert cell.wait(lambda: after() == before)  # nothing is left of what was configured


def test_a_job_with_a_date_that_is_none_is_refused_with_a_code(cell: Cell) -> None:
    for name in ("machine", "force_ctrl", "planner"):
        cell.wake(name)
    text = quick_cone().text
    for bad in (text.replace("name: mini_cone", "name: 2024-13-45"), "[" * 20_000, "name: " + "9" * 5000):
        assert bad != text
        reset = cell.call(Reset, "machine/reset", new_blank=True, job_text=bad)
        armed = cell.call(Arm, "force_ctrl/arm", plan_id="plan", count=1, job_text=bad)
        planned = cell.plan(bad)
        codes = {reset.code, armed.code, planned.code}
        assert len(codes) == 1
        assert codes <= {ErrorCode.FILE_FIELD, ErrorCode.FILE_SYNTAX}
        assert "job" in reset.message
    assert all(node.alive for node in cell.group.nodes)
    for name in ("machine", "force_ctrl", "planner"):
        for transition in DOWN:
            assert cell.change(name, transition)


@pytest.mark.parametrize("name", NODES)
def test_parameters_answer_after_the_end_of_a_node(cell: Cell, name: str) -> None:
    """Last, since nothing follows a shutdown."""
    assert cell.change(name, Transition.TRANSITION_UNCONFIGURED_SHUTDOWN)
    assert cell.state(name) == State.PRIMARY_STATE_FINALIZED
    parameters_answer(cell, name)
