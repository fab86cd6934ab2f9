"""Kinematics and stiffness of a six-axis arm, judged by matrices multiplied by hand, differences and levers."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.rig import load_rig
from isf_core.geometry.kinematics import Gantry
from isf_core.geometry.serial_arm import PAIRS, SerialArm, choose_posture, compliance_field, compliance_terms

DEG = np.pi / 180.0
REGION = (0.125, 0.125, 0.11)


@pytest.fixture(scope="module")
def arm() -> SerialArm:
    found = load_rig("kr210_arm").arm(1)
    assert found is not None
    return found


def least(arm: SerialArm, tips: np.ndarray, tilts: np.ndarray, rolls: np.ndarray) -> np.ndarray:
    """(R, 8) rad, for every roll and branch the least distance from limits and singular poses; -1 out of reach."""
    worst = np.full((len(rolls), 8), np.inf)
    for i, roll in enumerate(rolls):
        for tip, tilt in zip(tips, tilts, strict=True):
            every = arm.inverse(tip, tilt, roll)
            here = np.where(every.exists, np.minimum(every.margin, every.singular), -1.0)
            worst[i] = np.minimum(worst[i], here)
    return worst


def denavit_hartenberg(joints: np.ndarray, tool: float) -> np.ndarray:
    """(4, 4), flange with tool in the base of a KR 210 R2700 extra, from the table of a data sheet: four numbers for a
    joint, in another order of turns than the URDF that the rig follows."""

    def link(angle: float, offset: float, length: float, twist: float) -> np.ndarray:
        c, s, ct, st = np.cos(angle), np.sin(angle), np.cos(twist), np.sin(twist)
        return np.array(
            [
                [c, -s * ct, s * st, length * c],
                [s, c * ct, -c * st, length * s],
                [0.0, st, ct, offset],
                [0.0, 0.0, 0.0, 1.0],
            ]
        )

    a = joints
    quarter = np.pi / 2
    chain = [
        link(-a[0], 0.675, 0.350, -quarter),
        link(a[1], 0.0, 1.150, 0.0),
        link(a[2] - quarter, 0.0, -0.041, -quarter),
        link(-a[3], 1.200, 0.0, quarter),
        link(a[4], 0.0, 0.0, -quarter),
        link(-a[5], 0.215 + tool, 0.0, 0.0),
    ]
    return np.linalg.multi_dot(chain)


def random_joints(arm: SerialArm, count: int, seed: int = 0) -> np.ndarray:
    low = np.array([joint.lowest for joint in arm.joints])
    high = np.array([joint.highest for joint in arm.joints])
    return np.random.default_rng(seed).uniform(low, high, (count, 6))


def test_forward_agrees_with_denavit_hartenberg(arm: SerialArm) -> None:
    for joints in random_joints(arm, 200):
        tip, turned = arm.forward(joints)
        other = denavit_hartenberg(joints, 0.350)
        np.testing.assert_allclose(tip - np.array(arm.place), other[:3, 3], atol=1e-6)
        np.testing.assert_allclose(turned[:, 0], other[:3, 2], atol=1e-9)  # the axis of the tool


@pytest.mark.parametrize("turn", [(0.0, 0.0, 0.0), (0.3, -0.4, 1.1)])
@pytest.mark.parametrize("tool_angle", [0.0, 40 * DEG])
@pytest.mark.parametrize("side", [1, -1])
def test_inverse_takes_every_branch_back_to_the_tip(
    arm: SerialArm, turn: tuple[float, float, float], tool_angle: float, side: int
) -> None:
    other = replace(arm, turn=turn, tool_angle=tool_angle, side=side, place=(-1.2, 0.3, -0.5))
    rng = np.random.default_rng(1)
    tips, tilts = rng.uniform(-0.4, 0.4, (300, 3)), rng.uniform(-0.5, 0.5, (300, 2))
    found = other.inverse(tips, tilts, rng.uniform(-3.0, 3.0, 300))
    again, turned = other.forward(found.joints)
    off = np.linalg.norm(again - tips[:, None], axis=-1)
    assert found.exists.sum() > 1000
    assert off[found.exists].max() < 1e-9
    # the shank leans by the tilt: about x, then y
    (sx, sy), (cx, cy) = np.sin(tilts).T, np.cos(tilts).T
    axis = side * np.stack([sy * cx, -sx, cy * cx], axis=-1)
    shank = -(turned @ np.array([np.cos(tool_angle), 0.0, -np.sin(tool_angle)]))
    apart = np.linalg.norm(shank - axis[:, None], axis=-1)
    assert apart[found.exists].max() < 1e-9


def test_joints_of_a_pose_are_among_the_branches(arm: SerialArm) -> None:
    joints = random_joints(arm, 300, seed=2)
    tips, turned = arm.forward(joints)
    axis = -turned[:, :, 0]
    upward = axis[:, 2] > 0.2
    tilts = np.stack(
        [np.arctan2(-axis[:, 1], np.hypot(axis[:, 0], axis[:, 2])), np.arctan2(axis[:, 0], axis[:, 2])], -1
    )
    # the roll of a pose is what turns the link without roll into the one that is there
    plain = arm.forward(arm.inverse(tips, tilts, np.zeros(300)).joints[:, 0])[1]
    across = np.einsum("nji,njk->nik", plain, turned)
    roll = -np.arctan2(across[:, 2, 1], across[:, 1, 1])
    found = arm.inverse(tips, tilts, roll)
    missing = np.abs(np.angle(np.exp(1j * (found.joints - joints[:, None])))).max(axis=-1)
    far = np.where(found.exists, missing, np.inf).min(axis=-1)
    reached = upward & (np.abs(np.sin(joints[:, 4])) > 0.05)
    assert reached.sum() > 40
    assert far[reached].max() < 1e-6


def test_jacobian_is_that_of_differences(arm: SerialArm) -> None:
    step = 1e-6
    for joints in random_joints(arm, 20, seed=3):
        jacobian = arm.jacobian(joints)
        for k in range(6):
            ahead, behind = joints.copy(), joints.copy()
            ahead[k] += step
            behind[k] -= step
            (tip_a, turn_a), (tip_b, turn_b) = arm.forward(ahead), arm.forward(behind)
            np.testing.assert_allclose(jacobian[:3, k], (tip_a - tip_b) / (2 * step), atol=1e-7)
            spin = (turn_a - turn_b) / (2 * step) @ arm.forward(joints)[1].T
            np.testing.assert_allclose(jacobian[3:, k], [spin[2, 1], spin[0, 2], spin[1, 0]], atol=1e-7)


def test_manipulability_vanishes_where_the_wrist_is_straight(arm: SerialArm) -> None:
    joints = np.array([0.0, -80.0, 100.0, 20.0, 50.0, 0.0]) * DEG
    straight = joints.copy()
    straight[4] = 0.0
    assert arm.manipulability(straight) < 1e-9
    assert arm.manipulability(joints) > 0.5


def test_the_tip_gives_way_as_levers_and_drives_do(arm: SerialArm) -> None:
    """The arm lies in the plane y = 0: a force along z turns joints 2, 3 and 5, one along y joints 1, 4 and 6. Levers
    are distances in the drawing of the arm, not columns of the Jacobian."""
    joints = arm.held(np.zeros(3))[0]
    np.testing.assert_allclose(joints[[0, 3, 5]], 0.0, atol=1e-9)
    compliance = arm.compliance(joints)
    # levers of a vertical force at the tip: horizontal distances of the joints' axes from it, m
    shoulder = 1.700 - 0.350
    elbow = shoulder - 1.150 * np.cos(joints[1])
    expected = shoulder**2 / 3.3e6 + elbow**2 / 2.5e6 + 0.0**2 / 0.30e6
    assert compliance[2, 2] == pytest.approx(expected, rel=1e-6)
    # a side force: joint 1 with 1.7 m; joint 4 turns about the forearm, whose line passes the tip at this distance
    slope = joints[1] + joints[2]  # of the forearm, downwards
    forearm = np.array([np.cos(slope), -np.sin(slope)])
    from_wrist = np.array([0.0, -(0.215 + 0.350)])
    beside = abs(forearm[0] * from_wrist[1] - forearm[1] * from_wrist[0])
    expected = 1.700**2 / 1.5e6 + beside**2 / 0.33e6
    assert compliance[1, 1] == pytest.approx(expected, rel=1e-6)
    assert np.linalg.eigvalsh(compliance).min() > 0.0


def test_posture_is_the_best_of_all_and_holds_over_the_sheet(arm: SerialArm) -> None:
    corners = np.array([[x, y, z] for x in (-0.12, 0.12) for y in (-0.12, 0.12) for z in (-0.1, 0.1)])
    assert arm.reachable(corners).all()
    other = replace(arm, tool_angle=30 * DEG)  # an arm whose roll matters to all joints
    chosen = choose_posture(other, REGION)
    tips, upright = np.vstack([corners, np.zeros(3)]), np.zeros((9, 2))
    rolls = np.arange(-180, 180, 5) * DEG
    worths = least(other, tips, upright, rolls)
    own = least(chosen, tips, upright, np.array([chosen.roll]))[0, chosen.branch]
    assert own > 0.9 * worths.max()
    assert own > 20 * DEG
    # a given roll is kept
    assert choose_posture(other, REGION, 35 * DEG).roll == pytest.approx(35 * DEG)


def test_an_arm_on_a_line_does_not_flip(arm: SerialArm) -> None:
    tips = np.linspace([-0.12, -0.12, -0.05], [0.12, 0.12, -0.05], 2000)
    joints, _, _ = arm.held(tips)
    assert np.abs(np.diff(joints, axis=0)).max() < 0.2 * DEG


@pytest.mark.parametrize(
    ("changed", "tip", "tilt", "text"),
    [
        ({}, (2.0, 0.0, 0.0), (0.0, 0.0), "too short"),
        ({}, (0.0, 0.0, 0.0), (0.7, 0.0), "tilted by 40.1 deg, 30 deg are allowed"),
        ({"place": (-1.7, 0.0, 1.1)}, (0.0, 0.0, 0.0), (0.0, 0.0), "joint A2 would stand at 1."),
        ({"clearance": 60 * DEG}, (0.0, 0.0, 0.0), (0.0, 0.0), "from a singular pose, 60 deg are needed"),
    ],
)
def test_what_the_arm_cannot_do_is_told(
    arm: SerialArm, changed: dict[str, object], tip: tuple[float, ...], tilt: tuple[float, ...], text: str
) -> None:
    other = replace(arm, **changed)  # type: ignore[arg-type]
    assert not other.reachable(np.array([tip]), np.array(tilt)).any()
    with pytest.raises(IsfError, match=text) as error:
        other.positions(np.array(tip), np.array(tilt))
    assert error.value.code is ErrorCode.TARGET_OUT_OF_WORKSPACE


def test_positions_and_tip_are_inverse(arm: SerialArm) -> None:
    tip, tilt = np.array([0.05, -0.03, -0.04]), np.array([0.2, -0.1])
    again, leaning = arm.tip(arm.positions(tip, tilt))
    np.testing.assert_allclose(again, tip, atol=1e-9)
    np.testing.assert_allclose(leaning, tilt, atol=1e-9)


def test_rig_names_the_arm(tmp_path: Path) -> None:
    upper, lower = load_rig("kr210_arm").make_kinematics()
    assert upper.axes == ("A1", "A2", "A3", "A4", "A5", "A6")
    assert isinstance(lower, Gantry)
    assert load_rig("ren2018").arm(1) is None


@pytest.mark.parametrize(
    ("text", "field"),
    [
        ("based_on: ren2018\nkinematics: arm\n", "tool_1.arm"),
        ("based_on: kr210_arm\nkinematics: gantry_xyz_uvw\n", "tool_1.arm"),
    ],
)
def test_arm_and_kinematics_go_together(tmp_path: Path, text: str, field: str) -> None:
    path = tmp_path / "rig.yaml"
    path.write_text(text)
    with pytest.raises(IsfError, match=field) as error:
        load_rig(str(path))
    assert error.value.code is ErrorCode.FILE_FIELD


@pytest.mark.parametrize(
    ("old", "new", "field"),
    [
        ("axis: -z", "axis: x", "joints.0.axis"),
        ("place: [0 mm, 0 mm, -41 mm]", "place: [0 mm, 5 mm, -41 mm]", "joints.3.place"),
        ("range: [-140 deg, -5 deg]", "range: [-5 deg, -140 deg]", "range must rise"),
        ("stiffness: 1.5 MN*m/rad", "stiffness: 1.5 kN", "N\\*m/rad"),
    ],
)
def test_an_arm_that_cannot_be_had_is_refused(tmp_path: Path, old: str, new: str, field: str) -> None:
    text = (Path(__file__).parents[2] / "rigs" / "kr210_arm.yaml").read_text()
    assert old in text
    path = tmp_path / "rig.yaml"
    path.write_text(text.replace(old, new))
    with pytest.raises(IsfError, match=field):
        load_rig(str(path))


def test_the_field_of_compliance_is_that_of_the_joints(arm: SerialArm) -> None:
    field = compliance_field(arm, REGION)
    rng = np.random.default_rng(4)
    tips, tilts = rng.uniform(-1, 1, (200, 3)) * REGION, rng.uniform(-0.3, 0.3, (200, 2))
    for tilt, within in ((np.zeros((200, 2)), 0.003), (tilts, 0.08)):
        exact = arm.compliance(arm.held(tips, tilt)[0])
        terms = np.array([compliance_terms(*tip, *lean) for tip, lean in zip(tips, tilt, strict=True)])
        values = terms @ field.T
        off = max(np.abs(values[:, n] - exact[:, i, j]).max() for n, (i, j) in enumerate(PAIRS))
        assert off < within * exact.max()
