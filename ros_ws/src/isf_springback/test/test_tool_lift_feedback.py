"""Tool lifts: what is read of them, how they scale a law, and that an off-nominal sheet is recognised by them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from isf_core.errors import ErrorCode
from isf_core.files.job import JobFile, lift_interval
from isf_core.process.deflection import SheetSection
from isf_springback.corrector import apply
from isf_springback.estimators.elastic import ElasticModel
from isf_springback.estimators.fused import FusedEstimator
from isf_springback.lift_feedback import (
    COMMON_DEVIATION,
    REGION_DEVIATION,
    LiftedLaw,
    LiftReading,
    lift_awaited,
    lift_due,
    reading_of,
)
from isf_springback.methods import make_corrector
from isf_springback.session import CorrectionSession
from springback_parts import JOB_TEXT, cone_contour, corrector_of, result_of

LOAD = 500.0


def job(method="analytic", every=1, support="opposite"):
    options = f"lift_every: {every}, elastic: {{loop_increment: 4 mm}}, method: {method}"
    text = JOB_TEXT.replace("method: analytic", options).replace("path: {", f"path: {{support: {support}, ")
    if support == "on_blank":
        text = text.replace("control: {support_force: 120 N}\n", "")
    return JobFile(text, Path("."))


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
    assert [k for k in range(10) if lift_due(third, k, 9, "elastic")] == [0, 2, 5]
    assert [k for k in range(10) if lift_awaited(third, k, "elastic")] == [1, 3, 6, 9]
    assert not any(lift_due(never, k, 9, "elastic") for k in range(9))


@pytest.mark.parametrize(
    ("changed", "method", "interval"),
    [
        ({}, "", 4),
        ({}, "auto", 4),
        ({}, "none", 0),
        ({}, "fused", 0),
        ({"method: elastic": "method: analytic"}, "", 0),
        ({"method: elastic": "method: analytic"}, "elastic", 4),
        ({"method: elastic": "method: elastic, lift_every: auto"}, "", 4),
        ({"method: elastic": "method: elastic, lift_every: 0"}, "", 0),
        ({"method: elastic": "method: elastic, lift_every: 7"}, "none", 7),
        ({"incremental_depth:": "style: spiral, incremental_depth:"}, "", 0),
    ],
)
def test_elastic_has_lifts_unless_the_job_says_otherwise(changed, method, interval):
    text = JOB_TEXT.replace("method: analytic", "method: elastic")
    for old, new in changed.items():
        assert old in text
        text = text.replace(old, new)
    assert lift_interval(JobFile(text, Path(".")).job, method) == interval


USUAL = 0.3e-3
"""m, dent that a tool usually stands in."""


def read(law, factor, dent=USUAL, place=(30e-3, 0.0, -5e-3), noise=0.0, rng=None):
    """Arguments of ``add``: springback of ``factor`` times ``law`` (K,) m, and ``dent`` m that the force does not
    change."""
    force = np.linspace(LOAD, 0.3 * LOAD, len(law))
    errors = 0.0 if rng is None else rng.normal(0.0, noise, len(law))
    return np.array(place), LiftReading(np.array(place), force, factor * law + dent + errors), law


WHOLE_SHEET = 3e-3 * np.linspace(1.0, 0.3, 30) ** 0.5
"""m, law of an unbacked sheet under the forces of :func:`read`."""
OVER_A_PLATE = 0.14e-3 * np.linspace(1.0, 0.3, 30)
"""m, law over a plate close to the opening."""


def test_an_estimate_converges_to_the_truth_and_knows_how_well():
    """S_true = 1.3 S_law at places along the loop, read with 0.05 mm of noise."""
    rng = np.random.default_rng(3)
    lifted, there, law = LiftedLaw(), np.array([[30e-3, 0.0, -5e-3]]), WHOLE_SHEET[:1]
    nothing = lifted.at(there, law)
    assert nothing.springback[0] == law[0]
    law_alone = np.hypot(COMMON_DEVIATION, REGION_DEVIATION) * law[0]
    assert nothing.deviation[0] == pytest.approx(np.hypot(law_alone, 0.3e-3))  # with what a law does not know of
    assert lifted.at(there, np.zeros(1)).deviation[0] == 0.0  # without a force nothing springs back
    spread = [float(nothing.deviation[0])]
    for turn in range(6):
        place = np.array([30e-3 * np.cos(turn), 30e-3 * np.sin(turn), -5e-3 - 1e-3 * turn])
        lifted.add(*read(WHOLE_SHEET, 1.3, USUAL, place, 0.05e-3, rng))
        spread.append(float(lifted.at(there, law).deviation[0]))
    found = lifted.at(there, law)
    assert found.springback[0] == pytest.approx(1.3 * law[0], rel=0.04)
    assert abs(found.springback[0] - 1.3 * law[0]) < 2.0 * found.deviation[0]
    assert np.all(np.diff(spread) <= 1e-9)
    assert spread[-1] < 0.3 * spread[0]
    assert "springs back 3.8" in lifted.remark()
    assert lifted.share_at(there)[0] == pytest.approx(1.3, rel=0.04)


@pytest.mark.parametrize(("dent", "missed"), [(USUAL, 0.03e-3), (0.0, 0.25e-3), (0.2e-3, 0.25e-3), (0.6e-3, 0.25e-3)])
@pytest.mark.parametrize(("law", "factor"), [(WHOLE_SHEET, 1.0), (WHOLE_SHEET, 0.7), (OVER_A_PLATE, 4.0)])
def test_a_way_that_the_force_does_not_change_is_no_springback(law, factor, dent, missed):
    """A usual dent is told apart to 0.03 mm; of another one less is missed than it differs by."""
    lifted = LiftedLaw()
    for depth in range(1, 5):
        place = (30e-3, 0.0, -2e-3 * depth)
        lifted.add(*read(law, factor, dent, place))
    assert abs(lifted.at(np.array([place]), law[:1]).springback[0] - factor * law[0]) < missed


def test_a_curve_over_a_plate_tells_its_dent_better_than_one_of_a_whole_sheet():
    """Where the law is small, the way that the force leaves standing is the dent."""
    missed = []
    for law, factor in ((WHOLE_SHEET, 1.0), (OVER_A_PLATE, 4.0)):
        lifted = LiftedLaw()
        for depth in range(1, 9):
            lifted.add(*read(law, factor, 0.55e-3, (30e-3, 0.0, -2e-3 * depth)))
        missed.append(abs(lifted.at(np.array([[30e-3, 0.0, -16e-3]]), law[:1]).springback[0] - factor * law[0]))
    assert missed[1] < 0.6 * missed[0] < 0.6 * 0.25e-3


def test_more_than_a_dent_is_springback():
    """1.2 mm that the force does not change: no dent is deeper than 0.6 mm."""
    lifted = LiftedLaw()
    for depth in range(1, 9):
        place = (30e-3, 0.0, -2e-3 * depth)
        lifted.add(*read(WHOLE_SHEET, 0.3, 1.2e-3, place))
    found = lifted.at(np.array([place]), WHOLE_SHEET[:1]).springback[0] / WHOLE_SHEET[0]
    assert 0.5 < found < (0.3 * 3.0 + 0.9) / 3.0


def test_a_curve_that_bends_more_than_the_law_is_no_way_of_less_than_none():
    """S_true = 1.3 S_law (F / 500 N)^0.1: between 1.3 and what is left of it at the least force."""
    lifted, steps = LiftedLaw(), np.linspace(1.0, 0.3, 30)
    for depth in range(1, 9):
        place = np.array([30e-3, 0.0, -2e-3 * depth])
        lifted.add(place, LiftReading(place, LOAD * steps, 1.3 * WHOLE_SHEET * steps**0.1), WHOLE_SHEET)
    assert 1.3 * 0.3**0.1 < lifted.at(place[None], WHOLE_SHEET[:1]).springback[0] / WHOLE_SHEET[0] < 1.3


def test_what_the_law_does_not_know_of_is_the_same_where_the_law_says_more():
    """Over a plate 0.43 mm more than the law's 0.14 mm: where that says 0.4 mm it is 0.8 to 0.9 mm, not four times as
    much; and without a force nothing springs back."""
    lifted = LiftedLaw()
    for depth in range(1, 9):
        place = (30e-3, 0.0, -2e-3 * depth)
        lifted.add(*read(OVER_A_PLATE, 4.0, USUAL, place))
    here = np.tile(place, (3, 1))
    more, same, none = lifted.at(here, np.array([0.4e-3, 0.14e-3, 0.0])).springback
    assert 0.8e-3 < more < 0.9e-3
    assert same == pytest.approx(0.56e-3, abs=0.02e-3)
    assert none == 0.0


@pytest.mark.parametrize(
    ("law", "factor", "least", "most"),
    [(WHOLE_SHEET, 5.0, 1.99, 2.0), (OVER_A_PLATE, 20.0, 7.3, 7.5), (WHOLE_SHEET, 0.1, 0.5, 0.51)],
)
def test_an_estimate_stays_within_what_is_believed(law, factor, least, most):
    """At most twice the law, or 0.9 mm more, and at least half of it."""
    lifted = LiftedLaw()
    for depth in range(1, 9):
        place = (30e-3, 0.0, -2e-3 * depth)
        lifted.add(*read(law, factor, USUAL, place))
    assert least <= lifted.at(np.array([place]), law[:1]).springback[0] / law[0] <= most


def test_a_region_of_its_own_is_reported_from_the_whole_part():
    """One place 15 % above the others: near it the estimate follows, far from it the others count."""
    lifted = LiftedLaw()
    for turn in range(6):
        place = 40e-3 * np.array([np.cos(turn), np.sin(turn), 0.0])
        lifted.add(*read(2.0 * WHOLE_SHEET, 1.15 if turn == 0 else 1.0, USUAL, place))
    near, far = lifted.share_at(np.array([[40e-3, 0.0, 0.0], [-40e-3, 0.0, 0.0]]))
    assert near > 1.06
    assert abs(far - 1.0) < 0.04


def test_lifts_that_contradict_what_was_expected_of_them_make_the_law_as_doubtful():
    """Springback of 1.0 and 1.6 of the law in turn, at one place: no law with a factor explains it. In agreement the
    same readings say how well they know."""
    place = (30e-3, 0.0, -4e-3)
    steady, torn = LiftedLaw(), LiftedLaw()
    for turn in range(8):
        steady.add(*read(WHOLE_SHEET, 1.3, USUAL, place))
        torn.add(*read(WHOLE_SHEET, 1.6 if turn % 2 else 1.0, USUAL, place))
    known, doubtful = (law.at(np.array([place]), WHOLE_SHEET[:1]) for law in (steady, torn))
    assert steady.spread == 1.0
    assert 2.0 < torn.spread < 8.0
    assert doubtful.deviation[0] == pytest.approx(torn.spread * known.deviation[0], rel=1e-6)


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
                gone = np.append(truth(nominal, force[:-1]) + USUAL, 0.0)
                method.add_lift(
                    reading_of(np.column_stack([np.full((41, 2), (x, y)), z + gone[0] - gone, force])), index
                )
        error[every] = abs(np.mean(lacks[-2:]))
    assert error[2] < 0.35 * error[0]
    assert error[2] < 0.15e-3
    assert any("tool lifting" in remark for remark in correction.remarks)


@pytest.mark.parametrize("name", ["analytic", "elastic", "fused"])
def test_a_sheet_that_the_forming_tool_holds_alone_with_less_than_both_tools_springs_back_by_what_the_lift_finds(name):
    """The support tool is beside the contact: while forming, both forces sum up to LOAD; 0.65 of it holds the sheet."""
    method = make_corrector(name, job(name, 2, "on_blank"))
    model = getattr(method.estimator, "_model", method.estimator)
    held = np.append(0.65 * np.linspace(LOAD, 0.2 * LOAD, 40), 0.0)
    for index in range(10):
        contour = cone_contour(index)
        correction = method.correct(contour)
        corrected = apply(contour, correction, support_stays=True)
        method.add_result(corrected, result_of(corrected, LOAD))
        springback, asked = (float(model.springback_under(contour, len(contour) - 1, f)[0]) for f in (held, [LOAD]))
        if index % 2 == 1:
            x, y, z = corrected.forming_tip[-1]
            gone = np.append(model.springback_under(contour, len(contour) - 1, held[:-1]) + USUAL, 0.0)
            rows = np.column_stack([np.full((41, 2), (x, y)), z + gone[0] - gone, held])
            method.add_lift(reading_of(rows), index)
    assert asked > springback + 0.5e-3
    assert float(correction.springback[-1]) == pytest.approx(springback, abs=0.15e-3)


def test_what_scans_have_fixed_stays_when_a_lift_changes_the_model():
    method = corrector_of(FusedEstimator, job("fused"))
    contours = [cone_contour(index) for index in range(8)]
    for contour in contours[:-1]:
        correction = method.correct(contour)
        method.add_result(apply(contour, correction), result_of(contour, LOAD))
    now = method.estimator._now
    known = method.estimator._fields(now, contours[-2].forming_tip[::20, :2])
    now.wall, now.bottom = (replace(field, covariance=1e-6 * field.covariance) for field in known)
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
        if index in (1, 2, 4):
            assert session.advance() is None  # a lift is due after contours 0, 1 and 3
            if index < 4:
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
