"""Pictures as files: PNG, or one HTML file to be turned in a browser; what keeps one from being written is told."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from isf_core.errors import ErrorCode, IsfError
from isf_core.view import page as view_page
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
    drawn = view_page.new_figure()
    text = view_page.page(drawn, page(drawn))
    with _to(path):
        path.write_text(text, encoding="utf-8")
    return path
