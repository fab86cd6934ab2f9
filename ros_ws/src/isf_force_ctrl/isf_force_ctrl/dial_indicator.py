"""Tool compliance from an external displacement sensor at the tip (Ren 2018, 2.2.1).

The tools are squeezed against each other through a pad; at several loads the force of the load cell f and the reading
of a dial indicator at the tip of one tool d are written down, for every tool, axis and place, and repeated. Per series
(one place, one repetition) d = C f + zero: the zero of the dial and the pad between the tools do not matter. The dial
tells one tool from the other and from the contact, which a squeeze alone cannot
(:mod:`isf_force_ctrl.identify_fit`); it needs hands, and nothing of the cell but its readings.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from isf_core.errors import ErrorCode, IsfError
from numpy.typing import NDArray

from isf_force_ctrl.identify_fit import LinearFit, fit_linear
from isf_force_ctrl.identify_piece import rig_piece

Array = NDArray[np.float64]

LEAST_FORCES = 3
"""Different loads per series, of any sign: fewer do not show whether the deflection is proportional."""

CONSTANT = 0.05
"""Standard deviation over mean of the places: more than that is not constant over the workspace (assumed; the simulated
machine's published bound is a small variation, below 5 %)."""

AXES = "xyz"


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


def fit_dial(table: DialTable) -> dict[tuple[int, int], DialAxis]:
    """Compliance of every (tool, axis) that the table holds; raises IsfError MEASUREMENT_FAILED.

    Outliers are left out and counted; more than a fifth of them, a residual beyond 5 % of the deflection (not linear)
    or a compliance that is not positive ends it: the sign of force or dial is wrong then.
    """
    pairs = sorted({(int(tool), int(axis)) for tool, axis in zip(table.tool, table.axis, strict=True)})
    return {pair: _fit_axis(table, *pair) for pair in pairs}


def dial_piece(rig: str, date: str, found: dict[tuple[int, int], DialAxis], present: dict[int, Array]) -> str:
    """YAML of a rig file on top of ``rig``; axes without readings keep the ``present`` (3,) m/N of their tool."""
    lines: list[str] = []
    facts: dict[str, str] = {}
    for tool in sorted({tool for tool, _ in found}):
        name = f"tool_{tool}"
        numbers = [found[tool, k].value if (tool, k) in found else present[tool][k] for k in range(3)]
        lines += [f"{name}:", "  compliance: [" + ", ".join(f"{1e6 * number:.4f} um/N" for number in numbers) + "]"]
        for k, axis in enumerate(AXES):
            facts[f"{name}.compliance.{axis}"] = (
                f"identified {date}: {_told(found[tool, k])}" if (tool, k) in found else f"not identified {date}: kept"
            )
    return rig_piece(rig, lines, facts)


def _told(item: DialAxis) -> str:
    apart = "" if item.constant else ", not constant over the workspace"
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
        if len(np.unique(force[series == number])) < LEAST_FORCES:
            raise _failed(
                f"{what}: a series has fewer than {LEAST_FORCES} different forces",
                "read the dial at several loads of every place and repetition",
            )
    whole = _line(force, deflection, series, what)
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
        between <= CONSTANT * value,
    )


def _line(force: Array, deflection: Array, series: NDArray[np.int64], what: str) -> LinearFit:
    return fit_linear(force[:, None], deflection, series.astype(np.int64), what)


def _failed(what: str, advice: str) -> IsfError:
    return IsfError(ErrorCode.MEASUREMENT_FAILED, what, where="dial indicator", advice=advice)
