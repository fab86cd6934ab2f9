"""Contact of a ball with the fine surface: first touch, wall around the ball, envelope, point equilibrium."""

from __future__ import annotations

import math

import numpy as np
from isf_core.types import Array

from isf_sim.jit import kernel
from isf_sim.sheet.surface import Surface, bilinear

PROBE_RAYS = 96
PROBE_NEAR, PROBE_FAR = 0.95, 1.6
"""Radii (over the tool radius) between which the slope of the wall round the tool is taken."""


@kernel
def touch_heights(surface: Surface, path: float, window: float, x: float, y: float, radius: float, out: Array) -> None:
    """Tip heights (m) at which a ball over (x, y) first touches the surface.

    out[0]: the surface as it was before the present pass (within ``window`` m of path), which makes the step
    independent of the tick spacing; out[1]: the present surface. -inf beside the sheet.
    """
    z, before, touched = surface.height, surface.before, surface.touched
    ny, nx = z.shape
    h = surface.h
    i0, i1 = max(int((x - radius - surface.x0) / h), 0), min(int((x + radius - surface.x0) / h) + 2, nx)
    j0, j1 = max(int((y - radius - surface.y0) / h), 0), min(int((y + radius - surface.y0) / h) + 2, ny)
    lagged = present = -math.inf
    for j in range(j0, j1):
        dy = surface.y0 + j * h - y
        for i in range(i0, i1):
            dx = surface.x0 + i * h - x
            rest = radius * radius - dx * dx - dy * dy
            if rest > 0.0:
                cap = math.sqrt(rest) - radius
                now = z[j, i]
                old = before[j, i] if path - touched[j, i] < window else now
                lagged = max(lagged, old + cap)
                present = max(present, now + cap)
    out[0] = lagged
    out[1] = present


@kernel
def touching_tip(surface: Surface, z: Array, side: float, x: float, y: float, radius: float) -> float:
    """Tip height (m) at which a ball over (x, y) touches ``side`` times the height field ``z``; -inf beside it."""
    ny, nx = z.shape
    h = surface.h
    i0, i1 = max(int((x - radius - surface.x0) / h), 0), min(int((x + radius - surface.x0) / h) + 2, nx)
    j0, j1 = max(int((y - radius - surface.y0) / h), 0), min(int((y + radius - surface.y0) / h) + 2, ny)
    highest = -math.inf
    for j in range(j0, j1):
        dy = surface.y0 + j * h - y
        for i in range(i0, i1):
            dx = surface.x0 + i * h - x
            rest = radius * radius - dx * dx - dy * dy
            if rest > 0.0:
                highest = max(highest, side * z[j, i] + math.sqrt(rest) - radius)
    return highest


@kernel
def support_height(surface: Surface, x: float, y: float, radius: float) -> float:
    """Tip height (m) at which a ball over (x, y) presses the sheet against the support; -inf without one."""
    if surface.holder[0] == 0.0:
        return -math.inf
    return touching_tip(surface, surface.support, 1.0, x, y, radius) + surface.holder[1]


@kernel
def probe_wall(surface: Surface, x: float, y: float, radius: float, out: Array) -> None:
    """Wall round the ball: out[0] steepest slope, out[1:3] unit horizontal vector towards the wall, out[3] wrap.

    The wrap is the integral of the slope round the tool over that of a straight wall of the same slope
    (> 1 in corners, 1 on a straight wall).
    """
    vx = vy = integral = 0.0
    slopes = np.empty(PROBE_RAYS)
    for k in range(PROBE_RAYS):
        angle = 2.0 * math.pi * k / PROBE_RAYS
        c, s = math.cos(angle), math.sin(angle)
        near = bilinear(
            surface.height, surface.x0, surface.y0, surface.h, x + PROBE_NEAR * radius * c, y + PROBE_NEAR * radius * s
        )
        far = bilinear(
            surface.height, surface.x0, surface.y0, surface.h, x + PROBE_FAR * radius * c, y + PROBE_FAR * radius * s
        )
        slopes[k] = slope = (far - near) / ((PROBE_FAR - PROBE_NEAR) * radius)
        if slope > 0.0:
            vx += slope * c
            vy += slope * s
            integral += slope * 2.0 * math.pi / PROBE_RAYS
    steepest = _peak(slopes)
    length = math.hypot(vx, vy)
    out[0] = steepest
    out[1] = vx / length if length > 1e-9 else 0.0
    out[2] = vy / length if length > 1e-9 else 0.0
    out[3] = integral / (2.0 * steepest) if steepest > 0.02 else 1.0


@kernel
def _peak(slopes: Array) -> float:
    """Maximum of a smooth periodic function from its samples, by the parabola through the three largest.

    The largest sample alone would rise and fall as the wall turns past the rays: a ripple of the wall angle, and with
    it of force and thickness, as many times round a part as there are rays.
    """
    n = slopes.shape[0]
    top = int(np.argmax(slopes))
    here, before, after = slopes[top], slopes[(top - 1) % n], slopes[(top + 1) % n]
    bend = 2.0 * here - before - after
    if here <= 0.0 or bend <= 0.0:
        return max(here, 0.0)
    return here + (after - before) ** 2 / (8.0 * bend)


@kernel
def envelope(surface: Surface, path: float, window: float, x: float, y: float, tip: float, radius: float) -> None:
    """Press a ball with its tip at (x, y, tip) into the surface: Z <- min(Z, ball)."""
    z = surface.height
    ny, nx = z.shape
    h = surface.h
    i0, i1 = max(int((x - radius - surface.x0) / h), 1), min(int((x + radius - surface.x0) / h) + 2, nx - 1)
    j0, j1 = max(int((y - radius - surface.y0) / h), 1), min(int((y + radius - surface.y0) / h) + 2, ny - 1)
    if i1 <= i0 or j1 <= j0:
        return
    # all nodes move from the same shape: in place, material would flow with the order of the nodes
    old = z[j0 - 1 : j1 + 1, i0 - 1 : i1 + 1].copy()
    origin = surface.origin[j0 - 1 : j1 + 1, i0 - 1 : i1 + 1].copy()
    bending = surface.bending[j0 - 1 : j1 + 1, i0 - 1 : i1 + 1].copy()
    for j in range(j0, j1):
        dy = surface.y0 + j * h - y
        for i in range(i0, i1):
            dx = surface.x0 + i * h - x
            rest = radius * radius - dx * dx - dy * dy
            if rest > 0.0:
                ball = tip + radius - math.sqrt(rest)
                if z[j, i] > ball:
                    begins = path - surface.touched[j, i] >= window
                    if begins:
                        surface.before[j, i] = z[j, i]
                        surface.touched[j, i] = path
                    _move_material(surface, j, i, old, origin, bending, j - j0 + 1, i - i0 + 1, z[j, i] - ball)
                    if begins:
                        surface.bending[j, i] += 1.0 / radius
                    z[j, i] = ball
                    surface.formed[j, i] = 1


@kernel
def _move_material(
    surface: Surface, j: int, i: int, z: Array, origin: Array, bending: Array, b: int, a: int, drop: float
) -> None:
    """Node (j, i) goes down by ``drop`` m: its material moves along the normal, so it comes from further up the slope.

    ``z`` m, ``origin`` m and ``bending`` 1/m: as they were before the ball came, in a window where the node is (b, a).
    """
    h = surface.h
    zx, zy = (z[b, a + 1] - z[b, a - 1]) / (2.0 * h), (z[b + 1, a] - z[b - 1, a]) / (2.0 * h)
    share = drop / (1.0 + zx * zx + zy * zy)
    sx, sy = max(min(share * zx, h), -h), max(min(share * zy, h), -h)
    before_a, before_b = a - 1 if sx > 0.0 else a + 1, b - 1 if sy > 0.0 else b + 1
    for k in range(2):
        here = origin[b, a, k]
        carried = abs(sx) * (origin[b, before_a, k] - here) + abs(sy) * (origin[before_b, a, k] - here)
        surface.origin[j, i, k] = here + carried / h - (sx if k == 0 else sy)
    bent = bending[b, a]
    carried = abs(sx) * (bending[b, before_a] - bent) + abs(sy) * (bending[before_b, a] - bent)
    surface.bending[j, i] = bent + carried / h


@kernel
def axial_force(
    gap: float,
    amplitude: float,
    exponent: float,
    step: float,
    compliance: float,
    guess: float,
    sink: float,
    sink_exponent: float,
    tool_compliance: float = 0.0,
    die_gap: float = -math.inf,
) -> float:
    """N, force F that satisfies gap = c F + S(F) + step (F / A)^(1/m): tool, sheet and plastic step in series.

    ``gap`` m: first touch minus commanded tip; ``compliance`` c m/N; S(F) = sink (F / guess)^b; ``step`` = 0 for
    the elastic branch. Monotone in F; Newton with bisection as the safeguard. A tool that presses the sheet against
    a support stops there, ``die_gap`` m above the commanded tip, instead of giving way by ``tool_compliance`` F:
    F is then what the sheet alone carries.
    """
    if gap <= max(die_gap, 0.0):
        return 0.0
    low, high = 0.0, 4.0 * amplitude + 1.0
    force = min(max(guess, 1.0), high)
    inverse = 1.0 / exponent
    for _ in range(60):
        sag = sink * (force / guess) ** sink_exponent
        plastic = step * (force / amplitude) ** inverse
        give = max(tool_compliance * force, die_gap)
        rest = gap - give - (compliance - tool_compliance) * force - sag - plastic
        if rest > 0.0:
            low = force
        else:
            high = force
        slope = compliance + (sink_exponent * sag + inverse * plastic) / force
        trial = force + rest / slope
        if not low < trial < high:
            trial = 0.5 * (low + high)
        if abs(trial - force) < 1e-4 * force + 1e-4:
            return trial
        force = trial
    return force
