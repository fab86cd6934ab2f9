"""Principal curvatures of the target at contact points, from the change of its smooth normals.

The slopes p, q of the surface follow from its normals; their differences over a tenth of the tool radius give the
second derivatives. With the first and second fundamental form of a height field, I = [[1 + p^2, p q], [p q, 1 + q^2]]
and II = [[z_xx, z_xy], [z_xy, z_yy]] / sqrt(1 + p^2 + q^2), the curvatures are the eigenvalues of I^-1 II. At an edge
of the mesh they are those of a rounding of about a tenth of the tool radius.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from isf_planner import surface_kernels
from isf_planner.target_surface import TargetSurface

Array = NDArray[np.float64]

REACH = 0.1
"""Part of the tool radius over which normals are compared."""


def principal(surface: TargetSurface, contact: Array, radius: float) -> Array:
    """(N, 2) 1/m, the larger first, positive where the surface is concave seen from above.

    ``contact`` (N, 2) m in x and y; ``radius`` of the tool, m.
    """
    step = REACH * radius
    sides = np.array([[0.0, 0.0], [step, 0.0], [-step, 0.0], [0.0, step], [0.0, -step]])
    points = (contact[:, None, :] + sides).reshape(-1, 2)
    horizontal = surface_kernels.horizontal_normals(surface.normal_xy, surface.origin, surface.pitch, points)
    vertical = np.sqrt(np.maximum(1.0 - (horizontal**2).sum(axis=1), 0.01))
    slope = (-horizontal / vertical[:, None]).reshape(-1, 5, 2)
    along_x = (slope[:, 1] - slope[:, 2]) / (2 * step)
    along_y = (slope[:, 3] - slope[:, 4]) / (2 * step)
    zxx, zyy, zxy = along_x[:, 0], along_y[:, 1], 0.5 * (along_x[:, 1] + along_y[:, 0])
    p, q = slope[:, 0].T
    w = 1.0 + p * p + q * q
    mean = ((1 + q * q) * zxx - 2 * p * q * zxy + (1 + p * p) * zyy) / (2 * w**1.5)
    gauss = (zxx * zyy - zxy * zxy) / (w * w)
    root = np.sqrt(np.maximum(mean * mean - gauss, 0.0))
    return np.column_stack([mean + root, mean - root])
