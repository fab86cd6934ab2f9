"""Turning of the tool by its spindle, contour by contour: at a speed of its own, or so that it rolls along the wall.

A ball of radius R that goes along a wall of angle a at the speed f touches it at R sin(a) from its axis. Where the
spindle turns f / (2 pi R sin(a)) times a second the contact is at rest on the sheet: the tool rolls, as it did on the
airfoil of Behera 2015, Case studies, which prints no formula.
Contours have one speed each, the one with the least slip (mean square over the path), as no spindle follows the points.
The sense follows from the side on which the wall stands: a contour that is run counter-clockwise inside of a pocket
asks for a clockwise turn. A tilted tool touches nearer to its axis and a flat tip farther from it, which is taken into
account. On a floor, and on what is nearly one, the ball touches with its pole, which hardly any speed makes roll: the
speed of the upper tool's contour before is kept, or that of its first wall.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from isf_core.contour import Contour
from isf_core.files.job import Job
from isf_core.files.tooling import ToolSpec
from isf_core.geometry.tool_axis import UP
from isf_core.types import Array

SPINDLE_TOOL = 1
"""The tool that turns: the upper one."""

FLATTEST = np.radians(5.0)
"""rad, wall angle up to which the speed before is kept (assumed: rolling there would take 11 times that of a wall)."""


def spindle_speeds(contours: Sequence[Contour], job: Job) -> tuple[float, ...]:
    """rad/s of the upper tool on each of the ``contours``, positive clockwise seen from above.

    0 where the lower tool forms; none at all without ``path.spindle``.
    """
    wanted = job.path.spindle
    if wanted == "none":
        return ()
    speeds: list[float] = []
    mine = [one for one in contours if _forms(one)]
    steep = next((one for one in mine if one.wall_angle.max() > FLATTEST), mine[0] if mine else None)
    kept = 0.0 if steep is None or wanted != "rolling" else _limited(steep, job)
    for contour in contours:
        if not _forms(contour):
            speeds.append(0.0)
        elif wanted != "rolling":
            speeds.append(wanted)
        else:
            if contour.wall_angle.max() > FLATTEST:
                kept = _limited(contour, job)
            speeds.append(kept)
    return tuple(speeds)


def _forms(contour: Contour) -> bool:
    return contour.forming_tool == SPINDLE_TOOL


def _limited(contour: Contour, job: Job) -> float:
    """rad/s, rolling, within the largest speed."""
    return float(np.clip(_rolling(contour, job.tool_1), -job.path.spindle_limit, job.path.spindle_limit))


def slip(contour: Contour, speed: float, tool: ToolSpec) -> float:
    """Mean speed of the contact on the sheet over the feed, 0 of a tool that rolls, 1 of one that does not turn.

    ``speed`` rad/s, positive clockwise seen from above, of the ``tool`` that forms the ``contour``.
    """
    feed, lever, way = _kinematics(contour, tool)
    return float((np.abs(feed - speed * lever) / feed * way).sum() / way.sum())


def _rolling(contour: Contour, tool: ToolSpec) -> float:
    """rad/s, positive clockwise, with the least slip along the contour."""
    feed, lever, way = _kinematics(contour, tool)
    return float((way * feed * lever).sum() / max((way * lever**2).sum(), np.finfo(float).tiny))


def _kinematics(contour: Contour, tool: ToolSpec) -> tuple[Array, Array, Array]:
    """At the N points of a contour: (N,) m/s feed, (N,) m lever of the contact about the axis, positive where a
    clockwise turn moves it backwards, and (N,) m of path."""
    tip = contour.forming_tip
    after, before = np.roll(tip, -1, axis=0), np.roll(tip, 1, axis=0)
    if not contour.closed:
        after[-1], before[0] = tip[-1], tip[0]
    along = after - before
    way = np.linalg.norm(along, axis=1)
    along = along / np.maximum(way, np.finfo(float).tiny)[:, None]
    axis = contour.forming_axis if contour.tilted else np.tile(UP, (len(contour), 1))
    outward = contour.normal * [1.0, 1.0, 0.0]
    outward /= np.maximum(np.linalg.norm(outward, axis=1), 1e-9)[:, None]
    contact = -tool.ball_radius * contour.normal - tool.flat_radius * outward  # from a point of the axis
    feed = contour.speed if len(contour.speed) else np.full(len(contour), contour.feed)
    return feed, (np.cross(axis, contact) * along).sum(axis=1), 0.5 * way
