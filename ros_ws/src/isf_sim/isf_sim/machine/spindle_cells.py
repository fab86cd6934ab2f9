"""Voltages of three tri-axial cells around a spindle, from the true force on the tip.

The spindle hangs as a rigid body on three cells and turns freely: three axial forces balance the axial force and both
moments of the force on the tip, and the cells share the horizontal force equally (Torrao 2013, 3.4.1). Gains, zero
offsets, noise, amplifier and converter of each of the nine channels follow; drift and crosstalk are left out. Noise is
that of the tick, so that nothing has to be saved but what a stuck channel holds.
"""

from __future__ import annotations

import numpy as np
from isf_core.files.spindle_cells import CHANNELS, CellFault, SpindleCells
from isf_core.types import Array

BLOCK = 4096
"""Ticks for which noise is drawn at a time."""
WEIGHT_HEIGHT = 0.5
"""Share of the height below the cells at which spindle and tool have their centre of weight (assumed)."""


class SpindleCellPlant:
    """The nine channels of one tool, deterministic for (cells, seed, variant, tool).

    Parameters
    ----------
    weight : N of spindle and tool below the cells ; gain : factor on all channels, of the variant
    rate : Hz of the ticks ; seeds : of noise, offsets and gains
    """

    def __init__(self, cells: SpindleCells, weight: float, gain: float, rate: float, seeds: tuple[int, ...]) -> None:
        self._cells, self._rate, self._seeds = cells, rate, seeds
        self._to_cells = cells.turn.T
        angles = np.radians([0.0, 120.0, -120.0])
        self._places = cells.radius * np.column_stack([np.cos(angles), np.sin(angles)])
        generator = np.random.default_rng([*seeds, 0])
        errors = generator.uniform(-cells.gain_error, cells.gain_error, (3, 3))
        self._per_newton = gain * (1.0 + errors) / cells.gain_array
        offsets = generator.uniform(-cells.zero_offset, cells.zero_offset, (3, 3))
        self._offsets, self._weight = offsets, np.array([0.0, 0.0, -weight])
        self._unloaded = self._without_contact(self._to_cells)
        self._step = 2.0 * cells.amplifier_range / 2**cells.adc_bits
        self._faults: list[tuple[CellFault, int]] = [(fault, CHANNELS.index(fault.channel)) for fault in cells.faults]
        self._block, self._noise = -1, np.empty((0, 9))

    def channel_forces(self, force: Array, height: float) -> Array:
        """(3, 3) N in the channels (rows are cells) under ``force`` (3,) N in axes of the arrangement, ``height`` m
        below it."""
        axial = force[2] / 3.0 + (2.0 * height / (3.0 * self._cells.radius**2)) * (self._places @ force[:2])
        return np.column_stack([np.tile(force[:2] / 3.0, (3, 1)), axial])

    def _without_contact(self, to_cells: Array) -> Array:
        """(3, 3) V of the channels under the weight alone, ``to_cells`` (3, 3) from frame ``sheet``."""
        return np.asarray(
            self._offsets
            + self._per_newton * self.channel_forces(to_cells @ self._weight, WEIGHT_HEIGHT * self._cells.height)
        )

    def volts(self, force: Array, tick: int, held: Array, turn: Array | None = None) -> Array:
        """(9,) V at ``tick`` under ``force`` (3,) N on the tip, axes of frame ``sheet``; NaN where a wire is broken.

        ``turn`` (3, 3) from axes of the tilted tool, whose cells tilt with it, to frame ``sheet``; None: upright.
        ``held`` (9,) V is what stuck channels hold, NaN until they are; written here.
        """
        block, row = divmod(tick, BLOCK)
        if block != self._block:
            self._noise = np.random.default_rng([*self._seeds, 1, block]).standard_normal((BLOCK, 9))
            self._block = block
        cells = self._cells
        to_cells = self._to_cells if turn is None else self._to_cells @ turn.T
        unloaded = self._unloaded if turn is None else self._without_contact(to_cells)
        load = self.channel_forces(to_cells @ force, cells.height)
        volts = (unloaded + self._per_newton * load).ravel() + cells.noise * self._noise[row]
        for fault, channel in self._faults:
            if fault.kind == "offset" and tick >= fault.after * self._rate:
                volts[channel] += fault.value
        volts = self._converted(volts)
        for fault, channel in self._faults:
            if tick < fault.after * self._rate:
                continue
            if fault.kind == "open":
                volts[channel] = np.nan
            elif fault.kind == "saturated":
                volts[channel] = cells.amplifier_range
            elif fault.kind == "stuck":
                held[channel] = volts[channel] if np.isnan(held[channel]) else held[channel]
                volts[channel] = held[channel]
            elif fault.other is not None:
                other = CHANNELS.index(fault.other)
                volts[[channel, other]] = volts[[other, channel]]
        return volts

    def read_again(self, volts: Array, held: Array, generator: np.random.Generator) -> Array:
        """(9,) V, another reading of the load that gave ``volts``; channels that are ``held`` stay."""
        again = self._converted(volts + self._cells.noise * generator.standard_normal(9))
        return np.where(np.isnan(held), again, volts)

    def _converted(self, volts: Array) -> Array:
        limit = self._cells.amplifier_range
        return np.asarray(np.round(np.clip(volts, -limit, limit) / self._step) * self._step)
