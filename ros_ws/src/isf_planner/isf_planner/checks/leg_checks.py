"""Are the hydraulic legs of a hexapod fast enough for this plan? Speeds of single legs, and what all take of the pump.

That every point is within strokes and joints is said by :func:`isf_planner.checks.part_checks.check_axes`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from isf_core.contour import Contour, contour_label
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.rig import Rig
from isf_core.geometry.hexapod import Hexapod
from isf_core.geometry.tool_axis import point_on_axis, tilt_of
from isf_core.types import Array, Indices

from isf_planner.checks.pace import paced
from isf_planner.part.mesh_checks import place_text


@dataclass(frozen=True)
class LegPath:
    """What the legs do between the points of a plan; N pieces.

    Attributes
    ----------
    tips : (N, 3) m, where each begins ; contour : (N,) index
    speed : (N, 6) m/s, outwards positive ; flow : (N,) m^3/s, of all legs from the pump
    """

    tips: Array
    contour: Indices
    speed: Array
    flow: Array


def leg_path(contours: Sequence[Contour], rig: Rig, ball_radius: float) -> LegPath | None:
    """Along contours of an upper tool; None where no hydraulic legs carry it. ``ball_radius`` m of a tilted one.

    The ways between contours, whose speed the force controller chooses, are left out.
    """
    kinematics = rig.make_kinematics()[0]
    pieces = [_of_contour(contour, kinematics, ball_radius) for contour in contours if isinstance(kinematics, Hexapod)]
    pieces = [piece for piece in pieces if piece is not None]
    if rig.legs is None or not pieces:
        return None
    tips, index, speed = (np.concatenate(column) for column in zip(*pieces, strict=True))
    outwards, inwards = rig.legs.areas
    flow = (outwards * np.maximum(speed, 0.0) + inwards * np.maximum(-speed, 0.0)).sum(axis=1)
    return LegPath(tips, index, speed, flow)


def check_legs(contours: Sequence[Contour], rig: Rig, ball_radius: float) -> None:
    """No leg is faster than its valve lets it, and all together take no more than the pump gives.

    Raises
    ------
    IsfError : LEGS_TOO_FAST with leg or pump, and the place on the part
    """
    path = leg_path(contours, rig, ball_radius)
    if path is None or rig.legs is None:
        return
    most = np.where(path.speed > 0.0, *rig.legs.free_speeds)
    share = np.abs(path.speed) / most
    row, leg = (int(index) for index in np.unravel_index(int(np.argmax(share)), share.shape))
    thirsty = int(np.argmax(path.flow))
    if share[row, leg] > 1.0:
        way = "out" if path.speed[row, leg] > 0.0 else "in"
        found = (
            f"leg {leg + 1} would have to go {way} at {1e3 * abs(path.speed[row, leg]):.0f} mm/s, "
            f"{1e3 * most[row, leg]:.0f} mm/s are all that its valve lets it"
        )
    elif path.flow[thirsty] > rig.legs.spare_flow:
        row = thirsty
        found = (
            f"the legs would need {6e4 * path.flow[row]:.0f} l/min, the pump gives {6e4 * rig.legs.spare_flow:.0f} "
            "l/min beyond what the valves leak"
        )
    else:
        return
    raise IsfError(
        ErrorCode.LEGS_TOO_FAST,
        found,
        where=f"{contour_label(int(path.contour[row]))} at {place_text(path.tips[row])}",
        advice="lower path.feed, or tool_axis.largest_rate where the tool is tilted",
    )


def _of_contour(contour: Contour, hexapod: Hexapod, ball_radius: float) -> tuple[Array, Indices, Array] | None:
    """Begin, index and speeds of the legs of every piece of ``contour``."""
    forming = contour.forming_tool == 1
    tips = contour.forming_tip if forming else contour.support_tip
    if len(tips) < 2:
        return None
    leans = forming and contour.tilted
    tilts = tilt_of(contour.forming_axis) if leans else np.zeros((len(tips), 2))
    strokes = hexapod.strokes(point_on_axis(tips, contour.forming_axis, ball_radius) if leans else tips, tilts)
    order, time = paced(contour)
    speed = np.diff(strokes[order], axis=0) / np.maximum(time, 1e-9)[:, None]
    return tips[order[:-1]], np.full(len(time), contour.index), speed
