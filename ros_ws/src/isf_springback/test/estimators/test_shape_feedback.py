"""Methods that look at the formed shape, on a sheet with known springback: they converge, and bad scans never jump."""

import json
from pathlib import Path

import numpy as np
import pytest
from isf_core.errors import ErrorCode
from isf_core.files.job import JobFile
from isf_springback.corrector import apply
from isf_springback.estimators.fused import OF_A_MODEL, carried, first_field, updated
from isf_springback.methods import make_corrector
from isf_springback.scan.feedback import scan_awaited, scan_due
from isf_springback.session import CorrectionSession
from scanned_sheet import COUNT, TARGET, Sheet
from springback_parts import JOB_TEXT, cone_contour, result_of

METHODS_WITH_EYES = ["mpc_vertical", "mpc_two_directional", "fused"]


def job(method="fused", **mpc):
    text = JOB_TEXT.replace("method: analytic", f"scan_every: 1, method: {method}, mpc: {json.dumps(mpc)}")
    return JobFile(text, Path("."))


def run(method, sheet, *, load=lambda k: 500.0, see=lambda points, k: points, count=COUNT):
    """Form a cone; the corrections and their mean push, m."""
    method.set_target(TARGET)
    corrections = []
    for index in range(count):
        nominal = cone_contour(index, count=COUNT)
        correction = method.correct(nominal)
        corrected = apply(nominal, correction)
        sheet.form(corrected)
        method.add_result(corrected, result_of(corrected, load(index)))
        points = see(sheet.points(), index)
        if points is not None:
            method.add_scan(points, index)
        corrections.append(correction)
    return corrections


def wall_error(sheet, low=4e-3, high=9e-3):
    """Mean error of the wall between two depths, m."""
    chosen = (TARGET.z < -low) & (TARGET.z > -high)
    return float((sheet.z - TARGET.z)[chosen].mean())


@pytest.mark.parametrize("name", METHODS_WITH_EYES)
def test_the_wall_becomes_right_whatever_the_model_believes(name):
    """Springback grows to ``amount`` within the first millimetres; the analytic model expects about 4 mm."""
    amount = 1.2e-3
    sheet = Sheet(lambda depth, around: amount * (1 - np.exp(-depth / 1.5e-3)))
    method = make_corrector(name, job(name))
    run(method, sheet)
    # a model that is wrong by 3 mm has over-formed the first contours before the shape could tell
    assert abs(wall_error(sheet)) < (0.3e-3 if name == "fused" else 0.15e-3)
    blind = Sheet(sheet.springback)
    run(make_corrector("mpc_vertical", job("mpc_vertical")), blind, see=lambda points, k: None)
    assert wall_error(blind) > 0.6 * amount


def test_fused_needs_fewer_contours_than_shape_alone_when_the_model_is_right():
    """The model's own springback as truth: feedforward has it from the second contour on."""
    model = make_corrector("analytic", job("analytic"))
    level = []
    for index in range(6):
        nominal = cone_contour(index, count=COUNT)
        corrected = apply(nominal, model.correct(nominal))
        model.add_result(corrected, result_of(corrected, 200.0))
        level.append(float(-corrected.forming_tip[:, 2].mean() + nominal.forming_tip[:, 2].mean()))
    truth = level[-1]
    errors = {}
    for name in ("fused", "mpc_vertical"):
        sheet = Sheet(lambda depth, around: truth * (1 - np.exp(-depth / 1e-3)))
        run(make_corrector(name, job(name)), sheet, load=lambda k: 200.0)
        errors[name] = abs(wall_error(sheet, 2e-3, 6e-3))
    assert errors["fused"] < errors["mpc_vertical"]


def test_step_depth_per_direction_follows_an_uneven_sheet():
    uneven = lambda depth, around: (1.0e-3 + 0.4e-3 * np.cos(around)) * (1 - np.exp(-depth / 1.5e-3))  # noqa: E731
    spread = {}
    for step in ("common", "per_direction"):
        sheet = Sheet(uneven)
        run(make_corrector("mpc_vertical", job("mpc_vertical", step=step)), sheet)
        chosen = (TARGET.z < -4e-3) & (TARGET.z > -9e-3)
        spread[step] = float((sheet.z - TARGET.z)[chosen].std())
    assert spread["per_direction"] < 0.6 * spread["common"]


def test_horizontal_springback_needs_horizontal_moves():
    """Walls that come back inwards by 0.5 mm: only the two-directional controller gets them right."""
    errors = {}
    for name in ("mpc_vertical", "mpc_two_directional"):
        sheet = Sheet(lambda depth, around: 0.5e-3, inwards=0.5e-3)
        run(make_corrector(name, job(name, distribution="uniform")), sheet)
        errors[name] = wall_error(sheet)
    assert errors["mpc_vertical"] > 0.3e-3
    assert abs(errors["mpc_two_directional"]) < 0.15e-3


@pytest.mark.parametrize("name", ["mpc_vertical", "fused"])
@pytest.mark.parametrize(
    ("spoil", "code"),
    [
        (lambda p: p + [5e-3, 0, 0], ErrorCode.SCAN_SHIFTED),
        (lambda p: p * np.nan, ErrorCode.SCAN_NOT_FINITE),
    ],
)
def test_a_bad_scan_gives_its_code_and_no_jump(name, spoil, code):
    sheet = Sheet(lambda depth, around: 1e-3 * (1 - np.exp(-depth / 1.5e-3)))
    corrections = run(
        make_corrector(name, job(name)), sheet, see=lambda points, k: spoil(points) if k == 12 else points, count=16
    )
    push = np.array([-c.offset[:, 2].mean() for c in corrections])
    assert corrections[13].code == code
    assert corrections[13].message
    assert corrections[14].code == 0
    assert abs(push[13] - push[12]) < 0.1e-3
    assert np.abs(np.diff(push[10:])).max() < 0.5e-3


@pytest.mark.parametrize("name", ["mpc_vertical", "fused"])
def test_noise_and_holes_hardly_matter(name):
    rng = np.random.default_rng(5)

    def scanner(points, k):
        hole = rng.uniform(-30e-3, 30e-3, 2)
        keep = np.linalg.norm(points[:, :2] - hole, axis=1) > 10e-3
        return points[keep] + rng.normal(0.0, 25e-6, (int(keep.sum()), 3))

    sheet = Sheet(lambda depth, around: 1e-3 * (1 - np.exp(-depth / 1.5e-3)))
    corrections = run(
        make_corrector(name, job(name, reference_angles=[f"{a} deg" for a in (0, 90, 210)])), sheet, see=scanner
    )
    assert abs(wall_error(sheet)) < 0.3e-3
    assert not any(c.code for c in corrections)


def test_disagreement_of_model_and_shape_is_reported_bounded_and_not_followed():
    """The model sees a force three times too high; the shape says 0.5 mm."""
    sheet = Sheet(lambda depth, around: 0.5e-3 * (1 - np.exp(-depth / 1e-3)))
    corrections = run(make_corrector("fused", job()), sheet, load=lambda k: 1500.0)
    reported = [c for c in corrections if any("relative to the model" in r for r in c.remarks)]
    assert reported
    push = np.array([-c.offset[:, 2].mean() for c in corrections])
    assert push.max() <= 10e-3
    assert push.min() >= -1e-3
    assert push[-1] == pytest.approx(0.5e-3, abs=0.4e-3)


def test_fused_reports_its_uncertainty_and_it_shrinks():
    sheet = Sheet(lambda depth, around: 1e-3 * (1 - np.exp(-depth / 1.5e-3)))
    corrections = run(make_corrector("fused", job()), sheet)
    assert corrections[0].uncertainty.mean() > 2 * corrections[-1].uncertainty.mean() > 0


def test_bias_is_shared_by_neighbours_and_a_surprise_is_believed_less():
    place = np.column_stack([np.arange(20) * 15e-3, np.zeros(20)])
    field = first_field(place)
    measured = np.full(20, np.nan)
    measured[10] = 1e-3
    once, doubtful = updated(field, measured, np.full(20, 0.1e-3))
    assert not doubtful.any()
    assert once.bias[10] == pytest.approx(1e-3, abs=0.05e-3)
    assert 0.3e-3 < once.bias[11] < once.bias[10]
    assert once.bias[0] == pytest.approx(
        OF_A_MODEL.common * once.bias[10], rel=0.05
    )  # far away only what is common to all
    assert once.deviation[10] < 0.2 * once.deviation[0]
    wild = np.where(np.isfinite(measured), 10e-3, np.nan)
    surprised, doubtful = updated(once, wild, np.full(20, 0.1e-3))
    assert doubtful[10]
    assert surprised.bias[10] < 5e-3
    assert carried(once, place).deviation[10] > once.deviation[10]


def test_which_contours_wait_for_a_scan():
    job_file = JobFile(JOB_TEXT.replace("method: analytic", "scan_every: 3, method: fused"), Path("."))
    due = [k for k in range(12) if scan_due(job_file, k, 12)]
    assert due == [2, 5, 8]
    assert [k for k in range(12) if scan_awaited(job_file, k)] == [3, 6, 9]
    assert not scan_due(JobFile(JOB_TEXT, Path(".")), 2, 12)


class Clock:
    now = 0.0

    def __call__(self):
        return self.now


@pytest.fixture
def clock():
    return Clock()


@pytest.fixture
def session(clock):
    session = CorrectionSession(5.0, clock)
    session.set_job(job(), "plan")
    session.set_target(TARGET)
    return session


def correct_first(session):
    session.add_contour(cone_contour(0, count=COUNT))
    first = session.advance()
    session.add_result(result_of(first.corrected, 500.0))  # ends at 1.0 s
    return first


def test_a_contour_waits_for_its_scan_and_ignores_an_older_one(session):
    correct_first(session)
    points = Sheet(lambda *_: 0.0).points()
    session.add_scan(points, 0.5)  # of an earlier moment
    session.add_contour(cone_contour(1, count=COUNT))
    assert session.advance() is None
    session.add_scan(points, 1.0)
    outcome = session.advance()
    assert outcome.correction.code == 0
    assert outcome.corrected is not None


def test_a_scan_may_come_before_the_result(session):
    session.add_contour(cone_contour(0, count=COUNT))
    first = session.advance()
    session.add_scan(Sheet(lambda *_: 0.0).points(), 1.0)
    session.add_result(result_of(first.corrected, 500.0))
    session.add_contour(cone_contour(1, count=COUNT))
    assert session.advance().correction.code == 0


def test_a_scan_that_never_comes_is_reported_and_the_part_goes_on(session, clock):
    correct_first(session)
    session.add_contour(cone_contour(1, count=COUNT))
    assert session.advance() is None
    clock.now = 5.0
    outcome = session.advance()
    assert outcome.correction.code == ErrorCode.SCAN_MISSING
    assert outcome.corrected is not None


def test_methods_without_eyes_do_not_wait(session):
    session.choose("analytic")
    correct_first(session)
    session.add_contour(cone_contour(1, count=COUNT))
    assert session.advance().correction.method == "analytic"


def test_methods_change_between_contours_without_a_jump(session):
    """From the shape methods to none and back; horizontal offsets are handed over too."""
    sheet = Sheet(lambda depth, around: 1e-3 * (1 - np.exp(-depth / 1.5e-3)))
    offsets = []
    for index in range(24):
        session.choose("fused" if index < 8 else "mpc_two_directional" if index < 16 else "none")
        nominal = cone_contour(index, count=COUNT)
        session.add_contour(nominal)
        outcome = session.advance()
        sheet.form(outcome.corrected)
        session.add_result(result_of(outcome.corrected, 500.0))
        session.add_scan(sheet.points(), 1.0)
        offsets.append(np.abs(outcome.correction.offset).mean(axis=0))
    assert np.abs(np.diff(offsets, axis=0)).max() <= 1.0e-3 + 1e-9
    assert offsets[-1][2] == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("name", METHODS_WITH_EYES)
def test_without_a_target_the_last_correction_is_kept(name):
    method = make_corrector(name, job(name))
    nominal = cone_contour(0, count=COUNT)
    method.add_result(nominal, result_of(apply(nominal, method.correct(nominal)), 500.0))
    method.add_scan(Sheet(lambda *_: 0.0).points(), 0)
    correction = method.correct(cone_contour(1, count=COUNT))
    assert correction.code == ErrorCode.CORRECTION_FAILED
    assert "target" in correction.message


def test_every_method_with_eyes_is_registered():
    for name in METHODS_WITH_EYES + ["mpc_tpif"]:
        assert make_corrector(name, job(name)).uses_scans
    assert not make_corrector("analytic", job("analytic")).uses_scans
