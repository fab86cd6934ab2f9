"""``isf report``: a report from a bag alone."""

from __future__ import annotations

from pathlib import Path

from isf_cell.commands.finish import finish


def report_bag(bag: Path, reference: Path | None, output: Path | None, *, as_json: bool) -> None:
    """Report of ``bag``, beside it unless ``output`` is given; raises IsfError BAG_UNREADABLE or BAG_INCOMPLETE."""
    bag = bag.resolve()
    folder = (output or bag.parent).resolve()
    folder.mkdir(parents=True, exist_ok=True)
    finish(folder, reference, failure=None, as_json=as_json, bag=bag)
