"""A plan in three dimensions: surface, paths of both tools coloured by what is predicted, warnings highlighted.

HTML is one file with everything in it, to be turned and zoomed in a browser (plotly); PNG is for documents
(matplotlib). Lengths are shown in mm.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from isf_core.contour import Contour
from isf_core.errors import ErrorCode, IsfError
from isf_core.types import Array
from isf_core.view.coloured import add_plain, beside_formed, broken, colour_bar, near_path, path_line
from matplotlib.figure import Figure
from scipy.spatial import KDTree

from isf_planner.part.warning_places import warning_places
from isf_planner.part_plan import Plan
from isf_planner.view.picture_files import write_view

MM = 1e3
WARNING = "#c1121f"
AXIS = "#5b6770"
UPPER, LOWER = "#0072B2", "#D55E00"
MAXIMUM_POINTS = 20_000
"""Points of a path in an HTML view; longer paths are thinned out."""

MAXIMUM_NODES = 250
"""Nodes of the surface along one side."""


@dataclass(frozen=True)
class Quantity:
    """What colours a path: name for people, and the values of a contour."""

    title: str
    of: Callable[[Contour], Array]


QUANTITIES = {
    "wall_angle": Quantity("wall angle in deg", lambda contour: np.degrees(contour.wall_angle)),
    "thickness": Quantity("thickness in mm", lambda contour: contour.thickness * MM),
    "force": Quantity("axial force in N", lambda contour: contour.predicted_force),
}

OF_STAGES = {
    "carried_thickness": "thickness after all stages in mm",
    "margin": "strain left before the forming limit",
}
"""Colours of a plan in stages: what is carried from pass to pass, where the last stage touches the sheet."""


@dataclass(frozen=True)
class Scene:
    """Everything that is drawn, mm.

    Attributes
    ----------
    x, y : (nx,), (ny,) ; z : (ny, nx), surface ; colour : (ny, nx), NaN where nothing is formed
    forming, support : tips (N, 3) with rows of NaN between contours; support (0, 3) with one tool; over a die where
        the tip meets the finished part
    values : (N,) of ``forming``
    forming_tools : which tools form, 1 (upper) and 2 (lower)
    warnings : place (3,) mm and text
    title : of the quantity
    axes : (K, 3), the axis of a tilted tool at some points of the path, tip, end and a row of NaN each
    body : (R, C, 3), shank and holder where they come nearest to anything, or (0, 0, 3)
    """

    x: Array
    y: Array
    z: Array
    colour: Array
    forming: Array
    support: Array
    values: Array
    forming_tools: tuple[int, ...]
    warnings: list[tuple[Array, str]]
    title: str
    axes: Array
    body: Array


def show(plan: Plan, path: Path, colour: str = "wall_angle") -> Path:
    """Write the view of ``plan`` to ``path`` (.html or .png) and return it.

    Raises
    ------
    IsfError : EXPORT_FORMAT_UNKNOWN (ending, colour, or plotly is not installed), FILE_NOT_WRITABLE
    """
    scene = make_scene(plan, quantity_of(plan, colour))
    heading = _heading(plan)
    return write_view(path, lambda figure: _draw_page(figure, scene, heading), lambda: _figure(scene, heading))


def quantity_of(plan: Plan, colour: str) -> Quantity:
    """What ``colour`` shows of ``plan``; raises IsfError EXPORT_FORMAT_UNKNOWN where it shows nothing."""
    if colour in QUANTITIES:
        return QUANTITIES[colour]
    if colour not in OF_STAGES:
        raise IsfError(
            ErrorCode.EXPORT_FORMAT_UNKNOWN,
            f"a plan cannot be coloured by '{colour}'",
            advice=f"known: {', '.join((*QUANTITIES, *OF_STAGES))}, features",
        )
    sheet = plan.stages[-1].sheet if plan.stages else None
    if sheet is None:
        raise IsfError(
            ErrorCode.EXPORT_FORMAT_UNKNOWN,
            f"'{colour}' is of a plan in several stages, from its job",
            advice="a job with path.stages, path.morph or finishing_passes; of one pass --colour thickness",
        )
    values = sheet.margin if colour == "margin" else sheet.thickness * MM
    last, tree = len(plan.stages) - 1, KDTree(sheet.points)

    def of(contour: Contour) -> Array:
        return values[tree.query(contour.contact)[1]] if contour.stage == last else np.empty(0)

    return Quantity(OF_STAGES[colour], of)


def flange_rise(plan: Plan) -> float:
    """m, what tips gain besides ``Contour.holder_height`` to be seen on the finished part: its height over a die."""
    return -min(contour.holder_height for contour in plan.contours)


def part_size(plan: Plan) -> str:
    """Depth and height of the part from its flange, for people."""
    z = plan.mesh[0][:, 2] * MM
    sizes = [f"{-z.min():.1f} mm deep"] if z.min() < -0.05 else []
    sizes += [f"{z.max():.1f} mm high"] if z.max() > 0.05 else []
    return " and ".join(sizes)


def make_scene(plan: Plan, quantity: Quantity) -> Scene:
    """What is drawn of a plan."""
    contours = [c for c in plan.contours if len(quantity.of(c)) == len(c)]
    values = [quantity.of(contour) for contour in contours]
    contacts = np.vstack([contour.contact for contour in contours])
    target = plan.target
    low, high = contacts[:, :2].min(axis=0) - 10e-3, contacts[:, :2].max(axis=0) + 10e-3
    columns = np.flatnonzero((target.x >= low[0]) & (target.x <= high[0]))
    rows = np.flatnonzero((target.y >= low[1]) & (target.y <= high[1]))
    columns = columns[:: max(1, len(columns) // MAXIMUM_NODES + 1)]
    rows = rows[:: max(1, len(rows) // MAXIMUM_NODES + 1)]
    x, y, z = target.x[columns], target.y[rows], target.z[np.ix_(rows, columns)]
    colour = near_path(contours, values, x, y)
    lift = [np.array([0.0, 0.0, c.holder_height + flange_rise(plan)]) for c in contours]
    support = [(c.support_tip + up) * MM for c, up in zip(contours, lift, strict=True)]
    stride = max(1, sum(len(contour) for contour in contours) // MAXIMUM_POINTS)
    return Scene(
        x=x * MM,
        y=y * MM,
        z=z * MM,
        colour=colour,
        forming=broken([(c.forming_tip + up) * MM for c, up in zip(contours, lift, strict=True)], contours, stride),
        support=broken(support, contours, stride) if any(map(len, support)) else np.empty((0, 3)),
        values=broken([value[:, None] for value in values], contours, stride)[:, 0],
        forming_tools=tuple(sorted({contour.forming_tool for contour in contours})),
        warnings=[(place * MM, text) for place, text in warning_places(plan.warnings)],
        title=quantity.title,
        axes=_axes_drawn(contours) * MM,
        body=_body_drawn(plan) * MM,
    )


AXES_DRAWN, AXIS_LENGTH = 150, 12e-3
"""How many axes of a tilted tool are drawn, and how long, m."""
AROUND = np.linspace(0.0, 2.0 * np.pi, 33)
"""rad, sides of a body that is drawn."""


def _axes_drawn(contours: list[Contour]) -> Array:
    tilted = [contour for contour in contours if contour.tilted]
    if not tilted:
        return np.empty((0, 3))
    tips = np.vstack([contour.forming_tip for contour in tilted])
    axis = np.vstack([contour.forming_axis for contour in tilted])
    index = np.linspace(0, len(tips) - 1, AXES_DRAWN).astype(int)
    ends = np.stack([tips[index], tips[index] + AXIS_LENGTH * axis[index], np.full((len(index), 3), np.nan)], axis=1)
    return np.asarray(ends.reshape(-1, 3))


def _body_drawn(plan: Plan) -> Array:
    """(R, C, 3) m: rings around the axis, from the ball's centre up."""
    if (shank := plan.shank) is None:
        return np.empty((0, 0, 3))
    contour = next(one for one in plan.contours if one.index == shank.contour)
    axis = contour.forming_axis[shank.point]
    across = np.cross(axis, [0.0, 1.0, 0.0])
    across /= np.linalg.norm(across)
    ring = np.cos(AROUND)[:, None] * across + np.sin(AROUND)[:, None] * np.cross(axis, across)
    profile = np.vstack([part[[[0, 2], [1, 3]]] for part in shank.solid.parts])  # (along, beside) of both ends
    centre = shank.solid.centre(contour.forming_tip[shank.point])
    return np.asarray(centre + profile[:, 0, None, None] * axis + profile[:, 1, None, None] * ring)


def _heading(plan: Plan) -> str:
    warned = "1 warning" if len(plan.warnings) == 1 else f"{len(plan.warnings)} warnings"
    return f"{plan.plan_id}: {len(plan.contours)} contours, part {part_size(plan)}, {warned}"


def _draw_page(figure: Any, scene: Scene, heading: str) -> str:
    """Draw on an empty figure of plotly and return its title."""
    limits = {"cmin": float(np.nanmin(scene.values)), "cmax": float(np.nanmax(scene.values))}
    plain = beside_formed(scene.colour)
    add_plain(figure, scene.x, scene.y, np.where(plain, scene.z, np.nan), opacity=0.8)
    figure.add_surface(
        x=scene.x,
        y=scene.y,
        z=np.where(np.isnan(scene.colour), np.nan, scene.z),
        surfacecolor=scene.colour,
        colorscale="Viridis",
        opacity=0.6,
        colorbar=colour_bar(scene.title),
        name="formed surface",
        showlegend=True,
        **limits,
    )
    forms, supports, other = _tool_names(scene)
    line = path_line(scene.values, "Viridis", (limits["cmin"], limits["cmax"]))
    figure.add_scatter3d(**_axes(scene.forming), mode="lines", line=line, name=forms)
    if len(scene.support):
        figure.add_scatter3d(**_axes(scene.support), mode="lines", line={"color": other, "width": 2}, name=supports)
    if len(scene.axes):
        axes = {"color": AXIS, "width": 3}
        figure.add_scatter3d(**_axes(scene.axes), mode="lines", line=axes, name="axis of the tool")
    if len(scene.body):
        x, y, z = np.moveaxis(scene.body, -1, 0)
        grey = [[0.0, AXIS], [1.0, AXIS]]
        figure.add_surface(
            x=x,
            y=y,
            z=z,
            opacity=0.5,
            colorscale=grey,
            showscale=False,
            name="tool, where it comes nearest",
            showlegend=True,
        )
    if scene.warnings:
        places = np.array([place for place, _ in scene.warnings])
        figure.add_scatter3d(
            **_axes(places),
            mode="markers",
            marker={"color": WARNING, "size": 7, "symbol": "diamond"},
            text=[_wrapped(text) for _, text in scene.warnings],
            hoverinfo="text",
            name="warnings",
        )
    return heading


def _tool_names(scene: Scene) -> tuple[str, str, str]:
    """Names of the forming and of the support tool, and the colour of the latter."""
    if scene.forming_tools == (1,):
        return "upper tool (forms)", "lower tool (supports)", LOWER
    if scene.forming_tools == (2,):
        return "lower tool (forms)", "upper tool (supports)", UPPER
    return "forming tool (upper or lower)", "support tool (the other)", LOWER


def _axes(points: Array) -> dict[str, Array]:
    return dict(zip("xyz", points.T, strict=True))


def _wrapped(text: str, width: int = 60) -> str:
    lines = [""]
    for word in text.split():
        if len(lines[-1]) + len(word) > width:
            lines.append("")
        lines[-1] += f"{word} "
    return "<br>".join(line.strip() for line in lines)


def _figure(scene: Scene, heading: str) -> Figure:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.cm import ScalarMappable
    from matplotlib.collections import LineCollection
    from matplotlib.colors import Normalize

    figure = Figure(figsize=(13.0, 6.2), layout="constrained")
    FigureCanvasAgg(figure)
    solid: Any = figure.add_subplot(1, 2, 1, projection="3d")
    above = figure.add_subplot(1, 2, 2)
    scale = Normalize(float(np.nanmin(scene.values)), float(np.nanmax(scene.values)))
    gx, gy = np.meshgrid(scene.x, scene.y)
    solid.plot_surface(gx, gy, scene.z, color="#dde3e8", alpha=0.35, rcount=60, ccount=60, lw=0)
    segments = np.stack([scene.forming[:-1], scene.forming[1:]], axis=1)
    whole = np.isfinite(segments).all(axis=(1, 2))
    segments, values = segments[whole], scene.values[:-1][whole]
    middle = segments.mean(axis=1)
    solid.scatter(*middle.T, c=values, cmap="viridis", norm=scale, s=0.7, lw=0, depthshade=False)
    if len(scene.support):
        _, supports, other = _tool_names(scene)
        solid.plot(*scene.support.T, color=other, lw=0.4, alpha=0.6, label=supports)
        solid.legend(loc="upper left", frameon=False)
    if len(scene.axes):
        solid.plot(*scene.axes.T, color=AXIS, lw=0.7)
        above.plot(*scene.axes[:, :2].T, color=AXIS, lw=0.7)
    # to scale in plan, depth stretched where the part is flat
    size = [float(np.ptp(scene.x)), float(np.ptp(scene.y)), float(np.ptp(scene.z))]
    solid.set_box_aspect((size[0], size[1], max(size[2], 0.25 * max(size[:2]))), zoom=0.8)
    solid.set(xlabel="x in mm", ylabel="y in mm", zlabel="z in mm")
    solid.view_init(elev=38, azim=-60)
    flat = LineCollection(list(segments[:, :, :2]), array=values, cmap="viridis", norm=scale, lw=1.0)
    above.add_collection(flat)
    above.set(aspect="equal", xlabel="x in mm", ylabel="y in mm", title="from above")
    above.set_xlim(scene.x[0], scene.x[-1])
    above.set_ylim(scene.y[0], scene.y[-1])
    for number, (place, _) in enumerate(scene.warnings, start=1):
        solid.scatter(*place, color=WARNING, marker="D", s=36, depthshade=False)
        above.plot(*place[:2], "D", color=WARNING, ms=7)
        above.annotate(f"{number}", place[:2], textcoords="offset points", xytext=(7, 5), color=WARNING, weight="bold")
    figure.colorbar(ScalarMappable(scale, "viridis"), ax=above, label=scene.title, shrink=0.8)
    figure.suptitle(heading, x=0.01, ha="left", fontsize=11)
    if scene.warnings:
        lines = [f"{k}  {text}" for k, (_, text) in enumerate(scene.warnings, start=1)]
        figure.supxlabel("\n".join(lines[:4]), x=0.01, ha="left", fontsize=8, color=WARNING, wrap=True)
    return figure
