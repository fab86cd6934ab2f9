"""Base of the cell's nodes: lifecycle transitions that report errors with a code, parameters, heartbeat.

A node overrides :meth:`CellNode.configure`, :meth:`activate`, :meth:`deactivate` and :meth:`cleanup`; each may
raise IsfError, which is logged, shown in ``/diagnostics`` and makes the transition fail. Nodes start
*unconfigured* and are brought up by the executive or another lifecycle manager; with the parameter ``autostart``
a node brings itself up, for use alone in another cell.

No callback ends the process: what one raises is reported with a code (:meth:`CellNode.fault`), and
:meth:`CellNode.make_safe` does what the node owes the tools. Whatever a node creates while it is configured or
activated is destroyed when it is cleaned up.
"""

from __future__ import annotations

import os
import time
import traceback
from collections.abc import Callable
from contextvars import ContextVar
from functools import partial
from typing import Any, Generic, TypeVar

from action_msgs.msg import GoalStatus
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from isf_core import __version__
from isf_core.errors import ErrorCode, IsfError, coded
from lifecycle_msgs.srv import ChangeState
from rcl_interfaces.msg import ParameterDescriptor, SetParametersResult
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.parameter import Parameter
from rclpy.qos import QoSPolicyKind, QoSProfile, qos_policy_name_from_kind

from isf_ros import parameters
from isf_ros.answers import client_discovered, keep_answers, once
from isf_ros.background import PatientActionServer
from isf_ros.busy_heartbeat import BusyHeartbeat
from isf_ros.guard import guarded, refuse
from isf_ros.process_identity import identity
from isf_ros.qos_match import best_effort, names_known, nothing_comes, nothing_goes, profile_of, taken_best_effort

HEARTBEAT_PERIOD = 0.5
"""s of wall time between two messages on ``/diagnostics``."""

FAULT_PERIOD = 1.0
"""s between two reports of faults at one place: a callback at the control rate may fail in every tick."""

NAME_PERIOD, NAME_LOOKS = 0.1, 50
"""s of wall time between two looks for the names of nodes whose deliveries do not go together, and how many: the
middleware tells of a topic before it tells whose it is, and of a node that is not of ROS it never does."""

OVERRIDES = (
    "add_on_set_parameters_callback",
    "create_client",
    "create_publisher",
    "create_service",
    "create_subscription",
    "create_timer",
    "destroy_node",
    "destroy_subscription",
    "on_activate",
    "on_cleanup",
    "on_configure",
    "on_deactivate",
    "on_error",
    "on_shutdown",
    "set_parameters_atomically",
)
"""What CellNode overrides of rclpy's node; nothing else of it may be hidden by a name of ours."""

ENDS = "finalized"
"""State of a node that was shut down, or whose process has been told to end: nothing brings it up any more."""

OWN_ARGUMENTS: ContextVar[tuple[str, ...]] = ContextVar("OWN_ARGUMENTS", default=())
"""ROS arguments for the next node that is made, where several are made in one process."""

P = TypeVar("P")


class CellNode(LifecycleNode, Generic[P]):
    """A lifecycle node with parameters from a dataclass and a heartbeat."""

    def __init__(self, name: str, parameters_type: type[P], *, autostart: bool = False, **options: Any) -> None:
        self._created: list[tuple[Callable[[Any], Any], Any]] = []
        self._in_transition = False
        self._fault_times: dict[str, float] = {}
        self._fault_count = 0
        self._successors: dict[int, Any] = {}
        self._apart: set[str] = set()
        super().__init__(name, **{"cli_args": list(OWN_ARGUMENTS.get()), **options})
        for service in self.services:  # those of the lifecycle are not made by create_service
            serve = service.callback
            if service.srv_type is ChangeState:
                serve = partial(self._change_state, serve)
            service.callback = guarded(serve, partial(self._service_failed, service.srv_name))
            keep_answers(self, service)
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
        self._heartbeat = self.create_timer(HEARTBEAT_PERIOD, self.publish_health, clock=self.steady_clock)
        self._process = {"pid": os.getpid(), "process": identity(), "version": __version__}
        self._health: dict[str, object] = {"state": self._state_label, **self._process}
        self._busy_heartbeat = BusyHeartbeat(self._publish_busy, HEARTBEAT_PERIOD)
        self._autostart = self.create_timer(0.0, self._bring_up, clock=self.steady_clock)

    def values(self, changes: dict[str, Any] | None = None) -> P:
        """The present parameters, or with ``changes`` of some; raises IsfError FILE_FIELD."""
        return parameters.read(self, self._parameters_type, changes)

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

    @property
    def exit_code(self) -> int:
        """Of the process, once the node is closed."""
        return 0

    def make_safe(self, error: IsfError) -> None:
        """Called after a fault in a callback that answers nobody: see to it that no tool stays pressed."""

    def health_values(self) -> dict[str, object]:
        """Numbers to show in ``/diagnostics``."""
        return {}

    def destroy_node(self) -> None:
        """Leave the ROS graph at once: the state machine would keep the node in it until a garbage collection."""
        self._busy_heartbeat.stop()
        super().destroy_node()
        self._state_machine.destroy_when_not_in_use()

    # -- for nodes to call ---------------------------------------------------------------------

    @property
    def is_active(self) -> bool:
        """True between activate and deactivate."""
        return self._state_label == "active"

    @property
    def is_configured(self) -> bool:
        """True between configure and cleanup."""
        return self._state_label in ("inactive", "active")

    def report(self, error: IsfError) -> None:
        """Log an expected failure and keep it in ``/diagnostics`` until :meth:`report_ok`."""
        self.get_logger().error(str(error))
        self._level, self._text = DiagnosticStatus.ERROR, str(error)
        self.publish_health()

    def warn(self, warning: IsfError) -> None:
        """Log what a person should look at though the work goes on; in ``/diagnostics`` until :meth:`report_ok`."""
        self.get_logger().warning(str(warning))
        if self._level != DiagnosticStatus.ERROR:
            self._level, self._text = DiagnosticStatus.WARN, str(warning)
            self.publish_health()

    def report_ok(self) -> None:
        """Clear the failure shown in ``/diagnostics``."""
        self._level, self._text = DiagnosticStatus.OK, "ok"

    def fault(self, error: Exception, where: str) -> IsfError:
        """Report what a callback (``where``) raised, unexpected failures with their traceback; returns it with a code.

        One report per place and second; all are counted in ``/diagnostics``.
        """
        found = coded(error, where=where, advice="a fault of this software; the traceback is in the node's log")
        self._fault_count += 1
        now = time.monotonic()
        if now - self._fault_times.get(where, -FAULT_PERIOD) >= FAULT_PERIOD:
            self._fault_times[where] = now
            if found is not error:
                self.get_logger().error("".join(traceback.format_exception(error)))
            self.report(found)
        return found

    def guard(self, callback: Callable[..., Any], where: str) -> Callable[..., Any]:
        """``callback`` of a thread or an entity that answers nobody; what it raises is a fault of this node."""
        return guarded(callback, partial(self._callback_failed, where))

    # -- entities: guarded, and destroyed by cleanup when made in a transition -------------------

    def create_subscription(
        self, kind: Any, topic: str, callback: Callable[..., Any], profile: QoSProfile | int, **options: Any
    ) -> Any:
        """As rclpy's; a stream that somebody publishes best effort is taken so, and both are told with a code."""
        asked = profile_of(profile)
        served = self.guard(callback, f"topic {topic}")
        make = partial(super().create_subscription, kind, topic, served)
        made: list[Any] = []

        def incompatible(event: Any) -> None:
            looser = best_effort(asked)
            if looser is None or event.last_policy_kind != QoSPolicyKind.RELIABILITY:
                policy = qos_policy_name_from_kind(event.last_policy_kind).lower()
                self.report_delivery(topic, self.report, partial(nothing_comes, self, topic, asked, policy))
            else:  # not here, where the subscription is in use
                once(self, lambda: self._take_best_effort(topic, asked, made[0], partial(make, looser, **options)))

        events = SubscriptionEventCallbacks(
            incompatible_qos=self.guard(incompatible, f"delivery of {topic}"), use_default_callbacks=False
        )
        made.append(make(asked, **{"event_callbacks": events, **options}))
        return self._noted(self.destroy_subscription, made[0])

    def destroy_subscription(self, subscription: Any) -> bool:
        """As rclpy's; what took the place of the subscription ends with it."""
        return bool(super().destroy_subscription(self._successors.pop(id(subscription), subscription)))

    def create_publisher(self, kind: Any, topic: str, profile: QoSProfile | int, **options: Any) -> Any:
        """As rclpy's; a subscription that asks for more than is offered is told with a code."""

        def incompatible(event: Any) -> None:
            policy = qos_policy_name_from_kind(event.last_policy_kind).lower()
            self.report_delivery(topic, self.warn, partial(nothing_goes, self, topic, profile_of(profile), policy))

        events = PublisherEventCallbacks(
            incompatible_qos=self.guard(incompatible, f"delivery of {topic}"), use_default_callbacks=False
        )
        made = super().create_publisher(kind, topic, profile, **{"event_callbacks": events, **options})
        return self._noted(self.destroy_publisher, made)

    def create_timer(self, period: float, callback: Callable[..., Any], *args: Any, **kw: Any) -> Any:
        name = getattr(callback, "__name__", "timer")
        made = super().create_timer(period, self.guard(callback, f"timer {name}"), *args, **kw)
        return self._noted(self.destroy_timer, made)

    def create_service(self, kind: Any, name: str, callback: Callable[..., Any], *args: Any, **kw: Any) -> Any:
        """As rclpy's; an answer that the middleware drops is sent again."""
        made = super().create_service(kind, name, guarded(callback, partial(self._service_failed, name)), *args, **kw)
        return self._noted(self.destroy_service, keep_answers(self, made))

    def create_client(self, *args: Any, **kw: Any) -> Any:
        return self._noted(self.destroy_client, super().create_client(*args, **kw))

    def create_action_server(
        self, kind: Any, name: str, execute: Callable[..., Any], accept: Callable[[Any], bool]
    ) -> ActionServer:
        """Server of an action that accepts a goal when ``accept`` of it is true, and every request to cancel. A goal
        is looked at when its client can be answered (:func:`isf_ros.answers.client_discovered`).

        The result of a goal that is aborted has a code: that of the exception, or INTERNAL. ``execute`` is a coroutine
        function that awaits nothing but :func:`isf_ros.background.in_thread`.
        """
        where = f"action {name}"

        async def serve(handle: Any) -> Any:
            try:
                result = await execute(handle)
            except Exception as error:
                found = self._react(error, where)
                result = refuse(kind.Result(), int(found.code), found.message)
            if handle.is_active:
                handle.abort()
            if handle.status == GoalStatus.STATUS_ABORTED and result.code == ErrorCode.OK:
                refuse(result, int(ErrorCode.INTERNAL), f"{name} was aborted without a reason")
            return result

        async def answer(goal: Any) -> GoalResponse:
            await client_discovered(self, name)
            return GoalResponse.ACCEPT if accept(goal) else GoalResponse.REJECT

        server = PatientActionServer(
            self,
            kind,
            name,
            serve,
            handle_accepted_callback=lambda handle: handle.execute(serve),
            goal_callback=guarded(answer, partial(self._goal_failed, where, GoalResponse.REJECT)),
            cancel_callback=lambda _: CancelResponse.ACCEPT,
            # of its own: rclpy's SingleThreadedExecutor calls none of a group while a goal of it waits for its client
            callback_group=MutuallyExclusiveCallbackGroup(),
        )
        return self._noted(ActionServer.destroy, server)

    def set_parameters_atomically(self, parameter_list: list[Parameter]) -> SetParametersResult:
        """As rclpy's, but a read-only parameter may be set to what it is: then a node takes what ``ros2 param dump``
        has written of it."""
        changes = [item for item in parameter_list if not self._is_fixed_so(item)]
        if not changes:
            return SetParametersResult(successful=True)
        return super().set_parameters_atomically(changes)

    def _is_fixed_so(self, item: Parameter) -> bool:
        if not self.has_parameter(item.name) or not self.describe_parameter(item.name).read_only:
            return False
        return bool(self.get_parameter(item.name).get_parameter_value() == item.get_parameter_value())

    def add_on_set_parameters_callback(self, callback: Callable[..., SetParametersResult]) -> None:
        def failed(error: Exception, *_: Any) -> SetParametersResult:
            found = self.fault(error, "setting a parameter")
            return SetParametersResult(successful=False, reason=found.message)

        super().add_on_set_parameters_callback(guarded(callback, failed))

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
        self._state_label = ENDS  # also where that failed
        self.publish_health()
        return TransitionCallbackReturn.SUCCESS

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """After a transition that raised what nobody expected: back to the beginning, from where it can be tried again.

        What the node still can undo is undone; the failure stays in ``/diagnostics``.
        """
        for undo in (self.deactivate, self.cleanup):
            try:
                undo()
            except Exception as error:  # of what half a transition has left
                self.get_logger().error(f"{undo.__name__} after a fault: {coded(error)}")
        self._destroy_created()
        self._state_label = "unconfigured"
        self.publish_health()
        return TransitionCallbackReturn.SUCCESS

    def _change_state(self, change: Callable[..., Any], request: Any, response: Any) -> Any:
        """As rclpy's, which raises an exception for the number of a transition that the present state has not."""
        possible = {number: label for number, label, *_ in self._state_machine.available_transitions}
        if request.transition.label or request.transition.id in possible:
            return change(request, response)
        what = f"no transition {request.transition.id} from state {self._state_machine.current_state[1]}"
        advice = ", ".join(f"{number} {label}" for number, label in possible.items())
        error = IsfError(
            ErrorCode.TRANSITION_FAILED, what, where="change_state", advice=f"there are {advice or 'none'}"
        )
        self.get_logger().warning(str(error))
        response.success = False
        return response

    def _transition(self, action: Callable[[], None], label: str) -> TransitionCallbackReturn:
        self._in_transition = True
        try:
            action()
        except IsfError as error:
            self.report(error)
            if self._state_label == "unconfigured":
                self._destroy_created()
            return TransitionCallbackReturn.FAILURE
        except Exception as error:
            self._react(error, f"transition to {label}")
            return TransitionCallbackReturn.ERROR
        finally:
            self._in_transition = False
        if label == "unconfigured":
            self._destroy_created()
        self._state_label = label
        self.report_ok()
        self.publish_health()
        return TransitionCallbackReturn.SUCCESS

    # -- faults and entities -----------------------------------------------------------------------

    def _callback_failed(self, where: str, error: Exception, *_: Any) -> None:
        self._react(error, where)

    def _react(self, error: Exception, where: str) -> IsfError:
        """Report a fault that leaves the work undone, and make the tools safe."""
        found = self.fault(error, where)
        try:
            self.make_safe(found)
        except Exception as another:
            self.fault(another, f"reaction to a fault in {where}")
        return found

    def _service_failed(self, name: str, error: Exception, _: Any, response: Any) -> Any:
        found = self.fault(error, f"service {name}")
        text = found.message if hasattr(response, "code") else str(found)
        return refuse(response, int(found.code), text)

    def _goal_failed(self, where: str, answer: GoalResponse, error: Exception, _: Any) -> GoalResponse:
        self.fault(error, where)
        return answer

    # -- delivery ----------------------------------------------------------------------------------

    def report_delivery(
        self, topic: str, report: Callable[[IsfError], None], error: Callable[[], IsfError], looks: int = NAME_LOOKS
    ) -> None:
        """Have ``topic``, whose QoS does not go together, named in ``/diagnostics``, and ``error`` of it reported as
        soon as the names of all nodes concerned are known, or after ``looks`` looks for them."""
        self._apart.add(topic)
        if looks and not names_known(self, topic):
            once(self, partial(self.report_delivery, topic, report, error, looks - 1), NAME_PERIOD)
        else:
            report(error())

    def _take_best_effort(self, topic: str, asked: QoSProfile, before: Any, make: Callable[[], Any]) -> None:
        if before not in list(self.subscriptions):
            return  # destroyed meanwhile
        self.report_delivery(topic, self.warn, partial(taken_best_effort, self, topic, asked))
        self.destroy_subscription(before)
        self._successors[id(before)] = make()

    def _noted(self, destroy: Callable[[Any], Any], entity: Any) -> Any:
        if self._in_transition:
            self._created.append((destroy, entity))
        return entity

    def _destroy_created(self) -> None:
        """Destroy what was made while the node was configured and activated, unless that was done before."""
        for destroy, entity in self._created:
            destroy(entity)
        self._created = []
        self._apart.clear()

    def _bring_up(self) -> None:
        self._autostart.cancel()
        if not self.get_parameter("autostart").value:
            return
        if self.trigger_configure() == TransitionCallbackReturn.SUCCESS:
            self.trigger_activate()

    def publish_health(self) -> None:
        """The regular sign of life, and at every change of what it says."""
        values = {"state": self._state_label, **self._process, **self.health_values()}
        if self._apart:
            values["qos_incompatible"] = ", ".join(sorted(self._apart))
        if self._fault_count:
            values["software_faults"] = self._fault_count
        self._health = values
        self._publish_status(values)
        self._busy_heartbeat.served()

    def tell_end(self) -> None:
        """The last sign of life: who waits for this node need not wait until its process is seen to have ended."""
        self._publish_status({**self._health, "state": ENDS})

    def _publish_busy(self, seconds: float) -> None:
        """The last sign of life once more, from a thread of its own: the executor is in one callback."""
        self._publish_status({**self._health, "in_one_callback_s": round(seconds, 1)})

    def _publish_status(self, values: dict[str, object]) -> None:
        status = DiagnosticStatus(
            level=self._level, name=self.get_fully_qualified_name(), message=self._text, hardware_id="isf"
        )
        status.values = [KeyValue(key=key, value=str(value)) for key, value in values.items()]
        message = DiagnosticArray(status=[status])
        message.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(message)
