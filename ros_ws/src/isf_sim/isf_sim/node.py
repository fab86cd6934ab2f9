"""Node ``machine``: the simulated machine behind the topics and services of a cell.

Services: tare, scan, stop, reset, save and load.
"""

from __future__ import annotations

import contextlib
import math
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile, load_job
from isf_core.files.own_folder import path_below
from isf_core.geometry.height_map import HeightMap
from isf_core.geometry.tool_axis import UPRIGHT
from isf_core.simulated_sheet import DEFAULT_SHEET, LARGEST_NUMBER, SHEET_KINDS, check_clock, sheet_kind
from isf_core.thinned_sheet import ThinnedSheet
from isf_msgs.msg import MachineState
from isf_msgs.srv import Reset, Scan, StateFile, Stop, Tare
from isf_ros import conversion, process, qos, stamps
from isf_ros.executive_watch import ExecutiveWatch
from isf_ros.lifecycle import CellNode
from isf_ros.parameters import parameter
from isf_ros.thread_priority import MAXIMUM_PRIORITY, Privileges, RealTimeSettings, acquire, release
from isf_ros.watchdog import RegularLook
from numpy.typing import NDArray

from isf_sim.machine.simulated_machine import MachineSample, SimulatedMachine
from isf_sim.machine.state import load_machine, plant_digest, save_machine
from isf_sim.real_time import PeriodicThread
from isf_sim.ros.joint_interface import CAUGHT_UP, Command, JointInterface, near
from isf_sim.ros.publishers import MachinePublishers, state_message
from isf_sim.ros.targets import TargetPair, TargetStream
from isf_sim.warm_up import warm_up


@dataclass(frozen=True)
class MachineParameters:
    """Parameters of the node ``machine``."""

    lockstep: bool = parameter(True, "one tick per pair of targets; false: ticks by the wall clock")
    job: str = parameter("", "job file whose blank is clamped at the start; empty: by machine/reset")
    variant: int = parameter(
        0, "plant for that blank: 0 nominal, others seeded variants, 101-120 sealed", minimum=0, maximum=LARGEST_NUMBER
    )
    world: int = parameter(0, "the same by its former name, where variant is 0", minimum=0, maximum=LARGEST_NUMBER)
    seed: int = parameter(0, "seed of noise and of the off-nominal plant", minimum=0, maximum=LARGEST_NUMBER)
    sheet: str = parameter(
        DEFAULT_SHEET,
        "sheet of that blank: fast (seconds), shell_coarse, shell or shell_fine (minutes)",
        choices=SHEET_KINDS,
    )
    target_timeout: float = parameter(
        0.0,
        "time without targets before a protective stop, which releases contact; 0: 20 s in lockstep, 2 s else",
        unit="s",
        minimum=0.0,
        maximum=3600.0,
    )
    real_time_priority: int = parameter(
        0, "SCHED_FIFO priority requested while ticking by the clock; 0: none", minimum=0, maximum=MAXIMUM_PRIORITY
    )
    raw_cells: bool = parameter(
        False,
        "of tools whose rig has spindle_cells: voltages on tool_k/raw_cells, and no wrench; a node load_cell makes it",
    )
    follow: str = parameter(
        "poses",
        "poses: tool_k/target; joints: JointState on machine/joint_commands, as of a hardware component of "
        "ros2_control, answered on machine/joint_states (not in lockstep)",
        choices=("poses", "joints"),
    )
    state_folder: str = parameter(
        "machine_states",
        "folder below which machine/save writes and machine/load reads; relative to the working directory",
    )
    pose_decimation: int = parameter(
        0, "ticks per pose, clock and state message; 0: 50 messages per second", minimum=0, maximum=100_000
    )


HEARTBEAT_PERIOD = 0.2
"""s of wall time after which a waiting machine repeats its wrenches."""
BRIDGE_PERIOD = 0.02
"""s of wall time after which a tick in real time that takes long reads the last loads again."""
LONGEST_CATCH_UP = 0.5
"""s, missed ticks beyond this are dropped."""
EXECUTIVE_SILENCE = 10.0
"""s of wall time without a sign of life of the executive after which tools that rest on the sheet are released.

Twice the patience of force_ctrl, which lifts them along their path; this is for a force_ctrl that does not."""
LONGEST_WAY = 1.0
"""s of simulated time for axes to come to rest at their last targets."""
REST = 1.0
"""s of wall time without a tick after which a machine in lockstep is at rest."""
LONGEST_RELEASE = 2.0
"""s of wall time after which a node that ends does not wait for its tools to be free any more."""
LOCKSTEP_TIMEOUT, REAL_TIME_TIMEOUT = 20.0, 2.0
"""s of wall time without targets after which a loaded or moving machine makes a protective stop. It stands from the
first tick without targets on: so long a controller on a busy computer may be silent and still go on."""


class MachineNode(CellNode[MachineParameters]):
    """ROS side of :class:`isf_sim.machine.simulated_machine.SimulatedMachine`."""

    def __init__(self) -> None:
        super().__init__("machine", MachineParameters)
        self._machine: SimulatedMachine | None = None
        self._output: MachinePublishers | None = None
        self._thread: PeriodicThread | None = None
        self._targets = TargetPair()
        self.lock = threading.RLock()
        self._first_tick = 0
        self._stamp = self._bridged = 0
        self._late = 0
        self._stream = TargetStream(REAL_TIME_TIMEOUT)
        self._privileges = Privileges()
        self._release: Iterator[MachineSample] | None = None
        self._last_publish = self._ticked = 0.0
        self._period = 0
        self._sample: MachineSample | None = None
        self._publishing = threading.Lock()
        self._joints: JointInterface | None = None
        self._holder: Any = None
        self._reported = 0

    # -- lifecycle ---------------------------------------------------------------------------------

    def configure(self) -> None:
        self._settings = values = self.values()
        timeout = values.target_timeout or (LOCKSTEP_TIMEOUT if values.lockstep else REAL_TIME_TIMEOUT)
        self._stream, self._look = TargetStream(timeout), RegularLook(0.5 * min(timeout, EXECUTIVE_SILENCE))
        if values.follow == "joints":
            if values.lockstep:
                raise IsfError(
                    ErrorCode.FILE_FIELD,
                    "joints are commanded by the clock, not in lockstep",
                    where="parameter follow",
                    advice="lockstep:=false, for force_ctrl and executive too",
                )
            self._joints = JointInterface(self, self._on_joints)
        if self._machine is not None and not values.job:  # its blank outlasts a cleanup
            self._listen_for(self._machine)
        if values.job:
            self.clamp(
                SimulatedMachine(
                    load_job(values.job),
                    variant=values.variant or values.world,
                    seed=values.seed,
                    sheet=sheet_kind(values.sheet),
                )
            )
        self._output = MachinePublishers(self, lockstep=values.lockstep, raw_cells=values.raw_cells)
        if self._joints is None:
            self.create_subscription(PoseStamped, "tool_1/target", lambda m: self._on_target(1, m), qos.STREAM)
            self.create_subscription(PoseStamped, "tool_2/target", lambda m: self._on_target(2, m), qos.STREAM)
        self._executive = ExecutiveWatch(self, EXECUTIVE_SILENCE)
        self.create_subscription(DiagnosticArray, "/diagnostics", self._executive.on_diagnostics, 50)
        MachineServices(self).create()
        look = 0.25 * HEARTBEAT_PERIOD if values.lockstep else 0.5 * BRIDGE_PERIOD
        self.create_timer(look, self._on_timer, clock=self.steady_clock)

    def activate(self) -> None:
        self._targets.clear()
        self._stream.forget()
        self._stream.following = False
        if self._machine is not None:
            self.start()

    def deactivate(self) -> None:
        self._let_go()
        self._executive.release()
        self.stop_thread()

    def cleanup(self) -> None:
        self._output = self._joints = None
        self._listen_to_holder(False)

    def make_safe(self, error: IsfError) -> None:
        """Protective stop: positions are held, contact is released."""
        machine = self._machine
        if machine is None or not self.is_active:
            return
        with self.lock:
            machine.latch(error.code, error.message)
            if self.in_lockstep and self._release is None:
                self.finish_tick(machine, machine.sample())

    def close(self) -> None:
        try:
            self._let_go()
        except Exception as error:  # the node ends all the same, in order
            self.fault(error, "release of the tools at the end")
        self.stop_thread()

    def _let_go(self) -> None:
        """A protective stop of loaded or moving tools, to its end, before nobody moves them any more."""
        machine = self._machine
        if machine is None or not self.is_active:
            return
        if self.in_lockstep and not machine.faulted:
            # time stood still since the last targets: axes that were on their way to them, in the air, get there
            for _ in range(round(LONGEST_WAY * machine.control_rate)):
                if machine.loaded or not machine.moving:
                    break
                machine.hold()
        if not (machine.loaded or machine.moving):
            return
        if not machine.faulted:
            self.stop_machine("the node is told to end, or to be inactive, with tools that are loaded or moving")
        elif self.in_lockstep and self._release is not None:
            self._release_contact(machine)  # where a fault of this software broke it off
        deadline, pause = time.monotonic() + LONGEST_RELEASE, threading.Event()
        while self._thread is not None and (machine.loaded or machine.moving) and time.monotonic() < deadline:
            pause.wait(0.01)

    def health_values(self) -> dict[str, object]:
        machine = self._machine
        if machine is None:
            return {"blank": "none"}
        return {
            "blank": machine.job_file.job.name,
            "tick": self._tick(),
            "faults": ", ".join(code.name for code, _ in machine.faults) or "none",
            "late_ticks": self._late_ticks(),
            **machine.plant.worker.values(),
            **machine.sheet_proof(),
            **(machine.legs.values() if machine.legs is not None else {}),
            **({} if self._settings.lockstep else self._privileges.values()),
        }

    # -- blank and time ------------------------------------------------------------------------------

    def clamp(self, machine: SimulatedMachine) -> None:
        """Take ``machine`` in place of the one before: a fresh blank or a saved one.

        Time goes on where it was, in a node that had no blank where that of the saved machine was.

        Raises
        ------
        IsfError : FILE_FIELD, its sheet cannot follow the wall clock
        """
        if not self._settings.lockstep:
            check_clock(machine.sheet_kind, machine.job_file.job)
        before = self._machine
        tick = machine.tick_count if before is None else self._tick()
        if before is not None and before.control_rate != machine.control_rate:
            tick = math.ceil(tick / before.control_rate * machine.control_rate)
        self._first_tick = tick - machine.tick_count
        self._machine = machine
        self._release = None
        self._stream.following = False
        self._reported = len(machine.events)
        self._targets.clear()
        self._listen_for(machine)
        name = machine.job_file.job.name
        self.get_logger().info(
            f"{machine.job_file.material.name} for '{name}', sheet {machine.sheet_kind}, "
            f"plant {machine.variant.as_dict()}"
        )

    def _listen_for(self, machine: SimulatedMachine) -> None:
        self._listen_to_holder(machine.job_file.job.process == "TPIF")
        if self._joints is not None:
            self._joints.clamp(machine.job_file)

    def _listen_to_holder(self, wanted: bool) -> None:
        """A blank holder belongs to TPIF alone: then every tick takes three targets instead of two."""
        self._targets.expect_holder(wanted)
        if wanted and self._holder is None:
            self._holder = self.create_subscription(PoseStamped, "holder/target", self._on_holder, qos.STREAM)
        elif not wanted and self._holder is not None:
            self.destroy_subscription(self._holder)
            self._holder = None

    def _tick(self) -> int:
        """Control ticks since the node was configured first, at the present rate."""
        return self._first_tick + (self._machine.tick_count if self._machine else 0)

    def start(self) -> None:
        machine = self.needed()
        if self._settings.lockstep:
            self.publish(machine.sample(), decimated=True)
        else:
            self._privileges = acquire(RealTimeSettings(self._settings.real_time_priority))
            if refused := self._privileges.reason:
                self.get_logger().warning(
                    f"ticks by the clock without the real-time settings that the system refused: {refused}", once=True
                )
            worker = machine.plant.worker
            worker.ahead, worker.priority = True, self._privileges.below
            self._thread = PeriodicThread(machine.control_rate, self.guard(self._on_period, "tick"))
            self._begin, self._started, self._period = self.get_clock().now().nanoseconds, time.monotonic(), -1
            self._thread.start()

    def stop_thread(self) -> None:
        if self._thread is not None:
            self._thread.stop()
            self._late += self._thread.late
            self._thread = None
            self.needed().plant.worker.priority = 0
            release(self._privileges)

    def _late_ticks(self) -> int:
        return self._late + (self._thread.late if self._thread is not None else 0)

    # -- ticks -------------------------------------------------------------------------------------

    def _on_target(self, tool: int, message: PoseStamped) -> None:
        if not self.is_active:
            return
        self._stream.heard()
        stamp, tip = stamps.to_nanoseconds(message.header.stamp), conversion.tip_of(message)
        self._targets.add(tool, stamp, tip, conversion.axis_of(message) if tool == 1 else UPRIGHT)
        self._tick_in_lockstep(stamp)

    def _on_joints(self, command: Command) -> None:
        sample = self._sample
        if not self.is_active or sample is None:
            return
        if not self._stream.following and not near(command, sample):
            machine = self.needed()
            if self._joints is not None and self._joints.strays(command) and not machine.faulted:
                with self.lock:
                    text = (
                        "joint commands move that did not begin where the tools are (a controller that started late?)"
                    )
                    machine.latch(ErrorCode.TARGET_JUMP, text)
            return
        self._stream.heard()
        for tool, tip, axis in ((1, command.tips[0], command.axis), (2, command.tips[1], UPRIGHT)):
            self._targets.add(tool, command.stamp, tip, axis)

    def _on_holder(self, message: PoseStamped) -> None:
        if not self.is_active:
            return
        stamp = stamps.to_nanoseconds(message.header.stamp)
        self._targets.add_holder(stamp, message.pose.position.z)
        self._tick_in_lockstep(stamp)

    def _tick_in_lockstep(self, stamp: int) -> None:
        """One tick when all targets of the stamp that is due have come."""
        machine = self._machine
        if machine is None or not self._settings.lockstep or machine.faulted:
            return
        due = stamps.tick_nanoseconds(self._tick() + 1, machine.control_rate)
        if stamp > due:
            self._stream.lost += 1
        if (tips := self._targets.take_at(due)) is not None:
            self._stream.following = True
            self.finish_tick(machine, machine.tick(*tips, self._targets.holder, axis=self._targets.axis))
            self._ticked = time.monotonic()
            self._stream.heard()  # a tick with a coarse solution is long; targets that wait meanwhile are not lost

    def _on_period(self, period: int) -> None:
        """One tick of the wall clock (real-time thread), and those that a coarse solution made it miss."""
        with self.lock:
            machine = self.needed()
            missed, self._period = period - self._period - 1, period
            if machine.faulted:
                sample = self._next_release_tick(machine)
            else:
                if missed > self._stream.timeout * machine.control_rate:  # stood still itself: they are of another time
                    self._targets.clear()
                tips = self._targets.take_newest()
                self._stream.period(tips is not None, missed / machine.control_rate, machine.moving)
                if tips is None:
                    sample = machine.hold()
                else:
                    most = round(LONGEST_CATCH_UP * machine.control_rate)
                    spare = 0 if self._joints is None else round(CAUGHT_UP * machine.control_rate)
                    apart = round(self._targets.elapsed * machine.control_rate / stamps.NANO)  # messages may be late
                    sample = machine.catch_up(
                        *tips,
                        1 + min(missed, most),
                        self._targets.holder,
                        waited=min(max(apart - 1, 0) + spare, most),
                        axis=self._targets.axis,
                    )
                self._check_stream(machine)
            self._stamp = self._stamp_of(period, machine)
            self.finish_tick(machine, sample)
            machine.between_ticks()

    def _stamp_of(self, period: int, machine: SimulatedMachine) -> int:
        return self._begin + stamps.tick_nanoseconds(period, machine.control_rate)

    def finish_tick(self, machine: SimulatedMachine, sample: MachineSample) -> None:
        if machine.faulted and self._release is None:
            self._protect(machine)
            sample = machine.sample()
        if failure := machine.plant.worker.new_failure():
            self.warn(failure)
        self.publish(sample, decimated=self._tick() % self._decimation(machine) == 0)

    def _decimation(self, machine: SimulatedMachine) -> int:
        return self._settings.pose_decimation or max(1, round(machine.control_rate / 50.0))

    def publish(self, sample: MachineSample, *, decimated: bool) -> None:
        publishers, machine = self._output, self.needed()
        if publishers is None:
            return
        if self._settings.lockstep:
            self._stamp = stamps.tick_nanoseconds(self._tick(), machine.control_rate)
        with self._publishing:
            if not self._settings.lockstep:  # a tick that took long ends after the readings that bridged it
                self._stamp = max(self._stamp, self._bridged)
            if decimated:  # before the wrenches: who answers them knows where the tools are
                publishers.poses(sample, self._stamp)
                if machine.legs is not None:
                    publishers.legs(machine.legs, self._stamp)
                publishers.state(self._state_message(machine), self._stamp)
            if self._joints is not None:
                self._joints.publish(sample, self._stamp)
            publishers.wrenches(sample, self._stamp)
            for event in machine.events[self._reported :]:
                publishers.event(event, self._stamp)
                self.get_logger().warning(f"{event.name}: {event.text}")
            self._reported = len(machine.events)
            self._sample, self._last_publish = sample, time.monotonic()

    def _on_timer(self) -> None:
        if self._machine is None or not self.is_active:
            return
        if self._settings.lockstep:
            self._wait_in_lockstep(self._machine)
        else:
            self._bridge_a_long_tick(self._machine)

    def _wait_in_lockstep(self, machine: SimulatedMachine) -> None:
        """Sign of life, and watch over the stream of targets."""
        if self._look.late():
            self.targets_not_served()
        if not machine.faulted:
            self._check_stream(machine)
            if machine.faulted:
                self.finish_tick(machine, machine.sample())
        elif self._release is not None:
            self._release_contact(machine)  # where a fault of this software broke it off
        if time.monotonic() - self._last_publish >= HEARTBEAT_PERIOD:
            self.publish(machine.sample(), decimated=True)

    def _bridge_a_long_tick(self, machine: SimulatedMachine) -> None:
        """Read the last loads again while the thread works on a coarse solution: a real load cell never pauses."""
        sample, publishers = self._sample, self._output
        if publishers is None or sample is None or self._thread is None:
            return
        with self._publishing:
            if time.monotonic() - self._last_publish >= BRIDGE_PERIOD:
                period = int((time.monotonic() - self._started) * machine.control_rate)
                self._bridged = self._stamp_of(period, machine)
                publishers.wrenches(machine.read_again(sample), self._bridged)
                self._last_publish = time.monotonic()

    # -- faults ----------------------------------------------------------------------------------

    def _check_stream(self, machine: SimulatedMachine) -> None:
        if (gone := self._executive.gone()) and machine.loaded and self._resting(machine):
            machine.latch(ErrorCode.UNATTENDED, f"{gone}, and the tools rest on the sheet")
            self._executive.release()
            return
        if not self._stream.ended():
            return
        if machine.loaded or machine.moving:
            text = f"no targets for {self._stream.timeout:g} s while the tools are loaded or moving"
            machine.latch(ErrorCode.TARGET_LOST, text)
        else:
            self._stream.following = False

    def _resting(self, machine: SimulatedMachine) -> bool:
        """True between contours; in lockstep time stands still then, also for tools that were left in motion."""
        if self._settings.lockstep:
            return time.monotonic() - self._ticked > REST
        return not machine.moving

    def _protect(self, machine: SimulatedMachine) -> None:
        """Protective stop: tell the fault, then move the tools clear (in real time tick by tick)."""
        self._release = machine.release_steps()
        self._stream.following = False
        code, text = machine.faults[-1]
        self.report(IsfError(code, text, where="machine", advice="positions are held and contact is released"))
        if self._output is not None:
            self._output.state(self._state_message(machine), self._stamp)
        if self._settings.lockstep:
            self._release_contact(machine)

    def _release_contact(self, machine: SimulatedMachine) -> None:
        while self._release_tick(machine) is not None:
            pass

    def _release_tick(self, machine: SimulatedMachine) -> MachineSample | None:
        """The next tick of a release, None after its last; a release whose tick raises begins anew with the next."""
        assert self._release is not None
        try:
            return next(self._release, None)
        except Exception:
            self._release = machine.release_steps()
            raise

    def _next_release_tick(self, machine: SimulatedMachine) -> MachineSample:
        if self._release is None:
            self._protect(machine)
        return self._release_tick(machine) or machine.hold()

    def _state_message(self, machine: SimulatedMachine) -> MachineState:
        mode = MachineState.FOLLOWING if self._stream.following else MachineState.IDLE
        return state_message(
            machine,
            mode=MachineState.PROTECTIVE_STOP if machine.faulted else mode,
            tick=self._tick(),
            received=self._targets.received,
            lost=self._stream.lost,
            late=self._late_ticks(),
            lockstep=self._settings.lockstep,
        )

    def needed(self) -> SimulatedMachine:
        if self._machine is None:
            raise IsfError(ErrorCode.NO_BLANK, "no blank is clamped", advice="call machine/reset with new_blank")
        return self._machine

    # -- for the services ------------------------------------------------------------------------

    @property
    def state_folder(self) -> Path:
        """Folder of the saved machines."""
        return Path(self._settings.state_folder).absolute()

    @property
    def in_lockstep(self) -> bool:
        """True when a tick needs targets of its stamp."""
        return self._settings.lockstep

    @property
    def reads_while_tared(self) -> bool:
        """True when readings of spindle cells have to be published for a tare."""
        return self.is_active and self._settings.lockstep and self._settings.raw_cells

    def stop_machine(self, reason: str) -> None:
        """Latch a stop that was asked for, and release contact."""
        machine = self._machine
        if machine is None:
            return
        machine.latch(ErrorCode.STOP_REQUESTED, reason)
        if self.is_active and self.in_lockstep and self._release is None:
            self.finish_tick(machine, machine.sample())

    def forget_targets(self) -> None:
        """After a reset: no release goes on, no old target counts, and an executive that is gone does not either."""
        self._executive.release()
        if not self.needed().faulted:
            self._release = None
        self._targets.clear()
        self._stream.forget()

    def targets_not_served(self) -> None:
        """After a long answer: neither the stream of targets nor the executive was lost meanwhile."""
        self._stream.not_served()
        self._executive.not_served()

    def start_in_real_time(self) -> None:
        """Tick by the wall clock again, if that is what the node does and nothing does it yet."""
        if self.is_active and self._machine is not None and not self.in_lockstep and self._thread is None:
            self.start()

    def wrenches_received(self) -> None:
        """Wait until the subscribers have the last wrenches."""
        if self._output is not None:
            self._output.wrenches_received()

    def tell_state(self) -> None:
        """The state out of turn, after a service has changed it by the clock; returns when its subscribers have it."""
        output, machine = self._output, self._machine
        if output is None or machine is None or not self.is_active or self.in_lockstep:
            return
        with self.lock:
            output.state(self._state_message(machine), self._stamp)
        output.state_received()  # ticks go on meanwhile

    def publish_scan(self, shape: HeightMap, thinned: ThinnedSheet | None) -> None:
        """The exact shape on "scan", thickness and strain margin, where there are any, on "machine/formed_sheet"."""
        if self._output is None:
            return
        stamp = stamps.to_stamp(self._stamp)
        if thinned is not None:  # first: who has the scan has the sheet, and may end the recording
            self._output.formed_sheet(conversion.thinned_sheet_to_cloud(thinned, stamp))
        self._output.scan(conversion.height_map_to_message(shape, stamp))

    def publish_cloud(self, points: NDArray[np.float64], *, clamped: bool) -> None:
        """Points (N, 3) m of the sheet as it is ``clamped`` on "scan", of the part out of it on its own topic."""
        if self._output is None:
            return
        cloud = conversion.points_to_cloud(points, stamps.to_stamp(self._stamp))
        if clamped:
            self._output.scan(cloud)
        else:
            self._output.released_part(cloud)


class MachineServices:
    """Answers for a node; every answer owns the machine while it works on it."""

    def __init__(self, node: MachineNode) -> None:
        self._node = node

    def create(self) -> None:
        """Create the services."""
        create = self._node.create_service
        create(Tare, "machine/tare", self._on_tare)
        create(Scan, "machine/scan", self._on_scan)
        create(Stop, "machine/stop", self._on_stop)
        create(Reset, "machine/reset", self._on_reset)
        create(StateFile, "machine/save", self._on_save)
        create(StateFile, "machine/load", self._on_load)

    def _on_tare(self, _: Tare.Request, response: Tare.Response) -> Tare.Response:
        with self._answering(response):
            machine = self._node.needed()
            zero_1, zero_2 = machine.tare()
            response.tool_1_zero, response.tool_2_zero = zero_1.tolist(), zero_2.tolist()
            if self._node.reads_while_tared:
                self._rest_for_tare(machine)
            self._publish_in_lockstep(machine)
        self._node.tell_state()
        return response

    def _rest_for_tare(self, machine: SimulatedMachine) -> None:
        """A node load_cell takes its zero from readings, and time passes in lockstep only here."""
        for sample in machine.rest_for_tare():
            self._node.publish(sample, decimated=False)
        self._node.targets_not_served()

    def _on_scan(self, request: Scan.Request, response: Scan.Response) -> Scan.Response:
        node = self._node
        with self._answering(response):
            machine = node.needed()
            if request.sensor:
                # a scanner takes its time; where time is the machine's own and nothing moves, that passes
                points = machine.measured_cloud(
                    clamped=request.clamped, duration=node.in_lockstep and not machine.moving
                )
                self._publish_in_lockstep(machine)
                node.publish_cloud(points, clamped=request.clamped)
                response.points = len(points)
            elif not request.clamped:
                points = machine.released_shape().points()
                points = points[np.isfinite(points[:, 2])]
                node.publish_cloud(points, clamped=False)
                response.points = len(points)
            else:
                shape = machine.measured_shape()
                node.publish_scan(shape, machine.thinned_sheet(shape))
                response.points = shape.z.size
            node.targets_not_served()
        return response

    def _on_stop(self, request: Stop.Request, response: Stop.Response) -> Stop.Response:
        with self._answering(response):
            self._node.stop_machine(request.reason or "stop was requested")
        self._node.tell_state()
        return response

    def _on_reset(self, request: Reset.Request, response: Reset.Response) -> Reset.Response:
        node = self._node
        if request.new_blank:
            node.stop_thread()  # before the machine is owned: the thread may wait for it
        try:
            with self._answering(response):
                if request.new_blank:
                    job_file = self._job_of(request)
                    kind = sheet_kind(request.sheet)
                    node.clamp(SimulatedMachine(job_file, variant=request.world, seed=request.seed, sheet=kind))
                else:
                    node.needed().reset()
                self._begin_anew()
        finally:
            node.start_in_real_time()  # with the blank before, where there is no new one
        node.tell_state()
        return response

    def _on_save(self, request: StateFile.Request, response: StateFile.Response) -> StateFile.Response:
        plant_digest()  # once it takes a second, in which ticks by the clock go on
        with self._answering(response):
            machine, path = self._node.needed(), self._path_of(request)
            with contextlib.suppress(OSError):  # the file that cannot be written says why
                path.parent.mkdir(parents=True, exist_ok=True)
            save_machine(machine, path)
            self._node.targets_not_served()
            self._node.get_logger().info(f"state saved to {path}")
        return response

    def _on_load(self, request: StateFile.Request, response: StateFile.Response) -> StateFile.Response:
        node = self._node
        with self._answering(response):
            machine = load_machine(self._path_of(request))
        if response.code == 0:
            node.stop_thread()
            try:
                with self._answering(response):
                    node.clamp(machine)
                    self._begin_anew()
            finally:
                node.start_in_real_time()
            node.tell_state()
        return response

    def _begin_anew(self) -> None:
        self._node.forget_targets()
        self._node.report_ok()
        self._publish_in_lockstep(self._node.needed())

    def _publish_in_lockstep(self, machine: SimulatedMachine) -> None:
        """Whoever has the answer may rely on it that force control has the readings after it."""
        node = self._node
        if node.is_active and node.in_lockstep:
            node.publish(machine.sample(), decimated=True)
            node.wrenches_received()

    def _job_of(self, request: Reset.Request) -> JobFile:
        if request.job_text:
            return JobFile(request.job_text, Path(request.base_folder), "job")
        return self._node.needed().given_file  # another sheet raises its force limits otherwise

    def _path_of(self, request: StateFile.Request) -> Path:
        return path_below(self._node.state_folder, request.path)

    @contextlib.contextmanager
    def _answering(self, response: Any) -> Iterator[None]:
        """Own the machine while a service works on it; an expected failure becomes code and message."""
        with self._node.lock:
            try:
                yield
            except IsfError as error:
                response.code, response.message = int(error.code), error.message
                self._node.get_logger().warning(str(error))


def main(args: list[str] | None = None) -> int:
    """Entry point of the node."""
    warm_up()  # before the node exists: compiling would make it look dead
    return process.run(MachineNode, args, streams=True)


if __name__ == "__main__":
    sys.exit(main())
