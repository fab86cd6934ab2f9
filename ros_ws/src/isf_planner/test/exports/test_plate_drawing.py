"""Drawings of backing plates, read as the pairs of code and value that DXF is made of."""

from __future__ import annotations

import numpy as np
import pytest
from isf_core.files.tooling import BackingPlateSpec
from isf_planner.exports.plate_drawing import plate_drawing


def pairs(text: str) -> list[tuple[int, str]]:
    lines = text.split("\n")
    return [(int(code), value.strip()) for code, value in zip(lines[::2], lines[1::2], strict=False)]


def entities(text: str) -> list[tuple[str, list[tuple[int, str]]]]:
    """Kind, and codes and values, of everything that is drawn."""
    found = pairs(text)
    first = found.index((2, "ENTITIES")) + 1
    last = next(k for k in range(first, len(found)) if found[k] == (0, "ENDSEC"))
    drawn: list[tuple[str, list[tuple[int, str]]]] = []
    for code, value in found[first:last]:
        if code == 0:
            drawn.append((value, []))
        else:
            drawn[-1][1].append((code, value))
    return drawn


def numbers(values: list[tuple[int, str]], code: int) -> list[float]:
    return [float(value) for found, value in values if found == code]


def test_lengths_are_mm() -> None:
    text = plate_drawing(BackingPlateSpec(shape="circle", size=(0.094, 0.094)))
    found = pairs(text)
    assert found[found.index((9, "$INSUNITS")) + 1] == (70, "4")
    assert found[-1] == (0, "EOF")
    assert text.isascii()


def test_a_round_opening_is_a_circle() -> None:
    ((kind, values),) = entities(plate_drawing(BackingPlateSpec(shape="circle", size=(0.094, 0.094))))
    assert kind == "CIRCLE"
    assert (8, "OPENING") in values
    assert numbers(values, 40) == pytest.approx([47.0])
    assert numbers(values, 10) + numbers(values, 20) == pytest.approx([0.0, 0.0], abs=1e-9)


def test_every_opening_is_a_closed_polyline() -> None:
    first = ((0.0, 0.0), (0.02, 0.0), (0.02, 0.02))
    second = ((-0.03, 0.0), (-0.01, 0.0), (-0.02, 0.02))
    drawn = entities(plate_drawing(BackingPlateSpec(shape="outline", openings=(first, second))))
    for (kind, values), loop in zip(drawn, (first, second), strict=True):
        assert kind == "LWPOLYLINE"
        assert (70, "1") in values  # closed
        corners = np.column_stack([numbers(values, 10), numbers(values, 20)])
        assert {tuple(corner) for corner in corners} == {(1e3 * x, 1e3 * y) for x, y in loop}


def test_a_rectangle_has_its_rounded_corners() -> None:
    plate = BackingPlateSpec(shape="rectangle", size=(0.1, 0.06), corner_radius=0.01)
    ((_, values),) = entities(plate_drawing(plate))
    x, y = np.abs(numbers(values, 10)), np.abs(numbers(values, 20))
    assert (x.max(), y.max()) == pytest.approx((50.0, 30.0), abs=1e-3)
    assert np.hypot(x - 40.0, y - 20.0) == pytest.approx(np.full(len(x), 10.0), abs=1e-6)
