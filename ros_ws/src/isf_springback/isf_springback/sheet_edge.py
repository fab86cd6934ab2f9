"""The edge of the sheet that is free to deflect: the clamp, or the opening of the backing plate around the path.

Over a backing plate the sheet bends inside the plate's opening only; beside it the plate carries it. The models take
this opening in place of the clamp. Whether the edge slides in its plane stays that of the clamp, which holds the sheet.
"""

from __future__ import annotations

import numpy as np
from isf_core.job import JobFile
from isf_core.opening import SMALLEST_GAP, ClampRadius, Opening, clamp_radius
from numpy.typing import NDArray

Array = NDArray[np.float64]


def free_size(job_file: JobFile) -> tuple[float, float]:
    """m, extent in x and y of the sheet that is free to deflect, centred at 0.

    Of a round plate the diameters: a model with straight edges then has the free corners outside the circle, and is a
    little too soft.
    """
    plate = job_file.job.backing_plate
    return job_file.rig.clamp.size if plate is None else plate.size


def edge_radius(job_file: JobFile, opening: Opening, points: Array, kind: ClampRadius) -> Array:
    """(M,) m, radius of the free sheet that belongs to ``points`` (M, 2) m; see :func:`isf_core.opening.clamp_radius`.

    A round plate has its own radius, whatever ``kind``.
    """
    plate = job_file.job.backing_plate
    if plate is None or plate.shape == "rectangle":
        return clamp_radius(opening, points, free_size(job_file), kind)
    radius = np.full(len(points), 0.5 * plate.size[0])
    return np.asarray(np.maximum(radius, opening.radius_towards(points) / (1.0 - SMALLEST_GAP)))
