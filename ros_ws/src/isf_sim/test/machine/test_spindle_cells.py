"""Voltages of three cells around a spindle: equilibrium by hand, faults at their time, the same after a saved state."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from isf_core.files.job import JobFile
from isf_core.files.rig import load_rig
from isf_core.files.spindle_cells import CHANNELS, CellFault, SpindleCells
from isf_sim.machine.simulated_machine import SimulatedMachine
from isf_sim.machine.spindle_cells import SpindleCellPlant
from isf_sim.machine.state import load_machine, save_machine

PUBLISHED = load_rig("torrao2013").tool_1.spindle_cells
assert PUBLISHED is not None
EXACT = PUBLISHED.model_copy(update={"noise": 0.0, "zero_offset": 0.0, "gain_error": 0.0, "adc_bits": 32})
RATE = 500.0


def plant(cells: SpindleCells, weight: float = 0.0) -> SpindleCellPlant:
    return SpindleCellPlant(cells, weight, 1.0, RATE, (0, 0, 2, 1))


def volts(cells: SpindleCells, force: Any, tick: int = 0, weight: float = 0.0) -> np.ndarray:
    return plant(cells, weight).volts(np.asarray(force, dtype=float), tick, np.full(9, np.nan))


@pytest.mark.parametrize(
    ("force", "axial"),
    [
        ((6500.0, 0.0, 13000.0), (15363.6, -1181.8, -1181.8)),  # Torrao 2013 eq. 3.7 with the signs of eq. 3.6
        ((0.0, 6500.0, 13000.0), (4333.3, 13885.9, -5219.2)),
        ((0.0, 0.0, 1000.0), (333.3, 333.3, 333.3)),
    ],
)
def test_axial_forces_are_the_published_ones(force: tuple[float, ...], axial: tuple[float, ...]) -> None:
    found = volts(EXACT, force).reshape(3, 3) * EXACT.gain_array
    assert found[:, 2] == pytest.approx(axial, abs=0.1)
    assert found[:, :2] == pytest.approx(np.tile(np.array(force[:2]) / 3.0, (3, 1)), abs=0.1)


@given(force=st.tuples(*[st.floats(-4e3, 4e3)] * 3), weight=st.floats(0.0, 500.0))
@settings(max_examples=30, deadline=None)
def test_spindle_and_cells_are_in_equilibrium(force: tuple[float, ...], weight: float) -> None:
    """Forces and moments about the tip, of what the cells read: no matrix of the model."""
    loads = volts(EXACT, force, weight=weight).reshape(3, 3) * EXACT.gain_array
    angles = np.radians([0.0, 120.0, 240.0])
    arms = np.column_stack([0.11 * np.cos(angles), 0.11 * np.sin(angles), np.full(3, 0.28)])  # from the tip
    left = np.array(force) + [0.0, 0.0, -weight] - loads.sum(axis=0)
    assert np.abs(left).max() < 0.01
    assert np.abs(np.cross(arms, loads).sum(axis=0)).max() < 0.01  # neither tip force nor weight has a lever about it


def test_a_tool_with_its_cells_below_reads_as_one_that_is_turned() -> None:
    below = EXACT.model_copy(update={"rotation": (np.pi, 0.0, 0.0)})
    assert volts(below, (30.0, -20.0, -400.0)) == pytest.approx(volts(EXACT, (30.0, 20.0, 400.0)), abs=1e-6)


def test_offsets_noise_gains_and_range_are_those_of_the_file() -> None:
    cells = plant(PUBLISHED)
    free = np.array([cells.volts(np.zeros(3), tick, np.full(9, np.nan)) for tick in range(4000)])
    assert np.abs(free.mean(axis=0)).max() < 0.051
    assert np.ptp(free.mean(axis=0)) > 0.01
    assert free.std(axis=0) == pytest.approx(0.3e-3, rel=0.1)  # converter included: a step of 0.3 mV adds 4 %
    assert np.abs(free / (20.0 / 2**16) - np.round(free / (20.0 / 2**16))).max() < 1e-6
    pressed = cells.volts(np.array([0.0, 0.0, 6000.0]), 0, np.full(9, np.nan)) - free[0]
    ratio = pressed[2::3] * PUBLISHED.gain_array[:, 2] / 2000.0
    assert np.abs(ratio - 1.0).max() < 2e-3
    assert np.abs(ratio - 1.0).max() > 1e-4
    assert np.nanmax(volts(PUBLISHED, (60e3, 0.0, 0.0))) == 10.0


def test_readings_between_ticks_that_take_long_are_fresh_but_of_stuck_channels() -> None:
    cells, held, generator = plant(PUBLISHED), np.full(9, np.nan), np.random.default_rng(1)
    held[2] = last = 0.25
    reading = cells.volts(np.array([0.0, 0.0, 300.0]), 5, held)
    reading[2], reading[4] = last, np.nan
    again = np.array([cells.read_again(reading, held, generator) for _ in range(200)])
    assert (again[:, 2] == last).all()
    assert np.isnan(again[:, 4]).all()
    others = [0, 1, 3, 5, 6, 7, 8]
    assert again[:, others].std(axis=0) == pytest.approx(0.3e-3, rel=0.25)
    assert np.abs(again[:, others].mean(axis=0) - reading[others]).max() < 0.2e-3


@pytest.mark.parametrize("kind", ["open", "saturated", "stuck", "offset", "swapped"])
def test_a_fault_begins_at_its_time_and_hits_its_channel(kind: str) -> None:
    extra: dict[str, Any] = {"offset": {"value": 0.5}, "swapped": {"other": "x3"}}.get(kind, {})
    fault = CellFault(channel="z2", kind=kind, after=0.1, **extra)  # type: ignore[arg-type]
    sound, spoiled = plant(PUBLISHED), plant(PUBLISHED.model_copy(update={"faults": (fault,)}))
    held, place, other = np.full(9, np.nan), CHANNELS.index("z2"), CHANNELS.index("x3")
    rows = []
    for tick in range(100):
        force = np.array([0.0, 50.0, 10.0 * tick])
        rows.append((sound.volts(force, tick, held.copy()), spoiled.volts(force, tick, held)))
    assert all(np.array_equal(a, b) for a, b in rows[:50])
    a, b = rows[-1]
    hit = {place, other} if kind == "swapped" else {place}
    assert {k for k in range(9) if a[k] != b[k]} == hit
    expected = {"saturated": 10.0, "stuck": rows[50][0][place], "swapped": a[other], "open": np.nan}
    assert b[place] == pytest.approx(expected.get(kind, a[place] + 0.5), abs=3e-4, nan_ok=True)


def test_a_machine_taken_up_goes_on_with_its_stuck_channel(tmp_path: Path) -> None:
    (tmp_path / "rig.yaml").write_text(
        "based_on: torrao2013\nname: stuck\ntool_1:\n  spindle_cells:\n"
        "    faults: [{channel: z1, kind: stuck, after: 0.1 s}]\n"
    )
    text = (
        f"name: saved\npart: {{mesh: none.stl, unit: mm}}\nprocess: SPIF\nrig: {tmp_path / 'rig.yaml'}\n"
        "sheet: {material: AA1050, thickness: 1 mm}\ntool_1: {radius: 5 mm}\n"
        "path: {incremental_depth: 1 mm, point_spacing: 1 mm, feed: 40 mm/s}\n"
    )
    machine = SimulatedMachine(JobFile(text, tmp_path))
    machine.tare()
    samples = list(machine.rest_for_tare())
    assert len(samples) == 250
    path = save_machine(machine, tmp_path / "machine.npz")
    again = load_machine(path)
    for _ in range(20):
        one, two = machine.hold(), again.hold()
        assert np.array_equal(one.volts_1, two.volts_1)
        assert one.volts_1[2] == samples[50].volts_1[2]
        assert one.volts_2 is None
