"""The log of 12 columns."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from isf_analysis.bag.text_log import HEADER, LogFile
from isf_core.errors import ErrorCode, IsfError


def test_a_log_has_twelve_columns_and_a_time_that_ascends(tmp_path: Path) -> None:
    log = LogFile(tmp_path / "log.txt")
    for time in (0.0, 0.05, 0.05, 0.02, 0.1):
        row = np.arange(12.0)
        row[[0, 11]] = time, np.nan
        log.add(row)
    log.close()
    lines = (tmp_path / "log.txt").read_text().splitlines()
    assert lines[0] == HEADER
    assert len(HEADER.removeprefix("# ").split()) == 12
    table = np.loadtxt(tmp_path / "log.txt")
    assert table.shape == (3, 12)
    np.testing.assert_array_equal(table[:, 0], [0.0, 0.05, 0.1])
    np.testing.assert_array_equal(table[0, 1:11], np.arange(1.0, 11.0))
    assert np.isnan(table[:, 11]).all()


def test_a_log_overwrites_nothing(tmp_path: Path) -> None:
    path = tmp_path / "log.txt"
    path.write_text("mine")
    with pytest.raises(IsfError) as caught:
        LogFile(path)
    assert caught.value.code == ErrorCode.FILE_NOT_WRITABLE
    assert path.read_text() == "mine"
