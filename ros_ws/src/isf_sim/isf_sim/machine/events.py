"""Events of a part: what happened to sheet or machine, each told once with place, time, value and limit.

fracture      strain of the wall beside the tool (elasto-plastic sheet: of any place) above the forming limit of the
              material times 1 + c_n F_n / 200 N over four tool radii of way (strains and bends of all passes:
              :class:`isf_core.files.material.FormingLimit`); c_n from the later failure of the funnel with force
              control (Ren 2018, 2.4.1)
galling       support force above c_g R_m R t0: 120 N is fine and 200 N sheds chips on AA1100-O with R 4.5 mm (same)
buckling      accumulative forming outside the stable gaps (Ren 2018, 3.2.3)
contact lost  the support tool carried load and carries none for 0.1 s, still beside the forming tool, which presses and
              goes on, by more than 1 mm in plan: while it stands, a measurement may move the support tool aside
die contact   the sheet under the tool reaches the die or the backing plate
saturation    a load cell is at the end of its range, or an axis is not driven as hard as its controller asks

A condition that holds on is one event; it can be told again after it was absent for 0.5 s (fracture: once per part).

The compiled tick judges the conditions (:func:`conditions`), as bits; a watch counts how long they hold. To ask the
watch takes longer than the tick, so it is left alone while the bits stay what they were and nothing is counted
(:func:`settled`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from isf_core.events import Event, EventKind
from isf_core.files.material import FormingLimit
from isf_core.types import Array

from isf_sim.jit import kernel
from isf_sim.machine.load_cells import CellState
from isf_sim.machine.tick import Axes
from isf_sim.sheet.sheet_point import Contact
from isf_sim.sheet.squeeze import Squeeze
from isf_sim.sheet.surface import Surface
from isf_sim.sheet.thickness import strain_up_the_wall

GALLING_FACTOR = 0.42
"""c_g, calibrated: geometric mean between the fine and the shedding support force of Ren 2018, 2.4.1."""
SQUEEZE_GAIN = 0.16
"""c_n, calibrated: funnel 19.0 mm deep without, 22.1 mm with 200 N, taken as a ratio of strains (assumed)."""
REFERENCE_FORCE = 200.0
TORN_WAY = 4.0
"""Tool radii of way over which the limit must be passed: the seam of the contours is thinner over a shorter way."""
LOADED, ENGAGED = 50.0, 10.0
"""N, forming tool presses; support tool carries load."""
LOST_AFTER, ABSENT_AFTER, ENGAGED_AFTER, BRIEF = 0.1, 0.5, 0.1, 0.01
"""s"""
LOST_WAY = 1e-3
"""m in plan that the forming tool goes on before contact counts as lost."""
TOUCHING = 1.0
"""N between sheet and support, from which on they touch."""

CHIPS, CARRIES, FREE, BESIDE, ON_SUPPORT, SATURATED, CLIPPED, THIN, LIMITED, BUCKLES = (1 << k for k in range(10))
"""Bits: support force above the limit of chips, above ENGAGED, none at all; tools together and pressing; sheet on its
support; an axis saturates; a reading clipped; wall thinner than the limit; bits of Axes.flags; an unstable ring."""

NEVER = -1
"""Conditions that no tick has."""


@dataclass(frozen=True)
class EventLimits:
    """Limits of one job: galling N, forming limit without squeeze, control rate Hz, tool radius, thickness m."""

    galling: float
    forming: FormingLimit
    rate: float
    radius: float
    thickness: float


class EventBounds(NamedTuple):
    """Limits of support force N, strain without squeeze (with the slope of its line, and the strain m per sum of
    curvatures that bends use up), of the gap m; radii m of upper and lower ball (0: none); blank thickness m."""

    galling: float
    strain: float
    slope: float
    bent: float
    gap: float
    upper: float
    lower: float
    thickness: float


class TickFacts(NamedTuple):
    """What is told of an event that begins with a tick.

    Attributes
    ----------
    time : s ; forming, support : tips m ; axial : N on the forming tool ; support_force : N, magnitude
    strain : of the wall beside the tool, as the forming limit counts it, 0 without contact ; thinnest : its place m
    buckles : gap / t0 of an unstable ring, NaN when stable ; clipped : readings in a row at the end of a range
    """

    time: float
    forming: tuple[float, float, float]
    support: tuple[float, float, float]
    axial: float
    support_force: float
    strain: float
    thinnest: tuple[float, float, float]
    buckles: float
    clipped: int


def event_limits(
    tensile_strength: float, forming: FormingLimit, radius: float, thickness: float, rate: float
) -> EventLimits:
    """Limits for a material (Pa), the smaller tool radius m, the blank's thickness m and the control rate Hz."""
    return EventLimits(
        galling=GALLING_FACTOR * tensile_strength * radius * thickness,
        forming=forming,
        rate=rate,
        radius=radius,
        thickness=thickness,
    )


def event_bounds(limits: EventLimits, radii: tuple[float, float], blank: float) -> EventBounds:
    """Bounds for ``limits``, ``radii`` m of both balls (0: no second tool) and a ``blank`` m thick."""
    forming = limits.forming
    bent = 0.5 * blank * forming.bending_share
    return EventBounds(limits.galling, forming.strain, forming.slope, bent, 3.0 * limits.thickness, *radii, blank)


@kernel
def squeezed_limit(strain: float, support_force: float) -> float:
    """Strain of fracture of a wall that is squeezed with ``support_force`` N; ``strain`` is that without."""
    return strain * (1.0 + SQUEEZE_GAIN * min(support_force / REFERENCE_FORCE, 1.0))


@kernel
def wall_strain(
    surface: Surface,
    contact: Contact,
    squeeze: Squeeze,
    radius: float,
    support_axial: float,
    bounds: EventBounds,
    place: Array,
) -> float:
    """Largest strain of the wall beside the tool of ``radius`` m, its place m in ``place`` (3,).

    What the support tool, loaded with ``support_axial`` N, has squeezed thin comes on top.
    """
    tip = contact.formed_tip
    strain = strain_up_the_wall(surface, tip[0], tip[1], contact.wall, radius, bounds.slope, bounds.bent, place)
    if support_axial != 0.0:
        slope = contact.wall[0]
        formed = bounds.thickness / math.sqrt(1.0 + slope * slope)
        strain += max(math.log(formed / squeeze.thickness[0]), 0.0)
    return strain


@kernel
def judge(
    axial: float,
    force: float,
    gap: float,
    strain: float,
    on_die: float,
    saturated: int,
    clipped: int,
    bounds: EventBounds,
) -> int:
    """Bits of a tick: N on forming and support tool, m between the balls, strain of the wall, N on the support."""
    bits = 0
    if force > bounds.galling:
        bits |= CHIPS
    if force > ENGAGED:
        bits |= CARRIES
    if force <= 0.0:
        bits |= FREE
    if gap < bounds.gap and axial > LOADED:
        bits |= BESIDE
    if on_die > TOUCHING:
        bits |= ON_SUPPORT
    if saturated != 0:
        bits |= SATURATED
    if clipped > 0:
        bits |= CLIPPED
    if strain > squeezed_limit(bounds.strain, force):
        bits |= THIN
    return bits


@kernel
def conditions(
    turned: bool,
    radius: float,
    axes: Axes,
    surface: Surface,
    contact: Contact,
    squeeze: Squeeze,
    cell_1: CellState,
    cell_2: CellState,
    bounds: EventBounds,
) -> int:
    """Bits after a tick; ``turned``: the lower tool presses; ``radius`` m of the tool that presses."""
    axial = -axes.force_2[2] if turned else axes.force_1[2]
    support = axes.force_1 if turned else axes.force_2
    fx, fy, fz = support[0], support[1], support[2]
    gap = math.inf
    if bounds.lower > 0.0:
        dx, dy = axes.tips[0, 0] - axes.tips[1, 0], axes.tips[0, 1] - axes.tips[1, 1]
        dz = axes.tips[1, 2] - bounds.lower - axes.tips[0, 2] - bounds.upper
        gap = math.sqrt(dx * dx + dy * dy + dz * dz) - bounds.upper - bounds.lower
    strain = 0.0
    if contact.axial[0] > 0.0:
        strain = wall_strain(surface, contact, squeeze, radius, fz, bounds, np.empty(3))
    clipped = max(cell_1.clipped[0], cell_2.clipped[0])
    force = math.sqrt(fx * fx + fy * fy + fz * fz)
    bits = judge(axial, force, gap, strain, contact.on_die[0], axes.saturated[0], clipped, bounds)
    if axes.flags[0] != 0:
        bits |= LIMITED
    return bits


@dataclass
class _Occurrence:
    present: float = 0.0
    absent: float = 1e9
    reported: bool = False


@dataclass
class EventWatch:
    """Counts conditions tick by tick; what it remembers is plain numbers, so that a machine's state can be saved."""

    limits: EventLimits
    occurrences: dict[str, _Occurrence] = field(default_factory=lambda: {k.name: _Occurrence() for k in EventKind})
    engaged: float = 0.0
    carrying: bool = False
    freed_x: float = math.nan
    freed_y: float = math.nan
    thinned_from: float = -1.0
    broken: bool = False

    def update(self, bits: int, travelled: float, x: float, y: float) -> list[EventKind]:
        """Kinds of the events that begin with a tick of conditions ``bits``; ``travelled`` m of path, forming tool at
        ``x``, ``y`` m."""
        found = []
        if self._begins(EventKind.GALLING, bits & CHIPS, BRIEF):
            found.append(EventKind.GALLING)
        if self._begins(EventKind.CONTACT_LOST, self._lost(bits, x, y), LOST_AFTER):
            found.append(EventKind.CONTACT_LOST)
        if self._begins(EventKind.BUCKLING, bits & BUCKLES, BRIEF):
            found.append(EventKind.BUCKLING)
        if self._begins(EventKind.DIE_CONTACT, bits & ON_SUPPORT, 0.0):
            found.append(EventKind.DIE_CONTACT)
        if self._begins(EventKind.SATURATION, bits & (CLIPPED | SATURATED), BRIEF):
            found.append(EventKind.SATURATION)
        if self._breaks(bits, travelled):
            found.append(EventKind.FRACTURE)
        return found

    def _breaks(self, bits: int, travelled: float) -> bool:
        """Once per part: thinning over the forming limit along four tool radii of way."""
        if self.broken or not bits & THIN:
            self.thinned_from = -1.0
            return False
        if self.thinned_from < 0.0:
            self.thinned_from = travelled
        self.broken = travelled - self.thinned_from >= TORN_WAY * self.limits.radius
        return self.broken

    def _lost(self, bits: int, x: float, y: float) -> bool:
        self.engaged = self.engaged + 1.0 / self.limits.rate if bits & CARRIES else 0.0
        if self.engaged >= ENGAGED_AFTER:
            self.carrying = True
        elif not bits & BESIDE:
            self.carrying = False  # lifted or sent away, not lost
        if not self.carrying or not bits & FREE:
            self.freed_x = self.freed_y = math.nan
            return False
        if math.isnan(self.freed_x):
            self.freed_x, self.freed_y = x, y
        return math.hypot(x - self.freed_x, y - self.freed_y) > LOST_WAY

    def _begins(self, kind: EventKind, holds: int | bool, after: float) -> bool:
        """True at the tick at which a condition has held for ``after`` s, once until it was absent for long enough."""
        seen = self.occurrences[kind.name]
        step = 1.0 / self.limits.rate
        if not holds:
            seen.present = 0.0
            seen.absent += step
            seen.reported = seen.reported and seen.absent < ABSENT_AFTER
            return False
        seen.present += step
        seen.absent = 0.0
        if seen.reported or seen.present < after:
            return False
        seen.reported = True
        return True


def settled(watch: EventWatch, bits: int) -> bool:
    """True when ``watch``, updated with a tick of ``bits``, would find nothing at another one, and change nothing that
    counts."""
    if bits & (CLIPPED | LIMITED):
        return False
    if bits & THIN and not watch.broken:
        return False  # the way since it is thin is counted
    if bits & CARRIES and watch.engaged < ENGAGED_AFTER:
        return False
    holds = {
        EventKind.GALLING: bool(bits & CHIPS),
        EventKind.CONTACT_LOST: watch.carrying and bool(bits & FREE),
        EventKind.BUCKLING: bool(bits & BUCKLES),
        EventKind.DIE_CONTACT: bool(bits & ON_SUPPORT),
        EventKind.SATURATION: bool(bits & SATURATED),
    }
    # what holds and was told stays so; what neither holds nor was told long enough ago is not counted
    return all(seen.reported == holds.get(EventKind[name], False) for name, seen in watch.occurrences.items())


def event_of(kind: EventKind, facts: TickFacts, limits: EventLimits) -> Event:
    """The event of ``kind`` that began with a tick of these ``facts``."""
    force = facts.support_force
    if kind is EventKind.GALLING:
        text = f"the support tool sheds chips: {force:.0f} N, limit {limits.galling:.0f} N"
        return Event(kind, facts.time, facts.support, force, limits.galling, text)
    if kind is EventKind.CONTACT_LOST:
        text = "the support tool lost the sheet while the forming tool presses"
        return Event(kind, facts.time, facts.support, force, ENGAGED, text)
    if kind is EventKind.BUCKLING:
        text = f"the sheet buckles between the tools: gap {facts.buckles:.2f} of its thickness, 0.6 is stable"
        return Event(kind, facts.time, facts.forming, facts.buckles, 0.6, text)
    if kind is EventKind.DIE_CONTACT:
        text = "the sheet under the tool touches its support"
        return Event(kind, facts.time, facts.forming, facts.axial, 0.0, text)
    if kind is EventKind.SATURATION:
        text = "a load cell is at the end of its range" if facts.clipped else "an axis saturates"
        return Event(kind, facts.time, facts.forming, facts.axial, 0.0, text)
    limit = squeezed_limit(limits.forming.strain, force)
    x, y, z = (1e3 * value for value in facts.thinnest)
    text = f"the sheet tears at ({x:.1f}, {y:.1f}, {z:.1f}) mm: strain {facts.strain:.2f}, it bears {limit:.2f}"
    return Event(kind, facts.time, facts.thinnest, facts.strain, limit, text)
