"""Markers for RViz: colours by wall angle, warnings at their place."""

from __future__ import annotations

import numpy as np
from builtin_interfaces.msg import Time
from isf_core.geometry.height_map import HeightMap
from isf_planner import Plan
from isf_planner.node_markers import TEXT_LENGTH, plan_markers
from planner_contours import circle
from visualization_msgs.msg import Marker


def made(*warnings: str) -> Plan:
    contours = (circle(angle=np.radians(20)), circle(angle=np.radians(60), z=-8e-3))
    empty = np.zeros(1)
    return Plan(
        "hand-0", contours, HeightMap(empty, empty, empty[:, None]), (np.empty((0, 3)), np.empty((0, 3), int)), warnings
    )


def test_contours_are_coloured_by_wall_angle() -> None:
    clear, first, second = plan_markers(made(), Time()).markers
    assert clear.action == Marker.DELETEALL
    for marker in (first, second):
        assert marker.type == Marker.LINE_STRIP
        assert marker.header.frame_id == "sheet"
        assert len(marker.colors) == len(marker.points) > 100
        assert marker.points[0] == marker.points[-1]
    # viridis: dark for flat, yellow for the steepest
    assert second.colors[0].g > 0.9 > 0.5 > first.colors[0].g


def test_warnings_stand_at_their_place() -> None:
    long = "contour 3 at x = 12.5, y = -3.0, z = -4.0 mm: " + "too long " * 20
    markers = plan_markers(made("nothing to see", long), Time()).markers[3:]
    assert [(marker.ns, marker.id, marker.type) for marker in markers] == [
        ("warnings", 0, Marker.SPHERE),
        ("warnings", 1, Marker.TEXT_VIEW_FACING),
    ]
    place = markers[0].pose.position
    np.testing.assert_allclose([place.x, place.y, place.z], [12.5e-3, -3e-3, -4e-3])
    assert markers[1].text == f"{long[:TEXT_LENGTH]}..."
    assert markers[1].pose.position.z > place.z
