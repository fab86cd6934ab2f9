"""Where your hardware goes: keep the methods of :class:`Hardware`, replace what they do.

Here a sheet of springs stands in for it: tools follow their targets with a lag, the sheet gives way like a spring that
yields, and two tools that squeeze it are pushed apart by another spring. All methods are called from one thread.

SI units, frame ``sheet``: origin at the centre of the blank, on its upper surface, z up. A tool's position is its tip,
the lowest point of the upper ball, the highest of the lower one. A force is what the sheet does to the tool.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

RADIUS, THICKNESS = 5e-3, 1e-3
"""m, of both balls and of the blank."""
PARKED = 25e-3
"""m above and below the sheet, where the tools are when the driver starts."""
LAG = 4e-3
"""s, time constant of the axes."""
SPRING, YIELD_FORCE = 1e6, 300.0
"""N/m of the sheet under a tool, N from which it stays where it was pushed."""
SQUEEZE = 0.5e6
"""N/m between two tools that squeeze the sheet."""
NOISE, ZEROS = 0.3, np.array([[4.0, -7.0, 12.0], [-3.0, 5.0, -9.0]])
"""N, noise of the load cells, and what they read unloaded before they are tared."""
FREE = 20.0
"""N, reading up to which a tool counts as free."""
HALF, CELL = 60e-3, 1e-3
"""m, half the side of the sheet that can be formed, and the distance of its points."""
RELEASE_SPEED, CLEAR = 50e-3, 20e-3
"""m/s at which contact is released after a stop, m above and below the sheet that the tools are lifted to at most."""


class Hardware:
    """Both tools, their load cells and the scanner of a machine that does not exist.

    Attributes
    ----------
    tips : (2, 3) m, where the tools are, by the encoders
    stopped : why the machine stands still and takes no targets; empty: it does not
    """

    def __init__(self, cycle: float) -> None:
        """``cycle``: s between two calls of :meth:`cycle`."""
        self.tips = np.array([[0.0, 0.0, PARKED], [0.0, 0.0, -PARKED]])
        self.stopped = ""
        self._share = 1.0 - math.exp(-cycle / LAG)
        self._release = cycle * RELEASE_SPEED
        self._loaded = np.zeros(2, dtype=bool)
        self._goal = self.tips.copy()
        self._zero = np.zeros((2, 3))
        self._noise = np.random.default_rng(0)
        self.clamp_fresh_blank()

    # -- what every driver needs ---------------------------------------------------------------

    def move(self, tool: int, tip: tuple[float, float, float]) -> None:
        """Have ``tool`` (1, 2) go to ``tip`` m. Without a new call it stands there."""
        if not self.stopped:
            self._goal[tool - 1] = tip

    def stand(self) -> None:
        """Have both tools stay where they are; a stop goes on."""
        if not self.stopped:
            self._goal = self.tips.copy()

    @property
    def released(self) -> bool:
        """True when a stop has taken the tools off the sheet."""
        return bool(self.stopped) and not self._loaded.any()

    def cycle(self) -> Array:
        """One cycle of the machine: the tools move, the load cells are read. (2, 3) N, the wrenches after tare."""
        if self.stopped:
            self._loaded &= np.array([1.0, -1.0]) * self._goal[:, 2] < CLEAR
            self._goal[:, 2] += self._loaded * [self._release, -self._release]
        self.tips += self._share * (self._goal - self.tips)
        return self._readings() - self._zero

    # -- level 2 ---------------------------------------------------------------------------------

    def tare(self) -> str:
        """Take what the load cells read as zero; why not, empty when it is done."""
        readings = np.mean([self._readings() for _ in range(100)], axis=0)
        if np.abs(readings - ZEROS).max() > FREE:
            return "a tool is loaded"
        self._zero = readings
        return ""

    def stop(self, reason: str) -> None:
        """Stand still at once, then have tools in contact leave the sheet; no targets are taken until :meth:`reset`."""
        self.stopped = reason
        self._goal = self.tips.copy()
        self._loaded = ~(np.abs(self._readings() - self._zero).max(axis=1) <= FREE)  # not known: as if it were

    # -- level 3 ---------------------------------------------------------------------------------

    def scan(self) -> Array:
        """(P, 3) m, the upper surface of the sheet."""
        x, y = np.meshgrid(self._axis, self._axis)
        return np.column_stack([x.ravel(), y.ravel(), self._z.ravel()])

    # -- after a stop ----------------------------------------------------------------------------

    def reset(self) -> None:
        """Take targets again."""
        self.stopped = ""

    # -- level 4 ---------------------------------------------------------------------------------

    def clamp_fresh_blank(self) -> None:
        """An operator does this; here it is a line."""
        self._axis = np.arange(-HALF, HALF + 0.5 * CELL, CELL)
        self._z = np.zeros((len(self._axis), len(self._axis)))

    # -- the sheet of springs --------------------------------------------------------------------

    def _readings(self) -> Array:
        forces = np.zeros((2, 3))
        forces[0, 2] = self._press(self.tips[0])
        centres = self.tips + np.array([[0.0, 0.0, RADIUS], [0.0, 0.0, -RADIUS]])
        line = centres[1] - centres[0]
        apart = float(np.linalg.norm(line))
        out = line / max(apart, 1e-9)
        # a wall is thinner than the blank: sine law, the line of the centres is normal to it
        squeezed = 2.0 * RADIUS + THICKNESS * abs(out[2]) - apart
        forces += SQUEEZE * max(squeezed, 0.0) * np.array([-out, out])
        return forces + ZEROS + self._noise.normal(0.0, NOISE, (2, 3))

    def _press(self, tip: Array) -> float:
        """N, upwards on the upper tool; what is pushed harder than it bears yields."""
        near = [slice(*np.searchsorted(self._axis, (at - RADIUS, at + RADIUS))) for at in tip[:2]]
        x, y = self._axis[near[0]], self._axis[near[1]]
        inside = RADIUS**2 - (x[None, :] - tip[0]) ** 2 - (y[:, None] - tip[1]) ** 2
        ball = tip[2] + RADIUS - np.sqrt(np.maximum(inside, 0.0))
        sheet = self._z[near[1], near[0]]
        depth = np.where(inside > 0.0, sheet - ball, 0.0)
        force = SPRING * float(depth.max(initial=0.0))
        if force > YIELD_FORCE:
            self._z[near[1], near[0]] = np.where(inside > 0.0, np.minimum(sheet, ball + YIELD_FORCE / SPRING), sheet)
        return min(force, YIELD_FORCE)
