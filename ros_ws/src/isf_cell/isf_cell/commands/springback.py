"""``isf springback predict``, ``control-points``, ``database`` and ``calibrate``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from isf_core.contour import Contour, contour_label
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile, load_job
from isf_planner import plan
from isf_springback.database.build import build_database, control_loops_of
from isf_springback.database.control_points import ControlLoop
from isf_springback.database.database import cached_path
from isf_springback.database.elastic_samples import depth_task, edge_condition, load_levels, solve_depth
from isf_springback.shell.edge_calibration import EdgeCalibration, PushCurve, calibrate_edge, read_push_curve
from rich.progress import Progress

from isf_cell.commands import terminal
from isf_cell.commands.run_folder import make_run_folder
from isf_cell.commands.springback_figures import draw_control_points
from isf_cell.run.flat_push import push_flat_sheet

_DIRECTIONS = {"x": np.array([1.0, 0.0, 0.0]), "y": np.array([0.0, 1.0, 0.0])}


def predict_part(job: Path, forces: list[float], depth_mm: float | None, direction: str, *, as_json: bool) -> None:
    """Table of deflections at one depth; raises IsfError as planner and shell do."""
    if direction not in (*_DIRECTIONS, "push"):
        raise IsfError(ErrorCode.FILE_FIELD, f"'{direction}' is not push, x or y", where="--direction")
    loads = np.unique(np.asarray(forces, dtype=np.float64)) if forces else load_levels(600.0, 3)
    if not (np.isfinite(loads).all() and loads[0] > 0):
        raise IsfError(ErrorCode.FILE_FIELD, "loads must be above zero", where="--force")
    job_file, contours = _planned(job)
    loops = control_loops_of(contours, job_file)
    loop = _loop_at(loops, depth_mm)
    upto = [contour for contour in contours if contour.index <= loop.index]
    # the path to small loads is short: more levels would not change the result
    task = depth_task(
        upto,
        loop.points[loop.computed],
        job_file,
        direction=_DIRECTIONS.get(direction),
        loads=loads,
        engine=job_file.job.springback.elastic.engine,
    )
    deflection = solve_depth(task)
    rows = [
        {
            "point": int(point),
            "x_mm": 1e3 * loop.points[point, 0],
            "y_mm": 1e3 * loop.points[point, 1],
            "kind": "centre" if loop.central[point] else "boundary",
            "deflection_mm": (1e3 * deflection[k]).tolist(),
        }
        for k, point in enumerate(loop.computed)
    ]
    edge = edge_condition(job_file)
    data = {
        "job": job_file.job.name,
        "contour": loop.index,
        "depth_mm": 1e3 * abs(float(loop.points[:, 2].mean())),
        "direction": direction,
        "edge": {"slope": edge.slope, "in_plane_N_per_mm2": None if edge.immovable else 1e-6 * edge.in_plane},
        "loads_N": loads.tolist(),
        "points": rows,
    }
    if as_json:
        terminal.print_json(data)
    title = f"{data['job']}, {contour_label(loop.index)}, depth {1e3 * abs(float(loop.points[:, 2].mean())):.1f} mm"
    heads = ("point", "x [mm]", "y [mm]", *(f"at {load:.0f} N [mm]" for load in loads))
    table = terminal.table_of(f"{title}: deflection along {direction}", *heads)
    for row in rows:
        numbers = [f"{value:.2f}" for value in row["deflection_mm"]]
        table.add_row(row["kind"], f"{row['x_mm']:.1f}", f"{row['y_mm']:.1f}", *numbers)
    terminal.console.print(table)


def show_control_points(job: Path, output: Path | None, *, as_json: bool) -> None:
    """Picture and table of the control points; raises IsfError as the planner does."""
    job_file, contours = _planned(job)
    loops = control_loops_of(contours, job_file)
    folder = make_run_folder(output, f"control-points-{job_file.job.name}")
    picture = draw_control_points(contours, loops, job_file, folder / "control_points.png")
    table = folder / "control_points.csv"
    rows = np.vstack(
        [
            np.column_stack(
                [
                    np.full(len(loop.points), loop.index),
                    1e3 * loop.points,
                    loop.central,
                    np.isin(np.arange(len(loop.points)), loop.computed),
                ]
            )
            for loop in loops
        ]
    )
    np.savetxt(table, rows, fmt="%.6g", delimiter=",", header="contour,x_mm,y_mm,z_mm,centre,computed", comments="")
    data = {
        "job": job_file.job.name,
        "path_points": int(sum(len(contour) for contour in contours)),
        "control_loops": len(loops),
        "stretches": [int(loop.labels.max()) + 1 for loop in loops],
        "control_points": int(sum(len(loop.points) for loop in loops)),
        "computed_points": int(sum(len(loop.computed) for loop in loops)),
        "picture": str(picture),
        "table": str(table),
    }
    if as_json:
        terminal.print_json(data)
    terminal.console.print(
        f"{data['control_points']} control points on {len(loops)} loops stand for {data['path_points']} points of the "
        f"path; {data['computed_points']} are computed, the others are their mirror images"
    )
    terminal.say(f"picture {picture}\ntable   {table}")


def compute_database(
    job: Path, output: Path | None, workers: int | None, scheduler: str | None, *, as_json: bool
) -> None:
    """Build and store the database; raises IsfError as planner, shell and files do."""
    job_file, contours = _planned(job)
    path = output or cached_path(job_file)
    with Progress(console=terminal.console, disable=not terminal.console.is_terminal) as bar:
        task = bar.add_task("springback database", total=None)
        database = build_database(
            contours,
            job_file,
            workers=workers,
            scheduler=scheduler,
            progress=lambda done, total: bar.update(task, completed=done, total=total),
        )
    database.save(path)
    worst = min(float(level.power(database.loads).r_squared.min()) for level in database.levels)
    data = {
        "job": job_file.job.name,
        "database": str(path),
        "levels": len(database.levels),
        "control_points": sum(len(level.points) for level in database.levels),
        "computed_points": database.computed,
        "power_law_r2_min": worst,
    }
    if as_json:
        terminal.print_json(data)
    terminal.console.print(
        f"{data['computed_points']} points computed for {data['control_points']} control points on "
        f"{data['levels']} loops; power law R2 {worst:.4f} or better"
    )
    terminal.say(f"database {path}")


def edge_of(job_file: JobFile, push: PushCurve) -> EdgeCalibration:
    """Edge condition that explains ``push`` with clamp, thickness and material of a job; raises as the shell does."""
    material = job_file.material
    return calibrate_edge(
        push,
        job_file.rig.clamp.size,
        job_file.job.sheet.thickness,
        material.young_modulus,
        material.poisson_ratio,
    )


def calibrate_clamp(
    job: Path, curve: Path | None, place_mm: tuple[float, float], variant: int = 0, seed: int = 0, *, as_json: bool
) -> None:
    """Edge condition from a push; without a ``curve`` the simulated machine is pushed.

    Raises IsfError for curves that say nothing.
    """
    job_file = load_job(job)
    place = (1e-3 * place_mm[0], 1e-3 * place_mm[1])
    if curve is None:
        with terminal.console.status("pushing the flat sheet of the simulated machine"):
            push = push_flat_sheet(job_file, variant, seed, place=place)
    else:
        push = read_push_curve(curve, place)
    found = edge_of(job_file, push)
    spring = 1e-6 * found.edge.in_plane
    lines = [f"edge_slope: {found.edge.slope}"]
    lines += [] if found.edge.immovable else [f"edge_stiffness: {spring:.4g} MPa"]
    data: dict[str, Any] = {
        "job": job_file.job.name,
        "edge_slope": found.edge.slope,
        "edge_stiffness_MPa": None if found.edge.immovable else spring,
        "rms_mm": 1e3 * found.deviation,
        "rms_of_largest": found.misfit,
        "remarks": list(found.remarks),
        "plain_rms_mm": {name: 1e3 * value for name, value in found.plain.items()},
        "force_N": found.force.tolist(),
        "measured_mm": (1e3 * found.measured).tolist(),
        "fitted_mm": (1e3 * found.fitted).tolist(),
    }
    if as_json:
        terminal.print_json(data)
    table = terminal.table_of("edge condition from the push", "condition", "rms difference [mm]")
    for name, value in found.plain.items():
        table.add_row(name, f"{1e3 * value:.3f}")
    name = "immovable" if found.edge.immovable else f"in-plane spring {spring:.3g} N/mm per mm"
    table.add_row(f"[bold]best: {found.edge.slope}, {name}[/bold]", f"[bold]{1e3 * found.deviation:.3f}[/bold]")
    terminal.console.print(table)
    for remark in found.remarks:
        terminal.warn(remark)
    if found.edge.immovable:
        terminal.console.print("in the rig file, section clamp:  edge: fixed")
    terminal.console.print("in the job file, section springback.elastic:  " + ", ".join(lines))


def _planned(job: Path) -> tuple[JobFile, Sequence[Contour]]:
    job_file = load_job(job)
    with terminal.console.status("planning"):
        contours = plan(job_file).contours
    return job_file, contours


def _loop_at(loops: Sequence[ControlLoop], depth_mm: float | None) -> ControlLoop:
    """Control loop nearest to a depth; the last one when none is given."""
    if depth_mm is None:
        return loops[-1]
    return min(loops, key=lambda loop: abs(abs(1e3 * float(loop.points[:, 2].mean())) - abs(depth_mm)))
