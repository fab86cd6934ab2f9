"""The fuzzy controller: printed rules and derived values of Torrao 2013, inference by hand, the table's error."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from isf_sim.legs.fuzzy import RULES, SETS, build_table, infer, look_up

TABLE = build_table()


def test_rules_are_odd() -> None:
    """Torrao 2013, Table 5.1: rule(-e, -de) = -rule(e, de)."""
    mirrored = [[SETS[6 - SETS.index(name)] for name in reversed(row)] for row in reversed(RULES)]
    assert [list(row) for row in RULES] == mirrored
    assert sum(len(row) for row in RULES) == 49


@pytest.mark.parametrize(
    ("error", "outputs"),
    [  # over rates of -1, -0.5, -0.1, 0, 0.1, 0.5, 1; derived from the rules with the same sets by another program
        (-1.0, (0.8892, 0.8706, 0.6810, 0.6667, 0.6667, 0.5000, 0.0)),
        (-0.5, (0.7066, 0.5407, 0.5000, 0.5000, 0.3806, 0.0, -0.5000)),
        (-0.1, (0.6667, 0.2860, 0.1116, 0.1116, 0.1116, -0.1667, -0.6667)),
        (0.0, (0.6667, 0.1667, 0.0, 0.0, 0.0, -0.1667, -0.6667)),
    ],
)
def test_inference_gives_the_derived_surface(error: float, outputs: tuple[float, ...]) -> None:
    rates = (-1.0, -0.5, -0.1, 0.0, 0.1, 0.5, 1.0)
    assert [infer(error, rate) for rate in rates] == pytest.approx(outputs, abs=1.5e-3)
    assert [infer(-error, -rate) for rate in rates] == pytest.approx([-value for value in outputs], abs=1.5e-3)


def test_centre_of_gravity_by_hand() -> None:
    """Error and rate zero in the middle of a set: one rule alone, so its triangle; halfway between two, their union."""
    assert infer(0.0, -1.0) == pytest.approx(2.0 / 3.0, abs=1e-6)  # (ze, nb) is pm, a whole triangle about 2/3
    assert infer(-0.5, 0.0) == pytest.approx(0.5, abs=1e-6)  # pm and ps by one half each, symmetric about 1/2
    # (nb, nb) is pb: the half triangle from 2/3 to 1 that rises to 1, with its centre two thirds of the way
    assert infer(-1.0, -1.0) == pytest.approx(2.0 / 3.0 + 2.0 / 9.0, abs=1e-3)


@given(error=st.floats(-1.5, 1.5), rate=st.floats(-1.5, 1.5))
@example(error=-2.0 / 3.0, rate=-2.0 / 3.0)
@settings(max_examples=40, deadline=None)
def test_table_is_near_the_inference_and_bounded(error: float, rate: float) -> None:
    """21 x 21 points (Torrao 2013, 5.3), bilinear between: off by 0.0746 at most, where a peak of the sets
    lies between its points, 2/3 (on a grid of 401 x 401 with the peaks)."""
    found = look_up(error, rate, TABLE)
    assert found == pytest.approx(infer(float(np.clip(error, -1, 1)), float(np.clip(rate, -1, 1))), abs=0.075)
    assert abs(found) <= 0.89
    assert look_up(-error, -rate, TABLE) == pytest.approx(-found, abs=1e-9)
