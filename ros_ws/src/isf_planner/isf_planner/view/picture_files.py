"""Pictures as files: PNG, or one HTML file to be turned in a browser; what keeps one from being written is told."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from isf_core.errors import ErrorCode, IsfError
from matplotlib.figure import Figure

DPI = 130


@contextmanager
def _to(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        what = f"the picture cannot be written: {error.strerror}"
        raise IsfError(ErrorCode.FILE_NOT_WRITABLE, what, where=str(path)) from error


def save_png(figure: Figure, path: Path) -> Path:
    """Write ``figure`` to ``path`` and return it; IsfError FILE_NOT_WRITABLE."""
    with _to(path):
        figure.savefig(path, dpi=DPI, metadata={"Software": "isf_planner"})
    return path


def write_view(path: Path, page: Callable[[Any], str], figure: Callable[[], Figure]) -> Path:
    """Write a view in three dimensions to ``path``, by its ending .html or .png, and return it.

    ``page`` draws on an empty figure of plotly and returns its title, with lengths in mm; ``figure`` is for the PNG.

    Raises
    ------
    IsfError : EXPORT_FORMAT_UNKNOWN (ending, or plotly is not installed), FILE_NOT_WRITABLE
    """
    ending = path.suffix.lower()
    if ending == ".png":
        return save_png(figure(), path)
    if ending != ".html":
        raise IsfError(
            ErrorCode.EXPORT_FORMAT_UNKNOWN,
            f"'{path.suffix}' is not a format of pictures",
            where=str(path),
            advice="use .html or .png",
        )
    try:
        import plotly.graph_objects as go  # type: ignore[import-untyped]
    except ImportError as error:
        raise IsfError(
            ErrorCode.EXPORT_FORMAT_UNKNOWN,
            "views in HTML need the package plotly",
            where=str(path),
            advice="pip install plotly, or use a name that ends in .png",
        ) from error
    drawn = go.Figure()
    title = page(drawn)
    drawn.update_layout(
        title=title,
        scene={"aspectmode": "data", **{f"{axis}axis": {"title": {"text": f"{axis} in mm"}} for axis in "xyz"}},
        legend={"x": 0.01, "y": 0.98},
        margin={"l": 0, "r": 0, "t": 40, "b": 0},
    )
    with _to(path):
        drawn.write_html(str(path), include_plotlyjs=True, full_html=True, default_height="97vh")
    return path
