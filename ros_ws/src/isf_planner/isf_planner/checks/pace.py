"""How long the tools take from point to point of a contour, as the force controller plays it."""

from __future__ import annotations

import numpy as np
from isf_core.contour import Contour
from isf_core.types import Array, Indices

SUPPORT_RATIO = 2.0
"""Speed of the support tool over that of the forming tool at which both get slower: the force controller's."""


def paced(contour: Contour) -> tuple[Indices, Array]:
    """(M,) points in order, of a closed contour back to the first one, and (M-1,) s from each to the next.

    Both tools are at a point at the same time, and the feed is that of the forming tip: on the outside of a corner the
    support tool has the longer way, and is so much faster up to :data:`SUPPORT_RATIO`. That both are slower where they
    speed up, brake or turn is left out.
    """
    n = len(contour)
    speed = contour.speed if len(contour.speed) else np.full(n, contour.feed)
    order = np.append(np.arange(n), 0) if contour.closed else np.arange(n)
    way = np.linalg.norm(np.diff(contour.forming_tip[order], axis=0), axis=1)
    if contour.has_support:
        across = np.linalg.norm(np.diff(contour.support_tip[order], axis=0), axis=1)
        way = np.maximum(way, across / SUPPORT_RATIO)
    return order, way / speed[order[:-1]]
