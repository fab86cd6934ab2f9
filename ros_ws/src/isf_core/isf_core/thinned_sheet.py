"""How thick a simulated sheet is after forming, and how much more it bears, at its own nodes."""

from __future__ import annotations

from dataclasses import dataclass

from isf_core.types import Array


@dataclass(frozen=True)
class ThinnedSheet:
    """Nodes of a formed sheet in rows and columns, frame ``sheet``; neighbours in the sheet are neighbours here.

    Attributes
    ----------
    points : (ny, nx, 3) m, upper face in the clamp
    thickness : (ny, nx) m, along the normal
    strain_margin : (ny, nx) true strain that is left before the material's forming limit without the support of a
        second tool (:class:`isf_core.files.material.FormingLimit`), negative beyond it; NaN where it is not known
    """

    points: Array
    thickness: Array
    strain_margin: Array
