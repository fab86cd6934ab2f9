"""The simulated two-tool machine: one blank, two tools on servo axes, two load cells, protective limits.

With the sample of a tick (:class:`MachineSample`), the limits that protect it, the facts of a tick that events are
found in, and the release of contact after a fault. Frame ``sheet``, SI units.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from isf_core.errors import ErrorCode, IsfError
from isf_core.events import Event
from isf_core.files.job import JobFile
from isf_core.geometry.height_map import HeightMap
from isf_core.geometry.kinematics import Gantry, Kinematics
from isf_core.geometry.tool_axis import UPRIGHT, between, point_on_axis, tilt_of
from isf_core.geometry.tool_solid import tool_solid
from isf_core.simulated_sheet import SheetKind, check_sheet, default_sheet, raised_limit_text, with_raised_force_limit
from isf_core.thinned_sheet import ThinnedSheet
from isf_core.types import Array

from isf_sim.explicit_shell.formed_sheet import FormedSheet
from isf_sim.explicit_shell.library import threads
from isf_sim.legs.legs import Legs, LegState
from isf_sim.machine import tick as mt
from isf_sim.machine.arm_give import ArmGive, with_arms
from isf_sim.machine.build import make_parts
from isf_sim.machine.events import (
    BUCKLES,
    LIMITED,
    LOADED,
    NEVER,
    EventBounds,
    EventWatch,
    TickFacts,
    conditions,
    event_bounds,
    event_of,
    judge,
    settled,
    wall_strain,
)
from isf_sim.machine.kernel_bundle import UNCHECKED, TickParts
from isf_sim.machine.leg_axes import drive_axes, leg_faults
from isf_sim.machine.load_cells import BLOCK, DRAWS, CellState, read_again, take_zero
from isf_sim.machine.spindle_cells import SpindleCellPlant
from isf_sim.machine.tick import Axes
from isf_sim.machine.tool_tilt import ToolTilt
from isf_sim.plant_constants import PlantConstants
from isf_sim.scanner import SCAN_TIME, kept_by_trimming, measured_points
from isf_sim.sheet import adsif
from isf_sim.sheet.die_plant import DiePlant
from isf_sim.sheet.role import NEEDS_TURN
from isf_sim.sheet.sheet_plant import SheetPlant
from isf_sim.sheet.sheet_point import DONE, TRAVELLED
from isf_sim.sheet.squeeze import Squeeze, no_squeeze
from isf_sim.sheet.turned_sheet import pressing_tip, turn_over
from isf_sim.variant import Variant, make_variant

__all__ = ["LIMIT_FORCE", "LIMIT_SPEED", "LIMIT_TRAVEL", "MachineSample", "SimulatedMachine"]

NO_TILT = np.zeros(2)
SETTLING_TIME = 0.4
"""s, for which a machine whose legs have stopped is looked at in place of a release; a longer gap in the stamps of the
wrenches is a fault of its own."""
TARE_READINGS = 200
TARE_TICKS = 250
"""Ticks at rest of :meth:`SimulatedMachine.rest_for_tare`: as many readings as node ``load_cell`` averages."""
LARGEST_TARE_FORCE = 20.0
"""N, true force above which a tool is not free."""
LARGEST_CLIPPED = 5
"""Readings in a row at the end of a load cell's range, after which it is no measurement any more."""
HOLDER_STEP = 0.1e-3
"""m of blank holder after which the sheet is brought over the die anew."""
MAXIMUM_EVENTS = 1000
SHANK_TICKS = 50
"""Ticks between two looks at the shank of a tilted tool."""
SHANK_TOLERANCE = 1.0e-3
"""m, by which it may seem to be in the sheet: the loaded sheet lies deeper than the unloaded one that is looked at."""
THINNING_TICKS = 25
"""Ticks between two looks at the strains of the elasto-plastic sheet."""


class SimulatedMachine:
    """A machine with a fresh blank for ``job_file``, tools parked; deterministic for (job, variant, seed, blank).

    ``sheet`` None: the kind that the job gets where none is named. The machine bears what its cells overstate of the
    force.

    Attributes
    ----------
    control_rate : Hz ; tick_count : ticks since the blank was clamped ; variant : Variant
    given_file : the job as it was given ; job_file : the same on a machine that bears more
    faults : latched faults (code, text), oldest first ; limits : flags of limits hit since the last reset
    events : what happened to the part, oldest first ; tared : True after :meth:`tare`
    holder_height : m, blank holder over its start (TPIF: negative as the sheet comes down over the die)
    """

    def __init__(
        self,
        job_file: JobFile,
        *,
        variant: int = 0,
        seed: int = 0,
        blank: int = 0,
        constants: PlantConstants | None = None,
        sheet: SheetKind | None = None,
    ) -> None:
        job = job_file.job
        sheet = sheet or default_sheet(job)
        check_sheet(sheet, job)
        self.given_file = job_file
        self.job_file = job_file = with_raised_force_limit(job_file, sheet)
        rig = job_file.rig
        self.variant_number, self.seed, self.blank = variant, seed, blank
        self.variant: Variant = make_variant(variant, seed, blank)
        self.plant_constants = constants or PlantConstants()
        constants, plant_file = (
            self.variant.constants(self.plant_constants),
            with_arms(self.variant.plant_file(job_file)),
        )
        self.control_rate = job.control.rate
        self.tick_count = 0
        self.faults: list[tuple[ErrorCode, str]] = []
        self.events: list[Event] = []
        self.limits = 0
        self.tared = False
        self.holder_height = 0.0
        park_1, park_2 = np.array([0.0, 0.0, rig.park_height]), np.array([0.0, 0.0, -rig.park_height])
        self._generator = np.random.default_rng([seed % 2**63, variant])
        self._more_generator = np.random.default_rng([seed % 2**63, variant, 1])
        self._noise_between_ticks = np.random.default_rng([seed % 2**63, variant, 2])
        parts = make_parts(plant_file, self.variant, constants, park_1, self._generator)
        self.plant: SheetPlant = parts.plant
        self._support = parts.support
        self.sheet_kind: SheetKind = sheet
        self._shell: FormedSheet | None = None
        if sheet != "fast":
            plant = self.plant
            self._shell = FormedSheet(
                plant_file,
                sheet,
                plant.material,
                plant.thickness,
                self.variant,
                constants,
                plant.surface,
                parts.support,
            )
        self._constants, self._turned_constants = parts.constants
        self._cell_1, self._cell_2 = parts.cells
        self._spindle_cells = [
            SpindleCellPlant(
                tool.spindle_cells,
                tool.weight,
                self.variant.load_cell_gain,
                self.control_rate,
                (seed % 2**63, variant, 2, number),
            )
            if tool.spindle_cells is not None
            else None
            for number, tool in enumerate((plant_file.rig.tool_1, plant_file.rig.tool_2), start=1)
        ]
        self._held = np.full((2, 9), np.nan)
        self._ring = parts.adsif
        self._adsif = adsif.no_ring(self.plant.surface) if parts.adsif else None
        self._axes = mt.parked_axes(park_1, park_2, self._constants.errors)
        self._legs: Legs | None = None
        if plant_file.rig.legs is not None:
            seeds = (seed % 2**63, variant, 4)
            self._legs = Legs(plant_file.rig, self.variant, self.control_rate, park_1, job.tool_1.ball_radius, seeds)
        self._arms = ArmGive(rig, self.variant.compliance, self.control_rate)
        self._way = np.zeros((2, 3))
        self._reached: Array | None = None
        self._squeeze = no_squeeze()
        self._parts = TickParts()
        self._kinematics = rig.make_kinematics()
        self._tilt = ToolTilt()
        self._solid = tool_solid(job.tool_1)
        self._linear = all(isinstance(item, Gantry) for item in self._kinematics)
        self._watch = EventWatch(parts.event_limits)
        self._settled = NEVER
        self._travel = np.array(rig.limits.travel)
        speed_step = rig.limits.speed / self.control_rate
        lower = job.tool_2
        self._balls = (job.tool_1.ball_radius, lower.ball_radius if lower else 0.0)
        self._radii = np.array([job.tool_1.radius, lower.radius if lower else 0.0])
        flat = job.tool_1.flat_radius + (lower.flat_radius if lower else 0.0)
        # force and compliance offsets may both drive the balls towards each other
        overlap = 2.0 * rig.limits.offset
        jump_step = constants.jump_margin * speed_step
        self._target_limits = mt.TargetLimits(self._travel, jump_step, speed_step, *self._balls, overlap, flat)
        self._bounds = event_bounds(parts.event_limits, self._balls, self.plant.thickness)
        # the tick looks at targets of its own accord, where no cylinder has to be asked
        self._check_in_tick = self._linear and self._adsif is None
        self._target = np.empty(6)
        self._draws = np.empty((0, 2 * DRAWS + 6))
        self._holder_asked = 0.0
        for cell in parts.cells:
            cell.reading[:] = np.round(cell.offset)  # first reading, unloaded and without noise

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
        self,
        target_1: Sequence[float] | Array,
        target_2: Sequence[float] | Array,
        holder_height: float = 0.0,
        *,
        waited: int = 0,
        axis: Sequence[float] = UPRIGHT,
    ) -> MachineSample:
        """One control tick towards tip targets (3,), (3,) m and a blank holder height m; never raises: see ``faults``.

        ``axis`` (3,): of tool 1. ``waited``: periods between these targets and the last ones, less one (real time only,
        where messages may be late): the step may be larger by as many ticks.
        """
        target = self._target
        target[:3], target[3:] = target_1, target_2
        if axis != UPRIGHT or not self._tilt.upright:
            self._ask_tilt(axis, waited)
        if self.faults:
            target[:] = self._axes.target
        elif self._check_in_tick and holder_height == self.holder_height == self._holder_asked:
            return self._advance(target, waited)
        else:
            self._check(target, waited)
            self._move_holder(holder_height)
        return self._advance(target)

    def catch_up(
        self,
        target_1: Sequence[float] | Array,
        target_2: Sequence[float] | Array,
        ticks: int,
        holder_height: float = 0.0,
        *,
        waited: int = 0,
        axis: Sequence[float] = UPRIGHT,
    ) -> MachineSample:
        """``ticks`` control ticks straight from the last targets to these, after a time without ticks."""
        start = self._axes.target.copy()
        way = np.concatenate([target_1, target_2]) - start
        shares = np.arange(1, ticks) / ticks
        leaning = [axis] * len(shares)
        if tuple(axis) != self._tilt.asked:
            leaning = between(np.array(self._tilt.asked), np.array(axis), shares).tolist()
        for share, on_the_way in zip(shares.tolist(), leaning, strict=True):
            point = start + share * way
            self.tick(point[:3], point[3:], holder_height, waited=waited, axis=on_the_way)
        return self.tick(target_1, target_2, holder_height, waited=waited, axis=axis)

    def between_ticks(self) -> None:
        """What need not be done before the readings of a tick are out; the next tick does it otherwise."""
        self.plant.worker.start()

    def hold(self) -> MachineSample:
        """One control tick with the last targets."""
        self._target[:] = self._axes.target
        return self._advance(self._target)

    def sample(self) -> MachineSample:
        """The present readings and tips."""
        axes = self._axes
        tips = axes.state[:, 0].copy()
        return MachineSample(
            self.tick_count,
            self.tick_count / self.control_rate,
            self._cell_1.reading.copy(),
            self._cell_2.reading.copy(),
            tips[:3],
            tips[3:],
            axes.force_1.copy(),
            axes.force_2.copy(),
            self._volts(0, axes.force_1, self._tilt.turn),
            self._volts(1, axes.force_2),
            self._tilt.axis,
        )

    # -- load cells, shape -----------------------------------------------------------------------------

    def read_again(self, sample: MachineSample) -> MachineSample:
        """``sample`` with other readings of the same loads, while a tick takes long: a working cell is never still.

        May be called while a tick is computed; not repeatable, and no part of the state.
        """
        cells, draw = self._constants, self._noise_between_ticks
        return sample._replace(
            wrench_1=read_again(sample.wrench_1, cells.cell_1, draw),
            wrench_2=read_again(sample.wrench_2, cells.cell_2, draw),
            volts_1=self._volts_again(0, sample.volts_1),
            volts_2=self._volts_again(1, sample.volts_2),
        )

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
        zero_1 = take_zero(self._constants.cell_1, self._cell_1, TARE_READINGS, self._generator)
        zero_2 = take_zero(self._constants.cell_2, self._cell_2, TARE_READINGS, self._generator)
        self.tared = True
        return zero_1, zero_2

    def rest_for_tare(self) -> Iterator[MachineSample]:
        """Ticks at rest whose readings whoever reads spindle cells takes as zero; none where there are no such cells.

        What reads six-axis cells needs no time: :meth:`tare` takes their zero itself.
        """
        if any(self._spindle_cells):
            for _ in range(TARE_TICKS):
                yield self.hold()

    @property
    def legs(self) -> Legs | None:
        """Legs of the upper tool, None on a machine without."""
        return self._legs

    @property
    def loaded(self) -> bool:
        """True when the sheet pushes on a tool with more than LARGEST_TARE_FORCE."""
        axes = self._axes
        return bool(max(np.abs(axes.force_1).max(), np.abs(axes.force_2).max()) > LARGEST_TARE_FORCE)

    @property
    def moving(self) -> bool:
        """True when an axis is faster than 1 mm/s."""
        return bool(np.abs(self._axes.state[:, 1]).max() > 1.0e-3)

    def measured_shape(self) -> HeightMap:
        """Unloaded upper surface without errors of a sensor, 1 mm grid."""
        if self._adsif is not None:
            return adsif.measured_shape(self._adsif, self.plant.surface)
        if self._shell is not None:
            return self._shell.measured_shape()
        return self.plant.measured_shape()

    def released_shape(self) -> HeightMap:
        """Upper surface of the part out of the clamp and trimmed, without errors of a sensor, 1 mm grid; NaN beside it.

        It lies as it came to rest, near where it was in the clamp; the sheet in the machine stays as it is.
        Raises IsfError SHEET_NOT_RELEASED of a sheet that has no shape out of the clamp, SHEET_MODEL_FAILED.
        """
        shape = self._released()
        kept = kept_by_trimming(shape.points()[:, :2], self.plant.surface).reshape(shape.z.shape)
        return HeightMap(shape.x, shape.y, np.where(kept, shape.z, np.nan))

    def _released(self) -> HeightMap:
        shell, surface = self._shell, self.plant.surface
        if shell is None:
            raise IsfError(
                ErrorCode.SHEET_NOT_RELEASED,
                f"the sheet {'of accumulative forming' if self._adsif is not None else 'fast'} has no shape out of "
                "the clamp",
                where="scan with clamped: false",
                advice="form the part on --sheet shell_coarse, shell or shell_fine; or scan it in the clamp",
            )
        surface.formed[...] = shell.formed(surface)
        return shell.measured_shape(shell.released(surface))

    def thinned_sheet(self, shape: HeightMap) -> ThinnedSheet | None:
        """Thickness of the sheet and how much more it bears; ``shape`` is the present :meth:`measured_shape`.

        None while nothing is formed, and of accumulative forming, whose model of the sheet has no thickness.
        """
        if self._adsif is not None:
            return None
        if self._shell is not None:
            return self._shell.thinned_sheet()
        return self.plant.thinned_sheet(shape, self._constants.squeeze)

    def sheet_values(self) -> dict[str, object]:
        """What stands behind the shapes and forces of this machine, for a summary."""
        if self._shell is not None:
            return self._shell.values()
        return {
            "model": "fast",
            "elements": (len(self.plant.shell.x) - 1) * (len(self.plant.shell.y) - 1),
            "cpu_s": round(self.plant.solve_time, 2),
        }

    def sheet_proof(self) -> dict[str, object]:
        """For ``/diagnostics``: what proves that the elasto-plastic sheet is formed slowly; nothing of another one."""
        return {} if self._shell is None else {"kinetic_over_plastic": self._shell.kinetic_over_plastic}

    def measured_cloud(self, *, clamped: bool = True, duration: bool = True) -> Array:
        """(N, 3) m, unordered, as a scanner sees the sheet; see :mod:`isf_sim.scanner`.

        ``duration``: the machine waits for the 2.5 s that a scan takes, ticks at rest. Not ``clamped``: after release
        and trimming; raises IsfError as :meth:`released_shape`.
        """
        tips, surface, shell = self._axes.tips.copy(), self.plant.surface, self._shell
        if clamped and shell is not None:
            surface.formed[...] = shell.formed(surface)
        shape = self.measured_shape() if clamped else self._released()
        points = measured_points(shape, surface, tips, self._radii, self.variant, self._more_generator, clamped)
        if duration:
            for _ in range(round(SCAN_TIME * self.control_rate)):
                self.hold()
        return points

    # -- faults --------------------------------------------------------------------------------------

    def latch(self, code: ErrorCode, text: str) -> None:
        """Latch a fault (once per code): from now on targets are ignored and the position is held."""
        if all(code != known for known, _ in self.faults):
            self.faults.append((code, text))

    def release(self) -> MachineSample:
        """Move the tools clear over internal ticks: forming tool off the sheet, support tool away along its force."""
        for _ in self.release_steps():
            pass
        return self.sample()

    def release_steps(self) -> Iterator[MachineSample]:
        """The ticks of :meth:`release`, one by one."""
        if self._legs is None or self._legs.driven:
            yield from release_steps(self._axes, self._travel, self.control_rate, self._advance, self.plant.pressing)
            return
        for _ in range(round(SETTLING_TIME * self.control_rate)):  # no leg can be moved
            yield self.hold()

    def reset(self) -> None:
        """Clear latched faults and limit flags; the tools stay where they are.

        Legs that were stopped are driven again from there."""
        self.faults.clear()
        self.limits = 0
        if self._legs is not None and not self._legs.driven:
            self._legs.restart()
            self._axes.target[:3] = self._axes.state[:3, 0]

    # -- state ---------------------------------------------------------------------------------------

    def state(self) -> MachineState:
        """Everything that changes; not copied."""
        self.plant.settle()
        return MachineState(
            tick_count=self.tick_count,
            faults=self.faults,
            events=self.events,
            limits=self.limits,
            tared=self.tared,
            holder_height=self.holder_height,
            holder_asked=self._holder_asked,
            target=self._target,
            draws=self._draws,
            generator=self._generator,
            more_generator=self._more_generator,
            plant=self.plant,
            shell=self._shell,
            ring=self._adsif,
            axes=self._axes,
            squeeze=self._squeeze,
            cell_1=self._cell_1,
            cell_2=self._cell_2,
            held=self._held,
            tilt=self._tilt,
            legs=self._legs.state if self._legs is not None else None,
            way=self._way,
            arms_at=self._arms.at,
            arms_rest=self._arms.rest,
            watch=self._watch,
            settled=self._settled,
        )

    def take_up(self, state: MachineState) -> None:
        """Go on from ``state``, which is not copied."""
        self.tick_count, self.faults, self.events = state.tick_count, state.faults, state.events
        self.limits, self.tared = state.limits, state.tared
        self.holder_height, self._holder_asked = state.holder_height, state.holder_asked
        self._target, self._draws = state.target, state.draws
        self._generator, self._more_generator = state.generator, state.more_generator
        self.plant, self._adsif, self._axes, self._squeeze = state.plant, state.ring, state.axes, state.squeeze
        self._shell = state.shell
        self._cell_1, self._cell_2, self._held = state.cell_1, state.cell_2, state.held
        self._tilt, self._watch, self._settled = state.tilt, state.watch, state.settled
        self._way, self._arms.at, self._arms.rest = state.way, state.arms_at, state.arms_rest
        if self._shell is not None:
            self._shell.shell.threads = threads()  # of this computer and process, not of those that saved it
        if self._legs is not None and state.legs is not None:
            self._legs.take_up(state.legs, state.tick_count)

    def state_copy(self) -> MachineState:
        """Everything that changes, for :meth:`restore`."""
        return copy.deepcopy(self.state())

    def restore(self, state: MachineState) -> None:
        """Go back to a state from :meth:`state_copy` of this machine."""
        self.take_up(copy.deepcopy(state))

    # -- inside --------------------------------------------------------------------------------------

    def _volts(self, tool: int, force: Array, turn: Array | None = None) -> Array | None:
        plant = self._spindle_cells[tool]
        return plant.volts(force, self.tick_count, self._held[tool], turn) if plant is not None else None

    def _volts_again(self, tool: int, volts: Array | None) -> Array | None:
        plant = self._spindle_cells[tool]
        if plant is None or volts is None:
            return volts
        return plant.read_again(volts, self._held[tool], self._noise_between_ticks)

    def _ask_tilt(self, axis: Sequence[float], waited: int) -> None:
        """The axis of tool 1 goes towards ``axis``; latches why it cannot, and then it stays."""
        if self.faults:
            return
        try:
            self._tilt.ask(axis, self._kinematics[0].tilt_limit, waited)
        except IsfError as error:
            self.limits |= LIMIT_TRAVEL if error.code is ErrorCode.TARGET_OUT_OF_WORKSPACE else 0
            self.latch(error.code, error.what)

    def _check(self, target: Array, waited: int) -> None:
        bits = mt.check_target(target, self._axes.target, waited, self._target_limits)
        if bits:
            self._judge_target(bits, target, waited)
        if not self.faults and not self._reaches(target) and (finding := self._reach_fault(target)) is not None:
            self.limits |= LIMIT_TRAVEL
            self.latch(*finding)
            target[:] = self._axes.target
        elif not self.faults and self._arms.present and not self._reaches(target):
            self._reached = target.copy()

    def _reach_fault(self, target: Array) -> Finding | None:
        """TARGET_OUT_OF_WORKSPACE when an axis cannot make the tips of ``target`` (6,) m with the tool's axis asked."""
        axis = self._tilt.asked
        return reach_fault(self._kinematics, target, None if axis == UPRIGHT else np.array(axis), self._balls[0])

    def _reaches(self, target: Array) -> bool:
        """False where it takes a closer look to say so."""
        if self._linear:
            return True
        if self._legs is not None:
            return self._legs.reaches(target[:3], self._asked_tilt())
        if self._reached is None or self._tilt.asked != UPRIGHT:
            return False
        return bool(np.abs(target - self._reached).max() < NEAR)

    def _asked_tilt(self) -> Array:
        """(2,) rad."""
        return NO_TILT if self._tilt.asked == UPRIGHT else tilt_of(np.array(self._tilt.asked))

    def _drive_legs(self, legs: Legs, target: Array) -> None:
        constants = self._constants
        tilt = self._asked_tilt()
        found = drive_axes(legs, target, tilt, self._axes, constants.servo, constants.errors, self.tick_count)
        if not self._tilt.upright:
            self._tilt.tell(legs.state.measured[3:5])
        for finding in leg_faults(found, legs) if found else ():
            self.latch(*finding)

    def _advance(self, target: Array, waited: int = UNCHECKED) -> MachineSample:
        if not self._tilt.upright and self._legs is None:
            self._tilt.follow(self._constants.servo)
        if self.plant.worker.waiting:
            self.between_ticks()
        before = self._axes.tips.copy() if self._shell is not None else self._axes.tips
        if self._legs is not None:
            self._drive_legs(self._legs, target)
        if self._arms.present:
            axes = self._axes
            mt.move_axes(target, axes, self._constants)
            self._arms.move(axes.tips, (axes.force_1, axes.force_2), self._tilt.state[:, 0], self._way)
        row = self.tick_count % BLOCK
        if row == 0 or len(self._draws) == 0:
            own, more = self._generator, self._more_generator
            self._draws = np.hstack([own.standard_normal((BLOCK, 2 * DRAWS)), more.standard_normal((BLOCK, 6))])
        if self._adsif is not None and self._ring is not None:
            draws, axes, surface = self._draws[row], self._axes, self.plant.surface
            outcome = mt.advance_adsif_tick(
                target, draws, axes, surface, self._adsif, self._ring, self._cell_1, self._cell_2, self._constants
            )
            cells = self._cell_1, self._cell_2
            contact, radius = self.plant.contact, self.plant.radius
            bits = conditions(False, radius, axes, surface, contact, self._squeeze, *cells, self._bounds)
            bits |= BUCKLES if outcome == adsif.BUCKLES else 0
        elif self._shell is not None:
            bits = self._advance_shell(self._shell, target, before, self._draws[row], waited)
        else:
            bits = self._advance_sheet(target, self._draws[row], waited)
        self.tick_count += 1
        if not self._tilt.upright and self.tick_count % SHANK_TICKS == 0 and self.plant.pressing == 1:
            self._check_shank()
        if bits != self._settled:
            self._check_limits()
            self._update_events(bits)
            self._settled = bits if settled(self._watch, bits) else NEVER
        return self.sample()

    def _check_shank(self) -> None:
        """Latch TOOL_COLLISION where shank or holder of the tilted tool have run into the sheet, as it is unloaded."""
        surface = self.plant.surface
        rows, columns = surface.height.shape
        x = np.asarray(surface.x0 + surface.h * np.arange(columns), dtype=np.float64)
        y = np.asarray(surface.y0 + surface.h * np.arange(rows), dtype=np.float64)
        sheet, nothing = HeightMap(x, y, surface.height), np.empty((0, 3))
        distance, place, part = self._solid.nearest(sheet, nothing, self._axes.tips[0], np.array(self._tilt.axis))
        if distance < -SHANK_TOLERANCE:
            what = f"the {self._solid.names[part]} of the tilted tool has run into the sheet at {millimetres(place)}"
            self.latch(ErrorCode.TOOL_COLLISION, what)

    def _advance_sheet(self, target: Array, draws: Array, waited: int) -> int:
        """The kernels of one tick; returns the conditions of events after it."""
        plant = self.plant
        while True:
            of_tool = self._constants if plant.pressing == 1 else self._turned_constants
            sheet = plant.surface, plant.track, plant.points, plant.contact
            tools = self._squeeze, plant.role, self._cell_1, self._cell_2, of_tool
            parts = self._axes, *sheet, *tools, self._target_limits, self._bounds
            request, answer = self._parts.advance(target, draws, waited, parts)
            if request == DONE:
                if isinstance(plant, DiePlant):
                    plant.note()
                return answer
            if request == mt.NEEDS_JUDGEMENT:
                self._judge_target(answer, target, waited)
                waited = UNCHECKED
            elif request == NEEDS_TURN:
                self._squeeze.force[:] = 0.0
                turn_over(plant, pressing_tip(self._axes.tips, 3 - plant.pressing, plant.thickness))
            else:
                plant.serve(request, pressing_tip(self._axes.tips, plant.pressing, plant.thickness))

    def _advance_shell(self, shell: FormedSheet, target: Array, before: Array, draws: Array, waited: int) -> int:
        """One tick on the elasto-plastic sheet, the tips being at ``before`` (2, 3) m; the conditions of events."""
        if waited != UNCHECKED:
            self._check(target, waited)
        axes, constants, path = self._axes, self._constants, self.plant.contact.path
        mt.move_axes(target, axes, constants)
        forming = self.plant.pressing - 1
        path[TRAVELLED] += float(np.linalg.norm(axes.tips[forming] - before[forming]))
        try:
            axes.force_1[:], axes.force_2[:] = shell.move(axes.tips)
            shell.strength.note(shell.shell, float(path[TRAVELLED]))
        except IsfError as error:
            self.latch(error.code, error.message)
            axes.force_1[:], axes.force_2[:] = shell.forces
        mt.finish_tick(draws, axes, self._cell_1, self._cell_2, constants)
        bounds = self._bounds
        gap = math.inf
        if bounds.lower > 0.0:
            self._find_forming_tool()
            upper, lower = axes.tips + np.array([[0.0, 0.0, bounds.upper], [0.0, 0.0, -bounds.lower]])
            dx, dy, dz = (upper - lower).tolist()
            gap = mt.apart(dx, dy, dz, self._target_limits.flat) - bounds.upper - bounds.lower
        if self.tick_count % THINNING_TICKS == 0:
            shell.strength.judge(shell.shell)
        turned = self.plant.pressing == 2
        axial = -float(axes.force_2[2]) if turned else float(axes.force_1[2])
        support = float(np.linalg.norm(axes.force_1 if turned else axes.force_2))
        clipped = max(int(self._cell_1.clipped[0]), int(self._cell_2.clipped[0]))
        saturated = int(axes.saturated[0])
        bits = judge(axial, support, gap, shell.strength.strain, 0.0, saturated, clipped, bounds)
        return bits | (LIMITED if axes.flags[0] else 0)

    def _find_forming_tool(self) -> None:
        """On the elasto-plastic sheet, the tool that presses harder forms: it pushes the sheet towards the other one.

        Another one does only with LOADED more than the one so far: forces ripple, and tools leave one by one.
        """
        role, watch = self.plant.role, self._watch
        push = float(self._axes.force_1[2] + self._axes.force_2[2])  # of the sheet, upwards on the upper tool
        if (-push if role.pressing[0] == 1 else push) > LOADED:
            role.pressing[0] = 3 - role.pressing[0]
            watch.engaged, watch.carrying = 0.0, False  # that was of the tool that forms now
            self._settled = NEVER

    def _check_limits(self) -> None:
        axes = self._axes
        if axes.flags[0]:
            flags, found = force_faults(axes, self._constants.force_limit, self.job_file)
            self.limits |= flags
            for finding in found:
                self.latch(*finding)

    def _update_events(self, bits: int) -> None:
        x, y, _ = self._axes.tips[self.plant.pressing - 1]
        kinds = self._watch.update(bits, float(self.plant.contact.path[TRAVELLED]), float(x), float(y))
        clipped = max(int(self._cell_1.clipped[0]), int(self._cell_2.clipped[0]))
        if kinds and len(self.events) < MAXIMUM_EVENTS:
            buckles = float(self._adsif.local[1]) if self._adsif is not None and bits & BUCKLES else math.nan
            time = self.tick_count / self.control_rate
            facts = tick_facts(
                time, self._axes, self.plant, self._squeeze, self._bounds, buckles=buckles, clipped=clipped
            )
            if self._shell is not None:
                strength = self._shell.strength
                x, y, z = strength.place.tolist()
                facts = facts._replace(strain=strength.strain, thinnest=(x, y, z))
            self.events += [event_of(kind, facts, self._watch.limits) for kind in kinds]
        if clipped >= LARGEST_CLIPPED and not self.faults:
            self.latch(
                ErrorCode.LOAD_CELL_RANGE, f"a load cell has been at the end of its range for {clipped} readings"
            )

    def _move_holder(self, height: float) -> None:
        """Bring the sheet over the die in steps, and exactly to where the holder stops."""
        stopped = height == self._holder_asked
        self._holder_asked = height
        if not math.isfinite(height):
            self.latch(ErrorCode.TARGET_NOT_FINITE, f"blank holder height {height} is not a finite height")
        elif height != self.holder_height and (
            stopped or self._shell is not None or abs(height - self.holder_height) >= HOLDER_STEP
        ):
            self.holder_height = height
            if self._shell is not None:
                self._shell.raised = -height
            elif self._support is not None and isinstance(self.plant, DiePlant):
                self.plant.rise(self._support, -height)

    def _judge_target(self, bits: int, target: Array, waited: int) -> None:
        """Latch what is wrong with a target, and put the held target in its place."""
        allowed = self._target_limits.jump * (1 + waited)
        flags, found = target_faults(bits, target, self._axes.target, allowed, self._travel)
        self.limits |= flags
        for finding in found:
            self.latch(*finding)
        if bits != mt.FAST:
            target[:] = self._axes.target


@dataclass
class MachineState:
    """Everything of a machine that changes while it runs; what is not here follows from job, variant and seed.

    A change of these fields, or of the objects in them, counts :data:`isf_sim.machine.state.VERSION` up.

    Attributes
    ----------
    tick_count, faults, events, limits, tared, holder_height : as of :class:`SimulatedMachine`
    holder_asked : m, height of the blank holder that was asked for last ; target : (6,) m, tips asked for last
    draws : noise of the present block of ticks ; generator, more_generator : of the noise after it
    plant, shell : the sheet, shell None where the fast model forms it
    ring : of accumulative forming, None in other processes
    axes, squeeze, cell_1, cell_2 : axes, sheet between the tools, load cells
    held : (2, 9) V, what stuck channels of spindle cells hold
    tilt : of tool 1 ; legs : None where the rig has none that move ; way : (2, 3) m, by which arms have given way
    arms_at, arms_rest : where their compliance was found, and what of it: of :class:`isf_sim.machine.arm_give.ArmGive`
    watch, settled : what is counted of events, and the conditions that change nothing of it
    """

    tick_count: int
    faults: list[tuple[ErrorCode, str]]
    events: list[Event]
    limits: int
    tared: bool
    holder_height: float
    holder_asked: float
    target: Array
    draws: Array
    generator: np.random.Generator
    more_generator: np.random.Generator
    plant: SheetPlant
    shell: FormedSheet | None
    ring: adsif.Adsif | None
    axes: mt.Axes
    squeeze: Squeeze
    cell_1: CellState
    cell_2: CellState
    held: Array
    tilt: ToolTilt
    legs: LegState | None
    way: Array
    arms_at: Array
    arms_rest: Array
    watch: EventWatch
    settled: int


class MachineSample(NamedTuple):
    """What the machine tells after a tick.

    Attributes
    ----------
    tick, time : number of the tick and its time, s
    wrench_1, wrench_2 : (6,) N and N m, load cells after tare
    tip_1, tip_2 : (3,) m, tips by the encoders
    true_force_1, true_force_2 : (3,) N, force of the sheet on each tool without errors of the cells
    volts_1, volts_2 : (9,) V of a tool's spindle cells, before tare; None where the rig has none
    axis_1 : (3,) unit, axis of tool 1 by the encoders
    """

    tick: int
    time: float
    wrench_1: Array
    wrench_2: Array
    tip_1: Array
    tip_2: Array
    true_force_1: Array
    true_force_2: Array
    volts_1: Array | None
    volts_2: Array | None
    axis_1: tuple[float, float, float] = UPRIGHT


Finding = tuple[ErrorCode, str]

LIMIT_TRAVEL, LIMIT_SPEED, LIMIT_FORCE = 1, 2, 4
"""Flags of limits that were hit, as in isf_msgs/msg/MachineState."""


def target_faults(bits: int, target: Array, held: Array, allowed: float, travel: Array) -> tuple[int, list[Finding]]:
    """Limit flags and faults for the ``bits`` of machine_tick.check_target.

    ``target``, ``held`` (6,) m ; ``allowed`` m in one tick ; ``travel`` (3,) m
    """
    flags, faults = 0, []
    if bits & mt.FAST:
        flags |= LIMIT_SPEED
    if bits & mt.NOT_FINITE:
        faults.append((ErrorCode.TARGET_NOT_FINITE, f"target {millimetres(target)} is not a position"))
    if bits & mt.JUMP:
        flags |= LIMIT_SPEED
        steps = np.linalg.norm((target - held).reshape(2, 3), axis=1)
        faults.append(
            (
                ErrorCode.TARGET_JUMP,
                f"target of tool {1 + int(np.argmax(steps))} jumps by {1e3 * steps.max():.3f} mm in one tick, "
                f"{1e3 * allowed:.3f} mm allowed",
            )
        )
    if bits & mt.OUTSIDE:
        flags |= LIMIT_TRAVEL
        faults.append(
            (
                ErrorCode.TARGET_OUT_OF_WORKSPACE,
                f"target {millimetres(target)} is outside the travel of +-{millimetres(travel)}",
            )
        )
    if bits & mt.OVERLAP:
        faults.append((ErrorCode.TOOL_COLLISION, f"the tools would run into each other at {millimetres(target)}"))
    return flags, faults


def reach_fault(
    kinematics: tuple[Kinematics, Kinematics], target: Array, axis: Array | None = None, radius: float = 0.0
) -> Finding | None:
    """TARGET_OUT_OF_WORKSPACE when an axis cannot make the tip of ``target`` (6,) m, else None.

    ``axis`` (3,): of tool 1, whose ball has the ``radius`` m; None: upright.
    """
    try:
        if axis is None:
            kinematics[0].positions(target[:3])
        else:
            kinematics[0].positions(point_on_axis(target[:3], axis, radius), tilt_of(axis))
        kinematics[1].positions(target[3:])
    except IsfError as error:
        return error.code, f"target {millimetres(target)}: {error.what}"
    return None


def force_faults(axes: Axes, limit: Array, job_file: JobFile) -> tuple[int, list[Finding]]:
    """Limit flags and faults, with the places of the tools, for the flags of a tick; ``limit`` (3,) N, of the job's
    machine."""
    limits, faults, flags = 0, [], int(axes.flags[0])
    tips, forces = axes.state[:, 0].reshape(2, 3), (axes.force_1, axes.force_2)
    if flags & mt.FORCE_EXCEEDED:
        limits |= LIMIT_FORCE
        told = [
            f"tool {number} at {millimetres(tip)} carries {newtons(force)}"
            for number, (tip, force) in enumerate(zip(tips, forces, strict=True), start=1)
            if np.any(np.abs(force) > limit)
        ]
        which = "" if job_file.force_raised == 1.0 else f", {raised_limit_text(job_file)}"
        faults.append((ErrorCode.FORCE_LIMIT, f"{'; '.join(told)}; the machine bears {newtons(limit)}{which}"))
    if flags & mt.TOOLS_TOUCH:
        faults.append((ErrorCode.TOOL_COLLISION, f"the tools press through the sheet at {millimetres(tips[0])}"))
    return limits, faults


def millimetres(position: Array) -> str:
    """Text "(x, y, z) mm" of a position in m."""
    return "(" + ", ".join(f"{1e3 * value:.3f}" for value in position) + ") mm"


def newtons(force: Array) -> str:
    """Text "(x, y, z) N" of a force in N."""
    return "(" + ", ".join(f"{round(value):d}" for value in force) + ") N"


def tick_facts(
    time: float, axes: Axes, plant: SheetPlant, squeeze: Squeeze, bounds: EventBounds, *, buckles: float, clipped: int
) -> TickFacts:
    """Facts after the tick at ``time`` s."""
    contact = plant.contact
    upper, lower = axes.tips.tolist()
    turned = plant.pressing == 2
    forming, support = (lower, upper) if turned else (upper, lower)
    on_forming, on_support = (axes.force_2, axes.force_1) if turned else (axes.force_1, axes.force_2)
    fx, fy, fz = on_support.tolist()
    strain, place = 0.0, np.zeros(3)
    if contact.axial[0] > 0.0:
        strain = float(wall_strain(plant.surface, contact, squeeze, plant.radius, fz, bounds, place))
    return TickFacts(
        time=time,
        forming=tuple(forming),
        support=tuple(support),
        axial=-float(on_forming[2]) if turned else float(on_forming[2]),
        support_force=math.sqrt(fx * fx + fy * fy + fz * fz),
        strain=strain,
        thinnest=(float(place[0]), float(place[1]), -float(place[2]) if turned else float(place[2])),
        buckles=buckles,
        clipped=clipped,
    )


NEAR = 1.0e-3
"""m, around tips that the arms have been found to reach, within which they are not asked again."""
RELEASE_SPEED = 20.0e-3
"""m/s, at which tools are moved clear."""
RELEASE_CLEARANCE = 3.0e-3
"""m, way beyond the loss of contact."""
LARGEST_RELEASE = 25.0e-3
"""m, a release ends here at the latest."""
AT_REST = 1.0e-3
"""m/s"""


def release_steps(
    axes: Axes, travel: Array, control_rate: float, advance: Callable[[Array], MachineSample], pressing: int = 1
) -> Iterator[MachineSample]:
    """The ticks of a release one by one, within ``travel`` (3,) m; ``advance`` makes a tick towards (6,) m.

    ``pressing``: the forming tool, 1 upper, 2 lower.
    """
    push = axes.force_2.copy() if pressing == 1 else axes.force_1.copy()
    clear = np.array([0.0, 0.0, 1.0 if pressing == 1 else -1.0])
    size = float(np.linalg.norm(push))
    away = push / size if size > 1.0 else -clear
    step = RELEASE_SPEED / control_rate * np.concatenate([clear, away] if pressing == 1 else [away, clear])
    limit = np.tile(travel, 2)
    free_way = moved = 0.0
    while free_way < RELEASE_CLEARANCE and moved < LARGEST_RELEASE:
        yield advance(np.clip(axes.target + step, -limit, limit))
        touching = np.abs(axes.force_1).max() > 0.0 or np.abs(axes.force_2).max() > 0.0
        free_way = 0.0 if touching else free_way + RELEASE_SPEED / control_rate
        moved += RELEASE_SPEED / control_rate
    while np.abs(axes.state[:, 1]).max() > AT_REST:
        yield advance(axes.target.copy())
