"""How well the contact force is held: set-points, parts and worlds, on the simulated machine in this process.

    ./isf python benchmarks/force_control.py                        # mini_cone and ren_pyramid, 120 N, nominal world
    ./isf python benchmarks/force_control.py --full --write         # everything in docs/force_control.md (an hour)
    ./isf python benchmarks/force_control.py --jobs mini_cone --worlds 1-5        # a piece of it
    ./isf python benchmarks/force_control.py --loops                # force control, compensation, both, none
    ./isf python benchmarks/force_control.py --set loop_gain=36     # with other values of ControlConfig

One row per run. Every engaged tick counts (mode CONTROL, corners and the first contours included). Two errors: of the
*reading*, unfiltered and with the noise of the cell, and of the *true* force, which only a simulated machine knows;
their difference is the cell's own. What was computed before with the same sources and options is taken from
``.isf/cache/force_control.json``, so that a run can be done in pieces and resumed.
"""

from __future__ import annotations

import argparse
import hashlib
import json
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from isf_analysis.deviation import compare
from isf_core.job import JobFile
from isf_force_ctrl import ControlConfig, ForceController
from isf_force_ctrl.control_state import Flag, Mode
from isf_planner import plan
from isf_planner.part_library import PARTS, part_mesh
from isf_sim.machine import SimulatedMachine
from isf_springback.method import apply, make_method

ROOT = Path(__file__).resolve().parents[1]
JOBS = ROOT / "examples" / "jobs"
CACHE = ROOT / ".isf" / "cache" / "force_control.json"
PAGE = ROOT / "docs" / "force_control.md"
SOURCES = ("isf_core", "isf_planner", "isf_force_ctrl", "isf_springback", "isf_sim")
HEADER = (
    "| job | N | world | reading within 10 N [%] | RMS [N] | true force within 10 N [%] | RMS [N] | 99.9 % below [N] | "
    "largest [N] | cell alone, RMS [N] | contact lost [ticks] | at the offset limit [%] | back-offs |\n"
    "|---|---|---|---|---|---|---|---|---|---|---|---|---|"
)
LOOPS_HEADER = (
    "| force control | compensation | largest error [mm] | mean error [mm] | base, mean [mm] | normal force [N] | "
    "its standard deviation [N] | without contact [%] |\n|---|---|---|---|---|---|---|---|"
)
SET_POINTS = (100.0, 120.0, 180.0, 200.0, 300.0)
SHORT = 16
"""Contours of ren_pyramid that are formed on the worlds: eight of them under force control."""
CONTACT = 5.0
"""N, less true normal force counts as lost contact."""


@dataclass(frozen=True)
class Case:
    """One run; ``changes`` replace fields of ControlConfig, ``compensation`` is the factor of the job."""

    job: str
    force: float
    world: int
    correction: str
    changes: tuple[tuple[str, float], ...] = ()
    contours: int | None = None
    compensation: float = 1.0
    shape: bool = False

    def key(self) -> str:
        """Name of its result: the case, the job and all sources it depends on."""
        text = json.dumps(asdict(self)) + _job_text(self.job) + sources()
        return hashlib.sha256(text.encode()).hexdigest()


@cache
def sources() -> str:
    """Digest of the packages a run depends on."""
    digest = hashlib.sha256(Path(__file__).read_bytes())
    for package in SOURCES:
        for path in sorted((ROOT / "ros_ws" / "src" / package).rglob("*")):
            if path.suffix in (".py", ".yaml", ".csv") and "test" not in path.parts:
                digest.update(path.read_bytes())
    return digest.hexdigest()


def _job_text(name: str) -> str:
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


def form(case: Case) -> tuple[Ticks, dict[str, float]]:
    """Ticks of a part, and its error against the target (empty unless asked for)."""
    text = _job_text(case.job).replace("compliance_compensation: 1.0", f"compliance_compensation: {case.compensation}")
    job_file = JobFile(text, JOBS, case.job)
    part = plan(job_file)
    machine = SimulatedMachine(job_file, world=case.world)
    machine.tare()
    method = make_method(case.correction, job_file)
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
        method.learn(corrected, result)
    shape: dict[str, float] = {}
    if case.shape:
        found = compare(machine.measured_shape(), part.target)
        base = found.regions.get("base", found.whole)
        shape = {
            "most": 1e3 * found.whole.max_abs,
            "mean": 1e3 * found.whole.mean_abs,
            "base": 1e3 * base.mean,
        }
    return ticks, shape


def measure(case: Case) -> dict[str, Any]:
    """Numbers of one run."""
    ticks, shape = form(case)
    table = np.array(ticks.rows)
    engaged = table[table[:, 4] == Mode.CONTROL]
    data: dict[str, Any] = {
        "code": ticks.code,
        "backoffs": ticks.backoffs,
        **{f"shape_{k}": v for k, v in shape.items()},
    }
    if case.shape:
        there = table[table[:, 3] > 0, 2]
        data |= {"force": float(there.mean()), "spread": float(there.std())}
        data["free"] = 100.0 * float((there < CONTACT).mean())
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
            "lost": int((true < CONTACT).sum()),
            "limit": 100.0 * float(((engaged[:, 5].astype(int) & Flag.SATURATED_OFFSET) != 0).mean()),
        }
    return data


def measured(cases: list[Case], processes: int) -> Iterator[tuple[Case, dict[str, Any]]]:
    """Numbers of all cases in order, from the cache where it has them; new ones are kept at once."""
    known: dict[str, Any] = json.loads(CACHE.read_text()) if CACHE.exists() else {}
    missing = [case for case in cases if case.key() not in known]
    with ProcessPoolExecutor(processes) as pool:
        fresh = pool.map(measure, missing)
        for case in cases:
            if case.key() not in known:
                data = next(fresh)
                known = (json.loads(CACHE.read_text()) if CACHE.exists() else {}) | {case.key(): data}
                CACHE.parent.mkdir(parents=True, exist_ok=True)
                CACHE.write_text(json.dumps(known))
            yield case, known[case.key()]


def row(case: Case, data: dict[str, Any]) -> str:
    """One line of the table."""
    failed = f" (ended with {data['code']})" if data["code"] else ""
    name = f"{case.job}, {case.contours} contours" if case.contours else case.job
    if "within" not in data:
        return f"| {name}{failed} | {case.force:.0f} | {case.world} |" + " - |" * 10
    return (
        f"| {name}{failed} | {case.force:.0f} | {case.world} | {data['read_within']:.2f} | {data['read_rms']:.2f} | "
        f"{data['within']:.2f} | {data['rms']:.2f} | {data['p999']:.1f} | {data['most']:.1f} | {data['cell']:.2f} | "
        f"{data['lost']} | {data['limit']:.2f} | {data['backoffs']} |"
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
            f"{value('most', max):.1f} | {value('cell', max):.2f} | {value('lost', max):.0f} | "
            f"{value('limit', max):.2f} | {value('backoffs', max):.0f} |"
        )
    return lines


def loops_row(case: Case, data: dict[str, Any]) -> str:
    """One line of the table of both loops."""
    return (
        f"| {f'{case.force:.0f} N' if case.force else 'off'} | {case.compensation:g} | {data['shape_most']:.3f} | "
        f"{data['shape_mean']:.3f} | {data['shape_base']:+.3f} | {data['force']:.0f} | {data['spread']:.1f} | "
        f"{data['free']:.1f} |"
    )


def full_cases(correction: str) -> list[Case]:
    """Parts and set-points on the nominal world, then worlds 1 to 20 at 120 N."""
    cases = [Case(job, force, 0, correction) for job in ("mini_cone", "ren_pyramid", "fin") for force in SET_POINTS]
    for job, contours in (("mini_cone", None), ("ren_pyramid", SHORT)):
        cases += [Case(job, 120.0, world, correction, contours=contours) for world in range(1, 21)]
    return cases


def loops_cases(job: str, correction: str) -> list[Case]:
    """Force control and compensation, each alone, both and none."""
    return [
        Case(job, force, 0, correction, compensation=factor, shape=True)
        for force, factor in ((0.0, 0.0), (0.0, 1.0), (120.0, 0.0), (120.0, 1.0))
    ]


def run_forces(cases: list[Case], processes: int) -> str:
    """The table of forces; printed line by line as well."""
    lines, worlds = [HEADER], dict[str, list[dict[str, Any]]]()
    print(HEADER, flush=True)
    for case, data in measured(cases, processes):
        lines.append(row(case, data))
        print(lines[-1], flush=True)
        if case.world and "within" in data:
            worlds.setdefault(f"{case.job}, worlds", []).append(data)
    for name, rows in worlds.items():
        lines += worlds_row(name, rows)
        print("\n".join(lines[-2:]), flush=True)
    return "\n".join(lines)


def run_loops(job: str, correction: str, processes: int) -> str:
    """The table of both loops."""
    lines = [LOOPS_HEADER]
    lines += [loops_row(case, data) for case, data in measured(loops_cases(job, correction), processes)]
    print("\n".join(lines), flush=True)
    return "\n".join(lines)


def write(mark: str, table: str) -> None:
    """Put ``table`` between the marks of the page."""
    text = PAGE.read_text(encoding="utf-8")
    begin, end = f"<!-- {mark}: begin -->\n", f"<!-- {mark}: end -->"
    head, _, rest = text.partition(begin)
    _, found, tail = rest.partition(end)
    assert found, f"{PAGE}: no marks for {mark}"
    PAGE.write_text(f"{head}{begin}{table}\n{end}{tail}", encoding="utf-8")


def _worlds(text: str) -> list[int]:
    first, _, last = text.partition("-")
    return list(range(int(first), int(last or first) + 1))


def main() -> None:
    """Run all cases and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--full", action="store_true", help="cone, pyramid and fin, all set-points, worlds 1 to 20")
    parser.add_argument("--loops", action="store_true", help="force control and compensation: each, both, none")
    parser.add_argument("--jobs", nargs="+", default=("mini_cone", "ren_pyramid"), help="examples, or fin")
    parser.add_argument("--forces", nargs="+", type=float, default=(120.0,))
    parser.add_argument("--worlds", nargs="+", type=_worlds, default=[[0]], metavar="N or N-M")
    parser.add_argument("--correction", default="analytic")
    parser.add_argument("--contours", type=int, help="only so many contours of each part")
    parser.add_argument("--set", nargs="*", default=(), metavar="FIELD=VALUE", help="fields of ControlConfig")
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--write", action="store_true", help="put the tables of --full and --loops into the page")
    arguments = parser.parse_args()
    changes = tuple((name, float(value)) for name, _, value in (item.partition("=") for item in arguments.set))
    worlds = [world for group in arguments.worlds for world in group]
    if arguments.loops or arguments.full:
        loops = run_loops(arguments.jobs[0], arguments.correction, arguments.processes)
        if arguments.write:
            write("loops", loops)
        if not arguments.full:
            return
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
