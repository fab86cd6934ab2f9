"""What the sheet does that nothing holds between the opening of a part and its clamp or backing plate: it bends there
for good while the part is formed, so that the opening sinks, with or without a correction of springback."""

from __future__ import annotations

import math

SAG = 0.6e-3
"""m by which the opening sinks, over the root of the mm of free sheet around it (14 parts of 1 mm of aluminium under
one tool on the elasto-plastic sheet within a factor of 1.4; scanned cones 0.7 to 1.3 mm: docs/methods/planning.md)."""

OF_DEPTH = 0.6
"""Largest sag over the depth of the part (a part 5 mm deep, free for 113 mm: docs/methods/planning.md)."""

TWO_TOOLS = 0.75
"""Sag with a second tool opposite the contact, over that with one (0.5 to 1.1 on the elasto-plastic sheet)."""


def opening_sag(free: float, depth: float = math.inf, *, two_tools: bool = False) -> float:
    """m, how far an opening sinks beside which the sheet is free for ``free`` m, of a part ``depth`` m deep."""
    return min(SAG * math.sqrt(max(1e3 * free, 0.0)), OF_DEPTH * depth) * (TWO_TOOLS if two_tools else 1.0)
