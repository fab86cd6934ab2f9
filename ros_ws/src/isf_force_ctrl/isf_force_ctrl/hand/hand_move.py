"""A straight movement of one tool by hand, as the controller plays it: ramped, bounded in speed, stopped by a touch."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from isf_core.errors import ErrorCode
from isf_core.types import Array

from isf_force_ctrl.control_state import Targets
from isf_force_ctrl.hand.hand_space import place
from isf_force_ctrl.measurements.measurement import AtRest, Glide, Stand
from isf_force_ctrl.motion.segments import Column, Row

SPEED = 10e-3
"""m/s where none is asked for."""

LARGEST_JOG = 30e-3
"""m/s, most of a jog: from it a tool stands 0.06 s after its button was let go."""

NEAR_SHEET = 5e-3
"""m/s, most towards the sheet within ``clearance`` of it: from it a tool stands 0.03 mm after a touch."""

SETTLING = 0.1
"""s at rest before a movement counts as ended: the axes lag behind, and in lockstep time would stand still with it."""

CONFIRMED = 2
"""Ticks above the force that count as a touch."""


class HandMove:
    """A :class:`~isf_force_ctrl.measurements.measurement.Measurement`: the other tool stands.

    A force that grows in the direction of the movement beyond ``touch_force`` N ends it with TOUCHED; away from what
    presses the tool may always go.
    """

    keeps_offsets = False
    phase = "moved by hand"

    def __init__(
        self,
        rest: AtRest,
        tool: int,
        way: Array,
        speed: float,
        *,
        touch_force: float,
        floors: Sequence[float],
        client: str,
    ) -> None:
        """``way`` (3,) m of the tip of ``tool`` (1, 2) at no more than ``speed`` m/s; ``floors`` m, of both tools, as
        of the space."""
        config, length = rest.config, float(np.linalg.norm(way))
        self.tool, self.client, self.length = tool, client, length
        self._config = config
        self._begin: Row = list(rest.row)
        self._tip = Column.TIP_1 if tool == 1 else Column.TIP_2
        self._direction = tuple((np.asarray(way, dtype=float) / max(length, 1e-12)).tolist())
        self._speed = min(speed if speed > 0.0 else SPEED, config.rapid_speed)
        self._up, self._floors, self._touch_force = (1.0 if tool == 1 else -1.0), tuple(floors), touch_force
        self._glide = Glide(length, self._speed, config.acceleration, config.rate)
        self._pressed, self._settled = 0, 0
        self._rest = rest.stand
        self.row: Row = list(self._begin)
        self.force = 0.0
        """N, on the tool, at the last tick."""
        self.code, self.message = ErrorCode.OK, ""
        self.ended = length <= 0.0

    @property
    def tip(self) -> tuple[float, float, float]:
        """(3,) m, commanded now."""
        x, y, z = self.row[self._tip : self._tip + 3]
        return x, y, z

    @property
    def stand(self) -> Stand:
        """As in the protocol: not clear after a touch, until both tools are away from the sheet."""
        clear = self.code is not ErrorCode.TOUCHED and (
            self._rest.clear or min(self._height(1), self._height(2)) >= self._config.clearance
        )
        return Stand(self._rest.tools, np.array([0.0, 0.0, 1.0]), clear=clear)

    @property
    def left(self) -> float:
        """m, way to go."""
        return self.length - self._glide.position

    def stop(self) -> None:
        """The button was let go: come to rest as soon as the ramp allows."""
        self._glide.stop()

    def step(self, time: float, targets: Targets, forces: tuple[float, ...]) -> Row:
        """As in the protocol."""
        self._watch(forces[3 * self.tool - 3 : 3 * self.tool])
        towards = self._up * self._direction[2] < -1e-6
        height = self._height(self.tool)
        self._glide.speed = min(self._speed, NEAR_SHEET) if towards and height < self._config.clearance else self._speed
        moved = self._glide.position if self._glide.at_rest else self._glide.step()
        row = list(self._begin)
        for k in range(3):
            row[self._tip + k] += moved * self._direction[k]
        self.row = row
        self._settled += self._glide.at_rest
        self.ended = self._settled > SETTLING * self._config.rate
        return row

    def give_up(self, code: ErrorCode, text: str, *, stay: bool) -> None:
        """End early, at rest where the tool is; it never goes back by itself."""
        if self.code is ErrorCode.OK:
            self.code, self.message = code, text
        self._glide.stop()

    def add_measured(self, tool: int, time: float, tip: Sequence[float]) -> None:
        """Where the tool is commanded to be is enough."""

    def _height(self, tool: int) -> float:
        """m, of the tip of ``tool`` over its floor."""
        z = self.row[(Column.TIP_1 if tool == 1 else Column.TIP_2) + 2]
        return (1.0 if tool == 1 else -1.0) * (z - self._floors[tool - 1])

    def _watch(self, force: Sequence[float]) -> None:
        self.force = math.hypot(*force)
        against = sum(f * d for f, d in zip(force, self._direction, strict=True)) < 0.0
        self._pressed = self._pressed + 1 if against and self.force > self._touch_force else 0
        if self._pressed >= CONFIRMED and self.code is ErrorCode.OK:
            self.give_up(
                ErrorCode.TOUCHED,
                f"tool_{self.tool} has touched at {place(np.array(self.tip))}: {self.force:.0f} N, more than "
                f"{self._touch_force:g} N, against the movement (move it away; where nothing was touched, tare)",
                stay=True,
            )
