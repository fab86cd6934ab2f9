"""Machine programs: a plan as one table of points, written with a post-processor, and read back.

The table holds both tips, speed and command force at every point.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from isf_core.contour import Contour
from isf_core.errors import ErrorCode, IsfError
from isf_core.geometry.serial_arm import SerialArm
from isf_core.geometry.tool_axis import UP, point_on_axis, quaternion_of, tilt_of
from isf_core.types import Array, Indices
from numpy.typing import NDArray

from isf_planner.exports.arm_fields import frame_fields, pose_fields
from isf_planner.exports.post_processor import Channel, PostProcessor, pattern


@dataclass(frozen=True)
class PathPoints:
    """N points of a program; a closed contour ends with its first point once more.

    Attributes
    ----------
    contour : (N,) number of the contour
    tool_1, tool_2 : (N, 3) m, tips of the upper and the lower tool; NaN of a tool that is not there
    speed : (N,) m/s ; force : (N,) N, set-point of the support tool's normal force, 0 for position control
    lift : (N,) bool, both tools are lifted clear before this point
    axis : (N, 3), axis of the upper tool
    forming : (N,) tool that forms, 1 or 2
    spindle : (N,) rad/s of the upper tool, positive clockwise seen from above, 0: it does not turn
    """

    contour: Indices
    tool_1: Array
    tool_2: Array
    speed: Array
    force: Array
    lift: NDArray[np.bool_]
    axis: Array
    forming: Indices
    spindle: Array

    @property
    def tilted(self) -> bool:
        """True when the upper tool is tilted somewhere."""
        return bool((self.axis != UP).any())

    @property
    def two_tools(self) -> bool:
        """True when both tools move."""
        return bool(np.isfinite(self.tool_1).all() and np.isfinite(self.tool_2).all())

    def lifted(self, clearance: float) -> tuple[float, float]:
        """m, z of the lifted tools 1 and 2: each ``clearance`` beyond the sheet plane and all its points, as the
        formed sheet is between the two."""
        first, second = self.tool_1[:, 2], self.tool_2[:, 2]
        up = first.max(initial=0.0, where=np.isfinite(first)) + clearance
        return float(up), float(second.min(initial=0.0, where=np.isfinite(second)) - clearance)


def path_points(contours: Sequence[Contour], spindle: Sequence[float] = ()) -> PathPoints:
    """Points of all contours in their order, with the ``spindle`` rad/s on each of these where it turns.

    A support tool that has waited comes to its first contour with lifted tools: beside the short step of the forming
    tool it would have centimetres to go, at a multiple of the feed.
    """
    waited = False
    names = ("contour", "tool_1", "tool_2", "speed", "force", "lift", "axis", "forming", "spindle")
    parts: dict[str, list[Array]] = {name: [] for name in names}
    for contour, turn in zip(contours, spindle or [0.0] * len(contours), strict=True):
        n = len(contour)
        order = np.append(np.arange(n), 0) if contour.closed else np.arange(n)
        missing = np.full((n, 3), np.nan)
        support = contour.support_tip if contour.has_support else missing
        tips = (contour.forming_tip, support) if contour.forming_tool == 1 else (support, contour.forming_tip)
        speed = contour.speed if len(contour.speed) else np.full(n, contour.feed)
        force = contour.support_force if contour.force_controlled else np.zeros(n)
        lift = np.zeros(len(order), dtype=bool)
        lift[0] = contour.retract or not parts["lift"] or (waited and not contour.support_waits)
        waited = contour.support_waits
        parts["contour"].append(np.full(len(order), contour.index))
        parts["forming"].append(np.full(len(order), contour.forming_tool))
        for name, value in zip(("tool_1", "tool_2", "speed", "force"), (*tips, speed, force), strict=True):
            parts[name].append(value[order])
        parts["lift"].append(lift)
        parts["spindle"].append(np.full(len(order), turn))
        tilted = contour.tilted and contour.forming_tool == 1
        parts["axis"].append(contour.forming_axis[order] if tilted else np.tile(UP, (len(order), 1)))
    return PathPoints(**{name: np.concatenate(value) for name, value in parts.items()})  # type: ignore[arg-type]


MM = 1e3


def write_programs(
    contours: Sequence[Contour],
    post: PostProcessor,
    path: Path,
    ball_radius: float = math.nan,
    arms: tuple[SerialArm | None, SerialArm | None] = (None, None),
    origin: Sequence[str] = (),
    spindle: Sequence[float] = (),
) -> list[Path]:
    """Write all programs of a plan beside each other and return their paths.

    Parameters
    ----------
    contours : of the plan
    post : format
    path : file name; channels add their suffix, a split program adds _001, _002, ...
    ball_radius : m, of the upper tool's tip, needed where that tool is tilted
    arms : that carry the upper and the lower tool; a format with programs for arms then writes these
    origin : where the contours come from, for people who read the program; what could end a comment is replaced
    spindle : rad/s of the upper tool on each contour, positive clockwise seen from above; none: it does not turn

    Raises
    ------
    IsfError : EXPORT_FORMAT_UNKNOWN when the format has no program for this number of tools, or says nothing of the
        spindle that turns; FILE_NOT_WRITABLE
    """
    lines = [as_comment(line) for line in origin]
    points = path_points(contours, spindle)
    points = replace(points, spindle=_held(points.spindle, post.spindle_change))
    wanted = "two tools" if points.two_tools else "one tool"
    tilted = points.tilted
    used = _arms_of(points, post, arms)
    if used:
        wanted = "two arms" if points.two_tools else "one arm"
    elif tilted:
        wanted = wanted.replace("two tools", "two tilted tools").replace("one tool", "one tilted tool")
    if tilted:
        points = replace(points, tool_1=point_on_axis(points.tool_1, points.axis, ball_radius))
    channels = [_with_origin(channel, lines) for channel in post.channels if channel.plans == wanted]
    if not channels:
        raise IsfError(
            ErrorCode.EXPORT_FORMAT_UNKNOWN,
            f"format {post.name} has no program for {wanted}",
            advice="no format has: leave tool_axis out"
            if wanted == "two tilted tools"
            else f"add a channel with 'plans: {wanted}' to a copy of it",
        )
    if points.spindle.any() and not any(channel.spindle for channel in channels):
        raise IsfError(
            ErrorCode.EXPORT_FORMAT_UNKNOWN,
            f"format {post.name} says nothing of the spindle, which path.spindle turns",
            advice="add the lines spindle and spindle_stop to a copy of it, or leave path.spindle out",
        )
    plan_id = as_comment(contours[0].plan_id)
    name = plan_id.rsplit("-", 1)[0]
    known = {
        "name": name,
        "program": _program_name(name),
        "plan_id": plan_id,
        "contours": len(contours),
        "origin": "; ".join(lines),
    }
    heights = points.lifted(post.clearance / MM)
    poses = _ArmFields(points, used, heights)
    for tool, arm in used.items():
        known |= frame_fields(arm, tool)
    if used:
        known |= poses.above(0)
    written = []
    for channel in channels:
        body = list(_body(points, channel, heights, known, poses))
        for number, text in enumerate(_files(body, channel, post.lines_per_file, known), start=1):
            split = f"_{number:03d}" if post.lines_per_file and len(body) > _room(channel, post.lines_per_file) else ""
            target = path.with_name(f"{path.stem}{channel.suffix}{split}{path.suffix or post.extension}")
            try:
                target.write_text("\n".join(text) + "\n", encoding="ascii", errors="replace")
            except OSError as error:
                what = f"the program cannot be written: {error.strerror}"
                raise IsfError(ErrorCode.FILE_NOT_WRITABLE, what, where=str(target)) from error
            written.append(target)
    return written


def read_programs(paths: Sequence[Path], post: PostProcessor) -> list[tuple[Array, Array]]:
    """Tips (tool_1, tool_2) of every contour, each (n, 3) m, of the files of one program in their order.

    Contours are told apart by the ``contour`` lines of the format; without such lines there is one. The tips of a
    tool that the program does not move are NaN; which tool a program moves is told by the suffix of its file name. The
    repeated first point of a closed contour is dropped.

    Raises
    ------
    IsfError : EXPORT_UNREADABLE when no line is a point of this format; FILE_NOT_FOUND
    """
    lines: list[str] = []
    for path in paths:
        try:
            lines += path.read_text(encoding="ascii", errors="replace").splitlines()
        except OSError as error:
            raise IsfError(ErrorCode.FILE_NOT_FOUND, "cannot be read", where=str(path)) from error
    best: list[tuple[Array, Array]] = []
    for channel in _candidates(post, paths):
        found = _contours_of(lines, channel)
        if sum(len(first) for first, _ in found) > sum(len(first) for first, _ in best):
            best = found
    if not best:
        raise IsfError(
            ErrorCode.EXPORT_UNREADABLE,
            f"no line is a point of format {post.name}",
            where=str(paths[0]) if paths else "",
            advice="name the format the program was written with",
        )
    return best


def _body(
    points: PathPoints, channel: Channel, heights: tuple[float, float], known: dict[str, object], poses: _ArmFields
) -> Iterator[tuple[str, dict[str, object]]]:
    """Templates with their values, line by line; the numbers of line and file come when files are made.

    ``heights`` m, of the lifted tools.
    """
    tips = np.column_stack([points.tool_1, points.tool_2]) * MM
    orientation = _orientation(points.axis) if points.tilted else np.tile(_orientation(UP[None]), (len(tips), 1))
    lifted = tips.copy()
    lifted[:, [2, 5]] = np.array(heights) * MM
    names = ("x1", "y1", "z1", "x2", "y2", "z2")
    feed = points.speed * MM
    both = _both_speeds(points)
    last = len(tips) - 1
    turning = 0.0
    for k in range(len(tips)):
        begins = k == 0 or points.contour[k] != points.contour[k - 1]
        values = known | {
            "contour": int(points.contour[k]) + 1,
            "point": k + 1,
            "feed": feed[k],
            "feed_min": 60.0 * feed[k],
            "feed_m": points.speed[k],
            "force": points.force[k],
            "feed1": both[k, 0] * MM,
            "feed2": both[k, 1] * MM,
            "feed1_m": both[k, 0],
            "feed2_m": both[k, 1],
            "phase": "FALSE" if points.contour[k] % 2 else "TRUE",
            **_turn_fields(points.spindle[k]),
            **poses.at(k),
            **dict(zip(ORIENTATION, orientation[k].tolist(), strict=True)),
        }
        at = values | dict(zip(names, tips[k].tolist(), strict=True))
        if begins:
            for line in channel.contour:
                yield line, at
            if points.spindle[k] != turning:
                turning = points.spindle[k]
                yield from ((line, at) for line in (channel.spindle if turning else channel.spindle_stop))
            if points.lift[k]:
                if k > 0:
                    above = values | dict(zip(names, lifted[k - 1].tolist(), strict=True)) | poses.above(k - 1)
                    yield from ((line, above) for line in channel.lift)
                above = values | dict(zip(names, lifted[k].tolist(), strict=True)) | poses.above(k)
                yield from ((line, above) for line in channel.lift)
        if k == 0 or points.lift[k] or (both[k] != both[k - 1]).any():
            yield from ((line, at) for line in channel.feed_change)
        yield channel.point, at
        if k == last or points.contour[k + 1] != points.contour[k]:
            for line in channel.contour_end:
                yield line, at
    above = values | dict(zip(names, lifted[last].tolist(), strict=True)) | poses.above(last)
    yield from ((line, above) for line in channel.lift)
    if turning:
        yield from ((line, above | _turn_fields(0.0)) for line in channel.spindle_stop)


def _held(speeds: Array, share: float) -> Array:
    """(N,) as ``speeds``, where one stays in force until another differs from it by more than its ``share``, stands
    still or turns the other way."""
    held, now = [], 0.0
    for speed in speeds.tolist():
        if abs(speed - now) > share * abs(now) or speed * now <= 0.0:
            now = speed
        held.append(now)
    return np.array(held)


def _turn_fields(speed: float) -> dict[str, object]:
    """What a program may say of a spindle that turns at ``speed`` rad/s, positive clockwise."""
    turn = 30.0 / math.pi * float(speed)
    return {"rpm": abs(turn), "turn": turn, "spindle_code": 3 if turn > 0.0 else 4 if turn < 0.0 else 5}


SLOWEST = 1e-4
"""m/s of a tool that hardly moves while the other one does."""


def _both_speeds(points: PathPoints) -> Array:
    """(N, 2) m/s of both tips on the way to each point: the forming one's is the feed, and both take the same time."""
    speeds = np.column_stack([points.speed, points.speed])
    if not points.two_tools:
        return speeds
    ways = [np.linalg.norm(np.diff(tips, axis=0, prepend=tips[:1]), axis=1) for tips in (points.tool_1, points.tool_2)]
    own, other = np.where(points.forming == 1, ways, ways[::-1])
    moves = (own > 1e-9) & ~points.lift
    shared = np.where(moves, points.speed * other / np.maximum(own, 1e-9), points.speed)
    rows = np.arange(len(shared))
    speeds[rows, np.where(points.forming == 1, 1, 0)] = np.maximum(np.round(shared, 6), SLOWEST)
    return speeds


def _arms_of(
    points: PathPoints, post: PostProcessor, arms: tuple[SerialArm | None, SerialArm | None]
) -> dict[int, SerialArm]:
    """Arms by tool, where each tool that moves has one and the format has programs for arms; else none."""
    moving = [tool for tool, tips in ((1, points.tool_1), (2, points.tool_2)) if np.isfinite(tips).all()]
    found = {tool: arm for tool in moving if (arm := arms[tool - 1]) is not None}
    plans = "two arms" if points.two_tools else "one arm"
    return found if len(found) == len(moving) and any(one.plans == plans for one in post.channels) else {}


class _ArmFields:
    """Fields of the arms at every point; none without arms. ``heights`` m, of the lifted tools."""

    def __init__(self, points: PathPoints, arms: dict[int, SerialArm], heights: tuple[float, float]) -> None:
        self._points, self._arms, self._heights = points, arms, heights
        self._tilts = {1: tilt_of(points.axis), 2: np.zeros((len(points.axis), 2))}
        self._names: tuple[str, ...] = ()
        found = []
        for tool, arm in arms.items():
            names, values = pose_fields(arm, tool, self._tips(tool), self._tilts[tool])
            self._names += names
            found.append(values)
        self._values = np.hstack(found) if found else np.empty((len(points.axis), 0))

    def at(self, k: int) -> dict[str, object]:
        """Of point ``k``."""
        return dict(zip(self._names, self._values[k].tolist(), strict=True))

    def above(self, k: int) -> dict[str, object]:
        """Of point ``k`` with the tools lifted."""
        fields: dict[str, object] = {}
        for tool, arm in self._arms.items():
            tip = self._tips(tool)[k : k + 1].copy()
            tip[:, 2] = self._heights[tool - 1]
            names, values = pose_fields(arm, tool, tip, self._tilts[tool][k : k + 1])
            fields |= dict(zip(names, values[0].tolist(), strict=True))
        return fields

    def _tips(self, tool: int) -> Array:
        return self._points.tool_1 if tool == 1 else self._points.tool_2


ORIENTATION = ("i1", "j1", "k1", "a1", "b1", "c1", "qw1", "qx1", "qy1", "qz1")


def _orientation(axis: Array) -> Array:
    """(N, 10), what a program may say of the upper tool with ``axis`` (N, 3): the columns ORIENTATION."""
    angles = np.degrees(tilt_of(axis))
    x, y, z, w = np.array([quaternion_of(one) for one in axis]).T
    half_turn = np.column_stack([0.0 - y, 0.0 - z, w, x])  # times half a turn about y, as w x y z
    return np.column_stack([axis, angles, 180.0 + angles[:, 0], half_turn])


LONGEST_COMMENT = 100
"""Characters of a comment (assumed: what controllers take in a line)."""

_NOT_IN_COMMENTS = str.maketrans("()%", "[]_")


def as_comment(text: str) -> str:
    """``text`` as it may stand in a comment of any format: one line of ASCII without what ends a comment or a program,
    of at most :data:`LONGEST_COMMENT` characters; it may come from a bag."""
    plain = "".join(c if c.isascii() and c.isprintable() else " " if c.isspace() else "?" for c in text)
    plain = " ".join(plain.translate(_NOT_IN_COMMENTS).split())
    return plain if len(plain) <= LONGEST_COMMENT else plain[: LONGEST_COMMENT - 3] + "..."


def _with_origin(channel: Channel, lines: Sequence[str]) -> Channel:
    """``channel`` with each line of its header that holds the field ``origin`` once for each of the ``lines``."""
    header: list[str] = []
    for template in channel.header:
        texts = [line.replace("{", "{{").replace("}", "}}") for line in lines]
        header += [template.replace("{origin}", text) for text in texts] if "{origin}" in template else [template]
    return channel.model_copy(update={"header": header})


def _program_name(name: str) -> str:
    """Letters, digits and underscores of ``name``, at most 24, with the number of a stage kept."""
    plain = re.sub(r"\W", "_", name)
    stage = re.search(r"_stage_\d+$", plain)
    ending = stage[0] if stage else ""
    return plain.removesuffix(ending)[: 24 - len(ending)] + ending


def _room(channel: Channel, lines_per_file: int) -> int:
    return lines_per_file - len(channel.header) - len(channel.footer)


def _files(
    body: list[tuple[str, dict[str, object]]], channel: Channel, lines_per_file: int | None, known: dict[str, object]
) -> Iterator[list[str]]:
    """Lines of every file."""
    room = _room(channel, lines_per_file) if lines_per_file else len(body)
    move = 0
    for number, begin in enumerate(range(0, len(body), room), start=1):
        piece = body[begin : begin + room]
        count = 1
        lines = []
        ends = known | {"file": number}
        for template, values in [
            *((line, ends) for line in channel.header),
            *piece,
            *((line, ends) for line in channel.footer),
        ]:
            move += "{move" in template
            lines.append(template.format_map(_Values(values, n=count, file=number, move=move)))
            count += 1
        yield lines


class _Values(dict[str, object]):
    """Values of one line; a position in a header, where there is none, is 0."""

    def __init__(self, values: dict[str, object], **more: object) -> None:
        super().__init__(values, **more)

    def __missing__(self, key: str) -> object:
        return 0.0


def _candidates(post: PostProcessor, paths: Sequence[Path]) -> list[Channel]:
    """Channels that may have written these files: those whose suffix the first name ends with, else those without."""
    stem = re.sub(r"_[0-9]{3}$", "", paths[0].stem) if paths else ""
    named = [channel for channel in post.channels if channel.suffix and stem.endswith(channel.suffix)]
    return named or [channel for channel in post.channels if not channel.suffix]


def _contours_of(lines: list[str], channel: Channel) -> list[tuple[Array, Array]]:
    point = pattern(channel.point)
    marks = [pattern(line) for line in channel.contour if "{contour}" in line]
    contours: list[list[list[float]]] = []
    for line in lines:
        if any(mark.fullmatch(line) for mark in marks) or not contours:
            contours.append([])
        match = point.fullmatch(line)
        if match:
            values = match.groupdict()
            contours[-1].append([float(values.get(f"{axis}{k}") or "nan") / MM for k in (1, 2) for axis in "xyz"])
    result = []
    for rows in contours:
        if not rows:
            continue
        table = np.array(rows)
        known = table[:, 3 * channel.tools[0] - 3 :][:, :3]
        if len(table) > 3 and np.array_equal(known[0], known[-1]):
            table = table[:-1]
        result.append((table[:, :3], table[:, 3:]))
    return result
