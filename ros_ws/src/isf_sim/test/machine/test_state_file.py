"""A machine saved and taken up again: bit-identical future; foreign and damaged files are refused with a code."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile
from isf_core.files.yaml_file import find_named
from isf_sim.machine.simulated_machine import MachineSample, SimulatedMachine
from isf_sim.machine.state import load_machine, plant_digest, save_machine
from isf_sim.plant_constants import PlantConstants

JOB = """
name: state-test
part: {mesh: none.stl, unit: mm}
process: DSIF
rig: ren2018
sheet: {material: AA5754-O, thickness: 1 mm}
tool_1: {radius: 5 mm}
tool_2: {radius: 5 mm}
path: {incremental_depth: 0.5 mm, point_spacing: 0.5 mm, feed: 30 mm/s}
control: {rate: 500 Hz}
"""
COARSE = PlantConstants(coarse_cell=250e-3 / 16, fine_cell=1e-3)
PARK = np.array([0.0, 0.0, -0.1])


def rings(machine: SimulatedMachine, first: int, last: int) -> list[MachineSample]:
    """Circles of a small cone, 0.5 mm apart in depth; the tool comes down from its park position first."""
    samples = []
    tip = machine.sample().tip_1 if first == 1 else None
    for k in range(first, last + 1):
        r = 22e-3 - 0.4e-3 * k
        points = [[r * np.cos(a), r * np.sin(a), -0.5e-3 * k] for a in np.arange(0, 2 * np.pi, 0.15e-3 / r)]
        if tip is None:
            tip = np.array([22e-3 - 0.4e-3 * (k - 1), 0.0, -0.5e-3 * (k - 1)])
        way = np.array(points[0]) - tip
        steps = int(np.ceil(np.linalg.norm(way) / 0.15e-3))
        approach = [tip + way * n / steps for n in range(1, steps + 1)]
        samples += [machine.tick(np.asarray(p), PARK) for p in [*approach, *points[1:]]]
        tip = np.array(points[0])
    return samples


@pytest.fixture(scope="module")
def saved(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[MachineSample], np.ndarray]:
    """A file written in the middle of a part, and what the saved machine did afterwards."""
    machine = SimulatedMachine(JobFile(JOB, Path()), variant=3, seed=5, constants=COARSE)
    machine.tare()
    rings(machine, 1, 6)
    path = save_machine(machine, tmp_path_factory.mktemp("state") / "machine.npz")
    return path, rings(machine, 7, 10), machine.measured_shape().z


def test_a_machine_taken_up_goes_on_bit_by_bit(saved: tuple[Path, list[MachineSample], np.ndarray]) -> None:
    path, expected, shape = saved
    machine = load_machine(path)
    assert machine.tared
    assert machine.tick_count == expected[0].tick - 1
    assert rings(machine, 7, 10)[-1].true_force_1[2] > 20.0
    machine = load_machine(path)
    for mine, other in zip(rings(machine, 7, 10), expected, strict=True):
        for a, b in zip(mine, other, strict=True):
            assert np.array_equal(a, b)
    assert np.array_equal(machine.measured_shape().z, shape)
    assert machine.faults == []


def test_faults_and_events_are_taken_up_too(tmp_path: Path) -> None:
    machine = SimulatedMachine(JobFile(JOB, Path()), constants=COARSE)
    for k in range(1, 1200):
        machine.tick(np.array([0.0, 0.0, 0.1 - 0.15e-3 * k]), PARK)
    assert [code for code, _ in machine.faults] == [ErrorCode.FORCE_LIMIT]
    again = load_machine(save_machine(machine, tmp_path / "faulted.npz"))
    assert again.faults == machine.faults
    assert again.events == machine.events
    assert np.array_equal(again.measured_shape().z, machine.measured_shape().z)
    assert again.release().tick == machine.release().tick


def change(path: Path, out: Path, **header: object) -> Path:
    with np.load(path) as archive:
        arrays = dict(archive)
    text = json.loads(arrays["header"].tobytes())
    text.update(header)
    arrays["header"] = np.frombuffer(json.dumps(text).encode(), dtype=np.uint8)
    with out.open("wb") as file:
        np.savez(file, **arrays)
    return out


def test_foreign_and_damaged_files_are_refused(
    saved: tuple[Path, list[MachineSample], np.ndarray], tmp_path: Path
) -> None:
    good = saved[0].read_bytes()
    files = {"text.npz": b"no archive", "empty.npz": b"", "half.npz": good[: len(good) // 2]}
    paths = [tmp_path / name for name in files]
    for path, content in zip(paths, files.values(), strict=True):
        path.write_bytes(content)
    foreign = tmp_path / "foreign.npz"
    np.savez(foreign, x=np.zeros(3))
    objects = tmp_path / "objects.npz"
    np.savez(objects, header=np.array([{"a": 1}], dtype=object))
    paths += [foreign, objects]
    paths.append(change(saved[0], tmp_path / "newer.npz", version=99))
    paths.append(change(saved[0], tmp_path / "other.npz", format="something"))
    paths.append(change(saved[0], tmp_path / "fields.npz", state={"tick_count": {"v": 1}}))
    for path in paths:
        with pytest.raises(IsfError) as error:
            load_machine(path)
        assert error.value.code == ErrorCode.FILE_SYNTAX, path
        assert path.name in error.value.message
    with pytest.raises(IsfError) as missing:
        load_machine(tmp_path / "none.npz")
    assert missing.value.code == ErrorCode.FILE_NOT_FOUND


def test_another_plant_and_missing_fields_are_named(
    saved: tuple[Path, list[MachineSample], np.ndarray], tmp_path: Path
) -> None:
    with pytest.raises(IsfError, match=r"saved by another plant.*0123456789ab.*form the part again") as error:
        load_machine(change(saved[0], tmp_path / "plant.npz", plant="0123456789ab"))
    assert error.value.code == ErrorCode.FILE_SYNTAX
    with pytest.raises(IsfError, match=r"only in the file: swell; missing in it: .*tick_count"):
        load_machine(change(saved[0], tmp_path / "fields.npz", state={"swell": {"v": 1}}))


def test_a_folder_that_is_none_is_reported(saved: tuple[Path, list[MachineSample], np.ndarray], tmp_path: Path) -> None:
    machine = load_machine(saved[0])
    with pytest.raises(IsfError) as error:
        save_machine(machine, tmp_path / "no" / "such" / "folder.npz")
    assert error.value.code == ErrorCode.FILE_NOT_WRITABLE


def test_a_state_outlives_comments_but_no_other_number(tmp_path: Path) -> None:
    file = tmp_path / "mechanics.py"
    file.write_text('"""Sheet."""\nHARDENING = 0.2\n"""Assumed."""\n', encoding="utf-8")
    before = plant_digest(tmp_path)
    file.write_text('"""The sheet."""\n# from a tensile test\nHARDENING = 0.2\n"""Measured."""\n', encoding="utf-8")
    plant_digest.cache_clear()
    assert plant_digest(tmp_path) == before
    file.write_text('"""The sheet."""\nHARDENING = 0.21\n', encoding="utf-8")
    plant_digest.cache_clear()
    assert plant_digest(tmp_path) != before


@pytest.mark.parametrize(
    ("name", "old", "new"),
    [
        ("rig", "force: [1000 N", "force: [1001 N"),
        ("material", "young_modulus: 70 GPa", "young_modulus: 71 GPa"),
        ("map", "0,0,0,5,0,0", "0,0,0,6,0,0"),
        ("", "assumed: one", "assumed: two"),
    ],
)
def test_a_machine_whose_rig_or_material_has_changed_is_refused(name: str, old: str, new: str, tmp_path: Path) -> None:
    """Their sources may be told otherwise; what they say decides."""
    (tmp_path / "map.csv").write_text("x,y,z,ex,ey,ez\n0,0,0,5,0,0\n")
    rig = "based_on: ren2018\nlimits: {force: [1000 N, 1000 N, 1500 N]}\ntool_1: {error_map: map.csv}\n"
    (tmp_path / "rig.yaml").write_text(rig + "provenance: {limits.force: 'assumed: one'}\n")
    (tmp_path / "sheet.yaml").write_text(find_named("materials", "AA5754-O").read_text())
    text = JOB.replace("rig: ren2018", "rig: rig.yaml").replace("AA5754-O", "sheet.yaml")
    file = save_machine(SimulatedMachine(JobFile(text, tmp_path), constants=COARSE), tmp_path / "machine.npz")
    load_machine(file)
    changed = tmp_path / {"material": "sheet.yaml", "map": "map.csv"}.get(name, "rig.yaml")
    assert old in changed.read_text()
    changed.write_text(changed.read_text().replace(old, new))
    if not name:
        load_machine(file)
        return
    what = "material sheet.yaml" if name == "material" else "rig rig.yaml"
    with pytest.raises(IsfError, match=f"was saved with another content of {what}: ") as error:
        load_machine(file)
    assert error.value.code == ErrorCode.FILE_SYNTAX
    assert "form the part again" in error.value.advice
