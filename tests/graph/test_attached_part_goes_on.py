"""A part in a standing cell goes on: after a kill of the command in the same cell, after one of a node in another."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import forked_process
import numpy as np
import pytest
import rclpy
import yaml
from geometry_msgs.msg import PoseStamped
from isf_analysis.bag.bag_reader import read_bag
from isf_cell import in_process
from isf_cell.commands.exit_codes import Exit
from isf_cell.run.checkpoint import CHECKPOINT, CheckpointFolder
from isf_core.errors import IsfError
from isf_core.files.job import load_job
from isf_core.files.yaml_file import find_named
from isf_msgs.msg import ExecutiveState
from isf_ros import qos
from quick_cone import CONTOURS_OF_LONGER, LONGER, quick_cone_file
from standing_cell import standing
from waiting import LIMIT, Waiting

pytestmark = pytest.mark.graph

SHAPE = 1e-6
"""m, by which graph and in-process cell may differ, whatever happened on the way."""

RUN = Path("runs") / "part"


def command(*arguments: str) -> list[str]:
    return [sys.executable, "-m", "isf_cell.cli", "form", *arguments]


def asked(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    return forked_process.run(command(*arguments), cwd=folder)


def kept(run: Path) -> int:
    """Contour before which the part is kept; 0: not yet."""
    try:
        return CheckpointFolder(run / CHECKPOINT).read().next_index
    except IsfError:
        return 0


class Looker:
    """Sees whether a part is formed, and where the forming tool is."""

    def __init__(self) -> None:
        rclpy.init()
        self.node = rclpy.create_node("looker")
        self._waiting = Waiting(self.node)
        self.until = self._waiting.until
        self.height, self.busy = float("nan"), False
        self.node.create_subscription(PoseStamped, "tool_1/pose", self._on_pose, qos.SENSOR)
        self.node.create_subscription(ExecutiveState, "executive/state", self._on_state, qos.CHANGES)

    def _on_pose(self, message: PoseStamped) -> None:
        self.height = message.pose.position.z

    def _on_state(self, message: ExecutiveState) -> None:
        self.busy = message.busy

    def close(self) -> None:
        self._waiting.close()
        self.node.destroy_node()
        rclpy.try_shutdown()


@contextmanager
def looking() -> Iterator[Looker]:
    looker = Looker()
    try:
        yield looker
    finally:
        looker.close()


def begun(folder: Path, *arguments: str) -> forked_process.ForkedProcess:
    return forked_process.start(
        command(*arguments), stdout=subprocess.PIPE, stderr=subprocess.PIPE, cwd=folder, env=dict(os.environ), text=True
    )


def result_of(process: Any) -> Any:
    words, errors = process.communicate(timeout=3 * LIMIT)
    assert process.returncode == Exit.OK, errors
    return json.loads(words)


def test_a_part_goes_on_in_the_cell_that_is_up_and_in_one_started_anew(tmp_path: Path) -> None:
    job, run = quick_cone_file(tmp_path, step=LONGER), tmp_path / RUN
    marked = yaml.safe_load(job.read_text(encoding="utf-8"))
    marked["path"]["hold_after"] = [1]
    job.write_text(yaml.safe_dump(marked), encoding="utf-8")
    going_on = ("--resume", str(RUN), "--attach", "--no-compare", "--json")

    with standing(tmp_path, str(job)) as (cell, told), looking() as looker:
        first = begun(tmp_path, str(job), "--attach", "--no-compare", "-o", str(RUN), "--json")
        assert looker.until(lambda: kept(run) == 1, 2 * LIMIT)
        second = asked(tmp_path, *going_on)
        assert (second.returncode, "1505 BUSY" in second.stderr) == (Exit.CELL, True), second.stderr
        assert forked_process.run([sys.executable, "-m", "isf_cell.cli", "go-on"], cwd=tmp_path).returncode == Exit.OK
        assert looker.until(lambda: kept(run) >= 2, 2 * LIMIT)
        first.send_signal(signal.SIGKILL)  # contour 3 is being formed
        assert looker.until(lambda: first.poll() is not None)
        assert looker.until(lambda: not looker.busy), "nobody is left who would record the part"
        assert looker.until(lambda: looker.height > 0.0)
        stopped_at = kept(run)
        assert 2 <= stopped_at < CONTOURS_OF_LONGER
        assert cell.poll() is None

        third = begun(tmp_path, *going_on)
        assert looker.until(lambda: kept(run) > stopped_at, 2 * LIMIT)
        os.kill(told["nodes"]["force_ctrl"], signal.SIGKILL)
        _, errors = third.communicate(timeout=2 * LIMIT)
        assert third.returncode == Exit.CELL, errors
        assert f"the part can go on, in a cell that is up: ./isf form --resume {run} --attach" in " ".join(
            errors.split()
        )
        assert cell.wait(LIMIT) == Exit.CELL

    with standing(tmp_path, "--rig", "ren2018", output="second"):
        formed = result_of(begun(tmp_path, *going_on))
        assert formed["complete"]
        assert formed["contours"] == CONTOURS_OF_LONGER
        finished = asked(tmp_path, *going_on)
        assert finished.returncode == Exit.INPUT
        assert "1008 PART_FINISHED" in finished.stderr

    record, whole = read_bag(run / "bag"), in_process.form(load_job(job))
    assert [item.index for item in record.results] == list(range(CONTOURS_OF_LONGER))
    assert record.scan is not None
    assert whole.scan is not None
    assert whole.scan.z.min() < -2e-3  # a part
    np.testing.assert_allclose(record.scan.z, whole.scan.z, atol=SHAPE)
    for mine, theirs in zip(whole.corrections, record.corrections, strict=True):
        np.testing.assert_allclose(theirs.offset, mine.offset, atol=SHAPE)


@pytest.mark.clock
def test_a_part_of_a_real_machine_goes_on_with_the_sheet_in_its_clamp(tmp_path: Path) -> None:
    """By the clock, above the example of a driver, whose state nobody can load."""
    job, run = quick_cone_file(tmp_path, step="2.5 mm"), tmp_path / RUN
    rig = find_named("rigs", "ren2018").read_text(encoding="utf-8")
    (tmp_path / "near.yaml").write_text(rig.replace("park_height: 100 mm", "park_height: 25 mm"), encoding="utf-8")
    marked = yaml.safe_load(job.read_text(encoding="utf-8"))
    marked["path"]["hold_after"] = [1]
    marked["rig"], marked["springback"] = "near.yaml", {"method": "none"}
    job.write_text(yaml.safe_dump(marked), encoding="utf-8")
    driver = forked_process.node("-m", "isf_driver_example.driver_node", level=4, rate=100.0)

    with driver, standing(tmp_path, str(job), "--driver"), looking() as looker:
        first = begun(tmp_path, str(job), "--attach", "-o", str(RUN), "--json")
        assert looker.until(lambda: kept(run) == 1, 2 * LIMIT)  # and waits
        first.send_signal(signal.SIGKILL)
        assert looker.until(lambda: first.poll() is not None and not looker.busy)
        assert looker.until(lambda: looker.height > 0.0)
        second = begun(tmp_path, "--resume", str(RUN), "--attach", "--json")
        words, errors = second.communicate(timeout=3 * LIMIT)
        assert second.returncode == Exit.OK, errors
        assert "the machine keeps no state" in errors
        assert json.loads(words)["contours"] == 2
    assert [item.index for item in read_bag(run / "bag").results] == [0, 1]
