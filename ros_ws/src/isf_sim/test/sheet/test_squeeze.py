"""Squeeze between two balls: law, direction, memory."""

from __future__ import annotations

import numpy as np
import pytest
from isf_sim.sheet.sheet_point import no_contact
from isf_sim.sheet.squeeze import SqueezeConstants, indentation_stiffness, no_squeeze, squeeze_sheet
from isf_sim.sheet.surface import flat_surface

R, T = 5e-3, 1e-3
COMPLIANCE = np.array([1e-6, 1e-6, 1e-7])


def constants(present: bool = True) -> SqueezeConstants:
    stiffness = indentation_stiffness(R, R, 200e6, 2.8)
    return SqueezeConstants(present, R, R, stiffness, 0.5, T, 3 * R, COMPLIANCE, COMPLIANCE, 200e6, 2.8)


def test_stiffness_of_the_study() -> None:
    """4.4 N/um for two balls of 5 mm and a flow stress of 200 MPa."""
    assert indentation_stiffness(R, R, 200e6, 2.8) == pytest.approx(4.4e6, rel=0.01)


@pytest.mark.parametrize("angle", [0.0, 0.6, 1.1])
def test_force_follows_the_overlap_along_the_line_of_centres(angle: float) -> None:
    """F = d0 / (1/k_m + n.(C1 + C2) n); it pushes the support tool away from the forming one."""
    overlap = 0.05e-3
    n = np.array([np.sin(angle), 0.0, -np.cos(angle)])
    forming = np.array([0.0, 0.0, -1e-3])
    support = forming + np.array([0.0, 0.0, R]) + (2 * R + T - overlap) * n + np.array([0.0, 0.0, R])
    state = no_squeeze()
    squeeze_sheet(forming, support, flat_surface((0.06, 0.06), 0.5e-3), no_contact(forming), state, constants())
    give = 1 / constants().stiffness + n @ (2 * COMPLIANCE * n)
    assert state.force == pytest.approx(overlap / give * n, abs=1e-6)
    assert state.force[2] < 0.0 or angle > 1.5  # a squeezed lower tool reads Fz < 0


def test_tools_apart_or_absent_do_not_squeeze() -> None:
    forming = np.array([0.0, 0.0, 0.0])
    surface = flat_surface((0.06, 0.06), 0.5e-3)
    for gap, present in ((1.01e-3, True), (0.5e-3, False)):
        state = no_squeeze()
        squeeze_sheet(forming, np.array([0, 0, -gap]), surface, no_contact(forming), state, constants(present))
        assert (state.force == 0.0).all()


def test_a_second_pass_meets_thinner_sheet_and_does_not_ratchet() -> None:
    """The lasting indentation lowers the force of the next pass; a third equal pass finds the second one's sheet."""
    forming, support = np.zeros(3), np.array([0.0, 0.0, -0.95e-3])
    surface, contact = flat_surface((0.06, 0.06), 0.5e-3), no_contact(np.zeros(3))
    forces = []
    for path in (0.0, 1.0, 2.0):
        contact.path[0] = path
        state = no_squeeze()
        squeeze_sheet(forming, support, surface, contact, state, constants())
        forces.append(-state.force[2])
    assert forces[1] < forces[0]
    assert forces[2] == pytest.approx(forces[1])


def test_force_over_sheet_squeezed_thin_in_places_has_no_steps() -> None:
    """Between the nodes of the memory the force changes by its share of the way, at the nodes it is what they hold."""
    surface, contact = flat_surface((0.06, 0.06), 0.5e-3), no_contact(np.zeros(3))
    ny, nx = surface.squeeze.shape
    surface.squeeze[...] = 200.0 * ((np.arange(nx) + np.arange(ny)[:, None]) % 2)  # full and none from node to node
    places = np.arange(-1e-3, 1e-3, 0.02e-3)
    force = []
    for place in places:
        state = no_squeeze()
        # a height at which the ball is crossed on the row of nodes at y = 0
        squeeze_sheet(
            np.array([place, 0.0, 0.0]), np.array([place, 0.0, -0.9e-3]), surface, contact, state, constants()
        )
        force.append(-state.force[2])
        surface.squeezed[...] = -1e9  # every place is met as by the first pass
        surface.squeeze[...] = 200.0 * ((np.arange(nx) + np.arange(ny)[:, None]) % 2)
    thinner = constants().memory * 200.0 / constants().stiffness
    most = thinner / (1 / constants().stiffness + 2 * COMPLIANCE[2])
    assert np.ptp(force) == pytest.approx(most, rel=1e-6)
    assert np.abs(np.diff(force)).max() == pytest.approx(most * 0.02 / 0.5, rel=1e-3)
