"""Files that others name over the network: below one folder, and nowhere else."""

from __future__ import annotations

from pathlib import Path

from isf_core.errors import ErrorCode, IsfError


def path_below(folder: Path, name: str) -> Path:
    """Path of the file ``name`` below ``folder``, links resolved.

    Raises
    ------
    IsfError : FILE_NOT_FOUND when ``name`` is empty; FILE_OUTSIDE when it is absolute, has a "..", or leads out of the
        folder by a symbolic link
    """
    if not name:
        raise IsfError(ErrorCode.FILE_NOT_FOUND, "no path is given", where="path", advice="name a file")
    asked = Path(name)
    advice = f"name a file below {folder}, such as part/state.npz"
    if asked.is_absolute() or ".." in asked.parts or "\0" in name:
        what = "only relative paths without '..' are accepted"
        raise IsfError(ErrorCode.FILE_OUTSIDE, what, where=f"path {name!r}", advice=advice)
    try:
        own = folder.resolve()
        path = (own / asked).resolve()
    except (OSError, RuntimeError) as error:  # a loop of links
        raise IsfError(ErrorCode.FILE_OUTSIDE, f"cannot be resolved: {error}", where=f"path {name!r}") from error
    if own not in path.parents:
        raise IsfError(ErrorCode.FILE_OUTSIDE, f"leads to {path}", where=f"path {name!r}", advice=advice)
    return path
