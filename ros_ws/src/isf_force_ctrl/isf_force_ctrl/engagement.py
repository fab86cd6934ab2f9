"""When a contour may start, and how fast it is travelled, from the force error.

Engaging ends when the set-point has been ramped and the filtered error has been small for a while; at the latest some
time after the ramp. The feed is lowered in proportion to the error beyond ``feed_error`` (Ren 2018, 5.1.2).
"""

from __future__ import annotations

import math

from isf_force_ctrl.control_config import ControlConfig


class Engagement:
    """Waits at the begin of a contour until the force has settled; one call per tick."""

    def __init__(self, config: ControlConfig) -> None:
        self._config = config
        self._waited = self._settled = 0

    def restart(self) -> None:
        """A new segment begins."""
        self._waited = self._settled = 0

    def over(self, wanted: float, set_point: float, force: float) -> bool:
        """True when the contour may start: ``wanted`` set-point, the present one and the filtered ``force``, N."""
        self._waited += 1
        config = self._config
        near = set_point == wanted and abs(wanted - force) <= config.settled_error
        self._settled = self._settled + 1 if near else 0
        ramp_ticks = abs(wanted) / config.set_point_rate * config.rate
        return (
            self._settled >= config.settled_time * config.rate
            or self._waited >= ramp_ticks + config.engage_timeout * config.rate
        )


def pace(config: ControlConfig, error: float) -> float:
    """Share of the planned feed, feed_floor..1, at the filtered force ``error`` (N)."""
    if config.feed_error == math.inf:
        return 1.0
    excess = (abs(error) - config.feed_error) / config.feed_error
    return max(config.feed_floor, min(1.0, 1.0 - excess))
