"""A recorded part as the page shows it, from its record: the time is that of the process.

A record holds the tools at the points of the contours and the normal force of every tick. When a tool was at a point is
taken from the length of its path between the first and the last tick in control.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from isf_analysis.measures.events import HARMLESS
from isf_analysis.measures.record import PartRecord
from isf_core.contour import Contour, ContourResult
from isf_core.types import Array

from isf_dashboard.history import COLUMNS, History
from isf_dashboard.part_feed import MM, Job, PartFeed

SAMPLES = 30_000
"""Of a run at most; a longer one is thinned out."""


def history_of(record: PartRecord) -> History:
    """All of the ``record``."""
    history = History("run", kept=SAMPLES, at_once=SAMPLES)
    feed = PartFeed(history)
    if record.target is not None:
        feed.target(0.0, record.target, record.preforms)
    feed.job(0.0, _job(record))
    shift, end = 0.0, 0.0
    ticks = sum(len(result.tick_time) for result in record.results)
    stride = max(1, -(-ticks // (SAMPLES - 2 * len(record.results) - 1)))
    corrections = {correction.index: correction for correction in record.corrections}
    results = {result.index: result for result in record.results}
    scans = {scan.index: scan for scan in record.scans}
    for contour in record.nominal:
        index, result = contour.index, results.get(contour.index)
        if result is not None and result.start + shift < end:  # the part went on, with a time that began anew
            shift = end - result.start
        begin = end if result is None else result.start + shift
        feed.nominal(begin, contour)
        if index in corrections:
            feed.correction(begin, corrections[index])
        if result is None:
            continue
        end = result.end + shift
        if len(rows := _samples(contour, result, stride)):
            rows[:, 0] += shift
            history.samples(rows)
        feed.result(end, result)
        if index in scans:
            feed.kept_scan(end, scans[index])
    for event in record.events:
        feed.event(min(event.time, end), event, harmless=event.kind in HARMLESS)
    for code, text in record.faults:
        feed.fault(end, "machine", code, text)
    if record.scan is not None:
        feed.scan(end, record.scan.points(), record.scan)
    for note in record.notes:
        history.add("event", 0.0, severity="note", text=note)
    history.set_status(
        {"recorded": True, "title": record.job_name, "end": end, "formed": record.formed, "planned": record.planned}
    )
    return history


def _job(record: PartRecord) -> Job:
    return Job(
        record.job_name,
        record.job_text,
        record.plan_id,
        record.process,
        record.correction,
        record.support_force,
        record.variant,
        record.lockstep,
        record.software,
        record.base_folder,
        plan_warnings=record.plan_warnings,
    )


def _samples(contour: Contour, result: ContourResult, stride: int) -> Array:
    """(n, C) every ``stride``-th tick; empty where a contour has no tick or no point."""
    forming = _first_of(result.forming_measured, result.forming_target)
    times = result.tick_time[::stride]
    if not len(times) or not len(forming):
        return np.empty((0, len(COLUMNS)))
    engaged = result.tick_time[result.tick_engaged] if result.tick_engaged.any() else result.tick_time
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(forming, axis=0), axis=1))])
    at_point = engaged[0] + (engaged[-1] - engaged[0]) * length / max(length[-1], 1e-12)
    rows = np.full((len(times), len(COLUMNS)), np.nan)
    rows[:, 0] = times
    support = _first_of(result.support_measured, result.support_target)
    tools = ((forming, result.forming_force), (support, result.support_force))
    order = (1, 2) if contour.forming_tool == 1 else (2, 1)
    for tool, (tips, forces) in zip(order, tools, strict=True):
        for name, values in _columns(tool, tips, forces):
            if len(values) == len(at_point):
                rows[:, COLUMNS.index(name)] = np.interp(times, at_point, values)
    for name, ticks in (("normal_force", result.tick_normal_force), ("set_point", result.tick_set_point)):
        if len(ticks) == len(result.tick_time):
            rows[:, COLUMNS.index(name)] = ticks[::stride]
    rows[:, COLUMNS.index("contour")] = contour.index
    return rows


def _columns(tool: int, tips: Array, forces: Array) -> Iterator[tuple[str, Array]]:
    for k, axis in enumerate("xyz"):
        if len(tips):
            yield f"{axis}{tool}", MM * tips[:, k]
        if len(forces):
            yield f"f{axis}{tool}", forces[:, k]


def _first_of(*arrays: Array) -> Array:
    return next((array for array in arrays if len(array) and np.isfinite(array).all()), arrays[-1])
