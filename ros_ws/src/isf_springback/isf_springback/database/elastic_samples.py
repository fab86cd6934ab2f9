"""Load and displacement of the control points of one depth, computed with the elastic shell: one task, one result.

A task holds all that the result depends on, so its digest names the result in a cache, and it can be sent to another
process or computer. Lengths in m, forces in N, frame ``sheet``.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from isf_core.contour import Contour
from isf_core.files.job import JobFile
from isf_core.types import Array

from isf_springback.sheet_edge import plate_edge
from isf_springback.shell.engine_kratos import kratos_displacement
from isf_springback.shell.formed_sheet import FacetSize, FormedSheet, formed_sheet, mesh_of
from isf_springback.shell.load_path import follow_loads
from isf_springback.shell.sheet_model import EdgeCondition, ShellModel, sine_law_thickness

ENGINE_VERSION = 1
"""Raised when the shell changes its results, so that caches made before are not used."""

LOAD_LEVELS = 6


@dataclass(frozen=True)
class DepthTask:
    """Control points of one depth.

    Attributes
    ----------
    index : contour at whose depth the sheet stands
    sheet : its shape
    points : (M, 2) m, loaded places, one after the other
    direction : (3,) unit, of the load
    loads : (L,) N, rising
    young, poisson, thickness : Pa, -, m of the flat blank
    edge : condition of the clamped edge
    size : facets
    engine : "compact", the shell of this package, or "kratos"
    """

    index: int
    sheet: FormedSheet
    points: Array
    direction: Array
    loads: Array
    young: float
    poisson: float
    thickness: float
    edge: EdgeCondition
    size: FacetSize
    engine: str = "compact"

    def digest(self) -> str:
        """Name of the result: all inputs at a resolution of 1 um and nine digits."""
        text = hashlib.sha256()
        for array in (
            *self.sheet.rims,
            *self.sheet.floors,
            self.sheet.places,
            self.sheet.clamp,
            *self.sheet.plates,
            self.points,
        ):
            text.update(np.round(np.asarray(array) * 1e6).astype(np.int64).tobytes())
        for array in (self.direction, self.loads):
            text.update(np.round(np.asarray(array), 9).tobytes())
        numbers = (self.young, self.poisson, self.thickness, self.edge.in_plane, *vars(self.size).values())
        text.update(f"{ENGINE_VERSION} {self.edge.slope} {[f'{number:.9g}' for number in numbers]}".encode())
        if self.engine != "compact":
            text.update(self.engine.encode())
        return text.hexdigest()[:24]


def depth_task(
    contours: Sequence[Contour],
    points: Array,
    job_file: JobFile,
    *,
    direction: Array | None = None,
    size: FacetSize = FacetSize(),  # noqa: B008 - frozen
    loads: Array | None = None,
    engine: str = "compact",
) -> DepthTask:
    """Task for ``points`` (M, 2) m on the last of ``contours``, loaded along the push unless ``direction`` is given.

    Raises
    ------
    IsfError : SHEET_MESH_FAILED
    """
    job, material = job_file.job, job_file.material
    last = contours[-1]
    return DepthTask(
        index=last.index,
        sheet=formed_sheet(contours, job_file.rig.clamp.size, plate_edge(job_file)),
        points=np.asarray(points, dtype=np.float64)[:, :2],
        direction=np.array([0.0, 0.0, last.push_sign]) if direction is None else np.asarray(direction, dtype=float),
        loads=load_levels(job.springback.elastic.largest_load) if loads is None else loads,
        young=material.young_modulus,
        poisson=material.poisson_ratio,
        thickness=job.sheet.thickness,
        edge=edge_condition(job_file),
        size=size,
        engine=engine,
    )


def edge_condition(job_file: JobFile) -> EdgeCondition:
    """Edge of the job: its calibrated spring, else what the rig's clamp says."""
    elastic = job_file.job.springback.elastic
    spring = elastic.edge_stiffness
    if spring is None:
        clamp = job_file.rig.clamp
        spring = np.inf if clamp.edge == "fixed" else clamp.edge_spring or 0.0
    return EdgeCondition(elastic.edge_slope, float(spring))


def load_levels(largest: float, count: int = LOAD_LEVELS) -> Array:
    """(count,) N, rising to ``largest``: equal steps, so that laws fit the large loads as well as the small."""
    return np.asarray(largest * np.arange(1, count + 1) / count)


def solve_depth(task: DepthTask) -> Array:
    """(M, L) m, displacement of every loaded point along the load at every level.

    Raises
    ------
    IsfError : SHEET_MESH_FAILED, SHELL_NOT_SOLVED; FILE_NOT_FOUND, the engine is not installed
    """
    mesh = mesh_of(task.sheet, task.points, task.size)
    thickness = sine_law_thickness(mesh, task.thickness)
    if task.engine == "kratos":
        moved = kratos_displacement(mesh, thickness, task.young, task.poisson, task.edge, task.direction, task.loads)
        return np.asarray(moved @ task.direction)
    model = ShellModel(mesh, thickness, task.young, task.poisson, task.edge)
    moved = follow_loads(model, mesh.loaded.tolist(), task.direction, task.loads, model.factor())
    return np.asarray(moved @ task.direction)
