"""Node load_cell in its own process: readings in, wrenches out, faults told, and force control fed by it; real DDS."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import forked_process
import numpy as np
import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped, WrenchStamped
from isf_core.errors import ErrorCode
from isf_load_cell.cell_file import load_cell_set_up
from isf_load_cell.node import LoadCellNode
from isf_load_cell.three_cells import readings_of
from isf_msgs.srv import Arm
from isf_ros import conversion, qos, stamps
from node_cell import FAR_JOB, JOB, LIMIT, QUICK, Cell, small_ring, watched
from rclpy.lifecycle import TransitionCallbackReturn
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger
from waiting import Waiting

pytestmark = pytest.mark.graph

DOCS = Path(__file__).resolve().parents[4] / "docs" / "own_cell" / "load_cells.md"
NODE = ("-m", "isf_load_cell.node")
MATRIX = "calibration_matrix: [[2, 0.1, 0], [0, -3, 0], [0, 0.2, 4]]\n"


class Bench:
    """A driver of a load cell: publishes readings, hears wrenches and what the node says of itself."""

    def __init__(self, waiting: Waiting, stack: ExitStack) -> None:
        self.waiting, self._stack, self.tick = waiting, stack, 0
        self.node, self.wait = waiting.node, waiting.until
        node = self.node
        self.wrenches: list[WrenchStamped] = []
        self.health: list[tuple[int, str, dict[str, str]]] = []
        self.raw = node.create_publisher(WrenchStamped, "raw", qos.STREAM)
        self.cells = node.create_publisher(JointState, "raw_cells", qos.STREAM)
        self.pose = node.create_publisher(PoseStamped, "pose", qos.SENSOR)
        node.create_subscription(WrenchStamped, "wrench", self.wrenches.append, qos.STREAM)
        node.create_subscription(DiagnosticArray, "/diagnostics", self._on_health, 10)
        self._asked = {name: node.create_client(Trigger, f"load_cell/{name}") for name in ("tare", "check_drift")}

    def _on_health(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name == "/load_cell":
                values = {item.key: item.value for item in status.values}
                self.health.append((int.from_bytes(status.level, "little"), status.message, values))

    def start(self, file: Path | None = None, **parameters: Any) -> None:
        if file is not None:
            parameters["file"] = file
        self._stack.enter_context(forked_process.node(*NODE, autostart=True, **{"tare_readings": 10, **parameters}))

    def ready(self, publisher: Any) -> None:
        assert self.wait(lambda: publisher.get_subscription_count() and self.node.count_publishers("wrench"))
        assert self.wait(lambda: any(values["state"] == "active" for _, _, values in self.health))

    def ask(self, service: str) -> Trigger.Response:
        client = self._asked[service]
        assert client.wait_for_service(LIMIT)
        future = client.call_async(Trigger.Request())
        assert self.wait(future.done)
        return future.result()

    def send(self, values: Any, names: list[str] | None = None) -> int:
        """Publish one reading, as a wrench or by name; its stamp in ns."""
        self.tick += 1
        stamp = stamps.to_stamp(stamps.tick_nanoseconds(50_000 + self.tick, 500.0))
        message: Any
        if names is None:
            message = WrenchStamped()
            message.header.frame_id = "sensor"
            conversion.set_wrench(message, values)
            publisher = self.raw
        else:
            message = JointState(name=names, effort=[float(value) for value in values])
            publisher = self.cells
        message.header.stamp = stamp
        publisher.publish(message)
        return stamps.to_nanoseconds(stamp)

    def answer(self, values: Any, names: list[str] | None = None) -> tuple[float, ...]:
        """The wrench that answers a reading, by its stamp."""
        sent = self.send(values, names)

        def found() -> list[WrenchStamped]:
            return [m for m in self.wrenches if stamps.to_nanoseconds(m.header.stamp) == sent]

        assert self.wait(found)
        (message,) = found()
        assert message.header.frame_id == "sheet"
        return conversion.wrench_array(message)

    def tared(self, unloaded: Callable[[], Any], names: list[str] | None = None) -> bool:
        """Send readings of the unloaded cell until the node has taken its zero from them."""

        def taken() -> bool:
            for _ in range(10):
                self.send(unloaded(), names)
            return bool(self.ask("tare").success)

        return self.wait(taken)

    def reported(self, level: bytes, *words: str) -> bool:
        """Wait until the newest status has the level and holds all words."""
        number = int.from_bytes(level, "little")

        def seen() -> bool:
            return bool(self.health) and self.health[-1][0] == number and all(w in self.health[-1][1] for w in words)

        return self.wait(seen)

    def shows(self, values: Any, level: bytes, words: str) -> bool:
        """One more reading, so that readings do not stop meanwhile; whether the node tells that."""
        self.send(values)
        number = int.from_bytes(level, "little")
        return bool(self.health) and self.health[-1][0] == number and words in self.health[-1][1]

    def silent(self, values: Any, names: list[str] | None = None) -> bool:
        """True when a reading is taken in and no wrench given out, as the node counts both."""

        def counts() -> tuple[int, int]:
            seen = len(self.health)
            assert self.wait(lambda: len(self.health) > seen + 1)  # one that began after the call
            return int(self.health[-1][2]["readings"]), int(self.health[-1][2]["wrenches"])

        readings, wrenches = counts()
        self.send(values, names)
        assert self.wait(lambda: int(self.health[-1][2]["readings"]) > readings)
        return int(self.health[-1][2]["wrenches"]) == wrenches


@pytest.fixture
def bench() -> Iterator[Bench]:
    with watched(Bench) as found:
        yield found


def written(folder: Path, text: str) -> Path:
    path = folder / "cell.yaml"
    path.write_text(text)
    return path


def test_readings_become_wrenches_and_faults_end_them(bench: Bench, tmp_path: Path) -> None:
    text = MATRIX + "range: 1000\nrotation: [0 deg, 0 deg, 90 deg]\nfrozen_after: 8\n"
    bench.start(written(tmp_path, text), timeout=5.0)
    bench.ready(bench.raw)
    unheard = bench.ask("tare")  # and the 5 s after which silence is a fault are not over
    assert not unheard.success
    assert "1202 WRENCH_LOST" in unheard.message
    random = np.random.default_rng(0)

    def free() -> np.ndarray:
        return np.array([10.0, -5.0, 20.0, 0.0, 0.0, 0.0]) + 0.01 * random.standard_normal(6)

    assert bench.silent(free())
    assert bench.reported(DiagnosticStatus.ERROR, "1205 NO_TARE", "not tared")
    early = bench.ask("tare")
    assert (early.success, "of 10" in early.message or "10 are needed" in early.message) == (False, True)
    assert bench.tared(free)
    wrench = bench.answer(free() + [10.0, 20.0, 30.0, 1.0, 2.0, 3.0])
    # Load in axes of the cell (22, -60, 124) and (1, 2, 3), turned by 90 degrees about z; noise of 0.01 units.
    assert wrench == pytest.approx((60.0, 22.0, 124.0, -2.0, 1.0, 3.0), abs=0.25)
    assert bench.reported(DiagnosticStatus.OK, "ok")
    assert bench.health[-1][2]["publishing"] == "True"

    # The driver was away for longer than the timeout: what it read before is no part of a new zero.
    bench.tick += 3000
    bench.answer(free() + [0.0, 0.0, 2.0, 0.0, 0.0, 0.0])
    returned = bench.ask("tare")
    assert (returned.success, "1 readings so far, 10 are needed" in returned.message) == (False, True)

    # Saturated: silence, also when the readings are good again, until the next tare.
    assert bench.silent([0.0, 995.0, 0.0, 0.0, 0.0, 0.0])
    assert bench.reported(DiagnosticStatus.ERROR, "1203 WRENCH_OUT_OF_RANGE", "channel 2")
    assert bench.health[-1][2]["publishing"] == "False"
    assert bench.silent(free())
    assert bench.tared(free)
    assert max(map(abs, bench.answer(free()))) < 0.5
    assert bench.reported(DiagnosticStatus.OK, "ok")

    # Unloaded readings tell the drift; beyond the limit the wrench goes on, with a warning.
    for _ in range(10):
        bench.answer(free() + [0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
    assert bench.ask("check_drift").message.startswith(("drift 3.9", "drift 4.0"))
    for _ in range(10):
        bench.answer(free() + [0.0, 0.0, 5.0, 0.0, 0.0, 0.0])
    drifted = bench.ask("check_drift")
    assert (drifted.success, "drifted by 20" in drifted.message) == (False, True)
    assert bench.reported(DiagnosticStatus.WARN, "1205 NO_TARE", "drifted")

    # Frozen: the same reading under new stamps.
    held = free()
    for _ in range(12):
        bench.send(held)
    assert bench.reported(DiagnosticStatus.ERROR, "1210 WRENCH_FROZEN")
    assert bench.silent(free())
    assert all(math.isfinite(value) for m in bench.wrenches for value in conversion.wrench_array(m))


def test_one_of_three_cells_may_be_lost(bench: Bench, tmp_path: Path) -> None:
    names = [f"cell_{k}{axis}" for k in (1, 2, 3) for axis in ("x", "y", "z")]
    gains = "".join(f"  {name}: 2456.7\n" for name in names)
    text = f"calibration_gains:\n{gains}three_cells: {{height: 280 mm}}\nrange: 9.5\n"
    bench.start(written(tmp_path, text), timeout=5.0)
    bench.ready(bench.cells)
    random = np.random.default_rng(0)

    def volts(*force: float) -> np.ndarray:
        return readings_of(np.array(force), 0.28).ravel() / 2456.7 + 1e-4 * random.standard_normal(9)

    assert bench.tared(lambda: volts(0.0, 0.0, 0.0) + 0.2, names)
    load = (300.0, -200.0, 1500.0)
    # Noise of 1e-4 V is 0.25 N in a channel; three channels, the lever of 280 to 110 mm and the fall-back add up.
    assert bench.answer(volts(*load) + 0.2, names)[:3] == pytest.approx(load, abs=5.0)
    order = list(reversed(range(9)))  # by name, in any order
    again = bench.answer((volts(*load) + 0.2)[order], [names[k] for k in order])
    assert again[:3] == pytest.approx(load, abs=5.0)
    # A driver that leaves out what it does not get.
    assert bench.answer((volts(*load) + 0.2)[3:], names[3:])[:3] == pytest.approx(load, abs=5.0)
    assert bench.reported(DiagnosticStatus.WARN, "cell_1z gives no reading", "the other channels")
    values = volts(*load) + 0.2
    values[5] = 9.49
    assert bench.silent(values, names)
    assert bench.reported(DiagnosticStatus.ERROR, "1203 WRENCH_OUT_OF_RANGE", "cell_2z is at the end")


def test_a_cell_that_turns_needs_its_pose(bench: Bench, tmp_path: Path) -> None:
    bench.start(written(tmp_path, MATRIX + "range: 1000\nweight: 40 N\n"), with_pose=True, timeout=3.0)
    bench.ready(bench.raw)
    inverse = np.linalg.inv([[2, 0.1, 0], [0, -3, 0], [0, 0.2, 4]])

    def free(turn: np.ndarray) -> np.ndarray:
        noise = 1e-3 * np.random.default_rng(bench.tick).standard_normal(6)
        return np.concatenate([inverse @ turn.T @ [0.0, 0.0, -40.0], np.zeros(3)]) + noise

    assert bench.silent(free(np.eye(3)))
    assert bench.wait(lambda: bench.shows(free(np.eye(3)), DiagnosticStatus.ERROR, "1222 POSE_LOST"))
    pose = conversion.make_pose()

    def at_rest() -> np.ndarray:
        bench.pose.publish(pose)
        return free(np.eye(3))

    assert bench.tared(at_rest)
    # Turned by 90 degrees about y the weight pulls along another axis of the cell: still nothing is felt.
    pose.pose.orientation.y = pose.pose.orientation.w = math.sqrt(0.5)
    turn = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])

    def felt() -> float:
        bench.pose.publish(pose)
        bench.wait(lambda: False, 0.05)
        return max(map(abs, bench.answer(free(turn))[:3]))

    assert bench.wait(lambda: felt() < 0.1)
    # The driver stops: told, and over by itself when it goes on.
    assert bench.reported(DiagnosticStatus.ERROR, "1202 WRENCH_LOST", "nothing on raw for 3 s")
    bench.pose.publish(pose)
    bench.send(free(turn))
    assert bench.reported(DiagnosticStatus.OK, "ok")


@pytest.mark.parametrize(
    ("option", "words"),
    [
        ("file:={}", ("1003 FILE_FIELD", "cell.yaml:3", "unknown field 'mass'")),
        ("rig:=none_such", ("1001 FILE_NOT_FOUND", "none_such")),
        ("tool:=1", ("1003 FILE_FIELD", "no load cell is named")),
        ("tool:=3", ("1003 FILE_FIELD", "parameter tool", "1 or 2: the tool of")),
        ("tare_readings:=0", ("1003 FILE_FIELD", "parameter tare_readings")),
        ("timeout:=-1.0", ("1003 FILE_FIELD", "parameter timeout", "0.01 to 60 s (time without")),
        ("timeout:=.nan", ("1003 FILE_FIELD", "parameter timeout")),
    ],
)
def test_what_cannot_be_used_leaves_the_node_unconfigured(tmp_path: Path, option: str, words: tuple[str, ...]) -> None:
    file = written(tmp_path, MATRIX + "range: 1000\nmass: 2 kg\n")
    rclpy.init(args=["--ros-args", "-p", option.format(file)])
    try:
        node = LoadCellNode()
        assert node.trigger_configure() == TransitionCallbackReturn.FAILURE
        assert all(word in node._text for word in words), node._text
        node.destroy_node()
    finally:
        rclpy.try_shutdown()


def test_a_cell_that_is_activated_again_has_no_zero_of_the_part_before() -> None:
    rclpy.init(args=["--ros-args", "-p", "rig:=ren2018", "-p", "tare_readings:=1"])
    try:
        node = LoadCellNode()
        assert node.trigger_configure() == TransitionCallbackReturn.SUCCESS
        for _ in range(2):
            assert node.trigger_activate() == TransitionCallbackReturn.SUCCESS
            assert node._stream is not None
            assert node._stream.fault is not None
            assert node._stream.fault.code is ErrorCode.NO_TARE
            node._take(stamps.to_stamp(1), np.zeros(6))
            node._stream.tare()
            assert node._stream.fault is None
            assert node.trigger_deactivate() == TransitionCallbackReturn.SUCCESS
        node.destroy_node()
    finally:
        rclpy.try_shutdown()


def documented() -> tuple[list[dict[str, str]], list[str]]:
    """Remaps of both nodes, and the examples of files, in the section of docs/own_cell/load_cells.md."""
    section = DOCS.read_text().split("## Readings of a load cell")[1].split("\n## ")[0]
    (block,) = re.findall(r"```sh\n(.*?)```", section, re.DOTALL)
    commands = block.replace("\\\n", " ").splitlines()
    nodes = [dict(re.findall(r"-r (\S+):=(\S+)", line)) for line in commands if "load_cell --ros-args" in line]
    tares = [line.split()[3] for line in commands if line.startswith("ros2 service call")]
    assert tares == [f"/{names['__node']}/tare" for names in nodes]
    return nodes, re.findall(r"```yaml\n(.*?)```", section, re.DOTALL)


def test_the_documented_files_are_read(tmp_path: Path) -> None:
    _, (six, three, rig) = documented()
    assert load_cell_set_up(str(written(tmp_path, six)), "", 1).channels is None
    names = tuple(f"{axis}{k}" for k in (1, 2, 3) for axis in "xyz")
    assert load_cell_set_up(str(written(tmp_path, three)), "", 1).channels == names
    assert load_cell_set_up("", str(written(tmp_path, rig)), 1).channels == names


@pytest.mark.parametrize(
    "lockstep", [True, pytest.param(False, marks=[pytest.mark.slow, pytest.mark.clock])], ids=["lockstep", "real time"]
)
def test_force_control_holds_its_force_on_readings_of_this_node(bench: Bench, tmp_path: Path, lockstep: bool) -> None:
    """Driver in one process, its two cells in two, force control in another. The cells are wired the wrong way round:
    as they are, force control refuses them (1212, test_force_ctrl_node.py)."""
    cell = Cell(bench.waiting, bench._stack)
    cell.job = JOB if lockstep else FAR_JOB
    file = written(tmp_path, "calibration_matrix: [[-1, 0, 0], [0, -1, 0], [0, 0, -1]]\nrange: 2000\n")
    nodes, _ = documented()
    drivers = {names["wrench"]: names["raw"] for names in nodes}
    assert set(drivers) == {"tool_1/wrench", "tool_2/wrench"}
    machine = str(Path(__file__).parents[2] / "isf_force_ctrl" / "test" / "standin_machine.py")
    bench._stack.enter_context(forked_process.node(machine, remap=drivers, sign=-1.0, lockstep=lockstep))
    clients = []
    readings = 1 if lockstep else 250  # in lockstep time stands still before the first contour
    for names in nodes:
        bench._stack.enter_context(
            forked_process.node(*NODE, remap=names, autostart=True, file=file, tare_readings=readings)
        )
        clients.append(bench.node.create_client(Trigger, f"{names['__node']}/tare"))
    bench._stack.enter_context(
        forked_process.node("-m", "isf_force_ctrl.node", autostart=True, lockstep=lockstep, wrench_timeout=2.0, **QUICK)
    )
    assert all(client.wait_for_service(LIMIT) for client in clients)
    assert cell._arm.wait_for_service(LIMIT)
    early = cell._arm.call_async(Arm.Request(plan_id="plan", count=1, job_text=cell.job, support_force=math.nan))
    assert bench.wait(early.done)
    assert early.result().code == ErrorCode.WRENCH_LOST  # nothing comes before the tare

    def tared(client: Any) -> bool:
        future = client.call_async(Trigger.Request())
        return bench.wait(future.done) and future.result().success

    assert all(bench.wait(lambda client=client: tared(client)) for client in clients)
    cell.armed(count=2)  # the second one never comes: it would only take time
    result = conversion.result_from_message(cell.form(small_ring(0, 2)))
    assert (result.completed, result.code) == (True, 0)
    force = result.tick_normal_force[result.tick_engaged]
    if lockstep:
        # Noise 1.2 N and steps of 1 N as without the node; the zero is one reading, so it is off by those too.
        assert np.mean(np.abs(force - 120.0) <= 10.0) >= 0.99
        assert result.lost_messages == 0
    else:  # timing depends on the machine the test runs on
        assert result.contact_fraction > 0.9
