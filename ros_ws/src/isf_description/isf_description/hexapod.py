"""Links and joints of the hexapod that carries an upper tool (Torrao 2013, chapter 4).

The platform hangs on virtual axes: place of the tip, then the tilt of the tool about y and x. Each leg is
a branch of its own from the base plate: a universal joint, the cylinder and its rod. URDF knows no closed chains; that
rod ends and platform joints meet is what the positions of the joints see to.
"""

from __future__ import annotations

import math

import numpy as np
from isf_core.files.rig import Rig
from isf_core.geometry.hexapod import Hexapod
from isf_core.geometry.tool_axis import axis_of, point_on_axis
from isf_core.types import Array

from isf_description.axes import ALONG, linear_axis
from isf_description.tree import Body, Joint, Limits, Link, Vector

TOOL = "tool_1"
UPRIGHT = f"{TOOL}_moved_z"
"""Frame at the tip with the axes of the sheet."""

TUBE, ROD = 0.65, 0.80
"""m; lengths of a cylinder's tube and of its rod (assumed)."""


def chain(rig: Rig, sheet: str, radius: float) -> tuple[list[Link], list[Joint]]:
    """From frame ``sheet`` to the end of the tool, whose ball has ``radius`` m, with platform, base plate and legs."""
    machine = rig.hexapod.kinematics()
    links = [Link(f"{TOOL}_{name}") for name in ("moved_x", "moved_y", "moved_z", "tilted_y", "tilted_x")]
    parents = [sheet, *(link.name for link in links)]
    joints = [linear_axis(rig, TOOL, axis, parents[axis], parents[axis + 1]) for axis in range(3)]
    tilt, speed, force = machine.tilt_limit, rig.limits.speed, rig.limits.force[0]
    bounds = Limits(-tilt, tilt, speed / machine.tool_length, force * machine.tool_length)
    ball = (0.0, 0.0, radius)  # the tool turns about the centre of its ball: its lowest point is the tip as ever
    joints += [
        Joint(f"{TOOL}_tilt_y", UPRIGHT, parents[4], "revolute", ball, axis=ALONG[1], limits=bounds),
        Joint(f"{TOOL}_tilt_x", parents[4], parents[5], "revolute", axis=ALONG[0], limits=bounds),
        Joint(f"{TOOL}_fixed", parents[5], TOOL, place=(0.0, 0.0, -radius)),
    ]
    plates = [
        Link("hexapod_platform", (Body("cylinder", (_radius(machine.platform), 40e-3), "carriage", fill=0.4),)),
        Link("hexapod_base", (Body("cylinder", (_radius(machine.base), 60e-3), "frame", (0.0, 0.0, 30e-3), 0.3),)),
    ]
    x, y, z = machine.sheet
    ends = [
        Joint("hexapod_platform_fixed", TOOL, "hexapod_platform", place=(0.0, 0.0, machine.tool_length)),
        Joint("hexapod_base_fixed", sheet, "hexapod_base", place=(-x, -y, -z)),
    ]
    legs = [_leg(machine, rig, number) for number in range(1, 7)]
    return (
        [*links, *plates, *(link for leg_links, _ in legs for link in leg_links)],
        [*joints, *ends, *(joint for _, leg_joints in legs for joint in leg_joints)],
    )


def columns(rig: Rig, floor: float) -> list[Body]:
    """Four columns from the table, ``floor`` m below the sheet, to the base plate."""
    machine = rig.hexapod.kinematics()
    height = floor - machine.sheet[2]
    side = 0.8 * _radius(machine.base)
    return [
        Body("box", (0.1, 0.1, height), "frame", (x, y, 0.5 * height), 0.3)
        for x in (-side, side)
        for y in (-side, side)
    ]


def _leg(machine: Hexapod, rig: Rig, number: int) -> tuple[list[Link], list[Joint]]:
    k = f"leg_{number}"
    x, y = machine.base[number - 1].tolist()
    tube = Body("cylinder", (45e-3, TUBE), "ram", (0.0, 0.0, -0.5 * TUBE), 0.5)
    rod = Body("cylinder", (22e-3, ROD), "tool", (0.0, 0.0, 0.5 * ROD))
    links = [Link(f"{k}_cross"), Link(f"{k}_tube", (tube,)), Link(f"{k}_rod", (rod,))]
    effort, speed = rig.limits.force[2], rig.limits.speed
    # from the normal of the plate, about which the joints of the description turn
    most = machine.joint_limit + float(np.arccos(-machine.straight[:, 2]).max())
    bend = Limits(-most, most, speed / machine.shortest, effort)
    stroke, ends = Limits(0.0, machine.stroke, speed, effort), (0.0, 0.0, -machine.shortest)
    cross, tube_end, rod_end = (link.name for link in links)
    return links, [
        Joint(f"{k}_swing_x", "hexapod_base", cross, "revolute", (x, y, 0.0), axis=ALONG[0], limits=bend),
        Joint(f"{k}_swing_y", cross, tube_end, "revolute", axis=ALONG[1], limits=bend),
        Joint(f"{k}_stroke", tube_end, rod_end, "prismatic", ends, axis=(0.0, 0.0, -1.0), limits=stroke),
    ]


def leg_positions(machine: Hexapod, tip: Vector, tilt: tuple[float, float], radius: float) -> dict[str, float]:
    """Joint to position (rad, m) of all legs for a tip (m, frame ``sheet``), a tilt (rad about x and y) and the
    ``radius`` m of the tool's ball."""
    found = {}
    angles = np.array(tilt)
    point = point_on_axis(np.array(tip), axis_of(angles), radius)
    legs = machine.legs(machine.place_of(point, angles), angles)
    for number, (x, y, z) in enumerate(legs.tolist(), start=1):
        length = math.sqrt(x * x + y * y + z * z)
        found[f"leg_{number}_swing_x"] = math.atan2(y, -z)
        found[f"leg_{number}_swing_y"] = -math.asin(x / length)
        found[f"leg_{number}_stroke"] = length - machine.shortest
    return found


def _radius(corners: Array) -> float:
    """m, of the circle around a plate's joints and what holds them."""
    return float(np.linalg.norm(corners, axis=1).max()) + 0.06
