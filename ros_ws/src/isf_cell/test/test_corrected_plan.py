"""Corrections in the contours of a plan: of recorded parts, and of jobs whose method needs no measurement."""

from __future__ import annotations

import re
import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from isf_analysis.bag.bag_writer import write_bag
from isf_analysis.measures.record import PartRecord
from isf_cell import in_process
from isf_cell.commands.learn import learn_record
from isf_cell.corrected_plan import CorrectedPlan, as_formed, corrected_ahead, uncorrected
from isf_cell.options import RunOptions
from isf_core.contour import Contour
from isf_core.errors import ErrorCode, IsfError
from isf_core.events import Event, EventKind
from isf_core.files.job import JobFile
from isf_planner import exports, plan
from isf_planner.gcode.reader import read_program
from isf_springback.estimators import learning
from quick_cone import CONTOURS, FOLDER, quick_cone
from synthetic_part import make_part

MICROMETRE = 1e-6
SHORT = make_part(contours=4, spacing=5e-3, points=12)
LIFTED = "method: analytic\n  lift_every: 1"


@pytest.fixture(scope="module")
def job() -> JobFile:
    return quick_cone(LIFTED)


@pytest.fixture(scope="module")
def part(job: JobFile) -> PartRecord:
    """Two tools, corrected by its forces, its tool lifted after every contour to measure."""
    return in_process.form(job, RunOptions(variant=21, seed=7))


@pytest.fixture(scope="module")
def run(part: PartRecord, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("formed") / "my_run"
    write_bag(part, folder / "bag")
    return folder


@pytest.fixture(scope="module")
def formed(run: Path) -> CorrectedPlan:
    return as_formed(run)


def bag_of_part(record: PartRecord, folder: Path) -> Path:
    write_bag(record, folder / "bag")
    return folder


def g_code(made: CorrectedPlan, folder: Path) -> str:
    (file,) = exports.export(made.plan, folder / "part.nc")
    return file.read_text(encoding="ascii")


def closed(contours: Sequence[Contour], tool: int) -> np.ndarray:
    """(N, 3) m, tips as a machine runs them: every contour ends at its first point."""
    tips = [one.forming_tip if one.forming_tool == tool else one.support_tip for one in contours]
    return np.vstack([np.vstack([tip, tip[:1]]) for tip in tips])


def test_the_program_of_a_run_is_that_of_its_contours_as_they_were_formed(
    formed: CorrectedPlan, part: PartRecord, tmp_path: Path
) -> None:
    program = read_program(g_code(formed, tmp_path), name="part.nc", step=1.0)
    assert not program.unknown
    assert not program.findings
    tips = program.tips[np.isfinite(program.speed)]  # without rapid moves
    for tool, columns in ((1, tips[:, :3]), (2, tips[:, 3:])):
        assert np.abs(columns - closed(part.corrected, tool)).max() <= MICROMETRE
        assert np.abs(columns - closed(part.nominal, tool)).max() > 1e-3
    deepest = max(np.linalg.norm(step.offset, axis=1).max() for step in part.corrections)
    assert formed.corrected
    assert formed.largest == pytest.approx(deepest)
    assert 2e-3 < formed.largest < 10e-3


@pytest.mark.parametrize("form", ["iso", "iso_two_channels", "krl", "krl_roboteam", "pmac", "rapid"])
def test_every_format_holds_both_corrected_tools(
    form: str, formed: CorrectedPlan, part: PartRecord, tmp_path: Path
) -> None:
    files = exports.export(formed.plan, tmp_path / "part", form)
    post = exports.load_post(form)
    seen = set()
    for group in {re.sub(r"_\d{3}$", "", file.stem) for file in files}:
        mine = [file for file in files if re.sub(r"_\d{3}$", "", file.stem) == group]
        contours = exports.read_programs(mine, post)
        assert len(contours) == CONTOURS
        for contour, tips in zip(part.corrected, contours, strict=True):
            for tool, (wanted, got) in enumerate(
                zip((contour.forming_tip, contour.support_tip), tips, strict=True), start=1
            ):
                if np.isfinite(got).all():
                    seen.add(tool)
                    assert np.abs(got - wanted).max() <= MICROMETRE
    assert seen == {1, 2}
    for file in files:
        assert "corrected for springback by method analytic" in file.read_text(encoding="ascii")


def test_tables_hold_the_corrected_tips(formed: CorrectedPlan, part: PartRecord, tmp_path: Path) -> None:
    exports.export(formed.plan, tmp_path / "part.csv")
    for name, tool in (("top", 1), ("bot", 2)):
        table = 1e-3 * np.loadtxt(tmp_path / f"part_{name}ToolTipPnts.csv", delimiter=",", skiprows=1)
        tips = [one.forming_tip if one.forming_tool == tool else one.support_tip for one in part.corrected]
        assert np.abs(table - np.vstack(tips)).max() <= MICROMETRE


def test_it_travels_as_the_program_of_the_plan_does_without_the_lifts_that_measure(
    formed: CorrectedPlan, part: PartRecord, job: JobFile, tmp_path: Path
) -> None:
    """The tool was lifted after every contour of this part; line by line the programs differ in their numbers alone."""
    assert part.job().springback.lift_every == 1
    nominal = g_code(uncorrected(plan(job), job), tmp_path)

    def skeleton(text: str) -> list[str]:
        return [re.sub(r"-?\d+\.\d+", "#", line) for line in text.splitlines() if not line.startswith("(")]

    assert skeleton(g_code(formed, tmp_path)) == skeleton(nominal)


def test_the_head_tells_where_it_comes_from(formed: CorrectedPlan, part: PartRecord, tmp_path: Path) -> None:
    lines = g_code(formed, tmp_path).splitlines()
    head = lines[: next(k for k, line in enumerate(lines) if line.startswith("(contour 1 "))]
    told = " ".join(head)
    for words in (
        f"mini_cone {part.plan_id}",
        "as they were formed, corrected for springback by method analytic",
        "simulated, sheet: fast, variant 21, seed 7",
        "run my_run",
        "not in it: force control, compliance compensation, on-line correction",
    ):
        assert words in told
    assert all(line.startswith("(") and line.count("(") == 1 == line.count(")") for line in head[1:5])
    assert "formed on: real machine" in " ".join(_head_of(replace(SHORT, variant=-1), tmp_path / "real"))


def _head_of(record: PartRecord, folder: Path) -> tuple[str, ...]:
    return as_formed(bag_of_part(record, folder)).plan.origin


def test_what_a_bag_calls_its_part_cannot_become_a_word_of_the_program(tmp_path: Path) -> None:
    """Names come from whoever recorded the bag: no line break, no end of a comment, nothing but ASCII."""
    name = "part)\nG0 Z-50\n(\r%é{x1}" + 200 * "x"
    made = as_formed(bag_of_part(replace(SHORT, job_name=name, correction=name), tmp_path))
    lines = g_code(made, tmp_path).splitlines()
    assert sum(line.startswith("G0 Z") for line in lines) == 2  # to the first point, and away from the last
    assert [line for line in lines if "%" in line] == ["%", "%"]
    assert max(map(len, lines)) <= 102
    assert any("part] G0 Z-50 [ _?{x1}xxx" in line for line in lines)


def test_a_bag_alone_is_enough(part: PartRecord, tmp_path: Path) -> None:
    """Of a job with a rig of its own, which nobody has any more: only programs for robots need it."""
    text = part.job_text.replace("rig: ren2018", "rig: my_rig.yaml")
    assert text != part.job_text
    bag = tmp_path / "taken_along"
    write_bag(replace(part, job_text=text, base_folder=str(tmp_path / "gone")), bag)
    made = as_formed(bag)
    for contour, wanted in zip(made.plan.contours, part.corrected, strict=True):
        assert np.array_equal(contour.forming_tip, wanted.forming_tip)
    assert made.rig is None
    assert made.rig_lost is not None
    assert "--base" in made.rig_lost.advice
    (tmp_path / "my_rig.yaml").write_text("based_on: ren2018\nname: my_rig\n", encoding="utf-8")
    shutil.copyfile(FOLDER.parent / "parts" / "mini_cone.stl", tmp_path / "mini_cone.stl")
    found = as_formed(bag, base=tmp_path)
    assert found.rig is not None
    assert found.rig.name == "my_rig"


TORN = Event(int(EventKind.FRACTURE), 1.0, (0.01, 0.0, -0.004), 1.2, 1.0, "the sheet tore")


@pytest.mark.parametrize(
    ("record", "code", "left", "words"),
    [
        (make_part(contours=4, stop_after=2, spacing=5e-3, points=12), None, 2, "contour 3"),
        (replace(SHORT, events=(TORN,)), ErrorCode.SHEET_TORN, 4, "tore"),
        (replace(SHORT, corrected=SHORT.corrected[:1] + SHORT.corrected[2:]), ErrorCode.BAG_INCOMPLETE, 1, "contour 2"),
        (
            replace(SHORT, **{name: getattr(SHORT, name)[:3] for name in ("nominal", "corrected", "results")}),
            ErrorCode.BAG_INCOMPLETE,
            3,
            "3 of 4",
        ),
    ],
    ids=["stopped", "torn", "lost message", "recorder ended"],
)
def test_half_a_part_has_a_program_only_where_it_is_asked_for(
    record: PartRecord, code: ErrorCode | None, left: int, words: str, tmp_path: Path
) -> None:
    run = bag_of_part(record, tmp_path)
    with pytest.raises(IsfError, match=words) as caught:
        as_formed(run)
    assert caught.value.code == (code or record.results[-1].code)
    assert "--incomplete" in caught.value.advice
    made = as_formed(run, incomplete=True)
    assert len(made.plan.contours) == left
    assert f"INCOMPLETE: {left} of 4 contours" in made.plan.origin[0]
    assert f"{left} of 4 contours" in made.remarks[0]
    lines = g_code(made, tmp_path).splitlines()
    assert any(line.startswith("(INCOMPLETE: ") for line in lines)
    assert sum(line.startswith("(contour ") for line in lines) == left


def test_nothing_formed_is_no_program(tmp_path: Path) -> None:
    record = make_part(contours=4, stop_after=0, spacing=5e-3, points=12)
    with pytest.raises(IsfError):
        as_formed(bag_of_part(record, tmp_path), incomplete=True)


def test_contours_that_were_not_corrected_as_asked_are_told(tmp_path: Path) -> None:
    lost = replace(SHORT.corrections[2], code=int(ErrorCode.CORRECTION_LIMITED), message="12.0 mm requested")
    record = replace(SHORT, corrections=(*SHORT.corrections[:2], lost, SHORT.corrections[3]))
    (remark,) = as_formed(bag_of_part(record, tmp_path)).remarks
    assert "1 of 4 contours" in remark
    assert "contour 3: 12.0 mm requested" in remark


def test_a_part_formed_without_a_correction_says_so(tmp_path: Path) -> None:
    made = as_formed(bag_of_part(make_part(correction="none", contours=4, spacing=5e-3, points=12), tmp_path))
    assert not made.corrected
    assert made.largest == 0.0
    assert "without a correction for springback" in made.plan.origin[0]
    assert "isf tryout" in made.remarks[0]


def test_the_contours_as_they_were_planned(run: Path, part: PartRecord) -> None:
    made = as_formed(run, nominal=True)
    for contour, wanted in zip(made.plan.contours, part.nominal, strict=True):
        assert np.array_equal(contour.forming_tip, wanted.forming_tip)
    assert "NOT CORRECTED" in made.plan.origin[0]
    assert not made.corrected


def test_a_malformed_contour_of_a_bag_is_refused(tmp_path: Path) -> None:
    tip = SHORT.corrected[1].forming_tip.copy()
    tip[3, 2] = np.nan
    bad = replace(SHORT.corrected[1], forming_tip=tip)
    record = replace(SHORT, corrected=(SHORT.corrected[0], bad, *SHORT.corrected[2:]))
    with pytest.raises(IsfError, match=r"contour 2 .*not finite at point 3"):
        as_formed(bag_of_part(record, tmp_path))


def test_a_plan_file_keeps_corrections_and_where_they_come_from(formed: CorrectedPlan, tmp_path: Path) -> None:
    (file,) = exports.export(formed.plan, tmp_path / "formed.npz")
    copy = exports.load_plan(file)
    assert copy.origin == formed.plan.origin
    direct = g_code(formed, tmp_path)
    (again,) = exports.export(copy, tmp_path / "again.nc")
    assert again.read_text(encoding="ascii") == direct


@pytest.fixture(scope="module")
def learned_job(part: PartRecord, tmp_path_factory: pytest.TempPathFactory) -> JobFile:
    """The same cone with method learned, from the part before."""
    file = tmp_path_factory.mktemp("learned") / "cone.npz"
    learning.save(learn_record(part, FOLDER), file)
    return quick_cone(f"method: learned\n  learning: {file}")


def test_a_job_that_needs_no_measurement_is_exported_as_its_first_part_is_formed(learned_job: JobFile) -> None:
    """To the last bit, whatever force control measures of that part."""
    made = corrected_ahead(plan(learned_job), learned_job)
    record = in_process.form(learned_job, RunOptions(variant=3))
    assert made.corrected
    for contour, wanted in zip(made.plan.contours, record.corrected, strict=True):
        assert np.array_equal(contour.forming_tip, wanted.forming_tip)
        assert np.array_equal(contour.support_tip, wanted.support_tip)
        assert np.array_equal(contour.contact, wanted.contact)
    told = " ".join(made.plan.origin)
    assert "corrected for springback by method learned" in told
    assert "cone.npz, from: simulated, sheet: fast, variant 21, seed 7" in told
    assert not made.remarks


def test_scans_that_the_job_asks_for_change_nothing_before_the_first_one(learned_job: JobFile) -> None:
    scanning = learned_job.changed({"springback": {"scan_every": 1}})
    one, other = (corrected_ahead(plan(job), job) for job in (learned_job, scanning))
    for contour, wanted in zip(other.plan.contours, one.plan.contours, strict=True):
        assert np.array_equal(contour.forming_tip, wanted.forming_tip)
    assert not other.remarks


@pytest.mark.parametrize("springback", ["method: analytic", "method: elastic", "method: fused\n  scan_every: 1"])
def test_a_method_that_measures_leaves_the_plan_and_says_so(springback: str) -> None:
    job = quick_cone(springback)
    nominal = plan(job)
    made = corrected_ahead(nominal, job)
    assert not made.corrected
    assert made.plan.contours == nominal.contours
    assert "NOT CORRECTED" in made.plan.origin[0]
    (remark,) = made.remarks
    assert "NOT corrected for springback" in remark
    assert "isf tryout JOB" in remark


def test_a_job_without_a_correction_needs_no_warning() -> None:
    job = quick_cone("method: none")
    made = corrected_ahead(plan(job), job)
    assert made.remarks == ()
    assert "not corrected for springback" in made.plan.origin[0]


def test_a_correction_of_another_plan_is_refused(learned_job: JobFile) -> None:
    other = learned_job.changed({"path": {"incremental_depth": "1 mm"}})
    with pytest.raises(IsfError) as caught:
        corrected_ahead(plan(other), other)
    assert caught.value.code == ErrorCode.LEARNING_UNUSABLE


def test_a_correction_that_the_rig_cannot_follow_is_refused(learned_job: JobFile, tmp_path: Path) -> None:
    """The plan itself fits: 5 mm down, and the support tool below it."""
    reach = -min(one.support_tip[:, 2].min() for one in plan(learned_job).contours) + 1e-3
    rig = tmp_path / "low.yaml"
    text = f"based_on: ren2018\nname: low\nlimits: {{travel: [0.2 m, 0.2 m, {1e3 * reach:.3f} mm]}}\n"
    rig.write_text(text, encoding="utf-8")
    low = learned_job.changed({"rig": str(rig)})
    made = plan(low)
    with pytest.raises(IsfError, match="leave the travel") as caught:
        corrected_ahead(made, low)
    assert caught.value.code == ErrorCode.PART_DOES_NOT_FIT
