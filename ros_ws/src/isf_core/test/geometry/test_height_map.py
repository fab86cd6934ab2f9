"""Height map: interpolation, gradient, round trip through points."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from isf_core.geometry.height_map import HeightMap

X, Y = np.linspace(-0.1, 0.1, 21), np.linspace(-0.05, 0.05, 11)


def test_a_plane_is_reproduced_with_its_gradient() -> None:
    gx, gy = np.meshgrid(X, Y)
    plane = HeightMap(X, Y, 0.3 * gx - 0.2 * gy + 0.01)
    at = plane.at(np.array([[0.0123, -0.0456], [0.2, 0.0]]))
    assert at[0] == pytest.approx(0.3 * 0.0123 + 0.2 * 0.0456 + 0.01, abs=1e-12)
    assert np.isnan(at[1])
    dz_dx, dz_dy = plane.gradient()
    np.testing.assert_allclose(dz_dx, 0.3, atol=1e-10)
    np.testing.assert_allclose(dz_dy, -0.2, atol=1e-10)


@given(arrays(float, (11, 21), elements=st.floats(-0.1, 0.1)), st.randoms(use_true_random=False))
def test_points_in_any_order_give_the_same_map(z: np.ndarray, random: object) -> None:
    order = np.random.default_rng(random.randint(0, 2**32 - 1)).permutation(z.size)  # type: ignore[attr-defined]
    back = HeightMap.from_points(HeightMap(X, Y, z).points()[order])
    np.testing.assert_array_equal(back.x, X)
    np.testing.assert_array_equal(back.y, Y)
    np.testing.assert_array_equal(back.z, z)


def test_an_incomplete_grid_is_refused() -> None:
    points = HeightMap(X, Y, np.zeros((11, 21))).points()
    with pytest.raises(ValueError, match="do not fill a grid"):
        HeightMap.from_points(points[:-1])
