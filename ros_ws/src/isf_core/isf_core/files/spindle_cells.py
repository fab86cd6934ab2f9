"""Three tri-axial load cells around a spindle, as a rig file describes them (Torrao 2013, 3.4).

Nine strain-gauge bridges with an amplifier each: horizontal x and y and axial of cell 1, then of cells 2 and 3. The
cells stand at 0, 120 and -120 degrees in the plane between platform and spindle, the tip below it. An axial channel
counts positive where it carries a force up the tool. What node ``load_cell`` reads and what the simulated machine gives
out are both from here; the model behind each is its own.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from pydantic import Field, model_validator

from isf_core.files.quantity import Angle, Force, Length, Time, Voltage, VoltageGain
from isf_core.files.yaml_file import FileModel
from isf_core.types import Array

CHANNELS = ("x1", "y1", "z1", "x2", "y2", "z2", "x3", "y3", "z3")
"""Names of the channels on ``tool_k/raw_cells``, in the order of the rows of gains."""

Channel = Literal["x1", "y1", "z1", "x2", "y2", "z2", "x3", "y3", "z3"]


class CellFault(FileModel):
    """What happens to a channel of the simulated machine."""

    channel: Channel
    """Which one."""
    kind: Literal["open", "saturated", "stuck", "offset", "swapped"]
    """`open`: a broken wire, no number; `saturated`: the end of the amplifier's range; `stuck`: what it read last, for
    good; `offset`: beside the truth by `value`; `swapped`: exchanged with the channel `other`."""
    after: Time = Field(default=0.0, ge=0)
    """Of machine time since the blank was clamped."""
    value: Voltage = 0.0
    """Of an `offset`."""
    other: Channel | None = None
    """Of `swapped`."""

    @model_validator(mode="after")
    def _with_its_kind(self) -> CellFault:
        if (self.kind == "swapped") != (self.other is not None) or self.other == self.channel:
            raise ValueError("other names the second channel of two that are swapped, and of nothing else")
        if (self.kind == "offset") != (self.value != 0.0):
            raise ValueError("value is how far a channel of kind offset is off, and of nothing else")
        return self


class SpindleCells(FileModel):
    """Three tri-axial cells at 120 degrees, nine channels."""

    gains: tuple[
        tuple[VoltageGain, VoltageGain, VoltageGain],
        tuple[VoltageGain, VoltageGain, VoltageGain],
        tuple[VoltageGain, VoltageGain, VoltageGain],
    ]
    """Of cells 1, 2, 3: x, y and axial channel."""
    height: Length = Field(gt=0, le=2.0)
    """From the plane of the cells to the tip of the tool in the spindle (H)."""
    radius: Length = Field(gt=0, le=2.0)
    """Of the circle on which the cells stand (R_f)."""
    rotation: tuple[Angle, Angle, Angle] = (0.0, 0.0, 0.0)
    """Of the arrangement against frame sheet, about its fixed axes x, y, z in this order; a tool with its cells below
    it is turned by 180 deg about x."""
    amplifier_range: Voltage = Field(gt=0)
    """Largest output of an amplifier, of either sign."""
    adc_bits: int = Field(default=16, ge=6, le=32)
    """Converter over plus and minus that range."""
    noise: Voltage = Field(default=0.0, ge=0)
    """Standard deviation of a reading."""
    zero_offset: Voltage = Field(default=0.0, ge=0)
    """Largest output without load; drawn for each channel."""
    gain_error: float = Field(default=0.0, ge=0, lt=0.5)
    """Largest share by which a channel differs from its gain; drawn for each channel."""
    inconsistency_limit: Force = Field(default=5.0, gt=0)
    """How far the channels may disagree at rest before one of them is left out."""
    inconsistency_ratio: float = Field(default=0.01, ge=0, lt=1)
    """Share of the force by which they may disagree beyond that."""
    faults: tuple[CellFault, ...] = ()
    """What happens to channels of the simulated machine, to try it."""

    @model_validator(mode="after")
    def _gains_are_not_zero(self) -> SpindleCells:
        if not np.all(np.array(self.gains)):
            raise ValueError("gains must not be zero")
        return self

    @property
    def gain_array(self) -> Array:
        """(3, 3) N/V, rows are cells."""
        return np.array(self.gains)

    @property
    def turn(self) -> Array:
        """(3, 3) from axes of the arrangement to frame ``sheet``."""
        from scipy.spatial.transform import Rotation  # imported late: most rigs have no such cells

        return np.asarray(Rotation.from_euler("xyz", self.rotation).as_matrix())
