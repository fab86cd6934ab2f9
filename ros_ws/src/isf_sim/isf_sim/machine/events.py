"""Events of a part: what happened to sheet or machine, each told once with place, time, value and limit.

fracture      ln(t0 / t) of the wall beside the tool above 1.15 ln(1 / cos(a_max)) (1 + c_n F_n / 200 N) over four tool
              radii of way; a_max of the material in one pass; c_n from the later failure of the funnel with force
              control (Ren 2018, 2.4.1)
galling       support force above c_g R_m R t0: 120 N is fine and 200 N sheds chips on AA1100-O with R 4.5 mm (same)
buckling      accumulative forming outside the stable gaps (Ren 2018, 3.2.3)
contact lost  the support tool carried load and carries none for 0.1 s, still beside the pressing forming tool
die contact   the sheet under the tool reaches the die or the backing plate
saturation    a load cell is at the end of its range, or an axis is not driven as hard as its controller asks

A condition that holds on is one event; it can be told again after it was absent for 0.5 s (fracture: once per part).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

from isf_core.events import Event, EventKind

GALLING_FACTOR = 0.42
"""c_g, calibrated: geometric mean between the fine and the shedding support force of Ren 2018, 2.4.1."""
SQUEEZE_GAIN = 0.16
"""c_n, calibrated: funnel 19.0 mm deep without, 22.1 mm with 200 N, taken as a ratio of strains (assumed)."""
REFERENCE_FORCE = 200.0
OWN_THINNING = 1.15
"""Thinning of a wall formed in one pass over the sine law's, as the material that is carried along gives it: 1.05 to
1.17 on cones of 45 to 70 deg with R 5 mm. The limit of the wall angle is one of a single pass, so it is told in the
same measure; nothing published went into it."""
TORN_WAY = 4.0
"""Tool radii of way over which the limit must be passed: the seam of the contours is thinner over a shorter way."""
LOADED, ENGAGED = 50.0, 10.0
"""N, forming tool presses; support tool carries load."""
LOST_AFTER, ABSENT_AFTER, ENGAGED_AFTER, BRIEF = 0.1, 0.5, 0.1, 0.01
"""s"""


@dataclass(frozen=True)
class EventLimits:
    """Limits of one job: galling N, fracture strain without squeeze, control rate Hz, tool radius, thickness m."""

    galling: float
    fracture: float
    rate: float
    radius: float
    thickness: float


class TickFacts(NamedTuple):
    """What :class:`EventWatch` looks at after a tick.

    Attributes
    ----------
    tick : number ; forming, support : tips m ; axial : N on the forming tool ; support_force : N, magnitude
    gap : m between the balls ; strain : ln(t0 / t) of the wall beside the tool, 0 without contact ; thinnest : its
        place m ; travelled : m of path
    buckles : gap / t0 of an unstable ring, NaN when stable ; on_support : sheet under the tool lies on the support
    clipped : readings in a row at the end of a range ; saturated : an axis' controller saturates
    """

    tick: int
    forming: tuple[float, float, float]
    support: tuple[float, float, float]
    axial: float
    support_force: float
    gap: float
    strain: float
    thinnest: tuple[float, float, float]
    travelled: float
    buckles: float
    on_support: bool
    clipped: int
    saturated: bool


def event_limits(
    tensile_strength: float, max_wall_angle: float, radius: float, thickness: float, rate: float
) -> EventLimits:
    """Limits for a material (Pa, rad), the smaller tool radius m, the blank's thickness m and the control rate Hz."""
    return EventLimits(
        galling=GALLING_FACTOR * tensile_strength * radius * thickness,
        fracture=-OWN_THINNING * math.log(math.cos(max_wall_angle)),
        rate=rate,
        radius=radius,
        thickness=thickness,
    )


@dataclass
class _Occurrence:
    present: float = 0.0
    absent: float = 1e9
    told: bool = False


@dataclass
class EventWatch:
    """Finds events tick by tick; what it remembers is plain numbers, so that a machine's state can be saved."""

    limits: EventLimits
    occurrences: dict[str, _Occurrence] = field(default_factory=lambda: {k.name: _Occurrence() for k in EventKind})
    engaged: float = 0.0
    carrying: bool = False
    thinned_from: float = -1.0
    broken: bool = False

    def look(self, facts: TickFacts) -> list[Event]:
        """Events that begin with this tick."""
        limits, found = self.limits, []
        force = facts.support_force
        limit = limits.galling
        if self._begins(EventKind.GALLING, force > limit, BRIEF):
            text = f"the support tool sheds chips: {force:.0f} N, limit {limit:.0f} N"
            found.append(self._event(EventKind.GALLING, facts, facts.support, force, limit, text))
        if self._begins(EventKind.CONTACT_LOST, self._lost(facts), LOST_AFTER):
            text = "the support tool lost the sheet while the forming tool presses"
            found.append(self._event(EventKind.CONTACT_LOST, facts, facts.support, force, ENGAGED, text))
        if self._begins(EventKind.BUCKLING, not math.isnan(facts.buckles), BRIEF):
            text = f"the sheet buckles between the tools: gap {facts.buckles:.2f} of its thickness, 0.6 is stable"
            found.append(self._event(EventKind.BUCKLING, facts, facts.forming, facts.buckles, 0.6, text))
        if self._begins(EventKind.DIE_CONTACT, facts.on_support, 0.0):
            text = "the sheet under the tool touches its support"
            found.append(self._event(EventKind.DIE_CONTACT, facts, facts.forming, facts.axial, 0.0, text))
        if self._begins(EventKind.SATURATION, facts.clipped > 0 or facts.saturated, BRIEF):
            which = "a load cell is at the end of its range" if facts.clipped else "an axis saturates"
            found.append(self._event(EventKind.SATURATION, facts, facts.forming, facts.axial, 0.0, which))
        broken = self._fracture(facts)
        return found if broken is None else [*found, broken]

    def _fracture(self, facts: TickFacts) -> Event | None:
        """Once per part: thinning over the forming limit along four tool radii of way."""
        limit = self.limits.fracture * (1.0 + SQUEEZE_GAIN * min(facts.support_force / REFERENCE_FORCE, 1.0))
        if self.broken or facts.strain <= limit:
            self.thinned_from = -1.0
            return None
        if self.thinned_from < 0.0:
            self.thinned_from = facts.travelled
        if facts.travelled - self.thinned_from < TORN_WAY * self.limits.radius:
            return None
        self.broken = True
        left = 1e3 * self.limits.thickness * math.exp(-facts.strain)
        text = f"the sheet tears: {left:.2f} mm are left, limit {1e3 * self.limits.thickness * math.exp(-limit):.2f} mm"
        return self._event(EventKind.FRACTURE, facts, facts.thinnest, facts.strain, limit, text)

    def _lost(self, facts: TickFacts) -> bool:
        self.engaged = self.engaged + 1.0 / self.limits.rate if facts.support_force > ENGAGED else 0.0
        beside = facts.gap < 3.0 * self.limits.thickness and facts.axial > LOADED
        if self.engaged >= ENGAGED_AFTER:
            self.carrying = True
        elif not beside:
            self.carrying = False  # lifted or sent away, not lost
        return self.carrying and facts.support_force <= 0.0

    def _begins(self, kind: EventKind, holds: bool, after: float) -> bool:
        """True at the tick at which a condition has held for ``after`` s, once until it was absent for long enough."""
        seen = self.occurrences[kind.name]
        step = 1.0 / self.limits.rate
        if not holds:
            seen.present = 0.0
            seen.absent += step
            seen.told = seen.told and seen.absent < ABSENT_AFTER
            return False
        seen.present += step
        seen.absent = 0.0
        if seen.told or seen.present < after:
            return False
        seen.told = True
        return True

    def _event(
        self,
        kind: EventKind,
        facts: TickFacts,
        position: tuple[float, float, float],
        value: float,
        limit: float,
        text: str,
    ) -> Event:
        return Event(kind, facts.tick / self.limits.rate, position, value, limit, text)
