"""The report: every figure is in it, its numbers are those of the summary, and it needs nothing from elsewhere."""

from __future__ import annotations

import base64
import json
import re
from collections.abc import Iterator
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import pytest
from isf_analysis.figures import style
from isf_analysis.measures.record import PartRecord
from isf_analysis.measures.summary import summary
from isf_analysis.report.page import Report, write_report
from isf_analysis.report.result_tables import constants, number, percent
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile
from isf_core.geometry.height_map import HeightMap
from synthetic_part import make_part

PART = make_part(spacing=2.5e-3, contours=5)
REFERENCE = make_part(spacing=2.5e-3, contours=5, correction="none")

assert PART.target is not None
TARGET = PART.target

PNG = b"\x89PNG\r\n\x1a\n"


class Page(HTMLParser):
    """Pictures, links and text of an HTML page, and whether its tags are balanced."""

    VOID = ("meta", "img", "br", "link", "input")

    def __init__(self, html: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.pictures: list[str] = []
        self.addresses: list[str] = []
        self.text = ""
        self.feed(html)
        assert not self.open

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        values = dict(attributes)
        self.text += " "
        if tag not in self.VOID:
            self.open.append(tag)
        if tag == "img":
            assert values["alt"]
            self.pictures.append(str(values["src"]))
        self.addresses += [str(values[name]) for name in ("href", "src") if name in values]

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag
        self.text += " "

    def handle_data(self, data: str) -> None:
        if self.open[-1:] not in (["style"], ["script"]):
            self.text += data


@pytest.fixture(scope="module", autouse=True)
def _coarse_pictures() -> Iterator[None]:
    """A fifth of the pixels: people look at the pictures, these tests only at what is drawn."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(style, "DPI", 34)
        yield


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Report:
    return write_report(PART, tmp_path_factory.mktemp("report"), reference=REFERENCE, bag="runs/cone/bag")


def page_of(report: Report) -> Page:
    return Page(report.html.read_text(encoding="utf-8"))


def test_every_figure_is_beside_the_page_and_inside_it(report: Report) -> None:
    assert [path.stem for path in report.pictures] == [
        "deviation_compare",
        "deviation_map",
        "section_x",
        "section_y",
        "histogram",
        "regions",
        "error_split",
        "corrections",
        "support_force",
        "contact",
        "forming_force",
    ]
    inside = [base64.b64decode(source.removeprefix("data:image/png;base64,")) for source in page_of(report).pictures]
    assert inside == [path.read_bytes() for path in report.pictures]
    assert all(picture.startswith(PNG) for picture in inside)


def test_the_page_needs_nothing_from_elsewhere(report: Report) -> None:
    assert all(address.startswith("data:") for address in page_of(report).addresses)
    html = report.html.read_text(encoding="utf-8")
    own = re.sub(r"base64,[A-Za-z0-9+/=]+|>[A-Za-z0-9+/=]{200,}<", "", html)
    assert not re.search(r"https?://|@import|url\(|<script[^>]+src=", own)


def test_the_numbers_on_the_page_are_those_of_the_summary(report: Report) -> None:
    numbers = summary(PART, REFERENCE, bag="runs/cone/bag", report=report.html)
    assert report.numbers == numbers
    assert json.loads((report.html.parent / "summary.json").read_text()) == numbers
    text = " ".join(page_of(report).text.split())
    before, after = numbers["reference"]["deviation"], numbers["deviation"]
    assert f"{before['max_mm']:.2f} → {after['max_mm']:.2f} mm" in text
    assert f"{before['mean_abs_mm']:.2f} → {after['mean_abs_mm']:.2f} mm" in text
    assert "5 of 5 contours formed" in text
    assert "Late control ticks 3" in text
    assert f"{numbers['force']['p999_abs_error_N']:.1f} N" in text
    for region in ("wall", "base", "rim", "flange"):
        for key in ("max_mm", "mean_abs_mm", "rms_mm"):
            assert f"{after['regions'][region][key]:.2f}" in text
            assert f"{before['regions'][region][key]:.2f}" in text
        for shape in (before, after):
            for share in ("0_1mm", "0_2mm", "0_3mm", "tolerance"):
                assert percent(shape["regions"][region][f"within_{share}_fraction"], digits=1) in text
            for value in shape["regions"][region]["table2"].values():
                assert number(value) in text
    assert f"{numbers['time']['planned_s']:.1f} s" in text
    assert "Thickness by: estimate from the scan; the blank is 1.00 mm thick" in text
    assert f"thinnest place {numbers['sheet_thickness']['thinnest']['thickness_mm']:.2f} –" in text
    assert "Forming is played by its button or the space key" in text


def test_constants_come_with_unit_and_source(report: Report) -> None:
    text = " ".join(page_of(report).text.split())
    assert "young_modulus 70 GPa published: Ren 2018" in text
    assert "contact_stiffness 0.45 N/um published: Ren 2018" in text
    assert "limits.speed 100 mm/s assumed" in text
    assert "incremental_depth: 0.5 mm" in text  # the job file itself
    assert "simulated machine" in text


NAMED_JOB = """
name: named
part: {mesh: part.stl, unit: mm}
process: SPIF
rig: ren2018
sheet: {material: AA1050, thickness: 1 mm}
tool_1: spif_a_flat_10
backing_plate: spif_a_round_90
path: {incremental_depth: 1 mm, point_spacing: 1 mm, feed: 40 mm/s}
"""


def test_constants_of_library_tools_and_plates_are_shown_while_they_are_those_of_the_job(tmp_path: Path) -> None:
    text = JobFile(NAMED_JOB, tmp_path).text
    shown = constants(replace(PART, job_text=text))
    assert "Upper tool spif_a_flat_10: constants and their sources" in shown
    assert "Backing plate spif_a_round_90: constants and their sources" in shown
    assert "published: Torrao 2013, Table 3.8" in shown
    changed = constants(replace(PART, job_text=text.replace("radius: 5 mm", "radius: 6 mm")))
    assert "Upper tool" not in changed
    assert "Backing plate" in changed


CASES: dict[str, tuple[PartRecord, set[str], str]] = {
    "without reference": (PART, {"deviation_compare"}, "No reference"),
    "without force control": (
        make_part(spacing=2.5e-3, contours=3, process="SPIF", support_force=0.0, correction="none"),
        {"deviation_compare", "corrections", "support_force", "contact"},
        "no force control in this part",
    ),
    "position control": (
        make_part(spacing=2.5e-3, contours=3, support_force=0.0, correction="none"),
        {"deviation_compare", "corrections"},
        "position controlled",
    ),
    "stopped": (make_part(spacing=2.5e-3, contours=5, stop_after=3), {"deviation_compare"}, "Part not complete"),
    "stopped at once": (
        make_part(spacing=2.5e-3, contours=5, stop_after=0),
        {"deviation_compare", "error_split"},
        "0 of 5 contours formed",
    ),
    "without scan": (
        replace(PART, scan=None, notes=("not in the bag: scan",)),
        {"deviation_compare", "deviation_map", "section_x", "section_y", "histogram", "regions", "error_split"},
        "No shape to compare",
    ),
    "another CAD": (
        replace(PART, target=HeightMap(TARGET.x + 9.0, TARGET.y, TARGET.z)),
        {"deviation_compare", "deviation_map", "section_x", "section_y", "histogram", "regions", "error_split"},
        "scan and wanted shape are not compared: scan and target have no point in common",
    ),
    "flat CAD": (
        replace(PART, target=HeightMap(TARGET.x, TARGET.y, 0.0 * TARGET.z)),
        {"deviation_compare", "deviation_map", "section_x", "section_y", "histogram", "regions", "error_split"},
        "the target is flat",
    ),
    "without corrections": (replace(PART, corrections=()), {"deviation_compare", "corrections"}, "Part complete"),
    "without results": (
        replace(PART, results=()),
        {"deviation_compare", "error_split", "support_force", "contact", "forming_force"},
        "Part not complete",
    ),
    "material of the user": (
        replace(PART, job_text=PART.job_text.replace("AA5754-O", "mine.yaml")),
        {"deviation_compare"},
        "constants of material and rig are not shown",
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_a_report_of_less_has_the_rest_and_says_so(case: str, report: Report, tmp_path: Path) -> None:
    part, missing, words = CASES[case]
    less = write_report(part, tmp_path / "report")
    assert {path.stem for path in report.pictures} - {path.stem for path in less.pictures} == missing
    page = page_of(less)
    assert len(page.pictures) == len(less.pictures)
    assert words in " ".join(page.text.split())


def test_a_part_that_ended_early_says_so_before_any_number(tmp_path: Path) -> None:
    html = write_report(make_part(spacing=2.5e-3, contours=5, stop_after=3), tmp_path).html.read_text(encoding="utf-8")
    banner = html.index("1201 WRENCH_NOT_FINITE")
    assert banner < html.index('<div class="cards">')


def test_a_failure_that_no_message_carried_is_reported_too(tmp_path: Path) -> None:
    died = IsfError(ErrorCode.NODE_DIED, "node 'springback' no longer responds")
    report = write_report(replace(PART, scan=None), tmp_path, failure=died)
    assert not report.numbers["complete"]
    assert "1502 NODE_DIED: node 'springback' no longer responds" in " ".join(page_of(report).text.split())


def test_what_a_job_says_is_text_not_markup(tmp_path: Path) -> None:
    evil = replace(PART, job_name="<b>$x</b>", job_text="name: <script>alert(1)</script>", notes=("<i>",), scan=None)
    html = write_report(evil, tmp_path).html.read_text(encoding="utf-8")
    assert "<script>alert" not in html
    assert "&lt;b&gt;$x&lt;/b&gt;" in html


def test_progress_is_reported_for_every_figure(tmp_path: Path) -> None:
    reported: list[str] = []
    report = write_report(make_part(contours=2, spacing=4e-3), tmp_path, progress=reported.append)
    assert sum(text.startswith("figure: ") for text in reported) == len(report.pictures)


def test_a_folder_that_cannot_be_made_is_reported(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(IsfError) as caught:
        write_report(replace(PART, scan=None, results=(), corrections=()), tmp_path / "file" / "report")
    assert caught.value.code == ErrorCode.FILE_NOT_WRITABLE


def test_the_style_is_not_left_behind(tmp_path: Path) -> None:
    import matplotlib as mpl

    before: dict[str, Any] = dict(mpl.rcParams)
    write_report(make_part(contours=2, spacing=4e-3), tmp_path)
    assert dict(mpl.rcParams) == before
