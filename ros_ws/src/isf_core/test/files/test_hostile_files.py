"""Files and texts from outside that nobody wrote for this software: every one ends with a code, none hangs."""

from __future__ import annotations

import os
import random
import re
from pathlib import Path

import pytest
from damaged import damaged_text
from isf_core.errors import ErrorCode, IsfError
from isf_core.files import bounded, quantity, yaml_file
from isf_core.files.job import Job, JobFile, load_job
from isf_core.files.material import load_material
from isf_core.files.rig import load_rig
from pydantic import TypeAdapter, ValidationError

ROOT = Path(__file__).resolve().parents[5]
JOBS = sorted((ROOT / "examples" / "jobs").glob("*.yaml"))
MINI = ROOT / "examples" / "jobs" / "mini_cone.yaml"


@pytest.mark.parametrize(
    ("text", "unit", "value"),
    [
        ("5 mm", "m", 5e-3),
        ("5mm", "m", 5e-3),
        (" -.5e1 mm ", "m", -5e-3),
        ("5. mm", "m", 5e-3),
        ("1.0 um/N", "m/N", 1e-6),
        ("50 N/mm/mm", "N/m**2", 50e6),
        ("500 mm/s**2", "m/s**2", 0.5),
        ("500 mm / s ^ 2", "m/s**2", 0.5),
        ("2 s**-1", "1/s", 2.0),
        ("24 1/s", "1/s", 24.0),
        ("10 1 / mm", "1/m", 1e4),
        ("1.5 MN*m/rad", "N*m/rad", 1.5e6),
        ("12 l/min", "m**3/s", 2e-4),
        ("7 µm", "m", 7e-6),
        ("25 degC", "degC", 25.0),
        ("50 °", "rad", 0.8726646259971648),
        ("3 rpm", "rad/s", 0.3141592653589793),
    ],
)
def test_a_number_with_its_unit_is_read(text: str, unit: str, value: float) -> None:
    assert quantity.parse(text, unit) == pytest.approx(value, rel=1e-12)


@pytest.mark.parametrize(
    ("text", "field", "advice"),
    [
        ("157 rad/s", quantity.Frequency, "500 Hz"),
        ("3000 rpm", quantity.Frequency, "500 Hz"),
        ("50 %", quantity.Angle, "50 deg"),
        ("5 dB", quantity.Angle, "50 deg"),
        ("10 Hz", quantity.AngularSpeed, "10 deg/s"),
        ("5 N*m/rad", quantity.Torque, "5 N*m"),
        ("5 kN*m", quantity.AngularStiffness, "1.5 MN*m/rad"),
    ],
)
def test_an_angle_is_no_mere_number(text: str, field: object, advice: str) -> None:
    """To pint a turn is 6.28 of anything: 157 rad/s would be 157 Hz instead of 25."""
    with pytest.raises(ValidationError, match=f"is not a quantity in .*; write for example {re.escape(advice)}"):
        TypeAdapter(field).validate_python(text, context=quantity.FROM_FILE)


@pytest.mark.parametrize(
    "text",
    [
        *(
            "9**9**9 mm",
            "5 mm % 3",
            "5 mm + 3 mm",
            "3 * 5 mm",
            "5*3 mm",
            "(5 mm)",
            "5 mm**99",
            "5 mm**2**2",
            "5 - 3 mm",
        ),
        *(
            "mm",
            "5",
            "",
            " ",
            "nan mm",
            "inf mm",
            "-inf mm",
            "1e999 mm",
            "0x10 mm",
            "1_0 mm",
            "5 mm; 3 mm",
            "5 mm\n3 mm",
        ),
        *("9" * 5000 + " mm", "5 " + "m" * 100_000, "5 mm" + "*mm" * 1000, "5 __import__", "5 kg", "5 mm.real", "51/m"),
    ],
)
def test_arithmetic_and_what_is_no_length_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="is not") as refused:
        quantity.parse(text, "m")
    assert len(str(refused.value)) < 250


def test_a_truth_value_is_no_quantity() -> None:
    text = MINI.read_text(encoding="utf-8").replace("engage_depth: 2 mm", "engage_depth: true")
    with pytest.raises(IsfError) as refused:
        JobFile(text, MINI.parent)
    assert refused.value.code is ErrorCode.FILE_UNIT
    assert "true has no unit" in refused.value.what


@pytest.mark.parametrize(
    ("field", "line"),
    [
        ("compliance_compensation: 1.0", "compliance_compensation: true"),
        ("tool_1:", "tolerance: {share: false}\ntool_1:"),
        ("  unit: mm", "  unit: mm\n  turn: [0 deg, 0 deg, true]"),
        ("  method: elastic", "  method: elastic\n  lift_every: true"),
    ],
)
def test_a_truth_value_is_no_number(field: str, line: str) -> None:
    text = MINI.read_text(encoding="utf-8")
    assert field in text
    with pytest.raises(IsfError, match=r"true|false") as refused:
        JobFile(text.replace(field, line), MINI.parent)
    assert refused.value.code in (ErrorCode.FILE_FIELD, ErrorCode.FILE_UNIT)


@pytest.mark.parametrize(
    ("text", "key", "line", "first"),
    [
        (MINI.read_text(encoding="utf-8") + "name: again\n", "name", 28, 2),
        ("a: {b: 1, c: 2, b: 3}", "b", 1, 1),
        ("a:\n  - x: 1\n    y: 2\n    x: 1", "x", 4, 2),
        ("1: one\n01: also one", "01", 2, 1),
        ("1: one\n'1': also one", "1", 2, 1),
        ("? [a]\n: {b: 1, b: 2}", "b", 2, 2),
        ("a: &a {b: 1}\nc: {<<: *a, <<: *a}", "<<", 2, 2),
    ],
)
def test_a_field_that_is_there_twice_is_refused(text: str, key: str, line: int, first: int) -> None:
    with pytest.raises(IsfError) as refused:
        yaml_file.content(text, "file.yaml")
    assert refused.value.code is ErrorCode.FILE_SYNTAX
    assert refused.value.what == f"'{key}' is there twice, first in line {first}"
    assert refused.value.where == f"file.yaml:{line}"


@pytest.mark.parametrize("field", ["  mesh: ../parts/mini_cone.stl", "rig: ren2018", "  material: AA5754-O"])
@pytest.mark.parametrize("name", ["a" * 3000, "a" * 3000 + ".yaml", r'"a\0b"', r'"a\0b.yaml"'])
def test_names_that_no_file_can_have_are_refused(field: str, name: str, tmp_path: Path) -> None:
    text = MINI.read_text(encoding="utf-8")
    assert field in text
    (tmp_path / "job.yaml").write_text(text.replace(field, f"{field.partition(':')[0]}: {name}"))
    if "mesh" in field and "\\0" not in name:
        assert load_job(tmp_path / "job.yaml").mesh is not None  # told when it is opened
        return
    with pytest.raises(IsfError) as refused:
        load_job(tmp_path / "job.yaml")
    assert refused.value.code in (ErrorCode.FILE_NOT_FOUND, ErrorCode.FILE_SYNTAX)
    assert len(str(refused.value)) < 800


def test_fields_stand_in_place_of_merged_ones() -> None:
    text = "a: &a {x: 1, y: 2}\nb: &b {<<: *a, y: 3}\nc: {<<: [*b, *a], z: 4}"
    assert yaml_file.content(text, "")["c"] == {"x": 1, "y": 3, "z": 4}


def test_a_field_twice_is_refused_in_every_kind_of_file(tmp_path: Path) -> None:
    for kind, load in (("rigs", load_rig), ("materials", load_material)):
        path = tmp_path / f"{kind}.yaml"
        shipped = next((ROOT / "ros_ws/src/isf_core" / kind).glob("*.yaml")).read_text(encoding="utf-8")
        path.write_text(f"{shipped}\nname: again\n", encoding="utf-8")
        with pytest.raises(IsfError, match="'name' is there twice") as refused:
            load(str(path), tmp_path)
        assert refused.value.where.startswith(f"{path}:")
    upper = tmp_path / "upper.yaml"
    upper.write_text("based_on: rigs.yaml\nname: upper\n", encoding="utf-8")
    with pytest.raises(IsfError, match="'name' is there twice") as refused:
        load_rig(str(upper), tmp_path)
    assert refused.value.where.startswith(f"{tmp_path / 'rigs.yaml'}:")


def test_pipes_devices_and_folders_are_no_files(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe.yaml"
    os.mkfifo(pipe)
    for path in (pipe, Path("/dev/zero"), tmp_path):
        with pytest.raises(IsfError) as refused:
            load_job(path)
        assert refused.value.code is ErrorCode.FILE_SYNTAX
        assert "a pipe or a device" in refused.value.what
        with pytest.raises(OSError, match="a pipe or a device"):
            bounded.read_content(path, 10)


def test_a_file_larger_than_its_limit_is_not_read(tmp_path: Path) -> None:
    path = tmp_path / "large.yaml"
    path.write_text("name: " + "x" * 200_000)
    with pytest.raises(IsfError, match="100,000 characters"):
        load_job(path)
    with path.open("r+b") as file:
        file.truncate(100_000_000_000)  # takes no room on the disk
    with pytest.raises(IsfError, match=r"larger than 0.4 MB"):
        load_job(path)
    path.write_bytes(b"name: \xff\xfe")
    with pytest.raises(IsfError, match="UTF-8"):
        load_job(path)


def doubling(merged: bool) -> str:
    """YAML whose aliases, written out, are ten to the power of nine."""
    lines = ["a0: &a0 {x: 1}"]
    for k in range(9):
        ten = ", ".join([f"*a{k}"] * 10)
        lines.append(f"a{k + 1}: &a{k + 1} {{<<: [{ten}]}}" if merged else f"a{k + 1}: &a{k + 1} [{ten}]")
    return "\n".join(lines)


@pytest.mark.parametrize("text", [doubling(merged=False), doubling(merged=True), "a: &a [*a]", "a: &a {b: *a}"])
def test_aliases_that_stand_for_endlessly_many_fields_are_refused(text: str) -> None:
    for read in (lambda: yaml_file.parse(text, Job, "job"), lambda: JobFile(text, MINI.parent)):
        with pytest.raises(IsfError, match="aliases"):
            read()


def test_an_alias_as_people_use_it_is_read() -> None:
    text = MINI.read_text(encoding="utf-8").replace("tool_1:\n", "tool_1: &same\n")
    text = text.replace("tool_2:\n  radius: 5 mm\n", "tool_2: *same\n")
    assert "*same" in text
    assert JobFile(text, MINI.parent).job.tool_2.radius == 5e-3


def test_two_thousand_damaged_files_are_read_or_refused_with_a_code(tmp_path: Path) -> None:
    chance = random.Random(2024)
    rigs, materials = (sorted((ROOT / "ros_ws/src/isf_core" / name).glob("*.yaml")) for name in ("rigs", "materials"))
    texts = {path: path.read_text(encoding="utf-8") for path in (*JOBS, *rigs, *materials)}
    place = tmp_path / "damaged.yaml"
    refused, codes = 0, set[ErrorCode]()
    for number in range(2000):
        path = chance.choice((JOBS, JOBS, rigs, materials)[number % 4])
        text = damaged_text(texts[path], chance)
        try:
            if path in JOBS:
                yaml_file.parse(text, Job, path.name)
            else:
                place.write_text(text, encoding="utf-8")
                (load_rig if path in rigs else load_material)(str(place), tmp_path)
        except IsfError as error:
            codes.add(error.code)
            refused += 1
    assert ErrorCode.INTERNAL not in codes
    assert 1000 < refused < 2000  # most accidents are faults, and some harm nothing: neither end was left untried
