"""A cell on two computers whose link loses and delays, then carries nothing: benchmarks/link.py, for its verdict."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]

pytestmark = [
    pytest.mark.graph,
    pytest.mark.clock,
    pytest.mark.slow,
    pytest.mark.skipif(
        os.geteuid() != 0 or not Path("/dev/net/tun").exists(), reason="network namespaces need root and /dev/net/tun"
    ),
]


def test_a_part_is_formed_over_a_bad_link_and_goes_on_after_a_cut() -> None:
    command = [sys.executable, str(ROOT / "benchmarks" / "link.py"), "--cases", "bad", "partition"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    bad, partition = json.loads(done.stdout)
    assert (bad["code"], bad["contours"]) == (0, 5), bad
    assert bad["frames_lost"] > 0.03 * bad["frames"]
    assert partition["code"] == 1502
    assert partition["released_after_s"] < 10.0
    assert partition["longest_silence_s"] < 2.0
    assert (partition["resumed"]["code"], partition["resumed"]["contours"]) == (0, 5), partition
