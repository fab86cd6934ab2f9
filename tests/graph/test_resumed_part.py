"""A part goes on after a crash: processes killed by SIGKILL in mid contour, then the rest formed by a new cell."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from isf_analysis.bag.bag_reader import read_bag
from isf_analysis.bag.open_bag import next_bag
from isf_cell import in_process
from isf_cell.options import RunOptions
from isf_cell.processes.process_group import ProcessGroup
from isf_cell.run import graph_run
from isf_cell.run.checkpoint import CHECKPOINT, CheckpointFolder
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import load_job
from quick_cone import CONTOURS, quick_cone_file

pytestmark = [pytest.mark.graph, pytest.mark.usefixtures("forked_nodes")]

SHAPE = 1e-6
"""m, by which graph and in-process cell may differ, whatever happened on the way."""

PATIENCE = 300.0
"""s, only to end a test that hangs."""


def kept(run: Path, index: int) -> bool:
    """True when the checkpoint before contour ``index`` is on the disk."""
    try:
        return CheckpointFolder(run / CHECKPOINT).read().next_index == index
    except IsfError:
        return False


def when(condition: Callable[[], bool], act: Callable[[], None]) -> threading.Thread:
    """A thread that acts as soon as the condition holds."""

    def watch() -> None:
        end = time.monotonic() + PATIENCE
        while not condition():
            assert time.monotonic() < end
            time.sleep(0.02)  # looks again, at most PATIENCE s: nobody is told that a checkpoint is on the disk
        act()

    thread = threading.Thread(target=watch, daemon=True)
    thread.start()
    return thread


def test_a_part_goes_on_after_kills_as_if_there_had_been_none(tmp_path: Path) -> None:
    """The command with all its nodes in contour 2, then one node in contour 3."""
    job, run = quick_cone_file(tmp_path), tmp_path / "run"
    kill_all_of_the_command(job, run)
    assert kept(run, 1)
    steps: list[int] = []
    assert kill_one_node(job, run, steps).code == ErrorCode.NODE_DIED
    assert kept(run, 2)

    job_file = load_job(job)
    result, failure = graph_run.form(job_file, RunOptions(), run, notes_in(steps), resume=True)
    assert failure is None
    assert steps == [1, 2]
    assert result.contours == CONTOURS
    assert result.lost_messages == 0
    record, whole = read_bag(run / "bag"), in_process.form(job_file, RunOptions())
    assert record.failure() is None
    assert [item.index for item in record.results] == list(range(CONTOURS))
    assert [item.index for item in record.corrected] == list(range(CONTOURS))
    assert result.sim_time == pytest.approx(whole.results[-1].end - whole.results[0].start, abs=0.02)
    assert record.scan is not None
    assert whole.scan is not None
    np.testing.assert_allclose(record.scan.z, whole.scan.z, atol=SHAPE)
    assert whole.scan.z.min() < -2e-3  # a part
    for mine, theirs in zip(whole.corrections, record.corrections, strict=True):
        np.testing.assert_allclose(theirs.offset, mine.offset, atol=SHAPE)
    for before, after in zip(whole.results, record.results, strict=True):
        np.testing.assert_allclose(after.forming_force, before.forming_force, atol=0.1)
    with pytest.raises(IsfError) as caught:
        CheckpointFolder(run / CHECKPOINT).read()
    assert caught.value.code is ErrorCode.PART_FINISHED


def kill_all_of_the_command(job: Path, run: Path) -> None:
    """``isf form``, killed with its seven nodes as soon as contour 1 is kept: contour 2 is being formed then."""
    command = [sys.executable, "-m", "isf_cell.cli", "form", str(job), "--no-compare", "-o", str(run)]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True)
    nodes: list[int] = []

    def kill_all() -> None:
        found = subprocess.run(["pgrep", "-P", str(process.pid)], capture_output=True, text=True, check=True).stdout
        nodes.extend(map(int, found.split()))
        for number in (process.pid, *nodes):
            os.kill(number, signal.SIGKILL)

    try:
        when(lambda: kept(run, 1), kill_all).join(PATIENCE)
        assert process.wait(PATIENCE) == -signal.SIGKILL
    finally:
        if process.poll() is None:  # it takes its nodes with it
            process.send_signal(signal.SIGINT)
            process.wait(PATIENCE)
    assert len(nodes) == 7


def kill_one_node(job: Path, run: Path, steps: list[int]) -> Any:
    """Result of the part that goes on, its force control killed as soon as contour 2 is kept."""
    client = graph_run.CellClient()
    try:
        with ProcessGroup(run / "logs_resumed_1") as group:
            graph_run.start_cell(group, next_bag(run / "bag"), lockstep=True, checkpoint=run / CHECKPOINT)
            client.wait_ready(group)
            victim = group["force_ctrl"].popen.pid
            when(lambda: kept(run, 2), lambda: os.killpg(victim, signal.SIGKILL))
            return client.form(load_job(job), RunOptions(), notes_in(steps), group, resume=True)
    finally:
        client.close()


def notes_in(steps: list[int]) -> Callable[[Any], None]:
    """Feedback that notes the contours that were formed."""
    return lambda message: steps.append(message.index) if message.phase == "forming" else None
