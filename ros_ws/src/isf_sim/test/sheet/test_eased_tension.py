"""The support tool as a local die: squeezed sheet yields under less tension, so the tool needs less force."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from isf_core.files.job import JobFile
from isf_core.files.material import load_material
from isf_core.files.rig import load_rig
from isf_core.types import Array
from isf_sim.machine.simulated_machine import SimulatedMachine
from isf_sim.machine.state import load_machine, save_machine
from isf_sim.sheet.sheet_plant import SheetPlant
from isf_sim.sheet.sheet_point import no_contact
from isf_sim.sheet.squeeze import SqueezeConstants, eased_tension, no_squeeze
from tool_pair import COARSE, JOB, Pair, start, tips_of

R, T, FLOW, CONSTRAINT = 5e-3, 1e-3, 187e6, 2.8
ANGLE = np.radians(50.0)
DEPTH, STEP, OPENING = 10e-3, 1e-3, 20e-3
CLOSER = 0.10e-3
"""m by which the support tool stands closer than the sine law says."""


def constants() -> SqueezeConstants:
    none = np.zeros(3)
    return SqueezeConstants(True, R, R, 1e6, 0.5, T, 3 * R, none, none, FLOW, CONSTRAINT)


def eased(force: float, thickness: float = T, angle: float = ANGLE, wall: tuple[float, float] = (1.0, 0.0)) -> float:
    """N, for a squeeze of ``force`` N outwards along x at ``angle`` rad from the vertical."""
    state, contact = no_squeeze(), no_contact(np.zeros(3))
    state.force[:] = force * np.sin(angle), 0.0, -force * np.cos(angle)
    state.thickness[0] = thickness
    contact.wall[:] = np.tan(ANGLE), *wall, 1.0
    return float(eased_tension(state, contact, constants()))


def test_a_small_force_spreads_over_the_thickness_alone() -> None:
    """t >> a: p = 4 F / (pi t^2) on a strip of width t, so 4 F / pi less, whatever the sheet."""
    for thickness in (0.5e-3, 2e-3):
        assert eased(1e-2, thickness) == pytest.approx(4e-2 / np.pi, rel=0.02)


def test_a_large_force_takes_the_whole_strength_of_the_strip_it_presses() -> None:
    """a >> t: p = s_f, nothing of the tension s_f t w is left on the width w = 2 a + t."""
    force = 5e4
    width = 2.0 * np.sqrt(force / (np.pi * CONSTRAINT * FLOW)) + T
    assert eased(force) == pytest.approx(FLOW * T * width, rel=1e-9)


def test_the_order_of_the_published_support_force() -> None:
    """120 N on a wall of 50 deg of a sheet of 1 mm: 0.27 mm of contact, 1.2 mm of width, 110 MPa, 83 N less."""
    assert eased(120.0, T * np.cos(ANGLE)) == pytest.approx(83.0, abs=2.0)


@settings(max_examples=40, deadline=None)
@given(st.floats(1e-3, 2e3), st.floats(0.3e-3, 3e-3), st.floats(1.01, 2.0))
def test_more_squeeze_eases_more_within_what_force_and_sheet_allow(force: float, thickness: float, more: float) -> None:
    width = 2.0 * np.sqrt(force / (np.pi * CONSTRAINT * FLOW)) + thickness
    found = eased(force, thickness)
    assert 0.0 < found <= min(4.0 * force / np.pi, FLOW * thickness * width) * (1 + 1e-12)
    assert eased(more * force, thickness) > found


def test_only_what_is_squeezed_on_the_side_of_the_wall_counts() -> None:
    """Full over the tip and beyond it towards the wall; none once the whole circle lies on the other side."""
    straight_below = eased(120.0, angle=0.0)
    assert eased(120.0) == pytest.approx(straight_below)
    assert eased(120.0, wall=(0.0, 1.0)) == pytest.approx(straight_below)  # ahead of the tool, wall beside it
    assert eased(120.0, wall=(-1.0, 0.0)) == 0.0
    assert 0.0 < eased(120.0, angle=0.05, wall=(-1.0, 0.0)) < straight_below


def test_no_squeeze_eases_nothing() -> None:
    assert eased(0.0) == 0.0


def blank() -> SheetPlant:
    rig = load_rig("ren2018")
    return SheetPlant(rig.clamp, load_material("AA5754-O"), T, R, 0.5e-3, rig.tool_1.compliance, constants=COARSE)


def ring(plant: SheetPlant, depth: float, tension: float) -> float:
    """N, mean axial force on a circle of 20 mm with ``tension`` N eased."""
    forces = []
    for turn in np.arange(0.0, 2 * np.pi, 0.04):
        plant.move(np.array([20e-3 * np.cos(turn), 20e-3 * np.sin(turn), -depth]), np.zeros(2), tension)
        forces.append(float(plant.contact.axial[0]))
    return float(np.mean(forces))


def test_the_tool_needs_less_force_and_never_a_negative_one() -> None:
    """However much is eased, the force stays positive and the sheet is formed deeper."""
    forces, depths = [], []
    for tension in (0.0, 60.0, 1e5):
        plant = blank()
        for k in range(1, 6):
            force = ring(plant, k * 1e-3, tension)
        forces.append(force)
        depths.append(float(plant.surface.height.min()))
    assert forces == sorted(forces, reverse=True)
    assert depths == sorted(depths, reverse=True)
    assert 0.0 < forces[0] - forces[1] < 60.0
    assert forces[2] > 0.0


def test_a_tool_on_a_support_keeps_its_force() -> None:
    """Pressed against a plate, the sheet is squeezed by plate and tool; the support tool changes nothing."""
    found = []
    for tension in (0.0, 100.0):
        plant = blank()
        plant.set_support(np.full(plant.surface.height.shape, -plant.thickness))
        found.append((ring(plant, 0.05e-3, tension), float(plant.contact.on_die[0]), plant.surface.height.copy()))
    assert found[0][1] > 0.0
    assert found[0][:2] == found[1][:2]
    assert np.array_equal(found[0][2], found[1][2])


def pair_on(side: int, *, supported: bool = True, law: bool = True) -> Pair:
    """Tools for a cone; without ``law``, squeezed sheet yields as any other."""
    pair = start(side)
    machine = pair.machine
    if not law:  # a sheet without strength has none to lose
        sides = [
            c._replace(squeeze=c.squeeze._replace(flow_stress=1e-9))
            for c in (machine._constants, machine._turned_constants)
        ]
        machine._constants, machine._turned_constants = sides
    first, second = cone_tips(STEP, 0.0, supported)
    pair.move(np.append(pair.forming[:2], 20e-3), np.append(pair.support[:2], -20e-3))
    pair.move(first + np.array([0.0, 0.0, 8e-3]), second - np.array([0.0, 0.0, 8e-3]))
    return pair


def cone_tips(depth: float, turn: float, supported: bool = True) -> tuple[Array, Array]:
    """Planned tips, the support tool ``CLOSER``, or far below."""
    first, second = tips_of(np.zeros(2), OPENING, depth, turn)
    towards = second - first - np.array([0.0, 0.0, 2 * R])
    second = second - CLOSER * towards / np.linalg.norm(towards)
    return first, second if supported else second - np.array([0.0, 0.0, 12e-3])


def rings(pair: Pair, first: int, last: int, supported: bool = True) -> Array:
    """(N, 12) true forces and tips of both tools on the contours ``first`` to ``last``."""
    rows = []
    for k in range(first, last + 1):
        pair.move(*cone_tips(k * STEP, 0.0, supported))
        for turn in np.arange(0.0, 2.0 * np.pi, 0.2e-3 / (OPENING - k * STEP / np.tan(ANGLE))):
            sample = pair.to(*cone_tips(k * STEP, turn, supported))
            rows.append(np.concatenate([sample.true_force_1, sample.true_force_2, sample.tip_1, sample.tip_2]))
    return np.array(rows)


@dataclass(frozen=True)
class Cone:
    """One formed cone: the machine, what its tools felt, the net axial force N on the sheet on the last contour."""

    machine: SimulatedMachine
    rows: Array

    @property
    def axial(self) -> float:
        last = self.rows[-200:]
        return float(abs(last[:, 2] + last[:, 5]).mean())

    @property
    def springback(self) -> float:
        """m, how far the base lies above the tool of the last contour."""
        middle = float(self.machine.plant.measured_shape().at(np.zeros((1, 2)))[0])
        return DEPTH - abs(middle)


@cache
def cone(side: int = 1, supported: bool = True, law: bool = True) -> Cone:
    pair = pair_on(side, supported=supported, law=law)
    return Cone(pair.machine, rings(pair, 1, round(DEPTH / STEP), supported))


def test_support_force_lowers_axial_force_and_springback() -> None:
    """By less than the axial part of what is eased; the law switched off, the same squeeze lowers neither so far."""
    with_law, without = cone(), cone(law=False)
    squeezed = np.linalg.norm(with_law.rows[-200:, 3:6], axis=1).mean()
    assert squeezed > 50.0
    bound = 4.0 / np.pi * squeezed * np.sin(ANGLE)
    assert 0.1 * bound < without.axial - with_law.axial < bound
    assert with_law.springback < without.springback
    assert with_law.machine.faults == []


def test_a_single_tool_has_nothing_eased() -> None:
    """The tool far below changes no bit, with the law or without it."""
    alone, without = cone(supported=False), cone(supported=False, law=False)
    assert float(alone.machine.plant.contact.eased[0]) == 0.0
    assert np.array_equal(alone.rows, without.rows)
    assert np.array_equal(alone.machine.measured_shape().z, without.machine.measured_shape().z)


def test_the_lower_tool_is_eased_as_the_upper_one() -> None:
    above, below = cone(), cone(side=-1)
    assert (above.machine.plant.pressing, below.machine.plant.pressing) == (1, 2)
    assert below.axial == pytest.approx(above.axial, rel=0.01)
    assert below.springback == pytest.approx(above.springback, rel=0.01)


def test_a_saved_machine_goes_on_bit_by_bit_in_the_middle_of_a_squeeze(tmp_path: Path) -> None:
    pair = pair_on(1)
    rings(pair, 1, 3)
    assert float(pair.machine.plant.contact.eased[0]) > 10.0
    restored = load_machine(save_machine(pair.machine, tmp_path / "squeezed.npz"))
    assert float(restored.plant.contact.eased[0]) == float(pair.machine.plant.contact.eased[0])
    forming, support = pair.forming, pair.support
    expected = rings(pair, 4, 4)
    again = rings(Pair(restored, forming, support), 4, 4)
    assert np.array_equal(expected, again)
    assert np.array_equal(pair.machine.plant.surface.height, restored.plant.surface.height)


def test_the_job_of_the_roles_has_a_support_tool() -> None:
    """What is switched off above is on in a machine as it is made."""
    machine = SimulatedMachine(JobFile(JOB, Path()), constants=COARSE)
    assert machine._constants.squeeze.flow_stress == pytest.approx(0.5 * 1.15 * (110e6 + 215e6), rel=0.05)
