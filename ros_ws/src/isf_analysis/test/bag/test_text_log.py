"""The log of 12 columns."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped, WrenchStamped
from isf_analysis.bag.text_log import HEADER, LogFile
from isf_analysis.recorder_node import TextSamples
from isf_core.errors import ErrorCode, IsfError
from rclpy.serialization import serialize_message


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


def _wrench(seconds: int, force: float) -> bytes:
    message = WrenchStamped()
    message.header.stamp.sec = seconds
    message.wrench.force.z = force
    return bytes(serialize_message(message))


def _pose(depth: float) -> bytes:
    message = PoseStamped()
    message.pose.position.z = depth
    return bytes(serialize_message(message))


@pytest.mark.parametrize(("recorded", "forces"), [(0, [-2.0, -3.0]), (None, [-1.0, -2.0, -3.0])])
def test_rows_begin_when_the_tool_has_a_place(tmp_path: Path, recorded: int | None, forces: list[float]) -> None:
    """A recorder may hear the first wrench before the first pose; where no pose is recorded it waits for none."""
    samples = TextSamples(LogFile(tmp_path / "log.txt"), [recorded, 1, None])
    for number, data in [(1, _wrench(10, -1.0)), (0, _pose(-0.005)), (1, _wrench(11, -2.0)), (1, _wrench(12, -3.0))]:
        samples.take(number, data)
    samples.close()
    table = np.loadtxt(tmp_path / "log.txt")
    np.testing.assert_array_equal(table[:, 9], forces)
    np.testing.assert_array_equal(table[:, 0], np.arange(len(forces)))
    np.testing.assert_array_equal(table[:, 3], -5.0 if recorded == 0 else np.nan)
