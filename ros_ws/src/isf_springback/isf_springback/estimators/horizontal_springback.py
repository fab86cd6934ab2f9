"""Horizontal part of the method "elastic": springback across the wall from the measured horizontal force.

While a wall is formed the tool pushes it outwards; when it leaves, the wall comes back inwards by what the shell says
under that force (Ren 2018, Table 4.6: about a third of the axial force, 0.6 mm at 200 N on the cone, left uncorrected
there). The contour is moved outwards by as much. Only the component across the path counts: along the path the force is
friction. The squeeze between two tools is a pair that leaves the sheet alone; it vanishes in the sum over both tools.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from isf_core.contour import Contour, ContourResult
from isf_core.files.job import JobFile
from isf_core.types import Array
from numpy.typing import NDArray

from isf_springback.database.control_points import ControlLoop
from isf_springback.database.elastic_samples import depth_task, load_levels
from isf_springback.database.load_displacement import CubicLaw, cubic_law
from isf_springback.estimators.estimator import Wall, wall_of
from isf_springback.loop_path import LoopPath, moving_average, nearest_points
from isf_springback.shell.formed_sheet import FacetSize, mesh_of
from isf_springback.shell.load_path import follow_loads
from isf_springback.shell.sheet_model import ShellModel, sine_law_thickness

LOAD_SHARE = 0.5
"""Largest horizontal load of the samples as a part of the axial one (published: the force is about a third)."""

LEVELS = 3

SECTORS = 24
"""Parts of the path over one of which the force is averaged (as for the axial force)."""

SMALLEST_SLOPE = np.sin(np.radians(10.0))
"""Horizontal part of the normal below which a place has no outward direction worth a correction."""


@dataclass(frozen=True)
class AcrossLoad:
    """Outward load of one contour: ``place`` (N, 2) m, ``load`` (N,) N on the sheet, positive outwards."""

    index: int
    place: Array
    load: Array


@dataclass(frozen=True)
class AcrossLevel:
    """Laws of one depth: ``places`` (M, 2) m along the loop, their ``law`` across the wall."""

    depth: float
    places: Array
    law: CubicLaw


def outward(contour: Contour) -> Array:
    """(N, 2) unit vectors in which the forming tool pushes the wall; zero where the sheet lies flat."""
    across = -np.asarray(contour.normal)[:, :2]
    size = np.linalg.norm(across, axis=1)
    steep = size > SMALLEST_SLOPE
    return np.asarray(np.where(steep[:, None], across / np.maximum(size, 1e-12)[:, None], 0.0))


def across_load(contour: Contour, result: ContourResult) -> AcrossLoad | None:
    """Load across the path, averaged over a sector; None when the result has no such forces or not finite ones."""
    force = np.asarray(result.forming_force, dtype=np.float64)
    if force.shape != (len(contour), 3):
        return None
    support = np.asarray(result.support_force, dtype=np.float64)
    if contour.has_support:
        if support.shape != force.shape:
            return None
        force = force + support
    load = -(force[:, :2] * outward(contour)).sum(axis=1)
    if not np.isfinite(load).all():
        return None
    path = LoopPath.of(contour)
    mean = moving_average(path, load, path.length / SECTORS)
    return AcrossLoad(contour.index, contour.forming_tip[:, :2].copy(), mean)


def across_level(
    contours: Sequence[Contour], loop: ControlLoop, places: Array, row: NDArray[np.int64], job_file: JobFile
) -> AcrossLevel:
    """Laws at the control points ``loop`` of the last of ``contours`` from computations at ``places`` (K, 2) m.

    ``row`` (M,) names the computation of each control point.

    Raises
    ------
    IsfError : SHEET_MESH_FAILED, SHELL_NOT_SOLVED, DATABASE_UNUSABLE
    """
    contour = contours[-1]
    loads = load_levels(LOAD_SHARE * job_file.job.springback.elastic.largest_load, LEVELS)
    task = depth_task(contours, places, job_file, size=FacetSize.coarse(), loads=loads)
    mesh = mesh_of(task.sheet, task.points, task.size)
    model = ShellModel(mesh, sine_law_thickness(mesh, task.thickness), task.young, task.poisson, task.edge)
    outwards = outward(contour)[nearest_points(places, contour.contact[:, :2])]
    along = np.column_stack([outwards, np.zeros(len(outwards))])
    moved = follow_loads(model, mesh.loaded.tolist(), along, loads, model.factor())
    samples = np.einsum("mlk,mk->ml", moved, along)
    depth = float(contour.contact[:, 2].mean())
    return AcrossLevel(depth, loop.points[:, :2], cubic_law(loads, samples[row]))


@dataclass
class _WallState:
    """What is known of one wall: the newest laws (``level``), the newest ``load``, and the indices of its contour in
    work (``index``) and of the one ``before`` that, -1 where there is none."""

    level: AcrossLevel | None = None
    load: AcrossLoad | None = None
    index: int = -1
    before: int = -1


class HorizontalSpringback:
    """State: what is known of every wall of the part."""

    def __init__(self, job_file: JobFile) -> None:
        self._job_file = job_file
        self._plan_id = ""
        self._walls: dict[Wall, _WallState] = defaultdict(_WallState)
        self._now = _WallState()

    @property
    def level(self) -> AcrossLevel | None:
        """The newest laws of the wall in work."""
        return self._now.level

    @level.setter
    def level(self, level: AcrossLevel) -> None:
        self._now.level = level

    def begin(self, contour: Contour) -> None:
        """Prepare for ``contour``; another plan, and another wall, begins without laws."""
        if contour.plan_id != self._plan_id:
            self._walls.clear()
        self._plan_id = contour.plan_id
        now = self._now = self._walls[wall_of(contour)]
        if contour.index != now.index:
            now.before, now.index = now.index, contour.index

    def due(self, contour: Contour) -> bool:
        """True when ``contour`` is a loop increment deeper than the laws at hand, and walls have begun."""
        if not outward(contour).any():
            return False
        level, depth = self.level, float(contour.contact[:, 2].mean())
        step = self._job_file.job.springback.elastic.loop_increment - 1e-6
        return level is None or abs(depth - level.depth) >= step

    def add_result(self, contour: Contour, result: ContourResult) -> None:
        """The load measured on ``contour``; without one the last offset is kept."""
        self._now.load = across_load(contour, result) if result.completed else None

    def wanted(self, contour: Contour) -> Array | None:
        """(N,) m, outward offset against the springback across the wall under the load of its contour before; None:
        not known."""
        load, level = self._now.load, self.level
        if load is None or level is None or load.index != self._now.before:
            return None
        path = LoopPath.of(contour)
        place = nearest_points(level.places, contour.contact[:, :2])
        order = np.argsort(path.position[place], kind="stable")
        place = place[order]
        force = load.load[nearest_points(contour.forming_tip[place, :2], load.place)]
        springback = CubicLaw(level.law.k[order]).displacement(force)
        period = path.length if path.closed else None
        along = np.interp(path.position, path.position[place], springback, period=period)
        return np.asarray(self._job_file.job.springback.gain * along)
