"""Machine programs from line templates: a post-processor is a YAML file, not code.

A template is a line of text with fields in braces, ``X{x1:.4f}``; braces of the machine's own language are doubled.
The same template, read as a pattern, takes a program apart again, so that a program can be checked against its plan.
"""

from __future__ import annotations

import re
import string
from pathlib import Path

from isf_core.errors import ErrorCode, IsfError
from isf_core.files import yaml_file
from isf_core.files.yaml_file import FileModel
from pydantic import Field, model_validator

FIELDS = {
    "x1": "mm, tip of the upper tool; of a tilted one the point where its axis leaves the tip",
    "y1": "mm",
    "z1": "mm",
    "x2": "mm, tip of the lower tool",
    "y2": "mm",
    "z2": "mm",
    "i1": "unit vector from the tip into the shank of the upper tool, x",
    "j1": "y",
    "k1": "z",
    "a1": "deg, tilt of the upper tool about x, then",
    "b1": "about y; no roll",
    "c1": "deg, a1 + 180: about x for a tool whose z axis points from the shank to the tip (KRL: A 0, B b1, C c1)",
    "qw1": "the same orientation, half a turn about y first, as a quaternion (RAPID)",
    "qx1": "x",
    "qy1": "y",
    "qz1": "z",
    "force": "N, set-point of the support force, 0 = position control",
    "feed": "mm/s",
    "feed_min": "mm/min",
    "feed_m": "m/s",
    "feed1": "mm/s of the upper tool on the way to the point, so that both arrive together",
    "feed2": "the same of the lower tool",
    "feed1_m": "m/s",
    "feed2_m": "m/s",
    "move": "number of the line with this field in the part: the same in the programs of both tools",
    "phase": "TRUE and FALSE by turns, contour by contour",
    "rpm": "1/min, speed of the upper tool's spindle, without sign",
    "spindle_code": "3 clockwise seen from above, 4 counter-clockwise, 5 standing still (M3, M4, M5)",
    "turn": "1/min, the same speed, negative counter-clockwise, 0 standing still",
    **{
        f"{name}{k}": f"{text}, of the {tool} tool's arm"
        for k, tool in ((1, "upper"), (2, "lower"))
        for name, text in {
            "ka": "deg, orientation of the flange in frame sheet about z",
            "kb": "then about y",
            "kc": "then about x (A, B, C of KRL)",
            "kqw": "the same as a quaternion",
            "kqx": "x",
            "kqy": "y",
            "kqz": "z",
            **{f"j{n}_": f"deg, joint {n}; in a header: above the first point" for n in range(1, 7)},
            "sx": "mm, frame sheet in the base of the arm",
            "sy": "mm",
            "sz": "mm",
            "sa": "deg, its orientation about z",
            "sb": "then y",
            "sc": "then x",
            "sqw": "the same as a quaternion",
            "sqx": "x",
            "sqy": "y",
            "sqz": "z",
            "tx": "mm, tip in the flange",
            "ty": "mm",
            "tz": "mm",
        }.items()
    },
    "n": "number of the line in its file",
    "point": "number of the point in the part, from 1",
    "contour": "number of the contour, from 1",
    "contours": "how many contours there are",
    "file": "number of the file of a split program, from 1",
    "name": "name of the part",
    "program": "name of the part with letters, digits and underscores only, at most 24",
    "plan_id": "of the plan",
    "origin": "where the contours come from; a line of the header with it is written once for each line of that",
}
"""What a template may contain."""

FOLDER = Path(__file__).resolve().parent / "posts"

_NUMBER = r"[-+]?[0-9]*\.?[0-9]+(?:[eE][-+]?[0-9]+)?"


class Channel(FileModel):
    """One program: the lines for one controller channel or robot."""

    suffix: str = ""
    """Added to the file name."""
    plans: str = Field(pattern="^(one tool|one tilted tool|two tools|one arm|two arms)$")
    """For which plans this program is written; those of arms where the rig has one for every tool, else the others."""
    header: list[str] = Field(default_factory=list)
    contour: list[str] = Field(default_factory=list)
    """Before the first point of every contour."""
    lift: list[str] = Field(default_factory=list)
    """Before a contour that is reached with lifted tools: the point is the one above (below) its first point."""
    feed_change: list[str] = Field(default_factory=list)
    """Before a point with another speed than the one before, for languages that set it apart from the move."""
    spindle: list[str] = Field(default_factory=list)
    """Before a contour at which the spindle of the upper tool gets another speed."""
    spindle_stop: list[str] = Field(default_factory=list)
    """Where it stops: before a contour that the lower tool forms, and at the end."""
    point: str
    contour_end: list[str] = Field(default_factory=list)
    footer: list[str] = Field(default_factory=list)

    @model_validator(mode="after")
    def _fields(self) -> Channel:
        for line in self.templates:
            try:
                used = {name for _, name, _, _ in string.Formatter().parse(line) if name is not None}
            except ValueError as error:
                raise ValueError(f"template '{line}': {error}; double the braces of the machine's language") from error
            unknown = used - set(FIELDS)
            if unknown:
                known = ", ".join(FIELDS)
                raise ValueError(f"template '{line}' has unknown field {', '.join(sorted(unknown))}; known: {known}")
        if bool(self.spindle) != bool(self.spindle_stop):
            raise ValueError("spindle and spindle_stop need each other: what starts to turn has to stop")
        if not {"x1", "x2"} & {name for _, name, _, _ in string.Formatter().parse(self.point)}:
            raise ValueError("template point needs the position of a tool, such as X{x1:.4f} Y{y1:.4f} Z{z1:.4f}")
        return self

    @property
    def templates(self) -> tuple[str, ...]:
        """All lines."""
        before = (*self.header, *self.contour, *self.spindle, *self.spindle_stop, *self.lift, *self.feed_change)
        return (*before, self.point, *self.contour_end, *self.footer)

    @property
    def tools(self) -> tuple[int, ...]:
        """Tools whose position the point template tells."""
        names = {name for _, name, _, _ in string.Formatter().parse(self.point)}
        return tuple(k for k in (1, 2) if f"x{k}" in names)


class PostProcessor(FileModel):
    """One program format."""

    name: str
    description: str
    extension: str = Field(pattern=r"^\.\w+$")
    lines_per_file: int | None = Field(default=None, ge=50)
    """A longer program is split into files of at most this many lines."""
    clearance: float = Field(default=20.0, gt=0.0)
    """mm, how far the tools are lifted off the sheet plane and all their points: the upper one up, the lower down."""
    spindle_change: float = Field(default=0.05, ge=0.0, lt=1.0)
    """Share of its speed by which the spindle's speed may be off before a line sets it anew (assumed)."""
    channels: list[Channel] = Field(min_length=1)


def load_post(name_or_path: str) -> PostProcessor:
    """Post-processor by name ("pmac") or from a user's YAML file; IsfError EXPORT_FORMAT_UNKNOWN or of the file."""
    path = Path(name_or_path)
    if path.suffix.lower() not in (".yaml", ".yml"):
        path = FOLDER / f"{name_or_path}.yaml"
        if not path.is_file():
            raise IsfError(
                ErrorCode.EXPORT_FORMAT_UNKNOWN,
                f"no program format '{name_or_path}'",
                advice=f"known: {', '.join(post_names())}; or give a YAML file of your own",
            )
    return yaml_file.load(path, PostProcessor)


def post_names() -> tuple[str, ...]:
    """Names of the formats that come with the planner."""
    return tuple(sorted(path.stem for path in FOLDER.glob("*.yaml")))


def pattern(template: str) -> re.Pattern[str]:
    """Regular expression that matches the lines of ``template`` and takes their numbers out by name."""
    parts, seen = [], set()
    for literal, name, _, _ in string.Formatter().parse(template):
        parts.append(re.sub(r"(?:\\?\s)+", r"\\s+", re.escape(literal)))
        if name is None:
            continue
        value = r"\S+?" if name in ("name", "program", "plan_id") else _NUMBER
        parts.append(f"({value})" if name in seen else f"(?P<{name}>{value})")
        seen.add(name)
    return re.compile(r"\s*" + "".join(parts) + r"\s*")
