"""The report of one part: one HTML file that needs nothing else, and its pictures beside it."""

from __future__ import annotations

import base64
import json
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from html import escape
from pathlib import Path
from typing import Any

from isf_core import __version__
from isf_core.errors import ErrorCode, IsfError
from isf_core.view import page as view_page

from isf_analysis.figures import report_figures, style
from isf_analysis.figures.cuts import Plane, asked_cuts
from isf_analysis.figures.part_view import part_view
from isf_analysis.figures.report_figures import Picture
from isf_analysis.measures.deviation import BASE_SLOPE, OPENING_DEPTH, RIM_WIDTH, WALL_SLOPE, Deviation, directions
from isf_analysis.measures.record import PartRecord
from isf_analysis.measures.sheet_thickness import ESTIMATED, PLANNED, SIMULATED
from isf_analysis.measures.summary import deviation_of, scan_errors_of, summarise
from isf_analysis.measures.verdict import verdict
from isf_analysis.report import finding_tables, result_tables
from isf_analysis.report.templates import filled

HTML_NAME = "report.html"
SUMMARY_NAME = "summary.json"

VIEW_WORDS = (
    "Turn it by mouse, touch or arrow keys; zoom by wheel, pinch, or the keys + and −; Home is as at first. "
    "The mark is the largest error, the thinnest place, the least strain margin, the largest force or correction. "
    "Paths are drawn on the sheet, where the contacts of the forming tool were planned. "
)
FORMING_WORDS = (
    " Forming is played by its button or the space key, and goes step by step with the slider or its arrow keys: the "
    "sheet after the step, the path of the tips in it and, as balls of their radius, the tools. The line above the "
    "picture says whether the sheet was scanned; what is swept by the tools, or the wanted shape so far, knows no "
    "springback, so that its last step differs from the finished part."
)
NO_FORMING_WORDS = (
    " The forming step by step is left out: nothing was formed, or neither a scan nor CAD tells the shape in between."
)
THICKNESS_WORDS = {
    SIMULATED: "Thickness as formed and strain margin are those of the simulated sheet: the margin is the true strain "
    "that is left before the forming limit of its material, without what a support tool adds to it. Where it is below "
    "0 along less than four tool radii of a contour, as can be at the seam of the contours, the machine tells no tear. "
    "Thickness (plan) is what the plan expected.",
    ESTIMATED: "No record tells the thickness of this sheet: the estimate is that of the blank times the cosine of the "
    "slope of the smoothed scan, thickness (plan) what the plan expected.",
    PLANNED: "Thickness is that of the plan, not measured.",
}
"""By what tells the thickness."""


@dataclass(frozen=True)
class Report:
    """A written report: the HTML file, the pictures beside it, and the numbers in it (also in summary.json)."""

    html: Path
    pictures: tuple[Path, ...]
    numbers: dict[str, Any]


def write_report(
    record: PartRecord,
    folder: Path | str,
    *,
    reference: PartRecord | None = None,
    bag: Path | str | None = None,
    failure: IsfError | None = None,
    sections: Sequence[Plane] = (),
    progress: Callable[[str], None] | None = None,
) -> Report:
    """Write report.html, its PNG files and summary.json into ``folder``, which is made when it does not exist.

    ``reference`` is the uncorrected part; ``bag`` is named in the numbers; ``failure`` is what ended the run when the
    record itself does not tell (a node that died, the operator); ``sections`` are drawn beside those that a report has
    anyway; ``progress`` hears what is being done.

    Raises
    ------
    IsfError : FILE_NOT_WRITABLE; of ``sections``, before anything is written: FILE_FIELD where one misses the part,
        BAG_INCOMPLETE where there is no shape
    """
    folder = Path(folder)
    notify = progress or _silent
    notify("comparing shapes")
    record, deviation = _compared(record)
    asked = asked_cuts(sections, deviation)
    reference_deviation = None
    if reference is not None:
        reference, reference_deviation = _compared(reference)
    html = folder / HTML_NAME
    scans = scan_errors_of(record)
    numbers = summarise(record, deviation, reference, reference_deviation, scans=scans, bag=bag, report=html)
    if failure is not None:
        numbers["complete"] = False
        numbers["failure"] = {"code": int(failure.code), "message": failure.message}
        numbers["verdict"] = verdict(numbers)
    pictures = report_figures.draw(record, deviation, reference, reference_deviation, notify, scans, asked)
    notify("writing the report")
    page = render(record, numbers, pictures, deviation)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        paths = []
        for picture in pictures:
            path = folder / f"{picture.name}.png"
            path.write_bytes(picture.png)
            paths.append(path)
        html.write_text(page, encoding="utf-8")
        text = json.dumps(numbers, indent=2, allow_nan=False)
        (folder / SUMMARY_NAME).write_text(text + "\n", encoding="utf-8")
    except OSError as error:
        raise IsfError(
            ErrorCode.FILE_NOT_WRITABLE, str(error), where=str(folder), advice="choose a writable folder"
        ) from error
    return Report(html, tuple(paths), numbers)


def _compared(record: PartRecord) -> tuple[PartRecord, Deviation | None]:
    """The record and its deviation; where scan and target do not go together, without the scans and with a note."""
    try:
        return record, deviation_of(record)
    except IsfError as error:
        note = f"scan and wanted shape are not compared: {error.what}"
        return replace(record, scan=None, scans=(), notes=(*record.notes, note)), None


def render(
    record: PartRecord, numbers: dict[str, Any], pictures: tuple[Picture, ...], deviation: Deviation | None
) -> str:
    """The HTML page."""
    plant = "real machine" if record.variant < 0 else "simulated machine"
    method = f"correction: {record.correction}" if record.corrects else "no springback correction"
    made = time.strftime("%Y-%m-%d %H:%M UTC", time.gmtime())
    try:
        (view, forming), missing = part_view(record, deviation), ""
    except IsfError as error:  # without plotly
        view, forming, missing = "", False, f"<p>The part cannot be turned here: {escape(error.what)}.</p>"
    caption = VIEW_WORDS + _thickness_words(numbers) + (FORMING_WORDS if forming else NO_FORMING_WORDS)
    return filled(
        "report_template.html",
        title=escape(f"Forming report: {record.job_name}"),
        heading=escape(f"Forming report: {record.job_name}"),
        subheading=escape(f"{record.process} · {method} · {plant}"),
        banners=result_tables.banners(numbers, numbers["reference"] is not None),
        cards=result_tables.cards(numbers),
        view_style=view_page.STYLE if view else "",
        view=f"<h2>The part, to be turned</h2><figure>{view}<figcaption>{caption}</figcaption></figure>"
        if view
        else missing,
        scripts=view_page.scripts() if view else "",
        chapters="\n".join(_chapters(record, numbers, pictures)),
        reading=_reading(record, numbers),
        footer=escape(f"Made {made} by isf_analysis {__version__}. Bag: {numbers['bag'] or 'none'}"),
    )


def _thickness_words(numbers: dict[str, Any]) -> str:
    known = numbers["sheet_thickness"]
    return THICKNESS_WORDS[known["source"]] if known is not None else ""


def _chapters(record: PartRecord, numbers: dict[str, Any], pictures: tuple[Picture, ...]) -> list[str]:
    parts: list[str] = []
    if numbers["deviation"] is not None:
        parts += [
            "<h2>Shape</h2>",
            *_figures(pictures, report_figures.SHAPE),
            result_tables.region_table(numbers),
            result_tables.share_table(numbers),
            result_tables.signed_table(numbers),
            finding_tables.split_table(numbers),
        ]
    if thickness := finding_tables.thickness_table(numbers):
        parts += ["<h2>Thickness</h2>", thickness]
    happened = finding_tables.event_table(numbers)
    if happened:
        parts += ["<h2>Events</h2>", happened]
    correction = [
        *_figures(pictures, report_figures.CORRECTION),
        *filter(
            None,
            (
                finding_tables.expected_table(numbers),
                finding_tables.outlook_table(numbers),
                finding_tables.remark_table(numbers),
            ),
        ),
    ]
    if correction:
        parts += ["<h2>Springback correction</h2>", *correction]
    force = _figures(pictures, report_figures.FORCE)
    if force:
        parts += ["<h2>Forces</h2>", *force]
    if numbers["force"] is not None:
        parts.append(result_tables.force_table(numbers["force"]))
    tables = (finding_tables.force_region_table(numbers), finding_tables.contact_loss_table(numbers))
    parts += [text for text in tables if text]
    if time_table := finding_tables.time_table(numbers):
        parts += ["<h2>Time</h2>", time_table]
    parts += ["<h2>Job and constants</h2>", result_tables.job_table(record), result_tables.constants(record)]
    parts.append(f"<details><summary>Job file</summary><pre>{escape(record.job_text)}</pre></details>")
    return parts


def _figures(pictures: tuple[Picture, ...], chapter: str) -> list[str]:
    return [_figure(picture) for picture in pictures if picture.chapter == chapter]


def _figure(picture: Picture) -> str:
    data = base64.b64encode(picture.png).decode("ascii")
    alt = escape(f"{picture.title}. {picture.caption}", quote=True)
    return (
        f'<figure id="{picture.name}"><h3>{escape(picture.title)}</h3>'
        f'<img alt="{alt}" src="data:image/png;base64,{data}">'
        f"<figcaption>{escape(picture.caption)}</figcaption></figure>"
    )


def _reading(record: PartRecord, numbers: dict[str, Any]) -> str:
    """What colours, signs and regions mean, and what the numbers do not tell."""
    base, wall = (round(math.degrees(angle)) for angle in (BASE_SLOPE, WALL_SLOPE))
    items = [
        f"<b>Deviation</b> is the measured minus the wanted height. {_sign_words(record)} <i>Normal to the surface</i> "
        "is the same distance measured square to the wanted surface, smaller on steep walls.",
        "<b>Regions</b> are those of the target. "
        f"<i>Whole part</i>: everything more than {1e3 * OPENING_DEPTH:g} mm off the flange, with the fillets. "
        f"<i>Wall</i>: steeper than {wall}°. <i>Base</i>: flatter than {base}° and farther from the flange than half "
        "the part. "
        f"<i>Rim</i>: {1e3 * RIM_WIDTH:g} mm of flange around the opening. "
        "Largest and mean error on the cards are of the whole part.",
        "<b>Colours of lines</b>: "
        + ", ".join(
            _key(colour, words)
            for colour, words in (
                (style.PART, "this part"),
                (style.UNCORRECTED, "uncorrected"),
                (style.TARGET, "target"),
                (style.SET_POINT, "set-point and tolerance"),
                (style.PREDICTION, "what a model predicted"),
            )
        )
        + ".",
    ]
    if numbers["force"] is not None:
        items.append(
            "<b>Support force</b> is the raw reading of the load cell with its noise. It is judged only while the "
            "loop is in full control: ramps, and contours under position control, are left out (grey in the figure)."
        )
    limits = [
        "The shape is measured <b>in the clamp</b> and not aligned to the target. Unclamping and trimming let the part "
        "spring further; that is not in these numbers.",
    ]
    if record.variant >= 0:
        limits.append(
            "The part was formed by a <b>simulated machine</b>. Its sheet model is an approximation, calibrated on few "
            "published parts; compare methods with it, and expect other numbers from real sheet."
        )
        if exact := numbers["exact_scans"]:
            limits.append(
                f"The scan {' and those '.join(exact)} {'are' if len(exact) > 1 else 'is'} <b>exact</b>: without the "
                "noise, the gaps and the misplacement of a scanner."
            )
        if record.sealed:
            limits.append(
                f"Variant {record.variant} of the machine is <b>sealed</b>: its runs are published, and no constant "
                "and no method is chosen by them."
            )
        if record.sheet.get("model") == "fast":
            limits.append(
                "The <b>fast</b> sheet yields only under the tools: what a real sheet does at the opening and in the "
                "flange is missing, so that its errors are too small there. <code>--sheet shell</code> has it."
            )
    items.append("<b>Limits</b>: " + " ".join(limits))
    return "<ul>" + "".join(f"<li>{item}</li>" for item in items) + "</ul>"


def _sign_words(record: PartRecord) -> str:
    down, up = (True, False) if record.target is None else directions(record.target)
    if not up:
        return (
            "Positive (red) is too high: the part sprang back or was not formed deep enough. Negative (blue) is too "
            "deep."
        )
    words = "Positive (red) is too high, negative (blue) is too low, also where the part stands up from the flange"
    return f"{words}; in what is formed downwards red means not deep enough." if down else f"{words}."


def _key(colour: str, words: str) -> str:
    return f'<span class="nowrap"><span class="key" style="background:{colour}"></span>{words}</span>'


def _silent(_: str) -> None:
    pass
