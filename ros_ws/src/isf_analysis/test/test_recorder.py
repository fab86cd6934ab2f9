"""The recorder as a process of its own over DDS: loses nothing, changes nothing, ends in order."""

from __future__ import annotations

import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import forked_process
import pytest
import rclpy
from burst_publisher import SCANS, target_bytes, wrench_bytes
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import WrenchStamped
from isf_analysis.bag import repair
from isf_analysis.bag.topics import cell_types
from isf_analysis.recorder_node import EXIT_INCOMPLETE
from isf_ros import qos
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rosbags.rosbag2 import Reader
from sensor_msgs.msg import JointState, PointCloud2
from std_srvs.srv import Trigger

pytestmark = pytest.mark.graph

COUNT, RATE = 2000, 800.0
LIMIT = 120.0
"""s; only to end a test that hangs: a process may take long to start."""


@contextmanager
def recorder(
    output: Path,
    *,
    autostart: bool = True,
    remap: str = "",
    room: int | None = None,
    program: tuple[str, ...] = ("-m", "isf_analysis.recorder_node"),
    **parameters: object,
) -> Iterator[forked_process.ForkedProcess]:
    """The recorder; its files may grow to ``room`` bytes, then the system refuses as a full disk does."""
    command = [sys.executable, *program, "--ros-args"]
    for name, value in {"output": output, "autostart": str(autostart).lower(), **parameters}.items():
        command += ["-p", f"{name}:={value}"]
    command += ["-r", remap] if remap else []

    process = forked_process.start(command, start_new_session=True, stderr=subprocess.PIPE, text=True)
    if room is not None:
        resource.prlimit(process.pid, resource.RLIMIT_FSIZE, (room, room))
    try:
        yield process
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
        process.wait(LIMIT)
        if process.stderr is not None:
            process.stderr.close()


def end(process: forked_process.ForkedProcess, number: signal.Signals, code: int = 0) -> str:
    """Output on stderr after the signal; the process must end by itself and with ``code``."""
    os.killpg(process.pid, number)
    _, text = process.communicate(timeout=LIMIT)
    assert process.returncode == code, text
    return text


def publish_burst(count: int = COUNT, rate: float = RATE) -> None:
    script = Path(__file__).with_name("burst_publisher.py")
    assert forked_process.run([sys.executable, str(script), str(count), str(rate)], timeout=2 * LIMIT).returncode == 0


def messages(bag: Path) -> dict[str, list[tuple[int, bytes]]]:
    found: dict[str, list[tuple[int, bytes]]] = {}
    with Reader(bag) as reader:
        for connection, stamp, data in reader.messages():
            found.setdefault(connection.topic, []).append((stamp, data))
    return found


@pytest.mark.parametrize(
    ("compression", "count", "ended_by"),
    [("none", COUNT, signal.SIGINT), ("zstd", 100, signal.SIGTERM)],
    ids=["fast", "compressed and terminated"],
)
def test_every_message_is_kept_byte_by_byte(
    compression: str, count: int, ended_by: signal.Signals, tmp_path: Path
) -> None:
    bag = tmp_path / "bag"
    began = time.time_ns()
    with recorder(bag, compression=compression) as process:
        publish_burst(count)
        text = end(process, ended_by)
    found = messages(bag)
    for topic, make in (("wrench", wrench_bytes), ("target", target_bytes)):
        sent = [make(number) for number in range(count)]
        for tool in (1, 2):
            assert [data for _, data in found[f"/tool_{tool}/{topic}"]][-count:] == sent  # greetings come before
    stamps = [stamp for stamp, _ in found["/tool_1/wrench"]]
    assert stamps == sorted(stamps)
    assert began < stamps[0] <= stamps[-1] < time.time_ns()
    job = cell_types().deserialize_cdr(found["/part/info"][-1][1], "isf_msgs/msg/JobInfo")
    assert job.job_name == "burst"
    result = cell_types().deserialize_cdr(found["/contour/result"][-1][1], "isf_msgs/msg/ContourResult")
    assert result.index == 7
    types = cell_types()
    scans = [types.deserialize_cdr(data, "sensor_msgs/msg/PointCloud2") for _, data in found["/scan"]]
    assert [scan.width for scan in scans][-SCANS:] == list(range(1, SCANS + 1))
    reported = [types.deserialize_cdr(data, "isf_msgs/msg/MachineEvent") for _, data in found["/machine/event"]]
    assert [event.kind for event in reported][-SCANS:] == list(range(1, SCANS + 1))
    assert [data for _, data in found["/holder/target"]][-SCANS:] == [target_bytes(n) for n in range(1, SCANS + 1)]
    assert "recorded" in text
    assert "lost" not in text


def test_raw_readings_are_kept_whatever_their_names_and_delivery(tmp_path: Path, observer: Node) -> None:
    bag = tmp_path / "bag"
    wrench = observer.create_publisher(WrenchStamped, "left/ft_raw", qos.SENSOR)  # a driver's own name, best effort
    cells = observer.create_publisher(JointState, "tool_2/raw_cells", qos.STREAM)
    named = JointState(name=["u1", "u2"], effort=[0.25, -0.5])
    with recorder(bag, remap="tool_1/raw:=left/ft_raw") as process:

        def silent() -> str:
            """Topics without a message, "" until the recorder has told of any (before it records it names none)."""
            wrench.publish(wrench_bytes(3))
            cells.publish(named)
            observer.get_logger().info("a word for the record")
            reported = [item.value for status in observer.heard for item in status.values if item.key == "silent"]
            return next((text for text in reversed(reported) if text), "")

        both = {"tool_1/raw", "tool_2/raw_cells", "/rosout"}
        assert spin_until(observer, lambda: (reported := silent()) != "" and not both & set(reported.split(", ")))
        end(process, signal.SIGINT)
    found = messages(bag)
    assert found["/left/ft_raw"][-1][1] == wrench_bytes(3)
    last = cell_types().deserialize_cdr(found["/tool_2/raw_cells"][-1][1], "sensor_msgs/msg/JointState")
    assert (last.name, last.effort.tolist()) == (["u1", "u2"], [0.25, -0.5])
    assert "/tool_2/raw" not in found  # nobody published there
    said = [cell_types().deserialize_cdr(data, "rcl_interfaces/msg/Log") for _, data in found["/rosout"]]
    assert "a word for the record" in [log.msg for log in said]
    told = [item.value for status in observer.heard for item in status.values if item.key == "not_installed"]
    assert bool(told) == (find_spec("tf2_msgs") is None)
    assert set(told) <= {"/tf, /tf_static"}


def test_wrenches_published_best_effort_are_recorded_and_reported(tmp_path: Path, observer: Node) -> None:
    with recorder(tmp_path / "bag") as process:
        loose = observer.create_publisher(WrenchStamped, "tool_1/wrench", qos.SENSOR)

        def recorded() -> bool:
            loose.publish(WrenchStamped())
            return any("1509 QOS_INCOMPATIBLE" in text and "tool_1/wrench" in text for text in heard(observer))

        assert spin_until(observer, recorded)
        for _ in range(20):  # best effort promises nothing of one message
            loose.publish(WrenchStamped())
            spin_until(observer, lambda: False, timeout=0.05)
        end(process, signal.SIGINT)
    assert messages(tmp_path / "bag")["/tool_1/wrench"]


def test_a_latched_topic_published_volatile_is_reported(tmp_path: Path, observer: Node) -> None:
    """Which topic, whose, which policy, what to do; the exit code says that the bag is not whole."""
    with recorder(tmp_path / "bag") as process:
        volatile = QoSProfile(depth=1, durability=DurabilityPolicy.VOLATILE)
        observer.create_publisher(PointCloud2, "scan", volatile)

        def reported() -> bool:
            return any(
                text == "[1509 QOS_INCOMPATIBLE] topic scan: nothing is received from node 'observer': durability "
                "volatile is offered, transient_local is required (publish with reliability reliable, durability "
                "transient_local)"
                for text in heard(observer)
            )

        assert spin_until(observer, reported)
        end(process, signal.SIGINT, EXIT_INCOMPLETE)


def test_a_recorder_that_ends_before_it_knows_whose_topic_it_is_says_that_the_bag_is_not_whole(
    tmp_path: Path, observer: Node
) -> None:
    with recorder(tmp_path / "bag", program=(str(Path(__file__).with_name("nameless_recorder.py")),)) as process:
        observer.create_publisher(PointCloud2, "scan", QoSProfile(depth=1, durability=DurabilityPolicy.VOLATILE))

        def apart() -> bool:
            found = [
                item.value for status in observer.heard for item in status.values if item.key == "qos_incompatible"
            ]
            return found[-1:] == ["scan"]

        assert spin_until(observer, apart)  # the names are waited for some seconds longer
        end(process, signal.SIGINT, EXIT_INCOMPLETE)


def test_an_existing_folder_is_refused(tmp_path: Path, observer: Node) -> None:
    (tmp_path / "bag").mkdir()
    (tmp_path / "bag" / "precious").write_text("keep")
    with recorder(tmp_path / "bag") as process:
        assert spin_until(observer, lambda: any("1603" in text for text in heard(observer)))
        end(process, signal.SIGINT, EXIT_INCOMPLETE)
    assert [item.name for item in (tmp_path / "bag").iterdir()] == ["precious"]


def test_an_unknown_topic_is_refused_with_the_known_ones(tmp_path: Path, observer: Node) -> None:
    with recorder(tmp_path / "bag", topics="['tool_3/wrench']") as process:
        assert spin_until(observer, lambda: any("tool_3/wrench" in text for text in heard(observer)))
        end(process, signal.SIGINT, EXIT_INCOMPLETE)
    assert not (tmp_path / "bag").exists()


WITHOUT_TF2 = """
import sys
sys.modules["tf2_msgs"] = sys.modules["tf2_msgs.msg"] = None
from isf_analysis import recorder_node
sys.exit(recorder_node.main())
"""
"""A recorder where ROS has no tf2_msgs, whether this one has or not."""


def test_a_topic_that_was_asked_for_and_cannot_be_recorded_is_refused(tmp_path: Path, observer: Node) -> None:
    with recorder(tmp_path / "bag", program=("-c", WITHOUT_TF2), topics="['tool_1/wrench', '/tf']") as process:
        assert spin_until(observer, lambda: any("/tf are not installed" in text for text in heard(observer)))
        end(process, signal.SIGINT, EXIT_INCOMPLETE)
    assert not (tmp_path / "bag").exists()


def test_deactivation_closes_the_bag_and_only_chosen_topics_are_in_it(tmp_path: Path, observer: Node) -> None:
    bag = tmp_path / "bag"
    topic = "tool_1/wrench"
    publisher = observer.create_publisher(WrenchStamped, topic, qos.STREAM)
    other = observer.create_publisher(WrenchStamped, "tool_2/wrench", qos.STREAM)
    with recorder(bag, autostart=False, topics=f"['{topic}']") as process:
        change(observer, Transition.TRANSITION_CONFIGURE)
        assert not bag.exists()
        change(observer, Transition.TRANSITION_ACTIVATE)

        def heard_something() -> bool:
            other.publish(wrench_bytes(4))
            publisher.publish(wrench_bytes(5))
            return any(value not in ("", "0") for value in received(observer))

        assert spin_until(observer, heard_something)
        change(observer, Transition.TRANSITION_DEACTIVATE)
        found = messages(bag)  # while the process lives
        assert list(found) == ["/tool_1/wrench"]
        assert found["/tool_1/wrench"][0][1] == wrench_bytes(5)
        end(process, signal.SIGINT)


def test_what_was_recorded_outlives_a_killed_recorder(tmp_path: Path) -> None:
    """The file is not closed, but everything is in it some time after it came (flush period 1 s)."""
    bag = tmp_path / "bag"
    sent = [wrench_bytes(number) for number in range(COUNT)]
    with recorder(bag) as process:
        publish_burst(COUNT, RATE)
        deadline = time.monotonic() + LIMIT
        while recovered(bag, tmp_path)[-1:] != sent[-1:]:
            assert time.monotonic() < deadline, "the recorder does not write"
            time.sleep(0.2)  # asks again, at most LIMIT s: a recorder tells nobody that it has written
        os.killpg(process.pid, signal.SIGKILL)
        process.wait(LIMIT)
    assert not (bag / "metadata.yaml").exists()
    assert recovered(bag, tmp_path)[-COUNT:] == sent  # greetings come before


def test_a_disk_that_is_full_is_reported_and_never_a_success(tmp_path: Path, observer: Node) -> None:
    """What was written stays readable."""
    bag = tmp_path / "bag"
    with recorder(bag, room=300_000) as process:
        publish_burst()
        assert spin_until(observer, lambda: any("BAG_NOT_WRITABLE" in text for text in heard(observer)))
        text = end(process, signal.SIGINT, EXIT_INCOMPLETE)
    assert "check the free space" in text
    assert recovered(bag, tmp_path)


def test_a_ring_is_written_when_a_node_reports_a_fault_and_when_asked(tmp_path: Path, observer: Node) -> None:
    bag = tmp_path / "bag"
    faults = observer.create_publisher(DiagnosticArray, "/diagnostics", 10)
    fault = DiagnosticStatus(name="machine", level=DiagnosticStatus.ERROR, message="1401 E_STOP")

    def kept() -> bool:
        faults.publish(DiagnosticArray(status=[fault]))  # again and again, as nodes do: one fault all the same
        return (bag / "metadata.yaml").exists()

    with recorder(bag, ring=300.0, ring_after=0.2, split_size=0.02) as process:
        publish_burst(100)
        assert not list(tmp_path.glob("bag*"))
        assert spin_until(observer, kept)
        client = observer.create_client(Trigger, "recorder/snapshot")
        assert client.wait_for_service(LIMIT)
        future = client.call_async(Trigger.Request())
        assert spin_until(observer, future.done)
        assert (future.result().success, future.result().message) == (True, f"{bag}-2")
        text = end(process, signal.SIGINT)
    assert text.count("recorded") == 2
    assert "1401 E_STOP" in text
    for folder in (bag, tmp_path / "bag-2"):
        assert len(list(folder.glob("bag*_*.mcap"))) >= 2
        found = messages(folder)
        assert [data for _, data in found["/tool_1/wrench"]][-100:] == [wrench_bytes(number) for number in range(100)]
        assert len(found["/part/info"]) >= 1
        told = [time for time, _ in found["/diagnostics"]]
        assert len(told) == len(set(told))  # what came with the fault is there once
    assert not (tmp_path / "bag-3").exists()


def test_the_fault_of_another_cell_is_not_kept_and_a_name_that_is_taken_loses_none(
    tmp_path: Path, observer: Node
) -> None:
    bag = tmp_path / "bag"
    (tmp_path / "bag-2").mkdir()  # of a recorder before
    faults = observer.create_publisher(DiagnosticArray, "/diagnostics", 10)
    state = {"own": DiagnosticStatus.OK}

    def publish(number: int) -> None:
        machine = partial(DiagnosticStatus, hardware_id="isf")
        other = machine(name="/cell_b/recorder", level=DiagnosticStatus.ERROR, message=f"other {number}")
        own = machine(name="/cell_a/my_recorder_of_forces", level=state["own"], message="own")
        faults.publish(DiagnosticArray(status=[other, own]))

    def heard_of_other() -> bool:
        publish(0)
        return any(value.isdecimal() and int(value) > 10 for value in received(observer))

    with recorder(bag, remap="__ns:=/cell_a", ring=300.0, ring_after=0.2) as process:
        assert spin_until(observer, heard_of_other)
        assert not bag.exists()
        for taken in (bag, tmp_path / "bag-3"):
            state["own"] = DiagnosticStatus.ERROR

            def closed(folder: Path = taken) -> bool:
                publish(1)
                return (folder / "metadata.yaml").exists()

            assert spin_until(observer, closed)
            state["own"] = DiagnosticStatus.OK
            publish(2)
        text = end(process, signal.SIGINT)
    assert text.count("recorded") == 2
    assert "/cell_b" not in text


def recovered(bag: Path, folder: Path) -> list[bytes]:
    """Wrenches of tool 1 in a repaired copy of a bag that was not closed."""
    copy = folder / "repaired.mcap"
    copy.unlink(missing_ok=True)
    if not repair.whole_records(bag / "bag.mcap", copy):
        return []
    with Reader(copy) as reader:
        wrenches = [connection for connection in reader.connections if connection.topic == "/tool_1/wrench"]
        return [data for _, _, data in reader.messages(wrenches)] if wrenches else []


# -- observing -------------------------------------------------------------------------------------


@pytest.fixture
def observer() -> Iterator[Node]:
    rclpy.init()
    node = rclpy.create_node("observer")
    node.heard = []  # type: ignore[attr-defined]
    node.create_subscription(DiagnosticArray, "/diagnostics", lambda m: node.heard.extend(m.status), 10)
    yield node
    node.destroy_node()
    rclpy.try_shutdown()


def heard(node: Any) -> list[str]:
    return [status.message for status in node.heard]


def received(node: Any) -> list[str]:
    return [item.value for status in node.heard for item in status.values if item.key == "received"]


def spin_until(node: Node, condition: Callable[[], Any], timeout: float = LIMIT) -> bool:
    deadline = time.monotonic() + timeout
    while not condition() and time.monotonic() < deadline:
        rclpy.spin_once(node, timeout_sec=0.1)
    return bool(condition())


def change(node: Node, transition: int) -> None:
    client = node.create_client(ChangeState, "recorder/change_state")
    assert client.wait_for_service(LIMIT)
    request = ChangeState.Request(transition=Transition(id=transition))
    future = client.call_async(request)
    assert spin_until(node, future.done)
    assert future.result().success
