"""The axis of a tilted tool along the contours: towards the sheet's normal, smooth, no faster than it may turn.

The tool presses along its axis. It is tilted in the plane of vertical and normal, towards the normal, by the wall angle
and at most by ``tool_axis.largest_tilt``: delta = min(lambda, 30 deg) (Torrao 2013, 6.2.3 and Fig. 6.12). Up to that
wall angle it presses at right angles to the sheet. Contacts and tips are those of an upright tool
(:mod:`isf_core.geometry.tool_axis`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from isf_core.contour import Contour, contour_label
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile
from isf_core.geometry.tool_axis import inclination, point_on_axis, tilt_of, turn_per_length
from isf_core.types import Array
from scipy.ndimage import uniform_filter1d

from isf_planner.part.mesh_checks import place_text
from isf_planner.paths.contour_making import SLOWEST

NEGLIGIBLE = 1e-6
"""rad, tilt of a contour that is left upright."""
JOINED = 1e-6
"""m, from the end of an open contour to the begin of the next one that goes on from it."""
TILT_STEP = 1e-3
"""rad, to which the largest tilt in reach is found."""
TILT_WORTH_A_WORD = 0.0175
"""rad (1 deg), by which a contour is tilted less than asked for."""
PIECE = 0.5e-3
"""m of path, at most, between two samples that are averaged."""


def with_tool_axis(contours: Sequence[Contour], job_file: JobFile) -> tuple[Contour, ...]:
    """``contours`` with ``forming_axis``, and with ``speed`` where the axis would turn too fast at the feed.

    Contours that are formed from below stay upright.

    Raises
    ------
    IsfError : TOOL_AXIS_REFUSED (the rig cannot, or not so far; the tip would all but stand while the axis turns)
    """
    spec = job_file.job.tool_axis
    most = _largest_tilt(job_file)
    result: list[Contour] = []
    for run in _runs(contours):
        if run[0].forming_tool != 1:
            result += run
            continue
        axis = _axis_of_run(run, most, job_file)
        cuts = np.cumsum([len(contour) for contour in run])[:-1]
        for contour, piece in zip(run, np.split(axis, cuts), strict=True):
            tilted = float(np.hypot(piece[:, 0], piece[:, 1]).max()) > NEGLIGIBLE
            result.append(_slowed(replace(contour, forming_axis=piece), spec.largest_rate) if tilted else contour)
    return tuple(contour.validate() for contour in result)


def pressing_axis(normal: Array, largest: float) -> Array:
    """(N, 3), axes tilted from vertical towards the normals (N, 3) by the wall angle, at most by ``largest`` rad."""
    level = np.hypot(normal[:, 0], normal[:, 1])
    tilt = np.minimum(np.arctan2(level, normal[:, 2]), largest)
    flat = normal[:, :2] / np.maximum(level, 1e-12)[:, None]
    return np.column_stack([np.sin(tilt)[:, None] * flat, np.cos(tilt)])


def smoothed(points: Array, axis: Array, length: float, *, closed: bool) -> Array:
    """(N, 3), axes (N, 3) averaged over ``length`` m of the path along ``points`` (N, 3) m.

    Averaged axes a turn by at most 2 tan(t) / ``length`` per metre, where no axis is tilted by more than t: each end of
    the average takes in one axis for another, which differ by 2 sin(t) at most, and the mean is no shorter than cos(t).
    """
    order = np.arange(len(points) + (1 if closed else 0)) % len(points)
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points[order], axis=0), axis=1))])
    count = max(8, int(np.ceil(way[-1] / PIECE)))
    even = np.linspace(0.0, way[-1], count + 1)
    columns = np.column_stack([np.interp(even, way, column) for column in axis[order].T])
    window = int(np.clip(2 * round(0.5 * length * count / max(way[-1], 1e-12)) + 1, 1, 2 * (count // 2) - 1))
    if closed:
        ring = uniform_filter1d(columns[:-1], window, axis=0, mode="wrap")
        mean = np.vstack([ring, ring[:1]])
    else:
        mean = uniform_filter1d(columns, window, axis=0, mode="nearest")
    at = np.column_stack([np.interp(way[: len(points)], even, column) for column in mean.T])
    return np.asarray(at / np.linalg.norm(at, axis=1)[:, None])


def _axis_of_run(run: Sequence[Contour], most: float, job_file: JobFile) -> Array:
    """(N, 3), smoothed axes of the points of a ``run``, tilted by at most ``most`` rad.

    Under strategy auto no further than the rig's axes reach all along the run; under five_axis
    :func:`isf_planner.checks.part_checks.check_axes` refuses what they do not.
    """
    spec, kinematics = job_file.job.tool_axis, job_file.rig.make_kinematics()[0]
    points = np.vstack([contour.forming_tip for contour in run])
    normal = np.vstack([contour.normal for contour in run])

    def tilted(largest: float) -> Array:
        return smoothed(points, pressing_axis(normal, largest), spec.smoothing, closed=run[0].closed)

    def reached(axis: Array) -> bool:
        within = kinematics.reachable(point_on_axis(points, axis, job_file.job.tool_1.ball_radius), tilt_of(axis))
        return bool(within.all())

    axis = tilted(most)
    if spec.strategy == "five_axis" or reached(axis):
        return axis
    low, high = 0.0, most
    while high - low > TILT_STEP:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if reached(tilted(middle)) else (low, middle)
    return tilted(low)


def tilt_warning(contours: Sequence[Contour], job_file: JobFile) -> tuple[str, ...]:
    """Where the rig's axes do not let the tool tilt as far as asked for, in one sentence."""
    most = job_file.job.tool_axis.largest_tilt
    lost, least, where = 0, most, ""
    for contour in contours:
        if contour.forming_tool != 1:
            continue
        wanted = np.minimum(contour.wall_angle, most)
        tilt = inclination(contour.forming_axis) if contour.tilted else np.zeros(len(contour))
        worst = int(np.argmax(wanted - tilt))
        if float(np.median(wanted - tilt)) > TILT_WORTH_A_WORD:
            lost += 1
            if tilt[worst] < least:
                least = float(tilt[worst])
                where = f"{contour_label(contour.index)} at {place_text(contour.forming_tip[worst])}"
    if not lost:
        return ()
    return (
        f"the tool is tilted less than asked for on {lost} of {len(contours)} contours, by {np.degrees(least):.1f} deg "
        f"on {where}: the axes of {job_file.rig.name} do not reach further",
    )


def _largest_tilt(job_file: JobFile) -> float:
    """rad; what the rig bears where the job leaves it to the rig."""
    spec, rig = job_file.job.tool_axis, job_file.rig
    if spec.strategy == "auto":
        return min(spec.largest_tilt, rig.largest_tilt)
    if rig.largest_tilt <= 0.0:
        raise IsfError(
            ErrorCode.TOOL_AXIS_REFUSED,
            f"the rig {rig.name} cannot tilt its tool",
            where="tool_axis.strategy five_axis",
            advice="write strategy: auto, which leaves the tool upright on it, or use a rig that can (torrao2013)",
        )
    if spec.largest_tilt > rig.largest_tilt + 1e-9:
        raise IsfError(
            ErrorCode.TOOL_AXIS_REFUSED,
            f"{np.degrees(spec.largest_tilt):.1f} deg are asked for, the rig {rig.name} tilts its tool by "
            f"{np.degrees(rig.largest_tilt):.1f} deg",
            where="tool_axis.largest_tilt",
            advice="ask for no more, or write strategy: auto",
        )
    return spec.largest_tilt


def _runs(contours: Sequence[Contour]) -> list[list[Contour]]:
    """Closed contours one by one, open ones with those that go on from them."""
    runs: list[list[Contour]] = []
    for contour in contours:
        before = runs[-1][-1] if runs else None
        if (
            before is not None
            and not (before.closed or contour.closed or contour.retract)
            and before.forming_tool == contour.forming_tool
            and np.linalg.norm(before.forming_tip[-1] - contour.forming_tip[0]) <= JOINED
        ):
            runs[-1].append(contour)
        else:
            runs.append([contour])
    return runs


def _slowed(contour: Contour, rate: float) -> Contour:
    """``contour`` with speeds at which its axis turns by at most ``rate`` rad/s."""
    turn = turn_per_length(contour.forming_tip, contour.forming_axis, closed=contour.closed)
    allowed = rate / np.maximum(turn, 1e-12)
    worst = int(np.argmin(allowed))
    if allowed[worst] < SLOWEST * contour.feed:
        raise IsfError(
            ErrorCode.TOOL_AXIS_REFUSED,
            f"the axis turns by {np.degrees(turn[worst]) * 1e-3:.2f} deg per mm of path: at {np.degrees(rate):.3g} "
            f"deg/s the tip would move at {allowed[worst] * 1e3:.3f} mm/s",
            where=f"{contour_label(contour.index)} at {place_text(contour.forming_tip[worst])}",
            advice="raise tool_axis.largest_rate or tool_axis.smoothing, or lower tool_axis.largest_tilt",
        )
    speed = contour.speed if len(contour.speed) else np.full(len(contour), contour.feed)
    if (allowed >= speed).all():
        return contour
    return replace(contour, speed=np.minimum(speed, allowed))
