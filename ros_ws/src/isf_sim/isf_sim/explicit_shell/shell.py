"""An elasto-plastic sheet of explicit shell elements and the state it is in; the kernels are in shell.c.

Time is not that of the process: the tool is moved at several metres per second, a thousand times faster than in a cell,
and all elements have the same time step by their mass. What makes the result that of the slow process is that kinetic
energy stays small against plastic work, which every run reports.
"""

from __future__ import annotations

import copy
import ctypes
import math
from dataclasses import dataclass, field
from enum import IntFlag
from itertools import pairwise
from typing import Any

import numpy as np
from isf_core.types import Array
from numpy.typing import NDArray

from isf_sim.explicit_shell import library
from isf_sim.explicit_shell.library import LAYERS, TOOL, TOOLS, ShellStruct

STEP_SHARE = 0.7
"""Of the time a wave needs through the smallest element (assumed; 0.9 is the usual limit for flat elements)."""

CONTACT_SHARE = 0.2
"""Of the stiffness at which contact alone would reach the limit of the time step."""

SPRING_SHARE = 0.5
"""Of the mass over the square of the time step, which a spring of the edge may have at most (4: unstable alone)."""

CONTACT_DAMPING = 0.3
"""Of the critical one of the sheet's mass on the stiffness of contact: the sheet does not chatter on the tool."""

SMOOTHING = 0.02
"""Share of a new contact force in the one that bends the machine: 50 steps."""

REST_STEPS, LONGEST_REST = 1000, 400
"""Steps between two looks at a sheet that comes to rest, and the most of these."""

SETTLED, CALM_LOOKS = 2.0e-6, 3
"""m by which a sheet at rest may be away from equilibrium, and how many looks in a row must find it so."""

APPROACH = 5.0
"""Across the sheet a tool that does not touch it is this much slower than along it, for it would hit it."""

PLUNGE_SHARE = 0.02
"""Of the speed along the sheet, that across it in contact, unless told otherwise: the whole sheet has to follow, and
swings through once in some 10 ms."""

REST_DAMPING, WITHDRAWAL_DAMPING = 700.0, 500.0
"""1/s of every motion while tools stand, and while one leaves the sheet: about critical for the first mode of 250 mm of
it, and less, so that the sheet follows."""

STANDS, REST_BEGINS = 1.0e-6, 2
"""m by which a tool that stands may move, and after how many moves in which all stand a sheet that one has left comes
to rest: the other one would feel how it swings."""

REST_MOVES, REST_TIME = 4, 8.0e-3
"""Moves in which it does, and s that they take together: a machine that stands gives a sheet all the time it needs."""

AT_REST = 1.0e-5
"""J, kinetic energy of a sheet that needs no more of it: one of 250 mm swings by some 0.03 mm with that."""

WITHDRAWAL_START, WITHDRAWAL_RAMP = 0.1, 5.0e-3
"""Share of its speed at which a tool begins to leave the sheet, and s until it has all of it: the sheet follows without
swinging, so that the force over the way is that of a sheet at rest."""

SLIP_SHARE = 0.02
"""Of the speed of the tools, below which friction fades: a step in it would make the sheet ring."""

SLIDES = 2.0e-3
"""m by which the sheet may slide along a support (assumed): this near to its edge an element has more points."""

DRAG_SHARE = 0.3
"""Of the sheet's mass over the time step, what friction over the speed of slip may be at most (2: unstable alone)."""

TABLE_STEP, TABLE_END = 0.002, 4.0
"""Plastic strain, of the tabulated flow curve."""


class Freedom(IntFlag):
    """What a node can do: shifts along x, y, z, turns about them. The bits are those of shell.c."""

    X, Y, Z = 1, 2, 4
    TURN_X, TURN_Y, TURN_Z = 8, 16, 32
    SHIFTS, TURNS = 7, 56
    ALL = 63


@dataclass(frozen=True)
class Sheet:
    """What is formed.

    Attributes
    ----------
    young_modulus : Pa ; poisson_ratio ; density : kg/m^3 ; thickness : m
    plastic_strain, flow_stress : (n,), (n,) Pa, flow curve, linear between its points, flat after the last
    kinematic : share of its hardening, 0 to 0.99, that moves the yield surface (Prager 1956) in place of widening it
    """

    young_modulus: float
    poisson_ratio: float
    thickness: float
    plastic_strain: Array
    flow_stress: Array
    density: float = 2700.0
    kinematic: float = 0.0


@dataclass(frozen=True)
class Edge:
    """How the edge of the sheet is held; z and rotations are fixed.

    Attributes
    ----------
    spring : N/m^2, in-plane spring per length of edge (inf: fixed) ; limit : N/m, friction limit of the clamp
    """

    spring: float = np.inf
    limit: float = np.inf


@dataclass(frozen=True)
class Ball:
    """A tool: ``radius`` m of the ball or of the rounding of a flat end, ``flat`` m radius of the flat, 0 for a ball.

    ``side`` : 1 touches the upper face, -1 the lower one ; ``compliance`` (3,) m/N by which the machine gives way
    """

    radius: float
    side: int = 1
    flat: float = 0.0
    compliance: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass
class State:
    """Everything that changes; saved and restored as a whole. n nodes, e elements, in the order of shell.c.

    Attributes
    ----------
    position, velocity, spin : (3, n) m, m/s, 1/s ; anchor : (2, n) m
    thickness, plastic_work : (e,) m, J ; stress : (3 LAYERS, e) Pa ; plastic_strain : (LAYERS, e)
    shear : (2, e) Pa ; hourglass : (5, e) N, N m ; drilling : (4, e) N m
    back_stress : (3 LAYERS, e) Pa, (0, e) for isotropic hardening
    """

    position: Array
    velocity: Array
    spin: Array
    anchor: Array
    thickness: Array
    stress: Array
    plastic_strain: Array
    shear: Array
    hourglass: Array
    drilling: Array
    plastic_work: Array
    back_stress: Array


@dataclass
class Kept:
    """A sheet as it was, for :meth:`ExplicitShell.go_back`: ``state``, ``tools`` (2,) of library.TOOL, ``raised`` m."""

    state: State
    tools: NDArray[Any]
    raised: float


@dataclass
class Support:
    """A rigid surface under the sheet: heights (ny, nx) m at x0 + i spacing, y0 + j spacing; -inf: none there.

    ``offset`` m by which it stands higher now.
    """

    height: Array
    x0: float
    y0: float
    spacing: float
    offset: float = 0.0
    points: int = 3
    arrays: tuple[NDArray[Any], ...] = field(default_factory=tuple)


class ExplicitShell:
    """A flat sheet on the grid of lines ``x`` (nx + 1,), ``y`` (ny + 1,) m, at z = 0 (its middle surface).

    Attributes
    ----------
    x, y : lines ; sheet, edge ; state : State
    load : (3, n) N on the nodes, as long as it is not changed ; None: none
    step : s, time step ; steps : done so far ; tools : (2,) of library.TOOL
    tool_speed, plunge_speed, withdrawal_speed : m/s of the tools along the sheet, across it while they touch it, and
        straight away from it
    threads : that compute it, 1 or 2, with the same result ; beside : s of the processor that the second one took
    """

    def __init__(
        self, x: Array, y: Array, sheet: Sheet, edge: Edge | None = None, *, friction: float = 0.1,
        tool_speed: float = 20.0, plunge_speed: float | None = None, withdrawal_speed: float | None = None,
        damping: float = 600.0,
    ) -> None:  # fmt: skip
        self.x, self.y, self.sheet, self.edge = x, y, sheet, edge or Edge()
        self.tool_speed = tool_speed
        self.plunge_speed = PLUNGE_SHARE * tool_speed if plunge_speed is None else plunge_speed
        self.withdrawal_speed = self.plunge_speed if withdrawal_speed is None else withdrawal_speed
        dx, dy = np.meshgrid(np.diff(x), np.diff(y))
        shortest = np.minimum(dx, dy)
        wave = np.sqrt(sheet.young_modulus / (sheet.density * (1.0 - sheet.poisson_ratio**2)))
        self.step = float(STEP_SHARE * shortest.min() / wave)
        self.steps, self.threads, self.beside = 0, library.threads(), 0.0
        self.state = _flat(x, y, sheet)
        self.load: Array | None = None
        self._area = np.ascontiguousarray((dx * dy).ravel())
        per_area = sheet.density * sheet.thickness * (shortest.min() / shortest) ** 2
        corner = per_area * dx * dy / 4.0
        self._mass = _at_nodes(corner)
        turning = corner * np.maximum(sheet.thickness**2 / 12.0, dx * dy / 8.0)
        self._per_mass, self._per_inertia = 1.0 / self._mass, 1.0 / _at_nodes(turning)
        self._hold_edge()
        nodes, elements = self._mass.size, self._area.size
        self._scratch = np.zeros((3, nodes)), np.zeros((3, nodes)), np.zeros((24, elements))
        self._contact_scratch = (
            np.zeros((TOOLS + 1, 3, nodes)), np.zeros((TOOLS + 1, len(y)), dtype=np.uint8), np.zeros(elements)
        )  # fmt: skip
        strain = np.arange(0.0, TABLE_END + TABLE_STEP, TABLE_STEP)
        curve = np.interp(strain, sheet.plastic_strain, sheet.flow_stress)
        self._flow = curve[0] + (1.0 - sheet.kinematic) * (curve - curve[0])
        self._hardening = np.append(np.diff(self._flow) / TABLE_STEP, 0.0)
        self._damping, self._friction = damping, friction
        self._leaving = 0.0  # s since a tool began to leave the sheet straight
        self._left = False  # one has lost contact, and none has moved on the sheet since
        self._stood = 0  # moves in which all tools stood
        self._contact = CONTACT_SHARE * sheet.density * sheet.thickness / self.step**2
        self.tools = np.zeros(TOOLS, dtype=TOOL)
        self._support: Support | None = None
        self._built: ShellStruct | None = None
        self._alone = 0  # calls still to be made with one thread

    # -- what it is made of ------------------------------------------------------------------------

    def set_tool(self, number: int, ball: Ball, tip: Array) -> None:
        """Tool ``number`` (0, 1) with its ``tip`` (3,) m at rest, the end of the ball towards the sheet."""
        tool = self.tools[number]
        tool["radius"], tool["flat"], tool["side"] = ball.radius, ball.flat, ball.side
        tool["compliance"], tool["felt"] = ball.compliance, 0.0
        tool["begin"] = tool["end"] = _centre(ball.radius, ball.side, tip)
        tool["node"] = [
            int(np.clip(np.searchsorted(line, value), 0, len(line) - 1))
            for line, value in ((self.x, tip[0]), (self.y, tip[1]))
        ]

    def hold(self, held: NDArray[np.bool_], freedoms: Freedom = Freedom.Z | Freedom.TURNS) -> None:
        """Hold ``freedoms`` of the nodes ``held`` (ny + 1, nx + 1): deflection and slope, as a clamped edge does.

        What is held keeps the velocity that is written to ``state`` afterwards: so a motion is prescribed.
        """
        nodes = held.ravel()
        self._fixed |= np.where(nodes, int(freedoms), 0).astype(np.uint8)
        for d in range(3):
            if freedoms & (Freedom.X << d):
                self.state.velocity[d, nodes] = 0.0
            if freedoms & (Freedom.TURN_X << d):
                self.state.spin[d, nodes] = 0.0

    def open_clamp(self) -> None:
        """Nothing is held any more, by the edge or by :meth:`hold`."""
        self._fixed[:] = 0
        self._spring_node = np.zeros(0, dtype=np.int32)

    def release(self, kept: NDArray[np.bool_]) -> None:
        """Open the clamp, take tools and support away and cut off the elements that are not ``kept`` (ny, nx).

        What is cut off stays in the arrays, without stress and with a thousandth of its thickness.
        """
        self.open_clamp()
        self._support = None
        self.tools["radius"] = 0.0
        cut, state = ~kept.ravel(), self.state
        state.thickness[cut] *= 1e-3
        for stresses in (state.stress, state.shear, state.hourglass, state.drilling, state.back_stress):
            stresses[:, cut] = 0.0

    def set_support(self, support: Support) -> None:
        """Put a rigid surface under the sheet."""
        heights = np.where(np.isfinite(support.height), support.height, -1e9).astype(float)
        plane, element, weight, area = self._points_over(support)
        support.arrays = (heights, plane, element, weight, area, np.empty(element.size, dtype=np.int32))
        self._support = support

    def _points_over(self, support: Support) -> tuple[Array, NDArray[np.int32], Array, Array]:
        """Height (elements,) m of ``support`` under the elements where it is a plane, -1e9 elsewhere; there, near its
        edges: element (k,), weights of its corners (4, k) and area (k,) m^2 of ``points`` squared points per element.
        """
        solid = np.where(np.isfinite(support.height), support.height, -1e9)
        rows, columns = (
            [_points_around(low, high, begin, support.spacing, points) for low, high in pairwise(line)]
            for line, begin, points in ((self.y, support.y0, solid.shape[0]), (self.x, support.x0, solid.shape[1]))
        )
        around = [solid[row, column] for row in rows for column in columns]
        lowest = np.array([part.min(initial=1e9) for part in around])
        highest = np.array([part.max(initial=-1e9) for part in around])
        plane, near = highest - lowest < 1e-9, highest > -1e8
        heights = np.where(near & plane, highest, -1e9)
        elements = np.flatnonzero(near & ~plane).astype(np.int32)
        count = support.points
        u = (np.arange(count) + 0.5) / count
        u, v = (grid.ravel() for grid in np.meshgrid(u, u))
        weights = np.stack([(1 - u) * (1 - v), u * (1 - v), u * v, (1 - u) * v])
        return (
            heights,
            np.repeat(elements, count**2),
            np.ascontiguousarray(np.tile(weights, elements.size)),
            np.repeat(self._area[elements], count**2) / count**2,
        )

    # -- motion --------------------------------------------------------------------------------------

    def move(self, tips: Array, least: int = 2, raised: float | None = None) -> Array:
        """Move both tools straight to ``tips`` (2, 3) m; returns the mean force (2, 3) N of the sheet on each.

        ``least``: steps at least, also for tools that rest ; ``raised`` m, the support is brought to that offset.
        """
        tools, time, leaving, on_sheet, farthest = self.tools, 0.0, False, False, 0.0
        tools["begin"] = tools["end"]
        for tool, tip in zip(tools, tips, strict=True):
            if tool["radius"] > 0.0:
                tool["end"] = _centre(tool["radius"], tool["side"], tip)
                dx, dy, dz = (tool["end"] - tool["begin"]).tolist()
                way = math.hypot(dx, dy, dz)
                farthest = max(farthest, way)
                across = self.plunge_speed if tool["touching"] > 0 else self.tool_speed / APPROACH
                if tool["touching"] > 0 and tool["side"] * dz > math.hypot(dx, dy):
                    leaving = True
                    across = self.withdrawal_speed * min(1.0, max(WITHDRAWAL_START, self._leaving / WITHDRAWAL_RAMP))
                on_sheet |= bool(tool["touching"] > 0 and way > STANDS)
                time = max(time, math.hypot(dx / self.tool_speed, dy / self.tool_speed, dz / across))
        raised = self.raised if raised is None or self._support is None else raised
        time = max(time, abs(raised - self.raised) / self.plunge_speed)
        self._leaving = self._leaving + time if leaving else 0.0
        self._left &= not on_sheet
        self._stood = self._stood + 1 if farthest <= STANDS and raised == self.raised else 0
        swings = self._left and tools["touching"].any() and self.kinetic_energy > AT_REST
        comes_to_rest = REST_BEGINS < self._stood <= REST_BEGINS + REST_MOVES and swings
        if comes_to_rest:
            time = max(time, REST_TIME / REST_MOVES)
        damping = WITHDRAWAL_DAMPING if leaving else REST_DAMPING if comes_to_rest else self._damping
        touched = tools["touching"] > 0
        self._advance(max(least, math.ceil(time / self.step)), damping, raised)
        self._left |= bool((touched & (tools["touching"] == 0)).any())
        if self._support:
            self._support.offset = raised
        return np.array(tools["mean"])

    def advance(self, steps: int, damping: float = 0.0) -> None:
        """Compute ``steps`` steps with the tools at rest where they are; ``damping`` 1/s of every motion."""
        self.tools["begin"] = self.tools["end"]
        self._advance(steps, damping)

    def place_tools(self, tips: Array) -> None:
        """Put the tools at ``tips`` (2, 3) m without any time: for tools that are clear of the sheet."""
        for tool, tip in zip(self.tools, tips, strict=True):
            if tool["radius"] > 0.0:
                tool["begin"] = tool["end"] = _centre(tool["radius"], tool["side"], tip)
                tool["felt"] = 0.0

    def keep(self, kept: Kept | None = None) -> Kept:
        """Sheet and tools as they are now, written over ``kept`` where there is one."""
        if kept is None:
            return Kept(copy.deepcopy(self.state), self.tools.copy(), self.raised)
        for name, array in vars(self.state).items():
            np.copyto(getattr(kept.state, name), array)
        np.copyto(kept.tools, self.tools)
        kept.raised = self.raised
        return kept

    def go_back(self, kept: Kept) -> None:
        """Sheet and tools are those of ``kept`` again, at rest: what moved them is over."""
        for name, array in vars(kept.state).items():
            np.copyto(getattr(self.state, name), array)
        self.state.velocity[:], self.state.spin[:] = 0.0, 0.0
        np.copyto(self.tools, kept.tools)
        for array in (*self._scratch, *self._contact_scratch):
            array[...] = 0  # what is no number would stay one
        if self._support:
            self._support.offset = kept.raised
        self._leaving, self._left, self._stood = 0.0, False, 0

    def settle(self, still: float = SETTLED) -> float:
        """Come to rest with tools and held nodes where they are, until the sheet is within ``still`` m of equilibrium.

        Returns how far it is away in the end, m: more than ``still`` after LONGEST_REST looks without success.

        Adaptive dynamic relaxation (Underwood 1983): damping is critical for the motion that is left, whose frequency
        is the Rayleigh quotient of what forces and positions changed by between two looks. How far equilibrium is
        away follows from the forces that are left and this frequency.
        """
        self.state.velocity[:], self.state.spin[:] = 0.0, 0.0
        self.advance(1)
        free = np.stack([self._fixed & bit == 0 for bit in (1, 2, 4)])
        position, force = self.state.position.copy(), self._scratch[0] * free
        frequency, calm, away = 0.0, 0, np.inf
        for _ in range(LONGEST_REST):
            self.advance(REST_STEPS, 2.0 * frequency)
            moved, change = self.state.position - position, self._scratch[0] * free - force
            position, force = position + moved, force + change
            inertia = float((self._mass * moved**2).sum())
            if not inertia > 0.0:
                return 0.0 if inertia == 0.0 else np.inf  # a shape without numbers never rests
            frequency = float(np.sqrt(max(0.0, -float((moved * change).sum())) / inertia))
            left = np.sqrt(float((force**2 * self._per_mass).sum()) / float(self._mass.sum()))
            speed = np.sqrt(2.0 * self.kinetic_energy / float(self._mass.sum()))
            away = float(max(left / frequency**2, speed / frequency)) if frequency > 0.0 else np.inf
            calm = calm + 1 if away <= still else 0
            if calm == CALM_LOOKS:
                break
        self.state.velocity[:], self.state.spin[:] = 0.0, 0.0
        return away

    def inverted_element(self) -> Array | None:
        """(3,) m, middle of the first element that is folded over (a corner of more than 180 deg); None: none is."""
        shape = len(self.y), len(self.x)
        node = self.state.position.reshape(3, *shape)
        corners = [node[:, :-1, :-1], node[:, :-1, 1:], node[:, 1:, 1:], node[:, 1:, :-1]]
        sides = [corners[(k + 1) % 4] - corners[k] for k in range(4)]
        normal = np.cross(corners[2] - corners[0], corners[3] - corners[1], axis=0)
        turned = [(np.cross(sides[k - 1], sides[k], axis=0) * normal).sum(axis=0) <= 0.0 for k in range(4)]
        found = np.argwhere(np.any(turned, axis=0))
        if not found.size:
            return None
        row, column = found[0]
        return np.asarray(sum(corner[:, row, column] for corner in corners) / 4.0)

    @property
    def raised(self) -> float:
        """m by which the support stands higher than it was set."""
        return self._support.offset if self._support else 0.0

    @property
    def force(self) -> Array:
        """(3, n) N, of everything on the nodes in the last step: nothing in equilibrium; what holds a node gives it
        the opposite."""
        return self._scratch[0].copy()

    @property
    def moment(self) -> Array:
        """(3, n) N m, the same of moments."""
        return self._scratch[1].copy()

    @property
    def kinetic_energy(self) -> float:
        """J, of the translations."""
        return float(0.5 * (self._mass * (self.state.velocity**2).sum(axis=0)).sum())

    @property
    def plastic_work(self) -> float:
        """J, since the sheet was flat."""
        return float(self.state.plastic_work.sum())

    def upper_face(self) -> Array:
        """(3, n) m, the points of the upper face over the nodes."""
        shape = len(self.y), len(self.x)
        middle = self.state.position.reshape(3, *shape)
        along = [np.gradient(middle[k], axis=1) for k in range(3)]
        across = [np.gradient(middle[k], axis=0) for k in range(3)]
        normal = np.cross(np.stack(along, axis=-1), np.stack(across, axis=-1))
        normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
        thickness = np.pad(self.state.thickness.reshape(shape[0] - 1, shape[1] - 1), 1, mode="edge")
        at_nodes = 0.25 * (thickness[1:, 1:] + thickness[1:, :-1] + thickness[:-1, 1:] + thickness[:-1, :-1])
        return np.asarray((middle + 0.5 * at_nodes * np.moveaxis(normal, -1, 0)).reshape(3, -1))

    @property
    def z(self) -> Array:
        """(ny + 1, nx + 1) m, heights of the nodes."""
        return self.state.position[2].reshape(len(self.y), len(self.x))

    # -- inside ----------------------------------------------------------------------------------

    def _advance(self, steps: int, damping: float, raised: float | None = None) -> None:
        struct = self._struct()
        struct.damping = damping
        if raised is not None:
            struct.support_to = raised
        shared = self._alone == 0 and steps * self._area.size >= library.SMALLEST_SHARE
        threads, cpu = self.threads if shared else 1, ctypes.c_double()
        crowded = library.advance()(
            ctypes.byref(struct), self.tools.ctypes.data, steps, SMOOTHING, threads, ctypes.byref(cpu)
        )
        self.beside += cpu.value
        self._alone = library.ALONE if crowded else max(0, self._alone - 1)
        self.steps += steps

    def _hold_edge(self) -> None:
        shape = len(self.y), len(self.x)
        border = np.zeros(shape, dtype=bool)
        border[[0, -1], :] = border[:, [0, -1]] = True
        held = np.isinf(self.edge.spring)
        self._fixed = np.where(border, Freedom.ALL if held else Freedom.Z | Freedom.TURNS, 0).astype(np.uint8).ravel()
        length, (along_x, along_y) = np.zeros(shape), (np.gradient(line) for line in (self.x, self.y))
        along_x[[0, -1]] *= 0.5
        along_y[[0, -1]] *= 0.5
        length[[0, -1], :] += along_x
        length[:, [0, -1]] += along_y[:, None]
        self._spring_node = np.flatnonzero(border & (not held and self.edge.spring > 0.0)).astype(np.int32)
        # a spring that the time step does not bear is as stiff as it bears
        bears = SPRING_SHARE * self._mass[self._spring_node] / self.step**2
        self._spring = np.minimum(self.edge.spring * length.ravel()[self._spring_node], bears)
        self._limit = np.minimum(self.edge.limit, 1e12) * length.ravel()[self._spring_node]

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_built": None}  # it points to arrays of this one

    def _struct(self) -> ShellStruct:
        """What the kernels need, with the present places of the arrays; made anew only where one was replaced."""
        arrays, built = self._arrays(), self._built
        if built is None or not _same(arrays, built.arrays):
            self._built = built = self._new_struct(arrays)
        if self._support is not None:
            built.support_from = built.support_to = self._support.offset
        return built

    def _new_struct(self, arrays: dict[str, NDArray[Any]]) -> ShellStruct:
        sheet, struct = self.sheet, ShellStruct()
        struct.nx, struct.ny, struct.table_size = len(self.x) - 1, len(self.y) - 1, self._flow.size
        struct.young, struct.poisson, struct.step = sheet.young_modulus, sheet.poisson_ratio, self.step
        struct.spring_size = self._spring_node.size
        struct.table_step, struct.friction = TABLE_STEP, self._friction
        struct.kinematic = sheet.kinematic
        struct.drag = DRAG_SHARE * sheet.density * sheet.thickness / self.step
        struct.contact, struct.slip_speed = self._contact, SLIP_SHARE * self.tool_speed
        struct.contact_time = 2.0 * CONTACT_DAMPING * np.sqrt(sheet.density * sheet.thickness / self._contact)
        if (support := self._support) is not None:
            struct.support_ny, struct.support_nx = support.height.shape
            struct.support_x, struct.support_y, struct.support_spacing = support.x0, support.y0, support.spacing
            struct.support_size = support.arrays[2].size
        for name, array in arrays.items():
            setattr(struct, name, array.ctypes.data)
        struct.arrays = arrays  # kept as long as the kernels use them
        return struct

    def _arrays(self) -> dict[str, NDArray[Any]]:
        """Those that the kernels use, by the names they have there."""
        force, moment, element_force = self._scratch
        contact_force, in_contact, thickness_before = self._contact_scratch
        arrays: dict[str, NDArray[Any]] = {
            **vars(self.state),
            "force": force,
            "moment": moment,
            "element_force": element_force,
            "contact_force": contact_force,
            "in_contact": in_contact,
            "thickness_before": thickness_before,
            "per_mass": self._per_mass,
            "per_inertia": self._per_inertia,
            "spring_node": self._spring_node,
            "spring": self._spring,
            "spring_limit": self._limit,
            "fixed": self._fixed,
            "flow_stress": self._flow,
            "hardening": self._hardening,
            "area": self._area,
        }
        if self.load is not None:
            arrays["load"] = np.ascontiguousarray(self.load, dtype=float)
        if self._support is not None:
            names = (
                "support_height",
                "support_plane",
                *(f"support_{name}" for name in ("element", "weight", "area", "near")),
            )
            arrays |= dict(zip(names, self._support.arrays, strict=True))
        return arrays


def _same(some: dict[str, NDArray[Any]], others: dict[str, NDArray[Any]]) -> bool:
    return some.keys() == others.keys() and all(array is others[name] for name, array in some.items())


def _flat(x: Array, y: Array, sheet: Sheet) -> State:
    grid_x, grid_y = (grid.ravel() for grid in np.meshgrid(x, y))
    nodes, elements = grid_x.size, (len(x) - 1) * (len(y) - 1)
    return State(
        position=np.stack([grid_x, grid_y, np.zeros(nodes)]),
        velocity=np.zeros((3, nodes)),
        spin=np.zeros((3, nodes)),
        anchor=np.stack([grid_x, grid_y]),
        thickness=np.full(elements, sheet.thickness),
        stress=np.zeros((3 * LAYERS, elements)),
        plastic_strain=np.zeros((LAYERS, elements)),
        shear=np.zeros((2, elements)),
        hourglass=np.zeros((5, elements)),
        drilling=np.zeros((4, elements)),
        plastic_work=np.zeros(elements),
        back_stress=np.zeros((3 * LAYERS if sheet.kinematic > 0.0 else 0, elements)),
    )


def _points_around(low: float, high: float, begin: float, spacing: float, points: int) -> slice:
    """Those of ``points`` at begin + i spacing m that surround low to high m, and as far as the sheet slides."""
    first, last = np.floor((low - SLIDES - begin) / spacing), np.ceil((high + SLIDES - begin) / spacing)
    return slice(max(0, int(first)), min(points, int(last) + 1))


def _at_nodes(of_corner: Array) -> Array:
    """(n,), what the elements (ny, nx) give to each of their nodes, summed."""
    ny, nx = of_corner.shape
    total = np.zeros((ny + 1, nx + 1))
    for j in (0, 1):
        for i in (0, 1):
            total[j : ny + j, i : nx + i] += of_corner
    return total.ravel()


def _centre(radius: float, side: float, tip: Array) -> Array:
    return np.asarray(tip, dtype=float) + np.array([0.0, 0.0, side * radius])
