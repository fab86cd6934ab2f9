"""Band Cholesky factors of the coarse shell's matrix, and those that are kept from one solution to the next.

On a grid of some forty lines a band matrix with LAPACK's blocked kernels is more than twice as fast as sparse
elimination with the best ordering. LAPACK is called through the pointers that scipy publishes for compiled code: other
threads go on meanwhile, and the matrix is factorised in place.
"""

from __future__ import annotations

import ctypes
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cython_lapack

Array = NDArray[np.float64]
Index = NDArray[np.int32]

SHIFTS = (0.0, 1e-3, 1e-2, 0.1, 1.0, 10.0, np.inf)
"""Parts of the diagonal that are added, one after the other, until a matrix is positive definite; infinite: the unit
matrix in its place."""


class Factor:
    """A = L L' of a symmetric matrix in band storage; ``shift``: part of the diagonal that was added to it."""

    def __init__(self, band: Array, shift: float) -> None:
        self._band, self.shift = band, shift

    def solve(self, right: Array) -> Array:
        """(n,) A^-1 right."""
        out = np.array(right, dtype=np.float64)
        band = self._band
        info = ctypes.c_int(0)
        one = ctypes.c_int(1)
        count, wide = (ctypes.c_int(value) for value in band.shape)
        reach = ctypes.c_int(band.shape[1] - 1)
        _DPBTRS(b"L", count, reach, one, band.ctypes.data, wide, out.ctypes.data, count, info)
        return out


class BandForm:
    """Where the values of a symmetric matrix in compressed columns go in band storage."""

    def __init__(self, rows: Index, starts: Index) -> None:
        columns = np.repeat(np.arange(len(starts) - 1), np.diff(starts))
        self._lower = np.flatnonzero(rows >= columns)
        below = rows[self._lower] - columns[self._lower]
        self._shape = (len(starts) - 1, int(below.max()) + 1)
        self._place = columns[self._lower].astype(np.int64) * self._shape[1] + below

    def factorise(self, values: Array) -> Factor:
        """Factors of the matrix with ``values`` (nnz,); shifted when it is not positive definite."""
        count, wide = (ctypes.c_int(value) for value in self._shape)
        reach = ctypes.c_int(self._shape[1] - 1)
        for shift in SHIFTS:
            band = np.zeros(self._shape)
            if np.isfinite(shift):
                band.ravel()[self._place] = values[self._lower]
                band[:, 0] += shift * np.abs(band[:, 0])
            else:
                band[:, 0] = 1.0  # the last resort always has factors
            info = ctypes.c_int(0)
            _DPBTRF(b"L", count, reach, band.ctypes.data, wide, info)
            if info.value == 0:
                return Factor(band, shift)
        raise AssertionError("unit matrix")


class KeptFactor:
    """The newest factors of a kind, to begin the next solution with.

    What counts as state is the matrix; its factors are made again where they are missing (a copy, a saved state).
    """

    def __init__(self, form: BandForm, entries: int) -> None:
        self.values = np.zeros(entries)
        self.known = False
        self._cache = _Cache(form)

    def get(self) -> Factor | None:
        """The kept factors, None when there are none."""
        return self._cache.factor(self.values) if self.known else None

    def renew(self, values: Array) -> Factor:
        """Factors of the matrix with ``values`` (nnz,), kept from now on."""
        self.values[...] = values
        self.known = True
        return self._cache.factor(self.values)

    def drop(self) -> None:
        """Forget them: the matrix is another one."""
        self.known = False


class _Cache:
    """Factors with the values they belong to; never part of a state."""

    constant_of_state = True

    def __init__(self, form: BandForm) -> None:
        self._form = form
        self._known: tuple[Array, Factor] | None = None

    def factor(self, values: Array) -> Factor:
        if self._known is None or not np.array_equal(self._known[0], values):
            self._known = (values.copy(), self._form.factorise(values))
        return self._known[1]

    def __deepcopy__(self, memo: dict[int, Any]) -> _Cache:
        return _Cache(self._form)


def _lapack(name: str) -> Any:
    """A LAPACK routine as a foreign function: the interpreter's lock is free while it runs."""
    capsule = cython_lapack.__pyx_capi__[name]
    api = ctypes.pythonapi
    api.PyCapsule_GetName.restype = ctypes.c_char_p
    api.PyCapsule_GetName.argtypes = [ctypes.py_object]
    api.PyCapsule_GetPointer.restype = ctypes.c_void_p
    api.PyCapsule_GetPointer.argtypes = [ctypes.py_object, ctypes.c_char_p]
    pointer = api.PyCapsule_GetPointer(capsule, api.PyCapsule_GetName(capsule))
    whole, array = ctypes.POINTER(ctypes.c_int), ctypes.c_void_p
    kinds = {
        "dpbtrf": (ctypes.c_char_p, whole, whole, array, whole, whole),
        "dpbtrs": (ctypes.c_char_p, whole, whole, whole, array, whole, array, whole, whole),
    }
    return ctypes.CFUNCTYPE(None, *kinds[name])(pointer)


_DPBTRF, _DPBTRS = _lapack("dpbtrf"), _lapack("dpbtrs")
