"""G-code to points: the words of Torrao 2013, Table 6.1, and those that our own exports and common CAM write.

The subset is small and every fault needs its line, its place and a code, which general parsers (they model the whole of
ISO 6983 for cutting) do not give: hence an own reader. Nothing is guessed: a word that is not understood is listed with
its line and makes the program unusable, as in the source (6.1.1).

Coordinates: a program tells tips. A word X, Y, Z (upper tool) or U, V, W (lower tool) counts from the origin of the
selected work coordinates (G54 to G57), with G53 from the origin of frame ``sheet``. Length compensation: at the start
and after G43 without H the length of the mounted tool is in force, so that Z is the tip; G43 H takes the length of tool
H; after G49 Z is the spindle's nose and the tip lies the tool's length below.

Tilt of the upper tool: A and B in degrees about x, then y (Torrao 2013, eq. 4.22 without roll), or its axis as the
vector A3= B3= C3=. X, Y, Z of a tilted tool are the point where its axis leaves the tip (tool centre point control:
G43.4, TRAORI); :meth:`Program.with_ball` makes tips of them. Along lines and arcs the angles change evenly.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.bounded import read_text
from isf_core.geometry.tool_axis import axis_of, tilt_of, tip_of_point
from isf_core.types import Array, Indices, Mask

from isf_planner.gcode.set_up import WORK_SYSTEMS, SetUp

LINES_JUDGED = 100_000
"""Lines after which a text with as many unknown words is another kind of file, which would be read for minutes."""
LARGEST_TEXT = 64_000_000
"""Characters of a program."""
MOST_POINTS = 2_000_000
"""Of a program, between points included."""
MOST_REPORTED = 1000
"""Findings and unknown words that are kept; all are counted."""
ARC_TOLERANCE = 10e-6
"""m, difference of an arc's radii at its two ends up to which it closes: numbers with two or three decimals."""
FARTHEST = 100.0
"""m, coordinate beyond which a number is a mistake."""
RAPID = math.inf
"""m/s of a rapid move: the machine's own."""

_COMMENT = re.compile(r"\([^()]*\)")
_WORD = re.compile(r"([A-Z])\s*([-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+))")
_VECTOR = re.compile(r"([ABC]3)\s*=\s*([-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+))")
_CENTRE_POINT_CONTROL = {"TRAORI", "TRAFOOF"}
_CHUNK = re.compile(r"\S+")
_AXES = "XYZUVW"
_LARGEST_ANGLE = 89.0
"""Degrees of A and B: the tool stands above the sheet."""
_NO_EFFECT_G = {"40", "43.4", "61", "64", "80", "94"}
_NO_EFFECT_M = {"0", "1", "3", "4", "5", "6", "7", "8", "9"}
_PLANES = {"17": (0, 1, 2), "18": (2, 0, 1), "19": (1, 2, 0)}
_CENTRE = "IJK"
_LENGTHS = {"20": 25.4e-3, "70": 25.4e-3, "21": 1e-3, "71": 1e-3}
_GROUPS = (
    ("0", "1", "2", "3"),
    tuple(_PLANES),
    tuple(_LENGTHS),
    ("43", "49"),
    tuple(str(number) for number in WORK_SYSTEMS),
    ("90", "91"),
    ("90.1", "91.1"),
)

_KNOWN_G = {code for group in _GROUPS for code in group} | _NO_EFFECT_G | {"4", "53"}
_KNOWN_M = _NO_EFFECT_M | {"2", "30"}


@dataclass(frozen=True)
class Unknown:
    """A word that is not understood: ``line`` counts from 1, ``text`` is the line (shortened)."""

    line: int
    word: str
    text: str


@dataclass(frozen=True)
class Finding:
    """What makes a program unusable, and the line (from 1)."""

    line: int
    error: IsfError


@dataclass(frozen=True)
class Program:
    """N points in the order of the program.

    Attributes
    ----------
    name : of the file
    tips : (N, 6) m, upper and lower tip in frame ``sheet``; of a tilted upper tool the point on its axis while ``ball``
        is 0
    axis : (N, 3), axis of the upper tool, or (0, 3) where the program never tilts it
    ball : m, radius of the upper tool's tip, 0 until :meth:`with_ball`
    line : (N,) from 1 ; speed : (N,) m/s, infinite for rapid moves ; given : (N,) bool, point that the program names
        (the others lie between, on the line or arc)
    dwell : s, all dwells together
    two_tools : the program moves the lower tool
    systems : work coordinate systems used, to the first line that does
    tool : (N,) number of the tool mounted, -1: none is known
    lower_from : index of the first point at which the program has named the whole place of the lower tool
    unknown, findings : the first MOST_REPORTED of each ; unknown_count : of all
    remarks : what was assumed
    stops : index of the point at which each program stop (M0) waits, and its line; a stop before every point has -1
    """

    name: str
    tips: Array
    line: Indices
    speed: Array
    given: Mask
    dwell: float
    two_tools: bool
    systems: dict[int, int]
    tool: Indices
    lower_from: int
    unknown: tuple[Unknown, ...]
    findings: tuple[Finding, ...]
    unknown_count: int
    remarks: tuple[str, ...]
    axis: Array = field(default_factory=lambda: np.empty((0, 3)))
    ball: float = 0.0
    stops: tuple[tuple[int, int], ...] = ()

    @property
    def tilted(self) -> bool:
        """True when the program tilts the upper tool somewhere."""
        return len(self.axis) > 0

    def with_ball(self, radius: float) -> Program:
        """The program with the tips of a ball of ``radius`` m; the same where the tool is never tilted."""
        if not self.tilted:
            return self
        tips = self.tips.copy()
        tips[:, :3] = tip_of_point(tips[:, :3], self.axis, radius)
        return replace(self, tips=tips, ball=radius)

    def __len__(self) -> int:
        return len(self.tips)

    @property
    def path_length(self) -> float:
        """m, of the upper tip, rapid moves included, from the first point on."""
        return float(np.linalg.norm(np.diff(self.tips[:, :3], axis=0), axis=1).sum())

    def time(self, rapid: float) -> float:
        """s, with ``rapid`` m/s for rapid moves, without acceleration."""
        steps = np.linalg.norm(np.diff(self.tips[:, :3], axis=0), axis=1)
        lower = np.linalg.norm(np.diff(self.tips[:, 3:], axis=0), axis=1)
        alone = np.where(steps > 0.0, steps, lower)
        return float((alone / np.minimum(self.speed[1:], rapid)).sum()) + self.dwell


def program_text(file: Path, advice: str = "check the path") -> str:
    """Text of a program; raises IsfError PROGRAM_UNREADABLE of one that is too long, FILE_NOT_FOUND with ``advice``."""
    try:
        if file.stat().st_size > LARGEST_TEXT:
            raise IsfError(ErrorCode.PROGRAM_UNREADABLE, "is too long", where=str(file), advice="split the program")
        return read_text(file, LARGEST_TEXT, errors="replace")
    except FileNotFoundError as error:
        raise IsfError(ErrorCode.FILE_NOT_FOUND, "no such program", where=str(file), advice=advice) from error
    except OSError as error:
        what = f"cannot be read: {error.strerror}"
        raise IsfError(ErrorCode.PROGRAM_UNREADABLE, what, where=str(file), advice=advice) from error


def read_program(
    text: str, set_up: SetUp | None = None, *, name: str = "program", step: float = 1e-3, feed: float = 30e-3
) -> Program:
    """Points of the G-code ``text``.

    Parameters
    ----------
    set_up : work offsets and tools; None: all offsets zero, no tools
    name : file, for people
    step : m, largest distance between points (Torrao 2013, 6.1.1: it depends on the length)
    feed : m/s, until the program gives F

    Raises
    ------
    IsfError : PROGRAM_UNREADABLE for a text that is too long, has too many points or unknown words, or moves nothing
        and has no fault that says why. Faults within are findings.
    """
    if len(text) > LARGEST_TEXT:
        raise IsfError(
            ErrorCode.PROGRAM_UNREADABLE,
            f"has {len(text) / 1e6:.0f} million characters, at most {LARGEST_TEXT / 1e6:.0f} are read",
            where=name,
            advice="split the program",
        )
    reader = _Reader(set_up or SetUp(), name, step, feed)
    for number, line in enumerate(text.splitlines(), start=1):
        if reader.block(number, line):
            break
        if number > LINES_JUDGED and reader.unknown_count >= number:
            what = f"is no program that can be read: {reader.unknown_count:,} words in {number:,} lines are unknown"
            advice = "check that it is G-code, and of the dialect that is read"
            raise IsfError(ErrorCode.PROGRAM_UNREADABLE, what, where=f"{name}:{number}", advice=advice)
    return reader.program()


@dataclass
class _Reader:
    """Modal state of the program; positions are tips in frame ``sheet``, m."""

    set_up: SetUp
    name: str
    step: float
    feed: float
    motion: str = ""
    plane: str = "17"
    unit: float = 1e-3
    absolute: bool = True
    centre_absolute: bool = False
    system: int = 54
    position: list[float] = field(default_factory=lambda: [0.0] * 8)  # tips, then tilt about x and y in rad
    rows: list[tuple[float, ...]] = field(default_factory=list)
    between: list[int] = field(default_factory=list)
    named: list[bool] = field(default_factory=list)
    total: int = 0
    dwell: float = 0.0
    two_tools: bool = False
    feed_given: bool = False
    ended: bool = False
    line: int = 0
    text: str = ""
    unknown: list[Unknown] = field(default_factory=list)
    findings: list[Finding] = field(default_factory=list)
    unknown_count: int = 0
    lower_named: set[str] = field(default_factory=set)
    lower_from: int | None = None
    systems: dict[int, int] = field(default_factory=dict)
    remarks: list[str] = field(default_factory=list)
    stops: list[tuple[int, int]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.tool = self.set_up.mounted
        self.length = self._length_of(self.tool)

    def block(self, number: int, line: str) -> bool:
        """Read one line; True when the program ends with it."""
        self.line, self.text = number, line.strip()[:120]
        words = self._words(line)
        codes = self._codes(words)
        end = bool({"2", "30"} & set(codes["M"]))
        self._modes(codes["G"], words)
        if "4" in codes["G"]:
            self._dwell(words)
        else:
            self._move(codes["G"], words)
        if "0" in codes["M"]:
            self.stops.append((len(self.rows), number))
        self.ended = self.ended or end
        return end

    def program(self) -> Program:
        """What was read."""
        if not self.rows and not self.findings and not self.unknown:
            raise IsfError(
                ErrorCode.PROGRAM_UNREADABLE,
                "moves no tool",
                where=self.name,
                advice="give a program with G0, G1, G2 or G3 and coordinates",
            )
        if not self.ended:
            self.remarks.append("the program has no end (M30): it may be cut off")
        if not self.feed_given and any(row[9] != RAPID for row in self.rows):
            self.remarks.append(f"the program gives no feed (F): {60e3 * self.feed:.0f} mm/min is taken")
        rows = np.array(self.rows, dtype=np.float64).reshape(-1, 11)
        count = np.array(self.between, dtype=np.int64)
        last = np.cumsum(count) - 1
        of = np.repeat(np.arange(len(rows)), count)
        share = (np.arange(len(of)) - (last - count)[of]) / count[of] if len(of) else np.empty(0)
        before = np.vstack([rows[:1, :8], rows[:-1, :8]])
        poses = before[of] + (rows[of, :8] - before[of]) * share[:, None]
        given = np.zeros(len(of), dtype=bool)
        given[last] = np.array(self.named, dtype=bool)
        poses[last] = rows[:, :8]
        return Program(
            self.name,
            poses[:, :6],
            rows[of, 8].astype(np.int64),
            rows[of, 9],
            given,
            self.dwell,
            self.two_tools,
            self.systems,
            rows[of, 10].astype(np.int64),
            int(of.size if self.lower_from is None else last[self.lower_from]),
            tuple(self.unknown),
            tuple(self.findings),
            self.unknown_count,
            tuple(self.remarks),
            axis_of(poses[:, 6:]) if rows[:, 6:8].any() else np.empty((0, 3)),
            stops=tuple((int(last[rows_before - 1]) if rows_before else -1, line) for rows_before, line in self.stops),
        )

    def _words(self, line: str) -> list[tuple[str, str]]:
        plain = _COMMENT.sub(" ", line).partition(";")[0].upper().strip()
        if plain.startswith("%"):
            return []
        words, at = [], 0
        plain = plain.removeprefix("/")
        while at < len(plain):
            if plain[at].isspace():
                at += 1
                continue
            match = _VECTOR.match(plain, at) or _WORD.match(plain, at)
            if match is None:
                chunk = _CHUNK.match(plain, at)
                assert chunk is not None  # no space stands here
                if chunk[0] in _CENTRE_POINT_CONTROL:
                    at = chunk.end()
                    continue
                self._not_known(plain[at : min(at + 40, chunk.end())])
                at = chunk.end()
                continue
            words.append((match[1], match[2]))
            at = match.end()
        return words

    def _codes(self, words: list[tuple[str, str]]) -> dict[str, list[str]]:
        codes: dict[str, list[str]] = {"G": [], "M": []}
        for letter, number in words:
            if letter in codes:
                codes[letter].append(_plain(number))
        for code in codes["G"]:
            if code not in _KNOWN_G:
                self._not_known(f"G{code}")
        for code in codes["M"]:
            if code not in _KNOWN_M:
                self._not_known(f"M{code}")
        for group in _GROUPS:
            both = sorted(set(group) & set(codes["G"]))
            if len(both) > 1:
                self._find(ErrorCode.PROGRAM_UNREADABLE, f"G{' and G'.join(both)} exclude each other in one line")
        return codes

    def _modes(self, codes: list[str], words: list[tuple[str, str]]) -> None:
        for code in codes:
            if code in _GROUPS[0] or (code == "80" and not set(codes) & set(_GROUPS[0])):
                self.motion = code.replace("80", "")
            self.plane = code if code in _PLANES else self.plane
            self.unit = _LENGTHS.get(code, self.unit)
            if code in ("90", "91"):
                self.absolute = code == "90"
            if code in ("90.1", "91.1"):
                self.centre_absolute = code == "90.1"
            if code in _GROUPS[4]:
                self.system = int(code)
                self.systems.setdefault(self.system, self.line)
        if (feed := self._value(words, "F")) is not None:
            if feed > 0.0:
                self.feed, self.feed_given = feed * self.unit / 60.0, True
            else:
                self._find(ErrorCode.PROGRAM_UNREADABLE, "the feed must be positive")
        if (tool := self._value(words, "T")) is not None:
            self.tool = int(tool)
            self.length = self._length_of(self.tool)
        if "49" in codes:
            if self.tool not in self.set_up.tools:
                self._no_tool(self.tool, "G49 needs the length of the tool that is mounted")
            self.length = 0.0
        if "43" in codes:
            wanted = self._value(words, "H")
            self.length = self._length_of(self.tool if wanted is None else int(wanted))
        else:
            self._not_meant(words, "H")

    def _length_of(self, tool: int | None) -> float:
        """m; without a library no tool has one, and none is needed."""
        if tool is None or (known := self.set_up.tools.get(tool)) is None:
            if tool is not None and self.set_up.tools:
                self._no_tool(tool, f"tool {tool} is not in the library")
            return 0.0
        return known.length

    def _no_tool(self, tool: int | None, what: str) -> None:
        advice = f"add tool {'N' if tool is None else tool} under tools of the set-up file"
        self._find(ErrorCode.PROGRAM_TOOL_UNKNOWN, what, advice)

    def _dwell(self, words: list[tuple[str, str]]) -> None:
        time = self._value(words, "P")
        self._not_meant(words, "YZUVWIJKR" if time is None else "XYZUVWIJKR")
        time = self._value(words, "X") if time is None else time
        if time is None or time < 0.0:
            self._find(ErrorCode.PROGRAM_UNREADABLE, "G4 needs its time in s (P or X)")
            return
        self.dwell += time

    def _move(self, codes: list[str], words: list[tuple[str, str]]) -> None:
        for letter, number in words:
            if letter == "C" and float(number) != 0.0:
                self._not_known(f"{letter}{number}")  # a tool has no roll
            elif letter in "DELQ":
                self._not_known(f"{letter}{number}")
        arc = self.motion in ("2", "3")
        moves = any(letter in _AXES or (arc and letter in "IJKR") for letter, _ in words)
        self._not_meant(words, ("P" if moves else "") if arc else "IJKR")  # P: more turns; R with G1: a rounded corner
        given = {letter: self._value(words, letter) for letter in _AXES}
        target = list(self.position)
        mounted = self.set_up.tools[self.tool].length if self.tool in self.set_up.tools else self.length
        lift = self.length - mounted
        origin = (0.0, 0.0, 0.0) if "53" in codes else self.set_up.offset(self.system)
        for k, letter in enumerate(_AXES):
            value = given[letter]
            if value is None:
                continue
            if self.absolute or "53" in codes:
                target[k] = value * self.unit + origin[k % 3] + (lift if k == 2 else 0.0)
            else:
                target[k] += value * self.unit
        turned = self._tilt(words, target)
        centred = any(letter in "IJKR" for letter, _ in words)
        if (
            all(value is None for value in given.values())
            and not turned
            and not (centred and self.motion in ("2", "3"))
        ):
            return
        if max(map(abs, target[:6])) > FARTHEST:
            self._find(ErrorCode.PROGRAM_OUT_OF_REACH, f"a coordinate is beyond {FARTHEST:.0f} m", "check the unit")
            return
        if not self.motion:
            self._find(ErrorCode.PROGRAM_UNREADABLE, "coordinates without G0, G1, G2 or G3 before")
            return
        if "53" not in codes:
            self.systems.setdefault(self.system, self.line)
        self.two_tools = self.two_tools or any(given[letter] is not None for letter in "UVW")
        if self.motion in ("2", "3"):
            self._arc(target, words, origin)
        else:
            self._append(target, RAPID if self.motion == "0" else self.feed)
        self.position = target
        if self.absolute or "53" in codes:
            self.lower_named |= {letter for letter in "UVW" if given[letter] is not None}
        if self.lower_from is None and self.lower_named == set("UVW"):
            self.lower_from = len(self.rows) - 1

    def _tilt(self, words: list[tuple[str, str]], target: list[float]) -> bool:
        """Write the tilt of a line into ``target``; True when the line names one."""
        angles = [self._value(words, letter) for letter in "AB"]
        vector = [self._value(words, letter) for letter in ("A3", "B3", "C3")]
        if any(value is not None for value in vector):
            x, y, z = (value or 0.0 for value in vector)
            if not (z > 0.0 and math.hypot(x, y) < math.tan(math.radians(_LARGEST_ANGLE)) * z):
                self._find(ErrorCode.PROGRAM_OUT_OF_REACH, f"the axis ({x:g}, {y:g}, {z:g}) points through the sheet")
                return True
            target[6:] = tilt_of(np.array([x, y, z])).tolist()
            return True
        for k, value in enumerate(angles):
            if value is None:
                continue
            angle = math.degrees(target[6 + k]) * (not self.absolute) + value
            if abs(angle) > _LARGEST_ANGLE:
                what = f"{'AB'[k]} tilts the tool by {angle:g} deg: its axis points through the sheet"
                self._find(ErrorCode.PROGRAM_OUT_OF_REACH, what)
                return True
            target[6 + k] = math.radians(angle)
        return any(value is not None for value in angles)

    def _append(self, target: list[float], speed: float, *, between: bool = True, named: bool = True) -> None:
        count = 1
        if between and self.rows:
            start = self.rows[-1]
            span = max(math.dist(start[:3], target[:3]), math.dist(start[3:6], target[3:6]))
            count = max(1, math.ceil(span / self.step - 1e-6))
        self.total += count
        if self.total > MOST_POINTS:
            raise IsfError(
                ErrorCode.PROGRAM_UNREADABLE,
                f"has more than {MOST_POINTS} points",
                where=f"{self.name}:{self.line}",
                advice="a larger --step, or split the program",
            )
        self.rows.append((*target, float(self.line), speed, -1.0 if self.tool is None else float(self.tool)))
        self.between.append(count)
        self.named.append(named)

    def _arc(self, target: list[float], words: list[tuple[str, str]], origin: tuple[float, float, float]) -> None:
        first, second, along = _PLANES[self.plane]
        start = np.array([self.position[first], self.position[second]])
        end = np.array([target[first], target[second]])
        clockwise = self.motion == "2"
        centre = self._centre(words, start, end, origin)
        if centre is None:
            self._append(target, self.feed)
            return
        out, back = start - centre, end - centre
        radius, radius_end = float(np.hypot(*out)), float(np.hypot(*back))
        if radius < 1e-9 or abs(radius - radius_end) > ARC_TOLERANCE:
            self._find(
                ErrorCode.PROGRAM_ARC_OPEN,
                f"the arc begins {1e3 * radius:.4f} mm and ends {1e3 * radius_end:.4f} mm from its centre",
                "correct end or centre; I, J, K count from the start of the arc unless G90.1 holds",
            )
            self._append(target, self.feed)
            return
        begin = math.atan2(out[1], out[0])
        sweep = math.atan2(back[1], back[0]) - begin
        sweep = sweep % math.tau if not clockwise else -((-sweep) % math.tau)
        if float(np.hypot(*(end - start))) < 1e-9:  # a full circle
            sweep = -math.tau if clockwise else math.tau
        span = math.hypot(abs(sweep) * max(radius, radius_end), target[along] - self.position[along])
        count = max(1, math.ceil(span / self.step - 1e-6))
        if self.total + count > MOST_POINTS:
            self.total = MOST_POINTS
            self._append(target, self.feed)  # refuses
        before = np.array(self.position)
        for k in range(1, count):
            share = k / count
            here = (before + share * (np.array(target) - before)).tolist()
            turned, size = begin + share * sweep, radius + share * (radius_end - radius)
            here[first] = float(centre[0]) + size * math.cos(turned)
            here[second] = float(centre[1]) + size * math.sin(turned)
            self._append(here, self.feed, between=False, named=False)
        self._append(target, self.feed, between=False)

    def _centre(
        self, words: list[tuple[str, str]], start: Array, end: Array, origin: tuple[float, float, float]
    ) -> Array | None:
        first, second, _ = _PLANES[self.plane]
        if (radius := self._value(words, "R")) is not None:
            radius *= self.unit
            chord = end - start
            half = 0.5 * float(np.hypot(*chord))
            if half < 1e-9 or abs(radius) < half - ARC_TOLERANCE:
                self._find(
                    ErrorCode.PROGRAM_ARC_OPEN,
                    f"a radius of {1e3 * abs(radius):.4f} mm does not reach over {2e3 * half:.4f} mm",
                    "correct R, or give the centre (I, J, K)",
                )
                return None
            rise = math.sqrt(max(radius**2 - half**2, 0.0))
            side = -1.0 if (self.motion == "2") == (radius > 0.0) else 1.0
            across = np.array([-chord[1], chord[0]]) / (2.0 * half)
            return 0.5 * (start + end) + side * rise * across
        values = [self._value(words, _CENTRE[k]) for k in (first, second)]
        if values == [None, None]:
            self._find(ErrorCode.PROGRAM_ARC_OPEN, "the arc has no centre and no radius", "add I, J, K or R")
            return None
        base = np.array([origin[first], origin[second]]) if self.centre_absolute else start
        return np.asarray(base + self.unit * np.array([value or 0.0 for value in values]))

    def _value(self, words: list[tuple[str, str]], letter: str) -> float | None:
        """Number of the word ``letter``, None without one or with one that cannot be used."""
        found = [number for key, number in words if key == letter]
        if not found:
            return None
        if len(found) > 1:
            self._find(ErrorCode.PROGRAM_UNREADABLE, f"{letter} stands {len(found)} times in one line")
        value = float(found[0])
        if not abs(value) < 1e9:
            self._find(ErrorCode.PROGRAM_UNREADABLE, f"the number of {letter} is out of all bounds")
            return None
        return value

    def _not_meant(self, words: list[tuple[str, str]], letters: str) -> None:
        """Words with one of ``letters``, which mean nothing here, or to another control something else."""
        for letter, number in words:
            if letter in letters:
                self._not_known(f"{letter}{number}")

    def _not_known(self, word: str) -> None:
        self.unknown_count += 1
        if len(self.unknown) < MOST_REPORTED:
            self.unknown.append(Unknown(self.line, word, self.text))

    def _find(self, code: ErrorCode, what: str, advice: str = "") -> None:
        error = IsfError(code, what, where=f"{self.name}:{self.line}", advice=advice)
        repeated = any(one.line == self.line and one.error.what == what for one in self.findings[-4:])
        if len(self.findings) < MOST_REPORTED and not repeated:
            self.findings.append(Finding(self.line, error))


def _plain(number: str) -> str:
    """Code without leading and trailing zeros: "01" is "1", "90.10" is "90.1"."""
    whole, _, rest = number.lstrip("+").partition(".")
    rest = rest.rstrip("0")
    return (whole.lstrip("0") or "0") + (f".{rest}" if rest else "")
