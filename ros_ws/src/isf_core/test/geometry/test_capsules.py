"""Distances of links from boxes and from each other, against the nearest of many sampled points."""

from __future__ import annotations

import numpy as np
import pytest
from isf_core.geometry.capsules import Box, segment_to_box, segment_to_segment


def test_segment_to_box_is_the_nearest_of_sampled_points() -> None:
    rng = np.random.default_rng(0)
    box = Box((-0.2, -0.1, 0.0), (0.3, 0.1, 0.4), "box")
    starts, ends = rng.uniform(-1, 1, (40, 3)), rng.uniform(-1, 1, (40, 3))
    points = starts[:, None] + np.linspace(0, 1, 20001)[:, None] * (ends - starts)[:, None]
    outside = np.maximum(np.maximum(np.array(box.low) - points, points - np.array(box.high)), 0.0)
    sampled = np.linalg.norm(outside, axis=-1).min(axis=1)
    np.testing.assert_allclose(segment_to_box(starts, ends, box), sampled, atol=2e-4)
    assert (sampled == 0.0).any()
    assert (sampled > 0.1).any()


def test_distances_that_can_be_read_off() -> None:
    box = Box((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), "box")
    start, end = np.array([2.0, 0.5, 0.5]), np.array([4.0, 0.5, 0.5])
    assert segment_to_box(start, end, box) == pytest.approx(1.0, abs=1e-9)
    crossing = np.array([0.0, 0.0, 2.0]), np.array([1.0, 1.0, 2.0])
    assert segment_to_segment(*crossing, np.array([0.0, 1.0, 2.5]), np.array([1.0, 0.0, 2.5])) == pytest.approx(
        0.5, abs=1e-9
    )
    assert segment_to_segment(start, end, start + [0, 3.0, 0], end + [0, 3.0, 0]) == pytest.approx(3.0, abs=1e-9)
