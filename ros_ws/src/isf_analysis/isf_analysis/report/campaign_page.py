"""The page of a campaign: one HTML file that needs nothing else, with every number's variant, sheet and seed."""

from __future__ import annotations

import base64
import statistics
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from html import escape

from isf_core import __version__
from isf_core.simulated_sheet import is_structural

from isf_analysis.figures.campaign_figures import error_strips
from isf_analysis.measures.campaign_row import CampaignRow
from isf_analysis.report.result_tables import DASH, banner, card, number, percent, table
from isf_analysis.report.templates import filled


@dataclass(frozen=True)
class Formed:
    """All rows of one job, method and sheet.

    Attributes
    ----------
    job, method, sheet ; rows : by variant
    """

    job: str
    method: str
    sheet: str
    rows: tuple[CampaignRow, ...]

    @property
    def whole(self) -> list[CampaignRow]:
        """Parts that were formed to their end."""
        return [row for row in self.rows if row.whole]

    @property
    def nominal(self) -> CampaignRow | None:
        """The whole part on the nominal plant."""
        return next((row for row in self.whole if row.variant == 0), None)

    @property
    def others(self) -> list[CampaignRow]:
        """Whole parts on the other variants."""
        return [row for row in self.whole if row.variant != 0]

    @property
    def failures(self) -> list[CampaignRow]:
        """Parts that ended early, were refused or not measured."""
        return [row for row in self.rows if not row.whole]

    def median(self, name: str) -> float | None:
        """Of field ``name`` over the whole parts on variants other than the nominal one."""
        values = [getattr(row, name) for row in self.others if getattr(row, name) is not None]
        return statistics.median(values) if values else None

    @property
    def told(self) -> list[CampaignRow]:
        """Whole parts of which an error was expected."""
        return [row for row in self.whole if row.reached_over_expected is not None]

    @property
    def overconfident(self) -> int:
        """Of these, those that came out worse than expected by more than a factor of 1.5."""
        return sum(row.overconfident for row in self.told)

    @property
    def worst(self) -> CampaignRow | None:
        """The other variant with the largest error."""
        return max(self.others, key=lambda row: row.max_mm or 0.0, default=None)


def grouped(rows: Iterable[CampaignRow]) -> list[Formed]:
    """Rows by job, sheet and method, in the order of their first ones."""
    found: dict[tuple[str, str, str], list[CampaignRow]] = {}
    for row in rows:
        found.setdefault((row.job, row.sheet, row.method), []).append(row)
    groups = [Formed(job, method, sheet, tuple(mine)) for (job, sheet, method), mine in found.items()]
    jobs = list(dict.fromkeys((group.job, group.sheet) for group in groups))
    return sorted(groups, key=lambda group: jobs.index((group.job, group.sheet)))


def campaign_page(
    name: str, rows: Sequence[CampaignRow], planned: int, text: str, processors: int, picture: bytes | None
) -> str:
    """HTML of campaign ``name``: ``rows`` of the ``planned`` parts, the ``text`` of its file, its picture."""
    groups = grouped(rows)
    made = time.strftime("%Y-%m-%d %H:%M UTC", time.gmtime())
    counts = [
        _count(len({row.job for row in rows}), "job"),
        _count(len({row.method for row in rows}), "method"),
        _count(len({row.variant for row in rows}), "variant"),
        _count(len({row.sheet for row in rows}), "sheet"),
    ]
    return filled(
        "campaign_template.html",
        heading=escape(f"Campaign: {name}"),
        subheading=escape(" · ".join([*counts, "simulated machine"])),
        banners=_banners(rows, planned),
        cards=_cards(groups, rows, planned),
        chapters="\n".join(_chapters(groups, picture)),
        behind=_behind(rows, text, processors),
        footer=escape(f"Made {made} by isf_analysis {__version__}."),
    )


def picture_of(rows: Sequence[CampaignRow]) -> bytes | None:
    """PNG of the errors; None without a whole part."""
    if not any(row.whole for row in rows):
        return None
    panels: dict[str, list[tuple[str, Sequence[CampaignRow]]]] = {}
    for group in grouped(rows):
        panels.setdefault(_titled(group.job, group.sheet, rows), []).append((group.method, group.rows))
    return error_strips(list(panels.items()))


def _count(number_of: int, what: str) -> str:
    return f"{number_of} {what}{'' if number_of == 1 else 's'}"


def _titled(job: str, sheet: str, rows: Sequence[CampaignRow]) -> str:
    return job if len({row.sheet for row in rows}) == 1 else f"{job}, sheet {sheet}"


def _banners(rows: Sequence[CampaignRow], planned: int) -> str:
    parts = []
    if len(rows) < planned:
        text = f"{len(rows)} of {planned} parts are there. The same command forms the rest."
        parts.append(banner("warn", "Campaign not complete", text))
    failed = [row for row in rows if not row.whole]
    if failed:
        text = f"{len(failed)} of {len(rows)} parts are not whole; they are listed with their codes and in no median."
        parts.append(banner("warn", "Parts ended early", text))
    if over := [row for row in rows if row.overload]:
        text = f"{len(over)} whole part(s) took more force than their machine bears, the first: {_case(over[0])}: "
        parts.append(banner("warn", "Beyond the machine", text + over[0].overload))
    if any(row.sealed for row in rows):
        text = "Variants 101 to 120 are for publishing results: no constant and no method may be chosen by them."
        parts.append(banner("warn", "Sealed variants", text))
    return "\n".join(parts)


def _cards(groups: Sequence[Formed], rows: Sequence[CampaignRow], planned: int) -> str:
    whole = sum(row.whole for row in rows)
    parts = [card("Whole parts", f"{whole} <small>of {planned}</small>", "formed to their end and measured")]
    for job, sheet in list(dict.fromkeys((group.job, group.sheet) for group in groups))[:4]:
        mine = [group for group in groups if (group.job, group.sheet) == (job, sheet)]
        ranked = [(_typical(group), group) for group in mine if _typical(group) is not None and not group.failures]
        if len(mine) > 1 and ranked:
            best, group = min(ranked, key=lambda item: item[0] or 0.0)
            what = "median of the variants" if group.others else "nominal plant"
            title = f"Smallest error, {_titled(job, sheet, rows)}"
            parts.append(card(title, f"{number(best)} <small>mm</small>", f"{group.method}; largest, {what}"))
    wall = sum(row.wall_s or 0.0 for row in rows)
    parts.append(card("Computed", _duration(wall), "of one core, all parts together"))
    return "\n".join(parts)


def _typical(group: Formed) -> float | None:
    return group.median("max_mm") if group.others else group.nominal.max_mm if group.nominal else None


def _chapters(groups: Sequence[Formed], picture: bytes | None) -> list[str]:
    parts = ["<h2>Methods side by side</h2>", _methods(groups)]
    if picture is not None:
        data = base64.b64encode(picture).decode("ascii")
        caption = (
            "A point is a whole part on one variant of the plant, the line their median, the open diamond the nominal "
            "plant. Dotted: the tolerance of the job."
        )
        parts.append(
            f'<figure id="errors"><h3>Largest errors</h3><img alt="{escape(caption, quote=True)}" '
            f'src="data:image/png;base64,{data}"><figcaption>{escape(caption)}</figcaption></figure>'
        )
    parts += ["<h2>Variant by variant</h2>", *_variants(groups)]
    failures = [row for group in groups for row in group.failures]
    if failures:
        lines = [
            [escape(_case(row)), escape(row.ending), escape(row.message or "no scan of the finished part")]
            for row in failures
        ]
        parts += ["<h2>Parts that are not whole</h2>", table("How they ended", ["part", "code", "what"], lines)]
    return parts


def _case(row: CampaignRow) -> str:
    return f"{row.job}, {row.method}, variant {row.variant}, {row.sheet}"


def _methods(groups: Sequence[Formed]) -> str:
    head = [
        "method",
        "whole parts",
        "nominal",
        "median",
        "worst",
        "in tolerance",
        "expected",
        "overconfident",
        "wall time",
    ]
    lines = []
    for group in groups:
        worst, nominal = group.worst, group.nominal
        share = group.median("within_tolerance") if group.others else nominal.within_tolerance if nominal else None
        codes = sorted({row.code for row in group.failures})
        ended = f' <span class="less">({", ".join(map(str, codes))})</span>' if codes else ""
        times = [row.wall_s for row in group.rows if row.wall_s is not None]
        place = f' <span class="less">({worst.variant})</span>' if worst else ""
        lines.append(
            [
                f"{escape(group.job)}: <b>{escape(group.method)}</b>"
                + ("" if group.sheet == "fast" else f' <span class="less">{group.sheet}</span>'),
                f"{len(group.whole)} of {len(group.rows)}{ended}",
                _pair(nominal.max_mm, nominal.mean_mm) if nominal else DASH,
                _pair(group.median("max_mm"), group.median("mean_mm")) if group.others else DASH,
                (_pair(worst.max_mm, worst.mean_mm) if worst else DASH) + place,
                percent(share, 1),
                _expected(group),
                f"{group.overconfident} of {len(group.told)}" if group.told else DASH,
                _duration(statistics.median(times)) if times else DASH,
            ]
        )
    caption = (
        "Errors of wall and base, largest / mean [mm]; median and worst (its variant) are of the variants but the "
        "nominal one, the share in tolerance, what the corrections expected of themselves and the time of a part are "
        "medians; a part is overconfident whose largest error is more than 1.5 times what was expected"
    )
    return table(caption, head, lines)


def _expected(group: Formed) -> str:
    """Medians of what was expected of the parts that the medians of the errors are of."""
    pairs = [(row.expected_max_mm, row.expected_mean_mm) for row in group.others or group.whole]
    known = [pair for pair in pairs if pair[0] is not None and pair[1] is not None]
    if not known:
        return '<span class="less">not known</span>' if group.whole else DASH
    return _pair(*(statistics.median(values) for values in zip(*known, strict=True)))


def _variants(groups: Sequence[Formed]) -> list[str]:
    """A table per job and sheet: a line per variant, a column per method."""
    tables = []
    rows = [row for group in groups for row in group.rows]
    for job, sheet in dict.fromkeys((group.job, group.sheet) for group in groups):
        mine = [group for group in groups if (group.job, group.sheet) == (job, sheet)]
        by_case = {(row.method, row.variant): row for group in mine for row in group.rows}
        variants = sorted({variant for _, variant in by_case})
        lines = [
            [f"{variant}{_kind(variant)}", *(_error(by_case.get((group.method, variant))) for group in mine)]
            for variant in variants
        ]
        caption = f"{escape(_titled(job, sheet, rows))}: largest / mean error of wall and base [mm]"
        tables.append(table(caption, ["variant", *(escape(group.method) for group in mine)], lines))
    return tables


def _kind(variant: int) -> str:
    word = "nominal" if variant == 0 else "other structure" if is_structural(variant) else ""
    return f' <span class="less">{word}</span>' if word else ""


def _error(row: CampaignRow | None) -> str:
    if row is None:
        return '<span class="less">to come</span>'
    return _pair(row.max_mm, row.mean_mm) if row.whole else f'<span class="less">{escape(row.ending)}</span>'


def _pair(largest: float | None, mean: float | None) -> str:
    return f"{number(largest)} / {number(mean)}"


def _duration(seconds: float) -> str:
    if seconds < 100:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 6000 else f"{seconds / 3600:.1f} h"


def _behind(rows: Sequence[CampaignRow], text: str, processors: int) -> str:
    def each(values: Iterable[object]) -> str:
        return escape(", ".join(map(str, dict.fromkeys(values))))

    sheets = {
        "fast": "fast: yields only under the tools, so that errors at the opening and in the flange are too small",
        "shell": "shell: elasto-plastic elements",
        "shell_coarse": "shell_coarse: elasto-plastic elements, larger ones",
        "shell_fine": "shell_fine: elasto-plastic elements, smaller ones",
    }
    tolerances = dict.fromkeys((row.job, row.tolerance_mm) for row in rows)
    lines = [
        ["plant", "simulated machine; its sheet model is an approximation, calibrated on few published parts"],
        ["sheet", escape("; ".join(sheets.get(sheet, sheet) for sheet in dict.fromkeys(row.sheet for row in rows)))],
        ["variants", each(row.variant for row in rows) + "; 0 is what the controllers believe, others differ from it"],
        ["seed", each(row.seed for row in rows) + ", of sensor noise and of the variants"],
        ["error", "vertical, in the clamp, formed minus wanted; parts are not unclamped, trimmed or aligned"],
        ["tolerance", escape("; ".join(f"{job}: {number(value)} mm" for job, value in tolerances))],
        ["control rate", escape("; ".join(f"{job}: {rate:g} Hz" for job, rate in _rates(rows)))],
        ["software", f"version {each(row.software for row in rows)}, sources {each(row.sources for row in rows)}"],
        ["time", f"of parts that were formed {processors} at a time, each by one core"],
    ]
    behind = table("", ["", ""], lines, wrap=True)
    return f"{behind}<details><summary>Campaign file</summary><pre>{escape(text)}</pre></details>"


def _rates(rows: Sequence[CampaignRow]) -> list[tuple[str, float]]:
    return list(dict.fromkeys((row.job, row.control_rate_Hz) for row in rows if row.control_rate_Hz is not None))
