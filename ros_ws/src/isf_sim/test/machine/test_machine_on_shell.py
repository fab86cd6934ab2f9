"""The machine with the elasto-plastic sheet: forces, lasting shape, state, and what it refuses."""

from __future__ import annotations

import copy
import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from isf_core.errors import ErrorCode, IsfError
from isf_core.events import EventKind
from isf_core.files.job import JobFile
from isf_core.files.yaml_file import find_named
from isf_core.geometry.height_map import HeightMap
from isf_core.simulated_sheet import SheetKind
from isf_msgs.srv import Reset
from isf_sim.explicit_shell.shell import Edge
from isf_sim.machine.simulated_machine import SimulatedMachine
from isf_sim.machine.state import load_machine, save_machine
from isf_sim.node import MachineServices
from isf_sim.plant_constants import PlantConstants

EXAMPLES = Path(__file__).resolve().parents[5] / "examples" / "jobs"

JOB = """
name: press
part: {mesh: ../parts/mini_cone.stl, unit: mm}
process: SPIF
rig: ren2018
sheet: {material: AA5754-O, thickness: 1 mm}
tool_1: {radius: 5 mm}
path: {incremental_depth: 0.5 mm, point_spacing: 0.5 mm, feed: 30 mm/s}
control: {rate: 500 Hz}
"""

COARSE = PlantConstants(shell_cell_radii=1.2, shell_flange_cell=16e-3)
"""Enough to see what the machine does with a sheet."""


def machine(text: str = JOB, sheet: str = "shell") -> SimulatedMachine:
    return SimulatedMachine(JobFile(text, EXAMPLES, "job"), constants=COARSE, sheet=sheet)  # type: ignore[arg-type]


def go(cell: SimulatedMachine, start: float, end: float, speed: float = 40e-3) -> np.ndarray:
    """Move the upper tool along z; forces (n, 3) N on it."""
    ticks = max(1, round(abs(end - start) * cell.control_rate / speed))
    away = (0.0, 0.0, -0.1)
    return np.array(
        [cell.tick((0.0, 0.0, height), away).true_force_1 for height in np.linspace(start, end, ticks + 1)[1:]]
    )


@pytest.fixture(scope="module")
def pressed() -> SimulatedMachine:
    cell = machine()
    park = cell.job_file.rig.park_height
    go(cell, park, 2e-3, speed=0.1)
    go(cell, 2e-3, -7e-3)
    return cell


def test_force_grows_with_depth_and_a_dent_is_left(pressed: SimulatedMachine) -> None:
    saved = pressed.state_copy()
    assert not pressed.faults
    held = go(pressed, -7e-3, -7e-3 - 1e-6)[-1]
    assert 300.0 < held[2] < 1200.0  # 400 N on 5 mm with a soft sheet
    assert np.abs(held[:2]).max() < 0.05 * held[2]
    go(pressed, -7e-3, 5e-3)
    assert pressed.sample().true_force_1[2] == 0.0
    shape = pressed.measured_shape()
    middle = shape.at(np.array([[0.0, 0.0], [0.03, 0.0], [0.12, 0.12]]))
    assert -4e-3 < middle[0] < -0.8e-3
    assert middle[0] < 2.0 * middle[1] < -0.1e-3  # the sheet beside the tool has yielded too
    assert middle[2] == pytest.approx(0.0, abs=0.1e-3)
    values = pressed.sheet_values()
    assert values["model"] == "shell"
    assert values["elements"] == pressed._shell.shell.state.thickness.size  # type: ignore[union-attr]
    assert 0.0 < values["kinetic_over_plastic"] < 1.0  # type: ignore[operator]  # little work, and the sheet springs back
    pressed.restore(saved)


def test_a_released_part_finds_another_shape_and_the_blank_in_the_machine_keeps_its_own(
    pressed: SimulatedMachine,
) -> None:
    saved = pressed.state_copy()
    go(pressed, -7e-3, -9e-3)
    go(pressed, -9e-3, 5e-3)
    shell, surface = pressed._shell, pressed.plant.surface
    assert shell is not None
    before = shell.shell.state.position.copy()
    clamped = shell.measured_shape()
    surface.formed[...] = shell.formed(surface)
    part = shell.released(surface)
    assert np.array_equal(shell.shell.state.position, before)
    kept = part.state.thickness > 0.5e-3
    assert 4 < kept.sum() < 0.3 * kept.size  # the dent and a rim of 8 mm
    force = np.abs(part.state.stress * part.state.thickness)  # per length of a cut
    assert force[:, ~kept].max() < 1e-3 * force[:, kept].max()
    here, at = np.array([[0.0, 0.0]]), np.array([[0.012, 0.0]])
    shape = shell.measured_shape(part)
    change = (shape.at(here) - shape.at(at)) - (clamped.at(here) - clamped.at(at))
    assert 1e-6 < abs(float(change[0])) < 0.5e-3
    exact = pressed.released_shape()
    assert exact.at(here)[0] == pytest.approx(shape.at(here)[0], abs=1e-9)
    assert np.array_equal(shell.shell.state.position, before)
    cloud = pressed.measured_cloud(clamped=False)
    assert np.hypot(cloud[:, 0], cloud[:, 1]).max() < 0.06
    assert 0.5 * len(cloud) < np.isfinite(exact.z).sum() < 2.0 * len(cloud)  # beside the part there is nothing
    pressed.restore(saved)


def test_the_fast_sheet_has_no_shape_out_of_the_clamp() -> None:
    """Not that in the clamp, which it would be taken for."""
    cell = machine(sheet="fast")
    for asked in (cell.released_shape, lambda: cell.measured_cloud(clamped=False)):
        with pytest.raises(IsfError, match="no shape out of the clamp") as caught:
            asked()
        assert caught.value.code == ErrorCode.SHEET_NOT_RELEASED
        assert "shell_coarse" in caught.value.advice
    assert np.isfinite(cell.measured_shape().z).all()


def test_a_torn_sheet_is_reported_once_with_what_is_left_of_it(pressed: SimulatedMachine) -> None:
    """Thinned by hand where the tool is; the tool then goes on four radii along a line."""
    saved = pressed.state_copy()
    assert pressed._shell is not None
    pressed._shell.shell.state.thickness *= 0.2
    away = (0.0, 0.0, -0.1)
    for x in np.arange(0.0, 26e-3, 0.1e-3):
        pressed.tick((x, 0.0, -7e-3), away)
    (torn,) = (event for event in pressed.events if event.kind is EventKind.FRACTURE)
    assert torn.value == pytest.approx(-np.log(0.2), rel=0.1)
    assert "tears" in torn.text
    pressed.restore(saved)


def test_goes_on_from_a_copy_and_from_a_file_bit_by_bit(pressed: SimulatedMachine, tmp_path: Path) -> None:
    saved = pressed.state_copy()
    file = save_machine(pressed, tmp_path / "state")
    once = go(pressed, -7e-3, -7.2e-3)
    pressed.restore(saved)
    assert np.array_equal(go(pressed, -7e-3, -7.2e-3), once)
    pressed.restore(saved)
    assert np.array_equal(go(load_machine(file), -7e-3, -7.2e-3), once)


def test_edge_and_hardening_of_the_files_reach_the_sheet_and_a_saved_machine_keeps_both(tmp_path: Path) -> None:
    (tmp_path / "rig.yaml").write_text(
        "based_on: ren2018\nclamp: {size: [80 mm, 80 mm], edge_spring: 45 N/mm/mm, edge_friction: 0.05 N/mm}\n"
        "provenance: {clamp.edge_spring: 'assumed: test', clamp.edge_friction: 'assumed: test'}\n"
    )
    material = find_named("materials", "AA5754-O").read_text()
    more = "kinematic_hardening: 0.5\nsaturation_stress: 258 MPa\nsaturation_strain: 0.06\n"
    stated = "".join(f"  {line.split(':')[0]}: 'assumed: test'\n" for line in more.splitlines())
    (tmp_path / "own.yaml").write_text(material.replace("provenance:\n", f"{more}provenance:\n{stated}"))
    text = JOB.replace("../parts", str(EXAMPLES.parent / "parts"))
    text = text.replace("rig: ren2018", "rig: rig.yaml").replace("AA5754-O", "own.yaml")
    cell = SimulatedMachine(JobFile(text, tmp_path, "job"), constants=COARSE, sheet="shell")
    assert cell._shell is not None
    assert cell._shell.shell.edge == Edge(45e6, pytest.approx(50.0))
    go(cell, cell.job_file.rig.park_height, 1e-3, speed=0.2)
    go(cell, 1e-3, -3e-3, speed=0.1)
    shell = cell._shell.shell
    assert np.abs(shell.state.back_stress).max() > 1e6
    slid = shell.state.anchor - np.array([grid.ravel() for grid in np.meshgrid(shell.x, shell.y)])
    assert 1e-6 < np.abs(slid).max() < 1e-3
    again = load_machine(save_machine(cell, tmp_path / "state"))
    assert again._shell is not None
    assert np.array_equal(again._shell.shell.state.back_stress, shell.state.back_stress)
    assert np.array_equal(go(again, -3e-3, -3.2e-3), go(cell, -3e-3, -3.2e-3))
    assert np.array_equal(again._shell.shell.state.back_stress, shell.state.back_stress)


def test_a_sheet_without_numbers_stops_the_machine_with_a_code(pressed: SimulatedMachine) -> None:
    saved = pressed.state_copy()
    assert pressed._shell is not None
    pressed._shell.shell.state.position[2, 5] = np.nan
    go(pressed, -7e-3, -7.01e-3)
    assert pressed.faults[0][0] == ErrorCode.SHEET_MODEL_FAILED
    assert "unstable" in pressed.faults[0][1]
    pressed.restore(saved)


def in_numbers(shape: HeightMap) -> np.ndarray:
    """(n, 3) m, points of ``shape``, all of which have numbers."""
    points = shape.points()
    assert len(points) == shape.z.size
    return points


def press_anew(cell: SimulatedMachine, depth: float) -> np.ndarray:
    """After a fault and its release: force (3,) N on the upper tool pressed to ``depth`` m where it is."""
    cell.reset()
    sample = cell.sample()
    (x, y, start), away = sample.tip_1, sample.tip_2
    for height in (*np.arange(start, 5e-3, 0.1e-3), *np.arange(5e-3, depth, -0.08e-3), depth):
        sample = cell.tick((x, y, height), away)
    assert not cell.faults
    return sample.true_force_1


BREAKS = {
    "unstable": lambda shell, work: shell.state.position[2].__setitem__(5, np.nan),
    "folded": lambda shell, work: shell.state.position[0].__setitem__(8 * len(shell.x) + 8, 1.0),
    "energy": lambda shell, work: shell.state.plastic_work.__setitem__(7, 2.0 * work + 0.6),
}


@pytest.mark.parametrize("how", BREAKS)
def test_a_sheet_whose_model_fails_is_kept_as_it_was(pressed: SimulatedMachine, how: str) -> None:
    """It is looked at every 32 ticks near the sheet: what it is like then is what can be scanned and reported."""
    saved = pressed.state_copy()
    sheet, away, x = pressed._shell, (0.0, 0.0, -0.1), 0.0
    assert sheet is not None
    while sheet._moves % 32:
        force = pressed.tick((0.0, 0.0, -7e-3), away).true_force_1
    sound = copy.deepcopy(sheet)
    for x in np.linspace(0.1e-3, 1e-3, 10):
        pressed.tick((x, 0.0, -7e-3), away)
    BREAKS[how](sheet.shell, sheet._work)
    ticks = 10
    while not pressed.faults:
        sample, ticks = pressed.tick((x, 0.0, -7e-3), away), ticks + 1
    ((code, text),) = pressed.faults
    assert code == ErrorCode.SHEET_MODEL_FAILED
    assert f"the sheet is kept as it was {ticks} ticks before" in text
    assert ticks <= 32
    assert np.array_equal(in_numbers(pressed.measured_shape()), in_numbers(sound.measured_shape()))
    assert pressed.sheet_values()["kinetic_over_plastic"] == sound.values()["kinetic_over_plastic"]
    assert sample.true_force_1 == pytest.approx(force, rel=0.02, abs=5.0)
    pressed.restore(saved)


def test_the_tool_gets_free_where_the_energy_is_near_its_limit(pressed: SimulatedMachine) -> None:
    """The sheet gives elastic work back as the tool is lifted: what was within 10 % and 0.5 J then is not any more."""
    saved = pressed.state_copy()
    sheet = pressed._shell
    assert sheet is not None
    room = 1.1 * sheet._work + 0.5 - sheet.shell.plastic_work
    sheet.shell.state.plastic_work[7] += room - 1e-3
    for _ in pressed.release_steps():
        pass
    ((code, _),) = pressed.faults
    assert code == ErrorCode.SHEET_MODEL_FAILED
    assert not pressed.loaded
    pressed.restore(saved)


def test_the_tool_is_lifted_out_of_a_sheet_whose_model_failed_and_the_sheet_goes_on(
    pressed: SimulatedMachine, tmp_path: Path
) -> None:
    """As it is lifted out of a sound one from the same place, without a kick; a saved machine does the same."""
    saved = pressed.state_copy()
    sheet, away = pressed._shell, (0.0, 0.0, -0.1)
    assert sheet is not None
    while sheet._moves % 32:
        force = pressed.tick((0.0, 0.0, -7e-3), away).true_force_1
    before = pressed.state_copy()
    pressed.release()
    lifted = in_numbers(pressed.measured_shape())
    pressed.restore(before)
    for x in np.linspace(0.1e-3, 1e-3, 10):
        pressed.tick((x, 0.0, -7e-3), away)
    pressed._shell.shell.state.position[2, 5] = np.nan  # type: ignore[union-attr]
    for _ in range(8):
        pressed.tick((1e-3, 0.0, -7e-3), away)
    assert len(pressed.faults) == 1
    assert pressed.sample().true_force_1[2] == pytest.approx(force[2], rel=0.05)  # it comes to rest 0.1 mm further on
    again = load_machine(save_machine(pressed, tmp_path / "state"))
    for cell in (pressed, again):
        forces = np.array([sample.true_force_1[2] for sample in cell.release_steps()])
        assert forces.max() < 1.1 * force[2]
        assert not cell.loaded
        assert len(cell.faults) == 1
    assert np.abs(in_numbers(pressed.measured_shape()) - lifted).max() < 0.1e-3
    one, other = (cell._shell.shell.state.position for cell in (pressed, again))  # type: ignore[union-attr]
    assert np.array_equal(one, other)
    assert press_anew(pressed, -7e-3)[2] == pytest.approx(force[2], rel=0.2)
    pressed.restore(saved)


def test_a_model_that_fails_again_while_the_tool_is_lifted_keeps_the_sheet(pressed: SimulatedMachine) -> None:
    saved = pressed.state_copy()
    sheet = pressed._shell
    assert sheet is not None
    for _ in range(40):
        pressed.hold()
    for k in range(60):
        if k % 20 == 10:
            sheet.shell.state.position[2, 5] = np.nan
        pressed.hold()
    assert len(pressed.faults) == 1
    in_numbers(pressed.measured_shape())
    pressed.release()
    assert not pressed.loaded
    in_numbers(pressed.measured_shape())
    pressed.restore(saved)


def test_a_model_that_fails_before_it_was_ever_looked_at_leaves_a_flat_blank() -> None:
    cell = machine()
    go(cell, cell.job_file.rig.park_height, 1.0e-3, speed=0.1)
    assert cell._shell is not None
    go(cell, 1.0e-3, -0.4e-3)
    assert cell._shell._moves < 32
    cell._shell.shell.state.position[2, 5] = np.nan
    go(cell, -0.4e-3, -1.2e-3)
    assert cell.faults
    assert not cell.measured_shape().z.any()
    cell.release()
    assert not cell.loaded
    assert press_anew(cell, -2e-3)[2] > 50.0


def test_an_element_folded_over_stops_the_machine_and_says_where(pressed: SimulatedMachine) -> None:
    saved = pressed.state_copy()
    assert pressed._shell is not None
    shell = pressed._shell.shell
    row, column = len(shell.y) // 4, len(shell.x) // 4
    node = row * len(shell.x) + column
    place = shell.state.position[:2, node].copy()
    shell.state.position[0, node] += 1.2 * (shell.x[column + 1] - shell.x[column])
    go(pressed, -7e-3, -6.9e-3, speed=1e-3)
    code, text = pressed.faults[0]
    assert code == ErrorCode.SHEET_MODEL_FAILED
    assert "folded over at" in text
    found = np.array([float(value) for value in text.split("[")[1].split("]")[0].split(",")])
    cell = max(float(np.diff(line[k - 2 : k + 3]).max()) for line, k in ((shell.x, column), (shell.y, row)))
    assert np.abs(1e-3 * found[:2] - place).max() < 1.2 * cell  # of an element at the node, which was moved so far
    pressed.restore(saved)
    go(pressed, -7e-3, -6.9e-3)
    assert pressed.faults == []


def test_energy_from_nowhere_stops_the_machine(pressed: SimulatedMachine) -> None:
    saved = pressed.state_copy()
    assert pressed._shell is not None
    work, plastic = pressed._shell._work, pressed._shell.shell.plastic_work
    assert 0.1 * work < plastic < 0.5 * work  # a push that is elastic for the most part
    pressed._shell.shell.state.plastic_work[7] += 1.2 * work + 0.6
    go(pressed, -7e-3, -6.9e-3, speed=1e-3)
    assert pressed.faults[0][0] == ErrorCode.SHEET_MODEL_FAILED
    assert "J as plastic work, tools gave it" in pressed.faults[0][1]
    pressed.restore(saved)


def test_an_undisturbed_sheet_has_no_element_folded_over(pressed: SimulatedMachine) -> None:
    assert pressed._shell is not None
    shell = pressed._shell.shell
    assert shell.inverted_element() is None
    at = shell.state.position.reshape(3, len(shell.y), len(shell.x))
    kept = at[:, 3, 4].copy()
    at[0, 3, 4] = at[0, 3, 6]  # beyond its neighbour
    middle = shell.inverted_element()
    assert middle is not None
    assert np.abs(middle[:2] - at[:2, 3, 5]).max() < 1.5 * float(np.diff(shell.x).max())  # an element at the node
    at[:, 3, 4] = kept
    assert shell.inverted_element() is None


def test_a_sheet_that_does_not_come_to_rest_is_reported(
    pressed: SimulatedMachine, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("isf_sim.explicit_shell.shell.LONGEST_REST", 2)
    before = pressed._shell.shell.state.position.copy()  # type: ignore[union-attr]
    with pytest.raises(IsfError, match=r"does not come to rest: \S+ mm away") as found:
        pressed.measured_shape()
    assert found.value.code == ErrorCode.SHEET_MODEL_FAILED
    assert np.array_equal(pressed._shell.shell.state.position, before)  # type: ignore[union-attr]


def test_cells_too_large_for_the_tool_are_refused() -> None:
    with pytest.raises(IsfError, match=r"too large for a tool of radius 5 mm") as refused:
        SimulatedMachine(JobFile(JOB, EXAMPLES, "job"), constants=PlantConstants(shell_cell_radii=1.6), sheet="shell")
    assert refused.value.code == ErrorCode.SHEET_MESH_COARSE


def golden_job(name: str) -> JobFile:
    folder = EXAMPLES.parents[1] / "tests" / "golden" / "jobs"
    return JobFile((folder / f"{name}.yaml").read_text(encoding="utf-8"), folder)


def test_accumulative_forming_is_refused() -> None:
    with pytest.raises(IsfError) as refused:
        SimulatedMachine(golden_job("adsif_cone"), sheet="shell")
    assert refused.value.code == ErrorCode.FILE_FIELD
    assert "SPIF, DSIF and TPIF" in str(refused.value)


def test_the_fast_sheet_refuses_a_support_tool_under_the_blank() -> None:
    job = JobFile((EXAMPLES / "ren_cone_on_blank.yaml").read_text(encoding="utf-8"), EXAMPLES, "job")
    with pytest.raises(IsfError, match="does not know a support tool that holds the blank") as refused:
        SimulatedMachine(job, sheet="fast")
    assert refused.value.code == ErrorCode.FILE_FIELD
    assert refused.value.advice == "take --sheet shell_coarse"
    SimulatedMachine(job, constants=COARSE, sheet="shell")
    assert SimulatedMachine(job).sheet_kind == "shell_coarse"


@pytest.mark.parametrize(
    ("sheet", "bears", "most"),
    [
        ("fast", "(1500, 1500, 2000) N", 2000.0),
        ("shell", "(2325, 2325, 3100) N, 1.55 times what ren2018 bears, since cells of this size overstate", 3100.0),
    ],
)
def test_a_tool_driven_into_the_die_ends_at_the_force_limit_with_its_place(
    sheet: SheetKind, bears: str, most: float
) -> None:
    """The die stands under the sheet, rigid: within 1.5 mm the machine is at its limit, and the sheet stays whole."""
    cell = SimulatedMachine(golden_job("tpif_cone"), constants=COARSE if sheet == "shell" else None, sheet=sheet)
    park = cell.job_file.rig.park_height
    for height in (*np.arange(park, 1e-3, -0.4e-3), *np.arange(1e-3, -5e-3, -0.05e-3)):
        cell.tick((0.0, 0.0, height), (0.0, 0.0, -park), 0.0)
        if cell.faults:
            break
    ((code, text),) = cell.faults
    assert code == ErrorCode.FORCE_LIMIT
    place = re.match(
        r"tool 1 at \((.*), (.*), (.*)\) mm carries \(.*, (\d+)\) N; the machine bears " + re.escape(bears), text
    )
    assert place is not None, text
    x, y, z, force = (float(value) for value in place.groups())
    assert (x, y) == pytest.approx((0.0, 0.0), abs=0.1)
    assert -1.5 < z < -0.1
    assert force > most
    for _ in cell.release_steps():
        pass
    assert not cell.loaded
    assert cell.measured_shape().z.min() > -1.5e-3


def test_a_die_carries_the_sheet_when_the_holder_comes_down() -> None:
    """By 3 mm, without a tool: over the die the sheet stands 3 mm above the holder, at the clamp it stays with it."""
    cell = SimulatedMachine(golden_job("tpif_cone"), constants=COARSE, sheet="shell")
    park = cell.job_file.rig.park_height
    for height in np.linspace(0.0, -3e-3, 50):
        cell.tick((0.0, 0.0, park), (0.0, 0.0, -park), height)
    assert not cell.faults
    saved = cell.state_copy()
    clamp = 0.5 * cell.job_file.rig.clamp.size[0]
    middle, edge = cell.measured_shape().at(np.array([[0.0, 0.0], [clamp - 2e-3, 0.0]]))
    assert middle == pytest.approx(3e-3, abs=0.15e-3)
    assert edge == pytest.approx(0.0, abs=0.2e-3)
    for height in np.linspace(-3e-3, 0.0, 50):
        cell.tick((0.0, 0.0, park), (0.0, 0.0, -park), height)
    assert cell.measured_shape().at(np.array([[0.0, 0.0]]))[0] < 1.5e-3
    cell.restore(saved)
    assert cell.measured_shape().at(np.array([[0.0, 0.0]]))[0] == middle


def test_a_tool_meets_the_sheet_in_the_middle_of_a_large_cell() -> None:
    """Cells of 10.7 mm: the ball of 5 mm is 9.3 mm from the nearest nodes as it touches the sheet between four."""
    cell = machine()
    assert cell._shell is not None
    x, y = cell._shell.shell.x, cell._shell.shell.y
    widths = [np.diff(line)[2:-2] for line in (x, y)]
    i, j = (2 + int(np.argmax(width)) for width in widths)
    assert (x[i + 1] - x[i], y[j + 1] - y[j]) == pytest.approx((10.66e-3, 10.66e-3), abs=0.01e-3)
    place, park = (0.5 * (x[i] + x[i + 1]), 0.5 * (y[j] + y[j + 1])), cell.job_file.rig.park_height
    for share in np.linspace(0.0, 1.0, 700):
        cell.tick((share * place[0], share * place[1], park), (0.0, 0.0, -park))
    forces = {}
    for height in (*np.arange(park, 2e-3, -0.2e-3), *np.arange(2e-3, -1.6e-3, -0.05e-3)):
        forces[round(1e3 * height, 2)] = cell.tick((*place, height), (0.0, 0.0, -park)).true_force_1[2]
    assert not cell.faults
    # rises from nothing as the tool comes onto the sheet, without a kick
    assert forces[0.5] == 0.0
    assert max(np.abs(np.diff(list(forces.values())))) < 100.0
    assert forces[-1.5] > 50.0


DSIF = JOB.replace("process: SPIF", "process: DSIF").replace(
    "tool_1: {radius: 5 mm}", "tool_1: {radius: 5 mm}\ntool_2: {radius: 5 mm}"
)


def test_a_lower_tool_that_forms_alone_is_no_support() -> None:
    """Pushed up 7 mm it carries more than a support tool may without chips, 452 N; and it is moved clear downwards."""
    cell = machine(DSIF)
    park = cell.job_file.rig.park_height
    heights = (*np.arange(-park, -3e-3, 0.2e-3), *np.arange(-3e-3, 8e-3, 0.08e-3))
    for height in heights:
        cell.tick((0.0, 0.0, park), (0.0, 0.0, height))
    for x in np.arange(0.0, 3e-3, 0.1e-3):
        sample = cell.tick((0.0, 0.0, park), (x, 0.0, heights[-1]))
    assert sample.true_force_2[2] < -460.0
    assert cell.plant.pressing == 2
    assert cell.events == []
    # its way counts, as that of the upper one would, from where it presses with 50 N on, 1 mm up
    assert float(cell.plant.contact.path[0]) == pytest.approx(heights[-1] - 1e-3 + 2.9e-3, abs=1e-3)
    assert not cell.faults
    cell.restore(cell.state_copy())
    assert cell.plant.pressing == 2
    cell.latch(ErrorCode.FORCE_LIMIT, "as if")
    cell.release()
    assert not cell.loaded
    assert cell.sample().tip_2[2] < heights[-1] - 2e-3


def test_the_tool_that_presses_harder_forms_and_ripple_changes_nothing() -> None:
    cell = machine(DSIF)
    forces = cell._axes.force_1, cell._axes.force_2
    found = []
    for up, down in ((400.0, -120.0), (100.0, -140.0), (100.0, -160.0), (130.0, -100.0), (300.0, -100.0)):
        forces[0][2], forces[1][2] = up, down
        cell._watch.carrying = True
        cell._find_forming_tool()
        found.append((cell.plant.pressing, cell._watch.carrying))
    assert found == [(1, True), (1, True), (2, False), (2, True), (1, False)]


def test_another_blank_has_the_limits_of_its_own_sheet() -> None:
    """What the node clamps anew where no job comes with the request."""
    cell = machine()
    assert cell.job_file.rig.limits.force == pytest.approx((2325.0, 2325.0, 3100.0))
    node = SimpleNamespace(needed=lambda: cell)
    services = MachineServices.__new__(MachineServices)
    services._node = node  # type: ignore[assignment]
    file = services._job_of(Reset.Request(new_blank=True))
    again = SimulatedMachine(file, sheet="fast")
    assert again.job_file.rig.limits.force == pytest.approx((1500.0, 1500.0, 2000.0))


def test_a_saved_sheet_is_computed_with_the_threads_of_the_one_who_takes_it_up(
    pressed: SimulatedMachine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = save_machine(pressed, tmp_path / "state")
    monkeypatch.setenv("ISF_SHELL_THREADS", "1")
    again = load_machine(file)
    assert again._shell is not None
    assert again._shell.shell.threads == 1
