"""A plan as a picture: contours from above, a section with both tools, wall angle and thickness over depth."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from isf_core.contour import Contour
from isf_core.errors import ErrorCode, IsfError
from isf_core.job import Job, JobFile
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle
from numpy.typing import NDArray

from isf_planner.planning import Plan

Array = NDArray[np.float64]

INK, MUTED, SHEET = "#1f2933", "#66727f", "#c9d1d9"
FORMING, SUPPORT, THICKNESS = "#0072B2", "#D55E00", "#009E73"
ANGLE_MAP = ListedColormap(mpl.colormaps["viridis"](np.linspace(0.0, 0.87, 256)))
"""Without the light end, which thin lines on white do not show."""
MM = 1e3

_STYLE: dict[str, Any] = {
    "font.size": 10,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": "#9aa5b1",
    "axes.labelcolor": INK,
    "axes.titlesize": 11,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "text.color": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "legend.frameon": False,
    "grid.color": "#dde3e8",
}


def draw_plan(plan: Plan, job_file: JobFile, path: Path) -> Path:
    """Write the picture of a plan as PNG to ``path`` and return it; IsfError FILE_NOT_WRITABLE."""
    with mpl.rc_context(_STYLE):
        figure = Figure(figsize=(12.0, 7.2), layout="constrained")
        FigureCanvasAgg(figure)
        grid = figure.add_gridspec(2, 2, width_ratios=(1.0, 1.05), height_ratios=(1.0, 0.9))
        _draw_from_above(figure, figure.add_subplot(grid[:, 0]), plan, job_file)
        _draw_section(figure.add_subplot(grid[0, 1]), plan, job_file.job)
        _draw_over_depth(figure.add_subplot(grid[1, 1]), plan)
        figure.suptitle(_title(plan, job_file.job), x=0.01, ha="left", fontsize=12)
        try:
            figure.savefig(path, dpi=130, metadata={"Software": "isf_planner"})
        except OSError as error:
            what = f"the picture cannot be written: {error.strerror}"
            raise IsfError(ErrorCode.FILE_NOT_WRITABLE, what, where=str(path)) from error
    return path


def _title(plan: Plan, job: Job) -> str:
    depth = -min(float(contour.forming_tip[:, 2].min()) for contour in plan.contours)
    return (
        f"{job.name}: {job.process}, {len(plan.contours)} contours to {depth * MM:.1f} mm, "
        f"path {plan.path_length:.2f} m, {plan.forming_time / 60:.1f} min at feed"
    )


def _draw_from_above(figure: Figure, axes: Axes, plan: Plan, job_file: JobFile) -> None:
    """Tip paths coloured by wall angle, in the clamp."""
    width, height = (side * MM for side in job_file.rig.clamp.size)
    axes.add_patch(Rectangle((-width / 2, -height / 2), width, height, fill=False, ec=MUTED, lw=1.5))
    lines = LineCollection([], cmap=ANGLE_MAP, linewidths=1.1)
    segments, angles = [], []
    for contour in plan.contours:
        tip = _closed(contour.forming_tip[:, :2]) * MM
        segments.append(np.stack([tip[:-1], tip[1:]], axis=1))
        angles.append(contour.wall_angle)
    lines.set_segments(list(np.concatenate(segments)))
    lines.set_array(np.degrees(np.concatenate(angles)))
    lines.set_clim(0.0, np.degrees(plan.largest_wall_angle))
    axes.add_collection(lines)
    starts = np.array([contour.forming_tip[0, :2] for contour in plan.contours]) * MM
    axes.plot(*starts.T, ".", ms=3, color=SUPPORT, label="start of each contour")
    outer = np.abs(np.vstack([contour.forming_tip[:, :2] for contour in plan.contours])).max() * MM
    # the clamp is shown when the part fills a good share of it; a small part would vanish in it
    reach = max(width, height) / 2 * 1.04 if outer > 0.2 * max(width, height) else outer * 1.25
    axes.set(xlim=(-reach, reach), ylim=(-reach, reach), xlabel="x in mm", ylabel="y in mm", aspect="equal")
    clamp = "frame: clamp" if reach > width / 2 else f"clamp {width:.0f} x {height:.0f} mm is outside"
    axes.set_title(f"Paths of the forming tip ({clamp})")
    axes.legend(loc="upper right", fontsize=9)
    figure.colorbar(lines, ax=axes, location="bottom", shrink=0.7, aspect=35, pad=0.01, label="wall angle in deg")


def _draw_section(axes: Axes, plan: Plan, job: Job) -> None:
    """Section along x through the start of the contours, with the tools at the steepest contour."""
    shown = max(plan.contours, key=lambda contour: float(contour.wall_angle[0]))
    y = round(float(shown.forming_tip[0, 1]), 7)
    x = plan.target.x
    z = plan.target.at(np.column_stack([x, np.full_like(x, y)]))
    # by the sine law the thickness measured along z stays that of the blank
    axes.fill_between(x * MM, (z - job.sheet.thickness) * MM, z * MM, color=SHEET, lw=0, label="sheet")
    axes.plot(x * MM, z * MM, color=INK, lw=1.2, label="target")
    tips = np.vstack([_crossings(contour, y) for contour in plan.contours]) * MM
    axes.plot(tips[:, 0], tips[:, 1], ".", ms=3, color=FORMING, label="forming tip")
    _draw_ball(axes, shown.forming_tip[0], job.tool_1.radius, FORMING, up=True)
    if shown.has_support and job.tool_2 is not None:
        _draw_ball(axes, shown.support_tip[0], job.tool_2.radius, SUPPORT, up=False)
    reach = np.abs(tips[:, 0]).max() + 4 * job.tool_1.radius * MM
    below = 2.4 * job.tool_2.radius * MM if shown.has_support and job.tool_2 else 0.3 * job.tool_1.radius * MM
    axes.set(xlim=(-reach, reach), xlabel="x in mm", ylabel="z in mm", aspect="equal")
    axes.set_ylim(float(z.min()) * MM - below, 2.2 * job.tool_1.radius * MM)
    axes.set_title(f"Section at y = {y * MM + 0.0:.1f} mm, tools at contour {shown.index + 1}")
    axes.legend(loc="upper left", fontsize=9, ncols=3, handlelength=1.4, columnspacing=1.2)


def _draw_ball(axes: Axes, tip: Array, radius: float, colour: str, *, up: bool) -> None:
    """A tool: its ball and the beginning of its shank."""
    side = 1.0 if up else -1.0
    centre = np.array([tip[0], tip[2] + side * radius]) * MM
    shank = Rectangle((centre[0] - radius * MM, centre[1]), 2 * radius * MM, side * 200.0, fc=colour, alpha=0.12, lw=0)
    axes.add_patch(shank)
    middle = (float(centre[0]), float(centre[1]))
    axes.add_patch(Circle(middle, radius * MM, fc="white", lw=0, zorder=1.5))
    axes.add_patch(Circle(middle, radius * MM, fc=(colour, 0.12), ec=colour, lw=1.5, zorder=1.6))
    axes.plot(tip[0] * MM, tip[2] * MM, "o", ms=4, color=colour)


def _draw_over_depth(axes: Axes, plan: Plan) -> None:
    """Wall angle and predicted thickness of every contour, smallest to largest."""
    depth = np.array([-contour.forming_tip[:, 2].mean() for contour in plan.contours]) * MM
    angle = np.degrees([np.percentile(contour.wall_angle, (0, 50, 100)) for contour in plan.contours])
    thickness = MM * np.array([np.percentile(contour.thickness, (0, 50, 100)) for contour in plan.contours])
    axes.fill_between(depth, angle[:, 0], angle[:, 2], color=FORMING, alpha=0.25, lw=0)
    axes.plot(depth, angle[:, 1], color=FORMING, lw=1.8)
    forced = [contour.force_controlled for contour in plan.contours]
    if any(forced):
        controlled = depth[np.array(forced)]
        axes.axvspan(controlled[0], controlled[-1], color=SUPPORT, alpha=0.08, lw=0)
        axes.text(controlled.mean(), 2.0, "force control of the support tool", ha="center", color=SUPPORT, fontsize=9)
    axes.set(xlabel="depth of the forming tip in mm", xlim=(0, depth[-1] * 1.02), ylim=(0, angle.max() * 1.15))
    axes.set_ylabel("wall angle in deg", color=FORMING)
    axes.grid(True)
    right = axes.twinx()
    right.fill_between(depth, thickness[:, 0], thickness[:, 2], color=THICKNESS, alpha=0.25, lw=0)
    right.plot(depth, thickness[:, 1], color=THICKNESS, lw=1.8, linestyle=(0, (5, 2)))
    right.set_ylabel("predicted thickness in mm", color=THICKNESS)
    right.set_ylim(0, thickness.max() * 1.15)
    right.spines["right"].set_visible(True)
    axes.set_title(f"Up to {angle.max():.1f} deg, thinnest {thickness.min():.2f} mm (sine law)")


def _closed(points: Array) -> Array:
    return np.vstack([points, points[:1]])


def _crossings(contour: Contour, y: float) -> Array:
    """(K, 2) m, x and z where the tip path crosses the plane at ``y``."""
    tip = _closed(contour.forming_tip)
    side = tip[:, 1] >= y
    k = np.flatnonzero(side[1:] != side[:-1])
    share = (y - tip[k, 1]) / (tip[k + 1, 1] - tip[k, 1])
    cut = tip[k] + share[:, None] * (tip[k + 1] - tip[k])
    return np.asarray(cut[:, [0, 2]])
