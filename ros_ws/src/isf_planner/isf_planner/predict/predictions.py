"""What a plan will do to sheet and machine: force along the path, thinning, margins and time, with where they hold.

Two force models: the regression of Aerens (the field's standard; fills ``Contour.predicted_force``) and the force
equilibrium of Praveen 2020 (eq. 1-3; also gives the radial force). Outside its range of wall angles a model is held
at the edge of the range: the regression, for one, goes to zero on a floor, the force of the tool does not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from isf_core.contour import Contour, contour_label
from isf_core.files.job import Job, JobFile
from isf_core.files.material import Material, flow_curve, plane_strain
from isf_core.files.rig import Rig
from isf_core.process.forming_force import aerens_axial_force, equilibrium_force
from isf_core.process.support_window import chip_force
from isf_core.types import Array
from numpy.typing import NDArray
from scipy.spatial import KDTree

from isf_planner.part.mesh_checks import place_text

MARGIN = 0.95
"""Part of a limit above which a point is warned of."""

NEAR = 3.0
"""Distance to the pass that a pass of partial paths is formed after, at most, over the tool radius."""

PLACES = 64
"""Points of a pass, about, by which its distance to another one is known."""


@dataclass(frozen=True)
class Validity:
    """Where a force model was fitted or tested: wall angle rad, sheet m, tool radius m (lowest, highest)."""

    name: str
    wall_angle: tuple[float, float]
    sheet: tuple[float, float]
    radius: tuple[float, float]

    def objections(self, sheet: float, radii: Sequence[float]) -> tuple[str, ...]:
        """What of the ``sheet`` (m) and the ``radii`` (m) of forming tools is out of range, for people."""
        reported = []
        checked = [("sheet of", sheet, self.sheet), *(("tool radius of", radius, self.radius) for radius in radii)]
        for what, value, (low, high) in checked:
            if not low - 1e-9 <= value <= high + 1e-9:
                reported.append(f"{what} {value * 1e3:.2f} mm (known for {low * 1e3:g} to {high * 1e3:g} mm)")
        return tuple(reported)


AERENS = Validity("regression", (np.radians(20), np.radians(65)), (0.5e-3, 2.0e-3), (5e-3, 12.5e-3))
"""Wall angles and sheets as :func:`isf_core.process.forming_force.aerens_axial_force` states; tools of 10 to 25 mm
diameter."""

EQUILIBRIUM = Validity("equilibrium", (np.radians(20), np.radians(60)), (0.8e-3, 0.8e-3), (6.35e-3, 6.35e-3))
"""Praveen 2020, 3: one sheet and one tool, walls up to 60 deg; below 20 deg the wall is flatter than the groove."""


@dataclass(frozen=True)
class Limits:
    """What the sheet allows.

    Attributes
    ----------
    wall_angle : rad, of the job or the material
    thinning : largest loss of thickness as part of the blank's that one pass may cause, 1 - cos(wall angle): the sine
        law at the steepest wall that the material bears in one pass, whatever the job permits
    """

    wall_angle: float
    thinning: float


@dataclass(frozen=True)
class Prediction:
    """One contour, N points.

    Attributes
    ----------
    axial : (N,) N, by the regression
    axial_equilibrium, radial_equilibrium : (N,) N, by the equilibrium
    regression_valid, equilibrium_valid : (N,) bool, the wall angle is in the model's range
    thinning : (N,) loss of thickness as part of the blank's
    angle_margin : (N,) rad, to the limit, negative beyond it
    time : s, for the contour itself at its planned speeds
    travel_time : s, from the contour before, or from lifted tools, at the rig's largest speed
    """

    axial: Array
    axial_equilibrium: Array
    radial_equilibrium: Array
    regression_valid: NDArray[np.bool_]
    equilibrium_valid: NDArray[np.bool_]
    thinning: Array
    angle_margin: Array
    time: float
    travel_time: float


def limits_of(material: Material, job: Job) -> Limits:
    """Wall angle and thinning that ``job`` may reach in ``material``."""
    angle = job.wall_angle_limit or material.max_wall_angle
    return Limits(angle, 1.0 - float(np.cos(material.max_wall_angle)))


def predict(contours: Sequence[Contour], job_file: JobFile) -> tuple[Prediction, ...]:
    """Prediction of every contour."""
    job, material = job_file.job, job_file.material
    limits = limits_of(material, job)
    curve = flow_curve(material)
    steps = step_depths(contours, job.path.incremental_depth, near_of(job))
    predictions = []
    before: Contour | None = None
    for contour, step in zip(contours, steps, strict=True):
        radius = _radius(contour.forming_tool, job)
        angle = contour.wall_angle
        held = np.clip(angle, *AERENS.wall_angle)
        balanced = np.clip(angle, *EQUILIBRIUM.wall_angle)
        stress = curve.stress(plane_strain(job.sheet.thickness, job.sheet.thickness * np.cos(balanced)))
        formed = job.sheet.thickness * np.cos(balanced)
        forces = _equilibrium(stress, formed, balanced, radius, step)
        predictions.append(
            Prediction(
                axial=aerens_axial_force(material.tensile_strength, job.sheet.thickness, radius, step, held),
                axial_equilibrium=forces[0],
                radial_equilibrium=forces[1],
                regression_valid=_inside(angle, AERENS),
                equilibrium_valid=_inside(angle, EQUILIBRIUM),
                thinning=1.0 - contour.thickness / job.sheet.thickness,
                angle_margin=limits.wall_angle - angle,
                time=contour_time(contour),
                travel_time=_travel_time(before, contour, job_file.rig),
            )
        )
        before = contour
    return tuple(predictions)


def with_predictions(contours: Sequence[Contour], job_file: JobFile) -> tuple[tuple[Contour, ...], tuple[str, ...]]:
    """Contours with ``predicted_force``, and warnings of points beyond a limit with their place."""
    predictions = predict(contours, job_file)
    filled = tuple(replace(c, predicted_force=p.axial) for c, p in zip(contours, predictions, strict=True))
    return filled, warnings_of(contours, predictions, job_file)


def warnings_of(contours: Sequence[Contour], predictions: Sequence[Prediction], job_file: JobFile) -> tuple[str, ...]:
    """The worst point of every limit that is exceeded or close, and models used outside their range."""
    job, rig = job_file.job, job_file.rig
    limits = limits_of(job_file.material, job)
    reported = []
    index, point, thinning = _worst(predictions, "thinning")
    # the sine law says nothing about several passes: isf_planner.forming.stages.strain_warnings
    in_stages = bool(job.path.stages) or job.path.morph is not None
    if thinning > MARGIN * limits.thinning and not (in_stages and contours[-1].stage):
        sheet = job.sheet.thickness * (1.0 - thinning) * 1e3
        word = "beyond" if thinning > limits.thinning else "close to"
        reported.append(
            f"{contour_label(index)} at {place_text(contours[index].contact[point])}: the sheet gets {sheet:.2f} mm "
            f"thin, a loss of {100 * thinning:.0f} %, {word} the {100 * limits.thinning:.0f} % of a wall of "
            f"{np.degrees(job_file.material.max_wall_angle):.0f} deg, the steepest that {job_file.material.name} bears "
            "in one pass"
        )
    index, point, axial = _worst(predictions, "axial")
    allowed = min(rig.limits.force[2], rig.load_cell.force_range[2])
    if axial > MARGIN * allowed:
        reported.append(
            f"{contour_label(index)} at {place_text(contours[index].contact[point])}: about {axial:.0f} N of axial "
            f"force are expected, the rig allows {allowed:.0f} N"
        )
    radii = sorted({_radius(contour.forming_tool, job) for contour in contours})
    if job.support_stays and job.tool_2 is not None:
        smaller = min(job.tool_1.ball_radius, job.tool_2.ball_radius)
        chips = chip_force(job_file.material.tensile_strength, smaller, job.sheet.thickness)
        if axial > chips:
            reported.append(
                f"the support tool under the blank carries what the forming tool presses, about {axial:.0f} N; it "
                f"sheds chips from {chips:.0f} N on (known of tools that squeeze a wall): see how the lower face of a "
                "first part looks"
            )
    objections = AERENS.objections(job.sheet.thickness, radii)
    if objections:
        reported.append(f"the predicted force is an extrapolation: {', '.join(objections)}")
    return tuple(reported)


def _radius(forming_tool: int, job: Job) -> float:
    """m, of the rounding that forms."""
    tool = job.tool_1 if forming_tool == 1 or job.tool_2 is None else job.tool_2
    return tool.ball_radius


def step_depths(contours: Sequence[Contour], default: float, near: float | None = None) -> Array:
    """(K,) m, how much deeper each contour runs than the one it is formed after; ``default`` for the first.

    ``near`` as in :func:`formed_after`.
    """
    height = [float(contour.forming_tip[:, 2].mean()) + contour.holder_height for contour in contours]
    steps = np.empty(len(contours))
    for k, before in enumerate(formed_after(contours, near)):
        step = abs(height[before] - height[k]) if before >= 0 else default
        steps[k] = step if step > 1e-6 else default
    return steps


def near_of(job: Job) -> float | None:
    """m, ``near`` of :func:`formed_after` for the contours of ``job``."""
    return NEAR * job.tool_1.ball_radius if job.path.partial_paths else None


def formed_after(contours: Sequence[Contour], near: float | None) -> list[int]:
    """Index of the contour that each one deepens: the one before it in its feature and stage, -1 for the first.

    Passes of partial paths run on one wall after the other. There it is the one that runs nearest, by the median over
    the tips, no more than ``near`` m away; -1 where there is none.
    """
    earlier: dict[tuple[int, int], list[int]] = {}
    result = []
    trees: dict[int, KDTree] = {}
    for k, contour in enumerate(contours):
        mine = earlier.setdefault((contour.feature, contour.stage), [])
        if near is None:
            result.append(mine[-1] if mine else -1)
        else:
            result.append(_nearest(contours, mine, contour, near, trees))
        mine.append(k)
    return result


def _nearest(
    contours: Sequence[Contour], earlier: Sequence[int], contour: Contour, near: float, trees: dict[int, KDTree]
) -> int:
    """Which of the ``earlier`` contours (indices) runs nearest to ``contour``, the last of these; fills ``trees``."""
    tips = contour.forming_tip[:: max(1, len(contour) // PLACES)]
    top = float(tips[:, 2].max())
    found, least = -1, near
    for k in reversed(earlier):
        if float(contours[k].forming_tip[:, 2].min()) - top > least:
            continue
        if k not in trees:
            trees[k] = KDTree(contours[k].forming_tip)
        distance = float(np.median(trees[k].query(tips, distance_upper_bound=least)[0]))
        if distance < least:
            found, least = k, distance
    return found


def contour_time(contour: Contour) -> float:
    """s, along the contour at its speeds, the way back to the first point included where it is closed."""
    tips = np.vstack([contour.forming_tip, contour.forming_tip[:1]]) if contour.closed else contour.forming_tip
    speed = contour.speed if len(contour.speed) else np.full(len(contour), contour.feed)
    if contour.closed:
        speed = np.append(speed, speed[0])
    way = np.linalg.norm(np.diff(tips, axis=0), axis=1)
    return float((way * 2.0 / (speed[1:] + speed[:-1])).sum())


def _travel_time(before: Contour | None, contour: Contour, rig: Rig) -> float:
    """s: straight at the feed from the contour before, or up, across and down at the rig's largest speed."""
    first = contour.forming_tip[0]
    if before is None:
        return float(abs(rig.park_height - first[2]) / rig.limits.speed)
    last = before.forming_tip[0 if before.closed else -1]
    if not contour.retract:
        return float(np.linalg.norm(first - last)) / contour.feed
    up = 2 * rig.park_height - last[2] - first[2]
    return float(up + np.linalg.norm(first[:2] - last[:2])) / rig.limits.speed


def _equilibrium(stress: Array, formed: Array, angle: Array, radius: float, step: float) -> tuple[Array, Array]:
    """Axial and radial force (N,) N for a flow stress that changes from point to point."""
    unit = equilibrium_force(1.0, formed, angle, radius, step)
    return unit.axial * stress, unit.radial * stress


def _inside(angle: Array, validity: Validity) -> NDArray[np.bool_]:
    low, high = validity.wall_angle
    return np.asarray((angle >= low) & (angle <= high))


def _worst(predictions: Sequence[Prediction], name: str) -> tuple[int, int, float]:
    """Contour, point and value of the largest value."""
    most = [float(getattr(prediction, name).max()) for prediction in predictions]
    index = int(np.argmax(most))
    return index, int(np.argmax(getattr(predictions[index], name))), most[index]
