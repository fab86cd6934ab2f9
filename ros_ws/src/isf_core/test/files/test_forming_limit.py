"""What a sheet bears: data of its material, else estimated from the largest wall angle of one pass."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from isf_core.errors import ErrorCode
from isf_core.events import Event, EventKind, torn
from isf_core.files.material import FormingLimit, forming_limit, load_material

MATERIALS = sorted(path.stem for path in Path(__file__).resolve().parents[2].glob("materials/*.yaml"))


@pytest.mark.parametrize("name", MATERIALS)
def test_every_material_says_what_it_bears_and_why(name: str) -> None:
    material = load_material(name)
    limit = forming_limit(material)
    assert not limit.estimated
    assert 0.4 < limit.strain < 2.3  # 76 deg in one pass (Behera 2015) are 2.2
    for field in ("fracture_strain", "fracture_slope", "bending_share"):
        assert material.provenance[field].startswith(("published", "calibrated", "assumed"))
    estimate = forming_limit(material.model_copy(update={"fracture_strain": None}))
    assert estimate.estimated
    if "from max_wall_angle" in material.provenance["fracture_strain"]:
        assert estimate.strain == pytest.approx(limit.strain, abs=1e-3)


def test_estimate_without_data() -> None:
    """60 deg: 1.15 ln 2 of thinning and 0.15 sin 60 tan 60 of bends."""
    unknown = {"max_wall_angle": math.radians(60.0), "fracture_strain": None, "fracture_slope": None}
    bare = load_material("DC04").model_copy(update={**unknown, "bending_share": None})
    assert forming_limit(bare) == FormingLimit(pytest.approx(1.022, abs=1e-3), 1.0, 0.15, estimated=True)


def test_the_first_tear_is_why_a_part_is_lost() -> None:
    chips = Event(EventKind.GALLING, 1.0, (0.0, 0.0, 0.0), 200.0, 150.0, "chips")
    tear = Event(EventKind.FRACTURE, 2.0, (0.01, 0.0, -0.01), 1.1, 1.0, "the sheet tears at (10.0, 0.0, -10.0) mm")
    assert torn([chips]) is None
    lost = torn([chips, tear])
    assert lost is not None
    assert lost.code is ErrorCode.SHEET_TORN
    assert "(10.0, 0.0, -10.0) mm" in lost.message
