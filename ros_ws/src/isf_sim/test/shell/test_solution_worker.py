"""Coarse solutions ahead of time: the same bits with and without a worker; a last bit stays a last bit."""

from __future__ import annotations

import concurrent.futures
import copy
import dataclasses
import os
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest
from isf_core.errors import ErrorCode
from isf_core.files.job import JobFile
from isf_core.files.material import load_material
from isf_core.files.rig import load_rig
from isf_core.types import Array
from isf_sim.machine.simulated_machine import SimulatedMachine
from isf_sim.machine.state import load_machine, save_machine
from isf_sim.plant_constants import PlantConstants
from isf_sim.sheet import coarse_solution, sheet_plant
from isf_sim.sheet.coarse_solution import Order
from isf_sim.sheet.control_points import (
    BEGIN,
    LEAD,
    NOTHING,
    TAKE,
    UNDER_WAY,
    ControlPoints,
    coarse_request,
    no_control_points,
)
from isf_sim.sheet.sheet_plant import SheetPlant
from isf_sim.shell.shell import Deflection, Shell
from isf_sim.shell.solution_worker import SolutionWorker

RIG, MATERIAL = load_rig("ren2018"), load_material("AA5754-O")
COARSE = PlantConstants(coarse_cell=250e-3 / 16, fine_cell=1e-3)
JOB = """
name: ahead
part: {mesh: none.stl, unit: mm}
process: SPIF
rig: ren2018
sheet: {material: AA5754-O, thickness: 1 mm}
tool_1: {radius: 5 mm}
path: {incremental_depth: 0.5 mm, point_spacing: 0.5 mm, feed: 30 mm/s}
"""


def make_plant(constants: PlantConstants = COARSE) -> SheetPlant:
    return SheetPlant(RIG.clamp, MATERIAL, 1e-3, 5e-3, 0.5e-3, RIG.tool_1.compliance, constants=constants)


def rings(depth: float, radius: float = 20e-3, step: float = 0.5e-3) -> Array:
    """(N, 3) m, tips round circles of ``radius`` m, ``step`` m apart: depths tie with the reach of a solution."""
    turn = np.arange(0.0, 2.0 * np.pi, 1e-3 / radius)
    levels = np.arange(1, round(depth / step) + 1) * step
    return np.vstack([np.column_stack([radius * np.cos(turn), radius * np.sin(turn), 0 * turn - z]) for z in levels])


def formed(plant: SheetPlant, tips: Array) -> Array:
    for tip in tips:
        plant.move(tip, np.zeros(2))
    return plant.measured_shape().z


def test_worker_changes_no_bit() -> None:
    shapes = []
    for ahead in (False, True):
        plant = make_plant()
        plant.worker.ahead = ahead
        shapes.append(formed(plant, rings(3e-3)))
    assert (shapes[0] == shapes[1]).all()


def pressed(machine: SimulatedMachine, turns: Array) -> list[Array]:
    """Wrenches of tool 1 on an arc at 4 mm depth."""
    out = []
    for turn in turns:
        tip = np.array([20e-3 * np.cos(turn), 20e-3 * np.sin(turn), -4e-3])
        out.append(machine.tick(tip, np.array([0.0, 0.0, -0.1])).wrench_1.copy())
    return out


def test_state_saved_while_a_solution_is_under_way(tmp_path: Path) -> None:
    """Copy and file go on bit by bit from a tick at which a solution was begun and not yet used."""
    machine = SimulatedMachine(JobFile(JOB, Path()), constants=COARSE)
    machine.plant.worker.ahead = True
    machine.tare()
    start = np.array([0.0, 0.0, 0.1])
    for share in np.linspace(0.0, 1.0, 900)[1:]:
        machine.tick(start + share * (np.array([20e-3, 0.0, -4e-3]) - start), -start)
    turns = np.arange(0.0, 6.0, 0.1e-3 / 20e-3)
    k = 0
    pressed(machine, turns[:200])
    while not machine.plant.points.pending[UNDER_WAY]:
        pressed(machine, turns[200 + k : 201 + k])
        k += 1
    assert k < 800
    kept = machine.state_copy()
    file = save_machine(machine, tmp_path / "state.npz")
    rest = turns[201 + k : 401 + k]
    first = pressed(machine, rest)
    taken_up = load_machine(file)
    assert np.array_equal(first, pressed(taken_up, rest))
    machine.restore(kept)
    assert np.array_equal(first, pressed(machine, rest))


def test_requests_follow_the_path_alone() -> None:
    points = no_control_points()
    assert coarse_request(points, 0.0, 0.0, 0.0, 0.0, 1e-3, 16e-3) == BEGIN
    points.pending[:2] = 1.0, LEAD
    assert coarse_request(points, 0.0, 0.0, 0.0, 0.0, 1e-3, 16e-3) == TAKE  # no law at all: it is waited for
    points = one_point()
    assert coarse_request(points, 15e-3, 0.0, 0.0, 0.0, 1e-3, 16e-3) == NOTHING
    assert coarse_request(points, 17e-3, 0.0, 0.0, 0.0, 1e-3, 16e-3) == BEGIN
    points.pending[:2] = 1.0, LEAD
    assert coarse_request(points, 18e-3, 0.0, 0.0, 0.5 * LEAD, 1e-3, 16e-3) == NOTHING
    assert coarse_request(points, 20e-3, 0.0, 0.0, 1.1 * LEAD, 1e-3, 16e-3) == TAKE
    assert coarse_request(points, 40e-3, 0.0, 0.0, 0.5 * LEAD, 1e-3, 16e-3) == TAKE


def one_point() -> ControlPoints:
    points = no_control_points()
    points.used[0] = 1
    return points


@pytest.mark.parametrize("error", [-1e-12, 1e-12])
def test_round_steps_do_not_decide_by_the_last_bit(error: float) -> None:
    """A path whose steps are as large as the reach of a solution asks for it on either side of the tie."""
    points = one_point()
    assert coarse_request(points, 0.0, 0.0, -1e-3 + error, 0.0, 1e-3, 16e-3) == BEGIN
    assert coarse_request(points, 16e-3 + error, 0.0, 0.0, 0.0, 1e-3, 16e-3) == BEGIN


def test_shape_does_not_amplify_a_picometre() -> None:
    """The tool moved by 1e-12 m: no node moves by more than 1e-9 m."""
    tips = rings(5e-3)
    moved = formed(make_plant(), tips + np.array([1e-12, 0.0, 0.0]))
    assert np.abs(moved - formed(make_plant(), tips)).max() < 1e-9


@pytest.mark.parametrize(
    "finer",
    [
        {"coarse_cell": 5e-3, "forming_cell": 2.8e-3},
        {"fresh_depth": 0.5e-3, "fresh_distance": 8e-3},
        {"fine_cell": 0.25e-3},
    ],
)
@pytest.mark.slow
def test_refinement_changes_the_depth_by_less_than_three_percent(finer: dict[str, float]) -> None:
    """Loops of a cone, 10 mm deep."""
    depths = []
    for constants in (PlantConstants(), dataclasses.replace(PlantConstants(), **finer)):
        tips = np.vstack(
            [
                rings(0.5e-3, 34e-3 - z / np.tan(np.radians(50.0))) - [0.0, 0.0, z - 0.5e-3]
                for z in np.arange(1, 21) * 0.5e-3
            ]
        )
        depths.append(float(formed(make_plant(constants), tips).min()))
    assert depths[1] == pytest.approx(depths[0], rel=0.03)


def test_copy_of_a_plant_works_on_its_own() -> None:
    plant = make_plant()
    plant.worker.ahead = True
    tips = rings(2e-3)
    formed(plant, tips[:200])
    plant.settle()
    other = copy.deepcopy(plant)
    assert (formed(plant, tips[200:]) == formed(other, tips[200:])).all()


def solution(state: float = 0.0) -> Deflection:
    return Deflection(np.full((1, 3), state), np.zeros(3), 0.0, 0, 0, True)


def test_waiting_is_counted() -> None:
    """A solution that is not ready when it is asked for is late, one that is ready is not."""
    worker, released = SolutionWorker(), threading.Event()
    worker.ahead = True

    def slow() -> Deflection:
        assert released.wait(120.0)
        return solution(1.0)

    class Asked(concurrent.futures.Future[Deflection]):
        """Lets the solution go on once its result is asked for: it cannot be there before."""

        def result(self, timeout: float | None = None) -> Deflection:
            released.set()
            return begun.result(timeout)

    worker.begin(slow)
    worker.start()
    assert worker._future is not None
    begun, worker._future = worker._future, Asked()
    found = worker.wait()
    assert found is not None
    assert found.state[0, 0] == 1.0
    assert worker.values()["late_solutions"] == 1
    assert worker.longest > 0.0
    assert worker.wait() is None
    worker.begin(solution)
    worker.start()
    assert worker._future is not None
    concurrent.futures.wait([worker._future])
    assert worker.wait() is not None
    assert worker.late == 1


def test_a_solution_starts_after_the_tick_that_begins_it() -> None:
    """Nothing runs before :meth:`start`; what was never started is found when it is asked for."""
    worker, begun = SolutionWorker(), threading.Event()
    worker.ahead = True

    def solve() -> Deflection:
        begun.set()
        return solution(3.0)

    worker.begin(solve)
    assert worker.waiting
    assert worker._future is None
    assert not begun.is_set()
    found = worker.wait()
    assert found is not None
    assert found.state[0, 0] == 3.0
    assert not worker.waiting


def test_the_next_tick_starts_a_solution_that_nobody_started() -> None:
    machine = SimulatedMachine(JobFile(JOB, Path()), constants=COARSE)
    machine.plant.worker.ahead = True
    machine.tare()
    start, k = np.array([0.0, 0.0, 0.1]), 0
    while not machine.plant.worker.waiting and k < 900:
        k += 1
        machine.tick(start + k / 900 * (np.array([20e-3, 0.0, -4e-3]) - start), -start)
    assert machine.plant.worker.waiting
    machine.hold()
    assert not machine.plant.worker.waiting
    machine.plant.settle()


def test_the_thread_takes_the_priority_that_it_is_given() -> None:
    """Not that of the thread which starts it; where the system does not permit one, it works as it is."""
    worker = SolutionWorker()
    worker.ahead = True
    worker.priority = 1
    seen = []

    def solve() -> Deflection:
        seen.append((os.sched_getscheduler(0), os.sched_getparam(0).sched_priority))
        return solution()

    worker.begin(solve)
    assert worker.wait() is not None
    worker.priority = 0
    worker.begin(solve)
    assert worker.wait() is not None
    ask = "import os; os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))"
    asked = subprocess.run([sys.executable, "-c", ask], capture_output=True, timeout=120, check=False)
    assert seen == [(os.SCHED_FIFO, 1) if asked.returncode == 0 else (os.SCHED_OTHER, 0), (os.SCHED_OTHER, 0)]
    assert worker.failed == 0


def test_a_solution_that_fails_in_its_thread_is_found_by_the_caller_and_reported() -> None:
    worker, here = SolutionWorker(), threading.get_ident()
    worker.ahead = True

    def only_here() -> Deflection:
        if threading.get_ident() != here:
            raise MemoryError("no room")
        return solution(2.0)

    worker.begin(only_here)
    found = worker.wait()
    assert found is not None
    assert found.state[0, 0] == 2.0
    assert worker.failed == 1
    failure = worker.new_failure()
    assert failure is not None
    assert failure.code is ErrorCode.SOLUTION_FAILED
    assert "MemoryError: no room" in failure.what
    assert worker.new_failure() is None


def test_a_machine_whose_thread_fails_goes_on_bit_by_bit(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every second solution breaks off in the thread after half of its work; the shape is that of a run without."""
    here, calls = threading.get_ident(), [0]

    def breaking(order: Order, shell: Shell, states: list[Array]) -> Deflection:
        if threading.get_ident() != here:
            calls[0] += 1
            if calls[0] % 2:
                coarse_solution.carry_lines(order.lines, shell, states)
                raise RuntimeError("thread lost")
        return coarse_solution.carry_out(order, shell, states)

    whole = formed(make_plant(), rings(2e-3))
    plant = make_plant()
    plant.worker.ahead = True
    monkeypatch.setattr(sheet_plant, "carry_out", breaking)
    broken = formed(plant, rings(2e-3))
    assert plant.worker.failed > 3
    assert (broken == whole).all()


def test_a_bundle_follows_what_is_put_in_place_of_its_parts() -> None:
    """A state taken back, or a sheet turned over, has other arrays: the kernels must work on these."""
    machine = SimulatedMachine(JobFile(JOB, Path()), constants=COARSE)
    machine.tare()
    start = np.array([0.0, 0.0, 0.1])
    for share in np.linspace(0.0, 1.0, 900)[1:]:
        machine.tick(start + share * (np.array([20e-3, 0.0, -2e-3]) - start), -start)
    kept = machine.state_copy()
    old = machine.plant.surface.height
    first = pressed(machine, np.arange(0.0, 0.4, 0.1e-3 / 20e-3))
    machine.restore(kept)
    assert machine.plant.surface.height is not old
    before = old.copy()
    assert np.array_equal(first, pressed(machine, np.arange(0.0, 0.4, 0.1e-3 / 20e-3)))
    assert (old == before).all()
