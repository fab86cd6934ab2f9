"""After the warm-ups nothing is left to compile: a node that compiles then looks dead."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]

SCRIPT = """
import importlib, pkgutil, sys
from pathlib import Path
import isf_sim
from isf_cell import in_process
from isf_core.files.job import load_job
from isf_sim.warm_up import warm_up
from numba.core.registry import CPUDispatcher

kernels = {}
for found in pkgutil.walk_packages(isf_sim.__path__, "isf_sim."):
    if not found.name.endswith(".node") and ".ros" not in found.name:
        module = importlib.import_module(found.name)
        kernels |= {f"{found.name}.{name}": v for name, v in vars(module).items() if isinstance(v, CPUDispatcher)}
warm_up()
ready = {name: set(kernel.signatures) for name, kernel in kernels.items()}
assert len(kernels) > 40
in_process.form(load_job(Path(sys.argv[1])))
late = sorted(name for name, kernel in kernels.items() if set(kernel.signatures) - ready[name])
sys.exit(f"compiled in mid-part: {late}" if late else 0)
"""


def test_forming_a_part_compiles_nothing_after_the_warm_up() -> None:
    """A whole small part, both tools, correction and force control."""
    run = subprocess.run(
        [sys.executable, "-c", SCRIPT, str(ROOT / "examples/jobs/mini_cone.yaml")],
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )
    assert run.returncode == 0, run.stderr[-2000:]


POSES = """
import sys
import numpy as np
from isf_core.geometry import hexapod_kernels
from isf_core.geometry.hexapod import spif_a
from isf_core.warm_up import warm_up
from numba.core.registry import CPUDispatcher

warm_up()
kernels = {name: v for name, v in vars(hexapod_kernels).items() if isinstance(v, CPUDispatcher)}
ready = {name: set(kernel.signatures) for name, kernel in kernels.items()}
assert len(kernels) > 3
hexapod, still = spif_a(tool_length=0.4, along_normals=True), np.zeros((3, 5)).T[:3]
still.flags.writeable = False
for tip in (np.zeros(3), [0, 0, 0], still[0], still[:, 0]):
    strokes = hexapod.positions(tip, [0, 0])
    hexapod.tip(strokes.tolist())
    hexapod.forward(np.tile(strokes + 0.942, (3, 1)).T.copy().T, still[:, :3], still[:, :2])
late = sorted(name for name, kernel in kernels.items() if set(kernel.signatures) - ready[name])
sys.exit(f"compiled after the warm-up: {late}" if late else 0)
"""


def test_poses_of_the_hexapod_compile_nothing_after_the_warm_up() -> None:
    """Of numbers in every form: lists, integers, columns, arrays that cannot be written to."""
    run = subprocess.run([sys.executable, "-c", POSES], capture_output=True, text=True, timeout=300, check=False)
    assert run.returncode == 0, run.stderr[-2000:]
