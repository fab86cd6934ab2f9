"""Time per pose of the hexapod's inverse and forward kinematics, and what compiling and batches gain.

    ./isf python benchmarks/kinematics.py

Forward begins 1 mm and 0.5 deg away. The ratios are of times per pose, on the same poses and from the same start:
``ratio_inverse`` one pose after the other by the formulas for many, limits included, over the compiled ones;
``ratio_forward`` Newton's method in numpy with the same Jacobian over the compiled one, one pose after the other;
``ratio_batch`` the compiled one pose after the other over all poses at once.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable

import numpy as np
from isf_core.geometry.hexapod import Hexapod, spif_a
from isf_core.types import Array

POSES = 2000


def main() -> None:
    """Print one JSON object."""
    hexapod = spif_a()
    rng = np.random.default_rng(1)
    tips, tilts = rng.uniform(-0.09, 0.09, (POSES, 3)), rng.uniform(-0.25, 0.25, (POSES, 2))
    place = hexapod.place_of(tips, tilts)
    lengths = hexapod.lengths(place, tilts)
    near, leaning = place + rng.uniform(-1e-3, 1e-3, place.shape), tilts + rng.uniform(-8.7e-3, 8.7e-3, tilts.shape)
    found = hexapod.forward(lengths, near, leaning)
    singles = list(zip(lengths[:200], near, leaning, strict=False))
    one_by_one = best(lambda: [hexapod.forward(*one) for one in singles])
    in_numpy = best(lambda: [by_numpy(hexapod, *one) for one in singles])
    forward = best(lambda: hexapod.forward(lengths, near, leaning)) / POSES
    pairs = list(zip(tips[:500], tilts[:500], strict=True))
    pairs = [pair for pair in pairs if hexapod.reachable(*pair)]
    single = best(lambda: [hexapod.positions(*pair) for pair in pairs]) / len(pairs)
    many = best(lambda: [hexapod.reachable(*pair) and hexapod.strokes(*pair) is None for pair in pairs]) / len(pairs)
    print(
        json.dumps(
            {
                "inverse_us": round(1e6 * best(lambda: hexapod.strokes(tips, tilts)) / POSES, 2),
                "inverse_single_us": round(1e6 * single, 1),
                "reachable_us": round(1e6 * best(lambda: hexapod.reachable(tips, tilts)) / POSES, 2),
                "forward_us": round(1e6 * forward, 2),
                "forward_single_us": round(1e6 * one_by_one / 200, 1),
                "forward_in_numpy_us": round(1e6 * in_numpy / 200, 1),
                "ratio_inverse": round(many / single, 1),
                "ratio_forward": round(in_numpy / one_by_one, 1),
                "ratio_batch": round(one_by_one / 200 / forward, 1),
                "iterations": found.iterations,
                "largest_error_nm": round(1e9 * float(np.abs(found.place - place).max()), 4),
            }
        )
    )


def best(call: Callable[[], object], repeats: int = 7) -> float:
    """s, of the fastest of ``repeats`` calls."""
    times = []
    for _ in range(repeats):
        started = time.perf_counter()
        call()
        times.append(time.perf_counter() - started)
    return min(times)


def by_numpy(hexapod: Hexapod, lengths: Array, place: Array, tilt: Array) -> Array:
    """(5,) pose by Newton's method, by the formulas for many poses."""
    pose = np.concatenate([place, tilt])
    for _ in range(30):
        missing = lengths - hexapod.lengths(pose[:3], pose[3:])
        if np.abs(missing).max() < 1e-12:
            break
        pose += np.linalg.lstsq(hexapod.pose_jacobian(pose[:3], pose[3:])[:, :5], missing, rcond=None)[0]
    return pose


if __name__ == "__main__":
    main()
