"""What was learned from formed parts, in one file: the correction of every contour, and samples of springback.

The file is numpy's npz without pickled objects; lengths in m. The correction field belongs to one part (job and plan);
the samples, springback with wall angle, curvature and distance to the rim, carry over to other parts.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from isf_core.errors import ErrorCode, IsfError
from isf_core.types import Array
from numpy.typing import NDArray

FORMAT = 1
FEATURES = (
    "wall angle [rad]",
    "curvature of the contour [1/m]",
    "depth of the contact [m]",
    "distance to the floor [m]",
)


@dataclass(frozen=True)
class Learned:
    """Knowledge from the parts formed so far; K rows are places on contours, S rows are samples.

    Attributes
    ----------
    job : name of the job ; contours : number of contours of its plan ; parts : parts learned from
    contour : (K,) index ; place : (K, 2) m, contact in plan view
    push : (K,) m, correction for the next part ; applied : (K,) m, that of the last part
    error : (K,) m, formed minus target height there after the last part, NaN where not seen
    gain : (K,) part of the error that is put into the next correction
    feature : (S, 4), see :data:`FEATURES` ; springback : (S,) m
    history : (P, 2) m, mean and largest error of the wall and floor below the rim, per part
    """

    job: str
    contours: int
    parts: int
    contour: NDArray[np.int64]
    place: Array
    push: Array
    applied: Array
    error: Array
    gain: Array
    feature: Array
    springback: Array
    history: Array

    def of_contour(self, index: int) -> tuple[Array, Array]:
        """Places (M, 2) m and push (M,) m of contour ``index``."""
        rows = self.contour == index
        return self.place[rows], self.push[rows]


def save(learned: Learned, path: Path) -> None:
    """Write ``learned``; raises IsfError FILE_NOT_WRITABLE."""
    values: dict[str, Any] = {name: np.asarray(value) for name, value in vars(learned).items()}
    try:
        with path.open("wb") as stream:
            np.savez_compressed(stream, format=np.asarray(FORMAT), **values)
    except OSError as error:
        raise IsfError(ErrorCode.FILE_NOT_WRITABLE, f"cannot be written: {error}", where=str(path)) from error


def load(path: Path) -> Learned:
    """Read a file of :func:`save`; raises IsfError LEARNING_UNUSABLE."""
    advice = "make it with: isf learn RUN... -o FILE"
    try:
        with np.load(path, allow_pickle=False) as data:
            if int(data["format"]) != FORMAT:
                raise ValueError(f"format {int(data['format'])}, this software reads {FORMAT}")
            values = {name: data[name] for name in Learned.__dataclass_fields__}
    except (OSError, ValueError, KeyError, EOFError) as error:
        raise IsfError(
            ErrorCode.LEARNING_UNUSABLE, f"cannot be used: {error}", where=str(path), advice=advice
        ) from error
    except Exception as error:  # zipfile and zlib raise their own errors for a damaged file
        raise IsfError(ErrorCode.LEARNING_UNUSABLE, f"is damaged: {error}", where=str(path), advice=advice) from error
    learned = Learned(
        **{**values, "job": str(values["job"]), "contours": int(values["contours"]), "parts": int(values["parts"])}
    )
    rows, samples = len(learned.contour), len(learned.springback)
    shapes = [learned.place.shape == (rows, 2), learned.push.shape == (rows,), learned.feature.shape == (samples, 4)]
    if not all(shapes) or not np.isfinite(learned.push).all() or not np.isfinite(learned.springback).all():
        raise IsfError(ErrorCode.LEARNING_UNUSABLE, "its arrays do not fit together", where=str(path), advice=advice)
    return learned
