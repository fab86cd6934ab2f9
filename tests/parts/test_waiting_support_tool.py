"""A cone formed with two tools over a near backing plate: the lower one waits and touches nothing, then presses."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from isf_analysis.measures.record import PartRecord
from isf_analysis.measures.summary import summary
from isf_cell.in_process import form
from isf_cell.options import RunOptions
from isf_core.files.job import load_job
from planner_parts import Cone, write

CONE = Cone(opening=25e-3, depth=13e-3, entry=3e-3, floor=6e-3, angle=np.radians(50.0))

JOB = """
name: cone
part: {{mesh: cone.stl, unit: mm}}
process: DSIF
rig: {rig}
sheet: {{material: AA5754-O, thickness: 1 mm}}
tool_1: {{radius: 5 mm}}
tool_2: {{radius: 5 mm}}
backing_plate: {{shape: circle, size: [54 mm, 54 mm]}}
path: {{incremental_depth: 1 mm, point_spacing: 1 mm, feed: 20 mm/s}}
control: {{rate: 200 Hz, support_force: 120 N}}
springback: {{method: analytic}}
"""


@pytest.fixture(scope="module")
def record(tmp_path_factory: pytest.TempPathFactory) -> PartRecord:
    folder = tmp_path_factory.mktemp("waiting")
    write(CONE.mesh(20e-6), folder / "cone.stl")
    rig = Path(__file__).resolve().parents[2] / "examples" / "rigs" / "clamp_120.yaml"
    (folder / "cone.yaml").write_text(JOB.format(rig=rig), encoding="utf-8")
    return form(load_job(folder / "cone.yaml"), RunOptions())


def test_it_touches_nothing_and_then_holds_its_force(record: PartRecord) -> None:
    assert record.failure() is None
    first = next(k for k, contour in enumerate(record.nominal) if not contour.support_waits)
    assert 3 <= first < len(record.nominal) - 2
    force = [np.linalg.norm(result.support_force[:, :2], axis=1) for result in record.results]
    assert max(float(np.nanmax(values)) for values in force[:first]) < 15.0  # N; the noise of the load cell
    later = [k for k in range(first + 1, len(force)) if record.nominal[k].force_controlled]
    assert later
    assert all(110.0 < float(np.nanmean(force[k])) < 130.0 for k in later)


def test_the_report_counts_no_contact_lost_while_it_waits(record: PartRecord) -> None:
    first = next(k for k, contour in enumerate(record.nominal) if not contour.support_waits)
    losses = summary(record)["contact_losses"]
    assert losses["path_mm"] < 1.05e3 * sum(contour.length for contour in record.nominal[first:])
    assert losses["longest"] is None or losses["longest"]["contour"] >= first
