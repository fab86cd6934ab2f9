"""The page of the springback table: published parts with their regions and goals, the table, pictures of every part."""

from __future__ import annotations

import json
import math
import statistics
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import springback_rows
from isf_analysis.figures import style
from isf_analysis.figures.shape_figures import deviation_pair, map_limit
from isf_analysis.measures.deviation import BANDS
from isf_analysis.measures.summary import MM
from isf_cell.commands.tryout import CONTROL_RATE
from isf_core.simulated_sheet import SEALED_VARIANTS

COMMAND = "./isf python benchmarks/springback_table.py --worlds 0,1-20 --jobs 2 --page"
SHELL_COMMAND = "./isf python benchmarks/springback_table.py --sheet shell_coarse --page"
MODELS = ("none", "analytic", "elastic", "fused(analytic)", "fused(elastic)", "fused(elastic)+push")
SHAPES = ("none", "mpc_vertical", "mpc_two_directional", "fused(elastic)-floor", "fused(elastic)")
LARGE = ("none", "analytic", "elastic", "fused(elastic)-floor", "fused(elastic)")


@dataclass(frozen=True)
class Goal:
    """What is to be reached: ``kind`` of measure, mm or share, in the median and in the worst world."""

    kind: str
    median: float
    worst: float


@dataclass(frozen=True)
class Published:
    """A part of a source: methods compared on it, region in which the source measures, its result, goals.

    ``large``: runs take so long that the off-nominal worlds are left out unless the part is asked for by name.
    """

    methods: tuple[str, ...]
    region: str
    uncorrected: str
    corrected: str
    goals: tuple[Goal, ...]
    note: str = ""
    large: bool = False


PRAVEEN = (Goal("max", 0.5, 0.8),)
PARTS: dict[str, Published] = {
    "ren_cone": Published(
        MODELS, "wall_and_base", "5.7 / 3.1", "1.5 / 0.8", (Goal("max", 0.6, 1.2), Goal("mean", 0.2, 0.5))
    ),
    "ren_cone_plate": Published(
        ("none", "elastic", "fused(elastic)"),
        "wall_and_base",
        "-",
        "-",
        (Goal("max", 0.6, 1.0), Goal("mean", 0.2, 0.4)),
        "over a plate 2 mm away, our own",
    ),
    "ren_pyramid": Published(
        MODELS, "wall_and_base", "4.8 / 2.6", "1.1 / 0.2", (Goal("max", 0.6, 1.1), Goal("mean", 0.15, 0.4))
    ),
    "lu_cone": Published(SHAPES, "base", "3.0", "0.25", (Goal("max", 0.15, 0.25),)),
    "lu_pyramid": Published(
        SHAPES, "walls_base", "3", "0.3 (corners 0.5)", (Goal("p95", 0.2, 0.3), Goal("max", 0.3, 0.5))
    ),
    "lu_asymmetric": Published(SHAPES, "walls_base", "3", "0.3 (few spots more)", (Goal("p95", 0.2, 0.3),)),
    "lu_tpif": Published(
        ("none", "mpc_tpif"),
        "wall_and_base",
        "19.5 % within 0.3",
        "70 % within 0.3",
        (Goal("share", 0.9, 0.8),),
    ),
    "praveen_cone_150": Published((*LARGE, "elastic"), "wall_and_base", "1.1", "0.33", PRAVEEN),
    "praveen_cone_250": Published(LARGE, "wall_and_base", "2.2", "0.75", PRAVEEN),
    "praveen_cone_610": Published(
        LARGE, "wall_and_base", "4.45", "0.77", PRAVEEN, "1 mm steps (published 0.5)", large=True
    ),
    "praveen_free_form": Published(LARGE, "wall_and_base", "2.88", "0.74", PRAVEEN, "F1 of 260 mm alone"),
}
"""mm, vertical, in the clamp. Sources: Ren 2018, 4.3; Lu 2016, 4.2-4.4; Praveen 2020, 3.2."""

WORDS = {
    "wall_and_base": "whole opening",
    "base": "base",
    "walls_base": "walls (steeper than 15 deg) and base",
}
SHELL_HEADER = "\n".join(
    ("| part | method | published | whole opening | base | rim | sealed: median; worst | formed on |", "|---" * 8 + "|")
)
HEADER = (
    "| part | method | worlds | nominal | median world | worst world | goals: median; worst |"
    "\n|---|---|---|---|---|---|---|"
)


def table(rows: Sequence[dict[str, Any]]) -> str:
    """Markdown table of all rows: per part and method the nominal world, median and worst of the others."""
    lines = [HEADER]
    for name, part in PARTS.items():
        methods = dict.fromkeys([*part.methods, *(row["method"] for row in rows if row["job"] == name)])
        found = [(method, springback_rows.of(rows, name, method)) for method in methods]
        lines += [line(name, part, method, some) for method, some in found if some]
    return "\n".join(lines)


def line(name: str, part: Published, method: str, rows: Sequence[dict[str, Any]]) -> str:
    """One line; runs that ended early are told and count in no number."""
    whole = [row for row in rows if row["code"] == 0 and part.region in row]
    nominal = [row for row in whole if row["world"] == 0]
    others = [row for row in whole if row["world"] != 0]
    ended = sorted({(row["contours"], row["planned"], row["code"]) for row in rows if row["code"]})
    reported = [f"{k} of {planned} contours, code {code}" for k, planned, code in ended]
    worlds = ("0" if nominal else "-") + (f" and {len(others)}" if others else "")
    cells = [
        name,
        method,
        "; ".join([worlds, *reported]),
        _numbers(part, nominal, statistics.median),
        _numbers(part, others, statistics.median),
        _numbers(part, others, max),
        "-" if method.startswith("none") else _goals(part, others, ended=bool(ended)),
    ]
    return "| " + " | ".join(cells) + " |"


def shell_table(rows: Sequence[dict[str, Any]]) -> str:
    """Markdown table of rows on elasto-plastic sheets, by part, method and sheet."""
    lines = [SHELL_HEADER]
    for name, part in PARTS.items():
        mine = [row for row in rows if row["job"] == name]
        for method in dict.fromkeys([*part.methods, *(row["method"] for row in mine)]):
            for sheet in dict.fromkeys(row["sheet"] for row in mine):
                found = springback_rows.of([row for row in mine if row["sheet"] == sheet], name, method)
                lines += [_shell_line(name, part, method, sheet, found)] if found else []
    return "\n".join(lines)


def _shell_line(name: str, part: Published, method: str, sheet: str, rows: Sequence[dict[str, Any]]) -> str:
    """One line: the nominal world by region, the worst of the sealed ones, and which runs ended early."""
    whole = [row for row in rows if row["code"] == 0 and part.region in row]
    nominal = next((row for row in rows if row["world"] == 0), None)
    regions = [_region(nominal, region) for region in ("wall_and_base", "base", "rim")]
    if nominal is not None and nominal["code"]:
        regions = [_ended(nominal), "-", "-"]
    sealed = [row for row in whole if row["world"] in SEALED_VARIANTS]
    others = [f"{row['world']}: {_ended(row)}" for row in rows if row["code"] and row is not nominal]
    formed_on = [f"{sheet}, {rows[0].get('elements', '-')} elements"]
    if nominal is not None and not nominal["code"]:
        formed_on.append(f"kinetic / plastic {100 * nominal['kinetic_over_plastic']:.2f} %")
    formed_on.append(f"{statistics.median(row['cpu_s'] for row in rows):.0f} s of CPU")
    shares = [row["force_N"] / row["rig_N"] for row in rows if "rig_N" in row and math.isfinite(row["force_N"])]
    formed_on += [f"up to {max(shares):.2f} of the force that the rig bears"] if shares else []
    published = part.uncorrected if method.startswith("none") else part.corrected
    cells = [name, method, published, *regions, "; ".join([*_sealed(sealed), *others]) or "-"]
    return "| " + " | ".join([*cells, ", ".join(formed_on)]) + " |"


def _sealed(rows: Sequence[dict[str, Any]]) -> list[str]:
    """Median and worst of the largest and the mean error, mm, over sealed worlds; nothing where there are none."""
    errors = [row["wall_and_base"] for row in rows]
    over = {"median": statistics.median, "worst": max} if errors else {}
    return [
        " / ".join(f"{of([error[kind] for error in errors]):.2f}" for kind in ("max", "mean"))
        + (f" of {len(rows)}" if name == "median" else ", worst")
        for name, of in over.items()
    ]


def _ended(row: dict[str, Any]) -> str:
    return f"ended at contour {row['contours']} of {row['planned']}, {row['code']}"


def _region(row: dict[str, Any] | None, region: str) -> str:
    """Largest, mean and signed mean error of a region, mm; a dash where there is none."""
    found = (row or {}).get(region)
    return f"{found['max']:.2f} / {found['mean']:.2f} / {found['signed']:+.2f}" if found else "-"


def _kinds(part: Published) -> tuple[str, ...]:
    kinds = ["max", "mean", *(goal.kind for goal in part.goals)]
    return tuple(dict.fromkeys(kinds)) if part.goals[0].kind != "share" else ("share", "max", "mean")


def _numbers(part: Published, rows: Sequence[dict[str, Any]], of: Any) -> str:
    if not rows:
        return "-"
    return " / ".join(_shown(kind, _over(rows, part.region, kind, of)) for kind in _kinds(part))


def _over(rows: Sequence[dict[str, Any]], region: str, kind: str, of: Any) -> float:
    values = [float(row[region][kind]) for row in rows]
    if of is max and kind == "share":
        return min(values)  # the worst world is that of the smallest share
    return float(of(values))


def _shown(kind: str, value: float) -> str:
    return f"{100 * value:.0f} %" if kind == "share" else f"{value:.2f}"


def _goals(part: Published, rows: Sequence[dict[str, Any]], *, ended: bool) -> str:
    """Each goal with what became of it: met, missed, or open while no off-nominal world was run."""
    texts = []
    for goal in part.goals:
        states = []
        for of, bound in ((statistics.median, goal.median), (max, goal.worst)):
            state = "open"
            if rows:
                value = _over(rows, part.region, goal.kind, of)
                good = value >= bound if goal.kind == "share" else value <= bound
                state = "met" if good and not (ended and of is max) else "missed"
            states.append(f"{_shown(goal.kind, bound)} {state}")
        texts.append(f"{goal.kind} " + "; ".join(states))
    return ", ".join(texts)


def best(rows: Sequence[dict[str, Any]], name: str) -> str | None:
    """Method with the smallest median of the part's first goal (largest share), of those with most worlds; not none."""
    part = PARTS[name]
    goal = part.goals[0]
    scores: list[tuple[int, float, str]] = []
    for method in dict.fromkeys(row["method"] for row in rows if row["job"] == name):
        found = springback_rows.of(rows, name, method)
        whole = [row for row in found if row["code"] == 0 and part.region in row]
        if not method.startswith("none") and whole and len(whole) == len(found):
            value = _over(whole, part.region, goal.kind, statistics.median)
            scores.append((-len(whole), -value if goal.kind == "share" else value, method))
    return min(scores)[2] if scores else None


def pictures(rows: Sequence[dict[str, Any]], maps: Path, folder: Path, prefix: str = "springback") -> list[str]:
    """Error maps of the nominal world without correction and with the best method, one picture per part."""
    texts = []
    for name in PARTS:
        method = best(rows, name)
        nominal = {row["method"]: row for row in rows if row["job"] == name and row["world"] == 0}
        shapes = [
            springback_rows.shapes(maps / f"{nominal[wanted]['key']}.npz") if wanted in nominal else None
            for wanted in ("none" if "none" in nominal else "none-floor", method or "")
        ]
        if method is None or shapes[0] is None or shapes[1] is None:
            continue
        (before, before_target), (after, target) = shapes[0], shapes[1]
        with style.applied():
            figure = deviation_pair(before, before_target, after, target, map_limit(before, after), method)
            data = style.png(figure)
        path = folder / "images" / f"{prefix}_{name}.png"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)
        texts.append(f"### {name}\n\n![{name}: without correction and with {method}](images/{path.name})\n")
    return texts


def _time(rows: Sequence[dict[str, Any]], name: str) -> str:
    times = [row["cpu_s"] for row in rows if row["job"] == name and row["code"] == 0]
    return f"{statistics.median(times):.0f}" if times else "-"


def write(rows: Sequence[dict[str, Any]], digest: str, maps: Path, folder: Path) -> Path:
    """Write the page, its pictures, and ``rows`` beside it; returns the page."""
    versions = sorted({row["sources"] for row in rows})
    reported = (
        f"Sources {digest}." if versions == [digest] else f"Rows of sources {', '.join(versions)}; present {digest}."
    )
    regions = "\n".join(
        f"| {name} | {WORDS[part.region]} | {part.uncorrected} | {part.corrected} | {_time(rows, name)} "
        f"| {part.note or '-'} |"
        for name, part in PARTS.items()
    )
    text = f"""# Springback: parts, methods, worlds

Written by `{COMMAND}`.
{reported}
Every run is a line of [springback.jsonl](springback.jsonl), lengths in mm.
Fast simulated sheet, formed in one process (elasto-plastic: [other page](springback_shell.md)); vertical errors in the
clamp, formed minus target, mm. World 0 is nominal; in the others sheet, machine and load cells are off by up to 20 %,
which the controllers do not know. Methods that look at the shape see a scan with noise, holes and registration after
every contour. First contours go by the predicted force
(`springback.first_contour`); the plant is that of the sources named above. With `+push` the edge of the clamp was
calibrated before the part, by one push on the flat sheet in that world (`isf springback calibrate`). With `-floor` the
passes over the floor that the job asks for are left out ([planning](../methods/paths.md#passes-over-the-floor)).

## Published

| part | region | uncorrected | corrected | CPU of a run here [s] | what differs here |
|---|---|---|---|---|---|
{regions}

Largest, or largest / mean. What else the jobs assume stands in `examples/jobs`.

## Reached

Per cell: largest / mean, then the measures of the goals (p95: 95 % of the points are closer; share: points within
{MM * BANDS[-1]:.1f} mm). Runs that ended early are named with their contours and code and count in no number.

{table(rows)}

## Error maps, nominal world

Left without correction, right the best method by the median of the first goal; the number on a map is the largest error
of the whole opening, whatever region the source measures.

{chr(10).join(pictures(rows, maps, folder)) or "None yet."}"""
    return _kept(folder / "springback.md", text, rows)


def write_shell(rows: Sequence[dict[str, Any]], maps: Path, folder: Path) -> Path:
    """The page of the rows on elasto-plastic sheets, as :func:`write`."""
    versions = ", ".join(sorted({row["sources"] for row in rows}))
    text = f"""# Springback on the elasto-plastic sheet

Written by `{SHELL_COMMAND}`; rows of sources {versions}.
Every run is a line of [springback_shell.jsonl](springback_shell.jsonl), lengths in mm; what has no line was not run.
The shipped jobs, at {CONTROL_RATE:g} Hz of control (at 500 Hz the shape of mini_cone is the same within 0.01 mm), on
the sheet that yields outside the tool ([the model](../methods/shell_sheet.md)): nothing of it was chosen on these
parts. The [other page](springback.md) has the fast sheet, which is flat again outside the opening; corrections were
made for that one.

Errors are vertical, in the clamp, formed minus target: largest / mean / signed mean of the region, mm, nominal world;
rim: 10 mm around the opening. Sealed worlds (101 and up) differ in structure and have chosen no constant. Published:
largest / mean, without or with correction; each source's own region stands on the other page. The axial force of
coarse cells is [too high](../methods/shell_sheet.md#axial-force), so that the simulated machine bears 1.8 times what
its rig says (`shell`: 1.55). The last column has the mean axial force of the hardest contour over the rig's limit:
where it exceeds 1 this sheet cannot say whether a real machine forms the part. What ended early met the raised limit
(1203, 1405).

{shell_table(rows)}
"""
    if maps_of_parts := pictures(rows, maps, folder, "springback_shell"):
        text += f"""
## Error maps, nominal world

Left without correction, right the method with the smallest error of those that formed the whole part; the number on a
map is the largest error of the whole opening.

{chr(10).join(maps_of_parts)}"""
    return _kept(folder / "springback_shell.md", text, rows)


def _kept(path: Path, text: str, rows: Sequence[dict[str, Any]]) -> Path:
    """Write a page, and its rows beside it."""
    lines = [json.dumps(row) for row in sorted(rows, key=lambda row: (row["job"], row["method"], row["world"]))]
    path.with_suffix(".jsonl").write_text("".join(f"{line}\n" for line in lines), encoding="utf-8")
    path.write_text(text.rstrip() + "\n", encoding="utf-8")
    return path
