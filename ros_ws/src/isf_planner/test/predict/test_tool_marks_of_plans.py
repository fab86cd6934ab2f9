"""Tool marks along planned contours: published spacings, exact cones, fillets, floors, spirals, and the wanted step."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from isf_core.contour import Contour
from isf_core.files.job import Job, JobFile, load_job
from isf_planner import plan
from isf_planner.predict.tool_marks import step_for, surface_of, tool_marks
from planner_contours import circle
from planner_parts import EXAMPLES, Cone, job_for, write

MM = 1e-3


def job(radius: str = "5 mm", process: str = "SPIF") -> Job:
    text = f"""
name: part
part: {{mesh: part.stl, unit: mm}}
process: {process}
rig: ren2018
sheet: {{material: AA5754-O, thickness: 1 mm}}
tool_1: {{radius: {radius}}}
tool_2: {{radius: 5 mm}}
path: {{incremental_depth: 0.5 mm, feed: 30 mm/s}}
"""
    return JobFile(text, Path()).job


def cone(angle: float, step: float, count: int = 4, radius: float = 60 * MM) -> list[Contour]:
    """Contours of a plane cone wall of ``angle`` deg, ``step`` m apart in depth."""
    a = np.radians(angle)
    return [
        replace(
            circle(radius=radius - k * step / np.tan(a), z=-2 * MM - k * step, angle=a, count=720),
            index=k,
            count=count,
        )
        for k in range(count)
    ]


@pytest.mark.parametrize(("step", "spacing", "measured"), [(0.6, 0.783, 0.751), (1.1, 1.436, 1.406)])
def test_spacing_of_the_published_cone(step: float, spacing: float, measured: float) -> None:
    """50 deg, tool of 30 mm (Lu 2016, 4.1.2)."""
    contours = cone(50, step * MM)
    found = surface_of(contours, tool_marks(contours, job("15 mm")))
    assert found is not None
    assert found.spacing / MM == pytest.approx(spacing, abs=0.001)
    assert measured < found.spacing / MM < measured / 0.958
    assert found.usual_spacing == pytest.approx(found.spacing, rel=1e-3)


@pytest.mark.parametrize(
    ("angle", "ridge"), [(15, 0.094), (25, 0.035), (30, 0.025), (45, 0.0125), (60, 0.0083), (80, 0.0064)]
)
def test_ridges_at_a_step_of_half_a_millimetre(angle: float, ridge: float) -> None:
    """Tool of 10 mm (Behera 2015, sequencing)."""
    contours = cone(angle, 0.5 * MM)
    found = surface_of(contours, tool_marks(contours, job()))
    assert found is not None
    assert found.ridge / MM == pytest.approx(ridge, rel=0.03)


@settings(max_examples=30, deadline=None)
@given(st.floats(20.0, 85.0), st.floats(0.05, 1.0), st.floats(1e-3, 0.03))
def test_the_step_for_a_wanted_ridge_leaves_it(angle: float, step: float, wanted: float) -> None:
    contours = cone(angle, step * MM)
    found = surface_of(contours, tool_marks(contours, job()))
    assert found is not None
    finer = cone(angle, step_for(found, 5 * MM, ridge=wanted * MM))
    then = surface_of(finer, tool_marks(finer, job()))
    assert then is not None
    assert then.ridge / MM == pytest.approx(wanted, rel=0.01)


def test_of_two_wishes_the_finer_step_is_told() -> None:
    contours = cone(45, 0.5 * MM)
    found = surface_of(contours, tool_marks(contours, job()))
    assert found is not None
    spaced = step_for(found, 5 * MM, spacing=1.0 * MM)
    assert spaced / MM == pytest.approx(np.sin(np.radians(45.0)), rel=1e-3)
    ridged = step_for(found, 5 * MM, ridge=5e-3 * MM)
    assert step_for(found, 5 * MM, ridge=5e-3 * MM, spacing=1.0 * MM) == min(spaced, ridged) == ridged


@pytest.fixture(scope="module")
def planned(tmp_path_factory: pytest.TempPathFactory) -> JobFile:
    path = write(Cone().mesh(5e-6), tmp_path_factory.mktemp("cone") / "cone.ply")
    return job_for(path, process="SPIF", force="0 N")


def test_fillets_and_floor_of_a_planned_cone(planned: JobFile) -> None:
    """Where the surface curves towards the tool, its contacts lie farther apart than its centres, as the floor's fillet
    of 8 mm makes of a ball of 5 mm 8 : 3; ridges follow from both. Flat entry and floor stay finite."""
    text = planned.text.replace("floor_step: none", "floor_step: 2 mm").replace("depth: 0.5 mm", "depth: 0.1 mm")
    made = plan(JobFile(text, planned.base))
    marks = tool_marks(made.contours, planned.job)
    found = surface_of(made.contours, marks)
    assert found is not None
    assert marks[0] is None
    on_wall = [k for k, one in enumerate(made.contours) if np.abs(one.wall_angle - np.radians(45)).max() < 1e-3]
    for k in on_wall[1:]:
        mark = marks[k]
        assert mark is not None
        np.testing.assert_allclose(mark.step, 0.1 * MM, rtol=0.02)
        np.testing.assert_allclose(mark.spacing, mark.step / np.sin(np.radians(45)), atol=5e-6)  # of facets
    lowest = max(k for k, one in enumerate(made.contours) if one.wall_angle.min() > np.radians(5))
    mark = marks[lowest]
    assert mark is not None
    assert np.median(mark.spacing / mark.pitch) == pytest.approx(np.sqrt(8.0 / 3.0), rel=0.05)
    assert found.floor_spacing == pytest.approx(2 * MM, rel=0.2)
    assert found.floor_ridge == pytest.approx(0.1 * MM, rel=0.4)  # 2^2 / 8 / 5 mm
    assert found.usual_ridge <= found.ridge < 5 * MM


def test_a_spiral_has_the_marks_of_contours(planned: JobFile) -> None:
    """On the plane wall; where one turn passes into the next nothing is told."""
    spiral = JobFile(planned.text.replace("path: {", "path: {style: spiral, "), planned.base)
    made = plan(spiral)
    marks = tool_marks(made.contours, spiral.job)
    on_wall = [k for k, one in enumerate(made.contours) if np.abs(one.wall_angle - np.radians(45)).max() < 1e-3]
    assert len(on_wall) > 5
    for k in on_wall[1:]:
        mark = marks[k]
        assert mark is not None
        known = np.isfinite(mark.spacing)
        assert 0.97 < known.mean() < 1.0
        np.testing.assert_allclose(mark.spacing[known], 0.5 * MM / np.sin(np.radians(45)), rtol=0.03)
    found = surface_of(made.contours, marks)
    assert found is not None
    assert np.sqrt(2.0) < found.per_step < 2.0


def test_constant_scallop_height_is_what_was_asked_for(planned: JobFile) -> None:
    text = planned.text.replace("path: {", "path: {spacing: scallop, scallop_height: 0.01 mm, smallest_step: 0.05 mm, ")
    asked = JobFile(text, planned.base)
    made = plan(asked)
    found = surface_of(made.contours, tool_marks(made.contours, asked.job))
    assert found is not None
    assert found.usual_ridge / MM == pytest.approx(0.010, rel=0.1)


def test_a_part_over_a_die_sinks_with_its_holder() -> None:
    """Contours at one height while the sheet goes down: 45 deg, 0.5 mm a contour."""
    contours = [
        replace(
            one,
            forming_tip=one.forming_tip + [0, 0, 0.5 * MM * k],
            contact=one.contact + [0, 0, 0.5 * MM * k],
            holder_height=-0.5 * MM * k,
        )
        for k, one in enumerate(cone(45, 0.5 * MM))
    ]
    found = surface_of(contours, tool_marks(contours, job()))
    assert found is not None
    assert found.spacing / MM == pytest.approx(0.7071, abs=0.001)


def test_marks_are_those_of_the_last_stage() -> None:
    contours = [*cone(45, 1.0 * MM), *[replace(one, stage=1) for one in cone(60, 0.5 * MM)]]
    marks = tool_marks(contours, job())
    found = surface_of(contours, marks)
    assert found is not None
    assert found.spacing / MM == pytest.approx(0.5774, abs=0.001)
    assert found.contour >= 4
    assert marks[4] is None


def test_nothing_is_told_where_no_pass_lies_beside_another() -> None:
    single = cone(45, 0.5 * MM, count=1)
    assert surface_of(single, tool_marks(single, job())) is None
    adsif = load_job(EXAMPLES / "jobs" / "adsif_cone.yaml").job
    assert tool_marks(cone(45, 0.5 * MM), adsif) == (None,) * 4
