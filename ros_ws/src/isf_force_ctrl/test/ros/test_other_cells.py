"""docs/own_cell/drivers.md: the node alone against drivers with names and habits of their own, over real DDS."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from geometry_msgs.msg import TwistStamped
from isf_core.errors import ErrorCode
from isf_force_ctrl.ros.publishers import MAXIMUM_PULL, PULL, TargetTwist
from isf_ros import conversion, qos
from node_cell import Cell, small_ring, watched

DOCS = Path(__file__).resolve().parents[5] / "docs" / "own_cell" / "drivers.md"


@pytest.fixture
def cell() -> Iterator[Cell]:
    with watched(Cell) as found:
        yield found


def documented(heading: str) -> dict[str, str]:
    """Remaps of the command under ``heading`` of the page."""
    section = DOCS.read_text().split(f"### {heading}")[1]
    command = re.search(r"```sh\n(ros2 run isf_force_ctrl force_ctrl.*?)```", section, re.DOTALL)
    assert command is not None
    return dict(re.findall(r"-r (\S+):=(\S+)", command.group(1)))


@pytest.mark.graph
@pytest.mark.parametrize(
    "heading",
    [
        "FZI cartesian controllers",
        pytest.param("CRISP controllers", marks=pytest.mark.slow),
        pytest.param("Ethernet sensor interface", marks=pytest.mark.slow),
    ],
)
def test_the_documented_names(cell: Cell, heading: str) -> None:
    remap = documented(heading)
    assert {"tool_1/target", "tool_2/target", "tool_1/wrench", "tool_2/wrench"} <= set(remap)
    cell.start(remap=remap)
    cell.armed()
    result = conversion.result_from_message(cell.form(small_ring()))
    assert (result.completed, result.code) == (True, 0)
    assert cell.targets == 0  # nothing under our own names


@pytest.mark.graph
@pytest.mark.clock
def test_a_driver_that_follows_twists_stays_on_the_path(cell: Cell) -> None:
    twists: list[tuple[float, float, float]] = []

    def keep(message: TwistStamped) -> None:
        linear = message.twist.linear
        twists.append((linear.x, linear.y, linear.z))

    cell.node.create_subscription(TwistStamped, "tool_1/target_twist", keep, qos.STREAM)
    drift = 1e-3
    cell.start({"lockstep": False, "twist": True, "drift": drift}, lockstep=False, output="twist")
    cell.armed()
    ring = small_ring()
    result = conversion.result_from_message(cell.form(ring))
    assert (result.completed, result.code) == (True, 0)
    assert cell.targets == 0
    seconds = result.tick_time[-1] - result.tick_time[0]
    away = np.hypot(*result.forming_measured[:, :2].T) - np.hypot(*ring.forming_tip[:, :2].T)
    # Without the pull the driver would have drifted by this much, with it by drift / PULL and what its servo lags.
    assert drift * seconds > 2e-3
    assert np.nanmax(np.abs(away)) < 0.6e-3
    # Parked: told to stand, and then left alone.
    assert cell.wait(lambda: twists and twists[-1] == (0.0, 0.0, 0.0))


@pytest.mark.graph
def test_twists_need_poses(cell: Cell) -> None:
    cell.start({"lockstep": False, "twist": True, "poses_until": 0}, lockstep=False, output="twist", wrench_timeout=0.5)
    assert cell.wait(lambda: cell.ask_to_arm().code == ErrorCode.POSE_LOST)


# -- the law -------------------------------------------------------------------------------------


def test_twists_lead_along_the_targets() -> None:
    law = TargetTwist((0.0, 0.0, 0.0), 500.0)
    assert law.step((1e-5, 0.0, -2e-5)) == pytest.approx((5e-3, 0.0, -1e-2))
    law.measured = (1e-5, 0.0, -2e-5)
    assert law.step((1e-5, 0.0, -2e-5)) == (0.0, 0.0, 0.0)


def test_a_tool_that_is_armed_tilted_is_turned_from_where_it_stands() -> None:
    def leaning(degrees: float) -> tuple[float, float, float]:
        return math.sin(math.radians(degrees)), 0.0, math.cos(math.radians(degrees))

    law = TargetTwist((0.0, 0.0, 0.05), 500.0, leaning(20.0))
    assert law.turn(leaning(20.0)) == (0.0, 0.0, 0.0)
    assert law.turn(leaning(19.98)) == pytest.approx((0.0, -math.radians(10.0), 0.0), abs=1e-6)  # rad/s: 10 deg/s back


def test_the_pull_is_limited_in_size() -> None:
    law = TargetTwist((0.0, 0.0, 0.0), 500.0)
    law.measured = (0.3, -0.4, 0.0)
    assert law.step((0.0, 0.0, 0.0)) == pytest.approx((-0.6 * MAXIMUM_PULL, 0.8 * MAXIMUM_PULL, 0.0))


@pytest.mark.parametrize("seed", range(5))
def test_drift_is_bounded_on_any_path(seed: int) -> None:
    random = np.random.default_rng(seed)
    rate, lag = 500.0, 10  # the pose is 20 ms old
    drift = random.uniform(-1e-3, 1e-3, 3)
    path = np.cumsum(random.normal(0.0, 2e-5, (5000, 3)), axis=0)
    law, at, seen = TargetTwist((0.0, 0.0, 0.0), rate), np.zeros(3), []
    worst = 0.0
    for target in path:
        velocity = np.array(law.step(tuple(target))) * 1.02 + drift  # the driver's scale is wrong as well
        at = at + velocity / rate
        seen.append(at)
        law.measured = tuple(seen[-lag] if len(seen) > lag else np.zeros(3))
        worst = max(worst, float(np.linalg.norm(at - target)))
    bound = (np.linalg.norm(drift) + 0.02 * rate * np.abs(np.diff(path, axis=0)).max() * np.sqrt(3)) / PULL
    assert worst < 1.5 * bound + 0.2e-3
