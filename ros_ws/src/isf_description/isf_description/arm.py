"""Links and joints of a six-axis arm that carries a tool: those of the rig file, from its base to the tip.

Bodies are boxes around the links with the radii of the rig; they are drawn, not more.
"""

from __future__ import annotations

import math

import numpy as np
from isf_core.files.arm import Arm
from isf_core.files.rig import Rig
from isf_core.geometry.serial_arm import SerialArm

from isf_description.tree import Body, Joint, Limits, Link, Vector

THICK = 1.2
"""Width of a link over the radius of its capsule."""


def joint_name(tool: int, name: str) -> str:
    """In the description and the joint states, of joint ``name`` of the rig; two arms may have the same names there."""
    return f"tool_{tool}_{name}"


def chain(rig: Rig, tool: int, sheet: str) -> tuple[list[Link], list[Joint]]:
    """From frame ``sheet`` to ``tool_k``, which has the axes of the sheet while the tool is upright."""
    spec, arm = _of(rig, tool)
    k = f"tool_{tool}"
    links, joints = [Link(f"{k}_base", _bodies(spec.joints[0].place, spec.joints[0].radius))], []
    joints.append(Joint(f"{k}_base_fixed", sheet, f"{k}_base", place=spec.base, turn=spec.base_turn))
    ends = [*(joint.place for joint in spec.joints[1:]), (spec.flange, 0.0, 0.0)]
    for number, (joint, made, end) in enumerate(zip(spec.joints, arm.joints, ends, strict=True), start=1):
        axis = [0.0, 0.0, 0.0]
        axis[made.axis] = float(made.sign)
        name = f"{k}_link_{number}"
        effort = rig.limits.force[2] * float(np.linalg.norm(arm.frames(np.zeros(6))[0][7] - np.array(arm.place)))
        joints.append(
            Joint(
                joint_name(tool, joint.name),
                links[-1].name,
                name,
                "revolute",
                joint.place,
                axis=(axis[0], axis[1], axis[2]),
                limits=Limits(joint.range[0], joint.range[1], joint.speed, effort),
            )
        )
        links.append(Link(name, _bodies(end, min(joint.radius, 0.15) if number > 1 else joint.radius)))
    reach = arm.along * spec.tool + np.array([spec.flange, 0.0, 0.0])
    holder = float(np.linalg.norm(reach)) - 0.1
    links.append(
        Link(
            f"{k}_mount",
            (Body("cylinder", (spec.holder, max(holder, 0.02)), "ram", (0.0, 0.0, arm.side * 0.5 * (0.2 + holder))),),
        )
    )
    lean = 0.5 * math.pi * arm.side - arm.tool_angle
    x, y, z = reach.tolist()
    joints.append(Joint(f"{k}_mounted", links[-2].name, f"{k}_mount", place=(x, y, z), turn=(0.0, -lean, 0.0)))
    joints.append(Joint(f"{k}_fixed", f"{k}_mount", k, turn=(0.0, 0.0, -arm.roll)))
    return links, joints


def _of(rig: Rig, tool: int) -> tuple[Arm, SerialArm]:
    spec, arm = (rig.tool_1 if tool == 1 else rig.tool_2).arm, rig.arm(tool)
    assert spec is not None
    assert arm is not None
    return spec, arm


def _bodies(end: Vector, radius: float) -> tuple[Body, ...]:
    """A box from the origin of a link to its ``end`` (3,) m."""
    x, y, z = (abs(value) + THICK * radius for value in end)
    return (Body("box", (x, y, z), "carriage", (0.5 * end[0], 0.5 * end[1], 0.5 * end[2]), 0.3),)
