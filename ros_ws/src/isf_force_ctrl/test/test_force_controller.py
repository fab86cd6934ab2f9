"""The whole controller against the contact sandbox: parts formed, faults, order, bumpless changes of mode."""

from dataclasses import replace

import numpy as np
import pytest
from contact_sandbox import Run, make_config, ring, run
from isf_core.contour import Process
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile
from isf_force_ctrl import ControlConfig, ForceController, Mode

PARK_1, PARK_2 = (0.0, 0.0, 0.03), (0.0, 0.0, -0.03)
FREE = [0.0] * 6


def part(count=2, **changes):
    return [ring(k, count, **dict(changes)) for k in range(count)]


def engaged_error(outcome: Run, set_point=120.0):
    return outcome.force[outcome.mode == Mode.CONTROL] - set_point


def largest_step_and_acceleration(targets, rate=500.0):
    velocity = np.diff(targets.reshape(-1, 2, 3), axis=0) * rate
    acceleration = np.diff(velocity, axis=0) * rate
    return np.linalg.norm(velocity, axis=2).max(), np.linalg.norm(acceleration, axis=2).max()


@pytest.fixture(scope="module")
def formed():
    """A three-contour part with sheet force, noise and both loops on."""
    return run(part(3), make_config(compensation=1.0), sheet=lambda time, angle: 150.0 + 30.0 * np.sin(2 * angle))


def test_part_is_formed_and_parked(formed):
    assert [result.completed for result in formed.results] == [True, True, True]
    assert formed.controller.mode is Mode.IDLE
    assert formed.targets[-1] == pytest.approx([*PARK_1, *PARK_2], abs=1e-4)
    order = [mode for k, mode in enumerate(formed.mode) if k == 0 or formed.mode[k - 1] != mode]
    assert order[:4] == [Mode.APPROACH, Mode.ENGAGE, Mode.CONTROL, Mode.FREEZE]
    assert order[-2:] == [Mode.LIFT, Mode.IDLE]


def test_force_is_held_with_both_loops_on(formed):
    # Force control and compliance compensation at the same time; +-10 N, 99 % of the engaged time.
    error = engaged_error(formed)
    assert np.mean(np.abs(error) <= 10.0) >= 0.99
    assert abs(error.mean()) < 3.0  # inside the dead zone


def test_targets_keep_speed_and_acceleration(formed):
    # Path: 0.06 m/s and 0.5 m/s^2. Compliance offset: slew 7 mm/s per axis; its acceleration is that slew over the
    # duration of the FIR (10 ms), twice for a reversal, both axes: 2 m/s^2. Force offset: K_i * slew of the error
    # = 0.19 m/s^2; turning with d_n adds less than 0.1.
    speed, acceleration = largest_step_and_acceleration(formed.targets)
    assert speed <= 0.06 + 0.01
    assert acceleration <= 0.5 + 2.0 + 0.3


def test_result_describes_the_contour(formed):
    result = formed.results[1]
    count = len(ring())
    for name in ("forming_force", "support_force", "forming_target", "support_target", "compliance_offset"):
        assert getattr(result, name).shape == (count, 3)
        assert np.isfinite(getattr(result, name)).all()
    ticks = len(result.tick_time)
    assert result.tick_set_point.shape == result.tick_normal_force.shape == result.tick_engaged.shape == (ticks,)
    assert np.diff(result.tick_time) == pytest.approx(0.002)
    assert (result.start, result.end) == (result.tick_time[0], result.tick_time[-1])
    assert result.contact_fraction == 1.0
    # Targets at the points are the contour plus offsets; the path is rounded by less than 10 um.
    planned = ring(1, 3).forming_tip + result.compliance_offset
    assert result.forming_target == pytest.approx(planned, abs=2e-5)
    # The forming tool is pushed inwards by 150 +- 30 N sheet force and 120 N squeeze: the offset is outwards.
    assert np.linalg.norm(result.compliance_offset, axis=1) == pytest.approx(270e-6, abs=60e-6)
    # +-4 N: 1 % noise of 1.2 N and steps of 1 N at a single sample, plus the control error inside the dead zone.
    assert np.linalg.norm(result.support_force[:, :2], axis=1) == pytest.approx(120.0, abs=12.0)


def test_raising_the_set_point_moves_the_support_tool_towards_the_forming_tool():
    # The sign check: raising the set-point moves the support tool towards the forming tool.
    low = run(part(1), make_config(support_force=80.0)).results[0]
    high = run(part(1), make_config(support_force=200.0)).results[0]
    apart_low = np.linalg.norm((low.support_target - low.forming_target)[:, :2], axis=1)
    apart_high = np.linalg.norm((high.support_target - high.forming_target)[:, :2], axis=1)
    ramped = slice(24, None)  # the set-point is ramped on the first 14 mm of the first contour
    assert (apart_high < apart_low)[ramped].all()
    assert high.force_offset[ramped].mean() - low.force_offset[ramped].mean() == pytest.approx(120.0 / 0.45e6, rel=0.05)


def test_position_control_loses_what_force_control_holds():
    # As on the cone of Ren 2018, 2.4.1: the gap opens by 0.3 mm on half of the turn; position control loses contact
    # there, force control does not.
    gap = lambda time, angle: 0.15e-3 * (1 - np.cos(angle))  # noqa: E731
    position = run(part(1, force=None), make_config(), gap=gap)
    force = run(part(1), make_config(), gap=gap)
    assert position.force[position.mode == Mode.POSITION].min() == 0.0
    assert force.results[0].contact_fraction == 1.0
    assert position.results[0].tick_set_point.size == 0
    assert position.results[0].force_offset.size == 0


def test_ramp_disturbance_within_ten_newton():
    # 500 um/s ramps up and down, without dead zone 9.4 N (rate over K_i); noise-free.
    gap = lambda time, angle: 0.15e-3 + 500e-6 * abs((time % 1.2) - 0.6)  # noqa: E731
    outcome = run(part(1, radius=30e-3), make_config(dead_zone=0.0), gap=gap, noise=False)
    error = engaged_error(outcome)
    assert np.abs(error).max() <= 10.0


def test_learning_takes_over_what_repeats():
    # The same gap error every contour: fed forward from the second contour on.
    gap = lambda time, angle: 0.2e-3 * np.sin(2 * angle)  # noqa: E731
    plain = run(part(3), make_config(dead_zone=1.0), gap=gap, noise=False)
    learned = run(part(3), make_config(dead_zone=1.0, learning=0.9), gap=gap, noise=False)

    def last_contour(outcome):
        result = outcome.results[-1]
        return np.abs(result.tick_normal_force - 120.0)[result.tick_engaged].mean()

    assert last_contour(learned) < 0.5 * last_contour(plain)


def test_feed_is_reduced_where_the_force_is_off():
    gap = lambda time, angle: 0.3e-3 * np.sin(2 * angle)  # noqa: E731
    constant = run(part(1), make_config(feed_error=np.inf), gap=gap, noise=False)
    adaptive = run(part(1), make_config(feed_error=6.0), gap=gap, noise=False)
    assert np.sum(adaptive.mode == Mode.CONTROL) > np.sum(constant.mode == Mode.CONTROL)
    assert np.abs(engaged_error(adaptive)).mean() < np.abs(engaged_error(constant)).mean()
    assert largest_step_and_acceleration(adaptive.targets)[1] <= 0.5 + 0.5 + 0.3


@pytest.mark.parametrize("stiffness", [0.5, 1.0, 3.0])
def test_contact_stiffness_may_be_wrong(stiffness):
    # Safe for K_c errors up to about three times; Ren 2018, 5.1.2, names errors of K_c as what a fixed gain must bear.
    outcome = run(part(1), make_config(), contact_stiffness=stiffness * 0.45e6)
    assert outcome.results[0].completed
    error = engaged_error(outcome)
    assert np.mean(np.abs(error) <= 10.0) >= 0.99


def test_lost_contact_is_reported_and_regained():
    gap = lambda time, angle: 1e-3 if 3.0 < time < 3.1 else 0.0  # noqa: E731
    result = run(part(1), make_config(), gap=gap).results[0]
    assert result.completed
    assert 0.9 < result.contact_fraction < 1.0
    assert result.saturations > 0
    assert result.tick_normal_force[result.tick_engaged][-1] == pytest.approx(120.0, abs=10.0)


def test_offset_saturates_on_an_endless_gap():
    outcome = run(part(1), make_config(), gap=lambda time, angle: 5e-3)
    result = outcome.results[0]
    assert result.completed
    assert result.contact_fraction == 0.0
    assert result.force_offset.max() == pytest.approx(1.5e-3)


def spoil(tick_of_fault, value):
    def on_tick(tick, controller, wrench_1, wrench_2):
        if tick == tick_of_fault:
            wrench_2 = [value, *wrench_2[1:]]
        return wrench_1, wrench_2

    return on_tick


@pytest.mark.parametrize(
    ("value", "code"),
    [
        (float("nan"), ErrorCode.WRENCH_NOT_FINITE),
        (float("inf"), ErrorCode.WRENCH_NOT_FINITE),
        (1501.0, ErrorCode.WRENCH_OUT_OF_RANGE),
    ],
)
@pytest.mark.parametrize("tick", [200, 1500])
def test_bad_wrench_holds(value, code, tick):
    outcome = run(part(2), make_config(compensation=1.0), on_tick=spoil(tick, value))
    (result,) = outcome.results
    assert (result.completed, result.code) == (False, code)
    assert "tool_2" in result.message
    assert ("limits.force" if code is ErrorCode.WRENCH_OUT_OF_RANGE else "check the load cell") in result.message
    assert outcome.controller.mode is Mode.HOLD
    assert np.isfinite(outcome.targets).all()
    _, acceleration = largest_step_and_acceleration(outcome.targets)
    assert acceleration <= 0.5 + 0.5 + 2.0 + 0.3  # as above, plus braking
    held = outcome.controller.tick(10**6, 0.0, FREE, FREE)
    assert held == outcome.controller.tick(10**6 + 1, 0.0, FREE, FREE)
    with pytest.raises(IsfError, match="held") as refused:
        outcome.controller.start(ring(1, 2))
    assert refused.value.code is code


def test_points_that_were_not_reached_are_nan():
    outcome = run(part(1), make_config(), on_tick=spoil(1500, float("nan")))
    force = outcome.results[0].forming_force
    reached = np.isfinite(force[:, 0])
    assert 0 < reached.sum() < len(force)
    assert not reached[-1]


def test_stop_decelerates_and_disarm_lifts():
    stopped = []

    def on_tick(tick, controller, wrench_1, wrench_2):
        if tick == 1500:
            controller.stop("operator")
            stopped.append(tick)
        return wrench_1, wrench_2

    outcome = run(part(2), make_config(), on_tick=on_tick)
    assert stopped
    assert outcome.results[0].code == ErrorCode.STOPPED
    assert "operator" in outcome.results[0].message
    controller = outcome.controller
    controller.disarm()
    assert controller.busy
    targets = [outcome.targets[-1]]
    while controller.busy:
        pair = controller.tick(1501, 0.0, FREE, FREE)
        targets.append([*pair.tip_1, *pair.tip_2])
    assert controller.mode is Mode.IDLE
    assert targets[-1] == pytest.approx([*PARK_1, *PARK_2], abs=1e-4)
    assert largest_step_and_acceleration(np.array(targets))[1] <= 0.5 + 0.3


def test_tools_that_rest_on_the_sheet_are_lifted_whoever_armed_them_last():
    """Armed anew after a fault, as its advice says, and then disarmed without a contour; or with one, which lifts
    first."""
    before = run(part(2), make_config(), on_tick=spoil(1500, float("nan"))).controller
    assert before.on_sheet
    for contours in (0, 1):
        controller = ForceController(make_config())
        controller.arm("again", 0, 2, *before.targets[:2])
        assert not controller.on_sheet
        controller.rests_as(before)
        assert controller.on_sheet
        if contours:
            controller.start(replace(ring(0, 2), plan_id="again"))
            tips = [controller.tick(tick, tick * 0.002, FREE, FREE).tip_1 for tick in range(50)]
            assert tips[-1][2] > tips[0][2] + 0.5e-3  # up, not along the sheet
        controller.disarm()
        for tick in range(50, 10_000):
            if not controller.busy:
                break
            controller.tick(tick, tick * 0.002, FREE, FREE)
        assert controller.mode is Mode.IDLE
        assert [*controller.targets.tip_1, *controller.targets.tip_2] == pytest.approx([*PARK_1, *PARK_2], abs=1e-4)


def test_disarm_while_moving_gives_a_result_and_parks():
    config = make_config()
    controller = ForceController(config)
    controller.arm("plan", 0, 1, PARK_1, PARK_2)
    controller.start(ring())
    for tick in range(1500):
        controller.tick(tick, tick * 0.002, FREE, FREE)
    controller.disarm()
    for tick in range(1500, 10000):
        if not controller.busy:
            break
        controller.tick(tick, tick * 0.002, FREE, FREE)
    assert controller.mode is Mode.IDLE
    result = controller.take_result()
    assert result is not None
    assert result.code == ErrorCode.STOPPED


def test_wrenches_lost_ends_the_contour_without_a_tick():
    controller = ForceController(make_config())
    controller.arm("plan", 0, 1, PARK_1, PARK_2)
    controller.start(ring())
    controller.tick(0, 0.0, FREE, FREE)
    controller.fail(ErrorCode.WRENCH_LOST, "no wrench for 5 s")
    result = controller.take_result()
    assert result is not None
    assert result.code == ErrorCode.WRENCH_LOST
    assert not controller.busy


def test_skipped_ticks_are_counted():
    controller = ForceController(make_config())
    controller.arm("plan", 0, 1, PARK_1, PARK_2)
    controller.start(ring())
    for tick in (0, 1, 2, 5, 6):
        controller.tick(tick, tick * 0.002, FREE, FREE)
    controller.fail(ErrorCode.WRENCH_LOST, "")
    result = controller.take_result()
    assert result is not None
    assert result.lost_messages == 2


def test_spif_leaves_tool_2_alone():
    contours = part(2, support_tip=np.empty((0, 3)), force=None, process=Process.SPIF)
    config = make_config(compensation=1.0, frozen_time=np.inf)
    controller = ForceController(config)
    controller.arm("plan", 0, 2, PARK_1, (0.01, 0.02, -0.025))
    tick = 0
    for contour in contours:
        controller.start(contour)
        while controller.busy:
            x, y = controller.targets.tip_1[:2]
            around = max(np.hypot(x, y), 1e-6)  # the sheet pushes the tool inwards, whatever side it is on
            push = [-50.0 * x / around, -50.0 * y / around, 300.0, 0.0, 0.0, 0.0]
            parked = controller.targets.tip_1[2] > 0.02  # a force there would be a drift of the cell
            pair = controller.tick(tick, tick / config.rate, FREE if parked else push, FREE)
            assert pair.tip_2 == (0.01, 0.02, -0.025)
            tick += 1
        result = controller.take_result()
        assert result is not None
        assert result.support_target.shape == (0, 3)
        outward = result.forming_target[:, :2] / np.linalg.norm(result.forming_target[:, :2], axis=1)[:, None]
        assert result.compliance_offset[:, :2] == pytest.approx(50e-6 * outward, abs=1e-6)


def test_mixed_contours():
    contours = [ring(0, 3, force=None), ring(1, 3, force=None), ring(2, 3)]
    outcome = run(contours, make_config())
    modes = set(outcome.mode.tolist())
    assert {Mode.POSITION, Mode.ENGAGE, Mode.CONTROL} <= modes
    assert np.mean(np.abs(engaged_error(outcome)) <= 10.0) >= 0.99


def test_far_contours_are_linked_in_the_air():
    there = ring(1, 2)
    moved = there.shifted(np.tile([0.06, 0.0, 0.0], (len(there), 1)))
    outcome = run([ring(0, 2), moved], make_config(), noise=False)
    assert [r.completed for r in outcome.results] == [True, True]
    assert largest_step_and_acceleration(outcome.targets)[1] <= 0.5 + 0.3 + 0.1
    order = [mode for k, mode in enumerate(outcome.mode) if k == 0 or outcome.mode[k - 1] != mode]
    assert order.count(Mode.LIFT) == 2


def test_repeats_bit_by_bit():
    first, second = (run(part(1), make_config(compensation=1.0)) for _ in range(2))
    assert np.array_equal(first.targets, second.targets)


def armed():
    controller = ForceController(make_config())
    controller.arm("plan", 1, 3, PARK_1, PARK_2)
    return controller


@pytest.mark.parametrize(
    ("contour", "match"),
    [
        (ring(1, 3, plan_id="other"), "plan 'plan' is armed"),
        (ring(0, 3), "out of order"),
        (ring(2, 3), "out of order"),
        (ring(1, 3, support_tip=np.empty((0, 3)), force=None), "one tool only"),
        (ring(1, 3, support_tip=np.empty((0, 3)), process=Process.SPIF), "no support tool"),
    ],
)
def test_wrong_contours_are_refused(contour, match):
    controller = armed()
    with pytest.raises(IsfError, match=match) as caught:
        controller.start(contour)
    assert caught.value.code is ErrorCode.CONTOUR_REJECTED
    assert not controller.busy
    controller.start(ring(1, 3))


def test_nothing_moves_before_arming():
    controller = ForceController(make_config())
    with pytest.raises(IsfError, match="NOT_ARMED"):
        controller.start(ring())
    with pytest.raises(IsfError, match="NOT_ARMED"):
        controller.tick(0, 0.0, FREE, FREE)
    assert controller.state().mode is Mode.IDLE


@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        (("", 0, 1, PARK_1, PARK_2), "no contours"),
        (("plan", 1, 1, PARK_1, PARK_2), "no contours"),
        (("plan", 0, 1, (0.0, 0.0, float("nan")), PARK_2), "positions"),
        (("plan", 0, 1, PARK_1, PARK_2, -5.0), "support force"),
        (("plan", 0, 1, PARK_1, PARK_2, None, (float("nan"),) * 3), "axis of tool_1"),
        (("plan", 0, 1, PARK_1, PARK_2, None, (0.0, 0.0, 0.0)), "axis of tool_1"),
    ],
)
def test_arming_is_checked(arguments, match):
    with pytest.raises(IsfError, match=match):
        ForceController(make_config()).arm(*arguments)


def test_state_follows_the_message(formed):
    controller = armed()
    controller.start(ring(1, 3))
    controller.tick(0, 0.0, FREE, [3.0, 0, 0, 0, 0, 0])
    state = controller.state()
    assert (state.plan_id, state.index, state.tick, state.mode) == ("plan", 1, 1, Mode.APPROACH)
    assert np.isnan(state.set_point)
    assert np.isnan(state.error)
    assert state.contact_stiffness == 0.45e6


JOB = """
name: cone
part: {mesh: cone.stl, unit: mm}
process: DSIF
rig: ren2018
sheet: {material: AA5754-O, thickness: 1 mm}
tool_1: {radius: 5 mm}
tool_2: {radius: 5 mm}
path: {incremental_depth: 0.5 mm, point_spacing: 0.5 mm, feed: 30 mm/s}
control: {rate: 500 Hz, support_force: 120 N}
"""


def test_config_from_a_job(tmp_path):
    job_file = JobFile(JOB, tmp_path)
    config = ControlConfig.from_job(job_file, support_force=90.0)
    assert config.rate == 500.0
    assert config.support_force == 90.0
    assert config.contact_stiffness == pytest.approx(0.45e6)
    assert config.forming_compliance == pytest.approx((1e-6, 1e-6))
    assert config.offset_limit == pytest.approx(1.5e-3)
    assert config.contact_force().integral_gain == pytest.approx(53.3e-6, abs=0.1e-6)


@pytest.mark.parametrize("rate", [100.0, 440.0, 1000.0])
def test_other_rates_form_as_well(rate):
    outcome = run(part(1, points=60), make_config(rate=rate), max_ticks=60000)
    assert outcome.results[0].completed
    assert np.mean(np.abs(engaged_error(outcome)) <= 10.0) >= 0.99
