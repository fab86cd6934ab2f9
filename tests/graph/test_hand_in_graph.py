"""An operator at a cell of real processes: modes, move_to, jog by messages and by joystick, work offsets, faults."""

from __future__ import annotations

import asyncio
import json
import math
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import forked_process
import numpy as np
import pytest
import rclpy
import yaml
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Point, PoseStamped, Vector3, WrenchStamped
from isf_cell import in_process
from isf_cell.processes.process_group import ProcessGroup
from isf_cell.run.graph_run import start_cell
from isf_core.errors import ErrorCode
from isf_core.files.job import JobFile
from isf_dashboard.server import TOKEN_VARIABLE, free_port, new_token
from isf_msgs.action import FormPart, MoveTo
from isf_msgs.msg import ContourResult, ExecutiveState, HandState, Jog
from isf_msgs.srv import CheckProgram, SetMode, SetZero
from isf_planner import exports, plan
from isf_planner.gcode.set_up import load_set_up
from isf_ros import qos
from isf_ros.conversion import wrench_array
from quick_cone import quick_cone
from rclpy.action import ActionClient
from sensor_msgs.msg import Joy
from std_srvs.srv import SetBool, Trigger
from tornado.httpclient import AsyncHTTPClient
from tornado.websocket import websocket_connect
from waiting import LIMIT, Waiting

pytestmark = [pytest.mark.graph, pytest.mark.usefixtures("forked_nodes")]

AUTOMATIC, MANUAL, SET_UP, SIMULATION = 0, 1, 2, 3
ENABLE = 4
"""Dead-man's button of a joystick, by the parameters of force_ctrl."""


class Operator:
    """The test's own node: calls by the interfaces of ROS alone, and what the cell tells."""

    group: ProcessGroup
    """The nodes of the cell."""

    def __init__(self, job: JobFile) -> None:
        self.job = job
        self.node = rclpy.create_node("operator")
        self._waiting = Waiting(self.node)
        self.wait = self._waiting.until
        self.states: list[ExecutiveState] = []
        self.hand: list[HandState] = []
        self.tips: list[tuple[float, float, float]] = []
        """m, of tool 1, as targets."""
        self.results: list[ContourResult] = []
        self.node.create_subscription(ExecutiveState, "executive/state", self.states.append, qos.CHANGES)
        self.node.create_subscription(HandState, "force_ctrl/hand", self.hand.append, qos.CHANGES)
        self.node.create_subscription(PoseStamped, "tool_1/target", self._on_target, qos.STREAM_SOURCE)
        self.node.create_subscription(ContourResult, "contour/result", self.results.append, qos.EVENT)
        self.heard: set[str] = set()
        self.heard_at: list[int] = []
        """One for every message of /diagnostics."""
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 50)
        self.jog = self.node.create_publisher(Jog, "jog", qos.STREAM)
        self.joy = self.node.create_publisher(Joy, "joy", 10)
        self.move = ActionClient(self.node, MoveTo, "move_to")
        self.part = ActionClient(self.node, FormPart, "form_part")
        self._clients = {
            kind: self.node.create_client(kind, f"executive/{name}")
            for kind, name in ((SetMode, "set_mode"), (SetZero, "zero"), (CheckProgram, "check_program"))
        }
        self.page = ""
        """Address of the dashboard."""

    def close(self) -> None:
        self.move.destroy()
        self.part.destroy()
        self._waiting.close()
        self.node.destroy_node()

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        self.heard_at.append(len(message.status))
        self.heard |= {status.name.rsplit("/", 1)[-1] for status in message.status}

    def _on_target(self, message: PoseStamped) -> None:
        place = message.pose.position
        self.tips.append((place.x, place.y, place.z))

    def call(self, request: Any) -> Any:
        """Response of the executive to ``request``."""
        client = next(one for kind, one in self._clients.items() if isinstance(request, kind.Request))
        assert self.wait(client.service_is_ready)
        asked = client.call_async(request)
        assert self.wait(asked.done, 3 * LIMIT)
        return asked.result()

    def set_mode(self, mode: int, **fields: Any) -> int:
        """Code of a change; the job goes with it."""
        request = SetMode.Request(mode=mode, job_text=self.job.text, base_folder=str(self.job.base), **fields)
        response = self.call(request)
        assert bool(response.code) == bool(response.message)
        return int(response.code)

    def manual(self) -> None:
        """In manual mode, where it is not."""
        if not (self.states and self.states[-1].mode == MANUAL and self.hand and self.hand[-1].armed):
            assert self.set_mode(MANUAL) == 0
            assert self.wait(lambda: self.hand and self.hand[-1].armed)
        self.wait(lambda: not self.hand[-1].client and not self.hand[-1].moving)

    def send(self, tool: int, place: tuple[float, float, float], speed: float = 30e-3, client: str = "") -> Any:
        """Handle of a goal to ``place`` mm."""
        assert self.wait(self.move.server_is_ready)
        x, y, z = (1e-3 * value for value in place)
        goal = MoveTo.Goal(tool=tool, position=Point(x=x, y=y, z=z), speed=speed, client=client)
        sent = self.move.send_goal_async(goal)
        assert self.wait(sent.done)
        assert sent.result().accepted
        return sent.result()

    def move_to(self, tool: int, place: tuple[float, float, float], speed: float = 30e-3) -> Any:
        """Result of a whole movement to ``place`` mm."""
        return self.result(self.send(tool, place, speed))

    def result(self, handle: Any) -> Any:
        """As soon as the state tells the same place: it comes by a topic of its own."""
        found = handle.get_result_async()
        assert self.wait(found.done)
        result = found.result().result
        assert result.code or self.wait(lambda: result.position in (self.hand[-1].tip_1, self.hand[-1].tip_2))
        return result

    def tip(self) -> np.ndarray:
        """(3,) mm, of tool 1 by the state of movement by hand."""
        place = self.hand[-1].tip_1
        return 1e3 * np.array([place.x, place.y, place.z])

    def press(
        self, until: Callable[[], Any], way: tuple[float, float, float], increment: float, client: str = "test"
    ) -> bool:
        """Hold a key (``way``, increment mm) until something holds; press it again when a busy computer lost it."""
        message = Jog(client=client, enable=True, tool=1, increment=1e-3 * increment)
        message.direction = Vector3(**dict(zip("xyz", map(float, way), strict=True)))

        def pressed() -> Any:
            if self.hand and self.hand[-1].code == ErrorCode.HAND_LOST:
                self.jog.publish(Jog(client=client, enable=False, tool=1))
            self.jog.publish(message)
            return until()

        return self.wait(pressed)

    def let_go(self, client: str = "test") -> None:
        self.jog.publish(Jog(client=client, enable=False, tool=1))
        assert self.wait(lambda: not self.hand[-1].moving and not self.hand[-1].client)

    def stick(self, until: Callable[[], Any], *axes: float, down: tuple[int, ...] = (ENABLE,)) -> bool:
        """Hold a joystick so until something holds."""
        message = Joy(axes=list(axes), buttons=[int(k in down) for k in range(8)])
        return self.wait(lambda: self.joy.publish(message) or until())

    def stands(self) -> np.ndarray:
        """(3,) mm, where tool 1 has come to rest."""
        assert self.wait(lambda: self.hand and not self.hand[-1].moving)
        return self.tip()


@pytest.fixture(scope="module")
def operator(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Operator]:
    """At one cell for all tests; its set-up file is in a folder of the test."""
    folder = tmp_path_factory.mktemp("hand")
    with pytest.MonkeyPatch.context() as patch, ProcessGroup(folder / "logs") as group:
        patch.setenv("ISF_CELLS", str(folder / "cells"))
        job = quick_cone("method: none")
        port, token = free_port(0), new_token()
        patch.setenv(TOKEN_VARIABLE, token)
        start_cell(group, None, lockstep=True, job_file=job)
        group.start("isf_dashboard", "dashboard", {"port": port}, outlives=True)
        rclpy.init()
        one = Operator(job)
        one.group = group
        one.page = f"127.0.0.1:{port}/{token}/"
        try:
            names = {node.name for node in group.nodes}  # on a busy computer they take a while to come up
            assert one.wait(lambda: one.states and names <= one.heard, 3 * LIMIT)
            yield one
        finally:
            one.close()
            rclpy.try_shutdown()


def test_nothing_moves_before_the_mode_is_manual(operator: Operator) -> None:
    assert operator.states[-1].mode == AUTOMATIC
    assert operator.call(SetZero.Request(system=54, tool=1)).code == ErrorCode.MODE_REFUSED
    assert operator.call(CheckProgram.Request(text="M30")).code == ErrorCode.MODE_REFUSED
    # set-up without a job: nobody knows yet what rig there is
    assert operator.call(SetMode.Request(mode=MANUAL)).code == ErrorCode.MODE_REFUSED
    assert operator.call(SetMode.Request(mode=9)).code == ErrorCode.MODE_REFUSED


def test_a_tool_goes_to_a_position_and_is_refused_where_it_must_not(operator: Operator) -> None:
    operator.manual()
    found = operator.move_to(1, (20.0, -10.0, 95.0))
    assert (found.code, found.message) == (0, "")
    np.testing.assert_allclose(operator.tip(), [20.0, -10.0, 95.0], atol=1e-6)
    assert operator.wait(lambda: np.allclose(operator.tips[-1], [20e-3, -10e-3, 95e-3], atol=1e-9))
    speed = 100.0 * np.linalg.norm(np.diff(operator.tips, axis=0), axis=1)  # the job's rate is 100 Hz
    assert speed.max() <= 30.1e-3
    before = operator.stands()
    for place, code in {
        (0.0, 0.0, -1.0): ErrorCode.MOVE_INTO_SHEET,
        (200.0, 0.0, 90.0): ErrorCode.MOVE_OUT_OF_REACH,
        (124.0, 0.0, 5.0): ErrorCode.MOVE_INTO_SHEET,
        (math.nan, 0.0, 90.0): ErrorCode.MOVE_OUT_OF_REACH,
    }.items():
        refused = operator.move_to(1, place)
        assert refused.code == code, refused
        assert refused.message
    assert operator.move_to(3, (0.0, 0.0, 90.0)).code == ErrorCode.MOVE_OUT_OF_REACH
    assert operator.move_to(2, (20.0, 0.0, -95.0)).code == 0  # the other tool stands meanwhile
    np.testing.assert_array_equal(operator.stands(), before)


def test_a_cancelled_move_stops_on_the_way(operator: Operator) -> None:
    operator.manual()
    begin = operator.stands()
    # slow: in lockstep an idle computer does a way of 2 s before the cancel has come
    handle = operator.send(1, (begin[0] - 60.0, begin[1], 95.0), 2e-3)
    assert operator.wait(lambda: operator.hand[-1].moving and operator.tip()[0] < begin[0] - 2.0)
    assert operator.wait(handle.cancel_goal_async().done)
    found = operator.result(handle)
    assert found.code == ErrorCode.STOPPED
    assert begin[0] - 60.0 < operator.stands()[0] < begin[0] - 2.0


def test_a_step_is_the_increment_and_a_held_key_is_one_step(operator: Operator) -> None:
    operator.manual()
    for way, increment in (((1, 0, 0), 0.01), ((0, -1, 0), 0.1), ((0, 0, 1), 1.0), ((-1, 0, 0), 10.0)):
        lost = True
        while lost:  # pressed again, a key that a busy computer lost is another step
            begin, seen = operator.stands(), len(operator.hand)
            assert operator.press(lambda seen=seen: any(one.moving for one in operator.hand[seen:]), way, increment)
            assert operator.press(lambda: not operator.hand[-1].moving, way, increment)
            since = len(operator.hand)
            assert operator.press(lambda since=since: len(operator.hand) > since + 3, way, increment)  # still held
            operator.let_go()
            lost = any(one.code == ErrorCode.HAND_LOST for one in operator.hand[seen:])
        np.testing.assert_allclose(operator.stands() - begin, increment * np.array(way, dtype=float), atol=1e-6)


def test_a_joystick_moves_nothing_without_its_button_and_stops_when_its_messages_do(operator: Operator) -> None:
    operator.manual()
    begin, since = operator.stands(), len(operator.hand)
    assert operator.stick(lambda: len(operator.hand) > since + 5, 0.0, -1.0, down=())
    np.testing.assert_array_equal(operator.stands(), begin)
    # one step of 1 mm along x for a deflection of axis 1, which is turned round
    seen = len(operator.hand)
    assert operator.stick(lambda: any(one.moving for one in operator.hand[seen:]), 0.0, -1.0)
    assert operator.stick(lambda: not operator.hand[-1].moving, 0.0, -1.0)
    np.testing.assert_allclose(operator.stands() - begin, [1.0, 0.0, 0.0], atol=1e-6)
    # twice the button for the larger increment: 10 mm, then as long as the stick is pushed
    for _ in range(2):
        for down in ((ENABLE, 1), (ENABLE,)):
            since = len(operator.hand)
            assert operator.stick(lambda since=since: len(operator.hand) > since + 1, 0.0, 0.0, down=down)
    begin = operator.stands()
    assert operator.stick(lambda: operator.tip()[0] < begin[0] - 1.0, 0.0, 1.0)
    # the stick says nothing any more: messages that were on their way for so long are refused before it is forgotten
    assert operator.wait(lambda: operator.hand[-1].code == ErrorCode.HAND_LOST and not operator.hand[-1].client)
    stood = operator.stands()
    assert begin[0] - 60.0 < stood[0] < begin[0] - 1.0  # a second of messages lost would be 10 mm
    # its messages come again, with the stick still pushed: not before it was let go
    since = len(operator.hand)
    assert operator.stick(lambda: len(operator.hand) > since + 5, 0.0, 1.0)
    np.testing.assert_array_equal(operator.stands(), stood)
    operator.stick(lambda: not operator.hand[-1].client, 0.0, 0.0, down=())


def test_two_clients_at_once(operator: Operator) -> None:
    operator.manual()
    begin = operator.stands()
    assert operator.press(lambda: operator.hand[-1].moving, (0, 1, 0), 0.0, "first")

    def other_refused() -> bool:
        second = Jog(client="second", enable=True, tool=2, direction=Vector3(x=1.0), increment=1e-3)
        operator.jog.publish(second)
        return any(one.code == ErrorCode.HAND_TAKEN for one in operator.hand[-20:])

    assert operator.press(other_refused, (0, 1, 0), 0.0, "first")
    assert operator.hand[-1].client == "first"
    assert operator.move_to(2, (0.0, 0.0, -80.0)).code == ErrorCode.HAND_TAKEN
    operator.let_go("first")
    assert operator.stands()[1] > begin[1]
    assert operator.move_to(2, (0.0, 0.0, -95.0)).code == 0


def test_a_client_that_is_lost_hands_its_movement_to_nobody(operator: Operator) -> None:
    """Another one is there already, with its button pressed: the tool stands, for it was not the one that moved it."""
    operator.manual()
    assert operator.move_to(1, (0.0, -40.0, 95.0)).code == 0
    assert operator.press(lambda: operator.hand[-1].moving, (0, 1, 0), 0.0, "first")
    since = len(operator.hand)

    def second_waits() -> bool:
        operator.jog.publish(Jog(client="second", enable=True, tool=1))
        return any(one.code == ErrorCode.HAND_LOST for one in operator.hand[since:]) and not operator.hand[-1].moving

    assert operator.wait(second_waits)
    assert any("'first'" in one.message for one in operator.hand[since:])
    assert operator.stands()[1] < 40.0  # the travel ends at 125 mm
    operator.let_go("second")


def test_a_movement_whose_button_is_let_go_did_not_get_there(operator: Operator) -> None:
    operator.manual()
    begin = operator.stands()
    handle = operator.send(1, (begin[0] + 60.0, begin[1], 95.0), 2e-3, client="program")
    pressed = Jog(client="program", enable=True, tool=1)
    assert operator.wait(lambda: operator.jog.publish(pressed) or operator.tip()[0] > begin[0] + 2.0)
    operator.jog.publish(Jog(client="program", enable=False, tool=1))
    found = operator.result(handle)
    assert found.code == ErrorCode.STOPPED
    assert "let go" in found.message
    assert begin[0] + 2.0 < operator.stands()[0] < begin[0] + 60.0


def test_a_killed_client_leaves_the_tool_standing(operator: Operator, tmp_path: Path) -> None:
    """The command isf move-to, as a process, in the middle of its movement."""
    operator.manual()
    assert operator.move_to(1, (60.0, 0.0, 95.0)).code == 0
    command = [sys.executable, "-m", "isf_cell.cli", "move-to", "-60", "0", "95", "--speed", "10"]
    client = forked_process.start(command, cwd=tmp_path, env=dict(os.environ))
    assert operator.wait(lambda: operator.tip()[0] < 58.0)
    client.send_signal(signal.SIGKILL)
    assert operator.wait(lambda: operator.hand[-1].code == ErrorCode.HAND_LOST)
    stood = operator.stands()
    assert -60.0 < stood[0] < 58.0
    assert "isf_" in operator.hand[-1].message
    assert operator.move_to(1, (0.0, 0.0, 95.0)).code == 0


@pytest.mark.clock  # 0.15 s of silence of the command are a fault, too, whatever kept it waiting
def test_a_force_ctrl_that_stood_still_itself_does_not_take_its_client_for_gone(
    operator: Operator, tmp_path: Path
) -> None:
    """The computer kept it waiting for 0.5 s, more than three times the silence that lets go."""
    operator.manual()
    assert operator.move_to(1, (40.0, 0.0, 95.0)).code == 0
    command = [sys.executable, "-m", "isf_cell.cli", "move-to", "0", "0", "95", "--speed", "10"]
    client = forked_process.start(command, cwd=tmp_path, env=dict(os.environ))
    assert operator.wait(lambda: operator.tip()[0] < 38.0)
    process = operator.group["force_ctrl"].popen
    os.killpg(process.pid, signal.SIGSTOP)
    time.sleep(0.5)  # the fault itself: it stands still for longer than the 0.15 s of silence that let go
    os.killpg(process.pid, signal.SIGCONT)
    assert client.wait(LIMIT) == 0
    assert operator.wait(lambda: np.allclose(operator.tip(), [0.0, 0.0, 95.0], atol=1e-6))


class Page:
    """A browser's side of the dashboard, in a thread of its own: holds a button until it is told to close."""

    def __init__(self, address: str, asked: dict[str, Any], then: str = "") -> None:
        self._address, self._asked, self._then, self._end = address, asked, then, threading.Event()
        self.answers: list[dict[str, Any]] = []
        self.failure: BaseException | None = None
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """As a browser that is closed: nothing is said."""
        self._end.set()
        self._thread.join(LIMIT)
        assert self.failure is None, self.failure

    def _run(self) -> None:
        try:
            asyncio.run(self._work())
        except BaseException as error:  # told by the test
            self.failure = error

    async def _work(self) -> None:
        socket = await websocket_connect(f"ws://{self._address}stream")
        while not self._end.is_set():
            await socket.write_message("{no words of a page}")
            await socket.write_message(json.dumps({"jog": self._asked}))
            await asyncio.sleep(0.05)  # the period of the page
        if self._then:
            url = f"http://{self._address}command/{self._then}"
            answer = await AsyncHTTPClient().fetch(url, method="POST", body="", raise_error=False)
            self.answers.append(json.loads(answer.body))
        socket.close()


def test_a_button_of_the_page_moves_the_tool_until_the_page_is_closed(operator: Operator) -> None:
    operator.manual()
    assert operator.move_to(1, (0.0, 0.0, 95.0), 60e-3).code == 0
    page = Page(operator.page, {"enable": True, "tool": 1, "way": [0, -1, 0], "increment": 0.1}, "zero_57_1")
    assert operator.wait(lambda: operator.hand[-1].client.startswith("page") and not operator.hand[-1].moving)
    assert operator.wait(lambda: np.allclose(operator.tip(), [0.0, -0.1, 95.0], atol=1e-6)), operator.tip()
    page.close()
    assert page.answers[0]["ok"], page.answers
    assert "G57 at" in page.answers[0]["text"]
    assert operator.wait(lambda: not operator.hand[-1].client)
    begin = operator.stands()
    page = Page(operator.page, {"enable": True, "tool": 1, "way": [1, 0, 0], "increment": 0})
    assert operator.wait(lambda: operator.tip()[0] > begin[0] + 1.0)
    page.close()
    assert operator.wait(lambda: operator.hand[-1].code == ErrorCode.HAND_LOST)
    assert operator.stands()[0] < 119.0  # the frame of the clamp, where it would have ended


def test_the_sheet_is_touched_by_hand(operator: Operator) -> None:
    operator.manual()
    # the last words of a page that was closed may still come, and have the tool for as long as they do
    codes = [int(ErrorCode.HAND_TAKEN)]
    above = (0.0, 0.0, 3.0)
    assert operator.wait(
        lambda: codes[-1] != ErrorCode.HAND_TAKEN or codes.append(operator.move_to(1, above, 60e-3).code)
    )
    assert codes[-1] == 0
    assert operator.press(lambda: operator.hand[-1].code == ErrorCode.TOUCHED, (0, 0, -1), 0.0)
    operator.let_go()
    assert -2.0 < operator.stands()[2] < 0.1
    # a work offset there: the tip then reads zero in G55
    response = operator.call(SetZero.Request(system=55, tool=1, axes="z"))
    assert response.code == 0
    assert response.offset.z == pytest.approx(1e-3 * operator.stands()[2], abs=5e-5)
    assert (response.offset.x, response.offset.y) == (0.0, 0.0)
    assert load_set_up(Path(response.file)).offset(55)[2] == pytest.approx(response.offset.z, abs=1e-7)
    assert operator.press(lambda: operator.tip()[2] > 5.0, (0, 0, 1), 0.0)
    operator.let_go()


def test_set_up_moves_nothing_and_sets_offsets(operator: Operator) -> None:
    operator.manual()
    assert operator.move_to(1, (12.5, -7.25, 50.0), 60e-3).code == 0
    assert operator.set_mode(SET_UP) == 0
    assert operator.wait(lambda: not operator.hand[-1].armed)
    assert operator.move_to(1, (0.0, 0.0, 95.0)).code == ErrorCode.NOT_ARMED
    response = operator.call(SetZero.Request(system=56, tool=1))
    assert response.code == 0, response.message
    np.testing.assert_allclose(
        [response.offset.x, response.offset.y, response.offset.z], [12.5e-3, -7.25e-3, 50e-3], atol=20e-6
    )
    told = operator.call(SetZero.Request(system=56, tool=1, axes="none"))
    assert told.offset.x == pytest.approx(response.offset.x, abs=1e-7)
    assert operator.call(SetZero.Request(system=53, tool=1)).code == ErrorCode.FILE_FIELD


def test_simulation_checks_a_program_with_the_stored_offsets(operator: Operator) -> None:
    assert operator.set_mode(SIMULATION) == 0
    assert operator.move_to(1, (0.0, 0.0, 95.0)).code == ErrorCode.NOT_ARMED
    assert operator.call(SetZero.Request(system=56, tool=1)).code == ErrorCode.MODE_REFUSED
    far = "G56 G90\nG0 X0 Y0 Z40\nG1 X120 Y0 Z40 F600\nM30\n"  # 132.5 mm of a travel of 125 mm, with the offset of G56
    found = operator.call(CheckProgram.Request(text=far, name="far.nc"))
    assert found.code == ErrorCode.PROGRAM_OUT_OF_REACH
    assert "far.nc:3" in found.message
    assert '"feasible": false' in found.report
    assert operator.call(CheckProgram.Request(text="G99 X1\n", name="x.nc")).code == ErrorCode.PROGRAM_WORD_UNKNOWN


@pytest.mark.parametrize("marked", ["in the job", "by M0 in its program", "by M0 after a lift"])
def test_a_part_waits_at_a_marked_contour_until_it_is_let_go_on(
    operator: Operator, marked: str, tmp_path: Path
) -> None:
    assert operator.set_mode(AUTOMATIC) == 0
    assert operator.wait(lambda: not operator.states[-1].changing)
    data = yaml.safe_load(operator.job.text)
    base = str(operator.job.base)
    if marked == "in the job":
        data["path"]["hold_after"] = [1]
    else:
        exports.export(plan(operator.job), tmp_path / "cone.nc")
        written = (tmp_path / "cone.nc").read_text()
        assert "(contour 2 of 3)" in written
        stop = "G0 Z20 W-20\nM0 (measure)" if "lift" in marked else "M0 (measure)"
        (tmp_path / "cone.nc").write_text(written.replace("(contour 2 of 3)", stop))
        del data["part"]
        data["path"] = {"program": "cone.nc"}
        data["control"]["support_force"] = "0 N"
        base = str(tmp_path)
    client = operator.node.create_client(Trigger, "executive/go_on")

    def go_on() -> bool:
        asked = client.call_async(Trigger.Request())
        assert operator.wait(asked.done)
        return bool(asked.result().success)

    wrenches: list[tuple[float, ...]] = []

    def on_wrench(message: WrenchStamped) -> None:
        wrenches.append(wrench_array(message))

    operator.node.create_subscription(WrenchStamped, "tool_1/wrench", on_wrench, qos.STREAM)
    assert operator.wait(client.service_is_ready)
    assert not go_on(), "nothing waits"
    operator.results.clear()
    operator.tips.clear()
    goal = FormPart.Goal(job_text=yaml.safe_dump(data), base_folder=base, support_force=math.nan)
    sent = operator.part.send_goal_async(goal)
    assert operator.wait(sent.done)
    assert operator.wait(lambda: operator.states[-1].waits_for, 3 * LIMIT)
    assert operator.states[-1].paused
    seen = len(operator.heard_at)
    assert operator.wait(lambda: len(operator.heard_at) > seen + 20)  # the cell lives on meanwhile
    assert [result.index for result in operator.results] == [0]
    pressed, end = wrenches[-1][2], operator.results[0].forming_target[:3]
    if "lift" in marked:
        assert abs(pressed) < 2.0  # N, noise and steps of the load cell
        assert operator.tips[-1] == pytest.approx((*end[:2], 0.1), abs=0.2e-3)  # park height of the rig
    else:
        assert pressed > 50.0
        assert operator.tips[-1] == pytest.approx(end, abs=0.2e-3)
    lifts = len(operator.tips)
    pausing = operator.node.create_client(SetBool, "executive/pause")
    assert operator.wait(pausing.service_is_ready)

    def pause(wanted: bool) -> None:
        asked = pausing.call_async(SetBool.Request(data=wanted))
        assert operator.wait(asked.done)
        assert asked.result().success

    pause(True)
    assert operator.wait(lambda: operator.states[-1].paused)
    assert operator.states[-1].waits_for  # an operator's pause is no end of the hold, and the hold's end none of it
    assert go_on()
    assert operator.wait(lambda: not operator.states[-1].waits_for)
    assert operator.states[-1].paused
    seen = len(operator.heard_at)
    assert operator.wait(lambda: len(operator.heard_at) > seen + 20)
    assert [result.index for result in operator.results] == [0]
    pause(False)
    done = sent.result().get_result_async()
    assert operator.wait(done.done, 3 * LIMIT)
    assert done.result().result.code == 0
    assert operator.wait(lambda: [result.index for result in operator.results] == [0, 1, 2])
    assert not operator.states[-1].waits_for
    deepest = min(operator.results[1].forming_target[2::3])
    assert min(tip[2] for tip in operator.tips[lifts:]) <= deepest  # down again
    # the same in one process, which does not wait: a lift that the graph made elsewhere would show in the forces
    here = in_process.form(JobFile(goal.job_text, Path(base))).results
    for mine, theirs in zip(here, operator.results, strict=True):
        np.testing.assert_allclose(np.reshape(theirs.forming_target, (-1, 3)), mine.forming_target, atol=1e-6)
        np.testing.assert_allclose(np.reshape(theirs.forming_force, (-1, 3)), mine.forming_force, atol=0.1)


def test_a_part_needs_automatic_and_keeps_the_mode_until_its_end(operator: Operator) -> None:
    operator.manual()
    goal = FormPart.Goal(job_text=operator.job.text, base_folder=str(operator.job.base), support_force=math.nan)
    sent = operator.part.send_goal_async(goal)
    assert operator.wait(sent.done)
    refused = operator.result(sent.result())
    assert refused.code == ErrorCode.MODE_REFUSED
    assert "automatic" in refused.message
    assert operator.set_mode(AUTOMATIC) == 0
    assert operator.wait(lambda: operator.states[-1].mode == AUTOMATIC and not operator.states[-1].changing)
    operator.results.clear()
    sent = operator.part.send_goal_async(goal)
    assert operator.wait(sent.done)
    assert operator.wait(
        lambda: operator.results and operator.states[-1].busy, 3 * LIMIT
    )  # the first contour is formed
    assert operator.set_mode(MANUAL) == ErrorCode.MODE_REFUSED
    assert operator.set_mode(SIMULATION) == ErrorCode.MODE_REFUSED
    assert operator.move_to(1, (0.0, 0.0, 95.0)).code == ErrorCode.NOT_ARMED
    done = sent.result().get_result_async()
    assert operator.wait(done.done, 3 * LIMIT)
    assert done.result().result.code == 0
    assert operator.wait(lambda: not operator.states[-1].busy)
    # with the formed sheet in the clamp: the lower tool stays below what was formed
    operator.manual()
    deepest = -1e3 * min(operator.results[-1].forming_target[2::3])
    refused = operator.move_to(2, (0.0, 0.0, -deepest - 0.5))
    assert refused.code == ErrorCode.MOVE_INTO_SHEET
    assert operator.set_mode(AUTOMATIC) == 0
