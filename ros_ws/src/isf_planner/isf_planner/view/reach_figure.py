"""Reach of a hexapod over a part, before anything runs: where its tip can be, and what its cylinders do on the way."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import matplotlib as mpl
import numpy as np
from isf_core.contour import Contour
from isf_core.files.rig import Rig
from isf_core.geometry.hexapod import Hexapod
from isf_core.geometry.kinematics import UPRIGHT
from isf_core.geometry.tool_axis import point_on_axis, tilt_of
from isf_core.types import Array
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.contour import QuadContourSet
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from isf_planner.view.picture_files import save_png
from isf_planner.view.plan_figure import MUTED, STYLE, SUPPORT

MM = 1e3
_NODES = 101
"""Of a map along one side."""
_WIDER = 3.5
"""Maps are this many times as wide as the travel: they show where reach ends."""


@dataclass(frozen=True)
class AxesUse:
    """What a part asks of the cylinders.

    Attributes
    ----------
    strokes : (N, 6) m, at all points ; margin : m, smallest distance of a stroke from its ends
    joint_angle : rad, largest bend of a joint ; force : N, largest push or pull of a cylinder under the predicted
        axial force, without weights; 0 when none is predicted
    """

    strokes: Array
    margin: float
    joint_angle: float
    force: float


def hexapod_of(rig: Rig) -> Hexapod | None:
    """The hexapod that moves the upper tool of ``rig``, None when another machine does."""
    upper = rig.make_kinematics()[0]
    return upper if isinstance(upper, Hexapod) else None


def axes_use(hexapod: Hexapod, contours: Sequence[Contour], ball_radius: float = 0.0) -> AxesUse:
    """Strokes, joints and forces of the cylinders along ``contours`` of an upper tool, whose tip has ``ball_radius`` m
    where it is tilted."""
    tips, tilt = _poses(contours, ball_radius)
    strokes = hexapod.strokes(tips, tilt)
    axial = np.concatenate(
        [one.predicted_force if len(one.predicted_force) else np.zeros(len(one)) for one in contours]
    )
    push = hexapod.leg_forces(axial[:, None] * np.array([0.0, 0.0, 1.0]), tips, tilt)
    return AxesUse(
        strokes,
        float(_margin(hexapod, strokes).min()),
        float(hexapod.joint_angles(hexapod.place_of(tips, tilt), tilt).max()),
        float(np.abs(push).max()),
    )


def draw_reach(hexapod: Hexapod, contours: Sequence[Contour], rig: Rig, path: Path, ball_radius: float = 0.0) -> Path:
    """Write the map of reach as PNG to ``path`` and return it; IsfError FILE_NOT_WRITABLE."""
    tips, use = _tips(contours), axes_use(hexapod, contours, ball_radius)
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(13.0, 5.4), layout="constrained")
        FigureCanvasAgg(figure)
        above, section, along = figure.subplots(1, 3, width_ratios=(1.0, 1.0, 1.15))
        deepest = float(tips[:, 2].min())
        reach = _WIDER * np.asarray(rig.limits.travel)
        x, y = np.linspace(-reach[0], reach[0], _NODES), np.linspace(-reach[1], reach[1], _NODES)
        z = np.linspace(-reach[2], reach[2], _NODES)
        gx, gy = np.meshgrid(x, y)
        shown = _map(above, hexapod, np.stack([gx, gy, np.full_like(gx, deepest)], axis=-1), (0, 1))
        gx, gz = np.meshgrid(x, z)
        _map(section, hexapod, np.stack([gx, np.zeros_like(gx), gz], axis=-1), (0, 2))
        for axes, (i, j) in ((above, (0, 1)), (section, (0, 2))):
            for contour in contours:
                axes.plot(*(contour.forming_tip[:, (i, j)] * MM).T, color=SUPPORT, lw=0.6)
            a, b = rig.limits.travel[i] * MM, rig.limits.travel[j] * MM
            axes.add_patch(Rectangle((-a, -b), 2 * a, 2 * b, fill=False, ec=MUTED, lw=1.5))
            axes.set_aspect("equal")
        above.set(title=f"Reach at z = {deepest * MM:.1f} mm", xlabel="x in mm", ylabel="y in mm")
        section.set(title="Reach at y = 0", xlabel="x in mm", ylabel="z in mm")
        label = "upright tool: smallest way of a cylinder to its end, mm (white: out of reach; frame: travel)"
        figure.colorbar(shown, ax=[above, section], location="bottom", shrink=0.8, aspect=45, label=label)
        way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(tips, axis=0), axis=1))])
        for k in range(6):
            along.plot(way, use.strokes[:, k] * MM, lw=1.0, label=f"L{k + 1}")
        for end in (0.0, hexapod.stroke):
            along.axhline(end * MM, color=MUTED, lw=1.5)
        along.set(title="Cylinders along the path", xlabel="path in m", ylabel="stroke in mm")
        along.legend(ncols=3, fontsize=9, loc="upper right", bbox_to_anchor=(1.0, 0.9))
        figure.suptitle(
            f"{rig.name}: {use.margin * MM:.0f} mm of stroke left, joints up to {np.degrees(use.joint_angle):.0f} of "
            f"{np.degrees(hexapod.joint_limit):.0f} deg, cylinders up to {use.force:.0f} N (predicted; no weights)",
            x=0.01,
            ha="left",
            fontsize=12,
        )
        return save_png(figure, path)


def _tips(contours: Sequence[Contour]) -> Array:
    """(N, 3) m, of the upper tool."""
    return np.vstack([one.forming_tip if one.forming_tool == 1 else one.support_tip for one in contours])


def _poses(contours: Sequence[Contour], ball_radius: float) -> tuple[Array, Array]:
    """(N, 3) m, where the axis of the upper tool leaves its tip, and (N, 2) rad, its tilt."""
    points, tilts = [], []
    for one in contours:
        tips = one.forming_tip if one.forming_tool == 1 else one.support_tip
        leans = one.tilted and one.forming_tool == 1
        points.append(point_on_axis(tips, one.forming_axis, ball_radius) if leans else tips)
        tilts.append(tilt_of(one.forming_axis) if leans else np.broadcast_to(UPRIGHT, (len(tips), 2)))
    return np.vstack(points), np.vstack(tilts)


def _margin(hexapod: Hexapod, strokes: Array) -> Array:
    """(...) m, smallest distance of the strokes (..., 6) from their ends; negative beyond."""
    return np.asarray(np.minimum(strokes, hexapod.stroke - strokes).min(axis=-1))


def _map(axes: Axes, hexapod: Hexapod, tips: Array, shown: tuple[int, int]) -> QuadContourSet:
    """Margin over the tips (n, n, 3) where the hexapod reaches them."""
    margin = _margin(hexapod, hexapod.strokes(tips, np.broadcast_to(UPRIGHT, (*tips.shape[:-1], 2))))
    margin[~hexapod.reachable(tips)] = np.nan
    i, j = shown
    levels = np.linspace(0.0, hexapod.stroke / 2 * MM, 11)
    return axes.contourf(tips[..., i] * MM, tips[..., j] * MM, margin * MM, levels=levels, cmap="viridis")
