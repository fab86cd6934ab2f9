"""How steep a wall may be planned: in one pass, and from pass to pass.

Without ``wall_angle_limit`` in the job

* one pass may be as steep as the sheet is known to bear in one (``max_wall_angle`` of the material, of a morph its
  ``failure_angle``): a part of one stage, and the first shape of several;
* each later shape, the part included, may be that steep too, or :data:`LARGEST_STEP` steeper than the one before.

Published are walls of 60 deg formed in one pass, 76 deg in three (Behera 2015, Table 1), 80 deg in four from 60 deg on,
6.7 deg each, which fail with the last of their depth at the ribs, a first shape of two thirds of the failure angle
(Behera 2015, 3d), and steps of 3 or 5 deg (Hirt 2004 in Lu 2016, 2.3.2). That one step holds for all materials and
however steep the wall is already is assumed.

This is a rule of planning. Whether the sheet bears what is permitted is a matter of its forming limit
(:mod:`isf_planner.forming.carried_sheet`). A ``wall_angle_limit`` takes the place of the whole rule; what the rule
would have refused is told then.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from isf_core.errors import ErrorCode, IsfError
from isf_core.types import Array

from isf_planner.part.mesh_checks import place_text

LARGEST_STEP = float(np.radians(7.0))
"""rad, by which a shape may be steeper than the one before (6.7 deg published; assumed for all materials)."""

START_SHARE = 6.0 / 7.0
"""First of the suggested angles over what one pass forms: 60 of 70 deg, the first pass of the published pyramids on the
sheet they were made of (its 70 deg are assumed)."""

LATEST_START = 0.9
"""The same at most, where that saves a stage (assumed)."""

EXACT = float(np.radians(0.1))
"""rad, by which facets are steeper than the wall they stand for."""


@dataclass(frozen=True)
class Wall:
    """The steepest wall of a shape: ``angle`` rad at ``place`` (3,) m."""

    angle: float
    place: Array


def largest(before: float | None, single: float) -> float:
    """rad, the steepest wall that may be planned after one of ``before`` rad (None: on the flat blank), in a sheet
    that bears ``single`` rad in one pass."""
    return single if before is None else max(single, before + LARGEST_STEP)


def first_refused(angles: Sequence[float], single: float, uncertain: float = 0.0) -> int | None:
    """Number from 0 of the first of the ``angles`` (rad, in the order of forming) that may not be planned.

    ``uncertain`` rad: how well the angles are known.
    """
    before: float | None = None
    for number, angle in enumerate(angles):
        if angle > largest(before, single) + uncertain + EXACT:
            return number
        before = angle
    return None


def check_steps(
    walls: Sequence[Wall], single: float, *, option: str, count: int, overruled: bool, uncertain: float = 0.0
) -> tuple[str, ...]:
    """Refuse shapes that are too steep for the pass they are formed in.

    Parameters
    ----------
    walls : steepest wall of every shape in the order of forming, the part last
    single : rad, what the sheet bears in one pass
    option : field of the job that makes the shapes before the part
    count : of all stages, finishing passes included
    overruled : the job has a ``wall_angle_limit``: what would be refused is returned as a warning
    uncertain : rad, how well the angles are known

    Raises
    ------
    IsfError : WALL_TOO_STEEP with stage, place and angles that may be planned
    """
    number = first_refused([wall.angle for wall in walls], single, uncertain)
    if number is None:
        return ()
    wall, before = walls[number], walls[number - 1].angle if number else None
    part = number == len(walls) - 1
    most = np.degrees(largest(before, single))
    after = "in one pass" if before is None else f"after walls of {np.degrees(before):.1f} deg"
    stage = f"stage {number + 1} of {count}" + ("" if part else ", a shape before the part")
    what = f"{stage}: the wall is {np.degrees(wall.angle):.1f} deg steep, {most:.1f} deg may be planned {after}"
    where = f"{'mesh' if part else 'shape'} at {place_text(wall.place)}"
    if overruled:
        return (f"{what}, at {place_text(wall.place)}; wall_angle_limit overrules that: the sheet may tear",)
    more = "more shapes (path.morph.shapes, or leave it out)" if option == "path.morph" and number else "other angles"
    advice = f"{more}, for example {stages_text(walls[-1].angle, single)}; or set wall_angle_limit to try it"
    raise IsfError(ErrorCode.WALL_TOO_STEEP, what, where=where, advice=f"{advice}: the sheet may tear")


def suggested(angle: float, single: float) -> tuple[int, ...]:
    """deg, whole, ascending: angles of the fewest stages before a wall of ``angle`` rad that keep the rule in a sheet
    that bears ``single`` rad in one pass; none when one pass may form it."""
    if angle <= single:
        return ()
    step, end, exact = np.degrees([LARGEST_STEP, angle, EXACT])
    count = int(np.ceil((end - exact - LATEST_START * np.degrees(single)) / step))
    start = np.ceil(max(START_SHARE * np.degrees(single), end - count * step) - exact)
    return tuple(int(value) for value in np.ceil(np.linspace(start, end, count + 1)[:-1] - exact))


def stages_text(angle: float, single: float) -> str:
    """The suggested angles as a line of a job."""
    return f"path.stages: [{', '.join(f'{value} deg' for value in suggested(angle, single))}]"
