"""A record of an in-process run as a bag with the topics and types of a recorded one.

Such a bag holds no wrenches, targets or poses: the ticks are in the results of the contours.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from isf_core.contour import Contour, ContourCorrection, ContourResult
from isf_core.events import Event
from isf_core.geometry.height_map import HeightMap
from isf_core.thinned_sheet import ThinnedSheet
from isf_core.types import Array
from isf_ros import fields
from numpy.typing import NDArray

from isf_analysis.bag import topics
from isf_analysis.bag.bag_file import BagFile
from isf_analysis.bag.sheet_health import KINETIC, health_message
from isf_analysis.bag.topics import Topic, cell_types, make_message
from isf_analysis.measures.contour_scan import ContourScan
from isf_analysis.measures.record import PartRecord

FRAME = "sheet"
NANO = 1_000_000_000
_KINDS = {4: 7, 8: 8}  # sensor_msgs/PointField: FLOAT32, FLOAT64 by size


def write_bag(record: PartRecord, path: Path | str, *, end: int | None = None) -> Path:
    """Write ``record`` as a new bag folder ``path``; returns it.

    ``end`` is the time of the last message, ns since 1970 (default: now). The receive times spread over the wall time
    of the run as the contours do over its simulated time.

    Raises
    ------
    IsfError : BAG_NOT_WRITABLE when the folder exists or cannot be written
    """
    path = Path(path)
    end = time.time_ns() if end is None else end
    start = end - round(record.wall_time * NANO)
    per_second = (end - start) / record.sim_time if record.sim_time > 0 else 0.0
    bag = BagFile(path)
    try:
        _Output(bag).write_part(record, start, end, per_second)
    finally:
        bag.close()
    return path


def job_fields(record: PartRecord) -> dict[str, Any]:
    """Fields of the message ``isf_msgs/JobInfo`` of a part, without its header."""
    return {
        "job_name": record.job_name,
        "job_text": record.job_text,
        "plan_id": record.plan_id,
        "process": record.process,
        "correction": record.correction,
        "support_force": float(record.support_force),
        "world": int(record.variant),
        "seed": int(record.seed),
        "control_rate": float(record.control_rate),
        "lockstep": bool(record.lockstep),
        "software": record.software,
        "sheet": str(record.sheet.get("model", "")),
        "base_folder": record.base_folder,
        "plan_warnings": list(record.plan_warnings),
    }


class _Output:
    """Serialises messages and writes each to its topic."""

    def __init__(self, bag: BagFile) -> None:
        self._bag = bag
        self._connections = {
            topic: bag.add(topic)
            for topic in (
                topics.JOB,
                topics.TARGET,
                topics.NOMINAL,
                topics.CORRECTED,
                topics.CORRECTION,
                topics.RESULT,
                topics.MACHINE_STATE,
                topics.EVENT,
                topics.SCAN,
                topics.FORMED_SHEET,
                topics.RELEASED_PART,
            )
        }

    def write_part(self, record: PartRecord, start: int, end: int, per_second: float) -> None:
        kinetic = record.sheet.get(KINETIC)
        if isinstance(kinetic, float):
            self._connections[topics.DIAGNOSTICS] = self._bag.add(topics.DIAGNOSTICS)
        self._write(topics.JOB, start, make_message(topics.JOB.type, header=_header(0.0), **job_fields(record)))
        self._write(topics.MACHINE_STATE, start, _machine_state(record, end=False))
        if record.target is not None:
            self._write(topics.TARGET, start, _target(record.target, record.preforms))
        corrected = {contour.index: contour for contour in record.corrected}
        corrections = {correction.index: correction for correction in record.corrections}
        results = {result.index: result for result in record.results}
        scans = {scan.index: scan for scan in record.scans}
        now = start
        for nominal in record.nominal:
            result = results.get(nominal.index)
            self._write(topics.NOMINAL, now, _contour(nominal))
            if nominal.index in corrections:
                self._write(topics.CORRECTION, now, _correction(corrections[nominal.index]))
            if nominal.index in corrected:
                self._write(topics.CORRECTED, now, _contour(corrected[nominal.index]))
            if result is not None:
                now = max(now, min(end, start + round(result.end * per_second)))
                self._write(topics.RESULT, now, _result(result))
            if nominal.index in scans:
                self._write(topics.SCAN, now, _points(scans[nominal.index]))
                now += 1  # the next contour comes after the scan, whatever the clock resolves
        end = max(end, now)
        for event in record.events:
            self._write(topics.EVENT, min(end, max(start, start + round(event.time * per_second))), _event(event))
        self._write(topics.MACHINE_STATE, end, _machine_state(record, end=True))
        if isinstance(kinetic, float):
            self._write(topics.DIAGNOSTICS, end, health_message(kinetic, _header(record.sim_time)))
        if record.scan is not None:
            self._write(topics.SCAN, end, _cloud(record.scan))
        if record.formed_sheet is not None:
            self._write(topics.FORMED_SHEET, end, _formed_sheet(record.formed_sheet))
        if record.released is not None:
            self._write(topics.RELEASED_PART, end, _released(record.released))

    def _write(self, topic: Topic, timestamp: int, message: Any) -> None:
        self._bag.write(self._connections[topic], timestamp, cell_types().serialize_cdr(message, topic.type))


def _machine_state(record: PartRecord, *, end: bool) -> Any:
    """First and last state: their difference tells the ticks and what the machine itself counted."""
    if not end:
        return make_message(topics.MACHINE_STATE.type, header=_header(0.0), tared=True, lockstep=bool(record.lockstep))
    rms, largest = record.axis_error or (0.0, 0.0)
    return make_message(
        topics.MACHINE_STATE.type,
        header=_header(record.sim_time),
        tick=int(record.ticks),
        late_ticks=max(0, int(record.late_ticks) - sum(result.late_ticks for result in record.results)),
        targets_lost=max(0, int(record.lost_messages) - sum(result.lost_messages for result in record.results)),
        fault_codes=np.array([code for code, _ in record.faults], dtype=np.int32),
        fault_messages=[text for _, text in record.faults],
        tared=True,
        lockstep=bool(record.lockstep),
        axis_error_rms=rms,
        axis_error_largest=largest,
    )


def _contour(contour: Contour) -> Any:
    return make_message(topics.NOMINAL.type, header=_header(0.0), **_values(contour, fields.CONTOUR))


def _correction(correction: ContourCorrection) -> Any:
    return make_message(topics.CORRECTION.type, header=_header(0.0), **_values(correction, fields.CORRECTION))


def _result(result: ContourResult) -> Any:
    return make_message(topics.RESULT.type, header=_header(result.end), **_values(result, fields.RESULT))


def _event(event: Event) -> Any:
    x, y, z = event.position
    return make_message(
        topics.EVENT.type,
        header=_header(event.time),
        kind=int(event.kind),
        position=make_message("geometry_msgs/msg/Point", x=x, y=y, z=z),
        value=event.value,
        limit=event.limit,
        text=event.text,
    )


def _values(source: Any, table: dict[str, str]) -> dict[str, Any]:
    """Message fields of a core dataclass, by the table both sides share."""
    values: dict[str, Any] = {}
    for name, kind in table.items():
        value = getattr(source, name)
        if kind in (fields.N, fields.N3):
            value = np.ascontiguousarray(value, dtype=np.float64).ravel()
        elif kind == fields.FLAGS:
            value = np.ascontiguousarray(value, dtype=np.uint8)
        elif kind == fields.TIME:
            value = _time(value)
        elif isinstance(value, np.generic):
            value = value.item()
        values[name] = int(value) if name == "process" else value
    return values


def _target(target: HeightMap, preforms: Sequence[HeightMap]) -> Any:
    table, names = fields.target_table(target, preforms)
    rows, columns, count = table.shape
    return _cloud_of(np.asarray(table, dtype="<f8").reshape(-1, count), rows, columns, _header(0.0), names)


def _cloud(height_map: HeightMap) -> Any:
    rows, columns = height_map.z.shape
    return _cloud_of(np.asarray(height_map.points(), dtype="<f8"), rows, columns, _header(0.0))


def _points(scan: ContourScan) -> Any:
    """In no order, of float32, which is finer than what is kept of a scan."""
    return _cloud_of(np.asarray(scan.points(), dtype="<f4"), 1, scan.count, _header(scan.time))


def _released(points: Array) -> Any:
    return _cloud_of(np.asarray(points, dtype="<f8"), 1, len(points), _header(0.0, fields.PART_FRAME))


def _formed_sheet(sheet: ThinnedSheet) -> Any:
    table = np.asarray(fields.thinned_sheet_table(sheet), dtype="<f8")
    rows, columns, count = table.shape
    return _cloud_of(table.reshape(-1, count), rows, columns, _header(0.0), fields.THINNED)


def _cloud_of(points: NDArray[Any], rows: int, columns: int, header: Any, names: Sequence[str] = "xyz") -> Any:
    """Cloud of ``points`` (rows * columns, K) as they are in memory, with the K fields ``names``."""
    size = points.itemsize
    return make_message(
        "sensor_msgs/msg/PointCloud2",
        header=header,
        height=rows,
        width=columns,
        fields=[
            make_message("sensor_msgs/msg/PointField", name=name, offset=size * k, datatype=_KINDS[size], count=1)
            for k, name in enumerate(names)
        ],
        point_step=len(names) * size,
        row_step=len(names) * size * columns,
        is_dense=bool(np.isfinite(points).all()),
        data=np.frombuffer(np.ascontiguousarray(points).tobytes(), dtype=np.uint8),
    )


def _header(seconds: float, frame: str = FRAME) -> Any:
    return make_message("std_msgs/msg/Header", stamp=_time(seconds), frame_id=frame)


def _time(seconds: float) -> Any:
    sec, nanosec = divmod(round(seconds * NANO), NANO)
    return make_message("builtin_interfaces/msg/Time", sec=int(sec), nanosec=int(nanosec))
