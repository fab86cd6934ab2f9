"""From a corrected contour to the path the tools follow, checked against the limits of the rig."""

from __future__ import annotations

import numpy as np
from isf_core.contour import Contour
from isf_core.errors import ErrorCode, IsfError
from numpy.typing import NDArray

from isf_force_ctrl.control_config import ControlConfig
from isf_force_ctrl.trajectory import ToolPath, horizontal_direction

Array = NDArray[np.float64]

LEAST_CENTRE_DISTANCE = 0.5e-3
"""m, horizontal distance of the ball centres below which d_n is not defined well enough."""


def contour_path(contour: Contour, config: ControlConfig, resting_tip: Array, support_force: float | None) -> ToolPath:
    """Path of both tools along ``contour``; ``resting_tip`` (3,) m is where tool_2 stays when it has no path.

    ``support_force`` N replaces the set-points of a force-controlled contour; 0 means position control.

    Raises IsfError CONTOUR_REJECTED.
    """
    contour.validate()
    where = f"contour {contour.index} of {contour.plan_id}"
    if contour.forming_tool != 1:
        raise IsfError(
            ErrorCode.CONTOUR_REJECTED,
            "is formed by tool_2, and swapped roles are not supported yet",
            where=where,
            advice="plan the part with its cavity opening towards tool_1",
        )
    _check_limits(contour, config, where)

    index = np.arange(len(contour) + (1 if contour.closed else 0))
    forming = contour.forming_tip[index % len(contour)]
    support = np.tile(resting_tip, (len(index), 1))
    if contour.has_support:
        support = contour.support_tip[index % len(contour)]
    set_point = np.full(len(index), np.nan)
    if contour.force_controlled and contour.has_support and support_force != 0.0:
        set_point = contour.support_force[index % len(contour)].astype(float)
        if support_force is not None:
            set_point[:] = support_force
    forced = bool(np.isfinite(set_point).all())
    direction = horizontal_direction(forming, support, LEAST_CENTRE_DISTANCE) if contour.has_support else None
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
    return ToolPath(
        tip_1=forming[keep],
        tip_2=support[keep],
        direction=direction[keep],
        set_point=set_point[keep],
        coordinate=index[keep].astype(float),
        arm=config.offset_limit if forced else 0.0,
    )


def _check_limits(contour: Contour, config: ControlConfig, where: str) -> None:
    if contour.feed > 0.9 * config.speed_limit:
        raise IsfError(
            ErrorCode.CONTOUR_REJECTED,
            f"feed of {contour.feed * 1e3:.0f} mm/s leaves no reserve to the rig's {config.speed_limit * 1e3:.0f} mm/s",
            where=where,
            advice="reduce path.feed",
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
    if contour.force_controlled and (contour.support_force < 0).any():
        raise IsfError(ErrorCode.CONTOUR_REJECTED, "support_force is negative: contacts only push", where=where)
