"""Levels of every feature of a surface, for a tool path of its own (Behera 2015, Intelligent sequencing, rule 1).

With ``path.spacing`` scallop or arc a wall is divided by its own slope, so that a steep one beside a shallow one is not
passed over as often as that one. The ribs at its upper and lower end are divided with it, and narrow walls with a wide
one beside them, by the flattest of both, as lifts for short passes would cost more than they save. Walls alike (one
kind, one range of depth, steps within 4 %, so that ridges are within 8 %) share their levels, and close levels of
different walls are made one: there their paths join. With spacing depth all features have the same levels. So they
have in the shapes before a part: there the features of the part lie, seen from above, but blended into each other.

What touches a border that runs along the levels belongs to both sides of it: at the lowest level of a wall the tool
also touches what follows below. So a level of a feature holds for its neighbours above and below, too; it lies within
the feature's own depth. A rib that runs down is formed with what it touches, and floor, flange and what is too
small to have a slope at every level.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from isf_core.files.job import Job
from isf_core.types import Array, Indices, Mask

from isf_planner.features.surface_features import FeatureMap, Kind, SurfaceFeature
from isf_planner.loops import level_spacing, tip_loops
from isf_planner.loops.level_spacing import Places
from isf_planner.loops.sections import TipGrid
from isf_planner.surface.target_surface import TargetSurface

FEWEST_PLACES = 40
"""Balls that touch a feature of which a slope is known."""

PLACES_PER_BAND = 10
"""Balls, on average, from which the slope at one height is taken."""

ENDS = 0.002
"""Share of the balls on a feature beyond its highest and lowest level: labels at a border are right to a cell."""

ALIKE = 0.04
"""Relative difference of the steps of features that share their levels."""

ONE_STEP = 0.05
"""Steps by which that may be off in any case, in half a feature."""

NARROW = 6.0
"""Mean length of the level lines of a narrow wall, over the tool radius: lifts would cost more than it saves."""

SAME_RANGE = 0.1
"""Difference of their upper and lower ends, over their depth."""

ONE_LEVEL = 0.04
"""Levels of different features closer than this share of the smaller step are one."""


@dataclass(frozen=True)
class FeatureLevels:
    """Levels of a part and which feature is formed at which of them.

    Attributes
    ----------
    z : (K,) m, falling, the last one at the full depth
    formed : (K, F) whether a feature is formed at a level ; touched : (F,) balls of the survey that touch a feature
    """

    z: Array
    formed: Mask
    touched: Indices

    def at(self, level: float) -> Mask:
        """(F,) which features are formed at ``level`` m; all where it is none of the levels, as at a pocket's end."""
        k = int(np.argmin(np.abs(self.z - level)))
        known = abs(float(self.z[k]) - level) < 1e-9 and k < len(self.z) - 1
        return self.formed[k] if known else np.ones(self.formed.shape[1], dtype=np.bool_)


@dataclass(frozen=True)
class _Group:
    """Features alike (numbers); ``z`` (K + 1,) m, their upper end and their levels, falling."""

    members: tuple[int, ...]
    z: Array


def feature_levels(
    grid: TipGrid, surface: TargetSurface, found: FeatureMap, job: Job, *, own: bool = True
) -> FeatureLevels:
    """Levels of the features ``found`` of a ``surface``, on which ``grid`` holds the tip.

    ``own``: every feature may have its own; else all have those of the whole surface.
    """
    surveyed = level_spacing.places(grid, surface, job.tool_1.ball_radius)
    label = found.of_points(surveyed.contact)
    touched = np.bincount(label, minlength=len(found.features))
    groups = _groups(found, surveyed, label, job) if own and job.path.spacing != "depth" else []
    if not groups:
        z = level_spacing.levels(grid, surface, job)
        return FeatureLevels(z, np.ones((len(z), len(touched)), dtype=np.bool_), touched)
    z, level_of = _merged([group.z for group in groups], grid.depth)
    formed = np.zeros((len(z), len(touched)), dtype=np.bool_)
    for group, rows in zip(groups, level_of, strict=True):
        near = {other for number in group.members for other in stacked(found, number)} | set(group.members)
        formed[np.ix_(rows, sorted(near))] = True
    grouped = {number for group in groups for number in group.members}
    for feature in found.features:
        if feature.kind is Kind.RIB_SEMI_VERTICAL and any(other in grouped for other in feature.neighbours):
            formed[:, feature.number] |= formed[:, [k for k in feature.neighbours if k in grouped]].any(axis=1)
        elif feature.number not in grouped:
            formed[:, feature.number] = True
    return FeatureLevels(z, formed, touched)


def stacked(found: FeatureMap, number: int) -> set[int]:
    """Features above and below one, and those that only a rib along the levels parts from it."""
    first = {*found.features[number].above, *found.features[number].below}
    ribs = [found.features[k] for k in first if found.features[k].kind.rib]
    return first | {k for rib in ribs for k in (*rib.above, *rib.below)} - {number}


def _groups(found: FeatureMap, surveyed: Places, label: Indices, job: Job) -> list[_Group]:
    """Walls with what is divided with them; those alike together."""
    alike: list[list[tuple[tuple[int, ...], Kind, Places]]] = []
    for members in _columns(found, job.tool_1.ball_radius):
        mine = surveyed.of(np.isin(label, members))
        if len(mine) < FEWEST_PLACES:
            continue
        column = (members, found.features[members[0]].kind, mine)
        for group in alike:
            if group[0][1] is column[1] and _alike(group[0][2], mine, job):
                group.append(column)
                break
        else:
            alike.append([column])
    groups = []
    for group in alike:
        parts = [part for *_, part in group]
        together = Places(*(np.concatenate([getattr(p, n) for p in parts]) for n in ("height", "slope", "contact")))
        z, steps = _divided(together, job)
        members = tuple(number for numbers, *_ in group for number in numbers)
        groups.append(_Group(members, np.append(z[0], level_spacing.divided(z, steps))))
    return groups


def _columns(found: FeatureMap, radius: float) -> list[tuple[int, ...]]:
    """Every wide wall, first, with the ribs along its ends and with the narrow walls beside it; what is left, alone."""
    features = found.features
    walls = [f.number for f in features if f.kind.wall and _width(f) >= NARROW * radius]
    owner = {number: number for number in walls}
    for feature in features:
        if feature.number in owner or feature.kind in (Kind.TOP, Kind.FLOOR, Kind.RIB_SEMI_VERTICAL):
            continue
        around = feature.beside if feature.kind.wall else feature.below if feature.kind is Kind.RIM else feature.above
        near = [k for k in around if k in walls] or [k for k in feature.neighbours if k in walls]
        owner[feature.number] = max(near, key=lambda k: features[k].area) if near else feature.number
    return [
        (first, *(k for k, other in owner.items() if other == first and k != first))
        for first in sorted(set(owner.values()))
    ]


def _width(feature: SurfaceFeature) -> float:
    """m, mean length of its level lines."""
    slant = (feature.highest - feature.lowest) / max(float(np.sin(feature.wall_angle)), 0.05)
    return feature.area / max(slant, 1e-6)


def _divided(mine: Places, job: Job) -> tuple[Array, Array]:
    """Heights (B + 1,) m of a feature and the steps (B + 1,) down to each."""
    bottom, top = np.quantile(mine.height, [ENDS, 1.0 - ENDS])
    bands = int(np.clip(len(mine) // PLACES_PER_BAND, 4, level_spacing.BANDS))
    z = np.linspace(float(top), float(min(bottom, top - 1e-6)), bands + 1)
    angle = level_spacing.wall_angles(z, mine)
    return z, level_spacing.steps_down(z, angle, job.path, job.tool_1.ball_radius)


def _alike(first: Places, second: Places, job: Job) -> bool:
    """One range of depth, and in the upper and the lower half as many steps."""
    (z1, steps1), (z2, steps2) = _divided(first, job), _divided(second, job)
    depth = max(float(np.ptp(z1)), float(np.ptp(z2)))
    if max(abs(z1[0] - z2[0]), abs(z1[-1] - z2[-1])) > SAME_RANGE * depth + job.path.smallest_step:
        return False
    halves = np.linspace(min(z1[0], z2[0]), max(z1[-1], z2[-1]), 3)
    count = [np.diff(np.interp(-halves, -z, steps)) for z, steps in ((z1, steps1), (z2, steps2))]
    return bool(np.allclose(count[0], count[1], rtol=ALIKE, atol=ONE_STEP))


def _merged(groups: list[Array], depth: float) -> tuple[Array, list[Indices]]:
    """All levels (K,) m, falling, and for every group of them (its upper end first) which of these are its own."""
    step = np.concatenate([-np.diff(z) for z in groups])
    values = np.concatenate([z[1:] for z in groups])
    owner = np.concatenate([np.full(len(z) - 1, k) for k, z in enumerate(groups)])
    order = np.argsort(-values, kind="stable")
    level = np.empty(len(values), dtype=np.int64)
    found: list[list[int]] = []
    for k in order:
        # with the highest one of a level, so that none drifts; a group is in one level only once
        together = bool(found) and values[found[-1][0]] - values[k] <= ONE_LEVEL * min(step[k], step[found[-1][0]])
        if together and owner[k] not in owner[found[-1]]:
            found[-1].append(int(k))
        else:
            found.append([int(k)])
        level[k] = len(found) - 1
    z = np.array([values[members].mean() for members in found])
    z = np.maximum(z, -depth)
    # a level just above the bottom would be none of a pocket (isf_planner.loops.sections)
    least = max(ONE_LEVEL * float(step[found[-1]].min()), 1.01 * tip_loops.SMALLEST_STEP * abs(float(z[0])))
    last = z <= -depth + least
    if not last.any():
        z, last = np.append(z, -depth), np.append(last, True)
    first = int(np.argmax(last))
    z = np.append(z[:first], -depth)
    level = np.minimum(level, first)
    return z, [level[owner == k] for k in range(len(groups))]
