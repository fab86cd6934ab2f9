"""``isf report``: a report from a bag alone."""

from __future__ import annotations

from pathlib import Path

from isf_cell.commands.finish import finish
from isf_cell.run_folder import bag_of, make_folder


def report_bag(bag: Path, reference: Path | None, output: Path | None, *, as_json: bool) -> None:
    """Report of ``bag`` (or of the run folder with it), beside it unless ``output`` is given.

    Raises IsfError BAG_UNREADABLE, BAG_INCOMPLETE, FILE_NOT_WRITABLE.
    """
    bag = bag_of(bag).resolve()
    folder = make_folder(output or bag.parent)
    finish(folder, reference and bag_of(reference), failure=None, as_json=as_json, bag=bag)
