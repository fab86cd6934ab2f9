"""How well the contact force is held: set-points, parts and worlds, on the simulated machine in this process.

    ./isf python benchmarks/force_control.py                        # mini_cone and ren_pyramid, 120 N, nominal world
    ./isf python benchmarks/force_control.py --full --write --processes 2    # everything in
    docs/results/force_control.md ./isf python benchmarks/force_control.py --jobs mini_cone --worlds 1-5        # a
    piece of it ./isf python benchmarks/force_control.py --set loop_gain=36     # with other values of ControlConfig

One row per run. Every engaged tick counts (mode CONTROL, corners and the first contours included). Two errors: of the
*reading*, unfiltered and with the noise of the cell, and of the *true* force, which only a simulated machine knows;
their difference is the cell's own. What was computed before with the same sources and options is taken from
``.isf/cache/force_control.json``, so that a run can be done in pieces and resumed.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from isf_core.files.job import JobFile
from isf_force_ctrl import ControlConfig, ForceController
from isf_force_ctrl.control_state import Flag, Mode
from isf_planner import plan
from isf_planner.part_library import PARTS, part_mesh
from isf_sim.machine.simulated_machine import SimulatedMachine
from isf_springback.corrector import apply
from isf_springback.methods import make_corrector

ROOT = Path(__file__).resolve().parents[1]
JOBS = ROOT / "examples" / "jobs"
CACHE = ROOT / ".isf" / "cache" / "force_control.json"
PAGE = ROOT / "docs" / "results" / "force_control.md"
SOURCES = ("isf_core", "isf_planner", "isf_force_ctrl", "isf_springback", "isf_sim")
HEADER = (
    "| job | N | world | reading within 10 N [%] | RMS [N] | true force within 10 N [%] | RMS [N] | 99.9 % below [N] | "
    "largest [N] | cell alone, RMS [N] | cell alone within 10 N [%] | true force less the cell's bias, within 10 N [%] "
    "| contact lost [ticks] | at the offset limit [%] | back-offs |\n" + "|---" * 15 + "|"
)
SET_POINTS = (100.0, 120.0, 180.0, 200.0, 300.0)
PARTS_FORMED = ("ren_cone", "mini_cone", "ren_pyramid", "fin")
WORLDS = range(1, 21)
CONTACT = 5.0
"""N, less true normal force counts as lost contact."""


SAID: list[str] = []
"""What ``--sources`` says."""


@dataclass(frozen=True)
class Case:
    """One run; ``changes`` replace fields of ControlConfig."""

    job: str
    force: float
    world: int
    correction: str
    changes: tuple[tuple[str, float], ...] = ()
    contours: int | None = None

    def key(self) -> str:
        """Name of its result: the case, the job and all sources it depends on."""
        text = json.dumps(asdict(self)) + job_text(self.job) + sources()
        return hashlib.sha256(text.encode()).hexdigest()


@cache
def sources() -> str:
    """Digest of the packages a run depends on, or what ``--sources`` says: results of another one to go on with."""
    if SAID:
        return SAID[0]
    digest = hashlib.sha256(Path(__file__).read_bytes())
    for package in SOURCES:
        for path in sorted((ROOT / "ros_ws" / "src" / package).rglob("*")):
            if path.suffix in (".py", ".yaml", ".csv") and "test" not in path.parts and "node" not in path.stem:
                digest.update(path.read_bytes())
    return digest.hexdigest()[:12]


def job_text(name: str) -> str:
    """Text of an example; ``fin`` is the fish fin of the library formed as the small cone."""
    if name != "fin":
        return (JOBS / f"{name}.yaml").read_text()
    mesh = CACHE.parent / "fish_fin.stl"
    if not mesh.exists():
        mesh.parent.mkdir(parents=True, exist_ok=True)
        part = part_mesh(PARTS["fish_fin"](depth=9e-3))
        trimesh.Trimesh(part.vertices * 1e3, part.faces, process=False).export(mesh)
    text = (JOBS / "mini_cone.yaml").read_text()
    for old, new in (("../parts/mini_cone.stl", str(mesh)), ("30 mm/s", "15 mm/s"), ("depth: 2 mm", "depth: 4 mm")):
        assert old in text, old
        text = text.replace(old, new)
    return text


@dataclass
class Ticks:
    """What is kept of every tick of a part in mode CONTROL or POSITION: set-point, reading, true force in N, whether
    the plan wants force control there, mode, flags."""

    rows: list[tuple[float, ...]]
    backoffs: int = 0
    code: int = 0


def form(case: Case) -> Ticks:
    """Ticks of a part."""
    job_file = JobFile(job_text(case.job), JOBS, case.job)
    part = plan(job_file)
    machine = SimulatedMachine(job_file, variant=case.world)
    machine.tare()
    method = make_corrector(case.correction, job_file)
    controller = ForceController(
        replace(ControlConfig.from_job(job_file, support_force=case.force), **dict(case.changes))
    )
    sample = machine.sample()
    controller.arm(part.plan_id, 0, len(part.contours), sample.tip_1.tolist(), sample.tip_2.tolist())
    ticks = Ticks([])
    for nominal in part.contours[: case.contours]:
        corrected = apply(nominal, method.correct(nominal))
        controller.start(corrected)
        while controller.busy:
            before = controller.targets
            targets = controller.tick(sample.tick, sample.time, sample.wrench_1.tolist(), sample.wrench_2.tolist())
            state = controller.state()
            if state.mode in (Mode.CONTROL, Mode.POSITION):
                away = np.subtract(before.tip_2[:2], before.tip_1[:2])
                away = away / max(float(np.hypot(*away)), 1e-6)
                true = float(away @ sample.true_force_2[:2])
                row = (state.set_point, state.normal_force, true, nominal.force_controlled, state.mode, state.flags)
                ticks.rows.append(row)
            sample = machine.tick(targets.tip_1, targets.tip_2, targets.holder_height)
        result = controller.take_result()
        assert result is not None
        ticks.backoffs += result.backoffs
        ticks.code = ticks.code or result.code
        if not result.completed:
            break
        method.add_result(corrected, result)
    return ticks


def measure(case: Case) -> dict[str, Any]:
    """Numbers of one run."""
    ticks = form(case)
    table = np.array(ticks.rows)
    engaged = table[table[:, 4] == Mode.CONTROL]
    data: dict[str, Any] = {"code": ticks.code, "backoffs": ticks.backoffs}
    if len(engaged):
        wanted, reading, true = engaged[:, :3].T
        read_error, error = np.abs(reading - wanted), np.abs(true - wanted)
        data |= {
            "read_within": 100.0 * float((read_error <= 10.0).mean()),
            "read_rms": float(np.sqrt((read_error**2).mean())),
            "within": 100.0 * float((error <= 10.0).mean()),
            "rms": float(np.sqrt((error**2).mean())),
            "p999": float(np.percentile(error, 99.9)),
            "most": float(error.max()),
            "cell": float(np.sqrt(((reading - true) ** 2).mean())),
            "cell_within": 100.0 * float((np.abs(reading - true) <= 10.0).mean()),
            "loop_within": 100.0 * float((np.abs(true - wanted + (reading - true).mean()) <= 10.0).mean()),
            "lost": int((true < CONTACT).sum()),
            "limit": 100.0 * float(((engaged[:, 5].astype(int) & Flag.SATURATED_OFFSET) != 0).mean()),
        }
    return data


def measured(cases: Sequence[Any], processes: int, run: Callable[[Any], dict[str, Any]] = measure) -> Iterator[Any]:
    """Pairs of case and numbers, in order, from the cache where it has them; new ones are kept at once."""
    known = _kept()
    missing = [case for case in cases if case.key() not in known]
    print(f"{len(cases) - len(missing)} of {len(cases)} known; --sources {sources()} goes on", file=sys.stderr)
    spent = 0.0
    with ProcessPoolExecutor(processes) as pool:
        running = {pool.submit(_timed, run, case): case for case in missing}
        shown = iter(cases)
        case = next(shown, None)
        for done, future in enumerate(as_completed(running), 1):
            data, seconds = future.result()
            known = _kept() | {running[future].key(): data}
            CACHE.parent.mkdir(parents=True, exist_ok=True)
            CACHE.write_text(json.dumps(known))
            spent += seconds
            left = spent / done * (len(missing) - done) / 60.0
            print(
                f"{done} of {len(missing)} run, {seconds:.0f} s CPU, {left:.0f} min left", file=sys.stderr, flush=True
            )
            while case is not None and case.key() in known:
                yield case, known[case.key()]
                case = next(shown, None)
        while case is not None:
            yield case, known[case.key()]
            case = next(shown, None)


def _kept() -> dict[str, Any]:
    return dict(json.loads(CACHE.read_text())) if CACHE.exists() else {}


def _timed(run: Callable[[Any], dict[str, Any]], case: Any) -> tuple[dict[str, Any], float]:
    start = time.process_time()
    return run(case), time.process_time() - start


def row(case: Case, data: dict[str, Any]) -> str:
    """One line of the table."""
    failed = f" (ended with {data['code']})" if data["code"] else ""
    name = f"{case.job}, {case.contours} contours" if case.contours else case.job
    name += "".join(f", {field} {value:g}" for field, value in case.changes)
    if "within" not in data:
        return f"| {name}{failed} | {case.force:.0f} | {case.world} |" + " - |" * 12
    return (
        f"| {name}{failed} | {case.force:.0f} | {case.world} | {data['read_within']:.2f} | {data['read_rms']:.2f} | "
        f"{data['within']:.2f} | {data['rms']:.2f} | {data['p999']:.1f} | {data['most']:.1f} | {data['cell']:.2f} | "
        f"{data['cell_within']:.2f} | {data['loop_within']:.2f} | {data['lost']} | {data['limit']:.2f} | "
        f"{data['backoffs']} |"
    )


def worlds_row(name: str, rows: list[dict[str, Any]]) -> list[str]:
    """Median and worst of the off-nominal worlds of one job."""
    lines = []
    for label, pick in (("median", np.median), ("worst", None)):

        def value(key: str, worst: Any, pick: Any = pick) -> float:
            return float((pick or worst)([data[key] for data in rows]))

        lines.append(
            f"| {name} | | {label} of {len(rows)} | {value('read_within', min):.2f} | {value('read_rms', max):.2f} | "
            f"{value('within', min):.2f} | {value('rms', max):.2f} | {value('p999', max):.1f} | "
            f"{value('most', max):.1f} | {value('cell', max):.2f} | {value('cell_within', min):.2f} | "
            f"{value('loop_within', min):.2f} | {value('lost', max):.0f} | {value('limit', max):.2f} | "
            f"{value('backoffs', max):.0f} |"
        )
    return lines


VERDICT_HEADER = (
    "| job | runs | true force within 10 N for 99.9 % | true force 3 N RMS | readings within 10 N for 99.9 % | "
    "readings 3 N RMS | force less the cell's bias for 99.9 % | contact never lost |\n" + "|---" * 8 + "|"
)


def verdict(name: str, rows: list[dict[str, Any]]) -> str:
    """In how many of the runs what is asked for holds."""
    tests: tuple[Callable[[dict[str, Any]], bool], ...] = (
        lambda data: data["within"] >= 99.9,
        lambda data: data["rms"] <= 3.0,
        lambda data: data["read_within"] >= 99.9,
        lambda data: data["read_rms"] <= 3.0,
        lambda data: data["loop_within"] >= 99.9,
        lambda data: data["lost"] == 0,
    )
    return f"| {name} | {len(rows)} | " + " | ".join(str(sum(map(test, rows))) for test in tests) + " |"


def full_cases(correction: str) -> list[Case]:
    """Parts and set-points on the nominal world, then worlds 1 to 20 at 120 N."""
    cases = [Case(job, force, 0, correction) for job in PARTS_FORMED for force in SET_POINTS]
    wider = (("offset_limit", 2e-3),)
    cases += [Case(job, 300.0, 0, correction, changes=wider) for job in ("ren_cone", "ren_pyramid")]
    return cases + [Case(job, 120.0, world, correction) for job in PARTS_FORMED for world in WORLDS]


def run_forces(cases: list[Case], processes: int) -> str:
    """The table of forces, and in how many runs it holds what is asked for; printed line by line as well."""
    lines, groups = [HEADER], dict[str, list[dict[str, Any]]]()
    print(HEADER, flush=True)
    for case, data in measured(cases, processes):
        lines.append(row(case, data))
        print(lines[-1], flush=True)
        if "within" in data:
            group = f"{case.job}, " + ("worlds" if case.world else "other limit" if case.changes else "set-points")
            groups.setdefault(group, []).append(data)
    for name, rows in groups.items():
        lines += worlds_row(name, rows) if name.endswith("worlds") else []
    lines += ["", VERDICT_HEADER] + [verdict(name, rows) for name, rows in groups.items()]
    print("\n".join(lines[len(cases) + 1 :]), flush=True)
    return "\n".join(lines)


def write(mark: str, table: str) -> None:
    """Put ``table`` between the marks of the page."""
    text = PAGE.read_text(encoding="utf-8")
    begin, end = f"<!-- {mark}: begin -->\n", f"<!-- {mark}: end -->"
    head, _, rest = text.partition(begin)
    _, found, tail = rest.partition(end)
    assert found, f"{PAGE}: no marks for {mark}"
    PAGE.write_text(f"{head}{begin}\n{table}\n\n{end}{tail}", encoding="utf-8")


def _worlds(text: str) -> list[int]:
    first, _, last = text.partition("-")
    return list(range(int(first), int(last or first) + 1))


def main() -> None:
    """Run all cases and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--full", action="store_true", help="cones, pyramid and fin, all set-points, worlds 1 to 20")
    parser.add_argument("--jobs", nargs="+", default=("mini_cone", "ren_pyramid"), help="examples, or fin")
    parser.add_argument("--forces", nargs="+", type=float, default=(120.0,))
    parser.add_argument("--worlds", nargs="+", type=_worlds, default=[[0]], metavar="N or N-M")
    parser.add_argument("--correction", default="analytic")
    parser.add_argument("--contours", type=int, help="only so many contours of each part")
    parser.add_argument("--set", nargs="*", default=(), metavar="FIELD=VALUE", help="fields of ControlConfig")
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--write", action="store_true", help="put the table of --full into the page")
    parser.add_argument("--sources", help="go on with the results of these sources, as the last run has told them")
    arguments = parser.parse_args()
    SAID[:] = [arguments.sources] if arguments.sources else []
    changes = tuple((name, float(value)) for name, _, value in (item.partition("=") for item in arguments.set))
    worlds = [world for group in arguments.worlds for world in group]
    cases = full_cases(arguments.correction) if arguments.full else []
    cases = cases or [
        Case(job, force, world, arguments.correction, changes, arguments.contours)
        for job in arguments.jobs
        for force in arguments.forces
        for world in worlds
    ]
    table = run_forces(cases, arguments.processes)
    if arguments.write and arguments.full:
        write("forces", table)


if __name__ == "__main__":
    main()
