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
from scipy.spatial.transform import Rotation

HEADER = "# time_s x_mm y_mm z_mm phi_deg theta_deg psi_deg fx_N fy_N fz_N fx2_N fy2_N"

_FORMAT = " ".join(["%.3f"] * 4 + ["%.4f"] * 3 + ["%.2f"] * 5)


def lines(rows: Iterable[Array]) -> Iterator[str]:
    """Rows (12,) in s, mm, deg and N as lines of the log; what is not known is ``nan``."""
    for row in rows:
        yield f"{_FORMAT % tuple(row)}\n"


def pose_angles(x: float, y: float, z: float, w: float) -> Array:
    """(3,) deg about x, y and z (Rz Ry Rx, Torrao 2013, eq. 4.22) of a quaternion; NaN for one of no length."""
    try:
        return np.asarray(Rotation.from_quat([x, y, z, w]).as_euler("ZYX", degrees=True))[::-1]
    except ValueError:
        return np.full(3, np.nan)


def check_free(path: Path) -> None:
    """Raise IsfError FILE_NOT_WRITABLE when ``path`` exists: a log is never overwritten."""
    if path.exists():
        raise IsfError(ErrorCode.FILE_NOT_WRITABLE, "exists", where=str(path), advice="choose another --log")


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
        """Append a sample (12,); raises IsfError FILE_NOT_WRITABLE."""
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
