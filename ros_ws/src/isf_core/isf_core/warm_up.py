"""Compile the core's kernels once, so that a hexapod's first pose is there at once: ``python -m isf_core.warm_up``."""

from __future__ import annotations

import sys
import time

import numpy as np

from isf_core.geometry.hexapod import spif_a


def warm_up() -> float:
    """One pose there and back; returns the wall time, s. Kernels found in the cache cost little."""
    started = time.perf_counter()
    spif_a().tip(spif_a().positions(np.zeros(3)))
    return time.perf_counter() - started


if __name__ == "__main__":
    print(f"kernels of the core ready in {warm_up():.1f} s", file=sys.stderr)
