"""Compensation in the plan, without feedback: bending of the tool, deflection of the sheet, error of the machine.

After Praveen 2020, 2.5. Both tools are moved by the same vector for the sheet, in the push direction of the forming
tool; only the forming tool is moved for its own bending; for the error of the machine the support tool is moved, so
that the distance of the tools is right, or the tool that the job knows to be off. The printed signs of eq. 20 and 21
would change the gap by millimetres and are not used. Forces come from the equilibrium of eq. 1-3: the axial one with
the groove angle of one increment, the radial one with the cusp angle
(:func:`isf_core.process.forming_force.cusp_angle`). The moved path has another wall angle, so force and deflection are
found again until the deflection stays.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import shapely
from isf_core.contour import Contour, contour_label
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.hardening_law import HardeningLaw
from isf_core.files.job import Job, JobFile
from isf_core.files.material import flow_curve, plane_strain
from isf_core.files.tooling import ToolSpec
from isf_core.geometry.opening import SMALLEST_GAP, Opening
from isf_core.process.deflection import SheetSection, cantilever_compliance, deflection, membrane_share, ring_load_law
from isf_core.process.forming_force import contact_patch, cusp_angle, equilibrium_force
from isf_core.types import Array
from scipy.spatial import KDTree

from isf_planner.part.mesh_checks import place_text
from isf_planner.predict import machine_error
from isf_planner.predict.predictions import EQUILIBRIUM, formed_after, near_of, step_depths

SETTLED = 20e-6
"""m, change of the sheet deflection below which the iteration ends (Praveen 2020, 2.5)."""

MAXIMUM_PASSES = 10

STEEPEST = np.radians(85.0)
"""rad, limit of the wall angle of a moved path."""

RATIO = (0.84, 0.9)
"""Radius of the opening over that of the clamp for which the deflection law is published (Praveen 2020, Table 1)."""


@dataclass(frozen=True)
class Deflections:
    """Along one contour, N points.

    Attributes
    ----------
    sheet : (N,) m, w ; tool : (N,) m, of the forming tool ; machine : (N,) m, tips too far apart
    wall_angle : (N,) rad, of the moved path
    membrane : (N,) part of the load that membrane forces carry
    """

    sheet: Array
    tool: Array
    machine: Array
    wall_angle: Array
    membrane: Array


def compensate(contours: Sequence[Contour], job_file: JobFile) -> tuple[tuple[Contour, ...], tuple[str, ...]]:
    """Contours with moved tips as ``path.compensation`` of the job wants them, and what was done, for people.

    Raises
    ------
    IsfError : COMPENSATION_FAILED when the deflection does not settle, with the place; faults of the error map
    """
    job = job_file.job
    if not contours:
        return (), ()
    found = deflections(contours, job_file)
    moved = tuple(_moved(contour, one, job) for contour, one in zip(contours, found, strict=True))
    return moved, _remarks(contours, found, job_file)


def deflections(contours: Sequence[Contour], job_file: JobFile) -> tuple[Deflections, ...]:
    """What bends under every contour; zero for what the job does not compensate."""
    job = job_file.job
    wanted = job.path.compensation
    error = machine_error.load(job_file.base / job.path.machine_error) if job.path.machine_error else None
    steps = step_depths(contours, job.path.incremental_depth, near_of(job))
    curve = flow_curve(job_file.material)
    angles = [contour.wall_angle for contour in contours]
    before = formed_after(contours, near_of(job))
    radii = _radii(contours, job_file)
    passes = MAXIMUM_PASSES if "sheet" in wanted else 1
    sheet = [np.zeros(len(contour)) for contour in contours]
    for attempt in range(passes):
        found = [
            _sheet_deflection(contour, angle, step, radius, curve, job_file) if "sheet" in wanted else None
            for contour, angle, step, radius in zip(contours, angles, steps, radii, strict=True)
        ]
        new = [one[0] if one else np.zeros(len(contour)) for one, contour in zip(found, contours, strict=True)]
        change = [float(np.abs(a - b).max()) for a, b in zip(new, sheet, strict=True)]
        sheet = new
        if "sheet" not in wanted or max(change) < SETTLED:
            break
        if attempt == passes - 1:
            _refuse(contours, sheet, change)
        angles = [_moved_angle(contours, sheet, k, before[k], float(steps[k]), job) for k in range(len(contours))]
    return tuple(
        Deflections(
            sheet=sheet[k],
            tool=_tool_deflection(contour, angles[k], float(steps[k]), curve, job)
            if "tool" in wanted
            else np.zeros(len(contour)),
            machine=error.at(contour.forming_tip) if error and "machine" in wanted else np.zeros(len(contour)),
            wall_angle=angles[k],
            membrane=one[1] if (one := found[k]) else np.zeros(len(contour)),
        )
        for k, contour in enumerate(contours)
    )


def _moved(contour: Contour, found: Deflections, job: Job) -> Contour:
    """The contour with both tips moved; the contact goes with the sheet."""
    push = -contour.normal
    axial = _axial_shift(contour, found.sheet, job)
    lift = np.column_stack([np.zeros((len(contour), 2)), axial])
    across = found.tool[:, None] * np.column_stack([push[:, :2], np.zeros(len(contour))])
    moved = contour.shifted(lift)
    moved = replace(moved, forming_tip=moved.forming_tip + across)
    return _closer(moved, found.machine, job)


def _closer(contour: Contour, error: Array, job: Job) -> Contour:
    """The contour with one tip moved by ``error`` (N,) m along z: where the tips are too far apart, the lower tool
    goes up or the upper one down."""
    if not contour.has_support or not error.any():
        return contour
    support = 3 - contour.forming_tool
    tool = {"support": support, "tool_1": 1, "tool_2": 2}[job.path.machine_error_tool]
    shift = np.column_stack([np.zeros((len(contour), 2)), -error if tool == 1 else error])
    if tool == support:
        return replace(contour, support_tip=contour.support_tip + shift)
    return replace(contour, forming_tip=contour.forming_tip + shift)


def _axial_shift(contour: Contour, sheet: Array, job: Job) -> Array:
    """(N,) m along z for a deflection ``sheet`` (N,) m."""
    push = -contour.normal[:, 2]
    factor = push if job.path.sheet_term == "component" else np.sign(push)
    return np.asarray(job.path.sheet_gain * sheet * factor)


def _sheet_deflection(
    contour: Contour,
    angle: Array,
    step: float,
    radii: tuple[Array, Array],
    curve: HardeningLaw,
    job_file: JobFile,
) -> tuple[Array, Array]:
    """Deflection w (N,) m and membrane share (N,), with the opening in the direction of each point (eq. 1-16)."""
    job, material = job_file.job, job_file.material
    radius = _tool(job, contour).ball_radius
    held = np.clip(angle, *EQUILIBRIUM.wall_angle)
    formed = job.sheet.thickness * np.cos(held)
    stress = curve.stress(plane_strain(job.sheet.thickness, formed))
    axial = equilibrium_force(stress, formed, held, radius, step).axial
    section = SheetSection(material.young_modulus, material.poisson_ratio, job.sheet.thickness)
    law = ring_load_law(section, *radii)
    w = deflection(law, axial / contact_patch(held, radius, step).perimeter)
    return w, membrane_share(law, w)


def _tool_deflection(contour: Contour, angle: Array, step: float, curve: HardeningLaw, job: Job) -> Array:
    """(N,) m, bending of the forming tool; zero for a tool whose length is not told."""
    tool = _tool(job, contour)
    if tool.stick_out is None:
        return np.zeros(len(contour))
    held = np.clip(angle, *EQUILIBRIUM.wall_angle)
    formed = job.sheet.thickness * np.cos(held)
    stress = curve.stress(plane_strain(job.sheet.thickness, formed))
    cusp = cusp_angle(held, step, tool.ball_radius)
    radial = equilibrium_force(stress, formed, held, tool.ball_radius, step, cusp).radial
    return np.asarray(radial * tool_compliance(tool))


def tool_compliance(tool: ToolSpec) -> float:
    """m/N at the tip of a cylindrical tool of known ``stick_out``."""
    diameter = 2.0 * (tool.shank_radius or tool.radius)
    return cantilever_compliance([(tool.stick_out or 0.0, diameter)], tool.young_modulus)


def _tool(job: Job, contour: Contour) -> ToolSpec:
    return job.tool_1 if contour.forming_tool == 1 or job.tool_2 is None else job.tool_2


def _moved_angle(
    contours: Sequence[Contour], sheet: Sequence[Array], k: int, before: int, step: float, job: Job
) -> Array:
    """(N,) rad: the wall between two contours gets steeper where the later one is moved farther."""
    contour = contours[k]
    if before < 0:
        return contour.wall_angle
    other = contours[before]
    nearest = KDTree(other.contact[:, :2]).query(contour.contact[:, :2])[1]
    farther = np.abs(_axial_shift(contour, sheet[k], job)) - np.abs(_axial_shift(other, sheet[before], job))[nearest]
    slope = np.tan(np.minimum(contour.wall_angle, STEEPEST)) * np.maximum(1.0 + farther / step, 0.0)
    return np.asarray(np.minimum(np.arctan(slope), STEEPEST))


def _radii(contours: Sequence[Contour], job_file: JobFile) -> list[tuple[Array, Array]]:
    """Radius of the clamp and of the opening (N,) m for every contour's points: clamp as the circle of equal area."""
    clamp = clamp_radius(job_file)
    openings = {key: Opening.of(loop) for key, loop in _openings(contours).items()}
    result = []
    for contour in contours:
        opening = openings[contour.feature, contour.stage]
        ring = np.minimum(opening.radius_towards(contour.contact[:, :2]), clamp * (1.0 - SMALLEST_GAP))
        result.append((np.full(len(contour), clamp), ring))
    return result


def _openings(contours: Sequence[Contour]) -> dict[tuple[int, int], Array]:
    """(N, 2) m, the opening that every feature and stage is formed in: the widest contour of the stage around it.

    What is formed within a pocket, deeper in its floor or around an island, hangs in the pocket's opening: between its
    own widest contour and the clamp there is a wall, and no flat sheet.
    """
    widest = {key: _outermost(contours, key) for key in dict.fromkeys((c.feature, c.stage) for c in contours)}
    shapes = {key: shapely.Polygon(loop) for key, loop in widest.items()}
    found = {}
    for key, loop in widest.items():
        around = [one for one in widest if one[1] == key[1] and shapely.contains_xy(shapes[one], loop).all()]
        found[key] = widest[max([key, *around], key=lambda one: shapes[one].area)]
    return found


def _outermost(contours: Sequence[Contour], key: tuple[int, int]) -> Array:
    """(N, 2) m, contacts of the widest contour of a feature."""
    mine = [contour.contact[:, :2] for contour in contours if (contour.feature, contour.stage) == key]
    return max(mine, key=lambda loop: float(np.ptp(loop, axis=0).max()))


def clamp_radius(job_file: JobFile) -> float:
    """m, circle of the area that is free to deflect: the backing plate's opening, else the clamp's."""
    plate = job_file.job.backing_plate
    if plate is not None:
        return plate.round_radius
    width, height = job_file.rig.clamp.size
    return float(np.sqrt(width * height / np.pi))


def _refuse(contours: Sequence[Contour], sheet: Sequence[Array], change: Sequence[float]) -> None:
    worst = int(np.argmax(change))
    point = int(np.argmax(sheet[worst]))
    raise IsfError(
        ErrorCode.COMPENSATION_FAILED,
        f"the sheet deflection still changes by {change[worst] * 1e6:.0f} um after {MAXIMUM_PASSES} passes",
        where=f"{contour_label(worst)} at {place_text(contours[worst].contact[point])}",
        advice="reduce path.sheet_gain, or leave sheet out of path.compensation",
    )


def _remarks(contours: Sequence[Contour], found: Sequence[Deflections], job_file: JobFile) -> tuple[str, ...]:
    """One line for each compensation, and what lies outside its published range."""
    job = job_file.job
    wanted = job.path.compensation
    reported = []
    if "sheet" in wanted:
        w = np.concatenate([one.sheet for one in found])
        share = np.concatenate([one.membrane for one in found])
        reported.append(
            f"compensated: sheet deflection {_range(w)} ({w.max() / job.sheet.thickness:.1f} times the sheet, "
            f"membrane forces carry {100 * share.min():.0f} to {100 * share.max():.0f} %), {job.path.sheet_term} shift"
        )
        radii = _radii(contours, job_file)
        ratio = np.concatenate([ring / clamp for clamp, ring in radii])
        if ratio.min() < RATIO[0] or ratio.max() > RATIO[1]:
            reported.append(
                f"the sheet deflection is an extrapolation: opening over clamp is {ratio.min():.2f} to "
                f"{ratio.max():.2f}, published for {RATIO[0]:g} to {RATIO[1]:g}"
            )
    if "tool" in wanted:
        reported.append(
            f"compensated: bending of the forming tool {_range(np.concatenate([one.tool for one in found]))}"
        )
    if "machine" in wanted and job.path.machine_error:
        reported.append(
            f"compensated: machine error {_range(np.concatenate([one.machine for one in found]))}, "
            f"{job.path.machine_error_tool.replace('_', ' ').replace('support', 'support tool')} moved"
        )
        reported += machine_error.load(job_file.base / job.path.machine_error).warnings
    return tuple(reported)


def _range(values: Array) -> str:
    return f"{values.min() * 1e3:.3f} to {values.max() * 1e3:.3f} mm"
