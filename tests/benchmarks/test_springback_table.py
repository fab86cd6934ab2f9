"""The springback table: rows by content, resumed, and told with what they can and cannot show."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from isf_analysis.measures.deviation import compare
from isf_cell.campaign import content
from isf_cell.campaign.rows_file import append_row, read_rows
from isf_cell.options import RunOptions
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile
from isf_core.geometry.height_map import HeightMap
from isf_sim.variant import make_variant

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"


@pytest.fixture(scope="module")
def table() -> Iterator[ModuleType]:
    sys.path.insert(0, str(BENCHMARKS))
    yield importlib.import_module("springback_table")
    sys.path.remove(str(BENCHMARKS))


def row(
    job: str, method: str, world: int, largest: float, region: str = "wall_and_base", **more: Any
) -> dict[str, Any]:
    numbers = {"max": largest, "mean": 0.3 * largest, "signed": 0.0, "p95": 0.8 * largest, "share": 0.5}
    name = f"{job}{method}{world}"
    made = {"key": name, "job": job, "method": method, "world": world, "sources": "s", "code": 0, "message": ""}
    return {**made, "contours": 5, "planned": 5, "cpu_s": 1.0, region: numbers, **more}


def pan(depth: float, lift: float = 0.0) -> HeightMap:
    """A round pan of ``depth`` m with walls of 45 deg, its inside ``lift`` m too high."""
    axis = np.linspace(-30e-3, 30e-3, 121)
    gx, gy = np.meshgrid(axis, axis)
    z = -np.clip(25e-3 - np.hypot(gx, gy), 0.0, depth)
    return HeightMap(axis, axis, z + lift * (z < 0))


def test_worlds_are_numbers_and_ranges(table: ModuleType) -> None:
    rows = table.springback_rows
    assert rows.worlds(["0,1-3"]) == [0, 1, 2, 3]
    assert rows.worlds(["2", "1-2"]) == [2, 1]
    with pytest.raises(ValueError, match="invalid literal"):
        rows.worlds(["all"])


def test_a_row_is_named_by_job_method_world_and_sources(table: ModuleType) -> None:
    rows, case = table.springback_rows, table.Case("mini_cone", "none", 0)
    job_file, _ = table.job_of(case)
    name = rows.key(case, job_file, "a")
    assert name == rows.key(case, table.job_of(case)[0], "a")
    changed = table.job_of(case)[0]
    changed.job = changed.job.model_copy(update={"wall_angle_limit": 1.0})
    others = [
        rows.key(replace(case, world=1), job_file, "a"),
        rows.key(replace(case, method="analytic"), job_file, "a"),
        rows.key(case, job_file, "b"),
        rows.key(case, changed, "a"),
    ]
    assert len({name, *others}) == 5


def test_a_row_stays_when_only_a_node_changes(
    table: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """A part of a row is formed in one process, without nodes."""
    for name in ("__init__", "core", "node", "node_outlet", "load_cell_node", "nodes_of_mesh"):
        (tmp_path / f"{name}.py").write_text("")
    monkeypatch.setattr(content, "source_file", lambda _: tmp_path / "__init__.py")
    before = content.sources()
    for name in ("node", "node_outlet", "load_cell_node"):
        (tmp_path / f"{name}.py").write_text("changed")
    assert content.sources() == before
    found = {before}
    for name in ("core", "nodes_of_mesh"):
        (tmp_path / f"{name}.py").write_text("changed")
        found.add(content.sources())
    assert len(found) == 3


def test_a_campaign_goes_on_behind_a_row_that_a_stop_cut_off(table: ModuleType, tmp_path: Path) -> None:
    path = tmp_path / "rows.jsonl"
    cases = table.cases_of(["ren_cone"], ["none", "analytic"], [0, 1])
    todo = table.missing(cases, {}, "s")
    assert [case for case, _ in todo] == cases
    append_row(path, {**row("ren_cone", "none", 0, 1.0), "key": todo[0][1]})
    with path.open("a", encoding="utf-8") as file:
        file.write('{"key": "cut o')
    append_row(path, {**row("ren_cone", "analytic", 0, 1.0), "key": todo[1][1]})
    left = table.missing(cases, read_rows(path), "s")
    assert [case for case, _ in left] == [case for case in cases if case.world == 1]
    assert len(table.missing(cases, read_rows(path), "other sources")) == len(cases)


def test_large_parts_stay_in_the_nominal_world_unless_named(table: ModuleType) -> None:
    def worlds_of(parts: list[str] | None) -> set[int]:
        return {case.world for case in table.cases_of(parts, ["none"], [0, 1]) if case.job == "praveen_cone_610"}

    assert worlds_of(None) == {0}
    assert worlds_of(["praveen_cone_610"]) == {0, 1}
    assert {case.world for case in table.cases_of(None, ["none"], [0, 1]) if case.job == "ren_cone"} == {0, 1}


def test_numbers_of_a_shape_are_those_of_its_regions(table: ModuleType) -> None:
    target = pan(8e-3)
    found = table.springback_rows.measures(compare(pan(8e-3, 0.25e-3), target))
    assert found["base"]["max"] == pytest.approx(0.25, abs=1e-3)
    assert found["base"]["share"] == 1.0
    assert found["walls_base"]["signed"] == pytest.approx(0.25, abs=1e-2)
    worse = table.springback_rows.measures(compare(pan(8e-3, 0.5e-3), target))
    assert worse["base"]["share"] == 0.0


def test_median_and_worst_world_leave_the_nominal_one_out(table: ModuleType) -> None:
    rows = [row("ren_cone", "analytic", world, largest) for world, largest in enumerate((9.0, 0.4, 0.5, 1.4))]
    (line,) = [text for text in table.springback_page.table(rows).splitlines() if "analytic" in text]
    cells = [cell.strip() for cell in line.strip("|").split("|")]
    assert cells[2] == "0 and 3"
    assert cells[3].startswith("9.00 / ")
    assert cells[4].startswith("0.50 / ")
    assert cells[5].startswith("1.40 / ")
    assert "max 0.60 met; 1.20 missed" in cells[6]


def test_a_part_that_ended_early_is_reported_and_meets_no_worst_goal(table: ModuleType) -> None:
    whole = row("lu_cone", "mpc_vertical", 1, 0.1, "base")
    ended = row("lu_cone", "mpc_vertical", 2, 0.1, "base", code=1203, contours=3)
    (line,) = [text for text in table.springback_page.table([whole, ended]).splitlines() if "mpc" in text]
    assert "3 of 5 contours, code 1203" in line
    assert "max 0.15 met; 0.25 missed" in line


def test_the_worst_share_is_the_smallest(table: ModuleType) -> None:
    rows = [row("lu_tpif", "mpc_tpif", world, 1.0) for world in (1, 2)]
    rows[0]["wall_and_base"]["share"], rows[1]["wall_and_base"]["share"] = 0.95, 0.70
    (line,) = [text for text in table.springback_page.table(rows).splitlines() if "mpc" in text]
    assert "share 90 % missed; 80 % missed" in line
    assert "70 % / 1.00" in line


def test_page_without_rows_is_written_and_says_so(table: ModuleType, tmp_path: Path) -> None:
    page = table.springback_page.write([], "digest", tmp_path / "maps", tmp_path)
    assert "None yet." in page.read_text(encoding="utf-8")


def test_the_rows_of_the_page_stand_beside_it(table: ModuleType, tmp_path: Path) -> None:
    rows = [row("ren_cone", "none", 1, 2.0), row("ren_cone", "none", 0, 1.0)]
    page = table.springback_page.write(rows, "digest", tmp_path / "maps", tmp_path)
    kept = read_rows(page.with_suffix(".jsonl"))
    assert list(kept.values()) == rows[::-1]
    assert page.with_suffix(".jsonl").name in page.read_text(encoding="utf-8")


def test_rows_on_the_elasto_plastic_sheet_have_a_page_of_their_own(table: ModuleType, tmp_path: Path) -> None:
    def shell(world: int, largest: float, **more: object) -> dict[str, object]:
        values = row("ren_cone", "none", world, largest, **more)
        errors = {"max": largest, "mean": 0.5, "signed": -0.25}
        return {**values, "sheet": "shell_coarse", "elements": 2304, "kinetic_over_plastic": 0.004, "rim": errors}

    rows = [shell(0, 5.0), shell(101, 6.0), shell(102, 7.0), shell(103, 9.0, code=1203, contours=3)]
    page = table.springback_page.write_shell(rows, tmp_path / "maps", tmp_path)
    text = page.read_text(encoding="utf-8")
    (line,) = [text for text in text.splitlines() if text.startswith("| ren_cone")]
    cells = [cell.strip() for cell in line.strip("|").split("|")]
    assert cells[2] == "5.7 / 3.1"  # published, Ren 2018, 4.3
    assert cells[3].startswith("5.00 / ")
    assert cells[5] == "5.00 / 0.50 / -0.25"
    # of those that were formed whole; the mean error of a row is 0.3 of its largest
    assert cells[6] == "6.50 / 1.95 of 2; 7.00 / 2.10, worst; 103: ended at contour 3 of 5, 1203"
    assert cells[7] == "shell_coarse, 2304 elements, kinetic / plastic 0.40 %, 1 s of CPU"
    taken = table.springback_page.shell_table([shell(0, 5.0, force_N=2500.0, rig_N=2000.0)])
    assert taken.rstrip(" |").endswith("1 s of CPU, up to 1.25 of the force that the rig bears")
    ended = table.springback_page.shell_table([shell(0, 5.0, code=1405, contours=2)])
    assert "| ended at contour 2 of 5, 1405 | - | - |" in ended
    assert len(read_rows(page.with_suffix(".jsonl"))) == 4
    assert len(table.springback_rows.latest([*rows, row("ren_cone", "none", 0, 1.0)])) == 5  # a row of each sheet


def test_a_case_on_another_sheet_has_a_row_and_a_rate_of_its_own(table: ModuleType) -> None:
    fast, shell = table.Case("mini_cone", "none", 0), table.Case("mini_cone", "none", 0, "shell_coarse")
    assert len({name for _, name in table.missing([fast, shell], {}, "digest")}) == 2
    assert [table.job_of(case)[0].job.control.rate for case in (fast, shell)] == [500.0, 100.0]


def test_the_command_of_the_page_leaves_out_what_the_sheet_cannot(table: ModuleType) -> None:
    """Methods with a push, unless they are asked for by name."""

    def methods(sheet: str) -> set[str]:
        return {case.method for case in table.cases_of(["ren_cone"], None, [0], sheet)}

    assert "fused(elastic)+push" in methods("fast")
    assert methods("shell_coarse") == methods("fast") - {"fused(elastic)+push"}


def test_a_push_on_another_sheet_is_refused(table: ModuleType, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        table.main(["--sheet", "shell", "--parts", "ren_cone", "--methods", "elastic+push"])
    assert "pushed on the fast one alone" in capsys.readouterr().err


@pytest.mark.slow
def test_small_part_from_run_to_page(table: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """mini_cone twice: the second time nothing is left to compute."""
    parts = {"mini_cone": replace(table.PARTS["ren_cone"], methods=("none", "analytic"))}
    monkeypatch.setattr(table, "PARTS", parts)
    monkeypatch.setattr(table.springback_page, "PARTS", parts)
    monkeypatch.setattr(table, "sources", lambda: "as they are")  # they may change while a test runs
    words = ["--parts", "mini_cone", "--rows", str(tmp_path / "rows.jsonl"), "--page", "--folder", str(tmp_path)]
    assert table.main(words) == 0
    kept = (tmp_path / "rows.jsonl").read_text(encoding="utf-8")
    assert len(kept.splitlines()) == 2
    assert (tmp_path / "images" / "springback_mini_cone.png").is_file()
    assert table.main(words) == 0
    assert (tmp_path / "rows.jsonl").read_text(encoding="utf-8") == kept


@pytest.mark.parametrize("benchmark", ["springback", "springback_rows"])
def test_both_tables_form_the_standard_worlds(
    benchmark: str, table: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[RunOptions] = []

    def form(job_file: JobFile, options: RunOptions) -> None:
        asked.append(options)
        raise IsfError(ErrorCode.CANCELLED, "far enough")

    module = importlib.import_module(benchmark)
    monkeypatch.setattr(module.in_process, "form", form)
    more = () if benchmark == "springback" else ("key", "digest", tmp_path)
    with suppress(IsfError):
        module.run(table.Case("mini_cone", "none", 3), *more)
    (options,) = asked
    assert make_variant(options.variant, options.seed) == make_variant(3)
