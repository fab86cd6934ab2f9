"""``isf report``: one JSON object, whatever fails, and the numbers that scripts look for."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from isf_analysis.bag.bag_writer import write_bag
from isf_analysis.figures import style
from isf_analysis.measures.record import PartRecord
from isf_analysis.measures.summary import deviation_of, summary
from isf_cell.commands import report
from isf_cell.commands.exit_codes import Exit, ReportedError, exit_for
from isf_cell.commands.tryout import Trial, _row
from isf_cell.replay.outcome import part_numbers
from isf_core.errors import IsfError
from isf_core.geometry.height_map import HeightMap
from synthetic_part import make_part

PART = make_part(contours=2, spacing=5e-3, points=12)


def reported(part: PartRecord, folder: Path) -> None:
    write_bag(part, folder / "run" / "bag")
    report.report_bag(folder / "run", None, None, folder / "shape", as_json=True)


def test_an_export_without_a_scan_is_one_object_with_the_failure(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(style, "DPI", 34)
    told: list[str] = []
    monkeypatch.setattr(report.terminal, "say", told.append)
    monkeypatch.setattr(report, "how_to_go_on", lambda _: "the part can go on")
    with pytest.raises(ReportedError) as caught:
        reported(replace(PART, scan=None), tmp_path)
    assert exit_for(caught.value.code) == Exit.ANALYSIS
    printed = json.loads(capsys.readouterr().out)
    assert printed["error"]["name"] == "BAG_INCOMPLETE"
    assert "not scanned" in printed["error"]["message"]
    assert printed["complete"]
    assert told[-1] == "the part can go on"
    assert "error" not in json.loads((tmp_path / "run" / "summary.json").read_text())
    assert (tmp_path / "run" / "report.html").is_file()


def test_a_report_with_its_shape(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(style, "DPI", 34)
    reported(PART, tmp_path)
    assert "error" not in json.loads(capsys.readouterr().out)
    assert (tmp_path / "shape" / "formed.ply").is_file()


@pytest.mark.parametrize("output", ["out", "some/new/out"])
def test_a_report_that_is_refused_leaves_no_empty_folder(output: str, tmp_path: Path) -> None:
    (tmp_path / "kept").mkdir()
    (tmp_path / "bag").mkdir()  # holds no bag
    for folder in (tmp_path / output, tmp_path / "kept"):
        with pytest.raises(IsfError, match="holds no bag"):
            report.report_bag(tmp_path / "bag", None, folder, as_json=False)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["bag", "kept"]


@pytest.mark.parametrize(
    ("unseen", "shown"), [(slice(0), None), (slice(None, 24), r"6\d\.\d %"), (slice(None), r"0\.0 %")]
)
def test_the_terminal_tells_how_much_was_measured_where_it_is_not_all(
    unseen: slice, shown: str | None, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of 51 rows, 17 of them over the part, the first 24 unknown, or all but the flange of the last three."""
    assert PART.scan is not None
    z = PART.scan.z.copy()
    z[unseen] = np.nan
    z[-3:] = 0.0
    report.terminal.show_summary(summary(replace(PART, scan=HeightMap(PART.scan.x, PART.scan.y, z))), None)
    said = "".join(capsys.readouterr())
    row = re.search(r"measured share of wall and base\D*([\d.]+ %)", said)
    assert (row is None) == (shown is None)
    assert row is None or re.fullmatch(str(shown), row.group(1))


@pytest.mark.parametrize("name", ["part.nc", "part.mpf", "PART.SRC"])
def test_a_program_is_not_what_the_shape_is_exported_as(name: str, tmp_path: Path) -> None:
    """It would become a folder of that name: the command that writes programs of runs is told, and nothing is made."""
    run = tmp_path / "run"
    write_bag(PART, run / "bag")
    with pytest.raises(IsfError, match="is no folder") as caught:
        report.report_bag(run, None, None, tmp_path / name, as_json=False)
    assert exit_for(caught.value.code) == Exit.INPUT
    assert f"isf plan RUN --export {name}" in caught.value.advice
    assert not (tmp_path / name).exists()
    assert not (run / "report.html").exists()


def test_a_section_that_cannot_be_drawn_leaves_the_report_as_it_was(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(style, "DPI", 34)
    run = tmp_path / "run"
    write_bag(PART, run / "bag")
    for sections in (("y=nowhere",), ("x=0", "y=500")):
        with pytest.raises(IsfError, match="--section") as caught:
            report.report_bag(run, None, None, sections=sections, as_json=False)
        assert exit_for(caught.value.code) == Exit.INPUT
        assert not (run / "report.html").exists()
    report.report_bag(run, None, None, sections=("x=0",), as_json=False)
    assert (run / "section_at_x_0mm.png").is_file()


def test_the_published_band_stays_beside_the_tolerance_of_the_job() -> None:
    """0.31 mm too high all over, in a job that allows 0.32 mm."""
    target = PART.target
    assert target is not None
    high = HeightMap(target.x, target.y, target.z + 0.31e-3)
    part = replace(PART, scan=high, job_text="tolerance: {shape: 0.32 mm}\n")
    shape = deviation_of(part)
    assert shape is not None
    for numbers in (part_numbers(part), _row(Trial("first", 0, part, shape))):
        assert numbers["within_tolerance_fraction"] == 1.0
        assert numbers["within_0_3mm_fraction"] == 0.0
