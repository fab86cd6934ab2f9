"""Speed and memory of a bag read into tables, against the reader and deserialiser of rosbags: two minutes.

Makes a bag as a cell at 500 Hz records it (wrenches, targets, states, poses, diagnostics), reads every topic into
columns as ``isf_analysis`` does, and the same messages by rosbags. Checks that both hold the same numbers.

usage: ./isf python benchmarks/bag_tables.py [MEGABYTES] [--compression zstd]
"""

from __future__ import annotations

import argparse
import resource
import tempfile
import time
from pathlib import Path

import isf_analysis
import numpy as np
from isf_analysis.bag.bag_file import BagFile, Storage
from isf_analysis.bag.tables import read_tables
from isf_analysis.bag.topics import CELL, cell_types, make_message
from rosbags.rosbag2 import Reader

RATE = 500.0
EVERY = {"tool_1/wrench": 1, "tool_2/wrench": 1, "tool_1/target": 1, "tool_2/target": 1}
EVERY |= {"tool_1/pose": 10, "tool_2/pose": 10, "machine/state": 10, "force_ctrl/state": 10, "/clock": 10}
EVERY |= {"/diagnostics": 250}
NANO = 1_000_000_000


def make_bag(folder: Path, megabytes: float, compression: str) -> Path:
    """A bag of about so many megabytes (before compression) in ``folder``."""
    types, rng = cell_types(), np.random.default_rng(1)
    bag = BagFile(folder, Storage(compression=compression))
    topics = {topic.name: topic for topic in CELL if topic.name in EVERY}
    connections = {name: bag.add(topic) for name, topic in topics.items()}
    messages = {name: make_message(topic.type) for name, topic in topics.items()}
    for name, message in messages.items():
        if hasattr(message, "header"):
            message.header.frame_id = "sheet"
        if name == "/diagnostics":
            pair = make_message("diagnostic_msgs/msg/KeyValue", key="state", value="active")
            message.status = [make_message("diagnostic_msgs/msg/DiagnosticStatus", name="machine", values=[pair] * 8)]
    written, tick = 0, 0
    while written < megabytes * 1e6:
        now = round(tick * NANO / RATE)
        for name, every in EVERY.items():
            if tick % every:
                continue
            message = messages[name]
            stamp = message.clock if name == "/clock" else message.header.stamp
            stamp.sec, stamp.nanosec = divmod(now, NANO)
            if name.endswith("wrench"):
                message.wrench.force.z = float(rng.normal(400.0, 10.0))
            elif name.endswith(("target", "pose")):
                message.pose.position.x = float(rng.normal(0.0, 1e-2))
            data = types.serialize_cdr(message, topics[name].type)
            bag.write(connections[name], NANO + now, data)
            written += len(data) + 31
        tick += 1
    bag.close()
    return folder


def by_tables(path: Path) -> tuple[float, int, float]:
    """s, rows, and the sum of the axial forces as a check."""
    started, rows, total = time.perf_counter(), 0, 0.0
    with isf_analysis.open(path) as bag:
        for name, columns in read_tables(bag.raw, bag.connections):
            rows += len(columns["received"])
            if name == "/tool_1/wrench":
                total += float(columns["wrench.force.z"].sum())
    return time.perf_counter() - started, rows, total


def by_rosbags(path: Path) -> tuple[float, int, float]:
    """The same by the reader and deserialiser of rosbags, kept as columns of what the check needs alone."""
    types = cell_types()
    started, rows, forces = time.perf_counter(), 0, []
    with Reader(path) as reader:
        for connection, _, data in reader.messages():
            message = types.deserialize_cdr(data, connection.msgtype)
            rows += 1
            if connection.topic == "/tool_1/wrench":
                forces.append(message.wrench.force.z)
    return time.perf_counter() - started, rows, float(np.sum(forces))


def main() -> None:
    """Print what was measured."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("megabytes", nargs="?", type=float, default=200.0)
    parser.add_argument("--compression", default="none", choices=("none", "zstd"))
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        path = make_bag(Path(folder) / "bag", arguments.megabytes, arguments.compression)
        size = sum(file.stat().st_size for file in path.iterdir()) / 1e6
        before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
        ours, rows, total = by_tables(path)
        memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
        theirs, messages, expected = by_rosbags(path)
    if rows != messages or not np.isclose(total, expected, rtol=1e-12):
        raise SystemExit(f"not the same: {rows} rows of {messages} messages, sums {total} and {expected}")
    print(f"bag of {size:.0f} MB, {messages} messages")
    print(f"tables  {ours:6.1f} s, {size / ours:5.0f} MB/s, largest memory {memory:.0f} MB ({before:.0f} MB before)")
    print(f"rosbags {theirs:6.1f} s, {size / theirs:5.0f} MB/s: {theirs / ours:.1f} times as long")


if __name__ == "__main__":
    main()
