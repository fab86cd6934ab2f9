"""Error map of a two-tool machine: how much farther apart than commanded the tips are, over the work space.

Measured with a dial gauge between the tools on a grid of places (Praveen 2020, 2.4) and fitted by a plane with a
radial sag, e = c0 + c1 x + c2 y + c3 r + c4 z, r the distance from the centre of the clamp. The form is our own: the
paper prints none, but this one reproduces its ten published extremes within 0.03 mm.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.bounded import read_lines
from isf_core.types import Array

from isf_planner.part.mesh_checks import place_text

RESIDUAL = 0.03e-3
"""m, largest deviation of a reading from the fit that is not worth a warning."""

COLUMNS = "x_mm,y_mm,z_mm,error_mm"


@dataclass(frozen=True)
class MachineError:
    """A fitted map.

    Attributes
    ----------
    coefficients : (5,) m and m/m, of 1, x, y, r, z
    residual : m, largest deviation of a reading, and ``place`` (3,) m where
    """

    coefficients: Array
    residual: float
    place: Array

    def at(self, points: Array) -> Array:
        """(N,) m, error at ``points`` (N, 3) m."""
        return np.asarray(_basis(points) @ self.coefficients)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Told when a reading does not fit."""
        if self.residual <= RESIDUAL:
            return ()
        return (
            f"the machine error read at {place_text(self.place)} is {self.residual * 1e3:.3f} mm off the fitted map",
        )


def fit(points: Array, errors: Array) -> MachineError:
    """Map of readings ``errors`` (N,) m at ``points`` (N, 3) m; readings in one plane tell nothing about z.

    Raises
    ------
    IsfError : COMPENSATION_FAILED when the places do not determine the map
    """
    basis = _basis(points)
    used = [0, 1, 2, 3] + ([4] if len(points) and np.ptp(points[:, 2]) > 1e-6 else [])
    # columns of equal size, so that the rank says whether the places determine the map
    scale = np.abs(basis[:, used]).max(axis=0, initial=1e-9)
    if len(points) < len(used) or np.linalg.matrix_rank(basis[:, used] / scale, 1e-6) < len(used):
        raise IsfError(
            ErrorCode.COMPENSATION_FAILED,
            f"{len(points)} readings do not determine the machine error",
            where="path.machine_error",
            advice="read the gauge on a grid of at least 3 x 3 places",
        )
    coefficients = np.zeros(5)
    coefficients[used] = np.linalg.lstsq(basis[:, used] / scale, errors, rcond=None)[0] / scale
    off = np.abs(basis @ coefficients - errors)
    worst = int(np.argmax(off))
    return MachineError(coefficients, float(off[worst]), points[worst])


def load(path: Path) -> MachineError:
    """Map of a CSV file with the columns x_mm, y_mm, z_mm, error_mm; IsfError FILE_NOT_FOUND, FILE_SYNTAX or of fit."""
    try:
        lines = read_lines(path)
    except FileNotFoundError as error:
        raise IsfError(
            ErrorCode.FILE_NOT_FOUND, "no such file", where=str(path), advice="path.machine_error of the job"
        ) from error
    except OSError as error:
        what = f"cannot be read: {error.strerror}"
        raise IsfError(ErrorCode.FILE_SYNTAX, what, where=str(path), advice=f"first line: {COLUMNS}") from error
    if not lines or lines[0].replace(" ", "") != COLUMNS:
        raise IsfError(
            ErrorCode.FILE_SYNTAX, "the columns are not named", where=f"{path}:1", advice=f"first line: {COLUMNS}"
        )
    rows = []
    for number, line in enumerate(lines[1:], start=2):
        if not line.strip():
            continue
        try:
            row = [float(value) for value in line.split(",")]
        except ValueError:
            row = []
        if len(row) != 4 or not np.isfinite(row).all():
            raise IsfError(ErrorCode.FILE_SYNTAX, "is not four numbers", where=f"{path}:{number}", advice=COLUMNS)
        rows.append(row)
    table = np.array(rows).reshape(-1, 4) * 1e-3
    return fit(table[:, :3], table[:, 3])


def _basis(points: Array) -> Array:
    radius = np.hypot(points[:, 0], points[:, 1])
    return np.column_stack([np.ones(len(points)), points[:, 0], points[:, 1], radius, points[:, 2]])
