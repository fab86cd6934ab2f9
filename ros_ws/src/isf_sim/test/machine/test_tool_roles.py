"""Both tools form: who presses is found from contact, and the lower tool forms as the upper one does, mirrored."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from isf_core.types import Array
from isf_sim.machine.simulated_machine import SimulatedMachine
from isf_sim.machine.state import load_machine, save_machine
from tool_pair import STEP, Pair, start, tips_of


def form_cone(pair: Pair, centre: Array, depth: float, opening: float = 28e-3, way: float = 0.15e-3) -> Array:
    """Both tools round a cone of 50 deg in steps of 0.5 mm; (N, 12) true forces and tips of tool 1 and tool 2."""
    rows: list[Array] = []
    first, second = tips_of(centre, opening, STEP, 0.0)
    high, low = np.array([0.0, 0.0, 8e-3]), np.array([0.0, 0.0, -8e-3])
    pair.move(np.append(pair.forming[:2], 20e-3), np.append(pair.support[:2], -20e-3))
    pair.move(first + high, second + low)
    for z in np.arange(1, round(depth / STEP) + 1) * STEP:
        pair.move(*tips_of(centre, opening, z, 0.0))
        for angle in np.arange(0.0, 2.0 * np.pi, way / opening):
            sample = pair.to(*tips_of(centre, opening, z, angle))
            rows.append(np.concatenate([sample.true_force_1, sample.true_force_2, sample.tip_1, sample.tip_2]))
    pair.move(pair.forming + high, pair.support + low)
    return np.array(rows)


@pytest.fixture(scope="module")
def both_sides() -> tuple[tuple[SimulatedMachine, Array], tuple[SimulatedMachine, Array]]:
    made = []
    for side in (1, -1):
        pair = start(side)
        rows = form_cone(pair, np.zeros(2), 3e-3)
        made.append((pair.machine, rows))
    return made[0], made[1]


def test_a_part_formed_from_below_is_the_mirror_of_one_formed_from_above(
    both_sides: tuple[tuple[SimulatedMachine, Array], tuple[SimulatedMachine, Array]],
) -> None:
    """Root mean square difference within 1 %: shapes of the part's height, forces of the largest one; 3 mm deep.

    Single nodes differ more (2 of 63001 by 1.8 %), because the plant amplifies the last bit: at 6 mm on this mesh an
    upper tool moved by 1e-15 m gives 0.030 mm root mean square against itself, as much as the mirror does.
    """
    (above, upper), (below, lower) = both_sides
    assert (above.plant.pressing, below.plant.pressing) == (1, 2)
    assert above.faults == below.faults == []
    pocket, dome = above.measured_shape().z, below.measured_shape().z
    size = np.abs(pocket).max()
    assert size > 0.3e-3
    formed = np.abs(pocket) > 0.1 * size
    assert np.sqrt(((dome + pocket)[formed] ** 2).mean()) < 0.01 * size
    assert dome == pytest.approx(-pocket, abs=0.05 * size)
    swapped = np.hstack([lower[:, 3:6], lower[:, :3]]) * np.array([1.0, 1.0, -1.0, 1.0, 1.0, -1.0])
    away = swapped - upper[:, :6]
    assert np.sqrt((away**2).mean()) < 0.01 * np.abs(upper[:, :6]).max()
    assert swapped[:, 2].mean() == pytest.approx(upper[:, 2].mean(), rel=0.01)


def test_signs_of_the_wrench_while_the_lower_tool_forms(
    both_sides: tuple[tuple[SimulatedMachine, Array], tuple[SimulatedMachine, Array]],
) -> None:
    """The sheet pushes the upper tool up and the lower one down; the squeeze sends the support tool outwards."""
    _, (_, rows) = both_sides
    last = rows[-1200:]
    assert last[:, 5].max() < -50.0
    assert last[:, 2].min() >= 0.0
    squeezed = last[np.linalg.norm(last[:, :3], axis=1) > 1.0]
    if len(squeezed):
        outward = (squeezed[:, 0:2] * (squeezed[:, 6:8] - squeezed[:, 9:11])).sum(axis=1)
        assert outward.min() > 0.0


def test_roles_change_after_the_tools_were_clear_and_each_part_stays(tmp_path: Path) -> None:
    """A pocket, then a dome beside it, then the pocket deeper; a machine saved in between goes on bit by bit."""
    pair = start(1)
    form_cone(pair, np.array([-40e-3, 0.0]), 2e-3)
    assert pair.machine.plant.pressing == 1
    below = Pair(pair.machine, Pair.mirrored(pair.support), Pair.mirrored(pair.forming), -1)
    form_cone(below, np.array([40e-3, 0.0]), 2e-3, way=0.2e-3)
    assert pair.machine.plant.pressing == 2
    shape = pair.machine.measured_shape()
    pocket, dome = shape.at(np.array([[-40e-3, 0.0], [40e-3, 0.0]]))
    # so shallow a part springs back to its bulge, upwards in a pocket and downwards in a dome
    assert pocket > 0.1e-3
    assert dome == pytest.approx(-pocket, rel=0.02)
    restored = load_machine(save_machine(pair.machine, tmp_path / "turned.npz"))
    assert restored.plant.pressing == 2
    futures = []
    for machine in (pair.machine, restored):
        again = Pair(machine, Pair.mirrored(below.support), Pair.mirrored(below.forming), 1)
        rows = form_cone(again, np.array([-40e-3, 0.0]), 1e-3, way=0.3e-3)
        assert machine.plant.pressing == 1
        assert machine.faults == []
        futures.append((rows, machine.measured_shape().z))
    assert np.array_equal(futures[0][0], futures[1][0])
    assert np.array_equal(futures[0][1], futures[1][1])


def test_release_moves_the_lower_tool_down_when_it_forms() -> None:
    pair = start(-1)
    first, second = tips_of(np.zeros(2), 28e-3, 3e-3, 0.0)
    pair.move(np.append(first[:2], 20e-3), np.append(second[:2], -20e-3))
    pair.move(first, second)
    before = pair.machine.sample()
    assert before.true_force_2[2] < -20.0
    after = pair.machine.release()
    assert (after.true_force_1 == 0.0).all()
    assert (after.true_force_2 == 0.0).all()
    assert after.tip_2[2] < before.tip_2[2]
    assert after.tip_1[2] > before.tip_1[2]
