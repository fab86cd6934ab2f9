"""The features of a part as a picture: coloured by kind, each with its name; HTML to be turned, PNG for documents."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from isf_core.contour import Contour, contour_label
from isf_core.types import Array, Indices
from matplotlib.figure import Figure

from isf_planner.features.surface_features import FeatureMap, Kind, SurfaceFeature
from isf_planner.surface import height_grid
from isf_planner.view.picture_files import write_view

MM = 1e3
COLOURS = {
    Kind.TOP: "#c9d1d9",
    Kind.FLOOR: "#8c6d46",
    Kind.PLANE: "#56B4E9",
    Kind.RULED_POSITIVE: "#009E73",
    Kind.RULED_NEGATIVE: "#CC79A7",
    Kind.FREEFORM_POSITIVE: "#94c973",
    Kind.FREEFORM_NEGATIVE: "#b48ead",
    Kind.RIM: "#5b6b7a",
    Kind.RIB_SEMI_VERTICAL: "#D55E00",
    Kind.RIB_TRANSITION: "#E69F00",
    Kind.RIB_BOTTOM: "#F0E442",
}

LARGEST_GRID = 180
"""Nodes of the drawn surface along one side."""


def show_features(found: FeatureMap, heading: str, path: Path, contours: Sequence[Contour] = ()) -> Path:
    """Write the picture of ``found``, with the partial paths that ``contours`` join, to ``path`` (.html or .png).

    Returns ``path``.

    Raises
    ------
    IsfError : EXPORT_FORMAT_UNKNOWN (ending, or plotly is not installed), FILE_NOT_WRITABLE
    """
    return write_view(
        path, lambda figure: _draw_page(figure, found, heading, contours), lambda: _figure(found, heading, contours)
    )


def name_of(feature: SurfaceFeature) -> str:
    """Of one feature, for people: number from 1, kind, wall angle, depth."""
    depth = f"{-feature.highest * MM + 0.0:.1f} to {-feature.lowest * MM + 0.0:.1f} mm deep"
    level = ", level rulings" if feature.horizontal_rulings else ""
    return f"{feature.number + 1} {feature.kind.title}{level}, {np.degrees(feature.wall_angle):.0f} deg, {depth}"


def summary_of(found: FeatureMap) -> str:
    """Counts in one line, for people."""
    return ", ".join(f"{count} {Kind(kind).title}" for kind, count in found.counts().items())


def _thinned(found: FeatureMap) -> tuple[Array, Indices, Indices]:
    """Nodes (N, 3) mm and facets (F, 3) of a coarser grid, and the feature (F,) of every facet."""
    stride = max(1, -(-max(found.label.shape) // LARGEST_GRID))
    heights = found.heights
    thin = type(heights)(heights.x[::stride], heights.y[::stride], heights.z[::stride, ::stride])
    mesh = height_grid.as_mesh(thin)
    corners = found.label[::stride, ::stride].ravel()[mesh.faces]
    # of three corners two alike decide; where all differ, the first
    label = np.where(corners[:, 1] == corners[:, 2], corners[:, 1], corners[:, 0])
    return mesh.vertices * MM, mesh.faces, label


def partial_lines(found: FeatureMap, contours: Sequence[Contour]) -> dict[int, Array]:
    """The partial path (N, 3) mm of every feature that ``contours`` touch: tips, a row of NaN after each curve."""
    lines: dict[int, list[Array]] = {}
    gap = np.full((1, 3), np.nan)
    for contour in contours:
        ends = (
            np.append(contour.forming_tip, contour.forming_tip[:1], axis=0) if contour.closed else contour.forming_tip
        )
        label = found.of_points(contour.contact)
        cuts = np.flatnonzero(np.diff(label)) + 1
        for begin, end in itertools.pairwise([0, *cuts.tolist(), len(label)]):
            lines.setdefault(int(label[begin]), []).append(np.vstack([ends[begin : end + 1] * MM, gap]))
    return {number: np.vstack(lines[number]) for number in sorted(lines)}


def _path_colour(kind: Kind) -> str:
    """Of a partial path on a feature: its colour, darker."""
    from matplotlib.colors import to_hex, to_rgb

    return str(to_hex([0.45 * channel for channel in to_rgb(COLOURS[kind])]))


def _draw_page(figure: Any, found: FeatureMap, heading: str, contours: Sequence[Contour]) -> str:
    """Draw on an empty figure of plotly and return its title."""
    vertices, faces, label = _thinned(found)
    kinds = np.array([list(Kind).index(feature.kind) for feature in found.features])
    for number, kind in enumerate(Kind):
        mine = kinds[label] == number
        if not mine.any():
            continue
        used, local = np.unique(faces[mine], return_inverse=True)
        owner = np.zeros(len(used), dtype=np.int64)
        local = local.reshape(-1, 3)
        owner[local] = label[mine][:, None]
        figure.add_mesh3d(
            **dict(zip("xyz", vertices[used].T, strict=True)),
            **dict(zip("ijk", local.T, strict=True)),
            color=COLOURS[kind],
            flatshading=True,
            lighting={"ambient": 0.75, "diffuse": 0.5, "specular": 0.05},
            name=f"{found.counts()[kind.value]} {kind.title}",
            showlegend=True,
            hovertext=[name_of(found.features[k]) for k in owner],
            hoverinfo="text",
        )
    for number, line in partial_lines(found, contours).items():
        feature = found.features[number]
        figure.add_scatter3d(
            **dict(zip("xyz", line.T, strict=True)),
            mode="lines",
            line={"color": _path_colour(feature.kind), "width": 3},
            name=f"path of {name_of(feature)}",
            showlegend=False,
        )
    if contours:
        starts = np.array([contour.forming_tip[0] for contour in contours]) * MM
        figure.add_scatter3d(
            **dict(zip("xyz", starts.T, strict=True)),
            mode="markers",
            marker={"color": ["#c1121f" if contour.retract else "#1f2933" for contour in contours], "size": 3},
            text=[_start_text(contour) for contour in contours],
            hoverinfo="text",
            name="starts (red: lifted before)",
        )
    places = np.array([feature.place for feature in found.features]) * MM
    figure.add_scatter3d(
        **dict(zip("xyz", (places + [0.0, 0.0, 0.5]).T, strict=True)),
        mode="text",
        text=[str(feature.number + 1) for feature in found.features],
        hovertext=[name_of(feature) for feature in found.features],
        hoverinfo="text",
        textfont={"size": 13, "color": "#1f2933"},
        name="numbers",
    )
    return heading


def _start_text(contour: Contour) -> str:
    form = "closed" if contour.closed else "open"
    return f"{contour_label(contour.index)}, {form}, {-contour.forming_tip[0, 2] * MM:.2f} mm deep"


def _figure(found: FeatureMap, heading: str, contours: Sequence[Contour]) -> Figure:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.colors import to_rgb
    from matplotlib.patches import Patch

    figure = Figure(figsize=(13.0, 6.4), layout="constrained")
    FigureCanvasAgg(figure)
    solid: Any = figure.add_subplot(1, 2, 1, projection="3d")
    above = figure.add_subplot(1, 2, 2)
    vertices, faces, label = _thinned(found)
    colour = np.array([to_rgb(COLOURS[feature.kind]) for feature in found.features])
    corners = vertices[faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    light = 0.62 + 0.38 * np.clip(normal @ np.array([-0.45, -0.55, 0.7]), 0.0, 1.0)
    drawn = solid.plot_trisurf(*vertices.T, triangles=faces, lw=0, shade=False)
    drawn.set_facecolors(colour[label] * light[:, None])
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    size = high - low
    solid.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    solid.set_box_aspect((size[0], size[1], max(size[2], 0.25 * max(size[:2]))), zoom=0.85)
    solid.set(xlabel="x in mm", ylabel="y in mm", zlabel="z in mm")
    solid.view_init(elev=48, azim=-60)
    heights = found.heights
    extent = (heights.x[0] * MM, heights.x[-1] * MM, heights.y[0] * MM, heights.y[-1] * MM)
    above.imshow(colour[found.label], origin="lower", extent=extent, interpolation="nearest")
    for feature in found.features:
        x, y = feature.place[:2] * MM
        above.annotate(f"{feature.number + 1}", (x, y), ha="center", va="center", fontsize=8, color="#1f2933")
    for number, path in partial_lines(found, contours).items():
        above.plot(*path[:, :2].T, color=_path_colour(found.features[number].kind), lw=0.5)
    for lifted, dot in ((False, "#1f2933"), (True, "#c1121f")):
        starts = np.array([c.forming_tip[0, :2] for c in contours if c.retract == lifted]).reshape(-1, 2) * MM
        above.plot(*starts.T, ".", ms=4, color=dot)
    title = "from above, with partial paths; starts black, after a lift red" if contours else "from above"
    above.set(aspect="equal", xlabel="x in mm", ylabel="y in mm", title=title)
    kinds = [kind for kind in Kind if kind.value in found.counts()]
    patches = [Patch(color=COLOURS[kind], label=f"{found.counts()[kind.value]} {kind.title}") for kind in kinds]
    above.legend(handles=patches, loc="upper left", bbox_to_anchor=(1.01, 1.0), frameon=False, fontsize=9)
    figure.suptitle(heading, x=0.01, ha="left", fontsize=11)
    return figure
