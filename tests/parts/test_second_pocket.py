"""A second pocket beside the first one: the tools come down from the air, and go as deep as asked with every method."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from isf_analysis.measures.record import PartRecord
from isf_cell import in_process
from isf_cell.commands.learn import learn_record
from isf_cell.options import RunOptions
from isf_core.files.job import JobFile
from isf_core.files.yaml_file import find_named
from isf_planner.part_library import PARTS, part_mesh
from isf_springback import method_names
from isf_springback.estimators import learning
from trimesh import Trimesh

METHODS = ["analytic", "elastic", "fused", "mpc_vertical", "mpc_two_directional"]

SECOND = 1
"""Feature number of the second pocket."""

ROUNDED = 0.2e-3
"""m by which the limit of the slope and the average round what is asked for off; the defect kept several mm."""

JOB = """
name: two_pockets
part: {mesh: two_pockets.stl, unit: mm}
process: SPIF
rig: small_clamp.yaml
sheet: {material: AA5754-O, thickness: 1.0 mm}
tool_1: {radius: 5 mm}
path: {incremental_depth: 1 mm, point_spacing: 1.5 mm, feed: 90 mm/s, transition: ramp, floor_step: none}
control: {rate: 100 Hz}
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("pockets")
    mesh = part_mesh(PARTS["two_pockets"](depth=6e-3, second_depth=4e-3))
    Trimesh(1e3 * mesh.vertices, mesh.faces, process=False).export(place / "two_pockets.stl")
    rig = find_named("rigs", "ren2018").read_text(encoding="utf-8")
    assert "size: [250 mm, 250 mm]" in rig
    small = rig.replace("size: [250 mm, 250 mm]", "size: [160 mm, 160 mm]")  # a smaller sheet is solved sooner
    (place / "small_clamp.yaml").write_text(small, encoding="utf-8")
    return place


def formed(folder: Path, springback: str, job: str = JOB) -> PartRecord:
    return in_process.form(JobFile(job + f"springback: {{{springback}}}\n", folder), RunOptions())


def pushes(record: PartRecord) -> tuple[float, float]:
    """m, largest push on the first contour of the second pocket, and the largest that its method asked for."""
    first = next(k for k, contour in enumerate(record.nominal) if contour.feature == SECOND)
    assert record.nominal[first].retract
    correction = record.corrections[first]
    # of methods that tell no springback what they asked for is what was given and what is left
    asked = correction.springback
    if not len(asked):
        asked = -correction.offset[:, 2] + (correction.residual if len(correction.residual) else 0.0)
    return float(-correction.offset[:, 2].min()), float(np.max(asked))


@pytest.mark.parametrize("name", METHODS)
@pytest.mark.parametrize("first", ["predicted", "zero"])
def test_the_first_contour_of_the_second_pocket_is_pushed_as_far_as_asked(folder: Path, name: str, first: str) -> None:
    """Nothing is kept of the push on the first pocket, which ends some mm deep, tens of mm away."""
    scans = "scan_every: 1, " if name == "fused" or name.startswith("mpc") else ""
    record = formed(folder, f"{scans}method: {name}, first_contour: {first}")
    assert record.failure() is None
    applied, asked = pushes(record)
    before = [k for k, contour in enumerate(record.nominal) if contour.feature != SECOND][-1]
    assert -record.corrections[before].offset[:, 2].mean() > 1e-3  # there was something to keep
    if name.startswith("mpc") or (first == "zero" and name != "fused"):
        assert asked == pytest.approx(0.0, abs=1e-6)
    assert applied == pytest.approx(asked, abs=ROUNDED)


@pytest.mark.parametrize("name", ["analytic", "elastic"])
def test_pockets_formed_level_by_level_are_both_corrected(folder: Path, name: str) -> None:
    """With partial paths the tools change the pocket after every level, and come back to what they left."""
    record = formed(folder, f"method: {name}", JOB.replace("transition: ramp", "partial_paths: true"))
    assert record.failure() is None
    features = [contour.feature for contour in record.nominal]
    assert features[:6] == [0, 1, 0, 1, 0, 1]
    assert [correction.code for correction in record.corrections] == [0] * len(features)
    for feature in (0, SECOND):
        own = [correction for k, correction in enumerate(record.corrections) if features[k] == feature]
        assert len(own) >= 3
        assert -np.mean(own[-1].offset[:, 2]) > 1e-3
        assert -np.mean(own[-1].offset[:, 2]) == pytest.approx(np.mean(own[-1].springback), abs=ROUNDED)


@pytest.fixture(scope="module")
def learned(folder: Path) -> None:
    """The file known.npz in the folder, of a part formed with the analytic method."""
    learning.save(learn_record(formed(folder, "method: analytic"), folder), folder / "known.npz")


@pytest.mark.parametrize("name", ["learned", "learned_map"])
@pytest.mark.usefixtures("learned")
def test_what_was_learned_of_a_pocket_is_replayed_from_the_air(folder: Path, name: str) -> None:
    record = formed(folder, f"method: {name}, learning: known.npz")
    assert record.failure() is None
    applied, asked = pushes(record)
    assert asked > 0.5e-3
    assert applied == pytest.approx(asked, abs=ROUNDED)


def test_every_method_has_its_case() -> None:
    """mpc_tpif forms over a die, where there is one feature; none has nothing to push."""
    assert set(method_names()) == {*METHODS, "learned", "learned_map", "mpc_tpif", "none"}
