"""What node ``force_ctrl`` has heard of the machine, and whether that is enough to move the tools."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import fields, replace

from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import Job, JobFile
from isf_core.geometry.tool_axis import UPRIGHT
from isf_msgs import msg as isf
from isf_ros import conversion
from isf_ros.watchdog import ReceiveWatchdog

from isf_force_ctrl.control_config import ControlConfig
from isf_force_ctrl.control_state import Vector
from isf_force_ctrl.ros.parameters import OF_THE_JOB, ForceCtrlParameters
from isf_force_ctrl.supervision.wrench_receiver import Fault, WrenchFrames

FRESH = 1.0
"""s, age up to which wrenches, poses and the machine's state count as present when arming."""

USUAL = 3.0
"""Usual distances of two wrenches within which one is not missing yet, whatever the rate of the load cells."""

SLOWEST = 4.0
"""Periods of the control rate that wrenches may usually be apart, by the clock (assumed): the force loop is stable for
what comes at its own rate."""


class Readiness:
    """Ages of wrenches and poses, state of the machine, and whose wrench is ``needed`` (1, 2).

    ``axis``: (3,) of tool 1 by its last pose.
    """

    def __init__(
        self, timeout: float, pose_timeout: float, frames: WrenchFrames, clock: Callable[[], float] = time.monotonic
    ) -> None:
        """``timeout``, ``pose_timeout`` s of ``clock`` without a wrench, a pose after which they count as lost."""
        self.timeout, self.pose_timeout, self._frames, self._clock = timeout, pose_timeout, frames, clock
        self.needed: list[int] = [1, 2]
        self._machine: tuple[float, isf.MachineState] | None = None
        self._stopped: float | None = None  # s of the clock since when the machine is in a protective stop
        self._watchdogs = (ReceiveWatchdog(timeout, clock), ReceiveWatchdog(timeout, clock))
        self._poses: list[tuple[float, Vector] | None] = [None, None]
        self._usual: dict[int, float] = {}  # s between wrenches of a tool, when the plan was armed
        self.axis: Vector = UPRIGHT

    def wrench(self, tool: int) -> None:
        """A wrench of ``tool`` has come."""
        self._watchdogs[tool - 1].feed()

    def machine(self, state: isf.MachineState) -> None:
        """The machine has told its ``state``."""
        now = self._clock()
        self._machine = (now, state)
        if state.mode != isf.MachineState.PROTECTIVE_STOP:
            self._stopped = None
        elif self._stopped is None:
            self._stopped = now

    def machine_fault(self, seconds: float) -> Fault | None:
        """Code and text of the fault for which the machine has been in a protective stop for ``seconds``."""
        if self._machine is None or self._stopped is None or self._clock() - self._stopped < seconds:
            return None
        state = self._machine[1]
        if not state.fault_codes:
            return ErrorCode.MACHINE_FAULTED, "the machine is in a protective stop, and tells no fault"
        fault = conversion.machine_fault(state)
        return fault.code, f"the machine is in a protective stop: {fault.what}"

    def pose(self, tool: int, tip: Vector) -> None:
        """A pose of ``tool`` has come."""
        self._poses[tool - 1] = (self._clock(), tip)

    def lost(self) -> list[int]:
        """Needed tools whose wrench has stopped coming."""
        return self.silent(self.timeout)

    def silent(self, seconds: float) -> list[int]:
        """Needed tools without a wrench for ``seconds``."""
        return [k for k in self.needed if self._watchdogs[k - 1].age() > seconds]

    def missing(self, seconds: float) -> list[int]:
        """Needed tools without a wrench for ``seconds``, or for longer where theirs usually come slower than that."""
        dogs, usual = self._watchdogs, self._usual
        return [k for k in self.needed if dogs[k - 1].age() > max(seconds, USUAL * usual.get(k, dogs[k - 1].distance))]

    def keep_rates(self, rate: float) -> None:
        """What is usual now is so from here on: silences while the tools are on the sheet do not become usual.

        Raises IsfError WRENCH_LOST where a needed wrench comes at less than a quarter of the control ``rate`` Hz: the
        tools would be moved by forces of long ago.
        """
        self._usual = {tool: self._watchdogs[tool - 1].distance for tool in self.needed}
        for tool, distance in self._usual.items():
            if distance * rate > SLOWEST:
                raise IsfError(
                    ErrorCode.WRENCH_LOST,
                    f"tool_{tool}/wrench comes {1.0 / distance:.3g} times a second; the job controls at {rate:g} Hz",
                    advice=f"raise the driver's rate, or lower control.rate to at most {SLOWEST / distance:.3g} Hz",
                )

    def tare_lost(self) -> bool:
        """True where the machine tells that its load cells are no longer tared."""
        return self._machine is not None and not self._machine[1].tared

    def lost_fault(self, tools: Sequence[int], seconds: float) -> Fault:
        """Code and text of the ``tools`` that are silent for ``seconds``: nothing comes, or nothing of use."""
        for tool in tools:
            if (fault := self._frames.fault(tool)) and fault[0] is ErrorCode.POSE_LOST:
                return fault
        names = " and ".join(f"tool_{k}/wrench" for k in tools)
        return ErrorCode.WRENCH_LOST, f"nothing on {names} for {seconds:g} s (is the machine node alive?)"

    def pose_lost_text(self) -> str:
        """What to say of needed tools whose pose has stopped coming; empty: none. Twists need the poses."""
        now, poses = self._clock(), self._poses
        lost = [k for k in self.needed if (pose := poses[k - 1]) is None or now - pose[0] > self.pose_timeout]
        names = " and ".join(f"tool_{k}/pose" for k in lost)
        return f"nothing on {names} for {self.pose_timeout:g} s: twists would drift away from the path" if lost else ""

    def check(self, *, tared: bool = False) -> None:
        """Raise IsfError WRENCH_LOST, POSE_LOST, WRENCH_FRAME or NO_TARE when the tools must not move; ``tared``: the
        wrenches come tared, and nobody has to say so.

        What a driver told that is gone or was started anew does not count: its tare ended with it, and its tools may
        stand anywhere.
        """
        if stale := self.silent(FRESH):
            raise IsfError(*self.lost_fault(stale, FRESH))
        now = self._clock()
        stale = [k for k in self.needed if (pose := self._poses[k - 1]) is None or now - pose[0] > FRESH]
        if stale:
            names = " and ".join(f"tool_{k}/pose" for k in stale)
            raise IsfError(
                ErrorCode.POSE_LOST,
                f"nothing on {names} in the last {FRESH:g} s: where the tools stand is not known",
                advice="the driver has to publish its poses, 5 a second or more",
            )
        self._frames.check(self.needed)
        if tared:
            return
        if self._machine is None or now - self._machine[0] > FRESH:
            raise IsfError(
                ErrorCode.NO_TARE,
                f"nothing on machine/state in the last {FRESH:g} s: whether the load cells are tared is not known",
                advice="the driver has to publish its state, 5 times a second or more, and machine/tare be called; or "
                "set wrenches_tared where the wrenches come tared",
            )
        if self.tare_lost():
            raise IsfError(ErrorCode.NO_TARE, "the load cells were not tared", advice="call machine/tare")

    def check_forming(self, forming_tool: int) -> None:
        """The forming tool may change from contour to contour; its load cell is needed from here on.

        Raises IsfError WRENCH_LOST, WRENCH_FRAME or POSE_LOST.
        """
        if forming_tool in self.needed or forming_tool not in (1, 2):
            return
        self._frames.check([forming_tool])
        if self._watchdogs[forming_tool - 1].age() > FRESH:
            raise IsfError(ErrorCode.WRENCH_LOST, f"nothing on tool_{forming_tool}/wrench, which forms this contour")
        self.needed = [1, 2]

    def tip(self, tool: int) -> Vector | None:
        """Where a tool is by its fresh pose; None: not known. To be asked together with :meth:`check`: what is fresh
        there is so here."""
        pose = self._poses[tool - 1]
        return pose[1] if pose is not None and self._clock() - pose[0] <= FRESH else None


def tools_with_load_cell(job: Job) -> list[int]:
    """Tools whose wrench is needed."""
    return [1, 2] if job.process in ("DSIF", "ADSIF") else [1]


def control_config(job_file: JobFile, parameters: ForceCtrlParameters) -> ControlConfig:
    """Configuration of the job with the node's parameters; raises IsfError for values that cannot be."""
    names = {item.name for item in fields(ControlConfig)}
    tuned = {item.name: getattr(parameters, item.name) for item in fields(ForceCtrlParameters) if item.name in names}
    tuned["set_point"] = None if parameters.set_point == OF_THE_JOB else parameters.set_point
    config = replace(ControlConfig.from_job(job_file), **tuned, runs_on=parameters.lockstep)
    config.check()
    return config
