"""Node executables by package and name, found where ``ros2 run`` finds them: ``lib/<package>/<name>``."""

from __future__ import annotations

import os
from pathlib import Path

from isf_core.errors import ErrorCode, IsfError


def find(package: str, name: str) -> Path:
    """Executable of a node; IsfError NODE_MISSING names what the package offers."""
    offered: list[str] = []
    for prefix in _prefixes():
        folder = prefix / "lib" / package
        if not folder.is_dir():
            continue
        path = folder / name
        if path.is_file() and os.access(path, os.X_OK):
            return path
        offered += sorted(item.name for item in folder.iterdir() if os.access(item, os.X_OK) and item.is_file())
    what = f"no executable '{name}' in package '{package}'" if offered else f"no package '{package}' with executables"
    advice = (
        f"it offers: {', '.join(offered)}" if offered else "build the workspace: ./scripts/setup.sh in the repository"
    )
    raise IsfError(ErrorCode.NODE_MISSING, what, advice=advice)


def checked_remap(names: str) -> str:
    """``FROM:=TO`` as ROS takes it after ``-r``; raises IsfError FILE_FIELD for anything else."""
    before, sign, after = names.partition(":=")
    if not sign or any(not name or set(name) & set(" :=\"'") for name in (before, after)):
        raise IsfError(
            ErrorCode.FILE_FIELD,
            f"'{names}' is not FROM:=TO",
            where="--remap",
            advice="for example: --remap tool_1/raw:=left/ft_raw",
        )
    return names


def _prefixes() -> list[Path]:
    return [Path(item) for item in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if item]
