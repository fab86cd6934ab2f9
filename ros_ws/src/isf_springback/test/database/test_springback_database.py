"""Database of a part: built, resumed, cancelled, stored, found again; damaged files; a local cluster."""

import json
from dataclasses import replace

import numpy as np
import pytest
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile
from isf_springback.database import build
from isf_springback.database.build import build_database, database_tasks
from isf_springback.database.database import Database, cached_path, database_of
from isf_springback.database.elastic_samples import edge_condition, solve_depth
from loop_parts import pyramid_loops
from springback_parts import JOB_TEXT, cone_contour


def job(tmp_path, elastic="{}"):
    (tmp_path / "cone.stl").write_text("solid")
    text = JOB_TEXT.replace("method: analytic", f"method: elastic, elastic: {elastic}")
    return JobFile(text, tmp_path)


@pytest.fixture
def quick(monkeypatch):
    """Samples that only depend on the place, where the shell itself is not the subject."""

    def rows(task):
        return (1e-5 + 1e-4 * np.linalg.norm(task.points, axis=1))[:, None] * task.loads**0.6

    monkeypatch.setattr(build, "solve_depth", rows)


@pytest.fixture
def cone():
    return [cone_contour(k) for k in range(6)]


def test_database_holds_what_the_shell_computes(tmp_path, cone):
    job_file = job(tmp_path)
    seen = []
    made = build_database(
        cone, job_file, workers=0, cache=tmp_path, progress=lambda done, all_: seen.append((done, all_))
    )
    assert [level.index for level in made.levels] == [1, 3, 5]
    assert seen == [(0, 3), (1, 3), (2, 3), (3, 3)]
    loops = build.control_loops_of(cone, job_file)
    last = database_tasks(cone, loops, job_file)[-1]
    assert made.levels[-1].displacement == pytest.approx(solve_depth(last))
    assert made.loads[-1] == 1000.0
    # the power law of Ren 2018 eq. 4-7: exponents between a membrane (1/3) and a linear plate
    power = [level.power(made.loads) for level in made.levels]
    assert all(0.34 < law.b[0] < 1.0 and law.r_squared[0] > 0.99 for law in power)


def test_images_under_symmetry_share_one_computation(tmp_path, quick):
    contours = pyramid_loops(corner=40e-3, depth=1e-3)
    made = build_database(contours, job(tmp_path), workers=0, cache=tmp_path)
    level = made.levels[0]
    assert len(level.points) == 16
    assert made.computed == 3
    assert len(np.unique(level.displacement[:, -1])) == 3


def test_the_tools_of_both_sides_have_their_own_radius(tmp_path):
    """Where a corner begins is seen through the window of the tool that forms it."""
    loop = pyramid_loops(corner=12e-3, depth=1e-3)[-1]
    text = JOB_TEXT.replace("tool_1: {radius: 5 mm}", "tool_1: {radius: 12 mm}")
    job_file = JobFile(text, tmp_path)
    below = replace(loop, index=1, feature=1, forming_tool=2)
    upper, lower = build.control_loops_of([replace(loop, index=0), below], job_file)
    (alone,) = build.control_loops_of([replace(below, index=0)], job_file)
    assert np.array_equal(lower.points, alone.points)
    assert np.abs(upper.points - lower.points).max() > 0.4e-3


def test_cancelled_build_goes_on_where_it_was(tmp_path, cone, monkeypatch, quick):
    job_file = job(tmp_path)
    done = []

    def stop():
        return len(done) >= 2

    with pytest.raises(IsfError) as failure:
        build_database(cone, job_file, workers=0, cache=tmp_path, progress=lambda n, _: done.append(n), cancelled=stop)
    assert failure.value.code == ErrorCode.CANCELLED
    computed, rows = [], build.solve_depth
    monkeypatch.setattr(build, "solve_depth", lambda task: computed.append(task.index) or rows(task))
    whole = build_database(cone, job_file, workers=0, cache=tmp_path)
    assert len(computed) == 2  # one of the three depths was kept
    assert len(whole.levels) == 3
    build_database(cone, job_file, workers=0, cache=tmp_path)
    assert len(computed) == 2


def test_damaged_cache_is_computed_again(tmp_path, cone, quick):
    job_file = job(tmp_path)
    first = build_database(cone[:2], job_file, workers=0, cache=tmp_path)
    for path in (tmp_path / "depths").glob("*.json"):
        path.write_text('{"displacement_m": [[1, 2')
    again = build_database(cone[:2], job_file, workers=0, cache=tmp_path)
    assert again.levels[0].displacement == pytest.approx(first.levels[0].displacement)


def test_cache_is_named_by_content(tmp_path, cone):
    loops = build.control_loops_of(cone, job(tmp_path))
    base = database_tasks(cone, loops, job(tmp_path))
    same = database_tasks([cone_contour(k, plan_id="other") for k in range(6)], loops, job(tmp_path))
    stiffer = database_tasks(cone, loops, job(tmp_path, "{edge_stiffness: 100 MPa}"))
    assert [task.digest() for task in base] == [task.digest() for task in same]
    assert not {task.digest() for task in base} & {task.digest() for task in stiffer}
    assert len({task.digest() for task in base}) == 3


def test_the_edge_is_that_of_the_rig_unless_the_job_has_one(tmp_path):
    assert edge_condition(job(tmp_path)).in_plane == 0.0
    (tmp_path / "own.yaml").write_text(
        "based_on: ren2018\nclamp: {edge_spring: 45 N/mm/mm}\nprovenance: {clamp.edge_spring: 'assumed: test'}\n"
    )
    own = JobFile(JOB_TEXT.replace("rig: ren2018", "rig: own.yaml"), tmp_path)
    assert edge_condition(own).in_plane == pytest.approx(45e6)
    text = JOB_TEXT.replace("rig: ren2018", "rig: own.yaml")
    text = text.replace("method: analytic", "method: elastic, elastic: {edge_stiffness: 100 MPa}")
    assert edge_condition(JobFile(text, tmp_path)).in_plane == pytest.approx(100e6)


def test_stored_and_found_again(tmp_path, cone, monkeypatch, quick):
    monkeypatch.setenv("ISF_CACHE_DIR", str(tmp_path / "cache"))
    job_file = job(tmp_path)
    assert database_of(job_file) is None
    made = build_database(cone[:2], job_file, workers=0)
    made.save(cached_path(job_file))
    found = database_of(job_file)
    assert found is not None
    assert found.levels[0].displacement == pytest.approx(made.levels[0].displacement, abs=1e-9)
    made.save(tmp_path / "db.json")
    named = database_of(job(tmp_path, "{database: db.json}"))
    assert named is not None
    assert named.computed == made.computed
    stored = json.loads((tmp_path / "db.json").read_text())["levels"][0]["power_law"]
    assert stored["r2"][0] > 0.99
    (tmp_path / "cone.stl").write_text("another solid")
    assert database_of(job_file) is None


def test_levels_know_their_stage(tmp_path, cone, quick):
    again = [replace(contour, index=4 + contour.index, stage=1) for contour in cone[:4]]
    path = tmp_path / "db.json"
    build_database([*cone[:4], *again], job(tmp_path), workers=0, cache=tmp_path).save(path)
    assert [(level.index, level.stage) for level in Database.load(path).levels] == [(1, 0), (3, 0), (5, 1), (7, 1)]


def test_a_database_is_of_what_the_accuracy_surfaces_say(tmp_path):
    """They move the path: other ones under the same name are another part."""
    text = JOB_TEXT.replace("unit: mm}", "unit: mm, accuracy_surfaces: surfaces.npz}")
    paths = []
    for content in (b"first", b"second"):
        (tmp_path / "surfaces.npz").write_bytes(content)
        paths.append(cached_path(JobFile(text, tmp_path)))
    assert paths[0] != paths[1]


@pytest.mark.parametrize("more", ["", "stages: [30 deg], ", "morph: {}, ", "finishing_passes: 1, "])
def test_a_database_of_a_part_in_stages_is_of_what_they_begin_with(tmp_path, monkeypatch, more):
    """One that was computed as if they began in a flat sheet is not found; others keep their names."""
    (tmp_path / "cone.stl").write_text("solid")
    job_file = JobFile(JOB_TEXT.replace("path: {", "path: {" + more), tmp_path)
    name = cached_path(job_file)
    monkeypatch.setattr("isf_springback.database.database.STAGES", "in a flat sheet")
    assert (cached_path(job_file) == name) is (more == "")


@pytest.mark.parametrize(
    "damage",
    [
        lambda data: "{",
        lambda data: json.dumps({}),
        lambda data: json.dumps(data | {"engine": -1}),
        lambda data: json.dumps(data | {"levels": []}),
        lambda data: json.dumps(data | {"loads_N": [1.0]}),
        lambda data: json.dumps(data | {"levels": [data["levels"][0] | {"displacement_m": [[6, 5, 4, 3, 2, 1]]}]}),
        lambda data: json.dumps(data | {"levels": [data["levels"][0] | {"points_m": [[float("nan"), 0, 0]]}]}),
    ],
)
def test_damaged_database_has_a_code(tmp_path, cone, damage, quick):
    path = tmp_path / "db.json"
    build_database(cone[:2], job(tmp_path), workers=0, cache=tmp_path).save(path)
    path.write_text(damage(json.loads(path.read_text())))
    with pytest.raises(IsfError) as failure:
        Database.load(path)
    assert failure.value.code == ErrorCode.DATABASE_UNUSABLE
    assert "isf springback database" in failure.value.message


def test_database_that_is_not_there_or_cannot_be_written(tmp_path, cone, quick):
    with pytest.raises(IsfError) as failure:
        Database.load(tmp_path / "none.json")
    assert failure.value.code == ErrorCode.FILE_NOT_FOUND
    blocked = tmp_path / "file"
    blocked.write_text("")
    with pytest.raises(IsfError) as failure:
        build_database(cone[:2], job(tmp_path), workers=0, cache=tmp_path).save(blocked / "db.json")
    assert failure.value.code == ErrorCode.FILE_NOT_WRITABLE


def test_contours_outside_the_clamp_are_refused(tmp_path):
    with pytest.raises(IsfError) as failure:
        build_database([cone_contour(k, opening=0.2) for k in range(3)], job(tmp_path), workers=0, cache=tmp_path)
    assert failure.value.code == ErrorCode.SHEET_MESH_FAILED


@pytest.mark.slow
def test_processes_and_cluster_give_the_same(tmp_path, cone):
    distributed = pytest.importorskip("distributed")
    job_file, cone = job(tmp_path), cone[:4]
    here = build_database(cone, job_file, workers=0, cache=tmp_path / "a")
    processes = build_database(cone, job_file, workers=2, cache=tmp_path / "b")
    with distributed.LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=None) as cluster:
        remote = build_database(cone, job_file, scheduler=cluster.scheduler_address, cache=tmp_path / "c")
    for other in (processes, remote):
        for level, expected in zip(other.levels, here.levels, strict=True):
            assert level.displacement == pytest.approx(expected.displacement, abs=1e-9)


@pytest.mark.slow
def test_scheduler_that_does_not_answer(tmp_path, cone):
    pytest.importorskip("distributed")
    with pytest.raises(IsfError) as failure:
        build_database(cone, job(tmp_path), scheduler="tcp://127.0.0.1:9", cache=tmp_path)
    assert failure.value.code == ErrorCode.SERVICE_TIMEOUT
