"""Node ``springback``: corrects every contour before it is formed.

A solution may take longer than the silence after which a node counts as dead: corrections are made in a thread of their
own, in the order of the messages; services and heartbeat go on meanwhile.

Scans may come from any scanner: ``sensor_msgs/PointCloud2`` with float32 or float64 coordinates at any offset.
"""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from isf_core.errors import ErrorCode, IsfError
from isf_core.files import quantity
from isf_core.files.job import JobFile, load_job
from isf_core.files.own_folder import path_below
from isf_core.simulated_sheet import with_raised_force_limit
from isf_msgs.msg import Contour, ContourCorrection, ContourResult, JobInfo
from isf_msgs.srv import StateFile
from isf_ros import process, qos, stamps
from isf_ros.background import Worker, in_thread
from isf_ros.conversion import (
    cloud_points,
    contour_from_message,
    contour_to_message,
    correction_to_message,
    lift_from_cloud,
    result_from_message,
    target_from_message,
)
from isf_ros.lifecycle import CellNode
from isf_ros.parameters import parameter
from rcl_interfaces.msg import SetParametersResult
from rclpy.parameter import Parameter
from sensor_msgs.msg import PointCloud2

from isf_springback.methods import check_name, method_names
from isf_springback.session import CorrectionSession

WAITING_PERIOD = 0.1
"""s of wall time between two attempts at a contour that waits."""

T = TypeVar("T")


@dataclass(frozen=True)
class SpringbackParameters:
    """Parameters of the node."""

    method: str = parameter(
        "",
        f"correction method from the next contour on (auto, {', '.join(method_names())}); empty: the job's",
        read_only=False,
    )
    job: str = parameter("", "job file, for a cell whose executive does not publish part/info")
    base_folder: str = parameter(
        "", "folder that relative material and rig paths of the job in part/info refer to", read_only=False
    )
    state_folder: str = parameter(
        "correction_states",
        "folder below which springback/save writes and springback/load reads; relative to the working directory",
    )
    result_timeout: float = parameter(
        5.0,
        "wall time to wait for the job, the result, the tool lift and the scan before a contour",
        unit="s",
        minimum=0.0,
        maximum=3600.0,
    )


class SpringbackNode(CellNode[SpringbackParameters]):
    """Thin shell around :class:`isf_springback.session.CorrectionSession`, which belongs to the worker."""

    def __init__(self) -> None:
        super().__init__("springback", SpringbackParameters)
        self._session = CorrectionSession(self.values().result_timeout)
        self._news = threading.Event()  # something has been handed to the worker
        self._worker = Worker(lambda error: self.fault(error, "correction"))
        self._activation = 0
        self._done = 0
        self._last_code = 0
        self._solve_time = 0.0
        self.add_on_set_parameters_callback(self._check_parameters)

    def configure(self) -> None:
        """Raises IsfError METHOD_UNKNOWN or an error of the job file."""
        values = self.values()
        self._session = CorrectionSession(values.result_timeout)
        self._session.choose(values.method)
        if values.job:
            self._session.set_job(load_job(values.job))
        self._correction = self.create_publisher(ContourCorrection, "contour/correction", qos.EVENT)
        self._corrected = self.create_publisher(Contour, "contour/corrected", qos.LATCHED)
        self.create_subscription(JobInfo, "part/info", self._on_info, qos.LATCHED)
        self.create_subscription(Contour, "contour/nominal", self._on_nominal, qos.LATCHED)
        self.create_subscription(ContourResult, "contour/result", self._on_result, qos.EVENT)
        self.create_subscription(PointCloud2, "part/target", self._on_target, qos.LATCHED)
        self.create_subscription(PointCloud2, "tool_lift", self._on_lift, qos.LATCHED)
        self.create_subscription(PointCloud2, "scan", self._on_scan, qos.LATCHED)
        self.create_service(StateFile, "springback/save", self._on_save)
        self.create_service(StateFile, "springback/load", self._on_load)
        self.create_timer(WAITING_PERIOD, self._on_timer, clock=self.steady_clock)

    def deactivate(self) -> None:
        """What is being solved is not published any more."""
        self._activation += 1
        self._worker.add(self._session.drop)

    def health_values(self) -> dict[str, object]:
        return {
            "method": self._session.method_name,
            "contours": self._done,
            "last_code": self._last_code,
            "solve_time": f"{self._solve_time:.4f}",
        }

    def _check_parameters(self, changes: list[Parameter]) -> SetParametersResult:
        for change in changes:
            if change.name == "method":
                try:
                    if change.value:
                        check_name(change.value)
                    self._worker.add(partial(self._session.choose, change.value))
                except IsfError as error:
                    return SetParametersResult(successful=False, reason=error.message)
        return SetParametersResult(successful=True)

    def _on_info(self, message: JobInfo) -> None:
        try:
            job_file = JobFile(message.job_text, Path(self.values().base_folder or "."), message.job_name or "job")
            job_file = with_raised_force_limit(job_file, message.sheet)
        except IsfError as error:
            self.report(error)
            return
        self._go_on_with(lambda session: session.set_job(job_file, message.plan_id, message.correction))

    def _on_nominal(self, message: Contour) -> None:
        if not self.is_active:
            return
        contour = self._convert(contour_from_message, message)
        if contour is not None:
            self._go_on_with(lambda session: session.add_contour(contour))

    def _on_result(self, message: ContourResult) -> None:
        result = self._convert(result_from_message, message)
        if result is not None:
            self._go_on_with(lambda session: session.add_result(result))

    def _on_target(self, message: PointCloud2) -> None:
        try:
            target, preforms = target_from_message(message)
        except ValueError as error:
            self.report(IsfError(ErrorCode.CORRECTION_FAILED, f"the target is not a height map: {error}"))
            return
        self._worker.add(partial(self._session.set_target, target, preforms))

    def _on_lift(self, message: PointCloud2) -> None:
        try:
            rows = lift_from_cloud(message)
        except ValueError as error:
            self.report(IsfError(ErrorCode.LIFT_MISSING, f"not a tool lift: {error}", where="topic tool_lift"))
            return
        self._go_on_with(lambda session: session.add_lift(rows, stamp_seconds(message)))

    def _on_scan(self, message: PointCloud2) -> None:
        try:
            points = cloud_points(message)
        except ValueError as error:
            self.report(IsfError(ErrorCode.SCAN_INCOMPLETE, f"not a cloud of points: {error}", where="topic scan"))
            return
        self._go_on_with(lambda session: session.add_scan(points, stamp_seconds(message)))

    async def _on_save(self, request: StateFile.Request, response: StateFile.Response) -> StateFile.Response:
        return await self._answered(response, partial(self._save, request.path))

    async def _on_load(self, request: StateFile.Request, response: StateFile.Response) -> StateFile.Response:
        def load() -> None:
            if not request.path:
                self._in_worker(lambda session: session.forget())
                return
            folder = path_below(Path(self.values().state_folder).absolute(), request.path)
            self._in_worker(lambda session: session.load(folder))

        return await self._answered(response, load)

    async def _answered(self, response: StateFile.Response, work: Callable[[], None]) -> StateFile.Response:
        """``response`` with the code and text of what ``work`` raised; other callbacks are served meanwhile."""
        try:
            await in_thread(work, self.executor)
        except IsfError as error:
            response.code, response.message = int(error.code), error.message
            self.get_logger().warning(str(error))
        return response

    def _save(self, path: str) -> None:
        """When the news of the last contour are here, or as long after as they are waited for."""
        values = self.values()
        folder = path_below(Path(values.state_folder).absolute(), path)
        deadline = time.monotonic() + values.result_timeout
        while not self._in_worker(lambda session: session.complete) and (left := deadline - time.monotonic()) > 0.0:
            self._news.wait(left)
            self._news.clear()
        self._in_worker(lambda session: session.save(folder))

    def _in_worker(self, ask: Callable[[CorrectionSession], T]) -> T:
        """What ``ask`` finds in the session, to which only the worker has access."""
        session, answer = self._session, Future[T]()

        def work() -> None:
            try:
                answer.set_result(ask(session))
            except BaseException as error:  # raised where it was asked
                answer.set_exception(error)

        self._worker.add(work)
        return answer.result()

    def _convert(self, convert: Callable[[Any], T], message: Any) -> T | None:
        """Core object of a message; a malformed one is reported and dropped."""
        try:
            return convert(message)
        except ValueError as error:
            where = f"{type(message).__name__} {message.index} of {message.plan_id or '(no plan)'}"
            self.report(IsfError(ErrorCode.CONTOUR_REJECTED, f"malformed message: {error}", where=where))
            return None

    def _go_on_with(self, news: Callable[[CorrectionSession], None]) -> None:
        """Have the worker tell the session the ``news``, and correct the contour that waits if its time has come."""
        session, activation = self._session, self._activation
        self._worker.add(lambda: news(session))
        self._news.set()
        self._worker.add(lambda: self._advance(session, activation))

    def _on_timer(self) -> None:
        if self.is_active and self._worker.idle:
            session, activation = self._session, self._activation
            self._worker.add(lambda: self._advance(session, activation))

    def _advance(self, session: CorrectionSession, activation: int) -> None:
        """In the worker; ``activation`` is the one in which it was asked for."""
        if not self.is_active or activation != self._activation:
            return
        outcome = session.advance()
        if outcome is None or not self.is_active or activation != self._activation:
            return
        stamp = self.get_clock().now().to_msg()
        correction = outcome.correction
        self._done += 1
        self._last_code = correction.code
        self._solve_time = correction.solve_time
        if correction.code:
            self.report(IsfError(ErrorCode(correction.code), correction.message))
        else:
            self.report_ok()
        self._correction.publish(correction_to_message(correction, stamp))
        if outcome.corrected is not None:
            self._corrected.publish(contour_to_message(outcome.corrected, stamp))


def stamp_seconds(message: Any) -> float:
    """s, stamp of the message."""
    return float(stamps.to_seconds(message.header.stamp))


def main() -> None:
    """Entry point of the executable ``springback``."""
    quantity.parse("1 mm", "m")  # loads the units now: with the first job they would hold up the first contour
    sys.exit(process.run(SpringbackNode))


if __name__ == "__main__":
    main()
