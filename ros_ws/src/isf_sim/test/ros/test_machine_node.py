"""Node ``machine`` in a process of its own, driven over DDS by a small client."""

from __future__ import annotations

import itertools
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import forked_process
import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from isf_core.errors import ErrorCode
from isf_msgs.msg import MachineEvent, MachineState
from isf_msgs.srv import Reset, Scan, StateFile, Stop, Tare
from isf_ros import conversion, qos, stamps
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from machine_client import JOB, LIMIT, PARKED, RATE, Client, press, served
from sensor_msgs.msg import PointCloud2

pytestmark = pytest.mark.graph

GOLDEN = Path(__file__).resolve().parents[5] / "tests" / "golden" / "jobs"

LONG_TICKS = """
import sys, time
from isf_sim import node
from isf_sim.machine import simulated_machine as machine
hold = machine.SimulatedMachine.hold
def long_hold(self):
    time.sleep(0.1)  # the fault itself: a tick of 50 periods, as on a computer that is held up
    return hold(self)
machine.SimulatedMachine.hold = long_hold
sys.exit(node.main())
"""
"""A machine whose ticks without targets take 50 periods: the readings in between are repeated ones."""


@pytest.fixture
def machine(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Client]:
    parameters = getattr(request, "param", [])
    program = ["-m", "isf_sim.node"]
    if "long_ticks" in parameters:
        program, parameters = ["-c", LONG_TICKS], parameters[1:]
    with served(program, tmp_path, parameters) as client:
        yield client


def test_ticks_in_lockstep_and_stops_on_faults(machine: Client) -> None:
    """200 ticks with exact stamps; a NaN target latches 1401 and holds; stop, reset and scan answer."""
    machine.ready()
    for number in range(1, 201):
        assert machine.tick(number, PARKED)
    assert sorted(machine.wrenches[0]) == [stamps.tick_nanoseconds(k, RATE) for k in range(201)]
    # an unloaded, tared cell: noise floor 0.5 N, steps of 1 N, drift of 2 N over 300 s
    assert np.abs(list(machine.wrenches[0].values())).max() < 10.0

    # a stamp handled before is a sign of life only
    machine.send(stamps.tick_nanoseconds(200, RATE), PARKED)
    before = machine.received
    assert machine.wait(lambda: machine.received >= before + 4)  # the repeated wrenches
    assert machine.newest() == stamps.tick_nanoseconds(200, RATE)

    machine.send(stamps.tick_nanoseconds(201, RATE), (np.array([np.nan, 0.0, 0.1]), PARKED[1]))
    assert machine.wait(lambda: machine.fault_codes() == [ErrorCode.TARGET_NOT_FINITE])
    assert machine.states[-1].mode == MachineState.PROTECTIVE_STOP
    held = machine.wait(lambda: machine.newest() > stamps.tick_nanoseconds(201, RATE))
    assert held  # the release ticked on its own
    newest = machine.newest()
    machine.send(newest + stamps.tick_nanoseconds(1, RATE), PARKED)
    before = machine.received
    assert machine.wait(lambda: machine.received >= before + 4)
    assert machine.newest() == newest  # targets are ignored while the fault is latched
    assert machine.call(Tare, "machine/tare", Tare.Request()).code == ErrorCode.MACHINE_FAULTED

    assert machine.call(Reset, "machine/reset", Reset.Request()).code == 0
    assert machine.wait(lambda: machine.fault_codes() == [])
    assert machine.call(Stop, "machine/stop", Stop.Request(reason="test")).code == 0
    assert machine.wait(lambda: machine.fault_codes() == [ErrorCode.STOP_REQUESTED])
    for sensor in (False, True):
        response = machine.call(Scan, "machine/scan", Scan.Request(clamped=False, sensor=sensor))
        assert (response.code, response.points) == (ErrorCode.SHEET_NOT_RELEASED, 0)
        assert "--sheet shell_coarse" in response.message
    response = machine.call(Scan, "machine/scan", Scan.Request(clamped=True))
    assert (response.code, response.points) == (0, 251 * 251)
    assert machine.wait(lambda: len(machine.scans) == 1)
    assert conversion.height_map_from_message(machine.scans[0]).z == pytest.approx(0.0, abs=1e-9)


def test_a_sheet_that_yields_is_scanned_out_of_the_clamp_on_a_topic_of_its_own(machine: Client) -> None:
    """The flat blank, trimmed by nothing; what is scanned in the clamp stays on ``scan``."""
    released: list[PointCloud2] = []
    machine.node.create_subscription(PointCloud2, "machine/released_part", released.append, qos.LATCHED)
    request = Reset.Request(new_blank=True, job_text=JOB, sheet="shell_coarse")
    assert machine.call(Reset, "machine/reset", request).code == 0
    response = machine.call(Scan, "machine/scan", Scan.Request(clamped=False))
    assert response.code == 0, response.message
    assert machine.wait(lambda: released)
    assert released[0].header.frame_id == "part"
    assert response.points == released[0].width * released[0].height > 0
    assert not machine.scans


@pytest.mark.parametrize("machine", [["target_timeout:=1.5"]], indirect=True)
def test_lost_targets_release_a_loaded_tool(machine: Client) -> None:
    """A stream that ends while the tool presses latches 1404 and the tool is lifted until the sheet is free."""
    machine.ready()
    press(machine, 4e-3)
    newest = machine.newest()
    assert machine.wrenches[0][newest][2] > 20.0
    assert machine.wait(lambda: machine.fault_codes() == [ErrorCode.TARGET_LOST])
    assert machine.wait(lambda: machine.newest() > newest and abs(machine.wrenches[0][machine.newest()][2]) < 10.0)


def test_a_node_that_is_told_to_end_releases_a_loaded_tool_before(machine: Client) -> None:
    machine.ready()
    press(machine, 4e-3)
    newest = machine.newest()
    assert machine.wrenches[0][newest][2] > 20.0
    machine.process.send_signal(signal.SIGTERM)
    assert machine.wait(lambda: machine.fault_codes() == [ErrorCode.STOP_REQUESTED])
    assert "told to end" in machine.states[-1].fault_messages[0]
    assert machine.wait(lambda: machine.newest() > newest and abs(machine.wrenches[0][machine.newest()][2]) < 10.0)
    assert machine.process.wait(LIMIT) == 0


def test_an_executive_that_is_gone_releases_a_loaded_tool(machine: Client) -> None:
    """Also when targets are still repeated: whoever sends them does not look after the part."""
    machine.ready()
    ticks = press(machine, 4e-3)
    tips = (np.array([0.0, 0.0, -4e-3]), PARKED[1])
    reported = machine.node.create_publisher(DiagnosticArray, "/diagnostics", 10)
    values = [KeyValue(key="pid", value="4711"), KeyValue(key="busy", value="True")]
    assert machine.wait(lambda: reported.get_subscription_count() == 1)
    reported.publish(DiagnosticArray(status=[DiagnosticStatus(name="/executive", values=values)]))

    def released() -> bool:
        machine.send(stamps.tick_nanoseconds(ticks, RATE), tips)
        return machine.fault_codes() == [ErrorCode.UNATTENDED]

    assert machine.wait(released)
    assert "4711" in machine.states[-1].fault_messages[0]
    assert machine.wait(lambda: abs(machine.wrenches[0][machine.newest()][2]) < 10.0)


@pytest.mark.parametrize("machine", [["target_timeout:=2.0"]], indirect=True)
def test_a_machine_that_stood_still_blames_nobody(machine: Client) -> None:
    """Targets that came while the process did not run have still to be received: no end of the stream."""
    machine.ready()
    ticks = press(machine, 4e-3)
    tips = (np.array([0.0, 0.0, -4e-3]), PARKED[1])
    for _ in range(3):
        machine.process.send_signal(signal.SIGSTOP)
        stopped = time.monotonic()
        while time.monotonic() < stopped + 2.5:
            machine.send(stamps.tick_nanoseconds(ticks, RATE), tips)
            machine.waiting.once()
        machine.process.send_signal(signal.SIGCONT)
        ticks += 1
        resumed, due = time.monotonic(), stamps.tick_nanoseconds(ticks, RATE)
        while machine.newest() < due and not machine.fault_codes() and time.monotonic() < resumed + LIMIT:
            machine.send(due, tips)  # repeated, as force_ctrl does
            machine.waiting.once()
        assert (machine.newest(), machine.fault_codes()) == (due, [])


@pytest.mark.clock
@pytest.mark.parametrize("machine", [["lockstep:=false"]], indirect=True)
def test_real_time_ticks_by_the_clock(machine: Client) -> None:
    """Wrenches come without targets at the control rate; at rest the end of a stream is no fault."""
    request = Reset.Request(new_blank=True, job_text=JOB)
    assert machine.call(Reset, "machine/reset", request).code == 0
    assert machine.call(Tare, "machine/tare", Tare.Request()).code == 0
    assert machine.wait(lambda: len(machine.wrenches[0]) > 300)
    times = np.array(sorted(machine.wrenches[0]))
    period = stamps.NANO / RATE
    # every stamp lies on the grid of periods, whatever was missed
    assert np.abs(np.diff(times) / period - np.round(np.diff(times) / period)).max() < 1e-6
    sent = [0]

    def followed() -> bool:
        """A stream, not one message: what the machine does for a moment only, it may not tell on a busy computer."""
        sent[0] += 1
        machine.send(sent[0], PARKED)
        return any(s.mode == MachineState.FOLLOWING for s in machine.states)

    assert machine.wait(followed)
    assert machine.wait(lambda: machine.states[-1].mode == MachineState.IDLE)
    assert machine.fault_codes() == []


@pytest.mark.clock
@pytest.mark.parametrize("machine", [["lockstep:=false"]], indirect=True)
def test_after_a_reset_targets_begin_where_the_tools_stand(machine: Client) -> None:
    """Who was frozen before a stop and wakes after the reset goes on elsewhere: 20 mm are a jump, however late."""
    assert machine.call(Reset, "machine/reset", Reset.Request(new_blank=True, job_text=JOB)).code == 0
    sent = [0]

    def came(tips: object, condition: Callable[[], bool]) -> Callable[[], bool]:
        def sends() -> bool:
            sent[0] += stamps.NANO // 100
            machine.send(sent[0], tips)
            return condition()

        return sends

    assert machine.wait(came(PARKED, lambda: any(s.mode == MachineState.FOLLOWING for s in machine.states)))
    assert machine.call(Stop, "machine/stop", Stop.Request()).code == 0
    assert machine.wait(lambda: machine.fault_codes() == [ErrorCode.STOP_REQUESTED])
    assert machine.call(Reset, "machine/reset", Reset.Request()).code == 0
    assert machine.wait(lambda: machine.fault_codes() == [])
    sent[0] += 10 * stamps.NANO
    (x, y, z), lower = PARKED
    assert machine.wait(came(((x, y, z - 20e-3), lower), lambda: machine.fault_codes() != []))
    assert machine.fault_codes() == [ErrorCode.TARGET_JUMP]


SUBSCRIBER = """
import rclpy
from isf_ros import qos
from sensor_msgs.msg import PointCloud2
rclpy.init()
node = rclpy.create_node("subscriber")
node.create_subscription(PointCloud2, "scan", lambda _: print("has a scan", flush=True), qos.LATCHED)
rclpy.spin(node)
"""


@pytest.mark.clock
@pytest.mark.parametrize("machine", [["lockstep:=false"]], indirect=True)
def test_the_tools_do_not_wait_for_a_subscriber_out_of_reach(machine: Client) -> None:
    """As one on a computer whose link is cut: reliable, known, and silent."""
    assert machine.call(Reset, "machine/reset", Reset.Request(new_blank=True, job_text=JOB)).code == 0
    subscriber = forked_process.start([sys.executable, "-c", SUBSCRIBER], stdout=subprocess.PIPE, text=True)
    try:
        assert machine.call(Scan, "machine/scan", Scan.Request(clamped=True)).code == 0
        assert subscriber.stdout is not None
        assert subscriber.stdout.readline() == "has a scan\n"
        subscriber.send_signal(signal.SIGSTOP)
        before = machine.newest()
        assert machine.call(Scan, "machine/scan", Scan.Request(clamped=True)).code == 0
        assert machine.wait(lambda: machine.newest() > before + 6 * stamps.NANO)
        ticks = np.array(sorted(stamp for stamp in machine.wrenches[0] if stamp >= before))
        assert np.diff(ticks).max() < 4.0 * stamps.NANO  # a busy computer has gaps of its own
    finally:
        subscriber.kill()
        subscriber.wait()


@pytest.mark.clock
@pytest.mark.parametrize("machine", [["long_ticks", "lockstep:=false"]], indirect=True)
def test_a_long_tick_is_not_older_than_the_readings_that_bridged_it(machine: Client) -> None:
    """Else who reads them takes the step back for a clock that was set."""
    assert machine.call(Reset, "machine/reset", Reset.Request(new_blank=True, job_text=JOB)).code == 0
    assert machine.wait(lambda: len(machine.wrenches[0]) > 100)
    apart = np.diff(list(machine.wrenches[0]))  # in the order of their coming
    assert apart.min() > 0
    assert apart.min() < 0.1 * stamps.NANO  # some came between the ticks
    alike = [len(list(run)) for _, run in itertools.groupby(tuple(force) for force in machine.wrenches[0].values())]
    assert max(alike) < 10  # 30 alike are a frozen load cell to force control


def test_services_name_what_is_wrong(machine: Client) -> None:
    """Without a blank every service answers with its code; a job that cannot be read is told with its place."""
    assert machine.call(Tare, "machine/tare", Tare.Request()).code == ErrorCode.NO_BLANK
    assert machine.call(Scan, "machine/scan", Scan.Request(clamped=True)).code == ErrorCode.NO_BLANK
    assert machine.call(Reset, "machine/reset", Reset.Request()).code == ErrorCode.NO_BLANK
    wrong = Reset.Request(new_blank=True, job_text=JOB.replace("1 mm}", "1}"))
    response = machine.call(Reset, "machine/reset", wrong)
    assert response.code == ErrorCode.FILE_UNIT
    assert "job:6" in response.message
    assert machine.call(Stop, "machine/stop", Stop.Request()).code == 0


def test_a_blank_that_outlasts_a_cleanup_has_its_holder_again(machine: Client) -> None:
    """Of TPIF: every tick takes a target of the blank holder, too."""
    request = Reset.Request(new_blank=True, job_text=(GOLDEN / "tpif_cone.yaml").read_text(), base_folder=str(GOLDEN))
    assert machine.call(Reset, "machine/reset", request).code == 0

    def listens() -> bool:
        return bool(machine.node.get_subscriptions_info_by_topic("/holder/target"))

    assert machine.wait(listens)
    steps = Transition.TRANSITION_DEACTIVATE, Transition.TRANSITION_CLEANUP
    for step in steps:
        request = ChangeState.Request(transition=Transition(id=step))
        assert machine.call(ChangeState, "machine/change_state", request).success
    assert machine.wait(lambda: not listens())
    for step in (Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_ACTIVATE):
        request = ChangeState.Request(transition=Transition(id=step))
        assert machine.call(ChangeState, "machine/change_state", request).success
    assert machine.wait(listens)


def test_state_is_saved_and_taken_up(machine: Client, tmp_path: Path) -> None:
    """What was pressed stays after a fresh blank and a load; the clock goes on; a foreign file is refused."""
    machine.ready()
    held = (np.array([0.0, 0.0, -4e-3]), PARKED[1])
    last = press(machine, 4e-3) + 60
    for number in range(last - 59, last + 1):  # the servo comes to rest
        assert machine.tick(number, held)
    pressed = machine.wrenches[0][machine.newest()][2]
    path = "part/state.npz"
    assert machine.call(StateFile, "machine/save", StateFile.Request(path=path)).code == 0
    assert machine.call(Reset, "machine/reset", Reset.Request(new_blank=True)).code == 0
    assert machine.call(StateFile, "machine/load", StateFile.Request(path=path)).code == 0
    assert machine.tick(last + 1, held)
    again = machine.wrenches[0][stamps.tick_nanoseconds(last + 1, RATE)][2]
    assert again == pytest.approx(pressed, rel=0.05)
    states = tmp_path / "states"
    assert (states / path).is_file()

    def both(name: str) -> list[int]:
        request = StateFile.Request(path=name)
        return [machine.call(StateFile, f"machine/{do}", request).code for do in ("save", "load")]

    foreign = states / "foreign.npz"
    foreign.write_text("no machine")
    assert machine.call(StateFile, "machine/load", StateFile.Request(path="foreign.npz")).code == ErrorCode.FILE_SYNTAX
    assert both("") == [ErrorCode.FILE_NOT_FOUND] * 2
    assert both("foreign.npz/file.npz")[0] == ErrorCode.FILE_NOT_WRITABLE

    # Nothing is written or read outside the machine's own folder, by no way.
    outside = tmp_path / "outside.npz"
    outside.write_text("precious")
    (states / "link.npz").symlink_to(outside)
    (states / "up").symlink_to(tmp_path)
    (states / "loop.npz").symlink_to(states / "loop.npz")
    (states / "fresh.npz.partial").symlink_to(outside)
    ways = (str(outside), str(states / path), "../outside.npz", "part/../../outside.npz", "link.npz", "up/outside.npz")
    for way in (*ways, "up/new.npz", "loop.npz", "."):
        assert both(way) == [ErrorCode.FILE_OUTSIDE] * 2, way
    assert machine.call(StateFile, "machine/save", StateFile.Request(path="fresh.npz")).code == 0
    assert outside.read_text() == "precious"
    assert not (tmp_path / "new.npz").exists()


def test_sensor_scan_takes_its_time_and_force_limit_is_an_event(machine: Client) -> None:
    """2.5 s of machine time; points in no order, with noise; pressing too hard saturates the cell first."""
    machine.ready()
    assert machine.tick(1, PARKED)
    response = machine.call(Scan, "machine/scan", Scan.Request(clamped=True, sensor=True))
    assert response.code == 0
    assert machine.wait(lambda: len(machine.scans) == 1)
    cloud = machine.scans[0]
    assert (cloud.height, cloud.width) == (1, response.points)
    points = np.frombuffer(bytes(cloud.data), dtype="<f8").reshape(-1, 3)
    assert 1e-6 < np.abs(points[:, 2]).max() < 0.2e-3
    after = stamps.tick_nanoseconds(1 + 1250, RATE)
    assert machine.wait(lambda: machine.newest() == after)
    for number in range(1252, 1252 + 800):
        tip = np.array([0.0, 0.0, 0.1 - 0.0002 * (number - 1251)])
        stamp = stamps.tick_nanoseconds(number, RATE)
        machine.send(stamp, (tip, PARKED[1]))
        if not machine.ticked_to(stamp):
            break
    assert machine.fault_codes()
    assert machine.fault_codes()[0] in (ErrorCode.FORCE_LIMIT, ErrorCode.LOAD_CELL_RANGE)
    assert machine.wait(lambda: MachineEvent.SATURATION in [event.kind for event in machine.events])


def test_a_machine_that_ends_while_its_axes_are_on_their_way_in_the_air_has_no_fault(machine: Client) -> None:
    """In lockstep time stands still after the last targets of a part, with the axes still behind them."""
    machine.ready()
    for number in range(1, 40):
        assert machine.tick(number, (PARKED[0] - [0.0, 0.0, 0.0002 * number], PARKED[1]))
    machine.process.send_signal(signal.SIGTERM)
    assert machine.process.wait(LIMIT) == 0
    assert machine.fault_codes() == []
    assert "STOP_REQUESTED" not in machine.log.read_text(encoding="utf-8")
