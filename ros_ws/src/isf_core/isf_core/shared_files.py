"""Where material and rig files are found: a path given by the user, else the package's share folder."""

from __future__ import annotations

import os
from pathlib import Path

from isf_core.errors import ErrorCode, IsfError


def share_directory() -> Path:
    """``share/isf_core`` of the installed package, else the package's own source tree."""
    for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep):
        candidate = Path(prefix) / "share" / "isf_core"
        if (candidate / "materials").is_dir():
            return candidate
    return Path(__file__).resolve().parents[1]


def find_named(folder: str, name_or_path: str, base: Path | None = None) -> Path:
    """File for a name in ``share/isf_core/<folder>`` or a path relative to ``base``.

    Raises
    ------
    IsfError : FILE_NOT_FOUND, with the names that exist
    """
    if name_or_path.endswith((".yaml", ".yml")):
        path = Path(name_or_path)
        path = path if path.is_absolute() or base is None else base / path
        if path.is_file():
            return path
    else:
        path = share_directory() / folder / f"{name_or_path}.yaml"
        if path.is_file():
            return path
    known = ", ".join(sorted(p.stem for p in (share_directory() / folder).glob("*.yaml")))
    raise IsfError(
        ErrorCode.FILE_NOT_FOUND, f"no '{name_or_path}' in {folder}", where=str(path), advice=f"known: {known}"
    )
