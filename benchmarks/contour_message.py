"""How long a contour takes to become a message, to be published, and to become arrays again.

    ./isf python benchmarks/contour_message.py

Claim of docs/reference/architecture.md: a contour of 2,000 points converts and publishes in under 2 ms. As a yardstick
of this computer the same contact points are sent as ``nav_msgs/Path``.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
import rclpy
from builtin_interfaces.msg import Time
from isf_core.contour import Contour, Process
from isf_msgs.msg import Contour as ContourMessage
from isf_ros import conversion, qos
from nav_msgs.msg import Path
from rclpy.serialization import deserialize_message, serialize_message

POINTS, REPEATS = 2000, 200


def sample() -> Contour:
    """A contour of POINTS points with every array filled."""
    random = np.random.default_rng(1)
    xyz = [random.normal(size=(POINTS, 3)) for _ in range(4)]
    one = [random.random(POINTS) for _ in range(3)]
    return Contour("plan", 0, 1, Process.DSIF, 0.03, xyz[0], xyz[1], one[0], one[1], xyz[2], xyz[3], one[2])


def median_ms(work: Callable[[], object], repeats: int = REPEATS) -> float:
    """Median duration in ms."""
    times = []
    for _ in range(repeats):
        started = time.perf_counter()
        work()
        times.append(time.perf_counter() - started)
    return 1e3 * float(np.median(times))


def main() -> None:
    """Print the table."""
    rclpy.init()
    node = rclpy.create_node("benchmark")
    node.create_subscription(ContourMessage, "contour", lambda _: None, qos.LATCHED)
    publisher = node.create_publisher(ContourMessage, "contour", qos.LATCHED)
    paths = node.create_publisher(Path, "path", qos.LATCHED)
    contour = sample()
    raw = serialize_message(conversion.contour_to_message(contour))
    rows = {
        "convert and publish a contour": median_ms(lambda: publisher.publish(conversion.contour_to_message(contour))),
        "receive and convert a contour": median_ms(
            lambda: conversion.contour_from_message(deserialize_message(raw, ContourMessage))
        ),
        "convert and publish nav_msgs/Path": median_ms(
            lambda: paths.publish(conversion.path_to_message(contour.contact, Time())), repeats=20
        ),
    }
    for name, duration in rows.items():
        print(f"{name:36s} {duration:8.3f} ms")
    names = list(rows)
    print(f"{'Path over contour':36s} {rows[names[2]] / rows[names[0]]:8.0f} x")
    node.destroy_node()
    rclpy.shutdown()


if __name__ == "__main__":
    main()
