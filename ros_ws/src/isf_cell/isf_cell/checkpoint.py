"""How far a part is, written atomically after every contour, so that it can be resumed after a crash."""

from __future__ import annotations

import json
import os
from dataclasses import asdict, dataclass
from pathlib import Path


@dataclass(frozen=True)
class Checkpoint:
    """Progress of one part: the next contour to form is ``next_index`` of ``count``."""

    job_name: str
    plan_id: str
    next_index: int
    count: int
    correction: str
    world: int
    seed: int

    def write(self, path: Path) -> None:
        """Replace the file in one step: after a crash it holds either the old or the new state."""
        temporary = path.with_suffix(".part")
        temporary.write_text(json.dumps(asdict(self)), encoding="utf-8")
        with temporary.open() as stream:
            os.fsync(stream.fileno())
        temporary.replace(path)
