"""The golden runs: small parts with coarse steps for every process, springback method and measurement, and all plans.

``always`` is what every test run compares; the others are marked slow.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import golden_cell as cell
from golden_values import Quantity, Series

HERE = Path(__file__).resolve().parent
JOBS = HERE / "jobs"
EXAMPLES = sorted((HERE.parents[1] / "examples" / "jobs").glob("*.yaml"))
RECORDED = HERE / "recorded"

Run = Callable[[Path], dict[str, Series]]


@dataclass(frozen=True)
class Case:
    """A run by ``name``; ``process`` and ``method`` are what it covers ("" where none is at work).

    ``factor`` : bounds are so many times wider than those of :class:`golden_values.Quantity`
    """

    name: str
    run: Run
    process: str = ""
    method: str = ""
    always: bool = True
    factor: dict[Quantity, float] = field(default_factory=dict)

    @property
    def file(self) -> Path:
        """Where it is recorded."""
        return RECORDED / f"{self.name}.json"

    def series(self) -> dict[str, Series]:
        """Run it."""
        with TemporaryDirectory() as folder, cell.nothing_cached(Path(folder)):
            return self.run(Path(folder))


# Results of iterations that end when a step is small enough: another processor rounds otherwise and may take one step
# more or less. Load paths end with a step of 0.5 um, of displacements of some mm.
LOAD_PATHS = {Quantity.RELATIVE: 1e5}
# Estimates from noisy scans: 75 nm were seen between two processors. 1 um, and the forces that follow.
NOISY_SCANS = {Quantity.LENGTH: 1000.0, Quantity.FORCE: 100.0}

LONG_PLANS = (
    *("behera_80_25_ordinary", "behera_60_25", "behera_60_30", "behera_60_30_sequenced"),
    *("behera_pyramid_60", "behera_pyramid_76", "behera_pyramid_80", "behera_cone_65", "behera_cone_80"),
)
"""Jobs that take some 10 s to plan, in the way that behera_80_25 is planned."""


def _plan(job: Path) -> Case:
    return Case(f"plan_{job.stem}", lambda _: cell.planned(job), always=job.stem not in LONG_PLANS)


SCANS = "scan_every: 1, open_loop_contours: 1"


def _form(
    job: str,
    method: str,
    more: str = "",
    *,
    name: str = "",
    always: bool = False,
    contours: int | None = None,
    factor: dict[Quantity, float] | None = None,
    **options: Any,
) -> Case:
    """Part of ``job`` with ``method``; ``more`` YAML fields of its section, ``name`` of the case after that of both."""
    springback = f"method: {method}" + (f", {more}" if more else "")
    path = JOBS / f"{job}.yaml"
    options = {"seed": 3, **options}
    return Case(
        "_".join(filter(None, (job, method, name))),
        lambda _: cell.formed(path, springback, contours, **options),
        job.split("_")[0].upper() if job.endswith("cone") else "DSIF",
        method,
        always,
        factor or {},
    )


def _database(job: str) -> Case:
    path = JOBS / f"{job}.yaml"

    def run(folder: Path) -> dict[str, Series]:
        file, series = cell.database(path, folder)
        return series | cell.formed(path, f"method: elastic, elastic: {{database: {file}}}", seed=3)

    return Case(f"{job}_elastic_database", run, "DSIF", "elastic", factor=LOAD_PATHS)


def _identify(name: str, *, always: bool) -> Case:
    job = JOBS / "dsif_cone.yaml"
    return Case(
        f"identify_{name}",
        lambda folder: cell.identified(job, name, folder, "--repeats", 1, "--seed", 3, "--world", 1),
        always=always,
    )


def _learn(job: str) -> Case:
    path = JOBS / f"{job}.yaml"
    return Case(f"{job}_learn", lambda folder: cell.learned(path, folder, seed=3), always=False)


LIFTS = "lift_every: 2"
SENSOR = f"{SCANS}, scan_sensor: true"
ANALYTIC = "fused: {model: analytic}"
DENSE = "mpc: {coupled: true, solver: piqp, step: per_direction, distribution: dense}"

CASES = [
    *map(_plan, EXAMPLES),
    _form("spif_cone", "none", always=True),
    _form("spif_cone", "analytic", always=True),
    _form("spif_cone", "elastic"),
    _form("spif_cone", "fused", f"{SENSOR}, {LIFTS}, {ANALYTIC}"),
    _form("spif_cone", "mpc_vertical", SCANS),
    _form("spif_cone", "mpc_two_directional", SENSOR),
    _form("dsif_cone", "none", name="position_control", support_force=0.0),
    _form("dsif_cone", "analytic", always=True),
    _form("dsif_cone", "analytic", name="world_5", variant=5, always=True),
    _form("dsif_cone", "analytic", "first_contour: zero, gain: 0.8", name="zero"),
    _form("dsif_cone", "elastic"),
    _form("dsif_cone", "elastic", "elastic: {horizontal: true, forecast: linear, block: 2}", name="horizontal"),
    _database("dsif_cone"),
    _form("dsif_cone", "fused", f"{SENSOR}, {LIFTS}, {ANALYTIC}", always=True, factor=NOISY_SCANS),
    _form("dsif_cone", "fused", f"{LIFTS}, {ANALYTIC}", name="lifts"),
    _form("dsif_cone", "fused", f"{SCANS}, fused: {{model: elastic}}", name="elastic", always=True),
    _form("dsif_cone", "learned", "learning: dsif_cone_learned.npz", always=True),
    _form("dsif_cone", "learned_map", "learning: two_pockets_learned.npz", always=True),
    _form("dsif_cone", "mpc_vertical", SCANS, always=True),
    _form("dsif_cone", "mpc_two_directional", SENSOR, always=True),
    _form("dsif_cone", "mpc_two_directional", f"{SCANS}, {DENSE}", name="coupled"),
    _learn("dsif_cone"),
    _form("tpif_cone", "none"),
    _form("tpif_cone", "analytic"),  # ends at the force limit of the machine
    _form("tpif_cone", "fused", f"{SCANS}, {ANALYTIC}"),
    _form("tpif_cone", "mpc_tpif", SCANS, always=True),
    _form("tpif_cone", "mpc_tpif", f"{SENSOR}, mpc: {{step: per_direction, distribution: dense}}", name="dense"),
    _form("adsif_cone", "none", always=True, contours=12),
    _form("adsif_cone", "none", name="whole"),
    # The second pocket begins as the first did: lifted tools, a sheet that is flat there, nothing measured.
    _form("two_pockets", "none"),
    _form("two_pockets", "analytic"),
    _form("two_pockets", "elastic", "first_contour: zero"),
    _form("two_pockets", "fused", f"{SCANS}, first_contour: zero, {ANALYTIC}", always=True),
    _form("two_pockets", "mpc_vertical", SCANS, always=True),
    _form("two_pockets", "mpc_two_directional", SCANS),
    _form("two_pockets", "learned", "learning: two_pockets_learned.npz", always=True),
    _form("two_pockets", "learned_map", "learning: two_pockets_learned.npz"),
    _form("pocket_and_dome", "analytic", always=True),
    _form("pocket_and_dome", "fused", f"{SENSOR}, {LIFTS}, {ANALYTIC}"),
    _form("island", "analytic"),
    _form("island", "fused", f"{SCANS}, {ANALYTIC}"),
    _form("spiral", "analytic"),
    _form("spiral", "fused", f"{SCANS}, {ANALYTIC}"),
    _form("stages", "analytic"),
    _form("stages", "fused", f"{SCANS}, {ANALYTIC}"),
    _identify("compliance", always=True),
    _identify("stiffness", always=False),
    _identify("servo", always=True),
    _identify("signs", always=False),
]
