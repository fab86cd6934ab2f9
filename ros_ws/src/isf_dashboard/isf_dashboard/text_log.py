"""The log of the cell as text: a table of 12 columns, one row per sample, time ascending.

After Torrao 2013, section 6.1.1: a matrix of time, six of the pose and five forces. There the last two are presumably
the horizontal forces of a second set of load cells; here they are those of tool 2.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TextIO

import numpy as np
from isf_core.errors import ErrorCode, IsfError
from isf_core.types import Array

from isf_dashboard.history import COLUMNS

LOGGED = ("t", "x1", "y1", "z1", "phi1", "theta1", "psi1", "fx1", "fy1", "fz1", "fx2", "fy2")
"""Columns of a sample: s, mm, deg, N."""

HEADER = "# time_s x_mm y_mm z_mm phi_deg theta_deg psi_deg fx_N fy_N fz_N fx2_N fy2_N"

_CHOSEN = [COLUMNS.index(name) for name in LOGGED]
_FORMAT = " ".join(["%.3f"] * 4 + ["%.4f"] * 3 + ["%.2f"] * 5)


def lines(rows: Iterable[Array]) -> Iterator[str]:
    """The rows (C,) of a table of samples as lines of the log; what is not known is ``nan``."""
    for row in rows:
        yield f"{_FORMAT % tuple(np.asarray(row)[_CHOSEN])}\n"


class LogFile:
    """A log that is written as the samples come. Rows whose time does not ascend are left out."""

    def __init__(self, path: Path) -> None:
        """Begin the file ``path``; raises IsfError FILE_NOT_WRITABLE, also where it exists."""
        self.path, self._last = path, -np.inf
        try:
            self._file: TextIO = path.open("x", encoding="ascii", buffering=1)  # a row at a time
            self._file.write(f"{HEADER}\n")
        except OSError as error:
            raise _not_writable(path, error) from error

    def add(self, row: Array) -> None:
        """Append a sample; raises IsfError FILE_NOT_WRITABLE."""
        if not row[0] > self._last:
            return
        self._last = float(row[0])
        try:
            self._file.writelines(lines([row]))
        except OSError as error:
            raise _not_writable(self.path, error) from error

    def close(self) -> None:
        """End the file; raises IsfError FILE_NOT_WRITABLE."""
        try:
            self._file.close()
        except OSError as error:
            raise _not_writable(self.path, error) from error


def _not_writable(path: Path, error: OSError) -> IsfError:
    return IsfError(ErrorCode.FILE_NOT_WRITABLE, f"the log: {error.strerror}", where=str(path), advice="another name")
