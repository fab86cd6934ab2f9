"""Scans between contours: which methods look at them, when one is due, and the newest shape a method may use.

Over a die the blank holder moves from contour to contour; shapes, targets and contours then meet in the frame of the
die. How far the unformed floor may stand up as a dome bounds what counts as a plausible shape. m, frame ``sheet``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from isf_core.contour import Contour, Process, contour_label
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile
from isf_core.geometry.height_map import HeightMap
from isf_core.geometry.opening import SMALLEST_GAP
from isf_core.geometry.stage_shapes import StageShapes
from isf_core.types import Array

from isf_springback.scan import FormedShape, ScanExpectation, process_scan
from isf_springback.scan.formed_shape import ANY_SCALE, OPENING_DEPTH, opening_around
from isf_springback.scan.registration import ClampEdges


def scan_due(job_file: JobFile, index: int, count: int) -> bool:
    """True when the shape is measured between contour ``index`` (0-based) and the next one of ``count``."""
    every = job_file.job.springback.scan_every
    return every > 0 and (index + 1) % every == 0 and index + 1 < count


def scan_awaited(job_file: JobFile, index: int) -> bool:
    """True when contour ``index`` is corrected from a scan made just before it."""
    return index > 0 and scan_due(job_file, index - 1, index + 1)


class ScanMemory:
    """Takes scans and the target; gives the shape after one contour, with ``over_die`` in the frame of the die.

    Without ``over_die`` scans over a die are refused: shape, target and contour would not be in one frame.

    Of a part formed in stages the target is the shape that the stage in work ends with.

    Attributes
    ----------
    stage : in work, from 0
    target : the shape that it ends with, None until it is known
    began : the shape that it begins with; None: the flat blank
    shape, index : the newest usable shape and the contour it was measured after
    fault : why the newest scan was refused, None when it was not
    """

    def __init__(self, job_file: JobFile, *, over_die: bool = False) -> None:
        self._job_file = job_file
        self._over_die = over_die
        self.target: HeightMap | None = None
        self.began: HeightMap | None = None
        self.stage = 0
        self._shapes: StageShapes | None = None
        self.shape: FormedShape | None = None
        self.index = -1
        self.fault: IsfError | None = None
        self._taken = -1
        self._edges: ClampEdges | None = None

    def set_target(self, part: HeightMap, preforms: Sequence[HeightMap] = ()) -> None:
        """What the last stage ends with, and its finishing passes, and ``preforms``, the stages before it."""
        self._shapes = StageShapes(part, tuple(preforms))
        self.work_on(self.stage)

    def work_on(self, stage: int) -> None:
        """``stage``, from 0, is in work."""
        self.stage = stage
        if self._shapes is not None:
            self.target, self.began = self._shapes.end(stage), self._shapes.begin(stage)

    def clear(self) -> None:
        """A new part begins."""
        self.shape, self.index, self.fault, self._edges = None, -1, None, None

    def take(self, points: Array, contour: Contour | None, index: int) -> FormedShape | None:
        """The shape in ``points`` (P, 3) m after ``contour`` as planned; None with a ``fault`` when it is refused."""
        self.fault, self._taken = None, index
        if contour is not None:
            self.work_on(contour.stage)
        try:
            if self.target is None:
                raise IsfError(
                    ErrorCode.CORRECTION_FAILED,
                    "the target shape is not known",
                    where=f"scan after {contour_label(index)}",
                    advice="the planner publishes part/target; without it the last good correction is kept",
                )
            if contour is None or contour.index != index:
                raise IsfError(
                    ErrorCode.CONTOUR_OUT_OF_ORDER,
                    f"a scan after {contour_label(index)} came, "
                    f"{'no contour' if contour is None else contour_label(contour.index)} was formed last",
                    where="scan",
                )
            clamp = self._job_file.rig.clamp.size
            if contour.process is Process.TPIF and not self._over_die:
                raise IsfError(
                    ErrorCode.CORRECTION_FAILED,
                    "over a die the method does not know where shape and target lie relative to each other",
                    where=f"scan after {contour_label(index)}",
                    advice="use the method mpc_tpif",
                )
            if contour.process is Process.TPIF:
                self.shape = shape_over_die(points, self.target, clamp, contour, self._edges)
            else:
                level, began = float(contour.forming_tip[:, 2].min()), self.began
                dome = plausible_dome(self._job_file, contour, self.target, began)
                # other features are formed already, or not begun
                worked = opening_around(self.target, contour.contact[:, :2])
                self.shape = process_scan(
                    points,
                    ScanExpectation(
                        self.target, clamp, level, dome=dome, edges=self._edges, worked=worked, began=began
                    ),
                )
            self.index, self._edges = index, self.shape.edges
            return self.shape
        except IsfError as error:
            self.fault = error
            return None

    def fault_before(self, contour: Contour) -> IsfError | None:
        """Why the scan made just before ``contour`` was refused; None when it was not, or there was none."""
        return self.fault if self._taken == contour.index - 1 else None

    def since(self, index: int) -> FormedShape | None:
        """The newest shape, if it was measured after contour ``index`` or a later one."""
        return self.shape if self.index >= index else None


def shape_over_die(
    points: Array,
    target: HeightMap,
    clamp: tuple[float, float],
    contour: Contour,
    edges: ClampEdges | None = None,
    *,
    clamped: bool = True,
    least_scale: float = ANY_SCALE,
) -> FormedShape:
    """The shape after ``contour`` over a die, in the frame of the die (frame ``sheet`` before the holder moves).

    ``points`` (P, 3) m in frame ``sheet``, in which the flange stays at z = 0 and the part stands up; ``target`` the
    finished part on its flange; ``edges`` of the clamp in an earlier scan; ``clamped`` and ``least_scale`` as in
    ScanExpectation.
    Turned over, what stands up so far is a pocket as deep as the holder has moved (:func:`turned_shape`).

    Raises
    ------
    IsfError : as :func:`isf_springback.scan.process_scan`
    """
    holder = contour.holder_height
    stands = np.maximum(target_over_die(target).z - holder, 0.0)
    stood = HeightMap(target.x, target.y, stands)
    shape = turned_shape(points, stood, clamp, edges, clamped=clamped, least_scale=least_scale)
    return replace(shape, surface=HeightMap(shape.surface.x, shape.surface.y, holder + shape.surface.z))


def turned_shape(
    points: Array,
    target: HeightMap,
    clamp: tuple[float, float],
    edges: ClampEdges | None = None,
    *,
    clamped: bool = True,
    least_scale: float = ANY_SCALE,
) -> FormedShape:
    """The shape in ``points`` (P, 3) m of a ``target`` that stands up, all of it formed: checked as a pocket is, of
    ``least_scale`` of its depth.

    Raises
    ------
    IsfError : as :func:`isf_springback.scan.process_scan`
    """
    pocket = HeightMap(target.x, target.y, -target.z)
    turned = ScanExpectation(
        pocket, clamp, float(np.nanmin(pocket.z)), clamped=clamped, edges=edges, least_scale=least_scale
    )
    shape = process_scan(np.asarray(points) * np.array([1.0, 1.0, -1.0]), turned)
    return replace(shape, surface=HeightMap(shape.surface.x, shape.surface.y, -shape.surface.z))


def target_over_die(target: HeightMap) -> HeightMap:
    """``target``, the finished part on its flange, in the frame of the die: there its top is at z = 0."""
    return HeightMap(target.x, target.y, target.z - float(np.nanmax(target.z)))


def contour_over_die(contour: Contour) -> Contour:
    """``contour`` in the frame of the die; as it is where there is no blank holder."""
    up = np.array([0.0, 0.0, contour.holder_height])
    return replace(contour, contact=contour.contact + up, forming_tip=contour.forming_tip + up)


def plausible_dome(job_file: JobFile, contour: Contour, target: HeightMap, began: HeightMap | None = None) -> float:
    """m, largest height of the floor's middle over its edge after ``contour`` of the part ``target``, whose stage
    ``began`` with a shape, None: a flat one.

    With the radii r of the opening and R of the edge (of circles of the same area) and the depth d so far: a paraboloid
    of the slope d / (R - r), at most that of the steepest wall, is slope r / 2 high; of the curvature 2 s / (E t) at
    which the sheet begins to yield, s r^2 / (E t).
    """
    cell = float((target.x[1] - target.x[0]) * (target.y[1] - target.y[0]))
    opening = float(np.sqrt(np.count_nonzero(target.z < -OPENING_DEPTH) * cell / np.pi))
    if opening <= 0.0:
        return 0.0
    plate, clamp = job_file.job.backing_plate, job_file.rig.clamp.size
    edge = float(np.sqrt(clamp[0] * clamp[1] / np.pi)) if plate is None else plate.round_radius
    gap = max(edge - opening, SMALLEST_GAP * edge)
    deepest = float(contour.forming_tip[:, 2].min())
    depth = max(-(deepest if began is None else min(deepest, float(np.nanmin(began.z)))), 0.0)
    slope = min(depth / gap, float(np.tan(contour.wall_angle.max())))
    material = job_file.material
    elastic = material.yield_strength * opening**2 / (material.young_modulus * job_file.job.sheet.thickness)
    return float(min(0.5 * slope * opening, elastic))
