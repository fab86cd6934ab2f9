"""Tool lifts: what is read of them, how they scale a law, and that an off-nominal sheet is recognised by them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from isf_core.errors import ErrorCode
from isf_core.files.job import JobFile
from isf_core.process.deflection import SheetSection
from isf_springback.corrector import apply
from isf_springback.estimators.elastic import ElasticModel
from isf_springback.estimators.fused import FusedEstimator
from isf_springback.lift_feedback import (
    COMMON_DEVIATION,
    REGION_DEVIATION,
    LawScale,
    LiftReading,
    lift_awaited,
    lift_due,
    reading_of,
)
from isf_springback.methods import make_corrector
from isf_springback.session import CorrectionSession
from springback_parts import JOB_TEXT, cone_contour, corrector_of, result_of

LOAD = 500.0


def job(method="analytic", every=1):
    options = f"lift_every: {every}, elastic: {{loop_increment: 4 mm}}, method: {method}"
    return JobFile(JOB_TEXT.replace("method: analytic", options), Path("."))


def rows_of(springback, force=LOAD, exponent=0.6, place=(0.0, 0.0, -5e-3), points=60):
    """Rows of a lift with S = springback (F / force)^exponent."""
    loads = np.linspace(force, 0.0, points)
    displacement = springback * (loads / force) ** exponent
    z = place[2] + springback - displacement
    return np.column_stack([np.full(points, place[0]), np.full(points, place[1]), z, loads])


def test_a_lift_is_read_as_force_against_elastic_displacement():
    reading = reading_of(rows_of(4e-3))
    assert reading.springback == pytest.approx(4e-3)
    np.testing.assert_allclose(reading.displacement, 4e-3 * (reading.force / LOAD) ** 0.6, rtol=1e-9)
    assert reading.force.min() >= 0.3 * LOAD
    upward = rows_of(4e-3)
    upward[:, 2:] *= -1.0  # a lower forming tool lifts downwards, and reads the opposite force
    assert reading_of(upward).springback == pytest.approx(4e-3)


@pytest.mark.parametrize(
    "rows",
    [
        np.empty((0, 4)),
        rows_of(4e-3)[:2],
        rows_of(4e-3)[:, :3],
        rows_of(4e-3) * np.nan,
        rows_of(0.0),
        np.zeros((20, 4)),
        rows_of(0.5),
    ],
)
def test_a_useless_lift_is_no_reading(rows):
    assert reading_of(rows) is None


def test_lifts_are_due_between_contours_and_not_after_the_last():
    third, never = job(every=3), job(every=0)
    assert [k for k in range(10) if lift_due(third, k, 9)] == [2, 5]
    assert [k for k in range(10) if lift_awaited(third, k)] == [3, 6, 9]
    assert not any(lift_due(never, k, 9) for k in range(9))


def test_a_scale_converges_to_the_truth_and_knows_how_well():
    """S_true = 1.3 S_law (F / 500 N)^0.1 at places along the loop, read with 0.1 mm of noise."""
    rng = np.random.default_rng(3)
    scale, there = LawScale(), np.array([[30e-3, 0.0, -5e-3]])
    nothing = scale.at(there, np.array([LOAD]))
    assert nothing.factor[0] == 1.0
    assert nothing.deviation[0] == pytest.approx(np.hypot(COMMON_DEVIATION, REGION_DEVIATION))
    spread = [float(nothing.deviation[0])]
    for turn in range(6):
        place = np.array([30e-3 * np.cos(turn), 30e-3 * np.sin(turn), -5e-3 - 1e-3 * turn])
        force = np.linspace(LOAD, 0.3 * LOAD, 30)
        law = 3e-3 * (force / LOAD) ** 0.5
        true = 1.3 * law * (force / LOAD) ** 0.1
        reading = LiftReading(place, force, true * (1.0 + rng.normal(0.0, 0.02)))
        scale.add(place, reading, law)
        spread.append(float(scale.at(there, np.array([LOAD])).deviation[0]))
    found = scale.at(there, np.array([LOAD, 0.5 * LOAD])[:1])
    assert found.factor[0] == pytest.approx(1.3, rel=0.04)
    assert abs(np.log(found.factor[0] / 1.3)) < 2.0 * found.deviation[0]
    assert np.all(np.diff(spread) <= 1e-12)
    assert spread[-1] < 0.3 * spread[0]
    half = scale.at(there, np.array([0.5 * LOAD])).factor[0]
    assert half == pytest.approx(1.3 * 0.5**0.1, rel=0.05)
    assert "1.3" in scale.remark()


def test_a_region_of_its_own_is_reported_from_the_whole_part():
    """One place 15 % above the others: near it the scale follows, far from it the others count."""
    scale = LawScale()
    force, law = np.linspace(LOAD, 200.0, 20), np.linspace(3e-3, 2e-3, 20)
    for turn in range(6):
        place = 40e-3 * np.array([np.cos(turn), np.sin(turn), 0.0])
        factor = 1.15 if turn == 0 else 1.0
        scale.add(place, LiftReading(place, force, factor * law), law)
    near = scale.at(np.array([[40e-3, 0.0, 0.0]]), np.array([LOAD])).factor[0]
    far = scale.at(np.array([[-40e-3, 0.0, 0.0]]), np.array([LOAD])).factor[0]
    assert near > 1.06
    assert abs(far - 1.0) < 0.04


def softer(method):
    """Springback (K,) m of the true sheet where a contour ends, under forces (K,) N.

    Analytic law: thinner and softer than the job says. Shell: a quarter more than it says, as with another edge.
    """
    model = getattr(method.estimator, "_model", method.estimator)
    if isinstance(model, ElasticModel):
        return lambda contour, force: 1.25 * model.springback_under(contour, len(contour) - 1, force)
    section = model._section
    thin = SheetSection(0.9 * section.young_modulus, section.poisson_ratio, 0.88 * section.thickness)

    def law(contour, force):
        known, model._section = model._section, thin
        try:
            return model.springback_under(contour, len(contour) - 1, force)
        finally:
            model._section = known

    return law


@pytest.mark.parametrize("name", ["analytic", "elastic", "fused"])
def test_an_off_nominal_sheet_is_recognised_and_the_error_is_lower_than_without(name):
    """Error: what the push of the last contours lacks of the springback of the true sheet under the same force."""
    error = {}
    for every in (0, 2):
        method = make_corrector(name, job(name, every))
        truth, lacks = softer(method), []
        for index in range(10):
            nominal = cone_contour(index)
            correction = method.correct(nominal)
            corrected = apply(nominal, correction)
            method.add_result(corrected, result_of(corrected, LOAD))
            lacks.append(float(truth(nominal, np.array([LOAD]))[0] + correction.offset[-1, 2]))
            if every and index % every == 1:
                force = np.append(np.linspace(LOAD, 100.0, 40), 0.0)
                x, y, z = corrected.forming_tip[-1]
                gone = np.append(truth(nominal, force[:-1]), 0.0)
                method.add_lift(
                    reading_of(np.column_stack([np.full((41, 2), (x, y)), z + gone[0] - gone, force])), index
                )
        error[every] = abs(np.mean(lacks[-2:]))
    assert error[2] < 0.35 * error[0]
    assert error[2] < 0.15e-3
    assert any("tool lifting" in remark for remark in correction.remarks)


def test_what_scans_have_fixed_stays_when_a_lift_changes_the_model():
    method = corrector_of(FusedEstimator, job("fused"))
    contours = [cone_contour(index) for index in range(8)]
    for contour in contours[:-1]:
        correction = method.correct(contour)
        method.add_result(apply(contour, correction), result_of(contour, LOAD))
    known = method.estimator._fields(contours[-2].forming_tip[::20, :2])
    method.estimator._wall, method.estimator._bottom = (
        replace(field, covariance=1e-6 * field.covariance) for field in known
    )
    twin_push = -float(correction.offset[:, 2].mean())
    method.add_lift(reading_of(rows_of(1.3 * twin_push, place=tuple(contours[-2].forming_tip[-1]))), 6)
    after = method.correct(contours[-1])
    assert any("tool lifting" in remark for remark in after.remarks)
    assert -float(after.offset[:, 2].mean()) == pytest.approx(twin_push, abs=0.25e-3)


def test_a_new_part_begins_without_the_scale_of_the_last_one():
    method = corrector_of(ElasticModel, job("elastic"))
    contour = cone_contour(3)
    method.correct(contour)
    method.add_lift(reading_of(rows_of(8e-3, place=tuple(contour.forming_tip[-1]))), 3)
    assert method.estimator.lifted_share(contour.contact)[0] > 1.05
    method.correct(cone_contour(0, plan_id="next"))
    assert method.estimator.lifted_share(contour.contact)[0] == 1.0


def test_a_failed_lift_is_reported_and_changes_nothing():
    method = make_corrector("analytic", job())
    first, second = cone_contour(0), cone_contour(1)
    method.add_result(first, result_of(apply(first, method.correct(first)), LOAD))
    method.add_lift(None, 0)
    correction = method.correct(second)
    assert correction.code == 0
    assert any("no usable reading" in remark for remark in correction.remarks)
    assert method.estimator.lifted_share(second.contact)[0] == 1.0


class Clock:
    now = 0.0

    def __call__(self):
        return self.now


def test_the_session_waits_for_a_lift_and_goes_on_without_it():
    clock = Clock()
    session = CorrectionSession(5.0, clock)
    session.set_job(job(every=2))
    before = None
    for index in range(5):
        session.add_contour(cone_contour(index))
        if index in (2, 4):
            assert session.advance() is None  # a lift is due after contours 1 and 3
            if index == 2:
                session.add_lift(rows_of(6e-3, place=tuple(before.corrected.forming_tip[-1])), 1.0)
            else:
                session.add_lift(rows_of(6e-3), 0.5)  # older than the contour: of an earlier part
                assert session.advance() is None
                clock.now += 6.0
        before = session.advance()
        assert before.correction.code == (ErrorCode.LIFT_MISSING if index == 4 else 0)
        session.add_result(result_of(before.corrected, LOAD))
    # a method that takes over is told of the lift, too
    session.choose("fused")
    session.add_contour(cone_contour(5))
    clock.now += 6.0
    assert any("tool lifting" in remark for remark in session.advance().correction.remarks)
