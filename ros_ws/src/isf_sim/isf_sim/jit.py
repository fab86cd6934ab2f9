"""Compiled kernels: one decorator, and a cache on disk that never serves a kernel older than its source.

numba keys a cached kernel on the file it stands in, not on the files of the kernels it calls. The cache
folder therefore carries a digest of all sources of this package that hold kernels.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

import numba

F = TypeVar("F", bound=Callable[..., Any])


def _source_digest() -> str:
    digest = hashlib.sha256()
    for source in sorted(Path(__file__).parent.glob("*.py")):
        text = source.read_bytes()
        if b"isf_sim.jit" in text:
            digest.update(text)
    return digest.hexdigest()[:12]


_CACHE = str(Path(numba.config.CACHE_DIR or Path(__file__).parent / "__pycache__") / f"isf_sim-{_source_digest()}")


def kernel(function: F) -> F:
    """Compile ``function`` at its first call, or take it from the cache on disk; it runs without the interpreter."""
    before = numba.config.CACHE_DIR
    numba.config.CACHE_DIR = _CACHE  # read by numba when the function is decorated
    try:
        compiled = numba.njit(cache=True, error_model="numpy", nogil=True)(function)
    finally:
        numba.config.CACHE_DIR = before
    return cast(F, compiled)
