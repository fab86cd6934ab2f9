"""Node ``executive``: forms a part on request (action ``form_part``), with progress, pause and cancel.

Between parts it lets an operator move the tools, set work offsets and check programs, each in its mode
(:mod:`isf_cell.run.operator_modes`).
"""

from __future__ import annotations

import sys
import threading
import time
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from isf_analysis.measures.events import event_of_message
from isf_core.contour import contour_label
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile
from isf_core.simulated_sheet import sheet_kind
from isf_force_ctrl.hand.hand_space import place
from isf_msgs.action import FormPart
from isf_msgs.msg import (
    Contour,
    ContourCorrection,
    ContourResult,
    ExecutiveState,
    ForceCtrlState,
    HandState,
    JobInfo,
    MachineEvent,
    MachineState,
)
from isf_msgs.srv import CheckProgram, SetMode, SetZero
from isf_ros import process, qos
from isf_ros.background import Worker, in_thread
from isf_ros.conversion import correction_from_message, result_from_message, set_point_of, tip_of
from isf_ros.lifecycle import CellNode
from isf_ros.parameters import parameter
from isf_ros.process_identity import running
from rclpy.action.server import ServerGoalHandle
from rclpy.callback_groups import ReentrantCallbackGroup
from sensor_msgs.msg import PointCloud2
from std_srvs.srv import SetBool, Trigger

from isf_cell.options import RunOptions
from isf_cell.run.cell import PLAN_WARNING, PartGoal
from isf_cell.run.checkpoint import Checkpoint, CheckpointFolder, folder_below
from isf_cell.run.graph_cell import GraphCell, GraphSettings, managed_nodes
from isf_cell.run.graph_client import GraphClient
from isf_cell.run.heartbeat_monitor import HeartbeatMonitor
from isf_cell.run.machine_client import MACHINE
from isf_cell.run.operator_modes import OperatorMode, OperatorModes
from isf_cell.run.part_keeper import PartKeeper, PartTotals, not_kept
from isf_cell.run.part_run import PartRun
from isf_cell.run.part_step import PartStep


@dataclass(frozen=True)
class ExecutiveParameters:
    """Parameters of the executive."""

    lockstep: bool = parameter(
        True,
        "the machine is the simulated one in lockstep, and offers everything; false: by the clock, what the machine or "
        "driver offers is found out before a part",
    )
    service_timeout: float = parameter(
        20.0, "longest wait for an answer of another node", unit="s", minimum=0.1, maximum=3600.0
    )
    plan_timeout: float = parameter(600.0, "longest planning", unit="s", minimum=0.1, maximum=86_400.0)
    contour_timeout: float = parameter(1800.0, "longest contour, wall time", unit="s", minimum=0.1, maximum=864_000.0)
    silence_timeout: float = parameter(
        5.0,
        "time without a sign of life after which a node counts as dead, unless its process is seen to run (20 s) or to "
        "have ended (at once)",
        unit="s",
        minimum=0.5,
        maximum=600.0,
    )
    load_cells: str = parameter(
        "",
        "tools whose wrench a node load_cell_k makes; it is brought up, tared and watched with the others",
        choices=("", "1", "2", "1 2"),
    )
    checkpoint: str = parameter(
        "",
        "folder of the checkpoint written after every contour, also the state_folder of machine, springback and "
        "force_ctrl; empty: none",
    )
    state_folder: str = parameter(
        "",
        "folder below which a part keeps its checkpoint where form_part names one for it; also the state_folder of "
        "machine, springback and force_ctrl; empty: none",
    )
    job: str = parameter("", "job file whose rig, sheet and tools are meant where no part was formed yet; empty: none")
    set_up: str = parameter(
        "", "set-up file that executive/zero writes; empty: that of the rig in $ISF_CELLS or ~/.config/isf/cells"
    )


HAND_NEWS = 0.5
"""s of wall time within which a node hears of the end of a movement by hand after another one has."""

MODE_PERIOD = 0.25
"""s of wall time between two looks at what a mode other than automatic needs."""


class ExecutiveNode(CellNode[ExecutiveParameters]):
    """Serves ``form_part``; one part at a time."""

    def __init__(self) -> None:
        super().__init__("executive", ExecutiveParameters, autostart=True)
        self._cell: GraphCell | None = None
        self._handle: ServerGoalHandle | None = None
        self._paused = False
        self._hand_stands = threading.Event()
        self._hand_stands.set()
        self._run: PartRun | None = None
        self._waits_for = ""
        self._modes = OperatorModes(self._new_cell)
        self._leaving = Worker(lambda error: self.fault(error, "leaving a mode"))

    def configure(self) -> None:
        values = self.values()
        self._checkpoint = CheckpointFolder(Path(values.checkpoint).absolute()) if values.checkpoint else None
        self._states = Path(values.state_folder).resolve() if values.state_folder else None
        self._settings = GraphSettings(
            values.lockstep,
            values.service_timeout,
            values.plan_timeout,
            values.contour_timeout,
            values.silence_timeout,
            tuple(f"load_cell_{k}" for k in values.load_cells.split()),
            () if self._checkpoint is None else (self._checkpoint.path,),
        )
        self._monitor = HeartbeatMonitor(managed_nodes(self._settings.load_cells), values.silence_timeout)
        self._client = GraphClient(self, values.service_timeout)
        self._nominal = self.create_publisher(Contour, "contour/nominal", qos.LATCHED)
        self._info = self.create_publisher(JobInfo, "part/info", qos.LATCHED)
        self._lift = self.create_publisher(PointCloud2, "tool_lift", qos.LATCHED)
        self.create_subscription(ContourResult, "contour/result", self._on_result, qos.EVENT)
        self.create_subscription(ContourCorrection, "contour/correction", self._on_correction, qos.EVENT)
        self.create_subscription(MachineState, "machine/state", self._on_machine_state, qos.STREAM)
        self.create_subscription(ForceCtrlState, "force_ctrl/state", self._on_force_ctrl, qos.STREAM)
        self.create_subscription(MachineEvent, "machine/event", self._on_event, qos.EVENT)
        for tool in (1, 2):
            self.create_subscription(PoseStamped, f"tool_{tool}/pose", partial(self._on_pose, tool), qos.SENSOR)
        self.create_subscription(HandState, "force_ctrl/hand", self._on_hand, qos.CHANGES)
        self.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 50)
        self._modes.job_path, self._modes.set_up = values.job, values.set_up
        self._told_state = ExecutiveState()
        self._state_out = self.create_publisher(ExecutiveState, "executive/state", qos.CHANGES)
        self.create_timer(MODE_PERIOD, self._look_at_mode, clock=self.steady_clock)
        self.create_service(SetBool, "executive/pause", self._on_pause)
        self.create_service(Trigger, "executive/go_on", self._on_go_on)
        # a group of their own: while they wait for a thread, the node takes the answers that the thread waits for
        beside: dict[str, Any] = {"callback_group": ReentrantCallbackGroup()}
        self.create_service(SetMode, "executive/set_mode", self._on_set_mode, **beside)
        self.create_service(SetZero, "executive/zero", self._on_zero, **beside)
        self.create_service(CheckProgram, "executive/check_program", self._on_check_program, **beside)
        self.create_action_server(
            FormPart, "form_part", self._execute, lambda _: self.is_active and self._handle is None
        )

    def deactivate(self) -> None:
        """Raises IsfError BUSY while a part is formed: what it needs would be gone."""
        if self._handle is not None:
            raise IsfError(ErrorCode.BUSY, "a part is being formed", advice="cancel it first")
        if self._modes.mode is not OperatorMode.AUTOMATIC:
            raise IsfError(ErrorCode.BUSY, f"the mode is {self._modes.mode.word}", advice="set it to automatic first")

    def cleanup(self) -> None:
        self._client.close()

    def health_values(self) -> dict[str, object]:
        return {"busy": self._handle is not None, "paused": self.paused(), "mode": self._modes.mode.word}

    # -- what the cell publishes -------------------------------------------------------------------

    def publish_nominal(self, contour: Contour) -> None:
        self._nominal.publish(contour)

    def publish_info(self, info: JobInfo) -> None:
        info.header.stamp = self.get_clock().now().to_msg()
        self._info.publish(info)

    def publish_lift(self, cloud: PointCloud2) -> None:
        self._lift.publish(cloud)

    # -- the operator, who is behind the action --------------------------------------------------------

    def phase(self, text: str, index: int = 0, count: int = 0) -> None:
        self.get_logger().info(text)
        nan = float("nan")
        self._publish_feedback(
            FormPart.Feedback(
                phase=text, index=index, count=count, support_force=nan, predicted_springback=nan, correction=nan
            )
        )

    def warned(self, text: str) -> None:
        self.phase(f"{PLAN_WARNING}{text}")

    def formed(self, step: PartStep) -> None:
        self._publish_feedback(
            FormPart.Feedback(
                phase="forming",
                index=step.index,
                count=step.count,
                depth=step.depth,
                forming_force=step.forming_force,
                support_force=step.support_force,
                predicted_springback=step.springback,
                correction=step.correction,
            )
        )
        planned = self._run.planned if self._run else None
        if planned and step.index + 1 in planned.hold_after and step.index + 1 < step.count:
            self._waits_for = f"executive/go_on, after {contour_label(step.index)}"
            self._tell_state()

    def cancelled(self) -> bool:
        """Also where whoever asked is gone: nobody records the part any more, nor can end it."""
        handle = self._handle
        return handle is not None and (handle.is_cancel_requested or running(handle.request.process) is False)

    def paused(self) -> bool:
        return self._paused or bool(self._waits_for)

    def _publish_feedback(self, feedback: FormPart.Feedback) -> None:
        if self._handle is not None:
            self._handle.publish_feedback(feedback)

    # -- callbacks -----------------------------------------------------------------------------------

    async def _execute(self, handle: ServerGoalHandle) -> FormPart.Result:
        try:
            self._modes.require(OperatorMode.AUTOMATIC, what="forming a part")
        except IsfError as error:
            handle.abort()
            return FormPart.Result(code=int(error.code), message=error.message)
        self._handle, self._paused, self._waits_for = handle, False, ""
        self._tell_state()
        try:
            result = await in_thread(partial(self._form, handle), self.executor)
        finally:
            self._cell, self._handle, self._paused, self._waits_for = None, None, False, ""
            self._tell_state()
        if result.code == ErrorCode.OK:
            handle.succeed()
        elif handle.is_cancel_requested and result.code == ErrorCode.CANCELLED:
            handle.canceled()
        else:
            self.get_logger().error(f"part ended: [{result.code}] {result.message}")
            handle.abort()
        return result

    def _form(self, handle: ServerGoalHandle) -> FormPart.Result:
        """Form the part in a worker thread."""
        started, request = time.monotonic(), handle.request
        try:
            checkpoint = self._checkpoint_of(request)
            goal = self._goal_of(request, checkpoint)
        except IsfError as error:
            return FormPart.Result(code=int(error.code), message=error.message)
        self._cell = cell = self._new_cell(checkpoint)
        self._modes.job_file = goal.job_file
        if goal.first_index == 0:
            self._modes.formed(0.0, fresh=True)
        keeper = None
        if checkpoint is not None:
            keeper = PartKeeper(checkpoint, cell, self, lockstep=self._settings.lockstep)
        self._run = run = PartRun(cell, goal, self, keeper)
        failed = run.run()
        if failed is not None and failed.code is ErrorCode.CANCELLED and not handle.is_cancel_requested:
            failed = IsfError(ErrorCode.CANCELLED, "the process that asked for the part has ended", where="form_part")
        totals = PartTotals.of(run.results, cell.counts, goal.resume)
        return FormPart.Result(
            code=int(failed.code) if failed else 0,
            message=failed.message if failed else "",
            plan_id=run.planned.plan_id if run.planned else "",
            contours=totals.contours,
            ticks=totals.ticks,
            late_ticks=totals.late_ticks,
            lost_messages=totals.lost_messages,
            sim_time=totals.ended - totals.began,
            wall_time=time.monotonic() - started,
        )

    def _checkpoint_of(self, request: FormPart.Goal) -> CheckpointFolder | None:
        """Where the part is kept; None: nowhere. Raises IsfError FILE_OUTSIDE for a part that is to go on; a new one is
        formed nevertheless."""
        if not request.checkpoint:
            return self._checkpoint
        try:
            if self._states is None:
                raise IsfError(
                    ErrorCode.FILE_OUTSIDE,
                    "this cell has no folder below which it keeps parts",
                    where="parameter state_folder",
                    advice="isf cell starts executive, machine, springback and force_ctrl with one",
                )
            return CheckpointFolder(folder_below(self._states, request.checkpoint))
        except IsfError as error:
            if request.resume:
                raise
            self.phase(not_kept(error))
            return None

    def _goal_of(self, request: FormPart.Goal, checkpoint: CheckpointFolder | None) -> PartGoal:
        """Raises IsfError of job, options and checkpoint."""
        if request.resume:
            if checkpoint is None:
                raise IsfError(
                    ErrorCode.FILE_NOT_FOUND,
                    "the executive keeps no checkpoint",
                    where="parameter checkpoint",
                    advice="start it with the folder of the part that is to go on",
                )
            _check_request(request, checkpoint.read())
            return PartGoal.resumed(checkpoint.take_up())
        force = set_point_of(request.support_force)
        options = RunOptions(request.correction or None, force, request.world, request.seed, sheet_kind(request.sheet))
        return PartGoal(JobFile(request.job_text, Path(request.base_folder), "job"), options, request.first_index)

    @property
    def _listening(self) -> GraphCell | None:
        """The cell that is to hear what the nodes tell: of a part, or of a mode."""
        return self._cell or self._modes.cell

    def _new_cell(self, checkpoint: CheckpointFolder | None = None) -> GraphCell:
        settings = self._settings
        if checkpoint is not None and checkpoint is not self._checkpoint and self._states is not None:
            name = checkpoint.path.relative_to(self._states).as_posix()
            settings = replace(settings, kept_in=(checkpoint.path,), states_in=name)
        return GraphCell(self._client, self._monitor, self, self, settings)

    def _on_result(self, message: ContourResult) -> None:
        if self._cell:
            result = result_from_message(message)
            deepest = np.nanmin(result.forming_target[:, 2], initial=0.0) if len(result.forming_target) else 0.0
            self._modes.formed(-float(deepest))
            self._cell.on_result(result)

    def _on_correction(self, message: ContourCorrection) -> None:
        if self._cell:
            self._cell.on_correction(correction_from_message(message))

    def _on_machine_state(self, message: MachineState) -> None:
        self._monitor.stream(MACHINE)
        if cell := self._listening:
            cell.on_machine_state(message)

    def _on_force_ctrl(self, message: ForceCtrlState) -> None:
        if cell := self._listening:
            cell.on_force_ctrl(message)

    def _on_pose(self, tool: int, message: PoseStamped) -> None:
        self._modes.tip(tool, np.array(tip_of(message)))
        if tool == 1 and not self._settings.lockstep:  # a driver may publish nothing else that tells that it lives
            self._monitor.stream(MACHINE)

    def _on_hand(self, message: HandState) -> None:
        if message.moving:
            self._hand_stands.clear()
        else:
            self._hand_stands.set()

    def _on_event(self, message: MachineEvent) -> None:
        if cell := self._listening:
            cell.on_event(event_of_message(message))

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        own = self.get_namespace().rstrip("/") + "/"
        for status in message.status:
            if status.name.startswith(own):
                values = {item.key: item.value for item in status.values}
                name = status.name.removeprefix(own)
                told = (values.get(key, "") for key in ("state", "process", "version"))
                self._monitor.hear(name, status.message, *told)
                if name == "recorder" and (cell := self._listening):
                    cell.on_recorder(values.get("silent", ""), values.get("output", ""))

    def _on_pause(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        waiting, self._paused = self.paused(), request.data
        if not request.data:  # who goes on goes on past a hold of the job, too
            self._waits_for = ""
        response.success = self._handle is not None
        going_on = "going on" if waiting else "going on: nothing waited"
        response.message = "pausing after this contour" if request.data else going_on
        if not response.success:
            refused = IsfError(ErrorCode.MODE_REFUSED, "no part is being formed", where="executive/pause")
            response.message = str(refused)
            self._paused = False
        self._tell_state()
        return response

    def _on_go_on(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Go on after a contour of the plan's hold_after; an operator's pause ends by executive/pause."""
        response.success = bool(self._waits_for)
        refused = IsfError(ErrorCode.MODE_REFUSED, "no part waits for this", where="executive/go_on")
        response.message = "going on" if response.success else str(refused)
        if response.success:
            self._waits_for = ""
            if self._paused:
                response.message = "waiting for executive/pause: an operator has paused the part"
            self._tell_state()
        return response

    # -- modes -----------------------------------------------------------------------------------

    async def _on_set_mode(self, request: SetMode.Request, response: SetMode.Response) -> SetMode.Response:
        modes = self._modes
        await self._news_of_hand()
        try:
            wanted, job_file = self._mode_of(request)
            modes.changing = True
            self._tell_state()
            try:
                change = partial(modes.change, wanted, job_file, new_blank=request.new_blank)
                await in_thread(change, self.executor)
            finally:
                modes.changing = False
                self._tell_state()
        except IsfError as error:
            response.code, response.message = int(error.code), error.message
            self.get_logger().warning(str(error))
        else:
            self.get_logger().info(f"mode: {wanted.word}")
        return response

    def _mode_of(self, request: SetMode.Request) -> tuple[OperatorMode, JobFile | None]:
        """Raises IsfError MODE_REFUSED, and of the job."""
        refusal = ""
        if request.mode not in set(OperatorMode):
            refusal = f"there is no mode {request.mode}"
        elif not self.is_active:
            refusal = "the executive is not active"
        elif self._handle is not None:
            refusal = "a part is being formed"
        elif self._modes.changing:
            refusal = "the mode is being changed"
        elif not self._hand_stands.is_set():
            refusal = "a tool is moving"
        if refusal:
            raise IsfError(
                ErrorCode.MODE_REFUSED,
                refusal,
                where="executive/set_mode",
                advice="wait for its end, or end it; modes are 0 automatic, 1 manual, 2 set-up, 3 simulation",
            )
        job_file = JobFile(request.job_text, Path(request.base_folder), "job") if request.job_text else None
        return OperatorMode(request.mode), job_file

    async def _news_of_hand(self) -> None:
        """A client that asks once a tool stands may have heard of it before this node: that news is waited for."""
        if not self._hand_stands.is_set():
            await in_thread(partial(self._hand_stands.wait, HAND_NEWS), self.executor)

    async def _on_zero(self, request: SetZero.Request, response: SetZero.Response) -> SetZero.Response:
        await self._news_of_hand()
        try:
            if not self._hand_stands.is_set():
                raise IsfError(
                    ErrorCode.MODE_REFUSED, "a tool is moving", where="executive/zero", advice="let it stand"
                )
            origin, path = self._modes.zero(request.system, request.tool, request.axes)
            response.offset.x, response.offset.y, response.offset.z = origin
            response.file = str(path)
            self.get_logger().info(f"G{request.system} at {place(np.array(origin))}, in {path}")
        except IsfError as error:
            response.code, response.message = int(error.code), error.message
        return response

    async def _on_check_program(
        self, request: CheckProgram.Request, response: CheckProgram.Response
    ) -> CheckProgram.Response:
        try:
            check = partial(self._modes.check_program, request.text, request.name)
            failure, response.report = await in_thread(check, self.executor)
            if failure is not None:
                response.code, response.message = int(failure.code), failure.message
        except IsfError as error:
            response.code, response.message = int(error.code), error.message
        return response

    def _look_at_mode(self) -> None:
        modes = self._modes
        if modes.cell is not None and not modes.changing:
            try:
                modes.check()
            except IsfError as error:
                modes.changing = True
                self.report(error)
                self._leaving.add(partial(self._leave_mode, error))
        self._tell_state()

    def _leave_mode(self, error: IsfError) -> None:
        try:
            self._modes.leave_for(error)
        finally:
            self._hand_stands.set()  # who moved a tool may be gone, and tells no more that it stands
            self._modes.changing = False

    def _tell_state(self) -> None:
        """At every change."""
        modes = self._modes
        state = ExecutiveState(
            mode=int(modes.mode),
            changing=modes.changing,
            busy=self._handle is not None,
            paused=self.paused(),
            waits_for=self._waits_for,
            job=modes.job_file.job.name if modes.job_file is not None else "",
            code=int(modes.code),
            message=modes.message,
        )
        state.header = self._told_state.header
        if state == self._told_state and state.header.frame_id:
            return
        state.header.frame_id = "sheet"
        state.header.stamp = self.get_clock().now().to_msg()
        self._told_state = state
        self._state_out.publish(state)


def _check_request(request: FormPart.Goal, begun: Checkpoint) -> None:
    """Raise IsfError FILE_FIELD where a part that goes on is to be another one than it was begun as."""
    for name, asked, was in (
        ("job_text", request.job_text, begun.job_text),
        ("correction", request.correction, begun.correction),
        ("sheet", request.sheet, begun.sheet),
    ):
        if asked and asked != was:
            raise IsfError(
                ErrorCode.FILE_FIELD,
                "a part goes on as it was begun, this is another one",
                where=f"form_part, {name}",
                advice="leave it empty",
            )


def main(args: list[str] | None = None) -> None:
    """Entry point of ``ros2 run isf_cell executive``."""
    sys.exit(process.run(ExecutiveNode, args))


if __name__ == "__main__":
    main()
