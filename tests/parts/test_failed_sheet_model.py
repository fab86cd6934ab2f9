"""A part whose elasto-plastic sheet model fails: it ends with a code and a place, and what was formed is kept."""

from __future__ import annotations

import numpy as np
import pytest
from isf_analysis.measures.summary import summary
from isf_analysis.report.result_tables import banners
from isf_cell import in_process
from isf_cell.options import RunOptions
from isf_core.errors import ErrorCode
from isf_core.types import Array
from isf_sim.explicit_shell.formed_sheet import FormedSheet
from quick_cone import CONTOURS, quick_cone

FAILING_MOVE = 1500


def test_a_model_that_fails_in_the_part_ends_it_with_a_code_and_the_sheet_is_measured(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    move, moves = FormedSheet.move, 0

    def failing(sheet: FormedSheet, tips: Array) -> Array:
        nonlocal moves
        moves += 1
        if moves == FAILING_MOVE:
            sheet.shell.state.position[2, 40] = np.nan
        return move(sheet, tips)

    monkeypatch.setattr(FormedSheet, "move", failing)
    record = in_process.form(quick_cone("method: none"), RunOptions(sheet="shell_coarse"))
    assert 0 < len(record.results) < CONTOURS
    last = record.results[-1]
    assert (last.completed, last.code) == (False, ErrorCode.SHEET_MODEL_FAILED)
    assert "became unstable at [" in last.message
    assert "ticks before" in last.message
    assert record.scan is not None
    assert np.isfinite(record.scan.z).all()
    assert -4e-3 < record.scan.z.min() < -1e-3  # contours are 1.7 mm apart
    assert record.formed_sheet is not None
    assert np.isfinite(record.formed_sheet.thickness).all()
    numbers = summary(record)
    assert f"contour {last.index + 1}" in numbers["failure"]["message"]
    assert numbers["deviation"] is not None
    assert "1421 SHEET_MODEL_FAILED" in banners(numbers, has_reference=True)
