"""``isf form``: starts the nodes of a cell as processes, has the executive form a part, ends everything."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any

import rclpy
from action_msgs.msg import GoalStatus
from action_msgs.srv import CancelGoal
from diagnostic_msgs.msg import DiagnosticArray
from isf_analysis.bag.open_bag import next_bag
from isf_core.errors import ErrorCode, IsfError, failure
from isf_core.files.job import JobFile
from isf_core.files.rig import tools_with_spindle_cells
from isf_core.files.yaml_file import find_named
from isf_msgs.action import FormPart
from isf_msgs.msg import ExecutiveState
from isf_msgs.srv import Stop
from isf_ros import qos
from isf_ros.process import join_graph
from isf_ros.process_identity import identity
from rclpy.action import ActionClient
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.task import Future

from isf_cell.options import RunOptions
from isf_cell.processes.cell_nodes import CellChoice, cell_nodes, operator_arguments
from isf_cell.processes.ctrl_c import ctrl_c_held_back
from isf_cell.processes.domain_lock import alone_in_domain, busy
from isf_cell.processes.process_group import NodeProcess, ProcessGroup
from isf_cell.run.checkpoint import CHECKPOINT
from isf_cell.run.served import Served

START_TIMEOUT = 180.0
"""s for all nodes to come up; the first start after a build compiles kernels, and a busy computer takes a minute."""

LISTENING = 4.0
"""s for which a client listens at least before its cell forms: participants announce themselves every 3 s (what is said
once, at the start, may be missed), and an executive tells its process 2 times a second. Nodes take as long to start."""

PATIENCE = 0.02
"""s for which a client waits for a message before it looks whether Ctrl-C came: that has to stop tools within 50 ms."""

FIND_TIMEOUT = 30.0
"""s to find a cell that is up, with the start of the recorder beside it."""

CANCEL_TIME, STOP_TIME = 3.0, 0.5
"""s for a part to be left along its path, and for the machine to confirm that it holds: a cell ends within 5 s."""

Feedback = Callable[[FormPart.Feedback], None]


def start_cell(
    group: ProcessGroup,
    bag: Path | None,
    *,
    lockstep: bool,
    job_file: JobFile | None = None,
    checkpoint: Path | None = None,
    relayed: Sequence[str] = (),
) -> None:
    """Start the five nodes; with a ``bag`` folder the recorder too, and the node that makes frames and scene.

    These go into the bag: a viewer that opens it later shows the machine and the sheet, without ROS. Beside the bag the
    recorder writes the text log (:func:`text_log_beside`).

    Where the rig of ``job_file`` has spindle cells the machine gives out their voltages, and a node ``load_cell_k`` of
    each such tool makes the wrench. ``checkpoint``: folder of the part's. ``relayed``:
    rules FROM:=TO for what force control hears by another name.
    """
    tools: tuple[int, ...] = ()
    rig = ""
    if job_file is not None:
        tools = tools_with_spindle_cells(job_file.rig)
        rig = str(find_named("rigs", job_file.job.rig, job_file.base))
    choice = CellChoice(
        lockstep=lockstep,
        load_cells=tools,
        tilts=job_file is not None and job_file.tilts,
        rig=rig,
        bag="" if bag is None else str(bag),
        text_log="" if bag is None else str(text_log_beside(bag)),
        checkpoint="" if checkpoint is None else str(checkpoint),
        viewers=bag is not None,
    )
    start_nodes(group, choice, relayed)


def start_nodes(group: ProcessGroup, choice: CellChoice, relayed: Sequence[str] = ()) -> None:
    """Start the nodes of a cell; ``relayed`` as of :func:`start_cell`."""
    for node in cell_nodes(choice):
        name = "" if node.name == node.executable else node.name
        remap = [f"{own}:={other}" for own, other in node.remap]
        remap += relayed if node.name == "force_ctrl" else ()
        group.start(node.package, node.executable, node.parameters, name=name, remap=remap, outlives=node.outlives)


def text_log_beside(bag: Path) -> Path:
    """``operator_log.txt`` beside ``bag``; of the bags of a part that went on, bag-2 and so on, operator_log-2.txt."""
    return bag.with_name(bag.name.replace("bag", "operator_log", 1) + ".txt")


class CellClient:
    """A client of the executive: waits for the cell, forms one part, can cancel it."""

    def __init__(self) -> None:
        join_graph(operator_arguments())
        self._node = Node(f"isf_command_{os.getpid()}")
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self._node)
        self._listens_since = time.monotonic()
        self._states: dict[str, str] = {}
        self._executives: set[str] = set()
        self._node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 50)
        self._action = ActionClient(self._node, FormPart, "form_part")
        self._busy = False
        self._node.create_subscription(ExecutiveState, "executive/state", self._on_executive, qos.CHANGES)

    def close(self) -> None:
        """Leave the graph."""
        self._executor.remove_node(self._node)
        self._action.destroy()  # else it keeps the node in the graph until a garbage collection
        self._node.destroy_node()
        rclpy.try_shutdown()

    def forget(self) -> None:
        """Nodes were started again: what was heard of them before says nothing."""
        self._states.clear()
        self._executives.clear()

    def wait_ready(self, group: ProcessGroup) -> None:
        """Wait until the executive serves and every started node gives signs of life.

        Raises IsfError NODE_DIED, NODE_MISSING, or BUSY when a node of another cell answers in this ROS domain.
        """
        names = [node.name for node in group.nodes]
        own = {str(node.popen.pid) for node in group.nodes}

        def ready() -> bool:
            self._refuse_foreign_cell(own)
            self._check_own(group, ", while starting")
            active = all(self._states.get(name) == "active" for name in ("executive", "recorder") if name in names)
            heard = all(name in self._states for name in names) and self._action.server_is_ready()
            return active and heard and time.monotonic() > self._listens_since + LISTENING

        if not self._spin_until(ready, START_TIMEOUT):
            missing = [name for name in names if name not in self._states] or ["executive"]
            raise IsfError(
                ErrorCode.NODE_MISSING,
                f"not up after {START_TIMEOUT:g} s: {', '.join(missing)}",
                advice=f"see the logs in {group.log_folder}; ./isf doctor checks the installation",
            )

    def find_cell(self, group: ProcessGroup) -> None:
        """Wait for the executive of a cell that is up, and for the nodes of ``group``, which are beside it and have to
        know those of the cell: what is said once, by a publisher that is not known yet, is missed.

        Raises IsfError NODE_MISSING without a cell, NODE_DIED.
        """
        up = math.inf

        def ready() -> bool:
            nonlocal up
            self._check_own(group)
            if all(self._states.get(node.name) == "active" for node in group.nodes):
                up = min(up, time.monotonic())
            return self._action.server_is_ready() and time.monotonic() > up + LISTENING

        if self._spin_until(ready, FIND_TIMEOUT):
            return
        domain = os.environ.get("ROS_DOMAIN_ID") or "0"
        raise IsfError(
            ErrorCode.NODE_MISSING,
            f"no cell that forms parts answers in ROS domain {domain}",
            advice="start one: isf cell JOB; without --attach isf form starts its own",
        )

    def stay(self, group: ProcessGroup) -> None:
        """Until Ctrl-C (KeyboardInterrupt); raises IsfError NODE_DIED when a process of ``group`` ends before."""

        def died() -> bool:
            self._check_own(group)
            return False

        self._spin_until(died, None)

    def end_cell(self) -> None:
        """Cancel the part that is formed, and have the machine release the tools where that takes long; never raises.

        A cancelled part is left along its path, tools lifted clear.
        """
        cancel = self._node.create_client(CancelGoal, "form_part/_action/cancel_goal")
        stop = self._node.create_client(Stop, "machine/stop")
        try:
            if self._busy and cancel.service_is_ready():
                cancel.call_async(CancelGoal.Request())  # a request without an id is for all goals
                self._spin_until(lambda: not self._busy, CANCEL_TIME)
            if stop.service_is_ready():
                told = stop.call_async(Stop.Request(reason="the cell ends"))
                self._spin_until(told.done, STOP_TIME)
        finally:
            self._node.destroy_client(cancel)
            self._node.destroy_client(stop)

    @staticmethod
    def _check_own(group: ProcessGroup, when: str = "") -> None:
        for node in group.dead():
            raise _died(node, when)

    def _on_executive(self, message: ExecutiveState) -> None:
        self._busy = message.busy

    def form(
        self,
        job_file: JobFile,
        options: RunOptions,
        feedback: Feedback,
        group: ProcessGroup,
        *,
        resume: bool = False,
        checkpoint: Path | None = None,
    ) -> Any:
        """Result of ``form_part``; Ctrl-C cancels the part and still returns its result.

        ``checkpoint``: folder that a cell keeps the part in which is not of this process, and goes on without it; None:
        that of the executive.
        """
        goal = FormPart.Goal(
            job_text=job_file.text,
            base_folder=str(job_file.base),
            correction=options.correction or "",
            support_force=options.support_force_field(),
            world=options.variant,
            seed=options.seed,
            sheet=options.sheet or "",
            resume=resume,
            checkpoint="" if checkpoint is None else str(checkpoint.absolute()),
            process="" if checkpoint is None else identity(),
        )
        handle = self._wait(
            self._action.send_goal_async(goal, feedback_callback=lambda message: feedback(message.feedback)), group
        )
        if not handle.accepted:
            raise IsfError(ErrorCode.BUSY, "the executive refused the part", advice="wait until its present part ends")
        result = handle.get_result_async()
        try:
            response = self._wait(result, group)
        except KeyboardInterrupt:
            handle.cancel_goal_async()
            with suppress(KeyboardInterrupt):
                response = self._wait(result, group, timeout=90.0)
                return response.result
            raise
        if response.status == GoalStatus.STATUS_UNKNOWN:
            raise IsfError(ErrorCode.NODE_DIED, "the executive lost the part")
        return response.result

    def _wait(self, future: Future, group: ProcessGroup, timeout: float | None = None) -> Any:
        executive = next((node for node in group.nodes if node.name == "executive"), None)
        served = Served(self._action.server_is_ready, "the executive")

        def done() -> bool:
            if executive is not None and not executive.alive:
                raise _died(executive)
            if executive is None:  # of a cell that is up
                served.check()
            return future.done()

        if not self._spin_until(done, timeout):
            raise IsfError(ErrorCode.SERVICE_TIMEOUT, "the executive did not answer in time")
        return future.result()

    def _spin_until(self, condition: Callable[[], bool], timeout: float | None) -> bool:
        deadline = None if timeout is None else time.monotonic() + timeout
        with ctrl_c_held_back() as let_ctrl_c_through:
            while not condition():
                if deadline is not None and time.monotonic() > deadline:
                    return False
                let_ctrl_c_through()
                self._executor.spin_once(timeout_sec=PATIENCE)
        return True

    def _refuse_foreign_cell(self, own: set[str]) -> None:
        if self._executives <= own:
            return
        raise busy(os.environ.get("ROS_DOMAIN_ID") or "0")

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            values = {item.key: item.value for item in status.values}
            name = status.name.rsplit("/", 1)[-1]
            self._states[name] = values.get("state", "")
            if name == "executive":
                self._executives.add(values.get("pid", ""))


def form(
    job_file: JobFile,
    options: RunOptions,
    folder: Path,
    feedback: Feedback,
    *,
    lockstep: bool = True,
    resume: bool = False,
    dashboard_port: int | None = None,
) -> tuple[Any, IsfError | None]:
    """Form one part with a cell of its own; returns the action's result and its failure, if any.

    ``folder`` receives ``bag``, ``logs`` and ``checkpoint``; with ``resume`` the part of its checkpoint goes on, in a
    bag beside the first. ``dashboard_port``: of a page beside the run; its token is in the environment
    (:data:`isf_dashboard.server.TOKEN_VARIABLE`). All processes are ended before this returns. A part that was formed
    while its recorder ended or could not write has the failure BAG_INCOMPLETE.
    """
    bag, logs = _bag_and_logs(folder, resume=resume)
    with alone_in_domain(), ExitStack() as stack:
        client = CellClient()
        stack.callback(client.close)
        with ProcessGroup(logs) as group:
            if dashboard_port is not None:
                group.start("isf_dashboard", "dashboard", {"port": dashboard_port}, outlives=True)
            start_cell(group, bag, lockstep=lockstep, job_file=job_file, checkpoint=folder / CHECKPOINT)
            client.wait_ready(group)
            result = _result_of(client, job_file, options, feedback, group, resume=resume)
            recorder = group["recorder"]
            ended_early = not recorder.alive
    return result, _failure(result, bag, recorder, ended_early=ended_early)


def form_attached(
    job_file: JobFile, options: RunOptions, folder: Path, feedback: Feedback, *, resume: bool = False
) -> tuple[Any, IsfError | None]:
    """Form one part with the cell that is up in this ROS domain; as :func:`form`.

    The recorder alone is started here, and ended.
    """
    bag, logs = _bag_and_logs(folder, resume=resume)
    with ExitStack() as stack:
        client = CellClient()
        stack.callback(client.close)
        with ProcessGroup(logs) as group:
            wanted = {"output": str(bag), "autostart": True, "text_log": str(text_log_beside(bag))}
            group.start("isf_analysis", "recorder", wanted)
            client.find_cell(group)
            kept = folder / CHECKPOINT
            result = _result_of(client, job_file, options, feedback, group, resume=resume, checkpoint=kept)
            recorder = group["recorder"]
            ended_early = not recorder.alive
    return result, _failure(result, bag, recorder, ended_early=ended_early)


def _bag_and_logs(folder: Path, *, resume: bool) -> tuple[Path, Path]:
    """Of a part in ``folder``; of one that goes on beside those before."""
    bag = next_bag(folder / "bag") if resume else folder / "bag"
    return bag, folder / bag.name.replace("bag", "logs")


def _result_of(client: CellClient, *asked: Any, resume: bool, checkpoint: Path | None = None) -> Any:
    """That of the action; of a cell whose executive is gone one that says so: what was formed is reported."""
    try:
        return client.form(*asked, resume=resume, checkpoint=checkpoint)
    except IsfError as error:
        return FormPart.Result(code=int(error.code), message=error.message)


def _failure(result: Any, bag: Path, recorder: NodeProcess, *, ended_early: bool) -> IsfError | None:
    """That of the action, else that of its record, as of :func:`incomplete_record`."""
    if result.code:
        return failure(result.code, result.message)
    return incomplete_record(bag, recorder, ended_early=ended_early)


def _died(node: NodeProcess, when: str = "") -> IsfError:
    return IsfError(ErrorCode.NODE_DIED, f"node '{node.name}' {node.end}{when}", advice=f"its output is in {node.log}")


def incomplete_record(bag: Path, recorder: NodeProcess, *, ended_early: bool) -> IsfError | None:
    """The failure of a part that was formed while its ``recorder``, ended by now, could not record all of it.

    ``ended_early``: before the part did.
    """
    if not ended_early and recorder.popen.returncode == 0:
        return None
    words = recorder.last_lines(1)
    return IsfError(
        ErrorCode.BAG_INCOMPLETE,
        "the recorder did not record to the end" + (f"; its last output:  {words}" if words else ""),
        where=str(bag),
        advice=f"check the free space of the disk, and the log {recorder.log}; what was recorded is reported",
    )
