"""The database of the elastic shell that a part takes its laws from, computed before the part where it is missing."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

from isf_core.contour import Contour
from isf_core.errors import IsfError
from isf_core.files.job import JobFile

from isf_cell.commands import terminal

LONG = 30.0
"""s, after which it is told that the database is still being computed, and what would do without it."""


class DatabaseProgress:
    """Tells ``phase`` how many depths are computed, and once it takes long by ``clock`` (s) what would be faster.

    On a wide clamp the first depth alone takes minutes.
    """

    def __init__(self, phase: Callable[[str], None], clock: Callable[[], float] = time.monotonic) -> None:
        self._phase, self._clock, self._since = phase, clock, clock()
        self._counts, self._long = (0, 0), False

    def progress(self, done: int, total: int) -> None:
        """So many depths of all are computed."""
        self._counts = done, total
        text = f"springback database: {done} of {total} depths"
        if self._long:
            text += (
                f", still at it after {LONG:.0f} s: a wide clamp and a fine sheet take minutes, the first time only; "
                "--correction analytic forms without a database"
            )
        self._phase(text)

    def poll(self) -> bool:
        """To be called while it is computed; never asks it to stop."""
        if not self._long and self._clock() - self._since >= LONG:
            self._long = True
            self.progress(*self._counts)
        return False


def takes_database(job_file: JobFile, method: str) -> bool:
    """Whether ``method`` takes its laws from the database of the elastic shell in the user's cache."""
    asked = job_file.job.springback
    elastic = method == "elastic" or (method == "fused" and asked.fused.model == "elastic")
    return elastic and asked.elastic.database is None


def prepare_database(
    job_file: JobFile, method: str, phase: Callable[[str], None], contours: Sequence[Contour] | None = None
) -> None:
    """Put the database that ``method`` takes its laws from into the user's cache, unless it is there or the job names
    one: a part is corrected the same however often it is formed. ``phase`` is told what is done, ``contours`` are those
    of its plan where that is known.

    What prevents it is told as a warning; the laws are then computed while forming, on a coarse mesh.
    """
    if not takes_database(job_file, method):
        return
    # late: the shell and its solver take a second to load, which other methods need not wait for
    from isf_planner import plan
    from isf_springback.database.build import build_database
    from isf_springback.database.database import cached_path, database_of

    try:
        if database_of(job_file) is not None:
            return
        if contours is None:
            phase("springback database: planning")
            contours = plan(job_file).contours
        told = DatabaseProgress(phase)
        database = build_database(contours, job_file, progress=told.progress, cancelled=told.poll)
        database.save(cached_path(job_file))
    except IsfError as error:
        terminal.warn(f"{job_file.job.name}: no springback database, {error.message}")
