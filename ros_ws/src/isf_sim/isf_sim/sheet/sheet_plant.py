"""The sheet under the forming tool: fine surface, coarse shell and the events that tie them together.

The kernel (:mod:`isf_sim.sheet.sheet_point`) moves the tool from tick to tick; every millimetre of depth or 16 mm of
way it asks for a coarse solution of the *actual* shape, every sixteenth of a loop for an update of the following base.
While the lower tool presses, the whole state is turned over (:mod:`isf_sim.sheet.turned_sheet`).
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass

import numpy as np
from isf_core.files.material import Material, forming_limit
from isf_core.files.rig import Clamp
from isf_core.geometry.height_map import HeightMap
from isf_core.thinned_sheet import ThinnedSheet
from isf_core.types import Array

from isf_sim.plant_constants import PlantConstants
from isf_sim.sheet import base_following
from isf_sim.sheet.bulge import bulge_overlay
from isf_sim.sheet.coarse_solution import carry_lines, carry_out, make_order
from isf_sim.sheet.control_points import (
    CAPACITY,
    DUE,
    HEIGHT,
    LEAD,
    OFF_TIES,
    UNDER_WAY,
    ControlPoints,
    add_point,
    nearest_point,
    no_control_points,
)
from isf_sim.sheet.point_bundle import PointParts
from isf_sim.sheet.role import Role, first_role
from isf_sim.sheet.sheet_point import (
    DONE,
    LAST_BASE,
    LOOP,
    NEEDS_RESULT,
    NEEDS_SOLUTION,
    PRESSED,
    TRAVELLED,
    Contact,
    PointConstants,
    no_contact,
)
from isf_sim.sheet.shell_region import grow_region, no_region, opening_region, region_lines
from isf_sim.sheet.squeeze import SQUEEZED_THINNEST, SqueezeConstants, indentation_stiffness, lasting_indentation
from isf_sim.sheet.surface import LONG_AGO, Surface, TipTrack, bilinear_grid, empty_track, flat_surface
from isf_sim.sheet.thickness import limit_margin, thickness_map
from isf_sim.shell.shell import Elastic, Shell
from isf_sim.shell.shell_lines import Grading
from isf_sim.shell.solution_worker import SolutionWorker
from isf_sim.variant import Variant

SMALLEST_FORCE = 30.0
"""N, force of a coarse solution at first touch, when none is known yet."""
MAXIMUM_CELLS = 40
"""Cells of the coarse shell along the longer side: large blanks have larger cells at the clamp."""
BESIDE = 15.0e-3
"""m of flange that is told with the thickness of what was formed."""
MOST_NODES = 40_000
"""Nodes of which the thickness is told; of more every second, or third, in both directions."""
RELATED = 30.0e-3
"""m, distance (depth counts threefold) within which an earlier solution is a good start."""


@dataclass(frozen=True)
class LowerTool:
    """Ball radius m and compliance (3,) m/N of the lower tool, which may press as well."""

    radius: float
    compliance: tuple[float, float, float]


@dataclass
class Aside:
    """What waits while the other tool presses: its track, its path (4,) m as in Contact, its flag of a support."""

    track: TipTrack
    path: Array
    holder: Array


class SheetPlant:
    """State of one blank under an upper tool of ``radius`` m, and a ``lower`` one that may press instead.

    Attributes
    ----------
    surface, track, contact, points : state arrays, shared with the kernels; turned over while the lower tool presses
    role : Role, which tool presses ; aside : Aside
    shell : Shell ; material : perturbed Material ; thickness : m ; solve_time : s wall ; solutions : count
    """

    def __init__(
        self,
        clamp: Clamp,
        material: Material,
        thickness: float,
        radius: float,
        incremental_depth: float,
        compliance: tuple[float, float, float],
        *,
        variant: Variant | None = None,
        constants: PlantConstants | None = None,
        tip: Array | None = None,
        lower: LowerTool | None = None,
    ) -> None:
        variant = variant or Variant()
        self.constants = constants = constants or PlantConstants()
        self.thickness = thickness = thickness * variant.thickness
        self.material = material.model_copy(update={"young_modulus": material.young_modulus * variant.young_modulus})
        self.size = clamp.size
        self.shell = Shell(
            clamp.size,
            max(constants.coarse_cell, max(clamp.size) / MAXIMUM_CELLS),
            Elastic(self.material.young_modulus, self.material.poisson_ratio),
            thickness,
            edge=clamp.edge,
            edge_spring=variant.edge(clamp, constants.edge_spring)[0],
        )
        self.surface: Surface = flat_surface(clamp.size, constants.fine_cell)
        self.track: TipTrack = empty_track(clamp.size, constants.track_cell)
        self.contact: Contact = no_contact(np.array([0.0, 0.0, 0.1]) if tip is None else tip)
        self.points: ControlPoints = no_control_points()
        self.role: Role = first_role()
        self.aside = Aside(
            empty_track(clamp.size, constants.track_cell), np.array([0.0, LONG_AGO, 0.0, 0.0]), np.zeros(1)
        )
        upper = self._point_constants(radius, incremental_depth, compliance, variant)
        other = self._point_constants(lower.radius, incremental_depth, lower.compliance, variant) if lower else upper
        self.sides: tuple[PointConstants, PointConstants] = (upper, other)
        self.solve_time = 0.0
        self.solutions = 0
        self._states: list[Array] = []
        self._region = no_region()
        self.worker = SolutionWorker()
        self._parts = PointParts()
        self._asked = np.zeros(4)
        self._found: list[Array] = []

    @property
    def pressing(self) -> int:
        """The tool that presses: 1 upper, 2 lower."""
        return int(self.role.pressing[0])

    @property
    def point_constants(self) -> PointConstants:
        """Constants of the tool that presses."""
        return self.sides[self.pressing - 1]

    @property
    def radius(self) -> float:
        """m, ball of the tool that presses."""
        return self.point_constants.radius

    def move(self, tip: Array, pull: Array, eased: float = 0.0) -> None:
        """Move the pressing tool to ``tip`` (3,) m under the horizontal ``pull`` (2,) N of the support tool, whose
        squeeze takes ``eased`` N of tension (:func:`isf_sim.sheet.squeeze.eased_tension`)."""
        while True:
            request = self._parts.advance(
                tip, pull, eased, (self.surface, self.track, self.points, self.contact, self.point_constants)
            )
            if request == DONE:
                return
            self.serve(request, tip)

    def set_support(self, height: Array, offset: float = 0.0) -> None:
        """Put a rigid one-sided surface under the sheet, or move it.

        ``height`` (ny, nx) m on the nodes of ``surface``, -inf where there is none: the surface that the *lower*
        face of the sheet would touch, in frame ``sheet``. The lower face of the flat blank is at
        ``-plant.thickness``, so a backing plate flush with the clamp stands at that height. ``offset`` m is added
        to it; calling again with the same array and another offset raises a die towards the sheet (TPIF).

        Raises
        ------
        ValueError : wrong shape, or values that are NaN or +inf
        """
        self.drop_pending()
        surface = self.surface
        height = np.asarray(height, dtype=float)
        if height.shape != surface.height.shape:
            raise ValueError(f"support is {height.shape}, the sheet's grid {surface.height.shape}")
        if np.isnan(height).any() or np.isposinf(height).any() or not math.isfinite(offset):
            raise ValueError("heights of the support must be finite or -inf, its offset finite")
        moved, new = surface.holder[1] != offset, not surface.holder[0]
        surface.support[...] = height + self.thickness
        surface.holder[:] = (1.0 if np.isfinite(height).any() else 0.0, offset)
        if moved or not surface.holder[0]:
            self.points.used[0] = 0  # solutions over another support are no solutions any more
        opening = opening_region(surface) if new else None
        if opening is not None:
            self._region[...] = opening
            carry_lines(self._lines(), self.shell, self._states)

    def serve(self, request: int, tip: Array) -> None:
        """Do what the kernel asked for at ``tip`` (3,) m."""
        started = time.perf_counter()
        if request == NEEDS_SOLUTION:
            self._begin_solution(tip)
        elif request == NEEDS_RESULT:
            self._take_solution()
        else:
            self.update_base()
        self.solve_time += time.perf_counter() - started

    def update_base(self) -> None:
        """Let the base enclosed by the last loop follow the tool."""
        path = self.contact.path
        path[LAST_BASE] = path[TRAVELLED]
        pillow = self.constants.base_pillow * self.thickness
        base_following.follow(self.surface, self.track, path[PRESSED], path[LOOP], pillow, self.radius)

    def measured_shape(self, spacing: float = 1.0e-3) -> HeightMap:
        """Unloaded upper surface as a scanner sees it: Z and the bulge overlay, on a grid of ``spacing`` m.

        In frame ``sheet``, whichever tool presses.
        """
        self.update_base()
        strength = self.constants.bulge_strength(self.thickness, self.radius)
        coarse = max(1, round(self.constants.track_cell / self.surface.h))
        overlay = bulge_overlay(self.surface, coarse, strength, self.thickness, self.material)
        stride = max(1, round(spacing / self.surface.h))
        z = self.surface.height[::stride, ::stride]
        rows, columns = (stride / coarse * np.arange(n, dtype=np.float64) for n in z.shape)
        bulge = np.empty(z.shape)
        bilinear_grid(overlay, rows, columns, bulge)
        x = self.surface.x0 + stride * self.surface.h * np.arange(z.shape[1], dtype=np.float64)
        y = self.surface.y0 + stride * self.surface.h * np.arange(z.shape[0], dtype=np.float64)
        return HeightMap(x, y, (z + bulge) if self.pressing == 1 else -(z + bulge))

    def thinned_sheet(self, shape: HeightMap, squeeze: SqueezeConstants) -> ThinnedSheet | None:
        """Thickness and margin of what was formed and BESIDE m around it, on the nodes of ``shape``, which is the
        present :meth:`measured_shape`; None while nothing is formed."""
        surface = self.surface
        rows, columns = (np.flatnonzero(surface.formed.any(axis=axis)) for axis in (1, 0))
        if not rows.size:
            return None
        drawn = thickness_map(surface, self.thickness)
        thickness = np.maximum(drawn - lasting_indentation(surface, squeeze), SQUEEZED_THINNEST * drawn)
        margin = limit_margin(surface, self.thickness, forming_limit(self.material)) - np.log(drawn / thickness)
        stride = max(1, round((shape.x[1] - shape.x[0]) / surface.h))
        beside = round(BESIDE / surface.h)
        j, i = (
            np.arange(max(nodes[0] - beside, 0) // stride, min((nodes[-1] + beside) // stride + 1, count))
            for nodes, count in zip((rows, columns), shape.z.shape, strict=True)
        )
        thinned = math.ceil(math.sqrt(len(j) * len(i) / MOST_NODES))
        j, i = j[::thinned], i[::thinned]
        points = np.stack([*np.meshgrid(shape.x[i], shape.y[j]), shape.z[np.ix_(j, i)]], axis=-1)
        nodes = np.ix_(stride * j, stride * i)
        return ThinnedSheet(points, thickness[nodes], margin[nodes])

    def forget_solutions(self) -> None:
        """Drop the control points: the sheet is loaded in another way from now on."""
        self.drop_pending()
        self.points.used[0] = 0
        self._states = []

    # -- coarse solution -----------------------------------------------------------------------------

    def _begin_solution(self, tip: Array) -> None:
        """Begin the solution for a control point at ``tip`` (3,) m with the sheet as it is now."""
        shell, contact, pending, states = self.shell, self.contact, self.points.pending, self._states
        grown = grow_region(self._region, tip[0], tip[1])
        axial = self._expected_force(tip)
        order = make_order(
            self.surface,
            self._lines() if grown else (shell.x, shell.y),
            self.thickness,
            (float(tip[0]), float(tip[1])),
            np.array([contact.lateral[0], contact.lateral[1], -axial]),
            0.7 * self.radius,
            self._start(tip, axial),
        )
        pending[UNDER_WAY], pending[DUE] = 1.0, contact.path[TRAVELLED] + LEAD
        self._asked[:] = tip[0], tip[1], pending[HEIGHT], axial
        self.worker.begin(lambda: carry_out(order, shell, states))
        self.solutions += 1

    def _expected_force(self, tip: Array) -> float:
        """N, axial force for which a control point at ``tip`` (3,) m is computed: the present one.

        A tool that comes down again has none yet. What the sheet bore nearby is nearer to what it will bear than
        nothing: a law computed for 30 N and extrapolated to 3 kN took 14 % more force where contours begin.
        """
        present = float(self.contact.axial[0])
        if present <= 0.0:
            nearest, square = nearest_point(self.points, tip)
            if nearest >= 0 and square <= RELATED**2:
                present = float(self.points.force[nearest])
        return max(present, SMALLEST_FORCE)

    def settle(self) -> None:
        """Wait for a solution under way: what changes is complete then, and nothing else works on it."""
        deflection = self.worker.wait()
        if deflection is not None:
            self._found = [deflection.state, deflection.displacement, np.array([deflection.axial_compliance])]

    def _take_solution(self) -> None:
        """Make the solution under way a control point."""
        self.settle()
        state, displacement, compliance = self._found
        self.points.pending[UNDER_WAY] = 0.0
        self._keep(self._asked[:3].copy(), float(self._asked[3]), state, displacement, float(compliance[0]))

    def drop_pending(self) -> None:
        """Drop a solution under way: the sheet it was begun for is another one."""
        self.settle()
        self.points.pending[UNDER_WAY] = 0.0

    def _lines(self) -> tuple[Array, Array]:
        """(nx,), (ny,) m, where the forming region asks for the lines of the coarse shell."""
        constants = self.constants
        return region_lines(
            self.shell, self._region, Grading(constants.forming_cell, constants.cell_growth, constants.flange_cell)
        )

    def _start(self, tip: Array, axial: float) -> tuple[int, float]:
        """Number of the nearest earlier solution and its scale to the present force; negative when there is none."""
        nearest, square = nearest_point(self.points, tip)
        if nearest < 0 or square > RELATED**2:
            return -1, 0.0
        return nearest, math.sqrt(axial / self.points.force[nearest])

    def _keep(self, tip: Array, axial: float, state: Array, displacement: Array, compliance: float) -> None:
        """Add a control point; older ones close by, or far above or below, are dropped."""
        constants = self.constants
        below_grid = self._local_compliance(self.shell.cell_at(tip[0], tip[1])) - self.point_constants.local_compliance
        near = (0.6 * constants.fresh_distance - OFF_TIES) ** 2
        tall = 2.5 * constants.fresh_depth - OFF_TIES
        give, chosen = max(float(below_grid), 0.0), np.empty(CAPACITY, dtype=np.int64)
        kept = add_point(self.points, tip, axial, displacement, compliance, give, near, tall, chosen)
        self._states = [self._states[k] for k in chosen[:kept].tolist()] + [state]

    def _point_constants(
        self, radius: float, incremental_depth: float, compliance: tuple[float, float, float], variant: Variant
    ) -> PointConstants:
        constants = self.constants
        amplitude = (
            constants.force_factor
            * variant.force_level
            * (self.material.tensile_strength / 1e6)
            * (self.thickness * 1e3) ** 1.57
            * (2e3 * radius) ** 0.41
        )
        return PointConstants(
            radius=radius,
            amplitude=amplitude,
            step=incremental_depth,
            friction=self.material.friction * variant.friction,
            tangential_share=constants.tangential_share,
            exponent=constants.force_exponent,
            wrap_exponent=constants.wrap_exponent,
            compliance=np.array(compliance) * variant.compliance,
            local_compliance=self._local_compliance(constants.forming_cell),
            die_stiffness=self._die_stiffness(radius),
            window=constants.window_radii * radius,
            lag_length=constants.lag_length,
            fresh_depth=constants.fresh_depth,
            fresh_distance=constants.fresh_distance,
        )

    def _local_compliance(self, cell: float) -> float:
        """m/N, axial compliance of the sheet below the scale of a coarse cell of ``cell`` m."""
        rigidity = self.material.young_modulus * self.thickness**3 / (12.0 * (1.0 - self.material.poisson_ratio**2))
        return cell**2 / (16.0 * math.pi * rigidity)

    def _die_stiffness(self, radius: float) -> float:
        """N/m, plastic indentation of the sheet between the tool and a rigid, nearly flat support."""
        flow = 0.5 * self.constants.flow_factor * (self.material.yield_strength + self.material.tensile_strength)
        return indentation_stiffness(radius, 1e3 * radius, flow, self.constants.indentation_factor)
