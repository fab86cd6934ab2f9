"""Lines of the coarse shell and what the shell computes on lines of any spacing."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from isf_core.files.material import load_material
from isf_core.files.rig import load_rig
from isf_sim.sheet.sheet_plant import SheetPlant
from isf_sim.sheet.shell_region import grow_region, no_region, opening_region
from isf_sim.sheet.surface import flat_surface, sample
from isf_sim.shell.shell import Elastic, Shell
from isf_sim.shell.shell_assembly import HOURGLASS
from isf_sim.shell.shell_lines import Grading, graded_lines, linear_weights, node_widths
from isf_sim.shell.shell_pattern import star_weights

ALUMINIUM = Elastic(68e9, 0.3)
GRADING = Grading(3.5e-3, 1.4, 12e-3)
LENGTH = 0.25


def graded_shell(low: float = -60e-3, high: float = 20e-3, cells: int = 24, edge: str = "free") -> Shell:
    """A shell whose lines are close together to one side of the middle, differently along x and y."""
    shell = Shell((LENGTH, LENGTH), LENGTH / cells, ALUMINIUM, 1e-3, edge=edge)  # type: ignore[arg-type]
    lines = graded_lines(LENGTH, cells, low, high, GRADING)
    shell.move_lines(lines, graded_lines(LENGTH, cells, 0.0, 50e-3, GRADING))
    return shell


@settings(max_examples=60, deadline=None)
@given(
    st.floats(0.1, 0.8), st.integers(8, 60), st.floats(-0.5, 0.5), st.floats(0.0, 1.0), st.floats(1e-3, 20e-3)
)  # fmt: skip
def test_lines_span_the_sheet_with_bounded_growth(
    length: float, cells: int, middle: float, share: float, finest: float
) -> None:
    low, high = (middle - 0.5 * share) * length, (middle + 0.5 * share) * length
    lines = graded_lines(length, cells, low, high, Grading(finest, 1.4, 12e-3))
    size = np.diff(lines)
    assert lines[0] == -0.5 * length
    assert lines[-1] == 0.5 * length
    assert len(lines) == cells + 1
    assert (size > 0.0).all()
    ratio = size[1:] / size[:-1]
    # the last cell may be cut by rounding of the root alone
    assert max(ratio.max(), 1.0 / ratio.min()) < 1.4 + 1e-6
    assert size.min() > min(finest, length / cells) * (1.0 - 1e-6)


def test_region_gets_the_small_cells() -> None:
    size = np.diff(graded_lines(0.25, 40, -40e-3, 40e-3, GRADING))
    inner = np.abs(np.cumsum(size) - 0.5 * size - 0.125) < 38e-3
    assert size[inner] == pytest.approx(3.52e-3, abs=0.02e-3)
    assert size.max() == pytest.approx(12e-3, abs=0.1e-3)


def test_widths_add_up_to_the_length() -> None:
    lines = graded_lines(0.25, 30, 0.0, 30e-3, GRADING)
    assert node_widths(lines).sum() == pytest.approx(0.25, rel=1e-12)


def test_constant_strain_is_exact_and_in_balance() -> None:
    """Linear u, v and w on a tilted plane: no node inside feels a force, and the work on further displacements that are
    linear in u and v is that of the known stress on the whole sheet."""
    shell = graded_shell()
    shell.set_shape(0.1 * shell.node_x - 0.2 * shell.node_y, np.full(shell.count, 1e-3))
    gradient = np.array([[1e-3, -4e-4], [3e-4, 2e-3], [5e-3, -3e-3]])
    state = np.column_stack([shell.node_x, shell.node_y]) @ gradient.T
    (ux, uy), (vx, vy), (wx, wy) = gradient
    zx, zy = 0.1, -0.2
    shear = 0.5 * (uy + vx + zx * wy + zy * wx + wx * wy)
    strain = np.array([[ux + zx * wx + wx**2 / 2, shear], [shear, vy + zy * wy + wy**2 / 2]])
    metric = np.eye(2) + np.outer([zx, zy], [zx, zy])
    raised = np.linalg.inv(metric) @ strain @ np.linalg.inv(metric)
    nu, area = ALUMINIUM.poisson, LENGTH**2 * np.sqrt(np.linalg.det(metric))
    plane = nu * np.trace(np.linalg.solve(metric, strain)) * np.linalg.inv(metric) + (1.0 - nu) * raised
    stress = ALUMINIUM.young / (1.0 - nu**2) * 1e-3 * area * plane
    force = shell.inner_force(state)[:-1]
    plain = force - shell._springs * shell._flat(state)  # without the springs of the edge
    for along in range(2):
        for by, place in enumerate((shell.node_x, shell.node_y)):
            further = np.zeros((shell.count, 3))
            further[:, along] = place
            assert plain @ shell._flat(further) == pytest.approx(stress[along, by], rel=1e-9)
    inner = np.zeros((shell.ny, shell.nx), dtype=bool)
    inner[2:-2, 2:-2] = True  # beyond it the mirrored clamp and the edge's springs act
    at_nodes = np.append(force, 0.0)[shell._numbering.dof]
    assert np.abs(at_nodes[inner.ravel()]).max() < 1e-9 * np.abs(at_nodes).max()


def test_constant_curvature_is_exact_and_in_balance() -> None:
    """A parabola with twist has the same curvatures everywhere inside, and bending alone gives no force there."""
    shell = graded_shell()
    state = np.zeros((shell.count, 3))
    x, y = shell.node_x, shell.node_y
    state[:, 2] = 0.5 * 3e-6 * x**2 - 0.5 * 2e-6 * y**2 + 1e-6 * x * y  # far too flat for membrane strain
    pattern = shell._numbering.pattern
    around = state[pattern.star, 2]
    bend = np.column_stack([(weights * around).sum(axis=1) for weights in star_weights(shell.x, shell.y)])
    inner = np.zeros((shell.ny, shell.nx), dtype=bool)
    inner[1:-1, 1:-1] = True
    inside = bend[inner.ravel()]
    assert inside == pytest.approx(np.broadcast_to([3e-6, -2e-6], inside.shape), rel=1e-7)
    force = np.append(shell.inner_force(state)[:-1], 0.0)[shell._numbering.dof[:, 2]]
    inner[:2] = inner[-2:] = inner[:, :2] = inner[:, -2:] = False
    # edge nodes that are not held feel the clamp: the scale; membrane strain is of the second order
    rigidity = float(shell.rigidity[0])
    assert np.abs(force[inner.ravel()]).max() < 1e-6 * rigidity * 3e-6


def test_hourglass_stiffness_of_a_cell() -> None:
    """Force of an hourglass mode u on a cell: 0.02 E t (dx/dy + dy/dx) / 2 x 4 u, whatever the size of the cell."""
    shell = graded_shell(edge="fixed")
    shell.set_shape(np.zeros(shell.count), np.full(shell.count, 1e-3))
    state = np.zeros((shell.count, 3))
    j, i = np.divmod(np.arange(shell.count), shell.nx)
    inner = ~shell.boundary
    state[inner, 0] = 1e-6 * np.where((i + j) % 2, 1.0, -1.0)[inner]
    force = np.append(shell.inner_force(state)[:-1], 0.0)[shell._numbering.dof[:, 0]]
    cell = (shell.ny // 2) * (shell.nx - 1) + np.arange(4, shell.nx - 5)
    node = (shell.ny // 2) * shell.nx + np.arange(4, shell.nx - 5)
    shape = shell.cell_x / shell.cell_y + shell.cell_y / shell.cell_x
    around = [shape[cell + step] for step in (0, -1, -shell.nx + 1, -shell.nx)]
    expected = HOURGLASS * ALUMINIUM.young * 1e-3 * 0.5 * sum(around) * 4e-6 * np.where((i + j)[node] % 2, 1.0, -1.0)
    assert force[node] == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize(("edge", "sag"), [("free", 5.218e-3), ("fixed", 3.783e-3)])
def test_flat_sheet_on_graded_lines(edge: str, sag: float) -> None:
    """Square of 250 mm, 400 N in the centre, E 70 GPa, nu 0.33: facet shell elements of a refined mesh."""
    shell = Shell((0.25, 0.25), 0.25 / 40, Elastic(70e9, 0.33), 1e-3, edge=edge)  # type: ignore[arg-type]
    lines = graded_lines(0.25, 40, -40e-3, 40e-3, GRADING)
    shell.move_lines(lines, lines)
    found = shell.solve(shell.load_patch(0.0, 0.0, 0.0), np.array([0.0, 0.0, -400.0]))
    lowest = -float(found.state[:, 2].min())
    # 3 %: the load is spread over 6 mm
    assert lowest == pytest.approx(sag, rel=0.03)


def test_target_cone_is_soft_enough_along_x() -> None:
    """Ren 2018, table 4.6: 0.62 / 1.11 mm at 200 / 600 N, within 30 %; Z 2.71 / 5.09 mm within 5 %."""
    shell = Shell((0.25, 0.25), 0.25 / 40, ALUMINIUM, 1e-3)
    lines = graded_lines(0.25, 40, -40e-3, 40e-3, GRADING)
    shell.move_lines(lines, lines)
    opening, angle, height = 36e-3, np.radians(50.0), 21e-3
    r = np.hypot(shell.node_x, shell.node_y)
    slope = np.where((r < opening) & (r > opening - height / np.tan(angle)), angle, 0.0)
    shell.set_shape(-np.clip((opening - r) * np.tan(angle), 0.0, height), 1e-3 * np.cos(slope))
    patch = shell.load_patch(16e-3, 0.0, 3.5e-3)
    for axis, published, within in ((2, (2.71e-3, 5.09e-3), 0.05), (0, (0.62e-3, 1.11e-3), 0.30)):
        for force, reported in zip((200.0, 600.0), published, strict=True):
            load = np.zeros(3)
            load[axis] = -force
            assert abs(shell.solve(patch, load).displacement[axis]) == pytest.approx(reported, rel=within)


def test_moved_lines_carry_linear_fields() -> None:
    """Height, thickness and values on the nodes that are linear over the sheet arrive exactly."""
    shell = graded_shell(-30e-3, 30e-3)
    shell.set_shape(0.1 * shell.node_x - 0.2 * shell.node_y, 1e-3 + 1e-3 * shell.node_x)
    x, y = graded_lines(LENGTH, 24, -20e-3, 50e-3, GRADING), graded_lines(LENGTH, 24, -40e-3, 10e-3, GRADING)
    carried = shell.onto_lines(x, y)(shell.node_x)
    shell.move_lines(x, y)
    assert carried == pytest.approx(shell.node_x, abs=1e-15)
    assert shell.height == pytest.approx(0.1 * shell.node_x - 0.2 * shell.node_y, abs=1e-15)
    assert shell.thickness == pytest.approx(1e-3 + 1e-3 * shell.node_x, abs=1e-15)


def test_linear_weights_hold_the_border() -> None:
    lines = np.array([0.0, 1.0, 3.0])
    assert linear_weights(lines, np.array([-1.0, 2.0, 9.0])) @ lines == pytest.approx([0.0, 2.0, 3.0])


def test_samples_on_the_lines_keep_planes() -> None:
    surface = flat_surface((LENGTH, LENGTH), 0.5e-3)
    lines = graded_lines(LENGTH, 30, -10e-3, 40e-3, GRADING)
    x = surface.x0 + surface.h * np.arange(surface.height.shape[1])
    surface.height[...] = 0.3 * x - 0.1 * x[:, None]
    # middles of the windows are at nodes of the fine grid, at most half a cell of it away
    assert sample(surface, lines, lines)[0][4:-4, 4:-4] == pytest.approx(
        (0.3 * lines - 0.1 * lines[:, None])[4:-4, 4:-4], abs=0.4 * 0.25e-3 + 1e-9
    )


def test_region_follows_the_tool_and_the_opening_of_a_plate() -> None:
    region = no_region()
    assert grow_region(region, 30e-3, 0.0)
    assert not grow_region(region, 32e-3, 1e-3)
    assert grow_region(region, 20e-3, 0.0)
    assert region == pytest.approx(np.array([[13e-3, 37e-3], [-7e-3, 7e-3]]))
    surface = flat_surface((0.1, 0.1), 1e-3)
    assert opening_region(surface) is None
    surface.support[...] = 0.0
    surface.support[30:71, 20:61] = -np.inf
    assert opening_region(surface) == pytest.approx(np.array([[-34e-3, 14e-3], [-24e-3, 24e-3]]))


def test_coarse_lines_gather_where_the_plant_is_pressed() -> None:
    """After a loop of 20 mm radius off the middle the small cells are there, and the plant went on without a hitch."""
    rig = load_rig("ren2018")
    plant = SheetPlant(rig.clamp, load_material("AA5754-O"), 1e-3, 5e-3, 0.5e-3, rig.tool_1.compliance)
    for turn in np.linspace(0.0, 2.0 * np.pi, 150):
        plant.move(np.array([30e-3 + 20e-3 * np.cos(turn), 20e-3 * np.sin(turn), -3e-3]), np.zeros(2))
    assert plant.shell.cell_at(30e-3, 0.0) < 3.8e-3
    assert plant.shell.cell_at(-100e-3, 0.0) > 6e-3
    assert np.isfinite(plant.surface.height).all()
