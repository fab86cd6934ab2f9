"""Points of a ``sensor_msgs/PointCloud2`` from any scanner: float32 or float64 coordinates at any offset."""

from __future__ import annotations

from typing import Any

import numpy as np
from isf_ros import stamps
from numpy.typing import NDArray

_KINDS = {7: "f4", 8: "f8"}
"""PointField datatypes that coordinates may have."""


def cloud_points(message: Any) -> NDArray[np.float64]:
    """(P, 3) m; ValueError when x, y, z are missing, not floating point, or the data is cut off."""
    fields = {field.name: field for field in message.fields}
    order = ">" if message.is_bigendian else "<"
    names, formats, offsets = [], [], []
    for name in "xyz":
        if name not in fields or fields[name].datatype not in _KINDS:
            raise ValueError(f"needs floating-point x, y, z; this cloud has {sorted(fields)}")
        names.append(name)
        formats.append(order + _KINDS[fields[name].datatype])
        offsets.append(fields[name].offset)
    kind = np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": message.point_step})
    data = bytes(message.data)
    if len(data) != message.width * message.height * message.point_step:
        raise ValueError(f"{len(data)} bytes are not {message.width} x {message.height} points")
    table = np.frombuffer(data, dtype=kind)
    return np.column_stack([table[name].astype(np.float64) for name in "xyz"])


def stamp_seconds(message: Any) -> float:
    """s, stamp of the message."""
    return float(stamps.to_seconds(message.header.stamp))
