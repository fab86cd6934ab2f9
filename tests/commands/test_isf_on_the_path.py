"""``isf`` where nothing but the workspace is sourced, as a user of ROS does it."""

from __future__ import annotations

import subprocess
from pathlib import Path

from isf_core import __version__

ROOT = Path(__file__).resolve().parents[2]


def test_a_sourced_workspace_has_the_command(tmp_path: Path) -> None:
    script = f". {ROOT}/ros_ws/install/setup.bash && isf version"
    command = ["env", "-i", f"HOME={tmp_path}", "PATH=/usr/bin:/bin", "bash", "--noprofile", "--norc", "-c", script]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == __version__
