"""The sheet that a material file describes."""

from __future__ import annotations

import numpy as np
import pytest
from isf_core.files.material import load_material
from isf_sim.explicit_shell.formed_sheet import sheet_of
from isf_sim.variant import Variant


def test_the_sheet_of_a_material_takes_its_law_and_its_share_of_kinematic_hardening() -> None:
    material = load_material("AA5754-O")
    voce = {"saturation_stress": 258e6, "saturation_strain": 0.06, "kinematic_hardening": 0.4}
    sheet = sheet_of(material.model_copy(update=voce), 1e-3, Variant(force_level=1.1))
    assert sheet.kinematic == 0.4
    strain, stress = sheet.plastic_strain, sheet.flow_stress
    assert stress == pytest.approx(1.1e6 * (258.0 - 148.0 * np.exp(-strain / 0.06)), rel=1e-9)
    assert sheet_of(material, 1e-3, Variant()).kinematic == 0.0
    assert sheet_of(material, 1e-3, Variant()).flow_stress[0] == pytest.approx(110e6, rel=1e-9)  # at 0.2 %
