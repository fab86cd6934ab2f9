"""A cell node whose callbacks raise what nobody expects; started by test_guard.py."""

import sys
from dataclasses import dataclass
from typing import Any

from isf_core.errors import IsfError
from isf_msgs.action import PlanPart
from isf_msgs.srv import Tare
from isf_ros import answers, process
from isf_ros.lifecycle import CellNode
from isf_ros.parameters import parameter
from rcl_interfaces.msg import SetParametersResult
from std_msgs.msg import String
from std_srvs.srv import Trigger


@dataclass(frozen=True)
class FaultyParameters:
    """Parameters of the node."""

    number: int = parameter(0, "a parameter whose change fails", read_only=False)
    fails_in: str = parameter("", "transition that fails", read_only=False)
    undiscovered: int = parameter(0, "looks at the graph that find no place for answers to goals", read_only=False)
    streams: bool = parameter(False, "served as the nodes with streams are")


class FaultyNode(CellNode[FaultyParameters]):
    def __init__(self) -> None:
        super().__init__("faulty", FaultyParameters)
        self._ticks = 0
        self._made_safe = 0
        self._looks = 0
        self.add_on_set_parameters_callback(self._on_parameters)

    def configure(self) -> None:
        self._fail_in("configure")
        self.create_timer(0.05, self._on_timer, clock=self.steady_clock)
        self.create_subscription(String, "text", self._on_text, 10)
        self.create_service(Tare, "with_code", self._on_service)
        self.create_service(Trigger, "with_success", self._on_service)
        answers.answers_reach_all = self._answers_reach_all
        self.create_action_server(PlanPart, "plan", self._on_goal, self._accept)

    def activate(self) -> None:
        self._fail_in("activate")

    def deactivate(self) -> None:
        self._fail_in("deactivate")

    def make_safe(self, error: IsfError) -> None:
        self._made_safe += 1
        raise RuntimeError("the reaction fails, too")

    def health_values(self) -> dict[str, object]:
        return {"ticks": self._ticks, "made_safe": self._made_safe}

    def _answers_reach_all(self, node: Any, service: str) -> bool:
        self._looks += 1
        return self._looks > self.values().undiscovered

    def _fail_in(self, transition: str) -> None:
        if self.values().fails_in == transition:
            raise KeyError(transition)

    def _on_parameters(self, changes: list[Any]) -> SetParametersResult:
        if any(change.name == "number" for change in changes):
            raise ZeroDivisionError("by a parameter")
        return SetParametersResult(successful=True)

    def _on_timer(self) -> None:
        self._ticks += 1
        raise LookupError("in a timer")

    def _on_text(self, message: String) -> None:
        raise AttributeError(f"in a subscription: {message.data}")

    def _on_service(self, request: Any, response: Any) -> Any:
        raise OSError("in a service")

    def _accept(self, goal: PlanPart.Goal) -> bool:
        if goal.base_folder == "refuse":
            raise TypeError("in the goal callback")
        return True

    async def _on_goal(self, handle: Any) -> PlanPart.Result:
        how = handle.request.base_folder
        if how == "raise":
            raise ArithmeticError("in an action")
        if how == "abort":
            handle.abort()
        return PlanPart.Result()


if __name__ == "__main__":
    sys.exit(process.run(FaultyNode, streams="streams:=true" in sys.argv))
