"""A sheet with known springback that is formed contour by contour and scanned, for tests of several rooms."""

import numpy as np
from isf_core.geometry.height_map import HeightMap

GRID = np.arange(-125, 126) * 1e-3
X, Y = np.meshgrid(GRID, GRID)
OPENING, WALL, RADIUS = 36e-3, np.radians(50.0), 5e-3
COUNT = 24


def cone(depth):
    return np.clip((np.hypot(X, Y) - OPENING) * np.tan(WALL), -depth, 0.0)


TARGET = HeightMap(GRID, GRID, cone(0.5e-3 * COUNT))


INNER = slice(80, 171)
"""Part of the grid that the tool reaches."""


class Sheet:
    """A sheet that follows the ball and springs back by a set amount at every contour; formed walls stay.

    ``springback`` : m as a function of depth (m) and direction (rad, grid); ``inwards`` : m, horizontally
    """

    def __init__(self, springback, inwards=0.0):
        self.springback = springback
        self.inwards = inwards
        self.z = np.zeros_like(X)

    def form(self, corrected):
        x, y = X[INNER, INNER], Y[INNER, INNER]
        angle = np.arctan2(corrected.forming_tip[:, 1], corrected.forming_tip[:, 0])
        order = np.argsort(angle)
        around = np.arctan2(y, x)

        def at(values):
            return np.interp(around, angle[order], values[order], period=2 * np.pi)

        r_tip = at(np.hypot(corrected.forming_tip[:, 0], corrected.forming_tip[:, 1])) - self.inwards
        z_tip = at(corrected.forming_tip[:, 2])
        away = np.clip(np.hypot(x, y) - r_tip, 0.0, None)
        ball = z_tip + RADIUS - np.sqrt(np.maximum(RADIUS**2 - np.minimum(away, RADIUS) ** 2, 0.0))
        ball = np.where(away < 0.98 * RADIUS, ball, np.inf)
        recovered = ball + self.springback(-float(corrected.contact[:, 2].mean()), around)
        self.z[INNER, INNER] = np.minimum(self.z[INNER, INNER], recovered)

    def points(self):
        return np.column_stack([X.ravel(), Y.ravel(), self.z.ravel()])
