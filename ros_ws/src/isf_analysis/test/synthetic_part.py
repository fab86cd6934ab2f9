"""A part as a run would record it, from closed formulas: a truncated cone with springback, 42 contours.

The shape is known exactly at every point, so that tests can compute what the metrics must give. The magnitudes are
those of the published 50 deg cone (Ren 2018, table 4.6): 5.7 mm largest error uncorrected, 1.5 mm corrected.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from isf_analysis.measures.record import PartRecord
from isf_core.contour import Contour, ContourCorrection, ContourResult, Process
from isf_core.errors import ErrorCode
from isf_core.events import Event, EventKind
from isf_core.geometry.height_map import HeightMap
from isf_core.types import Array

JOB_TEXT = """\
name: cone
part:
  mesh: cone.stl
  unit: mm
process: {process}
rig: ren2018
sheet:
  material: AA5754-O
  thickness: 1 mm
tool_1:
  radius: 5 mm
tool_2:
  radius: 5 mm
path:
  incremental_depth: 0.5 mm
  point_spacing: 2 mm
  feed: 30 mm/s
"""


@dataclass(frozen=True)
class Cone:
    """Truncated cone opening upwards: radii and depth in m, wall angle in rad, one fillet radius at rim and base."""

    base_radius: float = 18e-3
    depth: float = 21e-3
    wall_angle: float = float(np.radians(50.0))
    fillet: float = 5e-3

    def profile(self, radius: Array) -> Array:
        """z (m) at ``radius`` (m): flat base, base fillet, straight wall, rim fillet, flange at zero."""
        a, f = self.wall_angle, self.fillet
        drop = f * (1 - np.cos(a))
        r1 = self.base_radius + f * np.sin(a)  # end of the base fillet
        r2 = r1 + (self.depth - 2 * drop) / np.tan(a)  # start of the rim fillet
        r3 = self.opening_radius
        r = np.asarray(radius, dtype=float)
        z = np.zeros_like(r)
        z = np.where(r < r3, -(f - np.sqrt(np.maximum(f**2 - (r3 - r) ** 2, 0.0))), z)
        z = np.where(r < r2, -self.depth + drop + (r - r1) * np.tan(a), z)
        z = np.where(r < r1, -self.depth + f - np.sqrt(np.maximum(f**2 - (r - self.base_radius) ** 2, 0.0)), z)
        return np.where(r < self.base_radius, -self.depth, z)

    @property
    def opening_radius(self) -> float:
        """m, radius where the rim fillet meets the flange."""
        drop = self.fillet * (1 - np.cos(self.wall_angle))
        wall = (self.depth - 2 * drop) / np.tan(self.wall_angle)
        return float(self.base_radius + 2 * self.fillet * np.sin(self.wall_angle) + wall)

    def radius_at(self, depth: float) -> float:
        """m, radius of the surface at ``depth`` m below the flange."""
        radii = np.linspace(self.base_radius, self.opening_radius, 2000)
        return float(np.interp(-depth, self.profile(radii), radii))


def grid(half_width: float = 125e-3, spacing: float = 1e-3) -> tuple[Array, Array]:
    """x and y of a square height map."""
    axis = np.linspace(-half_width, half_width, round(2 * half_width / spacing) + 1)
    return axis, axis.copy()


def target_map(cone: Cone, spacing: float = 1e-3) -> HeightMap:
    """The cone as a height map."""
    x, y = grid(spacing=spacing)
    return HeightMap(x, y, cone.profile(np.hypot(*np.meshgrid(x, y))))


def formed_map(target: HeightMap, cone: Cone, springback: float, seed: int) -> HeightMap:
    """The cone lifted by ``springback`` (m) at the base, less towards the rim, with global bending and scan noise."""
    gx, gy = np.meshgrid(target.x, target.y)
    r = np.hypot(gx, gy)
    lift = springback * np.clip(1.15 - (r / cone.opening_radius) ** 2, 0.0, 1.0) * (1 + 0.06 * gx / cone.opening_radius)
    bending = -0.22 * springback * np.exp(-(((r - cone.opening_radius) / 14e-3) ** 2))
    pillow = 0.25e-3 * np.clip(1 - (r / cone.base_radius) ** 2, 0.0, 1.0)
    noise = np.random.default_rng(seed).normal(0.0, 20e-6, target.z.shape)
    return HeightMap(target.x, target.y, target.z + lift + bending + pillow + noise)


def make_part(
    *,
    correction: str = "analytic",
    support_force: float = 120.0,
    process: str = "DSIF",
    contours: int = 42,
    stop_after: int | None = None,
    seed: int = 3,
    rate: float = 500.0,
    spacing: float = 1e-3,
    points: int = 120,
) -> PartRecord:
    """A record as the in-process cell gives it; ``stop_after`` contours the force controller holds with a fault."""
    cone = Cone()
    rng = np.random.default_rng(seed)
    corrects = correction != "none"
    target = target_map(cone, spacing)
    depths = np.linspace(cone.depth / contours, cone.depth, contours)
    nominal, corrected, corrections, results = [], [], [], []
    time = 0.0
    for k, depth in enumerate(depths):
        contour = _contour(cone, k, contours, float(depth), process, support_force, points)
        share = depth / cone.depth
        predicted = 4.2e-3 * share**0.8 * (1 + 0.08 * np.cos(4 * np.linspace(0, 2 * np.pi, points, endpoint=False)))
        offset = np.zeros((points, 3))
        offset[:, 2] = -predicted if corrects else 0.0
        fault = stop_after is not None and k == stop_after
        result = _result(contour.shifted(offset), time, rate, support_force, share, rng, fault=fault)
        time = result.end + 0.4
        nominal.append(contour)
        corrected.append(contour.shifted(offset))
        corrections.append(_correction(contour, correction, offset, predicted, share, points))
        results.append(result)
        if fault:
            break
    return PartRecord(
        job_name="cone",
        job_text=JOB_TEXT.format(process=process),
        plan_id="cone-plan",
        process=process,
        correction=correction,
        support_force=support_force,
        variant=0,
        seed=seed,
        control_rate=rate,
        lockstep=True,
        software="0.1.0",
        nominal=tuple(nominal),
        corrected=tuple(corrected),
        corrections=tuple(corrections),
        results=tuple(results),
        target=target,
        scan=formed_map(target, cone, 1.3e-3 if corrects else 5.4e-3, seed),
        ticks=round(time * rate),
        late_ticks=3,
        lost_messages=0,
        sim_time=round(time, 6),
        wall_time=71.25,
        tool_compliance=((1e-6, 1e-6, 1e-7), (1e-6, 1e-6, 1e-7)),  # of rig ren2018
    )


def in_stages(part: PartRecord) -> PartRecord:
    """``part`` formed in two stages: one of the same contours 0.3 mm beside, in a sheet of 1 mm, and its own."""
    count = len(part.nominal)
    beside = np.array([0.3e-3, 0.0, 0.0])

    def after(item: Any) -> Any:
        return replace(item, index=item.index + count)

    first = [
        replace(item, contact=item.contact + beside, thickness=np.full(len(item), 1e-3), count=2 * count)
        for item in part.nominal
    ]
    last = [replace(item, index=item.index + count, count=2 * count, stage=1) for item in part.nominal]
    span = part.results[-1].end - part.results[0].start + 1.0
    return replace(
        part,
        nominal=(*first, *last),
        corrected=(*part.corrected, *map(after, part.corrected)),
        corrections=(*part.corrections, *map(after, part.corrections)),
        results=(
            *part.results,
            *(replace(after(item), start=item.start + span, end=item.end + span) for item in part.results),
        ),
    )


def make_events(part: PartRecord) -> tuple[Event, ...]:
    """Two losses of contact, one galling and the first touch of the die, on contours of ``part``."""

    def event(kind: EventKind, contour: int, share: float, value: float, limit: float, text: str) -> Event:
        result = part.results[contour]
        x, y, z = part.nominal[contour].contact[int(share * 100)]
        time = round(result.start + share * (result.end - result.start), 6)
        return Event(int(kind), time, (float(x), float(y), float(z)), value, limit, text)

    return (
        event(EventKind.DIE_CONTACT, 0, 0.1, 40.0, 0.0, "the sheet under the tool touches its support"),
        event(EventKind.CONTACT_LOST, 1, 0.3, 0.0, 10.0, "the support tool lost the sheet <b>"),
        event(EventKind.GALLING, 2, 0.5, 210.0, 155.0, "the support tool sheds chips: 210 N, limit 155 N"),
        event(EventKind.CONTACT_LOST, 3, 0.7, -3.0, 10.0, "the support tool lost the sheet again"),
    )


def _contour(
    cone: Cone, index: int, count: int, depth: float, process: str, support_force: float, points: int
) -> Contour:
    radius = cone.radius_at(depth) if depth < cone.depth else cone.base_radius
    phi = np.linspace(0, 2 * np.pi, points, endpoint=False)
    outward = np.column_stack([np.cos(phi), np.sin(phi), np.zeros(points)])
    contact = radius * outward - [0.0, 0.0, depth]
    normal = -np.sin(cone.wall_angle) * outward + [0.0, 0.0, np.cos(cone.wall_angle)]
    supported = process in ("DSIF", "ADSIF")
    forming_tip = contact + 5e-3 * normal - [0.0, 0.0, 5e-3]
    support_tip = contact - 6e-3 * normal + [0.0, 0.0, 5e-3] if supported else np.empty((0, 3))
    controlled = supported and support_force > 0
    return Contour(
        plan_id="cone-plan",
        index=index,
        count=count,
        process=Process[process],
        feed=30e-3,
        contact=contact,
        normal=normal,
        wall_angle=np.full(points, cone.wall_angle),
        thickness=np.full(points, 1e-3 * np.cos(cone.wall_angle)),
        forming_tip=forming_tip,
        support_tip=support_tip,
        support_force=np.full(points, support_force) if controlled else np.empty(0),
    )


def _correction(
    contour: Contour, method: str, offset: Array, predicted: Array, share: float, points: int
) -> ContourCorrection:
    if method == "none":
        return ContourCorrection(contour.plan_id, contour.index, "none", offset, np.empty(0))
    control = slice(None, None, max(1, points // 12))
    return ContourCorrection(
        plan_id=contour.plan_id,
        index=contour.index,
        method=method,
        offset=offset,
        springback=predicted,
        control_point=contour.contact[control],
        control_point_springback=predicted[control],
        control_point_force=np.full(len(predicted[control]), 230 + 420 * share),
        saturated=np.zeros(points, dtype=bool),
        solve_time=0.012,
    )


def _result(
    contour: Contour,
    start: float,
    rate: float,
    set_point: float,
    share: float,
    rng: np.random.Generator,
    *,
    fault: bool,
) -> ContourResult:
    n = len(contour)
    length = contour.arc_length()[-1]
    ticks = int(length / contour.feed * rate * (0.6 if fault else 1.0)) + 100
    ramp = np.clip(np.arange(ticks) / 50.0, 0.0, 1.0)
    controlled = contour.force_controlled
    wanted = set_point * ramp if controlled else np.empty(0)
    if controlled:
        force = wanted * (1 + rng.normal(0.0, 0.015, ticks)) + rng.normal(0.0, 0.9, ticks)
    elif contour.has_support:
        force = 60.0 * np.clip(1 - 1.4 * share, 0.0, 1.0) * ramp + rng.normal(0.0, 0.5, ticks)
    else:
        force = np.empty(0)
    axial = 240 + 420 * share + 15 * np.sin(4 * np.linspace(0, 2 * np.pi, n)) + rng.normal(0, 4, n)
    forming_force = np.column_stack([rng.normal(0, 60, n), rng.normal(0, 60, n), axial])
    supported = contour.has_support
    return ContourResult(
        plan_id=contour.plan_id,
        index=contour.index,
        start=round(start, 6),
        end=round(start + ticks / rate, 6),
        completed=not fault,
        forming_force=forming_force,
        support_force=np.tile([-80.0, 0.0, 20.0], (n, 1)) if supported else np.empty((0, 3)),
        forming_target=contour.forming_tip,
        support_target=contour.support_tip,
        force_offset=np.full(n, 0.12e-3) if controlled else np.empty(0),
        compliance_offset=np.zeros((n, 3)),
        tick_time=start + np.arange(ticks) / rate,
        tick_set_point=wanted,
        tick_normal_force=force,
        tick_engaged=(ramp >= 1.0) if controlled else np.zeros(ticks, dtype=bool),
        forming_measured=contour.forming_tip + 1e-6,
        support_measured=contour.support_tip,
        contact_fraction=1.0 if controlled else 0.4 if supported else 0.0,
        saturations=0,
        late_ticks=0,
        lost_messages=0,
        code=int(ErrorCode.WRENCH_NOT_FINITE) if fault else 0,
        message="wrench of tool_2 is not finite" if fault else "",
    )
