"""What is to be identified, where and with how much force: goal of the action ``identify``, checked.

A place is a point on the sheet that both tools can go to: a point of the contour formed last, where the sheet is a wall
and the tools stand beside each other, or a flat point, where they stand one over the other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from isf_core.contour import Contour
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile
from isf_core.files.tooling import BackingPlateSpec
from isf_core.types import Array
from isf_force_ctrl.control_config import ControlConfig

ON_CONTOUR = 3.0e-3
"""m, a place nearer than this to the contour formed last is a point of it."""

MINIMUM_FORCE = 40.0
"""N, less than this tells nothing over the noise of a load cell (assumed)."""

MINIMUM_WALL = np.deg2rad(20.0)
"""rad; on flatter sheet the horizontal normal is not known well enough (assumed)."""

MAXIMUM_REPEATS = 20

ROOM_SHARE = 0.5
"""Of the way from the middle to where a ball touches clamp or backing plate: as far out flat places are (chosen)."""


class Property(IntEnum):
    """What can be identified; values as in ``isf_msgs/action/Identify``."""

    TOOL_COMPLIANCE = 1
    CONTACT_STIFFNESS = 2
    SERVO_RESPONSE = 3
    LOAD_CELL_SIGNS = 4


@dataclass(frozen=True)
class ToolGeometry:
    """``radii`` (2,) m of the tips of tool 1 and tool 2, ``thickness`` m of the blank.

    ``clamp`` m, free sheet in x and y; ``plate`` under it, None without: where neither tool may stand. ``flats`` (2,)
    m, radii of the flats of the tips, 0 of a hemisphere: the ball of a flat tip is its rounded edge. ``opposite``: the
    support tool of a contour is opposite the forming one; else it stays under the blank. ``accumulative``: the process
    is ADSIF.
    """

    radii: tuple[float, float]
    thickness: float
    clamp: tuple[float, float] = (np.inf, np.inf)
    plate: BackingPlateSpec | None = None
    flats: tuple[float, float] = (0.0, 0.0)
    opposite: bool = True
    accumulative: bool = False

    @staticmethod
    def from_job(job_file: JobFile) -> ToolGeometry:
        """Of a job; without a second tool its radius is 0."""
        job = job_file.job
        radii = job.tool_1.radius, job.tool_2.radius if job.tool_2 else 0.0
        flats = job.tool_1.flat_radius, job.tool_2.flat_radius if job.tool_2 else 0.0
        return ToolGeometry(
            radii,
            job.sheet.thickness,
            job_file.rig.clamp.size,
            job.backing_plate,
            flats,
            opposite=not job.support_stays,
            accumulative=job.process == "ADSIF",
        )

    @property
    def both_tools(self) -> bool:
        """False where the job has one tool."""
        return min(self.radii) > 0.0

    @property
    def balls(self) -> tuple[float, float]:
        """m, radii of what touches a wall: the ball, or the rounded edge of a flat tip."""
        return self.radii[0] - self.flats[0], self.radii[1] - self.flats[1]

    def between_balls(self, tip_1: Array, tip_2: Array) -> Array:
        """(..., 3) m from the centre of ball 1 to that of ball 2, for tips (..., 3); of the edge of a flat tip the part
        that is nearest to the other tool. Flats that lie over each other touch upright."""
        apart = tip_2 - tip_1
        apart[..., 2] -= sum(self.balls)
        across = np.linalg.norm(apart[..., :2], axis=-1, keepdims=True)
        apart[..., :2] *= np.maximum(0.0, 1.0 - sum(self.flats) / np.maximum(across, 1e-12))
        return np.asarray(apart)


@dataclass(frozen=True)
class IdentifySettings:
    """Goal: ``property``, ``tool`` (1, 2), ``repeats`` at each place, ``places`` (P, 3) m (none: a default set),
    ``max_force`` N that no load cell may exceed."""

    property: Property
    tool: int
    repeats: int
    places: Array
    max_force: float

    @staticmethod
    def of(property: int, tool: int, repeats: int, places: Sequence[float], max_force: float) -> IdentifySettings:
        """Settings from the fields of a goal; raises IsfError MEASUREMENT_REFUSED for what makes no sense."""
        if property not in set(Property):
            raise _refused(f"there is no property {property}", "1 to 4, see Identify.action")
        flat = np.asarray(places, dtype=float).ravel()
        if len(flat) % 3 or not np.isfinite(flat).all():
            raise _refused("places are not triples of finite numbers", "x, y, z in m, one after the other")
        if tool not in (1, 2):
            raise _refused(f"there is no tool {tool}", "1 or 2")
        if not 1 <= repeats <= MAXIMUM_REPEATS:
            raise _refused(f"{repeats} repeats are not possible", f"1 to {MAXIMUM_REPEATS}")
        return IdentifySettings(Property(property), tool, repeats, flat.reshape(-1, 3), max_force)

    def check_force(self, config: ControlConfig) -> None:
        """Raise IsfError MEASUREMENT_REFUSED when ``max_force`` is too small or more than the rig allows."""
        if self.property is Property.SERVO_RESPONSE:
            return
        most = min(config.force_limit)
        if not MINIMUM_FORCE <= self.max_force <= most:
            raise _refused(f"max_force of {self.max_force:g} N is not possible", f"{MINIMUM_FORCE:g} to {most:g} N")


@dataclass(frozen=True)
class Place:
    """Where the tools are to go.

    Attributes
    ----------
    tip_1, tip_2 : (3,) m, tips with the sheet between them, planned thickness
    normal : (3,) unit, from the centre of ball 1 to that of ball 2
    wall_angle : rad, 0 where it is flat
    """

    tip_1: Array
    tip_2: Array
    normal: Array
    wall_angle: float

    @property
    def flat(self) -> bool:
        """True where there is no horizontal normal to speak of."""
        return self.wall_angle < MINIMUM_WALL

    @property
    def horizontal(self) -> Array:
        """(3,) unit d_n of eq. 2-2, zero on the flat."""
        along = np.array([self.normal[0], self.normal[1], 0.0])
        return along / np.linalg.norm(along) if not self.flat else np.zeros(3)


def places_for(
    settings: IdentifySettings, config: ControlConfig, geometry: ToolGeometry, contour: Contour | None
) -> list[Place]:
    """Places of the goal, else the default set; ``contour`` is the one formed last, None on an unformed blank.

    Raises IsfError MEASUREMENT_REFUSED for a place out of reach, or where the property cannot be measured.
    """
    wall = contour
    if contour is None or not contour.has_support or contour.support_waits or contour.forming_tool != 1:
        wall = None
    if len(settings.places):
        places = [_place_at(point, geometry, wall) for point in settings.places]
    else:
        places = _default_places(geometry, wall, config)
    for place in places:
        _check_reach(place, config)
        _check_room(place, geometry)
    if settings.property is Property.CONTACT_STIFFNESS and all(place.flat for place in places):
        raise _refused(
            "the contact stiffness of eq. 2-8 acts along the horizontal normal, which flat sheet does not have",
            "form some contours first, and give places on the last one (or none)",
        )
    return places


def _default_places(geometry: ToolGeometry, wall: Contour | None, config: ControlConfig) -> list[Place]:
    """On a part: the points of the contour that face +x, +y, -x and -y, and its middle; on a blank: three places."""
    if wall is None:
        apart = min(0.2 * min(config.travel[0], config.travel[1]), ROOM_SHARE * _room(geometry))
        return [_flat(np.array([x, y, 0.0]), geometry) for x, y in ((0.0, 0.0), (apart, 0.0), (0.0, apart))]
    away = wall.support_tip - wall.forming_tip if geometry.opposite else -wall.normal
    places: list[Place] = []
    for direction in ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0)):
        along = away[:, :2] @ np.array(direction) / (np.linalg.norm(away[:, :2], axis=1) + 1e-12)
        place = _on_wall(int(np.argmax(along)), geometry, wall)
        if all(np.linalg.norm(place.tip_1 - other.tip_1) > ON_CONTOUR for other in places):
            places.append(place)
    middle = wall.forming_tip.mean(axis=0)
    return [*places, _flat(middle, geometry)]


def _place_at(point: Array, geometry: ToolGeometry, wall: Contour | None) -> Place:
    if wall is not None:
        distance = np.linalg.norm(wall.forming_tip - point, axis=1)
        nearest = int(np.argmin(distance))
        if distance[nearest] <= ON_CONTOUR:
            return _on_wall(nearest, geometry, wall)
    return _flat(point, geometry)


def _on_wall(index: int, geometry: ToolGeometry, wall: Contour) -> Place:
    tip_1 = wall.forming_tip[index]
    tip_2 = wall.support_tip[index] if geometry.opposite else _opposite(index, geometry, wall)
    apart = geometry.between_balls(tip_1, tip_2)
    normal = apart / np.linalg.norm(apart)
    angle = float(np.arctan2(np.linalg.norm(normal[:2]), -normal[2]))
    return Place(tip_1, tip_2, normal, angle)


def _opposite(index: int, geometry: ToolGeometry, wall: Contour) -> Array:
    """(3,) m, tip of tool 2 with the sheet between it and tool 1, of predicted thickness."""
    normal, ball = wall.normal[index], geometry.balls[1]
    across = float(np.linalg.norm(normal[:2]))
    tip = wall.contact[index] - (wall.thickness[index] + ball) * normal + [0.0, 0.0, ball]
    tip[:2] -= geometry.flats[1] * normal[:2] / max(across, 1e-12)
    return np.asarray(tip)


def _flat(point: Array, geometry: ToolGeometry) -> Place:
    below = point - np.array([0.0, 0.0, geometry.thickness])
    return Place(point, below, np.array([0.0, 0.0, -1.0]), 0.0)


def _room(geometry: ToolGeometry) -> float:
    """m from the middle of the sheet that both balls can stand at in x and y; of an outline as in its rectangle."""
    room = 0.5 * min(geometry.clamp) - max(geometry.radii)
    return room if geometry.plate is None else min(room, 0.5 * min(geometry.plate.extent) - geometry.radii[1])


def _check_room(place: Place, geometry: ToolGeometry) -> None:
    """Raise IsfError MEASUREMENT_REFUSED for a tool on the clamp, or a lower one in the backing plate."""
    for number, (tip, radius) in enumerate(zip((place.tip_1, place.tip_2), geometry.radii, strict=True), start=1):
        x, y, z = (float(value) for value in tip)
        at = f"tool {number}, a ball of radius {1e3 * radius:g} mm, at ({1e3 * x:.1f}, {1e3 * y:.1f}, {1e3 * z:.1f}) mm"
        if radius > 0.0 and (abs(x) > 0.5 * geometry.clamp[0] - radius or abs(y) > 0.5 * geometry.clamp[1] - radius):
            width, height = (1e3 * size for size in geometry.clamp)
            raise _refused(
                f"{at}, would stand on the clamp",
                f"give places further from the edge of the free sheet, {width:g} x {height:g} mm",
            )
        # its shank is below its ball: beside the opening there is plate at every height
        if number == 2 and radius > 0.0 and geometry.plate is not None:
            inside = float(geometry.plate.inside(np.array(x), np.array(y)))
            if inside < radius:
                raise _refused(
                    f"{at}, would run into the backing plate: {1e3 * inside:.1f} mm inside its opening",
                    f"give places at least {1e3 * radius:g} mm inside the opening of the backing plate",
                )


def _check_reach(place: Place, config: ControlConfig) -> None:
    margin = np.array([0.0, 0.0, config.clearance])
    for tip in (place.tip_1, place.tip_2):
        if (np.abs(tip) + margin > np.array(config.travel)).any():
            x, y, z = 1e3 * tip
            raise _refused(
                f"the place ({x:.1f}, {y:.1f}, {z:.1f}) mm is outside the travel of the tools",
                "in x, y, z: +-" + ", +-".join(f"{1e3 * limit:g}" for limit in config.travel) + " mm",
            )


def _refused(what: str, advice: str) -> IsfError:
    return IsfError(ErrorCode.MEASUREMENT_REFUSED, what, where="identify", advice=advice)
