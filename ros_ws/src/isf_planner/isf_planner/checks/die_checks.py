"""Is the die where the part says it is? Checked against the sheet and against the tool, in the frame of the die."""

from __future__ import annotations

import numpy as np
import trimesh
from isf_core.contour import Contour, contour_label
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import Job, JobFile
from isf_core.process.thickness_and_tips import sine_law
from isf_core.types import Array
from scipy.interpolate import RegularGridInterpolator
from scipy.spatial import KDTree

from isf_planner.part import meshes
from isf_planner.part.mesh_checks import check_size, place_text
from isf_planner.part.meshes import Mesh
from isf_planner.surface import surface_kernels, target_surface
from isf_planner.surface.target_surface import TargetSurface

EDGE = 0.7e-3
"""m, spacing of the points by which a die is checked."""

INTO_SHEET = 50e-6
"""m, by which the die may stand into the sheet: faceting of both meshes."""

APART = 0.3e-3
"""m, by which the whole die may stay away from the sheet before it is in the wrong place (assumed)."""

CRUSHED = 0.9
"""Part of the formed thickness that has to be left between tool and die."""


def load_die(job_file: JobFile) -> Array:
    """(M, 3) m, points on the surface of the job's die, no farther apart than about ``EDGE``.

    Raises
    ------
    IsfError : as :func:`isf_planner.part.meshes.load_mesh` and :func:`isf_planner.part.mesh_checks.check_size`;
        FILE_FIELD when the job has no die
    """
    die = job_file.job.die
    if die is None:
        raise IsfError(
            ErrorCode.FILE_FIELD, "process TPIF needs a die", where="die", advice="add die.mesh and die.unit"
        )
    mesh = meshes.load_mesh((job_file.base / die.mesh).resolve(), die.unit)
    check_size(
        mesh, job_file.rig.clamp.size, job_file.job.tool_1.radius, "die"
    )  # a wrong unit makes billions of points
    vertices, _ = trimesh.remesh.subdivide_to_size(mesh.vertices, mesh.faces, EDGE, max_iter=30)
    return np.unique(np.round(vertices, 7), axis=0)


def check_die(part: Mesh, height: float, job_file: JobFile) -> None:
    """The die keeps under the lower face of the finished sheet and reaches it somewhere.

    ``part`` in the frame of the die, ``height`` m of it over its flange.

    Raises
    ------
    IsfError : DIE_COLLISION with the place
    """
    points = load_die(job_file)
    size = tuple(float(2.2 * side) for side in np.abs(np.vstack([points, part.vertices]))[:, :2].max(axis=0))
    # the sampler knows the sheet at z = 0 beside the part: there it is the flange
    upper = target_surface.target_map(part.moved(np.array([0.0, 0.0, height])), (size[0], size[1]))
    face = RegularGridInterpolator((upper.y, upper.x), upper.z, bounds_error=False, fill_value=0.0)
    # under the sine law the lower face lies one blank's thickness straight below the upper one
    lower = face(points[:, 1::-1]) - height - job_file.job.sheet.thickness
    into = points[:, 2] - lower
    worst = int(np.argmax(into))
    tolerance = INTO_SHEET + _sampling_error(upper.z)
    if into[worst] > tolerance:
        raise IsfError(
            ErrorCode.DIE_COLLISION,
            f"the die stands {into[worst] * 1e3:.2f} mm into the finished sheet",
            where=f"die at {place_text(points[worst])}",
            advice="the die's surface is the part's lower face: the upper one less the blank's thickness, or below it",
        )
    if into[worst] < -APART - tolerance:
        raise IsfError(
            ErrorCode.DIE_COLLISION,
            f"the die stays {-into[worst] * 1e3:.2f} mm away from the finished sheet everywhere: it supports nothing",
            where=f"die at {place_text(points[worst])}",
            advice="give the die before the holder moves: the lower face of the blank lies on top of it",
        )


def check_tool(contours: tuple[Contour, ...], job: Job, points: Array, surface: TargetSurface) -> None:
    """The tool leaves the sheet its room over the die's ``points`` (M, 3) m, wherever the ball is near to the die.

    A ball may meet a wall and the flange at once, where the sheet has two thicknesses: each place is compared with its
    own, by the sine law on the sampled target ``surface`` in the frame of the die.

    Raises
    ------
    IsfError : DIE_COLLISION with contour and place
    """
    tree = KDTree(points)
    ball, blank = job.tool_1.ball_radius, job.sheet.thickness

    def formed(places: Array) -> Array:
        """(N,) m, thickness of the sheet at ``places`` (N, 3) m."""
        flat = np.ascontiguousarray(places[:, :2])
        tangent = surface_kernels.horizontal_normals(surface.normal_xy, surface.origin, surface.pitch, flat)
        return sine_law(blank, np.arcsin(np.clip(np.hypot(*tangent.T), 0.0, 1.0)))

    for contour in contours:
        contact = contour.contact + np.array([0.0, 0.0, contour.holder_height])
        centres = contact + ball * contour.normal
        near = KDTree(centres).sparse_distance_matrix(tree, ball + CRUSHED * blank, output_type="ndarray")
        if len(near) == 0:
            continue
        centre, die = centres[near["i"]], points[near["j"]]
        pressed = centre + ball * (die - centre) / np.maximum(near["v"], np.finfo(float).tiny)[:, None]
        # what lies between the two is slanted: the thinner end is what has to have room
        sheet = np.minimum(formed(die), formed(pressed))
        free = near["v"] - ball
        missing = CRUSHED * sheet - free
        worst = int(np.argmax(missing))
        if missing[worst] > INTO_SHEET:
            raise IsfError(
                ErrorCode.DIE_COLLISION,
                f"only {max(float(free[worst]), 0.0) * 1e3:.2f} mm are left between tool and die for a sheet of "
                f"{sheet[worst] * 1e3:.2f} mm",
                where=f"{contour_label(contour.index)} at {place_text(pressed[worst])}",
                advice="lower the die, or use a die whose surface follows the part's lower face",
            )


def _sampling_error(z: Array) -> float:
    """m, bound of what bilinear interpolation on the map's grid errs, from its second differences."""
    return 0.25 * float(max(np.abs(np.diff(z, 2, axis=0)).max(), np.abs(np.diff(z, 2, axis=1)).max()))
