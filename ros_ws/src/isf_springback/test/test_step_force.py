"""The step of the coming contour keeps the force below the limit of a machine whose exponent nobody knows."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from isf_core.files.job import JobFile
from isf_springback.corrector import (
    LARGEST_EXPONENT,
    SMALLEST_EXPONENT,
    WANTED_SHARE,
    FormedStep,
    StepForce,
    apply,
    depth_of,
    largest_step,
)
from isf_springback.methods import make_corrector
from scanned_sheet import COUNT, TARGET, Sheet
from springback_parts import JOB_TEXT, cone_contour, result_of

STEP = 0.5e-3


def job():
    return JobFile(JOB_TEXT.replace("method: analytic", "method: mpc_vertical, scan_every: 1"), Path("."))


def measured(contour, share):
    """A result whose axial force is ``share`` of the limit all around."""
    rig = job().rig
    limit = min(rig.limits.force[2], rig.load_cell.force_range[2])
    result = result_of(contour, 0.0)
    force = np.zeros_like(result.forming_force)
    force[:, 2] = share * limit
    return replace(result, forming_force=force)


def form(level, exponent, wanted=3e-3):
    """Shares of the limit and corrections; ``level`` share of the limit at the planned step once the wall stands.

    The force comes up over five contours and grows with the step as formed by ``exponent``; the sheet springs back by
    ``wanted`` m.
    """
    method = make_corrector("mpc_vertical", job())
    method.set_target(TARGET)
    sheet = Sheet(lambda depth, around: wanted * (1 - np.exp(-depth / 1e-3)))
    shares, corrections, depth = [], [], 0.0
    for index in range(14):
        nominal = cone_contour(index, count=COUNT)
        correction = method.correct(nominal)
        corrected = apply(nominal, correction)
        sheet.form(corrected)
        step, depth = max(depth_of(corrected) - depth, 1e-6), depth_of(corrected)
        shares.append(level * (1 - np.exp(-(index + 1) / 2.0)) * (step / STEP) ** exponent)
        method.add_result(corrected, measured(corrected, shares[-1]))
        method.add_scan(sheet.points(), index)
        corrections.append(correction)
    return np.array(shares), corrections


@pytest.mark.parametrize(("level", "exponent"), [(0.75, 0.18), (0.9, 0.5), (1.12, 0.18)])
def test_no_force_stops_the_part_whatever_its_exponent(level, exponent):
    """At 1.12 the plan itself is more than the machine bears: the part goes on with the step it bears, and says so."""
    shares, corrections = form(level, exponent)
    assert shares.max() < 1.0
    reported = [text for c in corrections for text in c.remarks if "are planned" in text]
    assert reported or level < 1.0
    if level < 0.9:  # the correction still comes up
        assert corrections[-1].offset[:, 2].mean() < -0.8e-3


def test_far_from_the_limit_nothing_is_held_back():
    weak, _ = form(0.2, 0.18)
    strong, _ = form(0.3, 0.18)
    assert strong / weak == pytest.approx(1.5, rel=1e-9)  # the same steps


def formed(step=STEP, force=1000.0, share=0.5):
    return FormedStep(depth=5e-3, step=step, mean=force, share=share)


@settings(max_examples=60, deadline=None)
@given(share=st.floats(0.2, 1.1), exponent=st.floats(SMALLEST_EXPONENT, LARGEST_EXPONENT), ratio=st.floats(0.4, 2.5))
def test_the_step_found_keeps_the_share_for_every_exponent_between_the_bounds(share, exponent, ratio):
    """Force law share (step / last step)^exponent, after any step before it."""
    last = formed(step=ratio * STEP, force=1000.0 * ratio**exponent, share=share)
    step = largest_step([formed(), last])
    assert share * (step / last.step) ** exponent <= WANTED_SHARE + 1e-9
    alone = largest_step([last])
    assert step <= alone + 1e-12


def test_half_of_what_the_force_grew_beside_the_step_comes_again():
    """From 1000 N to 1050 N at the same step: 1075 N are expected (1.5 F(i-1) - 0.5 F(i-2)); the step has to shrink."""
    step = largest_step([formed(force=1000.0, share=0.95 / 1.05), formed(force=1050.0, share=0.95)])
    assert step == pytest.approx(STEP * (WANTED_SHARE / (0.95 * 1075.0 / 1050.0)) ** (1 / SMALLEST_EXPONENT), rel=1e-6)
    assert step < STEP


def test_before_the_first_contour_and_after_one_without_forces_nothing_is_known():
    known = StepForce(job())
    first = cone_contour(0)
    assert known.deepest(first) == np.inf
    known.add(first, measured(first, 0.94))
    assert known.deepest(cone_contour(1)) < np.inf
    second = cone_contour(1)
    known.add(second, replace(measured(second, 0.94), forming_force=np.empty((0, 3))))
    assert known.deepest(cone_contour(2)) == np.inf
