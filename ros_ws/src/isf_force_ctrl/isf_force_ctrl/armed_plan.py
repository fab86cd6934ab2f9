"""The plan a controller is armed with: which contours may come, and in which order."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from isf_core.contour import Contour, contour_label
from isf_core.errors import ErrorCode, IsfError
from numpy.typing import NDArray


@dataclass
class ArmedPlan:
    """Contours ``next`` .. ``count`` - 1 of plan ``plan_id`` are accepted, in order; empty plan_id: nothing armed."""

    plan_id: str = ""
    next: int = 0
    count: int = 0

    @property
    def done(self) -> bool:
        """True when the last contour was accepted."""
        return self.next >= self.count

    def take(self, contour: Contour) -> None:
        """``contour`` is formed: the one after it is the next."""
        self.next = contour.index + 1

    def check(self, contour: Contour, *, busy: bool) -> None:
        """Raise IsfError CONTOUR_REJECTED unless ``contour`` is the one expected now."""
        where = contour_name(contour)
        if contour.plan_id != self.plan_id:
            raise IsfError(ErrorCode.CONTOUR_REJECTED, f"plan '{self.plan_id}' is armed", where=where)
        if busy or contour.index != self.next:
            raise IsfError(
                ErrorCode.CONTOUR_REJECTED, f"out of order, {contour_label(self.next)} is expected", where=where
            )


def armed_plan(
    plan_id: str, first_index: int, count: int, tips: NDArray[np.float64], support_force: float | None
) -> ArmedPlan:
    """A plan to be armed with the tools at ``tips`` (2, 3) m and the set-point ``support_force`` N (None: the plan's).

    Raises IsfError NOT_ARMED.
    """
    if not plan_id or not 0 <= first_index < count:
        raise IsfError(ErrorCode.NOT_ARMED, f"no contours to form: plan '{plan_id}', {first_index} of {count}")
    if tips.shape != (2, 3) or not np.isfinite(tips).all():
        raise IsfError(ErrorCode.NOT_ARMED, "the positions of the tools are not known")
    if support_force is not None and not support_force >= 0.0:
        raise IsfError(ErrorCode.NOT_ARMED, f"support force of {support_force} N is not possible")
    return ArmedPlan(plan_id, first_index, count)


def contour_name(contour: Contour) -> str:
    """What a contour is called in messages."""
    return f"{contour_label(contour.index)} of {contour.plan_id or '(no plan)'}"


def tips_of(tip_1: Sequence[float], tip_2: Sequence[float]) -> NDArray[np.float64]:
    """(2, 3) m from both tips."""
    return np.array([tip_1, tip_2], dtype=float)
