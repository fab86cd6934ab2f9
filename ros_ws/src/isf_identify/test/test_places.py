"""Where the tools go to by default, and places that clamp and backing plate forbid."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile
from isf_core.files.tooling import BackingPlateSpec
from isf_force_ctrl.control_config import ControlConfig
from isf_identify.settings import IdentifySettings, Property, ToolGeometry, places_for

EXAMPLES = Path(__file__).resolve().parents[4] / "examples" / "jobs"
FILE = JobFile((EXAMPLES / "mini_cone.yaml").read_text(), EXAMPLES)
CONFIG, GEOMETRY = ControlConfig.from_job(FILE), ToolGeometry.from_job(FILE)
OPENING = BackingPlateSpec(shape="circle", size=(46e-3, 46e-3))
LOOP = ((-0.03, -0.02), (0.03, -0.02), (0.03, 0.02), (-0.03, 0.02))


def tips(geometry: ToolGeometry, *places: float) -> np.ndarray:
    settings = IdentifySettings.of(Property.TOOL_COMPLIANCE, 1, 1, places, 200.0)
    return np.array([place.tip_1 for place in places_for(settings, CONFIG, geometry, None)])


def test_without_a_plate_on_a_large_sheet_they_are_where_they_were() -> None:
    assert GEOMETRY.clamp == (0.25, 0.25)
    assert tips(GEOMETRY) == pytest.approx(np.array([[0.0, 0.0, 0.0], [25e-3, 0.0, 0.0], [0.0, 25e-3, 0.0]]))


def test_they_stay_inside_the_opening_of_a_plate_and_inside_a_small_clamp() -> None:
    """An opening of 46 mm leaves the ball of 5 mm 18 mm to go, a clamp of 60 mm 25 mm: half of that."""
    with_plate = JobFile(
        (EXAMPLES / "mini_cone.yaml").read_text() + "\nbacking_plate: {shape: circle, size: [46 mm, 46 mm]}\n", EXAMPLES
    )
    assert tips(ToolGeometry.from_job(with_plate))[1:, :2] == pytest.approx(np.array([[9e-3, 0.0], [0.0, 9e-3]]))
    small = replace(GEOMETRY, clamp=(60e-3, 0.2))
    assert tips(small)[1:, :2] == pytest.approx(np.array([[12.5e-3, 0.0], [0.0, 12.5e-3]]))


@pytest.mark.parametrize(
    ("geometry", "place", "text"),
    [
        (replace(GEOMETRY, plate=OPENING), (18.1e-3, 0.0, 0.0), "tool 2, .* backing plate: 4.9 mm inside its opening"),
        (replace(GEOMETRY, plate=OPENING), (25e-3, 0.0, 0.0), "backing plate: -2.0 mm inside its opening"),
        (
            replace(GEOMETRY, plate=BackingPlateSpec(shape="outline", openings=(LOOP,))),
            (0.0, 16e-3, 0.0),
            "backing plate: 4.0 mm inside",
        ),
        (GEOMETRY, (121e-3, 0.0, 0.0), "tool 1, .* would stand on the clamp"),
        (GEOMETRY, (0.0, -121e-3, 0.0), "would stand on the clamp"),
    ],
)
def test_places_on_clamp_or_plate_are_refused(
    geometry: ToolGeometry, place: tuple[float, float, float], text: str
) -> None:
    with pytest.raises(IsfError, match=text) as refused:
        tips(geometry, *place)
    assert refused.value.code is ErrorCode.MEASUREMENT_REFUSED
    assert "give places" in refused.value.advice


def test_places_just_inside_are_taken() -> None:
    assert tips(replace(GEOMETRY, plate=OPENING), 17.9e-3, 0.0, 0.0)[0, 0] == 17.9e-3
    assert tips(GEOMETRY, 119e-3, 0.0, 0.0)[0, 0] == 119e-3
