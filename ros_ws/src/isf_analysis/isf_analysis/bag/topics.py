"""The topics of a cell: name, type and kind of delivery of each, and the message types to read and write them.

As in docs/reference/architecture.md. Names are relative to the namespace of the cell, except those that begin with a
slash. The kinds are the names of the profiles in ``isf_ros.qos``; ``DEFAULT`` is the ROS default (reliable, volatile).
Types come from the ``.msg`` files of ``isf_msgs``, without ROS.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Literal

import numpy as np
from isf_core.errors import ErrorCode, IsfError
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

Delivery = Literal["STREAM", "SENSOR", "LATCHED", "EVENT", "CHANGES", "DEFAULT"]


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
FORMED_SHEET = Topic("machine/formed_sheet", "sensor_msgs/msg/PointCloud2", "LATCHED")
RELEASED_PART = Topic("machine/released_part", "sensor_msgs/msg/PointCloud2", "LATCHED")
LIFT = Topic("tool_lift", "sensor_msgs/msg/PointCloud2", "LATCHED")
EVENT = Topic("machine/event", "isf_msgs/msg/MachineEvent", "EVENT")
ARMED = Topic("force_ctrl/armed", "isf_msgs/msg/ForceCtrlArmed", "LATCHED")
MACHINE_STATE = Topic("machine/state", "isf_msgs/msg/MachineState", "STREAM")
DIAGNOSTICS = Topic("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", "DEFAULT")

WRENCHES = tuple(Topic(f"tool_{k}/wrench", "geometry_msgs/msg/WrenchStamped", "STREAM") for k in (1, 2))
POSES = tuple(Topic(f"tool_{k}/pose", "geometry_msgs/msg/PoseStamped", "SENSOR") for k in (1, 2))

TRANSFORMS = "tf2_msgs/msg/TFMessage"
"""Type of topics on which each of several nodes tells its own frames."""

CELL = (
    *WRENCHES,
    Topic("tool_1/raw", "geometry_msgs/msg/WrenchStamped", "SENSOR"),
    Topic("tool_2/raw", "geometry_msgs/msg/WrenchStamped", "SENSOR"),
    Topic("tool_1/raw_cells", "sensor_msgs/msg/JointState", "SENSOR"),
    Topic("tool_2/raw_cells", "sensor_msgs/msg/JointState", "SENSOR"),
    Topic("tool_1/target", "geometry_msgs/msg/PoseStamped", "STREAM"),
    Topic("tool_2/target", "geometry_msgs/msg/PoseStamped", "STREAM"),
    Topic("tool_1/target_twist", "geometry_msgs/msg/TwistStamped", "STREAM"),
    Topic("tool_2/target_twist", "geometry_msgs/msg/TwistStamped", "STREAM"),
    Topic("tool_1/joint_trajectory", "trajectory_msgs/msg/JointTrajectory", "STREAM"),
    Topic("tool_2/joint_trajectory", "trajectory_msgs/msg/JointTrajectory", "STREAM"),
    *POSES,
    Topic("machine/joint_commands", "sensor_msgs/msg/JointState", "STREAM"),
    Topic("machine/joint_states", "sensor_msgs/msg/JointState", "STREAM"),
    Topic("machine/legs", "sensor_msgs/msg/JointState", "SENSOR"),
    Topic("tool_1/path", "nav_msgs/msg/Path", "LATCHED"),
    Topic("tool_2/path", "nav_msgs/msg/Path", "LATCHED"),
    TARGET,
    Topic("part/markers", "visualization_msgs/msg/MarkerArray", "LATCHED"),
    Topic("part/sheet", "visualization_msgs/msg/Marker", "LATCHED"),
    Topic("contour/path", "nav_msgs/msg/Path", "LATCHED"),
    JOB,
    NOMINAL,
    CORRECTED,
    CORRECTION,
    RESULT,
    ARMED,
    Topic("force_ctrl/state", "isf_msgs/msg/ForceCtrlState", "STREAM"),
    Topic("executive/state", "isf_msgs/msg/ExecutiveState", "CHANGES"),
    Topic("force_ctrl/hand", "isf_msgs/msg/HandState", "CHANGES"),
    Topic("jog", "isf_msgs/msg/Jog", "STREAM"),
    Topic("joy", "sensor_msgs/msg/Joy", "SENSOR"),
    Topic("holder/target", "geometry_msgs/msg/PoseStamped", "STREAM"),
    MACHINE_STATE,
    EVENT,
    SCAN,
    FORMED_SHEET,
    RELEASED_PART,
    LIFT,
    Topic("joint_states", "sensor_msgs/msg/JointState", "STREAM"),
    Topic("robot_description", "std_msgs/msg/String", "LATCHED"),
    Topic("/clock", "rosgraph_msgs/msg/Clock", "SENSOR"),
    DIAGNOSTICS,
    Topic("/rosout", "rcl_interfaces/msg/Log", "DEFAULT"),
    Topic("/parameter_events", "rcl_interfaces/msg/ParameterEvent", "DEFAULT"),
    Topic("/tf", TRANSFORMS, "DEFAULT"),
    Topic("/tf_static", TRANSFORMS, "LATCHED"),
)
"""All topics of a cell, which the recorder takes unless told otherwise. Those that nobody publishes stay empty: raw
readings come where nodes ``load_cell`` turn them into wrenches, by whatever delivery their driver has. /tf is recorded
where tf2_msgs is installed."""


PACKAGE = "isf_msgs"


@cache
def cell_types() -> Typestore:
    """Types of ROS 2 Jazzy and of ``isf_msgs``.

    Raises
    ------
    IsfError : FILE_NOT_FOUND when the message definitions are not installed
    """
    store = get_typestore(Stores.ROS2_JAZZY)
    for path in sorted(message_folder().glob("*.msg")):
        store.register(get_types_from_msg(path.read_text(encoding="utf-8"), f"{PACKAGE}/msg/{path.stem}"))
    return store


@cache
def definition(name: str) -> str:
    """Definition of messages ``name`` ("isf_msgs/msg/Contour") as it goes into a bag, those it is made of included.

    Those of ``isf_msgs`` stand there as their authors wrote them: with units, and with constants before the field that
    takes them, where viewers look for the names of its values. A type store keeps neither.
    """
    whole, _ = cell_types().generate_msgdef(name, ros_version=2)
    first, *others = whole.split(f"{_BETWEEN_DEFINITIONS}MSG: ")
    parts = [_written(name, first)]
    for other in others:
        title, _, text = other.partition("\n")
        package, _, message = title.partition("/")
        parts.append(f"{_BETWEEN_DEFINITIONS}MSG: {title}\n" + _written(f"{package}/msg/{message}", text))
    return "".join(parts)


_BETWEEN_DEFINITIONS = "=" * 80 + "\n"


def _written(name: str, generated: str) -> str:
    if not name.startswith(f"{PACKAGE}/"):
        return generated
    return (message_folder() / f"{name.rsplit('/', 1)[-1]}.msg").read_text(encoding="utf-8")


def message_folder() -> Path:
    """Folder of the ``.msg`` files: ``share/isf_msgs/msg`` of an installed workspace, that of a wheel, which carries
    them, else the source tree."""
    prefixes = [Path(item) for item in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if item]
    folders = [prefix / "share" / PACKAGE / "msg" for prefix in prefixes]
    here = Path(__file__).resolve()
    folders += [here.parent / "msg", here.parents[3] / PACKAGE / "msg"]
    for folder in folders:
        if folder.is_dir():
            return folder
    raise IsfError(
        ErrorCode.FILE_NOT_FOUND,
        "the message definitions of isf_msgs are not installed",
        where=str(folders[-1]),
        advice="build the workspace and source its setup file",
    )


def make_message(name: str, /, **values: Any) -> Any:
    """Message of type ``name`` ("isf_msgs/msg/Contour") with ``values``; all other fields are zero or empty."""
    store = cell_types()
    fields = {field: values.pop(field, None) for field, _ in store.fielddefs[name][1]}
    if values:
        raise TypeError(f"{name} has no field {', '.join(values)}")
    for field, description in store.fielddefs[name][1]:
        if fields[field] is None:
            fields[field] = _zero(description)
    return store.types[name](**fields)


def _zero(description: Any) -> Any:
    kind, detail = description
    if kind == Nodetype.BASE:
        name = detail[0]
        return "" if name == "string" else False if name == "bool" else 0.0 if name.startswith("float") else 0
    if kind == Nodetype.NAME:
        return make_message(detail)
    (inner_kind, inner), length = detail
    count = length if kind == Nodetype.ARRAY else 0
    if inner_kind == Nodetype.BASE and inner[0] != "string":
        return np.zeros(count, dtype={"octet": "uint8", "byte": "uint8", "char": "uint8"}.get(inner[0], inner[0]))
    return [_zero((inner_kind, inner)) for _ in range(count)]
