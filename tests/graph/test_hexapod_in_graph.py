"""A part formed by legs through real nodes: as in one process, with the legs on machine/legs, and a pump that stops."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from isf_analysis.bag.bag_reader import part_of
from isf_analysis.bag.open_bag import bag_of, open_bag
from isf_cell import in_process
from isf_cell.options import RunOptions
from isf_cell.run import graph_run
from isf_core.errors import ErrorCode
from isf_core.files.job import JobFile
from quick_cone import quick_cone

pytestmark = [pytest.mark.graph, pytest.mark.usefixtures("forked_nodes")]


def job_of(folder: Path, *faults: dict[str, str]) -> JobFile:
    """The quick cone, formed by one tool on the hexapod."""
    (folder / "rig.yaml").write_text(
        yaml.safe_dump({"based_on": "torrao2013", "name": "hexapod", "legs": {"faults": list(faults)}})
    )
    cone = quick_cone("method: none")
    job = yaml.safe_load(cone.text)
    del job["tool_2"]
    job |= {"process": "SPIF", "rig": str(folder / "rig.yaml")}
    job["control"] = {"rate": "250 Hz"}
    return JobFile(yaml.safe_dump(job), cone.base)


def quiet(_: Any) -> None:
    """Feedback that nobody looks at."""


def test_legs_form_a_part_through_the_graph_until_the_pump_stops(tmp_path: Path) -> None:
    fault = {"kind": "pump_stop", "after": "13 s"}
    _, failure = graph_run.form(job_of(tmp_path, fault), RunOptions(), tmp_path, quiet)
    assert failure is not None
    assert failure.code is ErrorCode.SUPPLY_PRESSURE
    with open_bag(bag_of(tmp_path / "bag")) as bag:
        there = part_of(bag)  # with the times of the machine
    here = in_process.form(job_of(tmp_path, fault))
    assert there.results[0].start == here.results[0].start  # one tare, however late its readings are taken
    assert len(there.results) == len(here.results) >= 2
    assert there.results[0].completed
    assert here.results[-1].code == there.faults[0][0] == ErrorCode.SUPPLY_PRESSURE
    for mine, theirs in zip(here.results[:-1], there.results[:-1], strict=True):
        np.testing.assert_allclose(theirs.forming_force, mine.forming_force, atol=0.1)
    assert there.axis_error is not None
    assert there.axis_error[1] < 1e-3  # legs lag while the pressure falls
    with open_bag(bag_of(tmp_path / "bag")) as bag:
        legs = [connection for connection in bag.connections if connection.topic.endswith("machine/legs")]
        joints = [message for _, message in bag.messages(legs)]
    assert joints[0].name == ["L1", "L2", "L3", "L4", "L5", "L6"]
    assert all(0.0 < min(joint.position) <= max(joint.position) < 0.4 for joint in joints)
