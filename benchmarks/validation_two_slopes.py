"""Two-slope pyramids after Behera 2015: how far a shallow lower wall pulls the finished upper wall inwards.

Published is the size of this tent effect, about 5 mm on ordinary two-slope parts and 10.04 mm on one of 80 and 25 deg
(AA3103 of 1.5 mm, upper wall 35 mm and lower 17.5 mm deep, ordinary multi-step forming), and its direction. Assumed:
half opening 75 mm and corners of 22 mm as in the pyramid of one slope, backing plate with an opening of 156 mm, steps
of 1 mm, an ordinary part of 60 and 25 deg, passes of 60, 67, 73 and 80 deg for the wall of 80 deg.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from isf_core.types import Array
from isf_sim.sheet.sheet_plant import SheetPlant
from plant_validation import SECTIONS, row, tool_circle
from validation_cases import backed_plant, rounded_square

HALF, CORNER, TOOL, STEP = 75e-3, 22e-3, 5e-3, 1e-3
UPPER, LOWER = 35e-3, 17.5e-3
"""m, depths of the two walls."""
LOWER_ANGLE = math.radians(25.0)
SIDES = ((1, 0), (0, 1), (-1, 0), (0, -1))
PLACES = np.linspace(8e-3, 27e-3, 20)
"""m, depths on the straight upper wall, clear of the entry and of the rib by more than a tool radius."""
FEWEST_NODES = 3
"""Nodes of the coarse shell across the wall, with fewer of which it has no moment that could be told."""
AWAY = 12e-3
"""m from the tool, beyond which bending of the wall is a matter of the whole part."""


@dataclass(frozen=True)
class Pull:
    """What happens to the upper walls, positive inwards.

    Attributes
    ----------
    scanned, formed : (4, N) m, along the normal, what the lower wall leaves in the middle of each upper wall: as a scan
        in the clamp shows it, and of the sheet's surface without the bulge
    elastic : m, largest way along the normal in any coarse solution, while the lower wall is formed
    moment : largest moment down the wall over its plastic moment, at least 12 mm from the tool: while the upper wall is
        formed, while the lower one is; NaN where the coarse shell has too few nodes across the wall
    """

    scanned: Array
    formed: Array
    elastic: float
    moment: tuple[float, float]


@dataclass
class Watch:
    """Follows the middle of the upper wall along +x through the coarse solutions: ways m and moments of each."""

    angle: float
    seen: int = 0
    way: list[float] = field(default_factory=list)
    moment: list[float] = field(default_factory=list)

    def check(self, plant: SheetPlant) -> None:
        """Note the newest solution, once."""
        if plant.solutions == self.seen or not plant._states:
            return
        self.seen = plant.solutions
        shell, tip = plant.shell, plant.points.place[plant.points.used[0] - 1]
        state = plant._states[-1].reshape(len(shell.y), len(shell.x), 3)[int(np.argmin(np.abs(shell.y)))]
        x, tan = shell.x, math.tan(self.angle)
        normal = math.cos(self.angle) * state[:, 2] - math.sin(self.angle) * state[:, 0]
        along = x / math.cos(self.angle)
        curvature = np.gradient(np.gradient(normal, along), along)
        wall = (x > HALF - 30e-3 / tan) & (x < HALF - 3e-3 / tan)
        away = wall & (np.hypot(x - tip[0], tip[1]) > AWAY)
        self.way.append(float(normal[wall].max()))
        if away.any() and wall.sum() >= FEWEST_NODES:
            self.moment.append(float(np.abs(curvature[away]).max()) * self._stiffness(plant))

    def _stiffness(self, plant: SheetPlant) -> float:
        """m, bending stiffness over plastic moment of the wall, its thickness by the sine law."""
        of = plant.material
        t = plant.thickness * math.cos(self.angle)
        bending = of.young_modulus * t**3 / (12.0 * (1.0 - of.poisson_ratio**2))
        return bending / (plant.constants.flow_factor * of.yield_strength * t**2 / 4.0)


def wall_loop(depth: float, angle: float, opening: float) -> Array:
    """(N, 2) m, loop of the tip at ``depth`` m on a wall of ``angle`` rad that would meet z = 0 at ``opening`` m."""
    side = float(tool_circle(depth, opening, angle, TOOL))
    return rounded_square(side, max(CORNER - (HALF - side), 3e-3), 1.0e-3)


def press(plant: SheetPlant, loop: Array, depth: float, watch: Watch) -> None:
    """One loop of the tip at ``depth`` m."""
    for point in loop:
        plant.move(np.array([point[0], point[1], -depth]), np.zeros(2))
        watch.check(plant)


def wall_places(angle: float) -> Array:
    """(4, N, 2) m, places in the middle of the four upper walls."""
    out = HALF - PLACES / math.tan(angle)
    return np.array([np.column_stack([out * x, out * y]) for x, y in SIDES])


def pulled(passes: tuple[float, ...]) -> tuple[Pull, SheetPlant]:
    """Form the upper wall in ``passes`` deg and the lower wall below it."""
    plant = backed_plant("behera2015", "AA3103", 1.5e-3, TOOL, STEP, 0.156)
    angle = math.radians(passes[-1])
    before, after = Watch(angle), Watch(angle)
    for degrees in passes:
        for depth in np.arange(STEP, UPPER + 1e-9, STEP):
            watch = before if degrees == passes[-1] else Watch(angle)
            press(plant, wall_loop(float(depth), math.radians(degrees), HALF), float(depth), watch)
    places = wall_places(angle)
    scanned, surface = heights(plant, places)
    rib = HALF - UPPER / math.tan(angle)
    opening = rib + UPPER / math.tan(LOWER_ANGLE)
    for depth in [*np.arange(UPPER + STEP, UPPER + LOWER, STEP), UPPER + LOWER]:
        inner = tool_circle(float(depth), opening, LOWER_ANGLE, TOOL) < tool_circle(float(depth), HALF, angle, TOOL)
        loop = wall_loop(float(depth), *((LOWER_ANGLE, opening) if inner else (angle, HALF)))
        press(plant, loop, float(depth), after)
    scanned_after, surface_after = heights(plant, places)
    along = math.cos(angle)
    moment = max(before.moment, default=math.nan), max(after.moment, default=math.nan)
    return Pull((scanned_after - scanned) * along, (surface_after - surface) * along, max(after.way), moment), plant


def heights(plant: SheetPlant, places: Array) -> tuple[Array, Array]:
    """(4, N) m at ``places`` (4, N, 2) m: as a scan in the clamp sees the sheet, and without the bulge."""
    shape = plant.measured_shape()
    scanned = np.array([shape.at(side) for side in places])
    surface = plant.surface
    columns = np.rint((places[..., 0] - surface.x0) / surface.h).astype(int)
    rows = np.rint((places[..., 1] - surface.y0) / surface.h).astype(int)
    return scanned, surface.height[rows, columns]


def two_slopes() -> None:
    """Rows of the ordinary part and of the one with a large difference in slope."""
    for passes, published, number in (
        ((60.0,), "about 5, inwards", 5.0),
        ((60.0, 67.0, 73.0, 80.0), "10.04 (largest error of the part), inwards", 10.04),
    ):
        pull, plant = pulled(passes)
        middle = 1e3 * pull.scanned.mean(axis=0)
        worst = float(middle[np.argmax(np.abs(middle))])
        formed = 1e3 * pull.formed.mean(axis=0)
        text = f"{worst:+.2f} ({formed[np.argmax(np.abs(formed))]:+.2f} without bulge)"
        quantity = f"Behera {passes[-1]:.0f}/25 deg pyramid, upper wall by the lower [mm]"
        row(quantity, published, text, "A", [(worst, number)])
        row("  elastic, while the lower wall is formed: at most [mm]", "-", f"{1e3 * pull.elastic:+.2f}", "-")
        if math.isfinite(pull.moment[1]):
            text = f"{pull.moment[0]:.2f}, {pull.moment[1]:.2f}"
            row("  its moment over the plastic one: upper, lower wall being formed", "-", text, "-")
        x = np.arange(0.0, 88e-3, 0.5e-3)
        SECTIONS[f"two_slopes_{passes[-1]:.0f}"] = (x, target(x, passes[-1]), plant.measured_shape().at(along_x(x)))


def along_x(x: Array) -> Array:
    """(N, 2) m, places along +x."""
    return np.column_stack([x, 0.0 * x])


def target(x: Array, degrees: float) -> Array:
    """(N,) m, height of the part along +x without fillets."""
    run = np.maximum(HALF - x, 0.0)
    rib = UPPER / math.tan(math.radians(degrees))
    upper = np.minimum(run, rib) * math.tan(math.radians(degrees))
    lower = np.clip((run - rib) * math.tan(LOWER_ANGLE), 0.0, LOWER)
    return -(upper + lower)
