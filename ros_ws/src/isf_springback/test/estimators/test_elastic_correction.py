"""Method "elastic": databases, the loop of one part, stages, no database, blocks, bad input; never a jump."""

from dataclasses import replace

import numpy as np
import pytest
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile
from isf_springback import make_corrector
from isf_springback.database.database import Database, DatabaseLevel
from isf_springback.database.elastic_samples import depth_task, load_levels, solve_depth
from isf_springback.database.load_displacement import cubic_law
from isf_springback.estimators.elastic import ElasticModel
from isf_springback.estimators.horizontal_springback import outward
from isf_springback.loop_path import PUSH_SLOPE, LoopPath
from isf_springback.shell.formed_sheet import FacetSize
from springback_parts import JOB_TEXT, cone_contour, corrector_of, result_of

LOADS = np.array([200.0, 400.0, 600.0])


def job(tmp_path, elastic="{}", gain=1.0):
    (tmp_path / "cone.stl").write_text("solid")
    text = JOB_TEXT.replace("method: analytic, gain: 1.0", f"method: elastic, gain: {gain}, elastic: {elastic}")
    return JobFile(text, tmp_path)


@pytest.fixture(autouse=True)
def own_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("ISF_CACHE_DIR", str(tmp_path / "cache"))


def cone_database(compliance=(10e-6,), every=2, count=42, points=1):
    """Linear laws: ``compliance`` m/N at evenly spread points of every second contour."""
    levels = []
    for index in range(every - 1, count, every):
        contour = cone_contour(index)
        place = np.arange(points) * (len(contour) // points)
        slope = np.resize(compliance, points)
        displacement = slope[:, None] * LOADS
        levels.append(
            DatabaseLevel(index, 0, contour.contact[0, 2], contour.contact[place], np.ones(points, bool), displacement)
        )
    return Database("cone", LOADS, tuple(levels), len(levels))


def form(method, forces, first=0):
    """Correct contour after contour, each answered by an axial force."""
    made = []
    for index, force in enumerate(forces, start=first):
        contour = cone_contour(index)
        made.append(method.correct(contour))
        method.add_result(contour, result_of(contour, force))
    return made


def test_steady_force_gives_the_law(tmp_path):
    method = corrector_of(ElasticModel, job(tmp_path), cone_database())
    made = form(method, [300.0] * 12)
    assert (made[0].offset == 0).all()  # published: the first contour has no history
    last = made[-1]
    assert last.springback == pytest.approx(3e-3, rel=1e-6)
    assert last.offset[:, 2] == pytest.approx(-3e-3, rel=1e-6)
    assert last.method == "elastic"
    assert last.code == 0
    assert last.control_point_force == pytest.approx(300.0)
    assert last.residual == pytest.approx(0.0, abs=1e-9)
    # before a tool lift: 20 % by what is common to the part, 7 % by region, 0.3 mm that no law knows of, and 30 N of
    # force at 10 um/N
    known = np.array([0.20 * 3e-3, 0.07 * 3e-3, 0.3e-3, 30.0 * 10e-6])
    assert last.uncertainty == pytest.approx(np.sqrt((known**2).sum()), rel=1e-6)


def test_changes_stay_within_the_limits_and_what_remains_is_reported(tmp_path):
    method = corrector_of(ElasticModel, job(tmp_path), cone_database())
    made = form(method, [500.0] * 8)
    steps = np.diff([correction.offset[:, 2].mean() for correction in made])
    assert (steps > -1.0e-3 - 1e-9).all()  # two incremental depths
    second = made[1]
    assert second.saturated.all()
    assert second.residual == pytest.approx(second.springback + second.offset[:, 2])
    assert (second.residual > 3e-3).all()


def test_springback_is_interpolated_along_the_loop(tmp_path):
    """Two control points of different compliance: both values met, slope within 50 um/mm."""
    method = corrector_of(ElasticModel, job(tmp_path), cone_database((6e-6, 8e-6), points=2))
    correction = form(method, [300.0] * 12)[-1]
    value = -correction.offset[:, 2]
    assert value.min() == pytest.approx(1.8e-3, abs=0.1e-3)
    assert value.max() == pytest.approx(2.4e-3, abs=0.1e-3)
    contour = cone_contour(11)
    step = np.diff(LoopPath.of(contour).position)
    assert (np.abs(np.diff(value)) <= PUSH_SLOPE * step + 1e-9).all()
    assert correction.control_point.shape == (2, 3)


def test_levels_are_blended_between_control_loops(tmp_path):
    database = cone_database(every=4)
    stiff = DatabaseLevel(11, 0, -6e-3, cone_contour(11).contact[:1], np.ones(1, bool), 5e-6 * LOADS[None])
    mixed = Database("cone", LOADS, (*database.levels[:2], stiff, *database.levels[3:]), 1)
    method = corrector_of(ElasticModel, job(tmp_path), mixed)
    made = form(method, [300.0] * 12)
    assert [made[k].springback.mean() for k in (7, 9, 11)] == pytest.approx([3e-3, 2.25e-3, 1.5e-3], rel=1e-6)


def in_two_stages(before, after):
    """Contours of two stages of one cone, ``before`` and ``after`` of them; the tools are lifted in between."""
    first = [cone_contour(index) for index in range(before)]
    again = [replace(cone_contour(index), index=before + index, stage=1, retract=index == 0) for index in range(after)]
    return [*first, *again]


def springback_of(method, contours, force=300.0):
    """Mean springback of every contour, m, each answered by the same axial force."""
    found = []
    for contour in contours:
        found.append(method.correct(contour).springback.mean())
        method.add_result(contour, result_of(contour, force))
    return found


def test_a_further_stage_goes_by_its_own_levels(tmp_path):
    """Before its first level by that one, not by a mean with the level at the end of the stage before."""
    levels = [
        DatabaseLevel(
            contour.index, 0, contour.contact[0, 2], contour.contact[:1], np.ones(1, bool), slope * LOADS[None]
        )
        for contour, slope in ((cone_contour(3), 10e-6), (cone_contour(5), 10e-6))
    ]
    again = cone_contour(3)
    levels.append(DatabaseLevel(9, 0, -2e-3, again.contact[:1], np.ones(1, bool), 5e-6 * LOADS[None], stage=1))
    method = corrector_of(ElasticModel, job(tmp_path), Database("cone", LOADS, tuple(levels), 3))
    found = springback_of(method, in_two_stages(6, 6))
    assert found[1:6] == pytest.approx([3e-3] * 5, rel=1e-6)
    assert found[7:] == pytest.approx([1.5e-3] * 5, rel=1e-6)


def test_where_a_database_lacks_the_stage_it_is_computed_while_forming(tmp_path):
    method = corrector_of(ElasticModel, job(tmp_path), cone_database(count=4))
    contours = in_two_stages(4, 2)
    springback_of(method, contours[:4])
    for contour in contours[4:]:
        correction = method.correct(contour)
        method.add_result(contour, result_of(contour, 300.0))
        assert correction.code == 0
        assert any("lacks this stage; computed while forming" in remark for remark in correction.remarks)
    assert correction.springback.min() > 0.1e-3


def test_a_further_stage_computes_its_own_law_where_the_one_before_has_just_been(tmp_path):
    """The law of the stage before is one of a flatter sheet, less than a loop increment away."""
    job_file = job(tmp_path)
    contours = in_two_stages(2, 2)
    found = springback_of(corrector_of(ElasticModel, job_file), contours)
    loads = load_levels(1000.0, 4)
    task = depth_task(contours[:3], contours[2].contact[:1], job_file, size=FacetSize.coarse(), loads=loads)
    own = cubic_law(loads, solve_depth(task)).displacement(np.array([300.0]))[0]
    assert found[3] == pytest.approx(own, rel=1e-6)
    assert found[1] > 1.015 * own


def across_of(method, contours, across):
    """Mean outward offset of every contour, m; the sheet pushes the tool inwards with ``across`` N of its wall."""
    found = []
    for contour in contours:
        offset = method.correct(contour).offset[:, :2]
        found.append(float((offset * outward(contour)).sum(axis=1).mean()))
        result = result_of(contour, 300.0)
        inwards = np.column_stack([outward(contour), np.zeros(len(contour))])
        pushed = result.forming_force - across[contour.feature] * inwards
        method.add_result(contour, replace(result, forming_force=pushed))
    return found


def test_pockets_in_turn_are_corrected_across_the_wall_by_their_own_force(tmp_path):
    contours = []
    for index in range(16):
        contour = cone_contour(index // 2, opening=25e-3)
        aside = np.array([90e-3 * (index % 2) - 45e-3, 0.0, 0.0])
        moved = {name: getattr(contour, name) + aside for name in ("contact", "forming_tip", "support_tip")}
        contours.append(replace(contour, index=index, feature=index % 2, retract=index > 0, **moved))
    method = corrector_of(ElasticModel, job(tmp_path, "{horizontal: true, loop_increment: 3 mm}"))
    found = across_of(method, contours, (130.0, 0.0))
    assert found[14] > 0.01e-3
    assert found[1::2] == pytest.approx([0.0] * 8, abs=1e-9)


def test_control_point_takes_the_mean_force_of_its_stretch(tmp_path):
    method = corrector_of(ElasticModel, job(tmp_path), cone_database())
    contour = cone_contour(0)
    wave = 300.0 + 100.0 * np.sin(np.arctan2(contour.contact[:, 1], contour.contact[:, 0]))
    method.correct(contour)
    method.add_result(contour, result_of(contour, wave))
    assert method.correct(cone_contour(1)).control_point_force == pytest.approx(300.0, abs=1.0)


def test_forecasts_differ_as_published(tmp_path):
    force = {}
    for law in ("hold", "half_step", "linear"):
        method = corrector_of(ElasticModel, job(tmp_path, f"{{forecast: {law}}}"), cone_database())
        form(method, [300.0, 340.0])
        force[law] = method.correct(cone_contour(2)).control_point_force[0]
    assert force == pytest.approx({"hold": 340.0, "half_step": 360.0, "linear": 380.0}, rel=1e-6)


def test_blocks_hold_the_mean_force_of_the_block_before(tmp_path):
    method = corrector_of(ElasticModel, job(tmp_path, "{block: 3, forecast: half_step}"), cone_database())
    made = form(method, [300.0, 310.0, 320.0, 400.0, 410.0, 420.0, 0.0, 0.0])
    forces = [correction.control_point_force[0] for correction in made]
    assert forces == pytest.approx([0, 0, 0, 310, 310, 310, 460, 460], rel=1e-6)
    assert all(correction.code == 0 for correction in made)


def predicted(index, force=500.0):
    contour = cone_contour(index)
    return replace(contour, predicted_force=np.full(len(contour), force))


@pytest.mark.parametrize(("first", "force"), [("predicted", 500.0), ("zero", 0.0)])
def test_the_first_block_goes_by_the_predicted_force_unless_told_otherwise(tmp_path, first, force):
    job_file = job(tmp_path, "{block: 3}").changed({"springback": {"first_contour": first}})
    method = corrector_of(ElasticModel, job_file, cone_database())
    forces = []
    for contour in (predicted(index) for index in range(5)):
        forces.append(method.correct(contour).control_point_force[0])
        method.add_result(contour, result_of(contour, 300.0))
    assert forces == pytest.approx([force, force, force, 300.0, 300.0], rel=1e-6)


def test_a_plan_taken_up_in_the_middle_lacks_the_force_of_a_block_too(tmp_path):
    method = corrector_of(ElasticModel, job(tmp_path, "{block: 3}"), cone_database())
    correction = method.correct(cone_contour(20))
    assert correction.code == ErrorCode.NO_FORCE_HISTORY
    assert not correction.offset.any()


def test_force_beyond_the_samples_is_reported(tmp_path):
    method = corrector_of(ElasticModel, job(tmp_path), cone_database())
    made = form(method, [900.0, 900.0])
    assert not made[0].remarks
    assert "beyond the computed loads" in made[1].remarks[0]


def test_without_database_it_computes_while_forming(tmp_path):
    """One point on a cone, anew only a millimetre deeper, in bounded time; near the fine model of the database."""
    method = corrector_of(ElasticModel, job(tmp_path))
    made = form(method, [200.0] * 4)
    assert [correction.code for correction in made] == [0] * 4
    assert 1e-3 < made[-1].springback.mean() < 4e-3
    assert len(method.estimator._levels) == 2
    assert made[-1].control_point.shape == (1, 3)


def test_database_of_another_plan_is_not_used(tmp_path):
    shifted = tuple(
        DatabaseLevel(level.index, 0, level.depth, level.points + [4e-3, 0, 0], level.central, level.displacement)
        for level in cone_database().levels
    )
    method = corrector_of(ElasticModel, job(tmp_path), Database("cone", LOADS, shifted, 1))
    made = form(method, [200.0, 200.0, 200.0])
    assert any("another plan" in remark for remark in made[1].remarks)
    assert made[2].springback.mean() > 1e-3
    assert made[2].code == 0


def test_named_database_that_is_missing_keeps_the_contour(tmp_path):
    method = make_corrector("elastic", job(tmp_path, "{database: none.json}"))
    for correction in form(method, [200.0, 200.0]):
        assert correction.code == ErrorCode.FILE_NOT_FOUND
        assert (correction.offset == 0).all()


@pytest.mark.parametrize("fault", ["missing", "nan", "incomplete", "order"])
def test_bad_forces_keep_the_last_good_correction(tmp_path, fault):
    method = corrector_of(ElasticModel, job(tmp_path), cone_database())
    good = form(method, [300.0] * 10)[-1]
    contour = cone_contour(10)
    method.correct(contour)
    if fault == "nan":
        method.add_result(contour, result_of(contour, np.nan))
    elif fault == "incomplete":
        method.add_result(contour, result_of(contour, 300.0, completed=False))
    elif fault == "order":
        method.add_result(cone_contour(3), result_of(cone_contour(3), 300.0))
    correction = method.correct(cone_contour(11))
    code = {"nan": ErrorCode.CORRECTION_FAILED, "order": ErrorCode.CONTOUR_OUT_OF_ORDER}
    assert correction.code == code.get(fault, ErrorCode.NO_FORCE_HISTORY)
    assert correction.offset[:, 2].mean() == pytest.approx(good.offset[:, 2].mean(), abs=1e-6)


def test_sheet_that_cannot_be_meshed_has_a_code(tmp_path):
    method = corrector_of(ElasticModel, job(tmp_path))
    wide = [cone_contour(k, opening=0.2) for k in range(2)]
    method.correct(wide[0])
    method.add_result(wide[0], result_of(wide[0], 200.0))
    correction = method.correct(wide[1])
    assert correction.code == ErrorCode.SHEET_MESH_FAILED
    assert (correction.offset == 0).all()


def test_new_part_starts_anew(tmp_path):
    method = corrector_of(ElasticModel, job(tmp_path), cone_database())
    form(method, [300.0] * 5)
    fresh = method.correct(cone_contour(0, plan_id="next"))
    assert (fresh.offset == 0).all()
    assert fresh.code == 0


def test_malformed_contour_is_refused(tmp_path):
    method = corrector_of(ElasticModel, job(tmp_path), cone_database())
    broken = cone_contour(0)
    broken.contact[3] = np.nan
    with pytest.raises(IsfError) as failure:
        method.correct(broken)
    assert failure.value.code == ErrorCode.CONTOUR_REJECTED


def test_correction_with_database_is_fast(tmp_path):
    """Below 0.2 s a contour (Ren 2018, 4.3.1); CPU time of the best of several, 16 control points, 3000 path points."""
    import time

    database = cone_database(tuple(np.linspace(6e-6, 8e-6, 16)), points=16)
    method = corrector_of(ElasticModel, job(tmp_path), database)
    times = []
    for index in range(6):
        contour = cone_contour(index)
        started = time.process_time()
        method.correct(contour)
        times.append(time.process_time() - started)
        method.add_result(contour, result_of(contour, 300.0))
    assert min(times) < 0.1
