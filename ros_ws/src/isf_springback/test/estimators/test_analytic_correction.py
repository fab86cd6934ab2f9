"""The method "analytic" contour by contour: level, signs, continuity, missing and bad forces, speed."""

from dataclasses import replace

import numpy as np
import pytest
from isf_core.contour import Process
from isf_core.errors import ErrorCode
from isf_springback import make_corrector
from isf_springback.corrector import apply
from isf_springback.estimators.analytic import AnalyticModel, AnalyticOptions
from springback_parts import cone_contour, corrector_of, job_file, result_of

CHANGE = 1e-3
"""m, two incremental depths."""


def run(method, loads, *, first=0, tool=1, rng=None):
    """Correct and learn the contours ``first``... under the sheet loads ``loads``; the corrections."""
    corrections = []
    for index, load in enumerate(loads, start=first):
        contour = cone_contour(index, tool=tool)
        correction = method.correct(contour)
        corrections.append(correction)
        method.add_result(apply(contour, correction), result_of(contour, load, rng=rng))
    return corrections


def test_level_against_the_published_cone():
    # Ren 2018 Table 4.6, cone, Z: 2.71 mm at 200 N, 5.09 mm at 600 N
    def level(force):
        return run(corrector_of(AnalyticModel, job_file()), [force] * 12)[-1].springback.mean() * 1e3

    # the factor REALISED is calibrated at 600 N on a ring of 36 mm; the first contour here has 35.6 mm: 2 %
    assert level(600.0) == pytest.approx(5.09, rel=0.02)
    # the cubic has the exponent 1/3 of a membrane, the cone 0.57: up to 30 % too much at a third of the force
    assert level(200.0) == pytest.approx(2.71, rel=0.30)


@pytest.mark.parametrize(("tool", "down"), [(1, -1.0), (2, 1.0)])
def test_the_correction_goes_along_the_push(tool, down):
    # an upper tool pushes down, the sheet springs up: correction -z, springback +z; a lower tool the other way
    last = run(corrector_of(AnalyticModel, job_file()), [500.0] * 8, tool=tool)[-1]
    assert (down * last.offset[:, 2] > 3e-3).all()
    assert (-down * last.springback > 3e-3).all()
    assert not last.offset[:, :2].any()


def test_gap_of_the_tools_is_unchanged():
    method = corrector_of(AnalyticModel, job_file())
    run(method, [500.0] * 8)
    contour = cone_contour(8)
    corrected = apply(contour, method.correct(contour))
    before = np.linalg.norm(contour.forming_tip - contour.support_tip, axis=1)
    after = np.linalg.norm(corrected.forming_tip - corrected.support_tip, axis=1)
    # Praveen 2020, 2.5: both tools shifted equally, to 1e-9
    assert after == pytest.approx(before, abs=1e-9)
    assert np.abs(corrected.forming_tip - contour.forming_tip).max() > 1e-3


def planned(index, force=571.0):
    contour = cone_contour(index)
    return replace(contour, predicted_force=np.full(len(contour), force))


def test_first_contour_is_pushed_by_the_predicted_force_at_once():
    """As the first contour after a swap: the tools are lifted, there is no change to limit."""
    first = corrector_of(AnalyticModel, job_file()).correct(planned(0))
    assert first.code == 0
    assert first.control_point_force == pytest.approx(np.full(24, 571.0))
    assert -first.offset[:, 2].mean() > 3.0 * CHANGE
    assert not first.saturated.any()


@pytest.mark.parametrize("plan", [cone_contour, planned])
def test_first_contour_as_published_is_not_corrected(plan):
    # published: S = 0 in block 1 (Ren 2018, 4.3.1)
    job = job_file(gain="gain: 1.0, first_contour: zero")
    first = corrector_of(AnalyticModel, job).correct(plan(0))
    assert first.code == 0
    assert not first.offset.any()


def test_without_a_predicted_force_the_first_contour_is_not_corrected():
    assert not corrector_of(AnalyticModel, job_file()).correct(cone_contour(0)).offset.any()


@pytest.mark.parametrize("change", [{"process": Process.TPIF}, {"stage": 1}])
def test_over_a_die_and_in_a_further_stage_the_first_contour_is_not_corrected(change):
    assert not corrector_of(AnalyticModel, job_file()).correct(replace(planned(0), **change)).offset.any()


def test_first_contour_by_estimate_takes_aerens_regression():
    first = corrector_of(AnalyticModel, job_file(), AnalyticOptions(first_contour="estimate")).correct(cone_contour(0))
    assert first.control_point_force == pytest.approx(np.full(24, first.control_point_force[0]))
    # Aerens' regression for 1 mm AA5754-O at 50 deg: several hundred N
    assert 300.0 < first.control_point_force[0] < 900.0


def test_the_force_that_the_plan_lets_rise_is_forecast():
    """Measured is 0.9 of the plan all along: so is the forecast, though the force rises; a plan that falls is held."""
    method = corrector_of(AnalyticModel, job_file(), AnalyticOptions(law="hold"))
    rising = [571.0, 655.0, 740.0, 700.0]
    reported = []
    for index, force in enumerate(rising):
        contour = planned(index, force)
        correction = method.correct(contour)
        reported.append(float(correction.control_point_force.mean()))
        method.add_result(apply(contour, correction), result_of(contour, 0.9 * max(rising[: index + 1])))
    assert reported == pytest.approx([571.0, 0.9 * 655.0, 0.9 * 740.0, 0.9 * 740.0], rel=1e-6)


def test_hindsight_is_the_model_under_the_force_that_was_measured():
    method = corrector_of(AnalyticModel, job_file(), AnalyticOptions(law="hold"))
    assert method.estimator.hindsight() is None
    contour = planned(0)
    correction = method.correct(contour)
    assert method.estimator.hindsight() is None
    method.add_result(apply(contour, correction), result_of(contour, 300.0))
    reported = method.estimator.hindsight()
    # 300 N in place of 571 N: clearly less; and what the next contour takes, whose force is held
    assert 0.3 * correction.springback.mean() < reported.mean() < 0.9 * correction.springback.mean()
    assert method.correct(planned(1)).springback.mean() == pytest.approx(reported.mean(), rel=0.03)


def test_no_change_above_the_limit_between_contours():
    levels = np.array([-c.offset[:, 2].mean() for c in run(corrector_of(AnalyticModel, job_file()), [650.0] * 12)])
    assert np.abs(np.diff(levels)).max() <= CHANGE + 1e-9
    assert levels[-1] > 4e-3


def test_noise_of_the_load_cell_is_averaged_out():
    smooth = run(corrector_of(AnalyticModel, job_file()), [500.0] * 14)[-1]
    noisy = run(corrector_of(AnalyticModel, job_file()), [500.0] * 14, rng=np.random.default_rng(3))[-1]
    # 1 % white per point, 15-20 points a sector, amplified by sqrt(5) in the forecast, halved or better by the
    # cube root: 0.3 % of 4.6 mm rms, 60 um as a bound on the largest of all points
    assert noisy.offset == pytest.approx(smooth.offset, abs=60e-6)
    assert not np.array_equal(noisy.offset, smooth.offset)


def test_force_history_is_matched_by_place_not_by_index():
    # a force that is higher on one side; contours start at changing places
    method = corrector_of(AnalyticModel, job_file())
    for index in range(14):
        contour = cone_contour(index, start=0.7 * index)
        side = 500.0 + 150.0 * contour.contact[:, 0] / np.abs(contour.contact[:, 0]).max()
        last = method.correct(contour)
        method.add_result(contour, result_of(contour, side))
    x, force = last.control_point[:, 0], last.control_point_force
    # the sector mean flattens the first harmonic by 1 - sinc(pi/24) = 0.3 %: 1 N; places are off by half a sector
    # of the change of radius between two contours: a few N
    assert force == pytest.approx(500.0 + 150.0 * x / np.abs(x).max(), abs=6.0)


def last_good_is_kept(method, code, index):
    """The correction of ``index`` has the code and equals the last one; returns it."""
    kept = method.correct(cone_contour(index))
    assert kept.code == code
    assert kept.message
    assert -kept.offset[:, 2] == pytest.approx(np.full(len(kept.offset), kept_level(method)), abs=20e-6)
    return kept


def kept_level(method):
    """Mean correction of the contour before the last."""
    return float(method.history.base.push.mean())


def test_missing_result_keeps_the_last_correction():
    method = corrector_of(AnalyticModel, job_file())
    run(method, [500.0] * 8)
    method.correct(cone_contour(8))  # never learned
    last_good_is_kept(method, ErrorCode.NO_FORCE_HISTORY, 9)


def test_not_finite_force_keeps_the_last_correction_and_recovers():
    method = corrector_of(AnalyticModel, job_file())
    run(method, [500.0] * 8)
    contour = cone_contour(8)
    method.correct(contour)
    bad = result_of(contour, 500.0)
    bad.forming_force[5] = np.nan
    method.add_result(contour, bad)
    last_good_is_kept(method, ErrorCode.CORRECTION_FAILED, 9)
    method.add_result(cone_contour(9), result_of(cone_contour(9), 500.0))
    assert method.correct(cone_contour(10)).code == 0


def test_incomplete_contour_keeps_the_last_correction():
    method = corrector_of(AnalyticModel, job_file())
    run(method, [500.0] * 8)
    contour = cone_contour(8)
    method.correct(contour)
    method.add_result(contour, result_of(contour, 500.0, completed=False))
    last_good_is_kept(method, ErrorCode.NO_FORCE_HISTORY, 9)


def pockets_in_turn(count):
    """Contours of two pockets 100 mm apart, level by level, the tools lifted in between."""
    for index in range(count):
        contour, aside = cone_contour(index // 2), np.array([100e-3 * (index % 2), 0.0, 0.0])
        moved = {name: getattr(contour, name) + aside for name in ("contact", "forming_tip", "support_tip")}
        yield replace(contour, index=index, feature=index % 2, retract=index > 0, **moved)


def test_a_bad_force_is_told_by_its_pocket_alone():
    """That of the 19th contour, in the first pocket: the second one goes on, the first one tells it at its next."""
    method = corrector_of(AnalyticModel, job_file())
    made = []
    for contour in pockets_in_turn(21):
        made.append(method.correct(contour))
        load = np.nan if contour.index == 18 else 500.0
        method.add_result(apply(contour, made[-1]), result_of(contour, load))
    assert [correction.code for correction in made] == [0] * 20 + [ErrorCode.CORRECTION_FAILED]
    assert "contour 19" in made[-1].message
    assert made[-1].offset[:, 2].mean() == pytest.approx(made[18].offset[:, 2].mean(), abs=20e-6)


def test_contour_out_of_order_keeps_the_last_correction():
    method = corrector_of(AnalyticModel, job_file())
    run(method, [500.0] * 8)
    last_good_is_kept(method, ErrorCode.CONTOUR_OUT_OF_ORDER, 12)


def test_result_out_of_order_is_reported():
    method = corrector_of(AnalyticModel, job_file())
    run(method, [500.0] * 8)
    method.correct(cone_contour(8))
    method.add_result(cone_contour(5), result_of(cone_contour(5), 500.0))
    last_good_is_kept(method, ErrorCode.CONTOUR_OUT_OF_ORDER, 9)


def test_start_in_the_middle_of_a_plan_is_reported():
    correction = corrector_of(AnalyticModel, job_file()).correct(cone_contour(20))
    assert correction.code == ErrorCode.NO_FORCE_HISTORY
    assert not correction.offset.any()


def test_asking_again_gives_the_same_answer():
    method = corrector_of(AnalyticModel, job_file())
    run(method, [500.0] * 4)
    first = method.correct(cone_contour(4))
    assert np.array_equal(method.correct(cone_contour(4)).offset, first.offset)


def test_a_new_plan_starts_anew():
    method = corrector_of(AnalyticModel, job_file())
    run(method, [500.0] * 8)
    fresh = method.correct(cone_contour(0, plan_id="another"))
    assert fresh.code == 0
    assert not fresh.offset.any()


def test_absurd_force_is_limited_and_reported():
    method = corrector_of(AnalyticModel, job_file(gain="gain: 2.0"))
    last = run(method, [20_000.0] * 20)[-1]
    assert last.code == ErrorCode.CORRECTION_LIMITED
    assert last.saturated.all()
    assert -last.offset[:, 2].min() == pytest.approx(10e-3)


def test_gain_scales_the_correction_and_not_the_prediction():
    full = run(corrector_of(AnalyticModel, job_file()), [500.0] * 10)[-1]
    half = run(corrector_of(AnalyticModel, job_file(gain="gain: 0.5")), [500.0] * 10)[-1]
    assert half.offset == pytest.approx(0.5 * full.offset, abs=1e-9)
    assert half.springback == pytest.approx(full.springback, abs=1e-12)


def test_the_fillet_of_a_floor_does_not_raise_the_prediction():
    # same force, wall angle falling to zero at the floor: the patch of the wall above stays in use
    method = corrector_of(AnalyticModel, job_file())
    wall = run(method, [500.0] * 20)[-1]
    for index, angle in enumerate((30.0, 10.0, 0.5), start=20):
        contour = cone_contour(index, angle=angle, radius=20e-3)
        floor = method.correct(contour)
        method.add_result(contour, result_of(contour, 500.0, squeeze=0.0))
    # the opening is round and the force the same: equal up to the chords of the opening
    assert floor.springback.mean() == pytest.approx(wall.springback.mean(), rel=1e-3)


def test_readings_of_the_sheet_term():
    def level(term):
        return run(corrector_of(AnalyticModel, job_file(), AnalyticOptions(sheet_term=term)), [500.0] * 14)[
            -1
        ].springback.mean()

    axial = level("axial")
    # Praveen 2020 eq. 19-22 read as w n_z; the wall has 50 deg everywhere: exact
    assert level("component") == pytest.approx(axial * np.cos(np.radians(50.0)), rel=1e-9)
    assert level("realised") == pytest.approx(axial * 0.66, rel=1e-9)


def test_solve_time_is_reported():
    # reported, not judged here: a wall-clock limit would measure the test machine
    assert all(c.solve_time > 0.0 for c in run(make_corrector("analytic", job_file()), [500.0] * 3))
