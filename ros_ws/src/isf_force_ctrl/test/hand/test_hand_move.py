"""A movement by hand on the simulated machine: ramped, as long as it was asked for, and stopped by the sheet."""

from __future__ import annotations

import numpy as np
import pytest
from isf_core.errors import ErrorCode, IsfError
from isf_force_ctrl.control_state import Mode
from isf_force_ctrl.hand.hand_move import HandMove
from plant_cell import PlantCell


@pytest.fixture
def cell() -> PlantCell:
    """Both tools parked, +-100 mm from an unformed sheet."""
    return PlantCell()


def move(cell: PlantCell, tool: int, way: tuple[float, float, float], speed: float = 10e-3) -> HandMove:
    """Begin a movement along ``way`` mm."""
    floors = 0.0, -1e-3
    return cell.controller.measure(
        lambda rest: HandMove(rest, tool, 1e-3 * np.array(way), speed, touch_force=25.0, floors=floors, client="test")
    )


def motion(cell: PlantCell, targets: np.ndarray) -> tuple[float, float]:
    """Largest speed (m/s) and acceleration (m/s^2) of either tip."""
    rate = cell.config.rate
    velocity = rate * np.diff(targets, axis=0)
    speeds = np.linalg.norm(velocity.reshape(-1, 2, 3), axis=2)
    rates = np.linalg.norm(rate * np.diff(velocity, axis=0).reshape(-1, 2, 3), axis=2)
    return float(speeds.max()), float(rates.max())


@pytest.mark.parametrize("tool", [1, 2])
def test_a_step_is_exactly_as_long_as_asked_for(cell: PlantCell, tool: int) -> None:
    begin = np.array([*cell.controller.targets.tip_1, *cell.controller.targets.tip_2])
    done = move(cell, tool, (1.0, -2.0, 0.5))
    targets = cell.run()
    assert done.ended
    assert (done.code, cell.controller.mode) == (ErrorCode.OK, Mode.ARMED)
    way = targets[-1] - begin
    np.testing.assert_allclose(way.reshape(2, 3)[tool - 1], [1e-3, -2e-3, 0.5e-3], atol=1e-9)
    np.testing.assert_array_equal(way.reshape(2, 3)[2 - tool], 0.0)
    speed, acceleration = motion(cell, np.vstack([begin, targets, targets[-1:]]))
    assert speed <= 10.1e-3
    assert acceleration <= 0.8  # 0.5 m/s^2; the last tick, which ends at the very place, may differ


def test_a_fast_move_is_bounded_by_the_speed_in_free_space(cell: PlantCell) -> None:
    move(cell, 1, (50.0, 0.0, 0.0), speed=5.0)
    speed, _ = motion(cell, cell.run())
    assert speed == pytest.approx(0.06, rel=1e-3)  # 60 mm/s: rapid_speed


def test_a_stop_takes_no_longer_than_its_ramp(cell: PlantCell) -> None:
    going = move(cell, 1, (60.0, 0.0, 0.0), speed=30e-3)
    cell.run(ticks=300)
    before = len(cell.run(ticks=1))
    going.stop()
    rest = cell.run()
    changing = np.flatnonzero(np.abs(np.diff(rest, axis=0)).max(axis=1) > 0.0)
    assert before == 1
    assert going.ended
    assert len(changing) / cell.config.rate <= 0.065  # s: 30 mm/s at 0.5 m/s^2, and a tick
    assert going.left > 0.04


def test_the_sheet_is_touched_and_not_pressed(cell: PlantCell) -> None:
    """Down from 100 mm by 103 mm: the sheet stops it, with little more than the 25 N, and it can leave again."""
    going = move(cell, 1, (0.0, 0.0, -103.0), speed=30e-3)
    targets = cell.run()
    assert going.code is ErrorCode.TOUCHED
    assert "25 N" in going.message
    assert -2e-3 < targets[-1][2] < 0.0
    assert 20.0 < cell.sample.true_force_1[2] < 60.0
    near = np.flatnonzero(targets[:, 2] < 3e-3)
    assert np.abs(np.diff(targets[near, 2])).max() * cell.config.rate <= 5.05e-3
    deeper = move(cell, 1, (0.0, 0.0, -1.0))
    cell.run()
    assert deeper.code is ErrorCode.TOUCHED
    assert deeper.left > 0.99e-3
    assert cell.controller.on_sheet
    away = move(cell, 1, (0.0, 0.0, 5.0))
    cell.run()
    assert cell.controller.on_sheet  # still near
    assert (away.code, away.left) == (ErrorCode.OK, pytest.approx(0.0, abs=1e-12))
    assert abs(cell.sample.true_force_1[2]) < 1.0
    move(cell, 1, (0.0, 0.0, 30.0))
    cell.run()
    assert not cell.controller.on_sheet


def test_a_stop_from_outside_holds_the_tool_and_it_can_be_moved_on(cell: PlantCell) -> None:
    going = move(cell, 1, (60.0, 0.0, 0.0))
    cell.run(ticks=200)
    cell.controller.stop("test")
    cell.run()
    assert (going.code, cell.controller.mode) == (ErrorCode.STOPPED, Mode.HOLD)
    again = move(cell, 1, (0.0, 1.0, 0.0))
    cell.run()
    assert again.code is ErrorCode.OK
    with pytest.raises(IsfError, match="stopped: test"):  # but no contour is formed
        cell.controller.start(cell.plan.contours[0])


def test_what_moves_after_a_stop_is_watched_like_all_that_moves(cell: PlantCell) -> None:
    """Lost wrenches end it, and after them nothing moves before the controller is armed again."""
    move(cell, 1, (60.0, 0.0, 0.0))
    cell.run(ticks=200)
    cell.controller.stop("test")
    cell.run()
    again = move(cell, 1, (0.0, 60.0, 0.0))
    cell.run(ticks=200)
    assert cell.controller.fault is None  # what a node asks before it tells of lost wrenches, poses and stamps
    cell.controller.fail(ErrorCode.WRENCH_LOST, "nothing on tool_1/wrench", ticking=True)
    cell.run()
    assert (again.code, cell.controller.mode) == (ErrorCode.WRENCH_LOST, Mode.HOLD)
    with pytest.raises(IsfError, match="not possible in HOLD"):
        move(cell, 1, (0.0, 1.0, 0.0))


def test_a_tool_that_has_touched_is_lifted_in_the_end(cell: PlantCell) -> None:
    move(cell, 1, (0.0, 0.0, -103.0), speed=30e-3)
    cell.run()
    assert cell.sample.true_force_1[2] > 20.0
    assert cell.controller.on_sheet
    cell.controller.disarm()
    assert cell.run()[-1][2] == pytest.approx(0.1, abs=1e-4)  # park height of the rig
    assert cell.controller.mode is Mode.IDLE


def test_a_wrench_that_is_no_number_ends_it(cell: PlantCell) -> None:
    going = move(cell, 1, (60.0, 0.0, 0.0))
    cell.run(ticks=200)
    for tick in range(200):
        if not cell.controller.busy:
            break
        sample = cell.sample
        cell.controller.tick(sample.tick + tick, sample.time, [float("nan")] * 6, [0.0] * 6)
    assert going.ended
    assert (going.code, cell.controller.mode) == (ErrorCode.WRENCH_NOT_FINITE, Mode.HOLD)
