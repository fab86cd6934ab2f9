"""Action ``identify`` of node ``force_ctrl``: properties of the machine, measured with its own tools."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile
from isf_msgs.action import Identify
from isf_ros.background import in_thread
from isf_ros.lifecycle import CellNode
from rclpy.action.server import ServerGoalHandle

from isf_force_ctrl.controller import ForceController
from isf_force_ctrl.measurements.measurement import Probe, load_measurement
from isf_force_ctrl.ros.measurement_actions import follow
from isf_force_ctrl.ros.readiness import Readiness


class IdentifyAction:
    """Serves the action for ``node``.

    ``armed`` gives the present controller and its job (None: nothing was armed), ``begun`` is called with the lock held
    when the measurement begins, so that the first targets go out.
    """

    def __init__(
        self,
        node: CellNode[Any],
        lock: threading.RLock,
        ready: Readiness,
        armed: Callable[[], tuple[ForceController, JobFile] | None],
        begun: Callable[[], None],
    ) -> None:
        self._node, self._lock, self._ready, self._armed, self._begun = node, lock, ready, armed, begun
        node.create_action_server(Identify, "identify", self._identify, lambda _: node.is_active)

    async def _identify(self, handle: ServerGoalHandle) -> Identify.Result:
        try:
            controller, identification, probe = self._start(handle.request)
        except IsfError as error:
            self._node.report(error)
            handle.abort()
            return Identify.Result(code=int(error.code), message=error.message)

        def notify() -> None:
            handle.publish_feedback(Identify.Feedback(phase=probe.phase, progress=float(probe.progress)))

        def measure() -> Identify.Result:
            follow(handle, lambda: controller.measuring, controller.cancel, self._lock, notify)
            if not probe.ended and probe.code is ErrorCode.OK:  # the controller was put away
                probe.give_up(ErrorCode.STOPPED, "the measurement was ended from outside", stay=True)
            found = identification.finding(probe, controller.config)
            result = Identify.Result(code=int(found.code), message=found.message, file_text=found.piece)
            result.value, result.uncertainty = found.value.tolist(), found.uncertainty.tolist()
            if found.notes:
                result.file_text = "".join(f"# {note}\n" for note in found.notes) + found.piece
            return result

        result = await in_thread(measure, self._node.executor)
        if result.code == ErrorCode.OK:
            handle.succeed()
        elif handle.is_cancel_requested:
            handle.canceled()
        else:
            self._node.report(IsfError(ErrorCode(result.code), result.message, where="identify"))
            handle.abort()
        return result

    def _start(self, goal: Identify.Goal) -> tuple[ForceController, Any, Probe]:
        """The controller, the measurement and its probe, begun."""
        armed = self._armed()
        if armed is None:
            raise IsfError(ErrorCode.NOT_ARMED, "no plan is armed", where="identify", advice="arm the plan first")
        controller, job_file = armed
        identification = load_measurement("identify")(
            job_file, goal.property, goal.tool, goal.repeats, goal.places, goal.max_force
        )
        self._ready.check(tared=self._node.values().wrenches_tared)
        with self._lock:
            probe = controller.measure(identification.probe)
            self._begun()
        return controller, identification, probe
