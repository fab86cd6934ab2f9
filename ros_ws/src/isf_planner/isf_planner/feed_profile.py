"""Speed along the path from an acceleration limit: slow in corners and at both ends, the feed elsewhere.

Half of the squared limit is for the turn, half for speeding up and slowing down, so that both together keep it:
v^2 <= a k^-1 / sqrt(2) in a turn of curvature k, and v may change by a / sqrt(2) per second.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from isf_core.contour import Contour
from numpy.typing import NDArray

Array = NDArray[np.float64]

SLOWEST = 0.02
"""Part of the feed that is never undercut: a speed of zero would never leave a point."""


def with_speed(contours: Sequence[Contour], joins: Sequence[bool], acceleration: float | None) -> list[Contour]:
    """Contours with ``speed`` (m/s) for an ``acceleration`` limit (m/s^2); as they are without one.

    ``joins``: the contour begins where the one before ends and the tool runs on without a stop.
    """
    if acceleration is None:
        return list(contours)
    result: list[Contour] = []
    starts = [k for k, joined in enumerate(joins) if not joined]
    for begin, end in zip(starts, [*starts[1:], len(contours)], strict=True):
        result += _run(contours[begin:end], acceleration)
    return result


def speeds(points: Array, closed: bool, feed: float, acceleration: float) -> Array:
    """(N,) m/s along points (N, 3) m, starting and ending at rest; ``closed``: it ends at the first point."""
    line = np.vstack([points, points[:1]]) if closed else points
    step = np.linalg.norm(np.diff(line, axis=0), axis=1)
    share = acceleration / np.sqrt(2.0)
    limit = np.full(len(line), feed)
    # the turn of the direction over two points before and after: single points carry the noise of settling
    reach = 2 if len(line) > 5 else 1
    before, after = line[reach:-reach] - line[: -2 * reach], line[2 * reach :] - line[reach:-reach]
    length = 0.5 * (np.linalg.norm(before, axis=1) + np.linalg.norm(after, axis=1))
    cosine = (before * after).sum(axis=1) / np.maximum(np.linalg.norm(before, axis=1), 1e-12)
    turn = np.arccos(np.clip(cosine / np.maximum(np.linalg.norm(after, axis=1), 1e-12), -1.0, 1.0))
    limit[reach:-reach] = np.minimum(feed, np.sqrt(share * length / np.maximum(turn, 1e-9)))
    limit[0] = limit[-1] = 0.0
    squares = limit**2
    for k in range(1, len(line)):
        squares[k] = min(squares[k], squares[k - 1] + 2 * share * step[k - 1])
    for k in range(len(line) - 2, -1, -1):
        squares[k] = min(squares[k], squares[k + 1] + 2 * share * step[k])
    return np.maximum(np.sqrt(squares), SLOWEST * feed)[: len(points)]


def _run(contours: Sequence[Contour], acceleration: float) -> list[Contour]:
    """Contours passed without a stop; the points where two of them meet are shared."""
    if len(contours) == 1 and contours[0].closed:
        only = contours[0]
        return [replace(only, speed=speeds(only.forming_tip, True, only.feed, acceleration))]
    line = np.vstack([contours[0].forming_tip[:1], *[contour.forming_tip[1:] for contour in contours]])
    speed = speeds(line, False, contours[0].feed, acceleration)
    cuts = np.cumsum([0] + [len(contour) - 1 for contour in contours])
    return [
        replace(contour, speed=speed[a : b + 1]) for contour, a, b in zip(contours, cuts[:-1], cuts[1:], strict=True)
    ]
