"""Recorder beside a cell by the wall clock at 500 Hz: messages per second, messages lost, processor time.

    ./isf python benchmarks/recorder.py                      # 20 s, 4,000 messages/s; about a minute
    ./isf python benchmarks/recorder.py --seconds 60 --extra 900

A cell of nodes forms `mini_cone` by the clock with wrenches and targets of both tools at 500 Hz each, under the example
driver (``--simulated``: the simulated machine, which is slower than that on two cores); its recorder writes the bag. A
publisher in a process of its own adds two reliable streams that a cell without holder and load cells leaves free
(holder/target and tool_1/raw), ``--extra`` messages/s each. While it sends, the processor time of the recorder's
process is read from the system, and afterwards every message of the streams is looked for in the bag.
"""

from __future__ import annotations

import argparse
import json
import os
import struct
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from isf_cell.options import RunOptions
from isf_cell.processes.cell_nodes import CellChoice, cell_nodes
from isf_cell.processes.domain_lock import alone_in_domain
from isf_cell.processes.process_group import ProcessGroup
from isf_cell.run.graph_run import CellClient
from isf_core.errors import IsfError
from isf_core.files.job import JobFile

JOB = Path(__file__).resolve().parents[1] / "examples" / "jobs" / "mini_cone.yaml"
RATE = 500.0
"""Hz, of control, wrenches and targets."""

STREAMS = ("holder/target", "tool_1/raw")


def publish(seconds: float, rate: float) -> None:
    """Send both streams once somebody listens and the cell forms; prints begin and end, ns since 1970, and counts."""
    import rclpy
    from geometry_msgs.msg import PoseStamped, WrenchStamped
    from isf_msgs.msg import ForceCtrlState
    from isf_ros import qos
    from rclpy.duration import Duration
    from rclpy.qos import QoSProfile
    from rclpy.serialization import serialize_message

    rclpy.init()
    node = rclpy.create_node("beside")
    deep = QoSProfile(depth=10_000, reliability=qos.STREAM.reliability, durability=qos.STREAM.durability)
    kinds = (PoseStamped, WrenchStamped)
    publishers = [node.create_publisher(kind, name, deep) for kind, name in zip(kinds, STREAMS, strict=True)]
    messages = [bytearray(serialize_message(kind())) for kind in kinds]
    modes: list[int] = []
    node.create_subscription(ForceCtrlState, "force_ctrl/state", lambda state: modes.append(state.mode), qos.STREAM)
    while not (len(modes) > 50 and all(item.get_subscription_count() for item in publishers)):
        rclpy.spin_once(node, timeout_sec=0.1)
    begin, start = time.time_ns(), time.monotonic()
    number = 0
    while (now := time.monotonic() - start) < seconds:
        while number < now * rate:
            for publisher, message in zip(publishers, messages, strict=True):
                struct.pack_into("<I", message, 8, number)  # nanoseconds of the stamp, after the head and the seconds
                publisher.publish(bytes(message))
            number += 1
        time.sleep(0.5e-3)  # this loop is the clock of the two streams: what is due is sent twice a millisecond
    end = time.time_ns()
    taken = all(publisher.wait_for_all_acked(Duration(seconds=10)) for publisher in publishers)
    print(json.dumps({"begin": begin, "end": end, "sent": number, "acknowledged": taken}), flush=True)


def processor_time(pid: int) -> float:
    """s of one core that the process has taken."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


@contextmanager
def forming(folder: Path, job: JobFile, *, simulated: bool) -> Iterator[int]:
    """A cell that forms ``job`` by the clock, recorded in ``folder``/bag; gives the process of its recorder."""
    choice = CellChoice(lockstep=False, machine=simulated, bag=str(folder / "bag"))
    with alone_in_domain(), ProcessGroup(folder / "logs") as group:
        if not simulated:
            group.start("isf_driver_example", "driver", {"rate": RATE}, name="machine")
        for node in cell_nodes(choice):
            group.start(node.package, node.executable, node.parameters, outlives=node.outlives)
        client = CellClient()
        try:
            client.wait_ready(group)

            def form() -> None:
                with suppress(IsfError):  # the cell is ended in mid-part
                    client.form(job, RunOptions(), lambda _: None, group)

            part = threading.Thread(target=form)
            part.start()
            yield group["recorder"].popen.pid
            group.stop()
            part.join()
        finally:
            client.close()


def measure(seconds: float, extra: float, *, simulated: bool) -> dict[str, object]:
    """One run; see above."""
    from isf_analysis.bag.open_bag import open_bag

    job = JobFile(JOB.read_text(encoding="utf-8").replace("rate: 250 Hz", f"rate: {RATE:g} Hz"), JOB.parent)
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        beside = [sys.executable, __file__, "--publish", "--seconds", str(seconds), "--extra", str(extra)]
        with (
            forming(folder, job, simulated=simulated) as pid,
            subprocess.Popen(beside, stdout=subprocess.PIPE, text=True) as publisher,
        ):
            used = [(time.time_ns(), processor_time(pid))]
            while publisher.poll() is None:
                time.sleep(0.05)  # the period of the measurement of processor time, which counts in 10 ms
                used.append((time.time_ns(), processor_time(pid)))
            assert publisher.stdout is not None
            told = json.loads(publisher.stdout.read())
        inside = [item for item in used if told["begin"] <= item[0] <= told["end"]]
        share = (inside[-1][1] - inside[0][1]) / (1e-9 * (inside[-1][0] - inside[0][0]))
        counts: dict[str, int] = {}
        every = 0
        with open_bag(folder / "bag") as bag:
            for block in bag.blocks(bag.connections):
                during = int(((block.times >= told["begin"]) & (block.times <= told["end"])).sum())
                every += during
                name = block.connection.topic.lstrip("/")
                counts[name] = counts.get(name, 0) + (len(block.times) if name in STREAMS else during)
    span = 1e-9 * (told["end"] - told["begin"])
    return {
        "messages_per_s": every / span,
        "wrenches_per_s": counts.get("tool_1/wrench", 0) / span,
        "targets_per_s": counts.get("tool_1/target", 0) / span,
        "sent": told["sent"],
        "lost": {name: told["sent"] - counts.get(name, 0) for name in STREAMS},
        "share_of_a_core": share,
        "load": os.getloadavg()[0],
    }


def main() -> None:
    """Measure, or be the publisher."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--extra", type=float, default=1000.0, help="messages/s on each of two topics")
    parser.add_argument("--publish", action="store_true", help=argparse.SUPPRESS)
    parser.add_argument("--simulated", action="store_true", help="the simulated machine instead of the example driver")
    given = parser.parse_args()
    if given.publish:
        publish(given.seconds, given.extra)
    else:
        print(json.dumps(measure(given.seconds, given.extra, simulated=given.simulated), indent=2))


if __name__ == "__main__":
    main()
