"""One cell that forms part after part: does anything in it grow?

usage: ./isf python benchmarks/soak.py [--hours 6] [--parts 1000] [--clock] [--json]

Starts the nodes of a cell once, recorded into one bag as by `isf cell --record`, and forms the quick cone with it, with
the corrections `elastic`, `none` and `fused` (scans) in turn, until the time is over. After every part the resident
memory, threads and open files of each node are read from the system, and what lies in the cell's folder beside the bag
is counted. A node grows when the median of its memory in the last third of the parts is more than a hundredth above
that of the second round of methods, parts 4 to 6. Ctrl-C ends it and prints what was measured until then.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median

from isf_cell.options import RunOptions
from isf_cell.processes.domain_lock import alone_in_domain
from isf_cell.processes.process_group import ProcessGroup
from isf_cell.run.checkpoint import CHECKPOINT
from isf_cell.run.graph_run import CellClient, start_cell

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests"))
from quick_cone import quick_cone  # noqa: E402

METHODS = ("method: elastic", "method: none", "method: fused\n  scan_every: 1")
GROWS = 0.01
"""Share of a node's memory in the second round, above which it is called growing."""


@dataclass
class Reading:
    """Of one process: ``memory`` resident, MB; ``threads`` and open ``files``."""

    memory: float
    threads: int
    files: int


@dataclass
class Soak:
    """What was measured, a reading per node and part."""

    readings: dict[str, list[Reading]] = field(default_factory=dict)
    codes: list[int] = field(default_factory=list)
    cell_time: float = 0.0
    wall_time: float = 0.0
    beside_bag: list[int] = field(default_factory=list)
    """Files in the cell's folder beside those of the bag, after each part."""

    def summary(self) -> dict[str, object]:
        """Of every node: medians of the second round and of the last third, growth; whether anything grew.

        Of fewer than six parts, what there is of them.
        """
        first = min(len(METHODS), len(self.codes) - 1)
        nodes = {}
        for name, readings in self.readings.items():
            last = readings[-max(1, len(readings) // 3) :]
            second = readings[first : first + len(METHODS)]
            begin, end = (median(item.memory for item in part) for part in (second, last))
            nodes[name] = {
                "second_round_mb": round(begin, 2),
                "last_third_mb": round(end, 2),
                "growth": round(end / begin - 1.0, 4),
                "threads": [second[0].threads, last[-1].threads],
                "files": [second[0].files, last[-1].files],
            }
        return {
            "parts": len(self.codes),
            "codes": {str(code): self.codes.count(code) for code in sorted(set(self.codes))},
            "hours_of_cell": round(self.cell_time / 3600, 2),
            "hours_of_wall": round(self.wall_time / 3600, 2),
            "files_beside_bag": [self.beside_bag[first], self.beside_bag[-1]],
            "growing": [name for name, row in nodes.items() if float(str(row["growth"])) > GROWS],
            "nodes": nodes,
        }


def reading_of(pid: int) -> Reading:
    """Of the process, from /proc."""
    folder = Path(f"/proc/{pid}")
    status = dict(line.split(":", 1) for line in (folder / "status").read_text().splitlines())
    return Reading(
        memory=int(status["VmRSS"].split()[0]) / 1024,
        threads=int(status["Threads"]),
        files=sum(1 for _ in (folder / "fd").iterdir()),
    )


def soak(hours: float, parts: int, *, lockstep: bool) -> Soak:
    """Form parts until ``hours`` or ``parts`` are over; what is going on is written to stderr."""
    measured = Soak()
    begun = time.monotonic()
    with tempfile.TemporaryDirectory() as scratch, alone_in_domain(), ProcessGroup(Path(scratch) / "logs") as group:
        folder = Path(scratch)
        start_cell(group, folder / "bag", lockstep=lockstep, checkpoint=folder / CHECKPOINT)
        client = CellClient()
        try:
            client.wait_ready(group)
            while len(measured.codes) < parts and time.monotonic() - begun < hours * 3600:
                job = quick_cone(METHODS[len(measured.codes) % len(METHODS)])
                result = client.form(job, RunOptions(), lambda _: None, group)
                measured.codes.append(int(result.code))
                measured.cell_time += result.sim_time
                measured.wall_time = time.monotonic() - begun
                inside = (item for item in folder.rglob("*") if item.is_file())
                measured.beside_bag.append(sum(1 for item in inside if folder / "bag" not in item.parents))
                for node in group.nodes:
                    measured.readings.setdefault(node.name, []).append(reading_of(node.popen.pid))
                now = "  ".join(f"{name} {readings[-1].memory:.1f}" for name, readings in measured.readings.items())
                print(f"part {len(measured.codes)}, code {result.code}, MB: {now}", file=sys.stderr, flush=True)
        except KeyboardInterrupt:
            print("ended by Ctrl-C", file=sys.stderr)
        finally:
            client.close()
    return measured


def main() -> None:
    """Measure and print; exit code 1 when a node grew or a part was not formed."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--hours", type=float, default=6.0, help="of wall time")
    parser.add_argument("--parts", type=int, default=1_000_000, help="at most")
    parser.add_argument("--clock", action="store_true", help="by the clock instead of in lockstep")
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()
    measured = soak(given.hours, given.parts, lockstep=not given.clock)
    if not measured.codes:
        sys.exit("no part was formed")
    summary = measured.summary()
    if given.json:
        print(json.dumps(summary, indent=2))
    else:
        nodes = summary.pop("nodes")
        assert isinstance(nodes, dict)
        for name, value in summary.items():
            print(f"{name}: {value}")
        print("\n| node | MB in the second round | last third | growth | threads | open files |")
        print("|---|---|---|---|---|---|")
        for name, row in nodes.items():
            threads, files = row["threads"], row["files"]
            print(
                f"| {name} | {row['second_round_mb']:.1f} | {row['last_third_mb']:.1f} | {row['growth']:+.1%} | "
                f"{threads[0]} -> {threads[1]} | {files[0]} -> {files[1]} |"
            )
    if summary["growing"] or any(measured.codes):
        sys.exit(1)


if __name__ == "__main__":
    main()
