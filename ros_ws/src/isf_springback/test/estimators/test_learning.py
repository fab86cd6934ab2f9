"""Learning from part to part on a sheet with known springback; files that are damaged or of another part."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from isf_core.contour import ContourCorrection
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile
from isf_core.geometry.height_map import HeightMap
from isf_springback.corrector import apply
from isf_springback.estimators import learning
from isf_springback.estimators.learning import curvature, learn_part
from isf_springback.methods import make_corrector
from scanned_sheet import COUNT, GRID, Sheet, cone
from springback_parts import JOB_TEXT, cone_contour

CLAMP = (0.25, 0.25)
TARGET = HeightMap(GRID, GRID, cone(0.5e-3 * COUNT + 5e-3 * (1 - np.cos(np.radians(50.0)))))
"""The cone down to the lowest tip of its contours."""


def job(method, folder, file="known.npz"):
    return JobFile(JOB_TEXT.replace("method: analytic", f"method: {method}, learning: {file}"), folder)


def growing(depth, around):
    return (1.2e-3 + 0.3e-3 * np.cos(around)) * (1 - np.exp(-depth / 1.5e-3))


def form(method, springback=growing):
    """One part; nominal contours, corrections, sheet."""
    sheet = Sheet(springback)
    nominal = [cone_contour(index, count=COUNT) for index in range(COUNT)]
    corrections = []
    for contour in nominal:
        correction = method.correct(contour)
        sheet.form(apply(contour, correction))
        corrections.append(correction)
    return nominal, corrections, sheet


def next_part(folder, known):
    method = (
        make_corrector("none", job("none", folder))
        if known is None
        else make_corrector("learned", job("learned", folder))
    )
    nominal, corrections, sheet = form(method)
    known = learn_part(nominal, corrections, sheet.points(), TARGET, CLAMP, 5e-3, "cone", known)
    learning.save(known, folder / "known.npz")
    return known, sheet


@pytest.fixture(scope="module")
def four_parts(tmp_path_factory):
    folder = tmp_path_factory.mktemp("learning")
    known, sheets = None, []
    for _ in range(4):
        known, sheet = next_part(folder, known)
        sheets.append(sheet)
    return folder, known, sheets


def test_the_error_falls_from_part_to_part(four_parts):
    _, known, _ = four_parts
    assert known.parts == 4
    mean = known.history[:, 0]
    assert mean[0] > 0.6e-3
    assert mean[1] < 0.6 * mean[0]
    assert mean[3] < 0.35 * mean[0]
    assert (np.diff(mean) < 0.02e-3).all()


def test_the_file_comes_back_as_it_was(four_parts):
    folder, known, _ = four_parts
    again = learning.load(folder / "known.npz")
    assert again.job == "cone"
    assert np.array_equal(again.push, known.push)
    assert np.array_equal(again.feature, known.feature)


def test_the_map_knows_the_springback_of_another_cone(four_parts):
    """Learned on this cone; a wider one on the same sheet is predicted from features alone.

    On one cone depth and curvature change together, so that they cannot be told apart: a third is what may be asked.
    """
    folder, _, _ = four_parts
    method = make_corrector("learned_map", job("learned_map", folder))
    method.set_target(TARGET)
    contour = cone_contour(14, count=COUNT, opening=38e-3)
    for index in range(15):
        contour = cone_contour(index, count=COUNT, opening=38e-3)
        correction = method.correct(contour)
    assert -correction.offset[:, 2].mean() == pytest.approx(1.2e-3, abs=0.4e-3)


def test_the_map_stays_inside_what_it_has_seen_and_says_so(four_parts):
    folder, known, _ = four_parts
    method = make_corrector("learned_map", job("learned_map", folder))
    method.set_target(TARGET)
    steep = cone_contour(0, count=COUNT, angle=75.0)
    correction = method.correct(steep)
    assert any("outside the learned range" in remark for remark in correction.remarks)
    assert np.abs(correction.springback).max() <= known.springback.max() + 1e-9


@pytest.mark.parametrize("count", [COUNT + 1, 2 * COUNT, 7])
def test_the_map_takes_the_floor_from_the_target(four_parts, count):
    """However many contours a plan has, with passes over the floor, further stages or other pockets: halfway down the
    springback is that of a plain plan."""
    folder, _, _ = four_parts
    found = []
    for number in (COUNT, count):
        method = make_corrector("learned_map", job("learned_map", folder))
        method.set_target(TARGET)
        found.append(method.correct(cone_contour(12, count=number)).springback)
    assert found[0].mean() > 0.8e-3
    assert np.array_equal(*found)


def test_the_map_says_that_it_lacks_the_target(four_parts):
    folder, _, _ = four_parts
    correction = make_corrector("learned_map", job("learned_map", folder)).correct(cone_contour(0, count=COUNT))
    assert correction.code == ErrorCode.CORRECTION_FAILED
    assert "the target shape is not known" in correction.message
    assert not correction.offset.any()


def test_a_place_that_does_not_answer_is_left_alone(tmp_path):
    """Nothing the tool does lowers this sheet: the correction stops growing instead of running away."""
    known, pushes = None, []
    target_only = HeldSheet()
    for _ in range(5):
        method = make_corrector("none" if known is None else "learned", job("learned", tmp_path))
        nominal, corrections, _ = form(method)
        known = learn_part(nominal, corrections, target_only.points(), TARGET, CLAMP, 5e-3, "cone", known)
        learning.save(known, tmp_path / "known.npz")
        pushes.append(np.abs(known.push).max())
    growth = np.diff(pushes)
    assert growth[-1] < 0.5 * growth[0]


class HeldSheet(Sheet):
    """A shape that is always 1 mm too high on the wall."""

    def __init__(self):
        super().__init__(growing)
        self.z = np.minimum(TARGET.z + 1.0e-3, 0.0)


def mirrored(points):
    return points * np.array([1.0, 1.0, -1.0])


def test_what_is_formed_from_below_alone_is_learned_as_its_mirror_image():
    """Where it stands up too high it was pushed too far; depth counts along the push."""
    nominal, corrections, sheet = form(make_corrector("none", JobFile(JOB_TEXT, Path("."))))
    up = learn_part(nominal, corrections, sheet.points(), TARGET, CLAMP, 5e-3, "cone")
    below = [cone_contour(index, count=COUNT, tool=2) for index in range(COUNT)]
    bump = HeightMap(GRID, GRID, -TARGET.z)
    down = learn_part(below, corrections, mirrored(sheet.points()), bump, CLAMP, 5e-3, "cone")
    assert up.push.max() > 0.5e-3
    for name in ("push", "error", "feature", "springback"):
        assert getattr(down, name) == pytest.approx(getattr(up, name), abs=1e-9)


def test_each_of_two_features_is_pushed_on_in_its_own_direction():
    """A pocket and a bump, all of it 0.4 mm too high: the one goes deeper, the other lower."""
    half = 12
    moved = {tool: np.array([x, 0.0, 0.0]) for tool, x in ((1, -60e-3), (2, 60e-3))}
    contours = [
        replace(cone_contour(k % half, tool=tool, opening=30e-3).shifted(moved[tool]), index=k, count=2 * half)
        for k, tool in enumerate([1] * half + [2] * half)
    ]
    depth = -float(contours[half - 1].forming_tip[:, 2].min())
    x, y = np.meshgrid(GRID, GRID)
    cones = [
        np.clip((30e-3 - np.hypot(x - move[0], y)) * np.tan(np.radians(50.0)), 0.0, depth) for move in moved.values()
    ]
    target = cones[1] - cones[0]
    formed = np.where(np.abs(target) > 0.3e-3, target + 0.4e-3, target)
    points = np.column_stack([x.ravel(), y.ravel(), formed.ravel()])
    none = [ContourCorrection(c.plan_id, c.index, "none", np.zeros((len(c), 3)), np.zeros(len(c))) for c in contours]
    known = learn_part(contours, none, points, HeightMap(GRID, GRID, target), CLAMP, 5e-3, "two")
    from_below = known.contour >= half
    assert np.median(known.push[~from_below]) == pytest.approx(0.7 * 0.4e-3, abs=0.05e-3)
    assert np.median(known.push[from_below]) == pytest.approx(-0.7 * 0.4e-3, abs=0.05e-3)


@pytest.mark.parametrize(("off", "parts"), [(0.0, 5), (0.6e-3, 5), (2e-3, 1)])
def test_a_part_that_was_moved_begins_anew(four_parts, off, parts):
    """It has as many contours as the one that was learned; its samples stay."""
    _, known, sheets = four_parts
    moved = [cone_contour(index, count=COUNT).shifted(np.array([off, 0.0, 0.0])) for index in range(COUNT)]
    corrections = form(make_corrector("none", JobFile(JOB_TEXT, Path("."))))[1]
    again = learn_part(moved, corrections, sheets[-1].points(), TARGET, CLAMP, 5e-3, "cone", known)
    assert (again.parts, len(again.history)) == (parts, parts)
    assert len(again.springback) > len(known.springback)


def test_points_far_apart_make_no_other_plan(four_parts):
    """A contour of 3 mm steps: the places in between lie on it."""
    folder, _, _ = four_parts
    contour = cone_contour(0, count=COUNT)
    few = replace(contour, **{
        name: getattr(contour, name)[::6]
        for name in ("contact", "normal", "wall_angle", "thickness", "forming_tip", "support_tip", "support_force")
    })  # fmt: skip
    assert make_corrector("learned", job("learned", folder)).correct(few).code == 0


@pytest.mark.parametrize("fault", ["missing", "damaged", "foreign", "other plan", "moved", "none named", "few samples"])
def test_a_file_that_cannot_be_used_is_refused_with_its_name(four_parts, tmp_path, fault):
    folder, known, _ = four_parts
    path = tmp_path / "known.npz"
    if fault == "damaged":
        path.write_bytes((folder / "known.npz").read_bytes()[:500])
    elif fault == "foreign":
        np.savez(path, something=np.zeros(3))
    elif fault in ("other plan", "moved", "few samples"):
        learning.save(known, path)
        if fault == "few samples":
            few = replace(known, springback=known.springback[:5], feature=known.feature[:5])
            learning.save(few, path)
    attempts = {
        "none named": lambda: make_corrector("learned", JobFile(JOB_TEXT, tmp_path)),
        "other plan": lambda: make_corrector("learned", job("learned", tmp_path)).correct(
            cone_contour(0, count=COUNT + 1)
        ),
        "moved": lambda: make_corrector("learned", job("learned", tmp_path)).correct(
            cone_contour(3, count=COUNT).shifted(np.array([2e-3, 0.0, 0.0]))
        ),
        "few samples": lambda: make_corrector("learned_map", job("learned_map", tmp_path)),
    }
    with pytest.raises(IsfError) as caught:
        attempts.get(fault, lambda: make_corrector("learned", job("learned", tmp_path)))()
    assert caught.value.code == ErrorCode.LEARNING_UNUSABLE
    assert caught.value.where
    if fault == "moved":
        assert "contour 4 runs up to 2.0 mm elsewhere" in caught.value.message
        assert "known.npz" in caught.value.where


def test_an_unfinished_part_teaches_nothing():
    nominal, corrections, sheet = form(make_corrector("none", JobFile(JOB_TEXT, Path("."))))
    with pytest.raises(IsfError) as caught:
        learn_part(nominal[:5], corrections[:5], sheet.points(), TARGET, CLAMP, 5e-3, "cone")
    assert caught.value.code == ErrorCode.LEARNING_UNUSABLE


def test_the_finished_part_tells_nothing_of_a_preform():
    """Formed once more the preform, which stands up to some mm above the part, gets the push that it had."""
    preform = HeightMap(GRID, GRID, 0.5 * TARGET.z)
    method = make_corrector("none", JobFile(JOB_TEXT, Path(".")))
    nominal, corrections, sheet = form(method)
    before = [
        replace(contour, contact=contour.contact * [1, 1, 0.5], forming_tip=contour.forming_tip * [1, 1, 0.5])
        for contour in nominal
    ]
    count = 2 * COUNT
    staged = [replace(contour, count=count) for contour in before]
    staged += [replace(contour, index=contour.index + COUNT, count=count, stage=1) for contour in nominal]
    pushed = [
        replace(one, index=one.index + shift, offset=one.offset - [0.0, 0.0, 0.3e-3])
        for shift in (0, COUNT)
        for one in corrections
    ]
    points = sheet.points()
    known = learn_part(staged, pushed, points, TARGET, CLAMP, 5e-3, "cone", preforms=(preform,))
    of_preform = known.contour < COUNT
    assert known.push[of_preform] == pytest.approx(np.full(of_preform.sum(), 0.3e-3), abs=1e-9)
    assert np.isnan(known.error[of_preform]).all()
    assert np.median(known.push[~of_preform]) > 0.8e-3
    assert len(known.springback) <= (~of_preform).sum()


@pytest.mark.parametrize("gain", [0.5, 1.0])
def test_what_a_part_was_pushed_by_is_replayed_whatever_the_gain(four_parts, tmp_path, gain):
    known = four_parts[1]
    learning.save(known, tmp_path / "known.npz")
    text = JOB_TEXT.replace("gain: 1.0", f"gain: {gain}").replace(
        "method: analytic", "method: learned, learning: known.npz"
    )
    corrector = make_corrector("learned", JobFile(text, tmp_path))
    for index in range(8):
        corrections = corrector.correct(cone_contour(index, count=COUNT))
    _, push = known.of_contour(7)
    assert -corrections.offset[:, 2].mean() == pytest.approx(push.mean(), abs=20e-6)


def test_the_error_of_a_part_by_place_keeps_its_mean_and_its_largest():
    """0.1 mm over the left half, 0.3 mm over the right one with a spike of -2 mm; nothing is known far out."""
    axis = np.linspace(-20e-3, 20e-3, 41)
    z = np.where(axis[None, :] < 0.0, 0.1e-3, 0.3e-3) + np.zeros((41, 1))
    z[20, 35] = -2e-3
    z[:, :5] = np.nan
    place = np.array([[-10.5e-3, 0.0], [10e-3, 0.0], [16.5e-3, 0.0], [-500e-3, 0.0]])
    found = learning.error_by_place(place, HeightMap(axis, axis, z))
    assert found[0] == pytest.approx(0.1e-3)
    assert found[1] == pytest.approx(0.3e-3)
    assert found[2] == pytest.approx(-2e-3)
    assert np.isnan(found[3])
    assert np.isnan(learning.error_by_place(place, HeightMap(axis, axis, np.full((41, 41), np.nan)))).all()


def expected_on(folder, index):
    """What the file in ``folder`` expects of contour ``index``: mm, error along +z and standard deviation."""
    correction = make_corrector("learned", job("learned", folder)).correct(cone_contour(index, count=COUNT))
    return 1e3 * correction.residual, 1e3 * correction.uncertainty


def test_a_try_out_tells_the_parts_formed_from_it_what_to_expect(four_parts, tmp_path):
    """Its parts on three sheets came out 0.1 mm too deep, 0.2 mm and 0.6 mm too high: mean and spread of them."""
    known = four_parts[1]
    tried = np.array([[-0.1e-3], [0.2e-3], [0.6e-3]]) + np.zeros(len(known.contour))
    learning.save(replace(known, tried=tried), tmp_path / "known.npz")
    left, spread = expected_on(tmp_path, 9)
    assert left == pytest.approx(np.full(len(left), 0.2333), abs=1e-3)
    assert spread == pytest.approx(np.full(len(left), 0.3512), abs=1e-3)
    learning.save(replace(known, tried=tried[:1]), tmp_path / "known.npz")
    left, spread = expected_on(tmp_path, 9)
    assert left == pytest.approx(np.full(len(left), -0.1), abs=1e-3)
    assert spread == pytest.approx(np.full(len(left), 0.3))  # of one part: what parts of one condition differ by
    learning.save(replace(known, tried=np.full((2, len(known.contour)), np.nan)), tmp_path / "known.npz")
    assert len(expected_on(tmp_path, 9)[1]) == 0  # not known


def test_a_part_before_leaves_what_its_correction_did_not_take(tmp_path):
    """0.7 of the error of the first part are put into the second: 0.3 of it are expected to be left."""
    known, _ = next_part(tmp_path, None)
    rows = known.contour == 12
    left, spread = expected_on(tmp_path, 12)
    assert np.median(1e3 * known.error[rows]) > 0.5
    assert left.mean() == pytest.approx(0.3 * 1e3 * known.error[rows].mean(), rel=0.05)
    assert spread == pytest.approx(np.full(len(left), 0.3))


def test_a_map_expects_what_its_samples_scatter_by(four_parts, tmp_path):
    folder, known, _ = four_parts
    noise = np.random.default_rng(2).normal(0.0, 0.25e-3, len(known.springback))
    learning.save(replace(known, springback=known.springback + noise), tmp_path / "known.npz")

    def scatter(base):
        method = make_corrector("learned_map", job("learned_map", base))
        method.set_target(TARGET)
        return 1e3 * method.correct(cone_contour(0, count=COUNT)).uncertainty.mean()

    assert scatter(folder) > 0.0
    assert scatter(tmp_path) == pytest.approx(np.hypot(scatter(folder), 0.25), rel=0.05)


@pytest.mark.parametrize("tried", [np.zeros((0, 3)), np.zeros(5), np.zeros((2, 5)), np.array([["a"]])])
def test_parts_of_a_try_out_that_do_not_fit_the_file_are_refused(four_parts, tmp_path, tried):
    learning.save(replace(four_parts[1], tried=tried), tmp_path / "known.npz")
    with pytest.raises(IsfError) as caught:
        learning.load(tmp_path / "known.npz")
    assert caught.value.code == ErrorCode.LEARNING_UNUSABLE


def test_curvature_of_a_circle():
    contour = cone_contour(3)
    radius = np.hypot(*contour.forming_tip[0, :2])
    assert curvature(contour) == pytest.approx(1.0 / radius, rel=0.05)


DOME, DEEP = 100e-3, 6.3e-3
"""m, radius and depth of a part whose bottom is curved to its middle."""


@pytest.mark.parametrize("short", [0.0, 0.05])
def test_a_curved_bottom_is_held_against_the_part_and_not_against_the_tip(short):
    """Contours 2 mm over the lowest place read what is left there, not that later contours went deeper."""
    away = np.hypot(*np.meshgrid(GRID, GRID))
    target = HeightMap(GRID, GRID, np.minimum(away**2 / (2 * DOME) - DEEP, 0.0))
    levels = 0.5e-3 * np.arange(1, 13)
    radii = np.sqrt(2 * DOME * (DEEP - levels))
    contours = [
        cone_contour(k, count=len(levels), radius=radius, angle=np.degrees(np.arctan(radius / DOME)))
        for k, radius in enumerate(radii)
    ]
    none = [
        ContourCorrection(contour.plan_id, contour.index, "none", np.zeros((len(contour), 3)), np.empty(0))
        for contour in contours
    ]
    points = target.points() * [1.0, 1.0, 1.0 - short]
    known = learn_part(contours, none, points, target, CLAMP, 5e-3, "dome")
    for contour, level in zip(contours[1:], levels[1:], strict=True):
        assert known.error[known.contour == contour.index] == pytest.approx(short * level, abs=0.04e-3)
