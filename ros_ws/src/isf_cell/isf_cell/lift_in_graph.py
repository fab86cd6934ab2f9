"""The tool lift between two contours through the node graph: the action of force_ctrl, and the topic for springback."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from isf_core.contour import ContourResult, contour_label
from isf_core.errors import ErrorCode, IsfError
from isf_msgs.action import LiftTool
from isf_ros import stamps
from isf_ros.conversion import lift_to_cloud
from sensor_msgs.msg import PointCloud2

from isf_cell.graph_client import GraphClient, Watch
from isf_cell.lift_between import NO_ROWS, SETTINGS, lift_rows


def lift_in_graph(
    client: GraphClient, watch: Watch, result: ContourResult, timeout: float, tell: Callable[[str], None]
) -> PointCloud2:
    """Lift the tool after the contour of ``result``; the message for ``tool_lift``, without points when it failed.

    Raises
    ------
    IsfError : NODE_DIED, CANCELLED; every other failure is told, and the part goes on without
    """
    goal = LiftTool.Goal(speed=SETTINGS.speed, zero_force=SETTINGS.zero_force, max_lift=SETTINGS.max_lift)
    rows = NO_ROWS
    try:
        found = client.run_action(LiftTool, "lift_tool", goal, watch, lambda _: None, timeout=timeout)
        if found.code:
            tell(f"the tool lift after {contour_label(result.index)} failed: {found.message}")
        else:
            rows = lift_rows(
                result, found.springback, found.force, np.asarray(found.lift_z), np.asarray(found.lift_force)
            )
    except IsfError as error:
        if error.code in (ErrorCode.NODE_DIED, ErrorCode.CANCELLED):
            raise
        tell(f"no tool lift after {contour_label(result.index)}: {error}")
    return lift_to_cloud(rows, stamps.from_seconds(result.end))
