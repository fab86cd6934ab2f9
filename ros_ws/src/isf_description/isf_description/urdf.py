"""A description as URDF: links with inertia, visual and collision bodies, joints with limits."""

from __future__ import annotations

import math
from collections.abc import Iterable
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import numpy as np
from isf_core.types import Array

from isf_description.ros2_control import ControlBlock
from isf_description.tree import Body, Description, Joint, Link

STEEL = 7850.0
"""kg/m^3"""

COLOURS = {
    "frame": (0.30, 0.33, 0.38, 1.0),
    "table": (0.42, 0.45, 0.50, 1.0),
    "clamp": (0.58, 0.61, 0.65, 1.0),
    "carriage": (0.24, 0.38, 0.56, 1.0),
    "ram": (0.66, 0.69, 0.74, 1.0),
    "cell": (0.87, 0.53, 0.12, 1.0),
    "tool": (0.82, 0.84, 0.87, 1.0),
    "die": (0.55, 0.47, 0.36, 1.0),
}
"""Name to red, green, blue, opacity."""

LEAST_MASS, LEAST_INERTIA = 1e-3, 1e-6
"""kg and kg m^2 of a link that moves and has no body: simulators ask for some."""


def to_urdf(description: Description, control: ControlBlock | None = None) -> str:
    """The text of the URDF file, with the block for ros2_control where one is given; ends with a line break."""
    robot = Element("robot", name=description.name)
    moving = {joint.child for joint in description.movable}
    for link in description.links:
        _add_link(robot, link, moves=link.name in moving)
    for joint in description.joints:
        _add_joint(robot, joint)
    if control is not None:
        control.add_to(robot, description)
    ElementTree.indent(robot)
    return '<?xml version="1.0"?>\n' + ElementTree.tostring(robot, encoding="unicode") + "\n"


def _add_link(robot: Element, link: Link, *, moves: bool) -> None:
    element = SubElement(robot, "link", name=link.name)
    mass, centre, inertia = mass_properties(link.bodies)
    if mass == 0.0 and moves:
        mass, inertia = LEAST_MASS, LEAST_INERTIA * np.eye(3)
    if mass > 0.0:
        inertial = SubElement(element, "inertial")
        SubElement(inertial, "origin", xyz=_numbers(centre), rpy="0 0 0")
        SubElement(inertial, "mass", value=_number(mass))
        terms = {f"i{'xyz'[a]}{'xyz'[b]}": _number(inertia[a, b]) for a in range(3) for b in range(a, 3)}
        SubElement(inertial, "inertia", terms)
    for body in link.bodies:
        visual = SubElement(element, "visual")
        _add_shape(visual, body)
        # its colour each time: materials of the whole file have to be unique, and two cells may be put into one file
        material = SubElement(visual, "material", name=body.colour)
        SubElement(material, "color", rgba=_numbers(COLOURS[body.colour]))
    for body in link.bodies:
        _add_shape(SubElement(element, "collision"), body)


def _add_shape(element: Element, body: Body) -> None:
    SubElement(element, "origin", xyz=_numbers(body.place), rpy="0 0 0")
    geometry = SubElement(element, "geometry")
    if body.shape == "box":
        SubElement(geometry, "box", size=_numbers(body.size))
    elif body.shape == "cylinder":
        SubElement(geometry, "cylinder", radius=_number(body.size[0]), length=_number(body.size[1]))
    elif body.shape == "sphere":
        SubElement(geometry, "sphere", radius=_number(body.size[0]))
    else:
        SubElement(geometry, "mesh", filename=Path(body.file).as_uri(), scale=_numbers(body.size))


def _add_joint(robot: Element, joint: Joint) -> None:
    element = SubElement(robot, "joint", name=joint.name, type=joint.kind)
    SubElement(element, "parent", link=joint.parent)
    SubElement(element, "child", link=joint.child)
    SubElement(element, "origin", xyz=_numbers(joint.place), rpy=_numbers(joint.turn))
    if joint.moves:
        SubElement(element, "axis", xyz=_numbers(joint.axis))
        SubElement(
            element,
            "limit",
            lower=_number(joint.limits.lowest),
            upper=_number(joint.limits.highest),
            effort=_number(joint.limits.effort),
            velocity=_number(joint.limits.speed),
        )


def mass_properties(bodies: Iterable[Body]) -> tuple[float, Array, Array]:
    """Mass (kg), centre (3,) m and inertia (3, 3) kg m^2 about it of ``bodies``; meshes are left out."""
    parts = [(_mass(body), np.array(body.place), body) for body in bodies if body.shape != "mesh"]
    mass = sum(part for part, _, _ in parts)
    if mass == 0.0:
        return 0.0, np.zeros(3), np.zeros((3, 3))
    centre = sum((part * place for part, place, _ in parts), np.zeros(3)) / mass
    inertia = np.zeros((3, 3))
    for part, place, body in parts:
        arm = place - centre
        inertia += np.diag(_own_inertia(part, body)) + part * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    return mass, np.asarray(centre), inertia


def _mass(body: Body) -> float:
    if body.shape == "box":
        volume = math.prod(body.size)
    elif body.shape == "cylinder":
        volume = math.pi * body.size[0] ** 2 * body.size[1]
    else:
        volume = 4.0 / 3.0 * math.pi * body.size[0] ** 3
    return STEEL * body.fill * volume


def _own_inertia(mass: float, body: Body) -> tuple[float, float, float]:
    """kg m^2 about the body's centre; of a hollow one as if it were solid and light."""
    if body.shape == "box":
        x, y, z = (side**2 for side in body.size)
        return mass / 12.0 * (y + z), mass / 12.0 * (x + z), mass / 12.0 * (x + y)
    if body.shape == "cylinder":
        radius, length = body.size
        across = mass / 12.0 * (3.0 * radius**2 + length**2)
        return across, across, 0.5 * mass * radius**2
    ball = 0.4 * mass * body.size[0] ** 2
    return ball, ball, ball


def _number(value: float) -> str:
    return f"{value + 0.0:.12g}"  # no -0


def _numbers(values: Iterable[float]) -> str:
    return " ".join(_number(value) for value in values)
