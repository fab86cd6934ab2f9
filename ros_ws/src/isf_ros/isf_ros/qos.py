"""The QoS profiles of the cell, by what a topic carries; no node makes its own."""

from __future__ import annotations

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy


def _profile(depth: int, reliability: ReliabilityPolicy, durability: DurabilityPolicy) -> QoSProfile:
    return QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=depth, reliability=reliability, durability=durability)


STREAM = _profile(10, ReliabilityPolicy.RELIABLE, DurabilityPolicy.VOLATILE)
"""Wrenches, targets and states at or near the control rate."""

STREAM_SOURCE = _profile(4000, ReliabilityPolicy.RELIABLE, DurabilityPolicy.VOLATILE)
"""The publishing side of STREAM: what a cell at 500 Hz sends in 8 s (in lockstep sooner: it goes as fast as it can) is
kept until it is acknowledged, so that a recorder that is held up for a moment loses nothing; a controller's own queue
stays short."""

READINGS = _profile(300, ReliabilityPolicy.RELIABLE, DurabilityPolicy.VOLATILE)
"""Raw readings at the control rate, as node load_cell takes them: in lockstep all those of a tare come at once."""

SENSOR = _profile(5, ReliabilityPolicy.BEST_EFFORT, DurabilityPolicy.VOLATILE)
"""Decimated poses and the clock: the newest matters, a lost one does not."""

LATCHED = _profile(1, ReliabilityPolicy.RELIABLE, DurabilityPolicy.TRANSIENT_LOCAL)
"""The present contour, paths, target, scan: late subscribers get the last one."""

CHANGES = _profile(20, ReliabilityPolicy.RELIABLE, DurabilityPolicy.TRANSIENT_LOCAL)
"""States told at every change: late subscribers get the last ones, and nobody misses a short one."""

EVENT = _profile(50, ReliabilityPolicy.RELIABLE, DurabilityPolicy.VOLATILE)
"""One message per contour that nobody may miss."""

TF = _profile(100, ReliabilityPolicy.RELIABLE, DurabilityPolicy.VOLATILE)
"""Transforms, as tf2 subscribes to them."""

TF_STATIC = _profile(100, ReliabilityPolicy.RELIABLE, DurabilityPolicy.TRANSIENT_LOCAL)
"""Transforms that stay, as tf2 subscribes to them: each is told once."""
