"""Record golden runs anew, after a wanted change of results; say in the commit what changed them.

usage: ./isf python tests/golden/record.py [--all | NAME...]     names as in golden_cases.py, * as in a shell
Without names it lists them. What changed is told per run, as the test would.
"""

from __future__ import annotations

import argparse
import platform
import subprocess
import sys
import time
from datetime import date
from fnmatch import fnmatch
from importlib.metadata import version
from pathlib import Path

import golden_values
from golden_cases import CASES, RECORDED


def provenance() -> dict[str, str]:
    """Which sources, libraries and processor gave the numbers."""
    here = Path(__file__).resolve().parent
    git = ["git", "-C", str(here), "describe", "--always", "--dirty", "--exclude", "*"]
    processor = [line for line in Path("/proc/cpuinfo").read_text().splitlines() if line.startswith("model name")]
    return {
        "recorded": date.today().isoformat(),
        "commit": subprocess.run(git, capture_output=True, text=True, check=True).stdout.strip(),
        "python": platform.python_version(),
        **{name: version(name) for name in ("numpy", "scipy", "numba")},
        "processor": processor[0].partition(":")[2].strip() if processor else platform.machine(),
    }


def main() -> None:
    """Record the runs asked for."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("names", nargs="*", help="runs to record; * as in a shell")
    parser.add_argument("--all", action="store_true", help="record every run")
    given = parser.parse_args()
    chosen = [case for case in CASES if given.all or any(fnmatch(case.name, name) for name in given.names)]
    if not chosen:
        print(*(case.name for case in CASES), sep="\n")
        sys.exit("none of these was asked for" if given.names else 0)
    stamp = provenance()
    RECORDED.mkdir(exist_ok=True)
    for case in chosen:
        started = time.perf_counter()
        series = case.series()
        known = golden_values.read(case.file) if case.file.exists() else None
        found = golden_values.differences(known, series, exact=True) if known is not None else []
        golden_values.write(case.file, stamp, series)
        print(f"{case.name}: {time.perf_counter() - started:.1f} s, {case.file.stat().st_size / 1e3:.0f} kB, ", end="")
        reported = [f"{len(found)} series changed", *found] if found else ["new" if known is None else "the same"]
        print("\n    ".join(reported), flush=True)
    if given.all:
        for path in RECORDED.glob("*.json"):
            if path.stem not in {case.name for case in CASES}:
                path.unlink()


if __name__ == "__main__":
    main()
