"""A coarse solution: what is noted of the sheet in the tick that begins one, and what is worked out from that later.

The tick notes the fine surface at the places that the coarse shell will have, 0.1 ms; the lines of the shell are moved,
its shape is set and the equilibrium is found by whoever carries the order out, a thread or the tick itself.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from isf_core.types import Array

from isf_sim.sheet.support import Under, sample_under, support_points
from isf_sim.sheet.surface import Surface, sample
from isf_sim.sheet.thickness import coarse_area
from isf_sim.shell.shell import Deflection, Shell

THINNEST_SHELL = 0.25
"""Smallest thickness of the coarse shell over the blank's."""


@dataclass(frozen=True)
class Order:
    """A solution to be found; shares nothing with the sheet it was noted from.

    Attributes
    ----------
    lines : (nx,), (ny,) m, lines of the shell ; height : (ny, nx) m ; origin : (ny, nx, 2) m, as in Surface
    under : what stands under the sheet ; blank : m, its thickness
    place : (2,) m, tool ; force : (3,) N on the sheet ; radius : m, of the loaded patch
    start : number of the earlier state to start from, negative: none ; scale : of that state
    """

    lines: tuple[Array, Array]
    height: Array
    origin: Array
    under: Under | None
    blank: float
    place: tuple[float, float]
    force: Array
    radius: float
    start: int
    scale: float


def make_order(
    surface: Surface,
    lines: tuple[Array, Array],
    blank: float,
    place: tuple[float, float],
    force: Array,
    radius: float,
    start: tuple[int, float],
) -> Order:
    """Note the ``surface`` as it is now; ``start``: number and scale as in :class:`Order`, the rest as there."""
    height, origin = sample(surface, *lines)
    return Order(
        lines=lines,
        height=height,
        origin=origin,
        under=sample_under(surface, *lines) if surface.holder[0] else None,
        blank=blank,
        place=place,
        force=force,
        radius=radius,
        start=start[0],
        scale=start[1],
    )


def carry_out(order: Order, shell: Shell, states: list[Array]) -> Deflection:
    """Find the deflection; ``states`` (N, 3) m of earlier solutions are carried over when lines move.

    From the flat state where the start leads nowhere.
    """
    carry_lines(order.lines, shell, states)
    _take_shape(order, shell)
    patch = shell.load_patch(*order.place, order.radius)
    start = order.scale * states[order.start] if order.start >= 0 else None
    deflection = shell.solve(patch, order.force, start)
    if not deflection.converged or not np.isfinite(deflection.displacement).all():
        deflection = shell.solve(patch, order.force)
    return deflection


def carry_lines(lines: tuple[Array, Array], shell: Shell, states: list[Array]) -> None:
    """Put the lines of ``shell`` to ``lines`` (nx,), (ny,) m, if they are not there, and its states with them."""
    if np.array_equal(shell.x, lines[0]) and np.array_equal(shell.y, lines[1]):
        return
    nodes = shell.onto_lines(*lines)
    states[:] = [nodes(state) for state in states]
    shell.move_lines(*lines)


def _take_shape(order: Order, shell: Shell) -> None:
    """Surface and thickness on the coarse grid; the clamp stays at z = 0."""
    height = order.height.ravel()
    height[shell.boundary] = 0.0
    zy, zx = np.gradient(height.reshape(shell.ny, shell.nx), shell.y, shell.x)
    cosine = 1.0 / np.sqrt(1.0 + zx**2 + zy**2).ravel()
    stretch = coarse_area(order.origin, shell.x, shell.y).ravel() * cosine
    shell.set_shape(height, order.blank * np.clip(stretch, THINNEST_SHELL, 1.0))
    if order.under is not None:
        shell.set_support(support_points(shell, order.under))
