"""A plan as a picture: contours from above, a section with both tools, wall angle and thickness over depth.

The section is drawn in the frame of the finished part. Over a die the tip is shown where it meets the finished part,
as frame ``sheet`` travels with the blank holder; in accumulative forming it stays at one depth and the part sinks.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from isf_core.contour import Contour
from isf_core.files.job import Job, JobFile
from isf_core.files.tooling import ToolSpec
from isf_core.types import Array
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle
from matplotlib.transforms import ScaledTranslation

from isf_planner.part_plan import Plan
from isf_planner.view.picture_files import save_png
from isf_planner.view.plan_view import flange_rise, part_size

INK, MUTED, SHEET = "#1f2933", "#66727f", "#c9d1d9"
FORMING, SUPPORT, THICKNESS = "#0072B2", "#D55E00", "#009E73"
ANGLE_MAP = ListedColormap(mpl.colormaps["viridis"](np.linspace(0.0, 0.87, 256)))
"""Without the light end, which thin lines on white do not show."""
PLATE = "#9aa5b1"
PLATE_SHOWN = 4e-3
"""m of the backing plate that are shown below its upper face; a job does not tell how thick it is."""
MM = 1e3

STYLE: dict[str, Any] = {
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

_SECTION_LABEL = {
    "ADSIF": "x in mm (the tools stay at one depth, the part sinks)",
    "TPIF": "x in mm (tool where it meets the finished part)",
}


def draw_plan(plan: Plan, job_file: JobFile, path: Path) -> Path:
    """Write the picture of a plan as PNG to ``path`` and return it; IsfError FILE_NOT_WRITABLE."""
    with mpl.rc_context(STYLE):
        return save_png(make_figure(plan, job_file), path)


def make_figure(plan: Plan, job_file: JobFile) -> Figure:
    """The picture of a plan: from above, section, curves over depth."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(12.0, 7.2), layout="constrained")
        FigureCanvasAgg(figure)
        grid = figure.add_gridspec(2, 2, width_ratios=(1.0, 1.05), height_ratios=(1.0, 0.9))
        _draw_from_above(figure, figure.add_subplot(grid[:, 0]), plan, job_file)
        _draw_section(figure, figure.add_subplot(grid[0, 1]), plan, job_file.job)
        _draw_over_depth(figure.add_subplot(grid[1, 1]), plan, job_file.job)
        figure.suptitle(_title(plan, job_file.job), x=0.01, ha="left", fontsize=12)
    return figure


def _title(plan: Plan, job: Job) -> str:
    return (
        f"{job.name}: {job.process}, {len(plan.contours)} contours, part {part_size(plan)}, "
        f"path {plan.path_length:.2f} m, {plan.forming_time / 60:.1f} min at feed"
    )


def _draw_from_above(figure: Figure, axes: Axes, plan: Plan, job_file: JobFile) -> None:
    """Tip paths coloured by wall angle, in the clamp."""
    width, height = (side * MM for side in job_file.rig.clamp.size)
    axes.add_patch(Rectangle((-width / 2, -height / 2), width, height, fill=False, ec=MUTED, lw=1.5))
    if (plate := job_file.job.backing_plate) is not None:
        edges = [np.vstack([edge, edge[:1]]) * MM for edge in plate.edges]
        axes.add_collection(LineCollection(edges, colors=MUTED, linewidths=1.2, label="opening of the backing plate"))
    lines = LineCollection([], cmap=ANGLE_MAP, linewidths=1.1)
    segments, angles = [], []
    for contour in plan.contours:
        tip = _line(contour)[:, :2] * MM
        segments.append(np.stack([tip[:-1], tip[1:]], axis=1))
        angles.append(contour.wall_angle[: len(tip) - 1])
    lines.set_segments(list(np.concatenate(segments)))
    lines.set_array(np.degrees(np.concatenate(angles)))
    lines.set_clim(0.0, np.degrees(plan.largest_wall_angle))
    axes.add_collection(lines)
    starts = np.array([contour.forming_tip[0, :2] for contour in plan.contours]) * MM
    axes.plot(*starts.T, ".", ms=3, color=SUPPORT, label="start of each contour")
    outer = np.abs(np.vstack([contour.forming_tip[:, :2] for contour in plan.contours])).max() * MM
    if plate is not None:
        outer = max(outer, max(plate.extent) / 2 * MM / 1.2)
    # the clamp is shown when the part fills a good share of it; a small part would vanish in it
    reach = max(width, height) / 2 * 1.04 if outer > 0.2 * max(width, height) else outer * 1.25
    axes.set(xlim=(-reach, reach), ylim=(-reach, reach), xlabel="x in mm", ylabel="y in mm", aspect="equal")
    clamp = "frame: clamp" if reach > width / 2 else f"clamp {width:.0f} x {height:.0f} mm is outside"
    axes.set_title(f"Paths of the forming tip ({clamp})")
    axes.legend(loc="upper right", fontsize=9)
    figure.colorbar(lines, ax=axes, location="bottom", shrink=0.7, aspect=35, pad=0.01, label="wall angle in deg")


def _draw_section(figure: Figure, axes: Axes, plan: Plan, job: Job) -> None:
    """Section along x where the steepest contour runs across it, with the tools there; one place per forming tool."""
    shown = _places(plan)
    contour, k = shown[0]
    y = round(float(contour.forming_tip[k, 1]), 7)
    x = plan.target.x
    z = plan.target.at(np.column_stack([x, np.full_like(x, y)]))
    # by the sine law the thickness measured along z stays that of the blank
    axes.fill_between(x * MM, (z - job.sheet.thickness) * MM, z * MM, color=SHEET, lw=0, label="sheet")
    axes.plot(x * MM, z * MM, color=INK, lw=1.2, label="target")
    if job.backing_plate is not None:
        _draw_plate(axes, x, y, job)
    rise = flange_rise(plan)
    crossings = [_crossings(_line(contour), y) + [0.0, contour.holder_height + rise] for contour in plan.contours]
    tips = np.vstack(crossings) * MM
    axes.plot(tips[:, 0], tips[:, 1], ".", ms=3, color=FORMING, label="forming tip")
    spans = [(float(z.min()) - job.sheet.thickness, float(z.max()))]
    for place in shown:
        spans += _draw_tools(axes, *place, job, rise)
    widest = max(tool.radius for tool in (job.tool_1, job.tool_2) if tool is not None) * MM
    reach = np.abs(tips[:, 0]).max() + 4 * widest
    axes.set(xlim=(-reach, reach), xlabel=_SECTION_LABEL.get(job.process, "x in mm"), ylabel="z in mm", aspect="equal")
    low, high = min(span[0] for span in spans), max(span[1] for span in spans)
    axes.set_ylim(low * MM - 0.3 * widest, high * MM + 0.3 * widest)
    names = " and ".join(str(number) for number in sorted(contour.index + 1 for contour, _ in shown))
    axes.set_title(f"Section at y = {round(y * MM, 1) + 0.0:.1f} mm, tools at contour {names}")
    below = axes.transAxes + ScaledTranslation(0.0, -0.42, figure.dpi_scale_trans)  # inches, under the axis label
    axes.legend(
        loc="upper center",
        bbox_to_anchor=(0.5, 0.0),
        bbox_transform=below,
        fontsize=9,
        ncols=5,
        handlelength=1.2,
        columnspacing=1.0,
    )


def _draw_plate(axes: Axes, x: Array, y: float, job: Job) -> None:
    """The backing plate at ``y`` m: its flat lies a sheet's thickness below z = 0."""
    assert job.backing_plate is not None
    along = np.linspace(x[0], x[-1], 2000)  # m; the rounded edge is narrower than the steps of a target
    top = job.backing_plate.height(along, np.full_like(along, y)) - job.sheet.thickness
    below = -job.sheet.thickness - PLATE_SHOWN
    axes.fill_between(
        along * MM, below * MM, top * MM, where=np.isfinite(top), color=PLATE, lw=0, label="backing plate", zorder=0.5
    )


def _places(plan: Plan) -> list[tuple[Contour, int]]:
    """Contour and point for each forming tool, steepest contour first, where the wall lies across the same section."""
    found: list[tuple[Contour, int]] = []
    steepest = sorted(plan.contours, key=lambda contour: -float(np.median(contour.wall_angle)))
    for contour in steepest:
        if any(contour.forming_tool == other.forming_tool for other, _ in found):
            continue
        leaning = np.abs(contour.normal[:, 1])
        if found:  # in the section of the first one
            y = found[0][0].forming_tip[found[0][1], 1]
            leaning = leaning + np.abs(contour.forming_tip[:, 1] - y) / 1e-3
        k = int(np.argmin(np.round(leaning, 3) - 1e-3 * np.sign(contour.forming_tip[:, 0])))
        if not found or leaning[k] < 1.0:
            found.append((contour, k))
    return found


def _draw_tools(axes: Axes, contour: Contour, k: int, job: Job, rise: float) -> list[tuple[float, float]]:
    """Both tools at one point of a contour; the heights (m) from the tip to the far side of each rounding."""
    upper = contour.forming_tool == 1
    tools = (job.tool_1, job.tool_2) if upper else (job.tool_2, job.tool_1)
    lift = np.array([0.0, 0.0, contour.holder_height + rise])
    spans = []
    for tool, tips, up, colour, name in (
        (tools[0], contour.forming_tip, upper, FORMING, "forming tool"),
        (tools[1], contour.support_tip, not upper, SUPPORT, "support tool"),
    ):
        if tool is None or not len(tips):
            continue
        tip = tips[k] + lift
        known = axes.get_legend_handles_labels()[1]
        _draw_tool(axes, tip, tool, colour, up=up, label="" if name in known else name)
        far = float(tip[2]) + (2.0 if up else -2.0) * tool.ball_radius
        spans.append((min(float(tip[2]), far), max(float(tip[2]), far)))
    return spans


def _draw_tool(axes: Axes, tip: Array, tool: ToolSpec, colour: str, *, up: bool, label: str) -> None:
    """A tool: its rounding, the flat between, and the beginning of its shank."""
    side = 1.0 if up else -1.0
    ball, flat, radius = tool.ball_radius * MM, tool.flat_radius * MM, tool.radius * MM
    x, z = float(tip[0]) * MM, (float(tip[2]) + side * tool.ball_radius) * MM
    axes.add_patch(Rectangle((x - radius, z), 2 * radius, side * 400.0, fc=colour, alpha=0.12, lw=0))
    for offset in {-flat, flat}:
        axes.add_patch(Circle((x + offset, z), ball, fc="white", lw=0, zorder=1.5))
        axes.add_patch(Circle((x + offset, z), ball, fc=(colour, 0.12), ec=colour, lw=1.5, zorder=1.6))
    if flat > 0:
        axes.plot([x - flat, x + flat], [float(tip[2]) * MM] * 2, color=colour, lw=1.5, zorder=1.6)
    axes.plot(x, float(tip[2]) * MM, "o", ms=4, color=colour, label=label or None, zorder=1.7)


def _draw_over_depth(axes: Axes, plan: Plan, job: Job) -> None:
    """Wall angle and predicted thickness of every contour, smallest to largest, feature by feature."""
    right = axes.twinx()
    way = np.array([_way(contour, job) for contour in plan.contours])
    angle = np.degrees([np.percentile(contour.wall_angle, (0, 50, 100)) for contour in plan.contours])
    thickness = MM * np.array([np.percentile(contour.thickness, (0, 50, 100)) for contour in plan.contours])
    feature = np.array([contour.feature for contour in plan.contours])
    for number in np.unique(feature):
        of = feature == number
        marker = "." if np.count_nonzero(of) == 1 else None
        axes.fill_between(way[of], angle[of, 0], angle[of, 2], color=FORMING, alpha=0.25, lw=0)
        axes.plot(way[of], angle[of, 1], color=FORMING, lw=1.8, marker=marker)
        right.fill_between(way[of], thickness[of, 0], thickness[of, 2], color=THICKNESS, alpha=0.25, lw=0)
        right.plot(way[of], thickness[of, 1], color=THICKNESS, lw=1.8, linestyle=(0, (5, 2)), marker=marker)
    forced = np.array([contour.force_controlled for contour in plan.contours])
    if forced.any():
        axes.axvspan(way[forced].min(), way[forced].max(), color=SUPPORT, alpha=0.08, lw=0)
        middle = 0.5 * (way[forced].min() + way[forced].max())
        axes.text(middle, 2.0, "force control of the support tool", ha="center", color=SUPPORT, fontsize=9)
    axes.set(xlabel=_way_label(plan, job), xlim=(0, way.max() * 1.02), ylim=(0, angle.max() * 1.15))
    axes.set_ylabel("wall angle in deg", color=FORMING)
    axes.grid(True)
    right.set_ylabel("predicted thickness in mm", color=THICKNESS)
    right.set_ylim(0, thickness.max() * 1.15)
    right.spines["right"].set_visible(True)
    law = "overlap method" if job.path.thickness == "overlap" else "sine law"
    axes.set_title(f"Up to {angle.max():.1f} deg, thinnest {thickness.min():.2f} mm ({law})")


def _way(contour: Contour, job: Job) -> float:
    """How far forming has come at a contour: turns (ADSIF), travel of the holder (TPIF), or away from the flange, mm.

    The tip of a lower forming tool starts at the lower face of the blank.
    """
    if job.process == "ADSIF":
        return float(contour.index + 1)
    z = float(contour.forming_tip[:, 2].mean()) + contour.holder_height
    return MM * abs(z if contour.forming_tool == 1 else z + job.sheet.thickness)


def _way_label(plan: Plan, job: Job) -> str:
    if job.process == "ADSIF":
        return "turn of the spiral, from the inside out"
    if job.process == "TPIF":
        return "travel of the blank holder in mm"
    names = {1: "depth", 2: "height"}
    used = " or ".join(names[tool] for tool in sorted({contour.forming_tool for contour in plan.contours}))
    return f"{used} of the forming tip from the flange in mm"


def _line(contour: Contour) -> Array:
    """(N, 3) or, closed, (N + 1, 3) m, the forming tip with the way back to its first point."""
    tip = contour.forming_tip
    return np.vstack([tip, tip[:1]]) if contour.closed else tip


def _crossings(tip: Array, y: float) -> Array:
    """(K, 2) m, x and z where the line (N, 3) crosses the plane at ``y``."""
    side = tip[:, 1] >= y
    k = np.flatnonzero(side[1:] != side[:-1])
    share = (y - tip[k, 1]) / (tip[k + 1, 1] - tip[k, 1])
    cut = tip[k] + share[:, None] * (tip[k + 1] - tip[k])
    return np.asarray(cut[:, [0, 2]])
