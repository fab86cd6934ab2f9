"""Markers of a plan for RViz: contours coloured by wall angle, and what the plan warns of at its place."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
from geometry_msgs.msg import Point
from isf_core.contour import Contour
from isf_core.types import Array
from isf_ros.conversion import FRAME
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from isf_planner.part.warning_places import warning_places
from isf_planner.part_plan import Plan

MARKER_POINTS = 200
"""Points of a contour in the view for people."""

LINE_WIDTH, WARNING_SIZE, TEXT_SIZE = 0.2e-3, 2e-3, 3e-3
"""m"""

TEXT_LENGTH = 60
"""Letters of a warning that are shown beside its place."""


def plan_markers(plan: Plan, stamp: Any) -> MarkerArray:
    """All markers of a plan: earlier ones are deleted, contours (ns ``contours``), warnings (ns ``warnings``)."""
    # viewers keep markers by number: those of an earlier plan with more contours would stay
    markers = [Marker(action=Marker.DELETEALL)]
    markers += [_contour(contour, plan.largest_wall_angle, stamp) for contour in plan.contours]
    markers += _warnings(warning_places(plan.warnings), stamp)
    return MarkerArray(markers=markers)


def _contour(contour: Contour, largest_angle: float, stamp: Any) -> Marker:
    marker = _marker(Marker.LINE_STRIP, "contours", contour.index, stamp)
    marker.scale.x = LINE_WIDTH
    order = np.arange(0, len(contour), max(1, len(contour) // MARKER_POINTS))
    order = np.append(order, 0 if contour.closed else len(contour) - 1)
    marker.points = [Point(x=x, y=y, z=z) for x, y, z in contour.contact[order].tolist()]
    # the scale begins at the flat sheet, so that colours of two parts can be compared
    shares = contour.wall_angle[order] / max(largest_angle, 1e-9)
    marker.colors = [_colour(row) for row in mpl.colormaps["viridis"](shares)]
    marker.color = marker.colors[0]
    return marker


def _warnings(places: Sequence[tuple[Array, str]], stamp: Any) -> list[Marker]:
    """A sphere and its text for every warning that names a place."""
    markers = []
    for number, (place, text) in enumerate(places):
        sphere = _marker(Marker.SPHERE, "warnings", 2 * number, stamp)
        sphere.scale.x = sphere.scale.y = sphere.scale.z = WARNING_SIZE
        label = _marker(Marker.TEXT_VIEW_FACING, "warnings", 2 * number + 1, stamp)
        label.scale.z = TEXT_SIZE
        label.text = text if len(text) <= TEXT_LENGTH else f"{text[:TEXT_LENGTH]}..."
        for marker, height in ((sphere, 0.0), (label, 2 * TEXT_SIZE)):
            x, y, z = place.tolist()
            marker.pose.position = Point(x=x, y=y, z=z + height)
            marker.color = ColorRGBA(r=0.76, g=0.07, b=0.12, a=1.0)
        markers += [sphere, label]
    return markers


def _marker(kind: int, name: str, number: int, stamp: Any) -> Marker:
    marker = Marker(type=kind, action=Marker.ADD, ns=name, id=number)
    marker.header.frame_id, marker.header.stamp = FRAME, stamp
    marker.pose.orientation.w = 1.0
    return marker


def _colour(row: Array) -> ColorRGBA:
    r, g, b, a = row.tolist()
    return ColorRGBA(r=r, g=g, b=b, a=a)
