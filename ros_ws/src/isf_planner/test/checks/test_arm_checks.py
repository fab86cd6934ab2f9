"""What an arm does along a plan: speeds of joints, distances of links, how far it gives way; and what is refused."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile, load_job
from isf_planner import Plan, plan
from isf_planner.checks.arm_checks import arm_paths, boxes, check_arms, clearances
from isf_planner.view.arm_figure import arm_pictures
from planner_contours import circle

EXAMPLES = Path(__file__).resolve().parents[5] / "examples" / "jobs"
RIG = Path(__file__).resolve().parents[3] / "isf_core" / "rigs" / "kr210_arm.yaml"
JOB = (EXAMPLES / "robot_cone.yaml").read_text()


@pytest.fixture(scope="module")
def made() -> tuple[Plan, JobFile]:
    job_file = JobFile(JOB, EXAMPLES, "robot_cone.yaml")
    return plan(job_file), job_file


@pytest.fixture
def with_rig(tmp_path: Path) -> Callable[[str, str], JobFile]:
    """The job on the rig with one text changed."""

    def change(old: str, new: str) -> JobFile:
        text = RIG.read_text()
        assert old in text
        (tmp_path / "rig.yaml").write_text(text.replace(old, new))
        return JobFile(JOB.replace("kr210_arm", str(tmp_path / "rig.yaml")), EXAMPLES, "robot_cone.yaml")

    return change


def test_joints_and_speeds_are_those_of_the_points(made: tuple[Plan, JobFile]) -> None:
    result, job_file = made
    (path,) = arm_paths(result.contours, job_file.rig, 5e-3)
    arm = job_file.rig.arm(1)
    assert arm is not None
    first = result.contours[0]
    n = len(first)
    np.testing.assert_allclose(path.tips[:n], first.forming_tip, atol=1e-12)
    np.testing.assert_allclose(path.tips[n], first.forming_tip[0], atol=1e-12)  # closed: the first point once more
    np.testing.assert_allclose(arm.forward(path.joints)[0], path.tips, atol=1e-9)
    # 30 mm/s by the Jacobian between two points, against the differences of the joints
    k = n // 3
    way = path.tips[k + 1] - path.tips[k]
    rates = np.linalg.solve(
        arm.jacobian(0.5 * (path.joints[k] + path.joints[k + 1])),
        np.concatenate([0.03 * way / np.linalg.norm(way), np.zeros(3)]),
    )
    fastest = np.radians([123, 115, 112, 179, 172, 219])
    np.testing.assert_allclose(path.speed[k], np.abs(rates) / fastest, rtol=1e-3, atol=1e-6)
    assert path.margin.min() > np.radians(40)
    assert path.singular.min() > np.radians(40)


def test_the_arm_gives_way_under_the_predicted_force(made: tuple[Plan, JobFile]) -> None:
    result, job_file = made
    (path,) = arm_paths(result.contours, job_file.rig, 5e-3)
    force = result.contours[4].predicted_force
    row = int(np.argmax(path.contour == result.contours[4].index))
    np.testing.assert_allclose(path.force[row], [0.0, 0.0, force[0]])  # the sheet pushes an upper tool upwards
    give = path.give[row]
    assert give[2] == pytest.approx(1.02e-6 * force[0], rel=0.05)
    assert give[2] > 0.0


def test_the_nearest_link_is_that_of_sampled_points(made: tuple[Plan, JobFile]) -> None:
    result, job_file = made
    paths = arm_paths(result.contours, job_file.rig, 5e-3)
    (near,) = clearances(paths, job_file.job, job_file.rig)
    assert (near.link, near.other) == ("tool holder", "clamp")
    # the holder ends 80 mm above the tip; the frame begins at 125 mm and is 20 mm high: by hand
    tip = paths[0].tips[near.row]
    aside = 0.125 - max(abs(tip[0]), abs(tip[1]))
    above = tip[2] + 0.080 - 0.020
    assert near.distance == pytest.approx(np.hypot(aside, above) - 0.060, abs=1e-4)
    every = np.hypot(0.125 - np.abs(paths[0].tips[:, :2]).max(axis=1), paths[0].tips[:, 2] + 0.060) - 0.060
    assert near.distance == pytest.approx(every.min(), abs=2e-4)
    assert {box.name for box in boxes(job_file.rig)} == {"clamp", "table"}


def test_a_wide_holder_runs_into_the_clamp(with_rig: Callable[[str, str], JobFile]) -> None:
    with pytest.raises(IsfError, match=r"tool holder of the arm of tool 1 would run .* mm into the clamp") as caught:
        plan(with_rig("holder: 60 mm", "holder: 140 mm"))
    assert caught.value.code is ErrorCode.ARM_COLLISION
    assert "contour" in caught.value.where


def test_a_thick_wrist_runs_into_the_clamp(with_rig: Callable[[str, str], JobFile]) -> None:
    with pytest.raises(IsfError, match=r"link after A5 of the arm of tool 1 would run .* into the clamp") as caught:
        plan(with_rig("radius: 120 mm", "radius: 400 mm"))
    assert caught.value.code is ErrorCode.ARM_COLLISION


def test_a_slow_joint_is_told_with_the_place(with_rig: Callable[[str, str], JobFile]) -> None:
    with pytest.raises(
        IsfError, match=r"joint A3 of tool 1 would have to turn at .* 1 deg/s are its largest"
    ) as caught:
        plan(with_rig("speed: 112 deg/s", "speed: 1 deg/s"))
    assert caught.value.code is ErrorCode.ARM_TOO_FAST
    assert "mm" in caught.value.where


def test_out_of_reach_is_told_with_joint_and_place(with_rig: Callable[[str, str], JobFile]) -> None:
    with pytest.raises(IsfError, match="too short") as caught:
        plan(with_rig("base: [-1700 mm", "base: [-3200 mm"))
    assert caught.value.code is ErrorCode.PART_DOES_NOT_FIT
    assert "contour" in caught.value.where


def test_the_map_is_drawn(made: tuple[Plan, JobFile], tmp_path: Path) -> None:
    result, job_file = made
    paths = arm_paths(result.contours, job_file.rig, 5e-3)
    near = check_arms(result.contours, job_file.job, job_file.rig)
    (picture,) = arm_pictures(paths, near, job_file.rig, tmp_path)
    assert picture.stat().st_size > 20_000
    with pytest.raises(IsfError) as caught:
        arm_pictures(paths, near, job_file.rig, tmp_path / "no")
    assert caught.value.code is ErrorCode.FILE_NOT_WRITABLE


def test_a_rig_without_arms_has_no_paths(made: tuple[Plan, JobFile]) -> None:
    result, _ = made
    other = JobFile(JOB.replace("kr210_arm", "ren2018"), EXAMPLES, "robot_cone.yaml")
    assert arm_paths(result.contours, other.rig, 5e-3) == ()
    assert check_arms(result.contours, other.job, other.rig) == ()


def test_a_support_tool_is_as_fast_as_its_way_is_long() -> None:
    """On the outside of a ring its tip is at the same point at the same time, up to twice as fast as the feed."""
    job_file = load_job(EXAMPLES / "robot_pair_cone.yaml")
    arm = job_file.rig.arm(2)
    assert arm is not None
    fastest = np.array([joint.speed for joint in arm.joints])
    for inner, times in ((30e-3, 34.04 / 26.46), (10e-3, 2.0)):
        ring = circle(inner, z=-3e-3, angle=np.radians(45.0), tools=2)
        _, path = arm_paths((ring,), job_file.rig, 5e-3)
        assert path.tool == 2
        k = 40
        way = path.tips[k + 1] - path.tips[k]
        rates = np.linalg.solve(
            arm.jacobian(0.5 * (path.joints[k] + path.joints[k + 1])),
            np.concatenate([30e-3 * times * way / np.linalg.norm(way), np.zeros(3)]),
        )
        np.testing.assert_allclose(path.speed[k], np.abs(rates) / fastest, rtol=2e-3, atol=1e-6)
