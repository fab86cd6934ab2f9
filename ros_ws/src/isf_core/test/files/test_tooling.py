"""Tools, blanks and backing plates as files: what the library holds, and jobs that name them."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import yaml
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import Job, JobFile
from isf_core.files.material import load_material
from isf_core.files.tooling import BLANKS, LIBRARIES, PLATES, TOOLS, BlankFile, Library, PlateFile, ToolFile, load_named
from isf_core.files.yaml_file import parse

FOLDER = Path(__file__).resolve().parents[2]
FILES = [(library, path.stem) for library in LIBRARIES for path in sorted((FOLDER / library.folder).glob("*.yaml"))]
JOB = """\
name: named
part: {mesh: part.stl, unit: mm}
process: SPIF
rig: torrao2013
sheet: aa1050_230  # 1 mm
tool_1: spif_a_ball_10
backing_plate: spif_a_round_90
path: {incremental_depth: 1 mm, point_spacing: 1 mm, feed: 40 mm/s}
"""
WRITTEN = """\
name: named
part: {mesh: part.stl, unit: mm}
process: SPIF
rig: torrao2013
sheet: {name: aa1050_230, material: AA1050, thickness: 1 mm, size: [230 mm, 230 mm]}
tool_1: {name: spif_a_ball_10, radius: 5 mm, stick_out: 70 mm}
backing_plate: {name: spif_a_round_90, shape: circle, size: [90 mm, 90 mm], edge_radius: 2 mm}
path: {incremental_depth: 1 mm, point_spacing: 1 mm, feed: 40 mm/s}
"""
OWN_TOOL = "name: own\nradius: 3 mm\nstick_out: 50 mm\nprovenance: {radius: 'assumed: x', stick_out: 'assumed: x'}\n"


def refusal(text: str, base: Path) -> IsfError:
    with pytest.raises(IsfError) as caught:
        JobFile(text, base, "job.yaml")
    return caught.value


@pytest.mark.parametrize(("library", "name"), FILES)
def test_every_file_loads_and_states_the_origin_of_every_constant(library: Library, name: str) -> None:
    found = load_named(library, str(FOLDER / library.folder / f"{name}.yaml"))
    written = yaml.safe_load((FOLDER / library.folder / f"{name}.yaml").read_text(encoding="utf-8"))
    assert found.name == name
    assert set(found.provenance) == set(written) - {"name", "provenance"}
    assert all(text.startswith(("published", "calibrated", "assumed")) for text in found.provenance.values())
    if isinstance(found, BlankFile):
        assert load_material(found.material).name == found.material


def test_the_tools_of_the_published_table_are_there() -> None:
    """Torrao 2013, Table 3.8: tip, diameter and length, mm."""
    table = {("ball", 5, 43), ("ball", 10, 70), ("ball", 15, 100), ("flat", 10, 70), ("flat", 15, 100)}
    found = set()
    for tip, diameter, _ in table:
        tool = load_named(TOOLS, f"spif_a_{tip}_{diameter}")
        assert isinstance(tool, ToolFile)
        assert tool.stick_out is not None
        kind = "ball" if tool.flat_radius == 0.0 else "flat"
        found.add((kind, round(2e3 * tool.radius), round(1e3 * tool.stick_out)))
    assert found == table


def test_blanks_of_three_holders_and_both_plates_are_there() -> None:
    """Torrao 2013, 3.5.2: 230, 500 and 1000 mm; openings of 180 x 180 mm and of 90 mm diameter."""
    sizes = {load_named(BLANKS, name).size for name in ("aa1050_230", "aa1050_500", "aa1050_1000")}  # type: ignore[union-attr]
    assert sizes == {(0.23, 0.23), (0.5, 0.5), (1.0, 1.0)}
    square, circle = load_named(PLATES, "spif_a_square_180"), load_named(PLATES, "spif_a_round_90")
    assert isinstance(square, PlateFile)
    assert isinstance(circle, PlateFile)
    assert (square.shape, square.size) == ("rectangle", (0.18, 0.18))
    assert (circle.shape, circle.size) == ("circle", (0.09, 0.09))


def test_a_job_of_names_is_the_job_of_their_fields(tmp_path: Path) -> None:
    named, written = JobFile(JOB, tmp_path), JobFile(WRITTEN, tmp_path)
    assert named.job == written.job
    assert named.material == written.material
    # its text needs no library: it is what nodes, recordings and other computers get
    assert parse(named.text, Job, "job") == written.job
    assert JobFile(named.text, tmp_path).text == named.text


def test_a_job_without_names_keeps_its_text(tmp_path: Path) -> None:
    assert JobFile(WRITTEN, tmp_path).text == WRITTEN


def test_own_files_stand_beside_the_job_and_a_blank_brings_its_own_material(tmp_path: Path) -> None:
    (tmp_path / "store").mkdir()
    (tmp_path / "store" / "tool.yaml").write_text(OWN_TOOL, encoding="utf-8")
    material = (FOLDER / "materials" / "AA1050.yaml").read_text(encoding="utf-8").replace("AA1050", "mine", 1)
    (tmp_path / "store" / "mine.yaml").write_text(material.replace("name: AA1050", "name: mine"), encoding="utf-8")
    origins = "provenance: {material: 'assumed: x', thickness: 'assumed: x', size: 'assumed: x'}\n"
    blank = f"name: own\nmaterial: mine.yaml\nthickness: 2 mm\nsize: [0.2 m, 0.3 m]\n{origins}"
    (tmp_path / "store" / "blank.yaml").write_text(blank, encoding="utf-8")
    text = JOB.replace("spif_a_ball_10", "store/tool.yaml").replace("aa1050_230", "store/blank.yaml")
    job = JobFile(text, tmp_path)
    assert job.job.tool_1.radius == pytest.approx(3e-3)
    assert job.job.sheet.thickness == pytest.approx(2e-3)
    assert job.material.name == "mine"


@pytest.mark.parametrize(
    ("old", "new", "code", "where", "words"),
    [
        ("spif_a_ball_10", "spif_a_ball_11", ErrorCode.FILE_NOT_FOUND, "job.yaml:6", "spif_a_ball_10"),
        ("aa1050_230 ", "mine.yaml ", ErrorCode.FILE_NOT_FOUND, "job.yaml:5", "path of its file"),
        ("spif_a_round_90", "[90 mm, 90 mm]", ErrorCode.FILE_FIELD, "job.yaml:7", "backing_plate"),
        # what does not go together is told with the line that names the file
        ("spif_a_ball_10", "spif_a_flat_10\ntool_axis: {strategy: five_axis}", ErrorCode.FILE_FIELD, ":7", "flat tip"),
    ],
)
def test_a_wrong_name_is_told_with_the_line_of_the_job(
    tmp_path: Path, old: str, new: str, code: ErrorCode, where: str, words: str
) -> None:
    error = refusal(JOB.replace(old, new), tmp_path)
    assert error.code is code
    assert error.where.endswith(where)
    assert words in error.message


@pytest.mark.parametrize(
    ("old", "new", "code", "line", "words"),
    [
        ("radius: 3 mm", "radius: 3", ErrorCode.FILE_UNIT, 2, "radius"),
        ("stick_out: 50 mm", "length: 50 mm", ErrorCode.FILE_FIELD, 3, "unknown field 'length'"),
        ("stick_out: 50 mm", "stick_out: 5 m", ErrorCode.FILE_FIELD, 3, "less than"),
        (", stick_out: 'assumed: x'", "", ErrorCode.FILE_FIELD, 3, "provenance is missing for stick_out"),
        ("name: own", "name: [own", ErrorCode.FILE_SYNTAX, 2, ""),
    ],
)
def test_a_faulty_file_is_told_with_its_own_line(
    tmp_path: Path, old: str, new: str, code: ErrorCode, line: int, words: str
) -> None:
    (tmp_path / "tool.yaml").write_text(OWN_TOOL.replace(old, new), encoding="utf-8")
    error = refusal(JOB.replace("spif_a_ball_10", "tool.yaml"), tmp_path)
    assert error.code is code
    assert error.where == f"{tmp_path / 'tool.yaml'}:{line}"
    assert words in error.what


def test_a_blank_that_does_not_reach_the_clamp_is_refused(tmp_path: Path) -> None:
    """The clamp of torrao2013 leaves 190 x 190 mm free."""
    blank = "{material: AA1050, thickness: 1 mm, size: [%s mm, 230 mm]}"
    error = refusal(JOB.replace("aa1050_230 ", blank % 180), tmp_path)
    assert (error.code, error.where) == (ErrorCode.FILE_FIELD, "job.yaml:5")
    assert "180 x 230 mm does not reach the clamp of torrao2013, 190 x 190 mm" in error.what
    JobFile(JOB.replace("aa1050_230 ", blank % 190), tmp_path)


CORNERS = "[[0 mm, 0 mm], [40 mm, 0 mm], [40 mm, 20 mm]]"


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ("shape: outline", "openings are missing"),
        (f"shape: outline, size: [90 mm, 90 mm], openings: [{CORNERS}]", "neither size nor corner_radius"),
        ("shape: outline, openings: [[[0 mm, 0 mm], [40 mm, 0 mm]]]", "opening 1 encloses nothing"),
        (f"shape: outline, openings: [{CORNERS}, [[1 mm, 0 mm], [2 mm, 0 mm], [3 mm, 0 mm]]]", "opening 2 encloses"),
        (
            "shape: outline, openings: [[[0 mm, 0 mm], [40 mm, 0 mm], [40 mm, 40 mm], [20 mm, -20 mm], [0 mm, 40 mm]]]",
            "opening 1 crosses itself",
        ),
        ("shape: outline, openings: [[[0, 0], [40, 0], [40, 20]]]", "unit"),
        ("shape: outline, openings: [[[0 mm, .nan], [40 mm, 0 mm], [40 mm, 20 mm]]]", "nan"),
        (f"shape: circle, size: [90 mm, 90 mm], openings: [{CORNERS}]", "openings belong to shape: outline"),
        ("shape: circle", "size is missing"),
    ],
)
def test_a_plate_without_a_whole_opening_is_refused(tmp_path: Path, fields: str, words: str) -> None:
    error = refusal(JOB.replace("spif_a_round_90", f"{{{fields}}}"), tmp_path)
    assert words in error.what.lower()
    assert error.where.startswith("job.yaml:7")


def test_an_outline_is_the_same_whichever_way_round_it_is_written(tmp_path: Path) -> None:
    """A triangle of 40 x 20 mm with its right corner at (40, 0), told by hand: its longest side rises by 1 in 2."""
    backwards = "[[40 mm, 20 mm], [40 mm, 0 mm], [0 mm, 0 mm]]"
    plates = [
        JobFile(JOB.replace("spif_a_round_90", f"{{shape: outline, openings: [{loop}]}}"), tmp_path).job.backing_plate
        for loop in (CORNERS, backwards)
    ]
    for plate in plates:
        assert plate is not None
        assert plate.extent == pytest.approx((80e-3, 40e-3))
        assert plate.round_radius == pytest.approx(math.sqrt(400e-6 / math.pi))
        x, y = np.array([38e-3, 20e-3, 45e-3]), np.array([10e-3, 5e-3, 10e-3])
        assert plate.inside(x, y) == pytest.approx([2e-3, 5e-3 * 2 / math.sqrt(5), -5e-3])
        assert plate.height(x, y)[:2] == pytest.approx([-np.inf, -np.inf])
        assert plate.height(x, y)[2] == 0.0
