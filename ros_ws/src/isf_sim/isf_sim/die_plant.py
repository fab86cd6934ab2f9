"""The sheet in two-point forming: a die rises through it, and what the tool has walked round rises with the die.

Frame ``sheet`` travels with the blank holder, so the tool goes round at a constant height while the die comes up. Kept
as simple as the process allows: when the holder moves by dh, the region enclosed by the last contour rises by dh (it
is carried by the die), nothing is left below the die, and the flange outside stays; the tool then presses the raised
edge down to its ball. The elastic answer is that of the shell on its one-sided support. Assumed: the enclosed sheet
moves as a whole; its base does not follow the tool as it does over an open clamp.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_fill_holes

from isf_sim.sheet_plant import SheetPlant
from isf_sim.sheet_point import LAST_BASE, TRAVELLED

Array = NDArray[np.float64]


class DiePlant(SheetPlant):
    """A SheetPlant over a die; :meth:`note` every tick, :meth:`rise` when the holder has moved."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self.walked: NDArray[np.bool_] = np.zeros(self.surface.height.shape, dtype=bool)

    def note(self) -> None:
        """Mark where the tool presses."""
        if self.contact.axial[0] + self.contact.on_die[0] <= 0.0:
            return
        surface = self.surface
        i = round((float(self.contact.formed_tip[0]) - surface.x0) / surface.h)
        j = round((float(self.contact.formed_tip[1]) - surface.y0) / surface.h)
        if 0 <= j < self.walked.shape[0] and 0 <= i < self.walked.shape[1]:
            self.walked[j, i] = True

    def rise(self, support: Array, offset: float) -> None:
        """Bring the die, ``support`` (ny, nx) m at rest, to ``offset`` m above its start."""
        surface = self.surface
        way = offset - float(surface.holder[1])
        self.set_support(support, offset)
        if way > 0.0:
            enclosed = binary_fill_holes(self.walked) & ~self.walked
            for height in (surface.height, surface.before):
                height[enclosed] += way
            self.walked[...] = False
        standing = surface.support + offset
        surface.formed[standing > surface.height + 1e-9] = 1
        for height in (surface.height, surface.before):
            np.maximum(height, standing, out=height, where=np.isfinite(standing))

    def update_base(self) -> None:
        """The die carries the base: it does not follow the tool."""
        self.contact.path[LAST_BASE] = self.contact.path[TRAVELLED]
