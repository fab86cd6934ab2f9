"""Recorded wrenches fed to the force controller again, tick by tick, with the recorded or with other parameters.

What it answers is set beside what was recorded. With the same parameters it is the same to the last bit, for a run in
lockstep. With others the sheet answers as it did, not as it would have: the answer tells what the controller would
have done with these forces, and nothing of the forces it would have had.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from isf_core.contour import Contour, ContourResult, contour_label
from isf_core.errors import ErrorCode, IsfError, failure
from isf_core.files.job import JobFile
from isf_core.types import Array, Indices
from isf_force_ctrl.control_config import ControlConfig
from isf_force_ctrl.controller import ForceController
from isf_force_ctrl.measurements.tool_lift import lift_tool
from isf_springback.scan.feedback import scan_due

from isf_cell.replay.recorded_run import NANO, Armed, Ticks
from isf_cell.run.tool_lift import SETTINGS

TAIL = 0.2
"""s before the end of a contour, whose wrenches stand for those of a controller that takes longer."""

LONGEST = 20.0
"""s that a controller may take longer than the recorded one."""


@dataclass
class ForceReplay:
    """What the controller answered.

    Attributes
    ----------
    contour : (n,) contour of every tick that was fed ; tick : (n,) its number among the recorded ticks
    target : (n, 6) m, answer: tips of tool 1 and tool 2
    results : of the contours
    unfed : recorded ticks that were fed to nothing, since the controller had ended before
    notes : what kept it from going on
    """

    contour: Indices
    tick: Indices
    target: Array
    results: tuple[ContourResult, ...]
    unfed: int
    notes: list[str] = field(default_factory=list)


def replay_force(
    ticks: Ticks,
    armed: Armed,
    contours: tuple[Contour, ...],
    results: tuple[ContourResult, ...],
    job_file: JobFile,
    config: ControlConfig,
    lifted: frozenset[int],
    progress: Callable[[int, int], None] | None = None,
) -> ForceReplay:
    """Feed ``ticks`` to a controller of ``config`` that forms the corrected ``contours``.

    The tool is lifted after the contours ``lifted``, by index, as it was. Every contour begins at the tick at which the
    recorded one began (``results``), whatever the one before took. One that was ended from outside (a fault of the
    machine, a stop) ends where its ticks end, for the recorded reason.
    """
    started = {result.index: round(result.start * NANO) for result in results if len(result.tick_time)}
    ended = {result.index: round(result.end * NANO) for result in results}
    broken_off = {item.index: failure(item.code, item.message) for item in results if not item.completed}
    controller = ForceController(config)
    plan_id = contours[0].plan_id if contours else ""
    controller.arm(plan_id, armed.first_index, armed.count, armed.tip_1, armed.tip_2, armed.support_force, armed.axis)
    feed = _Feed(controller, ticks, config.rate)
    found: list[ContourResult] = []
    notes: list[str] = []
    wanted = [contour for contour in contours if contour.index in started]
    early = round(0.4 * NANO / config.rate)  # ns; the start of a result by the clock is rounded to some 100 ns
    begins = [int(np.searchsorted(ticks.stamp, started[contour.index] - early)) for contour in wanted]
    begins.append(len(ticks.stamp))
    for k, contour in enumerate(wanted):
        end = begins[k + 1]
        feed.seek(begins[k])
        try:
            controller.start(contour)
        except IsfError as error:
            notes.append(f"{contour_label(contour.index)} could not be started: {error.what}")
            break
        formed = int(np.searchsorted(ticks.stamp, ended[contour.index] + early))
        ends = broken_off.get(contour.index) if ticks.exact else None
        feed.run(contour.index, end, formed, exact=ticks.exact, ends=ends)
        result = controller.take_result()
        if result is None:
            notes.append(f"{contour_label(contour.index)}: the controller ended without a result")
            break
        found.append(result)
        if not result.completed:
            notes.append(f"{contour_label(contour.index)}: {result.message}")
            break
        if ticks.exact:
            _between(controller, feed, contour, job_file, lifted, end)
        if progress is not None:
            progress(k + 1, len(wanted))
    contour_of, tick_of = (np.array(item, dtype=np.int64) for item in (feed.contour, feed.tick))
    target = np.array(feed.target, dtype=np.float64).reshape(-1, 6)
    unfed = len(ticks.stamp) - len(np.unique(tick_of))
    return ForceReplay(contour_of, tick_of, target, tuple(found), unfed, notes)


def _between(
    controller: ForceController, feed: _Feed, contour: Contour, job_file: JobFile, lifted: frozenset[int], end: int
) -> None:
    """What the executive had done before the next contour."""
    index, count = contour.index, contour.count
    if index in lifted:
        try:
            lift_tool(controller, SETTINGS)
        except IsfError:  # the tools are not on the sheet, as between two features
            pass
        else:
            feed.run(index, end, end, exact=True)
    if scan_due(job_file, index, count) and job_file.job.springback.scan_clear and contour.closed:
        controller.move_aside()
        feed.run(index, end, end, exact=True)


class _Feed:
    """Ticks as the node makes them."""

    def __init__(self, controller: ForceController, ticks: Ticks, rate: float) -> None:
        self._controller, self._ticks, self._rate = controller, ticks, rate
        self._position = self._pose = 0
        self._wrench_1, self._wrench_2 = ticks.wrench[:, :6].tolist(), ticks.wrench[:, 6:].tolist()
        self.contour: list[int] = []
        self.tick: list[int] = []
        self.target: list[tuple[float, ...]] = []

    def seek(self, position: int) -> None:
        """Go on at tick ``position``."""
        self._position = position
        stamp = self._ticks.stamp[position] if position < len(self._ticks.stamp) else np.iinfo(np.int64).max
        self._pose = int(np.searchsorted(self._ticks.pose_stamp, stamp))

    def run(self, index: int, end: int, last: int, *, exact: bool, ends: IsfError | None = None) -> None:
        """Until the controller rests; where it is not ``exact`` also the ticks up to ``end`` in which it rested.

        A controller that takes longer than the recorded one is given the wrenches of the :data:`TAIL` before tick
        ``last`` again and again; these ticks are compared with nothing. With ``ends`` it is ended after
        tick ``end`` in place of that.
        """
        controller, ticks = self._controller, self._ticks
        stamps, period = ticks.stamp, round(NANO / self._rate)
        tail = max(1, min(last, round(TAIL * self._rate)))
        begin = max(0, last - tail)
        stamp, number, more = 0, 0, 0
        while controller.busy or (not exact and self._position < end):
            inside = self._position < end
            if inside:
                position = self._position
                stamp = int(stamps[position])
                number = round(stamp * self._rate / NANO) if ticks.exact else position
                self._report_poses(stamp)
                self._position += 1
            elif ends is not None:
                controller.fail(ends.code, ends.what)
                return
            else:
                position, more = begin + more % tail, more + 1
                stamp, number = stamp + period, number + 1
                if more > LONGEST * self._rate:
                    controller.fail(ErrorCode.STOPPED, f"not at its end {LONGEST:g} s after the recorded one")
            time = number / self._rate if ticks.exact else stamp / NANO
            answer = controller.tick(number, time, self._wrench_1[position], self._wrench_2[position])
            if inside:
                self.contour.append(index)
                self.tick.append(position)
                self.target.append((*answer.tip_1, *answer.tip_2))
            elif more > LONGEST * self._rate:
                return

    def _report_poses(self, stamp: int) -> None:
        ticks = self._ticks
        while self._pose < len(ticks.pose_stamp) and ticks.pose_stamp[self._pose] <= stamp:
            tool, *tip = ticks.pose[self._pose].tolist()
            self._controller.add_measured(int(tool), int(ticks.pose_stamp[self._pose]) / NANO, tip)
            self._pose += 1
