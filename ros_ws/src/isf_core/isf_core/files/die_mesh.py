"""The upper surface of a job's die, read from its mesh file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from isf_core.errors import ErrorCode, IsfError
from isf_core.files.bounded import read_content
from isf_core.files.job import METRES, JobFile
from isf_core.files.mesh_parser import LARGEST, parse_mesh


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
    advice = f"export the surface as one of {', '.join(LARGEST)}, coarser where it is too large"
    kind = path.suffix.lower().lstrip(".")
    if kind not in LARGEST:
        raise IsfError(
            ErrorCode.MESH_UNREADABLE, f"'{path.suffix}' is not a mesh format", where=str(path), advice=advice
        )
    try:
        loaded = parse_mesh(read_content(path, LARGEST[kind]), kind)
        mesh = loaded.to_mesh() if hasattr(loaded, "to_mesh") else loaded
        vertices = np.asarray(mesh.vertices, dtype=np.float64).reshape(-1, 3)
        faces = np.asarray(getattr(mesh, "faces", np.empty((0, 3))), dtype=np.int64).reshape(-1, 3)
    except FileNotFoundError as error:
        raise IsfError(
            ErrorCode.FILE_NOT_FOUND, "no such die", where=str(path), advice="die.mesh is relative to the job file"
        ) from error
    except OSError as error:
        what = f"cannot be read: {error.strerror}"
        raise IsfError(ErrorCode.MESH_UNREADABLE, what, where=str(path), advice=advice) from error
    except (ValueError, TypeError, AttributeError) as error:  # not a mesh, or arrays that belong to none
        what = f"cannot be read: {error}"
        raise IsfError(ErrorCode.MESH_UNREADABLE, what, where=str(path), advice=advice) from error
    if len(faces) == 0:
        raise IsfError(ErrorCode.MESH_EMPTY, "has no triangles", where=str(path), advice=advice)
    return DieMesh(path, METRES[die.unit] * vertices, faces)
