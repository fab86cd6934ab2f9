"""A force controller at rest kept in a file, and taken up by one that was armed anew: it goes on bit by bit.

A numpy archive of plain arrays with a header in JSON: format, version, software, plan and the structure of the state.
Configuration and rig are those of the job that was armed.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from isf_core import __version__
from isf_core.contour import Contour, Process
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.archive import read_archive, write_archive
from isf_core.files.bounded import parse_json, reason
from isf_core.object_state import Encoder, StateMismatchError

from isf_force_ctrl.control_state import Mode
from isf_force_ctrl.controller import ForceController
from isf_force_ctrl.motion.tool_moves import Tools
from isf_force_ctrl.motion.trajectory import ToolPath

FORMAT, VERSION = "isf-force-control-state", 3


def save_controller(controller: ForceController, path: Path) -> None:
    """Replace the file ``path``.

    Raises
    ------
    IsfError : NOT_ARMED, nothing is armed or the tools are moving; FILE_NOT_WRITABLE
    """
    if controller.mode is Mode.IDLE or controller.busy:
        raise IsfError(
            ErrorCode.NOT_ARMED, "a controller is kept when it is armed and at rest", advice="between two contours"
        )
    encoder = _encoder()
    header = {
        "format": FORMAT,
        "version": VERSION,
        "software": __version__,
        "plan_id": controller.plan_id,
        "state": encoder.encode(controller),
    }
    arrays: dict[str, Any] = {f"a{k}": array for k, array in enumerate(encoder.arrays)}
    arrays["header"] = np.frombuffer(json.dumps(header).encode(), dtype=np.uint8)
    write_archive(path, arrays, make_folder=True)


def load_controller(controller: ForceController, path: Path) -> None:
    """Bring ``controller``, just armed with the same job and plan, into the state of the file.

    A controller for which this raises CHECKPOINT_UNUSABLE is not to be used any more.

    Raises
    ------
    IsfError : FILE_NOT_FOUND; CHECKPOINT_UNUSABLE, damaged, of another version or plan
    """
    advice = "form the part again, on a fresh blank"
    try:
        archive = read_archive(path)
        header = parse_json(archive["header"].tobytes())
        arrays = [archive[f"a{k}"] for k in range(len(archive) - 1)]
        known = (header["format"], header["version"], header["software"], header["plan_id"])
        state = header["state"]
    except FileNotFoundError as error:
        raise IsfError(ErrorCode.FILE_NOT_FOUND, "no such file", where=str(path), advice=advice) from error
    except (OSError, KeyError, ValueError, TypeError) as error:
        raise IsfError(
            ErrorCode.CHECKPOINT_UNUSABLE, f"is damaged: {reason(error)}", where=str(path), advice=advice
        ) from error
    if known != (FORMAT, VERSION, __version__, controller.plan_id):
        what = f"is of {' '.join(map(str, known))}, wanted is {FORMAT} {VERSION} {__version__} {controller.plan_id}"
        raise IsfError(ErrorCode.CHECKPOINT_UNUSABLE, what, where=str(path), advice=advice)
    try:
        _encoder().decode(state, arrays, controller)
    except (StateMismatchError, KeyError, IndexError, TypeError, ValueError, AttributeError) as error:
        raise IsfError(
            ErrorCode.CHECKPOINT_UNUSABLE, f"does not fit this software: {error}", where=str(path), advice=advice
        ) from error


def _encoder() -> Encoder:
    # a controller that was just armed has formed nothing yet
    return Encoder(records=(Contour, ToolPath, Tools), enums=(ErrorCode, Mode, Process))
