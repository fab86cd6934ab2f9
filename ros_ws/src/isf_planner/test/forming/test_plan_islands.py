"""Islands on a plane floor formed from their other side (path.islands: swap): contacts, tools, order, refusals.

The part is F1 / F2 of Praveen 2020, 3.2.1.1: a pocket formed from above, and a cone on its base formed from below.
"""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st
from isf_core.contour import Contour
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile
from isf_core.types import Array
from isf_planner import Plan, plan, replan
from isf_planner.exports import load_plan, save_plan
from isf_planner.forming.sides import parts
from isf_planner.part.meshes import Mesh
from isf_planner.part_library import part_mesh
from isf_planner.part_library.catalogue import free_form, two_pockets
from isf_planner.part_library.part import Part
from planner_parts import grid_mesh, job_for, revolve, told, write

T0, R = 1e-3, 5e-3
UP = np.array([0.0, 0.0, 1.0])


def swap_job(path: Path, path_lines: str = "islands: swap", method: str = "analytic", **changes: str) -> JobFile:
    text = job_for(path, **({"depth": "2 mm", "limit": "80 deg", "force": "0 N"} | changes)).text
    text = text.replace("squeeze_factor", f"{path_lines}, squeeze_factor")
    return JobFile(f"{text}\nspringback: {{method: {method}}}", path.parent)


def planned(mesh: Mesh, folder: Path, path_lines: str = "islands: swap", **changes: str) -> Plan:
    return plan(swap_job(write(mesh, folder / "part.ply"), path_lines, **changes))


def check_exact(made: Plan, part: Part, normals: float = 0.2) -> None:
    """Contacts within 5 um, normals within 0.2 deg, gap as predicted, no tip of either tool in the finished sheet."""
    for contour in made.contours:
        side = 1.0 if contour.forming_tool == 1 else -1.0
        contact = contour.contact + (T0 * UP if side < 0 else 0.0)
        assert np.abs(part.distance(contact)).max() < 5e-6
        cosine = (side * contour.normal * part.normal(contact[:, :2])).sum(axis=1)
        assert np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))).max() < normals
        centres = contour.forming_tip + side * R * UP, contour.support_tip - side * R * UP
        np.testing.assert_allclose(np.linalg.norm(centres[0] - contour.contact, axis=1), R, atol=1e-9)
        gap = np.linalg.norm(centres[0] - centres[1], axis=1) - 2 * R
        np.testing.assert_allclose(gap, contour.thickness, atol=1e-9)
        assert closest(part, contour, centres[0], side) > R - 25e-6
        if contour.feature > 0:  # the support tool stands in what was formed before; 0.1 mm of pressing are allowed
            assert closest(part, contour, centres[1], -side) > R - 0.1e-3


def closest(part: Part, contour: Contour, centre: Array, side: float) -> float:
    """m, smallest distance of ball centres (N, 3) from the face of the finished sheet that lies on their side."""
    reach = np.arange(-1.2 * R, 1.21 * R, 0.4e-3)
    around = np.stack(np.meshgrid(reach, reach), axis=-1).reshape(-1, 2)
    least = np.inf
    for c in centre[:: max(1, len(centre) // 12)]:
        place = c[:2] + around
        z = part.height(place) - (T0 if side < 0 else 0.0)
        least = min(least, float(np.linalg.norm(np.column_stack([place, z]) - c, axis=1).min()))
    return least


@pytest.fixture(scope="module")
def swapped(tmp_path_factory: pytest.TempPathFactory) -> Plan:
    return planned(part_mesh(free_form(), 2e-6), tmp_path_factory.mktemp("swap"))


def test_the_second_feature_is_formed_from_below(swapped: Plan) -> None:
    """F1 before F2, to its floor at -15 mm; F2 from there to its top at -7 mm; lifted between them and nowhere else."""
    assert told(swapped) == ()
    tools = [contour.forming_tool for contour in swapped.contours]
    assert tools == [1] * 8 + [2] * 4
    assert [contour.retract for contour in swapped.contours] == [k == 8 for k in range(12)]
    level = [contour.forming_tip[0, 2] for contour in swapped.contours]
    np.testing.assert_allclose(level[:8], [-2e-3, -4e-3, -6e-3, -8e-3, -10e-3, -12e-3, -14e-3, -15e-3], atol=1e-9)
    np.testing.assert_allclose(level[8:], np.array([-13e-3, -11e-3, -9e-3, -7e-3]) - T0, atol=1e-9)
    assert swapped.tree is not None
    found = [(f.number, f.parent, f.island, f.forming_tool) for f in swapped.tree.features]
    assert found == [(0, -1, False, 1), (1, 0, False, 2)]
    for loop in swapped.tree.loops:
        assert loop.forming_tool == (1 if loop.feature == 0 else 2)
    assert swapped.tree.loops[-1].level == pytest.approx(-7e-3)
    for outer, inner in pairwise(swapped.contours[8:]):  # from the floor inwards and upwards
        assert np.ptp(inner.forming_tip[:, 0]) < np.ptp(outer.forming_tip[:, 0])


def test_contacts_lie_on_the_exact_surface_and_nothing_is_cut(swapped: Plan) -> None:
    check_exact(swapped, free_form())


def test_around_is_what_it_was(tmp_path: Path, swapped: Plan) -> None:
    """The default forms the island around from above; without islands the option changes nothing."""
    around = planned(part_mesh(free_form(), 2e-6), tmp_path, "islands: around")
    assert {contour.forming_tool for contour in around.contours} == {1}
    assert around.tree is not None
    assert [feature.island for feature in around.tree.features] == [False, True]
    np.testing.assert_array_equal(around.target.z, swapped.target.z)
    mesh = part_mesh(two_pockets(), 10e-6)
    for one, other in zip(
        planned(mesh, tmp_path, "islands: around").contours, planned(mesh, tmp_path).contours, strict=True
    ):
        np.testing.assert_array_equal(one.forming_tip, other.forming_tip)
        np.testing.assert_array_equal(one.support_tip, other.support_tip)


@settings(max_examples=4, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    scale=st.floats(0.8, 1.1),
    angle=st.floats(35.0, 55.0),
    depth=st.floats(8e-3, 15e-3),
    share=st.floats(0.55, 1.1),
)
def test_random_free_forms(tmp_path: Path, scale: float, angle: float, depth: float, share: float) -> None:
    """Exact, or refused because the support tool has no room between F2 and the wall of F1.

    Beyond a share of 1 the second feature rises above the blank.
    """
    try:
        part = free_form(scale, np.radians(angle), depth, share * depth)
        mesh = part_mesh(part, 2e-6)
    except ValueError:
        assume(False)
    made = planned_unless_without_room(mesh, tmp_path)
    if made is None:
        return
    assert {contour.forming_tool for contour in made.contours} == {1, 2}
    check_exact(made, part, normals=0.3)


def planned_unless_without_room(mesh: Mesh, folder: Path) -> Plan | None:
    """The plan; None for the only reason to refuse such a part: no room for the support tool of F2."""
    try:
        return planned(mesh, folder)
    except IsfError as error:
        if error.code is ErrorCode.PART_TOO_SMALL_FOR_TOOL and "support tool" in error.what:
            return None
        raise


def wave(*rings: tuple[float, float]) -> Mesh:
    """A round part: heights (m) of rings, the wall between two of them a cosine over 12 mm; outermost first at z = 0.

    ``rings``: radius (m) at which each level begins, from the outside, and its height.
    """
    profile = [[rings[0][0] + 20e-3, 0.0]]
    before = 0.0
    for radius, level in rings:
        share = np.linspace(0.0, 1.0, 60)
        profile += np.column_stack(
            [radius + 12e-3 * (1 - share), before + (level - before) * 0.5 * (1 - np.cos(np.pi * share))]
        ).tolist()
        before = level
    return revolve(np.array(profile), 360)


def test_a_hollow_in_the_island_is_formed_from_above_again(tmp_path: Path) -> None:
    """Three features in each other; the innermost goes deeper than the floor of the first."""
    made = planned(wave((60e-3, -6e-3), (35e-3, -1e-3), (8e-3, -7e-3)), tmp_path, depth="1 mm", spacing="1 mm")
    assert made.tree is not None
    found = [(f.parent, f.island, f.forming_tool) for f in made.tree.features]
    assert found == [(-1, False, 1), (0, False, 2), (1, False, 1)]
    ends = [made.contours[k].forming_tip[0, 2] for k in (5, 10, 16)]
    np.testing.assert_allclose(ends, [-6e-3, -1e-3 - T0, -7e-3], atol=3e-6)
    assert [contour.retract for contour in made.contours] == [k in (6, 11) for k in range(17)]
    assert made.tree.loops[made.tree.features[2].loops[0]].level == pytest.approx(-2e-3)


def test_a_crater_in_a_dome_and_a_rise_above_the_blank(tmp_path: Path) -> None:
    """Seen from below a crater is an island on the dome's top; it may reach below the flange, as F2 may above it."""
    crater = planned(wave((50e-3, 4e-3), (20e-3, -2e-3)), tmp_path, depth="1 mm", spacing="1 mm")
    assert [contour.forming_tool for contour in crater.contours] == [2] * 4 + [1] * 6
    np.testing.assert_allclose(
        [c.forming_tip[0, 2] for c in crater.contours][4:], 1e-3 * np.arange(3, -3, -1), atol=3e-6
    )
    rise = planned(wave((50e-3, -4e-3), (20e-3, 2e-3)), tmp_path, depth="1 mm", spacing="1 mm")
    assert [contour.forming_tool for contour in rise.contours] == [1] * 4 + [2] * 6
    assert rise.contours[-1].forming_tip[0, 2] == pytest.approx(2e-3 - T0, abs=3e-6)


def test_a_step_in_the_floor_is_the_pocket_itself(tmp_path: Path) -> None:
    mesh = wave((50e-3, -3e-3), (25e-3, -6e-3))
    assert [(part.forming_tool, part.base) for part in parts(mesh, swap_islands=True)] == [(1, 0.0)]
    made = planned(mesh, tmp_path, depth="1 mm", spacing="1 mm")
    assert {contour.forming_tool for contour in made.contours} == {1}


X = np.linspace(-0.08, 0.08, 161)
GX, GY = np.meshgrid(X, X)


def bowl_with_hill(slope: float) -> Mesh:
    """A bowl with a hill in the middle of its floor, the floor inclined by ``slope``."""
    share = np.clip((np.hypot(GX, GY) / 70e-3 - 0.6) / 0.4, 0, 1)
    inside = 0.5 + 0.5 * np.cos(np.pi * share)
    hill = 4e-3 * (0.5 + 0.5 * np.cos(np.pi * np.clip(np.hypot(GX, GY) / 15e-3, 0, 1)))
    return grid_mesh(X, X, (-8e-3 + slope * GX) * inside + hill)


def test_an_island_needs_a_plane_floor(tmp_path: Path) -> None:
    level = planned(bowl_with_hill(0.0), tmp_path, depth="1 mm", spacing="1 mm")
    assert [contour.forming_tool for contour in level.contours].count(2) == 4
    with pytest.raises(IsfError) as reported:
        planned(bowl_with_hill(0.02), tmp_path, depth="1 mm", spacing="1 mm")
    assert reported.value.code is ErrorCode.ISLAND_WITHOUT_FLOOR
    assert "x = " in reported.value.where
    assert "islands: around" in reported.value.advice


def test_a_support_tool_without_room_is_refused_with_the_place(tmp_path: Path) -> None:
    """Between F1's wall and F2 the floor is 4 mm wide: tools of 3 mm get there, an upper one of 16 mm does not."""
    small = swap_job(
        write(wave((51e-3, -6e-3), (35e-3, -2e-3)), tmp_path / "part.ply"), depth="1 mm", spacing="1 mm", radius="3 mm"
    )
    assert {contour.forming_tool for contour in plan(small).contours} == {1, 2}
    with pytest.raises(IsfError, match="no room for the support tool of radius 16") as reported:
        plan(JobFile(small.text.replace("tool_1: {radius: 3 mm}", "tool_1: {radius: 16 mm}"), tmp_path))
    assert reported.value.code is ErrorCode.PART_TOO_SMALL_FOR_TOOL
    assert "x = " in reported.value.where


def test_heights_reported_are_those_of_the_sheet(tmp_path: Path) -> None:
    """A fillet smaller than the tool on top of F2: the warning, found in the view from below, names the sheet's z."""
    reported = planned(
        wave((75e-3, -8e-3), (14e-3, -2e-3)), tmp_path, depth="1 mm", spacing="1 mm", radius="9 mm"
    ).warnings
    fillets = [text for text in reported if "smaller than the tool" in text]
    heights = [float(text.split("z = ")[1].split(" mm")[0]) for text in fillets]
    assert len(heights) == 2
    assert -8.0 <= heights[1] <= -2.0


def test_engagement_counts_from_the_floor(tmp_path: Path) -> None:
    """Force control begins ``engage_depth`` above the floor; without a correction the swap is warned of."""
    path = write(part_mesh(free_form(), 10e-6), tmp_path / "part.ply")
    job = swap_job(path, depth="1 mm", force="100 N", engage="3 mm", method="none")
    made = plan(job)
    assert any("springs off these heights" in text for text in made.warnings)
    first = next(c for c in made.contours if c.forming_tool == 2 and c.force_controlled)
    assert first.forming_tip[0, 2] == pytest.approx(-15e-3 + 3e-3 - T0)
    again = replan(made, JobFile(job.text.replace("tool_1: {radius: 5 mm}", "tool_1: {radius: 4 mm}"), tmp_path))
    for one, other in zip(made.contours, again.contours, strict=True):
        np.testing.assert_allclose(one.contact, other.contact, atol=1e-9)


def test_one_tool_or_stages_cannot_swap(tmp_path: Path) -> None:
    path = write(part_mesh(free_form(), 10e-6), tmp_path / "part.ply")
    with pytest.raises(IsfError) as reported:
        swap_job(path, process="SPIF")
    assert reported.value.code is ErrorCode.FILE_FIELD
    with pytest.raises(IsfError) as reported:
        plan(swap_job(path, "islands: swap, stages: [30 deg]"))
    assert reported.value.code is ErrorCode.FEATURES_MIXED


def test_spiral_and_plan_file(tmp_path: Path) -> None:
    path = write(part_mesh(free_form(), 10e-6), tmp_path / "part.ply")
    made = plan(swap_job(path, "islands: swap, style: spiral", depth="1 mm"))
    for one, following in pairwise(made.contours):
        assert np.array_equal(one.forming_tip[-1], following.forming_tip[0]) == (not following.retract)
    save_plan(made, tmp_path / "plan.npz")
    read = load_plan(tmp_path / "plan.npz")
    assert [c.forming_tool for c in read.contours] == [c.forming_tool for c in made.contours]
    np.testing.assert_allclose(read.contours[-1].support_tip, made.contours[-1].support_tip, atol=1e-9)
