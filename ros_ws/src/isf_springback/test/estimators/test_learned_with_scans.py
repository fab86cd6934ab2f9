"""A part learned from one sheet and formed on another, with and without scans between its contours."""

from dataclasses import replace

import numpy as np
import pytest
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile
from isf_core.geometry.height_map import HeightMap
from isf_springback.corrector import apply
from isf_springback.estimators import learning
from isf_springback.estimators.fused import carried, first_field, shift_lever, updated
from isf_springback.estimators.learned import NOTHING_SEEN, SHEETS_DIFFER
from isf_springback.estimators.learning import learn_part
from isf_springback.methods import make_corrector
from isf_springback.scan.feedback import ScanMemory
from scanned_sheet import COUNT, GRID, Sheet, X, Y, cone
from springback_parts import JOB_TEXT, cone_contour

CLAMP = (0.25, 0.25)
TARGET = HeightMap(GRID, GRID, cone(0.5e-3 * COUNT + 5e-3 * (1 - np.cos(np.radians(50.0)))))
EVERY = 2
WALL = (np.hypot(X, Y) > 24e-3) & (np.hypot(X, Y) < 32e-3)
"""Formed after the first scans, above the fillet of the floor."""


def job(folder, every, more=""):
    springback = f"method: learned, learning: known.npz, scan_every: {every}"
    return JobFile(JOB_TEXT.replace("method: analytic", springback) + more, folder)


def sheet_of(largest):
    return Sheet(lambda depth, around: (largest + 0.3e-3 * np.cos(around)) * (1 - np.exp(-depth / 1.5e-3)))


class RisingSheet(Sheet):
    """A finished wall rises by 0.5 mm while the 4 mm of depth below it are formed."""

    def form(self, corrected):
        super().form(corrected)
        level = float(corrected.contact[:, 2].mean())
        above = np.clip((self.z - level) / 4e-3, 0.0, 1.0)
        below = np.clip((self.z - level - 0.5e-3) / 4e-3, 0.0, 1.0)
        self.z = np.minimum(self.z + np.where(self.z < -0.1e-3, 0.5e-3 * (above - below), 0.0), 0.0)


def form(method, sheet, job_file):
    """One part; nominal contours, corrections, shapes between them and what was remarked."""
    memory = ScanMemory(job_file)
    memory.set_target(TARGET)
    method.set_target(TARGET)
    nominal = [cone_contour(index, count=COUNT) for index in range(COUNT)]
    corrections, shapes, remarks = [], {}, []
    for contour in nominal:
        correction = method.correct(contour)
        sheet.form(apply(contour, correction))
        corrections.append(correction)
        remarks += correction.remarks
        if (contour.index + 1) % EVERY == 0:
            method.add_scan(sheet.points(), contour.index)
            shapes[contour.index] = memory.take(sheet.points(), contour, contour.index)
    return nominal, corrections, shapes, remarks


def error_of(sheet):
    """m, root mean square over the wall."""
    return float(np.sqrt(np.mean((sheet.z - TARGET.z)[WALL] ** 2)))


def learn(folder, sheets):
    """Formed on one sheet after the other without scans being used, each learning from the one before."""
    known = None
    for sheet in sheets:
        method = make_corrector("none" if known is None else "learned", job(folder, 0))
        nominal, corrections, shapes, _ = form(method, sheet, job(folder, EVERY))
        known = learn_part(nominal, corrections, sheet.points(), TARGET, CLAMP, 5e-3, "cone", known, shapes)
        learning.save(known, folder / "known.npz")
    return replay(folder, known, corrections)


def replay(folder, known, corrections):
    """The file of the last part as it was formed, as a try-out writes it."""
    again = replace(known, push=known.applied)
    learning.save(again, folder / "known.npz")
    return again


@pytest.mark.parametrize("rising", [False, True])
def test_scans_correct_what_another_sheet_does_differently(tmp_path, rising):
    kind = RisingSheet if rising else Sheet

    def of(largest):
        return kind(sheet_of(largest).springback)

    twins = [of(1.2e-3) for _ in range(3)]
    learn(tmp_path, twins)
    errors = {}
    for every in (0, EVERY):
        sheet = of(1.8e-3)
        form(make_corrector("learned", job(tmp_path, every)), sheet, job(tmp_path, EVERY))
        errors[every] = error_of(sheet)
    assert errors[0] > 0.6e-3
    assert errors[EVERY] < 0.1e-3 + error_of(twins[-1])


def test_a_finishing_pass_is_corrected_down_to_the_floor_by_what_its_wall_shows(tmp_path):
    """The pass before has formed the floor, of which nothing is seen then; the sheet springs back 0.6 mm more."""
    known = learn(tmp_path, [sheet_of(1.2e-3) for _ in range(3)])
    corrector = make_corrector("learned", job(tmp_path, EVERY))
    corrector.set_target(TARGET)
    sheet = sheet_of(1.8e-3)
    sheet.z = np.minimum(TARGET.z + 0.6e-3, 0.0)
    for index in range(COUNT):
        contour = replace(cone_contour(index, count=COUNT), stage=1)
        correction = corrector.correct(contour)
        sheet.form(apply(contour, correction))
        if (index + 1) % EVERY == 0:
            corrector.add_scan(sheet.points(), index)
        assert correction.code == 0
    _, before = known.of_contour(COUNT - 1)
    assert -correction.offset[:, 2].mean() - before.mean() == pytest.approx(0.6e-3, abs=0.25e-3)


def test_one_side_tells_that_the_part_lies_off_in_plan():
    """A part that lies off by 0.3 mm in +x, of which nothing is seen but the side where x is positive."""
    contour = cone_contour(12, count=COUNT)
    place = contour.contact[:: len(contour) // 36, :2]
    lever = shift_lever(contour, place)
    off = lever @ np.array([0.3e-3, 0.0])
    seen = place[:, 0] > 0.0
    assert off[seen].max() < 0.0
    assert np.abs(off).max() == pytest.approx(0.3e-3 * np.tan(np.radians(50.0)), rel=0.01)
    field = first_field(place, SHEETS_DIFFER, lever)
    for _ in range(3):
        field, _ = updated(field, np.where(seen, off, np.nan), np.full(len(place), 0.1e-3))
        field = carried(field, place, 1.0, SHEETS_DIFFER, lever)
    left = (field.bias - off)[place[:, 0] < -0.5 * place[:, 0].max()]
    assert np.abs(left).max() < 0.6 * np.abs(off).max()
    assert np.abs((field.bias - off)[seen]).max() < 0.1e-3


def test_a_path_that_was_led_back_over_the_sheet_tells_nothing(tmp_path):
    """What lies under a tool that has not come down is not the work of its contour, here of the first three."""
    known = learn(tmp_path, [sheet_of(1.2e-3) for _ in range(2)])
    applied = np.minimum(known.applied, -1.5e-3 + 0.4e-3 * known.contour)
    learning.save(replace(known, push=applied, applied=applied), tmp_path / "known.npz")
    method, sheet = make_corrector("learned", job(tmp_path, 1)), sheet_of(1.8e-3)
    method.set_target(TARGET)
    pushes = []
    for index in range(18):
        contour = cone_contour(index, count=COUNT)
        correction = method.correct(contour)
        sheet.form(apply(contour, correction))
        method.add_scan(sheet.points(), index)
        pushes.append(float(correction.springback.mean()))
    replayed = [applied[known.contour == index].mean() for index in range(18)]
    assert np.allclose(pushes[:7], replayed[:7], atol=0.02e-3)
    assert pushes[17] > replayed[17] + 0.2e-3


def test_on_the_same_sheet_scans_change_nothing(tmp_path):
    learn(tmp_path, [RisingSheet(sheet_of(1.2e-3).springback) for _ in range(3)])
    without, scanned = (
        form(
            make_corrector("learned", job(tmp_path, every)),
            RisingSheet(sheet_of(1.2e-3).springback),
            job(tmp_path, EVERY),
        )[1]
        for every in (0, EVERY)
    )
    far = max(np.abs(a.offset - b.offset).max() for a, b in zip(without, scanned, strict=True))
    assert far < 0.05e-3


def test_a_file_without_scans_replays_and_says_so(tmp_path):
    known = learn(tmp_path, [sheet_of(1.2e-3)])
    learning.save(replace(known, seen=None), tmp_path / "known.npz")
    replayed = form(make_corrector("learned", job(tmp_path, 0)), sheet_of(1.8e-3), job(tmp_path, EVERY))
    scanned = form(make_corrector("learned", job(tmp_path, EVERY)), sheet_of(1.8e-3), job(tmp_path, EVERY))
    assert all(np.array_equal(a.offset, b.offset) for a, b in zip(replayed[1], scanned[1], strict=True))
    assert NOTHING_SEEN in scanned[3]
    assert NOTHING_SEEN not in replayed[3]


def test_what_was_seen_comes_back_from_the_file(tmp_path):
    known = learn(tmp_path, [sheet_of(1.2e-3)])
    again = learning.load(tmp_path / "known.npz")
    assert np.array_equal(again.seen, known.seen, equal_nan=True)
    assert again.scanned == COUNT // EVERY
    scanned = np.isfinite(known.seen[:, 0])
    assert set(known.contour[scanned]) <= {index for index in range(COUNT) if (index + 1) % EVERY == 0}


@pytest.mark.parametrize("seen", [np.zeros(3), np.array([["a", "b"]]), np.zeros((2, 2))])
def test_a_file_with_other_readings_is_refused(tmp_path, seen):
    known = learn(tmp_path, [sheet_of(1.2e-3)])
    learning.save(replace(known, seen=seen), tmp_path / "known.npz")
    with pytest.raises(IsfError) as caught:
        make_corrector("learned", job(tmp_path, EVERY))
    assert caught.value.code == ErrorCode.LEARNING_UNUSABLE


def test_readings_that_are_none_count_as_not_seen(tmp_path):
    known = learn(tmp_path, [sheet_of(1.2e-3)])
    learning.save(replace(known, seen=np.full(known.seen.shape, np.inf)), tmp_path / "known.npz")
    sheet = sheet_of(1.8e-3)
    _, corrections, _, _ = form(make_corrector("learned", job(tmp_path, EVERY)), sheet, job(tmp_path, EVERY))
    assert all(np.isfinite(correction.offset).all() for correction in corrections)


def test_a_file_that_promises_more_contours_than_it_has_is_refused_at_the_first(tmp_path):
    known = learn(tmp_path, [sheet_of(1.2e-3)])
    learning.save(replace(known, contours=10**12), tmp_path / "known.npz")
    with pytest.raises(IsfError) as caught:
        make_corrector("learned", job(tmp_path, EVERY)).correct(cone_contour(0, count=COUNT))
    assert caught.value.code == ErrorCode.LEARNING_UNUSABLE


def test_scans_that_are_none_leave_the_correction_as_it_was(tmp_path):
    learn(tmp_path, [sheet_of(1.2e-3)])
    method = make_corrector("learned", job(tmp_path, EVERY))
    method.set_target(TARGET)
    for index in range(4):
        contour = cone_contour(index, count=COUNT)
        correction = method.correct(contour)
        method.add_scan(np.full((X.size, 3), np.nan), index)
    assert correction.code == ErrorCode.SCAN_NOT_FINITE
    assert np.isfinite(correction.offset).all()
