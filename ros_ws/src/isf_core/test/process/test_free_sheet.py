"""How far the opening of a part sinks beside which nothing holds the sheet."""

import pytest
from isf_core.process.free_sheet import opening_sag


@pytest.mark.parametrize(
    ("free", "reached"),  # mm, docs/methods/planning.md: parts on the elasto-plastic sheet; cones of 40 and 60 deg
    [(1.0, 0.82), (4.8, 1.72), (7.1, 1.69), (16.0, 2.82), (66.0, 5.15), (109.0, 4.70), (7.5, 2.05), (7.5, 2.7)],
)
def test_the_sag_is_that_of_formed_and_of_scanned_parts(free, reached):
    assert 1 / 1.7 < 1e3 * opening_sag(1e-3 * free) / reached < 1.7


def test_it_goes_by_the_root_of_the_free_sheet():
    assert opening_sag(9e-3) == pytest.approx(1.8e-3)
    assert opening_sag(0.0) == opening_sag(-1e-3) == 0.0


def test_a_shallow_part_sinks_less():
    assert opening_sag(113e-3, 5e-3) == pytest.approx(3.0e-3)
    assert opening_sag(113e-3, 21e-3) == opening_sag(113e-3) == pytest.approx(6.38e-3, rel=1e-3)


def test_two_tools_let_it_sink_three_quarters_as_far():
    assert opening_sag(16e-3, two_tools=True) == pytest.approx(1.8e-3)
