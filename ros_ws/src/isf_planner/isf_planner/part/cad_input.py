"""STEP and IGES files: meshed by OpenCASCADE (package ``cascadio``, optional) to a chord error of 5 um.

Both formats carry their unit; the mesh comes back in metres.
"""

from __future__ import annotations

import importlib.util
import io
import re
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import trimesh
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.bounded import MEGABYTE
from isf_core.types import Array, Indices

FORMATS = ("step", "stp", "iges", "igs")

CHORD_ERROR = 5e-6
"""m, distance allowed between facets and surface."""

TURN = 0.1
"""rad, turn of the surface allowed over one facet."""

LARGEST = 100 * MEGABYTE
"""bytes: a part with thousands of faces."""

LONGEST = 300.0
"""s for a conversion: the largest files of parts take a minute."""

_CONVERTER = Path(__file__).with_name("cad_converter.py")

UNIT_NAMES = {"IN": 25.4e-3, "INCH": 25.4e-3, "MM": 1e-3, "M": 1.0, "CM": 1e-2, "FT": 0.3048, "UM": 1e-6}

SI_PREFIXES = {"": 1.0, ".MILLI.": 1e-3, ".CENTI.": 1e-2, ".DECI.": 0.1, ".MICRO.": 1e-6, ".KILO.": 1e3}


def read(data: bytes, kind: str, where: str) -> tuple[Array, Indices, float | None]:
    """Vertices (V, 3) m, faces (F, 3) and the size of the file's own unit in m (None when it was not understood).

    Raises
    ------
    IsfError : MESH_UNREADABLE when the library is missing or the file cannot be read, MESH_EMPTY without a shape
    """
    is_step = kind in ("step", "stp")
    head = data[:64].lstrip()
    if is_step and not head.startswith(b"ISO-10303"):
        raise IsfError(
            ErrorCode.MESH_UNREADABLE,
            "is not a STEP file: it does not begin with ISO-10303",
            where=where,
            advice="export the surface again, as STEP AP214 for example",
        )
    if len(data) > LARGEST:
        what, advice = f"is larger than {LARGEST / MEGABYTE:g} MB", "export the part alone, without what belongs to it"
        raise IsfError(ErrorCode.MESH_UNREADABLE, what, where=where, advice=advice)
    binary = _convert(data, is_step, where)
    if not binary:
        raise IsfError(
            ErrorCode.MESH_UNREADABLE,
            f"no shape could be read from the {'STEP' if is_step else 'IGES'} file",
            where=where,
            advice="export the surface again; a damaged or empty file yields no shape",
        )
    mesh = trimesh.load(io.BytesIO(binary), file_type="glb", process=False).to_mesh()
    vertices = np.asarray(mesh.vertices, dtype=np.float64).reshape(-1, 3)
    faces = np.asarray(getattr(mesh, "faces", np.empty((0, 3))), dtype=np.int64).reshape(-1, 3)
    # the converter gives metres for STEP and millimetres for IGES, whatever the file's unit
    return vertices * (1.0 if is_step else 1e-3), faces, _step_unit(data) if is_step else _iges_unit(data)


def _convert(data: bytes, is_step: bool, where: str) -> bytes:
    if importlib.util.find_spec("cascadio") is None:
        raise IsfError(
            ErrorCode.MESH_UNREADABLE,
            "STEP and IGES files need the package cascadio, which is not installed",
            where=where,
            advice="install it (pip install cascadio), or export the surface as STL",
        )
    # the converter works in mm
    arguments = ["step" if is_step else "iges", f"{CHORD_ERROR * 1e3!r}", f"{TURN!r}"]
    try:
        done = subprocess.run(
            [sys.executable, str(_CONVERTER), *arguments], input=data, capture_output=True, timeout=LONGEST, check=False
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        what = (
            f"could not be converted in {LONGEST:g} s" if isinstance(error, subprocess.TimeoutExpired) else f"{error}"
        )
        raise IsfError(
            ErrorCode.MESH_UNREADABLE, what, where=where, advice="export the part alone, or its surface as STL"
        ) from error
    if done.returncode != 0:
        said = done.stderr.decode("utf-8", "replace").strip().splitlines() or ["the converter ended"]
        fault = done.returncode < 0  # what it wrote then says nothing of the file
        why = f"the converter ended by {signal.Signals(-done.returncode).name}" if fault else said[-1][:200]
        raise IsfError(
            ErrorCode.MESH_UNREADABLE,
            f"could not be converted: {why}",
            where=where,
            advice="export the surface again",
        )
    return done.stdout


def _step_unit(data: bytes) -> float | None:
    text = re.sub(r"\s+", "", data.decode("latin-1"))
    for entity in re.findall(r"=\(([^;]*LENGTH_UNIT\(\)[^;]*)\);", text):
        named = re.search(r"CONVERSION_BASED_UNIT\('([^']+)'", entity)
        if named:
            return UNIT_NAMES.get(named.group(1).upper())
    for entity in re.findall(r"=\(([^;]*LENGTH_UNIT\(\)[^;]*)\);", text):
        si = re.search(r"SI_UNIT\(([^,]*),\.METRE\.\)", entity)
        if si:
            return SI_PREFIXES.get(si.group(1).replace("$", ""))
    return None


def _iges_unit(data: bytes) -> float | None:
    lines = [line for line in data.decode("latin-1").splitlines() if line[72:73] == "G"]
    found = re.search(r",\d+H(INCH|IN|MM|CM|FT|UM|M),", "".join(line[:72] for line in lines))
    return UNIT_NAMES[found.group(1)] if found else None
