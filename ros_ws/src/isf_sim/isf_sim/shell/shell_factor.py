"""Band Cholesky factors of the coarse shell's matrix, and those that are kept from one solution to the next.

On a grid of some forty lines a band matrix with LAPACK's blocked kernels is more than twice as fast as sparse
elimination with the best ordering. Compiled code calls LAPACK through the pointers that scipy publishes, so a whole
solution runs without the interpreter and its lock.
"""

from __future__ import annotations

import ctypes
from typing import Any, NamedTuple

import llvmlite.binding
import numpy as np
from isf_core.types import Array
from numba import types
from numpy.typing import NDArray
from scipy.linalg import cython_lapack

from isf_sim.jit import kernel

Index = NDArray[np.int32]

SHIFTS = (0.0, 1e-3, 1e-2, 0.1, 1.0, 10.0, np.inf)
"""Parts of the diagonal that are added, one after the other, until a matrix is positive definite; infinite: the unit
matrix in its place."""
LOWER = ord("L")


class BandForm(NamedTuple):
    """Where the values of a symmetric matrix in compressed columns go in band storage.

    Attributes
    ----------
    rows, starts : the compressed columns, sorted, both triangles ; lower : (m,) values on and below the diagonal
    place : (m,) where they go in the flat band ; width : of the band
    """

    rows: Index
    starts: Index
    lower: NDArray[np.int64]
    place: NDArray[np.int64]
    width: int


def band_form(rows: Index, starts: Index) -> BandForm:
    """Form of the matrix with ``rows`` (nnz,) and column ``starts`` (n + 1,)."""
    columns = np.repeat(np.arange(len(starts) - 1), np.diff(starts))
    lower = np.flatnonzero(rows >= columns)
    below = rows[lower] - columns[lower]
    width = int(below.max()) + 1
    return BandForm(rows, starts, lower, columns[lower].astype(np.int64) * width + below, width)


class KeptFactor:
    """The newest factors L L' = A, to begin the next solution with.

    What counts as state is the matrix; its factors are made again where they are missing (a copy, a saved state).

    Attributes
    ----------
    values : (nnz,) of the matrix ; known : False when there is none ; made : Made, its factors
    """

    def __init__(self, form: BandForm) -> None:
        self.values = np.zeros(len(form.rows))
        self.known = False
        self.made = Made(form)

    def drop(self) -> None:
        """Forget them: the matrix is another one."""
        self.known = False


class Made:
    """Factors with the values they belong to; never part of a state.

    Attributes
    ----------
    band : (n, width) ; of : (nnz,) NaN where there are no factors ; shift : (1,) part of the diagonal that was added
    """

    constant_of_state = True

    def __init__(self, form: BandForm) -> None:
        self._form = form
        self.band = np.zeros((len(form.starts) - 1, form.width))
        self.of = np.full(len(form.rows), np.nan)
        self.shift = np.zeros(1)

    def __deepcopy__(self, memo: dict[int, Any]) -> Made:
        return Made(self._form)


@kernel
def ensure_factors(values: Array, form: BandForm, band: Array, of: Array, shift: Array) -> None:
    """Make ``band`` (n, width) hold the factors of the matrix with ``values`` (nnz,), unless it does already."""
    for k in range(len(values)):
        if values[k] != of[k]:
            make_factors(values, form, band, of, shift)
            return


@kernel
def make_factors(values: Array, form: BandForm, band: Array, of: Array, shift: Array) -> None:
    """Factors of the matrix with ``values`` (nnz,); shifted when it is not positive definite."""
    kind = np.array([LOWER], dtype=np.uint8)
    count = np.array([band.shape[0]], dtype=np.int32)
    wide = np.array([band.shape[1]], dtype=np.int32)
    reach = np.array([band.shape[1] - 1], dtype=np.int32)
    info = np.zeros(1, dtype=np.int32)
    flat = band.reshape(-1)
    of[:] = values
    for part in SHIFTS:
        band[:] = 0.0
        if np.isfinite(part):
            for k in range(len(form.lower)):
                flat[form.place[k]] = values[form.lower[k]]
            for j in range(band.shape[0]):
                band[j, 0] += part * abs(band[j, 0])
        else:
            band[:, 0] = 1.0  # the last resort always has factors
        _DPBTRF(kind.ctypes, count.ctypes, reach.ctypes, band.ctypes, wide.ctypes, info.ctypes)
        shift[0] = part
        if info[0] == 0:
            return


@kernel
def solve_band(band: Array, right: Array, out: Array) -> None:
    """``out`` (n,) = A^-1 right with the factors ``band`` (n, width) of A."""
    kind = np.array([LOWER], dtype=np.uint8)
    count = np.array([band.shape[0]], dtype=np.int32)
    wide = np.array([band.shape[1]], dtype=np.int32)
    reach = np.array([band.shape[1] - 1], dtype=np.int32)
    one = np.ones(1, dtype=np.int32)
    info = np.zeros(1, dtype=np.int32)
    out[:] = right
    _DPBTRS(
        kind.ctypes,
        count.ctypes,
        reach.ctypes,
        one.ctypes,
        band.ctypes,
        wide.ctypes,
        out.ctypes,
        count.ctypes,
        info.ctypes,
    )


@kernel
def symmetric_product(values: Array, form: BandForm, x: Array, out: Array) -> None:
    """``out`` (n,) = A x of the symmetric matrix with ``values`` (nnz,)."""
    for j in range(len(out)):
        total = 0.0
        for k in range(form.starts[j], form.starts[j + 1]):
            total += values[k] * x[form.rows[k]]
        out[j] = total


_TEXT, _WHOLE, _REAL = (types.CPointer(kind) for kind in (types.uint8, types.int32, types.float64))
_ARGUMENTS = {
    "dpbtrf": (_TEXT, _WHOLE, _WHOLE, _REAL, _WHOLE, _WHOLE),
    "dpbtrs": (_TEXT, _WHOLE, _WHOLE, _WHOLE, _REAL, _WHOLE, _REAL, _WHOLE, _WHOLE),
}


def _lapack(name: str) -> Any:
    """A LAPACK routine for compiled code: a symbol that kernels from the cache on disk find again."""
    capsule = cython_lapack.__pyx_capi__[name]
    api = ctypes.pythonapi
    api.PyCapsule_GetName.restype = ctypes.c_char_p
    api.PyCapsule_GetName.argtypes = [ctypes.py_object]
    api.PyCapsule_GetPointer.restype = ctypes.c_void_p
    api.PyCapsule_GetPointer.argtypes = [ctypes.py_object, ctypes.c_char_p]
    symbol = f"isf_sim_{name}"
    llvmlite.binding.add_symbol(symbol, api.PyCapsule_GetPointer(capsule, api.PyCapsule_GetName(capsule)))
    return types.ExternalFunction(symbol, types.void(*_ARGUMENTS[name]))


_DPBTRF, _DPBTRS = _lapack("dpbtrf"), _lapack("dpbtrs")
