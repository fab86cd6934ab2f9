"""What has to be right before a blank is clamped, check by check; free of ROS."""

from __future__ import annotations

import shutil
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from isf_core import __version__
from isf_core.errors import ErrorCode, IsfError

FREE_SPACE = 500_000_000
"""Bytes that have to be free for bag and checkpoint: 18 minutes of a part at 500 Hz (0.9 kB per tick)."""

PUBLISHED_ONCE = (
    "tool_1/target",
    "tool_2/target",
    "tool_1/wrench",
    "tool_2/wrench",
    "machine/state",
    "contour/nominal",
    "contour/corrected",
    "contour/correction",
    "contour/result",
)
"""Topics of which a second publisher is another cell, or a tool that somebody forgot."""

MOVES_THE_TOOLS = PUBLISHED_ONCE[:4]
"""Those of which a second publisher that comes in mid-part ends it."""


@dataclass(frozen=True)
class Check:
    """One check by its ``name``: ``found`` is what it saw, ``failed`` why the part cannot begin; None: it can."""

    name: str
    found: str
    failed: IsfError | None = None


def publishers(found: Mapping[str, Sequence[str]]) -> Check:
    """``found``: names of the nodes that publish each topic."""
    for topic, nodes in found.items():
        if len(nodes) > 1:
            names = ", ".join(f"'{name}'" for name in nodes)
            return Check(
                "one publisher of each topic",
                f"{len(nodes)} of {topic}",
                IsfError(
                    ErrorCode.SECOND_PUBLISHER,
                    f"{len(nodes)} nodes publish it: {names}",
                    where=f"topic {topic}",
                    advice="end the one that does not belong to this cell, or give each cell its namespace",
                ),
            )
    return Check("one publisher of each topic", f"{sum(map(bool, found.values()))} topics")


def twice(found: Mapping[str, Sequence[str]]) -> Check:
    """``found``: identities of the processes of each node name that more than one has."""
    for name, processes in found.items():
        which = " and ".join(process.partition(":")[0] for process in processes)
        return Check(
            "one process of each node",
            f"{len(processes)} of '{name}'",
            IsfError(
                ErrorCode.SECOND_PUBLISHER,
                f"processes {which} are both node '{name}'",
                where=f"node {name}",
                advice="end the one that does not belong to this cell, or give each cell its namespace",
            ),
        )
    return Check("one process of each node", "no name twice")


def versions(told: Mapping[str, str]) -> Check:
    """``told``: the software version that each node tells of itself, as far as it does."""
    others = {name: version for name, version in told.items() if version and version != __version__}
    if others:
        names = ", ".join(f"'{name}' {version}" for name, version in others.items())
        failed = IsfError(
            ErrorCode.VERSION_MISMATCH,
            f"the executive is of version {__version__}, of another one are {names}",
            advice="start all nodes from one installation",
        )
        return Check("one version of all nodes", names, failed)
    return Check("one version of all nodes", __version__)


def messages(hashes: Mapping[str, Mapping[str, str]]) -> Check:
    """``hashes``: for each topic the type hash that each of its nodes works with."""
    for topic, of_node in hashes.items():
        if len(set(of_node.values())) > 1:
            names = ", ".join(f"'{name}'" for name in sorted(of_node))
            failed = IsfError(
                ErrorCode.VERSION_MISMATCH,
                f"its message is defined differently by {names}",
                where=f"topic {topic}",
                advice="build all nodes with the same isf_msgs",
            )
            return Check("one definition of each message", topic, failed)
    return Check("one definition of each message", f"{len(hashes)} topics")


def disk(folders: Iterable[Path]) -> Check:
    """``folders`` into which bag and checkpoint go, those that are on this computer."""
    least = ""
    for folder in folders:
        there = next((path for path in (folder, *folder.parents) if path.is_dir()), None)
        if there is None:
            continue
        free = shutil.disk_usage(there).free
        least = f"{free / 1e9:.1f} GB free"
        if free < FREE_SPACE:
            failed = IsfError(
                ErrorCode.BAG_NOT_WRITABLE,
                f"only {free / 1e6:.0f} MB are free, {FREE_SPACE / 1e6:.0f} MB are wanted for bag and checkpoint",
                where=str(folder),
                advice="free some space, or choose another folder",
            )
            return Check("disk space", least, failed)
    return Check("disk space", least or "nothing is kept here")


def passed(checks: Sequence[Check]) -> str:
    """One line for a person; raises IsfError of the first check that failed, with all of them as a list."""
    failed = [check.failed for check in checks if check.failed is not None]
    if not failed:
        return "preflight: " + "; ".join(f"{check.name} ({check.found})" for check in checks)
    lines = [f"\n  {'FAILED' if check.failed else 'ok':6}  {check.name}: {check.found}" for check in checks]
    first = failed[0]
    raise IsfError(first.code, first.what, where=first.where, advice=first.advice + "; preflight:" + "".join(lines))
