"""The file of a load cell: what ``isf calibrate-cell`` writes, with the rest of what is known of the cell added.

The readings are in any unit, so ``range`` has none; all else carries its unit. A rig file gives what is missing: its
cells read N and N m in axes of frame ``sheet``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from isf_core.errors import ErrorCode, IsfError
from isf_core.files import yaml_file
from isf_core.files.quantity import Angle, Force, Frequency, Length
from isf_core.files.rig import Rig, ToolAxis, load_rig
from isf_core.files.spindle_cells import CHANNELS
from isf_core.files.yaml_file import FileModel
from isf_core.types import Array
from pydantic import Field, model_validator
from scipy.spatial.transform import Rotation

from isf_load_cell.reading import GRAVITY, CellReading, CellSettings
from isf_load_cell.stream import Reading
from isf_load_cell.three_cells import RADIUS, ThreeCellReading, ThreeCellSettings

MAXIMUM_CONDITION = 1e6
"""A matrix worse than this tells nothing of a force in some direction."""


class RigMatrix(FileModel):
    """The piece for a rig file that ``isf calibrate-cell`` writes for readings in N and N m."""

    matrix: tuple[tuple[float, float, float, float, float, float], ...] = Field(min_length=6, max_length=6)
    """Reading = matrix times load."""


class ThreeCells(FileModel):
    """Three tri-axial cells at 120 degrees around a spindle (Torrao 2013, 3.4.1)."""

    height: Length = Field(gt=0, le=2.0)
    """From the plane of the cells to the tip of the tool in the spindle."""
    radius: Length = Field(default=RADIUS, gt=0, le=2.0)
    weight_height: Length = Field(default=0.1, gt=0)
    """From the plane of the cells to the centre of what hangs below them."""
    inconsistency_limit: Force = Field(default=math.inf, gt=0)
    """How far the nine channels may disagree at rest before one of them is left out; without it they are not
    compared."""
    inconsistency_ratio: float = Field(default=0.01, ge=0, lt=1)
    """Share of the force by which they may disagree beyond that."""


class CellFile(FileModel):
    """One load cell, or three around a spindle."""

    calibration_matrix: tuple[tuple[float, ...], ...] | None = None
    """Three or six rows: load (N, N m) = matrix times readings less those without load."""
    calibration_gains: dict[str, float] | None = None
    """N per unit, by the name of the channel: in the order of the components of a wrench, or in that of ``channels``;
    with ``three_cells`` x, y and axial of cell 1, then of cells 2 and 3."""
    load_cell: RigMatrix | None = None
    channels: tuple[str, ...] | None = None
    """Names of the readings, when they come by name (sensor_msgs/JointState) and not as a wrench."""
    three_cells: ThreeCells | None = None
    range: float | tuple[float, ...] | None = None
    """Largest reading, of all channels or of each, in the unit of the readings."""
    rotation: tuple[Angle, Angle, Angle] = (0.0, 0.0, 0.0)
    """How the cell is turned against frame sheet: about the fixed axes x, y, z, in this order."""
    weight: Force | None = Field(default=None, ge=0)
    """Of tool and holder below the cell; matters only where the cell is turned while it works."""
    weight_centre: tuple[Length, Length, Length] = (0.0, 0.0, 0.0)
    """From the origin of the cell, in its axes, for the torques."""
    rate: Frequency = Field(default=500.0, gt=1.0)
    """Of the readings; for the low-pass."""
    cutoff: Frequency = Field(default=0.0, ge=0)
    """Of the low-pass; 0: none. Force control has its own: a second one takes from its margin."""
    taps: int | None = Field(default=None, ge=1, le=10_000)
    frozen_after: int = Field(default=50, ge=2)
    """Readings in a row, all the same, that count as a frozen signal; one channel of three cells: while its load
    moves."""
    drift_limit: Force = Field(default=10.0, gt=0)
    """Change of the unloaded force from which a new tare is asked for."""

    @property
    def calibrated(self) -> bool:
        """Whether the file says what a reading is in N."""
        return any(item is not None for item in (self.calibration_matrix, self.calibration_gains, self.load_cell))

    @model_validator(mode="after")
    def _one_calibration(self) -> CellFile:
        given = [self.calibration_matrix, self.calibration_gains, self.load_cell]
        if sum(item is not None for item in given) > 1:
            raise ValueError("more than one of calibration_matrix, calibration_gains and load_cell")
        if self.cutoff >= 0.5 * self.rate:
            raise ValueError("cutoff must be below half the rate")
        if self.three_cells is not None:
            if self.calibration_gains is None or len(self.calibration_gains) != 9:
                raise ValueError(
                    "three_cells need nine calibration_gains: x, y, axial of cell 1, then of cells 2 and 3"
                )
            if self.channels is not None:
                raise ValueError("the channels of three_cells are named by calibration_gains")
        values = np.array([*(self.calibration_gains or {}).values(), *np.ravel(self._rows())])
        if not np.isfinite(values).all() or (self.calibration_gains and not values.all()):
            raise ValueError("a calibration is of finite numbers, gains are not zero")
        return self

    def _rows(self) -> list[float]:
        rows = self.calibration_matrix or ()
        if self.calibration_matrix is not None and (len(rows) not in (3, 6) or len({len(row) for row in rows}) != 1):
            raise ValueError("calibration_matrix has three or six rows of the same length")
        if rows and len(rows[0]) < len(rows):
            raise ValueError("calibration_matrix has fewer columns (readings) than rows (loads)")
        return [value for row in rows for value in row]


@dataclass(frozen=True)
class CellSetUp:
    """``reading`` of the cell, ``rotation`` (3, 3) from its axes to frame sheet as it is mounted, and the names of its
    channels; ``channels`` None: readings come as a wrench (6,)."""

    reading: Reading
    rotation: Array
    channels: tuple[str, ...] | None


def load_cell_set_up(file: str, rig: str, tool: int) -> CellSetUp:
    """The cell of ``file`` (path), of ``rig`` (name or path), or of the file with what the rig knows beside it. A rig
    whose tool has spindle cells gives those, if the file has no calibration.

    ``tool`` (1, 2) is the one whose weight the rig tells. Raises IsfError FILE_NOT_FOUND, FILE_SYNTAX, FILE_UNIT,
    FILE_FIELD.
    """
    if not file and not rig:
        raise IsfError(
            ErrorCode.FILE_FIELD,
            "no load cell is named",
            where="parameters file, rig",
            advice="file: of the cell, from isf calibrate-cell; rig: name or path of a rig whose cells read N",
        )
    cell = yaml_file.load(Path(file), CellFile) if file else CellFile()
    machine = load_rig(rig) if rig else None
    where = file or rig
    of_rig = None if machine is None else (machine.tool_1 if tool == 1 else machine.tool_2)
    weight = cell.weight
    if weight is None:
        weight = 0.0 if of_rig is None else of_rig.weight
    mass = weight / float(np.linalg.norm(GRAVITY))
    if of_rig is not None and of_rig.spindle_cells is not None and not cell.calibrated:
        return spindle_cells_set_up(of_rig, cell, where)
    turn = Rotation.from_euler("xyz", cell.rotation).as_matrix()
    if cell.three_cells is not None:
        return _three_cells(cell, cell.three_cells, turn, mass, where)
    matrix = _matrix(cell, machine, where)
    channels = cell.channels
    if channels is not None and (len(set(channels)) != len(channels) or len(channels) != matrix.shape[1]):
        raise IsfError(
            ErrorCode.FILE_FIELD,
            f"{matrix.shape[1]} readings by the calibration, but {len(set(channels))} different names",
            where=f"{where}: channels",
        )
    settings = CellSettings(
        rate=cell.rate,
        matrix=matrix,
        rotation=turn,
        range=_range(cell, machine, matrix.shape[1], where),
        cutoff=cell.cutoff,
        taps=cell.taps,
        mass=mass,
        centre=np.array(cell.weight_centre),
        frozen_after=cell.frozen_after,
        drift_limit=cell.drift_limit,
    )
    return CellSetUp(CellReading(settings), turn, channels)


def _three_cells(cell: CellFile, three: ThreeCells, turn: Array, mass: float, where: str) -> CellSetUp:
    gains = cell.calibration_gains or {}
    settings = ThreeCellSettings(
        gains=np.array(list(gains.values())).reshape(3, 3),
        range=_range(cell, None, 9, where).reshape(3, 3),
        height=three.height,
        rotation=turn,
        names=tuple(gains),
        rate=cell.rate,
        radius=three.radius,
        cutoff=cell.cutoff,
        taps=cell.taps,
        mass=mass,
        mass_height=three.weight_height,
        frozen_after=cell.frozen_after,
        drift_limit=cell.drift_limit,
        inconsistency_limit=three.inconsistency_limit,
        inconsistency_ratio=three.inconsistency_ratio,
    )
    return CellSetUp(ThreeCellReading(settings), turn, settings.names)


def spindle_cells_set_up(axis: ToolAxis, cell: CellFile | None = None, where: str = "") -> CellSetUp:
    """The spindle cells of a rig's tool ``axis``, which has some, with what the file ``cell`` says otherwise.

    Raises IsfError FILE_FIELD (channels or range of ``where`` are not those of nine).
    """
    cells, cell = axis.spindle_cells, cell or CellFile()
    assert cells is not None
    names = cell.channels or CHANNELS
    if len(set(names)) != 9 or len(names) != 9:
        raise IsfError(ErrorCode.FILE_FIELD, "the spindle cells of the rig have nine channels", where=where)
    turned = "rotation" in cell.model_fields_set
    turn = Rotation.from_euler("xyz", cell.rotation).as_matrix() if turned else cells.turn
    weight = axis.weight if cell.weight is None else cell.weight
    limit = np.full(9, cells.amplifier_range) if cell.range is None else _range(cell, None, 9, where)
    settings = ThreeCellSettings(
        gains=cells.gain_array,
        range=limit.reshape(3, 3),
        height=cells.height,
        rotation=turn,
        names=names,
        rate=cell.rate,
        radius=cells.radius,
        cutoff=cell.cutoff,
        taps=cell.taps,
        mass=weight / float(np.linalg.norm(GRAVITY)),
        mass_height=0.5 * cells.height,
        frozen_after=cell.frozen_after,
        drift_limit=cell.drift_limit,
        inconsistency_limit=cells.inconsistency_limit,
        inconsistency_ratio=cells.inconsistency_ratio,
    )
    return CellSetUp(ThreeCellReading(settings), turn, settings.names)


def _matrix(cell: CellFile, machine: Rig | None, where: str) -> Array:
    """(3 or 6, C) load per reading; readings that come as a wrench have six channels."""
    if cell.calibration_matrix is not None:
        matrix = np.array(cell.calibration_matrix)
    elif cell.calibration_gains is not None:
        matrix = np.diag(_gains(cell.calibration_gains, cell.channels, where))
    elif cell.load_cell is not None:
        matrix = _inverse(cell.load_cell.matrix, where)
    elif machine is not None:
        matrix = np.eye(6) if machine.load_cell.matrix is None else _inverse(machine.load_cell.matrix, where)
    else:
        raise IsfError(
            ErrorCode.FILE_FIELD,
            "no calibration",
            where=where,
            advice="calibration_matrix, calibration_gains or load_cell, as isf calibrate-cell writes them",
        )
    if not np.linalg.cond(matrix[:3]) < MAXIMUM_CONDITION:
        raise IsfError(
            ErrorCode.FILE_FIELD, "a force in some direction gives no reading", where=f"{where}: calibration"
        )
    if cell.channels is None:
        if matrix.shape == (3, 3):  # torques of a sensor that was calibrated for forces are passed on
            matrix = np.block([[matrix, np.zeros((3, 3))], [np.zeros((3, 3)), np.eye(3)]])
        if matrix.shape[1] != 6 or matrix.shape[0] not in (3, 6):
            raise IsfError(
                ErrorCode.FILE_FIELD,
                f"{matrix.shape[1]} readings do not come as a wrench",
                where=where,
                advice="name them: channels: [u1, u2, ...], and publish them by name (sensor_msgs/JointState, effort)",
            )
    elif matrix.shape[0] not in (3, 6):
        raise IsfError(
            ErrorCode.FILE_FIELD, "gains of three or six channels make a force, or nine of three_cells", where=where
        )
    return matrix


def _gains(gains: dict[str, float], channels: tuple[str, ...] | None, where: str) -> list[float]:
    """Of the ``channels`` in their order; without names of channels in that of the file."""
    if channels is None:
        return list(gains.values())
    if set(gains) != set(channels):
        raise IsfError(
            ErrorCode.FILE_FIELD,
            f"gains are those of {', '.join(gains)}, channels are {', '.join(channels)}",
            where=f"{where}: channels",
            advice="the names in calibration_gains are those of the channels; channels says which one reads x, y and z",
        )
    return [gains[name] for name in channels]


def _inverse(rows: tuple[tuple[float, ...], ...], where: str) -> Array:
    response = np.array(rows)
    if not (np.isfinite(response).all() and np.linalg.cond(response) < MAXIMUM_CONDITION):
        raise IsfError(ErrorCode.FILE_FIELD, "the matrix has no inverse", where=f"{where}: load_cell.matrix")
    return np.linalg.inv(response)


def _range(cell: CellFile, machine: Rig | None, channels: int, where: str) -> Array:
    """(channels,) largest readings; torques beside a range of three forces have none."""
    if cell.range is not None:
        limit = np.array([cell.range] * channels if isinstance(cell.range, float) else cell.range)
        if cell.channels is None and len(limit) == 3 and channels == 6:
            limit = np.concatenate([limit, np.full(3, np.inf)])
    elif machine is not None and channels == 6:
        limit = np.array([*machine.load_cell.force_range, *machine.load_cell.torque_range])
    else:
        raise IsfError(
            ErrorCode.FILE_FIELD,
            "no range: a saturated cell could not be detected",
            where=where,
            advice="range: largest reading, in the unit of the readings",
        )
    if len(limit) != channels or not (limit > 0.0).all():
        raise IsfError(
            ErrorCode.FILE_FIELD, f"range: one positive number, or one for each of {channels} readings", where=where
        )
    return limit
