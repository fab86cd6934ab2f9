"""Tool lifts between contours through the node graph against the same cores in one process."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from isf_analysis.bag.bag_reader import read_bag
from isf_cell import in_process
from isf_cell.options import RunOptions
from isf_cell.run import graph_run
from isf_ros.conversion import lift_from_cloud, lift_to_cloud
from isf_ros.stamps import from_seconds, to_nanoseconds
from quick_cone import CONTOURS, quick_cone


def quiet(_: Any) -> None:
    """Feedback that nobody looks at."""


def test_a_lift_survives_its_message() -> None:
    rows = np.random.default_rng(2).normal(size=(17, 4))
    message = lift_to_cloud(rows, from_seconds(12.5))
    np.testing.assert_array_equal(lift_from_cloud(message), rows)
    assert to_nanoseconds(message.header.stamp) == 12_500_000_000
    assert lift_from_cloud(lift_to_cloud(np.empty((0, 4)), from_seconds(0.0))).shape == (0, 4)
    message.data = message.data[:-8]
    with pytest.raises(ValueError, match="bytes"):
        lift_from_cloud(message)
    message.fields = message.fields[:3]
    with pytest.raises(ValueError, match="force"):
        lift_from_cloud(message)


@pytest.mark.graph
@pytest.mark.usefixtures("forked_nodes")
def test_graph_and_in_process_agree_with_lifts(tmp_path: Path) -> None:
    """1 um, contour by contour; the tool is lifted after every second contour."""
    job_file = quick_cone("method: fused\n  lift_every: 2")
    _, failure = graph_run.form(job_file, RunOptions(seed=5), tmp_path, quiet)
    assert failure is None
    there, here = read_bag(tmp_path / "bag"), in_process.form(job_file, RunOptions(seed=5))
    assert [c.code for c in there.corrections] == [0] * CONTOURS
    for mine, theirs in zip(here.corrections, there.corrections, strict=True):
        np.testing.assert_allclose(theirs.offset, mine.offset, atol=1e-6)
        assert theirs.remarks == mine.remarks
    assert not any("tool lift" in remark for remark in here.corrections[1].remarks)
    assert any("tool lifting" in remark for remark in here.corrections[-1].remarks)
