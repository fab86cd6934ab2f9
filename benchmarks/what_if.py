"""What a gain of the force loop would do to a recorded part, against really forming the part with it: some minutes.

Forms a job through the node graph in lockstep, replays its bag without a change (every target and correction must be
the recorded one) and with another loop gain, and then forms the part through the node graph with that gain.

usage: ./isf python benchmarks/what_if.py [JOB] [--gain 36] [--variant 0]
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

from isf_analysis.bag.bag_reader import read_bag
from isf_cell.options import RunOptions
from isf_cell.processes.process_group import ProcessGroup
from isf_cell.replay.outcome import part_numbers, replay
from isf_cell.replay.recorded_run import read_run
from isf_cell.replay.what_if import parse
from isf_cell.run import graph_run
from isf_core.errors import IsfError
from isf_core.files.job import JobFile, load_job

ALLOWED = 1e-9
"""Relative error of the force's rms that a prediction may have: the same machine and noise, in lockstep."""

FELT = 0.05
"""Change of the force's rms that the gain must make, relative: else a prediction of no change would be right too."""


def form(job_file: JobFile, options: RunOptions, folder: Path, loop_gain: float | None) -> Path:
    """Bag of the part, formed with ``loop_gain`` 1/s (None: that of force control)."""
    client = graph_run.CellClient()
    try:
        with ProcessGroup(folder / "logs") as group:
            gain = {} if loop_gain is None else {"loop_gain": loop_gain}
            group.start("isf_analysis", "recorder", {"output": str(folder / "bag"), "autostart": True}, outlives=True)
            group.start("isf_sim", "machine", {"lockstep": True})
            group.start("isf_planner", "planner", {})
            group.start("isf_springback", "springback", {})
            group.start("isf_force_ctrl", "force_ctrl", {"lockstep": True, **gain})
            group.start("isf_cell", "executive", {"lockstep": True})
            client.wait_ready(group)
            result = client.form(job_file, options, lambda _: None, group)
    finally:
        client.close()
    if result.code:
        raise SystemExit(result.message)
    return folder / "bag"


def main() -> None:
    """Print what was measured; exit code 1 when a replay is not identical or a prediction off."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("job", nargs="?", type=Path, default=Path("examples/jobs/ren_cone.yaml"))
    parser.add_argument("--gain", type=float, default=36.0)
    parser.add_argument("--variant", type=int, default=0)
    arguments = parser.parse_args()
    job_file, options = load_job(arguments.job), RunOptions(seed=3, variant=arguments.variant)
    with tempfile.TemporaryDirectory() as folder:
        run = read_run(form(job_file, options, Path(folder) / "recorded", None))
        started = time.perf_counter(), time.process_time()
        same = replay(run, parse([]))
        decided = time.perf_counter() - started[0], time.process_time() - started[1]
        started = time.perf_counter(), time.process_time()
        found = replay(run, parse([f"force.loop_gain={arguments.gain}"]))
        predicted_in = time.perf_counter() - started[0], time.process_time() - started[1]
        formed = part_numbers(read_bag(form(job_file, options, Path(folder) / "formed", arguments.gain)))
    prediction = found.numbers()["prediction"]
    recorded, predicted = (prediction[which]["force_error_rms_N"] for which in ("recorded", "what_if"))
    really = formed["force_error_rms_N"]
    print(f"{job_file.job.name}, {run.part.planned} contours, {len(run.ticks.stamp) if run.ticks else 0} ticks")
    print(f"identical: {same.identical}, in {decided[0]:.1f} s ({decided[1]:.1f} s of a processor)")
    wall, processor = predicted_in
    print(f"loop gain {arguments.gain:g} 1/s predicted in {wall:.1f} s ({processor:.1f} s of a processor)")
    print(f"force error rms: recorded {recorded:.4f} N, predicted {predicted:.4f} N, formed {really:.4f} N")
    felt = abs(predicted - recorded) > FELT * recorded
    if not (same.identical and felt and abs(predicted - really) <= ALLOWED * really):
        raise SystemExit("not as it should be")


if __name__ == "__main__":
    try:
        main()
    except IsfError as error:
        raise SystemExit(str(error)) from error
