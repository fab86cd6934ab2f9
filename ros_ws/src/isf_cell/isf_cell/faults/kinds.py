"""The kinds of faults of a campaign: what is done to a cell from outside, and what is right for the cell to do then."""

from __future__ import annotations

import random
import resource
import shutil
import signal
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from isf_core.errors import ErrorCode

from isf_cell.faults import outside

Inject = Callable[[Any, random.Random], None]

NODES = ("machine", "planner", "springback", "force_ctrl", "executive")


@dataclass(frozen=True)
class FaultKind:
    """One row of the campaign.

    Attributes
    ----------
    name, text : for the table
    right : codes of which the part may end with any; OK among them: it may go on as if nothing had been
    inject : does it
    lockstep : False: by the wall clock
    recorder : the cell has a recorder
    command : done to ``isf form`` itself, with a cell of its own
    lasts : s of wall time after which it is undone; None: when the part has ended
    short : part of the short campaign
    known_after : s of wall time before which nothing tells it from a busy computer; what is asked for comes after
    """

    name: str
    text: str
    right: tuple[ErrorCode, ...]
    inject: Inject = field(repr=False)
    lockstep: bool = True
    recorder: bool = False
    command: bool = False
    lasts: float | None = None
    short: bool = False
    known_after: float = 0.0


DEATH = (ErrorCode.NODE_DIED,)
LEFT = (
    ErrorCode.NODE_DIED,
    ErrorCode.NODE_INACTIVE,
    ErrorCode.STOPPED,
    ErrorCode.TARGET_LOST,
    ErrorCode.STOP_REQUESTED,
)
UNDISTURBED = (ErrorCode.OK,)
SILENCE = 5.0
"""s without a sign of life after which a cell takes a process that it does not see running for dead."""

FROZEN = 10.0
"""s for which a process is stopped: longer than it takes to tell silence from load where nothing else is known."""


def _signal(node: str, number: signal.Signals) -> Inject:
    return lambda cell, _: cell.send(node, number)


def _processes() -> list[FaultKind]:
    kinds = [
        FaultKind(f"kill {node}", "SIGKILL", DEATH, _signal(node, signal.SIGKILL), short=node in SHORT)
        for node in NODES
    ]
    kinds += [FaultKind(f"end {node}", "SIGTERM", LEFT, _signal(node, signal.SIGTERM)) for node in NODES]
    slow = {
        "machine": (ErrorCode.WRENCH_LOST, ErrorCode.NODE_DIED),
        "force_ctrl": (ErrorCode.TARGET_LOST, ErrorCode.NODE_DIED),
        "executive": (ErrorCode.EXECUTIVE_LOST, ErrorCode.OK),
    }
    right: tuple[ErrorCode, ...]
    for node in NODES:
        right = slow.get(node, (ErrorCode.OK, ErrorCode.NODE_DIED))
        stop = _signal(node, signal.SIGSTOP)
        kinds.append(
            FaultKind(
                f"freeze {node}",
                f"SIGSTOP for {FROZEN:g} s",
                right,
                stop,
                lockstep=False,
                lasts=FROZEN,
                known_after=0.0 if node == "force_ctrl" else SILENCE,
            )
        )
    record = (ErrorCode.BAG_INCOMPLETE, ErrorCode.BAG_NOT_WRITABLE)
    for name, text, number, right in (
        ("kill recorder", "SIGKILL", signal.SIGKILL, record),
        ("end recorder", "SIGTERM", signal.SIGTERM, record),
        ("freeze recorder", f"SIGSTOP for {FROZEN:g} s", signal.SIGSTOP, (*record, ErrorCode.OK)),
    ):
        lasts = FROZEN if number == signal.SIGSTOP else None
        kinds.append(FaultKind(name, text, right, _signal("recorder", number), recorder=True, lasts=lasts))
    ended = (ErrorCode.NODE_DIED, ErrorCode.EXECUTIVE_LOST, ErrorCode.UNATTENDED, ErrorCode.STOPPED)
    kinds += [
        FaultKind(
            "kill command",
            "SIGKILL of isf form",
            (*ended, ErrorCode.OK),
            _signal("command", signal.SIGKILL),
            command=True,
        ),
        FaultKind(
            "end command",
            "SIGTERM of isf form",
            (*ended, ErrorCode.OK),
            _signal("command", signal.SIGTERM),
            command=True,
        ),
        FaultKind(
            "interrupt command",
            "Ctrl-C of isf form",
            (ErrorCode.CANCELLED,),
            _signal("command", signal.SIGINT),
            command=True,
        ),
        FaultKind(
            "freeze command",
            f"SIGSTOP of isf form for {FROZEN:g} s",
            UNDISTURBED,
            _signal("command", signal.SIGSTOP),
            command=True,
            lasts=FROZEN,
        ),
    ]
    return kinds


SHORT = ("force_ctrl", "executive", "springback")
"""Nodes killed in the short campaign."""


def _wrench(change: Callable[[random.Random], outside.Altered]) -> Inject:
    return lambda cell, chance: cell.outside.alter("wrench", (chance.choice((1, 2)),), change(chance))


def _streams() -> list[FaultKind]:
    both = (1, 2)
    lost = (ErrorCode.WRENCH_LOST,)
    return [
        FaultKind(
            "wrench silent", "no wrench of a tool any more", lost, _wrench(lambda _: outside.nothing), lockstep=False
        ),
        FaultKind(
            "wrench frozen",
            "the same reading with new stamps",
            (ErrorCode.WRENCH_FROZEN, ErrorCode.OK),
            _wrench(lambda _: outside.frozen()),
            short=True,
        ),
        FaultKind(
            "wrench not a number",
            "NaN in one component",
            (ErrorCode.WRENCH_NOT_FINITE,),
            _wrench(lambda _: outside.without_numbers),
            short=True,
        ),
        FaultKind(
            "wrench saturated",
            "10 kN in one component",
            (ErrorCode.WRENCH_OUT_OF_RANGE,),
            _wrench(lambda _: outside.saturated),
            short=True,
        ),
        FaultKind(
            "wrench late",
            "0.3 s late",
            (ErrorCode.WRENCH_LATE,),
            lambda cell, _: cell.outside.delay(both, 0.3),
            lockstep=False,
        ),
        FaultKind(
            "wrench lost in part",
            "every tenth never arrives",
            UNDISTURBED,
            _wrench(lambda chance: outside.lost(0.1, chance)),
            lockstep=False,
        ),
        FaultKind(
            "clock jump",
            "stamps of a tool 5 s later",
            (ErrorCode.WRENCH_CLOCK,),
            _wrench(lambda _: outside.stamped_later(5)),
            short=True,
        ),
        FaultKind(
            "poses silent",
            "no pose of a tool reaches force control",
            UNDISTURBED,
            lambda cell, _: cell.outside.alter("pose", both, outside.nothing),
            short=True,
        ),
    ]


def _peers() -> list[FaultKind]:
    named = (ErrorCode.SECOND_PUBLISHER,)
    return [
        FaultKind(
            "second targets",
            "another node publishes tool_1/target, 30 mm away",
            named,
            lambda cell, _: cell.outside.second_targets(0.03),
            lockstep=False,
        ),
        FaultKind(
            "springback deactivated",
            "by another program",
            (ErrorCode.NODE_INACTIVE,),
            lambda cell, _: cell.outside.deactivate("springback"),
            short=True,
        ),
        FaultKind(
            "force_ctrl deactivated",
            "by another program",
            (ErrorCode.NODE_INACTIVE, ErrorCode.STOPPED),
            lambda cell, _: cell.outside.deactivate("force_ctrl"),
        ),
        FaultKind(
            "machine deactivated",
            "by another program",
            (ErrorCode.NODE_INACTIVE, ErrorCode.WRENCH_LOST, ErrorCode.STOP_REQUESTED),
            lambda cell, _: cell.outside.deactivate("machine"),
        ),
        FaultKind(
            "parameters",
            "nonsense set on every node",
            UNDISTURBED,
            lambda cell, chance: cell.outside.set_nonsense(NODES, chance),
            short=True,
        ),
        FaultKind(
            "bad contours",
            "wrong lengths, no numbers, unknown plan",
            UNDISTURBED,
            lambda cell, chance: cell.outside.bad_contours(chance),
            short=True,
        ),
        FaultKind(
            "flood",
            "500 long messages a second on /diagnostics for 3 s",
            UNDISTURBED,
            lambda cell, _: cell.outside.flood(500.0),
            lasts=3.0,
        ),
        FaultKind(
            "cancel", "the operator cancels", (ErrorCode.CANCELLED,), lambda cell, _: cell.outside.cancel(), short=True
        ),
    ]


def _files() -> list[FaultKind]:
    record = (ErrorCode.BAG_INCOMPLETE, ErrorCode.BAG_NOT_WRITABLE)
    return [
        FaultKind(
            "disk full",
            "RLIMIT_FSIZE of the recorder",
            record,
            lambda cell, _: _fill_disk(cell),
            recorder=True,
            short=True,
        ),
        FaultKind(
            "bag deleted",
            "the folder of the record is removed",
            record,
            lambda cell, _: shutil.rmtree(cell.bag, ignore_errors=True),
            recorder=True,
        ),
        FaultKind(
            "checkpoint deleted",
            "the folder of the checkpoint is removed",
            UNDISTURBED,
            lambda cell, _: shutil.rmtree(cell.checkpoint, ignore_errors=True),
        ),
    ]


def _fill_disk(cell: Any) -> None:
    size = max((path.stat().st_size for path in cell.bag.rglob("*") if path.is_file()), default=0)
    resource.prlimit(cell.process("recorder").popen.pid, resource.RLIMIT_FSIZE, (size + 4096, size + 4096))


KINDS: tuple[FaultKind, ...] = (*_processes(), *_streams(), *_peers(), *_files())
"""All kinds, in the order of the table."""
