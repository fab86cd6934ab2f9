"""The elasto-plastic sheet of a job as the machine meets it: tips in, forces out; what a scanner sees of it.

Frame ``sheet``: the upper face of the flat blank is at z = 0.
"""

from __future__ import annotations

import copy
import math
import time
from dataclasses import dataclass

import numpy as np
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.bounded import read_content
from isf_core.files.job import METRES, JobFile
from isf_core.files.material import Material, forming_limit
from isf_core.files.mesh_parser import LARGEST, parse_mesh
from isf_core.files.rig import Clamp
from isf_core.files.tooling import ToolSpec
from isf_core.geometry.height_map import HeightMap
from isf_core.simulated_sheet import SheetKind, default_sheet
from isf_core.thinned_sheet import ThinnedSheet
from isf_core.types import Array
from numpy.typing import NDArray
from scipy.interpolate import griddata

from isf_sim.explicit_shell.grid import graded_lines
from isf_sim.explicit_shell.library import LANES
from isf_sim.explicit_shell.shell import Ball, Edge, ExplicitShell, Kept, Sheet, Support
from isf_sim.explicit_shell.strength import Strength, from_tip
from isf_sim.plant_constants import PlantConstants
from isf_sim.scanner import kept_by_trimming
from isf_sim.sheet.surface import Surface
from isf_sim.variant import Variant

AWAKE = 1.0e-3
"""m between a tool and the nodes of a sheet, beyond which it is not computed while it is at rest."""

ROOM = 0.25e-3
"""m between a tool and the faces of the sheet, beyond which that holds where large cells have their nodes further away:
more than the way of a tick."""

STILL_ENERGY = 1.0e-7
"""J, kinetic energy of a sheet that is at rest."""

MOST_CELLS = 56
"""Cells of the even region along its longer side: a larger part has larger cells."""

FIDELITY: dict[str, tuple[float, float, float]] = {
    "shell_coarse": (1.4, 2.0, 4.0),
    "shell": (1.0, 1.0, 1.0),
    "shell_fine": (1 / 1.5, 0.5, 0.5),
}
"""Per kind of sheet: factors on the size of the cells, on the speed of one tool, on that of two along the sheet."""

LARGEST_CELL = 1.5
"""Radii of the smallest ball, or rounding of a flat tip, that a cell of the even region may be long (chosen)."""

GLANCE = 8
"""Moves between two looks at the kinetic energy of a sheet with a tool on it."""

INSPECTION = 32
"""Moves between two looks at elements and energy, which cost about as much as a step of the model."""

ENERGY_ERROR = (0.1, 0.5)
"""Share of the work of the tools, and J, by which the plastic work may be larger than that work (chosen)."""

REST_ERROR = 5.0e-5
"""m from equilibrium, beyond which a sheet that should rest does not."""

FORMED_STRAIN = 0.01
"""Plastic strain of the middle layer from which on a place counts as formed."""


@dataclass
class LastGood:
    """A sheet as it was when it passed its last inspection.

    Attributes
    ----------
    shell : Kept ; bending, touched : of its strength ; work, kinetic : J, work of the tools, largest kinetic energy
    """

    shell: Kept
    bending: Array
    touched: Array
    work: float
    kinetic: float


class FormedSheet:
    """A fresh blank of ``job_file``, a sheet of ``kind`` in ``variant``.

    It lies over the heights ``support`` (ny, nx) m on the grid of ``surface``.

    Attributes
    ----------
    shell : ExplicitShell ; thickness : m, of the flat blank ; cpu : s of the processor spent on it
    raised : m by which the support shall stand higher after the next move (TPIF: the blank holder came down)
    largest_kinetic : J, largest kinetic energy so far
    strength : of the sheet, and what of it is used up

    Raises
    ------
    IsfError : SHEET_MESH_COARSE for a tool too small for its cells
    """

    def __init__(
        self,
        job_file: JobFile,
        kind: SheetKind,
        material: Material,
        thickness: float,
        variant: Variant,
        constants: PlantConstants,
        surface: Surface,
        support: Array | None,
    ) -> None:
        job, rig = job_file.job, job_file.rig
        self.thickness = thickness
        self.kind = kind
        coarseness, haste, haste_of_two = FIDELITY[kind]
        even = _part_region(job_file, job.tool_1.radius)
        smallest, flat = min((tool.ball_radius, tool.flat_radius) for tool in (job.tool_1, job.tool_2) if tool)
        cell = coarseness * max(constants.shell_cell_radii * smallest, float(np.ptp(even, axis=1).max()) / MOST_CELLS)
        if cell > LARGEST_CELL * smallest:
            tip = "a tool" if flat == 0.0 else "a tip with a corner"
            other = "fast, " if default_sheet(job) == "fast" else ""
            raise IsfError(
                ErrorCode.SHEET_MESH_COARSE,
                f"cells of {1e3 * cell:.1f} mm for this part are too large for {tip} of radius {1e3 * smallest:g} mm",
                where=f"--sheet {kind}",
                advice=f"take a finer --sheet, {other}or a larger tool",
            )
        x, y = (
            graded_lines(
                -0.5 * size,
                0.5 * size,
                _inside(region, size),
                cell,
                max(cell, coarseness * constants.shell_flange_cell),
                LANES,
            )
            for size, region in zip(rig.clamp.size, even, strict=True)
        )
        self.shell = ExplicitShell(
            x,
            y,
            sheet_of(material, thickness, variant),
            edge_of(rig.clamp, constants, variant),
            friction=material.friction * variant.friction,
            tool_speed=haste_of_two * constants.shell_speed if job.tool_2 else haste * constants.shell_speed_alone,
            plunge_speed=haste * constants.shell_plunge_speed,
            withdrawal_speed=min(1.0, haste) * constants.shell_plunge_speed,
            damping=constants.shell_damping,
        )
        self.shell.state.position[2] = -0.5 * thickness
        far = np.array([0.0, 0.0, 1.0])
        self.shell.set_tool(0, _tip(job.tool_1, 1, np.array(rig.tool_1.compliance) * variant.compliance), far)
        if job.tool_2 is not None:
            self.shell.set_tool(1, _tip(job.tool_2, -1, np.array(rig.tool_2.compliance) * variant.compliance), -far)
        if support is not None:
            self.shell.set_support(Support(support, surface.x0, surface.y0, surface.h))
        self.strength = Strength(self.shell, forming_limit(material), constants.window_radii * job.tool_1.radius)
        self._asleep = True
        self.cpu = self.largest_kinetic = self.raised = 0.0
        self._moves, self._work = 0, 0.0
        self._good = LastGood(
            self.shell.keep(), self.strength.bending.copy(), self.strength.touched.copy(), self._work, 0.0
        )
        self._shift = np.zeros((2, 3))  # m, of the tools in the model, from where they are in the machine

    def move(self, tips: Array) -> Array:
        """Move the tools straight to ``tips`` (2, 3) m; forces (2, 3) N of the sheet on them.

        A sheet whose model fails goes back to how it passed its last inspection, at rest, and the tools with it: from
        there they go the ways that they are moved, until they are clear of the sheet and where they should be.

        Raises
        ------
        IsfError : SHEET_MODEL_FAILED, the model became unstable, an element is folded over, or energy came from nowhere
        """
        try:
            return self._move(tips)
        except IsfError as failure:
            self._go_back(tips)
            back = f"the sheet is kept as it was {self._moves % INSPECTION or INSPECTION} ticks before"
            raise IsfError(
                failure.code, f"{failure.what}; {back}", where=failure.where, advice=failure.advice
            ) from failure

    def _move(self, tips: Array) -> Array:
        started = time.thread_time()
        tools = self.shell.tools
        if self._shift.any():
            if self._any_near(tips + self._shift) or self._any_near(tips):
                tips = tips + self._shift
            else:
                self._shift[:] = 0.0
                self.shell.place_tools(tips)
        near = self._any_near(tips)
        if not near and self._asleep and self.raised == self.shell.raised:
            self.shell.place_tools(tips)
            return np.zeros((2, 3))
        if self.raised != self.shell.raised:
            self._work = math.inf  # the holder works on the sheet too: nothing is known of the sum
        beside = self.shell.beside
        forces = self.shell.move(tips, raised=self.raised)
        done = float((forces * (tools["end"] - tools["begin"])).sum())
        self._work -= done
        self._moves += 1
        kinetic = 0.0 if near and self._moves % GLANCE else self.shell.kinetic_energy
        if not math.isfinite(done + kinetic):
            raise self._unstable(tips)
        self.largest_kinetic = max(self.largest_kinetic, kinetic)
        self._asleep = not near and kinetic < STILL_ENERGY
        if self._moves % INSPECTION == 0:
            self._inspect()
        self.cpu += time.thread_time() - started + self.shell.beside - beside
        return forces

    @property
    def forces(self) -> Array:
        """(2, 3) N, of the sheet on the tools in the last move."""
        return np.array(self.shell.tools["mean"])

    def unloaded(self) -> ExplicitShell:
        """The sheet at rest without tools; the one in the machine stays as it is.

        Raises IsfError SHEET_MODEL_FAILED when it does not come to rest.
        """
        shell = copy.deepcopy(self.shell)
        shell.tools["radius"] = 0.0
        return self._at_rest(shell)

    def released(self, surface: Surface) -> ExplicitShell:
        """The sheet at rest out of the clamp, trimmed round what is formed on ``surface``.

        Raises IsfError SHEET_MODEL_FAILED when it does not come to rest.
        """
        shell = copy.deepcopy(self.shell)
        x, y = np.meshgrid(*(0.5 * (line[1:] + line[:-1]) for line in (shell.x, shell.y)))
        shell.release(kept_by_trimming(np.column_stack([x.ravel(), y.ravel()]), surface).reshape(x.shape))
        return self._at_rest(shell)

    def measured_shape(self, shell: ExplicitShell | None = None, spacing: float = 1.0e-3) -> HeightMap:
        """Upper face of ``shell``, or of the sheet in the clamp without load, every ``spacing`` m of the free sheet."""
        shell = shell or self.unloaded()
        x, y, z = shell.upper_face()
        low, high = (np.array([line[k] for line in (shell.x, shell.y)]) for k in (0, -1))
        grid_x, grid_y = (np.arange(a, b + 0.5 * spacing, spacing) for a, b in zip(low, high, strict=True))
        heights = griddata(
            np.column_stack([x, y]), z, tuple(np.meshgrid(grid_x, grid_y)), method="cubic", fill_value=0.0
        )
        return HeightMap(grid_x, grid_y, heights)

    def thinned_sheet(self) -> ThinnedSheet:
        """Thickness and margin of the elements, at the middles of their upper faces as the sheet lies now."""
        shell = self.shell
        elements = len(shell.y) - 1, len(shell.x) - 1
        face = shell.upper_face().reshape(3, len(shell.y), len(shell.x))
        middles = 0.25 * (face[:, 1:, 1:] + face[:, 1:, :-1] + face[:, :-1, 1:] + face[:, :-1, :-1])
        return ThinnedSheet(
            np.ascontiguousarray(np.moveaxis(middles, 0, -1)),
            shell.state.thickness.reshape(elements).copy(),
            self.strength.margin(shell).reshape(elements),
        )

    def formed(self, surface: Surface) -> NDArray[np.int8]:
        """(ny, nx), 1 on the nodes of ``surface`` where the sheet has been formed."""
        shell = self.shell
        strained = shell.state.plastic_strain[2].reshape(len(shell.y) - 1, len(shell.x) - 1) > FORMED_STRAIN
        ny, nx = surface.height.shape
        i = np.clip(np.searchsorted(shell.x, surface.x0 + surface.h * np.arange(nx)) - 1, 0, strained.shape[1] - 1)
        j = np.clip(np.searchsorted(shell.y, surface.y0 + surface.h * np.arange(ny)) - 1, 0, strained.shape[0] - 1)
        return strained[np.ix_(j, i)].astype(np.int8)

    def _inspect(self) -> None:
        if (folded := self.shell.inverted_element()) is not None:
            raise self._failed(f"is folded over at {np.round(1e3 * folded, 1).tolist()} mm")
        (share, room), plastic = ENERGY_ERROR, self.shell.plastic_work
        if plastic > (1.0 + share) * self._work + room:
            row, column = divmod(int(np.argmax(self.shell.state.plastic_work)), len(self.shell.x) - 1)
            place = [round(1e3 * float(value), 1) for value in (self.shell.x[column], self.shell.y[row])]
            raise self._failed(
                f"took {plastic:.1f} J as plastic work, tools gave it {self._work:.1f} J; most is at {place} mm"
            )
        self._keep()

    def _keep(self) -> None:
        good, strength = self._good, self.strength
        self.shell.keep(good.shell)
        np.copyto(good.bending, strength.bending)
        np.copyto(good.touched, strength.touched)
        good.work, good.kinetic = self._work, self.largest_kinetic

    def _go_back(self, tips: Array) -> None:
        """The sheet is as it was at its last inspection, the tools being at ``tips`` (2, 3) m in the machine."""
        good, strength = self._good, self.strength
        self.shell.go_back(good.shell)
        np.copyto(strength.bending, good.bending)
        np.copyto(strength.touched, good.touched)
        # the sheet gives work back to the tools that are lifted from it: no sum of theirs can be held against it now
        self._work, self.largest_kinetic, self.raised = math.inf, good.kinetic, self.shell.raised
        for shift, tool, tip in zip(self._shift, self.shell.tools, tips, strict=True):
            if tool["radius"] > 0.0:
                shift[:] = tool["end"] - (0.0, 0.0, tool["side"] * tool["radius"]) - tip
        self._asleep = False
        strength.judge(self.shell)

    def _at_rest(self, shell: ExplicitShell) -> ExplicitShell:
        if (away := shell.settle()) > REST_ERROR:
            raise self._failed(f"does not come to rest: {1e3 * away:.2g} mm away from equilibrium")
        return shell

    def _unstable(self, tips: Array) -> IsfError:
        """With the place of the first node without numbers, if there is one, and the tools at ``tips`` (2, 3) m."""
        shell, place = self.shell, ""
        lost = ~(np.isfinite(shell.state.position) & np.isfinite(shell.state.velocity)).all(axis=0)
        if lost.any():
            row, column = divmod(int(np.argmax(lost)), len(shell.x))
            place = f" at {[round(1e3 * float(value), 1) for value in (shell.x[column], shell.y[row])]} mm"
        return self._failed(f"became unstable{place} with the tools at {np.round(1e3 * tips, 2).tolist()} mm")

    def _failed(self, how: str) -> IsfError:
        return IsfError(
            ErrorCode.SHEET_MODEL_FAILED,
            f"the sheet model {how}",
            where=f"--sheet {self.kind}",
            advice="check that the tools do not press through the sheet or into its support; try smaller cells",
        )

    @property
    def kinetic_over_plastic(self) -> float:
        """Largest kinetic energy so far over the plastic work: little where the tools move slowly enough."""
        work = self.shell.plastic_work
        return self.largest_kinetic / work if work > 0.0 else 0.0

    def values(self) -> dict[str, object]:
        """For a summary: what stands behind the numbers of a run."""
        return {
            "model": self.kind,
            "elements": int(self.shell.state.thickness.size),
            "kinetic_over_plastic": self.kinetic_over_plastic,
            "cpu_s": round(self.cpu, 2),
        }

    def _any_near(self, tips: Array) -> bool:
        """Whether a tool touches the sheet, or may do so soon with the tools at ``tips`` (2, 3) m."""
        tools = self.shell.tools
        return any(
            tools["touching"][number] > 0 or self._near(number, tip)
            for number, tip in enumerate(tips)
            if tools["radius"][number] > 0.0
        )

    def _near(self, number: int, tip: Array) -> bool:
        """Whether tool ``number`` with its ``tip`` (3,) m may touch the sheet soon: by its distance from the nearest
        node and by how much nearer the sheet may be to it between the nodes."""
        shell = self.shell
        tool = shell.tools[number]
        centre = np.array([tip[0], tip[1], tip[2] + tool["side"] * tool["radius"]])
        square = (from_tip(tool, shell.state.position - centre[:, None]) ** 2).sum(axis=0)
        nearest, reach = int(square.argmin()), float(tool["radius"]) + 0.5 * self.thickness
        row, column = divmod(nearest, len(shell.x))
        half = 0.5 * math.hypot(_longest_beside(shell.x, column), _longest_beside(shell.y, row))
        between = math.hypot(reach, half) - reach
        return float(np.sqrt(square[nearest])) - reach < max(AWAKE, between + ROOM)


def _tip(tool: ToolSpec, side: int, compliance: Array) -> Ball:
    return Ball(tool.ball_radius, side, flat=tool.flat_radius, compliance=tuple(compliance))


def edge_of(clamp: Clamp, constants: PlantConstants, variant: Variant) -> Edge:
    """How ``clamp`` holds the sheet: fixed, or by a spring that slides beyond the friction of the clamp."""
    return Edge() if clamp.edge == "fixed" else Edge(*variant.edge(clamp, constants.edge_spring))


def sheet_of(material: Material, thickness: float, variant: Variant) -> Sheet:
    """Sheet of ``material``, ``thickness`` m, with the flow curve of ``variant``."""
    strain = np.concatenate([[0.0], np.geomspace(1e-4, 4.0, 400)])
    return Sheet(
        material.young_modulus,
        material.poisson_ratio,
        thickness,
        strain,
        variant.force_level * variant.flow_stress(material, strain),
        kinematic=material.kinematic_hardening or 0.0,
    )


def _part_region(job_file: JobFile, radius: float) -> Array:
    """(2, 2) m, x and y from and to, of the part's mesh with room for the tool; the middle half of the free sheet for
    programs and for files that cannot be read here."""
    part, clamp = job_file.job.part, np.array(job_file.rig.clamp.size)
    half = 0.25 * clamp
    try:
        if part is None:
            raise ValueError("a program")
        path = job_file.base / part.mesh
        kind = path.suffix.lower().lstrip(".")
        mesh = parse_mesh(read_content(path, LARGEST[kind]), kind)
        size = np.ptp(mesh.bounds, axis=0) * (METRES[part.unit] if part.unit else 1e-3) * part.scale
        if "x" in part.up or "y" in part.up or any(part.turn):
            size = np.full(3, size.max())
        half = 0.5 * size[:2] + 2.0 * radius
    except Exception:  # whatever a loader raises: the planner says what is wrong with a part
        pass
    place = np.array(job_file.job.place) if job_file.job.place is not None else np.zeros(2)
    return np.stack([place - half, place + half], axis=1)


def _longest_beside(line: Array, k: int) -> float:
    """m, the longer one of the cells on both sides of coordinate ``k`` of ``line``."""
    return float(np.diff(line[max(0, k - 1) : k + 2]).max())


def _inside(region: Array, size: float) -> tuple[float, float]:
    margin = min(5.0e-3, 0.05 * size)
    return max(float(region[0]), -0.5 * size + margin), min(float(region[1]), 0.5 * size - margin)
