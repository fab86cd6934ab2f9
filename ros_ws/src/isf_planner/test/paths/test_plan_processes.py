"""Roles of the tools, support on the blank, flat tips, ADSIF and TPIF, on parts whose geometry is known."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import trimesh
from ball_gap import tool_gap
from isf_core.contour import Contour, Process
from isf_core.errors import ErrorCode, IsfError
from isf_core.files import adsif_surface
from isf_core.files.job import JobFile, load_job
from isf_planner import Plan, plan
from isf_planner.checks import part_checks
from planner_parts import EXAMPLES, Cone, grid_mesh, job_for, told, write

R = 5e-3
T0 = 1e-3
CONE = Cone(opening=20e-3, depth=6e-3)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("parts")
    mesh = CONE.mesh()
    write(mesh, place / "cone.stl")
    write(Cone().mesh(20e-6), place / "deep.stl")
    write(type(mesh)(mesh.vertices * [1, 1, -1], mesh.faces), place / "dome.stl")
    return place


def planned(folder: Path, name: str, options: str = "", tool_1: str = "", tool_2: str = "", **changes: str) -> Plan:
    """Plan with further lines of the path section and of the tools."""
    job = job_for(folder / f"{name}.stl", **({"depth": "1 mm"} | changes))
    text = job.text.replace("squeeze_factor:", f"{options} squeeze_factor:")
    for tool, more in (("tool_1", tool_1), ("tool_2", tool_2)):
        text = text.replace(f"{tool}: {{radius: 5 mm}}", f"{tool}: {{{more or 'radius: 5 mm'}}}")
    return plan(JobFile(text, folder))


def refused(code: ErrorCode, *args: object, **changes: object) -> IsfError:
    with pytest.raises(IsfError) as caught:
        planned(*args, **changes)  # type: ignore[arg-type]
    assert caught.value.code is code
    assert caught.value.where
    assert caught.value.advice
    return caught.value


# roles of the tools


def test_a_dome_is_the_pocket_seen_from_below(folder: Path) -> None:
    """Praveen 2020, 3.2.1.1: forming tool 2 where the feature rises; everything mirrored, one blank's thickness
    lower."""
    down, up = planned(folder, "cone").contours, planned(folder, "dome").contours
    assert len(down) == len(up)
    flip = np.array([1.0, 1.0, -1.0])
    for one, other in zip(down, up, strict=True):
        assert (one.forming_tool, other.forming_tool) == (1, 2)
        np.testing.assert_allclose(other.forming_tip, one.forming_tip * flip - [0, 0, T0], atol=1e-9)
        np.testing.assert_allclose(other.support_tip, one.support_tip * flip - [0, 0, T0], atol=1e-9)
        np.testing.assert_allclose(other.normal, one.normal * flip, atol=1e-9)
        # the upper tool is the support now: its ball's centre lies above its tip
        gap = np.linalg.norm(other.support_tip + [0, 0, R] - (other.forming_tip - [0, 0, R]), axis=1) - 2 * R
        np.testing.assert_allclose(gap, other.thickness, atol=1e-9)
        assert other.force_controlled == one.force_controlled


def test_roles_swap_within_one_part() -> None:
    result = plan(load_job(EXAMPLES / "jobs" / "two_features.yaml"))
    assert told(result) == ()
    tools = [contour.forming_tool for contour in result.contours]
    assert tools == [1] * 8 + [2] * 8
    assert [contour.retract for contour in result.contours] == [k == 8 for k in range(16)]
    for contour in result.contours:
        side = -1.0 if contour.forming_tool == 1 else 1.0
        x = contour.forming_tip[:, 0]
        assert 0.5 * (x.min() + x.max()) == pytest.approx(side * 24e-3, abs=1e-3)  # the ramp begins further out
        assert (contour.contact[:, 2] * side > 0 - (T0 if side > 0 else 0)).all()
    for one, following in pairwise(result.contours):  # ramps also on the side of the lower tool
        assert np.array_equal(one.forming_tip[-1], following.forming_tip[0]) == (not following.retract)
    assert result.tree is not None
    assert [feature.forming_tool for feature in result.tree.features] == [1, 2]
    assert result.target.z.max() == pytest.approx(4e-3, abs=1e-6)
    assert result.target.z.min() == pytest.approx(-4e-3, abs=1e-6)


@pytest.mark.parametrize("shape", ["cone", "dome"])
def test_a_part_is_told_to_be_moved_as_it_was(shape: str, tmp_path: Path) -> None:
    """A dome is turned over to be planned: what was moved down was told to be moved up."""
    sign = 1.0 if shape == "cone" else -1.0
    mesh = CONE.mesh(50e-6)
    write(type(mesh)(mesh.vertices * [1, 1, sign] + [3e-3, -2e-3, 7e-3], mesh.faces), tmp_path / f"{shape}.stl")
    moved = [text for text in planned(tmp_path, shape, depth="2 mm").warnings if "was moved" in text]
    assert len(moved) == 1
    assert moved[0].startswith("the part was moved by (-3.000, 2.000, -7.000) mm")


def test_what_two_tools_form_is_told_to_be_moved_once(tmp_path: Path) -> None:
    x = np.arange(-60e-3, 60.5e-3, 1e-3)
    gx, gy = np.meshgrid(x, x)
    both = [np.clip(20e-3 - np.hypot(gx - side * 28e-3, gy), 0.0, 4e-3) for side in (-1.0, 1.0)]
    write(grid_mesh(x, x, both[1] - both[0] + 7e-3), tmp_path / "both.ply")
    job = job_for(tmp_path / "both.ply", depth="2 mm")
    moved = [text for text in plan(job).warnings if "was moved" in text]
    assert len(moved) == 1
    assert "(0.000, 0.000, -7.000) mm" in moved[0].replace("-0.000", "0.000")


def test_a_dome_needs_a_lower_tool(folder: Path) -> None:
    refused(ErrorCode.MESH_INVERTED, folder, "dome", process="SPIF")


# support tool


@pytest.mark.parametrize("direction", ["same", "alternating"])
def test_support_stays_under_the_blank(direction: str, folder: Path) -> None:
    """The first contour is formed with support opposite; all others keep the tool on that line."""
    options = "support: on_blank," + (" direction: alternating," if direction == "alternating" else "")
    contours = planned(folder, "cone", options, force="0 N").contours
    opposite = planned(folder, "cone").contours
    np.testing.assert_array_equal(contours[0].support_tip, opposite[0].support_tip)
    first = np.hypot(*contours[0].support_tip[:, :2].T)
    for contour in contours[1:]:
        np.testing.assert_allclose(np.hypot(*contour.support_tip[:, :2].T), first.mean(), atol=20e-6)
        np.testing.assert_allclose(contour.support_tip[:, 2], contours[0].support_tip[0, 2], atol=20e-6)
        assert not contour.force_controlled
        bearing = [np.arctan2(tip[:, 1], tip[:, 0]) for tip in (contour.forming_tip, contour.support_tip)]
        apart = np.angle(np.exp(1j * (bearing[0] - bearing[1])))
        assert np.abs(apart).max() < np.radians(0.2)  # at the same path parameter, straight outwards


@pytest.mark.parametrize("part", ["cone", "pyramid"])
def test_a_support_tool_under_the_blank_goes_along_evenly(part: str) -> None:
    """What it leaps by from point to point slows both tools: ten times, while it followed the chords of its line."""
    made = planned(EXAMPLES / "parts", f"ren_{part}", "support: on_blank,", force="0 N")
    for contour in made.contours[1:]:
        support, forming = (np.vstack([tip, tip[:2]]) for tip in (contour.support_tip, contour.forming_tip))
        step, way = (np.linalg.norm(np.diff(line, axis=0), axis=1) for line in (support, forming))
        assert np.abs(np.diff(step)).max() < 0.5 * np.median(way)
        assert step.min() > 0.3 * np.median(way)


def test_gap_follows_the_thickness_of_the_overlap_method(folder: Path) -> None:
    """Praveen 2020, 2.1: within 2 % of the sine law at 45 deg in the developed wall, thicker near the opening."""
    contours = planned(folder, "deep", "thickness: overlap,", depth="0.5 mm").contours
    for contour in contours:
        gap = tool_gap(contour.forming_tip, contour.support_tip, R, R)
        np.testing.assert_allclose(gap, contour.thickness, atol=1e-9)
        assert np.ptp(contour.thickness) < 0.04 * T0  # the method scatters by 2-3 % between neighbouring elements
    sine = [T0 * np.cos(contour.wall_angle.mean()) for contour in contours]
    formed = [contour.thickness.mean() for contour in contours]
    assert formed[17] == pytest.approx(sine[17], rel=0.03)
    assert formed[7] > 1.05 * sine[7]  # below the opening


def test_features_without_sections_keep_the_sine_law(folder: Path) -> None:
    """Two contours are no sequence of passes: the sine law is used, and told with the place."""
    result = planned(folder, "cone", "thickness: overlap,", depth="4 mm")
    assert len(result.contours) == 2
    (reported,) = [text for text in result.warnings if text.startswith("thickness overlap")]
    assert "at x = " in reported
    for contour in result.contours:
        np.testing.assert_allclose(contour.thickness, T0 * np.cos(contour.wall_angle), rtol=1e-12)


def test_support_too_large_for_the_curvature_is_reported(folder: Path) -> None:
    """A support ball of 20 mm under an entry fillet of 5 mm; the same on a dome, seen from below."""

    def reported(name: str, tool_1: float, tool_2: float, options: str = "") -> list[str]:
        radii = {"tool_1": f"radius: {tool_1:g} mm", "tool_2": f"radius: {tool_2:g} mm"}
        return list(told(planned(folder, name, options, force="0 N", **radii)))

    def pressing(texts: list[str]) -> float:
        (text,) = texts
        assert "the support tool of radius 20.00 mm" in text
        return float(text.split("presses ")[1].split(" mm")[0])

    assert reported("cone", 5, 5) == reported("dome", 5, 5) == []
    deep = pressing(reported("cone", 5, 20))
    assert deep > 1.0
    assert pressing(reported("dome", 20, 5)) == pytest.approx(deep, abs=0.02)
    on_blank = reported("cone", 5, 20, "support: on_blank,")
    assert "contour 1 at" in on_blank[0]  # the others stay on its line
    assert 0.1 < pressing(on_blank) < deep


def test_a_flat_support_that_stands_too_high_is_reported(folder: Path) -> None:
    """The check alone: in place nothing is told, 0.5 mm higher the ring of the flat presses into the wall."""
    flat = "radius: 8 mm, corner_radius: 5 mm"
    made = planned(folder, "cone", tool_2=flat, force="0 N")
    assert told(made) == ()
    assert made.base is not None
    up = tuple(replace(contour, support_tip=contour.support_tip + [0, 0, 0.5e-3]) for contour in made.contours)
    (reported,) = part_checks.check_support(up, made.base.sides, made.base.job)
    assert 0.3 <= float(reported.split("presses ")[1].split(" mm")[0]) <= 0.55


# flat tips


def test_flat_tip_runs_inside_the_ball_of_its_corner(folder: Path) -> None:
    """A flat of radius 8 mm with corners of 5 mm: its axis is 3 mm further in, the contacts are those of the ball."""
    ball = planned(folder, "cone", process="SPIF").contours
    flat = planned(folder, "cone", process="SPIF", tool_1="radius: 8 mm, corner_radius: 5 mm").contours
    for one, other in zip(ball, flat, strict=True):
        inside = np.hypot(*one.forming_tip[:, :2].T) - np.hypot(*other.forming_tip[:, :2].T)
        np.testing.assert_allclose(inside, 3e-3, atol=3e-6)
        np.testing.assert_allclose(other.contact, one.contact, atol=1e-9)
        np.testing.assert_array_equal(other.forming_tip[:, 2], one.forming_tip[:, 2])


def test_flat_tips_on_both_sides_keep_the_thickness_apart(folder: Path) -> None:
    shape = "radius: 6 mm, corner_radius: 4.5 mm"
    for contour in planned(folder, "cone", tool_1=shape, tool_2="radius: 7 mm, corner_radius: 5 mm").contours:
        out = contour.forming_tip[:, :2] / np.linalg.norm(contour.forming_tip[:, :2], axis=1, keepdims=True)
        out = np.column_stack([out, np.zeros(len(out))])
        corner_1 = contour.forming_tip + 1.5e-3 * out + [0, 0, 4.5e-3]
        corner_2 = contour.support_tip - 2e-3 * out - [0, 0, 5e-3]
        np.testing.assert_allclose(np.linalg.norm(corner_1 - corner_2, axis=1), 9.5e-3 + contour.thickness, atol=1e-6)


def test_flat_tips_that_do_not_fit_are_refused(folder: Path) -> None:
    """The tip circle at the bottom is 10.7 mm: a flat of 14 mm stands over. A corner of 9.5 mm leaves the fillet."""
    wide = "radius: 19 mm, corner_radius: 5 mm"
    error = refused(ErrorCode.PART_TOO_SMALL_FOR_TOOL, folder, "cone", process="SPIF", tool_1=wide)
    assert "flat of the tool" in error.what
    blunt = planned(folder, "cone", process="SPIF", tool_1="radius: 10 mm, corner_radius: 9.5 mm")
    assert any("smaller than the tool" in warning for warning in blunt.warnings)


# ADSIF


@pytest.fixture(scope="module")
def adsif() -> Plan:
    return plan(load_job(EXAMPLES / "jobs" / "adsif_cone.yaml"))


def line(contours: tuple[Contour, ...], name: str) -> np.ndarray:
    first, others = getattr(contours[0], name)[:1], [getattr(contour, name)[1:] for contour in contours]
    return np.concatenate([first, *others])


def test_adsif_is_a_planar_spiral_outwards(adsif: Plan) -> None:
    tip = line(adsif.contours, "forming_tip")
    assert (tip[:, 2] == -1.6e-3).all()
    assert all(contour.process is Process.ADSIF and not contour.closed for contour in adsif.contours)
    for one, following in pairwise(adsif.contours):
        np.testing.assert_array_equal(one.forming_tip[-1], following.forming_tip[0])
    radius = np.hypot(*tip[:, :2].T)
    assert (np.diff(radius) > -20e-6).all()
    bearing = np.unwrap(np.arctan2(tip[:, 1], tip[:, 0]))
    turns = (bearing - bearing[0]) / (2 * np.pi)
    # one pitch per turn between the first and the last turn, which stay on their loops
    inner, outer = np.interp([2, len(adsif.contours) - 2], turns, radius)
    assert (outer - inner) / (len(adsif.contours) - 4) == pytest.approx(0.2e-3, rel=0.02)


def angle_and_gap(
    forming_tip: np.ndarray, support_tip: np.ndarray, radii: tuple[float, float]
) -> tuple[np.ndarray, np.ndarray]:
    """Position angle (N,) rad and gap (N,) m of two balls from their tips (N, 3) m; forming tool above."""
    forming, support = radii
    line = support_tip - forming_tip - np.array([0.0, 0.0, forming + support])
    distance = np.linalg.norm(line, axis=1)
    return np.arccos(np.clip(-line[:, 2] / distance, -1.0, 1.0)), distance - forming - support


def test_adsif_places_the_tools_for_the_local_wall(adsif: Plan) -> None:
    """On the straight wall of 30 deg: the pair of the trade-off policy, and its gap less what the tools give way."""
    surface = adsif_surface.load_surface("AA5754-O_1mm_R5")
    contours = adsif.contours
    angle = line(contours, "wall_angle")
    theta, gap = angle_and_gap(line(contours, "forming_tip"), line(contours, "support_tip"), (R, R))
    wall = np.abs(np.degrees(angle) - 30.0) < 0.1
    assert wall.mean() > 0.15
    expected, ratio = np.zeros(len(angle)), np.ones(len(angle))
    expected[wall], ratio[wall] = adsif_surface.choose(surface, angle[wall], "trade_off")
    assert np.degrees(adsif_surface.angle_variation(surface, expected[wall])).max() <= 5.0 + 1e-9
    np.testing.assert_allclose(theta[wall], expected[wall], atol=1e-9)
    forces = adsif_surface.tool_forces(surface, theta, ratio)
    deflection = 1e-6 * (forces[0] + forces[1])  # both tools give way by 1 um/N (Ren 2018, 3.3.2)
    under_load = adsif_surface.opened_gap(gap, deflection, theta, R)
    formed = adsif_surface.stable_angle(surface, theta, under_load / T0)
    np.testing.assert_allclose(formed[wall], angle[wall], atol=np.radians(0.06))  # level sets are 0.05 deg apart


def test_adsif_reports_where_it_cannot_be_flat_enough_and_where_the_tools_are_soft(adsif: Plan) -> None:
    assert len(adsif.warnings) == 2
    assert "16.5 deg" in adsif.warnings[0]
    assert "0.7" in adsif.warnings[1]  # mm: 30 deg takes 738 N on both tools together, 1 um/N each
    assert "give way" in adsif.warnings[1]


def test_a_rig_too_soft_for_a_steep_wall_is_refused(tmp_path: Path) -> None:
    """35 deg takes 2.5 kN on both tools: they would have to overlap by 1 mm."""
    write(Cone(opening=24e-3, angle=np.radians(35), depth=6e-3, entry=2e-3).mesh(20e-6), tmp_path / "steep.stl")
    text = (EXAMPLES / "jobs" / "adsif_cone.yaml").read_text().replace("../parts/adsif_cone.stl", "steep.stl")
    with pytest.raises(IsfError) as caught:
        plan(JobFile(text, tmp_path))
    assert caught.value.code is ErrorCode.ADSIF_NOT_REACHABLE
    assert "too soft" in caught.value.what
    rigid = text.replace("  pitch:", "  compensate_compliance: false\n  pitch:")
    assert np.degrees(plan(JobFile(rigid, tmp_path)).largest_wall_angle) == pytest.approx(35.0, abs=0.3)


def test_walls_and_sheets_adsif_has_no_surface_for_are_refused(folder: Path) -> None:
    error = refused(ErrorCode.ADSIF_NOT_REACHABLE, folder, "cone", process="ADSIF", force="0 N")
    assert "45.0 deg" in error.what
    assert "37.3 deg at most" in error.what
    text = (EXAMPLES / "jobs" / "adsif_cone.yaml").read_text()
    for old, new in (("AA5754-O\n", "AA1100-O\n"), ("pitch: 0.2 mm", "pitch: 0.4 mm"), ("ness: 1.0", "ness: 0.8")):
        with pytest.raises(IsfError) as caught:
            plan(JobFile(text.replace(old, new, 1), EXAMPLES / "jobs"))
        assert caught.value.code is ErrorCode.ADSIF_SURFACE_MISMATCH


@pytest.mark.parametrize("policy", adsif_surface.POLICIES)
def test_placement_round_trip(policy: str) -> None:
    surface = adsif_surface.load_surface("AA5754-O_1mm_R5")
    theta, ratio = adsif_surface.choose(surface, np.radians(np.linspace(17, 37, 21)), policy)
    tip = np.random.default_rng(1).normal(size=(21, 3)) * 0.02
    bearing = np.linspace(0, 6, 21)
    away = np.column_stack([np.cos(bearing), np.sin(bearing), np.zeros(21)])
    support = adsif_surface.support_tip(tip, away, theta, ratio * T0, (R, 4e-3))
    back, gap = angle_and_gap(tip, support, (R, 4e-3))
    np.testing.assert_allclose(back, theta, atol=1e-9)
    np.testing.assert_allclose(gap, ratio * T0, atol=1e-12)


# TPIF


@pytest.fixture(scope="module")
def tpif() -> Plan:
    return plan(load_job(EXAMPLES / "jobs" / "tpif_cone.yaml"))


def test_tpif_follows_the_part_from_the_top_down(tpif: Plan) -> None:
    assert tpif.warnings == ()
    holders = [contour.holder_height for contour in tpif.contours]
    np.testing.assert_allclose(holders, -0.5e-3 * np.arange(1, 13), atol=1e-12)
    slope = np.tan(np.radians(40.0))
    for contour in tpif.contours:
        assert contour.process is Process.TPIF
        assert not contour.has_support
        np.testing.assert_allclose(contour.forming_tip[:, 2], 0.0, atol=1e-12)  # at the level of the blank holder
        radius = np.hypot(*contour.contact[:, :2].T)
        z = contour.contact[:, 2] + contour.holder_height + 6e-3  # over the flange of the finished part
        wall = np.abs(contour.wall_angle - np.radians(40.0)) < np.radians(0.3)
        np.testing.assert_allclose(radius[wall], 24e-3 - z[wall] / slope, atol=40e-6)  # the mesh errs by 10 um
    outward = [np.hypot(*contour.forming_tip[:, :2].T).mean() for contour in tpif.contours]
    assert (np.diff(outward) > 0).all()


def distance_to(triangles: np.ndarray, point: np.ndarray) -> float:
    closest = trimesh.triangles.closest_point(triangles, np.tile(point, (len(triangles), 1)))
    return float(np.linalg.norm(closest - point, axis=1).min())


def test_tpif_leaves_the_sheet_its_room_over_the_die(tpif: Plan) -> None:
    die = trimesh.load_mesh(EXAMPLES / "parts" / "tpif_cone_die.stl", process=False)
    for contour in tpif.contours[:6]:  # over the partial die
        centre = contour.forming_tip[::40] + [0, 0, contour.holder_height + R]
        distance = np.array([distance_to(die.triangles, point * 1e3) * 1e-3 for point in centre])
        # under the sine law the sheet is t0 cos(phi) thick along the normal; 20 um for the facets of part and die
        np.testing.assert_allclose(distance - R, contour.thickness[::40], atol=25e-6)


def test_tpif_spiral() -> None:
    job = load_job(EXAMPLES / "jobs" / "tpif_cone.yaml")
    contours = plan(JobFile(job.text.replace("  feed:", "  style: spiral\n  feed:"), job.base)).contours
    assert len(contours) == 13
    for one, following in pairwise(contours):
        height = [contour.forming_tip + [0, 0, contour.holder_height] for contour in (one, following)]
        np.testing.assert_allclose(height[0][-1], height[1][0], atol=1e-12)  # in the frame of the die
    assert contours[-1].holder_height == pytest.approx(-6e-3)


def test_a_die_in_the_way_is_refused(tmp_path: Path) -> None:
    parts = EXAMPLES / "parts"
    text = (
        (EXAMPLES / "jobs" / "tpif_cone.yaml")
        .read_text()
        .replace("../parts/tpif_cone.stl", str(parts / "tpif_cone.stl"))
    )
    die = trimesh.load_mesh(parts / "tpif_cone_die.stl", process=False)
    for shift, reported in (([0, 0, 0.4], "into the finished sheet"), ([2.0, 0, 0], "into the finished sheet")):
        die.copy().apply_translation(shift).export(tmp_path / "die.stl")
        with pytest.raises(IsfError) as caught:
            plan(JobFile(text.replace("../parts/tpif_cone_die.stl", "die.stl"), tmp_path))
        assert caught.value.code is ErrorCode.DIE_COLLISION
        assert reported in caught.value.what
        assert "die at x" in caught.value.where


def test_a_pocket_is_no_part_for_a_die(folder: Path) -> None:
    text = (EXAMPLES / "jobs" / "tpif_cone.yaml").read_text()
    text = text.replace("../parts/tpif_cone.stl", str(folder / "cone.stl"))
    with pytest.raises(IsfError) as caught:
        plan(JobFile(text, EXAMPLES / "jobs"))
    assert caught.value.code is ErrorCode.MESH_INVERTED
