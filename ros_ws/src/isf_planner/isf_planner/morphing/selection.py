"""Which shapes of a chain are formed (Behera 2015, constraints of the process).

The first one is as steep as two thirds of the angle at which the sheet fails in one pass. Each next one goes as far
towards the part as eq. 1 allows (:mod:`isf_planner.morphing.fold_over`), or, with their number given, each moves the
sheet down by the same volume. A chain is continuous: between two of its shapes lies any in proportion, so a step is
never too coarse.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise

import numpy as np
from isf_core.errors import ErrorCode, IsfError

from isf_planner.morphing.chain import Chain, steepest, steepest_place
from isf_planner.morphing.fold_over import FoldOver, Measure, fold_over
from isf_planner.part.mesh_checks import place_text

FIRST_SHARE = 2.0 / 3.0
"""Wall angle of the first shape over the failure angle (published)."""

NEAREST = 0.03
"""Shapes of a chain; steps are found to this, and shorter ones are none."""

ALLOWED = 0.9
"""Gap over limit up to which steps are taken: on the finer grid of the plan it is a little more."""


STEEPER = np.radians(1.0)
"""By how much a shape may be steeper than the part: a grid knows slopes no better."""


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


def first_place(chain: Chain, first_angle: float) -> float:
    """Where the chain is as steep as ``first_angle`` rad; 0 when the part is no steeper.

    Raises
    ------
    IsfError : MORPH_NOT_REACHED when the chain ends steeper than that
    """
    if steepest(chain.shape(0.0)) <= first_angle:
        return 0.0
    flattest = steepest(chain.shape(chain.length))
    if flattest > first_angle:
        raise IsfError(
            ErrorCode.MORPH_NOT_REACHED,
            f"after {chain.length} shapes the morph is still {np.degrees(flattest):.0f} deg steep, the first shape may "
            f"have {np.degrees(first_angle):.0f} deg",
            where="path.morph",
            advice="a smaller chi, or method diffusion",
        )
    low, high = 0.0, float(chain.length)
    while high - low > NEAREST:
        middle = 0.5 * (low + high)
        if steepest(chain.shape(middle)) > first_angle:
            low = middle
        else:
            high = middle
    return high


def select(
    chain: Chain, spacing: Spacing, count: int | None, *, keep_limit: bool, look: Callable[[], None] = lambda: None
) -> tuple[float, ...]:
    """Places on the chain of the shapes to be formed before the part, the flattest first; none when one pass forms it.

    Parameters
    ----------
    count : number of shapes; None: as many as the limit asks for
    keep_limit : refuse what does not keep it; else, with ``count`` None, take the most that are allowed
    look : called between steps; may raise to end the search

    Raises
    ------
    IsfError : MORPH_NOT_REACHED when the limit cannot be kept with the number of shapes, the chain does not get flat
        enough, or a shape is steeper than the part
    """
    first = first_place(chain, spacing.first_angle)
    if first <= 0.0:
        return ()
    steps = _Steps(chain, spacing, look)
    if count is None:
        places = steps.towards_part(first, ALLOWED)
        if len(places) > spacing.most:
            if keep_limit:
                raise not_reached(steps.fold_over(places[spacing.most - 1], 0.0), spacing.most, spacing.most)
            places = steps.evenly(first, spacing.most)
    else:
        places = steps.evenly(first, count)
    _check_slopes(chain, places)
    if keep_limit:
        worst = max((steps.fold_over(a, b) for a, b in pairwise((*places, 0.0))), key=lambda one: one.ratio)
        if worst.ratio > 1.0:
            raise not_reached(worst, len(places), count or spacing.most)
    return tuple(places)


def with_smaller_steps(
    chain: Chain, places: Sequence[float], part: float, allowed: Callable[[float], float], most: int
) -> tuple[float, ...]:
    """``places`` on the chain, the flattest first, and those in between that it takes for no wall to be too steep for
    its pass.

    Parameters
    ----------
    part : rad, steepest wall of the part ; allowed : rad, steepest wall after one of so many rad
    most : shapes before the part

    Raises
    ------
    IsfError : MORPH_NOT_REACHED with the place when that takes more shapes, or no shape lies in between
    """
    made = list(places)
    k = 1
    while k <= len(made):
        at = made[k] if k < len(made) else 0.0
        limit = allowed(steepest(chain.shape(made[k - 1])))
        angle = steepest(chain.shape(at)) if k < len(made) else part
        if angle <= limit + STEEPER:
            k += 1
            continue
        between = _largest(partial(_within, chain, limit), at, made[k - 1])
        if len(made) >= most or made[k - 1] - between < NEAREST:
            room = len(made) < most
            raise IsfError(
                ErrorCode.MORPH_NOT_REACHED,
                f"with {len(made)} shapes before the part walls get steeper from {np.degrees(limit):.0f} deg, which "
                f"may be planned, to {np.degrees(angle):.0f} deg in one step"
                + ("; no shape in between is flatter" if room else ""),
                where=f"shape at {place_text(steepest_place(chain.shape(at)))}",
                advice="another path.morph.method" if room else "allow more shapes (path.morph.most_shapes)",
            )
        made.insert(k, between)
    return tuple(made)


def _check_slopes(chain: Chain, places: Sequence[float]) -> None:
    part = steepest(chain.shape(0.0))
    slope = max(steepest(chain.shape(at)) for at in places)
    if slope > part + STEEPER:
        raise IsfError(
            ErrorCode.MORPH_NOT_REACHED,
            f"a shape before the part is {np.degrees(slope):.0f} deg steep where it is joined to the flange, the part "
            f"{np.degrees(part):.0f} deg",
            where="path.morph.joint_width",
            advice="a narrower joint, or leave joint_width out (the tool radius)",
        )


def not_reached(worst: FoldOver, count: int, most: int) -> IsfError:
    """MORPH_NOT_REACHED for a limit that ``count`` of at most ``most`` shapes do not keep."""
    more = "allow more shapes (path.morph.shapes or most_shapes), " if count >= most else ""
    return IsfError(
        ErrorCode.MORPH_NOT_REACHED,
        f"with {count} shapes the sheet may fold over: the next wall lies {worst.gap_text} away, "
        f"{worst.limit * 1e3:.1f} mm are allowed" + ("" if more else "; no shape in between is nearer"),
        where=f"shape at {place_text(worst.place)}",
        advice=f"{more}use a larger tool or a flatter wall, or only be warned (path.morph.fold_over: warn)",
    )


@dataclass(frozen=True)
class _Steps:
    chain: Chain
    spacing: Spacing
    look: Callable[[], None]

    def fold_over(self, before: float, after: float) -> FoldOver:
        self.look()
        chain, spacing = self.chain, self.spacing
        shapes = chain.shape(before), chain.shape(after)
        return fold_over(*shapes, spacing.radius, spacing.first_angle, spacing.measure)

    def towards_part(self, first: float, ratio: float) -> list[float]:
        """Places from ``first`` on, as far as ``ratio`` allows, until the part can follow; one too many at most."""
        places = [first]
        while len(places) <= self.spacing.most and self.fold_over(places[-1], 0.0).ratio > ratio:
            last = places[-1]
            place = _largest(lambda at, last=last: self.fold_over(last, at).ratio <= ratio, 0.0, last)  # type: ignore[misc]
            if last - place < NEAREST:
                break
            places.append(place)
        return places

    def evenly(self, first: float, count: int) -> list[float]:
        """``count`` places from ``first`` on, with the same volume between each two, and the last and the part."""
        volume = -self.chain.z.sum(axis=(1, 2))
        falling = np.minimum.accumulate(volume)
        start = float(np.interp(first, np.arange(len(volume)), falling))
        wanted = start + (falling[0] - start) * np.arange(count) / count
        return [float(at) for at in np.interp(-wanted, -falling, np.arange(len(volume)))]


def _within(chain: Chain, limit: float, place: float) -> bool:
    """Whether the shape at ``place`` of the ``chain`` is nowhere steeper than ``limit`` rad."""
    return steepest(chain.shape(place)) <= limit


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
