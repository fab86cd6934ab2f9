"""Springback by lifting the tool, on the simulated machine in one process and over DDS."""

from __future__ import annotations

import numpy as np
import pytest
from isf_core.errors import ErrorCode, IsfError
from isf_force_ctrl import Mode
from isf_force_ctrl.controller import ForceController
from isf_force_ctrl.measurements.tool_lift import LiftSettings, lift_tool
from plant_cell import PlantCell

SETTINGS = LiftSettings(speed=5e-3, zero_force=5.0, max_lift=8e-3)


@pytest.fixture(scope="module")
def formed() -> PlantCell:
    """Six contours of the cone, tools in contact under force control."""
    cell = PlantCell(ForceController)
    cell.form(6)
    return cell


@pytest.fixture
def cell(formed):
    """The formed part again: each test leaves tools and sheet as they were."""
    state = formed.machine.state_copy()
    controller = formed.controller
    yield formed
    if controller.mode is Mode.FREEZE:
        formed.machine.restore(state)
        formed.sample = formed.machine.sample()


def true_springback(cell: PlantCell) -> float:
    """m, rise of the tip (its own compliance included) at which the machine's true axial force vanishes."""
    state = cell.machine.state_copy()
    targets = cell.controller.targets
    tip_1, tip_2 = np.array(targets.tip_1), np.array(targets.tip_2)
    away = -2e-3 * cell.plan.contours[5].normal[0]
    for share in np.linspace(0.0, 1.0, 500):
        cell.machine.tick(tip_1, tip_2 + share * away)
    for _ in range(100):
        sample = cell.machine.hold()
    begin, force = sample.tip_1[2], sample.true_force_1[2]
    while sample.true_force_1[2] > 0.0:
        tip_1[2] += 4e-6
        sample = cell.machine.tick(tip_1, tip_2 + away)
    cell.machine.restore(state)
    return float(sample.tip_1[2] - begin - 1e-7 * force)


def test_springback_is_found_and_the_tools_return_to_their_place(cell):
    truth, shape = true_springback(cell), cell.machine.measured_shape()
    found = []
    for _ in range(4):
        before = cell.controller.targets
        lift = lift_tool(cell.controller, SETTINGS)
        targets = cell.run()
        assert (lift.code, lift.message, cell.controller.mode) == (ErrorCode.OK, "", Mode.FREEZE)
        # back where it was, within what the offsets still had to settle
        assert targets[-1] == pytest.approx([*before.tip_1, *before.tip_2], abs=1e-6)
        assert np.abs(np.diff(targets, axis=0)).max() * 500.0 <= 5e-3 + 1e-4
        assert np.abs(np.diff(targets, 2, axis=0)).max() * 500.0**2 <= 0.2
        found.append(lift.record().springback)
    # Ren 2018, 4.2.2: within 0.3 mm, standard deviation below 20 um; here the deviation is the load cell's noise
    assert np.mean(found) == pytest.approx(truth, abs=0.3e-3)
    assert np.std(found) < 50e-6
    assert np.nanmax(np.abs(cell.machine.measured_shape().z - shape.z)) < 1e-6  # no mark
    force = lift.record()
    assert force.lift_force.max() == pytest.approx(force.force, rel=0.1)
    assert np.ptp(force.lift_z) == pytest.approx(force.springback, rel=0.3)


def test_forming_goes_on_after_a_lift():
    cell = PlantCell(ForceController)
    cell.form(3)
    lift_tool(cell.controller, SETTINGS)
    cell.run()
    cell.controller.start(cell.plan.contours[3])
    targets = cell.run()
    assert cell.controller.take_result().completed
    assert np.abs(np.diff(targets, axis=0)).max() * 500.0 <= 0.1  # the rig's speed: nothing jumps


def test_a_lift_that_is_too_short_is_reported_and_returns(cell):
    before = cell.controller.targets
    lift = lift_tool(cell.controller, LiftSettings(5e-3, 5.0, 0.3e-3))
    targets = cell.run()
    assert lift.code is ErrorCode.MEASUREMENT_FAILED
    assert "max_lift" in lift.message
    assert np.isnan(lift.record().springback)
    assert targets[-1] == pytest.approx([*before.tip_1, *before.tip_2], abs=1e-6)
    assert targets[:, 2].max() - before.tip_1[2] == pytest.approx(0.3e-3, abs=1e-6)


def test_a_tool_that_is_free_at_once_tells_nothing(cell):
    """Before the force is averaged once, as after a support tool under the blank that carried the sheet."""
    lift = lift_tool(cell.controller, SETTINGS)
    targets = cell.controller.targets
    for tick in range(2000):
        axial = 0.0 if lift.phase in ("lifting", "returning") else 6.0
        lift.step(0.002 * tick, targets, (0.0, 0.0, axial, 0.0, 0.0, 0.0))
        if lift.ended:
            break
    assert lift.ended
    assert lift.code is ErrorCode.MEASUREMENT_FAILED
    assert "the force was gone after 0.0" in lift.message
    assert np.isnan(lift.record().springback)
    assert lift.record().force == pytest.approx(6.0)
    cell.run()


@pytest.mark.parametrize("ticks", [50, 350, 450, 700, 1100])
def test_cancelling_returns_from_any_phase(cell, ticks):
    before = cell.controller.targets
    lift = lift_tool(cell.controller, SETTINGS)
    cell.run(ticks)
    cell.controller.cancel()
    targets = cell.run()
    assert lift.code is ErrorCode.STOPPED
    assert not cell.controller.busy
    assert [*targets[-1]] == pytest.approx([*before.tip_1, *before.tip_2], abs=1e-6)
    assert cell.controller.mode is Mode.FREEZE


def test_refusals(cell):
    for settings in (
        LiftSettings(0.0, 5.0, 1e-3),
        LiftSettings(0.05, 5.0, 1e-3),
        LiftSettings(5e-3, -1.0, 1e-3),
        LiftSettings(5e-3, 5.0, float("nan")),
        LiftSettings(5e-3, 5.0, 1.0),
    ):
        with pytest.raises(IsfError) as caught:
            lift_tool(cell.controller, settings)
        assert caught.value.code == ErrorCode.NOT_ARMED
    assert caught.value.what == "max_lift of 1 m is not possible"
    lift_tool(cell.controller, SETTINGS)
    with pytest.raises(IsfError, match="moving"):
        lift_tool(cell.controller, SETTINGS)
    cell.run()


def test_parked_tools_are_not_lifted():
    cell = PlantCell(ForceController)
    with pytest.raises(IsfError, match="not on the sheet"):
        lift_tool(cell.controller, SETTINGS)


def test_stop_and_bad_wrench_hold_where_the_tools_are():
    cell = PlantCell(ForceController)
    cell.form(3)
    lift = lift_tool(cell.controller, SETTINGS)
    cell.run(600)
    cell.controller.stop("test")
    targets = cell.run()
    assert (lift.code, cell.controller.mode) == (ErrorCode.STOPPED, Mode.HOLD)
    assert np.abs(np.diff(targets, 2, axis=0)).max() * 500.0**2 <= 0.2
    # at rest after a stop the measurement is allowed again; a NaN wrench then holds as well
    again = lift_tool(cell.controller, SETTINGS)
    cell.run(100)
    cell.sample.wrench_1[1] = np.nan
    cell.run()
    assert (again.code, cell.controller.mode) == (ErrorCode.WRENCH_NOT_FINITE, Mode.HOLD)
    cell.controller.disarm()
    cell.run()
    assert cell.controller.mode is Mode.IDLE
    assert cell.sample.tip_1[2] == pytest.approx(cell.config.park_height, abs=1e-3)
