"""Vertical and tangential force on the support tool, controlled beside the horizontal normal one on request.

Between two balls the force acts along the line of centres: the horizontal normal loop sets its size, and only the
*direction* of the line can be chosen besides. Moving the support tool by s at right angles to that line turns it:

    vertical     s in the vertical plane of the line, away from the sheet's middle: dV / ds   = F_n / (l sin^2 a)
    tangential   s along the wall, horizontally:                                    dF_t / ds = F_n / L

F_n: set-point of the horizontal normal force; l, L: distance of the commanded ball centres in space and in the plane;
sin a = L / l. These stiffnesses are geometric, some 15 N/mm at 120 N, fifty times softer than the contact, and motion
at right angles to the line leaves the gap alone. So the law of :mod:`isf_force_ctrl.contact_force` acts on each, slowly
(``component_gain`` 1/s), and stays out of the way of the normal loop; margins: :func:`stability.component_margin`.

V is positive in compression, F_t along d_n (to the support tool) turned by +90 deg about z. Frictionless, V is
F_n cot(a) (Ren 2018, 2.3): the set-point when none is given.
"""

from __future__ import annotations

import math

from isf_force_ctrl.contact_force import ContactForceLoop
from isf_force_ctrl.control_config import ControlConfig
from isf_force_ctrl.segments import Row

LEAST_FORCE = 20.0
"""N, smaller set-points of the normal force count as this one in the gains."""
NEGLIGIBLE = 1e-10
"""m, offset that is dropped."""
LEAST_DISTANCE = 0.5e-3
"""m, smaller horizontal distances of the ball centres count as this one."""


class ForceComponents:
    """Offset of one tool, while it supports, for the vertical and the tangential force; one call per tick.

    ``tool``: 1 or 2. :attr:`offset` is (3,) m in frame ``sheet``.
    """

    def __init__(self, config: ControlConfig, tool: int) -> None:
        self._vertical = ContactForceLoop(config.component_force()) if config.vertical else None
        self._tangential = ContactForceLoop(config.component_force()) if config.tangential else None
        self._loops = [loop for loop in (self._vertical, self._tangential) if loop is not None]
        self._config = config
        self._sign = 1.0 if tool == 2 else -1.0
        self.offset = (0.0, 0.0, 0.0)
        """m, present offset."""

    @property
    def flags(self) -> int:
        """Limits that were active in the last tick, a sum of Flag."""
        flags = 0
        for loop in self._loops:
            flags |= loop.flags
        return flags

    @property
    def at_rest(self) -> bool:
        """True when nothing is left of the offsets."""
        return all(abs(loop.offset) < NEGLIGIBLE for loop in self._loops)

    def control(self, row: Row, force: tuple[float, float, float], normal_force: float) -> None:
        """One tick towards both set-points with the ``force`` of the sheet on the tool, N.

        ``normal_force`` N: set-point of the horizontal normal loop.
        """
        config, sign = self._config, self._sign
        flat, sine, cosine = self._line(row)
        pressed = max(normal_force, LEAST_FORCE)
        if self._vertical is not None:
            wanted = normal_force * cosine / sine if config.vertical_force is None else config.vertical_force
            self._vertical.set_gain(config.component_gain * flat * sine / pressed)
            self._vertical.control(wanted + sign * force[2])
        if self._tangential is not None:
            self._tangential.set_gain(config.component_gain * flat / pressed)
            self._tangential.control(config.tangential_force + sign * (row[7] * force[0] - row[6] * force[1]))
        self._place(row, sine, cosine)

    def freeze(self, row: Row) -> None:
        """Bring the offsets to rest."""
        for loop in self._loops:
            loop.freeze()
        self._place(row, *self._line(row)[1:])

    def ramp_back(self, row: Row) -> None:
        """One tick of taking the offsets back to zero."""
        for loop in self._loops:
            loop.ramp_back()
        self._place(row, *self._line(row)[1:])

    def _line(self, row: Row) -> tuple[float, float, float]:
        """Horizontal distance of the commanded ball centres, m; sine and cosine of the line's angle from the z axis."""
        flat = max(math.hypot(row[3] - row[0], row[4] - row[1]), LEAST_DISTANCE)
        height = row[2] - row[5] + self._config.ball_reach
        apart = math.hypot(flat, height)
        return flat, flat / apart, height / apart

    def _place(self, row: Row, sine: float, cosine: float) -> None:
        sign = self._sign
        out_x, out_y = sign * row[6], sign * row[7]
        turned = 0.0 if self._vertical is None else self._vertical.offset
        along = 0.0 if self._tangential is None else self._tangential.offset
        inward = -cosine * turned
        self.offset = (inward * out_x - along * out_y, inward * out_y + along * out_x, -sign * sine * turned)
