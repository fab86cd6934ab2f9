"""Where the tools go to by default, and places that clamp and backing plate forbid."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from isf_core.contour import Contour, Process
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile
from isf_core.files.tooling import BackingPlateSpec
from isf_force_ctrl.control_config import ControlConfig
from isf_identify.fits import fit_compliance
from isf_identify.settings import IdentifySettings, Property, ToolGeometry, places_for
from isf_identify.squeeze_probe import Reading

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


def flat_tips(wall: float) -> tuple[JobFile, Contour]:
    """Both tips of radius 5 mm with a rounded edge, of 2 mm and 3 mm, at a ``wall`` rad that faces +x, 0.8 mm thick."""
    text = (EXAMPLES / "mini_cone.yaml").read_text()
    for number, corner in ((1, 2), (2, 3)):
        plain = f"tool_{number}:\n  radius: 5 mm\n"
        assert plain in text
        text = text.replace(plain, f"{plain}  corner_radius: {corner} mm\n")
    normal = np.array([-np.sin(wall), 0.0, np.cos(wall)])  # from the sheet to tool 1
    edge_1, edge_2 = 2e-3 * normal, -(3e-3 + 0.8e-3) * normal
    tip_1 = edge_1 - [3e-3, 0.0, 2e-3]  # the flat ends 3 mm, or 2 mm, from the axis of the tool
    tip_2 = edge_2 + [2e-3, 0.0, 3e-3]
    one = np.zeros(1)
    contour = Contour(
        plan_id="plan",
        index=0,
        count=2,
        process=Process.DSIF,
        forming_tool=1,
        closed=True,
        contact=np.zeros((1, 3)),
        normal=normal[None],
        wall_angle=one + wall,
        thickness=one + 0.8e-3,
        forming_tip=tip_1[None],
        support_tip=tip_2[None],
        support_force=one + 120.0,
        feed=0.02,
    )
    return JobFile(text, EXAMPLES), contour


@pytest.mark.parametrize("degrees", [10.0, 45.0, 65.0])
def test_flat_tips_meet_a_wall_with_their_edges(degrees: float) -> None:
    wall = np.deg2rad(degrees)
    job_file, contour = flat_tips(wall)
    settings = IdentifySettings.of(Property.TOOL_COMPLIANCE, 1, 1, contour.forming_tip[0], 200.0)
    (place,) = places_for(settings, CONFIG, ToolGeometry.from_job(job_file), contour)
    assert place.normal == pytest.approx([np.sin(wall), 0.0, -np.cos(wall)])
    assert place.wall_angle == pytest.approx(wall)


@pytest.mark.parametrize("degrees", [10.0, 45.0, 65.0])
def test_where_the_support_tool_stays_under_the_blank_it_goes_to_the_wall(degrees: float) -> None:
    """Its tip of the contour is beside the part, 12 mm from the contact."""
    wall = np.deg2rad(degrees)
    job_file, contour = flat_tips(wall)
    text = job_file.text.replace("path:\n", "path:\n  support: on_blank\n")
    text = text.replace("support_force: 120 N", "support_force: 0 N")
    geometry = ToolGeometry.from_job(JobFile(text, EXAMPLES))
    stays = replace(contour, support_tip=np.array([[12e-3, 0.0, -1e-3]]), support_force=np.empty(0))
    settings = IdentifySettings.of(Property.TOOL_COMPLIANCE, 1, 1, contour.forming_tip[0], 200.0)
    (place,) = places_for(settings, CONFIG, geometry, stays)
    assert place.tip_2 == pytest.approx(contour.support_tip[0])
    assert place.normal == pytest.approx([np.sin(wall), 0.0, -np.cos(wall)])
    default = places_for(replace(settings, places=np.empty((0, 3))), CONFIG, geometry, stays)
    assert default[0].normal == pytest.approx(place.normal)


def test_flat_tips_over_each_other_touch_upright_and_need_their_whole_radius() -> None:
    geometry = ToolGeometry.from_job(flat_tips(0.5)[0])
    upright = geometry.between_balls(np.array([0.01, 0.0, 0.0]), np.array([0.012, 0.001, -1e-3]))
    assert upright == pytest.approx([0.0, 0.0, -6e-3])
    with pytest.raises(IsfError, match="a ball of radius 5 mm"):
        tips(geometry, 121e-3, 0.0, 0.0)


def test_the_compliance_at_a_wall_is_that_of_flat_tips() -> None:
    """Synthetic squeezes at walls of 45 and 65 deg: 2.0 um/N in x and 0.5 um/N in z, both tools and the contact."""
    compliance = np.array([2.0e-6, 0.0, 0.5e-6])
    readings = []
    for number, wall in enumerate(np.deg2rad([45.0, 65.0])):
        job_file, contour = flat_tips(wall)
        normal = -contour.normal[0]
        for force in (40.0, 80.0, 120.0, 160.0, 200.0, 240.0):
            push = force * normal  # on tool 2, whose way closes the gap
            tip_2 = contour.support_tip[0] - (normal @ (compliance * push)) * normal
            readings.append(Reading(number, 0, "squeeze", contour.forming_tip[0], tip_2, -push, push))
    fit = fit_compliance(readings, [], ToolGeometry.from_job(job_file))
    assert fit.total[[0, 2]] == pytest.approx([2.0e-6, 0.5e-6], rel=0.01)


def test_places_just_inside_are_taken() -> None:
    assert tips(replace(GEOMETRY, plate=OPENING), 17.9e-3, 0.0, 0.0)[0, 0] == 17.9e-3
    assert tips(GEOMETRY, 119e-3, 0.0, 0.0)[0, 0] == 119e-3
