"""A contour: the unit of exchange between planning, correction, execution and result.

Same arrays, same names and same order as ``isf_msgs/msg/Contour``. A contour over a floor is flat, at the level that
the contour before has reached.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from enum import IntEnum

import numpy as np

from isf_core.errors import ErrorCode, IsfError
from isf_core.geometry.tool_axis import UNIT_TOLERANCE
from isf_core.types import Array, Mask, Points, Stamp


class Process(IntEnum):
    """Process variants (Ren 2018, section 1.1); values as in ``isf_msgs/msg/Contour``."""

    SPIF = 1
    TPIF = 2
    DSIF = 3
    ADSIF = 4


def _empty() -> Array:
    return np.empty(0)


def _empty3() -> Array:
    return np.empty((0, 3))


def contour_label(index: int) -> str:
    """What people read of the contour ``index`` (from 0, as in messages): counted from 1, as in reports."""
    return f"contour {index + 1}"


STANDS_STILL = 1.0e-4
"""m in the plane that a support tool moves at most while it waits: what compensations leave it."""


@dataclass(frozen=True)
class Contour:
    """One closed (or open) path of the tools at one level, N points.

    Attributes
    ----------
    plan_id : identifies the plan this contour belongs to
    index, count : position in the plan (0-based) and number of contours in it
    feature, stage : feature number and forming stage, 0 for a single one
    process : Process
    forming_tool : 1 (upper) or 2 (lower)
    closed : the last point is followed by the first
    feed : m/s along the forming tip path
    contact : (N, 3) m, contact points of the forming tool on the sheet surface it touches
    normal : (N, 3) unit, out of the sheet towards the forming tool
    wall_angle : (N,) rad from the horizontal
    thickness : (N,) m, predicted thickness of the formed sheet
    forming_tip : (N, 3) m, tip of the forming tool (lowest point of an upper tool)
    support_tip : (N, 3) m, tip of the support tool (highest point of a lower tool), or (0, 3)
    support_force : (N,) N, set-point of the horizontal normal force on the support tool
        (Ren 2018 eq. 2-3), or (0,) for position control
    speed : (N,) m/s, largest speed of the forming tip at each point, or (0,) for ``feed`` everywhere
    predicted_force : (N,) N, axial force on the forming tool that the planner expects, or (0,)
    forming_axis : (N, 3) unit, from the tip of the forming tool into its shank, or (0, 3) for an upright tool; the
        support tool is upright (:mod:`isf_core.geometry.tool_axis`)
    retract : both tools are lifted clear and travel above and below the sheet to the first point
    lift_after : both tools are lifted clear after the last point, to park height, before the contour counts as formed
    floor_passes : the floor that this wall ends in is passed over after it, or this is such a pass
    holder_height : m, blank holder over its starting height while this contour is formed (TPIF), 0 at rest
    """

    plan_id: str
    index: int
    count: int
    process: Process
    feed: float
    contact: Points
    normal: Points
    wall_angle: Array
    thickness: Array
    forming_tip: Points
    support_tip: Points = field(default_factory=_empty3)
    support_force: Array = field(default_factory=_empty)
    speed: Array = field(default_factory=_empty)
    predicted_force: Array = field(default_factory=_empty)
    forming_axis: Points = field(default_factory=_empty3)
    forming_tool: int = 1
    closed: bool = True
    retract: bool = False
    lift_after: bool = False
    floor_passes: bool = False
    holder_height: float = 0.0
    feature: int = 0
    stage: int = 0

    def __len__(self) -> int:
        return len(self.forming_tip)

    @property
    def has_support(self) -> bool:
        """True when the contour moves a support tool."""
        return len(self.support_tip) > 0

    @property
    def support_waits(self) -> bool:
        """True when the support tool stands still below the sheet while the other one forms."""
        tip = self.support_tip[:, :2]
        return len(tip) > 1 and bool(np.all(np.ptp(tip, axis=0) < STANDS_STILL))

    @property
    def force_controlled(self) -> bool:
        """True when the support tool follows a force set-point."""
        return len(self.support_force) > 0

    @property
    def tilted(self) -> bool:
        """True when the axis of the forming tool is given: it is not upright everywhere."""
        return len(self.forming_axis) > 0

    def validate(self) -> Contour:
        """Return self, or raise IsfError CONTOUR_REJECTED that names the field at fault."""
        n = len(self.forming_tip)
        shapes = {
            "contact": (n, 3),
            "normal": (n, 3),
            "wall_angle": (n,),
            "thickness": (n,),
            "forming_tip": (n, 3),
        }
        optional = {
            "support_tip": (n, 3),
            "support_force": (n,),
            "speed": (n,),
            "predicted_force": (n,),
            "forming_axis": (n, 3),
        }
        where = f"{contour_label(self.index)} of {self.plan_id or '(no plan)'}"
        if n < 3:
            raise IsfError(ErrorCode.CONTOUR_REJECTED, f"has {n} points, needs 3 or more", where=where)
        if self.forming_tool not in (1, 2):
            raise IsfError(
                ErrorCode.CONTOUR_REJECTED, f"forming_tool is {self.forming_tool}, must be 1 or 2", where=where
            )
        if not (np.isfinite(self.feed) and self.feed > 0):
            raise IsfError(ErrorCode.CONTOUR_REJECTED, f"feed is {self.feed} m/s, must be positive", where=where)
        if not np.isfinite(self.holder_height):
            raise IsfError(ErrorCode.CONTOUR_REJECTED, "holder_height is not finite", where=where)
        if len(self.speed) and not (self.speed > 0).all():
            raise IsfError(ErrorCode.CONTOUR_REJECTED, "speed must be positive at every point", where=where)
        for name, shape in {**shapes, **optional}.items():
            array = getattr(self, name)
            if name in optional and len(array) == 0:
                continue
            if array.shape != shape:
                raise IsfError(
                    ErrorCode.CONTOUR_REJECTED, f"{name} has shape {array.shape}, expected {shape}", where=where
                )
            if not np.isfinite(array).all():
                bad = int(np.argmax(~np.isfinite(array).reshape(n, -1).all(axis=1)))
                raise IsfError(ErrorCode.CONTOUR_REJECTED, f"{name} is not finite at point {bad}", where=where)
        if self.tilted:
            self._check_axis(where)
        return self

    def _check_axis(self, where: str) -> None:
        """Raise CONTOUR_REJECTED unless ``forming_axis`` holds unit vectors that leave the sheet on the tool's side."""
        axis = self.forming_axis
        length = np.linalg.norm(axis, axis=1)
        leaves = np.minimum(-self.push_sign * axis[:, 2], (axis * self.normal).sum(axis=1))
        for bad, what in (
            (np.abs(length - 1.0) > UNIT_TOLERANCE, "is no unit vector"),
            (leaves <= 0.0, "points through the sheet"),
        ):
            if bad.any():
                worst = int(np.argmax(bad))
                x, y, z = axis[worst]
                raise IsfError(
                    ErrorCode.CONTOUR_REJECTED,
                    f"forming_axis ({x:.4f}, {y:.4f}, {z:.4f}) at point {worst} {what}",
                    where=where,
                    advice="it points from the tip into the shank: +z for an upright upper tool, -z for a lower one",
                )

    @property
    def push_sign(self) -> float:
        """z component of the push direction of the forming tool: -1 for the upper tool, +1 for the lower one."""
        return -1.0 if self.forming_tool == 1 else 1.0

    def shifted(self, offset: Array, *, support: bool = True) -> Contour:
        """Contact and both tips moved by ``offset`` (N, 3) m: gap, normals and angles stay.

        Without ``support`` the tip of the support tool stays, and the gap does not. A lower tool that waits goes on
        standing still, deeper by what the other one is pushed down at most.
        """
        tip = self.support_tip
        if support and self.support_waits:
            tip = tip + np.array([0.0, 0.0, min(float(offset[:, 2].min()), 0.0)])
        elif support and self.has_support:
            tip = tip + offset
        return replace(self, contact=self.contact + offset, forming_tip=self.forming_tip + offset, support_tip=tip)

    def arc_length(self) -> Array:
        """(N,) m, distance along the forming tip path from the first point."""
        steps = np.linalg.norm(np.diff(self.forming_tip, axis=0), axis=1)
        return np.concatenate([[0.0], np.cumsum(steps)])

    @property
    def length(self) -> float:
        """m, of the whole path of the forming tip, of a closed contour back to its first point."""
        closing = float(np.linalg.norm(self.forming_tip[0] - self.forming_tip[-1])) if self.closed else 0.0
        return float(self.arc_length()[-1]) + closing


@dataclass(frozen=True)
class ContourCorrection:
    """What the springback node did to one contour, N points, M control points.

    Attributes
    ----------
    plan_id, index : the contour
    method : name of the method ("none" when nothing was corrected)
    offset : (N, 3) m, added to contact and both tips; with ``path.support: on_blank`` not to the support tool's
    springback : (N,) m, predicted elastic recovery along +z of an upward springback
    control_point : (M, 3) m, where the model was evaluated
    control_point_springback : (M,) m, prediction there
    control_point_force : (M,) N, forecast axial force used there
    saturated : (N,) bool, a limit (gradient, magnitude) changed the point
    code, message : ErrorCode value (0 = ok) and its text
    solve_time : s of wall time
    uncertainty : (N,) m, standard deviation of the predicted springback, or (0,)
    residual : (N,) m, error along +z that will remain as far as the method can tell, or (0,)
    remarks : what cannot be corrected on this contour, where and why
    """

    plan_id: str
    index: int
    method: str
    offset: Points
    springback: Array
    control_point: Points = field(default_factory=_empty3)
    control_point_springback: Array = field(default_factory=_empty)
    control_point_force: Array = field(default_factory=_empty)
    saturated: Mask = field(default_factory=lambda: np.empty(0, dtype=bool))
    code: int = 0
    message: str = ""
    solve_time: float = 0.0
    uncertainty: Array = field(default_factory=_empty)
    residual: Array = field(default_factory=_empty)
    remarks: tuple[str, ...] = ()


@dataclass(frozen=True)
class ContourResult:
    """What happened while one contour was formed: N contour points, T control ticks.

    Attributes
    ----------
    plan_id, index : the contour
    start, end : s, time of the first and last tick (simulation or wall clock)
    completed : every point was reached
    code, message : ErrorCode value (0 = ok) and its text: why not completed, or of a completed contour a warning
    forming_force, support_force : (N, 3) N, force of the sheet on each tool at the points
    forming_target, support_target : (N, 3) m, streamed tips at the points, all offsets included
    forming_measured, support_measured : (N, 3) m from the machine's pose topics, (0, 3) when not published
    force_offset : (N,) m, offset of the support tool along the horizontal normal (towards the sheet positive)
    compliance_offset : (N, 3) m, offset of the forming tool
    contact_fraction : fraction of the engaged ticks with the support force above the contact threshold
    saturations : ticks in which a limiter of the force loop was active
    backoffs : times the gain was lowered because the force loop oscillated
    late_ticks, lost_messages : counted by the control node
    tick_time : (T,) s ; tick_set_point, tick_normal_force : (T,) N ; tick_engaged : (T,) bool
    """

    plan_id: str
    index: int
    start: Stamp
    end: Stamp
    completed: bool
    forming_force: Points
    support_force: Points
    forming_target: Points
    support_target: Points
    force_offset: Array
    compliance_offset: Points
    tick_time: Array
    tick_set_point: Array
    tick_normal_force: Array
    tick_engaged: Mask
    forming_measured: Points = field(default_factory=_empty3)
    support_measured: Points = field(default_factory=_empty3)
    contact_fraction: float = 0.0
    saturations: int = 0
    backoffs: int = 0
    late_ticks: int = 0
    lost_messages: int = 0
    code: int = 0
    message: str = ""


FLAT = np.radians(1.0)
"""rad, wall angle of what is floor."""
SAME_LEVEL = 20e-6
"""m between the tips of a pass over the floor and of the contour before it."""


def makes_floor(contour: Contour) -> bool:
    """True when all points of ``contour`` lie on a floor."""
    return bool(contour.wall_angle.max() <= FLAT)


def over_floor(contour: Contour, before: Contour | None) -> bool:
    """True when ``contour`` passes over the floor that the contour ``before`` it has reached, both as planned."""
    if before is None or (before.plan_id, before.feature, before.stage, before.forming_tool) != (
        contour.plan_id,
        contour.feature,
        contour.stage,
        contour.forming_tool,
    ):
        return False
    level = abs(float(contour.forming_tip[:, 2].mean() - before.forming_tip[:, 2].mean()))
    return level <= SAME_LEVEL and makes_floor(contour)


def passes_over_floors(contours: Sequence[Contour]) -> list[Contour]:
    """Those of the planned ``contours``, in order, that pass over a floor which the one before has reached."""
    return [contour for before, contour in itertools.pairwise(contours) if over_floor(contour, before)]


def with_floor_passes(contours: Sequence[Contour]) -> tuple[Contour, ...]:
    """The ``contours`` of a plan with ``floor_passes`` by what follows their walls: old plan files and bags lack it."""
    passed = {(one.feature, one.stage, one.forming_tool) for one in passes_over_floors(contours)}
    return tuple(
        replace(one, floor_passes=(one.feature, one.stage, one.forming_tool) in passed) if passed else one
        for one in contours
    )
