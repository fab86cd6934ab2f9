"""How accurate parts become, with and without correction, on nominal and off-nominal simulated machines.

    ./isf python benchmarks/accuracy.py                 # all examples, nominal world (about 3 minutes)
    ./isf python benchmarks/accuracy.py --worlds 0 1 2 3 4 --jobs ren_cone

Prints one table row per job, correction and world: error of wall and base against the CAD surface in the clamp, support
force while engaged. The same rows go to ``docs/results.md`` with ``--write``.
"""

from __future__ import annotations

import argparse
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from isf_analysis.summary import summary
from isf_cell import in_process
from isf_cell.options import RunOptions
from isf_core.job import load_job

ROOT = Path(__file__).resolve().parents[1]
JOBS = ("ren_cone", "ren_pyramid", "spif_cone")
HEADER = (
    "| job | world | correction | max [mm] | mean [mm] | base mean [mm] | within 10 N [%] | 99.9 % below [N] | "
    "contact [%] | late | wall [s] |\n|---|---|---|---|---|---|---|---|---|---|---|"
)


@dataclass(frozen=True)
class Case:
    """One run."""

    job: str
    correction: str
    world: int
    seed: int


def run(case: Case) -> dict[str, Any]:
    """Numbers of one run."""
    options = RunOptions(case.correction, None, case.world, case.seed)
    return summary(in_process.form(load_job(ROOT / "examples" / "jobs" / f"{case.job}.yaml"), options))


def row(case: Case, data: dict[str, Any]) -> str:
    """One line of the table."""

    def number(*path: str, digits: int = 2, factor: float = 1.0) -> str:
        value: Any = data
        for key in path:
            value = value.get(key) if isinstance(value, dict) else None
        return "-" if value is None else f"{factor * value:.{digits}f}"

    cells = [
        case.job,
        str(case.world),
        case.correction,
        number("deviation", "max_mm"),
        number("deviation", "mean_abs_mm"),
        number("deviation", "regions", "base", "mean_abs_mm"),
        number("force", "within_10N_fraction", factor=100.0),
        number("force", "p999_abs_error_N", digits=1),
        number("force", "contact_fraction", factor=100.0, digits=1),
        str(data["late_ticks"]),
        number("wall_s", digits=0),
    ]
    return "| " + " | ".join(cells) + " |"


def main() -> None:
    """Run all cases on all cores and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--jobs", nargs="+", default=JOBS)
    parser.add_argument("--corrections", nargs="+", default=("none", "analytic"))
    parser.add_argument("--worlds", nargs="+", type=int, default=(0,))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--write", type=Path, help="file that receives the table")
    arguments = parser.parse_args()
    cases = [
        Case(job, correction, world, arguments.seed)
        for job in arguments.jobs
        for world in arguments.worlds
        for correction in arguments.corrections
    ]
    lines = [HEADER]
    print(HEADER)
    with ProcessPoolExecutor() as pool:
        for case, data in zip(cases, pool.map(run, cases), strict=True):
            lines.append(row(case, data))
            print(lines[-1], flush=True)
    if arguments.write:
        arguments.write.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
