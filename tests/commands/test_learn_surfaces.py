"""``isf learn --surfaces``: from bags of several parts to a file that plans another part; and what it refuses."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from isf_analysis.bag.bag_writer import write_bag
from isf_analysis.measures.record import PartRecord
from isf_cell import in_process
from isf_cell.commands.learn import learn_surfaces
from isf_cell.options import RunOptions
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile
from isf_core.geometry.height_map import HeightMap
from isf_planner import plan
from isf_planner.surface.target_surface import target_map
from planner_parts import Cone
from quick_cone import CONTOURS, quick_cone

TOO_SHALLOW = 0.25e-3
"""m along the normal, of every part of these tests."""


@pytest.fixture(scope="module")
def part() -> PartRecord:
    record = in_process.form(quick_cone("method: none"))
    assert record.formed == CONTOURS
    return record


def shaped(part: PartRecord, cone: Cone) -> PartRecord:
    """``part`` with the shape of ``cone``, too shallow by the same everywhere."""
    target = target_map(cone.mesh(2e-5), (0.182, 0.182))
    off = TOO_SHALLOW * np.sqrt(1.0 + np.hypot(*target.gradient()) ** 2)
    scan = HeightMap(target.x, target.y, target.z + np.where(target.z < -0.05e-3, off, 0.0))
    return replace(part, target=target, scan=scan)


def bag_of(record: PartRecord, folder: Path) -> Path:
    write_bag(record, folder / "bag")
    return folder


def test_parts_of_several_shapes_plan_another_one(
    part: PartRecord, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cones = [(20e-3, 40, 4.5e-3), (22e-3, 48, 6e-3), (16e-3, 45, 4e-3), (18e-3, 42, 5.5e-3), (15e-3, 44, 5e-3)]
    runs = [
        bag_of(shaped(part, Cone(opening, np.radians(angle), depth, floor=6e-3)), tmp_path / f"run_{k}")
        for k, (opening, angle, depth) in enumerate(cones)
    ]
    file = tmp_path / "m.npz"
    learn_surfaces(runs[:4], file, as_json=False)
    capsys.readouterr()
    learn_surfaces(runs[4:], file, as_json=True)  # added to what is there
    told = json.loads(capsys.readouterr().out)
    assert told["shapes"] == 5
    assert len(told["parts"]) == 5
    for row in told["parts"]:
        assert row["rms_mm"] == pytest.approx(0.25, abs=0.02)
        assert row["held_out_rms_mm"] < 0.05
    job = quick_cone("method: none")
    moved = plan(JobFile(job.text.replace("unit: mm", f"unit: mm\n  accuracy_surfaces: {file}", 1), job.base))
    assert moved.moved is not None
    floor = min(contour.forming_tip[:, 2].min() for contour in moved.contours)
    assert floor == pytest.approx(-5e-3 - TOO_SHALLOW, abs=0.05e-3)


def test_a_single_part_is_too_few(part: PartRecord, tmp_path: Path) -> None:
    file = tmp_path / "m.npz"
    with pytest.raises(IsfError, match=r"1 different part\(s\), 4 are needed") as refused:
        learn_surfaces([bag_of(part, tmp_path / "run")], file, as_json=False)
    assert refused.value.code == ErrorCode.LEARNING_UNUSABLE
    assert not file.exists()


def test_runs_that_say_nothing_are_refused_by_name(part: PartRecord, tmp_path: Path) -> None:
    corrected = replace(part, correction="fused")
    surfaces = replace(part, job_text=part.job_text.replace("unit: mm", "unit: mm\n  accuracy_surfaces: x.npz", 1))
    cases = {
        "no scan of the finished part": replace(part, scan=None),
        "is no complete part": replace(part, results=part.results[:1]),
        "springback method fused": corrected,
        "itself formed with accuracy surfaces": surfaces,
    }
    for number, (what, record) in enumerate(cases.items()):
        run = bag_of(record, tmp_path / f"run_{number}")
        with pytest.raises(IsfError, match=what) as refused:
            learn_surfaces([run], tmp_path / "m.npz", as_json=False)
        assert refused.value.code == ErrorCode.LEARNING_UNUSABLE
        assert f"run_{number}" in refused.value.where


def test_parts_of_two_materials_are_not_mixed(part: PartRecord, tmp_path: Path) -> None:
    other = replace(part, job_text=part.job_text.replace("AA5754-O", "DC04"))
    runs = [bag_of(part, tmp_path / "first"), bag_of(other, tmp_path / "second")]
    with pytest.raises(IsfError, match="DC04 instead of AA5754-O") as refused:
        learn_surfaces(runs, tmp_path / "m.npz", as_json=False)
    assert refused.value.where.endswith("second")


def test_a_method_on_the_command_line_does_not_correct_twice() -> None:
    text = quick_cone("method: analytic").text.replace("unit: mm", "unit: mm\n  accuracy_surfaces: m.npz", 1)
    job = JobFile(text, quick_cone().base)
    RunOptions(correction="none").check(job)  # the uncorrected part beside it
    RunOptions().check(job)
    with pytest.raises(IsfError, match="corrected twice"):
        RunOptions(correction="fused").check(job)
