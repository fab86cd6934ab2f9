"""The decorator of the core's compiled kernels (:mod:`isf_core.compiled`)."""

from __future__ import annotations

from pathlib import Path

from isf_core.compiled import kernels_of

kernel = kernels_of("isf_core", Path(__file__).parent, "isf_core.jit")
