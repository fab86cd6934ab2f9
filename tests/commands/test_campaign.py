"""``isf campaign``: a table that goes on where it was, says what is stale, and refuses what it cannot use."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from isf_analysis.measures.campaign_row import CampaignRow
from isf_analysis.measures.summary import summary
from isf_analysis.report.campaign_page import campaign_page
from isf_cell import in_process
from isf_cell.campaign.cases import cases_of
from isf_cell.campaign.content import job_content
from isf_cell.commands.campaign import run_campaign
from isf_cell.options import RunOptions
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.campaign import CampaignFile, variant_numbers
from isf_core.files.job import JobFile, load_job
from isf_springback.database.database import database_of
from quick_cone import FOLDER, quick_cone_file


def campaign(folder: Path, methods: str = "[none, analytic]", more: str = "") -> Path:
    quick_cone_file(folder, step="2.5 mm")
    path = folder / "small.yaml"
    path.write_text(f"name: small\njobs: [quick_cone.yaml]\nmethods: {methods}\n{more}", encoding="utf-8")
    return path


def run(path: Path, capsys: pytest.CaptureFixture[str]) -> tuple[dict[str, Any], str]:
    run_campaign(path, path.parent / "out", 2, as_json=True)
    shown = capsys.readouterr()
    return json.loads(shown.out), shown.err


def test_a_campaign_goes_on_and_forms_a_changed_job_again(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = campaign(tmp_path)
    first, _ = run(path, capsys)
    rows_file, page = tmp_path / "out" / "rows.jsonl", tmp_path / "out" / "campaign.html"
    assert (first["parts"], first["whole"], first["stale"]) == (2, 2, 0)
    with (tmp_path / "out" / "campaign.csv").open(encoding="utf-8") as file:
        table = {row["method"]: row for row in csv.DictReader(file)}
    alone = summary(in_process.form(load_job(tmp_path / "quick_cone.yaml"), RunOptions(correction="none")))
    assert float(table["none"]["max_mm"]) == pytest.approx(alone["deviation"]["max_mm"], abs=1e-4)
    assert "analytic" in page.read_text(encoding="utf-8")
    kept = rows_file.read_bytes()
    lines = kept.splitlines(keepends=True)
    rows_file.write_bytes(lines[0] + lines[1][:40])  # as a kill leaves it
    again, told = run(path, capsys)
    assert "1 of 2 parts are there" in told
    assert [item["nominal_max_mm"] for item in again["methods"]] == [i["nominal_max_mm"] for i in first["methods"]]
    job = tmp_path / "quick_cone.yaml"
    job.write_text(job.read_text("utf-8").replace("thickness: 1.0 mm", "thickness: 3.5 mm"), encoding="utf-8")
    changed, told = run(path, capsys)
    assert changed["stale"] == 2
    assert "formed again" in " ".join(told.split())
    assert changed["whole"] == 0  # the machine does not bear this sheet
    assert all(item["codes"] for item in changed["methods"])


def test_what_is_equal_is_formed_once_and_has_a_row_by_every_name(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = campaign(tmp_path, "[none, {name: plain, change: {springback: {method: none}}}]")
    job = tmp_path / "quick_cone.yaml"
    (tmp_path / "copy.yaml").write_text(job.read_text(encoding="utf-8"), encoding="utf-8")
    path.write_text(path.read_text(encoding="utf-8").replace("[quick_cone.yaml]", "[quick_cone.yaml, copy.yaml]"))
    names = [(case, method) for case in ("quick_cone", "copy") for method in ("none", "plain")]
    rows_file = tmp_path / "out" / "rows.jsonl"
    made, told = run(path, capsys)
    assert "0 of 4 parts are there" in told
    (line,) = rows_file.read_text(encoding="utf-8").splitlines()
    rows_file.write_text("".join(json.dumps(json.loads(line) | {"job": j, "method": m}) + "\n" for j, m in names))
    again, told = run(path, capsys)  # as it was written when every name was formed for itself
    assert "4 of 4 parts are there" in told
    for data in (made, again):
        assert (data["formed"], data["whole"]) == (4, 4)
        assert [(item["job"], item["method"]) for item in data["methods"]] == names
        assert len({item["nominal_max_mm"] for item in data["methods"]}) == 1
        with (tmp_path / "out" / "campaign.csv").open(encoding="utf-8") as file:
            assert [(row["job"], row["method"]) for row in csv.DictReader(file)] == names


def test_the_database_of_a_job_is_made_before_its_parts_whatever_its_other_methods(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ISF_CACHE_DIR", str(tmp_path / "cache"))
    made, _ = run(campaign(tmp_path, "[elastic, none]"), capsys)
    assert made["whole"] == 2
    assert database_of(load_job(tmp_path / "quick_cone.yaml")) is not None


@pytest.mark.parametrize(
    ("methods", "more", "code", "said"),
    [
        ("[nothing]", "", ErrorCode.METHOD_UNKNOWN, "no springback method"),
        ("[none, none]", "", ErrorCode.FILE_FIELD, "stands there twice"),
        ("[none]", "variants: [5-1]", ErrorCode.FILE_FIELD, "no range"),
        ("[none]", "sheets: [slow]", ErrorCode.FILE_FIELD, "sheets.1: Input should be 'fast'"),
        ("[none]", "sheets: []", ErrorCode.FILE_FIELD, "sheets: Tuple should have at least 1 item"),
        ("[none]", "variant: [1]", ErrorCode.FILE_FIELD, "did you mean 'variants'"),
        ("[{name: a, change: {sheet: {thickness: 1}}}]", "", ErrorCode.FILE_UNIT, "thickness"),
    ],
)
def test_what_cannot_be_used_is_refused_before_anything_is_formed(
    tmp_path: Path, methods: str, more: str, code: ErrorCode, said: str
) -> None:
    with pytest.raises(IsfError, match=said) as caught:
        run_campaign(campaign(tmp_path, methods, more), tmp_path / "out", 1, as_json=False)
    assert caught.value.code == code
    assert "small.yaml" in caught.value.where
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("job", "change", "named"),
    [
        ("mini_cone", {"part": {"accuracy_surfaces": "named.npz"}, "springback": {"method": "none"}}, "named.npz"),
        ("adsif_cone", {"adsif": {"surface": "named.yaml"}}, "named.yaml"),
    ],
)
def test_the_content_of_a_job_is_that_of_the_files_it_names(
    tmp_path: Path, job: str, change: dict[str, Any], named: str
) -> None:
    changed = load_job(FOLDER / f"{job}.yaml").changed(change)
    text = changed.text.replace("../parts", str(FOLDER.parent / "parts"))
    contents = []
    for content in (None, b"one", b"two", b"one"):
        if content is not None:
            (tmp_path / named).write_bytes(content)
        contents.append(job_content(JobFile(text, tmp_path)))
    assert contents[1] == contents[3]
    assert len(set(contents)) == 3


def test_variants_are_numbers_and_ranges() -> None:
    assert variant_numbers([0, "1-3", "2,5"]) == (0, 1, 2, 3, 5)
    root = Path(__file__).resolve().parents[2]
    assert CampaignFile(root / "examples" / "campaigns" / "mini_cone.yaml").campaign.variants == (0, 1, 2)


def test_where_no_sheet_is_named_each_job_is_formed_on_its_own(tmp_path: Path) -> None:
    path = tmp_path / "two.yaml"
    jobs = ", ".join(str(FOLDER / f"{name}.yaml") for name in ("ren_cone", "ren_cone_on_blank"))
    path.write_text(f"name: two\njobs: [{jobs}]\nmethods: [none]\n", encoding="utf-8")
    chosen = {case.row.job: case.row.sheet for case in cases_of(CampaignFile(path), "")}
    assert chosen == {"ren_cone": "fast", "ren_cone_on_blank": "shell_coarse"}
    path.write_text(path.read_text(encoding="utf-8") + "sheets: []\n", encoding="utf-8")
    with pytest.raises(IsfError, match="sheets"):
        CampaignFile(path)


def test_a_whole_part_beyond_its_machine_is_told_on_the_page() -> None:
    rows = [
        CampaignRow("cone", "none", variant, 0, "shell_coarse", str(variant), "s", "1", max_mm=1.0, message=message)
        for variant, message in ((0, "contour 2: tool 1 took <2560 N>"), (1, ""))
    ]
    assert [row.overload for row in rows] == ["contour 2: tool 1 took <2560 N>", ""]
    assert replace(rows[0], code=1405).overload == ""
    page = campaign_page("small", rows, 2, "name: small", 1, None)
    assert "1 whole part(s) took more force than their machine bears" in page
    assert "contour 2: tool 1 took &lt;2560 N&gt;" in page
    assert "took more force" not in campaign_page("small", rows[1:], 1, "name: small", 1, None)


def test_parts_worse_than_expected_are_counted_by_method_and_those_that_cannot_tell_in_none() -> None:
    def row(variant: int, reached: float, expected: float | None, code: int = 0) -> CampaignRow:
        known = {"max_mm": reached, "expected_max_mm": expected, "expected_mean_mm": expected and 0.5 * expected}
        return CampaignRow("cone", "elastic", variant, 0, "fast", str(variant), "s", "1", code=code, **known)

    rows = [row(0, 1.4, 1.0), row(1, 1.6, 1.0), row(2, 9.0, None), row(3, 9.0, 1.0, code=1405)]
    assert [row.overconfident for row in rows] == [False, True, False, False]
    assert [row.reached_over_expected for row in rows] == [1.4, 1.6, None, None]
    page = campaign_page("small", rows, 4, "name: small", 1, None)
    assert '<td class="n">1 of 2</td>' in page
    silent = [replace(row, expected_max_mm=None, expected_mean_mm=None) for row in rows]
    page = campaign_page("small", silent, 4, "name: small", 1, None)
    assert "not known" in page
    assert "0 of" not in page.split("Methods side by side")[1].split("</table>")[0]
