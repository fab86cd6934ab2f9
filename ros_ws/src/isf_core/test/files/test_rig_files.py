"""Rig and material files: every file loads, tells where its constants come from, and carries what was published."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile
from isf_core.files.material import load_material
from isf_core.files.rig import Rig, ToolAxis, load_rig

FOLDER = Path(__file__).resolve().parents[2]
RIGS = sorted(path.stem for path in (FOLDER / "rigs").glob("*.yaml"))
MATERIALS = sorted(path.stem for path in (FOLDER / "materials").glob("*.yaml"))
TAGS = ("published", "calibrated", "assumed")


@pytest.mark.parametrize("name", RIGS)
def test_every_rig_loads_and_reports_the_origin_of_its_constants(name: str) -> None:
    rig = load_rig(str(FOLDER / "rigs" / f"{name}.yaml"))
    assert rig.name == name
    assert all(text.startswith(TAGS) for text in rig.provenance.values())
    reported = {key.split(".")[0] for key in rig.provenance}
    assert {"clamp", "compliance", "contact_stiffness", "servo", "load_cell", "limits", "park_height"} <= reported


def constants(values: dict[str, object], above: str = "") -> list[str]:
    """Names of all constants of a rig file, "load_cell.resolution"; those of both tools without the tool."""
    found: list[str] = []
    for key, value in values.items():
        name = f"{above}{key}"
        if isinstance(value, dict):
            found += constants(value, "" if key in ("tool_1", "tool_2") else f"{name}.")
        else:
            found.append(name)
    return found


def is_stated(constant: str, origins: set[str]) -> bool:
    """An origin stands for a constant, for a part of it (compliance.xy), or for all that begin with it."""
    return any(
        constant == origin or constant.startswith((f"{origin}.", f"{origin}_")) or origin.startswith(f"{constant}.")
        for origin in origins
    )


@pytest.mark.parametrize("name", RIGS)
def test_no_constant_of_a_rig_is_without_an_origin(name: str) -> None:
    values = yaml.safe_load((FOLDER / "rigs" / f"{name}.yaml").read_text(encoding="utf-8"))
    origins = set(values.pop("provenance"))
    names = set(constants(values)) - {"name", "based_on"}
    assert {constant for constant in names if not is_stated(constant, origins)} == set()
    assert is_stated("load_cell.noise_ratio", {"load_cell.noise"})
    assert not is_stated("load_cell.resolution", {"load_cell.noise"})


@pytest.mark.parametrize("name", MATERIALS)
def test_every_material_loads_and_its_strengths_are_in_order(name: str) -> None:
    material = load_material(str(FOLDER / "materials" / f"{name}.yaml"))
    assert material.name == name
    assert material.yield_strength < material.tensile_strength
    assert all(text.startswith(TAGS) for text in material.provenance.values())


def test_the_five_published_rigs_and_nine_materials_are_there() -> None:
    assert {"ren2018", "praveen2020", "lu2016", "behera2015", "torrao2013"} <= set(RIGS)
    named = "AA5754-O AA1100-O AA2024-T3 AA7075-O AA3103 AA1050 Al8011 DC04 AISI-304"
    assert set(named.split()) <= set(MATERIALS)


def test_published_machine_error_is_in_the_map() -> None:
    """Praveen 2020, 2.4: +0.10 to -0.27 mm over the opening of 610 mm; the fit through all ten is within 0.03 mm."""
    rig = load_rig(str(FOLDER / "rigs" / "praveen2020.yaml"))
    assert rig.tool_1.error_map is not None
    table = np.loadtxt(rig.tool_1.error_map, delimiter=",", skiprows=1)
    ring = np.hypot(table[:, 0], table[:, 1])
    near = table[np.abs(ring - 300.0) < 10.0, 5]
    assert near.max() == pytest.approx(100.0, abs=30.0)
    assert near.min() == pytest.approx(-270.0, abs=30.0)


@pytest.mark.parametrize(
    "fields",
    [
        {"error_x": ((0.0, 1e-6), (0.0, 2e-6))},
        {"error_z": ((0.01, 0.0), (-0.01, 0.0))},
        {"backlash": (0.0, -1e-6, 0.0)},
        {"weight": -1.0},
    ],
)
def test_impossible_axes_are_refused(fields: dict[str, object]) -> None:
    with pytest.raises(ValueError, match=r"rise|negative|greater"):
        ToolAxis.model_validate({"compliance": (1e-6, 1e-6, 1e-7), **fields})


def test_matrix_of_a_load_cell_has_six_rows(tmp_path: Path) -> None:
    text = (FOLDER / "rigs" / "ren2018.yaml").read_text()
    path = tmp_path / "rig.yaml"
    path.write_text(text.replace("  crosstalk: 0.01\n", "  crosstalk: 0.01\n  matrix: [[1, 0, 0, 0, 0, 0]]\n"))
    with pytest.raises(IsfError) as error:
        load_rig(str(path))
    assert error.value.code == ErrorCode.FILE_FIELD
    assert "six rows" in error.value.message


def test_tools_wait_for_a_scan_within_the_travel(tmp_path: Path) -> None:
    assert load_rig("ren2018").aside == (0.0, pytest.approx(0.12))
    path = tmp_path / "own.yaml"
    for place, fits in (("[50 mm, -20 mm]", True), ("[0 mm, 125 mm]", False), ("[nan mm, 0 mm]", False)):
        path.write_text(f"based_on: ren2018\nscan_place: {place}\n", encoding="utf-8")
        if fits:
            assert load_rig(str(path)).aside == pytest.approx((0.05, -0.02))
        else:
            with pytest.raises(IsfError, match="scan_place"):
                load_rig(str(path))


ORIGIN = "provenance: {clamp.edge_spring: 'assumed: test', clamp.edge_friction: 'assumed: test'}\n"


def own_clamp(folder: Path, clamp: str, origin: str = ORIGIN, below: str = "ren2018") -> Rig:
    (folder / "own.yaml").write_text(f"based_on: {below}\nclamp: {{{clamp}}}\n{origin}", encoding="utf-8")
    return load_rig(str(folder / "own.yaml"))


def test_edge_of_a_clamp_as_a_spring_that_slides(tmp_path: Path) -> None:
    clamp = own_clamp(tmp_path, "edge_spring: 45 N/mm/mm, edge_friction: 200 N/mm").clamp
    assert (clamp.edge, clamp.edge_spring, clamp.edge_friction) == ("free", pytest.approx(45e6), pytest.approx(2e5))
    assert own_clamp(tmp_path, "edge_spring: 45 MPa").clamp.edge_spring == pytest.approx(45e6)
    assert load_rig("ren2018").clamp.edge_spring is None


@pytest.mark.parametrize(
    ("clamp", "origin", "below", "said"),
    [
        ("edge_friction: 200 N/mm", ORIGIN, "ren2018", "clamp.edge_friction: needs clamp.edge_spring"),
        ("edge_spring: 45 N/mm/mm", ORIGIN, "praveen2020", "clamp.edge_spring: a fixed edge does not move"),
        ("edge_spring: 45 N/mm/mm", "", "ren2018", "provenance is missing for clamp.edge_spring"),
        ("edge_spring: 45 N/mm", ORIGIN, "ren2018", "not a quantity"),
        ("edge_spring: 0 MPa", ORIGIN, "ren2018", "clamp.edge_spring: 0 MPa must be greater than 0 N/mm/mm"),
        ("edge_spring: 45 MPa, edge_friction: 200 N", ORIGIN, "ren2018", "not a quantity"),
    ],
)
def test_an_edge_that_is_none_is_refused(tmp_path: Path, clamp: str, origin: str, below: str, said: str) -> None:
    with pytest.raises(IsfError, match=said):
        own_clamp(tmp_path, clamp, origin, below)


@pytest.mark.parametrize(
    ("cells", "code", "said"),
    [
        ("faults: [{channel: z2, kind: open, after: 12}]", ErrorCode.FILE_UNIT, "no unit"),
        ("faults: [{channel: z4, kind: open}]", ErrorCode.FILE_FIELD, "channel"),
        ("faults: [{channel: z2, kind: swapped}]", ErrorCode.FILE_FIELD, "other names"),
        ("faults: [{channel: z2, kind: swapped, other: z2}]", ErrorCode.FILE_FIELD, "other names"),
        ("faults: [{channel: z2, kind: offset}]", ErrorCode.FILE_FIELD, "kind offset"),
        ("faults: [{channel: z2, kind: stuck, value: 1 V}]", ErrorCode.FILE_FIELD, "kind offset"),
        ("gains: [[1 N/V, 1 N/V], [1 N/V, 1 N/V], [1 N/V, 1 N/V]]", ErrorCode.FILE_FIELD, "gains"),
        ("height: 0 mm", ErrorCode.FILE_FIELD, "height"),
        ("amplifier_range: 10 N", ErrorCode.FILE_UNIT, "not a quantity in V"),
    ],
)
def test_spindle_cells_that_cannot_be_are_refused(tmp_path: Path, cells: str, code: ErrorCode, said: str) -> None:
    path = tmp_path / "rig.yaml"
    path.write_text(f"based_on: torrao2013\nname: tried\ntool_1:\n  spindle_cells:\n    {cells}\n")
    with pytest.raises(IsfError, match=said) as caught:
        load_rig(str(path))
    assert caught.value.code is code


def test_the_tool_of_the_job_is_in_the_chuck_of_the_hexapod() -> None:
    """338 mm from the platform to the chuck (Torrao 2013, 4.2) and the tool; 70 mm where the job does not tell."""
    rig = load_rig("torrao2013")
    lengths = [rig.with_tool(stick_out).hexapod.kinematics().tool_length for stick_out in (None, 0.043, 0.1)]
    assert lengths == pytest.approx([0.408, 0.381, 0.438])
    jobs = Path(__file__).parents[5] / "examples" / "jobs"
    text = (jobs / "torrao_cone_45.yaml").read_text(encoding="utf-8")
    job_file = JobFile(text.replace("  radius: 5 mm\n", "  radius: 5 mm\n  stick_out: 43 mm\n"), jobs)
    assert job_file.rig.make_kinematics()[0].tool_length == pytest.approx(0.381)  # type: ignore[attr-defined]


def test_a_gantry_has_no_table_of_a_hexapod() -> None:
    rig = load_rig("ren2018")
    with pytest.raises(ValueError, match="hexapod"):
        Rig.model_validate(rig.model_dump() | {"hexapod": {"table": "1.4 m"}})
