"""The simulated machine as hardware of ros2_control, under a stand-in of controller_manager; all in processes.

What the stand-in does is said in tests/standin_controller_manager.py; it takes description and parameter file as the
real one does. The chain is force_ctrl - trajectory controllers - hardware component - machine.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import forked_process
import numpy as np
import pytest
import rclpy
from action_msgs.msg import GoalStatus
from geometry_msgs.msg import PoseStamped
from isf_cell.processes.process_group import ProcessGroup
from isf_core.errors import ErrorCode
from isf_core.files.job import JobFile
from isf_core.files.rig import load_rig
from isf_description.cell import describe
from isf_description.ros2_control import ControlBlock, controllers
from isf_msgs.action import FormPart
from isf_msgs.msg import ContourResult, MachineState
from isf_ros import qos
from isf_ros.conversion import result_from_message
from quick_cone import quick_cone
from rclpy.action import ActionClient
from sensor_msgs.msg import JointState
from waiting import Waiting

pytestmark = [pytest.mark.graph, pytest.mark.clock, pytest.mark.usefixtures("forked_nodes")]

RATES = {"ren2018": 100.0, "kr210_pair": 200.0}
"""Hz; the servos of the arms are too slow for the force loop at 100 Hz."""
QUICK = {"acceleration": 2.0, "seam_speed": 1.0}
STANDIN = str(Path(__file__).resolve().parents[1] / "standin_controller_manager.py")
SQUEEZED = 60.0
"""N"""


class Cell:
    """One that asks for a part and sees how it goes; ``manager``: the stand-in."""

    manager: forked_process.Process

    def __init__(self) -> None:
        self.node = rclpy.create_node("observer")
        self._waiting = Waiting(self.node)
        self.wait = self._waiting.until
        self.results: list[Any] = []
        self.poses: list[PoseStamped] = []
        self.joints: list[JointState] = []
        self.told: list[JointState] = []
        self.states: list[MachineState] = []
        self.node.create_subscription(
            ContourResult, "contour/result", lambda m: self.results.append(result_from_message(m)), qos.EVENT
        )
        self.node.create_subscription(PoseStamped, "tool_1/pose", self.poses.append, qos.SENSOR)
        self.node.create_subscription(MachineState, "machine/state", self.states.append, qos.STREAM)
        self.node.create_subscription(JointState, "machine/joint_commands", self.joints.append, qos.STREAM)
        self.node.create_subscription(JointState, "joint_state_broadcaster/joint_states", self.told.append, 10)
        self._action = ActionClient(self.node, FormPart, "form_part")

    def close(self) -> None:
        self._action.destroy()
        self._waiting.close()
        self.node.destroy_node()

    def form(self, job: JobFile) -> Any:
        assert self.wait(self._action.server_is_ready)
        goal = FormPart.Goal(job_text=job.text, base_folder=str(job.base))
        sent = self._action.send_goal_async(goal)
        assert self.wait(sent.done)
        assert sent.result().accepted
        result = sent.result().get_result_async()
        assert self.wait(result.done)
        assert result.result().status in (GoalStatus.STATUS_SUCCEEDED, GoalStatus.STATUS_ABORTED)
        return result.result().result


def near_rig(folder: Path, name: str) -> Path:
    """The rig with its tools parked near the sheet."""
    path = folder / f"{name}.yaml"
    provenance = "provenance: {park_height: assumed}"
    path.write_text(f"based_on: {name}\nname: near\npark_height: 25 mm\n{provenance}\n", encoding="utf-8")
    return path


def tiny_part(rig: Path, rate: float) -> JobFile:
    """The small cone in two quick contours."""
    text = quick_cone("method: none", step="2.5 mm").text
    for old, new in {
        "feed: 20 mm/s": "feed: 80 mm/s",
        "rig: ren2018": f"rig: {rig}",
        "rate: 100 Hz": f"rate: {rate:g} Hz",
        "support_force: 120 N": f"support_force: {SQUEEZED:g} N",
    }.items():
        assert old in text
        text = text.replace(old, new)
    return JobFile(text, quick_cone().base)


@contextmanager
def under_ros2_control(folder: Path, rig: Path, rate: float) -> Iterator[Cell]:
    known = load_rig(str(rig))
    block = ControlBlock.of(known, describe(known), 5e-3)
    file = folder / "controllers.yaml"
    file.write_text(controllers(block.tools, rate), encoding="utf-8")
    rclpy.init()
    cell = Cell()
    try:
        with ProcessGroup(folder / "logs") as group:
            group.start("isf_sim", "machine", {"lockstep": False, "follow": "joints"})
            group.start("isf_planner", "planner", {})
            group.start("isf_springback", "springback", {})
            output = {"output": "joint_trajectory", "described_joints": True}
            group.start("isf_force_ctrl", "force_ctrl", {"lockstep": False, **output, **QUICK})
            group.start("isf_cell", "executive", {"lockstep": False})
            viewer = {"autostart": True, "lockstep": False, "rig": str(rig), "ros2_control": True}
            group.start("isf_description", "cell_state_publisher", viewer)
            with forked_process.node(STANDIN, controllers=str(file)) as cell.manager:
                # a controller that starts when targets move already begins elsewhere, and the part ends with 1402
                assert cell.wait(lambda: cell.told and cell.joints)
                yield cell
    finally:
        cell.close()
        rclpy.try_shutdown()


@pytest.mark.parametrize("name", ["ren2018", pytest.param("kr210_pair", marks=pytest.mark.slow)])
def test_a_part_is_formed_through_the_controllers(tmp_path: Path, name: str) -> None:
    rig = near_rig(tmp_path, name)
    with under_ros2_control(tmp_path, rig, RATES[name]) as cell:
        result = cell.form(tiny_part(rig, RATES[name]))
        assert (result.code, result.message) == (0, ""), result.message
        assert len(cell.results) == result.contours == 2
        forces = np.concatenate([item.tick_normal_force[item.tick_engaged] for item in cell.results])
        # the joints of two arms in three processes, 200 times a second, come late on a busy computer
        assert forces.mean() == pytest.approx(SQUEEZED, abs=10.0 if name == "ren2018" else 25.0)
        deepest = min(pose.pose.position.z for pose in cell.poses)
        assert -7e-3 < deepest < -4.5e-3  # the cone is 5 mm deep
        parked = np.array(list(cell.joints[-1].position))
        assert cell.wait(lambda: np.allclose(cell.told[-1].position, parked, atol=1e-4))
        names = [f"tool_{k}_{axis}" for k in (1, 2) for axis in ("xyz" if name == "ren2018" else ARM_JOINTS)]
        assert list(cell.told[-1].name) == names
        if name == "ren2018":  # by hand: joints are coordinates of the tips
            np.testing.assert_allclose(parked, [0.0, 0.0, 25e-3, 0.0, 0.0, -25e-3], atol=20e-6)


ARM_JOINTS = ("A1", "A2", "A3", "A4", "A5", "A6")


def test_a_controller_manager_that_ends_in_mid_part_ends_the_part(tmp_path: Path) -> None:
    rig = near_rig(tmp_path, "ren2018")
    with under_ros2_control(tmp_path, rig, 100.0) as cell:

        def on_sheet(message: PoseStamped) -> None:
            if message.pose.position.z < -2e-3:
                cell.manager.kill()

        cell.node.create_subscription(PoseStamped, "tool_1/pose", on_sheet, qos.SENSOR)
        result = cell.form(tiny_part(rig, 100.0))
        assert result.code != 0
        lost = cell.wait(lambda: any(ErrorCode.TARGET_LOST in state.fault_codes for state in cell.states))
        assert lost, result.message
