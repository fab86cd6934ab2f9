"""Where a warning points to: places are written into warnings for people, and read from them for pictures."""

from __future__ import annotations

import re
from collections.abc import Iterable

import numpy as np
from isf_core.types import Array

_NUMBER = r"(-?[0-9]+\.?[0-9]*)"
_PLACE = re.compile(rf"x = {_NUMBER}, y = {_NUMBER}(?:, z = {_NUMBER})? mm")

_HEIGHT = re.compile(r"((?:\bz =|\blevel) )(-?[0-9]+\.([0-9]+)) mm")

_SHIFT = re.compile(rf"(\({_NUMBER}, {_NUMBER}, )(-?[0-9]+\.([0-9]+))\) mm")


def in_sheet(text: str, forming_tool: int, base: float) -> str:
    """A text with heights as ``forming_tool`` sees them over a flange at ``base`` m, with those of frame ``sheet``.

    A shift, written as (x, y, z) mm, is turned over with the view; the height of the flange is no part of it.
    """

    def moved(match: re.Match[str]) -> str:
        return f"{match[1]}{-float(match[4]) + 0.0:.{len(match[5])}f}) mm"

    def turned(match: re.Match[str]) -> str:
        height = base * 1e3 + (float(match[2]) if forming_tool == 1 else -float(match[2]))
        return f"{match[1]}{height + 0.0:.{len(match[3])}f} mm"

    if forming_tool == 2:
        text = _SHIFT.sub(moved, text)
    return _HEIGHT.sub(turned, text) if forming_tool == 2 or base else text


def warning_places(warnings: Iterable[str]) -> list[tuple[Array, str]]:
    """Place (3,) m and text of every warning that names one, as :func:`.mesh_checks.place_text` writes it.

    A place without a height gets z = 0.
    """
    found = []
    for text in warnings:
        for match in _PLACE.finditer(text):
            found.append((np.array([float(value or 0.0) for value in match.groups()]) * 1e-3, text))
    return found
