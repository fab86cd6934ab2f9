"""Order of job, contours and results at the springback node, without ROS."""

import numpy as np
import pytest
from isf_core.errors import ErrorCode, IsfError
from isf_springback.corrector import Corrector
from isf_springback.estimators.estimator import Estimator, Prediction
from isf_springback.session import CorrectionSession
from springback_parts import cone_contour, job_file, result_of

TIMEOUT = 5.0


class Clock:
    """A clock that the test moves."""

    now = 0.0

    def __call__(self):
        return self.now


@pytest.fixture
def clock():
    return Clock()


@pytest.fixture
def session(clock):
    session = CorrectionSession(TIMEOUT, clock)
    session.set_job(job_file(), "plan")
    return session


def form(session, index, load=500.0, plan_id="plan"):
    """Correct contour ``index`` and hand in its result; the outcome."""
    session.add_contour(cone_contour(index, plan_id=plan_id))
    outcome = session.advance()
    assert outcome is not None
    session.add_result(result_of(outcome.corrected, load))
    return outcome


def level(outcome):
    return -outcome.correction.offset[:, 2].mean()


def test_a_part_in_order(session):
    outcomes = [form(session, index) for index in range(8)]
    assert [o.correction.code for o in outcomes] == [0] * 8
    assert {o.correction.method for o in outcomes} == {"analytic"}
    assert level(outcomes[-1]) > 4e-3
    moved = outcomes[-1].corrected.forming_tip - cone_contour(7).forming_tip
    assert moved == pytest.approx(outcomes[-1].correction.offset, abs=1e-15)


def test_a_contour_waits_for_the_result_before(session):
    form(session, 0)
    session.add_contour(cone_contour(1))
    first = session.advance()
    session.add_contour(cone_contour(2))
    assert session.advance() is None
    session.add_result(result_of(first.corrected, 500.0))
    assert session.advance().correction.code == 0
    assert session.advance() is None


def test_a_result_that_never_comes_keeps_the_last_correction(session, clock):
    last = [form(session, index) for index in range(6)][-1]
    session.add_contour(cone_contour(6))
    kept = session.advance()
    session.add_contour(cone_contour(7))
    clock.now = TIMEOUT - 0.01
    assert session.advance() is None
    clock.now = TIMEOUT
    late = session.advance()
    assert late.correction.code == ErrorCode.NO_FORCE_HISTORY
    assert level(late) == pytest.approx(level(kept), abs=20e-6)
    assert level(late) >= level(last) - 20e-6


def test_a_contour_waits_for_its_job(clock):
    session = CorrectionSession(TIMEOUT, clock)
    session.set_job(job_file(), "another plan")
    session.add_contour(cone_contour(0))
    assert session.advance() is None
    session.set_job(job_file(), "plan", method="none")
    assert session.advance().correction.method == "none"


def test_without_a_job_the_contour_is_refused(clock):
    session = CorrectionSession(TIMEOUT, clock)
    session.add_contour(cone_contour(0))
    clock.now = TIMEOUT
    outcome = session.advance()
    assert outcome.corrected is None
    assert outcome.correction.code == ErrorCode.CORRECTION_FAILED
    assert "part/info" in outcome.correction.message


def test_a_malformed_contour_is_refused(session):
    contour = cone_contour(0)
    contour.normal[3] = np.nan
    session.add_contour(contour)
    outcome = session.advance()
    assert outcome.corrected is None
    assert outcome.correction.code == ErrorCode.CONTOUR_REJECTED


def test_unknown_method_is_refused_and_the_old_one_stays(session):
    with pytest.raises(IsfError) as caught:
        session.choose("magic")
    assert caught.value.code == ErrorCode.METHOD_UNKNOWN
    assert session.method_name == "analytic"


def test_auto_is_the_method_that_goes_with_the_job(session):
    session.choose("auto")
    assert session.method_name == "elastic"
    session.choose("")
    session.set_job(job_file(), "plan", method="auto")
    assert session.method_name == "elastic"


def test_unknown_method_of_the_run_is_reported(session):
    session.set_job(job_file(), "plan", method="magic")
    session.add_contour(cone_contour(0))
    assert session.advance().correction.code == ErrorCode.METHOD_UNKNOWN


def test_a_method_without_its_scans_is_refused_at_the_first_contour_and_declined_later(session):
    session.choose("mpc_vertical")
    session.add_contour(cone_contour(0))
    refused = session.advance()
    assert refused.corrected is None
    assert refused.correction.code == ErrorCode.FILE_FIELD
    assert "springback.scan_every" in refused.correction.message
    session.choose("")
    for index, choice, code in ((0, "", 0), (1, "mpc_vertical", ErrorCode.FILE_FIELD), (2, "", 0)):
        session.choose(choice)
        contour = cone_contour(index)
        session.add_contour(contour)
        outcome = session.advance()
        assert (outcome.correction.code, outcome.correction.method) == (code, "analytic")
        session.add_result(result_of(contour, 500.0))
    assert outcome.correction.message == ""


@pytest.mark.parametrize("method", ["learned", "learned_map"])
def test_a_method_that_cannot_be_made_is_declined_in_mid_part(session, method):
    """The job names no springback.learning: half a part is formed, and goes on with the method it has."""
    for index, choice, code in ((0, "", 0), (1, method, ErrorCode.LEARNING_UNUSABLE), (2, "", 0)):
        session.choose(choice)
        contour = cone_contour(index)
        session.add_contour(contour)
        outcome = session.advance()
        assert outcome.corrected is not None
        assert (outcome.correction.code, outcome.correction.method) == (code, "analytic")
        session.add_result(result_of(contour, 500.0))


def test_method_changes_between_contours_without_a_jump(session):
    levels, methods = [], []
    for index in range(24):
        if index == 8:
            session.choose("none")
        if index == 16:
            session.choose("analytic")
        outcome = form(session, index)
        assert outcome.correction.code == 0
        levels.append(level(outcome))
        methods.append(outcome.correction.method)
    assert methods == ["analytic"] * 8 + ["none"] * 8 + ["analytic"] * 8
    # two incremental depths per contour
    assert np.abs(np.diff(levels)).max() <= 1e-3 + 1e-9
    assert levels[15] == pytest.approx(0.0, abs=1e-9)
    assert levels[23] > 4e-3


@pytest.mark.parametrize("plan_id", ["plan", "next"])
def test_a_new_part_starts_without_correction(session, plan_id):
    for index in range(6):
        form(session, index)
    session.set_job(job_file(), plan_id)
    fresh = form(session, 0, plan_id=plan_id)
    assert fresh.correction.code == 0
    assert level(fresh) == 0.0
    assert form(session, 1, plan_id=plan_id).correction.code == 0


def test_a_contour_sent_twice_gets_the_same_answer(session):
    for index in range(5):
        form(session, index)
    session.add_contour(cone_contour(5))
    first = session.advance()
    session.add_contour(cone_contour(5))
    assert np.array_equal(session.advance().correction.offset, first.correction.offset)


@pytest.mark.parametrize("switch", [None, 6])
def test_a_part_goes_on_as_if_it_had_not_been_interrupted(session, switch, tmp_path, clock):
    """Bit for bit, after a change of the method too."""
    going_on = None
    for index in range(14):
        if index == switch:
            session.choose("none")
        if index == 10:
            going_on = CorrectionSession(TIMEOUT, clock)
            going_on.choose("none" if switch else "")
            going_on.load(tmp_path)
            going_on.set_job(job_file(), "plan")
        whole = form(session, index, load=400.0 + 20.0 * index)
        assert session.complete
        if going_on is None:
            session.save(tmp_path)
        else:
            again = form(going_on, index, load=400.0 + 20.0 * index)
            assert again.correction.code == 0
            assert np.array_equal(again.correction.offset, whole.correction.offset)
            assert np.array_equal(again.corrected.contact, whole.corrected.contact)
    assert switch or level(whole) > 3e-3


def test_only_what_is_new_is_written(session, tmp_path):
    form(session, 0)
    session.save(tmp_path)
    first = (tmp_path / "contour_000000.001.npz").stat().st_mtime_ns
    form(session, 1)
    session.save(tmp_path)
    assert (tmp_path / "contour_000000.001.npz").stat().st_mtime_ns == first
    names = ["contour_000000.001.npz", "contour_000001.001.npz"]
    assert sorted(path.name for path in tmp_path.iterdir()) == names


def test_contours_of_another_state_are_not_gone_on_with(session, tmp_path, clock):
    """Those of a part that came farther, and none at all."""
    for index in range(8):
        form(session, index)
    session.save(tmp_path)
    other = CorrectionSession(TIMEOUT, clock)
    other.load(tmp_path)
    other.set_job(job_file(), "plan")
    other.add_contour(cone_contour(4))
    assert other.advance().correction.code == ErrorCode.CHECKPOINT_UNUSABLE
    (tmp_path / "empty").mkdir()
    with pytest.raises(IsfError) as caught:
        other.load(tmp_path / "empty")
    assert caught.value.code == ErrorCode.FILE_NOT_FOUND


def test_a_new_part_begins_after_one_that_was_to_go_on_and_did_not(session, tmp_path, clock):
    form(session, 0)
    session.save(tmp_path)
    other = CorrectionSession(TIMEOUT, clock)
    other.set_job(job_file(), "plan")
    other.load(tmp_path)  # ... and the part ends before its next contour
    other.forget()
    assert form(other, 0).correction.code == 0
    assert form(other, 1).correction.code == 0


def test_a_method_that_decides_otherwise_by_now_is_noticed(session, tmp_path, clock):
    for index in range(6):
        form(session, index)
    session.save(tmp_path)
    other = CorrectionSession(TIMEOUT, clock)
    other.load(tmp_path)
    other.set_job(job_file(gain="gain: 0.8"), "plan")
    other.add_contour(cone_contour(6))
    refused = other.advance()
    assert refused.corrected is None
    assert refused.correction.code == ErrorCode.CHECKPOINT_UNUSABLE
    assert "another correction" in refused.correction.message


class Counting(Estimator):
    """Asks for 0.1 mm more each time, as a method does that keeps what it computed; lacks something at contour 3."""

    name = "analytic"
    asked = 0

    def estimate(self, contour, history):
        self.asked += 1
        lacks = IsfError(ErrorCode.CORRECTION_FAILED, "lacks something") if contour.index == 3 else None
        return Prediction(np.empty(0), push=np.full(len(contour), 0.1e-3 * self.asked), fault=lacks)


def test_a_method_is_asked_again_for_a_contour_it_lacked_something_for(session, tmp_path, clock, monkeypatch):
    monkeypatch.setattr("isf_springback.session.make_corrector", lambda name, job: Corrector(Counting(job), job))
    for index in range(6):
        form(session, index)
        session.save(tmp_path)
    other = CorrectionSession(TIMEOUT, clock)
    other.load(tmp_path)
    other.set_job(job_file(), "plan")
    whole, again = form(session, 6), form(other, 6)
    assert again.correction.code == 0, again.correction.message
    assert np.array_equal(again.correction.offset, whole.correction.offset)


@pytest.mark.parametrize("size", [0, 10, 5000])
def test_a_damaged_file_of_a_contour_is_refused(session, size, tmp_path):
    form(session, 0)
    session.save(tmp_path)
    path = tmp_path / "contour_000000.001.npz"
    path.write_bytes(path.read_bytes()[:size])
    with pytest.raises(IsfError) as caught:
        session.load(tmp_path)
    assert caught.value.code == ErrorCode.CHECKPOINT_UNUSABLE
    assert form(session, 1).correction.code == 0  # the part in hand goes on


def test_results_of_other_plans_are_ignored(session):
    form(session, 0)
    session.add_contour(cone_contour(1))
    session.advance()
    session.add_result(result_of(cone_contour(1, plan_id="old"), 500.0))
    session.add_contour(cone_contour(2))
    assert session.advance() is None
