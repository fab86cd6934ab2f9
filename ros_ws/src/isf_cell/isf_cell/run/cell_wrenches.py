"""The wrenches of a machine in this process: as its cells read, and from spindle cells as node ``load_cell`` does."""

from __future__ import annotations

import numpy as np
from isf_core.errors import ErrorCode, IsfError
from isf_core.events import Event, cell_event
from isf_core.files.rig import tools_with_spindle_cells
from isf_core.geometry.hexapod import rotation
from isf_core.geometry.tool_axis import UPRIGHT, tilt_of
from isf_core.types import Array
from isf_load_cell.cell_file import spindle_cells_set_up
from isf_load_cell.stream import CellStream
from isf_sim.machine.simulated_machine import TARE_TICKS, MachineSample, SimulatedMachine


class CellWrenches:
    """Wrenches for force control from the samples of ``machine``, whose tools are free and which was tared.

    Attributes
    ----------
    events : channels that were lost, and forces that were ; fault : code and text of the latter, None without
    """

    def __init__(self, machine: SimulatedMachine) -> None:
        self.events: list[Event] = []
        self.fault: tuple[ErrorCode, str] | None = None
        self._streams: dict[int, CellStream] = {}
        self._mounting: dict[int, Array] = {}
        self._last: dict[int, list[float]] = {}
        rig = machine.job_file.rig
        for tool in tools_with_spindle_cells(rig):
            axis = rig.tool_1 if tool == 1 else rig.tool_2
            set_up = spindle_cells_set_up(axis)
            self._streams[tool] = CellStream(set_up.reading, TARE_TICKS)
            self._mounting[tool] = set_up.rotation
        for sample in machine.rest_for_tare() if self._streams else ():
            self.of(sample)
        for tool, stream in self._streams.items():
            stream.tare()
            self._tell(tool, stream.take_news(), machine.tick_count / machine.control_rate)

    def of(self, sample: MachineSample) -> tuple[list[float], list[float]]:
        """(6,) and (6,) N and N m; of cells that no longer tell the force the last ones."""
        read = {1: sample.wrench_1.tolist(), 2: sample.wrench_2.tolist()}
        for tool, stream in self._streams.items():
            volts = sample.volts_1 if tool == 1 else sample.volts_2
            assert volts is not None
            before = stream.fault
            turn = None
            if tool == 1 and sample.axis_1 != UPRIGHT:  # the cells tilt with the tool
                turn = rotation(tilt_of(np.array(sample.axis_1))) @ self._mounting[tool]
            wrench = stream.add(sample.tick + 1, np.asarray(volts), turn)  # a stamp of 0 would be none
            self._tell(tool, stream.take_news(), sample.time)
            if stream.fault is not before and stream.fault is not None:
                self.events.append(cell_event(stream.fault, tool, sample.time, lost=True))
                self.fault = stream.fault.code, stream.fault.message
            self._last[tool] = read[tool] = self._last.get(tool, [0.0] * 6) if wrench is None else wrench.tolist()
        return read[1], read[2]

    def _tell(self, tool: int, news: list[IsfError], time: float) -> None:
        self.events += [cell_event(error, tool, time, lost=False) for error in news]
