"""Node ``planner``: plans parts on request (action ``plan_part``) and hands out their contours."""

from __future__ import annotations

import sys
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from isf_core.contour import Contour, contour_label
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile
from isf_core.types import Array
from isf_msgs.action import PlanPart
from isf_msgs.srv import GetContour
from isf_ros import process, qos
from isf_ros.background import in_thread
from isf_ros.conversion import contour_to_message, path_to_message, target_to_message
from isf_ros.lifecycle import CellNode
from isf_ros.parameters import parameter
from nav_msgs.msg import Path as PathMessage
from rclpy.action.server import ServerGoalHandle
from sensor_msgs.msg import PointCloud2
from visualization_msgs.msg import MarkerArray

from isf_planner.node_markers import plan_markers
from isf_planner.part_plan import Plan
from isf_planner.planning import plan


@dataclass(frozen=True)
class PlannerParameters:
    """Parameters of the node ``planner``."""

    plans_kept: int = parameter(
        8, "plans that get_contour can still serve; the oldest is dropped first", minimum=1, maximum=1000
    )
    path_poses: int = parameter(
        2000, "largest number of poses in tool_1/path and tool_2/path", minimum=1, maximum=1_000_000
    )


class PlannerNode(CellNode[PlannerParameters]):
    """ROS side of :func:`isf_planner.plan`."""

    def __init__(self) -> None:
        super().__init__("planner", PlannerParameters)
        self._plans: OrderedDict[str, Plan] = OrderedDict()
        self._busy = False

    # -- lifecycle ---------------------------------------------------------------------------------

    def configure(self) -> None:
        self._settings = self.values()
        self._target = self.create_publisher(PointCloud2, "part/target", qos.LATCHED)
        self._markers = self.create_publisher(MarkerArray, "part/markers", qos.LATCHED)
        self._paths = [self.create_publisher(PathMessage, f"tool_{k}/path", qos.LATCHED) for k in (1, 2)]
        self.create_service(GetContour, "planner/get_contour", self._on_get_contour)
        self.create_action_server(PlanPart, "plan_part", self._execute, lambda _: self.is_active and not self._busy)

    def cleanup(self) -> None:
        self._plans.clear()

    def health_values(self) -> dict[str, object]:
        return {"plans": len(self._plans), "busy": self._busy}

    # -- planning --------------------------------------------------------------------------------

    async def _execute(self, handle: ServerGoalHandle) -> PlanPart.Result:
        self._busy = True
        try:
            made = await in_thread(lambda: self._plan(handle), self.executor)
        except IsfError as error:
            if error.code == ErrorCode.PLAN_CANCELLED:
                handle.canceled()
            else:
                self.report(error)
                handle.abort()
            return PlanPart.Result(code=int(error.code), message=error.message)
        finally:
            self._busy = False
        self.report_ok()
        self._keep(made)
        self._publish(made)
        handle.succeed()
        return PlanPart.Result(
            plan_id=made.plan_id,
            count=len(made.contours),
            warnings=list(made.warnings),
            hold_after=list(made.hold_after),
        )

    def _plan(self, handle: ServerGoalHandle) -> Plan:
        request = handle.request
        job_file = JobFile(request.job_text, Path(request.base_folder or "."), "job")
        return plan(
            job_file,
            progress=lambda phase, share: handle.publish_feedback(PlanPart.Feedback(phase=phase, progress=share)),
            cancelled=lambda: bool(handle.is_cancel_requested),
        )

    def _keep(self, made: Plan) -> None:
        self._plans[made.plan_id] = made
        self._plans.move_to_end(made.plan_id)
        while len(self._plans) > self._settings.plans_kept:
            self._plans.popitem(last=False)

    def _on_get_contour(self, request: GetContour.Request, response: GetContour.Response) -> GetContour.Response:
        made = self._plans.get(request.plan_id)
        if made is None or request.index >= len(made.contours):
            known = ", ".join(self._plans) or "none"
            what = f"no plan '{request.plan_id}'" if made is None else f"no {contour_label(request.index)} in that plan"
            error = IsfError(ErrorCode.PLAN_UNKNOWN, what, advice=f"known plans: {known}; plan the part again")
            response.code, response.message = int(error.code), error.message
        else:
            response.contour = contour_to_message(made.contours[request.index], self._now())
        return response

    # -- views -------------------------------------------------------------------------------------

    def _publish(self, made: Plan) -> None:
        stamp = self._now()
        self._target.publish(target_to_message(made.target, made.preforms, stamp))
        for tool, publisher in enumerate(self._paths, 1):
            publisher.publish(path_to_message(tips_of(made.contours, tool), stamp, self._settings.path_poses))
        self._markers.publish(plan_markers(made, stamp))

    def _now(self) -> Any:
        return self.get_clock().now().to_msg()


def tips_of(contours: Sequence[Contour], tool: int) -> Array:
    """(N, 3) m, tips of ``tool`` (1 or 2) along all contours, which it forms or supports."""
    return np.vstack([one.forming_tip if one.forming_tool == tool else one.support_tip for one in contours])


def main(args: list[str] | None = None) -> None:
    """Entry point of ``ros2 run isf_planner planner``."""
    sys.exit(process.run(PlannerNode, args))


if __name__ == "__main__":
    main()
