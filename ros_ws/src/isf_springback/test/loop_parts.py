"""Loops of parts for the tests of control points: circles, rounded and sharp squares, arcs with known ends."""

from dataclasses import replace

import numpy as np
from springback_parts import cone_contour


def contour_of(ring, depth, index=0, spacing=0.5e-3, angle=45.0):
    """Contour at ``depth`` m through the closed line ``ring`` (K, 2) m, wall angle ``angle`` deg everywhere."""
    closed = np.vstack([ring, ring[:1]])
    position = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(closed, axis=0), axis=1))])
    n = round(position[-1] / spacing)
    at = np.arange(n) * position[-1] / n
    xy = np.column_stack([np.interp(at, position, closed[:, axis]) for axis in range(2)])
    ahead = np.roll(xy, -1, axis=0) - np.roll(xy, 1, axis=0)
    inward = np.column_stack([-ahead[:, 1], ahead[:, 0]]) / np.linalg.norm(ahead, axis=1)[:, None]
    wall = np.radians(angle)
    normal = np.column_stack([np.sin(wall) * inward, np.full(n, np.cos(wall))])
    contact = np.column_stack([xy, np.full(n, -depth)])
    return replace(
        cone_contour(index, count=100),
        contact=contact,
        normal=normal,
        wall_angle=np.full(n, wall),
        thickness=np.full(n, 1e-3),
        forming_tip=contact,
        support_tip=np.empty((0, 3)),
        support_force=np.empty(0),
    )


def arc(centre, radius, start, end, step=0.1e-3):
    """Points (K, 2) of an arc from angle ``start`` to ``end`` deg; a sense below zero turns clockwise."""
    count = max(3, round(abs(np.radians(end - start)) * radius / step))
    turn = np.radians(np.linspace(start, end, count))
    return np.asarray(centre) + radius * np.column_stack([np.cos(turn), np.sin(turn)])


def rounded_square(half, corner):
    """Counter-clockwise square with half side ``half`` and corner radius ``corner`` m (0: sharp)."""
    if corner == 0.0:
        corners = half * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
        return corners
    c = half - corner
    return np.vstack(
        [
            arc((c, c), corner, 0, 90),
            arc((-c, c), corner, 90, 180),
            arc((-c, -c), corner, 180, 270),
            arc((c, -c), corner, 270, 360),
        ]
    )


def pyramid_loops(half=60e-3, corner=40e-3, depth=20e-3, step=1e-3, angle=45.0):
    """Contours of a pyramid with rounded corners; inner loops are offsets of the outer one."""
    loops = []
    for index in range(round(depth / step)):
        inwards = (index + 1) * step / np.tan(np.radians(angle))
        ring = rounded_square(half - inwards, max(corner - inwards, 0.0))
        loops.append(contour_of(ring, (index + 1) * step, index))
    return loops
