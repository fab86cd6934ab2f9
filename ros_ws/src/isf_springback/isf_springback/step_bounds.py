"""How much deeper than the one before a corrected contour may go, so that a correction cannot overload the machine.

The force of forming grows with the step between two contours as they are formed, not as they are planned. A correction
that catches up adds to the planned step; here it is held to :data:`LARGEST_STEP` planned steps, and to less where the
force measured on the last contour comes near the limit of the machine.
"""

from __future__ import annotations

import numpy as np
from isf_core.contour import ContourResult
from isf_core.job import JobFile

LARGEST_STEP = 3.0
"""Planned steps between consecutive corrected contours: the planned one and the published change of a correction, two
incremental depths (Ren 2018, 4.3.1). With 2, the bound of step control (Lu 2016, 3.4.1.2), corrections of an unbacked
sheet come too late: chosen after a look at a shallow cone, see docs/springback_feedback.md."""

FREE_SHARE = 0.7
"""Share of the force limit up to which a correction may grow freely (assumed)."""

FULL_SHARE = 0.9
"""Share of the force limit from which a correction does not grow (assumed)."""


def force_share(result: ContourResult, job_file: JobFile) -> float:
    """Largest measured force of the forming tool as a share of the limit of its axis: of machine or load cell.

    0 where nothing finite was measured.
    """
    force = np.abs(np.asarray(result.forming_force, dtype=np.float64))
    if force.ndim != 2 or force.shape[-1] != 3 or not np.isfinite(force).any():
        return 0.0
    limit = np.minimum(job_file.rig.limits.force, job_file.rig.load_cell.force_range)
    return float(np.nanmax(np.where(np.isfinite(force), force, 0.0) / limit))


def largest_rise(job_file: JobFile, share: float, largest_step: float = LARGEST_STEP) -> float:
    """m, by which a correction may grow from one contour to the next when the last one took ``share`` of the limit.

    ``largest_step`` in planned steps.
    """
    room = float(np.clip((FULL_SHARE - share) / (FULL_SHARE - FREE_SHARE), 0.0, 1.0))
    return room * (largest_step - 1.0) * job_file.job.path.incremental_depth


def force_remark(share: float) -> str:
    """What a person should know when the force held a correction back."""
    return (
        f"the force is at {100 * share:.0f} % of the machine's limit: the correction grows slower; "
        "take a smaller tool or depth step"
    )
