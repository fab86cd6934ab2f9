"""Messages of the node: transforms, and the sheet as a marker."""

from __future__ import annotations

from typing import Any

from geometry_msgs.msg import Point, TransformStamped
from isf_core.types import Array, Indices
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker

from isf_description.surface import height_colours
from isf_description.tree import Joint

BLANK = (0.75, 0.79, 0.84)
"""Red, green, blue of a sheet whose depth nobody has scanned."""


def transform_message(joint: Joint, position: float, stamp: Any, prefix: str) -> TransformStamped:
    """How the child of ``joint`` stands in its parent at ``position`` m or rad."""
    place, turn = joint.transform(position)
    message = TransformStamped(child_frame_id=prefix + joint.child)
    message.header.frame_id, message.header.stamp = prefix + joint.parent, stamp
    moved, turned = message.transform.translation, message.transform.rotation
    moved.x, moved.y, moved.z = place
    turned.x, turned.y, turned.z, turned.w = turn
    return message


def sheet_marker(vertices: Array, triangles: Indices, frame: str, stamp: Any) -> Marker:
    """The upper surface of the sheet, ``vertices`` (V, 3) m and ``triangles`` (T, 3), coloured by height."""
    marker = _marker(Marker.TRIANGLE_LIST, frame, stamp)
    marker.scale.x = marker.scale.y = marker.scale.z = 1.0
    points = [Point(x=x, y=y, z=z) for x, y, z in vertices.tolist()]
    colours = [ColorRGBA(r=r, g=g, b=b, a=1.0) for r, g, b in height_colours(vertices[:, 2]).tolist()]
    order = triangles.ravel().tolist()
    marker.points = [points[k] for k in order]  # a vertex is one object, however many triangles share it
    marker.colors = [colours[k] for k in order]
    if not order:
        marker.action = Marker.DELETE
    return marker


def blank_marker(size: tuple[float, float], thickness: float, frame: str, stamp: Any) -> Marker:
    """The flat blank between the clamps, ``size`` m in x and y; paths and tools below it are seen through it."""
    marker = _marker(Marker.CUBE, frame, stamp)
    marker.scale.x, marker.scale.y, marker.scale.z = *size, thickness
    marker.pose.position.z = -0.5 * thickness
    red, green, blue = BLANK
    marker.color = ColorRGBA(r=red, g=green, b=blue, a=0.35)
    return marker


def _marker(kind: int, frame: str, stamp: Any) -> Marker:
    marker = Marker(type=kind, action=Marker.ADD, ns="sheet", id=0)
    marker.header.frame_id, marker.header.stamp = frame, stamp
    marker.pose.orientation.w = 1.0
    marker.color.a = 1.0
    return marker
