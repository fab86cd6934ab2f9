"""Room between the forming tool and the die: how far a contour may be corrected before it presses the sheet onto it.

Frame of the die: frame ``sheet`` with the blank holder at its start (``scan_memory.contour_over_die``).
Room is the free distance of ball and die less the thickness of the sheet between them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from isf_core.contour import Contour
from isf_core.files.die_mesh import read_die
from isf_core.files.job import JobFile
from isf_core.types import Array, Mask
from scipy.spatial import KDTree

from isf_springback.loop_path import PUSH_SLOPE, LoopPath, below_values

SPACING = 0.7e-3
"""m between the points by which the die is known: the distance of a ball of 5 mm from it is then right to 10 um."""

BESIDE = 0.1e-3
"""m of room from which the sheet counts as free of the die (assumed: more than its faceting and its thickness err)."""

_HALVINGS = 10


@dataclass(frozen=True)
class DieRoom:
    """The die as points in its frame, in a tree, and the ``radius`` m of the forming ball."""

    tree: KDTree
    radius: float

    def of(self, contour: Contour, offset: Array | float = 0.0) -> Array:
        """(N,) m, room at the points of ``contour`` moved by ``offset`` (N, 3) m; negative where it is pressed."""
        centre = contour.contact + offset + self.radius * contour.normal
        return np.asarray(self.tree.query(centre)[0] - self.radius - contour.thickness)


def die_room(job_file: JobFile) -> DieRoom | None:
    """The die of a job; None when it has none.

    Raises
    ------
    IsfError : FILE_NOT_FOUND, MESH_UNREADABLE, MESH_EMPTY
    """
    mesh = read_die(job_file)
    if mesh is None:
        return None
    import trimesh  # late: jobs without a die need not pay

    points, _ = trimesh.remesh.subdivide_to_size(mesh.vertices, mesh.faces, SPACING, max_iter=30)
    return DieRoom(KDTree(np.unique(np.round(points, 7), axis=0)), job_file.job.tool_1.ball_radius)


def free_of_die(room: DieRoom, contour: Contour) -> Mask:
    """(N,) points of ``contour``, in the frame of the die, at which the die does not carry the sheet."""
    return room.of(contour) > BESIDE


def within_room(room: DieRoom, contour: Contour, offset: Array) -> tuple[Array, Mask]:
    """``offset`` (N, 3) m shortened where it would leave the sheet less room than it needs, and where (N,).

    ``contour`` in the frame of the die. Where the plan itself leaves less, it stays as planned. The share that is left
    of the offset changes along the path no faster than a correction may.
    """
    least = np.minimum(room.of(contour), 0.0)

    def fits(share: Array) -> Mask:
        return np.asarray(room.of(contour, share[:, None] * offset) >= least - 1e-6)

    pressed = ~fits(np.ones(len(contour)))
    if not pressed.any():
        return offset, pressed
    low, high = np.zeros(len(contour)), np.ones(len(contour))
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        good = fits(middle)
        low, high = np.where(good, middle, low), np.where(good, high, middle)
    share = np.where(pressed, low, 1.0)
    size = max(float(np.linalg.norm(offset, axis=1).max()), 1e-9)
    share = np.asarray(below_values(LoopPath.of(contour), share, PUSH_SLOPE / size))
    return share[:, None] * offset, share < 1.0
