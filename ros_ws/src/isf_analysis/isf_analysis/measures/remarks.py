"""What springback correction said about its own limits, put together over all contours, most severe first.

Remarks are sentences with numbers that change from contour to contour; sentences that differ in their numbers alone
are one group. A group is told in the words of the contour with the largest number of millimetres (else the last).
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from isf_core.contour import ContourCorrection

_NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?")
_LENGTH = re.compile(r"([-+]?\d+(?:\.\d+)?) mm\b")


@dataclass(frozen=True)
class Remark:
    """One group of remarks.

    Attributes
    ----------
    text : the remark where it was strongest
    contours : indices of the contours that carry it
    size : mm, the largest length it names; 0 when it names none
    failed : the correction reports an error code with it
    """

    text: str
    contours: tuple[int, ...]
    size: float
    failed: bool = False


def grouped(corrections: Sequence[ContourCorrection]) -> tuple[Remark, ...]:
    """All remarks by kind: failures first, then by the length they name, then by the number of contours."""
    groups: dict[tuple[bool, str], list[tuple[int, str]]] = {}
    for correction in corrections:
        for failed, text in _texts(correction):
            groups.setdefault((failed, _NUMBER.sub("#", text)), []).append((correction.index, text))
    found = []
    for (failed, _), items in groups.items():
        strongest = max(reversed(items), key=lambda item: _size(item[1]))
        indices = tuple(sorted({index for index, _ in items}))
        found.append(Remark(strongest[1], indices, _size(strongest[1]), failed))
    return tuple(sorted(found, key=lambda remark: (not remark.failed, -remark.size, -len(remark.contours))))


def spans(indices: Sequence[int]) -> str:
    """Numbers as people write them: "0-4, 7"."""
    parts: list[list[int]] = []
    for index in sorted(indices):
        if parts and index == parts[-1][-1] + 1:
            parts[-1].append(index)
        else:
            parts.append([index])
    return ", ".join(f"{part[0]}-{part[-1]}" if len(part) > 1 else f"{part[0]}" for part in parts)


def _texts(correction: ContourCorrection) -> Iterator[tuple[bool, str]]:
    if correction.code or correction.message:
        text = correction.message or "the method failed without a message"
        yield True, f"{correction.code}: {text}" if correction.code else text
    seen = set()
    for text in correction.remarks:
        if text not in seen:
            seen.add(text)
            yield False, text
    if correction.saturated.any():
        share = 100 * float(correction.saturated.mean())
        yield False, f"a limit of the correction was reached at {share:.0f} % of the points"


def _size(text: str) -> float:
    return max((abs(float(value)) for value in _LENGTH.findall(text)), default=0.0)
