"""Node force_ctrl in its own process against a stand-in machine in another, over real DDS."""

from __future__ import annotations

import signal
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from isf_core.contour import Process
from isf_core.errors import ErrorCode
from isf_force_ctrl import ControlConfig
from isf_msgs.action import MoveAside
from isf_msgs.msg import ForceCtrlState
from isf_ros import conversion, qos
from node_cell import JOB, LIMIT, QUICK, Cell, call_action, long_ring, small_ring, watched
from std_srvs.srv import Trigger

pytestmark = pytest.mark.graph


@pytest.fixture
def cell() -> Iterator[Cell]:
    with watched(Cell) as found:
        yield found


def test_forms_a_part_in_lockstep(cell: Cell) -> None:
    own = {name: getattr(ControlConfig, name) for name in QUICK}
    cell.start(**own)
    cell.armed(count=2)
    for index in range(2):
        result = conversion.result_from_message(cell.form(small_ring(index, 2)))
        assert (result.completed, result.code, result.index) == (True, 0, index)
        force = result.tick_normal_force[result.tick_engaged]
        # The sandbox's force is constant but for noise of 1.2 N and steps of 1 N.
        assert np.mean(np.abs(force - 120.0) <= 10.0) >= 0.99
        assert result.lost_messages == 0
        assert np.diff(result.tick_time) == pytest.approx(0.002, abs=1e-6)
    assert cell.rests_in(ForceCtrlState.IDLE)
    modes = {state.mode for state in cell.states}
    assert {ForceCtrlState.ENGAGE, ForceCtrlState.CONTROL, ForceCtrlState.LIFT} <= modes
    # Parked: nothing is streamed any more, not even repeated.
    cell.wait(lambda: False, 0.5)
    before = cell.targets
    cell.wait(lambda: False, 0.7)
    assert cell.targets == before


def test_a_move_has_ended_when_the_machine_has_done_its_last_targets(
    cell: Cell, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Else a scan right after it may overtake them, and the part takes another course from run to run."""
    last_targets = tmp_path / "last"
    monkeypatch.setenv("LAST_TARGETS", str(last_targets))
    marking = Path(__file__).parents[1] / "marking_force_ctrl.py"
    cell.start({"last_targets": last_targets}, program=(str(marking),))
    cell.armed(count=2)
    assert cell.form(small_ring(0, 2)).completed
    assert not last_targets.exists()
    moved, _ = call_action(cell, MoveAside, "move_aside", MoveAside.Goal())
    assert (moved.code, moved.message) == (0, "")
    assert not last_targets.exists()


def test_nan_wrench_holds_with_its_code(cell: Cell) -> None:
    cell.start({"nan_at": 400})
    cell.armed()
    result = cell.form(small_ring())
    assert (result.completed, result.code) == (False, ErrorCode.WRENCH_NOT_FINITE)
    assert cell.rests_in(ForceCtrlState.HOLD)
    before = cell.targets
    assert cell.wait(lambda: cell.targets > before + 2)  # still alive: the last targets are repeated


def test_wrenches_that_stop_end_the_contour(cell: Cell) -> None:
    cell.start({"silent_at": 400}, wrench_timeout=1.0)
    cell.armed()
    result = cell.form(small_ring())
    assert (result.completed, result.code) == (False, ErrorCode.WRENCH_LOST)
    assert "machine" in result.message


def test_a_controller_that_stood_still_blames_nobody(cell: Cell) -> None:
    """Wrenches that came while the process did not run have still to be received: the contour goes on."""
    cell.start(wrench_timeout=2.0)
    for _ in range(3):
        cell.armed()
        cell.states.clear()
        cell.results.clear()
        cell._contours.publish(conversion.contour_to_message(small_ring()))
        assert cell.wait(lambda: any(state.mode == ForceCtrlState.CONTROL for state in cell.states))
        cell.process.send_signal(signal.SIGSTOP)
        cell.wait(lambda: False, timeout=2.5)
        cell.process.send_signal(signal.SIGCONT)
        assert cell.wait(lambda: cell.results)
        assert (cell.results[-1].completed, cell.results[-1].code) == (True, 0)


def test_refusals(cell: Cell) -> None:
    cell.start({"tared": False})
    cell._contours.publish(conversion.contour_to_message(small_ring()))
    response = cell.arm()
    deadline = time.monotonic() + LIMIT
    assert response.code == ErrorCode.NO_TARE
    while "not tared" not in response.message and time.monotonic() < deadline:
        response = cell.arm()
    assert cell.targets == 0  # the contour came before anything was armed
    disarmed = cell.arm(plan_id="")
    assert disarmed.code == 0


def test_contours_out_of_order_are_answered(cell: Cell) -> None:
    cell.start()
    cell.armed(count=3)
    result = cell.form(small_ring(1, 3))
    assert (result.completed, result.code, result.index) == (False, ErrorCode.CONTOUR_REJECTED, 1)
    assert cell.targets == 0


def test_a_contour_sent_early_is_reported_what_is_the_case(cell: Cell) -> None:
    cell.start()
    unarmed = cell.form(small_ring(0, 2))
    assert (unarmed.completed, unarmed.code, unarmed.index) == (False, ErrorCode.NOT_ARMED, 0)
    assert "no plan is armed" in unarmed.message
    cell.armed(plan_id="another", count=2)
    other = cell.form(small_ring(0, 2))
    assert (other.completed, other.code) == (False, ErrorCode.CONTOUR_REJECTED)
    assert "plan 'another' is armed" in other.message
    assert "arm the plan of this contour" in other.message
    assert cell.targets == 0

    # While a contour is formed the next one is early; the same one once more is no news.
    cell.armed(count=2)
    begun = len(cell.states)
    cell._contours.publish(conversion.contour_to_message(long_ring(0, 2)))
    assert cell.wait(lambda: any(state.mode == ForceCtrlState.CONTROL for state in cell.states[begun:]))
    cell._contours.publish(conversion.contour_to_message(long_ring(0, 2)))
    early = cell.form(small_ring(1, 2))
    assert (early.completed, early.code, early.index) == (False, ErrorCode.CONTOUR_REJECTED, 1)
    assert "too early" in early.message
    assert "arm" not in early.message.split("(")[-1]
    assert cell.wait(lambda: len(cell.results) > 3)
    assert (cell.results[3].completed, cell.results[3].code, cell.results[3].index) == (True, 0, 0)
    last = cell.form(small_ring(1, 2))  # now it is time
    assert (last.completed, last.code) == (True, 0)


def test_stop_and_disarm(cell: Cell) -> None:
    cell.start()
    cell.armed()
    client = cell.node.create_client(Trigger, "force_ctrl/stop")
    assert client.wait_for_service(LIMIT)
    cell._contours.publish(conversion.contour_to_message(long_ring()))
    assert cell.wait(lambda: any(state.mode == ForceCtrlState.APPROACH for state in cell.states))
    assert cell.wait(client.call_async(Trigger.Request()).done)
    assert cell.wait(lambda: cell.results)
    assert cell.results[-1].code == ErrorCode.STOPPED
    assert cell.arm(plan_id="").code == 0
    assert cell.rests_in(ForceCtrlState.IDLE)


@pytest.mark.clock
def test_real_time_forms_a_contour(cell: Cell) -> None:
    cell.start({"lockstep": False}, lockstep=False)
    cell.armed()
    result = conversion.result_from_message(cell.form(small_ring()))
    # Timing depends on the machine the test runs on; forming and counting must work on any.
    assert (result.completed, result.code) == (True, 0)
    assert result.contact_fraction > 0.9
    assert len(result.tick_time) > 500


def test_a_driver_with_other_topic_names(cell: Cell) -> None:
    # docs/own_cell/drivers.md: the node alone against a driver that follows a stream of poses under names of its own
    names = {
        "tool_1/target": "left/target_frame",
        "tool_1/wrench": "left/ft_sensor_wrench",
        "tool_2/target": "right/target_frame",
        "tool_2/wrench": "right/ft_sensor_wrench",
    }
    cell.start(remap=names)
    frames: list[PoseStamped] = []
    cell.node.create_subscription(PoseStamped, "left/target_frame", frames.append, qos.STREAM)
    cell.armed()
    result = conversion.result_from_message(cell.form(small_ring()))
    assert (result.completed, result.code) == (True, 0)
    assert cell.targets == 0
    assert {frame.header.frame_id for frame in frames} == {"sheet"}


def test_latency_is_measured(cell: Cell) -> None:
    cell.start()
    cell.armed()
    cell.form(small_ring())
    latency = np.array([state.latency for state in cell.states if state.mode == ForceCtrlState.CONTROL])
    assert latency.size
    assert np.isfinite(latency).all()
    assert (latency > 0.0).all()


def test_saturated_cell_holds_with_its_code(cell: Cell) -> None:
    cell.start({"saturated_at": 400})
    cell.armed()
    result = cell.form(small_ring())
    assert (result.completed, result.code) == (False, ErrorCode.WRENCH_OUT_OF_RANGE)
    assert "tool_2" in result.message or "tool_1" in result.message


@pytest.mark.clock
def test_a_fifth_of_the_wrenches_may_be_lost_in_real_time(cell: Cell) -> None:
    cell.start({"lockstep": False, "lost_share": 0.2}, lockstep=False)
    cell.armed()
    result = conversion.result_from_message(cell.form(small_ring()))
    assert (result.completed, result.code) == (True, 0)
    assert result.contact_fraction > 0.9


def test_contour_for_one_tool_is_answered(cell: Cell) -> None:
    cell.start()
    cell.armed()
    contour = replace(small_ring(), support_tip=np.empty((0, 3)), support_force=np.empty(0))
    result = cell.form(contour)
    assert (result.completed, result.code) == (False, ErrorCode.CONTOUR_REJECTED)
    assert "one tool only" in result.message
    assert cell.targets == 0


def test_a_sheet_that_there_is_not_is_refused(cell: Cell) -> None:
    cell.start()
    answer = cell.ask_to_arm(sheet="soft")
    assert answer.code == ErrorCode.FILE_FIELD
    assert "no simulated sheet 'soft' (known: fast, shell, shell_coarse, shell_fine)" in answer.message


def test_by_the_clock_no_sheet_raises_the_limits_of_the_machine(cell: Cell) -> None:
    cell.start(lockstep=False)
    answer = cell.ask_to_arm(sheet="shell_coarse")
    assert answer.code == ErrorCode.FILE_FIELD
    assert "leave it empty for a real machine" in answer.message


def test_a_support_force_that_nothing_holds_is_refused(cell: Cell) -> None:
    """As the job loader refuses it; 0 N is position control, which every process has."""
    cell.start()
    without = JOB.replace("support_force: 120 N, ", "")
    spif, adsif = (without.replace("process: DSIF", f"process: {name}") for name in ("SPIF", "ADSIF"))
    tpif = without.replace("process: DSIF", "process: TPIF") + "die: {mesh: die.stl, unit: mm}\n"
    blank = without.replace("path: {", "path: {support: on_blank, ")
    for job, why in (
        (spif, "process SPIF has no support tool"),
        (tpif, "process TPIF has no support tool"),
        (adsif, "process ADSIF has no force control"),
        (blank, "path.support on_blank has no force control"),
    ):
        answer = cell.ask_to_arm(support_force=80.0, job=job)
        assert answer.code == ErrorCode.FILE_FIELD
        assert answer.message.startswith(f"support_force: {why}: 80 N cannot be held (leave it out (-1), or use a job")
    cell.armed(support_force=0.0, job=spif)


def test_blank_holder_has_targets_in_tpif(cell: Cell) -> None:
    cell.start()
    heights: list[float] = []
    cell.node.create_subscription(
        PoseStamped, "holder/target", lambda message: heights.append(message.pose.position.z), qos.STREAM
    )
    job = JOB.replace("DSIF", "TPIF").replace("support_force: 120 N, ", "") + "die: {mesh: die.stl, unit: mm}\n"
    cell.armed(job=job)
    nothing = np.empty((0, 3))
    contour = replace(
        small_ring(), process=Process.TPIF, support_tip=nothing, support_force=np.empty(0), holder_height=1e-3
    )
    result = cell.form(contour)
    assert (result.completed, result.code) == (True, 0)
    assert cell.wait(lambda: heights and max(heights) > 0.0 and heights[-1] == 0.0)
    assert max(heights) == pytest.approx(1e-3)  # and down again when parked


def test_a_frozen_wrench_holds_with_its_code(cell: Cell) -> None:
    cell.start({"frozen_at": 600})
    cell.armed()
    result = cell.form(small_ring())
    assert (result.completed, result.code) == (False, ErrorCode.WRENCH_FROZEN)
    assert cell.rests_in(ForceCtrlState.HOLD)


def test_a_cell_with_the_wrong_sign_holds_with_its_code(cell: Cell) -> None:
    cell.start({"sign": -1.0})
    cell.armed()
    result = cell.form(small_ring())
    assert (result.completed, result.code) == (False, ErrorCode.LOAD_CELL_SIGN)
