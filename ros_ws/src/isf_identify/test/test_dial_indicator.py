"""Compliance from dial readings: the published procedure (Ren 2018, 2.2.1) on synthetic readings with known answers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from isf_core.errors import ErrorCode, IsfError
from isf_identify.dial_indicator import DialTable, dial_piece, far_from, fit_dial, without_arms

TRUE = {1: np.array([1.0e-6, 1.1e-6, 0.1e-6]), 2: np.array([0.9e-6, 1.0e-6, 0.08e-6])}
"""m/N, in plane ten times softer than in z (Ren 2018, 2.2.1)."""
FORCES = np.array([20.0, 60.0, 100.0, 140.0, 180.0])


def readings(seed: int = 0, *, apart: float = 0.0, dial: float = 1.0e-6, cell: float = 0.01) -> DialTable:
    """Three places, six repetitions, both tools and all axes; a dial of 1 um and a cell of 1 % (Ren 2018, 2.3.4);
    ``apart`` is the relative difference of the compliance from place to place."""
    random = np.random.default_rng(seed)
    rows = []
    for tool in (1, 2):
        for axis in range(3):
            for place in range(3):
                for repeat in range(6):
                    zero = random.uniform(-1e-4, 1e-4)
                    for force in FORCES:
                        give = TRUE[tool][axis] * (1.0 + apart * (place - 1))
                        read = force * (1.0 + cell * random.standard_normal())
                        rows.append(
                            (tool, axis, place, repeat, read, zero + give * force + dial * random.standard_normal())
                        )
    table = np.array(rows)
    tool, axis, place, repeat = (table[:, k].astype(np.int64) for k in range(4))
    return DialTable(tool, axis, place, repeat, table[:, 4], table[:, 5])


def test_the_published_procedure_finds_both_tools() -> None:
    found, refused = fit_dial(readings())
    assert not refused
    assert set(found) == {(tool, axis) for tool in (1, 2) for axis in range(3)}
    for (tool, axis), item in found.items():
        true = TRUE[tool][axis]
        assert item.value == pytest.approx(true, rel=0.01 if axis < 2 else 0.06)
        assert abs(item.value - true) < 4.0 * item.deviation
        assert item.constant
        assert (item.repeats, item.places.tolist(), item.largest > 170.0) == (18, [0, 1, 2], True)


def test_the_deviation_is_that_of_many_repetitions() -> None:
    found = [fit_dial(_only(readings(seed), 1, 0))[0][1, 0] for seed in range(40)]
    spread = np.std([item.value for item in found], ddof=1)
    # the places' spread is in it as well, so it is the greater one of both
    assert spread < np.mean([item.deviation for item in found]) < 4.0 * spread


def test_a_workspace_that_is_not_constant_is_reported() -> None:
    item = fit_dial(_only(readings(apart=0.1), 1, 0))[0][1, 0]
    assert not item.constant
    assert item.per_place == pytest.approx(1e-6 * np.array([0.9, 1.0, 1.1]), rel=0.02)
    assert item.deviation == pytest.approx(0.1e-6, rel=0.15)
    assert "not constant" in dial_piece("ren2018", "2026-01-01", {(1, 0): item}, TRUE)


def test_a_slip_is_left_out() -> None:
    table = _only(readings(), 2, 1)
    slipped = table.deflection.copy()
    slipped[7] *= -1.0  # the dial read backwards once
    slipped[7] += 3e-4
    item = fit_dial(replace(table, deflection=slipped))[0][2, 1]
    assert item.rejected >= 1
    assert item.value == pytest.approx(1.0e-6, rel=0.02)


@pytest.mark.parametrize(
    ("change", "reported"),
    [
        (lambda force, dial: (-force, dial), "is -"),
        (lambda force, dial: (force, 1e-8 * force**2), "not linear"),
        (lambda force, dial: (np.where(force > 80.0, 100.0, 20.0), dial), "fewer than 3"),
    ],
)
def test_what_is_no_compliance_is_refused(change, reported) -> None:
    table = _only(readings(), 1, 0)
    force, dial = change(table.force, table.deflection)
    with pytest.raises(IsfError, match=reported) as caught:
        fit_dial(replace(table, force=force, deflection=dial))
    assert caught.value.code is ErrorCode.MEASUREMENT_FAILED


def test_axes_without_readings_keep_their_value() -> None:
    found, _ = fit_dial(_only(readings(), 2, 1))
    piece = dial_piece("ren2018", "2026-01-01", found, {1: TRUE[1], 2: np.array([3e-6, 3e-6, 3e-6])})
    assert piece.startswith('based_on: "ren2018"\ntool_2:\n  compliance: [3.0000 um/N, ')
    assert "tool_1" not in piece
    assert piece.count("not identified") == 2
    assert "+-" in piece


@pytest.mark.parametrize("seed", range(40))
def test_a_dial_of_1_um_is_good_enough(seed: int) -> None:
    found, refused = fit_dial(readings(seed))
    assert not refused
    assert all(item.constant for item in found.values())


def test_one_bent_axis_does_not_take_the_others_along() -> None:
    table = readings()
    bent = (table.tool == 1) & (table.axis == 2)
    deflection = np.where(bent, 2e-9 * table.force**2, table.deflection)
    found, refused = fit_dial(replace(table, deflection=deflection))
    assert list(refused) == [(1, 2)]
    assert len(found) == 5
    assert "not linear" in str(refused[1, 2])
    piece = dial_piece("ren2018", "2026-01-01", found, TRUE, refused)
    assert piece.count("readings refused, kept") == 1


def test_scatter_that_hides_the_slope_is_refused() -> None:
    with pytest.raises(IsfError, match="scatter"):
        fit_dial(_only(readings(dial=60e-6), 1, 2))


@pytest.mark.parametrize(
    ("scale", "column", "reported"),
    [(1000.0, "deflection_mm", "deflections are um"), (1e-3, "deflection_um", "deflections are mm")],
)
def test_another_unit_is_refused(scale: float, column: str, reported: str) -> None:
    table = readings()
    found, _ = fit_dial(replace(table, deflection=scale * table.deflection))
    refused = far_from(found, TRUE, column)
    assert set(refused) == set(found)
    assert reported in str(refused[1, 0])
    assert not far_from(fit_dial(table)[0], TRUE, column)


def _only(table: DialTable, tool: int, axis: int) -> DialTable:
    rows = (table.tool == tool) & (table.axis == axis)
    return DialTable(*(values[rows] for values in vars(table).values()))


def test_what_the_arm_takes_is_no_part_of_the_tool() -> None:
    """Springs in row: 4.20 um/N at the tip, 4.15 um/N of them the arm's joints."""
    item = fit_dial(_only(readings(), 1, 0))[0][1, 0]
    tip = replace(item, value=4.2e-6, deviation=0.01e-6, per_place=np.array([4.19e-6, 4.21e-6]))
    arms = {1: np.array([4.15e-6, 4.15e-6, 0.0]), 2: np.zeros(3)}
    alone, refused = without_arms({(1, 0): tip, (1, 2): item, (2, 0): item}, arms)
    assert not refused
    assert alone[1, 0].value == pytest.approx(0.05e-6)
    assert alone[1, 0].per_place == pytest.approx([0.04e-6, 0.06e-6])
    assert (alone[1, 2].value, alone[2, 0].value) == (item.value, item.value)
    piece = dial_piece("robot", "2026-01-01", alone, {1: np.zeros(3), 2: np.zeros(3)})
    assert "compliance: [0.0500 um/N" in piece
    assert "4.1500 um/N of the arm taken off" in piece
    hidden = replace(tip, deviation=0.06e-6)
    alone, refused = without_arms({(1, 0): hidden, (2, 0): item}, arms)
    assert set(alone) == {(2, 0)}
    assert refused[1, 0].code is ErrorCode.MEASUREMENT_FAILED
    assert "of which its arm takes 4.15" in refused[1, 0].what
    assert "tool_1.arm" in refused[1, 0].advice
