"""Tool compliance from an external displacement sensor at the tip (Ren 2018, 2.2.1).

The tools are squeezed against each other through a pad; at several loads the force of the load cell f and the reading
of a dial indicator at the tip of one tool d are written down, for every tool, axis and place, and repeated. Per series
(one place, one repetition) d = C f + zero: the zero of the dial and the pad between the tools do not matter. The dial
tells one tool from the other and from the contact, which a squeeze alone cannot
(:mod:`isf_identify.fits`); it needs hands, and nothing of the cell but its readings.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from isf_core.errors import ErrorCode, IsfError
from isf_core.types import Array
from numpy.typing import NDArray
from scipy import stats

from isf_identify.fits import MAXIMUM_RESIDUAL, OBSERVED, LinearFit, fit_linear
from isf_identify.rig_piece import rig_piece

MINIMUM_FORCES = 3
"""Different loads per series, of any sign: fewer do not show whether the deflection is proportional."""

CONSTANT = 0.05
"""Standard deviation over mean of the places: more than that is not constant over the workspace (assumed; the simulated
machine's published bound is a small variation, below 5 %)."""

DOUBT = 1.0e-3
"""Chance that scatter alone looks like a curve, below which it is one; likewise for places that differ."""

FAR = 20.0
"""Of the rig's compliance, or one over it: more is another unit, not another machine (assumed; the published tools
differ by 10 between their axes)."""

AXES = "xyz"
Pair = tuple[int, int]


@dataclass(frozen=True)
class DialTable:
    """Readings, one per row.

    Attributes
    ----------
    tool : (R,) 1 or 2 ; axis : (R,) 0, 1, 2 for x, y, z ; place, repeat : (R,) numbers of the series
    force : (R,) N, of the sheet or pad on the tool along the axis ; deflection : (R,) m, of the tip, positive where it
        gives way along the axis with that force
    """

    tool: NDArray[np.int64]
    axis: NDArray[np.int64]
    place: NDArray[np.int64]
    repeat: NDArray[np.int64]
    force: Array
    deflection: Array


@dataclass(frozen=True)
class DialAxis:
    """Compliance along one axis of one tool.

    Attributes
    ----------
    value, deviation : m/N; the deviation of a place drawn at random: of the fit, and from place to place
    per_place : (P,) m/N ; places : (P,) their numbers
    repeats : series ; readings, rejected : used and left out
    residual, largest : m rms, N
    constant : True where the places agree within CONSTANT, or there is one alone
    arm : m/N of the arm that carries the tool, taken off ``value`` and ``per_place``
    """

    value: float
    deviation: float
    per_place: Array
    places: NDArray[np.int64]
    repeats: int
    readings: int
    rejected: int
    residual: float
    largest: float
    constant: bool
    arm: float = 0.0


def fit_dial(table: DialTable) -> tuple[dict[Pair, DialAxis], dict[Pair, IsfError]]:
    """Compliance of every (tool, axis) that the table holds, and why others are refused (MEASUREMENT_FAILED).

    Outliers are left out and counted; more than a fifth of them, a curve that the scatter does not explain and that is
    more than 5 % of the deflection (rms), a slope that the scatter hides or one that is not positive refuse an axis:
    the sign of force or dial is wrong then. Raises that IsfError when no axis is left.
    """
    pairs = sorted({(int(tool), int(axis)) for tool, axis in zip(table.tool, table.axis, strict=True)})
    found: dict[Pair, DialAxis] = {}
    refused: dict[Pair, IsfError] = {}
    for pair in pairs:
        try:
            found[pair] = _fit_axis(table, *pair)
        except IsfError as error:
            refused[pair] = error
    if not found and refused:
        raise next(iter(refused.values()))
    return found, refused


def without_arms(
    found: dict[Pair, DialAxis], arms: dict[int, Array]
) -> tuple[dict[Pair, DialAxis], dict[Pair, IsfError]]:
    """``found`` of tool and holder alone: without what the ``arms`` (3,) m/N of the tools give way, 0 without an arm.

    Refused (MEASUREMENT_FAILED) is an axis on which the deviation hides what is left.
    """
    alone: dict[Pair, DialAxis] = {}
    refused: dict[Pair, IsfError] = {}
    for (tool, axis), item in found.items():
        arm = float(arms[tool][axis])
        left = item.value - arm
        if arm > 0.0 and not left > item.deviation:
            refused[tool, axis] = _failed(
                f"compliance of tool_{tool} along {AXES[axis]} is {1e6 * item.value:.4g} um/N, of which its arm takes "
                f"{1e6 * arm:.4g}: the {1e6 * left:.4g} +- {1e6 * item.deviation:.2g} um/N that are left are not known",
                f"check the stiffness of the joints of tool_{tool}.arm in the rig file",
            )
        else:
            alone[tool, axis] = replace(item, value=left, per_place=item.per_place - arm, arm=arm)
    return alone, refused


def far_from(found: dict[Pair, DialAxis], present: dict[int, Array], column: str) -> dict[Pair, IsfError]:
    """Axes beyond FAR times, or below 1 / FAR of, the ``present`` (3,) m/N of their tool, by the ``column`` read.

    No machine is that far from its rig file; a unit is. A ``present`` of 0 is not compared with.
    """
    refused: dict[Pair, IsfError] = {}
    for (tool, axis), item in found.items():
        known = float(present[tool][axis])
        if known <= 0.0 or 1.0 / FAR <= item.value / known <= FAR:
            continue
        if item.value > known:
            likely = "the deflections are um" if column == "deflection_mm" else "the forces are kN"
        else:
            likely = "the deflections are mm" if column == "deflection_um" else "the forces are not in N"
        refused[tool, axis] = _failed(
            f"compliance of tool_{tool} along {AXES[axis]} is {1e6 * item.value:.4g} um/N, {item.value / known:.3g} "
            f"times the rig's {1e6 * known:.4g} um/N",
            f"probably {likely}: name the column by its unit; of a machine that is so far off, put a rough value into "
            "the rig file first",
        )
    return refused


def dial_piece(
    rig: str,
    date: str,
    found: dict[Pair, DialAxis],
    present: dict[int, Array],
    refused: dict[Pair, IsfError] | None = None,
) -> str:
    """YAML of a rig file on top of ``rig``; axes without readings, and ``refused`` ones, keep the ``present`` (3,) m/N
    of their tool."""
    refused = refused or {}
    lines: list[str] = []
    facts: dict[str, str] = {}
    for tool in sorted({tool for tool, _ in found}):
        name = f"tool_{tool}"
        numbers = [found[tool, k].value if (tool, k) in found else present[tool][k] for k in range(3)]
        lines += [f"{name}:", "  compliance: [" + ", ".join(f"{1e6 * number:.4f} um/N" for number in numbers) + "]"]
        for k, axis in enumerate(AXES):
            reported = f"not identified {date}: {'readings refused, ' if (tool, k) in refused else ''}kept"
            facts[f"{name}.compliance.{axis}"] = (
                f"identified {date}: {_remarks(found[tool, k])}" if (tool, k) in found else reported
            )
    return rig_piece(rig, lines, facts)


def _remarks(item: DialAxis) -> str:
    apart = "" if item.constant else ", not constant over the workspace"
    apart += f", {1e6 * item.arm:.4f} um/N of the arm taken off" if item.arm else ""
    return (
        f"{1e6 * item.value:.4f} +- {1e6 * item.deviation:.4f} um/N, dial indicator at the tip, {len(item.places)} "
        f"places, {item.repeats} series, {item.readings} readings ({item.rejected} left out), forces to "
        f"{item.largest:.0f} N{apart}"
    )


def _fit_axis(table: DialTable, tool: int, axis: int) -> DialAxis:
    rows = (table.tool == tool) & (table.axis == axis)
    what = f"compliance of tool_{tool} along {AXES[axis]}"
    force, deflection = table.force[rows], table.deflection[rows]
    series = np.unique(np.column_stack([table.place[rows], table.repeat[rows]]), axis=0, return_inverse=True)[1].ravel()
    for number in range(int(series.max()) + 1):
        if len(np.unique(force[series == number])) < MINIMUM_FORCES:
            raise _failed(
                f"{what}: a series has fewer than {MINIMUM_FORCES} different forces",
                "read the dial at several loads of every place and repetition",
            )
    whole = _line(force, deflection, series, what)
    _check_straight(force, deflection, series, whole, what)
    places = np.unique(table.place[rows])
    per_place = [
        _line(force[here], deflection[here], series[here], f"{what}, place {place}")
        for place in places
        for here in [table.place[rows] == place]
    ]
    values = np.array([fit.value[0] for fit in per_place])
    between = float(values.std(ddof=1)) if len(values) > 1 else 0.0
    value = float(whole.value[0])
    if value <= 0.0:
        raise _failed(f"{what} is {1e6 * value:.3f} um/N", "turn the sign of the force or of the dial in the table")
    if whole.deviation[0] > OBSERVED * value:
        raise _failed(
            f"{what} is {1e6 * value:.3f} +- {1e6 * whole.deviation[0]:.3f} um/N: the scatter of the readings hides it",
            "read the dial at greater loads, and more often",
        )
    own = float(np.mean([fit.deviation[0] ** 2 for fit in per_place]))
    # the spread of the places has their own scatter in it
    chance = float(stats.chi2.ppf(1.0 - DOUBT, max(1, len(values) - 1))) / max(1, len(values) - 1)
    constant = between <= max(CONSTANT * value, math.sqrt(chance * own))
    return DialAxis(
        value,
        float(np.hypot(whole.deviation[0], between)),
        values,
        places,
        int(series.max()) + 1,
        int(whole.used.sum()),
        int((~whole.used).sum()),
        whole.residual,
        float(np.abs(force).max()),
        constant,
    )


def _line(force: Array, deflection: Array, series: NDArray[np.int64], what: str) -> LinearFit:
    return fit_linear(force[:, None], deflection, series.astype(np.int64), what, most_residual=math.inf)


def _check_straight(force: Array, deflection: Array, series: NDArray[np.int64], line: LinearFit, what: str) -> None:
    """Raise IsfError when the readings bend by more than their scatter explains and by more than MAXIMUM_RESIDUAL.

    Square and cube of the force are added to the line (F test). The residual alone says nothing: stiff tools give way
    by little more than a dial scatters.
    """
    f, d, groups = force[line.used], deflection[line.used], series[line.used]
    unit = f / np.abs(f).max()
    powers = np.column_stack([unit**k for k in (1, 2, 3)])
    rows, y = _less_mean(powers, groups), _less_mean(d[:, None], groups)[:, 0]
    straight = rows[:, :1] @ np.linalg.lstsq(rows[:, :1], y, rcond=None)[0]
    bent_by, _, rank, _ = np.linalg.lstsq(rows, y, rcond=1e-6)
    bent = rows @ bent_by
    more, freedom = int(rank) - 1, len(y) - len(np.unique(groups)) - int(rank)
    if more < 1 or freedom < 1:
        return
    curve, scatter = float(((bent - straight) ** 2).sum()), float(((y - bent) ** 2).sum())
    size = math.sqrt(curve / len(y))
    significant = curve / more > float(stats.f.ppf(1.0 - DOUBT, more, freedom)) * scatter / freedom
    if significant and size > MAXIMUM_RESIDUAL * line.span:
        raise _failed(
            f"the {what} is not linear: bends by {1e6 * size:.1f} um (rms) of {1e6 * line.span:.0f} um, readings "
            f"scatter by {1e6 * math.sqrt(scatter / freedom):.1f} um",
            "check for play or a loose holder; read at smaller loads",
        )


def _less_mean(values: Array, groups: NDArray[np.int64]) -> Array:
    """(R, P) less the mean of each group (R,)."""
    index = np.unique(groups, return_inverse=True)[1].ravel()
    sums = np.zeros((int(index.max()) + 1, values.shape[1]))
    np.add.at(sums, index, values)
    return np.asarray(values - (sums / np.bincount(index)[:, None])[index])


def _failed(what: str, advice: str) -> IsfError:
    return IsfError(ErrorCode.MEASUREMENT_FAILED, what, where="dial indicator", advice=advice)
