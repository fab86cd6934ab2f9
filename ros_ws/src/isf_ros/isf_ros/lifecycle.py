"""Base of the cell's nodes: lifecycle transitions that report errors with a code, parameters, heartbeat.

A node overrides :meth:`CellNode.configure`, :meth:`activate`, :meth:`deactivate` and :meth:`cleanup`; each may
raise IsfError, which is logged, shown in ``/diagnostics`` and makes the transition fail. Nodes start
*unconfigured* and are brought up by the executive or another lifecycle manager; with the parameter ``autostart``
a node brings itself up, for use alone in another cell.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any, Generic, TypeVar

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from isf_core.errors import ErrorCode, IsfError
from rcl_interfaces.msg import ParameterDescriptor
from rclpy.clock import Clock, ClockType
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn

from isf_ros import parameters

HEARTBEAT_PERIOD = 0.5
"""s of wall time between two messages on ``/diagnostics``."""

P = TypeVar("P")


class CellNode(LifecycleNode, Generic[P]):
    """A lifecycle node with parameters from a dataclass and a heartbeat."""

    def __init__(self, name: str, parameters_type: type[P], *, autostart: bool = False, **options: Any) -> None:
        super().__init__(name, **options)
        self._parameters_type = parameters_type
        parameters.declare(self, parameters_type)
        self.declare_parameter(
            "autostart",
            autostart,
            ParameterDescriptor(description="configure and activate without a lifecycle manager", read_only=True),
        )
        self.steady_clock = Clock(clock_type=ClockType.STEADY_TIME)
        self._state_label = "unconfigured"
        self._level = DiagnosticStatus.OK
        self._text = "ok"
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self._heartbeat = self.create_timer(HEARTBEAT_PERIOD, self._publish_health, clock=self.steady_clock)
        self._autostart = self.create_timer(0.0, self._bring_up, clock=self.steady_clock)

    def values(self) -> P:
        """The present parameters."""
        return parameters.read(self, self._parameters_type)

    # -- for nodes to override ---------------------------------------------------------------

    def configure(self) -> None:
        """Read parameters, make publishers and subscriptions."""

    def activate(self) -> None:
        """Start working."""

    def deactivate(self) -> None:
        """Stop working; the node can be activated again."""

    def cleanup(self) -> None:
        """Undo :meth:`configure`."""

    def close(self) -> None:
        """Called once before the process ends, in any state: write what must not be lost."""

    def health_values(self) -> dict[str, object]:
        """Numbers to show in ``/diagnostics``."""
        return {}

    def destroy_node(self) -> None:
        """Leave the ROS graph at once: the state machine would keep the node in it until a garbage collection."""
        super().destroy_node()
        self._state_machine.destroy_when_not_in_use()

    # -- for nodes to call ---------------------------------------------------------------------

    @property
    def is_active(self) -> bool:
        """True between activate and deactivate."""
        return self._state_label == "active"

    def report(self, error: IsfError) -> None:
        """Log an expected failure and keep it in ``/diagnostics`` until :meth:`report_ok`."""
        self.get_logger().error(str(error))
        self._level, self._text = DiagnosticStatus.ERROR, str(error)
        self._publish_health()

    def warn(self, warning: IsfError) -> None:
        """Log what a person should look at though the work goes on; in ``/diagnostics`` until :meth:`report_ok`."""
        self.get_logger().warning(str(warning))
        if self._level != DiagnosticStatus.ERROR:
            self._level, self._text = DiagnosticStatus.WARN, str(warning)
            self._publish_health()

    def report_ok(self) -> None:
        """Clear the failure shown in ``/diagnostics``."""
        self._level, self._text = DiagnosticStatus.OK, "ok"

    # -- lifecycle -----------------------------------------------------------------------------

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        return self._transition(self.configure, "inactive")

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        super().on_activate(state)
        return self._transition(self.activate, "active")

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        super().on_deactivate(state)
        return self._transition(self.deactivate, "inactive")

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        return self._transition(self.cleanup, "unconfigured")

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        if self.is_active:
            self._transition(self.deactivate, "inactive")
        return TransitionCallbackReturn.SUCCESS

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        self._state_label = "unconfigured"
        return TransitionCallbackReturn.SUCCESS

    def _transition(self, action: Callable[[], None], label: str) -> TransitionCallbackReturn:
        try:
            action()
        except IsfError as error:
            self.report(error)
            return TransitionCallbackReturn.FAILURE
        self._state_label = label
        self.report_ok()
        self._publish_health()
        return TransitionCallbackReturn.SUCCESS

    def _bring_up(self) -> None:
        self._autostart.cancel()
        if not self.get_parameter("autostart").value:
            return
        if self.trigger_configure() == TransitionCallbackReturn.SUCCESS:
            self.trigger_activate()

    def _publish_health(self) -> None:
        status = DiagnosticStatus(
            level=self._level, name=self.get_fully_qualified_name(), message=self._text, hardware_id="isf"
        )
        values = {"state": self._state_label, "pid": os.getpid(), **self.health_values()}
        status.values = [KeyValue(key=key, value=str(value)) for key, value in values.items()]
        message = DiagnosticArray(status=[status])
        message.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(message)


def failure(code: ErrorCode | int, text: str) -> IsfError:
    """IsfError from the code and text of a service or action response."""
    try:
        return IsfError(ErrorCode(code), text)
    except ValueError:
        return IsfError(ErrorCode.TRANSITION_FAILED, f"unknown error code {code}: {text}")
