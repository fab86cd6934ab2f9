"""Parts replayed from one of their contours on: as they were before it, and with other settings after it.

Against the record, and against parts formed contour by contour with force control and springback themselves.
Bags of the node graph: tests/graph/test_whole_part.py.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from isf_analysis.bag.bag_writer import write_bag
from isf_analysis.measures.record import PartRecord
from isf_cell import in_process
from isf_cell.commands.replay import replay_run
from isf_cell.commands.resume import alone
from isf_cell.options import RunOptions
from isf_cell.replay.differences import difference
from isf_cell.replay.outcome import Replay, replay
from isf_cell.replay.recorded_run import read_run
from isf_cell.replay.what_if import parse
from isf_core.contour import ContourResult
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile
from isf_force_ctrl.control_config import ControlConfig
from isf_force_ctrl.controller import ForceController
from isf_planner import plan
from isf_sim.machine.simulated_machine import SimulatedMachine
from isf_springback.corrector import Corrector, apply
from isf_springback.methods import make_corrector
from quick_cone import CONTOURS_OF_LONGER, LONGER, quick_cone

OPTIONS = RunOptions(seed=7, variant=21)
N = 4
"""Contour of the small cone, from 1, before which something changes; under force control, and not the last."""

GOLDEN = Path(__file__).resolve().parents[5] / "tests" / "golden" / "jobs"


def golden(name: str, springback: str) -> JobFile:
    """A golden job, a part of another process, with the fields ``springback`` of that section."""
    text = (GOLDEN / f"{name}.yaml").read_text(encoding="utf-8")
    # else its plan has cancelled what force control would, and nothing is left to change
    text = text.replace("policy: trade_off", "policy: trade_off\n  compensate_compliance: false")
    return JobFile(f"{text}springback: {{{springback}}}\n", GOLDEN)


def cone(springback: str = "method: analytic") -> JobFile:
    """The small cone in five contours."""
    return quick_cone(springback, step=LONGER)


@pytest.fixture(scope="module")
def part() -> PartRecord:
    return in_process.form(cone(), OPTIONS)


@pytest.fixture(scope="module")
def run(part: PartRecord, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("run")
    write_bag(part, folder / "bag")
    return folder


def from_contour(run: Path, number: int, *changes: str) -> Replay:
    """Contour ``number`` from 1."""
    return replay(read_run(run), parse(changes), start=number - 1)


SCANNED = "scan_every: 1\n  open_loop_contours: 1\n  lift_every: 2\n  method"


@pytest.mark.parametrize(
    ("job", "process", "method"),
    [
        (cone(f"{SCANNED}: fused"), "DSIF", "fused"),
        (cone(f"{SCANNED}: mpc_vertical"), "DSIF", "mpc_vertical"),
        (cone(f"{SCANNED}: elastic"), "DSIF", "elastic"),
        (golden("spif_cone", "method: analytic"), "SPIF", "analytic"),
        (golden("tpif_cone", "method: mpc_tpif, scan_every: 1, open_loop_contours: 1"), "TPIF", "mpc_tpif"),
        (golden("adsif_cone", "method: none"), "ADSIF", "none"),
    ],
    ids=lambda item: item if isinstance(item, str) else "",
)
def test_without_changes_it_is_the_record_and_a_change_is_felt_from_its_contour_on(
    job: JobFile, process: str, method: str, tmp_path: Path
) -> None:
    """A slower compliance compensation, which every process has, and another springback gain where one corrects."""
    formed = in_process.form(job, OPTIONS)
    assert (formed.process, formed.correction) == (process, method)
    write_bag(formed, tmp_path / "bag")
    middle = formed.planned // 2 + 1
    same = from_contour(tmp_path, middle)
    assert same.identical is True, same.numbers()
    assert same.before is not None
    assert (same.before.compared, same.before.identical) == (middle - 1, True)
    changes = ("force.compliance_time=0.6", *(() if method == "none" else ("springback.gain=0.6",)))
    other = from_contour(tmp_path, middle, *changes)
    numbers = other.numbers()
    assert other.before is not None
    assert other.before.identical, other.before
    assert numbers["identical"] is False
    assert numbers["results"]["first_contour"] == middle - 1
    if method not in ("none", "mpc_vertical", "mpc_tpif"):  # these two know no gain
        assert numbers["corrections"]["first_contour"] == middle - 1
        assert other.again is not None
        one, two = (record.corrections[middle - 1] for record in (formed, other.again))
        np.testing.assert_array_equal(two.springback, one.springback)  # the new gain is all that is new to it


def by_hand(
    job: JobFile, change: Callable[[ForceController], None], successor: Corrector | None = None
) -> list[ContourResult]:
    """The part formed with machine, force control and springback alone, ``change`` called before contour :data:`N`;
    from it on ``successor`` corrects, which followed the one before it."""
    machine = SimulatedMachine(job, variant=OPTIONS.variant, seed=OPTIONS.seed, sheet=OPTIONS.sheet)
    machine.tare()
    planned, sample = plan(job), machine.sample()
    corrector = make_corrector(OPTIONS.method(job), job)
    correctors = [corrector] if successor is None else [corrector, successor]
    for each in correctors:
        each.set_target(planned.target)
    controller = ForceController(ControlConfig.from_job(job))
    controller.arm(planned.plan_id, 0, len(planned.contours), sample.tip_1.tolist(), sample.tip_2.tolist())
    found: list[ContourResult] = []
    for contour in planned.contours:
        if contour.index == N - 1:
            change(controller)
            correctors = correctors[-1:]
        correction = correctors[0].correct(contour)
        for each in correctors[1:]:
            each.follow(contour, correction)
        corrected = apply(contour, correction)
        controller.start(corrected)
        while controller.busy:
            targets = controller.tick(sample.tick, sample.time, sample.wrench_1.tolist(), sample.wrench_2.tolist())
            sample = machine.tick(targets.tip_1, targets.tip_2, targets.holder_height, axis=targets.axis)
        result = controller.take_result()
        assert result is not None
        for each in correctors:
            each.add_result(corrected, result)
        found.append(result)
    return found


def retuned(**values: Any) -> Callable[[ForceController], None]:
    """What a node does with parameters that are set."""
    return lambda controller: controller.retune(replace(controller.config, **values))


@pytest.mark.parametrize(
    ("change", "values"),
    [
        ("force.loop_gain=10", {"loop_gain": 10.0}),
        ("force.integral_gain=40", {"loop_gain": 18.0}),  # by 0.45 N/um
        ("force.filter_cutoff=15", {"filter_cutoff": 15.0}),
        ("control.support_force=90 N", {"set_point": 90.0}),
        ("control.compliance_compensation=0.2", {"compensation": 0.2}),
    ],
)
def test_it_is_the_part_whose_force_control_is_retuned_there(change: str, values: dict[str, float], run: Path) -> None:
    found = from_contour(run, N, change)
    assert found.again is not None
    formed = by_hand(cone(), retuned(**values))
    against = difference(formed, found.again.results)
    assert against.compared == CONTOURS_OF_LONGER
    assert {name: size for name, size in against.differing.items() if size > 1e-9} == {}
    felt = difference(found.run.part.results, formed)
    assert felt.first == N - 1
    assert felt.differing["support_target"] > 1e-6  # m


def test_it_is_the_part_that_another_method_corrects_from_there(part: PartRecord, run: Path) -> None:
    found = from_contour(run, N, "springback.method=fused")
    assert found.again is not None
    formed = by_hand(cone(), lambda _: None, make_corrector("fused", cone()))
    against = difference(formed, found.again.results)
    assert against.compared == CONTOURS_OF_LONGER
    assert {name: size for name, size in against.differing.items() if size > 1e-9} == {}
    assert [item.method for item in found.again.corrections] == ["analytic"] * (N - 1) + ["fused"] * 2
    assert difference(part.corrections, found.again.corrections).first == N - 1


def test_a_gain_of_the_same_method_is_all_that_changes(part: PartRecord, run: Path) -> None:
    """Half the gain asks for half the push: on contour N the prediction is the recorded one, and its push is nearer to
    half of it than to the whole."""
    found = from_contour(run, N, "springback.gain=0.5")
    assert found.again is not None
    before, after = part.corrections[N - 1], found.again.corrections[N - 1]
    np.testing.assert_array_equal(after.springback, before.springback)
    assert np.abs(after.offset).mean() < 0.95 * np.abs(before.offset).mean()


def test_what_is_told_and_written(run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    replay_run(run, ["force.loop_gain=10"], tmp_path / "out", None, None, from_contour=N, as_json=True)
    told = capsys.readouterr()
    data = json.loads(told.out)
    assert data["from"] == N
    assert data["identical"] is False
    assert data["identical_unknown"] is None
    assert data["results"]["first_contour"] == N - 1  # from 0, as in messages
    assert data["prediction"]["recorded"]["contours"] == CONTOURS_OF_LONGER - N + 1
    recorded, changed = (data["prediction"][which]["force_error_rms_N"] for which in ("recorded", "what_if"))
    assert changed > 1.05 * recorded  # a slower loop holds the force worse
    words = " ".join(told.err.split())
    assert f"contours 1 to {N - 1} formed again as recorded: the same bit for bit" in words
    assert "warning" not in words
    assert f"from contour {N} on with the changes" in words
    lines = (tmp_path / "out" / "contours.csv").read_text().splitlines()
    place = lines[0].split(",").index("changed")
    assert [line.split(",")[place] for line in lines[1:]] == ["0", "0", "0", "1", "1"]
    assert (tmp_path / "out" / "replay.png").stat().st_size > 20_000


def test_without_changes_nothing_is_called_what_if(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    replay_run(run, [], None, None, None, from_contour=1, as_json=True)
    told = capsys.readouterr()
    data = json.loads(told.out)
    assert (data["from"], data["identical"], data["before"]) == (1, True, None)
    assert "identical: true" in told.err
    assert "formed again" in told.err
    assert "what if" not in told.err


def test_of_a_record_that_ends_early_the_rest_is_not_known(part: PartRecord, tmp_path: Path) -> None:
    short = {name: getattr(part, name)[:3] for name in ("nominal", "corrected", "corrections", "results")}
    write_bag(replace(part, **short, scan=None), tmp_path / "bag")
    found = from_contour(tmp_path, 2)
    assert found.identical is None
    assert found.identical_unknown == f"only 3 of {CONTOURS_OF_LONGER} contours are recorded"
    assert found.before is not None
    assert found.before.identical
    other = from_contour(tmp_path, 2, "force.loop_gain=10", "springback.gain=0.5")
    assert other.identical is False
    numbers = other.numbers()["prediction"]  # of the contours that are in both
    assert (numbers["recorded"]["contours"], numbers["what_if"]["contours"]) == (2, 2)
    with pytest.raises(IsfError, match="1 to 3 so far") as caught:
        from_contour(tmp_path, 4)
    assert caught.value.code == ErrorCode.FILE_FIELD


def test_a_record_that_is_another_part_is_told(
    part: PartRecord, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """One target of the second contour, in the last bit."""
    target = part.results[1].forming_target.copy()
    target[3, 0] = np.nextafter(target[3, 0], 1.0)
    results = (part.results[0], replace(part.results[1], forming_target=target), *part.results[2:])
    write_bag(replace(part, results=results), tmp_path / "bag")
    replay_run(tmp_path, [], None, None, None, from_contour=N, as_json=True)
    told = capsys.readouterr()
    data = json.loads(told.out)
    assert data["identical"] is False
    assert data["before"]["first_contour"] == 1
    assert set(data["before"]["differing_fields"]) == {"forming_target"}
    assert "warning contours 1 to 3 formed again are not those of the record, they differ from contour 2 on" in told.err


@pytest.mark.parametrize(
    ("number", "change", "named"),
    [
        (N, "force.acceleration=0.4", "leave --from out"),
        (N, "force.adapt_stiffness=true", "leave --from out"),
        (N, "control.components=[normal, vertical]", "leave --from out"),
        (N, "variant=3", "--variant 3"),
        (N, "sheet=shell", "--sheet shell"),
        (N, "path.incremental_depth=1 mm", "the plan"),
        (N, "control.support_force=2 N", "no contact"),
        (N, "springback.method=mpc_vertical", "scan_every"),
        (0, "", "--from 1 to 5"),
        (CONTOURS_OF_LONGER + 1, "", "contours 1 to 5"),
    ],
)
def test_what_cannot_be_from_a_contour_on_is_refused(number: int, change: str, named: str, run: Path) -> None:
    with pytest.raises(IsfError, match=named) as caught:
        replay_run(run, [change] if change else [], None, None, None, from_contour=number, as_json=False)
    assert caught.value.code == ErrorCode.FILE_FIELD


def test_a_support_force_where_none_is_held_is_refused(tmp_path: Path) -> None:
    write_bag(in_process.form(cone(), replace(OPTIONS, support_force=0.0)), tmp_path / "bag")
    with pytest.raises(IsfError, match="under force control") as caught:
        from_contour(tmp_path, N, "control.support_force=100 N")
    assert caught.value.code == ErrorCode.FILE_FIELD
    assert caught.value.advice == "leave --from out: the whole part is formed so"


def test_a_support_force_is_held_where_the_plan_had_none(tmp_path: Path) -> None:
    """Planned with 0 N: all contours are under position control."""
    job = quick_cone("method: none")
    without = JobFile(job.text.replace("support_force: 120 N", "support_force: 0 N"), job.base)
    assert without.job.support_force_at() == 0.0
    planned = in_process.form(without, OPTIONS)
    assert not any(contour.force_controlled for contour in planned.nominal)
    write_bag(planned, tmp_path / "bag")
    found = replay(read_run(tmp_path), parse(["control.support_force=100 N"]))
    assert found.again is not None
    (held,) = (
        result for result in found.again.results if result.tick_engaged.any()
    )  # the first and the last never are
    assert held.index == 1
    assert held.tick_set_point[held.tick_engaged].max() == pytest.approx(100.0)
    # and it can be drawn, though only one of the two held a force
    replay_run(tmp_path, ["control.support_force=100 N"], tmp_path / "out", None, None, as_json=False)
    assert (tmp_path / "out" / "replay.png").is_file()


def test_what_contradicts_it_is_refused(part: PartRecord, run: Path, tmp_path: Path) -> None:
    with pytest.raises(IsfError, match="leave out --no-replant, or --from") as caught:
        replay_run(run, [], None, None, False, from_contour=N, as_json=False)
    assert caught.value.code == ErrorCode.FILE_FIELD
    write_bag(replace(part, variant=-1, sheet={}), tmp_path / "real" / "bag")
    with pytest.raises(IsfError, match="leave --from out") as caught:
        from_contour(tmp_path / "real", N)
    assert caught.value.code == ErrorCode.FILE_FIELD
    write_bag(part, tmp_path / "busy" / "bag")
    (tmp_path / "busy" / "checkpoint").mkdir()
    with alone(tmp_path / "busy"), pytest.raises(IsfError, match="forms this part") as caught:
        replay_run(tmp_path / "busy", [], None, None, None, from_contour=N, as_json=False)
    assert caught.value.code == ErrorCode.BUSY


def test_ctrl_c_leaves_no_files(
    run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """In the middle of forming, where the operator sees the contour after the change."""
    from isf_cell.commands import terminal

    def interrupted(_: object, step: Any) -> None:
        if step.index == N - 1:
            raise KeyboardInterrupt

    monkeypatch.setattr(terminal.PartProgress, "contour", interrupted)
    with pytest.raises(IsfError, match="stopped by the operator") as caught:
        replay_run(run, ["force.loop_gain=10"], tmp_path / "out", None, None, from_contour=N, as_json=False)
    assert caught.value.code == ErrorCode.CANCELLED
    assert list(tmp_path.iterdir()) == []
