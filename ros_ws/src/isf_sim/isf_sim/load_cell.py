"""Load cells: gain, crosstalk, noise, drift, zero offset, saturation and resolution.

Torques are not modelled (zero). Noise is drawn in blocks, so that a tick costs no call of the generator.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from isf_core.rig import LoadCell
from numpy.typing import NDArray

from isf_sim.jit import kernel
from isf_sim.plant_constants import PlantConstants

Array = NDArray[np.float64]

BLOCK = 4096
"""Ticks for which noise is drawn at a time."""
DRAWS = 6
"""Normal numbers per cell and tick: three for noise, three for drift."""


class CellConstants(NamedTuple):
    """matrix (3, 3): gain and crosstalk; noise ratio; floor, resolution N; range (3,) N; drift: decay per tick and
    size of a draw N."""

    matrix: Array
    noise_ratio: float
    noise_floor: float
    resolution: float
    range: Array
    decay: float
    draw: float


class CellState(NamedTuple):
    """drift (3,) N incl. the zero offset's wander; offset (3,) N; zero (3,) N taken by tare; reading (3,) N."""

    drift: Array
    offset: Array
    zero: Array
    reading: Array


def make_cell(
    cell: LoadCell, plant: PlantConstants, control_rate: float, gain: float, generator: np.random.Generator
) -> tuple[CellConstants, CellState]:
    """One cell with its own crosstalk and zero offset drawn from ``generator``."""
    crosstalk = generator.uniform(-cell.crosstalk, cell.crosstalk, (3, 3))
    matrix = gain * (np.eye(3) + crosstalk * (1.0 - np.eye(3)))
    decay = float(np.exp(-1.0 / (plant.drift_time * control_rate)))
    constants = CellConstants(
        matrix=matrix,
        noise_ratio=cell.noise_ratio,
        noise_floor=cell.noise_floor,
        resolution=cell.resolution,
        range=np.array(cell.force_range),
        decay=decay,
        draw=plant.drift * float(np.sqrt(1.0 - decay**2)),
    )
    offset = generator.uniform(-plant.zero_offset, plant.zero_offset, 3)
    return constants, CellState(np.zeros(3), offset, np.zeros(3), np.zeros(3))


@kernel
def read_cell(force: Array, draws: Array, cell: CellConstants, state: CellState) -> None:
    """Reading (3,) N, after tare, of the true ``force`` (3,) N with normal numbers ``draws`` (6,)."""
    for k in range(3):
        state.drift[k] = cell.decay * state.drift[k] + cell.draw * draws[3 + k]
        value = cell.matrix[k, 0] * force[0] + cell.matrix[k, 1] * force[1] + cell.matrix[k, 2] * force[2]
        value += max(cell.noise_ratio * abs(value), cell.noise_floor) * draws[k] + state.drift[k] + state.offset[k]
        value = min(max(value, -cell.range[k]), cell.range[k])
        if cell.resolution > 0.0:
            value = np.round(value / cell.resolution) * cell.resolution
        state.reading[k] = value - state.zero[k]
