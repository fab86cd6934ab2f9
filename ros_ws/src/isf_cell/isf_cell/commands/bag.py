"""``isf bag``: a bag summed up, written as tables, and made whole again; without ROS."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import isf_analysis
from isf_analysis.bag.copy import copy_bag
from isf_analysis.bag.table_files import write_tables
from isf_core.errors import IsfError

from isf_cell.commands import terminal
from isf_cell.commands.run_folder import make_folder


def show_bag(path: Path, *, namespace: str | None = None, as_json: bool) -> None:
    """Part (of the cell ``namespace``), duration and topics of the bag at ``path``; raises IsfError BAG_UNREADABLE."""
    with isf_analysis.open(path, namespace) as bag:
        raw = bag.raw
        topics = [{"name": name, "type": table.type, "messages": table.messages} for name, table in bag.items()]
        data: dict[str, Any] = {
            "bag": str(bag.raw.path),
            "messages": raw.message_count,
            "duration_s": raw.duration * 1e-9,
            "start": raw.start_time * 1e-9,
            "topics": topics,
            "part": None,
        }
        try:
            part = bag.part
        except IsfError as error:
            bag.raw.note(error.message)
        else:
            data["part"] = {
                "job": part.job_name,
                "process": part.process,
                "correction": part.correction,
                "planned_contours": part.planned,
                "formed_contours": part.formed,
                "lockstep": part.lockstep,
                "variant": part.variant,
                "seed": part.seed,
                "software": part.software,
                "scans": len(part.scans) + (part.scan is not None),
                "events": len(part.events),
            }
        data["notes"] = list(dict.fromkeys([*bag.notes, *(bag.part.notes if data["part"] else ())]))
    if as_json:
        terminal.print_json(data)
    began = time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(data["start"])) if topics and data["messages"] else "-"
    terminal.say(f"{data['bag']}: {data['messages']} messages in {data['duration_s']:.1f} s from {began}")
    if data["part"]:
        numbers = data["part"]
        terminal.say(
            f"part {numbers['job']} ({numbers['process']}, correction {numbers['correction']}): "
            f"{numbers['formed_contours']} of {numbers['planned_contours']} contours formed"
        )
    table = terminal.table_of("", "topic", "type", "messages")
    for topic in topics:
        table.add_row(topic["name"], topic["type"], str(topic["messages"]))
    terminal.console.print(table)
    for note in data["notes"]:
        terminal.warn(note)


def write_bag_tables(
    path: Path,
    output: Path,
    formats: Sequence[str] | None,
    topics: Sequence[str] | None,
    *,
    namespace: str | None = None,
    as_json: bool,
) -> None:
    """Tables of the bag at ``path`` as files in ``output``, of the part that the cell ``namespace`` formed.

    Raises IsfError as write_tables, BAG_UNREADABLE.
    """
    started = time.perf_counter()
    with isf_analysis.open(path, namespace) as bag:
        folder = make_folder(output)
        rows = write_tables(bag, folder, formats, topics)
        notes = list(bag.notes)
    seconds = time.perf_counter() - started
    if as_json:
        terminal.print_json({"folder": str(folder), "rows": rows, "seconds": seconds, "notes": notes})
    table = terminal.table_of("", "table", "rows")
    for name, count in rows.items():
        table.add_row(name, str(count))
    terminal.console.print(table)
    for note in notes:
        terminal.warn(note)
    terminal.say(f"tables  {folder}")


def repair_bag(path: Path, output: Path, *, as_json: bool) -> None:
    """What can be read of the bag at ``path`` as the new bag ``output``.

    Raises IsfError BAG_UNREADABLE, BAG_NOT_WRITABLE.
    """
    copied = copy_bag(path, output.absolute())
    if as_json:
        terminal.print_json(
            {
                "bag": str(copied.path),
                "topics": copied.topics,
                "messages": copied.messages,
                "notes": list(copied.notes),
            }
        )
    terminal.say(f"{copied.messages} messages of {copied.topics} topics in {copied.path}")
    for note in copied.notes:
        terminal.warn(note)
