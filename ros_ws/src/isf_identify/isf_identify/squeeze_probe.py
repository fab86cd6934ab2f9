"""Squeeze tests of the two tools against each other through the sheet, at several places.

At each place tool 1 goes onto the sheet, tool 2 comes from a standoff until it touches, and then:

* the squeeze is raised in steps along the line of centres, both tools at rest at every step;
* both tools are moved up together at half the squeeze, which takes the sheet's own force off tool 1 while the commanded
  gap stays the same (Ren 2018 eq. 2-9: what the gap does then is the deflection of tool 1 alone);
* for the contact stiffness, tool 2 alone makes small horizontal steps along d_n instead.

Every rest gives one :class:`Reading`; what follows from them is computed in :mod:`isf_identify.fits`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from isf_core.errors import ErrorCode, IsfError
from isf_core.types import Array
from isf_force_ctrl.measurements.measurement import AtRest, Probe, Program
from isf_force_ctrl.motion import tool_moves
from isf_force_ctrl.motion.tool_moves import Posture

from isf_identify.settings import IdentifySettings, Place, Property, ToolGeometry

LEVELS = 6
"""Squeezes at each place (published: six locations of three places; here six loads)."""

TOP = 0.75
"""Share of max_force that the largest squeeze aims at: overshoot and noise fit into the rest."""

PRESSED = 0.15
"""Share of max_force with which tool 1 is pressed onto flat sheet before tool 2 comes."""

STANDOFF, REACH = 0.8e-3, 1.5e-3
"""m: tool 2 begins to feel for the sheet so far from its planned place, and gives up so far beyond it."""

DROP = 8.0e-3
"""m over (and under) a flat place from which the tools feel for the sheet."""

TOUCH = 8.0
"""N more than at the standoff that count as contact (assumed: eight steps of a load cell)."""

FEEL, PRESS = 0.5e-3, 2.0e-3
"""m/s: tool 2 on its way to contact and while squeezing at most; tool 1 onto flat sheet."""

SQUEEZE = 0.2e-3
"""m/s while the squeeze is raised."""

RISE, RISES = 0.25e-3, 4
"""m and number of the steps of both tools up together."""

STEP, STEPS = 20.0e-6, 6
"""m and number of the horizontal steps for the contact stiffness."""

SETTLE, RECORD = 0.2, 0.3
"""s at rest before a reading, and of its mean."""


@dataclass(frozen=True)
class Reading:
    """Means over one rest.

    Attributes
    ----------
    place, repeat : number of the place and of the repetition
    kind : "free" (tool 2 away), "squeeze", "carried" (both raised together) or "step" (horizontal)
    tip_1, tip_2 : (3,) m, commanded
    force_1, force_2 : (3,) N, of the sheet on each tool, mean
    """

    place: int
    repeat: int
    kind: str
    tip_1: Array
    tip_2: Array
    force_1: Array
    force_2: Array


class SqueezeProbe(Probe):
    """Collects :attr:`readings` at ``places``."""

    def __init__(self, rest: AtRest, settings: IdentifySettings, geometry: ToolGeometry, places: list[Place]) -> None:
        super().__init__(rest)
        self.settings, self.geometry, self.places = settings, geometry, places
        self.readings: list[Reading] = []
        self.largest = 0.0
        """N, largest force that either load cell has read."""
        self._ground = np.zeros(6)
        self._smooth = np.zeros(6)
        self._share = 1.0 / (1.0 + 0.01 * rest.config.rate)
        self._guarding = False

    # -- what the base class asks for ------------------------------------------------------------

    def watch(self) -> None:
        """Filter the forces, and end when one is beyond max_force."""
        if not self._guarding:
            return
        forces = np.asarray(self.forces)
        self._smooth += self._share * (forces - self._smooth)
        largest = max(_length(self.forces[:3]), _length(self.forces[3:]))
        self.largest = max(self.largest, largest)
        if largest > self.settings.max_force:
            raise IsfError(
                ErrorCode.MEASUREMENT_FAILED,
                f"{largest:.0f} N were read, max_force is {self.settings.max_force:g} N",
                where="identify",
                advice="allow more force, or choose a place where the sheet carries less",
            )

    def program(self) -> Program:
        """Every place ``repeats`` times."""
        self._guarding = True
        count = len(self.places) * self.settings.repeats
        for number in range(count):
            index, repeat = divmod(number, self.settings.repeats)
            self.progress = number / count
            yield from self._visit(index, repeat)
        self.progress = 1.0

    # -- one place -------------------------------------------------------------------------------

    def _visit(self, index: int, repeat: int) -> Program:
        place = self.places[index]
        name = f"place {index + 1} of {len(self.places)}, repeat {repeat + 1}"
        self.phase = f"{name}: going there"
        yield from self._go_to(place)
        self.phase = f"{name}: searching for contact"
        yield from self._read(index, repeat, "free")
        self._ground = np.concatenate([self.readings[-1].force_1, self.readings[-1].force_2])
        yield from self._touch(place)
        self.phase = f"{name}: squeezing"
        if self.settings.property is Property.CONTACT_STIFFNESS:
            yield from self._to_force(place, 0.5 * TOP * self.settings.max_force)
            yield from self._steps(place, index, repeat)
        else:
            yield from self._squeezes(place, index, repeat)
        if self.settings.property is Property.TOOL_COMPLIANCE:
            self.phase = f"{name}: carrying"
            yield from self._carry(place, index, repeat)
        yield from self.away()

    def _go_to(self, place: Place) -> Program:
        """Tool 1 onto the sheet, tool 2 to its standoff."""
        config = self.config
        off = STANDOFF * place.normal
        heading = float(np.arctan2(place.normal[1], place.normal[0])) if not place.flat else 0.0
        # the normal of the sheet towards tool 1, for lifting
        self.lift_normal = -place.normal
        if not place.flat:
            start = Posture(place.tip_1, place.tip_2 + off, heading, self.here().holder)
            moves = tool_moves.approach(config, self.here(), start, config.contact_speed, self.tools)
            yield from self.follow(moves[:-1])
            self.clear = False
            yield from self.follow(moves[-1:])
            return
        up = np.array([0.0, 0.0, DROP])
        over = Posture(place.tip_1 + up, place.tip_2 - up, 0.0, self.here().holder)
        yield from self.follow(tool_moves.approach(config, self.here(), over, config.contact_speed, self.tools))
        yield from self.rest(SETTLE)
        self.clear = False
        ground = self._smooth.copy()
        wanted = PRESSED * self.settings.max_force
        down, still = np.array([0.0, 0.0, -1.0]), np.zeros(3)
        yield from self.glide(down, still, 2.0 * DROP, PRESS, lambda: _length(self._smooth[:3] - ground[:3]) > wanted)
        if _length(self._smooth[:3] - ground[:3]) < TOUCH:
            raise self._no_contact("tool 1 finds no sheet there")
        here = self.here()
        yield from self.rest(SETTLE)
        self._ground = self._smooth.copy()
        gap = float(here.tip_1[2] - here.tip_2[2]) - self.geometry.thickness - STANDOFF
        yield from self.glide(still, -down, gap, PRESS, self._felt)

    def _touch(self, place: Place) -> Program:
        """Tool 2 towards tool 1 until it feels the sheet."""
        still = np.zeros(3)
        yield from self.glide(still, -place.normal, STANDOFF + REACH, FEEL, self._felt)
        if not self._felt():
            raise self._no_contact("tool 2 does not meet tool 1 through the sheet")

    def _felt(self) -> bool:
        change = self._smooth - self._ground
        return max(_length(change[:3]), _length(change[3:])) > TOUCH

    def _squeezes(self, place: Place, index: int, repeat: int) -> Program:
        top = TOP * self.settings.max_force
        begin = self._loaded()
        if begin > 0.8 * top:
            raise self._too_loaded(begin)
        for level in range(1, LEVELS + 1):
            yield from self._to_force(place, begin + (top - begin) * level / LEVELS)
            yield from self._read(index, repeat, "squeeze")

    def _carry(self, place: Place, index: int, repeat: int) -> Program:
        """Back to half the squeeze, then both tools up together, and down again."""
        squeezes = [item for item in self.readings if (item.place, item.repeat) == (index, repeat)][1:]
        half = squeezes[LEVELS // 2 - 1]
        way = half.tip_2 - np.array(self.row[3:6])
        length = _length(way)
        still, up = np.zeros(3), np.array([0.0, 0.0, 1.0])
        yield from self.glide(still, way / max(length, 1e-12), length, FEEL)
        yield from self._read(index, repeat, "carried")
        for _ in range(RISES):
            yield from self.glide(up, up, RISE, FEEL, self._near_limit)
            yield from self._read(index, repeat, "carried")

    def _steps(self, place: Place, index: int, repeat: int) -> Program:
        if place.flat:
            return
        still = np.zeros(3)
        yield from self._read(index, repeat, "step")
        for _ in range(STEPS):
            if self._near_limit():
                break
            yield from self.glide(still, -place.horizontal, STEP, SQUEEZE)
            yield from self._read(index, repeat, "step")

    # -- parts of it -----------------------------------------------------------------------------

    def _to_force(self, place: Place, wanted: float) -> Program:
        """Raise the squeeze until the more loaded tool reads ``wanted`` N."""
        still = np.zeros(3)
        if self._loaded() < wanted:
            yield from self.glide(still, -place.normal, REACH, SQUEEZE, lambda: self._loaded() >= wanted)

    def _loaded(self) -> float:
        return max(_length(self._smooth[:3]), _length(self._smooth[3:]))

    def _near_limit(self) -> bool:
        return self._loaded() > 0.5 * (1.0 + TOP) * self.settings.max_force

    def _read(self, place: int, repeat: int, kind: str) -> Program:
        rows: list[tuple[float, ...]] = []
        yield from self.rest(SETTLE)
        tips = np.array(self.targets, dtype=float)
        yield from self.rest(RECORD, lambda: rows.append(self.forces))
        mean = np.mean(rows, axis=0)
        self.readings.append(Reading(place, repeat, kind, tips[:3], tips[3:], mean[:3], mean[3:]))

    def _no_contact(self, what: str) -> IsfError:
        return IsfError(
            ErrorCode.MEASUREMENT_FAILED,
            what,
            where="identify",
            advice="check the place, the clamp and that both load cells read",
        )

    def _too_loaded(self, force: float) -> IsfError:
        return IsfError(
            ErrorCode.MEASUREMENT_FAILED,
            f"the sheet alone loads a tool with {force:.0f} N, which leaves too little of "
            f"{self.settings.max_force:g} N for the squeeze",
            where="identify",
            advice="allow more force, or choose other places",
        )


def _length(vector: object) -> float:
    return float(np.sqrt(np.square(np.asarray(vector, dtype=float)).sum()))
