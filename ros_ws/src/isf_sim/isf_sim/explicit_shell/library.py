"""The compiled kernels of shell.c, and the structs they share with Python."""

from __future__ import annotations

import ctypes
import os
from collections.abc import Callable
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any, cast

import numpy as np
from isf_core.errors import ErrorCode, IsfError
from numpy.typing import NDArray

LAYERS = 5
"""Points through the thickness."""

TOOLS = 2

LANES = 8
"""Elements that vector code computes at once: a row of another number of them has a slow rest."""

_double, _long, _pointer = ctypes.c_double, ctypes.c_int64, ctypes.c_void_p


class ShellStruct(ctypes.Structure):
    """``Shell`` of shell.c, field by field; ``arrays`` are what it points to."""

    constant_of_state = True
    """Made from the sheet: not part of a saved machine."""

    arrays: dict[str, NDArray[Any]]

    _fields_ = (
        *((name, _long) for name in ("nx", "ny", "table_size", "support_size", "spring_size")),
        *(
            (name, _double)
            for name in (
                "young", "poisson", "step", "damping", "table_step", "contact", "contact_time", "friction",
                "slip_speed", "drag", "kinematic",
            )
        ),
        *(
            (name, _pointer)
            for name in (
                "position", "velocity", "spin", "force", "moment", "per_mass", "per_inertia", "spring_node", "spring",
                "spring_limit", "anchor", "fixed", "load", "thickness", "stress", "plastic_strain", "shear",
                "hourglass", "plastic_work", "drilling", "back_stress", "element_force", "contact_force", "in_contact",
                "thickness_before", "flow_stress", "hardening", "area",
            )
        ),
        ("support_nx", _long),
        ("support_ny", _long),
        *((name, _double) for name in ("support_x", "support_y", "support_spacing", "support_from", "support_to")),
        *(
            (name, _pointer)
            for name in (
                "support_height", "support_plane", "support_element", "support_weight", "support_area", "support_near",
            )
        ),
    )  # fmt: skip


TOOL = np.dtype(
    [
        ("side", "f8"),
        ("radius", "f8"),
        ("flat", "f8"),
        ("begin", "f8", 3),
        ("end", "f8", 3),
        ("compliance", "f8", 3),
        ("felt", "f8", 3),
        ("mean", "f8", 3),
        ("node", "i8", 2),
        ("touching", "i8"),
    ]
)
"""``Tool`` of shell.c: an array of these is what the kernels change."""


SMALLEST_SHARE = 20_000
"""Steps times elements from which on a second thread is faster: one takes some 30 us to start."""


ALONE = 2000
"""Calls with one thread, after one in which other work needed the processors (chosen)."""

THREADS = "ISF_SHELL_THREADS"
"""Variable of the environment with the number of threads of a sheet, 1 or 2."""


def threads() -> int:
    """How many threads compute a sheet: two, on two processors, unless :data:`THREADS` is 1."""
    wanted = 1 if os.environ.get(THREADS) == "1" else 2
    return min(wanted, len(os.sched_getaffinity(0)))


@cache
def advance() -> Callable[..., int]:
    """``isf_shell_advance(shell, tools, steps, smoothing, threads, cpu)``, whether the second thread ended early.

    Raises IsfError when it was not built.
    """
    try:
        module = import_module("isf_sim.explicit_shell._shell")
    except ImportError as error:
        raise IsfError(
            ErrorCode.INTERNAL,
            f"the compiled part of the sheet model cannot be loaded: {error}",
            where=str(Path(__file__).parent),
            advice="build the workspace again (colcon build; a C compiler is needed)",
        ) from error
    function = ctypes.CDLL(str(module.__file__)).isf_shell_advance
    function.argtypes = (
        ctypes.POINTER(ShellStruct), ctypes.c_void_p, _long, _double, _long, ctypes.POINTER(_double)
    )  # fmt: skip
    function.restype = _long
    return cast(Callable[..., int], function)
