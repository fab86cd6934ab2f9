"""A height map: z over a regular grid, the form in which shapes are compared and scanned."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from isf_core.types import Array


@dataclass(frozen=True)
class HeightMap:
    """Upper surface of the sheet, frame ``sheet``.

    Attributes
    ----------
    x : (nx,) m ascending, y : (ny,) m ascending, z : (ny, nx) m (NaN where unknown)
    """

    x: Array
    y: Array
    z: Array

    def at(self, points: Array) -> Array:
        """(N,) m, bilinear z at ``points`` (N, 2) m; NaN outside the grid."""
        from scipy.interpolate import (
            RegularGridInterpolator,
        )  # late: 0.3 s that most nodes need not pay at their start

        interpolate = RegularGridInterpolator((self.y, self.x), self.z, bounds_error=False, fill_value=np.nan)
        return np.asarray(interpolate(np.asarray(points)[:, ::-1]))

    def gradient(self) -> tuple[Array, Array]:
        """dz/dx and dz/dy, each (ny, nx), dimensionless."""
        dz_dy, dz_dx = np.gradient(self.z, self.y, self.x)
        return np.asarray(dz_dx), np.asarray(dz_dy)

    def points(self) -> Array:
        """(nx*ny, 3) m, row by row."""
        gx, gy = np.meshgrid(self.x, self.y)
        return np.column_stack([gx.ravel(), gy.ravel(), self.z.ravel()])

    @staticmethod
    def from_points(points: Array) -> HeightMap:
        """Rebuild from ``points`` (nx*ny, 3) m as written by :meth:`points`.

        Raises ValueError when they are not a complete regular grid.
        """
        points = np.asarray(points, dtype=float)
        x = np.unique(points[:, 0])
        y = np.unique(points[:, 1])
        if len(points) != len(x) * len(y):
            raise ValueError(f"{len(points)} points do not fill a grid of {len(x)} x {len(y)}")
        z = np.empty((len(y), len(x)))
        z[np.searchsorted(y, points[:, 1]), np.searchsorted(x, points[:, 0])] = points[:, 2]
        return HeightMap(x, y, z)
