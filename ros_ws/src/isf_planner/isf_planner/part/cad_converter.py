"""Program that converts STEP or IGES from standard input to GLB on standard output, in mm: a process of its own.

A damaged file can end the process that OpenCASCADE runs in (a fault of memory access), which the cell must outlive.
"""

from __future__ import annotations

import os
import sys
from typing import Any


def main() -> None:
    """Arguments: "step" or "iges", chord error in mm, turn of the surface over one facet in rad.

    Exit code 1 with the error of the library as the last line on standard error.
    """
    kind, chord, turn = sys.argv[1], float(sys.argv[2]), float(sys.argv[3])
    output = os.dup(1)
    os.dup2(2, 1)  # the library prints what it finds wrong
    import cascadio  # prints, too

    of_kind: Any = cascadio.FileType.STEP if kind == "step" else cascadio.FileType.IGES
    # one thread, so that a plan repeats bit by bit
    made = cascadio.to_glb_bytes(
        sys.stdin.buffer.read(), of_kind, tol_linear=chord, tol_angular=turn, tol_relative=False, use_parallel=False
    )
    with os.fdopen(output, "wb") as file:
        file.write(bytes(made))


if __name__ == "__main__":
    main()
