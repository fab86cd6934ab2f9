"""How far the elasto-plastic sheet is used up against the forming limit of its material: strains and bends of its
elements, which stay with the material through all passes."""

from __future__ import annotations

from typing import Any

import numpy as np
from isf_core.files.material import FormingLimit
from isf_core.types import Array, Indices

from isf_sim.explicit_shell.shell import ExplicitShell
from isf_sim.sheet.surface import LONG_AGO

MIDDLE = np.array([-1.0, 9.0, 9.0, -1.0]) / 16.0
"""Weights of Catmull and Rom's interpolation half-way between the second and the third of four nodes."""

NOTED = 0.2e-3
"""m of path between two looks at what the tools touch: a tenth of an element."""


class Strength:
    """Bends of the elements of ``shell``, and what is left of them against ``limit``; ``window`` m of path within which
    a tool that comes again makes the same bend.

    Attributes
    ----------
    bending : (e,) 1/m, curvatures of the tools, of flat tips those of the corners, that an element was bent to, a pass
        each, summed up
    touched : (e,) m, path of the tool at which an element was last touched
    strain, place : largest one when it was judged last, as the forming limit counts it, and where, (3,) m
    """

    def __init__(self, shell: ExplicitShell, limit: FormingLimit, window: float) -> None:
        self._limit, self._window = limit, window
        self._blank = shell.sheet.thickness
        self.bending = np.zeros(shell.state.thickness.size)
        self.touched = np.full(shell.state.thickness.size, LONG_AGO)
        self.strain, self.place = 0.0, np.zeros(3)

    def note(self, shell: ExplicitShell, path: float) -> None:
        """Count the bends that begin now, the forming tool having travelled ``path`` m."""
        tools = [tool for tool in shell.tools if tool["radius"] > 0.0 and tool["touching"] > 0]
        if not tools or path - float(self.touched.max()) < NOTED:
            return
        middle = _middles(shell)
        for tool in tools:
            centre = tool["end"] + tool["compliance"] * tool["felt"]
            around = np.abs(middle[:2] - centre[:2, None]).max(axis=0) < tool["radius"] + tool["flat"] + self._blank
            near = np.flatnonzero(around)
            reach = tool["radius"] + 0.5 * shell.state.thickness[near]
            apart = from_tip(tool, _smooth_middles(shell, near) - centre[:, None])
            touched = near[np.linalg.norm(apart, axis=0) < reach]
            begins = touched[path - self.touched[touched] >= self._window]
            self.bending[begins] += 1.0 / tool["radius"]
            self.touched[touched] = path

    def judge(self, shell: ExplicitShell) -> None:
        """Find the largest strain, wherever it is: a wall is also pulled thin after the tool has passed."""
        strain = self._used(shell)
        worst = int(np.argmax(strain))
        self.strain, self.place = float(strain[worst]), _middles(shell)[:, worst].copy()

    def margin(self, shell: ExplicitShell) -> Array:
        """(e,) true strain that is left of the elements before the forming limit, negative beyond it."""
        return np.asarray(self._limit.strain - self._used(shell))

    def _used(self, shell: ExplicitShell) -> Array:
        """(e,) strain as the forming limit counts it."""
        limit = self._limit
        strain = np.log(self._blank / shell.state.thickness)
        if limit.slope != 1.0:
            strain = strain + (limit.slope - 1.0) * principal_strains(shell)[1]
        return np.asarray(strain + 0.5 * self._blank * limit.bending_share * self.bending)


def principal_strains(shell: ExplicitShell) -> tuple[Array, Array]:
    """(e,), (e,) larger and smaller true strain of the middle surface of the elements against the flat blank."""
    corners = _corners(shell)
    along_x = 0.5 * (corners[1] - corners[0] + corners[3] - corners[2])
    along_y = 0.5 * (corners[2] - corners[0] + corners[3] - corners[1])
    dx, dy = np.meshgrid(np.diff(shell.x), np.diff(shell.y))
    along_x, along_y = along_x / dx, along_y / dy
    xx, yy, xy = (along_x**2).sum(axis=0), (along_y**2).sum(axis=0), (along_x * along_y).sum(axis=0)
    half, spread = 0.5 * (xx + yy), np.sqrt((0.5 * (xx - yy)) ** 2 + xy**2)
    major = half + spread
    minor = (xx * yy - xy**2) / major
    return 0.5 * np.log(major.ravel()), 0.5 * np.log(np.maximum(minor.ravel(), 1e-12))


def from_tip(tool: Any, apart: Array) -> Array:
    """(3, n) m from the disc in the tip of ``tool`` (library.TOOL), as in shell.c, to what is ``apart`` (3, n) m from
    its centre: what lies beside the disc is nearer by its radius. A ball has no disc but its centre."""
    if tool["flat"] == 0.0:
        return apart
    out = np.hypot(apart[0], apart[1]) + 1e-12
    return np.concatenate([apart[:2] * np.maximum(1.0 - tool["flat"] / out, 0.0), apart[2:]])


def _corners(shell: ExplicitShell) -> tuple[Array, Array, Array, Array]:
    """(3, ny, nx) m four times: corners at the low x and y, high x, high y, both high."""
    position = shell.state.position.reshape(3, len(shell.y), len(shell.x))
    return position[:, :-1, :-1], position[:, :-1, 1:], position[:, 1:, :-1], position[:, 1:, 1:]


def _smooth_middles(shell: ExplicitShell, elements: Indices) -> Array:
    """(3, n) m, middles of ``elements`` (n,) on the smooth surface through the nodes, which the tools touch (Catmull
    and Rom's interpolation, as in shell.c); the middle of its corners lies inside of a bent element."""
    row, column = np.divmod(elements, len(shell.x) - 1)
    rows, columns = (
        np.clip(first[:, None] + np.arange(-1, 3), 0, len(line) - 1)
        for first, line in ((row, shell.y), (column, shell.x))
    )
    nodes = rows[:, :, None] * len(shell.x) + columns[:, None, :]
    return np.asarray(np.einsum("dnab,a,b->dn", shell.state.position[:, nodes], MIDDLE, MIDDLE))


def _middles(shell: ExplicitShell) -> Array:
    """(3, e) m, middles of the elements."""
    a, b, c, d = _corners(shell)
    return (0.25 * (a + b + c + d)).reshape(3, -1)
