"""From a corrected contour to the path the tools follow: its entry from the air, checked against the limits of the rig.

Frame ``sheet``, m, m/s.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from isf_core.contour import Contour, Process, contour_label
from isf_core.errors import ErrorCode, IsfError
from isf_core.geometry.tool_axis import inclination, turn_per_length
from isf_core.types import Array
from numpy.typing import NDArray

from isf_force_ctrl.control_config import ControlConfig
from isf_force_ctrl.motion.trajectory import ToolPath, horizontal_direction

MINIMUM_CENTRE_DISTANCE = 0.5e-3
"""m, horizontal distance of the ball centres below which d_n is not defined well enough."""

LARGEST_OVERLAP = 0.3e-3
"""m by which the balls of both tools may be planned into each other (assumed: the bending of tools that a plan makes up
for is less)."""

WRONG_SIDE = 0.01
"""z component of a normal, from which it points to the other side of the sheet."""

TILT_TOLERANCE = 1e-6
"""rad, beyond the largest tilt that rounding may lie."""

MINIMUM_SLOPE = 0.05
"""Horizontal part of the sheet's unit normal below which it has no direction worth following (3 deg; assumed)."""


def contour_path(
    contour: Contour, config: ControlConfig, tips: tuple[Array, Array], support_force: float | None
) -> ToolPath:
    """Path of both tools along ``contour``; ``tips`` (3,), (3,) m are where a tool stays that has no path.

    ``support_force`` N replaces the set-points of a force-controlled contour; 0 means position control.

    Raises IsfError CONTOUR_REJECTED.
    """
    contour.validate()
    where = f"{contour_label(contour.index)} of {contour.plan_id}"
    _check_tools(contour, config, where)
    _check_limits(contour, config, where)

    index = np.arange(len(contour) + (1 if contour.closed else 0))
    forming = contour.forming_tip[index % len(contour)]
    support = np.tile(tips[2 - contour.forming_tool], (len(index), 1))
    if contour.has_support:
        support = contour.support_tip[index % len(contour)]
    set_point = np.full(len(index), np.nan)
    if contour.force_controlled and support_force != 0.0:
        set_point = contour.support_force[index % len(contour)].astype(float)
        if support_force is not None:
            set_point[:] = support_force
    forced = bool(np.isfinite(set_point).all())
    tip_1, tip_2 = (forming, support) if contour.forming_tool == 1 else (support, forming)
    direction = _direction(contour, tip_1, tip_2, index % len(contour))
    if direction is None:
        if forced:
            raise IsfError(
                ErrorCode.CONTOUR_REJECTED,
                "has force set-points, but the tools stand above each other: there is no horizontal normal",
                where=where,
                advice="raise control.engage_depth, so that force control starts below the entry fillet",
            )
        direction = np.zeros(len(index))
    moved = np.linalg.norm(np.diff(forming, axis=0), axis=1) + np.linalg.norm(np.diff(support, axis=0), axis=1)
    keep = np.concatenate([[True], moved > 1e-9])
    if keep.sum() < 2:
        raise IsfError(ErrorCode.CONTOUR_REJECTED, "has no length", where=where)
    speed = contour.speed[index % len(contour)][keep] if len(contour.speed) else np.empty(0)
    if contour.tilted:
        bound = np.minimum(contour.feed, _axis_speed(contour, config))[index % len(contour)][keep]
        speed = np.minimum(speed, bound) if len(speed) else bound
    if forced and contour.closed and config.seam_speed < contour.feed:
        seam = _seam_speed(forming[keep], config)
        speed = np.minimum(speed, seam) if len(speed) else seam
    return ToolPath(
        tip_1=tip_1[keep],
        tip_2=tip_2[keep],
        direction=direction[keep],
        set_point=set_point[keep],
        coordinate=index[keep].astype(float),
        arm=config.offset_limit if forced else 0.0,
        forming=contour.forming_tool,
        speed=speed,
        holder=np.full(int(keep.sum()), contour.holder_height) if contour.holder_height else np.empty(0),
        axis=contour.forming_axis[index % len(contour)][keep] if contour.tilted else contour.forming_axis,
    )


def _axis_speed(contour: Contour, config: ControlConfig) -> Array:
    """(N,) m/s, at which the axis of the tool turns with the largest rate."""
    turn = turn_per_length(contour.forming_tip, contour.forming_axis, closed=contour.closed)
    return np.asarray(config.axis_rate / np.maximum(turn, 1e-9))


def _direction(contour: Contour, tip_1: Array, tip_2: Array, index: NDArray[np.int64]) -> Array | None:
    """(M,) rad, d_n from tool 1 to tool 2; with one tool where the other one would stand; None: nowhere defined."""
    if contour.has_support:
        return horizontal_direction(tip_1, tip_2, MINIMUM_CENTRE_DISTANCE)
    away = contour.normal[index] * (-1.0 if contour.forming_tool == 1 else 1.0)
    return horizontal_direction(np.zeros_like(away), away, MINIMUM_SLOPE)


def _seam_speed(tip: Array, config: ControlConfig) -> Array:
    """(M,) m/s, largest speed along a closed contour near its seam.

    Where the tools step down to the next level the gap changes by tenths of a millimetre within a few millimetres of
    path: at the feed, faster than the force loop can follow. The published programs raise their feed from line to line
    at the begin as well (Ren 2018, section 2.4).
    """
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(tip, axis=0), axis=1))])
    length = config.seam_length
    begin = np.maximum(way - length, 0.0)
    end = np.maximum(way[-1] - way - 0.5 * length, 0.0)
    return np.asarray(config.seam_speed * (1.0 + 4.0 * np.minimum(begin, end) / length))


def _check_tools(contour: Contour, config: ControlConfig, where: str) -> None:
    if config.process and contour.process.name != config.process:
        raise IsfError(
            ErrorCode.CONTOUR_REJECTED,
            f"is one of {contour.process.name}; a job of {config.process} is armed",
            where=where,
            advice="arm with the job that the contours were planned for",
        )
    if (contour.normal[:, 2] * contour.push_sign > WRONG_SIDE).any():
        raise IsfError(
            ErrorCode.CONTOUR_REJECTED,
            f"its normals point away from tool {contour.forming_tool}, which forms",
            where=where,
            advice="look at forming_tool and normal: from the contact to the centre of the ball",
        )
    if contour.has_support:
        _check_apart(contour, config, where)
        return
    if contour.process in (Process.DSIF, Process.ADSIF):
        raise IsfError(
            ErrorCode.CONTOUR_REJECTED,
            f"has a path for one tool only, {contour.process.name} needs two",
            where=where,
            advice="plan it with tool_2, or use process SPIF",
        )
    if contour.force_controlled:
        raise IsfError(ErrorCode.CONTOUR_REJECTED, "has force set-points, but no support tool", where=where)


def _check_apart(contour: Contour, config: ControlConfig, where: str) -> None:
    """In ADSIF the tools may be planned into each other, since they give way; a tilted ball is not above its tip."""
    if contour.process is Process.ADSIF or contour.tilted:
        return
    upper, lower = contour.forming_tip, contour.support_tip
    if contour.forming_tool != 1:
        upper, lower = lower, upper
    into = config.ball_reach - np.linalg.norm(upper - lower + [0.0, 0.0, config.ball_reach], axis=1)
    worst = int(np.argmax(into))
    if into[worst] > LARGEST_OVERLAP:
        raise IsfError(
            ErrorCode.CONTOUR_REJECTED,
            f"the balls of both tools would run {1e3 * into[worst]:.1f} mm into each other at point {worst + 1}",
            where=where,
            advice="look at support_tip: it is the highest point of the lower ball",
        )


def _check_limits(contour: Contour, config: ControlConfig, where: str) -> None:
    if contour.feed > 0.9 * config.speed_limit:
        raise IsfError(
            ErrorCode.CONTOUR_REJECTED,
            f"feed of {contour.feed * 1e3:.0f} mm/s leaves no reserve to the rig's {config.speed_limit * 1e3:.0f} mm/s",
            where=where,
            advice="reduce path.feed",
        )
    if contour.force_controlled and float(np.nanmax(contour.support_force)) > config.largest_set_point:
        raise IsfError(
            ErrorCode.CONTOUR_REJECTED,
            f"a set-point of {np.nanmax(contour.support_force):.0f} N is more than the rig bears "
            f"({config.largest_set_point:g} N)",
            where=where,
            advice="reduce control.support_force; limits.force of the rig if it bears more",
        )
    reach = np.array(config.travel) - [config.offset_limit, config.offset_limit, 0.0]
    for name, tips in (("forming_tip", contour.forming_tip), ("support_tip", contour.support_tip)):
        outside = (np.abs(tips) > reach).any(axis=1)
        if outside.any():
            worst = int(np.argmax(outside))
            x, y, z = tips[worst] * 1e3
            raise IsfError(
                ErrorCode.CONTOUR_REJECTED,
                f"{name} at point {worst} ({x:.1f}, {y:.1f}, {z:.1f}) mm is outside the travel of the rig",
                where=where,
                advice="the limits are rig.limits.travel less rig.limits.offset",
            )
    if contour.tilted:
        tilt = inclination(contour.forming_axis)
        worst = int(np.argmax(tilt))
        most = config.largest_tilt if contour.forming_tool == 1 else 0.0
        if tilt[worst] > most + TILT_TOLERANCE:
            raise IsfError(
                ErrorCode.CONTOUR_REJECTED,
                f"forming_axis at point {worst} is tilted by {np.degrees(tilt[worst]):.2f} deg, tool_"
                f"{contour.forming_tool} of this rig can be tilted by {np.degrees(most):.2f} deg",
                where=where,
                advice="plan the part for this rig, or with tool_axis.strategy auto",
            )
    if contour.force_controlled and (contour.support_force < 0).any():
        raise IsfError(ErrorCode.CONTOUR_REJECTED, "support_force is negative: contacts only push", where=where)


LENGTH = 3e-3
"""m of path on which the step is reached. Up to 10 mm it gave the same on that cone, 20 mm less (0.63 mm); what the
ramp itself leaves over a backing plate is 0.29 mm high with 5 mm, 0.25 mm with 3 mm (lu_pyramid, everywhere else less
than that)."""
STEEPEST = 0.75
"""Largest step over :data:`LENGTH`: further down the contour before is not what this one goes on from."""
NEAR = 5e-3
"""m in plan within which the contour before is the level that is entered from."""


def ramped(path: ToolPath, before: ToolPath | None) -> ToolPath:
    """``path`` of M vertices, its begin raised to the level of ``before``, the contour formed last, at that place.

    Under force control the supporting tool is raised as well, so that the gap stays what it is along the contour.
    Unchanged where ``before`` was formed by the other tool, lies further away, no higher, or far above.
    """
    if before is None or before.forming != path.forming:
        return path
    begin = path.forming_tip[0]
    apart = np.linalg.norm(before.forming_tip[:, :2] - begin[:2], axis=1)
    nearest = int(np.argmin(apart))
    up = 1.0 if path.forming == 1 else -1.0
    step = up * float(before.forming_tip[nearest, 2] - begin[2])
    if apart[nearest] > NEAR or not 0.0 < step <= STEEPEST * LENGTH:
        return path
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path.forming_tip, axis=0), axis=1))])
    raised = np.zeros_like(path.forming_tip)
    raised[:, 2] = up * step * np.clip(1.0 - way / LENGTH, 0.0, 1.0)
    forced = bool(np.isfinite(path.set_point[0]))
    return replace(
        path,
        tip_1=path.tip_1 + raised if forced or path.forming == 1 else path.tip_1,
        tip_2=path.tip_2 + raised if forced or path.forming == 2 else path.tip_2,
    )
