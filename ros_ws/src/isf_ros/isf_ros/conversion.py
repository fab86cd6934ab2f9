"""Core dataclasses to ROS messages and back; the only place where the two meet.

A tool lift travels as ``sensor_msgs/PointCloud2``: tip positions x, y, z (m, frame ``sheet``) with the axial force (N);
a thinned sheet as one of its nodes, with thickness (m) and strain margin.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import PoseStamped, WrenchStamped
from isf_core.contour import Contour, ContourCorrection, ContourResult
from isf_core.errors import ErrorCode, IsfError, failure
from isf_core.geometry.height_map import HeightMap
from isf_core.geometry.tool_axis import axis_of_quaternion, quaternion_of
from isf_core.thinned_sheet import ThinnedSheet
from isf_core.types import Array
from isf_msgs import msg as isf
from nav_msgs.msg import Path
from numpy.typing import NDArray
from sensor_msgs.msg import PointCloud2, PointField
from std_msgs.msg import Header

from isf_ros import fields, stamps

FRAME = "sheet"

contour_from_message = fields.contour_of
correction_from_message = fields.correction_of
result_from_message = fields.result_of
lift_from_cloud = fields.lift_of
thinned_sheet_from_cloud = fields.thinned_sheet_of
cloud_points = fields.cloud_columns


def contour_to_message(contour: Contour, stamp: Time | None = None) -> isf.Contour:
    """Message of a contour; ``stamp`` defaults to zero."""
    message = isf.Contour()
    _fill(message, contour, fields.CONTOUR, stamp)
    return message


def correction_to_message(correction: ContourCorrection, stamp: Time | None = None) -> isf.ContourCorrection:
    """Message of a correction."""
    message = isf.ContourCorrection()
    _fill(message, correction, fields.CORRECTION, stamp)
    return message


def result_to_message(result: ContourResult, stamp: Time | None = None) -> isf.ContourResult:
    """Message of a result."""
    message = isf.ContourResult()
    _fill(message, result, fields.RESULT, stamp)
    return message


def wrench_array(message: WrenchStamped) -> tuple[float, float, float, float, float, float]:
    """(6,) N and N m: force of the sheet on the tool, then torque."""
    force, torque = message.wrench.force, message.wrench.torque
    return (force.x, force.y, force.z, torque.x, torque.y, torque.z)


def set_wrench(message: WrenchStamped, wrench: Sequence[float] | NDArray[np.float64]) -> None:
    """Write (6,) N and N m into a message."""
    force, torque = message.wrench.force, message.wrench.torque
    force.x, force.y, force.z, torque.x, torque.y, torque.z = (float(value) for value in wrench)


def set_point_of(support_force: float) -> float | None:
    """N, set-point that the field ``support_force`` of a goal or of Arm asks for; None: that of the job.

    That is meant by NaN and by -1, which a field that was left out has; others are handed on, to be refused or held.
    """
    return None if math.isnan(support_force) or support_force == -1.0 else support_force


def machine_fault(state: isf.MachineState) -> IsfError:
    """The first fault of a machine that has one; MACHINE_FAULTED for a code of the driver's own."""
    text = (*state.fault_messages, "a fault is latched")[0]
    return failure(state.fault_codes[0], text, where="machine", otherwise=ErrorCode.MACHINE_FAULTED)


def tip_of(message: PoseStamped) -> tuple[float, float, float]:
    """(3,) m, tool tip of a pose."""
    position = message.pose.position
    return (position.x, position.y, position.z)


def set_tip(message: PoseStamped, tip: Sequence[float] | NDArray[np.float64]) -> None:
    """Write a tool tip (3,) m into a pose."""
    position = message.pose.position
    position.x, position.y, position.z = (float(value) for value in tip)


def axis_of(message: PoseStamped) -> tuple[float, float, float]:
    """(3,) unit, axis of the upper tool of a pose; NaN of a quaternion of zeros (isf_core.geometry.tool_axis)."""
    turn = message.pose.orientation
    return axis_of_quaternion((turn.x, turn.y, turn.z, turn.w))


def set_axis(message: PoseStamped, axis: Sequence[float] | NDArray[np.float64]) -> None:
    """Write the axis (3,) of the upper tool into a pose, without roll."""
    turn = message.pose.orientation
    turn.x, turn.y, turn.z, turn.w = quaternion_of(axis)


def make_pose() -> PoseStamped:
    """Pose in frame ``sheet`` without rotation, to be filled by :func:`set_tip`."""
    message = PoseStamped()
    message.header.frame_id = FRAME
    message.pose.orientation.w = 1.0
    return message


def make_wrench() -> WrenchStamped:
    """Wrench in axes of frame ``sheet``, to be filled by :func:`set_wrench`."""
    message = WrenchStamped()
    message.header.frame_id = FRAME
    return message


def path_to_message(tips: NDArray[np.float64], stamp: Time, most: int = 2000) -> Path:
    """``nav_msgs/Path`` of tips (N, 3) m, decimated to at most ``most`` poses: a view for people, not a command."""
    path = Path()
    path.header.frame_id = FRAME
    path.header.stamp = stamp
    step = max(1, -(-len(tips) // most))
    for tip in tips[::step]:
        pose = make_pose()
        set_tip(pose, tip)
        path.poses.append(pose)
    return path


def height_map_to_message(height_map: HeightMap, stamp: Time) -> PointCloud2:
    """Grid points x, y, z (float64) as a PointCloud2 of ny rows and nx columns."""
    return _table_to_cloud(height_map.points().reshape(*height_map.z.shape, 3), tuple("xyz"), stamp)


def points_to_cloud(points: Array, stamp: Time) -> PointCloud2:
    """Unordered points (N, 3) m as a cloud of one row, x, y, z as float64."""
    return _table_to_cloud(np.reshape(points, (1, -1, 3)), tuple("xyz"), stamp)


def height_map_from_message(message: Any) -> HeightMap:
    """Height map of a PointCloud2 (rclpy or bag) as written by :func:`height_map_to_message`; ValueError otherwise."""
    return fields.height_map_of(message)


def target_to_message(target: HeightMap, preforms: Sequence[HeightMap], stamp: Time) -> PointCloud2:
    """Message of ``part/target``: the wanted shape, and those of the stages before it on the same grid."""
    return _table_to_cloud(*fields.target_table(target, preforms), stamp)


def target_from_message(message: Any) -> tuple[HeightMap, tuple[HeightMap, ...]]:
    """Wanted shape and those of the stages before it, as written by :func:`target_to_message`; ValueError otherwise."""
    return fields.target_of(message)


def _fill(message: Any, source: Any, table: dict[str, str], stamp: Time | None) -> None:
    message.header.frame_id = FRAME
    if stamp is not None:
        message.header.stamp = stamp
    for name, kind in table.items():
        value = getattr(source, name)
        if kind in (fields.N, fields.N3):
            value = fields.to_flat(value)
        elif kind == fields.FLAGS:
            value = fields.to_flag_bytes(value)
        elif kind == fields.TEXTS:
            value = list(value)
        elif kind == fields.TIME:
            value = stamps.from_seconds(value)
        elif isinstance(value, np.generic):
            value = value.item()
        setattr(message, name, value)


_SIZE = 8


def lift_to_cloud(rows: Array, stamp: Time) -> PointCloud2:
    """The message of ``rows`` (K, 4): x, y, z in m, force in N."""
    return _table_to_cloud(np.asarray(rows, dtype="<f8").reshape(1, -1, len(fields.LIFT)), fields.LIFT, stamp)


def thinned_sheet_to_cloud(sheet: ThinnedSheet, stamp: Time) -> PointCloud2:
    """The message of a thinned sheet, in its rows and columns."""
    return _table_to_cloud(fields.thinned_sheet_table(sheet), fields.THINNED, stamp)


def _table_to_cloud(table: Array, names: tuple[str, ...], stamp: Time) -> PointCloud2:
    """Cloud of (rows, columns, K) with the K fields ``names``, float64."""
    table = np.ascontiguousarray(table, dtype="<f8")
    rows, columns, count = table.shape
    return PointCloud2(
        header=Header(stamp=stamp, frame_id=FRAME),
        height=rows,
        width=columns,
        fields=[
            PointField(name=name, offset=_SIZE * k, datatype=PointField.FLOAT64, count=1)
            for k, name in enumerate(names)
        ],
        is_bigendian=False,
        point_step=_SIZE * count,
        row_step=_SIZE * count * columns,
        data=table.tobytes(),
        is_dense=bool(np.isfinite(table).all()),
    )
