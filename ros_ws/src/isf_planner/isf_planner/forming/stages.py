"""Multi-stage forming: preforms with flatter walls, so that material is drawn from where the last stage cannot reach.

A wall steeper than the material bears in one pass is formed in stages, each some degrees steeper than the one before
(Hirt 2004 in Lu 2016, 2.3.2: 3 or 5 deg per stage). The preform of a stage is the lowest surface above the part that
is nowhere steeper than the stage's wall angle: it keeps the opening, and reaches the floor where there is room for it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from isf_core.contour import Contour
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import Job
from isf_core.types import Array
from numpy.typing import NDArray

from isf_planner.forming.sides import HalfPart, Side
from isf_planner.part.meshes import Mesh
from isf_planner.surface import surface_kernels

PITCH_PER_RADIUS = 0.1
"""Pitch of a preform's facets over the tool radius."""

LARGEST_GRID = 600
"""Most facets of a preform along one side."""


def preforms(mesh: Mesh, sides: Sequence[Side], job: Job) -> list[HalfPart]:
    """What the upper tool forms in the stages before the last one, from the whole part ``mesh``.

    Raises
    ------
    IsfError : FEATURES_MIXED when the part also rises above the blank
    """
    if not job.path.stages:
        return []
    if [side.forming_tool for side in sides] != [1]:
        raise IsfError(
            ErrorCode.FEATURES_MIXED,
            "stages are planned only for parts that the upper tool forms alone",
            where="path.stages",
            advice="leave path.stages out, or give the features as parts of their own",
        )
    return [HalfPart(preform(mesh, angle, job.tool_1.ball_radius), 1) for angle in job.path.stages]


def joined(groups: Sequence[Sequence[Contour]]) -> tuple[Contour, ...]:
    """Contours of all stages, in order, as one plan; both tools are lifted between stages."""
    count = sum(len(group) for group in groups)
    found: list[Contour] = []
    for stage, group in enumerate(groups):
        for k, contour in enumerate(group):
            retract = contour.retract or (stage > 0 and k == 0)
            found.append(replace(contour, index=len(found), count=count, stage=stage, retract=retract))
    return tuple(found)


def preform(mesh: Mesh, wall_angle: float, radius: float) -> Mesh:
    """Lowest surface above ``mesh`` that is nowhere steeper than ``wall_angle`` (rad), for a tool of ``radius`` m.

    A regular mesh over the bounding box of the part (up to one facet larger), opening towards +z like the part.

    Raises
    ------
    IsfError : PART_TOO_SMALL_FOR_TOOL when nothing is left to be formed at that angle
    """
    low, high = mesh.vertices[:, :2].min(axis=0), mesh.vertices[:, :2].max(axis=0)
    flange = float(mesh.vertices[:, 2].max())
    pitch = max(PITCH_PER_RADIUS * radius, float((high - low).max()) / LARGEST_GRID)
    cells = np.ceil((high - low) / pitch).astype(int)
    origin = 0.5 * (low + high) - 0.5 * pitch * cells  # the middle stays where it is, so that both are placed alike
    z = np.full((cells[1] + 1, cells[0] + 1), flange)
    none, covered = np.empty((0, 3)), np.zeros((cells[1] + 1, cells[0] + 1), dtype=np.bool_)
    surface_kernels.rasterise(
        mesh.vertices, mesh.faces, none, none, 0.0, origin, pitch, np.inf, z, np.empty((0, 0, 2)), covered
    )
    z = surface_kernels.dilate(z, *_cone(np.tan(wall_angle), pitch, flange - float(z.min()), float((high - low).max())))
    if flange - z.min() < 0.1 * radius:
        raise IsfError(
            ErrorCode.PART_TOO_SMALL_FOR_TOOL,
            f"nothing is formed with walls of {np.degrees(wall_angle):.0f} deg",
            where="path.stages",
            advice="leave this stage out, or make it steeper",
        )
    return _grid_mesh(origin, pitch, z)


def _cone(slope: float, pitch: float, height: float, farthest: float) -> tuple[NDArray[np.int64], Array]:
    """Node offsets (M, 2) of a hanging cone and how far (M,) m it has fallen there, to ``height`` or ``farthest`` m."""
    reach = int(np.ceil(min(height / slope, farthest) / pitch))
    steps = np.arange(-reach, reach + 1)
    offsets = np.stack(np.meshgrid(steps, steps, indexing="ij"), axis=-1).reshape(-1, 2)
    falls = slope * pitch * np.sqrt((offsets**2).sum(axis=1))
    return offsets[falls <= height], falls[falls <= height]


def _grid_mesh(origin: Array, pitch: float, z: Array) -> Mesh:
    x, y = origin[0] + pitch * np.arange(z.shape[1]), origin[1] + pitch * np.arange(z.shape[0])
    gx, gy = np.meshgrid(x, y)
    node = np.arange(z.size).reshape(z.shape)
    a, b, c, d = (corner.ravel() for corner in (node[:-1, :-1], node[:-1, 1:], node[1:, 1:], node[1:, :-1]))
    faces = np.vstack([np.column_stack([a, b, c]), np.column_stack([a, c, d])])
    return Mesh(np.column_stack([gx.ravel(), gy.ravel(), z.ravel()]), faces)
