"""What a bag lacks of a part, for people: contours without their messages, streams of which it holds nothing, and times
of receipt that do not follow each other."""

from __future__ import annotations

import itertools
from collections.abc import Collection, Iterable, Sequence

from isf_core.contour import Contour, ContourCorrection, ContourResult, contour_label

from isf_analysis.bag import topics
from isf_analysis.bag.topics import Topic

NANO = 1_000_000_000

LATE = NANO
"""ns by which a message may be received before one that was sent earlier on another topic (assumed)."""


def contours_missing(
    nominal: Sequence[Contour],
    corrected: Sequence[Contour],
    corrections: Sequence[ContourCorrection],
    results: Sequence[ContourResult],
) -> list[str]:
    """Contours and results missing between the first and the last recorded contour, and what was corrected of those
    that have a result: the springback node sends both for every contour, also where nothing is corrected."""
    planned = {contour.index for contour in nominal}
    reported = {result.index for result in results}
    until = range(max(planned | reported))
    wanted: tuple[tuple[Topic, Collection[int], set[int]], ...] = (
        (topics.NOMINAL, until, planned),
        (topics.CORRECTION, reported, {correction.index for correction in corrections}),
        (topics.CORRECTED, reported, {contour.index for contour in corrected}),
        (topics.RESULT, until, reported),
    )
    found = []
    for topic, needed, known in wanted:
        lost = sorted(set(needed) - known)
        if lost and not known:
            found.append(topic.name)
        elif lost:
            found.append(f"{topic.name} of {len(lost)} contour(s), first {contour_label(lost[0])}")
    return found


def needed_streams(nominal: Iterable[Contour]) -> list[Topic]:
    """Topics on which a cell of nodes has sent something while it formed ``nominal``: wrenches and poses of the tools
    that were used, and what force control was armed with."""
    tools = {tool for contour in nominal for tool in ((1, 2) if contour.has_support else (contour.forming_tool,))}
    return [*(kind[tool - 1] for kind in (topics.WRENCHES, topics.POSES) for tool in sorted(tools)), topics.ARMED]


def jumps_back(received: Sequence[tuple[str, int]]) -> list[tuple[str, int]]:
    """(where, ns) of each time of receipt that lies before the one of ``received`` (where, ns) that was sent earlier.

    The order is that in which they were sent. A jump that is shorter than the time between two of them is not seen.
    """
    steps = itertools.pairwise(received)
    return [(where, before - time) for (where, before), (_, time) in steps if before - time > LATE]
