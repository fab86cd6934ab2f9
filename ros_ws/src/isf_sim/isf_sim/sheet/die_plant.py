"""The sheet in two-point forming: a die rises through it, and what the tool has walked round rises with the die.

Frame ``sheet`` travels with the blank holder, so the tool goes round at a constant height while the die comes up. When
the holder moves by dh, the part, which is all that the loops so far enclose, rises by dh as a whole (the die carries
it), nothing is left below the die, and the flange hangs between the edge of the part and the clamp
(:mod:`isf_sim.sheet.flange_following`); the tool then presses the raised edge down to its ball. The elastic answer is
that of the shell on its one-sided support. Assumed: the part moves as a whole; its top does not follow the tool as a
base does over an open clamp.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from isf_core.types import Array, Mask
from scipy.ndimage import binary_fill_holes, distance_transform_edt

from isf_sim.sheet import flange_following
from isf_sim.sheet.sheet_plant import SheetPlant
from isf_sim.sheet.sheet_point import LAST_BASE, TRAVELLED

CLOSING = 0.25
"""Over the radius of the tool: a loop whose ends are less than twice this apart encloses what it goes round."""


class DiePlant(SheetPlant):
    """A SheetPlant over a die; :meth:`note` every tick, :meth:`rise` when the holder has moved.

    Attributes
    ----------
    walked : (ny, nx) where the tool has gone along the sheet since the last loop was closed
    part : (ny, nx) what closed loops enclose, it rises with the die ; flange : m, see flange_following
    """

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        shape = self.surface.height.shape
        self.walked: Mask = np.zeros(shape, dtype=bool)
        self.part: Mask = np.zeros(shape, dtype=bool)
        self._stride = max(1, round(self.constants.track_cell / self.surface.h))
        self.flange: Array = np.zeros(tuple((n - 1) // self._stride + 1 for n in shape))
        self._last = (-1, -1)
        self._begun = 0.0

    def note(self) -> None:
        """Mark where the tool presses, or goes round so low that the sheet could not rise past it."""
        surface, contact = self.surface, self.contact
        i = round((float(contact.last[0]) - surface.x0) / surface.h)
        j = round((float(contact.last[1]) - surface.y0) / surface.h)
        ny, nx = self.walked.shape
        on_sheet = 0 <= j < ny and 0 <= i < nx
        if not on_sheet or float(contact.last[2]) > surface.height[j, i] + self.point_constants.step:
            self._last = (-1, -1)
            return
        before, self._last = self._last, (j, i)
        if self._last == before:
            return
        steps = max(abs(j - before[0]), abs(i - before[1])) if before[0] >= 0 else 0
        if steps <= 1:
            self.walked[j, i] = True
        else:  # a fast tool skips nodes
            share = np.arange(steps + 1) / steps
            rows, columns = before[0] + share * (j - before[0]), before[1] + share * (i - before[1])
            self.walked[np.rint(rows).astype(int), np.rint(columns).astype(int)] = True

    def rise(self, support: Array, offset: float) -> None:
        """Bring the die, ``support`` (ny, nx) m at rest, to ``offset`` m above its start."""
        surface = self.surface
        way = offset - float(surface.holder[1])
        self.set_support(support, offset)
        if way > 0.0:
            self._close_loop()
            self._begun = float(self.contact.path[TRAVELLED])
            for height in (surface.height, surface.before):
                height[self.part] += way
        standing = surface.support + offset
        lifted = standing > surface.height + 1e-9
        surface.formed[lifted] = 1
        for height in (surface.height, surface.before):
            np.maximum(height, standing, out=height, where=np.isfinite(standing))
        self._hang_flange()

    def update_base(self) -> None:
        """The die carries the part; the flange follows the tool."""
        self._hang_flange()
        self.contact.path[LAST_BASE] = self.contact.path[TRAVELLED]

    def _hang_flange(self) -> None:
        surface = self.surface
        carried = surface.height <= surface.support + surface.holder[1] + 1e-9
        held = self.part | carried | self.walked | (surface.touched > self._begun)
        flange_following.follow(surface, held, self.flange, self._stride)
        standing = surface.support + surface.holder[1]
        for height in (surface.height, surface.before):
            np.maximum(height, standing, out=height, where=np.isfinite(standing))

    def _close_loop(self) -> None:
        """Add what the walked loop encloses to the part, unless the loop is still open."""
        found = np.argwhere(self.walked)
        if len(found) == 0:
            return
        reach = CLOSING * self.radius / self.surface.h
        margin = math.ceil(reach) + 2
        low = np.maximum(found.min(axis=0) - margin, 0)
        high = found.max(axis=0) + margin + 1
        window = np.s_[low[0] : high[0], low[1] : high[1]]
        wide = distance_transform_edt(~self.walked[window]) <= reach
        filled = binary_fill_holes(wide)
        if np.count_nonzero(filled) == np.count_nonzero(wide):
            return
        self.part[window] |= distance_transform_edt(filled) > reach
        self.walked[...] = False
