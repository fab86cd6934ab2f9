"""A controller kept in a file between two contours: another one goes on bit by bit, or says why it cannot."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from isf_core.errors import ErrorCode, IsfError
from isf_force_ctrl.control_config import ControlConfig
from isf_force_ctrl.control_state import Mode
from isf_force_ctrl.controller import ForceController
from isf_force_ctrl.kept_state import load_controller, save_controller
from isf_planner import plan
from quick_cone import quick_cone

PARK = ((0.0, 0.0, 0.1), (0.0, 0.0, -0.1))


class Formed:
    """Contours of the quick cone and a controller, on a sheet that pushes back with some noise."""

    def __init__(self) -> None:
        self.job_file = quick_cone()
        self.contours = plan(self.job_file).contours
        self.controller = self.armed(0)
        self._noise = np.random.default_rng(3)
        self._tick = 0

    def armed(self, index: int, plan_id: str = "") -> ForceController:
        controller = ForceController(ControlConfig.from_job(self.job_file))
        count = len(self.contours)
        controller.arm(plan_id or self.contours[0].plan_id, index, count, *PARK)
        return controller

    def form(self, index: int, *controllers: ForceController) -> list[list[Any]]:
        """All targets and the result of each of the ``controllers``, which get the same wrenches."""
        answers: list[list[Any]] = [[] for _ in controllers]
        for controller in controllers:
            controller.start(self.contours[index])
        while any(controller.busy for controller in controllers):
            touches = controllers[0].mode in (Mode.ENGAGE, Mode.CONTROL, Mode.POSITION)
            upper, lower = (np.array(tip) for tip in controllers[0].targets[:2])
            apart = (lower - upper)[:2] / max(1e-6, np.linalg.norm((lower - upper)[:2]))
            mean = np.array([0.0, 0.0, 300.0, 0.0, 0.0, 0.0]), np.array([*118.0 * apart, -50.0, 0.0, 0.0, 0.0])
            wrenches = [(touches * force + self._noise.normal(0.0, 1.0, 6)).tolist() for force in mean]
            self._tick += 1
            for controller, found in zip(controllers, answers, strict=True):
                found.append(controller.tick(self._tick, 0.01 * self._tick, *wrenches))
        for controller, found in zip(controllers, answers, strict=True):
            found.append(controller.take_result())
        return answers


@pytest.fixture
def formed() -> Formed:
    part = Formed()
    part.form(0, part.controller)
    return part


def test_another_controller_goes_on_bit_by_bit(formed: Formed, tmp_path: Path) -> None:
    save_controller(formed.controller, tmp_path / "state.npz")
    again = formed.armed(1)
    load_controller(again, tmp_path / "state.npz")
    assert again.targets == formed.controller.targets
    assert again.on_sheet
    for index in (1, 2):
        (*mine, here), (*theirs, there) = formed.form(index, formed.controller, again)
        assert mine == theirs
        assert here.completed == there.completed
        assert len(here.tick_time) > 100
        for name in ("forming_target", "support_target", "force_offset", "tick_normal_force"):
            np.testing.assert_array_equal(getattr(here, name), getattr(there, name))


def test_without_the_state_it_would_not_go_on_alike(formed: Formed) -> None:
    (*mine, _), (*theirs, _) = formed.form(1, formed.controller, formed.armed(1))
    assert mine != theirs


def test_only_a_controller_at_rest_is_kept(formed: Formed, tmp_path: Path) -> None:
    formed.controller.start(formed.contours[1])
    for controller in (formed.controller, ForceController(formed.controller.config)):
        with pytest.raises(IsfError) as caught:
            save_controller(controller, tmp_path / "state.npz")
        assert caught.value.code is ErrorCode.NOT_ARMED
    assert not list(tmp_path.iterdir())


def test_a_file_of_another_plan_or_version_is_refused(formed: Formed, tmp_path: Path) -> None:
    path = tmp_path / "state.npz"
    save_controller(formed.controller, path)
    assert refusal(formed.armed(1, "another"), path) is ErrorCode.CHECKPOINT_UNUSABLE
    with np.load(path) as archive:
        arrays = {name: archive[name] for name in archive.files}
    header = json.loads(arrays["header"].tobytes())
    for change in ({"software": "0.0.1"}, {"version": 99}, {"state": {"o": {"other": {"v": 1}}}}, {"state": 7}):
        arrays["header"] = np.frombuffer(json.dumps(header | change).encode(), dtype=np.uint8)
        np.savez(path, **arrays)
        assert refusal(formed.armed(1), path) is ErrorCode.CHECKPOINT_UNUSABLE


@pytest.mark.parametrize("size", [0, 100, 10_000])
def test_a_damaged_file_is_refused(formed: Formed, size: int, tmp_path: Path) -> None:
    path = tmp_path / "state.npz"
    save_controller(formed.controller, path)
    path.write_bytes(path.read_bytes()[:size])
    assert refusal(formed.armed(1), path) is ErrorCode.CHECKPOINT_UNUSABLE
    assert refusal(formed.armed(1), tmp_path / "none.npz") is ErrorCode.FILE_NOT_FOUND


def refusal(controller: ForceController, path: Path) -> ErrorCode:
    with pytest.raises(IsfError) as caught:
        load_controller(controller, path)
    return caught.value.code


def test_a_link_in_the_way_of_the_file_is_not_followed(formed: Formed, tmp_path: Path) -> None:
    outside = tmp_path / "outside"
    outside.write_text("precious")
    (tmp_path / "state.npz.partial").symlink_to(outside)
    save_controller(formed.controller, tmp_path / "state.npz")
    assert outside.read_text() == "precious"
    load_controller(formed.armed(1), tmp_path / "state.npz")
