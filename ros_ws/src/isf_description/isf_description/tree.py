"""Links and joints of a machine as a tree, with the bodies that are drawn: what URDF and tf both are made from."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Literal

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
"""x, y, z, w"""

ORIGIN: Vector = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Body:
    """A solid that is drawn, its axes those of its link.

    Attributes
    ----------
    shape : what it is
    size : m; (x, y, z) of a box, (radius, length) of a cylinder along z, (radius,) of a sphere; scale of a mesh
    colour : one of :data:`isf_description.urdf.COLOURS`
    place : m, of its centre
    fill : share of it that is steel
    file : of a mesh
    """

    shape: Literal["box", "cylinder", "sphere", "mesh"]
    size: tuple[float, ...]
    colour: str
    place: Vector = ORIGIN
    fill: float = 1.0
    file: str = ""


@dataclass(frozen=True)
class Link:
    """A frame, and what moves with it."""

    name: str
    bodies: tuple[Body, ...] = ()


@dataclass(frozen=True)
class Limits:
    """Of a joint that moves: ``lowest`` and ``highest`` position (m or rad), largest ``speed`` (m/s or rad/s) and
    ``effort`` (N or N m)."""

    lowest: float = 0.0
    highest: float = 0.0
    speed: float = 0.0
    effort: float = 0.0


@dataclass(frozen=True)
class Joint:
    """How the frame ``child`` stands in that of ``parent``: displaced and turned, then moved along or about ``axis``.

    Attributes
    ----------
    place : m ; turn : rad, about the fixed axes x, y, z of the parent in this order
    """

    name: str
    parent: str
    child: str
    kind: Literal["fixed", "prismatic", "revolute"] = "fixed"
    place: Vector = ORIGIN
    turn: Vector = ORIGIN
    axis: Vector = (0.0, 0.0, 1.0)
    limits: Limits = Limits()

    @property
    def moves(self) -> bool:
        """It has a position."""
        return self.kind != "fixed"

    def transform(self, position: float = 0.0) -> tuple[Vector, Quaternion]:
        """Place (m) and orientation of the child in axes of the parent at ``position`` m or rad."""
        turn = _of_angles(self.turn)
        if self.kind == "prismatic":
            along = _turned(turn, self.axis)
            x, y, z = (a + position * b for a, b in zip(self.place, along, strict=True))
            return (x, y, z), turn
        if self.kind == "revolute":
            sine = math.sin(0.5 * position)
            spin = (sine * self.axis[0], sine * self.axis[1], sine * self.axis[2], math.cos(0.5 * position))
            return self.place, _product(turn, spin)
        return self.place, turn


@dataclass(frozen=True)
class Description:
    """The tree of one cell; ``joints`` in an order in which every parent comes before its children."""

    name: str
    links: tuple[Link, ...] = field(repr=False)
    joints: tuple[Joint, ...] = field(repr=False)

    @property
    def movable(self) -> tuple[Joint, ...]:
        """The joints that have a position."""
        return tuple(joint for joint in self.joints if joint.moves)

    @property
    def fixed(self) -> tuple[Joint, ...]:
        """The joints that have none."""
        return tuple(joint for joint in self.joints if not joint.moves)

    def prefixed(self, prefix: str) -> Description:
        """The same with ``prefix`` before the name of every link and joint."""
        links = tuple(replace(link, name=prefix + link.name) for link in self.links)
        joints = tuple(
            replace(joint, name=prefix + joint.name, parent=prefix + joint.parent, child=prefix + joint.child)
            for joint in self.joints
        )
        return replace(self, links=links, joints=joints)


def _of_angles(angles: Vector) -> Quaternion:
    """Of the turn Rz Ry Rx of ``angles`` (x, y, z) rad."""
    if angles == ORIGIN:
        return (0.0, 0.0, 0.0, 1.0)
    result = (0.0, 0.0, 0.0, 1.0)
    for axis, angle in enumerate(angles):
        spin = [0.0, 0.0, 0.0, math.cos(0.5 * angle)]
        spin[axis] = math.sin(0.5 * angle)
        result = _product((spin[0], spin[1], spin[2], spin[3]), result)
    return result


def _product(a: Quaternion, b: Quaternion) -> Quaternion:
    """The turn ``b``, then ``a``."""
    return (
        a[3] * b[0] + a[0] * b[3] + a[1] * b[2] - a[2] * b[1],
        a[3] * b[1] - a[0] * b[2] + a[1] * b[3] + a[2] * b[0],
        a[3] * b[2] + a[0] * b[1] - a[1] * b[0] + a[2] * b[3],
        a[3] * b[3] - a[0] * b[0] - a[1] * b[1] - a[2] * b[2],
    )


def _turned(turn: Quaternion, vector: Vector) -> Vector:
    if turn[3] == 1.0:
        return vector
    x, y, z, _ = _product(_product(turn, (*vector, 0.0)), (-turn[0], -turn[1], -turn[2], turn[3]))
    return (x, y, z)
