"""How deep the next contour may go for its force to stay below the limit of the machine.

The force of forming grows with the step between two contours as they are formed, by an exponent that no controller
knows of its machine. Bounds of it are enough: a step grows as if the larger one held, and shrinks as if the smaller one
did. Half of what else the force rose by (the wall comes up, the part gets deeper) is taken to come again (Ren 2018,
4.3.1). Every contour is measured again, so that an error of these bounds lasts one contour.

Steps, m, are those of the commanded tips along the push, corrections included, over a die in the frame of the die.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from isf_core.contour import Contour, ContourResult
from isf_core.files.job import JobFile

from isf_springback.sheet_load import push_sign

LARGEST_EXPONENT = 0.5
"""Growth of the force with the step if all of it were the arc that the ball wets, which grows with its root (assumed as
the upper bound; Praveen 2020, eq. 2: acos(1 - step / radius))."""

SMALLEST_EXPONENT = 0.15
"""Assumed as the lower bound: somewhat less than the published one, 0.18 (scallop^0.09, Aerens et al. 2009)."""

WANTED_SHARE = 0.95
"""Largest force that a step is planned for, as a share of the limit (assumed): of a load cell with 1 % noise the
largest of 30,000 ticks lies 4 % over the mean, the largest of the 400 points of a contour 3 %; with the forecast off
by 1 %, and corners, 0.96 let strong sheets reach the limit."""

PLANNED_SHARE = 0.965
"""The same for a step that is no larger than planned (assumed): to make it smaller leaves the part too high, so that
the plan may come nearer to the limit than a correction."""

SMALLEST_STEP = 0.2
"""Planned steps that a contour goes deeper at least, whatever the force (assumed): the tool keeps forming."""

CALMEST = 0.1
"""Planned steps below which a step says nothing of the force: the tool was led back."""


@dataclass(frozen=True)
class FormedStep:
    """One contour as it was formed.

    Attributes
    ----------
    depth : m, mean tip along the push ; step : m, deeper than the contour before
    mean : N, axial force on the forming tool, mean around the contour
    share : largest force as a share of the limit of its axis
    """

    depth: float
    step: float
    mean: float
    share: float


class StepForce:
    """Remembers the last two contours of one feature; see the module text."""

    def __init__(self, job_file: JobFile) -> None:
        self._job_file = job_file
        self._steps: list[FormedStep] = []
        self._of: tuple[str, int, int, int] | None = None

    def add(self, contour: Contour, result: ContourResult) -> None:
        """What was measured while ``contour``, as corrected, was formed; a result without forces is left out."""
        of = (contour.plan_id, contour.feature, contour.stage, contour.forming_tool)
        if of != self._of:
            self._steps, self._of = [], of
        share = force_share(result, self._job_file)
        axial = np.abs(np.asarray(result.forming_force, dtype=np.float64)[:, 2]) if share > 0.0 else np.empty(0)
        if not result.completed or not np.isfinite(axial).any():
            self._steps = []
            return
        depth = depth_of(contour)
        planned = self._job_file.job.path.incremental_depth
        step = depth - self._steps[-1].depth if self._steps else planned
        formed = FormedStep(depth, max(step, CALMEST * planned), float(np.nanmean(axial)), share)
        self._steps = [*self._steps[-1:], formed]

    def deepest(self, contour: Contour) -> float:
        """m, largest depth of ``contour``, mean tip along the push; infinite where nothing was measured before it."""
        of = (contour.plan_id, contour.feature, contour.stage, contour.forming_tool)
        if not self._steps or of != self._of:
            return float("inf")
        planned = self._job_file.job.path.incremental_depth
        step = largest_step(self._steps)
        if step < planned:
            step = min(planned, largest_step(self._steps, PLANNED_SHARE))
        return self._steps[-1].depth + max(step, SMALLEST_STEP * planned)


def force_share(result: ContourResult, job_file: JobFile) -> float:
    """Largest measured force of the forming tool as a share of the limit of its axis: of machine or load cell.

    0 where nothing finite was measured.
    """
    force = np.abs(np.asarray(result.forming_force, dtype=np.float64))
    if force.ndim != 2 or force.shape[-1] != 3 or not np.isfinite(force).any():
        return 0.0
    limit = np.minimum(job_file.rig.limits.force, job_file.rig.load_cell.force_range)
    return float(np.nanmax(np.where(np.isfinite(force), force, 0.0) / limit))


def depth_of(contour: Contour) -> float:
    """m, mean tip of ``contour`` along the push, over a die in the frame of the die."""
    return push_sign(contour) * (float(np.mean(contour.forming_tip[:, 2])) + contour.holder_height)


def largest_step(steps: list[FormedStep], wanted: float = WANTED_SHARE) -> float:
    """m, after the formed ``steps`` (the last one or two count), for ``wanted`` share of the limit."""
    last = steps[-1]
    growth = 1.0
    if len(steps) > 1:
        before = steps[-2]
        ratio = last.step / before.step
        # the force of the contour before, had it gone as deep; the forecast is the published 1.5 F(i-1) - 0.5 F(i-2)
        alike = before.mean * min(ratio**exponent for exponent in (SMALLEST_EXPONENT, LARGEST_EXPONENT))
        growth = max(1.0, 1.5 - 0.5 * alike / max(last.mean, 1e-9))
    room = wanted / (last.share * growth)
    return float(last.step * room ** (1.0 / (LARGEST_EXPONENT if room >= 1.0 else SMALLEST_EXPONENT)))


def step_remark(step: float, planned: float, above: float) -> str:
    """What a person should know when the force held a correction back; ``above`` m over the plan the tool then is."""
    bears = f"the force of the machine bears a step of {1e3 * max(step, 0.0):.2f} mm here"
    if step >= planned:
        return f"{bears}: the correction grows slower; take a smaller tool or depth step"
    return (
        f"{bears}, {1e3 * planned:.2f} mm are planned: the tool goes {1e3 * abs(above):.2f} mm "
        f"{'above' if above > 0.0 else 'below'} the plan; take a smaller tool or depth step"
    )
