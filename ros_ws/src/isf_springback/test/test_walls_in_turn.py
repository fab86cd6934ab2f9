"""Features formed in turn, and further stages: what a contour continues, and which forces it is forecast from."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from isf_core.errors import ErrorCode
from isf_core.files.job import JobFile
from isf_core.geometry.height_map import HeightMap
from isf_springback.corrector import apply
from isf_springback.estimators.analytic import AnalyticModel, AnalyticOptions
from isf_springback.estimators.estimator import FormedContour
from isf_springback.estimators.sheet_model import AxialForce
from isf_springback.methods import make_corrector
from scanned_sheet import TARGET, Sheet
from springback_parts import JOB_TEXT, cone_contour, corrector_of, job_file, result_of

CHANGE = 1e-3
"""m, two incremental depths."""
LOADS = (500.0, 200.0)
"""N, measured in the first and in the second pocket."""


def in_turn(count):
    """Contours of two pockets 100 mm apart, level by level, the tools lifted in between."""
    contours = []
    for index in range(count):
        contour = cone_contour(index // 2)
        aside = np.array([100e-3 * (index % 2), 0.0, 0.0])
        moved = {name: getattr(contour, name) + aside for name in ("contact", "forming_tip", "support_tip")}
        contours.append(replace(contour, index=index, feature=index % 2, retract=index > 0, **moved))
    return contours


def form(method, contours, load=LOADS):
    """The corrections."""
    made = []
    for contour in contours:
        made.append(method.correct(contour))
        method.add_result(apply(contour, made[-1]), result_of(contour, load[contour.feature]))
    return made


def wall(index, **changes):
    """A contour at the rim after ``index`` others."""
    return replace(cone_contour(0), index=index, retract=True, **changes)


ALONE = {"support_force": np.empty(0), "support_tip": np.empty((0, 3))}
"""A contour of one tool."""


@pytest.mark.parametrize("change", [{"stage": 1, **ALONE}, {"stage": 1, "feature": 1}])
def test_a_further_stage_begins_without_the_push_on_the_floor_before_it(change):
    """As documented it is not corrected: the lifted tools keep nothing of the push at the end of the stage before."""
    method = corrector_of(AnalyticModel, job_file())
    before = form(method, [cone_contour(index) for index in range(12)])[-1]
    assert -before.offset[:, 2].min() > 4e-3
    first = method.correct(wall(12, **change))
    assert first.code == 0
    assert not first.offset.any()


@pytest.mark.parametrize("change", [{"retract": False, **ALONE}, {}])
def test_a_stage_without_a_lift_or_of_two_tools_changes_by_the_limit(change):
    """A support tool would lift the formed sheet until the forming tool carries."""
    method = corrector_of(AnalyticModel, job_file())
    form(method, [cone_contour(index) for index in range(12)])
    before = method.history.current.push.mean()
    first = method.correct(replace(wall(12, stage=1), **change))
    assert -first.offset[:, 2].mean() == pytest.approx(before - CHANGE, abs=20e-6)


def test_every_pocket_of_two_tools_begins_a_further_stage_with_its_own_push():
    method = corrector_of(AnalyticModel, job_file())
    left = [-known.offset[:, 2].mean() for known in form(method, in_turn(24))[-2:]]
    for feature in (0, 1):
        aside = np.array([100e-3 * feature, 0.0, 0.0])
        moved = {name: getattr(cone_contour(0), name) + aside for name in ("contact", "forming_tip", "support_tip")}
        first = method.correct(wall(24 + feature, stage=1, feature=feature, **moved))
        assert -first.offset[:, 2].mean() == pytest.approx(left[feature] - CHANGE, abs=20e-6)
        method.add_result(
            apply(wall(24 + feature, stage=1, feature=feature, **moved), first),
            result_of(wall(24 + feature, **moved), LOADS[feature]),
        )


def test_every_pocket_goes_on_from_its_own_contour():
    """No contour lacks the force of the one before it, and none jumps from the push that this pocket has had."""
    made = form(corrector_of(AnalyticModel, job_file()), in_turn(24))
    assert [correction.code for correction in made] == [0] * 24
    for feature, load in enumerate(LOADS):
        own = made[feature::2]
        assert own[-1].control_point_force == pytest.approx(np.full(24, load))
        assert own[-1].offset == pytest.approx(-own[-1].springback[:, None] * [0.0, 0.0, 1.0], abs=20e-6)
        levels = -np.array([correction.offset[:, 2].mean() for correction in own])
        assert levels[0] == 0.0
        assert np.diff(levels).max() <= CHANGE + 1e-9
    first, second = (-correction.offset[:, 2].mean() for correction in made[-2:])
    assert first > 1.2 * second > 2e-3


def test_the_trend_is_that_of_the_same_pocket():
    """Forces that rise by 20 N per level in one pocket and fall by 10 N in the other are forecast to go on so."""
    method = corrector_of(AnalyticModel, job_file(), AnalyticOptions(law="linear"))
    loads = {0: 400.0, 1: 300.0}
    for contour in in_turn(12):
        correction = method.correct(contour)
        if contour.index > 3:
            assert correction.control_point_force == pytest.approx(np.full(24, loads[contour.feature]), rel=1e-6)
        method.add_result(apply(contour, correction), result_of(contour, loads[contour.feature]))
        loads[contour.feature] += (20.0, -10.0)[contour.feature]


def test_blocks_are_filled_per_pocket():
    force = AxialForce(job_file(), "hold", block=2)
    before, found = None, []
    history = corrector_of(AnalyticModel, job_file()).history
    for contour in in_turn(12):
        force.begin(contour, before)
        history.advance(contour)
        history.current = FormedContour(contour, np.zeros((len(contour), 3)), np.zeros(len(contour)))
        found.append(force.at(contour, contour.forming_tip[:1, :2], contour.wall_angle[:1]).force[0])
        force.add(contour, result_of(contour, 100.0 * (contour.index + 1)), history)
        before = contour
    # two contours of a pocket without history and one more, then the mean of its last whole block
    assert found[::2] == pytest.approx([0.0, 0.0, 200.0, 200.0, 600.0, 600.0])
    assert found[1::2] == pytest.approx([0.0, 0.0, 300.0, 300.0, 700.0, 700.0])


def test_a_missing_force_is_told_by_its_pocket_alone():
    """The 20th contour has no result: the next of that pocket tells it, with the push that this pocket had."""
    method = corrector_of(AnalyticModel, job_file())
    contours = in_turn(24)
    form(method, contours[:19])
    kept = method.correct(contours[19]).offset[:, 2].mean()
    other = method.correct(contours[20])
    assert other.code == 0
    method.add_result(contours[20], result_of(contours[20], 500.0))
    late = method.correct(contours[21])
    assert late.code == ErrorCode.NO_FORCE_HISTORY
    assert "no measured force of contour 20" in late.message
    assert late.offset[:, 2].mean() == pytest.approx(kept, abs=20e-6)


def test_a_plan_may_begin_with_another_feature():
    """The first pocket comes second: nothing was missed."""
    made = form(corrector_of(AnalyticModel, job_file()), [replace(one, feature=1 - one.feature) for one in in_turn(6)])
    assert [correction.code for correction in made] == [0] * 6


def test_asking_again_after_a_return_gives_the_same():
    method = corrector_of(AnalyticModel, job_file())
    contours = in_turn(13)
    form(method, contours[:12])
    first = method.correct(contours[12])
    assert np.array_equal(method.correct(contours[12]).offset, first.offset)


SPRINGBACK = (0.8e-3, 0.2e-3)
"""m, in the first and in the second pocket."""
ASIDE = 45
"""mm, middle of the pockets from that of the clamp; cells of the scan."""


def formed_in_turn(method, load, count=40, every=1):
    """Pushes (m) of every contour, and the remarks: two pockets of one sheet, scanned after ``every`` contours."""
    text = JOB_TEXT.replace("method: analytic", f"method: {method}, scan_every: {every}")
    corrector = make_corrector(method, JobFile(text, Path(".")))
    sheets = [Sheet(lambda depth, around, own=own: own) for own in SPRINGBACK]

    def beside(first, second):
        return np.minimum(np.roll(first, -ASIDE, axis=1), np.roll(second, ASIDE, axis=1))

    corrector.set_target(HeightMap(TARGET.x, TARGET.y, beside(TARGET.z, TARGET.z)))
    pushes, remarks = [], []
    for index in range(count):
        feature = index % 2
        here = cone_contour(index // 2, count=count)
        moved = here.shifted(np.array([1e-3 * ASIDE * (2 * feature - 1), 0.0, 0.0]))
        contour = replace(moved, index=index, feature=feature, retract=index > 0)
        correction = corrector.correct(contour)
        assert correction.code == 0
        sheets[feature].form(here.shifted(correction.offset))
        corrector.add_result(apply(contour, correction), result_of(contour, load[feature], squeeze=0.0))
        z = beside(sheets[0].z, sheets[1].z)
        if (index + 1) % every == 0:
            corrector.add_scan(HeightMap(TARGET.x, TARGET.y, z).points(), index)
        pushes.append(-float(correction.offset[:, 2].mean()))
        remarks.append(correction.remarks)
    return np.array(pushes), remarks


@pytest.mark.parametrize("every", [1, 2])
@pytest.mark.parametrize("method", ["fused", "mpc_vertical"])
def test_scans_tell_of_every_pocket_by_itself(method, every):
    """No force says that anything springs back: all is found by the scans, which show both pockets. Every second one
    comes after the second pocket alone."""
    pushes, _ = formed_in_turn(method, (0.0, 0.0), every=every)
    for feature, springback in enumerate(SPRINGBACK):
        assert pushes[feature::2][10:] == pytest.approx(np.full(10, springback), abs=0.15e-3)


def test_the_force_on_one_pocket_holds_that_one_back():
    """2.9 kN of the 3 kN that the load cell bears are no reason to form the other pocket less deep."""
    pushes, remarks = formed_in_turn("mpc_vertical", (2900.0, 0.0), 24)
    held = [any("force of the machine" in remark for remark in one) for one in remarks]
    assert any(held[0::2])
    assert not any(held[1::2])
    assert pushes[0::2].max() < 0.4e-3
    assert pushes[1::2][8:] == pytest.approx(np.full(4, SPRINGBACK[1]), abs=0.15e-3)
