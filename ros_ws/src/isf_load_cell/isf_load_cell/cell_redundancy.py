"""What nine channels tell of three components of force, and of each other: three tri-axial cells around a spindle.

Axial channels give the force by equilibrium (Torrao 2013 eq. 3.6); the shear channels, which share the horizontal force
equally (eq. 3.8-3.10), give it once more. So one lost axial channel follows from the rest, and a channel that is off
shows: the nine readings then fit no force (parity space; the channel is the one without which they do). N, m.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from itertools import combinations

import numpy as np
from isf_core.errors import ErrorCode, IsfError
from isf_core.types import Array
from numpy.typing import NDArray

AXIAL = (2, 5, 8)
"""Places of the axial channels among the nine, which are x, y, axial of cell 1, then of cells 2 and 3."""

MAXIMUM_AMPLIFICATION = 8.0
"""N of error in a component of the force per N of error in each channel, beyond which it counts as not known. All
channels: 1.7; one axial channel lost: 4.9; a whole cell lost: 5.8; two axial channels lost: 9.3 (at the published
lengths)."""

EXPLAINED = 0.5
"""Share of the disagreement that may be left when the right channel is left out. Another one leaves 0.8 or more."""

Live = tuple[bool, ...]
"""For each of the nine channels whether it counts."""
Order = NDArray[np.int64]
LoadsOf = Callable[[Order, bool], Array]


def decomposition(height: float, radius: float) -> Array:
    """(3, 3), horizontal x, y and vertical force from the three axial readings (eq. 3.3-3.6); lengths in m."""
    lever, root = radius / height, np.cos(np.radians(30.0))
    return np.array([[lever, -lever / 2, -lever / 2], [0.0, lever * root, -lever * root], [1.0, 1.0, 1.0]])


def responses(height: float, radius: float) -> Array:
    """(9, 3) N in the channels per N of horizontal x, y and vertical force."""
    found = np.zeros((9, 3))
    found[0::3, 0] = found[1::3, 1] = 1.0 / 3.0
    found[list(AXIAL)] = np.linalg.inv(decomposition(height, radius))
    return found


class CellRedundancy:
    """Force from the channels that count, for cells at ``radius`` m with the tip ``height`` m below them."""

    def __init__(self, height: float, radius: float) -> None:
        self._axial = decomposition(height, radius)
        self._responses = responses(height, radius)
        self.force_matrix = cache(self._force_matrix)
        self.parity = cache(self._parity)
        self.expected = cache(self._expected)

    def _force_matrix(self, live: Live) -> Array:
        """(3, 9): force from readings in N, in which those that do not count are 0.

        Axial channels alone, as long as all three count; shear channels for the axial one that does not. Raises
        IsfError WRENCH_INCONSISTENT when the force is not known from ``live``.
        """
        found, use = np.zeros((3, 9)), np.array(live)
        axial = use[list(AXIAL)]
        if axial.all():
            found[:, AXIAL] = self._axial
            return found
        shear = use.copy()
        shear[list(AXIAL)] = False
        here = np.array(AXIAL)[axial]
        known = np.linalg.pinv(self._responses[here])
        open_ways = self._axial[:, ~axial]  # forces that only the lost axial channels would show
        seen = self._responses[shear] @ open_ways
        if np.linalg.matrix_rank(seen) == open_ways.shape[1]:
            fill = open_ways @ np.linalg.pinv(seen)
            found[:, here] = known - fill @ self._responses[shear] @ known
            found[:, shear] = fill
            if np.linalg.norm(found, axis=1).max() <= MAXIMUM_AMPLIFICATION:
                return found
        raise IsfError(ErrorCode.WRENCH_INCONSISTENT, "the other channels do not tell the force")

    def _parity(self, live: Live) -> Array:
        """(9, 9): what of the readings in N fits no force, over the channels that count."""
        use = np.array(live)
        found = np.zeros((9, 9))
        part = self._responses[use]
        found[np.ix_(use, use)] = np.eye(int(use.sum())) - part @ np.linalg.pinv(part)
        return found

    def _expected(self, live: Live) -> Array:
        """(9, 9): reading in N of each channel by the others that count; where they do not tell it, by the smallest
        force that they allow. 0 on the diagonal and for what does not count."""
        found = np.zeros((9, 9))
        for k in np.flatnonzero(live).tolist():
            others = np.array(live)
            others[k] = False
            found[k, others] = self._responses[k] @ np.linalg.pinv(self._responses[others])
        return found

    def disagreement(self, readings: Array, live: Live) -> float:
        """N, how far ``readings`` (9,) N are from those of any force."""
        return float(np.linalg.norm(self.parity(live) @ readings))

    def suspects(self, readings: Array, live: Live) -> tuple[tuple[int, ...], float]:
        """The channels without any one of which ``readings`` (9,) N fit a force, and the disagreement, N, that is left
        without the best of all channels. Several: it cannot be told which; none: no single one explains it."""
        parity = self.parity(live)
        off, share = parity @ readings, np.diag(parity)
        seen = share > 1e-6
        left = np.full(9, np.inf)
        left[seen] = np.sqrt(np.maximum(off @ off - off[seen] ** 2 / share[seen], 0.0))
        found = np.flatnonzero(left <= EXPLAINED * np.linalg.norm(off))
        return tuple(found.tolist()), float(left.min())

    def exchanged(self, loads_of: LoadsOf, live: Live) -> tuple[tuple[int, ...], float]:
        """The two channels whose cables are exchanged, and the disagreement, N, that is left with them put right; none
        and inf when no exchange explains the disagreement.

        ``loads_of`` gives the readings (9,) N for the order (9,) of the cables, with the zero in the same order (it was
        taken after the exchange), or not.
        """
        parity, order = self.parity(live), np.arange(9)
        limit = EXPLAINED * float(np.linalg.norm(parity @ loads_of(order, True)))
        pair: tuple[int, ...] = ()
        best = np.inf
        for i, j in combinations(np.flatnonzero(live).tolist(), 2):
            other = order.copy()
            other[[i, j]] = j, i
            left = min(float(np.linalg.norm(parity @ loads_of(other, with_zero))) for with_zero in (True, False))
            if left < min(limit, best):
                pair, best = (i, j), left
        return pair, best
