"""The opening of a part sinks beside which nothing holds the sheet: methods that know springback alone say so."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from isf_core.contour import Process
from isf_core.files.job import JobFile
from isf_springback.corrector import apply
from isf_springback.methods import make_corrector
from isf_springback.sheet_edge import opening_sag
from springback_parts import JOB_TEXT, cone_contour, result_of

PLATE = "backing_plate: {shape: circle, size: [88 mm, 88 mm]}\n"
FREE = 44.0 - (36.0 - 0.5 / np.tan(np.radians(50.0)))
"""mm between the first contour and the edge of the plate."""


def job(text=JOB_TEXT, plate=PLATE):
    return JobFile(text + plate, Path("."))


def one_tool(contour):
    return replace(contour, process=Process.SPIF, support_tip=np.empty((0, 3)), support_force=np.empty(0))


def waiting(contour):
    return replace(contour, support_tip=np.repeat(contour.support_tip[:1], len(contour), axis=0))


@pytest.mark.parametrize("method", ["analytic", "elastic", "fused"])
def test_it_is_foreseen_where_the_part_begins_and_nowhere_else(method):
    corrector = make_corrector(method, job())
    first, second = cone_contour(0), cone_contour(1)
    opening = corrector.correct(first)
    np.testing.assert_allclose(1e3 * opening.residual, -0.6 * np.sqrt(FREE) * 0.75, rtol=1e-6)
    corrector.add_result(apply(first, opening), result_of(first, 500.0))
    below = corrector.correct(second)
    # what the limits cut off, and nothing else
    np.testing.assert_allclose(below.residual, below.offset[:, 2] + below.springback * -second.push_sign, atol=1e-9)


def test_a_lower_tool_lets_it_rise():
    correction = make_corrector("analytic", job()).correct(cone_contour(0, tool=2))
    assert correction.residual.min() > 1e-3


@pytest.mark.parametrize(
    ("contour", "plate", "sag"),
    [
        (cone_contour(0), PLATE, 0.6 * np.sqrt(FREE) * 0.75),
        (one_tool(cone_contour(0)), PLATE, 0.6 * np.sqrt(FREE)),
        (waiting(cone_contour(0)), PLATE, 0.6 * np.sqrt(FREE)),
        (
            one_tool(cone_contour(0)),
            "",
            0.6 * np.sqrt(125.0 - (44.0 - FREE) * np.sqrt(0.5)),
        ),  # where the clamp is farthest away
        (one_tool(cone_contour(0, count=4)), "", 0.6 * 2.0),  # 2 mm deep
        (replace(cone_contour(0), process=Process.TPIF), PLATE, 0.0),
        (replace(cone_contour(0), process=Process.ADSIF), PLATE, 0.0),
        (cone_contour(4), PLATE, 0.0),  # begins inside another feature
    ],
)
def test_how_far(contour, plate, sag):
    assert 1e3 * opening_sag(contour, job(plate=plate)) == pytest.approx(sag, rel=1e-3)


def test_a_support_tool_under_the_blank_holds_it():
    text = JOB_TEXT.replace("control: {support_force: 120 N}\n", "").replace(
        "0.5 mm, feed", "0.5 mm, support: on_blank, feed"
    )
    assert opening_sag(cone_contour(0), job(text, "")) == 0.0
