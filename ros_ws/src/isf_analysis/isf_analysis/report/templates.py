"""The HTML pages of this package: templates, filled, in one style."""

from __future__ import annotations

from importlib import resources
from string import Template

from isf_core import __version__


def filled(name: str, **parts: str) -> str:
    """The page of template ``name`` with ``parts``, HTML that is ready, in their places."""
    page, style = (resources.files("isf_analysis").joinpath(file).read_text("utf-8") for file in (name, STYLE))
    return Template(page).substitute(parts, page_style=style, version=__version__)


STYLE = "report_style.css"
