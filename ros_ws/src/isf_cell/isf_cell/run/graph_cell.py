"""The cell through the node graph: machine, planner, springback and force_ctrl by their services, actions and topics.

For a worker thread; messages reach it through the ``on_...`` methods, which the node's executor calls.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath
from typing import Any, Protocol

import numpy as np
from isf_core import __version__
from isf_core.contour import ContourCorrection, ContourResult, contour_label
from isf_core.errors import ErrorCode, IsfError, failure, told
from isf_core.events import Event, force_unknown, torn
from isf_core.files.rig import tools_with_spindle_cells
from isf_msgs.action import LiftTool, MoveAside, PlanPart
from isf_msgs.msg import Contour, ForceCtrlState, JobInfo, MachineState
from isf_msgs.srv import Arm, GetContour, Reset, Scan, StateFile, Stop, Tare
from isf_ros import conversion, stamps
from isf_ros.conversion import contour_from_message, lift_to_cloud
from isf_ros.watchdog import RegularLook
from lifecycle_msgs.srv import ChangeState
from sensor_msgs.msg import PointCloud2
from std_srvs.srv import Trigger

from isf_cell.run import preflight
from isf_cell.run.cell import FormedContour, Operator, PartGoal, PlannedPart
from isf_cell.run.checkpoint import CONTOURS, state_file
from isf_cell.run.graph_client import POLL, GraphClient
from isf_cell.run.heartbeat_monitor import HeartbeatMonitor
from isf_cell.run.machine_client import HARMLESS, MACHINE, MachineClient
from isf_cell.run.part_keeper import TickCounts
from isf_cell.run.tool_lift import NO_ROWS, SETTINGS, lift_rows


def managed_nodes(load_cells: tuple[str, ...]) -> tuple[str, ...]:
    """Nodes brought up in this order, down in reverse, with the nodes ``load_cells``."""
    return MACHINE, *load_cells, "planner", "springback", "force_ctrl"


COMMANDS = (
    (Reset, "machine/reset"),
    (Tare, "machine/tare"),
    (Scan, "machine/scan"),
    (Stop, "machine/stop"),
    (Arm, "force_ctrl/arm"),
    (Trigger, "force_ctrl/stop"),
    (StateFile, "springback/save"),
    (StateFile, "springback/load"),
    (StateFile, "force_ctrl/save"),
    (StateFile, "force_ctrl/load"),
)
"""Services that change something."""

_SYMPTOMS = (ErrorCode.TARGET_LOST, ErrorCode.WRENCH_LOST, ErrorCode.MACHINE_FAULTED, ErrorCode.SERVICE_TIMEOUT)
"""Failures that may only be the consequence of a node that died; the death is then the thing to tell."""

_OF_AN_INTRUDER = (
    ErrorCode.TARGET_JUMP,
    ErrorCode.TARGET_OUT_OF_WORKSPACE,
    ErrorCode.TARGET_NOT_FINITE,
    ErrorCode.WRENCH_CLOCK,
    ErrorCode.TOOL_COLLISION,
    ErrorCode.FORCE_LIMIT,
)
"""Failures that may come from somebody who sends targets or wrenches beside the cell."""

NOT_HEARD_YET = (ErrorCode.WRENCH_LOST, ErrorCode.POSE_LOST, ErrorCode.NO_TARE)
"""What force_ctrl refuses to arm with until it has heard the machine."""

_END_THE_PART = (ErrorCode.NODE_DIED, ErrorCode.CANCELLED)
"""Failures of a lift or a scan that the part does not go on after."""


PUBLISHERS_PERIOD = 1.0
"""s between two looks at who sends targets and wrenches."""

RECORDED_FIRST = frozenset(("tool_1/wrench", "part/info"))
"""Topics of the machine and of the executive that a recorder has to hear before the first contour."""

LONGEST_RELEASE = 2.0
"""s of machine time in which a protective stop of the simulated machine has released its tools."""

READINGS_LOST = 5.0
"""s of wall time in which node ``load_cell`` has worked through the readings of a tare; after it they count as lost."""

SIGN_OF_LIFE = 2.0
"""s within which every node tells that it lives, twice at least."""

LONGEST_LIFT = 60.0
"""s of wall time in which force control has lifted and parked the tools."""

REAL_MACHINE = -1
"""Variant of what is not simulated."""


class Publishers(Protocol):
    """What is published on the way."""

    def publish_nominal(self, contour: Contour) -> None: ...

    def publish_info(self, info: JobInfo) -> None: ...

    def publish_lift(self, cloud: PointCloud2) -> None: ...


@dataclass(frozen=True)
class GraphSettings:
    """Times of a run, s of wall time; see the executive's parameters."""

    lockstep: bool
    service_timeout: float
    plan_timeout: float
    contour_timeout: float
    silence_timeout: float
    load_cells: tuple[str, ...] = ()
    """Nodes that make wrenches of raw readings."""
    kept_in: tuple[Path, ...] = ()
    """Folders on this computer into which the run is written."""
    states_in: str = ""
    """Folder of the part's checkpoint, below the state_folder of the nodes; empty: that folder itself."""


class GraphCell:
    """A cell of :mod:`isf_cell.run.cell` for one part."""

    def __init__(
        self,
        client: GraphClient,
        monitor: HeartbeatMonitor,
        publishers: Publishers,
        operator: Operator,
        settings: GraphSettings,
    ) -> None:
        self._client = client
        self._monitor = monitor
        self._to_graph = publishers
        self._operator = operator
        self._settings = settings
        self._look = RegularLook(0.5 * settings.silence_timeout)
        self._news = threading.Condition()
        self._results: dict[int, ContourResult] = {}
        self._corrections: dict[int, ContourCorrection] = {}
        self._machine = MachineClient(client, lockstep=settings.lockstep, report=operator.phase)
        self._all = self._managed = managed_nodes(settings.load_cells)
        self._state: MachineState | None = None
        self._recorder_waits_for: frozenset[str] = frozenset()
        self._events: list[Event] = []
        self._at_start = TickCounts()
        self._plan_id = ""
        self._began: float | None = None
        self._formed_before = 0.0
        self._sensor = False
        self._record = ""
        self._force_ctrl: int | None = None
        self._formed_plan = ""
        self._next_look = 0.0

    # -- news from the graph (executor thread) -------------------------------------------------

    def on_result(self, result: ContourResult) -> None:
        """A contour ended."""
        if result.plan_id == self._plan_id:
            with self._news:
                self._results[result.index] = result
                self._news.notify_all()

    def on_correction(self, correction: ContourCorrection) -> None:
        """A contour was corrected."""
        if correction.plan_id == self._plan_id:
            self._corrections[correction.index] = correction

    def on_event(self, event: Event) -> None:
        """The machine told what happened to the sheet or to itself."""
        self._events.append(event)

    def on_machine_state(self, state: MachineState) -> None:
        """The machine told its state."""
        self._state = state

    def on_force_ctrl(self, state: ForceCtrlState) -> None:
        """Force control told its state."""
        self._force_ctrl, self._formed_plan = int(state.mode), state.plan_id

    def on_recorder(self, silent: str, output: str) -> None:
        """The recorder told the topics from which nothing came yet, separated by commas, and the folder of its bag."""
        self._record = output
        self._recorder_waits_for = frozenset(silent.split(", "))

    # -- the cell (worker thread) --------------------------------------------------------------

    @property
    def counts(self) -> TickCounts:
        """Of the machine since the part began."""
        state, begin = self._state, self._at_start
        if state is None:
            return TickCounts()
        return TickCounts(
            max(0, state.tick - begin.ticks),
            max(0, state.late_ticks - begin.late),
            max(0, state.targets_lost - begin.lost),
        )

    def bring_up(self) -> None:
        """As in the protocol; finds out what the machine offers."""
        self._monitor.forget()
        self._client.prepare((*COMMANDS, HARMLESS))
        self._client.prepare((ChangeState, f"{name}/change_state") for name in self._all)
        self._client.prepare((Trigger, f"{name}/tare") for name in self._settings.load_cells)
        managed = self._machine.find(self._watch_operator, lambda: self._monitor.heard(MACHINE))
        self._managed = self._all if managed else self._all[1:]
        for name in self._managed:
            # a node may compile or load for long and be silent meanwhile; its answer is a sign of life
            self._client.bring_up(name, self._watch_operator)
            self._monitor.hear(name, "")
        self._machine.look(self._watch_operator, lifecycle=managed)
        self._operator.phase(preflight.passed(list(self._checks())))

    def reset(self, goal: PartGoal) -> None:
        """As in the protocol."""
        self._machine.check(goal.method, goal.job_file)
        self._tell_plain_wrenches(goal)
        self._leave_contour(goal)
        self._state, self._events = None, []
        self._began = None
        self._formed_before = 0.0 if goal.resume is None else goal.resume.ended - goal.resume.began
        kept = goal.resume.state_of(MACHINE) if goal.resume is not None else ""
        if kept and not self._machine.offer.simulated:
            raise IsfError(
                ErrorCode.CHECKPOINT_UNUSABLE,
                "the part was formed on the simulated machine, this is another one",
                where=MACHINE,
                advice="start the simulated machine",
            )
        if kept:
            self._machine.take_up(self._state_path(kept), self._watch_nodes, timeout=6 * self._settings.service_timeout)
            if not self._goes_on_exactly(goal):
                self._machine.stop("the part goes on", self._watch_nodes)
                self._wait_until_released(goal)
                self._machine.reset(goal, self._watch_nodes, timeout=6 * self._settings.service_timeout)
            return
        if goal.resume is not None and self._machine.offer.simulated:
            raise IsfError(
                ErrorCode.CHECKPOINT_UNUSABLE,
                "the part was formed on a machine that keeps no state, this is the simulated one",
                where=MACHINE,
                advice="go on at that machine: isf cell JOB --driver, then isf form --resume RUN --attach",
            )
        if goal.resume is not None:
            self._operator.phase("the machine keeps no state: the part goes on with the sheet in its clamp")
        self._machine.reset(goal, self._watch_nodes, timeout=6 * self._settings.service_timeout)

    def tare(self) -> None:
        """As in the protocol; the simulated machine of a resumed part has the tare that it had."""
        machine = self._machine
        for name in self._settings.load_cells if self._settings.lockstep else ():
            self._wait_until_load_cell_hears(name)
        if not machine.taken_up:
            machine.tare(self._watch_nodes)
        for name in self._settings.load_cells:
            self._tare_load_cell(name)
        if not machine.offer.state:
            self._at_start = TickCounts()
            return
        self._client.wait_until(
            lambda: (
                (state := self._state) is not None and not state.fault_codes and (state.tared or not machine.tells_tare)
            ),
            self._watch_nodes,
            "the machine does not report that it is tared and without a fault",
            ErrorCode.SERVICE_TIMEOUT,
        )
        if (state := self._state) is not None:
            self._at_start = TickCounts(state.tick, state.late_ticks, state.targets_lost)

    def plan(self, goal: PartGoal) -> PlannedPart:
        """As in the protocol."""
        result = self._client.run_action(
            PlanPart,
            "plan_part",
            PlanPart.Goal(job_text=goal.job_file.text, base_folder=str(goal.job_file.base)),
            self.check,
            lambda feedback: self._operator.phase(f"planning: {feedback.phase}"),
            timeout=self._settings.plan_timeout,
        )
        if result.code:
            raise failure(result.code, result.message)
        self._plan_id = result.plan_id
        holds = tuple(int(number) for number in result.hold_after)
        return PlannedPart(result.plan_id, int(result.count), holds, tuple(result.warnings))

    def arm(self, goal: PartGoal, planned: PlannedPart) -> None:
        """As in the protocol."""
        base, options = str(goal.job_file.base), goal.options
        self._sensor = goal.options.scans_with_sensor(goal.job_file)
        self._client.set_parameter("springback", "base_folder", base, self.check)
        self._client.set_parameter("springback", "method", goal.method, self.check)
        self._to_graph.publish_info(self._info(goal, planned))
        # empty for a new part: one that was to go on and did not may have left its contours
        request = StateFile.Request(path="" if goal.resume is None else self._state_path(CONTOURS))
        timeout = 6 * self._settings.service_timeout
        self._client.checked_call(StateFile, "springback/load", request, self.check, timeout=timeout)
        armed = Arm.Request(
            plan_id=planned.plan_id,
            first_index=goal.first_index,
            count=planned.count,
            job_text=goal.job_file.text,
            base_folder=base,
            support_force=options.support_force_field(),
            sheet=self._sheet(goal),
        )
        self._take_up_force_control(goal)
        self._arm(armed)
        self._wait_for_recorder()

    def arm_by_hand(self, goal: PartGoal, *, depth: float, new_blank: bool) -> bool:
        """Make force control ready to move the tools by hand, on the sheet that is in the clamp, ``depth`` m deep.

        True when a fresh sheet was clamped: a simulated machine does so where there is none, and for ``new_blank``.
        Faults are cleared, and load cells tared. Raises IsfError.
        """
        self._state, self._events = None, []
        clamped = new_blank
        timeout = 6 * self._settings.service_timeout
        try:
            there = goal if new_blank else replace(goal, first_index=1)
            self._machine.reset(there, self._watch_nodes, timeout=timeout)
        except IsfError as error:
            if error.code is not ErrorCode.NO_BLANK:
                raise
            self._machine.reset(goal, self._watch_nodes, timeout=timeout)
            clamped = True
        self.tare()
        job_file = goal.job_file
        request = Arm.Request(by_hand=True, sheet_depth=0.0 if clamped else depth)
        request.job_text, request.base_folder = job_file.text, str(job_file.base)
        request.support_force, request.sheet = goal.options.support_force_field(), self._sheet(goal)
        self._arm(request)
        return clamped

    def disarm(self) -> None:
        """Force control moves the tools no more; they stand where they are when they are clear of the sheet."""
        self._client.checked_call(Arm, "force_ctrl/arm", Arm.Request(plan_id=""), self._watch_nodes)

    def _arm(self, request: Arm.Request) -> None:
        """Arm force control, which may first have to hear the machine, just activated.

        One that was frozen when the part ended goes on with its contour: it leaves that first. What another plan has it
        do is left alone.
        """
        deadline = time.monotonic() + self._settings.service_timeout
        pause, left = threading.Event(), False
        while True:
            response = self._client.call(Arm, "force_ctrl/arm", request, self.check)
            if not response.code:
                return
            error = failure(response.code, response.message)
            own = bool(request.plan_id) and self._formed_plan == request.plan_id
            if error.code is ErrorCode.NOT_ARMED and own and not left:
                left = True
                self._leave()
                continue
            if error.code not in NOT_HEARD_YET or time.monotonic() > deadline:
                raise error
            pause.wait(0.2)

    def _leave_contour(self, goal: PartGoal) -> None:
        """By the clock, a force control that was frozen when a part ended has the machine, once that follows targets
        again, go at once to where it believes the tools to be: it leaves that first. In lockstep it can do so only when
        the machine makes ticks again (:meth:`_arm`)."""
        own = {self._plan_id, goal.resume.plan_id if goal.resume is not None else ""} - {""}
        if self._settings.lockstep or self._force_ctrl in (None, ForceCtrlState.IDLE) or self._formed_plan not in own:
            return
        self._leave()

    def _leave(self) -> None:
        self._client.call(Trigger, "force_ctrl/stop", Trigger.Request(), self._watch_nodes)
        self.disarm()
        self._wait_until_lifted()

    def _take_up_force_control(self, goal: PartGoal) -> None:
        """In lockstep, armed next, it goes on with the tools on the sheet as they were; else the next contour is
        approached."""
        if goal.resume is not None and self._goes_on_exactly(goal):
            timeout = 6 * self._settings.service_timeout
            request = StateFile.Request(path=self._state_path(goal.resume.state_of("force_ctrl")))
            self._client.checked_call(StateFile, "force_ctrl/load", request, self.check, timeout=timeout)

    def _wait_for_recorder(self) -> None:
        """A recorder, where there is one, finds the machine late on a busy computer: without the wrenches of the first
        tick a record could not be replayed."""

        def missing() -> frozenset[str]:
            return RECORDED_FIRST & self._recorder_waits_for

        if not self._client.within(self._settings.service_timeout, lambda: not missing(), self.check):
            names = ", ".join(sorted(missing()))
            self._operator.phase(f"the recorder has not received {names}: the record lacks the beginning")

    def form_contour(self, index: int) -> FormedContour:
        """As in the protocol."""
        request = GetContour.Request(plan_id=self._plan_id, index=index)
        response = self._client.ask(GetContour, "planner/get_contour", request, self.check)
        if response.code:
            # a second planner, just started, answers too and has no plan; its first sign of life names it
            self._client.within(SIGN_OF_LIFE, lambda: bool(self._monitor.twice()), self.check)
            self._name_intruder()
            raise failure(response.code, response.message)
        with self._news:  # what came before it was sent is no result of this contour
            self._results.pop(index, None)
        self._to_graph.publish_nominal(response.contour)
        result = self._wait_for_result(index)
        if self._began is None:
            self._began = result.start - self._formed_before
        return FormedContour(contour_from_message(response.contour), self._corrections.get(index), result)

    def lift(self, formed: FormedContour) -> None:
        """As in the protocol; a lift that failed is published without points."""
        goal = LiftTool.Goal(speed=SETTINGS.speed, zero_force=SETTINGS.zero_force, max_lift=SETTINGS.max_lift)
        after, rows, result = contour_label(formed.nominal.index), NO_ROWS, formed.result
        try:
            found = self._act(LiftTool, "lift_tool", goal)
            curve = np.asarray(found.lift_z), np.asarray(found.lift_force)
            rows = lift_rows(result, found.springback, found.force, *curve)
        except IsfError as error:
            self._go_on_after(error, f"no tool lift after {after}")
        self._to_graph.publish_lift(lift_to_cloud(rows, stamps.from_seconds(result.end)))

    def scan(self, formed: FormedContour, *, aside: bool) -> None:
        """As in the protocol."""
        if not self._machine.offer.scanner:
            return  # as was told at the beginning; no need to lift the tools
        after = contour_label(formed.nominal.index)
        if aside:
            try:
                self._act(MoveAside, "move_aside", MoveAside.Goal())
            except IsfError as error:
                self._go_on_after(error, f"the tools were not moved aside after {after}")
        try:
            self._machine.scan(self.check, sensor=self._sensor)
        except IsfError as error:
            self._go_on_after(error, f"no scan after {after}")

    @property
    def _exact(self) -> bool:
        """The part can go on with the tools on the sheet.

        Not by the clock, nor where nodes of load cells, whose tare is not kept, have to be tared with the tools free.
        """
        return self._settings.lockstep and not self._settings.load_cells

    def _goes_on_exactly(self, goal: PartGoal) -> bool:
        """Machine and force control are taken up as they were; else the tools are released and come from the air."""
        before = goal.resume
        return self._exact and before is not None and all(before.state_of(name) for name in (MACHINE, "force_ctrl"))

    def save_state(self, next_index: int) -> tuple[str, ...]:
        """As in :class:`isf_cell.run.part_keeper.StateSaver`."""
        written = [f"{CONTOURS}/contour_{next_index - 1:06d}"]
        timeout = 6 * self._settings.service_timeout
        request = StateFile.Request(path=self._state_path(CONTOURS))
        self._client.checked_call(StateFile, "springback/save", request, self.check, timeout=timeout)
        if self._exact:
            written.append(state_file("force_ctrl", next_index))
            request = StateFile.Request(path=self._state_path(written[-1]))
            self._client.checked_call(StateFile, "force_ctrl/save", request, self.check, timeout=timeout)
        if self._machine.offer.simulated:
            written.append(state_file(MACHINE, next_index))
            self._machine.save(self._state_path(written[-1]), self.check, timeout=timeout)
        return tuple(written)

    def check(self) -> None:
        """Raise IsfError when a node died or was taken down, the operator cancelled, the machine has a fault, the load
        cells no longer tell the force, or a contour was not corrected."""
        self._watch_nodes()
        self._watch_operator()
        self._watch_states()
        self._watch_publishers()
        state = self._state
        if state is not None and state.fault_codes:
            raise conversion.machine_fault(state)
        if (unknown := force_unknown(list(self._events))) is not None:
            raise unknown
        for correction in list(self._corrections.values()):
            if correction.code and not len(correction.offset):  # refused: no corrected contour will follow
                where = f"springback, {contour_label(correction.index)}"
                raise failure(correction.code, correction.message, where=where)

    def torn(self) -> IsfError | None:
        """As in the protocol."""
        return torn(self._events, self._began or 0.0)

    def explain(self, error: IsfError) -> IsfError:
        """A fault that a dead node explains is told as its death, one that a second publisher explains names him."""
        if error.code in _OF_AN_INTRUDER:
            try:
                self._name_intruder()
            except IsfError as cause:
                return IsfError(cause.code, cause.what, where=cause.where, advice=f"{cause.advice}; {error.message}")
        if error.code not in _SYMPTOMS:
            return error
        try:
            self._client.wait_until(
                lambda: False, self._watch_nodes, "", error.code, timeout=self._settings.silence_timeout + 1.0
            )
        except IsfError as cause:
            if cause.code == ErrorCode.NODE_DIED:
                return IsfError(ErrorCode.NODE_DIED, cause.what, where=cause.where, advice=error.message)
        return error

    def stop(self, error: IsfError) -> None:
        """Each step may fail without stopping the next; only time limits count, the part has failed already.

        A part that was cancelled, or is torn, is left by force_ctrl, along its path; where it does not do so in time
        the machine releases the tools.
        """
        by_machine = self._machine.offer.stop
        if error.code in (ErrorCode.CANCELLED, ErrorCode.SHEET_TORN) or not by_machine:
            self._attempt(lambda: self._client.call(Trigger, "force_ctrl/stop", Trigger.Request(), _no_watch))
            release = Arm.Request(plan_id="")
            self._attempt(lambda: self._client.call(Arm, "force_ctrl/arm", release, _no_watch))
            by_machine = not self._attempt(self._wait_until_lifted) and by_machine
        if by_machine and MACHINE not in self._monitor.dead():  # else nobody would answer
            self._attempt(lambda: self._machine.stop(f"part ended with {error.code.name}", self._watch_machine))

    def finish(self) -> None:
        """As in the protocol."""
        dead = set(self._monitor.dead())
        if self._plan_id and MACHINE not in dead:
            self._attempt(lambda: self._machine.scan(_no_watch, sensor=False))
        for name in reversed(self._managed):
            if name not in dead and self._monitor.heard(name):
                self._attempt(lambda name=name: self._client.bring_down(name, _no_watch))  # type: ignore[misc]

    # -- inside ----------------------------------------------------------------------------------

    def _state_path(self, name: str) -> str:
        """What the nodes are asked for: ``name`` in the folder of the checkpoint."""
        return (PurePosixPath(self._settings.states_in) / name).as_posix()

    def _checks(self) -> Iterator[preflight.Check]:
        """Before a blank is clamped. Job, rig and files were read before; the plan is held against the rig when it is
        made, wrenches, poses and tare are asked for by arming."""
        client = self._client
        yield preflight.publishers(self._publishers(preflight.PUBLISHED_ONCE))
        yield preflight.twice(self._monitor.twice())
        yield preflight.versions(self._monitor.versions())
        yield preflight.messages({topic: client.type_hashes(topic) for topic in preflight.PUBLISHED_ONCE})
        yield preflight.disk(self._settings.kept_in + ((Path(self._record),) if self._record else ()))

    def _watch_publishers(self) -> None:
        """Once a second: raise IsfError SECOND_PUBLISHER when somebody sends targets or wrenches beside the cell."""
        now = time.monotonic()
        if now < self._next_look:
            return
        self._next_look = now + PUBLISHERS_PERIOD
        self._name_intruder()

    def _name_intruder(self) -> None:
        moving = preflight.publishers(self._publishers(preflight.MOVES_THE_TOOLS))
        for found in (moving, preflight.twice(self._monitor.twice())):
            if found.failed is not None:
                raise found.failed

    def _publishers(self, topics: Sequence[str]) -> dict[str, list[str]]:
        """Names of the nodes that publish each of ``topics``; the machine does not where a node load_cell_k makes the
        wrench: it keeps the topic and sends nothing on it."""
        found = {topic: self._client.publisher_names(topic) for topic in topics}
        for name in self._settings.load_cells:
            topic = f"tool_{name[-1]}/wrench"
            found[topic] = [node for node in found[topic] if node.rsplit("/", 1)[-1] != MACHINE]
        return found

    def _wait_until_lifted(self) -> None:
        """Who takes force_ctrl down before would leave the tools in the sheet."""
        self._client.wait_until(
            lambda: self._force_ctrl in (None, ForceCtrlState.IDLE),
            self._watch_nodes,
            "force_ctrl does not report that it has lifted the tools",
            ErrorCode.SERVICE_TIMEOUT,
            timeout=LONGEST_LIFT,
        )

    def _wait_until_released(self, goal: PartGoal) -> None:
        """In lockstep a stop is answered when the tools are clear; by the clock its ticks take their time."""
        if self._settings.lockstep:
            return
        needed = LONGEST_RELEASE * goal.job_file.job.control.rate
        ticks: list[int] = []

        def released() -> bool:
            if (state := self._state) is not None and state.fault_codes:
                ticks.append(state.tick)
            return bool(ticks) and ticks[-1] - ticks[0] >= needed

        what = "the machine does not report that it has released the tools"
        self._client.wait_until(released, self._watch_nodes, what, ErrorCode.SERVICE_TIMEOUT)

    def _tell_plain_wrenches(self, goal: PartGoal) -> None:
        """A standing cell may have been made for another rig. A driver makes wrenches its own way, or gives none: then
        force control is not armed."""
        needed = [f"load_cell_{tool}" for tool in tools_with_spindle_cells(goal.job_file.rig)]
        if (lacking := sorted({*needed} - {*self._settings.load_cells})) and self._machine.offer.simulated:
            self._operator.phase(
                f"no node {' or '.join(lacking)}: the wrench is not made of the rig's spindle_cells, but read by its "
                "load_cell; a cell that is started for this job or rig has the nodes"
            )

    def _wait_until_load_cell_hears(self, name: str) -> None:
        """In lockstep the readings of a tare come all at once: a node that the machine has not found yet misses them.
        Until then the machine repeats a reading five times a second."""
        deadline, pause = time.monotonic() + self._settings.service_timeout, threading.Event()
        while not (response := self._ask_for_tare(name)).success:
            error = told(response.message)
            if error is None or error.code is not ErrorCode.WRENCH_LOST or time.monotonic() > deadline:
                return  # the tare tells what is wrong
            pause.wait(0.05)

    def _tare_load_cell(self, name: str) -> None:
        """The node takes its zero from readings that may not all have come yet; in lockstep they come with a tare of
        the machine alone, which takes a second of its time: asked for again only where they seem to be lost."""
        now = time.monotonic()
        deadline, lost, pause = now + self._settings.service_timeout, now + READINGS_LOST, threading.Event()
        while not (response := self._ask_for_tare(name)).success:
            if time.monotonic() > deadline:
                raise told(response.message) or IsfError(ErrorCode.NO_TARE, response.message, where=name)
            pause.wait(0.2)
            if self._settings.lockstep and time.monotonic() > lost:
                self._machine.tare(self._watch_nodes)
                lost = time.monotonic() + READINGS_LOST

    def _ask_for_tare(self, name: str) -> Trigger.Response:
        response: Trigger.Response = self._client.call(Trigger, f"{name}/tare", Trigger.Request(), self._watch_nodes)
        return response

    def _act(self, kind: Any, name: str, goal: Any) -> Any:
        """Result of an action of force_ctrl between two contours; raises its code."""
        found = self._client.run_action(
            kind, name, goal, self.check, lambda _: None, timeout=self._settings.contour_timeout
        )
        if found.code:
            raise failure(found.code, found.message)
        return found

    def _go_on_after(self, error: IsfError, reported: str) -> None:
        if error.code in _END_THE_PART:
            raise error
        self._operator.phase(f"{reported}: {error}")

    def _wait_for_result(self, index: int) -> ContourResult:
        deadline = time.monotonic() + self._settings.contour_timeout
        with self._news:
            while index not in self._results:
                self.check()
                if time.monotonic() > deadline:
                    raise IsfError(
                        ErrorCode.CONTOUR_TIMEOUT,
                        f"no result within {self._settings.contour_timeout:g} s",
                        where=contour_label(index),
                    )
                self._news.wait(POLL)
            return self._results[index]

    def _watch_operator(self) -> None:
        if self._operator.cancelled():
            raise IsfError(ErrorCode.CANCELLED, "cancelled by the operator")

    def _watch_machine(self) -> None:
        if MACHINE in self._monitor.dead():
            raise IsfError(ErrorCode.NODE_DIED, f"node '{MACHINE}' no longer responds")

    def _watch_states(self) -> None:
        left = self._monitor.deactivated()
        if left:
            self._name_intruder()  # a second process of the name tells the state of its own
        for name, state in left.items():
            raise IsfError(
                ErrorCode.NODE_INACTIVE,
                f"node '{name}' is {state} in the middle of the part",
                advice="another program deactivated it, or it was restarted; form the part again",
            )

    def _watch_nodes(self) -> None:
        if self._look.late():
            self._monitor.not_served()
        for name in self._monitor.dead():
            words = self._monitor.last_words(name)
            last = f"; its last output:  {words}" if words not in ("", "ok") else ""
            raise IsfError(
                ErrorCode.NODE_DIED,
                f"node '{name}' no longer responds{last}",
                advice="the machine holds and releases contact; see the log of the node, restart it",
            )

    def _attempt(self, action: Callable[[], Any]) -> bool:
        """False when it failed, which the operator is told."""
        try:
            action()
        except IsfError as error:
            self._operator.phase(f"while ending the part: {error}")
            return False
        return True

    def _sheet(self, goal: PartGoal) -> str:
        """Kind of the simulated sheet; empty: a real one."""
        return goal.options.sheet_of(goal.job_file) if self._machine.offer.simulated else ""

    def _info(self, goal: PartGoal, planned: PlannedPart) -> JobInfo:
        job, options, offer = goal.job_file.job, goal.options, self._machine.offer
        return JobInfo(
            job_name=job.name,
            job_text=goal.job_file.text,
            plan_id=planned.plan_id,
            process=job.process,
            correction=goal.method,
            support_force=float(options.set_point(goal.job_file)),
            world=options.variant if offer.simulated else REAL_MACHINE,
            seed=options.seed,
            sheet=self._sheet(goal),
            control_rate=float(job.control.rate),
            lockstep=self._settings.lockstep,
            software=__version__,
            base_folder=str(goal.job_file.base),
            first_index=goal.first_index,
            plan_warnings=list(planned.warnings),
        )


def _no_watch() -> None:
    """Nothing ends the wait but its time limit."""
