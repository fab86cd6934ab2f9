"""Tables of the report on what happened and what could not be done, from the numbers of :mod:`findings`.

Contours are counted from 1 here, from 0 in the numbers.
"""

from __future__ import annotations

from html import escape
from typing import Any

from isf_core.contour import contour_label

from isf_analysis.measures.expected_error import reached_over_expected
from isf_analysis.measures.force_regions import AFTER, BEFORE, CONTACT, CORNER_RADIUS
from isf_analysis.measures.remarks import spans
from isf_analysis.measures.sheet_thickness import SHARE
from isf_analysis.report.result_tables import DASH, number, percent, table

Numbers = dict[str, Any]

REGION_WORDS = {
    "transition": f"transition between contours ({1e3 * BEFORE:g} mm before, {1e3 * AFTER:g} mm after)",
    "corner": f"corners (tighter than {1e3 * CORNER_RADIUS:g} mm)",
    "wall": "along the wall",
    "all": "all points",
}

MAXIMUM_REMARKS = 12
"""Groups of remarks that are shown; the rest is in summary.json."""


def event_table(numbers: Numbers) -> str:
    """One row per kind of event, most severe first; nothing without events."""
    rows = []
    for event in numbers["events"]:
        first = event["first"]
        contour = "between contours" if first["contour"] is None else contour_label(first["contour"])
        position = first["position_mm"]
        place = DASH if None in position else ", ".join(number(value, 1) for value in position)
        kind = escape(event["kind"])
        rows.append(
            [
                kind if event["harmless"] else f"<b>{kind}</b>",
                f"{event['count']}",
                f"{contour}, {number(first['time_s'], 2)} s",
                place,
                escape(event["text"]),
            ]
        )
    head = ["event", "times", "first", "at x, y, z [mm]", "farthest beyond the limit"]
    return table("What the machine noticed, most severe first", head, rows, text=(2, 4)) if rows else ""


def thickness_table(numbers: Numbers) -> str:
    """Thinnest place and least strain margin, and where they are; nothing where no thickness is known."""
    known = numbers["sheet_thickness"]
    if known is None:
        return ""
    rows = []
    for words, place in (("thinnest place", known["thinnest"]), ("least strain margin", known["least_margin"])):
        if place is not None:
            margin = place["margin"]
            shown = number(margin)
            rows.append(
                [
                    words,
                    f"{number(place['thickness_mm'])}",
                    f"<b>{shown}</b>" if margin is not None and margin < 0.0 else shown,
                    ", ".join(number(value, 1) for value in place["place_mm"]),
                    number(place["planned_mm"]),
                ]
            )
    if known["most_bear"] is not None:
        rows.append(
            [f"{100 * SHARE:g} % of what was formed have at least", DASH, number(known["most_bear"]), DASH, DASH]
        )
    blank = "" if known["blank_mm"] is None else f"; the blank is {number(known['blank_mm'])} mm thick"
    head = ["", "thickness [mm]", "strain margin", "at x, y, z [mm]", "planned there [mm]"]
    return table(f"Thickness by: {known['source']}{blank}", head, rows)


def remark_table(numbers: Numbers) -> str:
    """What the correction cannot do, and why; nothing without remarks."""
    remarks = numbers["remarks"]
    if not remarks:
        return ""
    total = max(numbers["contours_planned"], 1)
    rows = [
        [
            ("<b>failed</b> " if item["failed"] else "") + escape(item["text"]),
            escape(f"{spans([index + 1 for index in item['contours']])} ({len(item['contours'])} of {total})"),
        ]
        for item in remarks[:MAXIMUM_REMARKS]
    ]
    caption = "What springback correction says about its limits, most severe first"
    left = len(remarks) - MAXIMUM_REMARKS
    more = f" ({left} more in summary.json)" if left > 0 else ""
    return table(caption + more, ["remark, where it is strongest", "contours"], rows, wrap=True)


def expected_table(numbers: Numbers) -> str:
    """What the correction expected of wall and base beside what was reached; nothing where nothing was corrected."""
    found = numbers["expected_error"]
    if numbers["correction"] in ("", "none"):
        return ""
    known = found["largest_mm"] is not None
    rows = [
        [
            f"{words} error of wall and base",
            _mm(found[f"{key}_mm"]) if known else "not known",
            _mm(found[f"reached_{key}_mm"]),
            number(reached_over_expected(found[f"{key}_mm"], found[f"reached_{key}_mm"]), 1),
        ]
        for words, key in (("largest", "largest"), ("mean", "mean"))
    ]
    stands_on = f"Stands on: {found['stands_on']}" if known else f"Not known: {found['not_known']}"
    return table(escape(f"Expected beside reached error. {stands_on}"), ["", "expected", "reached", "ratio"], rows)


def outlook_table(numbers: Numbers) -> str:
    """What corrections foresaw at the points of the contours, and their uncertainty; nothing when they tell none."""
    outlook = numbers["outlook"]
    if outlook is None:
        return ""
    rows = [
        [words, *(_mm(outlook.get(f"{kind}_{key}_mm")) for kind in ("residual", "reached"))]
        for words, key in (
            ("signed error, mean over all contours", "mean"),
            ("largest", "max_abs"),
            ("signed, mean of the last contour", "last_mean"),
        )
    ]
    rows += [
        ["uncertainty of the prediction (1 σ), mean", _mm(outlook["uncertainty_mean_mm"]), DASH],
        ["uncertainty of the prediction (1 σ), largest", _mm(outlook["uncertainty_max_mm"]), DASH],
    ]
    head = ["at the contour points, vertical", "foreseen", "reached in the final scan"]
    caption = "Error that corrections foresaw, as what their limits leave: uncertainty comes on top"
    return table(caption, head, [row for row in rows if set(row[1:]) != {DASH}])


SPLIT_ROWS = {
    "correction": "sent beyond the plan by the correction",
    "tool": "δ<sub>1</sub>: forming tool beside where it was sent",
    "followed": "of which seen by the encoders",
    "deflected": "of which deflection under the force, less its compensation",
    "sheet": "δ<sub>2</sub>: sheet beside the tool: springback in the clamp, and what later contours moved",
    "error": "error of the part in the clamp: their sum",
    "support": "support tool under position control, beside where it was sent; positive: off the sheet",
}


def split_table(numbers: Numbers) -> str:
    """Where the error comes from; nothing where error or tips are not known."""
    split = numbers["error_split"]
    if split is None:
        return ""
    rows = [
        [words, *(_mm(split[name][f"{key}_mm"]) for key in ("mean", "rms", "max_abs"))]
        for name, words in SPLIT_ROWS.items()
    ]
    rows = [row for row in rows if set(row[1:]) != {DASH}]
    released = [split["released"][f"{key}_mm"] for key in ("mean", "rms", "max_abs")]
    measured = ["not measured" if value is None else _mm(value) for value in released]
    rows.append(["δ<sub>3</sub>: springback by unclamping and trimming, not in the sum", *measured])
    caption = (
        f"Where the error comes from (Ren 2018, eq. 1-1): at the points of {split['contours']} contours, normal to the "
        "wanted surface; positive: not far enough"
    )
    return table(caption, ["term", "mean", "rms", "largest"], rows, wrap=True)


def time_table(numbers: Numbers) -> str:
    """Planned beside actual time, and where the difference went; nothing without a formed contour."""
    time = numbers["time"]
    if time is None:
        return ""
    rows = [
        ["planned: path at its feed", _seconds(time["planned_s"])],
        ["actual: first to last tick of every contour", _seconds(time["actual_s"])],
        ["of which: lower speed at single points, by plan", _seconds(time["slowed_s"], sign=True)],
        ["of which: approach, building up and letting go of the force", _seconds(time["force_ramps_s"], sign=True)],
        ["of which: path slower in full force control than planned", _seconds(time["force_control_s"], sign=True)],
        [
            "of which: contours under position control: approach, lift, accelerating and braking",
            _seconds(time["rest_s"], sign=True),
        ],
        ["between contours: corrections, lifts, scans, waiting", _seconds(time["between_s"])],
        [
            "contour that took longest beyond its plan",
            f"{contour_label(time['slowest_contour'])}, {_seconds(time['slowest_excess_s'], sign=True)}",
        ],
    ]
    return table(f"Time of {time['contours']} formed contours, planned and actual", ["", ""], rows)


def force_region_table(numbers: Numbers) -> str:
    """Support force by region of the path; nothing without a support tool."""
    regions = numbers["force_regions"]
    if regions is None:
        return ""
    controlled = regions["all"]["rms_error_N"] is not None
    rows = []
    for name, words in REGION_WORDS.items():
        region = regions[name]
        row = [words, percent(region["share"]), percent(region["contact_lost_fraction"])]
        if controlled:
            row += [number(region[f"{key}_error_N"], 1) for key in ("mean", "rms", "p99_abs", "max_abs")]
            row.append(percent(region["within_10N_fraction"]))
        rows.append(row)
    head = ["where", "of the points", f"below {CONTACT:g} N"]
    if controlled:
        head += ["mean error [N]", "rms [N]", "99 % below [N]", "largest [N]", "within ± 10 N"]
    return table("Support force by region, at the contour points", head, rows)


def contact_loss_table(numbers: Numbers) -> str:
    """Where the support tool lost the sheet; nothing without a support tool."""
    losses = numbers["contact_losses"]
    if losses is None:
        return ""
    share = percent(losses["length_mm"] / losses["path_mm"]) if losses["path_mm"] else DASH
    rows = [
        ["stretches without contact", f"{losses['count']}"],
        ["their length", f"{number(losses['length_mm'], 1)} mm, {share} of the path"],
    ]
    if losses["count"]:
        begun = ", ".join(f"{name} {count}" for name, count in losses["begun_in"].items() if count)
        longest = losses["longest"]
        place = ", ".join(number(value, 1) for value in longest["start_mm"])
        rows += [
            ["where they begin", begun],
            [
                "longest",
                f"{number(longest['length_mm'], 1)} mm from ({place}) mm on {contour_label(longest['contour'])}",
            ],
        ]
    rows.append(["gain lowered because the loop oscillated", f"{numbers['backoffs']} times"])
    return table("Contact of the support tool", ["", ""], rows)


def _seconds(value: float | None, *, sign: bool = False) -> str:
    return DASH if value is None else f"{'+' if sign and value >= 0.0 else ''}{number(value, 1)} s"


def _mm(value: float | None) -> str:
    return DASH if value is None else f"{number(value)} mm"
