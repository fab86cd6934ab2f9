"""Compiled kernels: one decorator per package, and a cache on disk that never serves a kernel older than its source.

numba keys a cached kernel on the file it stands in, not on the files of the kernels it calls. The cache folder
therefore carries a digest of all sources of the package that hold kernels.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

F = TypeVar("F", bound=Callable[..., Any])


def kernels_of(package: str, folder: Path, mark: str) -> Callable[[F], F]:
    """Decorator that compiles a function at its first call, or takes it from the cache on disk.

    Compiled functions run without the interpreter and without its lock.

    Parameters
    ----------
    package : name of the package, for the cache folder
    folder : where its sources are
    mark : text that every source with kernels contains (the import of this decorator)
    """
    import numba  # only packages with kernels need it

    cache = str(_writable(numba.config.CACHE_DIR, folder) / f"{package}-{_digest(folder, mark.encode())}")

    def kernel(function: F) -> F:
        before = numba.config.CACHE_DIR
        numba.config.CACHE_DIR = cache  # read by numba when the function is decorated
        try:
            compiled = numba.njit(cache=True, error_model="numpy", nogil=True)(function)
        finally:
            numba.config.CACHE_DIR = before
        return cast(F, compiled)

    return kernel


def _writable(chosen: str, folder: Path) -> Path:
    """Where kernels are kept: as ``chosen`` by the user, beside the sources, or in the user's cache where those cannot
    be written to."""
    if chosen:
        return Path(chosen)
    if os.access(folder, os.W_OK):
        return folder / "__pycache__"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "isf" / "kernels"


def _digest(folder: Path, mark: bytes) -> str:
    digest = hashlib.sha256()
    for source in sorted(folder.rglob("*.py")):
        text = source.read_bytes()
        if mark in text:
            digest.update(text)
    return digest.hexdigest()[:12]
