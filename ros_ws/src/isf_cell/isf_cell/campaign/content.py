"""What the numbers of a simulated part depend on, as digests: its job with all files it names, and the sources."""

from __future__ import annotations

import hashlib
import re
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path

from isf_core.errors import IsfError
from isf_core.files.job import JobFile
from isf_core.files.yaml_file import find_named

COMPUTED_BY = ("isf_core", "isf_planner", "isf_force_ctrl", "isf_springback", "isf_sim")
"""Packages whose sources count, but for their nodes; of isf_cell and isf_analysis only what takes part."""

NODES = re.compile(r"(.+/)?(ros/.+|([^/]+_)?node(_[^/]+)?)\.py")
"""Files of nodes and folders ros: a part is formed in one process without any."""

ALSO = (
    "isf_cell.in_process",
    "isf_cell.run.in_process_cell",
    "isf_cell.run.part_run",
    "isf_cell.run.flat_push",
    "isf_cell.options",
    "isf_analysis.measures.deviation",
    "isf_analysis.measures.force_metrics",
)


def sources() -> str:
    """Digest of the sources that the packages are imported from."""
    text = hashlib.sha256()
    files: list[Path] = []
    for name in COMPUTED_BY:
        folder = source_file(name).parent
        files += sorted(path for path in folder.rglob("*.py") if not NODES.fullmatch(path.as_posix()))
        files += sorted([*folder.rglob("*.c"), *folder.rglob("*.h")])
    for path in [*files, *(source_file(name) for name in ALSO)]:
        text.update(path.name.encode() + path.read_bytes())
    return text.hexdigest()[:12]


def source_file(name: str) -> Path:
    """Of a module or package of the workspace."""
    found = find_spec(name)
    assert found is not None
    assert found.origin is not None
    return Path(found.origin)


def job_content(job_file: JobFile) -> str:
    """Digest of a job with its rig and material, its mesh and the other files it names."""
    job = job_file.job
    text = hashlib.sha256()
    text.update(job.model_dump_json().encode())
    text.update(job_file.rig.model_dump_json().encode() + job_file.material.model_dump_json().encode())
    own = job.springback
    named = [*map(str, job_file.sources), job.path.set_up, job.path.machine_error, own.learning, own.elastic.database]
    named += [job.die.mesh if job.die else None, job.accuracy_surfaces]
    files = [job_file.base / name for name in named if name is not None]
    if job.adsif is not None:
        with suppress(IsfError):  # where there is none, planning says so
            files.append(find_named("adsif", job.adsif.surface, job_file.base))
    for path in filter(Path.is_file, files):
        text.update(path.read_bytes())
    return text.hexdigest()[:16]
