"""A tool lift as ``sensor_msgs/PointCloud2``: tip positions x, y, z (m, frame "sheet") with the axial force (N).

The first point is the loaded tool at rest, the last one where the force vanishes, in between the unloading curve in its
order. A cloud without points says that the measurement failed. The stamp is not older than the end of the contour after
which the tool was lifted.
"""

from __future__ import annotations

import numpy as np
from builtin_interfaces.msg import Time
from numpy.typing import NDArray
from sensor_msgs.msg import PointCloud2, PointField
from std_msgs.msg import Header

Array = NDArray[np.float64]

NAMES = ("x", "y", "z", "force")
_SIZE = 8


def lift_to_cloud(rows: Array, stamp: Time) -> PointCloud2:
    """The message of ``rows`` (K, 4): x, y, z in m, force in N."""
    table = np.ascontiguousarray(np.asarray(rows, dtype="<f8").reshape(-1, len(NAMES)))
    fields = [
        PointField(name=name, offset=_SIZE * k, datatype=PointField.FLOAT64, count=1) for k, name in enumerate(NAMES)
    ]
    step = _SIZE * len(NAMES)
    return PointCloud2(
        header=Header(stamp=stamp, frame_id="sheet"),
        height=1,
        width=len(table),
        fields=fields,
        is_bigendian=False,
        point_step=step,
        row_step=step * len(table),
        data=table.tobytes(),
        is_dense=True,
    )


def lift_from_cloud(message: PointCloud2) -> Array:
    """(K, 4) m, N; ValueError when a field is missing, not float64, or the data is cut off."""
    offsets = {field.name: field.offset for field in message.fields if field.datatype == PointField.FLOAT64}
    if not set(NAMES) <= set(offsets):
        raise ValueError(f"needs float64 fields {', '.join(NAMES)}; this cloud has {sorted(offsets)}")
    data = bytes(message.data)
    if len(data) != message.width * message.height * message.point_step:
        raise ValueError(f"{len(data)} bytes are not {message.width} x {message.height} points")
    order = ">" if message.is_bigendian else "<"
    kind = np.dtype(
        {
            "names": NAMES,
            "formats": [order + "f8"] * len(NAMES),
            "offsets": [offsets[name] for name in NAMES],
            "itemsize": max(int(message.point_step), _SIZE),
        }
    )
    table = np.frombuffer(data, dtype=kind)
    return np.column_stack([table[name].astype(np.float64) for name in NAMES])
