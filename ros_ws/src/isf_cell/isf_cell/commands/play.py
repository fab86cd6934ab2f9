"""``isf play``: a bag into the ROS graph."""

from __future__ import annotations

import math
import shutil
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import isf_analysis
import numpy as np
from isf_analysis.bag.playback import begin_of_contour
from isf_core.errors import ErrorCode, IsfError
from isf_core.files import yaml_file

from isf_cell.commands import terminal
from isf_cell.processes.executables import checked_remap
from isf_cell.replay.recorded_run import read_run

FASTEST_CLOCK = 10_000.0
"""Hz of ``/clock``."""


@dataclass(frozen=True)
class PlayOptions:
    """Options of the command: see there; ``contour`` counts from 1."""

    rate: float
    contour: int | None
    topics: Sequence[str]
    remap: Sequence[str]
    clock: float
    paused: bool
    delay: float
    namespace: str | None = None


def play_into_node(
    path: Path, node: str, options: PlayOptions, parameters: Sequence[str], base: Path | None, *, as_json: bool
) -> None:
    """Give the run at ``path`` to the live ``node`` and tell how its answers differ from the recorded ones.

    ``options`` : of them the namespace counts; ``parameters`` NAME:=VALUE of a node that is started; ``base`` : folder
    that the job's paths refer to. Raises IsfError BAG_UNREADABLE, BAG_INCOMPLETE, FILE_FIELD, codes of the job and of
    the node.
    """
    if replace(options, delay=0.0, namespace=None) != PlayOptions(1.0, None, (), (), 0.0, False, 0.0):
        raise IsfError(
            ErrorCode.FILE_FIELD,
            "a node gets the whole part, in the order of cause and effect",
            where="--into",
            advice="leave out --rate, --from, --topic, --remap, --clock and --paused",
        )
    run = read_run(path, options.namespace)
    job_file = run.job_file(base)
    given = dict(_parameter(item) for item in parameters)
    from isf_cell.replay import live_node  # late: ROS is not needed to refuse

    live_node.check(run, node)
    logs = Path(tempfile.mkdtemp(prefix="isf_play_"))  # kept where the node fails: the error names it
    with terminal.part_progress(f"into {node}") as progress:
        answer = live_node.play_into(run, node, job_file, logs, given, progress.share)
    shutil.rmtree(logs, ignore_errors=True)
    decided = answer.results or answer.corrections
    assert decided is not None
    data = {
        "node": node,
        "started": answer.started,
        "identical": answer.identical,
        "targets": {
            "compared": answer.targets,
            "differing": answer.differing,
            "unfed": answer.unfed,
            "largest_um": 1e6 * answer.largest,
        },
        "contours": {
            "compared": decided.compared,
            "missing": decided.missing,
            "first_differing": decided.first,
            "differing_fields": decided.differing,
        },
        "notes": list(answer.notes),
    }
    if as_json:
        terminal.print_json(data)
    which = "started for it" if answer.started else "that runs in this domain"
    if answer.targets:
        terminal.say(
            f"{node} ({which}) answered {answer.targets} recorded ticks: {answer.differing} targets differ, by at most "
            f"{1e6 * answer.largest:.3f} um" + (f"; {answer.unfed} ticks were fed to nothing" if answer.unfed else "")
        )
    kind = "results" if answer.results else "corrections"
    same = "all the same" if decided.identical else f"{', '.join(decided.differing) or 'some are missing'} differ"
    terminal.say(f"{node} ({which}): {kind} of {decided.compared} contours, {same}")
    terminal.say(f"identical: {str(answer.identical).lower()}")
    for note in answer.notes:
        terminal.warn(note)


def play_bag(path: Path, options: PlayOptions, *, as_json: bool) -> None:
    """Play the bag or run at ``path``; raises IsfError BAG_UNREADABLE, BAG_INCOMPLETE, FILE_FIELD, FILE_NOT_FOUND."""
    if not (math.isfinite(options.rate) and options.rate > 0.0):
        raise IsfError(ErrorCode.FILE_FIELD, "a rate is positive", where="--rate", advice="1 is as it was recorded")
    if not 0.0 <= options.clock <= FASTEST_CLOCK:
        raise IsfError(
            ErrorCode.FILE_FIELD,
            f"a clock of {options.clock:g} Hz",
            where="--clock",
            advice=f"0 to {FASTEST_CLOCK:g}; 0 publishes none",
        )
    if not 0.0 <= options.delay < math.inf:
        raise IsfError(ErrorCode.FILE_FIELD, f"a delay of {options.delay:g} s", where="--delay", advice="such as 1")
    with isf_analysis.open(path, options.namespace) as bag:
        remap = dict(checked_remap(item).split(":=") for item in options.remap)
        try:
            names = [bag[topic].name for topic in options.topics] or [
                name for name, table in bag.items() if table.messages
            ]
            renamed = {bag[old].name: new if new.startswith("/") else f"/{new}" for old, new in remap.items()}
        except KeyError as error:
            raise IsfError(
                ErrorCode.FILE_FIELD, str(error.args[0]), where="--topic, --remap", advice="isf bag info lists them"
            ) from error
        begin = begin_of_contour(bag.raw, options.contour - 1, options.namespace) if options.contour else 0
        connections = [connection for name in names for connection in bag.connections[name]]
        from isf_cell.run.player import Player, Playing  # late: ROS is not needed to refuse

        playing = Playing(options.rate, begin, renamed, options.delay, options.clock, options.paused)
        player = Player(bag.raw, connections, playing)
        try:
            terminal.say(f"playing {len(names)} topics at rate {options.rate:g}; Ctrl-C ends")
            played = player.play(lambda count, since: terminal.say(f"  {count} messages, {since:.0f} s"))
        finally:
            player.close()
        notes = list(bag.notes)
    late = 1e3 * np.array(played.late or [0.0])
    data = {
        "messages": played.messages,
        "seconds": played.seconds,
        "late_ms": {"median": float(np.median(late)), "p99": float(np.quantile(late, 0.99)), "max": float(late.max())},
        "real_time_priority": played.priority,
        "notes": notes,
    }
    if as_json:
        terminal.print_json(data)
    terminal.say(
        f"played {played.messages} messages in {played.seconds:.1f} s; published {np.median(late):.2f} ms late "
        f"(99 % below {np.quantile(late, 0.99):.2f} ms)"
    )
    for note in notes:
        terminal.warn(note)


def _parameter(item: str) -> tuple[str, object]:
    """Name and value as ROS reads it: 36.0 is a number, true a flag, all else a text; raises IsfError FILE_FIELD."""
    name, sign, text = item.partition(":=")
    if not (name.isidentifier() and sign):
        raise IsfError(
            ErrorCode.FILE_FIELD,
            f"'{item}' is not NAME:=VALUE",
            where="--param",
            advice="for example: --param loop_gain:=36.0",
        )
    try:
        value = yaml_file.content(text, "--param")
    except IsfError:  # a text that is no YAML
        value = text
    return name, value if isinstance(value, bool | int | float) else text
