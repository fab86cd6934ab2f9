"""The topics of a cell: name, type and kind of delivery of each, as in docs/architecture.md.

Names are relative to the namespace of the cell, except those that begin with a slash. The kinds are the names of the
profiles in ``isf_node.qos``; ``DEFAULT`` is the ROS default (reliable, volatile).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Delivery = Literal["STREAM", "SENSOR", "LATCHED", "EVENT", "DEFAULT"]


@dataclass(frozen=True)
class Topic:
    """One topic of a cell: its name, ``package/msg/Type`` and kind of delivery."""

    name: str
    type: str
    delivery: Delivery


JOB = Topic("part/info", "isf_msgs/msg/JobInfo", "LATCHED")
TARGET = Topic("part/target", "sensor_msgs/msg/PointCloud2", "LATCHED")
SCAN = Topic("scan", "sensor_msgs/msg/PointCloud2", "LATCHED")
NOMINAL = Topic("contour/nominal", "isf_msgs/msg/Contour", "LATCHED")
CORRECTED = Topic("contour/corrected", "isf_msgs/msg/Contour", "LATCHED")
CORRECTION = Topic("contour/correction", "isf_msgs/msg/ContourCorrection", "EVENT")
RESULT = Topic("contour/result", "isf_msgs/msg/ContourResult", "EVENT")
LIFT = Topic("tool_lift", "sensor_msgs/msg/PointCloud2", "LATCHED")
EVENT = Topic("machine/event", "isf_msgs/msg/MachineEvent", "EVENT")
MACHINE_STATE = Topic("machine/state", "isf_msgs/msg/MachineState", "STREAM")

CELL = (
    Topic("tool_1/wrench", "geometry_msgs/msg/WrenchStamped", "STREAM"),
    Topic("tool_2/wrench", "geometry_msgs/msg/WrenchStamped", "STREAM"),
    Topic("tool_1/raw", "geometry_msgs/msg/WrenchStamped", "SENSOR"),
    Topic("tool_2/raw", "geometry_msgs/msg/WrenchStamped", "SENSOR"),
    Topic("tool_1/raw_cells", "sensor_msgs/msg/JointState", "SENSOR"),
    Topic("tool_2/raw_cells", "sensor_msgs/msg/JointState", "SENSOR"),
    Topic("tool_1/target", "geometry_msgs/msg/PoseStamped", "STREAM"),
    Topic("tool_2/target", "geometry_msgs/msg/PoseStamped", "STREAM"),
    Topic("tool_1/pose", "geometry_msgs/msg/PoseStamped", "SENSOR"),
    Topic("tool_2/pose", "geometry_msgs/msg/PoseStamped", "SENSOR"),
    Topic("tool_1/path", "nav_msgs/msg/Path", "LATCHED"),
    Topic("tool_2/path", "nav_msgs/msg/Path", "LATCHED"),
    TARGET,
    Topic("part/markers", "visualization_msgs/msg/MarkerArray", "LATCHED"),
    JOB,
    NOMINAL,
    CORRECTED,
    CORRECTION,
    RESULT,
    Topic("force_ctrl/state", "isf_msgs/msg/ForceCtrlState", "STREAM"),
    Topic("holder/target", "geometry_msgs/msg/PoseStamped", "STREAM"),
    MACHINE_STATE,
    EVENT,
    SCAN,
    LIFT,
    Topic("/clock", "rosgraph_msgs/msg/Clock", "SENSOR"),
    Topic("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", "DEFAULT"),
)
"""All topics of a cell, which the recorder takes unless told otherwise. Those that nobody publishes stay empty: raw
readings come where nodes ``load_cell`` turn them into wrenches, by whatever delivery their driver has."""
