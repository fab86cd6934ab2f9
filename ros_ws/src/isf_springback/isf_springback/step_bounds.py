"""How much deeper than the one before a corrected contour may go, and how near the machine was to its limit.

The force of forming grows with the step between two contours as they are formed, not as they are planned. A correction
that catches up adds to the planned step; here it is held to :data:`LARGEST_STEP` planned steps. What the force bears is
decided by :mod:`isf_springback.step_force`.
"""

from __future__ import annotations

import numpy as np
from isf_core.contour import ContourResult
from isf_core.job import JobFile

LARGEST_STEP = 3.0
"""Planned steps between consecutive corrected contours: the planned one and the published change of a correction, two
incremental depths (Ren 2018, 4.3.1). With 2, the bound of step control (Lu 2016, 3.4.1.2), corrections of an unbacked
sheet come too late: chosen after a look at a shallow cone, see docs/springback_feedback.md."""


def force_share(result: ContourResult, job_file: JobFile) -> float:
    """Largest measured force of the forming tool as a share of the limit of its axis: of machine or load cell.

    0 where nothing finite was measured.
    """
    force = np.abs(np.asarray(result.forming_force, dtype=np.float64))
    if force.ndim != 2 or force.shape[-1] != 3 or not np.isfinite(force).any():
        return 0.0
    limit = np.minimum(job_file.rig.limits.force, job_file.rig.load_cell.force_range)
    return float(np.nanmax(np.where(np.isfinite(force), force, 0.0) / limit))


def largest_rise(job_file: JobFile, largest_step: float = LARGEST_STEP) -> float:
    """m, by which a correction may grow from one contour to the next; ``largest_step`` in planned steps."""
    return (largest_step - 1.0) * job_file.job.path.incremental_depth
