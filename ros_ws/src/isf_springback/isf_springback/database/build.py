"""Computes the load-displacement database of a plan: depths in parallel, resumable, cancellable, here or on a cluster.

The same tasks go through the same function whether they run in this process, in worker processes or on a
``dask.distributed`` scheduler; only the executor differs.
"""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, Future, ProcessPoolExecutor, wait
from concurrent.futures import TimeoutError as WaitTimeoutError
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from isf_core.contour import Contour, over_floor
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.bounded import read_json
from isf_core.files.job import JobFile
from isf_core.types import Array

from isf_springback.database.control_points import ControlLoop, ControlPointOptions, control_points
from isf_springback.database.database import Database, cache_folder, make_database, write_json
from isf_springback.database.elastic_samples import DepthTask, depth_task, solve_depth
from isf_springback.loop_path import forming_radii
from isf_springback.sheet_edge import holding_size

Progress = Callable[[int, int], None]
"""Called with the depths done and all depths."""

_POLL = 0.2
"""s, how often a cancel is looked for."""

_ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}


def control_loops_of(contours: Sequence[Contour], job_file: JobFile) -> list[ControlLoop]:
    """Control points of a plan as the job wants them."""
    options = ControlPointOptions(loop_increment=job_file.job.springback.elastic.loop_increment)
    return control_points(contours, forming_radii(job_file), holding_size(job_file), options)


def database_tasks(contours: Sequence[Contour], loops: Sequence[ControlLoop], job_file: JobFile) -> list[DepthTask]:
    """One task per control loop.

    Raises
    ------
    IsfError : SHEET_MESH_FAILED
    """
    position = {contour.index: k for k, contour in enumerate(contours)}
    engine = job_file.job.springback.elastic.engine
    return [
        depth_task(contours[: position[loop.index] + 1], loop.points[loop.computed], job_file, engine=engine)
        for loop in loops
    ]


def build_database(
    contours: Sequence[Contour],
    job_file: JobFile,
    *,
    workers: int | None = None,
    scheduler: str | None = None,
    cache: Path | None = None,
    progress: Progress | None = None,
    cancelled: Callable[[], bool] | None = None,
) -> Database:
    """Database of all ``contours`` of a plan.

    Parameters
    ----------
    workers : processes; None: one per processor, 0: in this process
    scheduler : address of a dask.distributed scheduler, used in place of own processes
    cache : folder of the depths computed before; None: the user's cache folder

    Raises
    ------
    IsfError : SHEET_MESH_FAILED, SHELL_NOT_SOLVED; CANCELLED, what was computed is kept in the cache;
        FILE_NOT_WRITABLE; SERVICE_TIMEOUT, no scheduler answers
    """
    folder = (cache or cache_folder()) / "depths"
    contours = [contour for k, contour in enumerate(contours) if k == 0 or not over_floor(contour, contours[k - 1])]
    loops = control_loops_of(contours, job_file)
    tasks = database_tasks(contours, loops, job_file)
    samples: list[Array | None] = [_cached(folder, task) for task in tasks]
    missing = [k for k, rows in enumerate(samples) if rows is None]
    done = len(tasks) - len(missing)
    if progress:
        progress(done, len(tasks))
    if missing:
        with _executor(workers, scheduler, len(missing)) as executor:
            # deep sheets take longest: they go first, so that no worker is left with one at the end
            for k, rows in _results(executor, [(k, tasks[k]) for k in reversed(missing)], cancelled):
                samples[k] = rows
                _keep(folder, tasks[k], rows)
                done += 1
                if progress:
                    progress(done, len(tasks))
    complete = [rows for rows in samples if rows is not None]
    return make_database(job_file.job.name, tasks[0].loads, contours, loops, complete)


def _results(
    executor: Executor | None, tasks: list[tuple[int, DepthTask]], cancelled: Callable[[], bool] | None
) -> Iterator[tuple[int, Array]]:
    if executor is None:
        for k, task in tasks:
            _stop_if(cancelled)
            yield k, solve_depth(task)
        return
    waiting: dict[Future[Array], int] = {executor.submit(solve_depth, task): k for k, task in tasks}
    try:
        while waiting:
            _stop_if(cancelled)
            for future in _finished(list(waiting)):
                yield waiting.pop(future), np.asarray(future.result())
    finally:
        for future in waiting:
            future.cancel()


def _finished(futures: list[Future[Array]]) -> list[Future[Array]]:
    try:
        done = wait(futures, timeout=_POLL, return_when="FIRST_COMPLETED").done
    except WaitTimeoutError:
        return []
    return list(done)


def _stop_if(cancelled: Callable[[], bool] | None) -> None:
    if cancelled and cancelled():
        raise IsfError(
            ErrorCode.CANCELLED,
            "the springback database was cancelled",
            where="isf springback database",
            advice="the same command goes on from here",
        )


@contextmanager
def _executor(workers: int | None, scheduler: str | None, tasks: int) -> Iterator[Executor | None]:
    if scheduler is not None:
        yield from _on_cluster(scheduler)
        return
    count = min(workers if workers is not None else (os.cpu_count() or 1), tasks)
    if count <= 1 and workers is not None:
        yield None
        return
    before = {name: os.environ.get(name) for name in _ONE_THREAD}
    os.environ.update(_ONE_THREAD)  # the workers read it when they load numpy
    pool = ProcessPoolExecutor(count, mp_context=multiprocessing.get_context("spawn"))
    try:
        yield pool
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


def _on_cluster(scheduler: str) -> Iterator[Executor]:
    try:
        from distributed import Client
    except ImportError as error:
        raise IsfError(
            ErrorCode.FILE_NOT_FOUND,
            "dask.distributed is not installed",
            where="--scheduler",
            advice="install it with: pip install distributed; or leave --scheduler out",
        ) from error
    try:
        client = Client(scheduler, timeout=10)
    except (OSError, ValueError) as error:
        raise IsfError(
            ErrorCode.SERVICE_TIMEOUT,
            f"no dask scheduler answers: {error}",
            where=scheduler,
            advice="start one with: dask scheduler; and workers with: dask worker ADDRESS",
        ) from error
    try:
        yield client.get_executor(pure=False)
    finally:
        client.close()


def _cached(folder: Path, task: DepthTask) -> Array | None:
    path = folder / f"{task.digest()}.json"
    if not path.is_file():
        return None
    try:
        rows = np.array(read_json(path)["displacement_m"], dtype=np.float64)
    except (ValueError, KeyError, TypeError, OSError):
        return None  # computed again and written over
    fits = rows.shape == (len(task.points), len(task.loads)) and bool(np.isfinite(rows).all())
    return rows if fits else None


def _keep(folder: Path, task: DepthTask, rows: Array) -> None:
    write_json(folder / f"{task.digest()}.json", {"contour": task.index, "displacement_m": rows.tolist()})
