"""Progress of a part on the disk, from which it goes on after a crash; free of ROS.

The folder of a part holds ``part.json`` and the files of state that it names, each with its checksum: of the simulated
machine, of the springback correction. ``part.json`` is replaced in one step after all of them are on the disk, so that
a kill or a power cut at any time leaves the last whole checkpoint.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

from isf_core import __version__
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.bounded import read_json, reason
from isf_core.files.job import JobFile
from isf_core.simulated_sheet import sheet_kind

from isf_cell.options import RunOptions

FORMAT, VERSION = "isf-part-checkpoint", 2
CHECKPOINT = "checkpoint"
"""Folder of the checkpoint in that of a run."""

PART_FILE = "part.json"
CONTOURS = "contours"
"""Folder of what springback keeps, within that of the checkpoint."""

FORM_AGAIN = "form the part again, on a fresh blank"


NODES = ("machine", "force_ctrl")
"""Nodes whose whole state is in one file, of the last contour alone."""


_STATE = re.compile(rf"({'|'.join(NODES)})_\d{{6}}\.npz|{CONTOURS}/(contour_\d{{6}}\.\d{{3,}}|target)\.npz")


def state_file(node: str, next_index: int) -> str:
    """Name of the state of ``node`` before contour ``next_index``."""
    return f"{node}_{next_index:06d}.npz"


@dataclass(frozen=True)
class Checkpoint:
    """What a part goes on with.

    Attributes
    ----------
    job_name, job_text, base_folder : the job
    correction : springback method in use ; support_force : N, None: the job's ; variant, seed, sheet : as RunOptions
    plan_id, count : the plan and how many contours it has
    next_index : the first contour that is not formed
    began, ended : s, begin of the first contour and end of the last one that is formed, by the clock of the results
    ticks, late_ticks, lost_messages : counted so far
    lost : why the part cannot be completed; empty: it can
    lockstep : how it was formed last; False by the wall clock
    software : version that wrote it
    files : names below the folder, with the SHA-256 of each
    """

    job_name: str
    job_text: str
    base_folder: str
    correction: str
    support_force: float | None
    variant: int
    seed: int
    sheet: str
    plan_id: str
    count: int
    next_index: int
    began: float = 0.0
    ended: float = 0.0
    ticks: int = 0
    late_ticks: int = 0
    lost_messages: int = 0
    lost: str = ""
    lockstep: bool = True
    software: str = __version__
    files: Mapping[str, str] = field(default_factory=dict)

    @property
    def job_file(self) -> JobFile:
        """The job; raises IsfError of the files that it names."""
        return JobFile(self.job_text, Path(self.base_folder), f"job {self.job_name}")

    @property
    def options(self) -> RunOptions:
        """What the run chose beyond its job."""
        return RunOptions(self.correction, self.support_force, self.variant, self.seed, sheet_kind(self.sheet))

    def state_of(self, node: str) -> str:
        """File of ``node``, one of :data:`NODES`; empty: its state is not kept, as that of a real machine."""
        name = state_file(node, self.next_index)
        return name if name in self.files else ""


def folder_below(root: Path, asked: str) -> Path:
    """The folder ``asked``, relative to ``root`` or absolute, links resolved.

    Raises
    ------
    IsfError : FILE_OUTSIDE unless it lies below ``root``
    """
    try:
        own = root.resolve()
        found = (own / asked).resolve()
    except (OSError, RuntimeError, ValueError) as error:  # a loop of links, a name that is none
        raise IsfError(ErrorCode.FILE_OUTSIDE, f"cannot be resolved: {error}", where=repr(asked)) from error
    if own not in found.parents:
        raise IsfError(
            ErrorCode.FILE_OUTSIDE,
            f"lies outside {own}, below which this cell keeps parts",
            where=str(found),
            advice="choose an --output below it, or start the cell with --runs",
        )
    return found


class CheckpointFolder:
    """The folder of one part's checkpoint.

    Raises
    ------
    IsfError : FILE_NOT_WRITABLE from every method that writes
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._known: dict[str, tuple[int, str]] = {}

    def begin(self) -> None:
        """A new part: what is left of another one goes."""
        with _writing(self.path):
            self.path.mkdir(parents=True, exist_ok=True)
            (self.path / PART_FILE).unlink(missing_ok=True)
            self._keep_only(())

    def checksums(self, next_index: int) -> dict[str, str]:
        """Name and SHA-256 of every file of state before contour ``next_index``; each is on the disk then. A file that
        has not changed since it was read last is not read again."""
        found = {}
        with _writing(self.path):
            for name in self._newest(next_index):
                path = self.path / name
                changed = path.stat().st_mtime_ns
                if self._known.get(name, (0, ""))[0] != changed:
                    self._known[name] = (changed, _on_disk(path))
                found[name] = self._known[name][1]
        return found

    def write(self, checkpoint: Checkpoint) -> None:
        """Replace the checkpoint; files of state that it does not name go."""
        content = asdict(checkpoint)
        text = json.dumps(
            {"format": FORMAT, "version": VERSION, "sha256": _digest(content), "content": content}, indent=1
        )
        path = self.path / PART_FILE
        partial = path.with_suffix(".partial")
        with _writing(self.path):
            self.path.mkdir(parents=True, exist_ok=True)
            with partial.open("w", encoding="utf-8") as file:
                file.write(text)
                file.flush()
                os.fsync(file.fileno())
            for folder in (self.path / CONTOURS, self.path):  # their names have to be on the disk before it names them
                if folder.is_dir():
                    _sync_folder(folder)
            partial.replace(path)
            _sync_folder(self.path)
            self._keep_only(checkpoint.files)

    def read(self) -> Checkpoint:
        """The checkpoint, whole and of this software; changes nothing.

        Raises
        ------
        IsfError : FILE_NOT_FOUND, there is none; CHECKPOINT_UNUSABLE, it is damaged or of another version;
            PART_FINISHED, all contours are formed; SHEET_TORN, the part is lost
        """
        checkpoint = self._content()
        if checkpoint.software != __version__:
            raise self._unusable(
                f"was written by version {checkpoint.software} of the software, this is {__version__}",
                f"go on with version {checkpoint.software}, or {FORM_AGAIN}",
            )
        if checkpoint.lost:
            raise IsfError(ErrorCode.SHEET_TORN, checkpoint.lost, where=str(self.path), advice=FORM_AGAIN)
        if checkpoint.next_index >= checkpoint.count:
            raise IsfError(
                ErrorCode.PART_FINISHED,
                f"all {checkpoint.count} contours are formed",
                where=str(self.path),
                advice="nothing is left to do; ./isf report makes its report again",
            )
        for name, digest in checkpoint.files.items():
            try:
                whole = _on_disk(self.path / name) == digest
            except OSError as error:
                raise self._unusable(f"{name} cannot be read: {error}", FORM_AGAIN) from error
            if not whole:
                raise self._unusable(f"{name} is damaged", FORM_AGAIN)
        return checkpoint

    def take_up(self) -> Checkpoint:
        """As :meth:`read`; the part goes on with it, and files of state that it does not name go."""
        checkpoint = self.read()
        with _writing(self.path):
            self._keep_only(checkpoint.files)
        return checkpoint

    # -- inside ----------------------------------------------------------------------------------

    def _content(self) -> Checkpoint:
        path = self.path / PART_FILE
        try:
            data = read_json(path)
        except FileNotFoundError as error:
            raise IsfError(
                ErrorCode.FILE_NOT_FOUND,
                "no checkpoint: not a run of ./isf form, or no contour was formed",
                where=str(path),
                advice=FORM_AGAIN,
            ) from error
        except (OSError, ValueError) as error:
            raise self._unusable(f"is damaged: {reason(error)}", FORM_AGAIN) from error
        if not isinstance(data, dict) or data.get("format") != FORMAT:
            raise self._unusable("is no checkpoint of a part", FORM_AGAIN)
        if data.get("version") != VERSION:
            raise self._unusable(
                f"is of format version {data.get('version')}, this software reads {VERSION}",
                "go on with the software that wrote it",
            )
        content: Any = data.get("content")
        known = {item.name for item in fields(Checkpoint)}
        if not isinstance(content, dict) or set(content) != known or data.get("sha256") != _digest(content):
            raise self._unusable("is damaged: its checksum is another one", FORM_AGAIN)
        return Checkpoint(**content)

    def _unusable(self, what: str, advice: str) -> IsfError:
        return IsfError(ErrorCode.CHECKPOINT_UNUSABLE, what, where=str(self.path / PART_FILE), advice=advice)

    def _names(self) -> list[str]:
        """Files of state; others may lie beside them, such as those that a person had the machine save."""
        found = [*self.path.glob("*.npz"), *(self.path / CONTOURS).glob("*.npz")]
        names = (path.relative_to(self.path).as_posix() for path in found)
        return sorted(name for name in names if _STATE.fullmatch(name))

    def _newest(self, next_index: int) -> list[str]:
        """Of the nodes those before contour ``next_index``, of every contour the last file."""
        nodes = [state_file(node, next_index) for node in NODES]
        newest = {
            name.split(".")[0]: name for name in self._names() if name.startswith(f"{CONTOURS}/") or name in nodes
        }
        return list(newest.values())

    def _keep_only(self, names: Iterable[str]) -> None:
        for name in set(self._names()) - set(names):
            (self.path / name).unlink(missing_ok=True)


@contextmanager
def _writing(path: Path) -> Iterator[None]:
    """What the disk refuses, as FILE_NOT_WRITABLE of ``path``."""
    try:
        yield
    except OSError as error:
        raise IsfError(
            ErrorCode.FILE_NOT_WRITABLE,
            f"the checkpoint cannot be written: {error}",
            where=str(path),
            advice="check the free space and the rights of the folder",
        ) from error


def _digest(content: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def _on_disk(path: Path) -> str:
    """SHA-256 of a file, which is on the disk when this returns."""
    digest = hashlib.sha256()
    with path.open("rb") as file:
        os.fsync(file.fileno())
        while part := file.read(1 << 20):
            digest.update(part)
    return digest.hexdigest()


def _sync_folder(path: Path) -> None:
    number = os.open(path, os.O_RDONLY)
    try:
        os.fsync(number)
    finally:
        os.close(number)
