"""Entering a contour from the air: from the level of the contour before."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from isf_force_ctrl.controller import ForceController
from isf_force_ctrl.motion.contour_path import LENGTH, ramped
from isf_force_ctrl.motion.trajectory import ToolPath
from plant_cell import PlantCell


def ring(z: float, radius: float = 20e-3, turn: float = 0.0, forming: int = 1) -> ToolPath:
    angle = turn + np.linspace(0.0, 2.0 * np.pi, 401)
    tip = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), np.full(401, z)])
    rest = np.tile([0.0, 0.0, 0.05 if forming == 2 else -0.05], (401, 1))
    nothing = np.full(401, np.nan)
    pair = (tip, rest) if forming == 1 else (rest, tip)
    return ToolPath(*pair, np.zeros(401), nothing, np.arange(401.0), forming=forming)


@pytest.mark.parametrize("forming", [1, 2])
def test_the_begin_is_raised_to_the_contour_before_and_the_rest_is_not(forming):
    up = 1.0 if forming == 1 else -1.0
    before, path = ring(-up * 3e-3, 20.3e-3, forming=forming), ring(-up * 3.5e-3, turn=0.6, forming=forming)
    entered = ramped(path, before)
    raised = up * (entered.forming_tip - path.forming_tip)
    assert raised[0, 2] == pytest.approx(0.5e-3, abs=1e-9)
    assert (np.diff(raised[:, 2]) <= 1e-15).all()
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path.forming_tip, axis=0), axis=1))])
    assert (raised[way >= LENGTH, 2] == 0.0).all()
    assert (raised[:, :2] == 0.0).all()
    np.testing.assert_array_equal(entered.support_tip, path.support_tip)


def test_under_force_control_both_tools_are_raised_alike():
    path = replace(ring(-3.5e-3), set_point=np.full(401, 120.0))
    entered = ramped(path, ring(-3e-3))
    raised = entered.tip_1 - path.tip_1
    assert raised[0, 2] == pytest.approx(0.5e-3, abs=1e-9)
    np.testing.assert_allclose(entered.tip_2 - path.tip_2, raised, atol=1e-15)


def test_nothing_changes_where_there_is_no_step_from_the_contour_before():
    path = ring(-3e-3)
    assert ramped(path, ring(-2.5e-3)) is not path
    for before in (None, ring(-3e-3), ring(-4e-3), ring(-1e-3, radius=40e-3), ring(-1e-3, forming=2), ring(0.0)):
        assert ramped(path, before) is path


@pytest.mark.parametrize("forced", [False, True])
def test_only_contours_from_the_air_are_entered_so(forced: bool):
    cell = PlantCell(ForceController, seam_speed=5e-3)
    cell.form(2)
    third, fourth = cell.plan.contours[2], cell.plan.contours[3]
    assert fourth.force_controlled
    cell.controller.start(third)  # linked: straight down where the one before ended
    linked = cell.run()
    assert cell.controller.take_result().completed
    cell.controller.move_aside()
    cell.run()
    cell.controller.start(fourth if forced else replace(fourth, support_force=np.empty(0)))
    entered = cell.run()
    result = cell.controller.take_result()
    assert result.completed
    begin = fourth.forming_tip[0]
    near = np.hypot(*(entered[:, :2] - begin[:2]).T) < 0.3e-3
    arrived = int(np.argmax(near))
    left = arrived + int(np.argmin(near[arrived:]))
    assert entered[arrived:left, 2].min() > begin[2] + 0.3e-3
    assert entered[:, 2].min() == pytest.approx(fourth.forming_tip[:, 2].min(), abs=2e-5)
    assert linked[:, 2].min() == pytest.approx(third.forming_tip[:, 2].min(), abs=2e-5)
    if forced:  # with the support tool at its own level up to 31 N
        assert np.abs(result.tick_normal_force[result.tick_engaged] - 120.0).max() <= 10.0


def test_a_holder_and_speeds_along_the_path_stay():
    path = replace(ring(-3.5e-3), speed=np.full(401, 0.02), holder=np.full(401, 1e-3))
    entered = ramped(path, ring(-3e-3))
    np.testing.assert_array_equal(entered.speed, path.speed)
    np.testing.assert_array_equal(entered.holder, path.holder)
