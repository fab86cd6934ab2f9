"""``isf tryout`` on the fast sheet: finds a correction, says what it is worth, goes on where it was, refuses misuse."""

from __future__ import annotations

import json
import re
import shutil
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import forked_process
import numpy as np
import pytest
import yaml
from isf_analysis.bag.bag_reader import read_bag
from isf_analysis.measures.deviation import compare
from isf_analysis.measures.summary import summary as measured
from isf_cell import in_process
from isf_cell.commands.exit_codes import Exit
from isf_cell.commands.tryout import SetUp, Tryout, _bands, _folder, _set_ups, _tried, try_out
from isf_cell.corrected_plan import corrected_ahead
from isf_cell.options import RunOptions
from isf_cell.replay.recorded_run import read_run
from isf_core.errors import ErrorCode, IsfError
from isf_core.files import yaml_file
from isf_core.files.job import JobFile, load_job
from isf_core.simulated_sheet import SheetKind
from isf_core.types import Array
from isf_planner import plan
from isf_springback.estimators import learning
from quick_cone import FOLDER, quick_cone, quick_cone_file

ADSIF = FOLDER / "adsif_cone.yaml"
REN_CONE_PLATE = FOLDER / "ren_cone_plate.yaml"


@dataclass
class Done:
    """A finished try-out: what it was, its folder, its summary."""

    wanted: Tryout
    folder: Path
    summary: dict[str, object]


def summary_of(folder: Path) -> dict[str, object]:
    found: dict[str, object] = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    return found


def faster(job: Path, *others: tuple[str, str]) -> Path:
    """``job`` at a rate that a try-out takes back, with ``others`` changed."""
    text = job.read_text(encoding="utf-8")
    for old, new in (("rate: 100 Hz", "rate: 200 Hz"), *others):
        assert old in text
        text = text.replace(old, new)
    job.write_text(text, encoding="utf-8")
    return job


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> Done:
    base = tmp_path_factory.mktemp("tryout")
    job = faster(quick_cone_file(base, step="2.5 mm"))
    wanted = Tryout(job, sheet="fast", steps=1, variants=(1, 2), checks=(21,), check_sheet="fast")
    try_out(wanted, base / "out", as_json=False)
    return Done(wanted, base / "out", summary_of(base / "out"))


def parts_of(summary: dict[str, object], name: str) -> list[dict[str, float]]:
    parts = summary["parts"]
    assert isinstance(parts, list)
    return [part for part in parts if part["part"] == name]


def test_the_chosen_part_is_the_best_and_better_than_the_first(done: Done) -> None:
    parts = done.summary["parts"]
    assert isinstance(parts, list)
    names = ("first", "replay", "probe 1", "probe 2", "step 1")
    assert [(part["part"], part["variant"]) for part in parts[:10]] == [(name, k) for name in names for k in (1, 2)]
    chosen, first = (parts_of(done.summary, name) for name in (str(done.summary["chosen"]), "first"))
    assert max(part["mean_mm"] for part in chosen) < 0.7 * max(part["mean_mm"] for part in first)


def test_variants_share_one_correction(done: Done) -> None:
    """But in the first part, where the method asks for another one by the forces of each."""

    def offset(part: str, variant: int) -> Array:
        return read_bag(done.folder / part / f"variant_{variant}").corrections[-1].offset

    assert not np.array_equal(offset("first", 1), offset("first", 2))
    assert np.array_equal(offset("replay", 1), offset("replay", 2))


def test_its_job_forms_the_chosen_part_wherever_it_is_taken(done: Done, tmp_path: Path) -> None:
    for name in ("job.yaml", "plan.npz"):
        shutil.copyfile(done.folder / name, tmp_path / name)
    job = load_job(tmp_path / "job.yaml")
    assert job.job.springback.method == "learned"
    assert job.job.control.rate == 200.0
    record = in_process.form(job, RunOptions(variant=1))
    assert record.scan is not None
    assert record.target is not None
    mean = compare(record.scan, record.target).whole.mean_abs
    chosen = parts_of(done.summary, str(done.summary["chosen"]))[0]
    assert 1e3 * mean == pytest.approx(chosen["mean_mm"], abs=0.02)  # at another rate
    assert read_bag(done.folder / "first" / "variant_1").control_rate == 100.0


def test_its_job_is_exported_with_the_contours_of_the_chosen_part(done: Done) -> None:
    job = load_job(done.folder / "job.yaml")
    made = corrected_ahead(plan(job), job)
    chosen = read_bag(done.folder / str(done.summary["chosen"]).replace(" ", "_") / "variant_1")
    for contour, wanted in zip(made.plan.contours, chosen.corrected, strict=True):
        assert np.abs(contour.forming_tip - wanted.forming_tip).max() <= 1e-9
        assert np.abs(contour.support_tip - wanted.support_tip).max() <= 1e-9
    assert made.plan.origin[1].startswith("correction file plan.npz, from: try-out on the simulated sheet")


def test_what_to_expect_is_that_of_the_other_variants(done: Done) -> None:
    checks = done.summary["checks"]
    expected = done.summary["expected"]
    assert isinstance(checks, list)
    assert isinstance(expected, dict)
    assert [check["variant"] for check in checks] == [21]
    assert expected["mean_mm"]["worst"] == checks[0]["mean_mm"]
    assert expected["from_variants"] == [21]


def test_a_part_formed_from_it_expects_what_the_other_variants_came_to(done: Done) -> None:
    expected = done.summary["expected"]
    assert isinstance(expected, dict)
    known = learning.load(done.folder / "plan.npz")
    assert known.tried is not None
    assert known.tried.shape == (1, len(known.contour))
    found = measured(in_process.form(load_job(done.folder / "job.yaml"), RunOptions(variant=3)))["expected_error"]
    assert found["largest_mm"] == pytest.approx(expected["largest_mm"]["median"], rel=0.15)
    assert found["mean_mm"] == pytest.approx(expected["mean_mm"]["median"], rel=0.15)
    assert found["stands_on"] == "parts formed before, real or tried (springback.learning)"
    assert found["reached_over_expected"] > 0.0


def test_it_goes_on_where_it_was(done: Done) -> None:
    """One part was left half written; nothing else is formed again, and the result is equal."""
    bags = sorted(done.folder.glob("*/variant_?"))
    assert len(bags) == 12
    times = {bag: bag.stat().st_mtime_ns for bag in bags}
    lost = done.folder / "probe_2" / "variant_1"
    lost.rename(lost.with_suffix(".part"))
    try_out(done.wanted, done.folder, as_json=False)
    assert [bag for bag in bags if bag.stat().st_mtime_ns != times[bag]] == [lost]
    assert not lost.with_suffix(".part").exists()
    assert summary_of(done.folder) == done.summary


def test_a_part_of_another_correction_is_formed_anew(done: Done) -> None:
    """As one that an earlier version has asked for."""
    plan = done.folder / "step_1.npz"
    known = learning.load(plan)
    learning.save(replace(known, push=known.push + 1e-3), plan)
    made = [*done.folder.glob("step_1/variant_1"), *done.folder.glob("check_of_step_1_on_fast/variant_21")]
    before = [bag.stat().st_mtime_ns for bag in made]
    try_out(done.wanted, done.folder, as_json=False)
    assert all(bag.stat().st_mtime_ns > time for bag, time in zip(made, before, strict=True))
    assert summary_of(done.folder) == done.summary


def test_another_job_does_not_go_on_in_its_folder(done: Done, tmp_path: Path) -> None:
    job = faster(quick_cone_file(tmp_path), ("thickness: 1.0 mm", "thickness: 1.2 mm"))
    with pytest.raises(IsfError, match="another job") as caught:
        try_out(Tryout(job, sheet="fast"), done.folder, as_json=False)
    assert caught.value.code == ErrorCode.FILE_NOT_WRITABLE


@pytest.mark.parametrize("named", ["springback.learning", "part.accuracy_surfaces", "springback.elastic.database"])
def test_other_contents_of_a_file_that_the_job_names_do_not_go_on_in_its_folder(tmp_path: Path, named: str) -> None:
    change: dict[str, object] = {"part": {"mesh": str(FOLDER.parent / "parts" / "mini_cone.stl")}}
    *sections, field = named.split(".")
    at = change
    for section in sections:
        at = at.setdefault(section, {})  # type: ignore[assignment]
    at[field] = str(tmp_path / "named")
    job_file = quick_cone().changed(change)
    (tmp_path / "named").write_text("first", encoding="utf-8")
    set_ups = [SetUp("first", "as the job says", job_file)]
    folder = _folder(Tryout(Path("job.yaml")), set_ups, tmp_path / "out")
    (folder / "first").mkdir()
    assert _folder(Tryout(Path("job.yaml")), set_ups, folder) == folder
    (tmp_path / "named").write_text("second", encoding="utf-8")
    with pytest.raises(IsfError, match="other contents of a file"):
        _folder(Tryout(Path("job.yaml")), set_ups, folder)


def test_over_a_die_the_bands_follow_the_blank_holder(done: Done) -> None:
    """There all tips are at z = 0."""
    known = learning.load(done.folder / "step_1.npz")
    nominal = read_bag(done.folder / "first" / "variant_1").nominal
    deep = [float(contour.forming_tip[:, 2].min()) for contour in nominal]
    over_die = [
        replace(contour.shifted(np.array([0.0, 0.0, -depth])), holder_height=depth)
        for contour, depth in zip(nominal, deep, strict=True)
    ]
    assert len(nominal) == 2
    assert np.array_equal(_bands(known, over_die), _bands(known, nominal))
    assert (_bands(known, over_die).sum(axis=0) > 0.0).all()


def test_scans_of_the_real_part_are_held_against_those_of_the_chosen_one(tmp_path: Path) -> None:
    """The parts tried are not scanned between contours; the chosen one is, and its plan says what was seen."""
    scans = ("method: analytic", "method: analytic\n  scan_every: 1\n  scan_sensor: true")
    job = faster(quick_cone_file(tmp_path, step="2.5 mm"), scans)
    wanted = Tryout(job, sheet="fast", steps=1, checks=(21,), check_sheet="fast")
    try_out(wanted, tmp_path / "out", as_json=False)
    folder, chosen = tmp_path / "out", str(summary_of(tmp_path / "out")["chosen"])
    scanned = {path.parent.name for path in folder.glob("*/variant_*") if read_bag(path).scans}
    assert scanned == {"first", f"scans of {chosen}".replace(" ", "_"), f"check of {chosen} on fast".replace(" ", "_")}
    text = read_bag(folder / f"scans_of_{chosen.replace(' ', '_')}" / "variant_0").job_text
    assert yaml.safe_load(text)["springback"]["scan_sensor"] is False
    plan = learning.load(folder / "plan.npz")
    assert plan.seen is not None
    assert np.isfinite(plan.seen[plan.contour == 0]).any()
    assert np.array_equal(plan.push, learning.load(folder / f"{chosen.replace(' ', '_')}.npz").push)
    found = load_job(folder / "job.yaml").job.springback
    assert (found.method, found.scan_every, found.scan_sensor) == ("learned", 1, True)


def test_sealed_variants_are_kept_for_the_judgement(done: Done, tmp_path: Path) -> None:
    with pytest.raises(IsfError, match="101 are sealed"):
        try_out(Tryout(done.wanted.job, variants=(0, 101)), tmp_path, as_json=False)
    assert not any(tmp_path.iterdir())


def test_a_job_that_is_refused_leaves_no_folder(tmp_path: Path) -> None:
    """Here by the planner, when the first part is to be formed."""
    text = quick_cone_file(tmp_path).read_text(encoding="utf-8")
    plate = "backing_plate: {shape: circle, size: [30 mm, 30 mm]}"
    (tmp_path / "plate.yaml").write_text(f"{text}\n{plate}\n", encoding="utf-8")
    with pytest.raises(IsfError, match="edge of the backing plate"):
        try_out(Tryout(tmp_path / "plate.yaml", sheet="fast"), tmp_path / "out", as_json=False)
    assert not (tmp_path / "out").exists()


COMPENSATED = ("path:\n", "path:\n  compensation: [sheet]\n"), ("method: analytic", "method: none")


@pytest.mark.parametrize("kind", ["compensated", "adsif", "no part"])
def test_what_no_try_out_corrects_is_refused_before_a_part_is_formed(tmp_path: Path, kind: str) -> None:
    job = tmp_path / "quick_cone.yaml"
    if kind == "compensated":
        faster(quick_cone_file(tmp_path), *COMPENSATED)
        field, what = "path.compensation", "sheet corrects in the plan what a try-out corrects"
    elif kind == "adsif":
        job.write_text(ADSIF.read_text(encoding="utf-8").replace("../parts", str(FOLDER.parent / "parts")))
        field, what = "process", "ADSIF forms at a constant depth"
    else:
        fields = yaml.safe_load(quick_cone_file(tmp_path).read_text(encoding="utf-8"))
        fields |= {"process": "SPIF", "path": {"program": "part.nc", "feed": "20 mm/s"}}
        others = {key: value for key, value in fields.items() if key not in ("part", "tool_2", "control")}
        job.write_text(yaml.safe_dump(others), encoding="utf-8")
        field, what = "part", "the job names none"
    with pytest.raises(IsfError, match=what) as caught:
        try_out(Tryout(job, sheet="fast"), tmp_path / "out", as_json=False)
    assert (caught.value.code, caught.value.where) == (ErrorCode.FILE_FIELD, field)
    assert caught.value.advice
    assert not (tmp_path / "out").exists()


def test_a_refused_job_leaves_what_others_put_in_the_folder(tmp_path: Path) -> None:
    text = quick_cone_file(tmp_path).read_text(encoding="utf-8")
    job, out = tmp_path / "plate.yaml", tmp_path / "out"
    job.write_text(f"{text}\nbacking_plate: {{shape: circle, size: [30 mm, 30 mm]}}\n", encoding="utf-8")
    wanted = Tryout(job, sheet="fast")
    _folder(wanted, [SetUp("first", "as the job says", load_job(job))], out)
    (out / "notes.txt").write_text("mine", encoding="utf-8")
    with pytest.raises(IsfError, match="edge of the backing plate"):
        try_out(wanted, out, as_json=False)
    assert [item.name for item in out.iterdir()] == ["notes.txt"]


def test_a_variant_that_had_a_say_is_no_check(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    loose = ("control:\n", "tolerance: {shape: 9 mm, share: 0.5}\ncontrol:\n")
    job = faster(quick_cone_file(tmp_path, step="2.5 mm"), loose)
    try_out(Tryout(job, sheet="fast", variants=(0, 21), checks=(21,)), tmp_path / "out", as_json=False)
    assert "variants 21: the correction is made for them" in capsys.readouterr().err
    summary = summary_of(tmp_path / "out")
    assert summary["checks"] == []
    assert summary["expected"]["from_variants"] == [0, 21]  # type: ignore[index]
    assert summary["expected"]["stands_on"].endswith("no check of it")  # type: ignore[index]


def test_a_part_out_of_tolerance_on_the_variants_it_is_checked_on_is_not_called_good(tmp_path: Path) -> None:
    """In 2 mm are 71 % of the first part on the variant it is made for, and 41 % on the other one."""
    job = faster(
        quick_cone_file(tmp_path, step="2.5 mm"), ("control:\n", "tolerance: {shape: 2 mm, share: 0.6}\ncontrol:\n")
    )
    wanted = Tryout(job, sheet="fast", variants=(1,), checks=(0,), check_sheet="fast")
    try_out(wanted, tmp_path / "out", as_json=False)
    summary = summary_of(tmp_path / "out")
    assert summary["chosen"] == "first"
    assert summary["within_tolerance"] is False
    (told,) = summary["prevented_by"]  # type: ignore[misc]
    assert "out of tolerance on variants that had no say in it: 0 (41 %)" in told


LOOSE = ("control:\n", "tolerance: {shape: 9 mm, share: 0.5}\ncontrol:\n")


def test_the_model_of_a_try_out_does_not_judge_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """By the tolerance of this job the first part is good; it is formed again on other cells, with another speed."""
    job = quick_cone_file(tmp_path, step="2.5 mm")
    text = re.sub(r"tool_2:\n  radius: .*\n|  (support_force|engage_depth): .*\n", "", job.read_text(encoding="utf-8"))
    job.write_text(text, encoding="utf-8")
    faster(job, ("process: DSIF", "process: SPIF"), LOOSE)
    wanted, out = Tryout(job, sheet="fast", checks=(21,)), tmp_path / "out"
    try_out(wanted, out, as_json=False)
    summary = summary_of(out)
    judged, found = read_bag(out / "check_of_first_on_shell_coarse" / "variant_21"), read_bag(out / "first/variant_0")
    assert (found.sheet["model"], judged.sheet["model"]) == ("fast", "shell_coarse")
    assert judged.scan is not None
    assert judged.target is not None
    expected: Any = summary["expected"]
    reached = 1e3 * compare(judged.scan, judged.target).whole.mean_abs
    assert expected["mean_mm"]["worst"] == pytest.approx(reached, rel=1e-6)
    assert (expected["from_sheet"], expected["from_variants"]) == ("shell_coarse", [21])
    told = "variant 21, which had no say in it, and on the sheet shell_coarse, of other cells and tool speed"
    assert told in expected["stands_on"]
    assert told in " ".join(capsys.readouterr().err.split())
    bag = out / "check_of_first_on_shell_coarse" / "variant_21"
    time = bag.stat().st_mtime_ns
    try_out(wanted, out, as_json=False)
    assert bag.stat().st_mtime_ns == time, "it goes on where it was"
    assert summary_of(out) == summary
    try_out(replace(wanted, check_sheet="fast"), out, as_json=False)
    captured = capsys.readouterr()
    assert "judged by the sheet fast that it was found on" in " ".join(captured.err.split())
    anew: Any = summary_of(out)["expected"]
    assert anew["from_sheet"] == "fast"
    assert "that it was found on, too" in anew["stands_on"]
    assert anew["mean_mm"] != expected["mean_mm"]


@pytest.mark.parametrize(
    ("sheet", "judge"),
    [("fast", "shell_coarse"), ("shell_coarse", "shell"), ("shell", "shell_coarse"), ("shell_fine", "shell")],
)
def test_the_sheet_of_the_checks_is_another_one(sheet: SheetKind, judge: SheetKind) -> None:
    assert Tryout(Path("job.yaml"), sheet=sheet).judge == judge
    assert Tryout(Path("job.yaml"), sheet=sheet, check_sheet="shell_fine").judge == "shell_fine"


def test_what_no_check_can_be_formed_on_is_refused_before_a_part_is_formed(tmp_path: Path) -> None:
    job, out = quick_cone_file(tmp_path), tmp_path / "out"
    with pytest.raises(IsfError, match="the fast sheet does not know a support tool that holds") as caught:
        try_out(Tryout(job, check_sheet="fast"), out, as_json=False)
    assert (caught.value.where, caught.value.advice) == ("--check-sheet fast", "take shell")
    with pytest.raises(IsfError, match="no part is checked"):
        try_out(Tryout(job, checks=(), check_sheet="shell"), out, as_json=False)
    assert not out.exists()


def test_horizontal_corrections_which_no_plan_has_are_not_taken_for_an_answer_to_a_probe(tmp_path: Path) -> None:
    """The part that the probes are held against is the first one again, without them."""
    across = ("method: analytic", "method: elastic\n  elastic: {horizontal: true}")
    job = faster(quick_cone_file(tmp_path), across)
    try_out(Tryout(job, sheet="fast", steps=1, checks=()), tmp_path / "out", as_json=False)
    first, again = (read_bag(tmp_path / "out" / name / "variant_0").corrections for name in ("first", "replay"))
    assert any(made.offset[:, :2].any() for made in first)
    assert not any(made.offset[:, :2].any() for made in again)
    assert again[-1].offset[:, 2] == pytest.approx(first[-1].offset[:, 2], abs=0.05e-3)


def test_a_correction_that_does_not_get_through_is_left_out(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The machine bears the part of this sheet, but not what the job's method adds to it."""
    job = faster(quick_cone_file(tmp_path, step="2.5 mm"), ("thickness: 1.0 mm", "thickness: 2.0 mm"))
    try_out(Tryout(job, sheet="fast", steps=1, checks=()), tmp_path / "out", as_json=False)
    told = capsys.readouterr().err
    assert "first does not complete on variant 0" in told
    assert "begins again without a correction" in told
    summary = summary_of(tmp_path / "out")
    assert not parts_of(summary, "first")
    (uncorrected,) = parts_of(summary, "uncorrected")
    (chosen,) = parts_of(summary, str(summary["chosen"]))
    assert chosen["mean_mm"] < uncorrected["mean_mm"]
    assert "the machine bears" in str(summary["prevented_by"])
    assert (tmp_path / "out" / "tryout.png").is_file()


def test_no_step_is_taken_where_no_probe_gets_through(tmp_path: Path) -> None:
    """It would be the first part again. More steps are not what helps."""
    change = {
        "path": {"incremental_depth": "3 mm", "point_spacing": "2 mm", "feed": "60 mm/s"},
        "control": {"rate": "100 Hz"},
    }
    text = load_job(FOLDER / "tpif_cone.yaml").changed(change).text.replace("../parts", str(FOLDER.parent / "parts"))
    (tmp_path / "job.yaml").write_text(text, encoding="utf-8")
    try_out(Tryout(tmp_path / "job.yaml", sheet="fast", steps=1, checks=()), tmp_path / "out", as_json=False)
    summary = summary_of(tmp_path / "out")
    prevented = " ".join(summary["prevented_by"])  # type: ignore[arg-type]
    assert {part["part"] for part in summary["parts"]} == {"first"}  # type: ignore[attr-defined]
    assert "probe 1 does not complete" in prevented
    assert "more of them may help" not in prevented
    assert not (tmp_path / "out" / "step_1").exists()


LOW_RIG = """based_on: ren2018
name: low
park_height: 7.7 mm
limits: {travel: [125 mm, 125 mm, 8.2 mm]}
provenance:
  park_height: "assumed: for this test"
  limits.travel: "assumed: for this test"
"""


def test_a_probe_whose_contour_is_refused_is_one_failed_part(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """With 1 mm more push at its lowest, the cone of 7.5 mm would leave the travel of the rig; the other probes do."""
    change = {
        "rig": "low.yaml",
        "process": "SPIF",
        "part": {"scale": 1.5},
        "tool_2": None,
        "path": {"incremental_depth": "2.6 mm", "point_spacing": "2 mm", "feed": "60 mm/s"}
        | {"floor_step": "6 mm", "floor_rounds": 1},
        "control": {"support_force": None, "engage_depth": None},
        "springback": {"method": "none"},
    }
    (tmp_path / "low.yaml").write_text(LOW_RIG, encoding="utf-8")
    job = quick_cone_file(tmp_path)
    fields = yaml_file.merged(yaml.safe_load(job.read_text(encoding="utf-8")), change)
    job.write_text(yaml.safe_dump(fields), encoding="utf-8")
    try_out(Tryout(job, sheet="fast", steps=1, checks=(), jobs=2), tmp_path / "out", as_json=False)
    told = " ".join(capsys.readouterr().err.split())
    summary = summary_of(tmp_path / "out")
    assert {"first", "probe 1", "probe 2", "probe 3"} < {part["part"] for part in summary["parts"]}  # type: ignore[attr-defined]
    assert not parts_of(summary, "probe 4")
    for text in (told, " ".join(summary["prevented_by"])):  # type: ignore[arg-type]
        assert "probe 4 does not complete on variant 0: contour 3 of mini_cone" in text
        assert "forming_tip at point 0 (12.7, -0.1, -8.5) mm is outside the travel of the rig" in text
    kept = read_bag(tmp_path / "out" / "probe_4" / "variant_0")
    assert [result.completed for result in kept.results] == [True, False], "what was formed before it is kept"


def test_its_job_finds_its_files_whatever_they_are_called(tmp_path: Path) -> None:
    """Those without an ending, too; the part has the name of a file, which it is not."""
    own = tmp_path / "own"
    own.mkdir()
    rows = [f"{x},{y},{z},0.1" for x in (-20, 0, 20) for y in (-20, 0, 20) for z in (-20, 0)]
    (own / "gauge").write_text("\n".join(["x_mm,y_mm,z_mm,error_mm", *rows]), encoding="utf-8")
    job = faster(
        quick_cone_file(own, step="2.5 mm"),
        ("name: mini_cone", "name: gauge.v1"),
        ("path:\n", "path:\n  compensation: [machine]\n  machine_error: gauge\n"),
        ("control:\n", "tolerance: {shape: 9 mm, share: 0.5}\ncontrol:\n"),
    )
    shutil.copyfile(own / "gauge", own / "gauge.v1")
    try_out(Tryout(job, sheet="fast", checks=()), tmp_path / "out", as_json=False)
    found = load_job(tmp_path / "out" / "job.yaml")
    assert found.job.name == "gauge.v1"
    assert any("machine error 0.100 to 0.100 mm" in text for text in plan(found).warnings)


def test_a_part_that_no_correction_gets_through_ends_it_with_its_place(tmp_path: Path) -> None:
    """The machine bears less than this sheet takes."""
    job = faster(quick_cone_file(tmp_path), ("thickness: 1.0 mm", "thickness: 3.5 mm"))
    with pytest.raises(IsfError, match="uncorrected does not complete on variant 0") as caught:
        try_out(Tryout(job, sheet="fast"), tmp_path / "out", as_json=False)
    assert str(tmp_path) in caught.value.where


PLATE = "backing_plate: {{shape: circle, size: [{0} mm, {0} mm]}}"


def test_the_best_set_up_is_gone_on_with(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """One of the others cannot be formed, which is told and does not end the try-out."""
    job = faster(quick_cone_file(tmp_path, step="2.5 mm"), ("method: analytic", "method: none"))
    ways = (PLATE.format(24), f"{PLATE.format(60)},\n  springback: {{method: analytic}}")
    wanted = Tryout(job, sheet="fast", steps=1, checks=(21,), alternatives=ways, check_sheet="fast")
    try_out(wanted, tmp_path / "out", as_json=False)
    summary = summary_of(tmp_path / "out")
    told = capsys.readouterr().err
    assert "set-up 2 cannot be formed" in told
    assert "goes on with set-up 3" in told
    assert summary["set_up"] == ways[1]
    refused = summary["set_ups_refused"]
    assert isinstance(refused, dict)
    assert list(refused) == [ways[0]]
    assert "into the backing plate" in refused[ways[0]]
    (first,), (third,) = (parts_of(summary, name) for name in ("first", "set-up 3"))
    assert third["mean_mm"] < first["mean_mm"]
    for name in (
        "probe_1",
        str(summary["chosen"]).replace(" ", "_"),
        f"check_of_{summary['chosen']}_on_fast".replace(" ", "_"),
    ):
        (bag,) = (tmp_path / "out" / name).glob("variant_*")
        assert yaml.safe_load(read_bag(bag).job_text)["backing_plate"]["size"] == ["60 mm", "60 mm"]
    found = load_job(tmp_path / "out" / "job.yaml").job
    assert found.backing_plate is not None
    assert found.backing_plate.size == (0.06, 0.06)
    head = "# Set-up: backing_plate: {shape: circle, size: [60 mm, 60 mm]}, springback: {method: analytic}\n"
    assert head in (tmp_path / "out" / "job.yaml").read_text(encoding="utf-8")


def test_a_support_tool_that_may_stand_anywhere_is_tried_under_the_blank(tmp_path: Path) -> None:
    """On the sheet that yields; by the tolerance of this job any first part is good."""
    loose = "tolerance: {shape: 9 mm, share: 0.5}\ncontrol:\n"
    job = faster(quick_cone_file(tmp_path, step="2.5 mm"), ("control:\n", loose), ("method: analytic", "method: none"))
    assert "support_force" in job.read_text(encoding="utf-8")
    try_out(Tryout(job, checks=()), tmp_path / "out", as_json=False)
    summary = summary_of(tmp_path / "out")
    assert {part["part"] for part in parts_of(summary, "first") + parts_of(summary, "set-up 2")} == {
        "first",
        "set-up 2",
    }
    (bag,) = (tmp_path / "out" / "set-up_2").glob("variant_*")
    formed = read_bag(bag)
    assert yaml.safe_load(formed.job_text)["path"]["support"] == "on_blank"
    assert formed.support_force == 0.0
    said = load_job(tmp_path / "out" / "job.yaml").job.path.support
    assert said == ("on_blank" if "under the blank" in str(summary["set_up"]) else "opposite")


@pytest.mark.parametrize("no_plate", [False, True])
def test_a_sheet_that_nothing_holds_is_tried_over_a_plate(tmp_path: Path, no_plate: bool) -> None:
    """On the sheet that yields, under one tool; not by a job that says that there is no plate."""
    loose = "tolerance: {shape: 9 mm, share: 0.5}\ncontrol:\n"
    job = quick_cone_file(tmp_path, step="2.5 mm")
    text = re.sub(r"tool_2:\n  radius: .*\n|  (support_force|engage_depth): .*\n", "", job.read_text(encoding="utf-8"))
    job.write_text(text + ("backing_plate: null\n" if no_plate else ""), encoding="utf-8")
    faster(job, ("process: DSIF", "process: SPIF"), ("control:\n", loose), ("method: analytic", "method: none"))
    try_out(Tryout(job, checks=()), tmp_path / "out", as_json=False)
    summary = summary_of(tmp_path / "out")
    found = load_job(tmp_path / "out" / "job.yaml").job
    if no_plate:
        assert not parts_of(summary, "set-up 2")
        assert found.backing_plate is None
        return
    (alone,), (held,) = (parts_of(summary, name) for name in ("first", "set-up 2"))
    assert held["mean_by_region_mm"]["rim"] > alone["mean_by_region_mm"]["rim"]  # type: ignore[index, operator]
    assert held["mean_mm"] < alone["mean_mm"]
    assert found.backing_plate is not None
    assert found.backing_plate.size == pytest.approx((0.035, 0.035))  # r = 17.45 mm at 0.1 mm of depth
    assert "which has to be made" in str(summary["set_up"])


def coarse_cone_over_plate(tmp_path: Path, **changes: Any) -> Path:
    """The job ren_cone_plate in steps of 2 mm, with sections as in ``changes``."""
    folder = REN_CONE_PLATE.parent
    job = JobFile(REN_CONE_PLATE.read_text(encoding="utf-8"), folder).changed(
        {
            "part": {"mesh": str(folder.parent / "parts" / "ren_cone.stl")},
            "path": {"incremental_depth": "2 mm", "point_spacing": "2 mm"},
            "control": {"rate": "100 Hz"},
        }
    )
    (tmp_path / "job.yaml").write_text(job.changed(changes).text, encoding="utf-8")
    return tmp_path / "job.yaml"


def test_an_uncorrected_first_part_passes_over_the_floor_as_the_parts_that_learn_from_it(tmp_path: Path) -> None:
    job = load_job(coarse_cone_over_plate(tmp_path, springback={"method": "none"}))
    learned = plan(_tried(job, tmp_path / "known.npz", None, "none")).contours
    assert learned[-1].floor_passes
    assert not plan(job).contours[-1].floor_passes
    for first in (_tried(job, None, None, "none"), _tried(job.changed({"springback": None}), None, "none", "none")):
        assert first.job.springback.method == "none"
        tips = [contour.forming_tip for contour in plan(first).contours]
        assert all(np.array_equal(tip, one.forming_tip) for tip, one in zip(tips, learned, strict=True))


def test_a_set_up_that_its_method_cannot_correct_says_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The plate is so near that it lies under the first contour: the planner lets it be, the model of the sheet not."""
    coarse_cone_over_plate(
        tmp_path,
        path={"floor_step": "none"},
        backing_plate={"size": ["71 mm", "71 mm"]},
        tolerance={"shape": "9 mm", "share": 0.5},
    )
    try_out(Tryout(tmp_path / "job.yaml", sheet="fast", checks=()), tmp_path / "out", as_json=False)
    told = " ".join(capsys.readouterr().err.split())
    assert "first was not corrected at 11 of 11 contours: contour 1: the contours reach within" in told
    assert "% within 9 mm" in told  # the tolerance of the job


def test_what_prevents_the_part_is_not_what_ended_another_set_up(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The machine does not bear the thicker sheet."""
    job, thicker = quick_cone_file(tmp_path, step="2.5 mm"), "sheet: {thickness: 3.5 mm}"
    try_out(Tryout(job, sheet="fast", steps=1, checks=(), alternatives=(thicker,)), tmp_path / "out", as_json=False)
    assert "set-up 2 does not complete on variant 0" in capsys.readouterr().err
    summary = summary_of(tmp_path / "out")
    assert summary["set_up"] == "as the job says"
    assert "(--steps 1)" in str(summary["prevented_by"])
    assert "the machine bears" not in str(summary["prevented_by"])


def test_parts_are_tried_on_a_machine_that_bears_what_the_cells_overstate(tmp_path: Path) -> None:
    """On the sheet that yields, whose cells overstate the force. No such part is called good."""
    job = faster(
        quick_cone_file(tmp_path, step="2.5 mm"),
        ("control:\n", "tolerance: {shape: 9 mm, share: 0.5}\ncontrol:\n"),
        ("path:\n", "path:\n  support: opposite\n"),
        ("thickness: 1.0 mm", "thickness: 1.8 mm"),
        ("method: analytic", "method: none"),
    )
    try_out(Tryout(job, checks=()), tmp_path / "out", as_json=False)
    summary = summary_of(tmp_path / "out")
    assert summary["chosen"] == "first"
    (bag,) = (tmp_path / "out" / "first").glob("variant_*")
    record = read_bag(bag)
    force = max(np.abs(result.forming_force[:, 2]).max() for result in record.results)
    assert 2000.0 < force < 1.8 * 2000.0
    assert f"took {force:.0f} N here, ren2018 bears 2000 N" in str(summary["overload"])
    beyond = [result for result in record.results if np.abs(result.forming_force[:, 2]).max() > 2000.0]
    assert beyond == [result for result in record.results if result.code == ErrorCode.FORCE_LIMIT]
    assert read_run(bag).job_file().rig.limits.force == pytest.approx((2700.0, 2700.0, 3600.0))  # in a replay, too
    numbers = measured(record)
    first = np.abs(beyond[0].forming_force[:, 2]).max()
    assert f"tool 1 took {first:.0f} N in z, ren2018 bears 2000 N" in numbers["overload"]
    assert numbers["complete"]
    assert not numbers["verdict"]["good"]
    assert any("force: contour" in text for text in numbers["verdict"]["short_of"])


def test_a_part_beyond_what_the_cells_overstate_ends_and_says_what_the_machine_bears(tmp_path: Path) -> None:
    job = faster(quick_cone_file(tmp_path, step="2.5 mm"), ("thickness: 1.0 mm", "thickness: 3.5 mm"))
    record = in_process.form(load_job(job), RunOptions(correction="none", sheet="shell_coarse"))
    assert not record.results[-1].completed
    assert "1.8 times what ren2018 bears, since cells of this size overstate" in record.results[-1].message


ON_BLANK = (
    "path: {support: on_blank}, control: {support_force: null, engage_depth: null}, springback: {first_contour: null}"
)


@pytest.mark.parametrize(
    ("text", "code", "what"),
    [
        ("", ErrorCode.FILE_SYNTAX, "holds no fields"),
        ("on_blank", ErrorCode.FILE_FIELD, "changes nothing"),
        ("path: {support: [", ErrorCode.FILE_SYNTAX, ""),
        ("path: {suport: on_blank}", ErrorCode.FILE_FIELD, "suport"),
        ("path: {support: beside}", ErrorCode.FILE_FIELD, "support"),
        ("springback: {method: nothing_known}", ErrorCode.METHOD_UNKNOWN, "nothing_known"),
        ("rig: nowhere.yaml", ErrorCode.FILE_NOT_FOUND, "nowhere"),
        ("path: {compensation: [sheet]}, springback: {method: none}", ErrorCode.FILE_FIELD, "sheet corrects in the"),
        (ON_BLANK, ErrorCode.FILE_FIELD, "the fast sheet does not know"),
    ],
)
def test_what_is_no_set_up_is_refused_before_a_part_is_formed(
    tmp_path: Path, text: str, code: ErrorCode, what: str
) -> None:
    with pytest.raises(IsfError) as caught:
        try_out(Tryout(quick_cone_file(tmp_path), sheet="fast", alternatives=(text,)), tmp_path / "out", as_json=False)
    assert caught.value.code == code, caught.value.message
    assert what in caught.value.message
    assert "--or" in caught.value.where
    assert caught.value.advice
    assert not (tmp_path / "out").exists()


def test_a_set_up_that_is_tried_anyway_is_not_tried_twice(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """On the sheet that yields, the support tool is tried under the blank where the job leaves it open."""
    job = quick_cone_file(tmp_path)
    ways = _set_ups(Tryout(job, alternatives=(ON_BLANK, "control: {support_force: 60 N}")), load_job(job))
    assert [way.name for way in ways] == ["first", "set-up 2", "set-up 3"]
    assert ways[2].job_file.job.control.support_force == 60.0
    assert "is tried already: support tool under the blank" in " ".join(capsys.readouterr().err.split())


def test_a_method_of_a_set_up_that_another_one_overrides_is_refused(tmp_path: Path) -> None:
    wanted = Tryout(
        quick_cone_file(tmp_path), sheet="fast", correction="none", alternatives=("springback: {method: fused}",)
    )
    with pytest.raises(IsfError, match=r"springback\.method has no effect") as caught:
        try_out(wanted, tmp_path / "out", as_json=False)
    assert caught.value.code == ErrorCode.FILE_FIELD
    assert not (tmp_path / "out").exists()


def test_the_command_takes_several_set_ups_and_names_the_one_that_is_none(tmp_path: Path) -> None:
    job = quick_cone_file(tmp_path)
    ways = ["--or", "control: {support_force: 60 N}", "--or", "on_blank"]
    run = forked_process.run([sys.executable, "-m", "isf_cell.cli", "tryout", str(job), *ways], cwd=tmp_path)
    assert run.returncode == Exit.INPUT
    assert "--or 'on_blank'" in run.stderr
    assert "changes nothing of the job" in run.stderr
    assert not (tmp_path / "runs").exists()
