"""Eighteen voltages close the force loop: a rig whose tools hang on three tri-axial cells each, through real nodes.

The machine publishes voltages, a node load_cell of each tool makes the wrench, force control holds the normal force.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from isf_analysis.bag.bag_reader import read_bag
from isf_cell import in_process
from isf_cell.options import RunOptions
from isf_cell.processes.process_group import ProcessGroup
from isf_cell.run import graph_run
from isf_core.errors import ErrorCode
from isf_core.events import EventKind
from isf_core.files.job import JobFile
from isf_core.files.yaml_file import find_named
from quick_cone import quick_cone

pytestmark = [pytest.mark.graph, pytest.mark.usefixtures("forked_nodes")]

OPEN = {"channel": "z2", "kind": "open", "after": "12 s"}
STUCK = {"channel": "z1", "kind": "stuck", "after": "12.5 s"}


def job_of(folder: Path, *faults: dict[str, str]) -> JobFile:
    """The quick cone on the machine with two tools, each on the published cells; ``faults`` of the lower ones."""
    cells = yaml.safe_load(find_named("rigs", "torrao2013").read_text())["tool_1"]["spindle_cells"]
    rig = {
        "based_on": "ren2018",
        "name": "spindle_cells",
        "tool_1": {"spindle_cells": cells},
        "tool_2": {"spindle_cells": {**cells, "rotation": ["180 deg", "0 deg", "0 deg"], "faults": list(faults)}},
    }
    (folder / "rig.yaml").write_text(yaml.safe_dump(rig))
    cone = quick_cone()
    return JobFile(cone.text.replace("rig: ren2018", f"rig: {folder / 'rig.yaml'}"), cone.base)


def quiet(_: Any) -> None:
    """Feedback that nobody looks at."""


@pytest.mark.slow
def test_the_part_goes_on_with_a_broken_wire_as_in_one_process(tmp_path: Path) -> None:
    job_file = job_of(tmp_path, OPEN)
    _, failure = graph_run.form(job_file, RunOptions(), tmp_path, quiet)
    assert failure is None
    there, here = read_bag(tmp_path / "bag"), in_process.form(job_file)
    for mine, theirs in zip(here.results, there.results, strict=True):
        np.testing.assert_allclose(theirs.tick_normal_force, mine.tick_normal_force, atol=0.1)
    held = there.results[1]  # the one under force control
    force = held.tick_normal_force[held.tick_engaged]
    assert force.mean() == pytest.approx(120.0, abs=3.0)
    for record in (here, there):
        (event,) = [item for item in record.events if item.kind == EventKind.LOAD_CELL]
        # 12 s of the machine's time, of which the tare took 2.5 s; that of a bag counts from the beginning of the part
        assert event.time - record.results[0].start == pytest.approx(9.5, abs=0.02)
        assert "tool 2: [1201 WRENCH_NOT_FINITE] load-cell channel z2 gives no reading" in event.text


@pytest.mark.parametrize(
    "lockstep", [True, pytest.param(False, marks=[pytest.mark.slow, pytest.mark.clock])], ids=["lockstep", "real time"]
)
def test_a_force_that_is_not_known_any_more_ends_the_part(tmp_path: Path, lockstep: bool) -> None:
    _, failure = graph_run.form(job_of(tmp_path, OPEN, STUCK), RunOptions(), tmp_path, quiet, lockstep=lockstep)
    assert failure is not None
    assert failure.code in (ErrorCode.WRENCH_FROZEN, ErrorCode.WRENCH_INCONSISTENT)  # whichever shows first
    assert "z2 gives no reading; load-cell channel z1 " in failure.what
    record = read_bag(tmp_path / "bag")
    kinds = [event.kind for event in record.events if event.kind in (EventKind.LOAD_CELL, EventKind.FORCE_UNKNOWN)]
    assert kinds == [EventKind.LOAD_CELL, EventKind.LOAD_CELL, EventKind.FORCE_UNKNOWN]
    assert ErrorCode.STOP_REQUESTED in [code for code, _ in record.faults]  # the machine has released contact


def test_a_cell_that_was_made_for_another_rig_tells_that_the_voltages_are_not_used(tmp_path: Path) -> None:
    """As with isf form --attach: the part is formed, by wrenches of another kind than in a cell of its own."""
    told: list[str] = []
    client = graph_run.CellClient()
    try:
        with ProcessGroup(tmp_path / "logs") as group:
            graph_run.start_cell(group, None, lockstep=True)
            client.wait_ready(group)
            result = client.form(job_of(tmp_path), RunOptions(), lambda message: told.append(message.phase), group)
    finally:
        client.close()
    assert (result.code, result.message) == (0, "")
    (line,) = [text for text in told if "spindle_cells" in text]
    assert line.startswith("no node load_cell_1 or load_cell_2: ")
    assert told.index(line) < told.index("forming")
