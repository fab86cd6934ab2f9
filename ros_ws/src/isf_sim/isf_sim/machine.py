"""The simulated two-tool machine: one blank, two tools on servo axes, two load cells, protective limits.

Frame ``sheet``; a wrench is what the sheet does to the tool, after tare. The upper tool (tool_1) forms; the lower one
(tool_2) squeezes the sheet against it. Not modelled: a lower tool that forms on its own, dies, torques.

Reported tips are those of the axes' encoders: the deflection of tool and frame under load is not in them, as on a
real machine.
"""

from __future__ import annotations

import copy
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from isf_core.errors import ErrorCode, IsfError
from isf_core.height_map import HeightMap
from isf_core.job import JobFile
from numpy.typing import NDArray

from isf_sim import machine_tick as mt
from isf_sim.load_cell import BLOCK, DRAWS, make_cell
from isf_sim.plant_constants import PlantConstants
from isf_sim.servo import make_servo
from isf_sim.sheet_plant import SheetPlant
from isf_sim.sheet_point import DONE
from isf_sim.squeeze import SqueezeConstants, indentation_stiffness, no_squeeze
from isf_sim.world import World, make_world

Array = NDArray[np.float64]

LIMIT_TRAVEL, LIMIT_SPEED, LIMIT_FORCE = 1, 2, 4
"""Flags of limits that were hit, as in isf_msgs/msg/MachineState."""

TARE_READINGS = 200
LARGEST_TARE_FORCE = 20.0
"""N, true force above which a tool is not free."""
RELEASE_SPEED = 20.0e-3
"""m/s, at which tools are moved clear in a protective stop."""
RELEASE_CLEARANCE = 3.0e-3
"""m, way beyond the loss of contact."""
LARGEST_RELEASE = 25.0e-3
"""m, a release ends here at the latest."""


class MachineSample(NamedTuple):
    """What the machine tells after a tick.

    Attributes
    ----------
    tick, time : number of the tick and its time, s
    wrench_1, wrench_2 : (6,) N and N m, load cells after tare
    tip_1, tip_2 : (3,) m, tips by the encoders
    true_force_1, true_force_2 : (3,) N, force of the sheet on each tool without errors of the cells
    """

    tick: int
    time: float
    wrench_1: Array
    wrench_2: Array
    tip_1: Array
    tip_2: Array
    true_force_1: Array
    true_force_2: Array


class SimulatedMachine:
    """A machine with a fresh blank for ``job_file``, tools parked; deterministic for (job, world, seed).

    Attributes
    ----------
    control_rate : Hz ; tick_count : ticks since the blank was clamped ; world : World
    faults : latched faults (code, text), oldest first ; limits : flags of limits hit since the last reset
    tared : True after :meth:`tare`
    """

    def __init__(
        self, job_file: JobFile, *, world: int = 0, seed: int = 0, constants: PlantConstants | None = None
    ) -> None:
        job, rig = job_file.job, job_file.rig
        self.job_file = job_file
        self.world: World = make_world(world, seed)
        self.control_rate = job.control.rate
        self.tick_count = 0
        self.faults: list[tuple[ErrorCode, str]] = []
        self.limits = 0
        self.tared = False
        constants = constants or PlantConstants()
        park_1, park_2 = np.array([0.0, 0.0, rig.park_height]), np.array([0.0, 0.0, -rig.park_height])
        self.plant = SheetPlant(
            rig.clamp,
            job_file.material,
            job.sheet.thickness,
            job.tool_1.radius,
            job.path.incremental_depth,
            rig.tool_1.compliance,
            world=self.world,
            constants=constants,
            tip=park_1,
        )
        generator = np.random.default_rng([seed % 2**63, world])
        cell = rig.load_cell
        gain = self.world.load_cell_gain
        cell_1, self._cell_1 = make_cell(cell, constants, self.control_rate, gain, generator)
        cell_2, self._cell_2 = make_cell(cell, constants, self.control_rate, gain, generator)
        self._generator = generator
        self._axes = mt.parked_axes(park_1, park_2)
        self._squeeze = no_squeeze()
        self._constants = mt.MachineConstants(
            servo=make_servo(
                rig.servo.bandwidth,
                rig.servo.rate,
                self.control_rate,
                constants.servo_damping,
                constants.servo_pole_ratio,
            ),
            point=self.plant.point_constants,
            squeeze=self._squeeze_constants(constants),
            cell_1=cell_1,
            cell_2=cell_2,
            force_limit=np.array(rig.limits.force),
        )
        self._travel = np.array(rig.limits.travel)
        self._speed_step = rig.limits.speed / self.control_rate
        self._jump_step = constants.jump_margin * self._speed_step
        self._radii = np.array([job.tool_1.radius, job.tool_2.radius if job.tool_2 else 0.0])
        # force and compliance offsets may both drive the balls towards each other
        self._overlap = 2.0 * rig.limits.offset
        self._target = np.empty(6)
        self._draws = np.empty((0, 2 * DRAWS))
        self._read()

    # -- ticking -------------------------------------------------------------------------------------

    @property
    def solve_time(self) -> float:
        """s of wall time spent in sheet mechanics."""
        return self.plant.solve_time

    @property
    def faulted(self) -> bool:
        """True while a fault is latched: targets are ignored and the position is held."""
        return bool(self.faults)

    def tick(
        self, target_1: Sequence[float] | Array, target_2: Sequence[float] | Array, *, waited: int = 0
    ) -> MachineSample:
        """One control tick towards tip targets (3,), (3,) m; never raises: see ``faults``.

        ``waited``: periods between these targets and the last ones, less one (real time only, where messages may
        be late): the step may be larger by as many ticks.
        """
        target = self._target
        target[:3], target[3:] = target_1, target_2
        if self.faults:
            target[:] = self._axes.target
        else:
            bits = mt.check_target(
                target,
                self._axes.target,
                self._travel,
                self._jump_step * (1 + waited),
                self._speed_step * (1 + waited) * (1.0 + 1e-9),
                self._radii,
                self._overlap,
            )
            if bits:
                self._judge_target(bits, target, self._jump_step * (1 + waited))
        return self._advance(target)

    def catch_up(
        self, target_1: Sequence[float] | Array, target_2: Sequence[float] | Array, ticks: int, *, waited: int = 0
    ) -> MachineSample:
        """``ticks`` control ticks straight from the last targets to these, after a time without ticks."""
        start = self._axes.target.copy()
        way = np.concatenate([target_1, target_2]) - start
        for k in range(1, ticks):
            point = start + (k / ticks) * way
            self.tick(point[:3], point[3:], waited=waited)
        return self.tick(target_1, target_2, waited=waited)

    def hold(self) -> MachineSample:
        """One control tick with the last targets."""
        self._target[:] = self._axes.target
        return self._advance(self._target)

    def sample(self) -> MachineSample:
        """The present readings and tips."""
        axes = self._axes
        wrench_1, wrench_2 = np.zeros(6), np.zeros(6)
        wrench_1[:3], wrench_2[:3] = self._cell_1.reading, self._cell_2.reading
        tips = axes.state[:, 0].copy()
        return MachineSample(
            self.tick_count,
            self.tick_count / self.control_rate,
            wrench_1,
            wrench_2,
            tips[:3],
            tips[3:],
            axes.force_1.copy(),
            axes.force_2.copy(),
        )

    # -- load cells, shape -----------------------------------------------------------------------------

    def tare(self) -> tuple[Array, Array]:
        """Take the mean of TARE_READINGS readings as zero; returns both zeros (6,), (6,) N and N m.

        Raises
        ------
        IsfError : MACHINE_FAULTED, FORCE_LIMIT (a tool is loaded)
        """
        if self.faults:
            raise IsfError(ErrorCode.MACHINE_FAULTED, "the load cells cannot be tared", advice="call machine/reset")
        if self.loaded:
            raise IsfError(ErrorCode.FORCE_LIMIT, "a tool is loaded", advice="lift the tools clear before tare")
        zeros = []
        for cell, state in ((self._constants.cell_1, self._cell_1), (self._constants.cell_2, self._cell_2)):
            noise = np.maximum(cell.noise_floor, 0.0) * self._generator.standard_normal((TARE_READINGS, 3))
            raw = state.offset + state.drift + noise
            if cell.resolution > 0:
                raw = np.round(raw / cell.resolution) * cell.resolution
            before = state.zero.copy()
            state.zero[:] = raw.mean(axis=0)
            state.reading[:] += before - state.zero
            zeros.append(np.concatenate([state.zero, np.zeros(3)]))
        self.tared = True
        return zeros[0], zeros[1]

    @property
    def loaded(self) -> bool:
        """True when the sheet pushes on a tool with more than LARGEST_TARE_FORCE."""
        axes = self._axes
        return bool(
            max(np.abs(axes.force_1).max(initial=0.0), np.abs(axes.force_2).max(initial=0.0)) > LARGEST_TARE_FORCE
        )

    @property
    def moving(self) -> bool:
        """True when an axis is faster than 1 mm/s."""
        return bool(np.abs(self._axes.state[:, 1]).max() > 1.0e-3)

    def measured_shape(self) -> HeightMap:
        """Unloaded upper surface, 1 mm grid."""
        return self.plant.measured_shape()

    # -- faults --------------------------------------------------------------------------------------

    def latch(self, code: ErrorCode, text: str) -> None:
        """Latch a fault (once per code): from now on targets are ignored and the position is held."""
        if all(code != known for known, _ in self.faults):
            self.faults.append((code, text))

    def release(self) -> MachineSample:
        """Move the tools clear over internal ticks: forming tool up, support tool away along its measured force."""
        for _ in self.release_steps():
            pass
        return self.sample()

    def release_steps(self) -> Iterator[MachineSample]:
        """The ticks of :meth:`release`, one by one."""
        axes = self._axes
        push = axes.force_2.copy()
        size = float(np.linalg.norm(push))
        away = push / size if size > 1.0 else np.array([0.0, 0.0, -1.0])
        step = RELEASE_SPEED / self.control_rate * np.concatenate([[0.0, 0.0, 1.0], away])
        limit = np.tile(self._travel, 2)
        free_way = moved = 0.0
        while free_way < RELEASE_CLEARANCE and moved < LARGEST_RELEASE:
            yield self._advance(np.clip(axes.target + step, -limit, limit))
            touching = np.abs(axes.force_1).max() > 0.0 or np.abs(axes.force_2).max() > 0.0
            free_way = 0.0 if touching else free_way + RELEASE_SPEED / self.control_rate
            moved += RELEASE_SPEED / self.control_rate
        while self.moving:
            yield self.hold()

    def reset(self) -> None:
        """Clear latched faults and limit flags; the tools stay where they are."""
        self.faults.clear()
        self.limits = 0

    # -- state ---------------------------------------------------------------------------------------

    def state_copy(self) -> dict[str, Any]:
        """Everything that changes, for :meth:`restore`."""
        return copy.deepcopy({k: v for k, v in self.__dict__.items() if k not in _UNCHANGING})

    def restore(self, state: dict[str, Any]) -> None:
        """Go back to a state from :meth:`state_copy` of this machine."""
        self.__dict__.update(copy.deepcopy(state))

    # -- inside --------------------------------------------------------------------------------------

    def _advance(self, target: Array) -> MachineSample:
        row = self.tick_count % BLOCK
        if row == 0 or len(self._draws) == 0:
            self._draws = self._generator.standard_normal((BLOCK, 2 * DRAWS))
        plant, axes = self.plant, self._axes
        while True:
            request = mt.advance_tick(
                target,
                self._draws[row],
                axes,
                plant.surface,
                plant.track,
                plant.points,
                plant.contact,
                self._squeeze,
                self._cell_1,
                self._cell_2,
                self._constants,
            )
            if request == DONE:
                break
            plant.serve(request, axes.state[:3, 0].copy())
        self.tick_count += 1
        if axes.flags[0]:
            self._judge_forces(int(axes.flags[0]))
        return self.sample()

    def _read(self) -> None:
        """First reading of the unloaded cells, noise left out."""
        for state in (self._cell_1, self._cell_2):
            state.reading[:] = np.round(state.offset)

    def _judge_target(self, bits: int, target: Array, allowed: float) -> None:
        """Latch what is wrong with a target, and put the held target in its place."""
        if bits == mt.FAST:
            self.limits |= LIMIT_SPEED
            return
        held = self._axes.target
        if bits & mt.NOT_FINITE:
            self.latch(ErrorCode.TARGET_NOT_FINITE, f"target {_millimetres(target)} is not a position")
        if bits & mt.JUMP:
            self.limits |= LIMIT_SPEED
            steps = np.linalg.norm((target - held).reshape(2, 3), axis=1)
            self.latch(
                ErrorCode.TARGET_JUMP,
                f"target of tool {1 + int(np.argmax(steps))} jumps by {1e3 * steps.max():.3f} mm in one tick, "
                f"{1e3 * allowed:.3f} mm allowed",
            )
        if bits & mt.OUTSIDE:
            self.limits |= LIMIT_TRAVEL
            self.latch(
                ErrorCode.TARGET_OUT_OF_WORKSPACE,
                f"target {_millimetres(target)} is outside the travel of +-{_millimetres(self._travel)}",
            )
        if bits & mt.OVERLAP:
            self.latch(ErrorCode.TOOL_COLLISION, f"the tools would run into each other at {_millimetres(target)}")
        target[:] = held

    def _judge_forces(self, flags: int) -> None:
        axes = self._axes
        if flags & mt.FORCE_EXCEEDED:
            self.limits |= LIMIT_FORCE
            self.latch(
                ErrorCode.FORCE_LIMIT,
                f"force on tool 1 {np.round(axes.force_1)} N, on tool 2 {np.round(axes.force_2)} N; "
                f"limit {self._constants.force_limit} N per axis",
            )
        if flags & mt.TOOLS_TOUCH:
            self.latch(ErrorCode.TOOL_COLLISION, "the tools press through the sheet")

    def _squeeze_constants(self, constants: PlantConstants) -> SqueezeConstants:
        job, rig, material = self.job_file.job, self.job_file.rig, self.plant.material
        flow = 0.5 * constants.flow_factor * (material.yield_strength + material.tensile_strength)
        radius_1 = job.tool_1.radius
        radius_2 = job.tool_2.radius if job.tool_2 else radius_1
        return SqueezeConstants(
            present=job.tool_2 is not None,
            forming_radius=radius_1,
            support_radius=radius_2,
            stiffness=indentation_stiffness(
                radius_1, radius_2, flow * self.world.force_level, constants.indentation_factor
            ),
            memory=constants.squeeze_memory,
            thickness=self.plant.thickness,
            window=constants.window_radii * radius_1,
            forming_compliance=np.array(rig.tool_1.compliance) * self.world.compliance,
            support_compliance=np.array(rig.tool_2.compliance) * self.world.compliance,
        )


_UNCHANGING = {"job_file", "world", "_constants", "_travel", "_radii"}


def _millimetres(position: Array) -> str:
    return "(" + ", ".join(f"{1e3 * value:.3f}" for value in position) + ") mm"
