"""Node ``executive``: forms a part on request (action ``form_part``), with progress, pause and cancel."""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from isf_analysis.measures.events import event_of_message
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile
from isf_core.simulated_sheet import sheet_kind
from isf_msgs.action import FormPart
from isf_msgs.msg import Contour, ContourCorrection, ContourResult, ForceCtrlState, JobInfo, MachineEvent, MachineState
from isf_ros import process, qos
from isf_ros.background import in_thread
from isf_ros.conversion import correction_from_message, result_from_message
from isf_ros.lifecycle import CellNode
from isf_ros.parameters import parameter
from rclpy.action.server import ServerGoalHandle
from sensor_msgs.msg import PointCloud2
from std_srvs.srv import SetBool

from isf_cell.options import RunOptions
from isf_cell.run.cell import PartGoal
from isf_cell.run.checkpoint import Checkpoint, CheckpointFolder
from isf_cell.run.graph_cell import GraphCell, GraphSettings, managed_nodes
from isf_cell.run.graph_client import GraphClient
from isf_cell.run.heartbeat_monitor import HeartbeatMonitor
from isf_cell.run.machine_client import MACHINE
from isf_cell.run.part_keeper import PartKeeper, PartTotals
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


class ExecutiveNode(CellNode[ExecutiveParameters]):
    """Serves ``form_part``; one part at a time."""

    def __init__(self) -> None:
        super().__init__("executive", ExecutiveParameters, autostart=True)
        self._cell: GraphCell | None = None
        self._handle: ServerGoalHandle | None = None
        self._paused = False

    def configure(self) -> None:
        values = self.values()
        self._checkpoint = CheckpointFolder(Path(values.checkpoint).absolute()) if values.checkpoint else None
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
        if not values.lockstep:  # a driver may publish nothing else that tells that it lives
            self.create_subscription(PoseStamped, "tool_1/pose", self._on_pose, qos.SENSOR)
        self.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 50)
        self.create_service(SetBool, "executive/pause", self._on_pause)
        self.create_action_server(
            FormPart, "form_part", self._execute, lambda _: self.is_active and self._handle is None
        )

    def deactivate(self) -> None:
        """Raises IsfError BUSY while a part is formed: what it needs would be gone."""
        if self._handle is not None:
            raise IsfError(ErrorCode.BUSY, "a part is being formed", advice="cancel it first")

    def cleanup(self) -> None:
        self._client.close()

    def health_values(self) -> dict[str, object]:
        return {"busy": self._handle is not None, "paused": self._paused}

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

    def cancelled(self) -> bool:
        return self._handle is not None and bool(self._handle.is_cancel_requested)

    def paused(self) -> bool:
        return self._paused

    def _publish_feedback(self, feedback: FormPart.Feedback) -> None:
        if self._handle is not None:
            self._handle.publish_feedback(feedback)

    # -- callbacks -----------------------------------------------------------------------------------

    async def _execute(self, handle: ServerGoalHandle) -> FormPart.Result:
        self._handle, self._paused = handle, False
        self._cell = GraphCell(self._client, self._monitor, self, self, self._settings)
        try:
            result = await in_thread(partial(self._form, self._cell, handle.request), self.executor)
        finally:
            self._cell, self._handle = None, None
        if result.code == ErrorCode.OK:
            handle.succeed()
        elif result.code == ErrorCode.CANCELLED:
            handle.canceled()
        else:
            self.get_logger().error(f"part ended: [{result.code}] {result.message}")
            handle.abort()
        return result

    def _form(self, cell: GraphCell, request: FormPart.Goal) -> FormPart.Result:
        """Form the part in a worker thread."""
        started = time.monotonic()
        try:
            goal = self._goal_of(request)
        except IsfError as error:
            return FormPart.Result(code=int(error.code), message=error.message)
        keeper = None if self._checkpoint is None else PartKeeper(self._checkpoint, cell, self)
        run = PartRun(cell, goal, self, keeper)
        failed = run.run()
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

    def _goal_of(self, request: FormPart.Goal) -> PartGoal:
        """Raises IsfError of job, options and checkpoint."""
        if request.resume:
            if self._checkpoint is None:
                raise IsfError(
                    ErrorCode.FILE_NOT_FOUND,
                    "the executive keeps no checkpoint",
                    where="parameter checkpoint",
                    advice="start it with the folder of the part that is to go on",
                )
            _check_request(request, self._checkpoint.read())
            return PartGoal.resumed(self._checkpoint.take_up())
        force = None if np.isnan(request.support_force) else float(request.support_force)
        options = RunOptions(request.correction or None, force, request.world, request.seed, sheet_kind(request.sheet))
        return PartGoal(JobFile(request.job_text, Path(request.base_folder), "job"), options, request.first_index)

    def _on_result(self, message: ContourResult) -> None:
        if self._cell:
            self._cell.on_result(result_from_message(message))

    def _on_correction(self, message: ContourCorrection) -> None:
        if self._cell:
            self._cell.on_correction(correction_from_message(message))

    def _on_machine_state(self, message: MachineState) -> None:
        self._monitor.stream(MACHINE)
        if self._cell:
            self._cell.on_machine_state(message)

    def _on_force_ctrl(self, message: ForceCtrlState) -> None:
        if self._cell:
            self._cell.on_force_ctrl(message)

    def _on_pose(self, _: PoseStamped) -> None:
        self._monitor.stream(MACHINE)

    def _on_event(self, message: MachineEvent) -> None:
        if self._cell:
            self._cell.on_event(event_of_message(message))

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        own = self.get_namespace().rstrip("/") + "/"
        for status in message.status:
            if status.name.startswith(own):
                values = {item.key: item.value for item in status.values}
                name = status.name.removeprefix(own)
                told = (values.get(key, "") for key in ("state", "process", "version"))
                self._monitor.hear(name, status.message, *told)
                if name == "recorder" and self._cell:
                    self._cell.on_recorder(values.get("silent", ""), values.get("output", ""))

    def _on_pause(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        self._paused = request.data
        response.success = self._cell is not None
        response.message = "pausing after this contour" if request.data else "going on"
        if not response.success:
            response.message = "no part is being formed"
            self._paused = False
        return response


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
