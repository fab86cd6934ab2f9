"""Flow curves: a published one, and the estimate against its own definition."""

from __future__ import annotations

import numpy as np
import pytest
from isf_core.files.material import flow_curve, load_material, plane_strain


def test_published_curve() -> None:
    curve = flow_curve(load_material("Al8011"))
    assert not curve.estimated
    assert curve.stress(1.0) == pytest.approx(144e6)
    assert curve.stress(0.5) == pytest.approx(144e6 * 0.5**0.02)


@pytest.mark.parametrize("name", ["AA1100-O", "AA5754-O", "AA7075-O", "AA2024-T3"])
def test_estimate_reproduces_yield_and_tensile_strength(name: str) -> None:
    material = load_material(name)
    curve = flow_curve(material)
    assert curve.estimated
    assert 0.005 < curve.exponent < 0.5
    assert curve.stress(0.002) == pytest.approx(material.yield_strength, rel=1e-9)
    # engineering stress of the curve, K strain^n exp(-strain), has its maximum at the tensile strength
    strain = np.linspace(0.002, 0.6, 60001)
    assert (curve.stress(strain) * np.exp(-strain)).max() == pytest.approx(material.tensile_strength, rel=1e-6)


def test_plane_strain_of_a_wall() -> None:
    assert plane_strain(1e-3, 1e-3) == 0.0
    assert plane_strain(1e-3, 0.5e-3) == pytest.approx(2 / np.sqrt(3) * np.log(2))
