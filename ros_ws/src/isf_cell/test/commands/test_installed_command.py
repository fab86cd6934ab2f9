"""The file that is ``isf`` where the workspace is sourced."""

from __future__ import annotations

import runpy
from pathlib import Path

INSTALLED = Path(__file__).resolve().parents[2] / "bin" / "isf"


def test_a_process_of_a_pool_that_reads_it_does_not_run_it() -> None:
    """A spawned process executes the file of its owner under this name; running the command there ended both."""
    assert "main" in runpy.run_path(str(INSTALLED), run_name="__mp_main__")
