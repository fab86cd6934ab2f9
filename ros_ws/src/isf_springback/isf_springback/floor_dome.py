"""How far the unformed floor may stand up as a dome while the sheet around it is pushed down.

A wide thin sheet formed close to its edge turns at the path by the slope of the sheet between edge and path, and the
floor inside, which nothing holds, bends up as a whole: a paraboloid with that slope at its edge. More than the sheet
bears elastically it cannot stand up. A scan of a shallow contour shows more of this dome than of the part. Seen on the
simulated machine; that it is so on a real sheet is assumed.
"""

from __future__ import annotations

import numpy as np
from isf_core.contour import Contour
from isf_core.files.job import JobFile
from isf_core.geometry.height_map import HeightMap
from isf_core.geometry.opening import SMALLEST_GAP

from isf_springback.scan_processing.formed_shape import OPENING_DEPTH
from isf_springback.sheet_edge import free_size


def plausible_dome(job_file: JobFile, contour: Contour, target: HeightMap) -> float:
    """m, largest height of the floor's middle over its edge after ``contour`` of the part ``target``.

    With the radii r of the opening and R of the edge (of circles of the same area) and the depth d so far: a paraboloid
    of the slope d / (R - r), at most that of the steepest wall, is slope r / 2 high; of the curvature 2 s / (E t) at
    which the sheet begins to yield, s r^2 / (E t).
    """
    cell = float((target.x[1] - target.x[0]) * (target.y[1] - target.y[0]))
    opening = float(np.sqrt(np.count_nonzero(target.z < -OPENING_DEPTH) * cell / np.pi))
    if opening <= 0.0:
        return 0.0
    plate, size = job_file.job.backing_plate, free_size(job_file)
    circle = plate is not None and plate.shape == "circle"
    edge = 0.5 * size[0] if circle else float(np.sqrt(size[0] * size[1] / np.pi))
    gap = max(edge - opening, SMALLEST_GAP * edge)
    depth = max(-float(contour.forming_tip[:, 2].min()), 0.0)
    slope = min(depth / gap, float(np.tan(contour.wall_angle.max())))
    material = job_file.material
    elastic = material.yield_strength * opening**2 / (material.young_modulus * job_file.job.sheet.thickness)
    return float(min(0.5 * slope * opening, elastic))
