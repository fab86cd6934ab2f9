"""Writes docs/results/validation.md and its pictures from the rows of plant_validation.py."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
from isf_analysis.figures import style
from isf_core.types import Array
from isf_sim.plant_constants import PlantConstants, provenance
from isf_sim.variant import STANDARD_VARIANTS, make_variant

DOCS = Path(__file__).resolve().parents[1] / "docs" / "results"
DATA = Path(__file__).with_name("validation_rows.json")
"""Rows of the last run of every part."""

TITLES = {
    "ren_cone": "Cone of Ren 2018, uncorrected, 0.2 mm steps",
    "ren_pyramid": "Pyramid of Ren 2018 along x, uncorrected, 0.2 mm steps",
    "lu_cone": "Cone of Lu 2016 over a backing plate, 2 mm steps",
    "behera_pyramid": "Pyramid of Behera 2015, middle of the walls",
    "two_slopes_60": "Pyramid of 60 and 25 deg after Behera 2015, middle of the walls",
    "two_slopes_80": "Pyramid of 80 and 25 deg after Behera 2015, middle of the walls",
    "tpif_cone": "Two-point forming over a die",
    "adsif_cone": "Accumulative forming, gap compensated",
}
BANDS = {
    "ren_cone": (5.7, "published largest error 5.7 mm"),
    "ren_pyramid": (4.8, "published largest error 4.8 mm"),
    "lu_cone": (3.0, "published base error about 3 mm"),
}
"""mm over the target's base, as published."""

HEAD = """# Validation of the simulated machine

Written by `./isf python benchmarks/plant_validation.py --page`; nothing here was measured on a real cell. Every row is
a published number and what the plant gives for it.

* **P** predicted: no constant was tuned to the number. **C** calibrated: a constant was. **A** depends on a dimension
  that the source does not print and that had to be assumed.
* *met*: within 15 % (forces 20 %) with the right sign; *fails*: not so; -: nothing to compare with.
"""


def write(
    fresh: dict[str, list[dict[str, str]]], sections: dict[str, tuple[Array, Array, Array]], order: Sequence[str]
) -> None:
    """The page, with the ``fresh`` rows of some parts in place of earlier ones, and a picture of every section."""
    known = json.loads(DATA.read_text(encoding="utf-8")) if DATA.is_file() else {}
    known.update(fresh)
    DATA.write_text(json.dumps({name: known[name] for name in order if name in known}, indent=1) + "\n")
    rows = [item for name in order for item in known.get(name, [])]
    for name, (r, target, formed) in sections.items():
        _picture(name, r, target, formed)
    pictures = [
        f"![{title}](images/validation_{name}.png)\n"
        for name, title in TITLES.items()
        if (DOCS / "images" / f"validation_{name}.png").is_file()
    ]
    missing = [name for name in order if name not in known and name != "speed"]
    earlier = (
        ["\\* measured before the mesh was graded and the sheet elastic between tool and clamp; not run again.\n"]
        if any(item.get("earlier") for item in rows)
        else []
    )
    notes = [f"Not run yet: {', '.join(missing)}.\n"] if missing else []
    parts = [HEAD, _table(rows), _counts(rows), *earlier, *notes, *pictures]
    parts += [_MATERIALS, _CONSTANTS_HEAD, _constants(), _EVENTS, _VARIANTS_HEAD, _variants(), _LIMITS]
    (DOCS / "validation.md").write_text("\n".join(parts), encoding="utf-8")


def _table(rows: Sequence[dict[str, Any]]) -> str:
    lines = ["| quantity | published | plant | | |", "|---|---|---|---|---|"]
    for item in rows:
        verdict = "**fails**" if item["verdict"] == "fails" else item["verdict"]
        plant = f"{item['plant']} \\*" if item.get("earlier") else item["plant"]
        cells = (item["quantity"].strip(), item["published"], plant, verdict, item["tag"])
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def _counts(rows: Sequence[dict[str, Any]]) -> str:
    predicted = [item for item in rows if item["verdict"] != "-" and not item["tag"].startswith("C")]
    met = sum(item["verdict"] == "met" for item in predicted)
    return f"Of {len(predicted)} rows that were not calibrated {met} are met.\n"


def _picture(name: str, r: Array, target: Array, formed: Array) -> None:
    with style.applied():
        figure = style.new_figure(3.4)
        axes = figure.add_subplot()
        axes.plot(1e3 * r, 1e3 * target, color=style.TARGET, label="target")
        axes.plot(1e3 * r, 1e3 * formed, color=style.UNCORRECTED, label="plant")
        if name in BANDS:
            error, text = BANDS[name]
            axes.axhline(1e3 * float(np.nanmin(target)) + error, color=style.MUTED, ls="--", lw=1, label=text)
        axes.set(xlabel="distance from the centre [mm]", ylabel="height [mm]", title=TITLES[name])
        axes.legend(frameon=False)
        (DOCS / "images" / f"validation_{name}.png").write_bytes(style.png(figure))


_MATERIALS = """## Two materials

Torrao 2013, 7.1.3, forms truncated cones of 1 mm and measures "around 1 kN" in AA1050 and "about five times" as much
in DPS780, where tensile curves had made ten times expected. Size, wall angle, tool, step and feed of the two cones are
not printed, nor is the temper of the aluminium or any constant of the sheets; both curves are other authors' sheets.
The plant has the soft temper (R_m 80 MPa) and the standard grade (R_m 800 MPa), both assumed, and one cone for both:
45 deg, a ball of 10 mm, steps of 1 mm.

| judge | DPS780 over AA1050 |
|---|---|
| published | about 5 |
| fast sheet: regression, linear in R_m | 10.0 |
| elasto-plastic sheet, cells of 3.5 / 2.5 mm (`axial_force.py --step 1`) | 9.2 / 9.4 |
| CalculiX, a clamped disc pressed down by 1 to 5 mm (`calculix_press.py`) | 9.0 to 11.0 |
| ratio of the flow stresses, plastic strains from 0.05 to 1.2 | 8.6 to 11.1 |

The last row holds for every rigid-plastic model with these curves, one tool, path and friction, and equal strains
behind both sheets. With the velocities of one sheet the other's power bounds its force from above, and the same the
other way round, so the ratio of the forces lies between the least and the largest ratio of the flow stresses: bending
and stretching cannot make 5 of it. Ten times is what these curves give, and no constant of the plant was changed.

So the sheets or the conditions of the two tests were probably others. The aluminium is further off than the steel: the
plant gives 0.36 kN of 1 kN, and 3.6 kN of 5 (elasto-plastic, with the coarser cells, which make forces too large: 0.57
and 5.3 kN). By the regression half-hard aluminium (R_m 105 to 145 MPa, EN 485-2) makes the ratio 5.5 to 7.6; and so
do, with the soft one, steps of 10 mm, which the source used on aluminium: 6.6, or 5.8 with the tool of 15 mm. Which it
was, if one of these, is not known.
"""

_CONSTANTS_HEAD = """## Constants

Calibrated, over all rigs together: the bulge below, the limit of chips (one pair of published forces), the gain of
squeeze on the forming limit (one pair of depths), two entries of the force table of ADSIF, the wall-angle limit of
AA1050, what bends use up of the forming limit (AA3103) and the forming limit of AA7075-O: eight. The five constants of
the surface of stable angles are a fit to the 19 angles that are published with it.
Constants of rigs and materials are in their files, each with its origin.
"""


def _constants() -> str:
    lines = ["| constant | value | origin |", "|---|---|---|"]
    origins = provenance()
    for item in fields(PlantConstants):
        if not origins[item.name].startswith("assumed"):
            lines.append(f"| {item.name} | {item.default:g} | {origins[item.name]} |")
    return "\n".join(lines) + "\n"


_EVENTS = """## Events and limits

| event | condition | origin |
|---|---|---|
| fracture | major + k minor strain + b sum(t0/2R) > e_f (1 + 0.16 F_n/200 N), four radii | material; gain calibrated |
| galling | support force over 0.42 R_m R t0; not reported in ADSIF | calibrated: 120 N and 200 N of Ren 2018, 2.4.1 |
| buckling | ADSIF: gap below 0.6 t0, below 0.7 t0 at position angles up to 25 deg | published: Ren 2018, 3.2.3 |
| contact lost | no support force for 0.1 s beside the pressing tool, which goes on | assumed times |
| die contact | sheet under the tool carried by die or backing plate | - |
| saturation | load cell at the end of its range, axis beyond its following error | - |
| load cell, force unknown | told by node `load_cell` of the nine channels of spindle cells | - |

e_f, k and b are `fracture_strain`, `fracture_slope` and `bending_share` of the material, and nothing else: what a job's
`wall_angle_limit` or a material's `max_wall_angle` lets the planner make is another thing. Strains are those of the
material from the flat blank on, so a wall of several passes is stretched less than one of a single pass, and bent more
often. Where no source gives e_f it comes from the largest wall angle, 1.15 ln(1 / cos a) + b sin a tan a: 1.15 is what
the plant's own thinning of one pass is over the sine law, the rest its bends. The gain of squeeze is a ratio of depths
(19.0 and 22.1 mm), taken as a ratio of strains (assumed). The funnel that this pair was measured on is formed on an
assumed generatrix, an arc from the printed 65 deg that reaches 66 deg, by the sine law the limit, at 19.0 mm: the first
depth is put in by the geometry, and only how much deeper force control gets is the plant's answer. It is too deep: [the
sheet](../methods/sheet.md) explains it. b is calibrated on two walls of several passes (0.13 to 0.22 separate them) and
e_f of AA7075-O between steps of 0.5 and 0.7 mm; smaller and larger steps follow. The wall of 80 deg in four passes tore
at the ribs of a pyramid and at the bottom of a cone; the cone that is formed for these rows tells no place on its wall
apart.
"""

_VARIANTS_HEAD = """## Variants 1 to 20

Controllers are scored on these (seed 0, `isf_sim.variant.STANDARD_VARIANTS`), never on the nominal one alone; others
differ in [structure](../methods/machine.md#variants).
Factors on the nominal constants; edge spring in N/mm^2; registration of a scanner in mm and deg.
The yield strength acts through the flow stress alone, its mean with the tensile strength: on the stiffness of the
squeeze between the tools and of the sheet between tool and die. The sheet between tool and clamp never yields.
"""


def _variants() -> str:
    lines = [
        "| variant | E | t | force | friction | compliance | cell | edge | yield | registration x, y, z, turn |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for number in STANDARD_VARIANTS:
        w = make_variant(number)
        shift = ", ".join(f"{1e3 * v:+.2f}" for v in (w.registration_x, w.registration_y, w.registration_z))
        lines.append(
            f"| {number} | {w.young_modulus:.3f} | {w.thickness:.3f} | {w.force_level:.3f} | {w.friction:.3f} | "
            f"{w.compliance:.3f} | {w.load_cell_gain:.3f} | {w.edge_spring / 1e6:.1f} | {w.yield_strength:.3f} | "
            f"{shift}, {np.degrees(w.registration_turn):+.3f} |"
        )
    return "\n".join(lines) + "\n"


_LIMITS = """## What is simplified

* Circular clamps are the squares around them. The hexapod checks its workspace; servo and errors act along x, y and z.
* ADSIF has no over-bend while the tools pass, no elastic recovery, and one response surface (1 mm, R 5 mm, AA5754-O).
* TPIF: what closed loops of the tool enclose rises with the die as a whole, and the sheet never lies below the die; the
  flange hangs between the edge of the part and the clamp like a membrane. Springback is the sag of the sheet under the
  tool's force, as in the other processes; the part itself does not bend on its die between contours.
* A scan of the unclamped, trimmed part cuts the flange and levels the rim; the change of shape by unclamping itself
  (published: at most 0.03 mm on walls) is left out. Sizes of shine, shadow and registration are assumed.
* Torques of a load cell have neither drift nor zero offset. Backlash is a pure play without friction.
"""
