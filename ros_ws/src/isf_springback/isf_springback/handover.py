"""From one method to another without a jump: horizontal offsets change by a bounded amount per contour.

Every method limits the push (z) against the correction applied last (:mod:`isf_springback.continuity`). Horizontal
offsets are known only to the methods that make them, so that what another method left is faded out here.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from isf_core.contour import Contour, ContourCorrection
from isf_core.files.job import JobFile

from isf_springback.continuity import CHANGE_PER_DEPTH
from isf_springback.loop_path import nearest_points


def fade_horizontal(
    contour: Contour, correction: ContourCorrection, before: Contour, applied: ContourCorrection, job_file: JobFile
) -> ContourCorrection:
    """``correction`` of ``contour`` with a horizontal offset near the one ``applied`` to the contour ``before``.

    The change at a place is at most two incremental depths (the limit of the push, Ren 2018, 4.3.1).
    """
    offset = np.asarray(correction.offset)
    if offset.shape != (len(contour), 3) or applied.offset.shape != (len(before), 3):
        return correction
    nearest = nearest_points(contour.forming_tip[:, :2], before.forming_tip[:, :2])
    old = applied.offset[nearest, :2]
    way = offset[:, :2] - old
    size = np.linalg.norm(way, axis=1)
    limit = CHANGE_PER_DEPTH * job_file.job.path.incremental_depth
    far = size > limit
    if not far.any():
        return correction
    share = np.where(far, limit / np.maximum(size, 1e-12), 1.0)
    limited = offset.copy()
    limited[:, :2] = old + share[:, None] * way
    saturated = correction.saturated if len(correction.saturated) == len(contour) else np.zeros(len(contour), bool)
    return replace(correction, offset=limited, saturated=saturated | far)
