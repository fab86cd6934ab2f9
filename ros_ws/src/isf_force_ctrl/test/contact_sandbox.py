"""A small contact model for testing the force controller: springs, servo and load cell, nothing of a forming process.

Series springs of Ren 2018 eq. 2-4 to 2-9 along the horizontal normal of a ring-shaped wall, a third-order 30 Hz servo
per axis (2.3.3, Butterworth) fed through a first-order hold, 1 % or 0.5 N noise and 1 N steps at the load cell
(2.2, 2.3.4).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from isf_core.contour import Contour, Process
from isf_force_ctrl import ControlConfig, ForceController
from scipy.linalg import expm

SUBSTEPS = 4

RIG = {
    "rate": 500.0,
    "park_height": 0.03,
    "travel": (0.125, 0.125, 0.11),
    "speed_limit": 0.1,
    "force_limit": (1500.0, 1500.0, 2000.0),
    "servo_bandwidth": 30.0,
    "contact_stiffness": 0.45e6,
    "forming_compliance": (1e-6, 1e-6),
    "compensation": 0.0,
    "offset_limit": 1.5e-3,
}
"""Rig of Ren 2018 as in rigs/ren2018.yaml, in SI units; parked nearer, so that tests are short."""


def make_config(**changes: object) -> ControlConfig:
    """Configuration of the published rig with ``changes``."""
    return ControlConfig(**{**RIG, **changes})  # type: ignore[arg-type]


class Servo:
    """Axes with a third-order Butterworth response, inputs ramped linearly within a tick."""

    def __init__(self, start: np.ndarray, rate: float = 500.0, bandwidth: float = 30.0) -> None:
        w = 2 * np.pi * bandwidth
        a = np.zeros((4, 4))
        a[0, 1] = a[1, 2] = 1.0
        a[2, :3] = [-(w**3), -2 * w**2, -2 * w]
        a[2, 3] = w**3
        transition = expm(a / rate / SUBSTEPS)
        self._a, self._b = transition[:3, :3], transition[:3, 3]
        self._state = np.zeros((3, len(start)))
        self._state[0] = start
        self._last = np.array(start, dtype=float)

    def step(self, command: np.ndarray) -> np.ndarray:
        """Positions (m) one tick later."""
        for k in range(SUBSTEPS):
            now = self._last + (command - self._last) * (k + 0.5) / SUBSTEPS
            self._state = self._a @ self._state + np.outer(self._b, now)
        self._last = np.array(command, dtype=float)
        return self._state[0].copy()


@dataclass
class Sandbox:
    """Two tools squeezing a wall; ``overlap`` is the nominal squeeze (m) at the planned positions.

    ``gap`` (m, function of time and place) is a disturbance that opens the gap; ``sheet`` N presses the forming tool
    inwards.
    """

    tip_1: np.ndarray
    tip_2: np.ndarray
    planned_distance: float
    overlap: float = 0.1e-3
    contact_stiffness: float = 0.45e6
    tool_stiffness: float = 1e6
    gap: Callable[[float, float], float] = lambda time, angle: 0.0
    sheet: Callable[[float, float], float] = lambda time, angle: 0.0
    noise: bool = True
    forming_tool: int = 1
    seed: int = 0
    rate: float = 500.0
    tick: int = 0
    force: float = 0.0
    true_forces: list[float] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._servo = Servo(np.concatenate([self.tip_1, self.tip_2]), self.rate)
        self._random = np.random.default_rng(self.seed)
        self.position = np.concatenate([self.tip_1, self.tip_2])

    @property
    def time(self) -> float:
        """s."""
        return self.tick / self.rate

    def wrenches(self) -> tuple[list[float], list[float]]:
        """Present wrenches of the sheet on both tools."""
        p1, p2 = self.position[:3], self.position[3:]
        apart = p2[:2] - p1[:2]
        distance = float(np.hypot(*apart))
        angle = float(np.arctan2(p1[1], p1[0]))
        near = abs(p1[2]) < 0.015 and abs(p2[2]) < 0.015 and 0.0 < distance < 0.02
        sheet = self.sheet(self.time, angle) if near else 0.0
        squeeze = 0.0
        if near:
            squeeze = (
                self.planned_distance
                + self.overlap
                - self.gap(self.time, angle)
                - sheet / self.tool_stiffness
                - distance
            )
        force = max(0.0, self.contact_stiffness * squeeze)
        self.force = force
        normal = apart / distance if distance > 0 else np.zeros(2)
        on_2 = (force + (sheet if self.forming_tool == 2 else 0.0)) * normal
        on_1 = -(force + (sheet if self.forming_tool == 1 else 0.0)) * normal
        return [*self._cell(on_1), 0.0, 0.0, 0.0, 0.0], [*self._cell(on_2), 0.0, 0.0, 0.0, 0.0]

    def advance(self, tip_1: tuple[float, ...], tip_2: tuple[float, ...]) -> None:
        """Move on by one tick with new targets."""
        self.position = self._servo.step(np.array([*tip_1, *tip_2]))
        self.tick += 1

    def _cell(self, force: np.ndarray) -> np.ndarray:
        if not self.noise:
            return force
        spread = np.maximum(0.01 * np.abs(force), 0.5)
        return np.round(force + spread * self._random.standard_normal(2))


def ring(index: int = 0, count: int = 1, **changes: object) -> Contour:
    """Contour of a 50 deg cone, 5 mm balls and 1 mm sheet, near (x, y) = 0; ``changes`` replace fields."""
    radius = float(changes.pop("radius", 15e-3))  # type: ignore[arg-type]
    points = int(changes.pop("points", 160))  # type: ignore[call-overload]
    force = changes.pop("force", 120.0)
    around = 2 * np.pi * np.arange(points) / points
    out = np.column_stack([np.cos(around), np.sin(around), np.zeros(points)])
    wall = np.radians(50.0)
    normal = -np.sin(wall) * out + [0.0, 0.0, np.cos(wall)]
    contact = radius * out + [0.0, 0.0, -(index + 1) * 0.5e-3]
    thickness = 1e-3 * np.cos(wall)
    fields: dict[str, object] = {
        "plan_id": "plan",
        "index": index,
        "count": count,
        "process": Process.DSIF,
        "feed": 0.03,
        "contact": contact,
        "normal": normal,
        "wall_angle": np.full(points, wall),
        "thickness": np.full(points, thickness),
        "forming_tip": contact + 5e-3 * normal - [0.0, 0.0, 5e-3],
        "support_tip": contact - (5e-3 + thickness) * normal + [0.0, 0.0, 5e-3],
        "support_force": np.full(points, force) if force is not None else np.empty(0),
    }
    return Contour(**{**fields, **changes})  # type: ignore[arg-type]


def mirrored(contour: Contour) -> Contour:
    """The same contour formed by tool 2 from below, tool 1 supporting."""
    turn = np.array([1.0, 1.0, -1.0])
    return replace(
        contour,
        forming_tool=2,
        contact=contour.contact * turn,
        normal=contour.normal * turn,
        forming_tip=contour.forming_tip * turn,
        support_tip=contour.support_tip * turn if contour.has_support else contour.support_tip,
    )


def spiral(count: int = 3, **changes: object) -> list[Contour]:
    """Turns of a spiral that begin where the one before ended; each is open and has its last point on the next one."""
    turns = []
    for index in range(count):
        low, high = ring(index, count, **dict(changes)), ring(index + 1, count, **dict(changes))
        points = len(low)
        share = (np.arange(points + 1) / points)[:, None]
        at = np.arange(points + 1) % points
        fields = {
            name: (1 - share) * getattr(low, name)[at] + share * getattr(high, name)[at]
            for name in ("contact", "forming_tip", "support_tip")
        }
        per_point = {
            name: getattr(low, name)[at] for name in ("normal", "wall_angle", "thickness", "support_force")
            if len(getattr(low, name))
        }  # fmt: skip
        turns.append(replace(low, closed=False, **fields, **per_point))
    return turns


def planned_distance(contour: Contour) -> float:
    """m, horizontal distance of the tips of a ring."""
    if not contour.has_support:
        return 0.0
    return float(np.linalg.norm((contour.support_tip - contour.forming_tip)[0, :2]))


@dataclass
class Run:
    """What a closed loop did: per tick true force (T,) N, targets (T, 6) m, engaged (T,) and the results."""

    force: np.ndarray
    targets: np.ndarray
    mode: np.ndarray
    results: list
    holder: np.ndarray
    sandbox: Sandbox
    controller: ForceController


def run(
    contours: list[Contour],
    config: ControlConfig,
    max_ticks: int = 40000,
    on_tick: Callable[[int, ForceController, list, list], tuple[list, list]] | None = None,
    **plant: object,
) -> Run:
    """Form ``contours`` against a sandbox; ``on_tick`` may replace the wrenches of a tick."""
    tip_1, tip_2 = np.array([0.0, 0.0, config.park_height]), np.array([0.0, 0.0, -config.park_height])
    sandbox = Sandbox(tip_1, tip_2, planned_distance(contours[0]), rate=config.rate, **plant)  # type: ignore[arg-type]
    if not plant.get("noise", True):
        config = replace(config, frozen_time=np.inf)  # a cell without noise stands still
    controller = ForceController(config)
    controller.arm("plan", contours[0].index, contours[0].count, tip_1, tip_2)
    forces, targets, modes, results, holder = [], [], [], [], []
    for contour in contours:
        controller.start(contour)
        while controller.busy and sandbox.tick < max_ticks:
            wrench_1, wrench_2 = sandbox.wrenches()
            if on_tick:
                wrench_1, wrench_2 = on_tick(sandbox.tick, controller, wrench_1, wrench_2)
            pair = controller.tick(sandbox.tick, sandbox.time, wrench_1, wrench_2)
            forces.append(sandbox.force)
            targets.append([*pair.tip_1, *pair.tip_2])
            modes.append(controller.mode)
            holder.append(pair.holder_height)
            sandbox.advance(pair.tip_1, pair.tip_2)
        result = controller.take_result()
        if result is not None:
            results.append(result)
        if controller.fault:
            break
    return Run(np.array(forces), np.array(targets), np.array(modes), results, np.array(holder), sandbox, controller)
