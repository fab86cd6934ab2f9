"""The formed part in three dimensions: its shape by deviation or thickness, the tool path by force or correction, and
its forming step by step."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from isf_core.contour import Contour
from isf_core.geometry.height_map import HeightMap
from isf_core.thinned_sheet import ThinnedSheet
from isf_core.types import Array
from isf_core.view import page
from isf_core.view.coloured import add_plain, beside_formed, broken, colour_bar, near_path, path_line

from isf_analysis.figures.cuts import part_frame
from isf_analysis.figures.forming_view import add_forming
from isf_analysis.figures.shape_figures import map_limit
from isf_analysis.measures.deviation import RIM_WIDTH, Deviation
from isf_analysis.measures.force_regions import path_forces
from isf_analysis.measures.forming_steps import forming_steps
from isf_analysis.measures.record import PartRecord
from isf_analysis.measures.sheet_thickness import estimated_thickness

MM = 1e3
LARGEST_GRID = 40_000
"""Nodes of the drawn surface; a finer one is thinned out."""
MAXIMUM_POINTS = 20_000
"""Points of a drawn path; a longer one is thinned out."""
LIFTED = 0.15e-3
"""m by which a path is drawn above the sheet, so that it is seen."""
DEVIATION_SCALE = [
    [0.0, "#053061"], [0.2, "#2f79b5"], [0.35, "#92c5de"], [0.5, "#e6e9eb"],
    [0.65, "#f4a582"], [0.8, "#d6604d"], [1.0, "#67001f"],
]  # fmt: skip
"""That of the maps (ColorBrewer RdBu), light grey at zero: white would not be seen on a white page."""


class PartView(NamedTuple):
    """HTML of the part to be turned (:func:`isf_core.view.page.fragment`), empty when the record has nothing to show;
    ``forming``: the forming step by step is in it."""

    html: str
    forming: bool


def part_view(record: PartRecord, deviation: Deviation | None) -> PartView:
    """The part of ``record`` to be turned.

    Raises
    ------
    IsfError : EXPORT_FORMAT_UNKNOWN when plotly is not installed
    """
    drawing = Drawing(page.new_figure())
    shape = _shape(record, deviation)
    contours = {contour.index: contour for contour in record.last_stage}
    if deviation is not None and shape is not None and record.target is not None:
        _deviation(drawing, shape, deviation, record.target)
    if record.formed_sheet is not None:
        _formed_sheet(drawing, record.formed_sheet, deviation)
    estimate = estimated_thickness(record, deviation)
    if estimate is not None and shape is not None:
        _estimated_thickness(drawing, shape, estimate)
    if shape is not None and contours:
        _thickness(drawing, shape, list(contours.values()))
    _paths(drawing, record, contours, shape)
    steps = forming_steps(record)
    if steps is not None:
        moving = add_forming(drawing.figure, steps)
        drawing.close("forming", steps=moving)
    if not drawing.views:
        return PartView("", forming=False)
    html = page.fragment(drawing.figure, drawing.views, f"{record.job_name} in three dimensions")
    return PartView(html, forming=steps is not None)


class Drawing:
    """A figure of plotly that is filled view by view."""

    def __init__(self, figure: Any) -> None:
        self.figure = figure
        self.views: dict[str, page.View] = {}

    def close(self, words: str, *labels: tuple[Array, str], steps: page.Steps | None = None) -> None:
        """What was added since the last view is the view ``words``, with ``labels`` at places (3,) mm and its steps."""
        first = sum(len(view.traces) for view in self.views.values())
        self.views[words] = page.View(range(first, len(self.figure.data)), labels, steps)


def _shape(record: PartRecord, deviation: Deviation | None) -> HeightMap | None:
    """What was formed where it was measured, else what was wanted; the opening and some flange, m."""
    target = record.target
    if target is None:
        return None
    if deviation is None:
        return _thinned(target)
    x0, x1, y0, y1 = part_frame(deviation, RIM_WIDTH)
    columns, rows = (target.x >= x0) & (target.x <= x1), (target.y >= y0) & (target.y <= y1)
    formed = (target.z + deviation.error.z)[np.ix_(rows, columns)]
    return _thinned(HeightMap(target.x[columns], target.y[rows], formed))


def _thinned(heights: HeightMap) -> HeightMap:
    stride = int(np.ceil(np.sqrt(heights.z.size / LARGEST_GRID)))
    return HeightMap(heights.x[::stride], heights.y[::stride], heights.z[::stride, ::stride])


def _grid(shape: HeightMap) -> tuple[Array, Array, Array]:
    return _short(shape.x), _short(shape.y), _short(shape.z)


def _short(lengths: Array) -> Array:
    """m to mm, to a micrometre: what a page needs to hold."""
    return np.round(MM * lengths, 3).astype(np.float32)


def _deviation(drawing: Drawing, shape: HeightMap, deviation: Deviation, target: HeightMap) -> None:
    x, y, z = _grid(shape)
    columns, rows = np.searchsorted(deviation.error.x, shape.x), np.searchsorted(deviation.error.y, shape.y)
    limit = map_limit(deviation)
    drawing.figure.add_surface(
        x=x,
        y=y,
        z=z,
        surfacecolor=_short(deviation.error.z[np.ix_(rows, columns)]),
        cmin=-limit,
        cmax=limit,
        colorscale=DEVIATION_SCALE,
        colorbar=colour_bar("deviation [mm], red: too high"),
        hovertemplate="x %{x:.1f}, y %{y:.1f}, z %{z:.2f} mm<br>deviation %{surfacecolor:+.2f} mm<extra></extra>",
        lighting={"ambient": 0.8, "diffuse": 0.35, "specular": 0.03},
    )
    wx, wy, worst = deviation.whole.worst
    labels = []
    if np.isfinite(worst):  # at the node of the target, which a thinned shape may not have
        height = target.z[np.searchsorted(target.y, wy), np.searchsorted(target.x, wx)] + worst
        labels.append((MM * np.array([wx, wy, height]), f"{MM * worst:+.2f} mm"))
    drawing.close("deviation", *labels)


def _thickness(drawing: Drawing, shape: HeightMap, contours: Sequence[Contour]) -> None:
    values = [MM * contour.thickness for contour in contours]
    colour = near_path(contours, values, shape.x, shape.y)
    if not np.isfinite(colour).any():
        return
    x, y, z = _grid(shape)
    add_plain(drawing.figure, x, y, np.where(beside_formed(colour), z, np.nan))
    grid = shape.x, shape.y, shape.z
    _coloured_surface(drawing, grid, colour, "thickness by the plan [mm]", "%{surfacecolor:.2f} mm thick (plan)")
    thinnest = int(np.argmin(np.concatenate(values)))
    place = np.vstack([_on_shape(contour.contact, shape) for contour in contours])[thinnest]
    drawing.close("thickness (plan)", (MM * place, f"{np.concatenate(values)[thinnest]:.2f} mm"))


def _formed_sheet(drawing: Drawing, sheet: ThinnedSheet, deviation: Deviation | None) -> None:
    """Two views of the simulated sheet itself, where it lies in the frame of the map."""
    rows, columns = np.ones(sheet.thickness.shape[0], dtype=bool), np.ones(sheet.thickness.shape[1], dtype=bool)
    if deviation is not None:
        x0, x1, y0, y1 = part_frame(deviation, RIM_WIDTH)
        x, y = sheet.points[..., 0], sheet.points[..., 1]
        inside = (x >= x0) & (x <= x1) & (y >= y0) & (y <= y1)
        rows, columns = inside.any(axis=1), inside.any(axis=0)
    stride = int(np.ceil(np.sqrt(max(1, rows.sum() * columns.sum()) / LARGEST_GRID)))
    drawn = np.ix_(np.flatnonzero(rows)[::stride], np.flatnonzero(columns)[::stride])
    if min(len(drawn[0]), drawn[1].shape[1]) < 2:
        return
    points, thickness, margin = sheet.points[drawn], MM * sheet.thickness[drawn], sheet.strain_margin[drawn]
    for words, title, values, text in (
        ("thickness (as formed)", "thickness of the simulated sheet [mm]", thickness, "%{surfacecolor:.2f} mm thick"),
        ("strain margin", "true strain left before it tears", margin, "strain margin %{surfacecolor:.2f}"),
    ):
        if not np.isfinite(values).any():
            continue
        _coloured_surface(drawing, (points[..., 0], points[..., 1], points[..., 2]), values, title, text)
        whole = sheet.strain_margin if values is margin else MM * sheet.thickness
        least = np.unravel_index(int(np.nanargmin(whole)), whole.shape)
        drawing.close(words, (MM * sheet.points[least], f"{whole[least]:.2f}" + ("" if values is margin else " mm")))


def _estimated_thickness(drawing: Drawing, shape: HeightMap, estimate: HeightMap) -> None:
    columns, rows = np.searchsorted(estimate.x, shape.x), np.searchsorted(estimate.y, shape.y)
    values = MM * estimate.z[np.ix_(rows, columns)]
    if not np.isfinite(values).any():
        return
    grid = shape.x, shape.y, shape.z
    _coloured_surface(
        drawing, grid, values, "thickness by the slope of the scan [mm]", "%{surfacecolor:.2f} mm thick (estimate)"
    )
    j, i = np.unravel_index(int(np.nanargmin(values)), values.shape)
    place = MM * np.array([shape.x[i], shape.y[j], shape.z[j, i]])
    drawing.close("thickness (estimate)", (place, f"{values[j, i]:.2f} mm"))


def _coloured_surface(
    drawing: Drawing, points: tuple[Array, Array, Array], values: Array, title: str, text: str
) -> None:
    """Surface through ``points`` x, y and z, m, coloured by ``values`` (ny, nx) from the least to the largest."""
    x, y, z = points
    low, high = _limits(values.ravel())
    drawing.figure.add_surface(
        x=_short(x),
        y=_short(y),
        z=np.where(np.isfinite(values), _short(z), np.nan),
        surfacecolor=np.round(values, 3).astype(np.float32),
        cmin=low,
        cmax=high,
        colorscale="Viridis",
        colorbar=colour_bar(title),
        hovertemplate="x %{x:.1f}, y %{y:.1f}, z %{z:.2f} mm<br>" + text + "<extra></extra>",
        lighting={"ambient": 0.8, "diffuse": 0.35, "specular": 0.03},
    )


def _paths(drawing: Drawing, record: PartRecord, contours: dict[int, Contour], shape: HeightMap | None) -> None:
    formed = [result for result in record.results if result.index in contours]
    forming = [r for r in formed if r.forming_force.shape == contours[r.index].forming_tip.shape]
    _path(
        drawing,
        "forming force",
        "axial force on the forming tool [N]",
        "N",
        [contours[result.index] for result in forming],
        [np.abs(result.forming_force[:, 2]) for result in forming],
        shape,
    )
    supporting = {path.index: path for path in path_forces(record.results, record.corrected)}
    held = [
        contours[index]
        for index, path in supporting.items()
        if index in contours and len(path.force) == len(contours[index])
    ]
    _path(
        drawing,
        "support force",
        "normal force on the support tool [N]",
        "N",
        held,
        [supporting[contour.index].force for contour in held],
        shape,
    )
    offsets = {item.index: item.offset for item in record.corrections if record.corrects}
    moved = [
        contour
        for contour in contours.values()
        if offsets.get(contour.index, np.empty(0)).shape == contour.forming_tip.shape
    ]
    _path(
        drawing,
        "correction",
        "moved deeper by the correction [mm]",
        "mm",
        moved,
        [MM * contour.push_sign * offsets[contour.index][:, 2] for contour in moved],
        shape,
    )


def _path(
    drawing: Drawing,
    words: str,
    title: str,
    unit: str,
    contours: Sequence[Contour],
    values: Sequence[Array],
    shape: HeightMap | None,
) -> None:
    """A view of the contacts of ``contours`` coloured by ``values``, on the plain shape."""
    known = [np.isfinite(one) for one in values]
    if not any(one.any() for one in known):
        return
    if shape is not None:
        add_plain(drawing.figure, *_grid(shape))
    stride = max(1, -(-sum(len(contour) for contour in contours) // MAXIMUM_POINTS))
    places = [_on_shape(contour.contact, shape) for contour in contours]
    line = broken(places, contours, stride)
    colour = broken([one[:, None] for one in values], contours, stride)[:, 0]
    digits = 3 if unit == "mm" else 1
    limits = _limits(np.concatenate(values))
    # a place without a value has no colour: the line is broken there
    drawn = np.where(np.isfinite(colour)[:, None], np.round(MM * line, 2), np.nan).astype(np.float32)
    shown: Any = np.round(np.nan_to_num(colour, nan=limits[0]), digits).astype(np.float32)
    drawing.figure.add_scatter3d(
        **dict(zip("xyz", drawn.T, strict=True)),
        mode="lines",
        line={**path_line(shown, "Viridis", limits), "colorbar": colour_bar(title)},
        customdata=shown,
        hovertemplate="x %{x:.1f}, y %{y:.1f}, z %{z:.2f} mm<br>%{customdata} " + unit + "<extra></extra>",
        showlegend=False,
    )
    everywhere = np.concatenate(values)
    worst = int(np.nanargmax(np.abs(everywhere)))
    drawing.close(words, (MM * np.vstack(places)[worst], f"{everywhere[worst]:.{digits - 1}f} {unit}"))


def _on_shape(contact: Array, shape: HeightMap | None) -> Array:
    """(N, 3) m, contacts where they are seen from above on ``shape``; as planned where that is unknown."""
    if shape is None:
        return contact
    z = shape.at(contact[:, :2])
    return np.column_stack([contact[:, :2], np.where(np.isfinite(z), z + LIFTED, contact[:, 2])])


def _limits(values: Array) -> tuple[float, float]:
    """Least and largest of the known ``values``, apart from each other."""
    low, high = float(np.nanmin(values)), float(np.nanmax(values))
    return (low, high) if high - low > 1e-3 else (low - 5e-4, high + 5e-4)
