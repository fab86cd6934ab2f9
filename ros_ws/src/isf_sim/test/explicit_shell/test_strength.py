"""What is used up of the elasto-plastic sheet: strains of its elements, and the bends that a tool makes."""

from __future__ import annotations

import numpy as np
import pytest
from isf_core.files.material import FormingLimit
from isf_sim.explicit_shell.shell import Ball, ExplicitShell, Sheet
from isf_sim.explicit_shell.strength import Strength, principal_strains

BLANK = 1e-3


def flat_shell() -> ExplicitShell:
    line = np.linspace(-0.01, 0.01, 6)
    curve = np.array([0.0, 1.0]), np.array([100e6, 200e6])
    return ExplicitShell(line, line, Sheet(70e9, 0.33, BLANK, *curve))


def test_principal_strains_of_a_stretched_and_turned_sheet() -> None:
    shell = flat_shell()
    c, s = np.cos(0.4), np.sin(0.4)
    turn = np.array([[c, -s], [s, c]])
    stretch = turn @ np.diag([1.5, 1.2]) @ turn.T
    tilted = np.array([[0.6, 0.0], [0.0, 1.0], [0.8, 0.0]])  # a plane in space
    shell.state.position[:] = tilted @ stretch @ shell.state.position[:2]
    major, minor = principal_strains(shell)
    assert major == pytest.approx(np.full(25, np.log(1.5)), abs=1e-9)
    assert minor == pytest.approx(np.full(25, np.log(1.2)), abs=1e-9)


def test_minor_strain_counts_by_the_slope_of_the_fracture_line() -> None:
    shell = flat_shell()
    shell.state.position[:2] *= 1.25
    shell.state.thickness[:] = BLANK / 1.25**2
    used = []
    for slope in (1.0, 0.5):
        strength = Strength(shell, FormingLimit(1.0, slope, 0.0), 15e-3)
        strength.judge(shell)
        used.append(strength.strain)
    assert used == pytest.approx([2.0 * np.log(1.25), 1.5 * np.log(1.25)], abs=1e-9)


def test_a_tool_that_comes_again_after_a_while_bends_again_where_it_touches() -> None:
    shell = flat_shell()
    shell.set_tool(0, Ball(5e-3), np.array([0.0, 0.0, 0.5 * BLANK - 0.02e-3]))
    shell.tools["touching"][0] = 1
    strength = Strength(shell, FormingLimit(1.0, 1.0, 0.15), 15e-3)
    for path in (0.0, 10e-3, 30e-3):  # the second is the same pass
        strength.note(shell, path)
    assert strength.bending.max() == pytest.approx(2.0 / 5e-3)
    assert 0 < np.count_nonzero(strength.bending) < 9
    strength.judge(shell)
    assert strength.strain == pytest.approx(0.15 * 2.0 * 0.5 * BLANK / 5e-3)
    assert np.hypot(*strength.place[:2]) < 3e-3


@pytest.mark.parametrize(("depth", "gives_way"), [(0.1e-3, 0.0), (0.05e-3, 0.0), (0.1e-3, 0.05e-3), (-0.01e-3, 0.0)])
@pytest.mark.parametrize("thickness", [BLANK, 0.7 * BLANK])
def test_what_the_ball_touches_is_bent_to_it(depth: float, gives_way: float, thickness: float) -> None:
    """``depth`` inside the upper face of a flat sheet it touches a disc; its machine lifts it by ``gives_way``."""
    line = np.linspace(-4e-3, 4e-3, 33)
    shell = ExplicitShell(line, line, Sheet(70e9, 0.33, BLANK, np.array([0.0, 1.0]), np.array([100e6, 200e6])))
    shell.state.thickness[:] = thickness
    compliance = gives_way / 500.0
    shell.set_tool(0, Ball(5e-3, compliance=(0.0, 0.0, compliance)), np.array([0.0, 0.0, 0.5 * thickness - depth]))
    shell.tools["touching"][0], shell.tools["felt"][0] = 1, (0.0, 0.0, 500.0)
    strength = Strength(shell, FormingLimit(1.0, 1.0, 0.15), 15e-3)
    strength.note(shell, 0.0)
    reach, middle = 5e-3 + 0.5 * thickness, 0.5 * (line[1:] + line[:-1])
    height = reach - depth + gives_way
    disc = np.hypot(*np.meshgrid(middle, middle)) < np.sqrt(max(0.0, reach**2 - height**2))
    assert (strength.bending > 0.0).reshape(disc.shape).tolist() == disc.tolist()


def test_an_element_that_is_wrapped_round_the_ball_is_touched_where_it_touches() -> None:
    """A cylinder of the ball's radius through nodes 3.5 mm apart: the middles of their chords lie 0.28 mm inside."""
    x, y = np.arange(-14e-3, 14.1e-3, 3.5e-3), np.arange(-5.25e-3, 5.3e-3, 3.5e-3)
    shell = ExplicitShell(x, y, Sheet(70e9, 0.33, BLANK, np.array([0.0, 1.0]), np.array([100e6, 200e6])))
    radius = 5e-3 + 0.5 * BLANK
    turn = np.tile(np.clip(x / radius, -1.2, 1.2), len(y))
    shell.state.position[0] = radius * np.sin(turn)
    shell.state.position[2] = -radius * np.cos(turn)
    for lifted, touched in ((0.1e-3, False), (0.25e-3, False), (-0.1e-3, True)):
        shell.set_tool(0, Ball(5e-3), np.array([0.0, 0.0, -5e-3 + lifted]))
        shell.tools["touching"][0] = 1
        strength = Strength(shell, FormingLimit(1.0, 1.0, 0.15), 15e-3)
        strength.note(shell, 0.0)
        below = strength.bending.reshape(len(y) - 1, len(x) - 1)[1, 3:5]
        assert (below > 0.0).tolist() == [touched, touched]


def test_a_wall_that_is_pulled_thin_after_the_tool_has_passed_is_judged() -> None:
    shell = flat_shell()
    shell.set_tool(0, Ball(5e-3), np.array([-8e-3, -8e-3, 0.5 * BLANK]))
    shell.state.thickness[-1] = BLANK / np.e  # at the corner (8, 8) mm, 23 mm away
    strength = Strength(shell, FormingLimit(0.9, 1.0, 0.15), 15e-3)
    strength.judge(shell)
    assert strength.strain == pytest.approx(1.0)
    assert strength.place[:2] == pytest.approx([8e-3, 8e-3])
    assert strength.margin(shell).min() == pytest.approx(-0.1)


def test_a_flat_tip_touches_with_its_disc_and_bends_to_its_corner() -> None:
    """0.1 mm inside a flat sheet, corner 2 mm, disc 1.5 mm: it touches to 1.5 mm + sqrt(2.5^2 - 2.4^2) = 2.2 mm."""
    line = np.linspace(-4e-3, 4e-3, 33)
    shell = ExplicitShell(line, line, Sheet(70e9, 0.33, BLANK, np.array([0.0, 1.0]), np.array([100e6, 200e6])))
    shell.set_tool(0, Ball(2e-3, flat=1.5e-3), np.array([0.0, 0.0, 0.4e-3]))
    shell.tools["touching"][0] = 1
    strength = Strength(shell, FormingLimit(1.0, 1.0, 0.15), 15e-3)
    strength.note(shell, 0.0)
    middle = 0.5 * (line[1:] + line[:-1])
    disc = np.hypot(*np.meshgrid(middle, middle)) < 2.2e-3
    assert (strength.bending > 0.0).reshape(disc.shape).tolist() == disc.tolist()
    assert strength.bending.max() == pytest.approx(500.0)
