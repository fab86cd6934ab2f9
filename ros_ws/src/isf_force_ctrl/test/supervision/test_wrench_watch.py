"""Signals that lie: frozen, in other axes, of the wrong sign; and contours that do not join."""

from dataclasses import replace
from itertools import count

import numpy as np
import pytest
from contact_sandbox import make_config, ring, run, spiral
from isf_core.errors import ErrorCode, IsfError
from isf_force_ctrl import ForceController, Mode
from isf_force_ctrl.supervision.wrench_receiver import WrenchFrames
from isf_force_ctrl.supervision.wrench_watch import WrenchWatch

ROWS = ([4e-5 * k, 0.0, 0.0, 4e-5 * k, 0.0, 0.0] for k in count())
"""Tips of both tools along x, 20 mm/s at 500 Hz."""


def test_tools_brake_50_ms_after_a_wrench_has_frozen_and_go_on_when_it_is_back():
    kept, tips, doubted, stood = {}, [], [], []

    def freeze(tick, controller, wrench_1, wrench_2):
        tips.append(np.array(controller.targets.tip_1))
        if controller.mode is Mode.CONTROL:
            kept.setdefault("tick", tick + 200)  # well under way
        since = tick - kept.get("tick", np.inf)
        if 0 <= since < 100:  # 0.2 s: too short for a fault
            kept.setdefault("wrench", list(wrench_2))
            if controller.repeating:
                doubted.append(since)
            if np.linalg.norm(tips[-1] - tips[-2]) == 0.0:
                stood.append(since)
            return wrench_1, list(kept["wrench"])
        return wrench_1, wrench_2

    outcome = run([ring(0, 1, radius=25e-3)], make_config(), on_tick=freeze)
    result = outcome.results[-1]
    assert (result.completed, result.code) == (True, 0)
    assert doubted[0] <= 25, "0.05 s at 500 Hz"
    assert stood, "and they stand before it is back"
    assert outcome.controller.repeating == 0


@pytest.mark.parametrize("each", [1, 5])
def test_a_cell_of_coarse_steps_or_slower_than_its_driver_makes_no_tool_stand(each):
    watch, random, still = WrenchWatch(make_config()), np.random.default_rng(1), [0.0] * 6
    for reading in range(4000 // each):
        value = [*(4.0 * np.round(30.0 + 0.3 * random.standard_normal(3))), 0.0, 0.0, 0.0]
        for _ in range(each):
            assert watch.check(list(value), still, 1, Mode.CONTROL, 120.0, next(ROWS)) is None
            assert watch.repeating == 0 or reading < 100, "what is usual for it is learned"


@pytest.mark.parametrize(
    ("mode", "speed", "doubted"),
    [
        (Mode.APPROACH, 20e-3, True),  # pressed into a sheet that has sprung up
        (Mode.ENGAGE, 20e-3, True),
        (Mode.CONTROL, 20e-3, True),
        (Mode.ENGAGE, 0.0, False),  # waits for the support tool: a cell without noise reads the same
        (Mode.CONTROL, 0.5e-3, False),
        (Mode.LIFT, 20e-3, False),  # the way out of the sheet, whatever the cell says
    ],
)
def test_a_reading_that_repeats_is_doubted_where_its_tool_moves_into_the_sheet_or_along_it(mode, speed, doubted):
    watch = WrenchWatch(make_config())
    for tick in range(25):  # 0.05 s at 500 Hz
        row = [0.0, 0.0, -speed * tick / 500.0, 0.0, 0.0, 0.0]
        assert watch.check([0.0, 0.0, 300.0, 0.0, 0.0, 0.0], [0.0] * 6, 1, mode, 0.0, row) is None
    assert watch.repeating == (1 if doubted else 0)


@pytest.mark.parametrize("tool", [1, 2])
def test_a_frozen_wrench_holds(tool):
    kept = {}

    def freeze(tick, controller, wrench_1, wrench_2):
        wrenches = [wrench_1, wrench_2]
        if controller.mode is Mode.CONTROL:
            kept.setdefault("wrench", list(wrenches[tool - 1]))
            kept.setdefault("tick", tick)
        if kept:
            wrenches[tool - 1] = list(kept["wrench"])
        return wrenches

    outcome = run([ring(0, 1, radius=25e-3)], make_config(), on_tick=freeze)
    result = outcome.results[-1]
    assert (result.completed, result.code) == (False, ErrorCode.WRENCH_FROZEN)
    assert f"tool_{tool}/wrench" in result.message
    assert outcome.controller.mode is Mode.HOLD
    # found within 0.3 s, and braked
    assert result.end <= kept["tick"] / 500.0 + 0.3 + 0.2


def test_noise_and_unloaded_cells_are_not_frozen():
    watch = WrenchWatch(make_config())
    random = np.random.default_rng(0)
    still = [0.0] * 6
    for _ in range(5000):
        loaded = [*np.round(120.0 + 1.2 * random.standard_normal(3)), 0.0, 0.0, 0.0]
        assert watch.check(loaded, still, 1, Mode.CONTROL, 120.0, next(ROWS)) is None


def test_a_reading_that_is_used_again_is_not_frozen():
    # by the clock, while no new message comes: that is a lost signal, and told as one
    watch, kept = WrenchWatch(make_config()), [(0.0, 0.0, 100.0, 0.0, 0.0, 0.0)] * 2
    assert all(watch.check(*kept, 1, Mode.CONTROL, 120.0, next(ROWS)) is None for _ in range(1000))
    found = [
        watch.check([0.0, 0.0, 100.0, 0.0, 0.0, 0.0], kept[1], 1, Mode.CONTROL, 120.0, next(ROWS)) for _ in range(200)
    ]
    assert found[-1][0] is ErrorCode.WRENCH_FROZEN


def test_a_normal_force_of_the_wrong_sign_holds():
    def turned(_, controller, wrench_1, wrench_2):
        return wrench_1, [-value for value in wrench_2]

    outcome = run([ring(0, 1)], make_config(), on_tick=turned)
    result = outcome.results[-1]
    assert (result.completed, result.code) == (False, ErrorCode.LOAD_CELL_SIGN)
    assert "support tool_2" in result.message
    # the loop pushes while it is not noticed: far less than to the offset limit
    assert outcome.force.max() < 250.0


@pytest.mark.parametrize(("forming", "wrong"), [(1, -1.0), (2, 1.0)])
def test_an_axial_force_of_the_wrong_sign_holds(forming, wrong):
    def turned(_, controller, wrench_1, wrench_2):
        wrenches = [wrench_1, wrench_2]
        if controller.mode is Mode.POSITION:
            wrenches[forming - 1][2] = wrong * (300.0 + np.random.default_rng().standard_normal())
        return wrenches

    contour = ring(0, 1, force=None)
    if forming == 2:
        from contact_sandbox import mirrored

        contour = mirrored(contour)
    result = run([contour], make_config(), on_tick=turned, forming_tool=forming).results[-1]
    assert (result.completed, result.code) == (False, ErrorCode.LOAD_CELL_SIGN)
    assert f"forming tool_{forming}" in result.message


def test_short_tension_is_no_wrong_sign():
    watch = WrenchWatch(make_config())
    for tick in range(400):
        fz = -60.0 - tick % 3 if tick % 50 < 40 else 5.0  # 80 ms at a time
        assert watch.check([0, 0, fz, 0, 0, 0], [0] * 6, 1, Mode.POSITION, 0.0, next(ROWS)) is None


def test_frames():
    """The axes of "cell" are known, those of "flange" no longer, of others never."""

    def turned(frame, stamp, wrench):
        if frame == "cell":
            return (*wrench[1:3], wrench[0], *wrench[3:])
        code = ErrorCode.POSE_LOST if frame == "flange" else ErrorCode.WRENCH_FRAME
        raise IsfError(code, f"what is said of {frame}")

    frames = WrenchFrames("sheet", turned)
    frames.check([1, 2])
    wrench = (1.0, 2.0, 3.0, 0.0, 0.0, 0.0)
    assert frames.in_sheet(1, "sheet", 5, wrench) is wrench
    assert frames.in_sheet(2, "cell", 5, wrench)[:3] == (2.0, 3.0, 1.0)
    frames.check([1, 2])
    for frame, code in (("tool0", ErrorCode.WRENCH_FRAME), ("flange", ErrorCode.POSE_LOST)):
        assert frames.in_sheet(2, frame, 5, wrench) is None
        frames.check([1])
        with pytest.raises(IsfError, match=f"tool_2/wrench .* what is said of {frame}") as caught:
            frames.check([1, 2])
        assert caught.value.code == code
    frames.in_sheet(2, "sheet", 5, wrench)
    frames.check([1, 2])


def test_an_open_contour_that_does_not_join_is_refused():
    turns = spiral(3)
    controller = ForceController(make_config())
    outcome = run(turns[:1], make_config())
    controller = outcome.controller
    shift = np.array([0.0, 8e-3, 0.0])
    far = replace(
        turns[1],
        contact=turns[1].contact + shift,
        forming_tip=turns[1].forming_tip + shift,
        support_tip=turns[1].support_tip + shift,
    )
    with pytest.raises(IsfError, match=r"8\.\d mm from the end") as caught:
        controller.start(far)
    assert caught.value.code == ErrorCode.CONTOUR_NOT_JOINED
    # lifted on purpose it is formed, and so is the one that joins
    controller.start(replace(far, retract=True))
    assert controller.busy
