"""``isf cell``: real processes that stay up for other commands, and end with tools lifted or when a node dies."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from threading import Thread

import forked_process
import numpy as np
import pytest
import rclpy
import yaml
from geometry_msgs.msg import PoseStamped
from isf_cell.commands.exit_codes import Exit
from isf_cell.run.hand_client import HandClient
from isf_cell.run.operator_modes import OperatorMode
from isf_core.errors import ErrorCode, IsfError
from isf_msgs.msg import ContourResult, HandState
from isf_ros import qos
from quick_cone import CONTOURS, quick_cone_file
from rclpy.executors import SingleThreadedExecutor
from sensor_msgs.msg import Joy
from standing_cell import alive, isf, standing
from waiting import LIMIT, Waiting

pytestmark = pytest.mark.graph

MANUAL = int(OperatorMode.MANUAL)
ENABLE, LARGER = 4, 1
"""Buttons of a gamepad, by the parameters of force_ctrl."""


def test_a_cell_stays_for_other_commands_and_ends_with_tools_lifted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ISF_CELLS", str(tmp_path / "cells"))
    job = str(quick_cone_file(tmp_path))
    with standing(tmp_path, job) as (cell, told):
        names = {"machine", "planner", "springback", "force_ctrl", "executive", "cell_state_publisher"}
        assert set(told["nodes"]) == names
        assert isf(tmp_path, "mode") == {"mode": "automatic"}
        isf(tmp_path, "mode", "manual")  # the job is that of the cell
        assert isf(tmp_path, "mode") == {"mode": "manual"}, "the newest of the states that are kept"
        isf(tmp_path, "move-to", "5", "-5", "95", "--speed", "60")
        assert isf(tmp_path, "jog", "-z")["position_mm"] == pytest.approx([5.0, -5.0, 94.0], abs=1e-3)
        assert isf(tmp_path, "zero", "G55")["origin_mm"] == pytest.approx([5.0, -5.0, 94.0], abs=0.1)
        isf(tmp_path, "mode", "automatic")
        second = forked_process.run([sys.executable, "-m", "isf_cell.cli", "form", job], cwd=tmp_path)
        assert second.returncode == Exit.CELL
        assert "--attach" in second.stderr

        marked = yaml.safe_load(Path(job).read_text())
        marked["path"]["hold_after"] = [1]
        (tmp_path / "marked.yaml").write_text(yaml.safe_dump(marked))
        command = [
            sys.executable,
            "-m",
            "isf_cell.cli",
            "form",
            "marked.yaml",
            "--attach",
            "--no-compare",
            "-o",
            "part",
        ]
        forming = forked_process.start(
            [*command, "--json"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, cwd=tmp_path, text=True
        )
        assert forming.stderr is not None
        said = ""
        for line in forming.stderr:
            said += line
            if "isf go-on" in line:
                break
        assert "1006 FILE_OUTSIDE" in said, "the folder is not below runs"
        assert "waits after contour 1" in line
        assert isf(tmp_path, "go-on") == {"paused": False, "message": "going on"}
        words, _ = forming.communicate(timeout=LIMIT)
        formed = json.loads(words)
        assert formed["complete"]
        assert formed["contours"] == CONTOURS
        assert np.loadtxt(tmp_path / "part" / "operator_log.txt").shape[1] == 12

        rclpy.init()
        node = rclpy.create_node("looker")
        waiting = Waiting(node)
        heights: list[float] = []
        results: list[ContourResult] = []
        node.create_subscription(
            PoseStamped, "tool_1/pose", lambda message: heights.append(message.pose.position.z), qos.SENSOR
        )
        node.create_subscription(ContourResult, "contour/result", results.append, qos.EVENT)
        try:
            another = forked_process.start(
                [sys.executable, "-m", "isf_cell.cli", "form", job, "--attach", "--no-compare", "-o", "second"],
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
                cwd=tmp_path,
                env=dict(os.environ),
                text=True,
            )
            assert waiting.until(lambda: results and heights and heights[-1] < -1e-3, 3 * LIMIT)
            cell.send_signal(signal.SIGINT)
            assert waiting.until(lambda: cell.poll() is not None)
        finally:
            waiting.close()
            node.destroy_node()
            rclpy.try_shutdown()
        _, words = another.communicate(timeout=LIMIT)
    assert cell.poll() == Exit.OK, (tmp_path / "stderr.txt").read_text()
    assert heights[-1] > 0.0, "off the sheet"
    assert not [name for name, process in told["nodes"].items() if alive(process)]
    # a busy computer does not tell the part's end before the executive's
    assert another.poll() in (Exit.CANCELLED, Exit.CELL), words


@pytest.mark.clock
def test_tools_are_moved_by_hand_by_the_clock(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ISF_CELLS", str(tmp_path / "cells"))
    job = quick_cone_file(tmp_path)
    with standing(tmp_path, str(job), "--real-time"):
        with HandClient() as client:
            client.set_mode(MANUAL)
            there = client.move_to(1, (20e-3, -10e-3, 95e-3), 60e-3, lambda _: None)
            assert there == pytest.approx((20e-3, -10e-3, 95e-3), abs=1e-9)
            with pytest.raises(IsfError) as refused:
                client.move_to(1, (0.0, 0.0, -5e-3), 60e-3, lambda _: None)
            assert refused.value.code == ErrorCode.MOVE_INTO_SHEET
            for way in ((1.0, 0.0, 0.0), (0.0, 0.0, -1.0), (1.0, 0.0, 0.0)):  # what was refused is not told of these
                client.step(1, way, 1e-3, 10e-3)
            assert client.hand is not None
            tip = client.hand.tip_1
            assert (tip.x, tip.y, tip.z) == pytest.approx((22e-3, -10e-3, 94e-3), abs=1e-9)

        rclpy.init()
        node = rclpy.create_node("looker")
        waiting = Waiting(node)
        hand: list[HandState] = []
        node.create_subscription(HandState, "force_ctrl/hand", hand.append, qos.CHANGES)
        command = [sys.executable, "-m", "isf_cell.cli", "move-to", "-90", "-10", "94", "--speed", "10"]
        moved = forked_process.start(command, cwd=tmp_path, env=dict(os.environ))
        try:
            # what came before is told first: the movement at the beginning was above this one
            assert waiting.until(
                lambda: hand and hand[-1].moving and hand[-1].tip_1.x < 20e-3 and hand[-1].tip_1.z < 94.5e-3
            )
            moved.send_signal(signal.SIGKILL)
            assert waiting.until(lambda: hand[-1].code == ErrorCode.HAND_LOST and not hand[-1].moving)
        finally:
            waiting.close()
            node.destroy_node()
            rclpy.try_shutdown()
        assert -90e-3 < hand[-1].tip_1.x < 20e-3


class Gamepad:
    """A publisher of ``sensor_msgs/Joy`` in a thread of its own: 25 messages per second, as of ``joy_node``."""

    def __init__(self) -> None:
        self._node = rclpy.create_node("gamepad")
        self._joy = self._node.create_publisher(Joy, "joy", 10)
        self._timer = self._node.create_timer(0.04, self._repeat)
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self._node)
        self._thread = Thread(target=self._executor.spin, daemon=True)
        self._thread.start()
        self.axes, self.buttons, self.silent = (0.0, 0.0), frozenset[int](), False
        self.sent = 0

    def _repeat(self) -> None:
        if not self.silent:
            self._joy.publish(Joy(axes=list(self.axes), buttons=[int(k in self.buttons) for k in range(8)]))
            self.sent += 1

    def close(self) -> None:
        self._executor.shutdown()
        self._thread.join()
        self._node.destroy_node()


@pytest.mark.clock
def test_a_gamepad_moves_a_tool_by_the_clock_while_its_dead_mans_button_is_held(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At 10 mm/s a tool that went on for a second after the button is let go would be 10 mm farther."""
    monkeypatch.setenv("ISF_CELLS", str(tmp_path / "cells"))
    with standing(tmp_path, str(quick_cone_file(tmp_path)), "--real-time"):
        isf(tmp_path, "mode", "manual")
        rclpy.init()
        node = rclpy.create_node("looker")
        waiting = Waiting(node)
        hand: list[HandState] = []
        node.create_subscription(HandState, "force_ctrl/hand", hand.append, qos.CHANGES)
        pad = Gamepad()

        def goes() -> bool:
            return hand[-1].moving and hand[-1].client == "joy"

        def heard(count: int) -> bool:
            wanted = pad.sent + count
            return waiting.until(lambda: pad.sent > wanted)

        def pushed_past(limit: float) -> bool:
            """Push the stick until the tool is beyond. A computer that keeps the pad waiting for longer than a lost one
            is waited for is told so: let go, and push anew, as the message says."""
            deadline = time.monotonic() + LIMIT
            while time.monotonic() < deadline:
                pad.axes, pad.buttons = (0.0, 0.0), frozenset({ENABLE})
                assert heard(5)
                pad.axes = (0.0, 1.0)
                assert waiting.until(goes)
                assert waiting.until(lambda: not goes() or hand[-1].tip_1.x < limit)
                if goes():
                    return True
                assert hand[-1].code == ErrorCode.HAND_LOST, hand[-1]
            return False

        try:
            assert waiting.until(lambda: hand and hand[-1].armed)
            pad.axes, pad.buttons = (0.0, 1.0), frozenset({ENABLE})
            assert waiting.until(goes), "found by force_ctrl"
            pad.buttons = frozenset()
            assert waiting.until(lambda: not hand[-1].moving)
            begin = hand[-1].tip_1.x
            hand[:-1] = []
            assert heard(25)
            assert not any(one.moving for one in hand), "without the button"
            pad.axes, pad.buttons = (0.0, 0.0), frozenset({ENABLE})
            assert heard(5)
            for buttons in ({ENABLE, LARGER}, {ENABLE}) * 2:  # 10 mm, then as long as the stick is pushed
                pad.buttons = frozenset(buttons)
                assert heard(5)
            assert pushed_past(begin - 2e-3)
            pad.buttons = frozenset()  # the stick is pushed still
            let_go = hand[-1].tip_1.x
            assert waiting.until(lambda: not hand[-1].moving)
            assert hand[-1].code == ErrorCode.OK
            assert let_go - 10e-3 < hand[-1].tip_1.x < begin - 2e-3

            assert pushed_past(hand[-1].tip_1.x - 2e-3)
            pad.silent, lost = True, hand[-1].tip_1.x
            assert waiting.until(lambda: hand[-1].code == ErrorCode.HAND_LOST and not hand[-1].moving)
            assert hand[-1].tip_1.x > lost - 10e-3
        finally:
            pad.close()
            waiting.close()
            node.destroy_node()
            rclpy.try_shutdown()


def test_a_cell_whose_node_dies_ends_and_says_which(tmp_path: Path) -> None:
    with standing(tmp_path, "--rig", "ren2018", "--real-time") as (cell, told):
        os.kill(told["nodes"]["planner"], signal.SIGKILL)
        assert cell.wait(LIMIT) == Exit.CELL
    words = (tmp_path / "stderr.txt").read_text()
    assert "1502 NODE_DIED" in words
    assert "'planner' was ended by SIGKILL" in words
    assert not [name for name, process in told["nodes"].items() if alive(process)]


def test_what_no_cell_can_be_made_of_is_refused_before_anything_starts(tmp_path: Path) -> None:
    job = str(quick_cone_file(tmp_path))
    for arguments, code in (
        (("cell", "nothing.yaml"), Exit.INPUT),
        (("cell", "--rig", "nothing"), Exit.INPUT),
        (("cell", job, "--rig", "ren2018"), Exit.INPUT),
        (("form", job, "--attach", "--real-time"), Exit.USAGE),
    ):
        done = forked_process.run([sys.executable, "-m", "isf_cell.cli", *arguments], cwd=tmp_path)
        assert done.returncode == code, done.stderr
    assert not (tmp_path / "runs").exists()
