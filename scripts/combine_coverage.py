"""Unite the coverage data of many processes: ``combine_coverage.py OUTPUT PREFIX``, files PREFIX*.

A test may kill a process while that writes its data, which leaves a torn database: ``coverage combine`` stops there and
the rest is not counted. Here such a file is named and left out.
"""

from __future__ import annotations

import sys
from pathlib import Path

from coverage import CoverageData
from coverage.exceptions import CoverageException


def combine(output: Path, prefix: str) -> list[Path]:
    """Write ``output`` from the files in its folder whose names begin with ``prefix``, and remove those; the torn."""
    united, torn = CoverageData(str(output)), []
    united.erase()
    for file in sorted(output.parent.glob(f"{prefix}*")):
        try:
            # first where nothing can be spoilt: an update that fails is not taken back, coverage keeps no journal
            alone = CoverageData(no_disk=True)
            found = CoverageData(str(file))
            found.read()
            alone.update(found)
        except CoverageException:
            torn.append(file)
        else:
            united.update(alone)
        file.unlink()
    return torn


if __name__ == "__main__":
    for file in combine(Path(sys.argv[1]), sys.argv[2]):
        print(f"coverage: {file.name} is torn, its process was killed while it wrote")
