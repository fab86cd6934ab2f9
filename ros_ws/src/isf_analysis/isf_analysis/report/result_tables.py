"""Words, cards and tables of the report, as HTML, from the numbers of :mod:`isf_analysis.measures.summary`."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from html import escape
from pathlib import Path
from typing import Any

from isf_core.errors import ErrorCode, IsfError
from isf_core.events import EventKind, kind_name
from isf_core.files import yaml_file
from isf_core.files.tooling import LIBRARIES, Library, load_named
from isf_core.files.yaml_file import FileModel

from isf_analysis.figures.shape_figures import REGION_LABELS
from isf_analysis.measures.deviation import REGIONS
from isf_analysis.measures.force_metrics import by_place, force_metrics
from isf_analysis.measures.percent import percent as as_percent
from isf_analysis.measures.record import PartRecord
from isf_analysis.measures.verdict import WITHIN_BAND, in_tolerance

DASH = "–"
_SOURCES = ("", "value", "source")
Numbers = dict[str, Any]


def number(value: float | None, digits: int = 2) -> str:
    """Number as text, a dash for an unknown one."""
    return DASH if value is None else f"{round(value, digits) + 0.0:.{digits}f}"  # no -0.00


def banners(numbers: Numbers, has_reference: bool) -> str:
    """What a reader must know first: whole and good or not (:mod:`verdict`), and what the record lacks."""
    failure = numbers["failure"]
    count = f"{numbers['contours']} of {numbers['contours_planned']} contours formed"
    if failure is None:
        short_of, proviso = numbers["verdict"]["short_of"], numbers["verdict"]["proviso"]
        if short_of:
            parts = [banner("warn", "Part complete, but not good", f"{count}. {_sentences(short_of)}")]
        elif proviso:
            parts = [
                banner(
                    "info",
                    "Part complete, in tolerance on the fast sheet",
                    f"{count}{_by_exact_scans(numbers)}. {_sentences([proviso])}",
                )
            ]
        else:
            parts = [banner("good", "Part complete and good", f"{count}, and in tolerance{_by_exact_scans(numbers)}.")]
    else:
        where = f"{_code_name(failure['code'])}: {failure['message']}."
        text = (
            f"{count}. {where} All numbers below are of what was formed until then, measured against the whole target."
        )
        title = "Record not complete" if _of_record(failure["code"]) else "Part not complete"
        parts = [banner("bad", title, text)]
    if numbers["deviation"] is None:
        parts.append(banner("warn", "No shape to compare", "The record holds no scan that can be used, or no target."))
    if numbers["expected_error"]["overconfident"]:
        parts.append(banner("warn", "Worse than expected", _overconfident(numbers["expected_error"])))
    parts += [banner("warn", "Note", f"{note}.") for note in numbers["notes"]]
    parts += [banner("warn", "The plan warned", f"{text}.") for text in numbers["plan_warnings"]]
    parts += [banner("bad", f"Event: {event['kind']}", f"{event['text']}.") for event in _lost_part(numbers)]
    other = numbers["reference"]
    if other is not None and not other["complete"]:
        parts.append(banner("warn", "The uncorrected reference is not complete", other["failure"]["message"] + "."))
    if not has_reference and numbers["correction"] not in ("", "none"):
        parts.append(
            banner(
                "warn",
                "No reference",
                "Without a bag of the uncorrected part the effect of the correction is not shown.",
            )
        )
    return "\n".join(parts)


def _by_exact_scans(numbers: Numbers) -> str:
    """That what was measured has no errors of a scanner, to end a sentence with; empty: it has."""
    exact = numbers["exact_scans"]
    return f" (exact scan {' and '.join(exact)}: no errors of a scanner)" if exact else ""


def _overconfident(found: Numbers) -> str:
    return (
        f"The correction expected a largest error of {number(found['largest_mm'])} mm, by {found['stands_on']}; "
        f"{number(found['reached_largest_mm'])} mm were reached, {number(found['reached_over_expected'], 1)} times as "
        "much. Its other numbers may be as overconfident."
    )


def cards(numbers: Numbers) -> str:
    """The numbers to remember."""
    parts = [
        _error_card("Largest error", numbers, "max_mm", "max"),
        _error_card("Mean error", numbers, "mean_abs_mm", "mean_abs"),
        _expected_card(numbers["expected_error"]),
        _force_card(numbers["force"]),
        card(
            "Contours formed",
            f"{numbers['contours']} <small>of {numbers['contours_planned']}</small>",
            "",
            numbers["complete"],
        ),
        card("Late control ticks", f"{numbers['late_ticks']}", f"of {numbers['ticks']:,} ticks".replace(",", " ")),
        card(
            "Lost messages",
            f"{numbers['lost_messages']}",
            f"{number(numbers['sim_s'], 1)} s of process, {number(numbers['wall_s'], 1)} s of wall time",
        ),
    ]
    if off := numbers["machine"].get("leg_error_um"):
        text = f"{number(off['largest'], 1)} <small>µm</small>"
        parts.append(card("Legs off their set-points", text, f"largest in contact; {number(off['rms'], 1)} µm rms"))
    return "\n".join(parts)


def region_table(numbers: Numbers) -> str:
    """Deviation by region: of the reference, where there is one, and of this part."""
    keys: dict[str, tuple[str, Callable[[float | None], str]]] = {
        "max_mm": ("largest", number),
        "mean_abs_mm": ("mean", number),
        "rms_mm": ("rms", number),
        "mean_mm": ("signed mean", number),
        "max_normal_mm": ("largest, normal", number),
    }
    return _by_region("Deviation by region [mm], vertical", numbers, lambda region: region, keys)


def share_table(numbers: Numbers) -> str:
    """Shares of the measured points of each region within the usual bands and the tolerance of the job, and how much
    of the region was measured."""
    shown = partial(percent, digits=1)
    own = numbers["tolerance"]["shape_mm"]
    keys = {f"within_0_{k}mm_fraction": (f"± 0.{k} mm", shown) for k in (1, 2, 3)}
    keys["within_tolerance_fraction"] = (f"tolerance, ± {own:g} mm", shown)
    keys["coverage"] = ("measured, of the region", shown)
    return _by_region("Share of the measured points within", numbers, lambda region: region, keys)


def signed_table(numbers: Numbers) -> str:
    """The six statistics of Behera 2015, Table 2, of each region."""
    keys = {
        "mean_positive_mm": ("mean of the positive", number),
        "mean_negative_mm": ("of the negative", number),
        "max_mm": ("largest", number),
        "min_mm": ("smallest", number),
        "mean_mm": ("mean", number),
        "std_mm": ("standard deviation", number),
    }
    caption = "Signed distance along the normal [mm] (Behera 2015, Table 2)"
    return _by_region(caption, numbers, lambda region: region["table2"], keys)


def _by_region(
    caption: str,
    numbers: Numbers,
    values: Callable[[Numbers], Numbers],
    keys: Mapping[str, tuple[str, Callable[[float | None], str]]],
) -> str:
    """Table with a row per region: ``keys`` of ``values(region)`` with their heads and formats."""
    other = numbers["reference"]
    before = other["deviation"]["regions"] if other and other["deviation"] else None
    after = numbers["deviation"]["regions"]
    rows = []
    for name in REGIONS:
        cells = [shown(values(after[name])[key]) for key, (_, shown) in keys.items()]
        if before is not None:
            old = [shown(values(before[name])[key]) for key, (_, shown) in keys.items()]
            cells = [f"{was} → <b>{cell}</b>" for was, cell in zip(old, cells, strict=True)]
        rows.append([REGION_LABELS[name], *cells])
    caption += ", uncorrected → <b>this part</b>" if before is not None else ""
    return table(caption, ["region", *(label for label, _ in keys.values())], rows)


def force_table(force: Numbers) -> str:
    """Accuracy of the support force."""
    rows = [
        ["set-point", _set_point(force)],
        ["within ± 10 N, while in full control", percent(force["within_10N_fraction"])],
        ["error, 99 % of the time below", f"{number(force['p99_abs_error_N'], 1)} N"],
        ["error, 99.9 % of the time below", f"{number(force['p999_abs_error_N'], 1)} N"],
        ["largest error", f"{number(force['max_abs_error_N'], 1)} N"],
        ["rms error", f"{number(force['rms_error_N'], 2)} N"],
        ["mean error", f"{number(force['mean_error_N'], 2)} N"],
        ["in contact, while in full control", percent(force["contact_fraction"])],
        ["in full control", f"{number(force['engaged_s'], 1)} s, {percent(force['engaged_fraction'])} of the ticks"],
    ]
    return table("Support force, raw signal of the load cell", ["", ""], rows)


def percent(fraction: float | None, digits: int = 2) -> str:
    """As of isf_analysis.measures.percent, with a dash for what is not known."""
    return DASH if fraction is None else as_percent(fraction, digits)


def job_table(record: PartRecord) -> str:
    """What was formed, how, and with which software."""
    metrics = force_metrics(record.results, record.control_rate) if record.support_force > 0 else None
    support = f"{record.support_force:.0f} N" if record.support_force > 0 else "position control or none"
    if metrics is not None and (places := by_place(metrics.lowest, metrics.highest)):
        support += f", by place {places}"
    rows = [
        ["job", record.job_name],
        ["process", record.process],
        ["springback correction", record.correction or "none"],
        ["support force set-point", support],
        ["machine", record.plant],
        ["control rate", f"{record.control_rate:.0f} Hz{', lockstep' if record.lockstep else ''}"],
        ["plan", record.plan_id],
        ["software that formed the part", record.software],
    ]
    return table("Job", ["", ""], [[escape(cell) for cell in row] for row in rows])


def constants(record: PartRecord) -> str:
    """Constants of material, rig, tools, blank and plate with where each comes from, by the names in the job; text when
    those of material or rig are unknown."""
    try:
        job = record.job()
        parts = [
            _sources("Material", yaml_file.find_shipped("materials", job.sheet.material)),
            _sources("Rig", yaml_file.find_shipped("rigs", job.rig)),
        ]
    except (IsfError, OSError) as error:
        words = error.message if isinstance(error, IsfError) else str(error)
        return f"<p>The constants of material and rig are not shown: {escape(words)}</p>"
    titles = {"tool_1": "Upper tool", "tool_2": "Lower tool", "sheet": "Blank", "backing_plate": "Backing plate"}
    for library in LIBRARIES:
        for section in library.sections:
            path = _library_file(library, getattr(job, section))
            parts += [] if path is None else [_sources(titles[section], path)]
    return "\n".join(parts)


def _library_file(library: Library, spec: FileModel | None) -> Path | None:
    """Shipped file that the section ``spec`` of a job was read from; None for fields of its own, or of another file."""
    name = getattr(spec, "name", None)
    if spec is None or name is None:
        return None
    try:
        path = yaml_file.find_shipped(library.folder, name)
    except IsfError:
        return None
    same = load_named(library, str(path)).model_dump(exclude={"provenance"}) == spec.model_dump()
    return path if same else None


def _sources(title: str, path: Path) -> str:
    """Table of one file: values as written there, with their units, and the source of each."""
    content = yaml_file.content(yaml_file.read(path), str(path))
    provenance = content.get("provenance", {})
    rows = [[escape(key), _value_text(content, key), escape(str(text))] for key, text in provenance.items()]
    return table(f"{title} {escape(str(content.get('name', path.stem)))}: constants and their sources", _SOURCES, rows)


def table(
    caption: str, head: Sequence[str], rows: Iterable[Sequence[str]], *, text: Sequence[int] = (), wrap: bool = False
) -> str:
    """HTML table of ready HTML cells; cells that are numbers are aligned right.

    ``text``: columns of words in a table of numbers; ``wrap``: the first column holds sentences.
    """
    kind = ' class="wrap"' if wrap else ""
    lines = [f'<div class="table"><table{kind}><caption>{caption}</caption>']
    if any(head):
        lines.append(
            "<thead><tr>"
            + "".join(_cell("th", word, k not in text, len(head), k) for k, word in enumerate(head))
            + "</tr></thead>"
        )
    lines.append("<tbody>")
    for row in rows:
        lines.append(
            "<tr>"
            + f"<th>{row[0]}</th>"
            + "".join(_cell("td", word, k not in text, len(row), k) for k, word in enumerate(row[1:], 1))
            + "</tr>"
        )
    lines.append("</tbody></table></div>")
    return "\n".join(lines)


def _cell(tag: str, text: str, numeric: bool, columns: int, column: int) -> str:
    right = numeric and column > 0 and columns > 3
    return f'<{tag} class="n">{text}</{tag}>' if right else f"<{tag}>{text}</{tag}>"


def banner(kind: str, title: str, text: str) -> str:
    """HTML of a sentence above all others; ``kind``: good, warn or bad."""
    return f'<div class="banner {kind}"><strong>{escape(title)}</strong>{escape(text)}</div>'


def card(label: str, value: str, note: str, good: bool | None = None) -> str:
    """HTML of one number to remember; ``value`` is ready HTML."""
    kind = "" if good is None else " good" if good else " bad"
    return (
        f'<div class="card{kind}"><div class="label">{escape(label)}</div>'
        f'<div class="value">{value}</div><div class="note">{escape(note)}</div></div>'
    )


def _error_card(label: str, numbers: Numbers, key: str, factor: str) -> str:
    """Green in tolerance alone, red where the correction has made it worse."""
    own = numbers["deviation"]
    good = True if in_tolerance(numbers) else None
    value = f"{number(own[key] if own else None)} <small>mm</small>"
    other = numbers["reference"]
    if not other or not other["deviation"] or not own:
        return card(label, value, "vertical, whole part", good)
    before = f'<span class="before">{number(other["deviation"][key])} → </span>'
    gain = (numbers["improvement"] or {}).get(factor)
    note = (
        "against uncorrected"
        if gain is None
        else f"{100 * abs(1 - 1 / gain):.0f} % {'less' if gain >= 1 else 'more'} than uncorrected"
    )
    return card(label, before + value, note, False if gain is not None and gain < 1 else good)


def _expected_card(found: Numbers) -> str:
    """Red where the part came out worse than the correction expected by more than a factor of 1.5."""
    label = "Expected largest error"
    if found["largest_mm"] is None:
        return card(label, "not known", found["not_known"])
    ratio = found["reached_over_expected"]
    note = "what was reached is not known" if ratio is None else f"reached {number(ratio, 1)} times as much"
    return card(
        label, f"{number(found['largest_mm'])} <small>mm</small>", note, False if found["overconfident"] else None
    )


def _force_card(force: Numbers | None) -> str:
    if force is None:
        return card("Support force", DASH, "no force control in this part")
    share = force["within_10N_fraction"]
    places = by_place(force["set_min_N"], force["set_max_N"])
    value = percent(share).replace(" %", " <small>%</small>")
    return card(
        f"Within ± 10 N of {_set_point(force)}",
        value,
        "of the time in full control" + (", by place" if places else ""),
        None if share is None else share >= WITHIN_BAND,
    )


def _set_point(force: Numbers) -> str:
    return by_place(force["set_min_N"], force["set_max_N"]) or f"{number(force['set_N'], 0)} N"


def _lost_part(numbers: Numbers) -> list[Numbers]:
    """Events after which the part is scrap."""
    scrap = {kind_name(EventKind.FRACTURE), kind_name(EventKind.BUCKLING)}
    return [event for event in numbers["events"] if event["kind"] in scrap]


def _sentences(texts: Sequence[str]) -> str:
    return " ".join(f"{text[:1].upper()}{text[1:]}." for text in texts)


def _of_record(code: int) -> bool:
    """Is it the record that failed, not the part?"""
    return code in (ErrorCode.BAG_INCOMPLETE, ErrorCode.BAG_NOT_WRITABLE, ErrorCode.BAG_UNREADABLE)


def _code_name(code: int) -> str:
    if not code:
        return "Cause"
    try:
        return f"{code} {ErrorCode(code).name}"
    except ValueError:
        return f"code {code}"


def _value_text(values: dict[str, Any], key: str) -> str:
    """Value of a dotted name; nothing for the name of a group that the file spells differently."""
    current: Any = values
    for part in key.split("."):
        if not isinstance(current, dict) or part not in current:
            return ""
        current = current[part]
    if isinstance(current, dict):
        return escape(", ".join(f"{name} {_plain(value)}" for name, value in current.items()))
    return escape(_plain(current))


def _plain(value: Any) -> str:
    return " × ".join(str(item) for item in value) if isinstance(value, list) else str(value)
