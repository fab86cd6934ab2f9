"""Sheet deflection against the numbers of Praveen 2020; E and nu are not printed there."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from isf_core.process.deflection import SheetSection, deflection, membrane_share, ring_load_law

# Al8011 of the paper; 70 GPa and 0.33 reproduce its finite elements (3.1)
PAPER = SheetSection(young_modulus=70e9, poisson_ratio=0.33, thickness=0.8e-3)
LOAD = 16.50e3
"""N/m, 381 N over the perimeter of the contact patch (3.1)."""

# r_b, r_l in mm; a N/mm^4, b N/mm^2, w mm at 16.50 N/mm (eq. 5-16); combined w of Table 1 in mm
ROWS = [
    (50, 42, 67.10, 25.45, 0.4335, 0.428, 0.33),
    (350, 300, 0.27196, 0.101185, 3.898, 4.05, 0.976),
    (1000, 900, 0.033147, 0.011767, 7.910, 7.95, 0.994),
]


def test_rigidities():
    # D = 3351.66 N mm and C = 62 843.7 N/mm (2.3), to six digits
    assert PAPER.bending_rigidity == pytest.approx(3.35166, rel=1e-5)
    assert PAPER.in_plane_rigidity == pytest.approx(62_843.7e3, rel=1e-5)


@pytest.mark.parametrize(("clamp", "ring", "a", "b", "w", "table", "share"), ROWS)
def test_coefficients_root_and_table_1(clamp, ring, a, b, w, table, share):
    law = ring_load_law(PAPER, clamp * 1e-3, ring * 1e-3)
    # four printed digits of the coefficient table
    assert law.cubic * 1e-12 == pytest.approx(a, rel=3e-4)
    assert law.linear * 1e-6 == pytest.approx(b, rel=3e-4)
    found = deflection(law, LOAD)
    assert found * 1e3 == pytest.approx(w, rel=3e-4)
    # Table 1 was computed with an unprinted l + m: reproduced to 4 % with one value for all rows
    assert found * 1e3 == pytest.approx(table, rel=0.04)
    # membrane share of the load, to two digits
    assert membrane_share(law, found) == pytest.approx(share, abs=0.006)


def test_root_of_the_unit_test_table():
    # 3.8978 with the complex pair -1.949 +- 3.430i
    law = ring_load_law(PAPER, 0.350, 0.300)
    assert deflection(law, LOAD) * 1e3 == pytest.approx(3.8978, abs=1e-4)
    roots = np.roots([float(law.cubic), 0.0, float(law.linear), -LOAD]) * 1e3
    pair = roots[np.iscomplex(roots)]
    # the printed digits
    assert pair.real == pytest.approx([-1.949] * 2, abs=1e-3)
    assert np.abs(pair.imag) == pytest.approx([3.430] * 2, abs=1e-3)


def test_small_deflection_theory_alone_is_far_too_soft():
    # "w_small / w_combined > 40 for r_b >= 350" is all that Table 1 supports
    for clamp, ring in ((0.35, 0.3), (1.0, 0.9)):
        law = ring_load_law(PAPER, clamp, ring)
        assert LOAD / law.linear > 40 * deflection(law, LOAD)


@pytest.mark.parametrize(("gap", "w"), [(8, 0.485), (50, 4.007), (100, 8.054)])
def test_thin_annulus(gap, w):
    # limits a -> C/(2 s^3), b -> 3 D/s^3; at r_b = 100 m the curvature of the ring is below 0.2 %
    law = ring_load_law(PAPER, 100.0, 100.0 - gap * 1e-3)
    s = gap * 1e-3
    assert law.cubic == pytest.approx(PAPER.in_plane_rigidity / (2 * s**3), rel=2e-3)
    # the bending bracket is a small difference of large terms: 1e-16 / (s / r_b)^3 is still below 1 %
    assert law.linear == pytest.approx(3 * PAPER.bending_rigidity / s**3, rel=1e-2)
    # values of the same limits evaluated, three decimals
    assert deflection(law, LOAD) * 1e3 == pytest.approx(w, abs=2e-3 * w + 5e-4)


@given(
    ring=st.floats(0.01, 1.0),
    gap=st.floats(0.01, 0.5),
    thickness=st.floats(0.3e-3, 3e-3),
    load=st.floats(0.0, 1e6),
)
def test_root_solves_the_cubic(ring, gap, thickness, load):
    law = ring_load_law(SheetSection(70e9, 0.33, thickness), ring + gap, ring)
    found = deflection(law, load)
    assert found >= 0
    # rounding of the closed form only
    assert law.cubic * found**3 + law.linear * found == pytest.approx(load, rel=1e-9, abs=1e-9)


@given(load=st.floats(1.0, 1e5), more=st.floats(1.01, 3.0))
def test_more_load_or_wider_span_deflects_more(load, more):
    law = ring_load_law(PAPER, 0.2, 0.1)
    assert deflection(law, more * load) > deflection(law, load)
    assert deflection(ring_load_law(PAPER, 0.2 * more, 0.1), load) > deflection(law, load)


def test_odd_in_the_load():
    law = ring_load_law(PAPER, 0.2, 0.1)
    assert deflection(law, -LOAD) == pytest.approx(-deflection(law, LOAD), rel=1e-12)


@pytest.mark.parametrize(("clamp", "ring"), [(0.1, 0.1), (0.1, 0.2), (0.1, 0.0)])
def test_ring_must_lie_in_the_clamp(clamp, ring):
    with pytest.raises(ValueError, match="inside the clamp"):
        ring_load_law(PAPER, clamp, ring)
