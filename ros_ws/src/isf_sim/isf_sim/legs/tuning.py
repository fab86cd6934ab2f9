"""Sandbox that tunes the legs: step, ramp, circle and tool path with each controller, without a sheet.

The machine is that of the simulation (:class:`isf_sim.legs.legs.Legs`); a constant force on the tip stands for the
sheet. Errors are those of the true strokes against the set-points, without the transducers' noise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from isf_core.files.hydraulic_legs import Controller
from isf_core.files.rig import Rig
from isf_core.geometry.kinematics import UPRIGHT
from isf_core.types import Array

from isf_sim.legs.legs import Legs
from isf_sim.variant import Variant

CONTROLLERS: tuple[Controller, ...] = ("feedforward", "fuzzy")
REST = 1.0
"""s at the first point before a case begins: the loops find their rest."""
SOFT_START = 0.2
"""s in which the speed along a ramp or circle grows to its value."""


@dataclass(frozen=True)
class Case:
    """A path of the tip, (T, 3) m per tick, ``name`` and what it is for people; ``force`` (3,) N on the tip.

    ``speed`` m/s along it where that is constant; ``settled``: share of the ticks that come before it is.
    """

    name: str
    text: str
    tips: Array
    speed: float = 0.0
    settled: float = 0.0
    force: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class LegResponse:
    """What the legs did: per tick ``wanted`` and ``strokes`` (T, 6) m, ``tips`` (T, 3) m true, ``volts`` (T, 6),
    ``pressure`` (T,) Pa; ``found``: bits of the watch that ended it early, 0: none."""

    wanted: Array
    strokes: Array
    tips: Array
    volts: Array
    pressure: Array
    found: int
    rate: float

    def error(self, settled: float = 0.0) -> tuple[float, float]:
        """m, root mean square and largest error of a leg after the share ``settled`` of the ticks."""
        off = (self.strokes - self.wanted)[int(settled * len(self.wanted)) :]
        return float(np.sqrt((off**2).mean())), float(np.abs(off).max())

    def ripple(self, speed: float, settled: float) -> float:
        """Largest share by which the speed of the true tip differs from ``speed`` m/s; NaN when it was stopped before
        that was settled."""
        steps = np.linalg.norm(np.diff(self.tips, axis=0), axis=1)[int(settled * len(self.tips)) :] * self.rate
        return float(np.abs(steps / speed - 1.0).max()) if len(steps) else float("nan")

    def settling(self, band: float) -> float:
        """s, after which every leg stays within ``band`` m of its last set-point; infinite when one does not."""
        outside = np.flatnonzero(np.abs(self.strokes - self.wanted[-1]).max(axis=1) > band)
        if not len(outside):
            return 0.0
        last = int(outside[-1]) + 1
        return last / self.rate if last < len(self.wanted) and not self.found else float("inf")


def step_case(rate: float, tip: Array, size: float = 1e-3) -> Case:
    """The set-point jumps downwards by ``size`` m at once."""
    return Case("step", f"step of {1e3 * size:g} mm down", np.tile(tip - [0.0, 0.0, size], (round(1.5 * rate), 1)))


def ramp_case(rate: float, tip: Array, speed: float = 20e-3) -> Case:
    """Down for one second with ``speed`` m/s."""
    way = np.cumsum(np.minimum(np.arange(round(rate)) / (SOFT_START * rate), 1.0)) * speed / rate
    tips = tip - way[:, None] * [0.0, 0.0, 1.0]
    return Case("ramp", f"ramp of {1e3 * speed:g} mm/s down", tips, speed, SOFT_START + 0.1)


def circle_case(
    rate: float, centre: Array, radius: float, speed: float, force: tuple[float, float, float] = (0.0, 0.0, 0.0)
) -> Case:
    """Once around a circle with ``speed`` m/s."""
    count = round((2.0 * np.pi * radius / speed + 0.5 * SOFT_START) * rate)
    angle = np.cumsum(np.minimum(np.arange(count) / (SOFT_START * rate), 1.0)) * speed / rate / radius
    tips = centre + radius * np.column_stack([np.cos(angle), np.sin(angle), np.zeros(count)])
    text = f"circle of {1e3 * radius:.0f} mm at {1e3 * speed:g} mm/s"
    return Case("circle", text, tips, speed, 1.5 * SOFT_START * rate / count, force)


def path_case(rate: float, points: Array, speed: float, force: tuple[float, float, float]) -> Case:
    """Along the ``points`` (N, 3) m with ``speed`` m/s, without slowing down at corners."""
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    count = round((way[-1] / speed + 0.5 * SOFT_START) * rate)
    along = np.cumsum(np.minimum(np.arange(count) / (SOFT_START * rate), 1.0)) * speed / rate
    tips = np.column_stack([np.interp(along, way, points[:, k]) for k in range(3)])
    return Case(
        "path", f"contour of the job at {1e3 * speed:g} mm/s", tips, speed, 1.5 * SOFT_START * rate / count, force
    )


def respond(rig: Rig, case: Case, rate: float, controller: Controller, ball: float = 5e-3) -> LegResponse:
    """The legs of ``rig`` with ``controller`` and a tool with a ``ball`` of that radius (m) along ``case``, ticks at
    ``rate`` Hz; ends where the watch stops them."""
    assert rig.legs is not None  # the caller looked
    rig = rig.model_copy(update={"legs": rig.legs.model_copy(update={"controller": controller, "faults": ()})})
    start = case.tips[0] if case.name != "step" else case.tips[0] + [0.0, 0.0, 1e-3]
    legs = Legs(rig, Variant(), rate, np.asarray(start, dtype=np.float64), ball, (0, 0, 4))
    force, tick, found = np.array(case.force), 0, 0
    rest = round(REST * rate)
    rows: list[tuple[float, ...]] = []
    while tick < rest + len(case.tips) and not found:
        found = legs.move(case.tips[tick - rest] if tick >= rest else start, UPRIGHT, force, tick)
        if tick >= rest or found:
            state = legs.state
            rows.append((*state.wanted, *state.motion[:, 0], *legs.tip(), *state.volts, state.supply[0]))
        tick += 1
    table = np.array(rows)
    return LegResponse(table[:, :6], table[:, 6:12], table[:, 12:15], table[:, 15:21], table[:, 21], found, rate)
