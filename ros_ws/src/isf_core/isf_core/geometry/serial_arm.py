"""A six-axis arm with a spherical wrist that carries a forming tool: kinematics, stiffness, and its free roll.

Frames: ``base`` of the arm, all of whose link frames are parallel to it when every joint is at zero (as URDF files of
industrial arms are written), and ``sheet``. The tool lies along the axis of the last joint, or at an angle to it. A
forming tool is the same from all sides, so its turn about itself, the *roll*, is free: it is chosen once for a rig,
such that joints stay far from their limits and from singular poses everywhere over the sheet, and then held. So is the
branch of the inverse kinematics: an arm that keeps both cannot flip between two contours.

The inverse is the closed form for an arm of this kind (Pieper 1968): two branches each for shoulder, elbow and wrist.
Every function takes any number of poses at once in the leading axes; m, rad, N.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from isf_core.errors import ErrorCode, IsfError
from isf_core.geometry.hexapod import rotation
from isf_core.types import Array, Mask

BRANCHES = 8
"""Shoulder front or back, elbow, wrist: 2 each."""
ROLLS = 72
"""Turns of the last link that are tried, 5 deg apart."""
_ROUNDING = 1e-9
"""rad, by which rounding may lead beyond a limit."""
_UPRIGHT = np.zeros(2)


@dataclass(frozen=True)
class ArmJoint:
    """One revolute joint.

    Attributes
    ----------
    name : of the joint ; place : (3,) m, of it in the link before, all joints at zero
    axis : 0, 1, 2 for x, y, z ; sign : 1, or -1 where the joint turns the other way
    lowest, highest : rad ; speed : rad/s, largest ; stiffness : N m/rad, of its drive as the tool feels it
    """

    name: str
    place: tuple[float, float, float]
    axis: int
    sign: int
    lowest: float
    highest: float
    speed: float
    stiffness: float

    @property
    def middle(self) -> float:
        """rad, between the limits."""
        return 0.5 * (self.lowest + self.highest)

    @property
    def span(self) -> float:
        """rad, from the middle to where the joint stops, or to where it would be written as the other half turn."""
        return min(0.5 * (self.highest - self.lowest), math.pi)


class Inverse(NamedTuple):
    """Solutions of all branches; the leading axes are those of the poses, then BRANCHES.

    Attributes
    ----------
    joints : (..., 8, 6) rad ; exists : (..., 8), the links are long enough
    margin : (..., 8) rad, of the joint that is nearest to a limit, negative beyond it
    singular : (..., 8) rad, angle of shoulder, elbow or wrist from the nearest singular pose
    """

    joints: Array
    exists: Mask
    margin: Array
    singular: Array


@dataclass(frozen=True)
class SerialArm:
    """One arm and the tool it holds.

    Attributes
    ----------
    joints : six ; flange, tool : m, from the place of the last joint to the flange, and on to the tip
    tool_angle : rad, between the axis of the last joint and the tool, which leans towards -z of the last link
    place, turn : (3,) m and (3,) rad about the fixed axes x, y, z: the base in frame ``sheet``
    tilt_limit : rad, largest tilt of the tool ; clearance : rad, least angle from a singular pose
    side : 1 above the sheet, -1 below it
    roll, branch : rad and 0..7, held while forming; see :func:`choose_posture`
    """

    joints: tuple[ArmJoint, ...]
    flange: float
    tool: float
    place: tuple[float, float, float]
    turn: tuple[float, float, float] = (0.0, 0.0, 0.0)
    tool_angle: float = 0.0
    tilt_limit: float = 0.0
    clearance: float = math.radians(5.0)
    side: int = 1
    roll: float = 0.0
    branch: int = 0
    name: str = field(default="arm", compare=False)

    @property
    def axes(self) -> tuple[str, ...]:
        """Names of the joints."""
        return tuple(joint.name for joint in self.joints)

    @property
    def tilt_lever(self) -> float:
        """m, from the tip to the wrist."""
        return self.flange + self.tool

    # -- forward -------------------------------------------------------------------------------------

    def frames(self, joints: Array) -> tuple[Array, Array]:
        """(..., 8, 3) m, places in frame ``sheet`` of the base's origin, the six joints and the tip, and (..., 6, 3, 3)
        orientations of the links, for joints (..., 6) rad."""
        joints = np.asarray(joints, dtype=np.float64)
        turned, place = self._base_turn, np.asarray(self.place, dtype=np.float64)
        places, turns = [np.broadcast_to(place, (*joints.shape[:-1], 3))], []
        for k, joint in enumerate(self.joints):
            place = place + turned @ np.array(joint.place)
            turned = turned @ _turn(joint.axis, joint.sign * joints[..., k])
            places.append(np.broadcast_to(place, (*joints.shape[:-1], 3)))
            turns.append(turned)
        places.append(place + turned @ self._reach)
        return np.stack(places, axis=-2), np.stack(turns, axis=-3)

    def forward(self, joints: Array) -> tuple[Array, Array]:
        """(..., 3) m, tips in frame ``sheet``, and (..., 3, 3), orientations of the last link."""
        places, turns = self.frames(joints)
        return places[..., -1, :], turns[..., -1, :, :]

    def jacobian(self, joints: Array) -> Array:
        """(..., 6, 6), twist of the tip in axes of ``sheet`` (m/s, then rad/s) per rate of the joints (rad/s)."""
        places, turns = self.frames(joints)
        tip = places[..., -1, :]
        columns = []
        for k, joint in enumerate(self.joints):
            along = joint.sign * turns[..., k, :, joint.axis]
            columns.append(np.concatenate([np.cross(along, tip - places[..., k + 1, :]), along], axis=-1))
        return np.stack(columns, axis=-1)

    def compliance(self, joints: Array) -> Array:
        """(..., 3, 3) m/N, way of the tip per force on it, joints giving way alone: J K^-1 J^T (Salisbury 1980).

        Links are stiff, and that the load itself changes the stiffness is left out (Dumas 2011).
        """
        along = self.jacobian(joints)[..., :3, :]
        soft = np.array([1.0 / joint.stiffness for joint in self.joints])
        return np.asarray((along * soft) @ np.swapaxes(along, -1, -2))

    def manipulability(self, joints: Array) -> Array:
        """(...) m^3, |det J| (Yoshikawa 1985); 0 in a singular pose."""
        return np.abs(np.linalg.det(self.jacobian(joints)))

    # -- inverse -------------------------------------------------------------------------------------

    def inverse(self, tips: Array, tilts: Array = _UPRIGHT, roll: Array | float | None = None) -> Inverse:
        """All branches for tips (..., 3) m, tilts (..., 2) rad and rolls (...) rad (None: the one that is held)."""
        wrist, turned = self._wrist(np.asarray(tips, dtype=np.float64), np.asarray(tilts), roll)
        one, two, three = self.joints[:3]
        upper, fore = np.array(three.place), np.array(self.joints[3].place) + np.array(self.joints[4].place)
        long, short = math.hypot(upper[0], upper[2]), math.hypot(fore[0], fore[2])
        of_upper, of_fore = math.atan2(upper[2], upper[0]), math.atan2(fore[2], fore[0])
        flat, height = np.hypot(wrist[..., 0], wrist[..., 1]), wrist[..., 2] - one.place[2] - two.place[2]
        bearing = np.arctan2(wrist[..., 1], wrist[..., 0])
        found, exists, singular = [], [], []
        for shoulder in (0, 1):
            first = bearing + shoulder * math.pi
            out = (1.0 - 2.0 * shoulder) * flat - two.place[0]
            far = np.hypot(out, height)
            with np.errstate(invalid="ignore", divide="ignore"):
                cosine = (long**2 + far**2 - short**2) / (2.0 * long * far)
                folded = (long**2 + short**2 - far**2) / (2.0 * long * short)
            fits = np.abs(cosine) <= 1.0
            bent = np.arccos(np.clip(folded, -1.0, 1.0))
            at_elbow = np.minimum(bent, math.pi - bent)
            at_shoulder = np.arcsin(np.minimum(flat / (long + short), 1.0))
            for elbow in (1.0, -1.0):
                rise = np.arctan2(height, out) + elbow * np.arccos(np.clip(cosine, -1.0, 1.0))
                dip = np.arctan2(height - long * np.sin(rise), out - long * np.cos(rise))
                second = two.sign * (of_upper - rise)
                third = three.sign * (of_fore - dip - two.sign * second)
                first_turn, arm_turn = one.sign * first, two.sign * second + three.sign * third
                inner = np.swapaxes(_turn(2, one.sign * first_turn) @ _turn(1, arm_turn), -1, -2) @ turned
                bend = np.arccos(np.clip(inner[..., 0, 0], -1.0, 1.0))
                at_wrist = np.minimum(bend, math.pi - bend)
                for wrist_sign in (1.0, -1.0):
                    last = (
                        np.arctan2(wrist_sign * inner[..., 1, 0], -wrist_sign * inner[..., 2, 0]),
                        wrist_sign * bend,
                        np.arctan2(wrist_sign * inner[..., 0, 1], wrist_sign * inner[..., 0, 2]),
                    )
                    own = [joint.sign * value for joint, value in zip(self.joints[3:], last, strict=True)]
                    found.append(np.stack([first_turn, second, third, *own], axis=-1))
                    exists.append(fits)
                    singular.append(np.minimum(np.minimum(at_shoulder, at_elbow), at_wrist))
        joints = np.stack(found, axis=-2)
        joints = self._middle + np.mod(joints - self._middle + math.pi, 2.0 * math.pi) - math.pi
        margin = (self._span - np.abs(joints - self._middle)).min(axis=-1)
        return Inverse(joints, np.stack(exists, axis=-1), margin, np.stack(singular, axis=-1))

    def held(self, tips: Array, tilts: Array = _UPRIGHT) -> tuple[Array, Array, Array]:
        """Joints (..., 6) rad, margin (...) rad and angle from a singular pose (...) rad of the branch that is held;
        margin and angle are -inf where the links are too short."""
        every = self.inverse(tips, tilts)
        k = self.branch
        none = ~every.exists[..., k]
        return (
            every.joints[..., k, :],
            np.where(none, -np.inf, every.margin[..., k]),
            np.where(none, -np.inf, every.singular[..., k]),
        )

    def reachable(self, tips: Array, tilts: Array = _UPRIGHT) -> Mask:
        """(N,), the joints make the tips (N, 3) m with the tilts (N, 2) or (2,) rad, within limits and far enough from
        singular poses."""
        tilts = np.broadcast_to(np.asarray(tilts, dtype=np.float64), (*np.shape(tips)[:-1], 2))
        _, margin, singular = self.held(tips, tilts)
        leans = np.abs(tilts).max(axis=-1) > self.tilt_limit + _ROUNDING
        return np.asarray((margin >= -_ROUNDING) & (singular >= self.clearance) & ~leans)

    def positions(self, tip: Array, tilt: Array = _UPRIGHT) -> Array:
        """(6,) rad, joints for one tip (3,) m and tilt (2,) rad.

        Raises
        ------
        IsfError : TARGET_OUT_OF_WORKSPACE with the joint, or the singular pose, that stands in the way
        """
        tilt = np.asarray(tilt, dtype=np.float64)
        if np.abs(tilt).max() > self.tilt_limit + _ROUNDING:
            raise _out(
                f"the tool would be tilted by {np.degrees(np.abs(tilt).max()):.1f} deg, "
                f"{math.degrees(self.tilt_limit):.0f} deg are allowed",
                "tilt less",
            )
        joints, margin, singular = self.held(np.asarray(tip, dtype=np.float64), tilt)
        if not np.isfinite(margin):
            places, _ = self.frames(np.zeros(6))
            far = np.linalg.norm(self._wrist(np.asarray(tip), tilt, None)[0])
            raise _out(
                f"{self.name} is too short: its wrist would be {far:.2f} m from its base "
                f"(at most {np.linalg.norm(places[5] - places[0]):.2f} m when stretched)",
                "move the base of the arm or the part",
            )
        if margin < -_ROUNDING:
            worst = int(np.argmin(self._span - np.abs(joints - self._middle)))
            joint = self.joints[worst]
            raise _out(
                f"joint {joint.name} would stand at {math.degrees(joints[worst]):.1f} deg, "
                f"{math.degrees(joint.lowest):.0f} to {math.degrees(joint.highest):.0f} deg are allowed",
                "move the base of the arm or the part, or give the arm another roll",
            )
        if singular < self.clearance:
            raise _out(
                f"{self.name} would be {math.degrees(singular):.1f} deg from a singular pose, "
                f"{math.degrees(self.clearance):.0f} deg are needed",
                "move the base of the arm or the part, or give the arm another roll",
            )
        return joints

    def tip(self, positions: Array) -> tuple[Array, Array]:
        """Tip (3,) m and tilt (2,) rad of the joints (6,) rad."""
        tip, turned = self.forward(np.asarray(positions))
        x, y, z = -self.side * (turned @ self.along)
        return tip, np.array([math.atan2(0.0 - y, math.hypot(x, z)), math.atan2(x, z)])

    # -- parts ---------------------------------------------------------------------------------------

    @cached_property
    def _base_turn(self) -> Array:
        return rotation(np.array(self.turn))

    @cached_property
    def along(self) -> Array:
        """(3,), the tool's direction from flange to tip in the last link."""
        return np.array([math.cos(self.tool_angle), 0.0, -math.sin(self.tool_angle)])

    @cached_property
    def _reach(self) -> Array:
        """(3,) m, the tip in the last link."""
        return np.array([self.flange, 0.0, 0.0]) + self.tool * self.along

    @cached_property
    def _middle(self) -> Array:
        return np.array([joint.middle for joint in self.joints])

    @cached_property
    def _span(self) -> Array:
        return np.array([joint.span for joint in self.joints])

    def _wrist(self, tips: Array, tilts: Array, roll: Array | float | None) -> tuple[Array, Array]:
        """(..., 3) m, centre of the wrist, and (..., 3, 3), orientation of the last link, both in axes of the base."""
        angle = np.asarray(self.roll if roll is None else roll, dtype=np.float64)
        upright = _turn(1, np.array(0.5 * math.pi * self.side - self.tool_angle))
        turned = rotation(tilts) @ _turn(2, angle) @ upright
        centre = tips - turned @ (self._reach + np.array(self.joints[5].place))
        return (centre - np.array(self.place)) @ self._base_turn, self._base_turn.T @ turned


def choose_posture(arm: SerialArm, region: Sequence[float], roll: float | None = None) -> SerialArm:
    """``arm`` with the roll (or the given one, rad) and the branch that stay farthest from limits and singular poses.

    ``region`` (3,) m: tips with |x|, |y|, |z| up to it are looked at, upright, and the middle tilted to every side.
    """
    grid = np.stack(np.meshgrid(*([-r, 0.0, r] for r in region), indexing="ij"), axis=-1).reshape(-1, 3)
    tilts = np.zeros((len(grid), 2))
    if arm.tilt_limit > 0.0:
        leaning = arm.tilt_limit * np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
        grid, tilts = np.vstack([grid, np.zeros((4, 3))]), np.vstack([tilts, leaning])
    rolls = np.linspace(-math.pi, math.pi, ROLLS, endpoint=False) if roll is None else np.array([roll])
    every = arm.inverse(grid[None], tilts[None], rolls[:, None])
    worth = np.where(every.exists, np.minimum(every.margin, every.singular), -1.0)
    good = (worth > 0.0).sum(axis=1)  # (R, 8), how many poses can be taken at all
    # with a tool in line with the last joint the roll moves that joint alone: then to the middle of its range
    aside = np.abs(every.joints[..., 5] - arm.joints[5].middle).mean(axis=1) / (2.0 * math.pi)
    # rounded, so that of two mirrored postures the same one is taken on every machine
    score = good + np.round(np.clip(worth.min(axis=1), -1.0, 3.0) / 4.0, 6) - 1e-4 * np.round(aside, 6)
    best, branch = np.unravel_index(int(np.argmax(score)), score.shape)
    return replace(arm, roll=float(rolls[best]), branch=int(branch))


def _turn(axis: int, angle: Array) -> Array:
    """(..., 3, 3), rotation about x, y or z by ``angle`` (...) rad."""
    cosine, sine = np.cos(angle), np.sin(angle)
    matrix = np.zeros((*np.shape(angle), 3, 3))
    i, j = (axis + 1) % 3, (axis + 2) % 3
    matrix[..., axis, axis] = 1.0
    matrix[..., i, i] = matrix[..., j, j] = cosine
    matrix[..., j, i], matrix[..., i, j] = sine, -sine
    return matrix


def _out(what: str, advice: str) -> IsfError:
    return IsfError(ErrorCode.TARGET_OUT_OF_WORKSPACE, what, where="kinematics", advice=advice)


PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
"""Entries of a symmetric matrix, in the order of :func:`compliance_field`."""
TERMS = 15
"""Of the polynomial: 1, x, y, z and their six products; the tilt about x and y and its three products."""


def compliance_field(arm: SerialArm, region: Sequence[float]) -> Array:
    """(6, TERMS), the compliance m/N over tips with coordinates up to ``region`` (3,) m as polynomials, quadratic in
    tip and tilt; for what has to know it at every tick.
    """
    grid = np.stack(np.meshgrid(*(np.linspace(-r, r, 5) for r in region), indexing="ij"), axis=-1).reshape(-1, 3)
    tilts = np.zeros((len(grid), 2))
    if arm.tilt_limit > 0.0:
        leaning = arm.tilt_limit * np.array([[x, y] for x in (-1.0, 0.0, 1.0) for y in (-1.0, 0.0, 1.0) if x or y])
        grid, tilts = np.vstack([grid, np.zeros((len(leaning), 3))]), np.vstack([tilts, leaning])
    joints, margin, _ = arm.held(grid, tilts)
    known = np.isfinite(margin)
    soft = arm.compliance(joints[known])
    values = np.stack([soft[:, i, j] for i, j in PAIRS], axis=-1)
    terms = np.array([compliance_terms(*tip, *tilt) for tip, tilt in zip(grid[known], tilts[known], strict=True)])
    return np.ascontiguousarray(np.linalg.lstsq(terms, values, rcond=None)[0].T)


def compliance_terms(x: float, y: float, z: float, about_x: float, about_y: float) -> tuple[float, ...]:
    """(TERMS,) of the polynomials of :func:`compliance_field` at a tip (m) and tilt (rad)."""
    place = (1.0, x, y, z, x * x, y * y, z * z, x * y, x * z, y * z)
    return (*place, about_x, about_y, about_x * about_x, about_y * about_y, about_x * about_y)
