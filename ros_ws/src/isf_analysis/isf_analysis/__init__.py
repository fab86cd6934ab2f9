"""Recorder, bags, tables, metrics and report of formed parts."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from isf_analysis.bag.tables import Bag


def open(path: Path | str, namespace: str | None = None) -> Bag:
    """Tables of the bag, or of the run folder with its bag, at ``path``; needs no ROS.

    ``namespace`` : cell that is meant, where the bag holds several.

    Raises
    ------
    IsfError : BAG_UNREADABLE
    """
    from isf_analysis.bag.tables import Bag  # late: the recorder, too, imports this package, and does not read

    return Bag(path, namespace)
