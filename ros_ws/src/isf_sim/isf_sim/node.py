"""Node ``machine``: the simulated machine behind the topics and services of a cell.

Topics, services, lockstep and watchdogs: docs/architecture.md. A blank is clamped by the parameter ``job`` or by
``machine/reset``; without one the node is active but silent.
"""

from __future__ import annotations

import contextlib
import math
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from geometry_msgs.msg import PoseStamped
from isf_core.errors import ErrorCode, IsfError
from isf_core.job import JobFile, load_job
from isf_msgs.msg import MachineState
from isf_msgs.srv import Reset, Scan, Stop, Tare
from isf_node import conversion, process, qos, stamps
from isf_node.lifecycle import CellNode
from isf_node.watchdog import ReceiveWatchdog

from isf_sim.machine import MachineSample, SimulatedMachine
from isf_sim.node_outlet import MachineOutlet
from isf_sim.node_parameters import MachineParameters
from isf_sim.real_time import PeriodicThread
from isf_sim.target_pair import TargetPair
from isf_sim.warm_up import warm_up

HEARTBEAT_PERIOD = 0.2
"""s of wall time after which a waiting machine repeats its wrenches."""
BRIDGE_PERIOD = 0.02
"""s of wall time after which a tick in real time that takes long repeats the last wrenches."""
LONGEST_CATCH_UP = 0.5
"""s, missed ticks beyond this are dropped."""
LOCKSTEP_TIMEOUT, REAL_TIME_TIMEOUT = 2.0, 0.25
"""s of wall time without targets after which a loaded or moving machine stops."""

LARGEST_DRY = 2
"""Ticks without a new pair of targets that are no gap in real time."""


class MachineNode(CellNode[MachineParameters]):
    """ROS side of :class:`isf_sim.machine.SimulatedMachine`."""

    def __init__(self) -> None:
        super().__init__("machine", MachineParameters)
        self._machine: SimulatedMachine | None = None
        self._outlet: MachineOutlet | None = None
        self._thread: PeriodicThread | None = None
        self._entities: list[tuple[Any, Any]] = []
        self._targets = TargetPair()
        self._lock = threading.RLock()
        self._first_tick = 0
        self._stamp = 0
        self._lost = 0
        self._late = 0
        self._dry = 0
        self._following = False
        self._release: Iterator[MachineSample] | None = None
        self._published = 0.0
        self._period = 0
        self._sample: MachineSample | None = None
        self._publishing = threading.Lock()

    # -- lifecycle ---------------------------------------------------------------------------------

    def configure(self) -> None:
        self._parameters = values = self.values()
        timeout = values.target_timeout or (LOCKSTEP_TIMEOUT if values.lockstep else REAL_TIME_TIMEOUT)
        self._watchdog = ReceiveWatchdog(timeout)
        if values.job:
            self._clamp(load_job(values.job), values.world, values.seed)
        self._outlet = MachineOutlet(self, clock=values.lockstep)
        subscriptions = [
            self.create_subscription(PoseStamped, "tool_1/target", lambda m: self._on_target(1, m), qos.STREAM),
            self.create_subscription(PoseStamped, "tool_2/target", lambda m: self._on_target(2, m), qos.STREAM),
        ]
        services = [
            self.create_service(Tare, "machine/tare", self._on_tare),
            self.create_service(Scan, "machine/scan", self._on_scan),
            self.create_service(Stop, "machine/stop", self._on_stop),
            self.create_service(Reset, "machine/reset", self._on_reset),
        ]
        look = 0.25 * HEARTBEAT_PERIOD if values.lockstep else 0.5 * BRIDGE_PERIOD
        timer = self.create_timer(look, self._on_timer, clock=self.steady_clock)
        self._entities = [
            *((self.destroy_subscription, item) for item in subscriptions),
            *((self.destroy_service, item) for item in services),
            (self.destroy_timer, timer),
        ]

    def activate(self) -> None:
        self._targets.clear()
        self._watchdog.clear()
        self._following = False
        if self._machine is not None:
            self._start()

    def deactivate(self) -> None:
        self._stop_thread()

    def cleanup(self) -> None:
        for destroy, entity in self._entities:
            destroy(entity)
        self._entities = []
        if self._outlet is not None:
            self._outlet.close()
            self._outlet = None

    def close(self) -> None:
        self._stop_thread()

    def health_values(self) -> dict[str, object]:
        machine = self._machine
        if machine is None:
            return {"blank": "none"}
        return {
            "blank": machine.job_file.job.name,
            "tick": self._tick(),
            "faults": ", ".join(code.name for code, _ in machine.faults) or "none",
            "late_ticks": self._late_ticks(),
        }

    # -- blank and time ------------------------------------------------------------------------------

    def _clamp(self, job_file: JobFile, world: int, seed: int) -> None:
        """Fresh blank and parked tools; time goes on where it was."""
        machine = SimulatedMachine(job_file, world=world, seed=seed)
        before = self._machine
        if before is not None and before.control_rate != machine.control_rate:
            self._first_tick = math.ceil(self._tick() / before.control_rate * machine.control_rate)
        else:
            self._first_tick = self._tick()
        self._machine = machine
        self._release = None
        self._following = False
        self._targets.clear()
        self.get_logger().info(
            f"blank of {job_file.material.name} for '{job_file.job.name}', plant {machine.world.as_dict()}"
        )

    def _tick(self) -> int:
        """Control ticks since the node was configured first, at the present rate."""
        return self._first_tick + (self._machine.tick_count if self._machine else 0)

    def _start(self) -> None:
        machine = self._needed()
        if self._parameters.lockstep:
            self._publish(machine.sample(), decimated=True)
        else:
            self._begin = self.get_clock().now().nanoseconds
            self._period = -1
            self._thread = PeriodicThread(machine.control_rate, self._on_period)
            self._thread.start()

    def _stop_thread(self) -> None:
        if self._thread is not None:
            self._thread.stop()
            self._late += self._thread.late
            self._thread = None

    def _late_ticks(self) -> int:
        return self._late + (self._thread.late if self._thread is not None else 0)

    # -- ticks -------------------------------------------------------------------------------------

    def _on_target(self, tool: int, message: PoseStamped) -> None:
        if not self.is_active:
            return
        self._watchdog.feed()
        self._targets.put(tool, stamps.to_nanoseconds(message.header.stamp), conversion.tip_of(message))
        machine = self._machine
        if machine is None or not self._parameters.lockstep or machine.faulted:
            return
        due = stamps.tick_nanoseconds(self._tick() + 1, machine.control_rate)
        if stamps.to_nanoseconds(message.header.stamp) > due:
            self._lost += 1
        tips = self._targets.take_at(due)
        if tips is not None:
            self._following = True
            self._finish_tick(machine, machine.tick(*tips))
            self._watchdog.feed()  # a tick with a coarse solution is long; targets that wait meanwhile are not lost

    def _on_period(self, period: int) -> None:
        """One tick of the wall clock (real-time thread), and those that a coarse solution made it miss."""
        with self._lock:
            machine = self._needed()
            missed, self._period = period - self._period - 1, period
            if machine.faulted:
                sample = self._next_release_tick(machine)
            else:
                tips = self._targets.take_newest()
                self._following |= tips is not None
                self._dry = 0 if tips is not None else self._dry + 1
                # two free-running clocks leave single ticks without a pair; more of them in motion is a gap
                self._lost += int(self._following and self._dry > LARGEST_DRY and machine.moving)
                if missed > 0:
                    self._watchdog.feed()  # the subscriptions may not have been served either
                if tips is None:
                    sample = machine.hold()
                else:
                    most = round(LONGEST_CATCH_UP * machine.control_rate)
                    apart = round(self._targets.elapsed * machine.control_rate / stamps.NANO)  # messages may be late
                    sample = machine.catch_up(*tips, 1 + min(missed, most), waited=min(max(apart - 1, 0), most))
                self._check_stream(machine)
            self._stamp = self._stamp_of(period, machine)
            self._finish_tick(machine, sample)

    def _stamp_of(self, period: int, machine: SimulatedMachine) -> int:
        return self._begin + stamps.tick_nanoseconds(period, machine.control_rate)

    def _finish_tick(self, machine: SimulatedMachine, sample: MachineSample) -> None:
        if machine.faulted and self._release is None:
            self._protect(machine)
            sample = machine.sample()
        self._publish(sample, decimated=self._tick() % self._decimation(machine) == 0)

    def _decimation(self, machine: SimulatedMachine) -> int:
        return self._parameters.pose_decimation or max(1, round(machine.control_rate / 50.0))

    def _publish(self, sample: MachineSample, *, decimated: bool) -> None:
        outlet, machine = self._outlet, self._needed()
        if outlet is None:
            return
        if self._parameters.lockstep:
            self._stamp = stamps.tick_nanoseconds(self._tick(), machine.control_rate)
        with self._publishing:
            if decimated:  # before the wrenches: who answers them knows where the tools are
                outlet.poses(sample, self._stamp)
                outlet.state(self._state_message(machine), self._stamp)
            outlet.wrenches(sample, self._stamp)
            self._sample, self._published = sample, time.monotonic()

    def _on_timer(self) -> None:
        if self._machine is None or not self.is_active:
            return
        if self._parameters.lockstep:
            self._wait_in_lockstep(self._machine)
        else:
            self._bridge_a_long_tick(self._machine)

    def _wait_in_lockstep(self, machine: SimulatedMachine) -> None:
        """Sign of life, and watch over the stream of targets."""
        if not machine.faulted:
            self._check_stream(machine)
            if machine.faulted:
                self._finish_tick(machine, machine.sample())
        if time.monotonic() - self._published >= HEARTBEAT_PERIOD:
            self._publish(machine.sample(), decimated=True)

    def _bridge_a_long_tick(self, machine: SimulatedMachine) -> None:
        """Repeat the last readings while the thread works on a coarse solution: a real load cell never pauses."""
        sample, outlet = self._sample, self._outlet
        if outlet is None or sample is None or self._thread is None:
            return
        with self._publishing:
            if time.monotonic() - self._published >= BRIDGE_PERIOD:
                now = self.get_clock().now().nanoseconds - self._begin
                period = int(now * machine.control_rate / stamps.NANO)
                outlet.wrenches(sample, self._stamp_of(period, machine))
                self._published = time.monotonic()

    # -- faults ----------------------------------------------------------------------------------

    def _check_stream(self, machine: SimulatedMachine) -> None:
        if not self._following or not self._watchdog.expired():
            return
        if machine.loaded or machine.moving:
            machine.latch(
                ErrorCode.TARGET_LOST,
                f"no targets for {self._watchdog.timeout:g} s while the tools are loaded or moving",
            )
        else:
            self._following = False

    def _protect(self, machine: SimulatedMachine) -> None:
        """Protective stop: tell the fault, then move the tools clear (in real time tick by tick)."""
        code, text = machine.faults[-1]
        self.report(IsfError(code, text, where="machine", advice="positions are held and contact is released"))
        self._following = False
        self._release = machine.release_steps()
        if self._outlet is not None:
            self._outlet.state(self._state_message(machine), self._stamp)
        if self._parameters.lockstep:
            for _ in self._release:
                pass

    def _next_release_tick(self, machine: SimulatedMachine) -> MachineSample:
        if self._release is None:
            self._protect(machine)
        assert self._release is not None
        sample = next(self._release, None)
        return sample if sample is not None else machine.hold()

    def _state_message(self, machine: SimulatedMachine) -> MachineState:
        mode = MachineState.FOLLOWING if self._following else MachineState.IDLE
        return MachineState(
            mode=MachineState.PROTECTIVE_STOP if machine.faulted else mode,
            fault_codes=[int(code) for code, _ in machine.faults],
            fault_messages=[text for _, text in machine.faults],
            limits=machine.limits,
            tick=self._tick(),
            targets_received=self._targets.received,
            targets_lost=self._lost,
            late_ticks=self._late_ticks(),
            lockstep=self._parameters.lockstep,
            tared=machine.tared,
            solve_time=machine.solve_time,
        )

    def _needed(self) -> SimulatedMachine:
        if self._machine is None:
            raise IsfError(ErrorCode.NO_BLANK, "no blank is clamped", advice="call machine/reset with new_blank")
        return self._machine

    # -- services --------------------------------------------------------------------------------

    def _on_tare(self, _: Tare.Request, response: Tare.Response) -> Tare.Response:
        with self._answering(response):
            machine = self._needed()
            zero_1, zero_2 = machine.tare()
            response.tool_1_zero, response.tool_2_zero = zero_1.tolist(), zero_2.tolist()
            if self.is_active and self._parameters.lockstep:
                self._publish(machine.sample(), decimated=True)
        return response

    def _on_scan(self, _: Scan.Request, response: Scan.Response) -> Scan.Response:
        with self._answering(response):
            shape = self._needed().measured_shape()
            if self._outlet is not None:
                self._outlet.scan(shape, self._stamp)
            response.points = shape.z.size
            if self._watchdog.fed:
                self._watchdog.feed()  # targets were not served during the scan
        return response

    def _on_stop(self, request: Stop.Request, response: Stop.Response) -> Stop.Response:
        with self._answering(response):
            machine = self._machine
            if machine is not None:
                machine.latch(ErrorCode.STOP_REQUESTED, request.reason or "stop was requested")
                if self.is_active and self._parameters.lockstep and self._release is None:
                    self._finish_tick(machine, machine.sample())
        return response

    def _on_reset(self, request: Reset.Request, response: Reset.Response) -> Reset.Response:
        if request.new_blank:
            self._stop_thread()  # before the machine is owned: the thread may wait for it
        with self._answering(response):
            if request.new_blank:
                self._clamp(self._job_of(request), request.world, request.seed)
            else:
                self._needed().reset()
                self._release = None
            self._targets.clear()
            self._watchdog.clear()
            self.report_ok()
            if self.is_active and self._parameters.lockstep:
                self._publish(self._needed().sample(), decimated=True)
        if self.is_active and self._machine is not None and not self._parameters.lockstep and self._thread is None:
            self._start()
        return response

    def _job_of(self, request: Reset.Request) -> JobFile:
        if request.job_text:
            return JobFile(request.job_text, Path(request.base_folder), "job")
        return self._needed().job_file

    @contextlib.contextmanager
    def _answering(self, response: Any) -> Iterator[None]:
        """Own the machine while a service works on it; an expected failure becomes code and message."""
        with self._lock:
            try:
                yield
            except IsfError as error:
                response.code, response.message = int(error.code), error.message
                self.get_logger().warning(str(error))


def main(args: list[str] | None = None) -> int:
    """Entry point of the node."""
    warm_up()  # before the node exists: compiling would make it look dead
    return process.run(MachineNode, args, streams=True)


if __name__ == "__main__":
    sys.exit(main())
