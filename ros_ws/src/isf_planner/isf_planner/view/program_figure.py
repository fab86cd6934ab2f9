"""A program as a picture: from above and from the side, with what the tool does not reach."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np
from isf_core.files.rig import Rig
from isf_core.types import Array, Mask
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from isf_planner.gcode.reader import Finding, Program
from isf_planner.view.picture_files import save_png
from isf_planner.view.plan_figure import MUTED, STYLE, SUPPORT

MM = 1e3


def draw_program(program: Program, findings: Sequence[Finding], rig: Rig, path: Path) -> Path:
    """Write the picture of a ``program`` with N > 0 points as PNG and return ``path``; IsfError FILE_NOT_WRITABLE."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(12.0, 6.4), layout="constrained")
        FigureCanvasAgg(figure)
        above, side = figure.subplots(1, 2, width_ratios=(1.0, 1.1))
        tips = program.tips[:, :3] * MM
        rapid = ~np.isfinite(program.speed)
        at_fault = np.isin(program.line, [finding.line for finding in findings])
        depth = _draw(above, tips[:, :2], tips[:, 2], rapid, at_fault)
        _draw(side, tips[:, [0, 2]], tips[:, 2], rapid, at_fault)
        width, height = (side_length * MM for side_length in rig.clamp.size)
        inside = bool((np.abs(tips[:, :2]).max(axis=0) < np.array([width, height]) / 4).all())
        if not inside:  # a small part would vanish in it
            above.add_patch(Rectangle((-width / 2, -height / 2), width, height, fill=False, ec=MUTED, lw=1.5))
        title = "From above" + ("" if inside else " (frame: clamp)")
        above.set(xlabel="x in mm", ylabel="y in mm", title=title)
        above.autoscale_view()
        above.set_aspect("equal", adjustable="datalim")
        side.axhline(0.0, color=MUTED, lw=1.0)
        side.set(xlabel="x in mm", ylabel="z in mm", title="From the side (sheet at z = 0)")
        above.legend(loc="upper right", fontsize=9)
        figure.colorbar(depth, ax=side, location="bottom", shrink=0.7, aspect=35, label="z of the tip in mm")
        figure.suptitle(
            f"{program.name}: {len(program)} points, {program.path_length:.2f} m, {len(findings)} findings",
            x=0.01,
            ha="left",
            fontsize=12,
        )
        return save_png(figure, path)


def _draw(axes: Axes, places: Array, depth: Array, rapid: Mask, at_fault: Mask) -> LineCollection:
    """Moves at feed coloured by depth, rapid moves, and points of lines at fault."""
    moves = np.stack([places[:-1], places[1:]], axis=1)
    fed = ~rapid[1:]
    lines = LineCollection(list(moves[fed]), cmap="viridis", linewidths=1.0)
    lines.set_array(depth[1:][fed])
    axes.add_collection(lines)
    axes.add_collection(LineCollection(list(moves[~fed]), colors=MUTED, linewidths=0.7, linestyles=":", label="rapid"))
    if at_fault.any():
        axes.plot(*places[at_fault].T, "x", color=SUPPORT, ms=6, label="not possible")
    axes.autoscale_view()
    if float(depth.min()) < 0.0:
        lines.set_clim(float(depth.min()), 0.0)  # over the sheet nothing is formed
    return lines
