"""Shape of the sheet in a further stage: that of the stage before, as far as the new one has not reached it."""

from dataclasses import replace

import numpy as np
import pytest
from isf_springback.shell.formed_sheet import formed_sheet
from shell_sheets import cone_contours

CLAMP = (0.25, 0.25)
MIDDLE = np.zeros((1, 2))


def plan_of(*stages, **changes):
    """Contours of the cones ``stages`` (opening, angle, depth), one after the other."""
    groups = [[replace(one, stage=stage) for one in cone_contours(*cone)] for stage, cone in enumerate(stages)]
    contours = [contour for group in groups for contour in group]
    return [replace(contour, index=index, **changes) for index, contour in enumerate(contours)]


def across(contours, *radii):
    """mm, height at ``radii`` mm along x."""
    places = 1e-3 * np.column_stack([radii, np.zeros(len(radii))])
    return 1e3 * formed_sheet(contours, CLAMP).height(places)


def test_a_finishing_pass_begins_in_the_part():
    """20 contours of 1 mm at 50 deg, then the first one again: the floor stays where it is, and so does the wall."""
    contours = plan_of((36e-3, 50.0, 20e-3), (36e-3, 50.0, 20e-3))
    assert formed_sheet(contours[:20], CLAMP).height(MIDDLE) == pytest.approx([-20e-3])
    for formed in (21, 30, 40):
        assert formed_sheet(contours[:formed], CLAMP).height(MIDDLE) == pytest.approx([-20e-3])
        # 36 mm less 5 and 15 mm of depth at 50 deg
        assert across(contours[:formed], 31.80, 23.41, 50.0) == pytest.approx([-5.0, -15.0, 0.0], abs=0.05)


def test_a_steeper_stage_replaces_what_lies_above_it():
    """A cone of 30 deg, of which one of 60 deg has formed the upper 5 mm."""
    contours = plan_of((36e-3, 30.0, 10e-3), (36e-3, 60.0, 10e-3))
    formed = contours[:15]
    # the new wall: 36 mm less 4 mm of depth at 60 deg; the old one: less 8 and 10 mm at 30 deg
    assert across(formed, 33.69, 22.14, 18.68, 0.0) == pytest.approx([-4.0, -8.0, -10.0, -10.0], abs=0.05)
    # between them, where the old wall lay 3.3 mm deep, it now leads from the new loop to the old one below it
    assert -6.0 < across(formed, 30.3)[0] < -5.0
    # and at the end all of the old one is gone: 36 mm less 9 mm at 60 deg
    assert across(contours, 30.80, 22.14) == pytest.approx([-9.0, -10.0], abs=0.05)


def test_from_below_it_is_the_same_upside_down():
    contours = [
        replace(contour, contact=contour.contact * [1.0, 1.0, -1.0], forming_tool=2)
        for contour in plan_of((36e-3, 30.0, 10e-3), (36e-3, 60.0, 10e-3))
    ]
    assert across(contours[:15], 33.69, 22.14, 0.0) == pytest.approx([4.0, 8.0, 10.0], abs=0.05)


def test_a_pocket_beside_one_in_a_further_stage_stays():
    first, second = (
        [replace(one, contact=one.contact + [x, 0.0, 0.0], feature=feature) for one in cone_contours(30e-3, 50.0, 9e-3)]
        for feature, x in enumerate((-50e-3, 50e-3))
    )
    again = [replace(one, stage=1) for one in first[:2]]
    assert across([*first, *second, *again], -50.0, 50.0) == pytest.approx([-9.0, -9.0], abs=1e-6)
