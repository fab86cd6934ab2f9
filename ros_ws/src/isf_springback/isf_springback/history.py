"""What the contours of a part were corrected by: the one in work, and the one from which its correction steps off.

Every correction leaves the last one by a bounded step, whatever method gave either, so that no change of method,
missing force or wrong order makes the tools jump. Where the tools come down from the air there is nothing to step off from.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from isf_core.contour import Contour, contour_label
from isf_core.errors import ErrorCode, IsfError
from isf_core.types import Array

from isf_springback.loop_path import nearest_points
from isf_springback.scan_memory import ScanMemory
from isf_springback.sheet_load import push_sign


@dataclass(frozen=True)
class FormedContour:
    """A contour as planned, and how it was formed.

    Attributes
    ----------
    offset : (N, 3) m, correction of contact and tips
    over_floor : the contour passed over a floor that was formed before
    """

    contour: Contour
    offset: Array
    over_floor: bool = False

    @property
    def push(self) -> Array:
        """(N,) m, offset along the push direction of the forming tool."""
        return np.asarray(push_sign(self.contour) * self.offset[:, 2])

    def seen_from(self, contour: Contour) -> Array:
        """(N, 3) m, the offset at the nearest place in plan view of every point of another contour."""
        return np.asarray(self.offset[nearest_points(contour.forming_tip[:, :2], self.contour.forming_tip[:, :2])])


class History:
    """The contour in work (``current``) and the one that its correction continues (``base``), with their offsets.

    Before the first contour the tools are lifted, and so when they swap or travel to another feature: there is no base
    and no change to limit. The depth that they go to at once is bounded by the largest correction alone.

    Attributes
    ----------
    base, current : None where there is none
    scans : the target, and the shapes measured between contours
    """

    def __init__(self, scans: ScanMemory) -> None:
        self.scans = scans
        self.base: FormedContour | None = None
        self.current: FormedContour | None = None

    def advance(self, contour: Contour) -> IsfError | None:
        """Prepare for ``contour``; returns CONTOUR_OUT_OF_ORDER when it does not follow the last one.

        Asking again for the same contour starts from the same base; a new plan starts anew.
        """
        current = self.current
        if current is None or current.contour.plan_id != contour.plan_id:
            if current is not None:
                self.scans.clear()
            self.base = self.current = None
            return None
        last = current.contour
        if contour.index == last.index:
            return None
        lifted = contour.retract and contour.stage == 0 and contour.feature != last.feature
        self.base = None if lifted or last.forming_tool != contour.forming_tool else current
        if contour.index == last.index + 1:
            return None
        return IsfError(
            ErrorCode.CONTOUR_OUT_OF_ORDER,
            f"{contour_label(contour.index)} came after {contour_label(last.index)}",
            where=f"plan {contour.plan_id}",
            advice="contours must come in the order of the plan; the last good correction is kept",
        )

    def add(self, contour: Contour, offset: Array, *, over_floor: bool = False) -> None:
        """``contour`` is formed with ``offset`` (N, 3) m."""
        self.current = FormedContour(contour, np.array(offset, dtype=np.float64), over_floor)

    def last_offset(self, contour: Contour) -> Array:
        """(N, 3) m, the offset of the base seen from ``contour``; zero when there is none."""
        return np.zeros((len(contour), 3)) if self.base is None else self.base.seen_from(contour)

    def last_push(self, contour: Contour) -> Array:
        """(N,) m, the same along the push direction."""
        return np.asarray(push_sign(contour) * self.last_offset(contour)[:, 2])
