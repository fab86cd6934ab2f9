"""Scans and tool lifts between contours through the node graph against the same cores in one process, and learning from
the bag."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from isf_analysis.bag.bag_reader import read_bag
from isf_cell import in_process
from isf_cell.commands.learn import learn_record
from isf_cell.options import RunOptions
from isf_cell.replay.live_node import play_into
from isf_cell.replay.outcome import replay
from isf_cell.replay.recorded_run import read_run
from isf_cell.replay.what_if import parse
from isf_cell.run import graph_run
from isf_ros.conversion import lift_from_cloud, lift_to_cloud
from isf_ros.stamps import from_seconds, to_nanoseconds
from isf_springback.estimators import learning
from isf_springback.estimators.learning import Learned
from quick_cone import FOLDER, quick_cone


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
def test_graph_and_in_process_agree_with_scans_and_lifts(tmp_path: Path) -> None:
    """1 um, contour by contour; scans after every third contour as a scanner would be used on a long part, lifts after
    the first and every fourth."""
    fields = "method: fused\n  fused: {model: analytic}\n  scan_every: 3\n  lift_every: 4\n  scan_sensor: true"
    job_file = quick_cone(fields, step="0.5 mm")  # what was seen tells after six contours
    _, failure = graph_run.form(job_file, RunOptions(seed=5), tmp_path, quiet)
    assert failure is None
    there, here = read_bag(tmp_path / "bag"), in_process.form(job_file, RunOptions(seed=5))
    assert [c.code for c in there.corrections] == [0] * there.planned
    for mine, theirs in zip(here.corrections, there.corrections, strict=True):
        np.testing.assert_allclose(theirs.offset, mine.offset, atol=1e-6)
        assert theirs.remarks == mine.remarks
    for mine, theirs in zip(here.results, there.results, strict=True):  # 1 um and 0.1 N here too
        np.testing.assert_allclose(theirs.forming_target, mine.forming_target, atol=1e-6)
        np.testing.assert_allclose(theirs.support_target, mine.support_target, atol=1e-6)
        np.testing.assert_allclose(theirs.forming_force, mine.forming_force, atol=0.1)
        np.testing.assert_allclose(theirs.support_force, mine.support_force, atol=0.1)
    assert [len(rows) > 10 for _, rows in read_run(tmp_path).lifts] == [True, True, True]
    assert here.corrections[-1].uncertainty.mean() < here.corrections[1].uncertainty.mean()
    assert [scan.index for scan in there.scans] == [2, 5, 8]
    for mine, theirs in zip(here.scans, there.scans, strict=True):
        np.testing.assert_allclose(theirs.points(), mine.points(), atol=1.1e-5)
    again = replay(read_run(tmp_path), parse([]))  # every scan and lift, and the moves they need, as recorded
    lost = again.lost_targets  # by the recorder, on a busy computer
    assert again.identical is (None if lost else True), again.numbers()
    assert not again.target_distance.any()
    run = read_run(tmp_path)
    assert run.ticks is not None
    for node in ("force_ctrl", "springback"):  # live ones, over the middleware
        played = play_into(run, node, run.job_file(), tmp_path / "logs", {})
        assert played.identical, played
        assert played.started
        assert not played.notes
        decided = played.results or played.corrections
        assert decided is not None
        assert decided.compared == there.planned
        assert played.targets == (np.isfinite(run.ticks.target).all(axis=1).sum() if node == "force_ctrl" else 0)
    known = learn_record(there, FOLDER)
    assert known.parts == 1
    assert np.abs(known.push).max() > 1e-3
    assert known.seen is not None
    _second_part_agrees(known, tmp_path / "second")


def _second_part_agrees(known: Learned, folder: Path) -> None:
    """Of another sheet: corrected by what its scans show to differ from the part that was learned from."""
    folder.mkdir()
    learning.save(known, folder / "known.npz")
    fields = f"method: learned\n  learning: {folder / 'known.npz'}\n  scan_every: 3\n  scan_sensor: true"
    job_file, other_sheet = quick_cone(fields, step="0.5 mm"), RunOptions(seed=5, variant=3)
    _, failure = graph_run.form(job_file, other_sheet, folder, quiet)
    assert failure is None
    there, here = read_bag(folder / "bag"), in_process.form(job_file, other_sheet)
    assert [c.code for c in there.corrections] == [0] * there.planned
    for mine, theirs in zip(here.corrections, there.corrections, strict=True):
        np.testing.assert_allclose(theirs.offset, mine.offset, atol=1e-6)
    # scans had a say: by more than five times what graph and process may differ by
    replayed = known.push[known.contour == there.planned - 1]
    assert abs(-there.corrections[-1].offset[:, 2].mean() - replayed.mean()) > 5e-6
