"""Compliances, contact stiffness and signs of load cells from the readings of squeeze tests.

With n from ball 1 to ball 2, commanded centres, a contact of stiffness k_m and F_s = F_1 + F_2, the part of tool 1's
force that the sheet puts on it (Ren 2018 eq. 2-4 to 2-9, written for any direction), the commanded gap of the balls is

    gap = T - n . (C_1 + C_2 + 1/k_m) F_2 + n . C_1 F_s

with one unknown T for every visit of a place. A squeeze loads both tools alike, so it shows the sum alone. C_1 shows
itself where the sheet loads tool 1 alone: there tool 2 is the indicator of its deflection, as the dial of the published
procedure (2.2.1) is. Sheet at rest pushes along z, so in x and y the sum can only be shared out by a known ratio.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from isf_core.errors import ErrorCode, IsfError
from isf_core.types import Array
from numpy.typing import NDArray

from isf_identify.settings import Place, ToolGeometry
from isf_identify.squeeze_probe import Reading

MAXIMUM_REJECTED = 0.2
"""Share of readings that may be outliers."""

OUTLIER = 4.5
"""Robust standard deviations from the fit."""

MINIMUM_DEVIATION = 0.2e-6
"""m; readings nearer to the fit than this are never outliers (assumed, resolution of encoder and cell)."""

MAXIMUM_RESIDUAL = 0.05
"""Of the deflection: a greater residual (rms) is not a linear compliance."""

OBSERVED = 0.3
"""Largest standard deviation over value of a compliance that counts as observed."""

SMALL = 0.02e-6
"""m/N; a compliance known to this is observed, however small it is."""

NEGLIGIBLE = 0.01
"""Of the largest force along n: components below it carry no information."""


@dataclass(frozen=True)
class LinearFit:
    """``value``, ``deviation`` (standard) of the parameters; ``residual`` (rms) and ``span`` of what was fitted;
    ``covariance``; ``used`` mask of the rows that are no outliers; NaN where a parameter cannot be told."""

    value: Array
    deviation: Array
    covariance: Array
    residual: float
    span: float
    used: NDArray[np.bool_]


def fit_linear(
    matrix: Array, wanted: Array, groups: NDArray[np.int64], what: str, *, most_residual: float = MAXIMUM_RESIDUAL
) -> LinearFit:
    """Least squares of ``wanted`` (R,) = ``matrix`` (R, P) p + one constant per group (R,), without outliers.

    Raises IsfError MEASUREMENT_FAILED: too few readings, too many outliers, or a residual beyond ``most_residual`` of
    the deflection (not linear).
    """
    used = np.ones(len(wanted), dtype=bool)
    while True:
        rows, y = _centred(matrix[used], groups[used]), _centred(wanted[used, None], groups[used])[:, 0]
        scale = np.sqrt((rows**2).sum(axis=0))
        scale[scale == 0.0] = 1.0
        u, s, v = np.linalg.svd(rows / scale, full_matrices=False)
        good = s > 1e-6 * s[0] if len(s) and s[0] > 0.0 else np.zeros(len(s), dtype=bool)
        freedom = len(y) - len(set(groups[used].tolist())) - int(good.sum())
        if freedom < 2:
            raise _failed(f"{len(y)} readings are too few for the {what}")
        value = (v[good].T * (1.0 / s[good])) @ (u[:, good].T @ y) / scale
        apart = y - rows @ value
        robust = max(1.4826 * float(np.median(np.abs(apart - np.median(apart)))), MINIMUM_DEVIATION)
        worst = int(np.argmax(np.abs(apart)))
        if abs(apart[worst]) <= OUTLIER * robust:
            break
        used[np.flatnonzero(used)[worst]] = False
        if (~used).sum() > MAXIMUM_REJECTED * len(used):
            raise _failed(f"more than {100 * MAXIMUM_REJECTED:.0f} % of the readings do not fit the {what}")
    residual = float(np.sqrt((apart**2).sum() / freedom))
    span = float(np.ptp(y))
    if residual > most_residual * span:
        raise _failed(f"the {what} is not linear: residual {1e6 * residual:.1f} um of {1e6 * span:.0f} um")
    inverse = (v[good].T * s[good] ** -2) @ v[good] / np.outer(scale, scale)
    # a parameter with a part outside the space that the readings span cannot be told
    shown = (v[good] ** 2).sum(axis=0) > 1.0 - 1e-6
    value = np.where(shown, value, np.nan)
    covariance = residual**2 * inverse
    deviation = np.where(shown, np.sqrt(np.diag(covariance)), np.nan)
    return LinearFit(value, deviation, covariance, residual, span, used)


@dataclass(frozen=True)
class ComplianceFit:
    """Per axis x, y, z, m/N; NaN where the readings do not tell.

    Attributes
    ----------
    total, total_deviation : (3,) C_1 + C_2 + 1/k_m
    first, first_deviation : (3,) C_1, where the sheet loads tool 1 along the axis
    residual, span : m, rms of what is not explained, and range of what is
    rejected : outliers
    force, gap, fitted : (R,) N along n, m less T, and the fit to it, for a picture
    """

    total: Array
    total_deviation: Array
    first: Array
    first_deviation: Array
    residual: float
    span: float
    rejected: int
    force: Array
    gap: Array
    fitted: Array

    def contact(self, ratio: float) -> tuple[float, float]:
        """1/k_m and its deviation, m/N, when C_2 is ``ratio`` times C_1 in z (half of C_2 is counted as unknown)."""
        second = ratio * self.first[2]
        own = float(np.hypot(self.total_deviation[2], self.first_deviation[2]))
        return float(self.total[2] - self.first[2] - second), float(np.hypot(own, 0.5 * second))

    def of_tool(self, tool: int, ratio: Array) -> tuple[Array, Array, list[str]]:
        """Compliance of ``tool`` (1, 2), its deviation (3,), m/N, and per axis where it comes from.

        ``ratio`` (3,) is C_2 / C_1 of the present rig file: it shares out what is seen as a sum.
        """
        value, deviation = np.full(3, np.nan), np.full(3, np.nan)
        how = ["not observable: no squeeze along this axis (flat sheet; form a wall first)"] * 3
        give, give_deviation = self.contact(ratio[2])
        for axis in range(3):
            if tool == 1 and np.isfinite(self.first[axis]):
                value[axis], deviation[axis] = self.first[axis], self.first_deviation[axis]
                how[axis] = "measured on its own, under the force of the sheet"
            elif axis == 2 and np.isfinite(self.total[2]):
                how[axis] = "not observable: seen only together with tool 1 and the contact"
            elif np.isfinite(self.total[axis]) and np.isfinite(give):
                share = (ratio[axis] if tool == 2 else 1.0) / (1.0 + ratio[axis])
                value[axis] = share * (self.total[axis] - give)
                deviation[axis] = share * np.hypot(self.total_deviation[axis], give_deviation)
                how[axis] = f"share {share:.2f} (ratio of the rig file, assumed) of the measured sum of both tools"
            elif np.isfinite(self.total[axis]):
                how[axis] = "not observable: the contact is not known without a flat place"
        return value, deviation, how


def without_arm(arm: Array, value: Array, deviation: Array, how: list[str]) -> tuple[Array, Array, list[str]]:
    """Compliance of tool and holder alone, its deviation, m/N, and how, from the ``value`` (3,) with the ``arm`` (3,).

    What is left is NaN where the deviation hides it: the stiffness of an arm's joints is known less well than it takes.
    """
    value, deviation, how = value - arm, deviation.copy(), list(how)
    for axis in np.flatnonzero((arm > 0.0) & np.isfinite(value)):
        taken = f"{1e6 * arm[axis]:.4f} um/N of the arm taken off"
        how[axis] = f"{how[axis]}; {taken}"
        if not value[axis] > deviation[axis]:
            left = f"{1e6 * value[axis]:.4f} +- {1e6 * deviation[axis]:.4f} um/N are left, {taken}"
            value[axis] = deviation[axis] = np.nan
            how[axis] = f"not observable: {left}; check the stiffness of the arm's joints in the rig file"
    return value, deviation, how


def fit_compliance(readings: list[Reading], places: list[Place], geometry: ToolGeometry) -> ComplianceFit:
    """Compliances of both tools as far as the ``readings`` show them; raises IsfError MEASUREMENT_FAILED."""
    used = [item for item in readings if item.kind in ("squeeze", "carried")]
    if not used:
        raise _failed("there are no readings of a squeeze")
    gap, normal = _gaps(used, geometry)
    second = np.array([item.force_2 for item in used])
    sheet = np.array([item.force_1 for item in used]) + second
    groups = np.array([1000 * item.place + item.repeat for item in used])
    matrix = np.hstack([-normal * second, normal * sheet])
    # n_x of a flat place is zero but for noise, which must not carry anything into an axis
    matrix[np.abs(matrix) < NEGLIGIBLE * np.abs(matrix).max()] = 0.0
    fit = fit_linear(matrix, gap, groups, "squeeze")
    value, deviation = _observed(fit.value, fit.deviation)
    explained = matrix @ np.nan_to_num(fit.value)
    return ComplianceFit(
        value[:3],
        deviation[:3],
        value[3:],
        deviation[3:],
        fit.residual,
        fit.span,
        int((~fit.used).sum()),
        (normal * second).sum(axis=1),
        gap - _group_means(gap - explained, groups),
        explained,
    )


@dataclass(frozen=True)
class StiffnessFit:
    """K_c, N/m, from ``slopes`` (V,) with ``slope_deviation`` (V,) of every visit at ``wall_angle`` (V,) rad.

    ``force`` N over ``way`` m (R,) with the ``fitted`` force, for a picture.
    """

    value: float
    deviation: float
    slopes: Array
    slope_deviation: Array
    wall_angle: Array
    force: Array
    way: Array
    fitted: Array


def fit_stiffness(readings: list[Reading], places: list[Place]) -> StiffnessFit:
    """Horizontal normal force over the way of tool 2 along d_n; raises IsfError MEASUREMENT_FAILED."""
    visits: dict[tuple[int, int], list[Reading]] = {}
    for item in readings:
        if item.kind == "step":
            visits.setdefault((item.place, item.repeat), []).append(item)
    slopes, deviations, angles = [], [], []
    ways, forces, fitted = [], [], []
    for (place, _), items in visits.items():
        if len(items) < 4:
            continue
        along = places[place].horizontal
        force = np.array([item.force_2 @ along for item in items])
        way = -np.array([(item.tip_2 - items[0].tip_2) @ along for item in items])
        one = np.zeros(len(items), dtype=np.int64)
        # fitted as way over force: the outlier limits are lengths
        fit = fit_linear(force[:, None], way, one, "contact stiffness")
        slopes.append(1.0 / fit.value[0])
        deviations.append(fit.deviation[0] / fit.value[0] ** 2)
        angles.append(places[place].wall_angle)
        ways.append(way)
        forces.append(force)
        fitted.append(force.mean() + (way - way.mean()) / fit.value[0])
    if not slopes:
        raise _failed("no place gave enough steps within max_force")
    slope, own = np.array(slopes), np.array(deviations)
    if (slope <= 0.0).any():
        raise _failed("the force falls as the tool approaches: check the signs of the load cells")
    between = float(slope.std(ddof=1)) if len(slope) > 1 else 0.0
    deviation = float(np.hypot(between, np.sqrt((own**2).mean())))
    return StiffnessFit(
        float(slope.mean()),
        deviation,
        slope,
        own,
        np.array(angles),
        np.concatenate(forces),
        np.concatenate(ways),
        np.concatenate(fitted),
    )


@dataclass(frozen=True)
class SignFit:
    """What each load cell says about squeezes of known direction.

    Attributes
    ----------
    sign : (2, 3) of channels x, y, z of tool 1 and tool 2: 1 right, -1 turned round, 0 carries another axis; NaN where
        no squeeze had a part along that axis
    deviation : (2, 3) of the diagonal of ``share``
    share : (2, 3, 3) reading over force, row: channel, column: true axis, over the norm of the reading; NaN columns
        where no squeeze had a part along that axis
    source : (2, 3) axis 0, 1, 2 that a channel carries; -1 where it is not known
    crosstalk : (2,) largest share of another axis in a channel, NaN when not known
    """

    sign: Array
    deviation: Array
    share: Array
    source: NDArray[np.int64]
    crosstalk: Array

    def faults(self) -> list[str]:
        """What is wrong, for people."""
        names, found = "xyz", []
        for tool in (0, 1):
            for axis in range(3):
                source = int(self.source[tool, axis])
                if source >= 0 and source != axis:
                    found.append(f"F{names[axis]} of tool_{tool + 1} carries {names[source]}")
                elif self.sign[tool, axis] < 0.0:
                    found.append(f"F{names[axis]} of tool_{tool + 1} has the wrong sign")
        return found


def fit_signs(readings: list[Reading], places: list[Place], geometry: ToolGeometry) -> SignFit:
    """Signs, order and crosstalk of the force channels from the squeezes; raises IsfError MEASUREMENT_FAILED.

    A squeeze loads tool 2 along n and tool 1 along -n by as much; the norm of a reading is that of the force, whatever
    its signs and order are.
    """
    changes: list[tuple[Array, Array, Array]] = []
    visits = sorted({(item.place, item.repeat) for item in readings})
    for visit in visits:
        items = [item for item in readings if (item.place, item.repeat) == visit and item.kind == "squeeze"]
        _, normals = _gaps(items, geometry) if items else (None, np.empty((0, 3)))
        for item, normal in zip(items[1:], normals[1:], strict=True):
            changes.append((normal, item.force_1 - items[0].force_1, item.force_2 - items[0].force_2))
    if len(changes) < 3:
        raise _failed("there are too few squeezes")
    normal = np.array([item[0] for item in changes])
    share, sign = np.full((2, 3, 3), np.nan), np.full((2, 3), np.nan)
    deviation, source = np.full((2, 3), np.nan), np.full((2, 3), -1)
    crosstalk = np.full(2, np.nan)
    for tool in (0, 1):
        change = np.array([item[1 + tool] for item in changes])
        size = np.linalg.norm(change, axis=1)
        if size.max() < 10.0:
            raise _failed(f"tool_{tool + 1} reads {size.max():.0f} N at most while it is squeezed: its cell is dead")
        direction = (normal if tool else -normal) * size[:, None]
        shown = _shown_axes(direction)
        fit, _, _, _ = np.linalg.lstsq(direction[:, shown], change, rcond=None)
        freedom = max(1, len(change) - int(shown.sum()))
        scatter = np.sqrt(((change - direction[:, shown] @ fit) ** 2).sum(axis=0) / freedom)
        inverse = np.sqrt(np.diag(np.linalg.inv(direction[:, shown].T @ direction[:, shown])))
        share[tool][:, shown] = fit.T
        axes = np.flatnonzero(shown)
        for axis in axes:
            column = share[tool][:, axis]
            channel = int(np.argmax(np.abs(column)))
            source[tool, channel] = axis
            if channel == axis:
                sign[tool, axis] = np.sign(column[axis])
            else:
                sign[tool, axis] = 0.0
            deviation[tool, axis] = scatter[axis] * inverse[list(axes).index(axis)]
        other = [
            abs(share[tool][channel, axis] / share[tool][np.argmax(np.abs(share[tool][:, axis])), axis])
            for axis in axes
            for channel in range(3)
            if channel != int(np.argmax(np.abs(share[tool][:, axis])))
        ]
        crosstalk[tool] = max(other)
    return SignFit(sign, deviation, share, source, crosstalk)


def _shown_axes(direction: Array) -> NDArray[np.bool_]:
    """(3,) axes that the directions (R, 3) tell apart from the others."""
    size = np.sqrt((direction**2).sum())
    shown = np.sqrt((direction**2).sum(axis=0)) > 0.1 * size
    while shown.sum() > 1 and np.linalg.svd(direction[:, shown], compute_uv=False)[-1] < 0.05 * size:
        # squeezes in one direction alone: only its greatest part is told
        weakest = min(np.flatnonzero(shown), key=lambda axis: float(np.abs(direction[:, axis]).sum()))
        shown[weakest] = False
    return shown


def _gaps(readings: list[Reading], geometry: ToolGeometry) -> tuple[Array, Array]:
    """(R,) m commanded gap between the balls, (R, 3) n."""
    apart = geometry.between_balls(
        np.array([item.tip_1 for item in readings]), np.array([item.tip_2 for item in readings])
    )
    distance = np.linalg.norm(apart, axis=1)
    return distance - sum(geometry.balls), apart / distance[:, None]


def _observed(value: Array, deviation: Array) -> tuple[Array, Array]:
    """NaN in place of values that the readings do not tell well enough."""
    with np.errstate(invalid="ignore"):
        known = (deviation <= SMALL) | ((value > 0.0) & (deviation <= OBSERVED * value))
    return np.where(known, value, np.nan), np.where(known, deviation, np.nan)


def _centred(rows: Array, groups: NDArray[np.int64]) -> Array:
    """Rows less the mean of their group."""
    result = rows.copy()
    for group in np.unique(groups):
        result[groups == group] -= rows[groups == group].mean(axis=0)
    return result


def _group_means(values: Array, groups: NDArray[np.int64]) -> Array:
    result = np.empty(len(values))
    for group in np.unique(groups):
        result[groups == group] = values[groups == group].mean()
    return result


def _failed(what: str) -> IsfError:
    return IsfError(ErrorCode.MEASUREMENT_FAILED, what, where="identify", advice="repeat it with more places or force")
