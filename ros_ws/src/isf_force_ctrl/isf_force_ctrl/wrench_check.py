"""Are two wrenches believable: finite and within the rig's force limits?"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from isf_core.errors import ErrorCode

Vector = tuple[float, float, float]


def plausible(wrench_1: Sequence[float], wrench_2: Sequence[float], limit: Vector) -> bool:
    """True when both wrenches (6,) are finite and their forces within ``limit`` (3,) N."""
    x, y, z = limit
    total = float(sum(wrench_1) + sum(wrench_2))
    return bool(
        math.isfinite(total)
        and -x <= wrench_1[0] <= x
        and -y <= wrench_1[1] <= y
        and -z <= wrench_1[2] <= z
        and -x <= wrench_2[0] <= x
        and -y <= wrench_2[1] <= y
        and -z <= wrench_2[2] <= z
    )


def fault_of(wrench_1: Sequence[float], wrench_2: Sequence[float], limit: Vector) -> tuple[ErrorCode, str]:
    """Code and text for wrenches that are not :func:`plausible`."""
    for tool, wrench in ((1, wrench_1), (2, wrench_2)):
        values = np.asarray(wrench, dtype=float)
        if not np.isfinite(values).all():
            return ErrorCode.WRENCH_NOT_FINITE, f"tool_{tool}/wrench is not finite (check the load cell and its cable)"
        beyond = np.abs(values[:3]) > limit
        if beyond.any():
            axis = int(np.argmax(beyond))
            return (
                ErrorCode.WRENCH_OUT_OF_RANGE,
                f"tool_{tool} reads {values[axis]:.0f} N in {'xyz'[axis]}, the rig allows {limit[axis]:.0f} N",
            )
    return ErrorCode.WRENCH_NOT_FINITE, "the sum of the wrenches is not finite"
