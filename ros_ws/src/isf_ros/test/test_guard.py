"""No exception in any callback ends the process of a cell node: each is answered or reported with a code."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import forked_process
import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from isf_core.errors import ErrorCode
from isf_msgs.action import PlanPart
from isf_msgs.srv import Tare
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rcl_interfaces.srv import SetParameters
from rclpy.action import ActionClient
from rclpy.parameter import Parameter
from std_msgs.msg import String
from std_srvs.srv import Trigger

pytestmark = pytest.mark.graph

LIMIT = 120.0
"""s; only to end a test that hangs."""


class Faulty:
    """The process of the node, and the node that watches it."""

    def __init__(self, process: forked_process.ForkedProcess) -> None:
        self.process = process
        self.node = rclpy.create_node("observer")
        self.heard: list[DiagnosticStatus] = []
        self.node.create_subscription(DiagnosticArray, "/diagnostics", lambda m: self.heard.extend(m.status), 10)
        self.text = self.node.create_publisher(String, "text", 10)

    def wait(self, condition: Callable[[], Any]) -> bool:
        deadline = time.monotonic() + LIMIT
        while not condition() and time.monotonic() < deadline:
            rclpy.spin_once(self.node, timeout_sec=0.05)
        return bool(condition())

    def call(self, kind: Any, name: str, **fields: Any) -> Any:
        client = self.node.create_client(kind, name)
        assert client.wait_for_service(LIMIT)
        future = client.call_async(kind.Request(**fields))
        assert self.wait(future.done)
        self.node.destroy_client(client)
        return future.result()

    def change(self, transition: int) -> bool:
        return bool(self.call(ChangeState, "faulty/change_state", transition=Transition(id=transition)).success)

    def state(self) -> str:
        return str(self.call(GetState, "faulty/get_state").current_state.label)

    def set(self, **values: Any) -> Any:
        changes = [Parameter(name, value=value).to_parameter_msg() for name, value in values.items()]
        return self.call(SetParameters, "faulty/set_parameters", parameters=changes).results[0]

    def reports(self, text: str) -> bool:
        """Wait until the node's diagnostics have an error with ``text``."""
        return self.wait(
            lambda: any(
                status.level == DiagnosticStatus.ERROR and text in status.message and "1 INTERNAL" in status.message
                for status in self.heard
            )
        )

    def goal(self, how: str) -> PlanPart.Result | None:
        """Result of an action that does ``how``; None when it is refused."""
        client = ActionClient(self.node, PlanPart, "plan")
        assert client.wait_for_server(LIMIT)
        sent = client.send_goal_async(PlanPart.Goal(base_folder=how))
        assert self.wait(sent.done)
        if not sent.result().accepted:
            client.destroy()
            return None
        result = sent.result().get_result_async()
        assert self.wait(result.done)
        client.destroy()
        return result.result().result


@pytest.fixture(scope="module", params=[False, True], ids=["waiting", "streaming"])
def faulty(request: pytest.FixtureRequest) -> Iterator[Faulty]:
    rclpy.init()
    with forked_process.node(str(Path(__file__).with_name("faulty_node.py")), streams=request.param) as process:
        found = Faulty(process)
        try:
            yield found
            assert process.poll() is None  # after all that
        finally:
            found.node.destroy_node()
            rclpy.try_shutdown()


def test_transitions_that_raise_go_back_to_the_beginning(faulty: Faulty) -> None:
    assert not faulty.change(Transition.TRANSITION_ACTIVATE)  # not from here: refused, and no fault of the node
    assert faulty.state() == "unconfigured"

    assert faulty.set(fails_in="configure").successful
    assert not faulty.change(Transition.TRANSITION_CONFIGURE)
    assert faulty.reports("KeyError: 'configure'")
    assert faulty.state() == "unconfigured"

    faulty.set(fails_in="activate")
    assert faulty.change(Transition.TRANSITION_CONFIGURE)
    assert not faulty.change(Transition.TRANSITION_ACTIVATE)
    assert faulty.reports("KeyError: 'activate'")
    assert faulty.state() == "unconfigured"

    faulty.set(fails_in="deactivate")
    assert faulty.change(Transition.TRANSITION_CONFIGURE)
    assert faulty.change(Transition.TRANSITION_ACTIVATE)
    assert not faulty.change(Transition.TRANSITION_DEACTIVATE)
    assert faulty.state() == "unconfigured"

    faulty.set(fails_in="")
    assert faulty.change(Transition.TRANSITION_CONFIGURE)
    assert faulty.change(Transition.TRANSITION_ACTIVATE)
    assert faulty.state() == "active"


def test_timers_and_subscriptions_go_on(faulty: Faulty) -> None:
    def values() -> dict[str, int]:
        status = faulty.heard[-1]
        return {item.key: int(item.value) for item in status.values if item.value.isdigit()}

    assert faulty.reports("LookupError: in a timer")
    assert faulty.wait(lambda: values().get("ticks", 0) > 20)
    assert faulty.wait(lambda: values()["software_faults"] >= values()["ticks"])
    assert values()["made_safe"] > 0
    assert faulty.wait(lambda: faulty.text.get_subscription_count() == 1)
    faulty.text.publish(String(data="hello"))
    assert faulty.reports("AttributeError: in a subscription: hello")
    assert "topic text" in next(status.message for status in faulty.heard if "hello" in status.message)


def test_services_answer_with_a_code(faulty: Faulty) -> None:
    response = faulty.call(Tare, "with_code")
    assert response.code == ErrorCode.INTERNAL
    assert "OSError: in a service" in response.message
    answer = faulty.call(Trigger, "with_success")
    assert (answer.success, "OSError: in a service" in answer.message) == (False, True)


def test_a_parameter_whose_check_raises_is_refused(faulty: Faulty) -> None:
    result = faulty.set(number=3)
    assert not result.successful
    assert "ZeroDivisionError: by a parameter" in result.reason


def test_a_goal_waits_for_its_client_and_nothing_else_waits(faulty: Faulty) -> None:
    faulty.set(undiscovered=10**9)  # given up after 10 s
    client = ActionClient(faulty.node, PlanPart, "plan")
    assert client.wait_for_server(LIMIT)
    sent = client.send_goal_async(PlanPart.Goal())
    before = faulty.state()  # asked of a service
    assert not sent.done()
    faulty.set(undiscovered=0)
    assert faulty.wait(sent.done)
    assert sent.result().accepted
    assert before == "active"
    client.destroy()


def test_an_aborted_goal_never_has_code_0(faulty: Faulty) -> None:
    assert faulty.goal("refuse") is None
    raised = faulty.goal("raise")
    assert raised is not None
    assert (raised.code, "ArithmeticError: in an action" in raised.message) == (ErrorCode.INTERNAL, True)
    for how in ("abort", "neither"):
        result = faulty.goal(how)
        assert result is not None
        assert result.code == ErrorCode.INTERNAL
        assert "without a reason" in result.message
