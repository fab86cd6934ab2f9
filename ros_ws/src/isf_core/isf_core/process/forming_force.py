"""Forming force predicted from process parameters, before anything is formed.

Two models: the regression of Aerens et al. (any aluminium or steel for which the tensile
strength is known) and the force equilibrium of Praveen 2020 (eq. 1-3) that also gives the
contact patch. The simulated machine does not use this module: it computes its forces from
the state of its sheet.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from isf_core.types import Array


def scallop_height(incremental_depth: Array | float, radius: float, wall_angle: Array | float) -> Array:
    """m, height of the cusp left between two contours on the wall."""
    pitch = np.asarray(incremental_depth) / np.sin(wall_angle)
    return np.asarray(pitch**2 / (8.0 * radius))


def aerens_axial_force(
    tensile_strength: float,
    thickness: float,
    radius: float,
    incremental_depth: float,
    wall_angle: Array | float,
) -> Array:
    """N, steady axial force by the regression F = 0.0716 Rm t^1.57 d^0.41 dh^0.09 a cos(a).

    Arguments in SI (Pa, m, m, m, rad); the regression itself is in MPa, mm, degrees.
    Valid for single-point forming of sheets of 0.5-2 mm at 20-65 deg.
    """
    angle = np.asarray(wall_angle, dtype=float)
    scallop = scallop_height(incremental_depth, radius, np.maximum(angle, 0.05))
    return np.asarray(
        0.0716
        * (tensile_strength / 1e6)
        * (thickness * 1e3) ** 1.57
        * (2 * radius * 1e3) ** 0.41
        * (scallop * 1e3) ** 0.09
        * np.degrees(angle)
        * np.cos(angle)
    )


def groove_angle(incremental_depth: Array | float, radius: float) -> Array:
    """rad, arc wetted by one increment on the groove side: acos(1 - dz/R) (Praveen 2020, reconstructed)."""
    ratio = np.clip(1.0 - np.asarray(incremental_depth) / radius, -1.0, 1.0)
    return np.asarray(np.arccos(ratio))


@dataclass(frozen=True)
class ContactPatch:
    """Tool-sheet contact as a rectangle (Praveen 2020 eq. 2): area m^2, length m, width m."""

    area: Array
    length: Array
    width: Array

    @property
    def perimeter(self) -> Array:
        """m, perimeter over which the axial force is spread as a line load (Praveen 2020, 2.3.3)."""
        return 2.0 * (self.length + self.width)


def cusp_angle(wall_angle: Array | float, incremental_depth: Array | float, radius: float) -> Array:
    """rad, slope at the cusp that two neighbouring grooves leave on the wall: asin(dz / (2 R tan(wall angle))).

    The other reading of Praveen's groove angle: as groove angle it gives axial forces that are too low, but radial
    forces that are positive and nearly constant over the wall angle, as the published tool deflections are.
    """
    ratio = np.asarray(incremental_depth) / (2.0 * radius * np.tan(wall_angle))
    return np.asarray(np.arcsin(np.clip(ratio, -1.0, 1.0)))


def contact_patch(
    wall_angle: Array | float, radius: float, incremental_depth: float, groove: Array | float | None = None
) -> ContactPatch:
    """Contact patch for a wall angle (rad); the limit is taken where wall and groove angle agree.

    ``groove``: rad, instead of :func:`groove_angle`.
    """
    wall = np.asarray(wall_angle, dtype=float)
    groove = groove_angle(incremental_depth, radius) if groove is None else np.asarray(groove)
    difference = groove - wall
    safe = np.where(np.abs(difference) < 1e-6, 1.0, difference)
    chord = np.where(np.abs(difference) < 1e-6, -np.cos(wall), (np.sin(wall) - np.sin(groove)) / safe)
    area = 0.5 * np.pi * radius * (radius + incremental_depth) + 0.5 * np.pi * radius**2 * chord
    length = radius * (wall + groove)
    return ContactPatch(np.asarray(area), np.asarray(length), np.asarray(area / length))


def contact_perimeter(wall_angle: Array | float, radius: float, incremental_depth: float) -> Array:
    """m, :attr:`ContactPatch.perimeter` of :func:`contact_patch`."""
    return contact_patch(wall_angle, radius, incremental_depth).perimeter


@dataclass(frozen=True)
class FormingForce:
    """Axial and radial force on the forming tool, N."""

    axial: Array
    radial: Array


def equilibrium_force(
    flow_stress: Array | float,
    thickness: Array | float,
    wall_angle: Array | float,
    radius: float,
    incremental_depth: float,
    groove: Array | float | None = None,
) -> FormingForce:
    """Forces from the membrane equilibrium under the tool (Praveen 2020 eq. 1-3).

    ``flow_stress`` Pa, ``thickness`` m of the formed wall, ``groove`` rad instead of :func:`groove_angle`. With that
    one the printed radial force is negative below about 45 deg and is clamped at zero there.
    """
    wall = np.asarray(wall_angle, dtype=float)
    t = np.asarray(thickness, dtype=float)
    groove = groove_angle(incremental_depth, radius) if groove is None else np.asarray(groove)
    patch = contact_patch(wall, radius, incremental_depth, groove)
    scale = 2.0 * np.asarray(flow_stress) / np.sqrt(3.0)
    thickness_stress = scale * t / (radius + t)
    meridional_stress = scale * radius / (radius + t)
    hoop_stress = 0.5 * scale * (radius - t) / (radius + t)
    normal = thickness_stress * patch.width * patch.length
    hoop = hoop_stress * patch.length * t
    meridional = meridional_stress * patch.width * t
    half = 0.5 * (wall - groove)
    axial = meridional * np.sin(wall) + hoop * np.sin(groove) + normal * np.cos(half)
    radial = meridional * np.cos(groove) + normal * np.sin(half) - hoop * np.cos(wall)
    return FormingForce(np.asarray(axial), np.maximum(radial, 0.0))
