"""What the formed shape shows that no correction of the coming contours can mend, and what would."""

from __future__ import annotations

import numpy as np
from isf_core.contour import Process
from isf_core.files.job import JobFile
from isf_core.geometry.height_map import HeightMap
from isf_core.types import Array

from isf_springback.scan_processing.formed_shape import FormedShape, regions
from isf_springback.scan_processing.sections import heights_at

RIM_SAG = 0.5e-3
"""m below the plan at which the rim is told (the usual tolerance of a formed part is 1 mm, Lu 2016, 1.1)."""
PILLOW = 0.3e-3
"""m by which the middle of the bottom may stand over its edge."""


def shape_remarks(shape: FormedShape, target: HeightMap, level: float, job_file: JobFile) -> tuple[str, ...]:
    """Remarks on the part after a contour with its tip at ``level`` m."""
    masks = regions(target)
    places = np.stack(np.meshgrid(target.x, target.y), axis=-1)
    formed = heights_at(shape.surface, places)
    error = formed - np.maximum(target.z, level)
    return (*_rim(error[masks["rim"]], job_file), *_pillow(formed, target, level, job_file))


def _rim(error: Array, job_file: JobFile) -> tuple[str, ...]:
    known = error[np.isfinite(error)]
    if len(known) < 20:
        return ()
    sag = -float(np.mean(known))
    if sag < RIM_SAG:
        return ()
    job = job_file.job
    better = "a backing plate with an opening close to the path"
    if job.process_type is Process.SPIF:
        better += ", or two tools (DSIF)"
    if job.backing_plate is not None:
        better = "a smaller opening of the backing plate"
    return (
        f"the rim lies {1e3 * sag:.1f} mm below the plan: sheet outside the path bends and no tool lifts it; {better} "
        "would hold it",
    )


def _pillow(formed: Array, target: HeightMap, level: float, job_file: JobFile) -> tuple[str, ...]:
    """Middle of the bottom (where the target is deeper than the tool has been) against its edge."""
    bottom = target.z <= level + 0.05e-3
    if bottom.sum() < 200:
        return ()
    rows, columns = np.nonzero(bottom)
    centre = np.array([target.x[columns].mean(), target.y[rows].mean()])
    distance = np.hypot(target.x[columns] - centre[0], target.y[rows] - centre[1])
    height = formed[rows, columns]
    outer = np.quantile(distance, 0.8)
    edge, middle = height[distance > outer], height[distance < 0.3 * outer]
    edge, middle = edge[np.isfinite(edge)], middle[np.isfinite(middle)]
    if len(edge) < 10 or len(middle) < 10:
        return ()
    rise = float(middle.mean() - edge.mean())
    if rise < PILLOW:
        return ()
    better = "passes over the floor (path.floor_step), support from below (DSIF) or a smaller depth step would lower it"
    if job_file.job.path.floor_step is not None:
        better = "the passes over the floor lower it"
    return (
        f"the middle of the bottom stands {1e3 * rise:.1f} mm over its edge (pillow): contours on the walls do not "
        f"reach it; {better}",
    )
