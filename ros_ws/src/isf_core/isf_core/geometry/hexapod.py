"""The hexapod of the SPIF-A machine: six cylinders between a base and a moving platform (Torrao 2013, chapter 4).

Poses are those of the platform's origin in the base's frame, unless a function says tip: ``place`` (..., 3) m and
``angles`` (..., 2) rad about x, then y, or (..., 3) with the roll about z last (the source calls them yaw, pitch, roll;
the machine allows no roll). Every function takes any number of poses at once in the leading axes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from isf_core.errors import ErrorCode, IsfError
from isf_core.types import Array, Mask

if TYPE_CHECKING:
    from isf_core.geometry.hexapod_kernels import Plates

_STEPS = 1e-9
"""m, beyond a limit that rounding may lie."""


def _semi_regular_hexagon(long_edge: float, short_edge: float, *, short_first: bool) -> Array:
    """(6, 2) m, corners of a hexagon with alternating edges, in the order of the legs (Torrao 2013, 4.2)."""
    slope = np.tan(np.pi / 6)
    outer = (long_edge / 2 + short_edge) * slope
    middle = (short_edge / 2 + long_edge) * slope
    inner = (long_edge - short_edge) / 2 * slope
    if short_first:  # the short edge stands at -x
        corners = [(-middle, -short_edge / 2), (inner, (long_edge + short_edge) / 2), (outer, long_edge / 2)]
    else:  # the long edge stands at -x
        corners = [(-outer, -long_edge / 2), (-inner, (long_edge + short_edge) / 2), (middle, short_edge / 2)]
    first, third, fourth = corners
    mirror = np.array([1.0, -1.0])
    return np.array(
        [first, mirror * np.array(first), third, fourth, mirror * np.array(fourth), mirror * np.array(third)]
    )


@dataclass(frozen=True)
class ForwardPose:
    """What :meth:`Hexapod.forward` found, with the leading axes of its lengths.

    Attributes
    ----------
    place : (..., 3) m ; tilt : (..., 2) rad ; iterations : of the slowest pose ; converged : (...)
    """

    place: Array
    tilt: Array
    iterations: int
    converged: Mask


@dataclass(frozen=True)
class Hexapod:
    """Six cylinders between a fixed base (above) and a platform that carries an upper tool pointing down.

    Attributes
    ----------
    base, platform : (6, 2) m, joints in their plates' planes (published: edges 600/200 and 300/150 mm)
    shortest, stroke : m, cylinder between joints when retracted, and its stroke (published: 942, 400 mm)
    tool_length : m, platform plane to tip (published: 338 mm + tool; here the tool of 100 mm)
    sheet : (3,) m, origin of frame ``sheet`` in the base's frame (assumed: the table's height is a set-up value)
    tilt_limit : rad (published: 30 deg about x and y) ; reach : m, of the platform in x and y (published: 500 mm)
    joint_limit : rad, between a cylinder and the way in which its joints are straight (published: universal joints of
        45 deg)
    along_normals : they are straight along the normals of both plates; else along the cylinders of the upright
        platform in mid-stroke (assumed: where they are is not published)
    """

    base: Array
    platform: Array
    shortest: float = 0.942
    stroke: float = 0.400
    tool_length: float = 0.438
    sheet: tuple[float, float, float] = (0.0, 0.0, -1.475)
    tilt_limit: float = float(np.radians(30.0))
    reach: float = 0.5
    joint_limit: float = float(np.radians(45.0))
    along_normals: bool = False

    @property
    def axes(self) -> tuple[str, ...]:
        """Names of the cylinders."""
        return tuple(f"L{k}" for k in range(1, 7))

    @property
    def tilt_lever(self) -> float:
        """m, from the tip to the joints of the platform."""
        return float(np.hypot(self.tool_length, _norm(self.platform).max()))

    @cached_property
    def straight(self) -> Array:
        """(6, 3), unit: along which the cylinders' joints are straight, the same in the frames of both plates."""
        if self.along_normals:
            return np.tile([0.0, 0.0, -1.0], (6, 1))
        middle = self.shortest + 0.5 * self.stroke
        return self.legs(np.array([0.0, 0.0, -np.sqrt(middle**2 - self._offset_squared())]), np.zeros(2)) / middle

    def legs(self, place: Array, angles: Array) -> Array:
        """(..., 6, 3) m, from the joints of the base to those of the platform (Torrao 2013, eq. 4.17)."""
        return self._arms(angles) + np.asarray(place)[..., None, :] - _in_plane(self.base)

    def lengths(self, place: Array, angles: Array) -> Array:
        """(..., 6) m, distances between joints (Torrao 2013, eq. 4.24)."""
        return _norm(self.legs(place, angles))

    def jacobian(self, place: Array, angles: Array) -> Array:
        """(..., 6, 6), rates of the cylinders per twist of the platform (m/s, rad/s; base axes), Torrao 2013, 4.3.1.

        Columns: velocity of the platform's origin, angular velocity.
        """
        arms = self._arms(angles)
        legs = arms + np.asarray(place)[..., None, :] - _in_plane(self.base)
        along = legs / _norm(legs)[..., None]
        return np.concatenate([along, _cross(arms, along)], axis=-1)

    def pose_jacobian(self, place: Array, angles: Array) -> Array:
        """(..., 6, 6), rates of the cylinders per rate of (x, y, z, angles about x, y, z): Torrao 2013, eq. 4.41, with
        the columns in the order of the pose."""
        plain = self.jacobian(place, angles)
        return np.concatenate([plain[..., :3], plain[..., 3:] @ spin_of_angles(angles)], axis=-1)

    def place_of(self, tip: Array, tilt: Array) -> Array:
        """(..., 3) m, platform for tips (..., 3) m in frame ``sheet``: orientation turns about the tip."""
        return np.asarray(tip) + np.array(self.sheet) + self.tool_length * rotation(tilt)[..., :, 2]

    def tip_of(self, place: Array, tilt: Array) -> Array:
        """(..., 3) m, tips in frame ``sheet``."""
        return np.asarray(place) - np.array(self.sheet) - self.tool_length * rotation(tilt)[..., :, 2]

    def strokes(self, tip: Array, tilt: Array) -> Array:
        """(..., 6) m, of the cylinders, limits not looked at."""
        return self.lengths(self.place_of(tip, tilt), tilt) - self.shortest

    def joint_angles(self, place: Array, tilt: Array) -> Array:
        """(..., 12) rad, by which the joints of the cylinders at the base bend (six), then those at the platform."""
        legs = self.legs(place, tilt)
        along = legs / _norm(legs)[..., None]
        at_platform = (along * (self.straight @ np.swapaxes(rotation(tilt), -1, -2))).sum(axis=-1)
        cosines = np.concatenate([(along * self.straight).sum(axis=-1), at_platform], axis=-1)
        return np.asarray(np.arccos(np.clip(cosines, -1.0, 1.0)))

    def reachable(self, tips: Array, tilts: Array = np.zeros(2)) -> Mask:  # noqa: B008 - never written to
        """(N,), cylinders, joints, tilt and reach allow the tips (N, 3) m with the tilts (N, 2) or (2,) rad."""
        tilts = np.broadcast_to(np.asarray(tilts, dtype=np.float64), (*np.shape(tips)[:-1], 2))
        place = self.place_of(tips, tilts)
        legs = self.legs(place, tilts)
        lengths = _norm(legs)
        strokes = lengths - self.shortest
        fits = (strokes >= -_STEPS).all(axis=-1) & (strokes <= self.stroke + _STEPS).all(axis=-1)
        fits &= (np.abs(place[..., :2]) <= self.reach).all(axis=-1) & (np.abs(tilts) <= self.tilt_limit).all(axis=-1)
        at_platform = (legs * (self.straight @ np.swapaxes(rotation(tilts), -1, -2))).sum(axis=-1)
        least = np.cos(self.joint_limit) * lengths
        return np.asarray(fits & (np.minimum((legs * self.straight).sum(axis=-1), at_platform) >= least).all(axis=-1))

    def positions(self, tip: Array, tilt: Array = np.zeros(2)) -> Array:  # noqa: B008 - never written to
        """(6,) m, strokes of the cylinders (0 retracted) for one tip (3,) m and tilt (2,) rad.

        Raises
        ------
        IsfError : TARGET_OUT_OF_WORKSPACE with what stands in the way
        """
        from isf_core.geometry.hexapod_kernels import strokes_of

        tip, tilt, strokes = np.array(tip, dtype=np.float64), np.array(tilt, dtype=np.float64), np.empty(6)
        x, y, straightest = strokes_of(tip, tilt, self._plates, strokes)
        if max(abs(x), abs(y)) > self.reach or max(abs(tilt[0]), abs(tilt[1])) > self.tilt_limit:
            raise IsfError(
                ErrorCode.TARGET_OUT_OF_WORKSPACE, "the platform would leave its reach or tilt", where="kinematics"
            )
        each = strokes.tolist()
        if min(each) < -_STEPS or max(each) > self.stroke + _STEPS:
            worst = int(np.argmax(np.maximum(-strokes, strokes - self.stroke)))
            raise IsfError(
                ErrorCode.TARGET_OUT_OF_WORKSPACE,
                f"cylinder {worst + 1} would have a stroke of {1e3 * strokes[worst]:.1f} mm, "
                f"0 to {1e3 * self.stroke:.0f} mm is available",
                where="kinematics",
                advice="move the part or the table",
            )
        if straightest < math.cos(self.joint_limit):
            bent = self.joint_angles(self.place_of(tip, tilt), tilt)
            worst = int(np.argmax(bent))
            raise IsfError(
                ErrorCode.TARGET_OUT_OF_WORKSPACE,
                f"the {'base' if worst < 6 else 'platform'} joint of cylinder {worst % 6 + 1} would bend by "
                f"{np.degrees(bent[worst]):.1f} deg, {np.degrees(self.joint_limit):.0f} deg is available",
                where="kinematics",
                advice="tilt less, or move the part or the table",
            )
        return strokes

    def forward(self, lengths: Array, place: Array | None = None, tilt: Array | None = None) -> ForwardPose:
        """Poses without roll that have the ``lengths`` (..., 6) m, by Newton's method (Torrao 2013, 4.3.1, corrected).

        ``place``, ``tilt``: where to begin (the last pose known); None: on the centre line, upright.
        """
        from isf_core.geometry.hexapod_kernels import find_poses

        lengths = np.array(lengths, dtype=np.float64, order="C")
        lead = lengths.shape[:-1]
        pose = np.zeros((*lead, 5))
        if place is None:
            pose[..., 2] = -np.sqrt(np.maximum(lengths.mean(axis=-1) ** 2 - self._offset_squared(), 1e-6))
        else:
            pose[..., :3] = place
        if tilt is not None:
            pose[..., 3:] = tilt
        fits = np.empty(lead, dtype=np.bool_)
        used = find_poses(lengths.reshape(-1, 6), self._plates, pose.reshape(-1, 5), fits.reshape(-1))
        return ForwardPose(pose[..., :3], pose[..., 3:], used, fits)

    def tip(self, positions: Array) -> tuple[Array, Array]:
        """Tip (3,) m and tilt (2,) rad of the strokes (6,) m; raises TARGET_OUT_OF_WORKSPACE."""
        found = self.forward(np.asarray(positions) + self.shortest)
        if not bool(found.converged):
            raise IsfError(
                ErrorCode.TARGET_OUT_OF_WORKSPACE, "no pose without spin has these cylinder lengths", where="kinematics"
            )
        tip = self.tip_of(found.place, found.tilt)
        try:
            self.positions(tip, found.tilt)
        except IsfError as error:  # also the pose mirrored at the base, above it
            raise IsfError(
                ErrorCode.TARGET_OUT_OF_WORKSPACE, "the pose found is out of the platform's reach", where="kinematics"
            ) from error
        return tip, found.tilt

    def leg_forces(self, force: Array, tip: Array, tilt: Array) -> Array:
        """(..., 6) N, with which the cylinders push (pull: negative) against ``force`` (..., 3) N of the sheet on the
        tip (..., 3) m in frame ``sheet`` (Torrao 2013, eq. 8.1); weights are left out."""
        arm = -self.tool_length * rotation(tilt)[..., :, 2]
        force = np.broadcast_to(np.asarray(force, dtype=np.float64), arm.shape)
        wrench = np.concatenate([force, _cross(arm, force)], axis=-1)
        jacobian = self.jacobian(self.place_of(tip, tilt), tilt)
        return np.asarray(-np.linalg.solve(np.swapaxes(jacobian, -1, -2), wrench[..., None])[..., 0])

    @cached_property
    def _plates(self) -> Plates:
        """What the kernels take."""
        from isf_core.geometry.hexapod_kernels import Plates  # needs numba, which most programs with a rig do not

        base, platform, straight, sheet = (
            np.array(corners, dtype=np.float64, order="C")
            for corners in (self.base, self.platform, self.straight, self.sheet)
        )
        return Plates(base, platform, straight, sheet, float(self.tool_length), float(self.shortest))

    def _arms(self, angles: Array) -> Array:
        """(..., 6, 3) m, joints of the platform from its origin, base axes."""
        return self.platform @ np.swapaxes(rotation(angles)[..., :2], -1, -2)

    def _offset_squared(self) -> float:
        """m^2, mean squared horizontal offset of the cylinders on the centre line."""
        return float(((self.platform - self.base) ** 2).sum(axis=1).mean())


@dataclass(frozen=True)
class CableSensors:
    """Three cables from the base to the platform's centre: its place without the cylinders (Torrao 2013, 4.3.3).

    Attributes
    ----------
    a, b, c : m, the cables begin at (0, 0), (0, c) and (a, b) of their frame (no layout is published)
    origin : (3,) m, of that frame in the base's frame
    """

    a: float
    b: float
    c: float
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def lengths(self, place: Array) -> Array:
        """(..., 3) m of the cables."""
        starts = np.array([[0.0, 0.0, 0.0], [0.0, self.c, 0.0], [self.a, self.b, 0.0]]) + np.array(self.origin)
        return _norm(np.asarray(place)[..., None, :] - starts)

    def place(self, lengths: Array) -> Array:
        """(..., 3) m, below the base; NaN where the cables do not meet (Torrao 2013, eq. 4.43-4.45, corrected)."""
        first, second, third = np.moveaxis(np.asarray(lengths, dtype=np.float64), -1, 0)
        y = (self.c**2 + first**2 - second**2) / (2.0 * self.c)
        x = (self.a**2 + self.b**2 + first**2 - third**2 - 2.0 * self.b * y) / (2.0 * self.a)
        with np.errstate(invalid="ignore"):
            z = -np.sqrt(first**2 - x**2 - y**2)
        return np.stack([x, y, z], axis=-1) + np.array(self.origin)

    def disagreement(self, place: Array, lengths: Array) -> Array:
        """(...) m, distance between the ``place`` (..., 3) m that the cylinders tell and that of the cables.

        A cylinder's transducer that is off shows here and not in the cylinders alone. NaN: the cables do not meet.
        """
        return _norm(np.asarray(place) - self.place(lengths))


def rotation(angles: Array) -> Array:
    """(..., 3, 3) Rz Ry Rx of ``angles`` (..., 2) or (..., 3) rad about x, y and z (Torrao 2013, eq. 4.22)."""
    angles = np.asarray(angles, dtype=np.float64)
    cosine, sine = np.cos(angles), np.sin(angles)
    cx, cy, sx, sy = cosine[..., 0], cosine[..., 1], sine[..., 0], sine[..., 1]
    matrix = np.empty((*angles.shape[:-1], 3, 3))
    matrix[..., 0, 0], matrix[..., 0, 1], matrix[..., 0, 2] = cy, sy * sx, sy * cx
    matrix[..., 1, 0], matrix[..., 1, 1], matrix[..., 1, 2] = 0.0, cx, -sx
    matrix[..., 2, 0], matrix[..., 2, 1], matrix[..., 2, 2] = -sy, cy * sx, cy * cx
    if angles.shape[-1] == 2:
        return matrix
    cz, sz = cosine[..., 2, None], sine[..., 2, None]
    rolled = matrix.copy()
    rolled[..., 0, :] = cz * matrix[..., 0, :] - sz * matrix[..., 1, :]
    rolled[..., 1, :] = sz * matrix[..., 0, :] + cz * matrix[..., 1, :]
    return rolled


def spin_of_angles(angles: Array) -> Array:
    """(..., 3, 3), angular velocity per rate of the angles about x, y and z (Torrao 2013, eq. 4.40, columns turned)."""
    angles = np.asarray(angles, dtype=np.float64)
    cy, sy = np.cos(angles[..., 1]), np.sin(angles[..., 1])
    roll = angles[..., 2] if angles.shape[-1] == 3 else np.zeros_like(cy)
    cz, sz = np.cos(roll), np.sin(roll)
    matrix = np.zeros((*angles.shape[:-1], 3, 3))
    matrix[..., 0, 0], matrix[..., 1, 0], matrix[..., 2, 0] = cy * cz, cy * sz, -sy
    matrix[..., 0, 1], matrix[..., 1, 1] = -sz, cz
    matrix[..., 2, 2] = 1.0
    return matrix


def _in_plane(corners: Array) -> Array:
    """(6, 3) m."""
    return np.column_stack([corners, np.zeros(len(corners))])


def _norm(vectors: Array) -> Array:
    return np.asarray(np.sqrt((vectors * vectors).sum(axis=-1)))


def _cross(a: Array, b: Array) -> Array:
    """np.cross over the last axis, several times as fast."""
    result = np.empty(np.broadcast_shapes(a.shape, b.shape))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        result[..., i] = a[..., j] * b[..., k] - a[..., k] * b[..., j]
    return result


def spif_a(**set_up: Any) -> Hexapod:
    """The hexapod of the SPIF-A machine; ``set_up``: what is not the default of :class:`Hexapod`."""
    return Hexapod(
        base=_semi_regular_hexagon(0.6, 0.2, short_first=True),
        platform=_semi_regular_hexagon(0.3, 0.15, short_first=False),
        **set_up,
    )
