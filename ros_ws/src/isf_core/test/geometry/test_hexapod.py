"""The hexapod against its source's plates, numbers derived from them by another implementation, and plain mechanics."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from isf_core.errors import ErrorCode, IsfError
from isf_core.geometry.hexapod import CableSensors, rotation, spif_a
from isf_core.types import Array
from scipy.spatial.transform import Rotation

HEXAPOD = spif_a()
NORMALS = spif_a(along_normals=True)
HOME = np.array([0.0, 0.0, -1.1172872])

DERIVED = {
    (0, 0, -911.8830, 0, 0, 0): [942.0] * 6,
    (0, 0, -1117.2872, 0, 0, 0): [1142.0] * 6,
    (0, 0, -1321.0339, 0, 0, 0): [1342.0] * 6,
    (0, 0, -1000, 0, 0, 0): [1027.5375] * 6,
    (100, 0, -1100, 0, 0, 0): [1149.7919, 1149.7919, 1115.3829, 1123.1205, 1123.1205, 1115.3829],
    (0, 100, -1100, 0, 0, 0): [1125.0926, 1133.9459, 1113.9270, 1109.4293, 1149.2751, 1144.9163],
    (200, -150, -1100, 0, 0, 0): [1198.2109, 1185.6262, 1147.7477, 1169.1731, 1109.9396, 1101.0562],
    (500, 0, -1000, 0, 0, 0): [1239.6667, 1239.6667, 1071.0098, 1110.7045, 1110.7045, 1071.0098],
    (0, 500, -1000, 0, 0, 0): [1120.6397, 1164.4026, 1063.4065, 1039.6313, 1237.2685, 1216.8950],
    (0, 0, -1100, 10, 0, 0): [1150.4751, 1099.5386, 1087.4797, 1112.5938, 1138.0549, 1163.8401],
    (0, 0, -1100, 0, 10, 0): [1096.2625, 1096.2625, 1117.6490, 1162.0858, 1162.0858, 1117.6490],
    (0, 0, -1100, 0, 0, 10): [1132.8965, 1119.5435, 1132.8965, 1119.5435, 1132.8965, 1119.5435],
    (50, -30, -1150, 5, -8, 0): [1223.2373, 1194.7890, 1160.4272, 1142.5645, 1143.3840, 1189.1602],
    (50, -30, -1150, 15, -20, 0): [1284.6204, 1205.3742, 1137.2849, 1089.4206, 1112.2499, 1232.0730],
    (0, 0, -1100, 30, 0, 0): [1197.8533, 1051.1197, 1021.0038, 1090.5788, 1163.7707, 1239.9390],
    (0, 0, -1100, 0, 30, 0): [1045.9752, 1045.9752, 1103.1148, 1233.1817, 1233.1817, 1103.1148],
}
"""mm and deg to mm: derived from the plates of Torrao 2013, 4.2, by another implementation; none is printed there."""

BASE = np.array([(-404.145, -100), (-404.145, 100), (115.470, 400), (288.675, 300), (288.675, -300), (115.470, -400)])
PLATFORM = np.array([(-173.205, -150), (-173.205, 150), (-43.301, 225), (216.506, 75), (216.506, -75), (-43.301, -225)])
"""(6, 2) mm, joints by the formulas of Torrao 2013, 4.2."""


def poses(count: int, seed: int = 3) -> tuple[Array, Array]:
    """``count`` reachable platform places and tilts."""
    rng = np.random.default_rng(seed)
    tips = rng.uniform([-0.11, -0.11, -0.09], [0.11, 0.11, 0.05], (4 * count, 3))
    tilts = rng.uniform(-0.3, 0.3, (4 * count, 2))
    chosen = np.nonzero(HEXAPOD.reachable(tips, tilts))[0][:count]
    assert len(chosen) == count
    return HEXAPOD.place_of(tips[chosen], tilts[chosen]), tilts[chosen]


def test_plates_are_the_hexagons_of_the_source() -> None:
    """Joints to 1e-3 mm, with the order of rows reconstructed, and edges 600/200 and 300/150 mm."""
    assert 1e3 * HEXAPOD.base == pytest.approx(BASE, abs=1e-3)
    assert 1e3 * HEXAPOD.platform == pytest.approx(PLATFORM, abs=1e-3)
    for corners, edges in ((HEXAPOD.base, (200, 600)), (HEXAPOD.platform, (150, 300))):
        found = 1e3 * np.linalg.norm(corners - np.roll(corners, -1, axis=0), axis=1)
        assert sorted(found) == pytest.approx(sorted([*edges] * 3), abs=1e-3)
    assert 1e3 * np.linalg.norm(HEXAPOD.base, axis=1) == pytest.approx([416.333] * 6, abs=1e-3)
    assert 1e3 * np.linalg.norm(HEXAPOD.platform, axis=1) == pytest.approx([229.129] * 6, abs=1e-3)


def test_all_derived_poses_at_once() -> None:
    known = np.array(list(DERIVED), dtype=float)
    found = HEXAPOD.lengths(1e-3 * known[:, :3], np.radians(known[:, 3:]))
    assert 1e3 * found == pytest.approx(np.array(list(DERIVED.values())), abs=1e-3)


def test_tip_chain_of_the_source() -> None:
    """Torrao 2013, 4.3: table 1600 mm below the base, work zero 200 mm over it, tool of 100 mm."""
    hexapod = type(HEXAPOD)(HEXAPOD.base, HEXAPOD.platform, sheet=(0.0, 0.0, -1.4))
    tips = 1e-3 * np.array([[0, 0, 0], [10, 20, -5], [10, 20, -5], [-90, 90, -30], [60, 0, -20.0]])
    tilts = np.radians([[0, 0], [0, 0], [5, -8], [0, 0], [-15, 20.0]])
    strokes = [
        [48.5944] * 6,
        [55.0161, 57.0201, 48.5791, 48.4438, 57.4893, 55.6206],
        [86.7622, 58.9018, 59.5929, 33.6020, 37.4782, 89.5825],
        [60.7602, 69.6957, 84.2437, 72.1931, 111.3697, 114.4924],
        [94.5858, 158.7853, 122.9944, 184.2297, 195.8701, 58.1756],
    ]
    assert 1e3 * hexapod.strokes(tips, tilts) == pytest.approx(np.array(strokes), abs=1e-3)


def test_rotation_is_that_of_another_library() -> None:
    """scipy's extrinsic x, y, z, and the element of eq. 4.22 that a wrong order would change."""
    angles = np.random.default_rng(1).uniform(-1.0, 1.0, (50, 3))
    assert rotation(angles) == pytest.approx(Rotation.from_euler("xyz", angles).as_matrix(), abs=1e-12)
    (sx, sy, sz), (cx, cy, cz) = np.sin(angles).T, np.cos(angles).T  # printed: eq. 4.22
    printed = [
        [cz * cy, cz * sy * sx - sz * cx, cz * sy * cx + sz * sx],
        [sz * cy, sz * sy * sx + cz * cx, sz * sy * cx - cz * sx],
        [-sy, cy * sx, cy * cx],
    ]
    assert rotation(angles) == pytest.approx(np.moveaxis(np.array(printed), -1, 0), abs=1e-12)
    assert rotation(angles[:, :2]) == pytest.approx(rotation(angles * [1, 1, 0]), abs=1e-15)
    assert np.abs(np.linalg.det(rotation(angles)) - 1.0).max() < 1e-12


def test_jacobian_at_home_is_the_derived_row() -> None:
    """Derived from the plates of the source by another implementation."""
    jacobian = HEXAPOD.jacobian(HOME, np.zeros(2))
    scale = np.array([1, 1, 1, 1e3, 1e3, 1e3])
    assert jacobian[0] * scale == pytest.approx([0.2022, -0.0438, -0.9784, 146.754, -169.457, 37.917], abs=1e-3)
    assert np.linalg.det(jacobian) * 1e9 == pytest.approx(-2.757e6, rel=1e-3)
    assert np.abs(jacobian).max(axis=0)[:3] == pytest.approx([0.2022, 0.1970, 0.9784], abs=1e-4)
    aside = HEXAPOD.jacobian(np.array([0.5, 0.0, -1.0]), np.zeros(2))
    assert np.abs(aside[:, 0]).max() == pytest.approx(0.5896, abs=1e-4)


def test_condition_over_the_stroke_and_what_errors_of_legs_move_the_tip() -> None:
    """Derived: 6.91 retracted, 8.43 in the middle, 9.94 extended, scaled by the radius of the platform; 2.87 mm across
    and 0.42 mm along per mm of independent leg errors, at 438 mm."""
    for z, condition in ((-911.883, 6.91), (-1117.287, 8.43), (-1321.034, 9.94)):
        jacobian = HEXAPOD.jacobian(np.array([0.0, 0.0, 1e-3 * z]), np.zeros(2))
        assert np.linalg.cond(jacobian / [1, 1, 1, 0.229129, 0.229129, 0.229129]) == pytest.approx(condition, abs=0.01)
    twist = np.linalg.inv(HEXAPOD.jacobian(HOME, np.zeros(2)))
    tip = twist[:3] + np.cross(twist[3:], np.array([0.0, 0.0, -0.438]), axisa=0, axisc=0)
    assert np.sqrt((tip**2).sum(axis=1)) == pytest.approx([2.87, 2.87, 0.42], abs=0.01)


@pytest.mark.parametrize(
    ("z", "half"), [(-950, 500), (-1000, 460), (-1060, 410), (-1100, 370), (-1150, 320), (-1200, 250), (-1250, 170)]
)
def test_square_that_the_upright_platform_reaches(z: float, half: float) -> None:
    """Half its side, mm, derived in steps of 10 mm from the strokes alone."""
    for side, inside in ((half, True), (half + 10.0, False)):
        line = np.linspace(-side, side, 41)
        edge = np.concatenate(
            [np.column_stack([line, np.full(41, y)]) for y in (-side, side)]
            + [np.column_stack([np.full(41, x), line]) for x in (-side, side)]
        )
        lengths = 1e3 * HEXAPOD.lengths(1e-3 * np.column_stack([edge, np.full(len(edge), z)]), np.zeros(2))
        assert bool(((lengths >= 942.0) & (lengths <= 1342.0)).all()) is inside, side


def test_pose_jacobian_against_differences() -> None:
    """Central differences of the lengths over all six freedoms, roll included."""
    place, tilt = poses(40)
    pose = np.column_stack([place, tilt, np.linspace(-0.2, 0.2, 40)])
    found = HEXAPOD.pose_jacobian(pose[:, :3], pose[:, 3:])
    for k in range(6):
        step = np.eye(6)[k] * 1e-6
        ahead, behind = pose + step, pose - step
        slope = (HEXAPOD.lengths(ahead[:, :3], ahead[:, 3:]) - HEXAPOD.lengths(behind[:, :3], behind[:, 3:])) / 2e-6
        assert found[:, :, k] == pytest.approx(slope, abs=1e-8)


def test_work_of_the_cylinders_is_that_of_the_force_on_the_tip() -> None:
    """Virtual work, by finite motions of the tip: no Jacobian takes part in the powers."""
    place, tilt = poses(60)
    tip = HEXAPOD.tip_of(place, tilt)
    rng = np.random.default_rng(5)
    force = rng.normal(0.0, 3e3, (60, 3))
    push = HEXAPOD.leg_forces(force, tip, tilt)
    velocity, rate = rng.normal(0.0, 0.05, (60, 3)), rng.normal(0.0, 0.2, (60, 2))
    h = 1e-5
    ahead = HEXAPOD.strokes(tip + h * velocity, tilt + h * rate)
    behind = HEXAPOD.strokes(tip - h * velocity, tilt - h * rate)
    of_cylinders = (push * (ahead - behind) / (2.0 * h)).sum(axis=1)
    of_sheet = (force * velocity).sum(axis=1)  # tilting about the tip does no work there
    assert np.abs(of_cylinders + of_sheet).max() < 1e-6 * np.abs(push).max()


def test_equilibrium_of_the_platform_under_leg_forces() -> None:
    """Sum of forces and of moments about the base's origin, from joints and tip as points in space."""
    place, tilt = poses(20)
    tip, force = HEXAPOD.tip_of(place, tilt), np.array([6500.0, -2000.0, 13000.0])
    push = HEXAPOD.leg_forces(force, tip, tilt)
    legs = HEXAPOD.legs(place, tilt)
    along = push[..., None] * legs / np.linalg.norm(legs, axis=-1, keepdims=True)
    joints = np.column_stack([HEXAPOD.base, np.zeros(6)])
    assert np.abs(along.sum(axis=1) + force).max() < 1e-7
    moment = np.cross(joints, along).sum(axis=1) + np.cross(tip + np.array(HEXAPOD.sheet), force)
    assert np.abs(moment).max() < 1e-7


@pytest.mark.parametrize(
    ("force", "pushes"),
    [
        ((0, 0, 13000), [2214.6] * 6),
        ((6500, 0, 13000), [-7477, -7477, 11151, 2969, 2969, 11151]),
        ((0, 6500, 13000), [6939, -2509, 8246, 12970, -8540, -3816]),
    ],
)
def test_derived_cylinder_forces(force: tuple[float, float, float], pushes: list[float]) -> None:
    """Loads of Torrao 2013; the cylinder forces are derived from its plates by another implementation."""
    tip = HEXAPOD.tip_of(HOME, np.zeros(2))
    assert HEXAPOD.leg_forces(np.array(force), tip, np.zeros(2)) == pytest.approx(pushes, abs=0.6)


def test_forward_from_the_middle_of_the_stroke() -> None:
    """Two thousand reachable poses: all found, in at most 6 steps."""
    place, tilt = poses(2000)
    found = HEXAPOD.forward(HEXAPOD.lengths(place, tilt))
    assert found.converged.all()
    assert found.iterations <= 6
    assert np.abs(found.place - place).max() < 1e-9
    assert np.abs(found.tilt - tilt).max() < 1e-9


def test_forward_from_the_last_pose_takes_three_steps() -> None:
    """1 mm and 0.5 deg away in every coordinate."""
    place, tilt = poses(500, seed=8)
    rng = np.random.default_rng(2)
    near = place + rng.uniform(-1e-3, 1e-3, place.shape)
    leaning = tilt + np.radians(rng.uniform(-0.5, 0.5, tilt.shape))
    found = HEXAPOD.forward(HEXAPOD.lengths(place, tilt), near, leaning)
    assert found.converged.all()
    assert found.iterations <= 3
    assert np.abs(found.place - place).max() < 1e-9


def test_single_poses_are_those_of_many() -> None:
    """Strokes and limits of the compiled single pose, by the formulas for many, in and out of reach."""
    rng = np.random.default_rng(4)
    tips, tilts = rng.uniform(-0.3, 0.3, (600, 3)), rng.uniform(-0.55, 0.55, (600, 2))
    for hexapod in (HEXAPOD, NORMALS):
        strokes, allowed = hexapod.strokes(tips, tilts), hexapod.reachable(tips, tilts)
        assert 50 < allowed.sum() < 550
        for k, (tip, tilt) in enumerate(zip(tips, tilts, strict=True)):
            if allowed[k]:
                assert np.abs(hexapod.positions(tip, tilt) - strokes[k]).max() < 1e-12
            else:
                with pytest.raises(IsfError):
                    hexapod.positions(tip, tilt)


def test_lengths_of_no_pose_give_the_one_that_fits_best() -> None:
    """Least squares: what is missing is orthogonal to every motion of the pose, by the formulas for many."""
    place, tilt = poses(200)
    lengths = HEXAPOD.lengths(place, tilt) + np.random.default_rng(6).uniform(-1e-3, 1e-3, (200, 6))
    found = HEXAPOD.forward(lengths, place, tilt)
    assert found.converged.sum() < 5
    missing = lengths - HEXAPOD.lengths(found.place, found.tilt)
    slopes = HEXAPOD.pose_jacobian(found.place, found.tilt)[..., :5]
    assert np.abs(np.swapaxes(slopes, -1, -2) @ missing[..., None]).max() < 1e-9
    assert np.abs(found.place - place).max() < 20e-3


def test_one_bad_row_spoils_no_other() -> None:
    """Lengths that are no numbers, that no pose has, and one that begins in a singular pose (flat, in the base)."""
    place, tilt = poses(100)
    lengths, start, leaning = HEXAPOD.lengths(place, tilt), place + 1e-3, tilt.copy()
    lengths[3], lengths[40], start[70], leaning[70] = np.nan, [0.0, 2.0, 0.0, 2.0, 0.0, 2.0], 0.0, 0.0
    found = HEXAPOD.forward(lengths, start, leaning)
    good = np.delete(np.arange(100), [3, 40, 70])
    assert found.converged[good].all()
    assert np.abs(found.place[good] - place[good]).max() < 1e-9
    assert not found.converged[[3, 40]].any()


@settings(max_examples=60, deadline=None)
@given(st.lists(st.floats(0.0, 2.0), min_size=6, max_size=6))
def test_forward_of_any_lengths_ends(lengths: list[float]) -> None:
    """A pose with these lengths, or not converged; never an exception and never a wrong pose."""
    found = HEXAPOD.forward(np.array(lengths))
    if found.converged:
        assert HEXAPOD.lengths(found.place, found.tilt) == pytest.approx(lengths, abs=1e-6)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 199), st.lists(st.floats(-2e-3, 2e-3), min_size=6, max_size=6), st.booleans())
def test_forward_of_lengths_near_a_pose(row: int, noise: list[float], exact: bool) -> None:
    """Five freedoms have no pose for noisy lengths: told, not invented. Those of a pose give its tip, or an error."""
    place, tilt = poses(200)
    lengths = HEXAPOD.lengths(place[row], tilt[row]) + (0.0 if exact else 1.0) * np.array(noise)
    found = HEXAPOD.forward(lengths)
    if exact:
        assert HEXAPOD.tip(lengths - HEXAPOD.shortest)[0] == pytest.approx(HEXAPOD.tip_of(place[row], tilt[row]))
    if found.converged:
        assert HEXAPOD.lengths(found.place, found.tilt) == pytest.approx(lengths, abs=1e-6)


def test_no_tip_out_of_reach() -> None:
    """A pose with these lengths exists, 0.3 m under the lowest that the strokes allow."""
    place = np.array([0.0, 0.0, -1.6])
    with pytest.raises(IsfError, match="out of the platform's reach") as caught:
        HEXAPOD.tip(HEXAPOD.lengths(place, np.zeros(2)) - HEXAPOD.shortest)
    assert caught.value.code == ErrorCode.TARGET_OUT_OF_WORKSPACE


def test_a_joint_that_bends_too_far_is_told() -> None:
    """A tool tilted about its tip in the middle: strokes allow 30 deg, joints straight along the normals do not."""
    tilt = np.array([np.radians(29.0), 0.0])
    assert NORMALS.joint_angles(NORMALS.place_of(np.zeros(3), tilt), tilt).max() > np.radians(45.0)
    with pytest.raises(IsfError, match=r"joint of cylinder .* would bend by") as caught:
        NORMALS.positions(np.zeros(3), tilt)
    assert caught.value.code == ErrorCode.TARGET_OUT_OF_WORKSPACE
    assert not NORMALS.reachable(np.zeros((1, 3)), tilt)[0]
    assert HEXAPOD.reachable(np.zeros((1, 3)), tilt)[0]


def bends_by_hand(tips: Array, azimuths: Array, tilt: float, lever: float, table: float) -> tuple[Array, Array, Array]:
    """Bends (N, 12) deg of joints straight along the legs in mid-stroke, and of those along the normals, and lengths
    (N, 6) mm, from the printed plates with scipy's rotations; tips (N, 2) mm on the table's plane."""
    base = np.array([(-404.145, -100), (-404.145, 100), (115.47, 400), (288.675, 300), (288.675, -300), (115.47, -400)])
    plate = np.array(
        [(-173.205, -150), (-173.205, 150), (-43.301, 225), (216.506, 75), (216.506, -75), (-43.301, -225)]
    )
    middle = np.column_stack([plate - base, np.full(6, -1117.287)]) / 1142.0
    bends, from_normals, lengths = [], [], []
    for (x, y), azimuth in zip(tips, azimuths, strict=True):
        axis = np.array([np.sin(tilt) * np.cos(azimuth), np.sin(tilt) * np.sin(azimuth), np.cos(tilt)])
        turn = Rotation.from_euler("xyz", [-np.arcsin(axis[1]), np.arctan2(axis[0], axis[2]), 0.0])
        joints = np.array([x, y, -table]) + lever * axis + turn.apply(np.column_stack([plate, np.zeros(6)]))
        legs = joints - np.column_stack([base, np.zeros(6)])
        length = np.linalg.norm(legs, axis=1)
        along = legs / length[:, None]
        in_plate = turn.inv().apply(along)
        lengths.append(length)
        bends.append(np.degrees(np.arccos([*(along * middle).sum(axis=1), *(in_plate * middle).sum(axis=1)])))
        from_normals.append(np.degrees(np.arccos([*-along[:, 2], *-in_plate[:, 2]])))
    return np.array(bends), np.array(from_normals), np.array(lengths)


@pytest.mark.parametrize("tool", [43, 70, 100])
@pytest.mark.parametrize("depth", [0, 60])
def test_every_tool_can_be_tilted_by_30_deg_inwards_in_the_whole_opening(tool: int, depth: int) -> None:
    """Torrao 2013, 6.2.3, with its joints of 45 deg, where they are straight along the legs; along the normals nowhere
    all around. The table's height is that of the rig."""
    hexapod = spif_a(tool_length=0.338 + 1e-3 * tool)
    along_normals = spif_a(tool_length=0.338 + 1e-3 * tool, along_normals=True)
    around, radius = (grid.ravel() for grid in np.meshgrid(np.radians(np.arange(0, 360, 10)), [0.0, 30.0, 60.0, 85.0]))
    tips = -radius[:, None] * np.column_stack([np.cos(around), np.sin(around)])
    bends, from_normals, lengths = bends_by_hand(tips, around, np.radians(30.0), 338.0 + tool, 1475.0 + depth)
    assert bends.max() < 45.0
    assert lengths.min() > 942.0
    assert lengths.max() < 1342.0
    axis = np.column_stack([0.5 * np.cos(around), 0.5 * np.sin(around), np.full(len(around), np.cos(np.radians(30.0)))])
    tilts = np.column_stack([-np.arcsin(axis[:, 1]), np.arctan2(axis[:, 0], axis[:, 2])])
    places = 1e-3 * np.column_stack([tips, np.full(len(tips), -float(depth))])
    assert hexapod.reachable(places, tilts * (1.0 - 1e-12)).all()
    bent = np.degrees(hexapod.joint_angles(hexapod.place_of(places, tilts), tilts))
    assert bent == pytest.approx(bends, abs=2e-3)
    bent = np.degrees(along_normals.joint_angles(along_normals.place_of(places, tilts), tilts))
    assert bent == pytest.approx(from_normals, abs=2e-3)
    for height in range(1300, 1750, 10):  # of the table
        assert bends_by_hand(tips[:36], around[:36], np.radians(30.0), 338.0 + tool, height)[1].max() > 48.0


def test_reachable_agrees_with_the_gate_of_single_poses() -> None:
    rng = np.random.default_rng(4)
    tips, tilts = rng.uniform(-0.5, 0.5, (150, 3)), rng.uniform(-0.6, 0.6, (150, 2))
    tips[:, 2] = rng.uniform(-0.25, 0.25, 150)
    tilts[::2] = 0.0
    free = []
    for tip, tilt in zip(tips, tilts, strict=True):
        try:
            HEXAPOD.positions(tip, tilt)
            free.append(True)
        except IsfError:
            free.append(False)
    assert HEXAPOD.reachable(tips, tilts).tolist() == free
    assert 20 < sum(free) < 130


def test_stroke_of_the_centre_line() -> None:
    """409.15 mm between retracted and extended, derived from the cylinders of the source (942 to 1342 mm)."""
    z = np.linspace(-1.5, -0.7, 80001)
    place = np.column_stack([np.zeros_like(z), np.zeros_like(z), z])
    free = HEXAPOD.reachable(HEXAPOD.tip_of(place, np.zeros(2)), np.zeros(2))
    assert 1e3 * np.ptp(z[free]) == pytest.approx(409.15, abs=0.05)


def test_three_cables_tell_a_cylinder_that_is_off() -> None:
    cables = CableSensors(a=0.3, b=0.1, c=0.35, origin=(-0.1, -0.15, 0.0))
    place, tilt = poses(30)
    lengths = cables.lengths(place)
    assert cables.place(lengths) == pytest.approx(place, abs=1e-9)
    right = HEXAPOD.forward(HEXAPOD.lengths(place, tilt), cables.place(lengths))
    assert cables.disagreement(right.place, lengths).max() < 1e-9
    off = HEXAPOD.lengths(place, tilt)
    off[:, 2] += 1e-3
    wrong = HEXAPOD.forward(off)
    assert cables.disagreement(wrong.place, lengths).min() > 0.1e-3
    assert np.isnan(cables.place(np.array([0.1, 1.0, 1.0]))).any()
