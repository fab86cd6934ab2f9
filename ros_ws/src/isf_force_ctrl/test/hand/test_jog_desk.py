"""Who jogs, and what a joystick asks for."""

from __future__ import annotations

from dataclasses import replace

import pytest
from isf_core.errors import ErrorCode, IsfError
from isf_force_ctrl.hand.jog_desk import JogDemand, JogDesk, Wish
from isf_force_ctrl.hand.joy_map import JoyKeys, JoyMap

STEP = JogDemand("page", True, 1, (1.0, 0.0, 0.0), 1e-3)
REST = replace(STEP, direction=(0.0, 0.0, 0.0))
GO = replace(STEP, increment=0.0)


class Clock:
    now = 100.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def desk(clock: Clock) -> JogDesk:
    return JogDesk(clock)


def test_a_key_is_one_step_however_long_it_is_held(desk: JogDesk) -> None:
    assert desk.hear(STEP) is Wish.START
    assert desk.hear(STEP) is Wish.START  # the tool was still moving before
    desk.begun()
    assert [desk.hear(STEP) for _ in range(5)] == [Wish.NOTHING] * 5
    assert desk.hear(REST) is Wish.NOTHING  # a step goes on to its end
    assert desk.hear(STEP) is Wish.START


def test_without_increment_it_moves_as_long_as_the_key_is_pressed(desk: JogDesk) -> None:
    assert desk.hear(GO) is Wish.START
    desk.begun()
    assert desk.hear(GO) is Wish.NOTHING
    assert desk.hear(replace(GO, direction=(0.0, 0.0, 0.0))) is Wish.STOP


def test_another_key_stops_before_it_moves(desk: JogDesk) -> None:
    desk.hear(GO)
    desk.begun()
    other = replace(GO, direction=(0.0, 1.0, 0.0))
    assert desk.hear(other) is Wish.STOP
    assert desk.hear(other) is Wish.START


def test_nothing_moves_without_the_button(desk: JogDesk) -> None:
    released = replace(STEP, enable=False)
    assert desk.hear(released) is Wish.NOTHING
    desk.hear(STEP)
    desk.begun()
    assert desk.hear(released) is Wish.STOP
    assert desk.owner == ""


def test_one_client_at_a_time(desk: JogDesk, clock: Clock) -> None:
    desk.hear(STEP)
    other = replace(STEP, client="joy")
    assert desk.hear(other) is Wish.TAKEN
    assert desk.hear(replace(other, direction=(0.0, 0.0, 0.0))) is Wish.NOTHING
    assert not desk.take("move_to", watched=False)
    desk.hear(replace(STEP, enable=False))
    assert desk.hear(other) is Wish.START
    assert desk.owner == "joy"


def test_who_is_silent_has_let_go_and_begins_anew_with_the_keys_up(desk: JogDesk, clock: Clock) -> None:
    desk.hear(STEP)
    desk.begun()
    clock.now += 0.149
    assert not desk.lost()
    clock.now += 0.002
    assert desk.lost()
    desk.release(lost=True)
    assert desk.hear(STEP) is Wish.LET_GO  # the messages are back, with the key still down
    assert desk.hear(REST) is Wish.NOTHING
    assert desk.hear(STEP) is Wish.START


def test_a_movement_without_a_watched_client_is_never_lost(desk: JogDesk, clock: Clock) -> None:
    assert desk.take("move_to", watched=False)
    clock.now += 60.0
    assert not desk.lost()
    assert desk.hear(STEP) is Wish.TAKEN


@pytest.mark.parametrize("direction", [(float("nan"), 0.0, 0.0), (float("inf"), 0.0, 0.0), (0.0, 0.0, 0.0)])
def test_what_is_no_direction_moves_nothing(desk: JogDesk, direction: tuple[float, float, float]) -> None:
    assert desk.hear(replace(STEP, direction=direction)) is Wish.NOTHING


KEYS = JoyKeys.of("-1 -0 4", 4, 0, 2, 1)


def buttons(*down: int) -> list[int]:
    return [int(k in down) for k in range(8)]


def test_a_stick_is_a_key_with_hysteresis() -> None:
    joy = JoyMap(KEYS)

    def direction(*axes: float) -> tuple[float, float, float]:
        return joy.demand(axes, buttons(4)).direction

    assert direction(0.0, 0.5, 0, 0, 0.0) == (0.0, 0.0, 0.0)
    assert direction(0.0, 0.7, 0, 0, 0.0) == (-1.0, 0.0, 0.0)  # axis 1, turned round, is x
    assert direction(0.0, 0.4, 0, 0, 0.0) == (-1.0, 0.0, 0.0)
    assert direction(0.0, 0.2, 0, 0, 0.0) == (0.0, 0.0, 0.0)
    assert direction(-1.0, 0.0, 0, 0, 1.0) == (0.0, 1.0, 1.0)
    assert direction(float("nan"), 0.0) == (0.0, 0.0, 0.0)  # of a device without the fifth axis


def test_increment_and_tool_are_chosen_by_buttons_while_the_dead_mans_is_held() -> None:
    joy = JoyMap(KEYS)
    assert (joy.increment, joy.tool) == (1e-3, 1)
    joy.demand([], buttons(1))
    assert joy.increment == 1e-3, "without the dead man's button"
    joy.demand([], buttons(4))
    chosen = []
    for _ in range(5):
        chosen.append(joy.demand([], buttons(4, 1)).increment)
        joy.demand([], buttons(4, 1))  # held: not another time
        joy.demand([], buttons(4))
    assert chosen == [10e-3, 0.0, 0.0, 0.0, 0.0]
    for _ in range(9):
        joy.demand([], buttons(4, 2))
        joy.demand([], buttons(4))
    assert joy.increment == 0.01e-3
    assert joy.demand([], buttons(4, 0)).tool == 2
    assert not joy.demand([1.0] * 5, buttons()).enable
    assert not joy.demand([1.0] * 5, []).enable


@pytest.mark.parametrize("text", ["", "0 1", "0 1 2 3", "x y z"])
def test_axes_that_are_none_are_refused(text: str) -> None:
    with pytest.raises(IsfError) as refused:
        JoyKeys.of(text, 4, 0, 2, 1)
    assert refused.value.code == ErrorCode.FILE_FIELD


def test_a_receiver_that_stood_still_counts_the_silence_anew(desk: JogDesk, clock: Clock) -> None:
    desk.hear(GO)
    clock.now += 0.4
    desk.not_served()
    assert not desk.lost()
    clock.now += 0.14
    assert not desk.lost()
    clock.now += 0.02
    assert desk.lost()
