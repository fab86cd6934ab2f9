"""What stands under the sheet: backing plate and die of a job as one rigid surface on the plant's grid.

Heights are those that the lower face of the sheet would touch, frame ``sheet``: the lower face of the flat blank is at
-t, the top of a plate flush with the clamp likewise. -inf where there is nothing.
"""

from __future__ import annotations

import numpy as np
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.die_mesh import read_die
from isf_core.files.job import JobFile
from isf_core.types import Array
from numpy.typing import NDArray

from isf_sim.jit import kernel
from isf_sim.sheet.surface import Surface

LARGEST_RISE = 1.0e-3
"""m, a die that stands higher above the lower face of the flat blank than this does not fit under it."""


def support_of(job_file: JobFile, surface: Surface, thickness: float) -> Array | None:
    """(ny, nx) m on the nodes of ``surface``, or None when the job has neither backing plate nor die.

    Raises
    ------
    IsfError : BLANK_DOES_NOT_FIT, MESH_UNREADABLE, MESH_EMPTY, FILE_NOT_FOUND
    """
    job = job_file.job
    x = surface.x0 + surface.h * np.arange(surface.height.shape[1], dtype=np.float64)
    y = surface.y0 + surface.h * np.arange(surface.height.shape[0], dtype=np.float64)
    heights = []
    if job.backing_plate is not None:
        clamp = job_file.rig.clamp.size
        extent = job.backing_plate.extent
        if extent[0] > clamp[0] or extent[1] > clamp[1]:
            raise IsfError(
                ErrorCode.BLANK_DOES_NOT_FIT,
                f"the opening of the backing plate is {_millimetres(extent)}, the free sheet {_millimetres(clamp)}",
                where="backing_plate",
                advice="choose a smaller opening, or leave the backing plate out",
            )
        heights.append(job.backing_plate.height(*np.meshgrid(x, y)) - thickness)
    mesh = read_die(job_file)
    if mesh is not None:
        die = die_heights(mesh.vertices, mesh.faces, x, y)
        top = float(die.max())
        if not np.isfinite(top):
            raise IsfError(
                ErrorCode.BLANK_DOES_NOT_FIT,
                "the die is not under the sheet",
                where=str(mesh.path),
                advice="give it in frame sheet, whose origin is the middle of the blank",
            )
        if top > LARGEST_RISE - thickness:
            raise IsfError(
                ErrorCode.BLANK_DOES_NOT_FIT,
                f"the die stands {1e3 * (top + thickness):.2f} mm above the lower face of the flat blank",
                where=str(mesh.path),
                advice="give the die with the blank holder at its start: its top at or below z = -thickness",
            )
        heights.append(die)
    return np.maximum.reduce(heights) if heights else None


def die_heights(vertices: Array, faces: NDArray[np.int64], x: Array, y: Array) -> Array:
    """(ny, nx) m, highest z of the triangles (M, 3) of ``vertices`` (N, 3) m over every node, -inf beside them."""
    heights = np.full((len(y), len(x)), -np.inf)
    _raise_to(vertices, faces, float(x[0]), float(y[0]), float(x[1] - x[0]), heights)
    return heights


@kernel
def _raise_to(vertices: Array, faces: NDArray[np.int64], x0: float, y0: float, h: float, out: Array) -> None:
    """Raise ``out`` to the plane of every triangle over the nodes inside it; upright triangles have no node inside."""
    ny, nx = out.shape
    slack = 1e-9
    for f in range(faces.shape[0]):
        a, b, c = vertices[faces[f, 0]], vertices[faces[f, 1]], vertices[faces[f, 2]]
        area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        if abs(area) < 1e-16:
            continue
        i0 = max(int((min(a[0], b[0], c[0]) - x0) / h), 0)
        i1 = min(int((max(a[0], b[0], c[0]) - x0) / h) + 2, nx)
        j0 = max(int((min(a[1], b[1], c[1]) - y0) / h), 0)
        j1 = min(int((max(a[1], b[1], c[1]) - y0) / h) + 2, ny)
        for j in range(j0, j1):
            y = y0 + j * h
            for i in range(i0, i1):
                x = x0 + i * h
                u = ((x - a[0]) * (c[1] - a[1]) - (y - a[1]) * (c[0] - a[0])) / area
                v = ((b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0])) / area
                if u >= -slack and v >= -slack and u + v <= 1.0 + slack:
                    out[j, i] = max(out[j, i], a[2] + u * (b[2] - a[2]) + v * (c[2] - a[2]))


def _millimetres(size: tuple[float, float]) -> str:
    return " x ".join(f"{1e3 * value:.0f}" for value in size) + " mm"
