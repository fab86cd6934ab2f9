"""Tools lifted clear and moved aside between contours, on the simulated machine in one process."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from isf_core.errors import ErrorCode, IsfError
from isf_force_ctrl import Mode
from isf_force_ctrl.controller import ForceController
from plant_cell import PlantCell


def formed(count: int) -> PlantCell:
    cell = PlantCell(ForceController)
    cell.form(count)
    return cell


def test_the_tools_wait_at_park_height_beside_the_sheet_and_form_on():
    cell = formed(3)
    cell.controller.move_aside()
    targets = cell.run()
    config = cell.config
    assert cell.controller.mode is Mode.ARMED
    assert config.aside == (0.0, config.travel[1] - 5e-3)
    x, y = config.aside
    assert targets[-1] == pytest.approx([x, y, config.park_height, x, y, -config.park_height], abs=1e-5)
    lifted = targets[:, 2] >= config.park_height - 1e-9
    assert np.ptp(targets[~lifted][:, :2], axis=0).max() < 1e-3  # straight up before anything moves sideways
    assert not cell.machine.loaded

    cell.controller.move_aside()  # they are there already
    assert not cell.controller.busy

    cell.controller.start(cell.plan.contours[3])
    targets = cell.run()
    assert np.abs(np.diff(targets, axis=0)).max() * cell.config.rate <= 0.1  # the rig's speed: nothing jumps
    result = cell.controller.take_result()
    assert result.completed
    assert result.lost_messages == 0
    engaged = result.tick_engaged
    error = result.tick_normal_force[engaged] - result.tick_set_point[engaged]
    assert np.abs(error).mean() < 5.0
    assert result.forming_force[:, 2].mean() > 50.0


def test_tools_that_wait_over_the_sheet_are_moved_aside_without_another_lift():
    cell = PlantCell(ForceController)
    cell.controller.start(replace(cell.plan.contours[0], lift_after=True))
    lifted = cell.run()
    assert cell.controller.take_result().completed
    assert not cell.machine.loaded
    assert (lifted[-1, 2], lifted[-1, 5]) == pytest.approx((cell.config.park_height, -cell.config.park_height))
    assert lifted[-1, :2] == pytest.approx(cell.plan.contours[0].forming_tip[0, :2], abs=1e-4)
    cell.controller.move_aside()
    targets = cell.run()
    assert targets[:, 2] == pytest.approx(cell.config.park_height)
    x, y = cell.config.aside
    assert targets[-1] == pytest.approx([x, y, cell.config.park_height, x, y, -cell.config.park_height], abs=1e-5)
    cell.controller.start(cell.plan.contours[1])
    cell.run()
    assert cell.controller.take_result().completed


def test_it_is_refused_where_it_is_not_safe():
    cell = formed(2)
    cell.controller.start(cell.plan.contours[2])
    cell.run(300)
    with pytest.raises(IsfError, match="moving") as refused:
        cell.controller.move_aside()
    assert refused.value.code is ErrorCode.NOT_ARMED
    cell.controller.stop("test")
    cell.run()
    with pytest.raises(IsfError, match="held: stopped"):
        cell.controller.move_aside()


def test_a_stop_on_the_way_holds_the_tools_where_they_are():
    cell = formed(2)
    cell.controller.move_aside()
    cell.run(700)
    cell.controller.stop("test")
    targets = cell.run()
    assert cell.controller.fault == (ErrorCode.STOPPED, "stopped: test")
    assert cell.controller.mode is Mode.HOLD
    assert targets[-1][2] < cell.config.park_height
