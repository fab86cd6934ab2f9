"""Services of the node ``machine``: tare, scan, stop, reset, save and load."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from isf_core.errors import ErrorCode, IsfError
from isf_core.job import JobFile
from isf_msgs.srv import Reset, Scan, StateFile, Stop, Tare

from isf_sim.machine import SimulatedMachine
from isf_sim.state_file import load_machine, save_machine

if TYPE_CHECKING:
    from isf_sim.node import MachineNode


class MachineServices:
    """Answers for a node; every answer owns the machine while it works on it."""

    def __init__(self, node: MachineNode) -> None:
        self._node = node

    def create(self) -> list[Any]:
        """Create the services; the node destroys them."""
        create = self._node.create_service
        return [
            create(Tare, "machine/tare", self._on_tare),
            create(Scan, "machine/scan", self._on_scan),
            create(Stop, "machine/stop", self._on_stop),
            create(Reset, "machine/reset", self._on_reset),
            create(StateFile, "machine/save", self._on_save),
            create(StateFile, "machine/load", self._on_load),
        ]

    def _on_tare(self, _: Tare.Request, response: Tare.Response) -> Tare.Response:
        with self._answering(response):
            machine = self._node.needed()
            zero_1, zero_2 = machine.tare()
            response.tool_1_zero, response.tool_2_zero = zero_1.tolist(), zero_2.tolist()
            self._tell_in_lockstep(machine)
        return response

    def _on_scan(self, request: Scan.Request, response: Scan.Response) -> Scan.Response:
        node = self._node
        with self._answering(response):
            machine = node.needed()
            if request.sensor:
                # a scanner takes its time; where time is the machine's own and nothing moves, that passes
                points = machine.measured_cloud(
                    clamped=request.clamped, duration=node.in_lockstep and not machine.moving
                )
                self._tell_in_lockstep(machine)
                node.publish_cloud(points)
                response.points = len(points)
            else:
                shape = machine.measured_shape()
                node.publish_scan(shape)
                response.points = shape.z.size
            node.targets_not_served()
        return response

    def _on_stop(self, request: Stop.Request, response: Stop.Response) -> Stop.Response:
        with self._answering(response):
            self._node.stop_machine(request.reason or "stop was requested")
        return response

    def _on_reset(self, request: Reset.Request, response: Reset.Response) -> Reset.Response:
        node = self._node
        if request.new_blank:
            node.stop_thread()  # before the machine is owned: the thread may wait for it
        with self._answering(response):
            if request.new_blank:
                job_file = self._job_of(request)
                node.clamp(SimulatedMachine(job_file, world=request.world, seed=request.seed))
            else:
                node.needed().reset()
            self._begin_anew()
        node.start_in_real_time()
        return response

    def _on_save(self, request: StateFile.Request, response: StateFile.Response) -> StateFile.Response:
        with self._answering(response):
            path = save_machine(self._node.needed(), self._path_of(request))
            self._node.targets_not_served()
            self._node.get_logger().info(f"state saved to {path}")
        return response

    def _on_load(self, request: StateFile.Request, response: StateFile.Response) -> StateFile.Response:
        node = self._node
        with self._answering(response):
            machine = load_machine(self._path_of(request))
        if response.code == 0:
            node.stop_thread()
            with self._answering(response):
                node.clamp(machine)
                self._begin_anew()
            node.start_in_real_time()
        return response

    def _begin_anew(self) -> None:
        self._node.forget_targets()
        self._node.report_ok()
        self._tell_in_lockstep(self._node.needed())

    def _tell_in_lockstep(self, machine: SimulatedMachine) -> None:
        node = self._node
        if node.is_active and node.in_lockstep:
            node.publish(machine.sample(), decimated=True)

    def _job_of(self, request: Reset.Request) -> JobFile:
        if request.job_text:
            return JobFile(request.job_text, Path(request.base_folder), "job")
        return self._node.needed().job_file

    @staticmethod
    def _path_of(request: StateFile.Request) -> Path:
        if not request.path:
            raise IsfError(ErrorCode.FILE_NOT_FOUND, "no path is given", where="path", advice="name a file")
        return Path(request.path)

    @contextlib.contextmanager
    def _answering(self, response: Any) -> Iterator[None]:
        """Own the machine while a service works on it; an expected failure becomes code and message."""
        with self._node.lock:
            try:
                yield
            except IsfError as error:
                response.code, response.message = int(error.code), error.message
                self._node.get_logger().warning(str(error))
