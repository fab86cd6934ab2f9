"""URDF of every rig and of jobs, read by another reader: frames, legs, limits, masses; surfaces of scans."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import load_job
from isf_core.files.rig import Rig, load_rig
from isf_core.geometry.hexapod import rotation
from isf_description.cell import HOLDER, describe, tip_frame
from isf_description.joints import tool_positions
from isf_description.surface import height_colours, surface
from isf_description.tree import Body, Description, Link
from isf_description.urdf import STEEL, mass_properties, to_urdf
from scipy.spatial.transform import Rotation
from urdf_reading import Urdf, numbers

ROOT = Path(__file__).resolve().parents[4]
RIGS = ("behera2015", "lu2016", "praveen2020", "ren2018", "torrao2013")
ARMS = (("kr210_arm", 1), ("kr210_pair", 1), ("kr210_pair", 2))
UPRIGHT = (0.0, 0.0, 0.0, 1.0)


def read(rig: Rig) -> Urdf:
    return Urdf(to_urdf(describe(rig)))


def of_job(name: str) -> Urdf:
    job_file = load_job(ROOT / "examples" / "jobs" / f"{name}.yaml")
    return Urdf(to_urdf(describe(job_file.rig, job_file)))


@pytest.mark.parametrize("name", RIGS)
def test_every_rig_has_its_frames_and_the_limits_of_its_file(name: str) -> None:
    rig = load_rig(name)
    urdf = read(rig)
    assert urdf.root == "base"
    assert {"table", "clamp", "sheet", "tool_1", "tool_2", "tool_1_cell", "tool_2_cell"} <= set(urdf.links)
    np.testing.assert_allclose(urdf.transform("clamp", "sheet", {})[:3, 3], [0.0, 0.0, 1e-3])
    assert urdf.transform("table", "sheet", {})[2, 3] > 0.3  # both tools have room above the table
    for k in (1, 2):
        for axis, travel in zip("xyz", rig.limits.travel, strict=True):
            assert urdf.limits(f"tool_{k}_{axis}") == pytest.approx((-travel, travel))
    for joint in urdf.joints.values():
        if joint.attrib["type"] == "fixed":
            continue
        limit = joint.find("limit")
        assert limit is not None
        assert float(limit.attrib["effort"]) > 0.0
        assert float(limit.attrib["velocity"]) > 0.0


def test_root_has_no_mass_and_what_moves_has_one() -> None:
    """KDL, and with it robot_state_publisher, warns of an inertia of the root; simulators refuse to move nothing."""
    for name in (*RIGS, "kr210_arm", "kr210_pair"):
        urdf = read(load_rig(name))
        assert urdf.links["base"].find("inertial") is None
        for joint in urdf.joints.values():
            child = urdf.links[joint.find("child").attrib["link"]]  # type: ignore[union-attr]
            inertial = child.find("inertial")
            if joint.attrib["type"] != "fixed" or child.find("visual") is not None:
                assert inertial is not None, child.attrib["name"]
                values = {key: float(text) for key, text in inertial.find("inertia").attrib.items()}  # type: ignore[union-attr]
                matrix = np.array([[values["i" + min(a, b) + max(a, b)] for b in "xyz"] for a in "xyz"])
                first, second, third = np.linalg.eigvalsh(matrix)
                assert 0.0 < first <= second <= third < 1.0001 * (first + second)  # else it is of no body


@pytest.mark.parametrize(("name", "k"), ARMS)
@pytest.mark.parametrize("tilt", [(0.0, 0.0), (0.3, -0.2)])
def test_an_arm_of_the_urdf_ends_in_the_tip_that_its_joints_make(name: str, k: int, tilt: tuple[float, float]) -> None:
    """Joint states put into the URDF by another reader: tip and axes of the tool are those of the pose."""
    rig = load_rig(name)
    urdf = read(rig)
    turned = Rotation.from_matrix(rotation(np.array(tilt)))
    quaternion = tuple(turned.as_quat().tolist())
    positions = tool_positions(rig, k, 0.0)((0.06, -0.08, 0.03), quaternion)  # type: ignore[arg-type]
    found = urdf.transform("sheet", f"tool_{k}", positions)
    np.testing.assert_allclose(found[:3, 3], [0.06, -0.08, 0.03], atol=1e-6)
    np.testing.assert_allclose(found[:3, :3], turned.as_matrix(), atol=1e-7)
    assert urdf.limits(f"tool_{k}_A2") == pytest.approx((math.radians(-140), math.radians(-5)))
    assert float(urdf.joints[f"tool_{k}_A6"].find("limit").attrib["velocity"]) == pytest.approx(math.radians(219))  # type: ignore[union-attr]
    assert list(positions) == [f"tool_{k}_A{n}" for n in range(1, 7)]


def test_an_arm_says_what_it_cannot_show() -> None:
    reach = tool_positions(load_rig("kr210_arm"), 1, 5e-3)
    with pytest.raises(IsfError) as caught:
        reach((5.0, 0.0, 0.0), UPRIGHT)
    assert caught.value.code is ErrorCode.TARGET_OUT_OF_WORKSPACE
    with pytest.raises(IsfError) as caught:
        reach((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0))
    assert caught.value.code is ErrorCode.TARGET_NOT_FINITE


@settings(max_examples=25)
@given(tip=st.tuples(*[st.floats(-0.1, 0.1)] * 3), k=st.sampled_from([1, 2]), name=st.sampled_from(RIGS))
def test_the_tip_of_the_urdf_is_the_pose(tip: tuple[float, float, float], k: int, name: str) -> None:
    rig = load_rig(name)
    found = read(rig).transform("sheet", f"tool_{k}", tool_positions(rig, k, 5e-3)(tip, UPRIGHT))
    np.testing.assert_allclose(found[:3, 3], tip, atol=1e-9)
    np.testing.assert_allclose(found[:3, :3], np.eye(3), atol=1e-12)


HEXAPOD = read(load_rig("torrao2013"))


@settings(max_examples=15)
@given(tip=st.tuples(*[st.floats(-0.1, 0.1)] * 3), tilt=st.tuples(*[st.floats(-0.5, 0.5)] * 2))
def test_legs_of_the_hexapod_end_at_the_platform(tip: tuple[float, float, float], tilt: tuple[float, float]) -> None:
    machine = load_rig("torrao2013").hexapod.kinematics()
    turn = rotation(np.array(tilt))
    x, y, z, w = Rotation.from_matrix(turn).as_quat().tolist()
    positions = tool_positions(load_rig("torrao2013"), 1, 5e-3)(tip, (x, y, z, w))
    placed = HEXAPOD.transform("sheet", "tool_1", positions)
    end = np.array(tip) + 5e-3 * (np.array([0.0, 0.0, 1.0]) - turn[:, 2])  # where the axis leaves the ball
    np.testing.assert_allclose(placed[:3, 3], end, atol=1e-9)
    np.testing.assert_allclose(placed[:3, :3], turn, atol=1e-9)
    centre = (placed @ [0.0, 0.0, 5e-3, 1.0])[:3]
    np.testing.assert_allclose(centre, np.array(tip) + [0.0, 0.0, 5e-3], atol=1e-9)  # the tip is its lowest point
    platform = HEXAPOD.transform("hexapod_base", "hexapod_platform", positions)
    upright = HEXAPOD.transform("sheet", tip_frame(load_rig("torrao2013"), 1), positions)
    np.testing.assert_allclose(
        upright, [[1, 0, 0, tip[0]], [0, 1, 0, tip[1]], [0, 0, 1, tip[2]], [0, 0, 0, 1]], atol=1e-9
    )
    strokes = machine.strokes(end, np.array(tilt))
    for n in range(6):
        rod = HEXAPOD.transform("hexapod_base", f"leg_{n + 1}_rod", positions)
        np.testing.assert_allclose(rod[:3, 3], (platform @ [*machine.platform[n], 0.0, 1.0])[:3], atol=1e-9)
        assert positions[f"leg_{n + 1}_stroke"] == pytest.approx(strokes[n], abs=1e-12)


def test_load_cells_stand_where_the_rig_says() -> None:
    rig = load_rig("torrao2013")
    np.testing.assert_allclose(HEXAPOD.transform("tool_1", "tool_1_cell", {})[:3, 3], [0.0, 0.0, 0.28])
    places = [HEXAPOD.transform("tool_1", f"tool_1_cell_{n}", {})[:3, 3] for n in (1, 2, 3)]
    np.testing.assert_allclose(places[0], [0.11, 0.0, 0.28], atol=1e-12)
    assert rig.tool_1.spindle_cells is not None
    np.testing.assert_allclose(np.linalg.norm(places[1] - places[2]), 0.11 * math.sqrt(3.0))


def test_a_job_gives_tools_blank_and_die() -> None:
    spif, tpif, dsif = of_job("spif_cone"), of_job("tpif_cone"), of_job("ren_cone")
    assert "tool_2" not in spif.links
    assert "tool_2" in dsif.links
    sphere = dsif.links["tool_1"].find("visual/geometry/sphere")
    assert sphere is not None
    assert float(sphere.attrib["radius"]) == 5e-3
    lower = dsif.links["tool_2"].find("visual/geometry/sphere/../../origin")
    assert lower is not None
    np.testing.assert_allclose(numbers(lower.attrib["xyz"]), [0.0, 0.0, -5e-3])  # the tip is the highest point
    mesh = tpif.links["die"].find("visual/geometry/mesh")
    assert mesh is not None
    assert Path(mesh.attrib["filename"].removeprefix("file://")).is_file()
    assert mesh.attrib["scale"] == "0.001 0.001 0.001"
    down = {HOLDER: -0.01}  # the sheet comes down; the die stays, so that it has risen in frame sheet
    np.testing.assert_allclose(tpif.transform("sheet", "die", {})[:3, 3], np.zeros(3), atol=1e-12)
    np.testing.assert_allclose(tpif.transform("sheet", "die", down)[:3, 3], [0.0, 0.0, 0.01], atol=1e-12)


def test_two_cells_go_into_one_file() -> None:
    description = describe(load_rig("ren2018")).prefixed("left_")
    urdf = Urdf(to_urdf(description))
    assert urdf.root == "left_base"
    assert all(name.startswith("left_") for name in (*urdf.links, *urdf.joints))
    assert urdf.robot.find("material") is None  # of the whole file, which has to be unique


def test_masses_by_hand() -> None:
    """A rod of 2 m along z, 0.1 m beside the axis, and a ball: parallel axes as in a textbook."""
    rod = Body("cylinder", (0.01, 2.0), "tool", (0.1, 0.0, 0.0))
    mass, centre, inertia = mass_properties([rod])
    own = math.pi * 1e-4 * 2.0 * STEEL
    assert mass == pytest.approx(own)
    np.testing.assert_allclose(centre, [0.1, 0.0, 0.0])
    assert inertia[0, 0] == pytest.approx(own * (4.0 / 12.0 + 1e-4 / 4.0))
    both, _, about = mass_properties([rod, Body("cylinder", (0.01, 2.0), "tool", (-0.1, 0.0, 0.0))])
    assert both == pytest.approx(2.0 * own)
    assert about[2, 2] == pytest.approx(2.0 * (own * 0.5e-4 + own * 0.01))
    assert mass_properties([Body("mesh", (1.0, 1.0, 1.0), "die", file="die.stl")])[0] == 0.0


@pytest.mark.parametrize(
    ("name", "tip", "turn"),
    [
        ("ren2018", (math.nan, 0.0, 0.0), UPRIGHT),
        ("torrao2013", (0.0, math.inf, 0.0), UPRIGHT),
        ("torrao2013", (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0)),
    ],
)
def test_what_is_no_pose_is_refused(
    name: str, tip: tuple[float, float, float], turn: tuple[float, float, float, float]
) -> None:
    with pytest.raises(IsfError) as caught:
        tool_positions(load_rig(name), 1, 5e-3)(tip, turn)
    assert caught.value.code == ErrorCode.TARGET_NOT_FINITE


def areas(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """m^2 of the triangles in plan view; positive where they turn to the left, seen from above."""
    corners = vertices[triangles]
    across, along = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    return np.asarray(0.5 * (across[:, 0] * along[:, 1] - across[:, 1] * along[:, 0]))


def test_a_scan_becomes_a_surface_with_its_holes() -> None:
    axis = np.linspace(-0.1, 0.1, 101)
    x, y = (a.ravel() for a in np.meshgrid(axis, axis))
    points = np.stack([x, y, 0.1 * x - 0.2 * y], axis=1)
    hidden = np.hypot(x - 0.05, y) < 0.02
    points[hidden, 2] = np.nan
    vertices, triangles = surface(points, 50)
    np.testing.assert_allclose(vertices[:, 2], 0.1 * vertices[:, 0] - 0.2 * vertices[:, 1], atol=1e-12)
    area = areas(vertices, triangles)
    assert (area > 0.0).all()
    assert area.sum() == pytest.approx(0.2**2 - math.pi * 0.02**2, rel=0.02)
    assert len(vertices) <= 52**2
    for few in (points[:3], np.full((9, 3), np.nan), np.empty((0, 3))):
        assert len(surface(few, 50)[1]) == 0


def test_a_small_part_on_a_large_sheet_is_shown_finely_and_the_rim_coarsely() -> None:
    axis = np.linspace(-0.125, 0.125, 251)
    x, y = (a.ravel() for a in np.meshgrid(axis, axis))
    points = np.stack([x, y, -0.5 * np.clip(0.02 - np.hypot(x, y), 0.0, 0.01)], axis=1)
    vertices, triangles = surface(points, 50)
    assert areas(vertices, triangles).sum() == pytest.approx(0.25**2, rel=1e-9)  # all of the sheet
    inside = np.hypot(vertices[:, 0], vertices[:, 1]) < 0.02
    assert inside.sum() > 0.4 * (math.pi * 0.02**2) / 1e-6  # about a vertex per mm^2, as it is scanned
    assert len(vertices) < 3500
    noisy = points[np.random.default_rng(1).permutation(len(points))[::3]]  # a scanner's cloud: no grid, no order
    assert areas(*surface(noisy, 50)).sum() > 0.8 * 0.25**2


def test_the_deepest_place_has_the_end_of_the_scale_and_a_flat_sheet_its_beginning() -> None:
    colours = height_colours(np.array([0.0, -0.02]))
    np.testing.assert_allclose(colours, [[0.99, 0.91, 0.14], [0.27, 0.0, 0.33]])
    assert height_colours(np.full(4, -1e-6)) == pytest.approx(np.tile([0.99, 0.91, 0.14], (4, 1)), abs=0.01)


@pytest.mark.parametrize("nothing_seen", [1e6, 1e300, math.inf, math.nan])
def test_what_a_scanner_writes_where_it_sees_nothing_does_not_change_the_surface(nothing_seen: float) -> None:
    axis = np.linspace(-0.1, 0.1, 61)
    x, y = np.meshgrid(axis, axis)
    points = np.stack([x, y, np.where(np.hypot(x, y) < 0.05, -0.02, 0.0)], axis=-1).reshape(-1, 3)
    vertices, triangles = surface(points, 50)
    for bad in (np.full(3, nothing_seen), np.array([0.0, 0.0, nothing_seen])):
        found, drawn = surface(np.vstack([points, bad]), 50)
        np.testing.assert_allclose(found, vertices, atol=1e-12)
        assert len(drawn) == len(triangles)


def test_a_load_cell_close_to_the_tip_leaves_no_body_of_negative_length() -> None:
    rig = load_rig("ren2018")
    near = rig.model_copy(update={"load_cell": rig.load_cell.model_copy(update={"tip_distance": 5e-3})})
    lengths = [float(body.get("length", 0.0)) for body in read(near).robot.iter("cylinder")]
    assert lengths
    assert min(lengths) > 0.0


def test_the_mesh_of_a_die_is_an_url_that_viewers_can_open() -> None:
    body = Body("mesh", (1e-3, 1e-3, 1e-3), "die", file="/parts of today/die 50%.stl")
    text = to_urdf(Description("cell", (Link("die", (body,)),), ()))
    assert 'filename="file:///parts%20of%20today/die%2050%25.stl"' in text
