"""Six-axis load cells: gain, crosstalk, noise, drift, zero offset, saturation and resolution.

The cell sits above its tool (tool_1) or below it (tool_2), ``tip_distance`` from the tip; a force on the tip so gives
torques as well. Noise is drawn in blocks, so that a tick costs no call of the generator. Torques have noise, but
neither drift nor zero offset (assumed small against their range).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from isf_core.files.rig import LoadCell
from isf_core.types import Array
from numpy.typing import NDArray

from isf_sim.jit import kernel
from isf_sim.plant_constants import PlantConstants

BLOCK = 4096
"""Ticks for which noise is drawn at a time."""
DRAWS = 6
"""Normal numbers per cell and tick for the forces: three for noise, three for drift; torques take three more."""


class CellConstants(NamedTuple):
    """matrix (6, 6): gain and crosstalk; noise ratio; floor, resolution, range (6,) N and N m; drift: decay per tick
    and size of a draw N; arm m: from the cell to the tip along z (negative for a cell above its tool)."""

    matrix: Array
    noise_ratio: float
    noise_floor: Array
    resolution: Array
    range: Array
    decay: float
    draw: float
    arm: float


class CellState(NamedTuple):
    """drift (3,) N incl. the zero offset's wander; offset (6,); zero (6,) taken by tare; reading (6,) N and N m after
    tare; clipped (1,): readings in a row with a channel at the end of its range."""

    drift: Array
    offset: Array
    zero: Array
    reading: Array
    clipped: NDArray[np.int64]


def make_cell(
    cell: LoadCell,
    plant: PlantConstants,
    control_rate: float,
    gain: float,
    generator: np.random.Generator,
    *,
    weight: float = 0.0,
    above: bool = True,
) -> tuple[CellConstants, CellState]:
    """One cell with its own crosstalk and zero offset drawn from ``generator``, ``weight`` N hanging on it."""
    crosstalk = generator.uniform(-cell.crosstalk, cell.crosstalk, (3, 3))
    if cell.matrix is None:
        matrix = gain * np.eye(6)
        matrix[:3, :3] = gain * (np.eye(3) + crosstalk * (1.0 - np.eye(3)))
    else:
        matrix = gain * np.array(cell.matrix)
    deviation = plant.drift if cell.drift is None else cell.drift
    time = plant.drift_time if cell.drift_time is None else cell.drift_time
    decay = float(np.exp(-1.0 / (time * control_rate)))
    reach = np.array([*cell.force_range, *cell.torque_range])
    steps = np.array([cell.resolution] * 3 + [0.0] * 3)
    constants = CellConstants(
        matrix=matrix,
        noise_ratio=cell.noise_ratio,
        noise_floor=np.array([cell.noise_floor] * 3 + [cell.torque_noise_floor] * 3),
        resolution=steps if cell.adc_bits is None else 2.0 * reach / 2**cell.adc_bits,
        range=reach,
        decay=decay,
        draw=deviation * float(np.sqrt(1.0 - decay**2)),
        arm=-cell.tip_distance if above else cell.tip_distance,
    )
    largest = plant.zero_offset if cell.zero_offset is None else cell.zero_offset
    offset = np.concatenate([generator.uniform(-largest, largest, 3), np.zeros(3)])
    offset[2] -= weight
    return constants, CellState(np.zeros(3), offset, np.zeros(6), np.zeros(6), np.zeros(1, dtype=np.int64))


def take_zero(
    cell: CellConstants, state: CellState, readings: int, generator: np.random.Generator
) -> NDArray[np.float64]:
    """Take the mean of ``readings`` readings of the free tool as zero; returns it, (6,) N and N m."""
    noise = np.maximum(cell.noise_floor[:3], 0.0) * generator.standard_normal((readings, 3))
    raw = np.zeros((readings, 6))
    raw[:, :3] = state.offset[:3] + state.drift + noise
    steps = np.where(cell.resolution > 0, cell.resolution, 1.0)
    raw = np.where(cell.resolution > 0, np.round(raw / steps) * steps, raw)
    before = state.zero.copy()
    state.zero[:] = raw.mean(axis=0)
    state.reading[:] += before - state.zero
    return state.zero.copy()


def read_again(reading: Array, cell: CellConstants, generator: np.random.Generator) -> NDArray[np.float64]:
    """Another reading (6,) N and N m of the load that gave ``reading``: other noise on it."""
    noise = np.maximum(cell.noise_ratio * np.abs(reading), cell.noise_floor)
    again = reading + noise * generator.standard_normal(6)
    steps = np.where(cell.resolution > 0, cell.resolution, 1.0)
    return np.where(cell.resolution > 0, reading + np.round((again - reading) / steps) * steps, again)


@kernel
def read_cell(force: Array, draws: Array, torque_draws: Array, cell: CellConstants, state: CellState) -> None:
    """Reading (6,) after tare of the true ``force`` (3,) N on the tip, with normal numbers (6,) and (3,)."""
    load = np.empty(6)
    for k in range(3):
        load[k] = force[k]
    load[3], load[4], load[5] = -cell.arm * force[1], cell.arm * force[0], 0.0
    clipped = False
    for k in range(6):
        value = 0.0
        for m in range(6):
            value += cell.matrix[k, m] * load[m]
        noise = max(cell.noise_ratio * abs(value), cell.noise_floor[k])
        if k < 3:
            state.drift[k] = cell.decay * state.drift[k] + cell.draw * draws[3 + k]
            value += noise * draws[k] + state.drift[k] + state.offset[k]
        else:
            value += noise * torque_draws[k - 3]
        if abs(value) >= cell.range[k]:
            clipped = True
        value = min(max(value, -cell.range[k]), cell.range[k])
        if cell.resolution[k] > 0.0:
            value = np.round(value / cell.resolution[k]) * cell.resolution[k]
        state.reading[k] = value - state.zero[k]
    state.clipped[0] = state.clipped[0] + 1 if clipped else 0
