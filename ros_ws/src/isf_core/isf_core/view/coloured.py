"""Surfaces and paths of a plotly figure, coloured by a quantity; lengths in mm."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.ndimage import binary_dilation
from scipy.spatial import KDTree

from isf_core.contour import Contour
from isf_core.types import Array, Mask

SHEET = "#b4bec8"


def near_path(contours: Sequence[Contour], values: Sequence[Array], x: Array, y: Array) -> Array:
    """(ny, nx), the value of the nearest contact as seen from above at the nodes ``x`` (nx,), ``y`` (ny,) m.

    ``values`` (N,) per contour. NaN beside the path, farther than its steps reach: nothing was formed there. In
    accumulative forming contacts are made higher up than they end.
    """
    nodes = np.column_stack([a.ravel() for a in np.meshgrid(x, y)])
    return value_near_path(contours, values, nodes).reshape(len(y), len(x))


def value_near_path(contours: Sequence[Contour], values: Sequence[Array], places: Array) -> Array:
    """(M,), as :func:`near_path` at ``places`` (M, 2) m."""
    contacts = np.vstack([contour.contact for contour in contours])
    distance, nearest = KDTree(contacts[:, :2]).query(places)
    pitch = 3.0 * float(np.median(np.linalg.norm(np.diff(contours[0].contact, axis=0), axis=1))) + 1.5e-3
    return np.asarray(np.where(distance < pitch, np.concatenate(values)[nearest], np.nan))


def beside_formed(colour: Array) -> Mask:
    """Nodes of the plain surface beside the coloured one, ``colour`` (ny, nx) with NaN where nothing is formed.

    A cell is drawn where all its four nodes are, and plotly leaves out a part of it where it borders on one that is
    not. So the plain surface reaches to the second neighbour of every node without a colour, the diagonal ones too: no
    gap is left between the surfaces.
    """
    return np.asarray(binary_dilation(np.isnan(colour), structure=np.ones((3, 3), dtype=np.bool_), iterations=2))


def broken(arrays: Sequence[Array], contours: Sequence[Contour], stride: int) -> Array:
    """Rows of all contours, closed ones closed, with a row of NaN after each so that no line joins them."""
    pieces = []
    for array, contour in zip(arrays, contours, strict=True):
        thinned = array[::stride]
        pieces += [thinned, thinned[:1] if contour.closed else array[-1:], np.full((1, array.shape[1]), np.nan)]
    return np.vstack(pieces)


def add_plain(figure: Any, x: Array, y: Array, z: Array, opacity: float = 1.0) -> None:
    """Surface of one colour: ``x`` (nx,), ``y`` (ny,), ``z`` (ny, nx), NaN where there is none."""
    figure.add_surface(
        x=x,
        y=y,
        z=z,
        surfacecolor=np.zeros(z.shape, dtype=np.uint8),
        colorscale=[[0.0, SHEET], [1.0, SHEET]],
        opacity=opacity,
        showscale=False,
        name="sheet",
        hoverinfo="skip",
    )


def colour_bar(title: str) -> dict[str, Any]:
    """Options of a colour bar that names quantity and unit."""
    return {"title": {"text": title, "side": "right"}, "thickness": 14, "len": 0.8, "x": 1.0, "xpad": 4}


def path_line(values: Array, colorscale: str | list[list[Any]], limits: tuple[float, float]) -> dict[str, Any]:
    """Options of a line coloured by ``values`` (N,) between two limits."""
    return {"color": values, "colorscale": colorscale, "width": 4, "cmin": limits[0], "cmax": limits[1]}
