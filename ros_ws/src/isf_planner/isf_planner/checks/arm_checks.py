"""Can the arms of a rig form this plan? Speed of the joints, distance of the links from clamp, table and each other.

That every point is within the limits of the joints and away from singular poses is said by
:func:`isf_planner.checks.part_checks.check_axes`. Links are capsules with the radii of the rig, from each joint to the
next, and the holder from the flange to the shank. The shank itself belongs to the sheet:
:mod:`isf_planner.checks.shank_checks`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from isf_core.contour import Contour, contour_label
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.arm import Arm
from isf_core.files.job import Job
from isf_core.files.rig import Rig
from isf_core.geometry.capsules import Box, segment_to_box, segment_to_segment
from isf_core.geometry.serial_arm import SerialArm
from isf_core.geometry.tool_axis import point_on_axis, tilt_of
from isf_core.types import Array, Indices

from isf_planner.checks.pace import paced
from isf_planner.part.mesh_checks import place_text

STRIP, PLATE = 50e-3, 25e-3
"""m, width of the clamping frame around the free sheet, thickness of its lower half (assumed)."""
OVERHANG = 0.35
"""m, of the table beyond the frame (assumed)."""
STICK_OUT = 80e-3
"""m, of a tool whose job does not tell (assumed)."""
POSES = 2000
"""Poses at most whose distances are looked at, evenly along the path."""


@dataclass(frozen=True)
class ArmPath:
    """What one arm does along a plan; N points.

    Attributes
    ----------
    tool : 1 or 2 ; arm : its kinematics ; tips, tilts : (N, 3) m, (N, 2) rad ; contour : (N,) index
    joints : (N, 6) rad ; margin, singular : (N,) rad, from the limits and from a singular pose
    speed : (N, 6), speeds of the joints at the feed over the largest ones
    force : (N, 3) N, predicted, of the sheet on the tool
    """

    tool: int
    arm: SerialArm
    tips: Array
    tilts: Array
    contour: Indices
    joints: Array
    margin: Array
    singular: Array
    speed: Array
    force: Array

    @property
    def give(self) -> Array:
        """(N, 3) m, by which the arm gives way under the predicted force."""
        return np.asarray((self.arm.compliance(self.joints) @ self.force[..., None])[..., 0])


@dataclass(frozen=True)
class ArmClearance:
    """Where a link comes nearest to anything: distance m, link, what it is, and the row of the :class:`ArmPath`."""

    distance: float
    link: str
    other: str
    row: int


def arm_paths(contours: Sequence[Contour], rig: Rig, ball_radius: float) -> tuple[ArmPath, ...]:
    """Of every tool that an arm carries; ``ball_radius`` m of a tilted forming tool."""
    paths = []
    for tool in (1, 2):
        arm = rig.arm(tool)
        parts = [_of_contour(contour, tool, ball_radius) for contour in contours] if arm is not None else []
        parts = [part for part in parts if part is not None]
        if arm is None or not parts:
            continue
        tips, tilts, force, index, time = (np.concatenate(one) for one in zip(*parts, strict=True))
        joints, margin, singular = arm.held(tips, tilts)
        fastest = np.array([joint.speed for joint in arm.joints])
        turned = np.abs(np.diff(joints, axis=0, append=joints[-1:]))
        speed = turned / np.maximum(time, 1e-9)[:, None] / fastest
        paths.append(ArmPath(tool, arm, tips, tilts, index, joints, margin, singular, speed, force))
    return tuple(paths)


def check_arms(contours: Sequence[Contour], job: Job, rig: Rig) -> tuple[ArmClearance, ...]:
    """The nearest that each arm comes to anything; none without arms.

    Raises
    ------
    IsfError : ARM_TOO_FAST, ARM_COLLISION with joint or link, and the place on the part
    """
    paths = arm_paths(contours, rig, job.tool_1.ball_radius)
    for path in paths:
        worst, joint = np.unravel_index(int(np.argmax(path.speed)), path.speed.shape)
        if path.speed[worst, joint] > 1.0:
            limit = path.arm.joints[joint]
            raise IsfError(
                ErrorCode.ARM_TOO_FAST,
                f"joint {limit.name} of tool {path.tool} would have to turn at "
                f"{np.degrees(path.speed[worst, joint] * limit.speed):.0f} deg/s, {np.degrees(limit.speed):.0f} deg/s "
                "are its largest",
                where=f"{contour_label(path.contour[worst])} at {place_text(path.tips[worst])}",
                advice="lower path.feed; where the speed is that of a jump, give the arm another roll",
            )
    return clearances(paths, job, rig)


def clearances(paths: Sequence[ArmPath], job: Job, rig: Rig) -> tuple[ArmClearance, ...]:
    """As :func:`check_arms`, of paths that are known."""
    found = []
    for path in paths:
        spec = _spec(rig, path.tool)
        rows = np.unique(np.linspace(0, len(path.tips) - 1, min(len(path.tips), POSES)).astype(np.int64))
        starts, ends, radii, names = capsules(path, spec, rows, _stick_out(job, path.tool))
        nearest = [
            (segment_to_box(starts, ends, box) - radii, box.name)  # (rows, links)
            for box in boxes(rig)
        ]
        for other in paths:
            if other.tool != path.tool and len(other.tips) == len(path.tips):
                far_starts, far_ends, far_radii, far_names = capsules(
                    other, _spec(rig, other.tool), rows, _stick_out(job, other.tool)
                )
                nearest += [
                    (
                        segment_to_segment(starts, ends, far_starts[:, [k]], far_ends[:, [k]]) - radii - far_radii[k],
                        f"{far_names[k]} of tool {other.tool}",
                    )
                    for k in range(len(far_names))
                ]
        distance, other_name = min(nearest, key=lambda one: float(one[0].min()))
        row, link = np.unravel_index(int(np.argmin(distance)), distance.shape)
        found.append(ArmClearance(float(distance[row, link]), names[link], other_name, int(rows[row])))
        if found[-1].distance < 0.0:
            at = found[-1].row
            raise IsfError(
                ErrorCode.ARM_COLLISION,
                f"the {names[link]} of the arm of tool {path.tool} would run {-1e3 * found[-1].distance:.0f} mm into "
                f"the {other_name}",
                where=f"{contour_label(path.contour[at])} with the tip at {place_text(path.tips[at])}",
                advice="move the base of the arm, use a longer tool (arm.tool, tool_1.stick_out), or correct the radii "
                "and sizes in the rig",
            )
    return tuple(found)


def boxes(rig: Rig) -> tuple[Box, ...]:
    """Clamping frame and table, in frame ``sheet``."""
    x, y = 0.5 * rig.clamp.size[0], 0.5 * rig.clamp.size[1]
    low, high = -PLATE, rig.clamp.height
    frame = [
        Box(
            (sign * x if sign > 0 else -x - STRIP, -y - STRIP, low),
            (x + STRIP if sign > 0 else -x, y + STRIP, high),
            "clamp",
        )
        for sign in (-1, 1)
    ]
    frame += [
        Box((-x, sign * y if sign > 0 else -y - STRIP, low), (x, y + STRIP if sign > 0 else -y, high), "clamp")
        for sign in (-1, 1)
    ]
    depths = [arm.table for arm in (rig.tool_1.arm, rig.tool_2.arm) if arm is not None and arm.table is not None]
    if depths:
        half_x, half_y = x + STRIP + OVERHANG, y + STRIP + OVERHANG
        frame.append(Box((-half_x, -half_y, -min(depths) - 0.06), (half_x, half_y, -min(depths)), "table"))
    return tuple(frame)


def capsules(path: ArmPath, spec: Arm, rows: Indices, stick_out: float) -> tuple[Array, Array, Array, tuple[str, ...]]:
    """Begin and end (R, L, 3) m, radii (L,) m and names of the links of an arm at ``rows`` of its path.

    The first link, from the base to the second joint, stands where the arm stands and is left out.
    """
    places, turns = path.arm.frames(path.joints[rows])
    tip = places[:, 7]
    along = turns[:, 5] @ path.arm.along
    shank = tip - stick_out * along
    flange = tip - spec.tool * along
    points = [*(places[:, k] for k in range(2, 6)), flange]
    starts, ends = np.stack([*points[:-1], flange], axis=1), np.stack([*points[1:], shank], axis=1)
    radii = np.array([*(joint.radius for joint in spec.joints[1:5]), spec.holder])
    names = tuple(f"link after {joint.name}" for joint in spec.joints[1:5])
    return starts, ends, radii, (*names, "tool holder")


def _spec(rig: Rig, tool: int) -> Arm:
    spec = (rig.tool_1 if tool == 1 else rig.tool_2).arm
    assert spec is not None
    return spec


def _stick_out(job: Job, tool: int) -> float:
    spec = job.tool_1 if tool == 1 else job.tool_2
    return STICK_OUT if spec is None or spec.stick_out is None else spec.stick_out


def _of_contour(contour: Contour, tool: int, ball_radius: float) -> tuple[Array, Array, Array, Array, Array] | None:
    """Points, tilts, forces, index and time s to the next point, of ``tool`` along a contour, closed ones to their
    first point again; None where the tool does nothing.

    The way to the next contour has its own speed: it takes for ever here.
    """
    forming = contour.forming_tool == tool
    tips = contour.forming_tip if forming else contour.support_tip
    if not len(tips):
        return None
    n = len(tips)
    leans = forming and contour.tilted
    tilts = tilt_of(contour.forming_axis) if leans else np.zeros((n, 2))
    points = point_on_axis(tips, contour.forming_axis, ball_radius) if leans else tips
    force = np.zeros((n, 3))
    if forming and len(contour.predicted_force):
        force[:, 2] = -contour.push_sign * contour.predicted_force
    order, time = paced(contour)
    return points[order], tilts[order], force[order], np.full(len(order), contour.index), np.append(time, np.inf)
