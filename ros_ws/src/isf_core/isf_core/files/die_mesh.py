"""The upper surface of a job's die, read from its mesh file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import METRES, JobFile


@dataclass(frozen=True)
class DieMesh:
    """Frame ``sheet`` with the blank holder at its start.

    Attributes
    ----------
    path : the file
    vertices : (V, 3) m ; faces : (F, 3) indices
    """

    path: Path
    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]


def read_die(job_file: JobFile) -> DieMesh | None:
    """The die of a job; None when it has none.

    Raises
    ------
    IsfError : FILE_NOT_FOUND, MESH_UNREADABLE, MESH_EMPTY
    """
    die = job_file.job.die
    if die is None:
        return None
    path = (job_file.base / die.mesh).resolve()
    if not path.is_file():
        raise IsfError(
            ErrorCode.FILE_NOT_FOUND, "no such die", where=str(path), advice="die.mesh is relative to the job file"
        )
    import trimesh  # late: jobs without a die need not pay

    try:
        mesh = trimesh.load(path, force="mesh")
        vertices, faces = np.asarray(mesh.vertices, dtype=np.float64), np.asarray(mesh.faces, dtype=np.int64)
    except Exception as error:  # trimesh raises whatever its loaders raise
        raise IsfError(ErrorCode.MESH_UNREADABLE, f"cannot be read: {error}", where=str(path)) from error
    if len(faces) == 0:
        raise IsfError(ErrorCode.MESH_EMPTY, "has no triangles", where=str(path))
    return DieMesh(path, METRES[die.unit] * vertices, faces)
