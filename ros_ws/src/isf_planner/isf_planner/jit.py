"""The decorator of the planner's compiled kernels (:mod:`isf_core.compiled`)."""

from __future__ import annotations

from pathlib import Path

from isf_core.compiled import kernels_of

kernel = kernels_of("isf_planner", Path(__file__).parent, "isf_planner.jit")
