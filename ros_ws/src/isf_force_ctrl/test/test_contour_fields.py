"""Fields of a contour beyond the closed ring: spirals, speed, retract, holder, swapped roles, both compensated."""

from dataclasses import replace

import numpy as np
import pytest
from contact_sandbox import make_config, mirrored, ring, run, spiral
from hypothesis import given, settings
from hypothesis import strategies as st
from isf_core.contour import Process
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile
from isf_force_ctrl import ControlConfig, ForceController, Mode
from isf_force_ctrl.motion.trajectory import Limits, ToolPath, sample

PARK_1, PARK_2 = (0.0, 0.0, 0.03), (0.0, 0.0, -0.03)
FREE = [0.0] * 6


def velocity(outcome):
    return np.diff(outcome.targets.reshape(-1, 2, 3), axis=0) * 500.0


def largest_acceleration(outcome):
    return np.linalg.norm(np.diff(velocity(outcome), axis=0) * 500.0, axis=2).max()


def order_of(outcome):
    return [mode for k, mode in enumerate(outcome.mode) if k == 0 or outcome.mode[k - 1] != mode]


@pytest.mark.parametrize("force", [120.0, None])
def test_turns_of_a_spiral_run_on_without_lift_or_stop(force):
    outcome = run(spiral(3, force=force), make_config(), noise=False)
    forming = Mode.CONTROL if force else Mode.POSITION
    assert [result.completed for result in outcome.results] == [True] * 3
    assert order_of(outcome).count(Mode.LIFT) == 1  # only after the last turn
    assert order_of(outcome).count(Mode.ENGAGE) == (1 if force else 0)
    on_path = np.flatnonzero(outcome.mode == forming)
    inner = on_path[200:-200]
    assert np.diff(inner).max() <= 2  # the tick in which a turn ends counts as the next one's first
    speed = np.linalg.norm(velocity(outcome)[inner[:-1], 0], axis=1)
    assert speed.min() > 0.8 * speed.max()  # at the joints nearly as elsewhere
    assert largest_acceleration(outcome) <= 0.5 + 0.3
    if force:
        # The two ends of a joint are smoothed apart from each other: 10 um of the gap, 5 N.
        assert outcome.force[inner] == pytest.approx(120.0, abs=5.0)
    for result in outcome.results:
        assert np.isfinite(result.forming_force).all()


def test_turns_of_a_spiral_rest_where_the_next_one_may_be_late():
    outcome = run(spiral(3), make_config(runs_on=False), noise=False)
    assert [result.completed for result in outcome.results] == [True] * 3
    assert order_of(outcome).count(Mode.LIFT) == 1
    assert Mode.FREEZE in order_of(outcome)
    engaged = outcome.mode == Mode.CONTROL
    assert outcome.force[engaged] == pytest.approx(120.0, abs=2.0)


def test_a_corrected_turn_is_joined_smoothly():
    turns = spiral(3)
    turns[1] = turns[1].shifted(np.tile([0.0, 0.0, 0.15e-3], (len(turns[1]), 1)))
    turns[2] = turns[2].shifted(np.tile([0.05e-3, 0.05e-3, -0.1e-3], (len(turns[2]), 1)))
    outcome = run(turns, make_config(), noise=False)
    assert order_of(outcome).count(Mode.LIFT) == 1
    assert largest_acceleration(outcome) <= 0.5 + 0.3
    # The corrected turn is reached: its last point is where it was asked for.
    assert outcome.results[1].forming_target[-1] == pytest.approx(turns[1].forming_tip[-1], abs=6e-5)  # one tick


def test_force_control_sets_in_on_the_way():
    turns = spiral(3)
    turns[0] = replace(turns[0], support_force=np.empty(0))
    outcome = run(turns, make_config(), noise=False)
    order = [mode for mode in order_of(outcome) if mode != Mode.ARMED]  # the one tick between two turns
    assert order[1:4] == [Mode.POSITION, Mode.ENGAGE, Mode.CONTROL]
    assert outcome.force[outcome.mode == Mode.CONTROL] == pytest.approx(120.0, abs=10.0)
    assert np.linalg.norm(velocity(outcome)[outcome.mode[1:] == Mode.ENGAGE, 0], axis=1).min() > 0.016


@pytest.mark.parametrize("event", ["stop", "disarm", "other"])
def test_a_spiral_that_is_not_continued_comes_to_rest(event):
    turns = spiral(3, force=None)
    config = make_config()
    controller = ForceController(config)
    controller.arm("plan", 0, 3, PARK_1, PARK_2)
    controller.start(turns[0])
    targets = []

    def ticks(most=20000):
        for _ in range(most):
            if not controller.busy:
                break
            pair = controller.tick(len(targets), len(targets) * 0.002, FREE, FREE)
            targets.append([*pair.tip_1, *pair.tip_2])

    ticks()
    assert controller.take_result().completed
    if event == "stop":
        controller.stop("test")
    elif event == "disarm":
        controller.disarm()
    else:
        controller.start(replace(ring(1, 3, radius=14e-3, force=None), retract=True))
    assert controller.busy
    ticks()
    path = np.array(targets).reshape(-1, 2, 3)
    acceleration = np.diff(path, n=2, axis=0) * 500.0**2
    assert np.linalg.norm(acceleration, axis=2).max() <= 0.5 + 0.3
    assert controller.mode is {"stop": Mode.HOLD, "disarm": Mode.IDLE, "other": Mode.ARMED}[event]


def test_stop_near_the_end_of_a_turn_brakes():
    turns = spiral(2, force=None)
    for before in (1, 5, 30):
        controller = ForceController(make_config())
        controller.arm("plan", 0, 2, PARK_1, PARK_2)
        controller.start(turns[0])
        rows = len(controller._playback._queue[-1].rows)
        targets, on_path = [], 0
        while controller.busy:
            pair = controller.tick(len(targets), len(targets) * 0.002, FREE, [0.0] * 6)
            targets.append([*pair.tip_1, *pair.tip_2])
            on_path += controller.mode is Mode.POSITION
            if on_path == rows - before:
                controller.stop("test")
                on_path += 1
        path = np.array(targets).reshape(-1, 2, 3)
        assert controller.mode is Mode.HOLD
        assert np.linalg.norm(np.diff(path, n=2, axis=0) * 500.0**2, axis=2).max() <= 0.5 + 0.3


def test_speed_at_the_points_bounds_the_feed():
    points = 160
    speed = np.full(points, 0.03)
    speed[40:80] = 0.008
    outcome = run([ring(0, 1, radius=40e-3, points=points, speed=speed)], make_config(), noise=False)
    moving = velocity(outcome)[:, 0]
    angle = np.degrees(np.arctan2(outcome.targets[1:, 1], outcome.targets[1:, 0])) % 360.0
    on_path = outcome.mode[1:] == Mode.CONTROL
    slow = on_path & (angle > 360.0 * 40 / points) & (angle < 360.0 * 79 / points)
    assert np.linalg.norm(moving[slow], axis=1).max() <= 0.008 * 1.01
    fast = on_path & (angle > 240.0) & (angle < 330.0)
    assert np.linalg.norm(moving[fast], axis=1).mean() > 0.029


@given(
    speeds=st.lists(st.floats(0.002, 0.05), min_size=12, max_size=12),
    entry=st.sampled_from([0.0, 0.01]),
    runs_on=st.booleans(),
)
@settings(max_examples=25, deadline=None)
def test_any_profile_of_speeds_is_kept(speeds, entry, runs_on):
    count = len(speeds)
    tip = np.column_stack([np.linspace(0, 0.06, count), np.zeros(count), np.zeros(count)])
    path = ToolPath(
        tip_1=tip,
        tip_2=tip - [0.0, 0.0, 0.01],
        direction=np.zeros(count),
        set_point=np.full(count, np.nan),
        coordinate=np.arange(count, dtype=float),
        speed=np.maximum(np.array(speeds), entry if entry else 0.0),
    )
    motion = sample(path, 0.03, Limits(500.0, 0.5, 0.03, 0.01), entry=entry, runs_on=runs_on)
    moved = np.diff(motion.tip_1[:, 0])
    middle = 0.5 * (motion.tip_1[1:, 0] + motion.tip_1[:-1, 0])
    allowed = np.minimum(np.interp(middle, tip[:, 0], path.speed), 0.03)
    assert (moved * 500.0 <= allowed + 1e-4).all()
    assert np.abs(np.diff(moved) * 500.0**2).max() <= 0.5 * 1.001
    assert motion.coordinate[-1] == count - 1


def test_retract_lifts_both_tools_before_the_contour():
    contours = [ring(0, 2), replace(ring(1, 2), retract=True)]
    outcome = run(contours, make_config(), noise=False)
    order = order_of(outcome)
    assert order.count(Mode.LIFT) == 2
    between = outcome.targets[: np.flatnonzero(outcome.mode == Mode.CONTROL)[-1]]
    lifted = between[len(between) // 3 :]
    assert lifted[:, 2].max() == pytest.approx(0.03)
    assert lifted[:, 5].min() == pytest.approx(-0.03)


@pytest.mark.parametrize("force", [120.0, None])
@pytest.mark.parametrize("shape", [ring, spiral])
def test_lift_after_leaves_both_tools_above_and_below_the_end_of_the_contour(shape, force):
    if shape is ring:
        first, second = ring(0, 2, force=force), ring(1, 2, force=force)
    else:
        first, second = spiral(2, force=force)
    contours = [replace(first, lift_after=True), replace(second, retract=True)]
    outcome = run(contours, make_config(), noise=False)
    assert [result.completed for result in outcome.results] == [True, True]
    assert order_of(outcome).count(Mode.LIFT) == 2  # not again before the second contour
    forming = Mode.CONTROL if force else Mode.POSITION
    lifting = np.flatnonzero(outcome.mode == Mode.LIFT)
    waits = lifting[: np.flatnonzero(np.diff(lifting) > 1)[0] + 1][-1] + 1  # the first tick after the first lift
    assert (outcome.mode[waits:] == forming).any()
    end, begin = outcome.targets[waits, :3], outcome.targets[waits, 3:]
    closing = first.forming_tip[0] if first.closed else first.forming_tip[-1]
    assert end[:2] == pytest.approx(closing[:2], abs=1e-4)  # straight up
    assert (end[2], begin[2]) == pytest.approx((0.03, -0.03), abs=1e-4)
    assert outcome.results[0].end <= 0.002 * (waits + 1)
    assert np.abs(velocity(outcome)[waits - 2]).max() < 1e-3  # at rest, a spiral too
    assert largest_acceleration(outcome) <= 0.5 + 0.3


def test_blank_holder_moves_between_contours():
    contours = [
        ring(k, 3, support_tip=np.empty((0, 3)), force=None, process=Process.TPIF, holder_height=k * 0.5e-3)
        for k in range(3)
    ]
    outcome = run(contours, make_config(), noise=False)
    forming = outcome.mode == Mode.POSITION
    assert set(np.round(outcome.holder[forming], 7)) == {0.0, 0.5e-3, 1.0e-3}
    assert np.abs(np.diff(outcome.holder[forming])).max() <= 0.5e-3
    assert np.abs(np.diff(outcome.holder)).max() * 500.0 <= 0.06 / 3
    assert outcome.holder[-1] == 0.0  # at rest after the part
    assert outcome.results[-1].completed


def test_holder_is_zero_for_other_processes():
    controller = ForceController(make_config())
    controller.arm("plan", 0, 1, PARK_1, PARK_2)
    controller.start(ring())
    assert controller.tick(0, 0.0, FREE, FREE).holder_height == 0.0


def test_roles_swapped():
    up = run([ring(k, 2) for k in range(2)], make_config(compensation=1.0), noise=False, sheet=lambda t, a: 100.0)
    down = run(
        [mirrored(ring(k, 2)) for k in range(2)],
        make_config(compensation=1.0, support_compliance=(1e-6, 1e-6)),
        noise=False,
        forming_tool=2,
        sheet=lambda t, a: 100.0,
    )
    assert [result.completed for result in down.results] == [True, True]
    assert down.force[down.mode == Mode.CONTROL] == pytest.approx(120.0, abs=5.0)
    # The mirror image of the part formed from above: same forces, same offsets, tips mirrored.
    turn = np.array([1.0, 1.0, -1.0])
    for above, below in zip(up.results, down.results, strict=True):
        assert below.force_offset == pytest.approx(above.force_offset, abs=2e-6)
        assert below.compliance_offset == pytest.approx(above.compliance_offset * turn, abs=2e-6)
        assert below.support_target == pytest.approx(above.support_target * turn, abs=1e-5)
        assert below.forming_force == pytest.approx(above.forming_force * turn, abs=2.0)
        assert below.contact_fraction == 1.0


def test_roles_may_change_from_contour_to_contour():
    contours = [ring(0, 2), mirrored(ring(1, 2))]
    config = make_config(compensation=1.0, support_compliance=(1e-6, 1e-6))
    outcome = run(contours, config, noise=False)
    assert [result.completed for result in outcome.results] == [True, True]
    assert order_of(outcome).count(Mode.LIFT) == 2
    assert largest_acceleration(outcome) <= 0.5 + 2.0 + 0.3  # compliance offset: see test_force_controller
    assert outcome.force[outcome.mode == Mode.CONTROL] == pytest.approx(120.0, abs=10.0)


def test_only_the_forming_tool_moves_without_a_support():
    contour = replace(mirrored(ring()), support_tip=np.empty((0, 3)), support_force=np.empty(0), process=Process.SPIF)
    controller = ForceController(make_config())
    controller.arm("plan", 0, 1, (0.01, 0.02, 0.025), PARK_2)
    controller.start(contour)
    tick = 0
    while controller.busy:
        pair = controller.tick(tick, tick * 0.002, FREE, FREE)
        assert pair.tip_1 == (0.01, 0.02, 0.025)
        tick += 1
    result = controller.take_result()
    assert result.forming_target == pytest.approx(contour.forming_tip, abs=2e-5)


def test_both_tools_compensated_without_force_control():
    config = make_config(compensation=0.8, support_compliance=(1e-6, 1e-6), support_compensation=0.6)
    contours = [replace(ring(k, 2, force=None), process=Process.ADSIF) for k in range(2)]
    outcome = run(contours, config, noise=False)
    controlled = run(contours, make_config(), noise=False)
    forming = outcome.mode == Mode.POSITION
    # K_p K_c = 1.4 * 0.45 of the squeeze comes back: F = F_0 / (1 - 0.63) = 2.7 F_0, moving as at rest.
    plain = controlled.force[controlled.mode == Mode.POSITION][-500:].mean()
    assert outcome.force[forming][-500:].mean() / plain == pytest.approx(2.7, rel=0.02)
    assert largest_acceleration(outcome) <= 0.5 + 2.0 + 0.3


def test_too_much_on_both_tools_is_refused():
    # Ren 2018, 2.3.3: K_p K_c = 0.9 with both; a compliance over-estimated by 12 % is unstable.
    with pytest.raises(IsfError, match="support_compensation") as caught:
        ForceController(make_config(compensation=1.0, support_compliance=(1e-6, 1e-6), support_compensation=1.0))
    assert caught.value.code is ErrorCode.UNSTABLE_GAIN


JOB = """
name: cone
part: {{mesh: cone.stl, unit: mm}}
process: {process}
rig: ren2018
sheet: {{material: AA5754-O, thickness: 1 mm}}
tool_1: {{radius: 5 mm}}
tool_2: {{radius: 5 mm}}
path: {{incremental_depth: 0.5 mm, point_spacing: 0.5 mm, feed: 30 mm/s}}
control: {{rate: 500 Hz{more}}}
"""


@pytest.mark.parametrize(
    ("process", "more", "factor"),
    [("DSIF", "", 0.0), ("ADSIF", "", 0.689), ("ADSIF", ", support_compensation: 0.2", 0.2)],
)
def test_support_compensation_of_a_job(process, more, factor, tmp_path):
    text = JOB.format(process=process, more=more) + ("adsif: {compensate_compliance: false}\n" * (process == "ADSIF"))
    config = ControlConfig.from_job(JobFile(text, tmp_path))
    assert config.compensation == 1.0
    # ADSIF: (0.95 * 0.8 / 0.45 - 1) = 0.689 of 1 um/N
    assert config.support_compensation == pytest.approx(factor, abs=1e-3)


@pytest.mark.parametrize("adsif", ["", "adsif: {pitch: 0.2 mm}\n"])
def test_a_gap_planned_for_the_compliance_is_not_compensated_again(adsif, tmp_path):
    # Ren 2018 eq. 3-12 makes the commanded gap smaller already: cancelling it once more closes it until it buckles
    config = ControlConfig.from_job(JobFile(JOB.format(process="ADSIF", more="") + adsif, tmp_path))
    assert (config.compensation, config.support_compensation) == (0.0, 0.0)


@pytest.mark.parametrize("more", [", compliance_compensation: 0.5", ", support_compensation: 0.2"])
def test_asking_for_both_compensations_of_a_gap_is_refused(more, tmp_path):
    with pytest.raises(IsfError, match="compensate_compliance") as caught:
        ControlConfig.from_job(JobFile(JOB.format(process="ADSIF", more=more), tmp_path))
    assert caught.value.code == ErrorCode.FILE_FIELD


def crossed(contour):
    """The lower tool 3 mm higher than planned."""
    return replace(contour, support_tip=contour.support_tip + [0.0, 0.0, 3e-3])


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        (lambda contour: replace(contour, process=Process.ADSIF), "is one of ADSIF; a job of DSIF is armed"),
        (lambda contour: replace(contour, count=99), "is one of 99, 1 were armed"),
        (crossed, "into each other"),
        (lambda contour: replace(contour, forming_tool=2), "point away from tool 2"),
        (lambda contour: replace(contour, support_force=np.full(len(contour), 5000.0)), "set-point of 5000 N"),
    ],
)
def test_a_contour_that_does_not_fit_what_is_armed_is_refused(changed, said):
    controller = ForceController(make_config(process="DSIF", ball_reach=10e-3))
    controller.arm("plan", 0, 1, PARK_1, PARK_2)
    with pytest.raises(IsfError, match=said) as refused:
        controller.start(changed(ring()))
    assert refused.value.code is ErrorCode.CONTOUR_REJECTED
    assert not controller.busy
    controller.start(ring())
    assert controller.busy


def test_a_set_point_beyond_the_rig_does_not_arm():
    controller = ForceController(make_config())
    with pytest.raises(IsfError, match="5000 N is more than the rig bears"):
        controller.arm("plan", 0, 1, PARK_1, PARK_2, 5000.0)


def test_tools_that_were_stopped_on_their_way_to_the_sheet_touch_nothing_and_are_lifted_first():
    config = make_config(park_height=0.1)
    controller = ForceController(config)
    controller.arm("plan", 0, 2, (0.0, 0.0, 0.1), (0.0, 0.0, -0.1))
    controller.start(ring(count=2))
    tick = 0
    while controller.targets.tip_1[2] > 70e-3:
        tick += 1
        controller.tick(tick, tick / config.rate, FREE, FREE)
    controller.stop("by hand")
    for later in range(tick + 1, tick + 500):
        controller.tick(later, later / config.rate, FREE, FREE)
    assert controller.mode is Mode.HOLD
    assert 20e-3 < controller.targets.tip_1[2] < 70e-3
    assert controller.clear_of_contour
    assert controller.on_sheet  # who arms anew lifts them first: they may stand in a pocket


def test_tools_that_were_stopped_on_the_sheet_are_not_clear_of_it():
    stopped = []

    def stop(tick, controller, *wrenches):
        if controller.mode is Mode.CONTROL and not stopped:
            stopped.append(controller)
            controller.stop("by hand")
        return wrenches

    run([ring(count=2)], make_config(), on_tick=stop, max_ticks=8000)
    assert stopped[0].mode is Mode.HOLD
    assert stopped[0].on_sheet
    assert not stopped[0].clear_of_contour
