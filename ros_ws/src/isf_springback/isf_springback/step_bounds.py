"""How much deeper than the one before a corrected contour may go, whatever the force.

The force of forming grows with the step between two contours as they are formed, not as they are planned. A correction
that catches up adds to the planned step; here it is held to :data:`LARGEST_STEP` planned steps. What the force bears is
decided by :mod:`isf_springback.step_force`.
"""

from __future__ import annotations

from isf_core.files.job import JobFile

LARGEST_STEP = 3.0
"""Planned steps between consecutive corrected contours: the planned one and the published change of a correction, two
incremental depths (Ren 2018, 4.3.1). With 2, the bound of step control (Lu 2016, 3.4.1.2), corrections of an unbacked
sheet come too late: chosen after a look at a shallow cone, see docs/springback_feedback.md."""


def largest_rise(job_file: JobFile, largest_step: float = LARGEST_STEP) -> float:
    """m, by which a correction may grow from one contour to the next; ``largest_step`` in planned steps."""
    return (largest_step - 1.0) * job_file.job.path.incremental_depth
