"""Tool marks: how far they lie apart on the wall, the ridges between them, and the step that a wanted surface needs.

Two neighbouring passes of a ball leave a ridge between their grooves. On a plane wall their marks are dz / sin(wall
angle) apart (Lu 2016 eq. 40; measured spacings are up to 4.1 % smaller, 4.1.2), and the ridge is as high as the circles
of two balls so far apart leave it. :func:`isf_core.process.forming_force.scallop_height` is the same for low ridges, as
the regression of the forming force has it.
"""

from __future__ import annotations

import numpy as np

from isf_core.types import Array


def mark_spacing(step: Array | float, wall_angle: Array | float) -> Array:
    """m, between neighbouring marks along the wall, for a ``step`` m in depth and a ``wall_angle`` rad, above 0."""
    return np.asarray(np.asarray(step) / np.sin(wall_angle))


def ridge_height(spacing: Array | float, radius: float) -> Array:
    """m, of the ridge (scallop) between marks ``spacing`` m apart, R - sqrt(R^2 - (spacing / 2)^2).

    ``radius`` R m of the ball. Where its passes do not meet, spacing above 2 R, the height is R: no more is known.
    """
    half = np.minimum(0.5 * np.asarray(spacing), radius)
    return np.asarray(half**2 / (radius + np.sqrt(radius**2 - half**2)))


def spacing_of_ridge(height: Array | float, radius: float) -> Array:
    """m, of marks with ridges of ``height`` m, at most ``radius`` m, between them: inverse of :func:`ridge_height`."""
    low = np.minimum(np.asarray(height), radius)
    return np.asarray(2.0 * np.sqrt(low * (2.0 * radius - low)))


def step_of_spacing(spacing: Array | float, wall_angle: Array | float) -> Array:
    """m in depth that leaves marks ``spacing`` m apart on a wall of ``wall_angle`` rad."""
    return np.asarray(np.asarray(spacing) * np.sin(wall_angle))
