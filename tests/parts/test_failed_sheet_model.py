"""A part whose elasto-plastic sheet model fails: it ends with a code, and what was formed is kept."""

from __future__ import annotations

import logging

import numpy as np
import pytest
from isf_cell import in_process
from isf_cell.options import RunOptions
from isf_core.errors import ErrorCode
from isf_core.types import Array
from isf_sim.explicit_shell.formed_sheet import FormedSheet
from quick_cone import CONTOURS, quick_cone

FAILING_MOVE = 1500


def test_a_model_that_fails_in_the_part_ends_it_with_a_code(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    move, moves = FormedSheet.move, 0

    def failing(sheet: FormedSheet, tips: Array) -> Array:
        nonlocal moves
        moves += 1
        if moves == FAILING_MOVE:
            sheet.shell.state.position[2, 40] = np.nan
        return move(sheet, tips)

    monkeypatch.setattr(FormedSheet, "move", failing)
    with caplog.at_level(logging.WARNING):
        record = in_process.form(quick_cone("method: none"), RunOptions(sheet="shell_coarse"))
    assert 0 < len(record.results) < CONTOURS
    last = record.results[-1]
    assert not last.completed
    assert "1421" in last.message or last.code == ErrorCode.SHEET_MODEL_FAILED, last
    assert "became unstable" in last.message
    assert record.scan is None
    assert "no scan of the finished part" in caplog.text
