"""``isf play`` in a process of its own, heard over real DDS: the messages that were recorded, latched ones first."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import forked_process
import pytest
import rclpy
from isf_analysis.bag import playback
from isf_analysis.bag.bag_writer import write_bag
from isf_analysis.bag.open_bag import open_bag
from isf_analysis.bag.playback import Recorded
from isf_cell.commands.exit_codes import Exit
from isf_cell.commands.play import PlayOptions, play_bag
from isf_cell.run.player import ReadAhead
from isf_core.errors import ErrorCode, IsfError
from isf_msgs.msg import Contour, ContourResult, JobInfo
from isf_ros import qos
from rclpy.node import Node
from rclpy.serialization import deserialize_message
from rosgraph_msgs.msg import Clock
from std_srvs.srv import SetBool, Trigger
from synthetic_part import make_part

CONTOURS = 4
PART = replace(make_part(contours=CONTOURS, spacing=10e-3, points=12), wall_time=1.5)


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_bag(PART, tmp_path_factory.mktemp("played") / "bag", end=1_000_000_000_000)


def test_messages_come_in_the_order_of_receipt(bag: Path) -> None:
    with open_bag(bag) as found:
        played = list(playback.in_order(found, found.connections))
        assert [item.time for item in played] == sorted(item.time for item in played)
        assert len(played) == found.message_count
        begin = playback.begin_of_contour(found, 2)
        assert all(item.time >= begin for item in playback.in_order(found, found.connections, begin))
        before = {item.connection.topic for item in playback.latched_before(found, found.connections, begin)}
        assert before == {"/part/info", "/part/target", "/contour/nominal", "/contour/corrected"}
        with pytest.raises(IsfError, match=r"contours 1 to 4") as caught:
            playback.begin_of_contour(found, 9)
        assert caught.value.code == ErrorCode.BAG_INCOMPLETE


@pytest.mark.parametrize(
    ("changes", "code"),
    [
        ({"rate": 0.0}, ErrorCode.FILE_FIELD),
        ({"clock": -5.0}, ErrorCode.FILE_FIELD),
        ({"clock": float("nan")}, ErrorCode.FILE_FIELD),
        ({"delay": float("inf")}, ErrorCode.FILE_FIELD),
        ({"topics": ("nothing",)}, ErrorCode.FILE_FIELD),
        ({"remap": ("a=b",)}, ErrorCode.FILE_FIELD),
        ({"contour": 99}, ErrorCode.BAG_INCOMPLETE),
    ],
)
def test_what_cannot_be_played_is_refused(changes: dict[str, Any], code: ErrorCode, bag: Path) -> None:
    with pytest.raises(IsfError) as caught:
        play_bag(bag, replace(PlayOptions(1.0, None, (), (), 0.0, False, 0.0), **changes), as_json=False)
    assert caught.value.code == code


def test_what_is_read_ahead_is_bounded_by_its_bytes(bag: Path) -> None:
    """Messages of 10 MB: six are held, and one is under way."""
    with open_bag(bag) as found:
        connection = found.connections[0]
    produced, enough, most = 0, threading.Event(), 0

    def large() -> Iterator[Recorded]:
        nonlocal produced
        for number in range(20):
            produced += 1
            if produced == 7:
                enough.set()
            yield Recorded(number, connection, bytes(10_000_000))

    with ReadAhead(large()) as ahead:
        taken = [next(ahead).time]
        assert enough.wait(120)
        for message in ahead:
            most = max(most, produced - len(taken))
            taken.append(message.time)
    assert taken == list(range(20))
    assert most <= 8

    def damaged() -> Iterator[Recorded]:
        yield Recorded(0, connection, b"")
        raise ValueError("damaged")

    with ReadAhead(damaged()) as ahead:
        assert next(ahead).time == 0
        with pytest.raises(ValueError, match="damaged"):
            next(ahead)
    with ReadAhead(large()) as ahead:  # given up in the middle: the thread ends
        next(ahead)
    assert "bag reader" not in {thread.name for thread in threading.enumerate()}


@pytest.mark.graph
def test_a_bag_is_heard_as_it_was_recorded(bag: Path) -> None:
    """From the third contour, paused, one step, then the rest; results under another name; the clock besides."""
    command = [sys.executable, "-m", "isf_cell.cli", "play", str(bag), "--from", "3", "--paused", "--rate", "2"]
    command += ["-r", "contour/result:=again/result", "--clock", "50", "--delay", "0", "--json"]
    with listening() as node:
        _hear(node, bag, command)


@pytest.mark.graph
def test_an_operator_need_not_wait_for_a_message_that_is_due_in_centuries(bag: Path) -> None:
    command = [sys.executable, "-m", "isf_cell.cli", "play", str(bag), "--from", "3", "--rate", "1e-12", "--delay", "0"]
    with listening() as node:
        heard: list[Any] = []
        node.create_subscription(ContourResult, "contour/result", heard.append, qos.EVENT)
        pause, step = node.create_client(SetBool, "player/pause"), node.create_client(Trigger, "player/step")
        process = forked_process.start(command, stderr=subprocess.PIPE, text=True)

        def ended() -> bool:
            return process.poll() is not None

        try:
            spin_until(node, lambda: pause.service_is_ready() and step.service_is_ready())
            asked = pause.call_async(SetBool.Request(data=True))
            spin_until(node, asked.done)
            while not ended():
                asked = step.call_async(Trigger.Request())
                spin_until(node, lambda: asked.done() or ended())  # noqa: B023 - called in this turn alone
                assert ended() or asked.result().success
            assert process.poll() == 0
            spin_until(node, lambda: [result.index for result in heard][-2:] == [2, 3])
        finally:
            process.kill()
            process.wait(60)


@pytest.mark.graph
def test_ctrl_c_is_told(bag: Path) -> None:
    command = [sys.executable, "-m", "isf_cell.cli", "play", str(bag), "--paused", "--json"]
    with listening() as node:
        pause = node.create_client(SetBool, "player/pause")
        process = forked_process.start(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        spin_until(node, pause.service_is_ready)
        process.send_signal(signal.SIGINT)
        told, errors = process.communicate(60)
    assert process.poll() == 130, errors
    assert json.loads(told)["error"]["code"] == ErrorCode.CANCELLED


@contextmanager
def listening() -> Iterator[Node]:
    rclpy.init()
    node = rclpy.create_node("listener")
    try:
        yield node
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


def spin_until(node: Node, condition: Callable[[], bool], told: Callable[[], object] = lambda: "") -> None:
    deadline = time.monotonic() + 120
    while not condition():
        rclpy.spin_once(node, timeout_sec=0.1)
        assert time.monotonic() < deadline, told()


def _hear(node: Node, bag: Path, command: list[str]) -> None:
    heard: dict[str, list[bytes]] = {name: [] for name in ("info", "nominal", "result", "clock")}
    kinds = {
        "info": (JobInfo, "/part/info", qos.LATCHED),
        "nominal": (Contour, "/contour/nominal", qos.LATCHED),
        "result": (ContourResult, "/again/result", qos.EVENT),
        "clock": (Clock, "/clock", qos.SENSOR),
    }
    for name, (kind, topic, profile) in kinds.items():
        node.create_subscription(kind, topic, heard[name].append, profile, raw=True)
    pause, step = node.create_client(SetBool, "player/pause"), node.create_client(Trigger, "player/step")
    process = forked_process.start(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)

    def until(condition: Callable[[], bool]) -> None:
        def found() -> bool:
            assert process.poll() in (None, 0), process.communicate(10)
            return condition()

        spin_until(node, found, lambda: {name: len(items) for name, items in heard.items()})

    def last_index(name: str) -> int:
        return int(deserialize_message(heard[name][-1], kinds[name][0]).index) if heard[name] else -1

    try:
        until(
            lambda: pause.service_is_ready() and step.service_is_ready() and node.count_publishers("/again/result") > 0
        )
        until(lambda: bool(heard["info"] and heard["nominal"]))  # latched before the third contour, while it waits
        assert deserialize_message(heard["nominal"][0], Contour).index == 1
        assert not heard["result"]
        stepped = step.call_async(Trigger.Request())
        until(stepped.done)
        assert stepped.result().success
        going = pause.call_async(SetBool.Request(data=False))
        until(going.done)
        until(lambda: all(last_index(name) == CONTOURS - 1 for name in ("nominal", "result")))
        out, err = process.communicate(60)
    finally:
        process.kill()
    assert process.poll() == Exit.OK, err
    assert json.loads(out)["messages"] > 8
    with open_bag(bag) as found:
        begin = playback.begin_of_contour(found, 2)
        played = list(playback.in_order(found, found.connections, begin))
    for name in ("info", "nominal"):  # latched ones keep the newest alone: those between may be replaced
        kind, topic, _ = kinds[name]
        recorded = [deserialize_message(item, kind) for item in _recorded(bag, topic)]
        again = [deserialize_message(item, kind) for item in heard[name]]  # the middleware pads what it sends
        assert again[-1] == recorded[-1]
        assert all(message in recorded for message in again)
    recorded = [deserialize_message(item.data, ContourResult) for item in played if item.connection.topic == RESULT]
    assert [deserialize_message(item, ContourResult) for item in heard["result"]] == recorded
    assert len(recorded) >= CONTOURS - 2
    clock = [deserialize_message(item, Clock).clock for item in heard["clock"]]
    since = [time.sec * 10**9 + time.nanosec - played[0].time for time in clock]
    assert since == sorted(set(since))  # best effort: some may be missing
    assert all(value % 20_000_000 == 0 for value in since)
    assert 0 <= since[0] <= since[-1] <= played[-1].time - played[0].time


RESULT = "/contour/result"


def _recorded(bag: Path, topic: str) -> list[bytes]:
    with open_bag(bag) as found:
        return [item.data for item in playback.in_order(found, found.connections) if item.connection.topic == topic]
