"""Where sections go: those that show a part by themselves, and those that its reader asks for.

Lengths in m, angles in rad from x, frame ``sheet``; what people write and read is in mm and degrees.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import shapely
from isf_core.errors import ErrorCode, IsfError
from isf_core.geometry.height_map import HeightMap
from isf_core.types import Array
from scipy import ndimage

from isf_analysis.measures.deviation import Deviation

MM = 1e3
MARGIN = 25e-3
"""m of flange shown around the opening."""

POINTS = 801
"""Of a section."""

GRAMMAR = "y=12.5 (along x, mm), x=0 (along y), 30deg (from x, through the middle) or 30deg@10,-5 (through x, y in mm)"


@dataclass(frozen=True)
class Cut:
    """Where a section goes.

    Attributes
    ----------
    name : file name without ending ; words : for its title
    centre : (x, y) m, where the distance is zero ; angle : rad from x
    begin, end : m from ``centre``, signed
    axis : what the distance is, for people ; label : its name on the map
    """

    name: str
    words: str
    centre: tuple[float, float]
    angle: float
    begin: float
    end: float
    axis: str
    label: str = ""

    def distances(self) -> Array:
        """(:data:`POINTS`,) m from ``centre``, from begin to end."""
        return np.linspace(self.begin, self.end, POINTS)

    def points(self, distances: Array) -> Array:
        """(N, 2) m, places at ``distances`` (N,) m from ``centre``."""
        return np.asarray(self.centre + distances[:, None] * np.array([np.cos(self.angle), np.sin(self.angle)]))


@dataclass(frozen=True)
class Plane:
    """A section that was asked for: an upright plane, ``angle`` rad from x.

    ``through`` (x, y) m; None: the middle of the part. ``axis`` x or y: the plane is along it, and distances are that
    coordinate; empty: at any angle. ``name`` of its file, ``label`` for people.
    """

    name: str
    label: str
    angle: float
    through: tuple[float, float] | None
    axis: str = ""


_NUMBER = r"([+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+))"
_ALONG = re.compile(rf"([xy])\s*=\s*{_NUMBER}\s*(?:mm)?")
_TURNED = re.compile(rf"{_NUMBER}\s*(?:deg|°)(?:\s*@\s*{_NUMBER}\s*,\s*{_NUMBER}\s*(?:mm)?)?")


def planes_of(texts: Iterable[str]) -> tuple[Plane, ...]:
    """The sections that ``texts`` ask for, such as ``y=12.5``, ``30deg`` or ``30deg@10,-5``; each of them once.

    Raises
    ------
    IsfError : FILE_FIELD, a text that is none
    """
    planes = (_plane(text) for text in texts)
    return tuple({plane.name: plane for plane in planes}.values())


def _plane(text: str) -> Plane:
    if along := _ALONG.fullmatch(text.strip()):
        fixed, value = along.group(1), float(along.group(2)) + 0.0  # no -0
        if np.isfinite(value):
            place = (value / MM, 0.0) if fixed == "x" else (0.0, value / MM)
            name, label = f"section_at_{fixed}_{value:.9g}mm", f"{fixed} = {value:.6g}"
            return Plane(name, label, np.pi / 2 if fixed == "x" else 0.0, place, "y" if fixed == "x" else "x")
    elif turned := _TURNED.fullmatch(text.strip()):
        angle, *place_mm = (float(value) + 0.0 for value in turned.groups() if value is not None)
        if np.isfinite([angle, *place_mm]).all() and abs(angle) <= 360.0:
            name, label = f"section_{angle:.9g}deg", f"{angle:.6g} deg"
            if not place_mm:
                return Plane(name, label, float(np.radians(angle)), None)
            x, y = place_mm
            name, label = f"{name}_at_{x:.9g}_{y:.9g}mm", f"{label} at ({x:.6g}, {y:.6g})"
            return Plane(name, label, float(np.radians(angle)), (x / MM, y / MM))
    raise IsfError(ErrorCode.FILE_FIELD, f"'{text}' is no section", where="--section", advice=f"write {GRAMMAR}")


def asked_cuts(planes: Sequence[Plane], deviation: Deviation | None) -> tuple[Cut, ...]:
    """Sections along ``planes`` of a part with ``deviation``, as far as the map of the deviation goes.

    Raises
    ------
    IsfError : FILE_FIELD, a plane misses the part and the flange around it, or runs where nothing was measured;
        BAG_INCOMPLETE, there is no ``deviation``
    """
    if not planes:
        return ()
    if deviation is None:
        raise IsfError(
            ErrorCode.BAG_INCOMPLETE,
            "there is no scan that can be compared with the wanted shape, so there are no sections",
            where="--section",
            advice="report the part without --section: its notes say what is missing",
        )
    return tuple(_asked(plane, deviation) for plane in planes)


def _asked(plane: Plane, deviation: Deviation) -> Cut:
    centre = plane.through if plane.through is not None else _middle(deviation)
    x0, x1, y0, y1 = part_frame(deviation)
    along = np.array([np.cos(plane.angle), np.sin(plane.angle)])
    reach = abs(complex(*centre)) + abs(complex(x1 - x0, y1 - y0)) + abs(complex(x0, y0))  # beyond the frame
    line = shapely.LineString([centre - reach * along, centre + reach * along])
    shown = shapely.get_coordinates(shapely.intersection(line, shapely.box(x0, y0, x1, y1)))
    if len(shown) < 2:
        raise IsfError(
            ErrorCode.FILE_FIELD,
            f"section {plane.label} misses the part",
            where="--section",
            advice=f"with its flange it is shown from x = {MM * x0:.0f} to {MM * x1:.0f} mm "
            f"and from y = {MM * y0:.0f} to {MM * y1:.0f} mm",
        )
    begin, end = sorted(float((point - centre) @ along) for point in shown[[0, -1]])
    label = _signed(plane.label)
    if plane.axis:
        words, axis = f"along {plane.axis} at {label} mm", plane.axis
    else:
        place = _signed(", ".join(f"{MM * value:.6g}" for value in centre))
        angle = _signed(f"{np.degrees(plane.angle):.6g}")
        words, axis = f"at {angle}° from x, through ({place}) mm", f"distance from ({place})"
    cut = Cut(plane.name, words, centre, plane.angle, begin, end, axis, label)
    points = cut.points(cut.distances())
    if not np.isfinite(deviation.error.at(points)).any():
        raise IsfError(
            ErrorCode.FILE_FIELD,
            f"nothing was measured along section {plane.label}",
            where="--section",
            advice="choose another one: the map of the deviation shows what was measured",
        )
    formed = HeightMap(deviation.error.x, deviation.error.y, deviation.masks["wall_and_base"].astype(float))
    if not (np.nan_to_num(formed.at(points)) > 0.5).any():
        return replace(cut, words=f"{words}, on the flange only")
    return cut


def cuts(deviation: Deviation) -> tuple[Cut, ...]:
    """Sections that show the part: along x, along y and through the largest error.

    Of several features: along the two largest, across each, and through the largest error. Sections go through the
    origin when the part is there, else through its middle. Features smaller than a hundredth of the largest, and those
    after the fourth, get none.
    """
    mask = deviation.masks["wall_and_base"]
    x, y = deviation.error.x, deviation.error.y
    labels, count = ndimage.label(mask, structure=np.ones((3, 3)))
    cells = ndimage.sum_labels(mask, labels, range(1, count + 1))
    kept = [k for k in range(1, count + 1) if cells[k - 1] >= 0.01 * cells.max()]
    boxes = ndimage.find_objects(labels)
    middles, halves = [], []
    for k in kept:
        rows, columns = boxes[k - 1]
        box = (x[columns.start], x[columns.stop - 1], y[rows.start], y[rows.stop - 1])
        middles.append((0.5 * float(box[0] + box[1]), 0.5 * float(box[2] + box[3])))
        halves.append(0.5 * float(np.hypot(box[1] - box[0], box[3] - box[2])))
    if len(kept) == 1:
        centre = (0.0, 0.0) if _at_origin(deviation) else middles[0]
        extent = _extent(deviation) if _at_origin(deviation) else halves[0] + MARGIN
        found = (
            _about("section_x", f"along x at y = {_mm(centre[1:])} mm", centre, 0.0, extent),
            _about("section_y", f"along y at x = {_mm(centre[:1])} mm", centre, np.pi / 2, extent),
        )
        return *found, *_worst_cut(deviation, centre, extent, found)
    order = np.argsort([-cells[k - 1] for k in kept], kind="stable")[:4]
    one, other = sorted(middles[k] for k in order[:2])
    angle = float(np.arctan2(other[1] - one[1], other[0] - one[0]))
    centre = (0.5 * (one[0] + other[0]), 0.5 * (one[1] + other[1]))
    extent = 0.5 * float(np.hypot(other[0] - one[0], other[1] - one[1])) + max(halves) + MARGIN
    along = _about("section_x", "through the two largest features", centre, angle, extent)
    across = [
        _about(
            f"section_feature_{n}",
            f"across the feature at ({_mm(middles[k])}) mm",
            middles[k],
            angle + np.pi / 2,
            halves[k] + MARGIN,
        )
        for n, k in enumerate(order)
    ]
    label = labels[np.argmin(np.abs(y - deviation.whole.worst[1])), np.argmin(np.abs(x - deviation.whole.worst[0]))]
    if not np.isfinite(deviation.whole.worst[2]) or label not in kept:
        return along, *across
    return (
        along,
        *across,
        *_worst_cut(deviation, middles[kept.index(label)], halves[kept.index(label)] + MARGIN, (along, *across)),
    )


def _about(name: str, words: str, centre: tuple[float, float], angle: float, extent: float) -> Cut:
    """Section to ``extent`` m on both sides of ``centre``."""
    axis = f"distance from ({_mm(centre)})" if any(centre) else "distance from the centre"
    return Cut(name, words, centre, angle, -extent, extent, axis)


def _worst_cut(
    deviation: Deviation, centre: tuple[float, float], extent: float, others: Sequence[Cut]
) -> tuple[Cut, ...]:
    """From ``centre`` through the largest error; none where there is no error, or it lies on one of the ``others``."""
    if not deviation.whole.max_abs > 0.0:  # NaN too
        return ()
    worst = np.array(deviation.whole.worst[:2])
    cell = float(deviation.error.x[1] - deviation.error.x[0])
    for cut in others:
        from_centre = worst - cut.centre
        beside = abs(from_centre[1] * np.cos(cut.angle) - from_centre[0] * np.sin(cut.angle))
        if beside <= cell:
            return ()
    x, y = worst - centre
    words = f"through the largest error at ({_mm(deviation.whole.worst[:2])}) mm"
    return (_about("section_worst", words, centre, float(np.arctan2(y, x)), extent),)


def _extent(deviation: Deviation) -> float:
    """m from the centre that a section should show: the farthest corner of the opening and some flange."""
    opening = deviation.masks["wall_and_base"]
    rows, columns = np.nonzero(opening)
    radius = np.hypot(deviation.error.x[columns], deviation.error.y[rows]).max()
    half = min(np.abs(deviation.error.x[[0, -1]]).min(), np.abs(deviation.error.y[[0, -1]]).min())
    return float(min(radius + MARGIN, half))


def _at_origin(deviation: Deviation) -> bool:
    rows, columns = np.abs(deviation.error.y), np.abs(deviation.error.x)
    return bool(deviation.masks["wall_and_base"][np.argmin(rows), np.argmin(columns)])


def _middle(deviation: Deviation) -> tuple[float, float]:
    """(x, y) m: the origin when the part is there, else the middle of all that is formed."""
    if _at_origin(deviation):
        return 0.0, 0.0
    x0, x1, y0, y1 = part_frame(deviation, 0.0)
    return 0.5 * (x0 + x1), 0.5 * (y0 + y1)


def part_frame(deviation: Deviation, margin: float = MARGIN) -> tuple[float, float, float, float]:
    """m, least and largest x and y that a map shows: the opening and ``margin`` of flange."""
    rows, columns = np.nonzero(deviation.masks["wall_and_base"])
    x, y = deviation.error.x, deviation.error.y
    return (
        float(max(x[0], x[columns.min()] - margin)),
        float(min(x[-1], x[columns.max()] + margin)),
        float(max(y[0], y[rows.min()] - margin)),
        float(min(y[-1], y[rows.max()] + margin)),
    )


def _mm(place: tuple[float, ...]) -> str:
    return _signed(", ".join(f"{MM * value + 0.0:.0f}" for value in place))


def _signed(text: str) -> str:
    """Numbers for pictures and pages; at the terminal a minus is one that can be copied."""
    return text.replace("-", "\N{MINUS SIGN}")
