"""How long forming took beside what the plan foresaw, and where the difference went."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from isf_core.contour import Contour

from isf_analysis.measures.force_metrics import engaged, has_set_point
from isf_analysis.measures.record import PartRecord


@dataclass(frozen=True)
class ProcessTime:
    """Of the contours that were formed completely; s, NaN for what needs a control rate that is not known.

    ``actual`` is ``planned`` + ``slowed`` + ``force_ramps`` + ``force_control`` + ``rest``.

    Attributes
    ----------
    contours : number of them
    planned : length of the path over the feed of each contour
    actual : from the first to the last tick of each contour, with its approach
    slowed : what the plan's own lower speeds at single points add to ``planned``
    force_ramps : ticks of force-controlled contours outside of full control: approach, building up and letting go
    force_control : time in full force control less the planned time of those contours: the path is slower, or
        finished while the force was built up (negative)
    rest : of contours under position control: approach, lift, accelerating and braking
    between : from the last tick of one contour to the first of the next: corrections, lifts, scans, waiting; without
        the pairs between which time began anew (the part went on after a crash)
    slowest : index of the contour that took longest beyond its plan ; slowest_excess : s, by how much
    """

    contours: int
    planned: float
    actual: float
    slowed: float
    force_ramps: float
    force_control: float
    rest: float
    between: float
    slowest: int
    slowest_excess: float


def process_time(record: PartRecord) -> ProcessTime | None:
    """Time of the part; None where no contour with its result is recorded as completed."""
    results = {result.index: result for result in record.results if result.completed}
    contours = {contour.index: contour for contour in record.nominal}
    pairs = [(contours[index], result) for index, result in sorted(results.items()) if index in contours]
    if not pairs:
        return None
    planned, slowed = np.array([_planned(contour) for contour, _ in pairs]).T
    actual = np.array([result.end - result.start for _, result in pairs])
    controlled = np.array([has_set_point(result) for _, result in pairs])
    tick = 1.0 / record.control_rate if record.control_rate > 0.0 else math.nan
    full = np.array(
        [
            np.count_nonzero(engaged(result)) * tick if under else 0.0
            for under, (_, result) in zip(controlled, pairs, strict=True)
        ]
    )
    ramps = math.fsum((actual - full)[controlled])
    held = math.fsum((full - planned - slowed)[controlled])
    rest = math.fsum((actual - planned - slowed)[~controlled])
    in_order = [result for _, result in sorted(results.items())]
    # time begins anew where a part went on after a crash: how long it waited is not known
    pauses = [after.start - before.end for before, after in pairwise(in_order)]
    between = math.fsum(pause for pause in pauses if pause >= 0.0)
    excess = actual - planned
    worst = int(np.argmax(excess))
    sums = math.fsum(planned), math.fsum(actual), math.fsum(slowed)
    return ProcessTime(len(pairs), *sums, ramps, held, rest, between, pairs[worst][0].index, float(excess[worst]))


def _planned(contour: Contour) -> tuple[float, float]:
    """s, of the path at the feed, and what lower speeds at its points add."""
    tip = np.vstack([contour.forming_tip, contour.forming_tip[:1]]) if contour.closed else contour.forming_tip
    step = np.linalg.norm(np.diff(tip, axis=0), axis=1)
    at_feed = float(step.sum()) / contour.feed
    if not len(contour.speed):
        return at_feed, 0.0
    speed = np.append(contour.speed, contour.speed[:1]) if contour.closed else contour.speed
    mean = np.minimum(0.5 * (speed[1:] + speed[:-1]), contour.feed)
    return at_feed, float((step / mean).sum()) - at_feed
