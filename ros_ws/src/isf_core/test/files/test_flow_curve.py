"""Flow curves: a published one, and the estimate against its own definition."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.hardening_law import FlowCurve
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
    assert isinstance(curve, FlowCurve)
    assert curve.estimated
    assert 0.005 < curve.exponent < 0.5
    assert curve.stress(0.002) == pytest.approx(material.yield_strength, rel=1e-9)
    # engineering stress of the curve, K strain^n exp(-strain), has its maximum at the tensile strength
    strain = np.linspace(0.002, 0.6, 60001)
    assert (curve.stress(strain) * np.exp(-strain)).max() == pytest.approx(material.tensile_strength, rel=1e-6)


def test_plane_strain_of_a_wall() -> None:
    assert plane_strain(1e-3, 1e-3) == 0.0
    assert plane_strain(1e-3, 0.5e-3) == pytest.approx(2 / np.sqrt(3) * np.log(2))


BASE = """name: own
young_modulus: 70 GPa
poisson_ratio: 0.33
yield_strength: 110 MPa
tensile_strength: 215 MPa
friction: 0.08
max_wall_angle: 66 deg
"""
TABLE = "flow_curve: [[0, 100 MPa], [0.1, 180 MPa], [0.3, 220 MPa]]\n"
SWIFT = "strength_coefficient: 400 MPa\nhardening_exponent: 0.25\npre_strain: 0.004\n"
VOCE = "saturation_stress: 258 MPa\nsaturation_strain: 0.06\n"


def written(folder: Path, lines: str) -> str:
    """A material file with ``lines`` and an origin for every field."""
    names = [line.split(":")[0] for line in (BASE + lines).splitlines() if not line.startswith("name")]
    stated = "".join(f"  {name}: 'assumed: test'\n" for name in names)
    (folder / "own.yaml").write_text(f"{BASE}{lines}provenance:\n{stated}", encoding="utf-8")
    return "own.yaml"


@pytest.mark.parametrize(
    ("lines", "strain", "stress"),
    [
        (TABLE, [0.0, 0.05, 0.3, 1.0], [100e6, 140e6, 220e6, 220e6]),
        (SWIFT, [0.0, 0.1, 1.0], [400e6 * 0.004**0.25, 400e6 * 0.104**0.25, 400e6 * 1.004**0.25]),
        (VOCE, [0.0, 0.06, 3.0], [110e6, 258e6 - 148e6 / np.e, 258e6]),
    ],
)
def test_laws_of_a_file(tmp_path: Path, lines: str, strain: list[float], stress: list[float]) -> None:
    curve = flow_curve(load_material(written(tmp_path, lines), tmp_path))
    assert not curve.estimated
    assert curve.stress(np.array(strain)) == pytest.approx(stress, rel=1e-9)


def test_a_share_of_kinematic_hardening_goes_with_any_law(tmp_path: Path) -> None:
    assert load_material(written(tmp_path, "kinematic_hardening: 0.4\n"), tmp_path).kinematic_hardening == 0.4
    assert load_material(written(tmp_path, VOCE + "kinematic_hardening: 0.99\n"), tmp_path).kinematic_hardening == 0.99


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        (TABLE + VOCE, "saturation_stress: the flow curve is given already by flow_curve"),
        (SWIFT + VOCE, "given already by strength_coefficient and hardening_exponent and pre_strain"),
        ("pre_strain: 0.004\n", "pre_strain: needs strength_coefficient and hardening_exponent too"),
        ("strength_coefficient: 400 MPa\n", "strength_coefficient: needs hardening_exponent too"),
        ("saturation_strain: 0.06\n", "saturation_strain: needs saturation_stress too"),
        ("saturation_stress: 100 MPa\nsaturation_strain: 0.1\n", "saturation_stress: is not above the yield strength"),
        ("flow_curve: [[0.1, 100 MPa], [0.2, 120 MPa]]\n", "flow_curve: must begin at plastic strain 0"),
        ("flow_curve: [[0, 100 MPa], [0.2, 90 MPa]]\n", "stress must not fall, which point 2"),
        ("flow_curve: [[0, 100 MPa], [0, 110 MPa]]\n", "strain must rise"),
        ("flow_curve: [[0, 100 MPa]]\n", "flow_curve: .*at least 2"),
        ("kinematic_hardening: 1.0\n", "kinematic_hardening: .*less than or equal to 0.99"),
    ],
)
def test_a_curve_that_is_none_is_refused(tmp_path: Path, lines: str, said: str) -> None:
    with pytest.raises(IsfError, match=said) as error:
        load_material(written(tmp_path, lines), tmp_path)
    assert error.value.code == ErrorCode.FILE_FIELD


def test_points_carry_units_and_laws_an_origin(tmp_path: Path) -> None:
    with pytest.raises(IsfError, match="has no unit") as error:
        load_material(written(tmp_path, "flow_curve: [[0, 100 MPa], [0.1, 180]]\n"), tmp_path)
    assert error.value.code == ErrorCode.FILE_UNIT
    path = tmp_path / written(tmp_path, VOCE)
    path.write_text(path.read_text().replace("  saturation_strain: 'assumed: test'\n", ""), encoding="utf-8")
    with pytest.raises(IsfError, match="provenance is missing for saturation_strain"):
        load_material("own.yaml", tmp_path)
