"""A fused correction cannot drive the step, and with it the force, past the limits of the machine."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from isf_core.contour import ContourCorrection
from isf_core.files.job import JobFile
from isf_springback.corrector import apply, force_share
from isf_springback.estimators.analytic import AnalyticModel
from isf_springback.estimators.estimator import NoCorrection
from isf_springback.methods import make_corrector
from scanned_sheet import COUNT, TARGET, Sheet
from springback_parts import JOB_TEXT, cone_contour, corrector_of, job_file, result_of

STEP = 0.5e-3


def job(text=""):
    return JobFile(JOB_TEXT.replace("method: analytic", "method: fused, " + text) if text else JOB_TEXT, Path("."))


def with_peak(contour, share):
    """A result whose largest axial force is ``share`` of the limit."""
    rig = job().rig
    limit = min(rig.limits.force[2], rig.load_cell.force_range[2])
    result = result_of(contour, 500.0)
    force = result.forming_force.copy()
    force[7, 2] = share * limit
    return replace(result, forming_force=force)


def pushes(shares, deeper=3e-3):
    """m, mean push of every contour while the shape asks for ``deeper`` more than the model."""
    method = make_corrector("fused", job("scan_every: 1"))
    method.set_target(TARGET)
    sheet, found = Sheet(lambda depth, around: 5e-3 + deeper), []
    for index, share in enumerate(shares):
        nominal = cone_contour(index, count=COUNT)
        correction = method.correct(nominal)
        corrected = apply(nominal, correction)
        sheet.form(corrected)
        method.add_result(corrected, with_peak(corrected, share))
        method.add_scan(sheet.points(), index)
        found.append((float(-correction.offset[:, 2].mean()), correction))
    return found


def test_share_of_the_weaker_limit():
    contour = cone_contour(0)
    assert force_share(with_peak(contour, 0.8), job()) == pytest.approx(0.8, abs=1e-12)
    empty = replace(result_of(contour, 500.0), forming_force=np.empty((0, 3)))
    assert force_share(empty, job()) == 0.0
    blind = replace(result_of(contour, 500.0), forming_force=np.full((len(contour), 3), np.nan))
    assert force_share(blind, job()) == 0.0


def test_no_step_exceeds_the_bound_however_much_is_asked_for():
    push = np.array([value for value, _ in pushes([0.3] * 12)])
    assert push[-1] > 3e-3
    assert np.abs(np.diff(push)).max() <= 2.0 * STEP + 1e-9


def test_near_the_force_limit_the_step_becomes_smaller_and_says_so():
    found = pushes([0.3] * 4 + [0.98] * 4)
    free = [value for value, _ in pushes([0.3] * 8)]
    push = np.array([value for value, _ in found])
    assert free[-1] > push[-1] + 0.1e-3
    assert (np.diff(push[4:], 2) < 0.0).all()
    assert push[-1] < push[4]
    assert any("allows a step" in remark for remark in found[-1][1].remarks)
    assert not any("allows a step" in remark or "limit" in remark for remark in found[3][1].remarks)


def test_the_model_of_fused_is_a_choice_of_the_job():
    """Without scans the prediction is that of the chosen model under the held force."""
    for chosen, model in (("model: analytic", "analytic"), ("model: elastic", "elastic"), ("", "elastic")):
        fused = make_corrector("fused", JobFile(JOB_TEXT.replace("model: analytic", chosen), Path(".")))
        alone = make_corrector(model, job())
        for index in range(3):
            contour = cone_contour(index)
            one, other = fused.correct(contour), alone.correct(contour)
            for method in (fused, alone):
                method.add_result(apply(contour, one), result_of(contour, 500.0))
            if index == 0:
                alone.follow(contour, one)
        assert one.code == 0
        np.testing.assert_allclose(one.springback, other.springback, rtol=1e-6)


@pytest.mark.parametrize("kind", [NoCorrection, AnalyticModel])
def test_a_method_comes_forward_step_by_step_where_another_has_pulled_back(kind):
    """The tool stands 2 mm over the plan; a contour changes by 1 mm, two incremental depths, at most."""
    method = corrector_of(kind, job_file())
    for index in range(3):
        contour = cone_contour(index)
        offset = np.tile([0.0, 0.0, 2e-3], (len(contour), 1))
        method.follow(contour, ContourCorrection("plan", index, "learned", offset, np.zeros(len(contour))))
        method.add_result(contour, result_of(contour, 0.0, squeeze=0.0))
    levels = []
    for index in (3, 4, 5):
        contour = cone_contour(index)
        levels.append(float(method.correct(contour).offset[:, 2].mean()))
        method.add_result(contour, result_of(contour, 0.0, squeeze=0.0))
    assert levels == pytest.approx([1e-3, 0.0, 0.0], abs=1e-6)
