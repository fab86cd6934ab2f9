"""A support tool under the blank (``path.support: on_blank``) holds the sheet where it is, whatever is corrected."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from ball_gap import tool_gap
from isf_core.files.job import JobFile
from isf_springback.corrector import SUPPORT_REMARK, apply
from isf_springback.loop_path import nearest_points
from isf_springback.methods import make_corrector
from springback_parts import JOB_TEXT, cone_contour, result_of

CONTOURS = 16
FREE = JOB_TEXT.replace("control: {support_force: 120 N}\n", "").replace(
    "0.5 mm, feed", "0.5 mm, support: SUPPORT, feed"
)


def corrected_contours(support, method):
    """(nominal, correction, corrected) of a few contours under 500 N."""
    job = JobFile(FREE.replace("SUPPORT", support), Path("."))
    corrector, found = make_corrector(method, job), []
    line = cone_contour(0).support_tip
    for index in range(CONTOURS):
        nominal = cone_contour(index)
        if support == "on_blank":
            nominal = replace(nominal, support_tip=line[nearest_points(nominal.contact[:, :2], line[:, :2])])
        correction = corrector.correct(nominal)
        corrected = apply(nominal, correction, support_stays=corrector.support_stays)
        corrector.add_result(corrected, result_of(corrected, 500.0))
        found.append((nominal, correction, corrected))
    return found


@pytest.mark.parametrize("method", ["analytic", "elastic"])
def test_the_support_tool_stays_and_the_forming_tool_is_corrected(method):
    made = corrected_contours("on_blank", method)
    for nominal, correction, corrected in made:
        np.testing.assert_array_equal(corrected.support_tip, nominal.support_tip)
        np.testing.assert_array_equal(corrected.forming_tip, nominal.forming_tip + correction.offset)
        np.testing.assert_array_equal(corrected.contact, nominal.contact + correction.offset)
        assert correction.code == 0
        # the sheet of 1 mm is not squeezed more than planned between the balls
        planned, left = (tool_gap(one.forming_tip, one.support_tip, 5e-3, 5e-3) for one in (nominal, corrected))
        assert (left - np.minimum(planned, 1e-3)).min() > -1e-9
    np.testing.assert_allclose(made[0][1].offset, 0.0, atol=1e-9)  # the tools are opposite
    # at last the tools are as far apart as the force asks for; who reads the report learns where they were not
    assert made[-1][1].offset[:, 2].max() < -1e-3
    told = [SUPPORT_REMARK in correction.remarks for _, correction, _ in made]
    assert (told[0], told[1], told[-1]) == (False, True, False)


@pytest.mark.parametrize("method", ["analytic", "elastic"])
def test_an_opposite_support_tool_moves_alike(method):
    made = corrected_contours("opposite", method)
    for nominal, correction, corrected in made:
        np.testing.assert_array_equal(corrected.support_tip, nominal.support_tip + correction.offset)
    assert made[-1][1].offset[:, 2].max() < -1e-3
