"""Time of the model-predictive controllers and of the method "fused" per contour, in CPU time.

    ./isf python benchmarks/mpc.py

The quadratic programs of 360 directions over a horizon of 6 contours; and one contour end to end: processing of a scan
of 63,000 points, sections, programs and limits.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from isf_core.contour import Contour, ContourResult
from isf_planner import plan
from isf_springback.corrector import apply
from isf_springback.estimators.mpc_problem import horizontal_problem, solve
from isf_springback.methods import make_corrector
from springback import Case, job_of

REPEATS = 7
CONTOUR = 20


def least(action: Callable[[], object]) -> float:
    """ms of CPU time, the least of several repeats."""
    times = []
    for _ in range(REPEATS):
        started = time.process_time()
        action()
        times.append(time.process_time() - started)
    return 1e3 * min(times)


def programs() -> list[str]:
    """Rows for 360 directions with few and with many active bounds."""
    rows = []
    generator = np.random.default_rng(0)
    for name, size in (("few bounds active", 0.2e-3), ("most bounds active", 2e-3)):
        problem = horizontal_problem(generator.normal(0.0, size, (360, 6)), 0.7, 0.5e-3)
        rows.append(f"| 360 directions, horizon 6, {name} | {least(lambda p=problem: solve(p)):.1f} |")  # type: ignore[misc]
    return rows


def end_to_end() -> list[str]:
    """Rows for one contour of the demonstration cone, scan included."""
    rows = []
    planned = plan(job_of(Case("ren_cone", "none", 0))[0])
    grid = planned.target
    for name in ("mpc_vertical", "mpc_two_directional", "mpc_tpif", "fused(analytic)"):
        job, method = job_of(Case("ren_cone", name, 0))
        corrector = make_corrector(method, job)
        assert corrector.uses_scans
        corrector.set_target(grid)
        for contour in planned.contours[:CONTOUR]:
            corrected = apply(contour, corrector.correct(contour))
            corrector.add_result(corrected, _result(corrected))
        level = float(planned.contours[CONTOUR - 1].forming_tip[:, 2].min())
        points = grid.points()
        points[:, 2] = np.maximum(points[:, 2], level) * 0.95
        looked = least(lambda c=corrector, p=points: c.add_scan(p, CONTOUR - 1))  # type: ignore[misc]
        corrected_in = least(lambda c=corrector: c.correct(planned.contours[CONTOUR]))  # type: ignore[misc]
        rows.append(f"| {name}: scan, then correction of one contour | {looked:.0f} + {corrected_in:.0f} |")
    return rows


def _result(contour: Contour) -> ContourResult:
    """A contour formed with 600 N."""
    n = len(contour)
    force = np.zeros((n, 3))
    force[:, 2] = 600.0
    none = np.empty(0)
    return ContourResult(
        contour.plan_id,
        contour.index,
        0.0,
        1.0,
        True,
        force,
        np.zeros((n, 3)),
        contour.forming_tip,
        contour.support_tip,
        np.zeros(n),
        np.zeros((n, 3)),
        none,
        none,
        none,
        np.empty(0, dtype=bool),
    )


def main() -> None:
    """Print the table."""
    print("| step | CPU time [ms] |\n|---|---|")
    for row in (*programs(), *end_to_end()):
        print(row, flush=True)


if __name__ == "__main__":
    main()
