"""What RViz shows of a plan: colours by wall angle, warnings at their place, the way of each tool."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from builtin_interfaces.msg import Time
from isf_core.geometry.height_map import HeightMap
from isf_planner import Plan
from isf_planner.node import tips_of
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


def test_the_way_of_a_tool_is_its_own_where_the_tools_swap() -> None:
    pocket = circle(tools=2)
    dome = replace(circle(z=3e-3, tools=2), forming_tool=2)
    contours = (pocket, dome, pocket)
    np.testing.assert_array_equal(
        tips_of(contours, 1), np.vstack([pocket.forming_tip, dome.support_tip, pocket.forming_tip])
    )
    np.testing.assert_array_equal(
        tips_of(contours, 2), np.vstack([pocket.support_tip, dome.forming_tip, pocket.support_tip])
    )
    assert len(tips_of((circle(),), 2)) == 0  # one tool alone
