"""What the page shows: news of a part in the order in which they came, and samples of the tools.

Whoever hears the cell, or reads a record, writes it from one thread; the server reads it for any number of browsers
from another. Nothing waits for a browser: each asks for what is new to it (:class:`Cursor`), and one that is slow gets
fewer of the samples that it missed.
"""

from __future__ import annotations

import base64
import json
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from isf_core.types import Array

COLUMNS = (
    "t",
    *("x1", "y1", "z1", "x2", "y2", "z2"),
    *("phi1", "theta1", "psi1", "phi2", "theta2", "psi2"),
    *("fx1", "fy1", "fz1", "fx2", "fy2", "fz2"),
    *("set_point", "normal_force", "feed", "contour", "mode", "flags"),
)
"""Of a sample: time since the beginning (s), tips (mm), angles about x, y, z (deg) and forces (N) of both tools, normal
force and its set-point (N), feed (mm/s), contour, mode and flags of force control. NaN: not known."""

LOGGED = [
    COLUMNS.index(name) for name in ("t", "x1", "y1", "z1", "phi1", "theta1", "psi1", "fx1", "fy1", "fz1", "fx2", "fy2")
]
"""Columns of a sample that the text log has (:mod:`isf_analysis.bag.text_log`)."""

KEPT = 36_000
"""Samples kept: half an hour at 20 per second; of a longer part every second one of the older half is let go."""

AT_ONCE = 4000
"""Samples in one message to a browser; of more, as for one that was slow, only every n-th is sent."""

TEXT_AT_ONCE = 1_000_000
"""Characters of news in one message, after which it ends."""


@dataclass
class Cursor:
    """How far a browser knows the history."""

    part: int = -1
    items: int = 0
    sample: int = 0
    status: int = -1


class History:
    """News (``items``), samples and the present status of a cell; all of a part are let go when the next one begins.

    ``mode`` : "live" or "run"
    """

    def __init__(self, mode: str, *, kept: int = KEPT, at_once: int = AT_ONCE) -> None:
        self.mode = mode
        self._lock = threading.Lock()
        self._kept, self._at_once = kept, at_once
        self._part = 0
        self._items: list[str] = []
        self._rows = np.empty((kept, len(COLUMNS)))
        self._numbers = np.empty(kept, dtype=np.int64)
        self._count = 0
        self._last = 0
        self._status: dict[str, Any] = {}
        self._status_number = 0

    def begin(self) -> None:
        """Another part: what was told of the one before is let go, the samples stay."""
        with self._lock:
            self._part += 1
            self._items = []

    def add(self, kind: str, time: float, **values: Any) -> None:
        """Tell something that happened at ``time`` s; arrays (numpy) go as float32, or as they are if of bytes."""
        text = _json({"kind": kind, "t": round(time, 3), **values})
        with self._lock:
            self._items.append(text)

    def sample(self, row: Sequence[float] | Array) -> None:
        """A sample, :data:`COLUMNS`."""
        self.samples(np.asarray(row, dtype=np.float64)[None, :])

    def samples(self, rows: Array) -> None:
        """Samples (N, C) in the order of time."""
        with self._lock:
            for row in rows:
                if self._count == self._kept:
                    self._thin_out()
                self._last += 1
                self._rows[self._count], self._numbers[self._count] = row, self._last
                self._count += 1

    def set_status(self, status: Mapping[str, Any]) -> None:
        """What holds now, as a whole; the one before is forgotten."""
        with self._lock:
            if status != self._status:
                self._status = dict(status)
                self._status_number += 1

    def table(self) -> Array:
        """(N, C) the samples that are kept."""
        with self._lock:
            return self._rows[: self._count].copy()

    @property
    def status(self) -> dict[str, Any]:
        """What was set last."""
        with self._lock:
            return dict(self._status)

    def news(self, cursor: Cursor) -> str | None:
        """What ``cursor``, which is moved, does not know yet, as JSON; None when it knows all."""
        with self._lock:
            parts = []
            if cursor.part != self._part:
                columns = json.dumps(COLUMNS)
                parts.append(f'"begin":{{"mode":"{self.mode}","part":{self._part},"columns":{columns}}}')
                cursor.part, cursor.items = self._part, 0
            if cursor.items < len(self._items):
                parts.append(f'"items":[{",".join(self._next_items(cursor))}]')
            if cursor.sample < self._last:
                parts.append(f'"samples":{_json(self._new_samples(cursor.sample))}')
                cursor.sample = self._last
            if cursor.status != self._status_number:
                parts.append(f'"status":{_json(self._status)}')
                cursor.status = self._status_number
        return f"{{{','.join(parts)}}}" if parts else None

    def _next_items(self, cursor: Cursor) -> list[str]:
        chosen, size = [], 0
        while cursor.items < len(self._items) and size < TEXT_AT_ONCE:
            chosen.append(self._items[cursor.items])
            size += len(chosen[-1])
            cursor.items += 1
        return chosen

    def _new_samples(self, after: int) -> Array:
        first = int(np.searchsorted(self._numbers[: self._count], after, side="right"))
        stride = -(-(self._count - first) // self._at_once)
        # the newest one is always among them
        return self._rows[first : self._count][::-1][:: max(1, stride)][::-1]

    def _thin_out(self) -> None:
        half = self._kept // 2
        chosen = np.concatenate([np.arange(0, half, 2), np.arange(half, self._kept)])
        self._count = len(chosen)
        self._rows[: self._count] = self._rows[chosen]
        self._numbers[: self._count] = self._numbers[chosen]


def _json(value: Any) -> str:
    return json.dumps(_finite(value), default=_packed, separators=(",", ":"), allow_nan=False)


def _finite(value: Any) -> Any:
    """``value`` with None for what is no number, which JSON does not know."""
    if isinstance(value, Mapping):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    if isinstance(value, float) and not np.isfinite(value):
        return None
    return value


def _packed(value: Any) -> Any:
    """An array as its shape and the base64 of its memory: float32, or bytes."""
    if isinstance(value, np.ndarray):
        kind = "u1" if value.dtype in (np.uint8, np.bool_) else "<f4"
        data = np.ascontiguousarray(value, dtype=kind).tobytes()
        return {"kind": kind.strip("<"), "shape": value.shape, "data": base64.b64encode(data).decode("ascii")}
    if isinstance(value, np.generic):
        return _finite(value.item())
    raise TypeError(f"{type(value).__name__} has no place in a message")
