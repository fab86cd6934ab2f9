"""Standard output of the command: results alone, whatever the libraries of this process print."""

from __future__ import annotations

import os
import sys


def keep_for_results() -> None:
    """From now on only what Python writes to ``sys.stdout`` reaches standard output; the rest goes to standard error.

    The middleware and its logging print to file descriptor 1 from C and C++, in the midst of the object of ``--json``.
    """
    sys.stdout.flush()
    results = os.dup(1)
    os.dup2(2, 1)
    stream = sys.stdout
    sys.stdout = os.fdopen(
        results, "w", encoding=stream.encoding, errors=stream.errors, buffering=1 if stream.isatty() else -1
    )
