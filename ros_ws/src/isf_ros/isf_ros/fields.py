"""How the core dataclasses and the messages of the same name convert, by the types of their fields.

It needs no ROS: it serves rclpy messages (:mod:`isf_ros.conversion`) as well as messages read from a bag.
"""

from __future__ import annotations

import array
from collections.abc import Callable, Sequence
from typing import Any, get_type_hints

import numpy as np
from isf_core.contour import Contour, ContourCorrection, ContourResult, Process
from isf_core.geometry.height_map import HeightMap
from isf_core.thinned_sheet import ThinnedSheet
from isf_core.types import Array, Mask, Points, Stamp
from numpy.typing import NDArray

PART_FRAME = "part"
"""Frame of a part out of the clamp: it lies as it was put down, and no transform leads to it."""

SCALAR, TIME, N, N3, FLAGS, TEXTS = "scalar", "time", "(N,)", "(N, 3)", "(N,) bool", "(K,) str"

_KINDS = {Points: N3, Array: N, Mask: FLAGS, Stamp: TIME, tuple[str, ...]: TEXTS}


def table_of(of: type) -> dict[str, str]:
    """How every field of the dataclass ``of`` stands in the message of the same name, by its type."""
    return {name: _KINDS.get(kind, SCALAR) for name, kind in get_type_hints(of, include_extras=True).items()}


CONTOUR = table_of(Contour)
CORRECTION = table_of(ContourCorrection)
RESULT = table_of(ContourResult)


def to_flat(value: Any) -> array.array[float]:
    """One copy of an array of any shape as ``array.array('d')``, which rclpy takes without checking each element."""
    flat = array.array("d")
    flat.frombytes(np.ascontiguousarray(value, dtype=np.float64).reshape(-1).view(np.uint8).data)
    return flat


def to_flag_bytes(value: Any) -> array.array[int]:
    """Booleans as ``array.array('B')`` of 0 and 1."""
    flat = array.array("B")
    flat.frombytes(np.ascontiguousarray(value, dtype=np.uint8).reshape(-1).data)
    return flat


def from_flat(value: Any, columns: int = 1) -> NDArray[np.float64]:
    """View (no copy) of a message array as (N,) or (N, columns); raises ValueError when it does not divide."""
    flat = np.asarray(value, dtype=np.float64)
    return flat if columns == 1 else flat.reshape(-1, columns)


def values_of(message: Any, table: dict[str, str], to_seconds: Callable[[Any], float]) -> dict[str, Any]:
    """Constructor arguments of a core dataclass from a message; arrays are views of the message's memory."""
    values: dict[str, Any] = {}
    for name, kind in table.items():
        if not hasattr(message, name):
            continue  # a bag of an older version: the default of the dataclass
        value = getattr(message, name)
        if kind == N3:
            value = from_flat(value, 3)
        elif kind == N:
            value = from_flat(value)
        elif kind == FLAGS:
            value = np.asarray(value, dtype=np.uint8).astype(bool)
        elif kind == TEXTS:
            value = tuple(str(text) for text in value)
        elif kind == TIME:
            value = to_seconds(value)
        values[name] = value
    return values


def contour_of(message: Any) -> Contour:
    """Core contour of an ``isf_msgs/Contour`` from rclpy or from a bag."""
    values = values_of(message, CONTOUR, _no_time)
    values["process"] = Process(values["process"])
    return Contour(**values)


def correction_of(message: Any) -> ContourCorrection:
    """Core correction of an ``isf_msgs/ContourCorrection``."""
    return ContourCorrection(**values_of(message, CORRECTION, _no_time))


def result_of(message: Any) -> ContourResult:
    """Core result of an ``isf_msgs/ContourResult``."""
    return ContourResult(**values_of(message, RESULT, lambda stamp: int(stamp.sec) + int(stamp.nanosec) * 1e-9))


def height_map_of(message: Any) -> HeightMap:
    """Height map of a grid-shaped ``sensor_msgs/PointCloud2`` with FLOAT64 x, y, z; ValueError otherwise."""
    names = [f.name for f in message.fields]
    if names[:3] != ["x", "y", "z"] or message.point_step != 24:
        raise ValueError(f"expected a cloud of float64 x, y, z; this one has fields {names}")
    points = np.frombuffer(bytes(message.data), dtype="<f8").reshape(-1, 3)
    return HeightMap.from_points(points)


PREFORM = "z_stage_"
"""Field of the height after stage 1, 2 .. of a part that is formed in stages, without the last (``part/target``)."""


def target_of(message: Any) -> tuple[HeightMap, tuple[HeightMap, ...]]:
    """The wanted shape, and those that the stages before the last end with, of a message of ``part/target``.

    Raises ValueError when it is not a whole grid with floating-point fields x, y, z and ``z_stage_1``, ``z_stage_2`` ..
    """
    count = sum(field.name.startswith(PREFORM) for field in message.fields)
    columns = cloud_columns(message, ("x", "y", "z", *(f"{PREFORM}{k}" for k in range(1, count + 1))))
    target, *preforms = (HeightMap.from_points(columns[:, [0, 1, k]]) for k in range(2, columns.shape[1]))
    return target, tuple(preforms)


def target_table(target: HeightMap, preforms: Sequence[HeightMap]) -> tuple[NDArray[np.float64], tuple[str, ...]]:
    """(ny, nx, K) the K fields of a message of ``part/target``, and their names.

    ``preforms``, of the stages before the last, stand on the grid of ``target``.
    """
    names = ("x", "y", "z", *(f"{PREFORM}{k}" for k in range(1, len(preforms) + 1)))
    columns = np.hstack([target.points(), *(preform.z.reshape(-1, 1) for preform in preforms)])
    return columns.reshape(*target.z.shape, len(names)), names


_POINT_KINDS = {7: "f4", 8: "f8"}
"""Datatypes of ``sensor_msgs/PointField`` that coordinates and forces may have."""


def cloud_columns(message: Any, names: str | Sequence[str] = "xyz") -> NDArray[np.float64]:
    """(P, C), the fields ``names`` of every point of a ``sensor_msgs/PointCloud2`` from rclpy or from a bag.

    Raises ValueError when one is missing or not floating point, or the data is cut off.
    """
    described = {field.name: field for field in message.fields}
    if any(name not in described or described[name].datatype not in _POINT_KINDS for name in names):
        raise ValueError(f"needs floating-point {', '.join(names)}; this cloud has {sorted(described)}")
    order = ">" if message.is_bigendian else "<"
    kind = np.dtype(
        {
            "names": list(names),
            "formats": [order + _POINT_KINDS[described[name].datatype] for name in names],
            "offsets": [described[name].offset for name in names],
            "itemsize": message.point_step,
        }
    )
    data = bytes(message.data)
    if len(data) != message.width * message.height * message.point_step:
        raise ValueError(f"{len(data)} bytes are not {message.width} x {message.height} points")
    table = np.frombuffer(data, dtype=kind)
    return np.column_stack([table[name].astype(np.float64) for name in names])


LIFT = ("x", "y", "z", "force")
"""Fields of a tool lift: m and N."""


def lift_of(message: Any) -> Array:
    """(K, 4) m, N of a tool lift; raises ValueError when a field is missing or the data is cut off."""
    return cloud_columns(message, LIFT)


THINNED = ("x", "y", "z", "thickness", "strain_margin")
"""Fields of a thinned sheet: m, and true strain."""


def thinned_sheet_of(message: Any) -> ThinnedSheet:
    """Thinned sheet of a ``sensor_msgs/PointCloud2`` in rows and columns; ValueError when a field is missing, the data
    is cut off, or there are less than two rows or columns."""
    if min(message.height, message.width) < 2:
        raise ValueError(f"{message.height} x {message.width} nodes are not a sheet in rows and columns")
    table = cloud_columns(message, THINNED).reshape(message.height, message.width, len(THINNED))
    return ThinnedSheet(*(np.ascontiguousarray(part) for part in (table[..., :3], table[..., 3], table[..., 4])))


def thinned_sheet_table(sheet: ThinnedSheet) -> Array:
    """(ny, nx, 5), the fields THINNED of every node."""
    return np.dstack([sheet.points, sheet.thickness, sheet.strain_margin])


def _no_time(_: Any) -> float:
    raise TypeError("this message has no time fields")
