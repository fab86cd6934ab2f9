"""Which shapes of a chain are formed (Behera 2015, constraints of the process).

The first one is as steep as two thirds of the angle at which the sheet fails in one pass. Each next one goes as far
towards the part as eq. 1 allows (:mod:`isf_planner.morphing.fold_over`), or, with their number given, all go equally
far by it. A chain is continuous: between two of its shapes lies any in proportion, so a step is never too coarse.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from isf_core.errors import ErrorCode, IsfError

from isf_planner.morphing.chain import Chain, steepest
from isf_planner.morphing.fold_over import NONE, FoldOver, Measure, fold_over
from isf_planner.part.mesh_checks import place_text

FIRST_SHARE = 2.0 / 3.0
"""Wall angle of the first shape over the failure angle (published)."""

NEAREST = 0.02
"""Shapes of a chain; steps are found to this, and shorter ones are none."""

ALLOWED = 0.98
"""Gap over limit up to which a step is taken when the limit is kept: the finer grid of the plan measures a little
more."""

LARGEST_RATIO = 20.0
"""Gap over limit beyond which an even spacing of few shapes is not looked for."""


@dataclass(frozen=True)
class Spacing:
    """How the steps of a chain are measured.

    Attributes
    ----------
    radius : m, of the tool ; first_angle : rad, of the first shape ; measure : of the gap
    most : largest number of shapes before the part
    """

    radius: float
    first_angle: float
    measure: Measure
    most: int


@dataclass(frozen=True)
class Selection:
    """Places on the chain, from the flattest shape to the one before the part, and the fold-over of every step.

    ``fold_overs`` has one more: of the part after the last shape.
    """

    places: tuple[float, ...]
    fold_overs: tuple[FoldOver, ...]


def first_place(chain: Chain, first_angle: float) -> float:
    """Where the chain is as steep as ``first_angle`` rad; 0 when the part is no steeper."""
    if steepest(chain.shape(0.0)) <= first_angle:
        return 0.0
    low, high = 0.0, float(chain.length)
    while high - low > NEAREST:
        middle = 0.5 * (low + high)
        if steepest(chain.shape(middle)) > first_angle:
            low = middle
        else:
            high = middle
    return high


def select(chain: Chain, spacing: Spacing, count: int | None, *, keep_limit: bool) -> Selection:
    """Shapes to be formed before the part; none when one pass forms it.

    Parameters
    ----------
    count : number of shapes; None: as many as the limit asks for
    keep_limit : refuse what does not keep it; else, with ``count`` None, take the most that are allowed

    Raises
    ------
    IsfError : MORPH_NOT_REACHED when the limit cannot be kept with the number of shapes
    """
    first = first_place(chain, spacing.first_angle)
    if first <= 0.0:
        return Selection((), ())
    steps = _Steps(chain, spacing)
    if count is None:
        places = steps.towards_part(first, ALLOWED)
        if len(places) > spacing.most:
            if keep_limit:
                raise _not_reached(steps.fold_over(places[spacing.most - 1], 0.0), spacing.most)
            places = steps.evenly(first, spacing.most)
    else:
        places = steps.evenly(first, count)
    ends = (*places[1:], 0.0)
    found = (NONE, *(steps.fold_over(a, b) for a, b in zip(places, ends, strict=True)))
    worst = max(found, key=lambda one: one.ratio)
    if keep_limit and worst.ratio > 1.0:
        raise _not_reached(worst, len(places))
    return Selection(tuple(places), found)


def _not_reached(worst: FoldOver, count: int) -> IsfError:
    return IsfError(
        ErrorCode.MORPH_NOT_REACHED,
        f"with {count} shapes the sheet may fold over: the next wall lies {worst.gap * 1e3:.1f} mm away, "
        f"{worst.limit * 1e3:.1f} mm are allowed",
        where=f"shape at {place_text(worst.place)}",
        advice="allow more shapes (path.morph.shapes or most_shapes), use a larger tool or a flatter wall, or only be "
        "warned (path.morph.fold_over: warn)",
    )


@dataclass(frozen=True)
class _Steps:
    chain: Chain
    spacing: Spacing

    def fold_over(self, before: float, after: float) -> FoldOver:
        chain, spacing = self.chain, self.spacing
        shapes = chain.shape(before), chain.shape(after)
        return fold_over(*shapes, spacing.radius, spacing.first_angle, spacing.measure)

    def towards_part(self, first: float, ratio: float, most: int | None = None) -> list[float]:
        """Places from ``first`` on, as far as ``ratio`` allows, until the part can follow: ``most`` + 1 at most."""
        places = [first]
        limit = self.spacing.most if most is None else most
        while len(places) <= limit and self.fold_over(places[-1], 0.0).ratio > ratio:
            last = places[-1]
            places.append(_largest(lambda at, last=last: self.fold_over(last, at).ratio <= ratio, 0.0, last))  # type: ignore[misc]
            if last - places[-1] < NEAREST:
                break
        return places

    def evenly(self, first: float, count: int) -> list[float]:
        """``count`` places whose steps have the same ratio of gap and limit, the last one to the part included."""
        low, high = 0.0, LARGEST_RATIO
        while high - low > 0.02:
            middle = 0.5 * (low + high)
            if len(self.towards_part(first, middle, count)) > count:
                low = middle
            else:
                high = middle
        places = self.towards_part(first, high, count)[:count]
        # fewer do: the steps left over halve the last ones
        while len(places) < count:
            ends = [*places, 0.0]
            widest = int(np.argmax([a - b for a, b in itertools.pairwise(ends)]))
            places.insert(widest + 1, 0.5 * (ends[widest] + ends[widest + 1]))
        return places


def _largest(allowed: Callable[[float], bool], low: float, high: float) -> float:
    """The place farthest from ``high`` (towards ``low``) that is still allowed, found by halving."""
    good = high
    while good - low > NEAREST:
        middle = 0.5 * (low + good)
        if allowed(middle):
            good = middle
        else:
            low = middle
    return good
