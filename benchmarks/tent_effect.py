"""Tent effect on the simulated sheets: how far a shallow lower wall pulls the finished wall above it inwards.

Published: about 5 mm on ordinary two-slope parts (AA3103 of 1.5 mm, upper wall 35 mm and lower 17.5 mm deep, Behera
2015, on interactions of features). Assumed: half opening 75 mm, radii, a backing plate whose opening is 2 mm wider, 60
and 25 deg for the ordinary part, steps of 1 mm.

The part is formed along one tool path, until the upper wall is whole, to its end, and after every finishing pass asked
for. What a scan adds to the first is told along the normal of the upper wall, in the middle of its four sides, inwards
positive; scans are of the sheet in the clamp, without a tool. With --passes upper walls of those angles are formed one
after the other before that of the part, which is the ordinary way to a wall of 80 deg: 10.04 mm published.

usage: ./isf python benchmarks/tent_effect.py [--sheets shell_coarse,fast] [--angles 60 25] [--json]
           [--finishing-passes N] [--passes ANGLE ...]

shell_coarse takes 6 minutes of one core and 8 more for a finishing pass, fast half a minute.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import trimesh
from isf_cell import in_process
from isf_cell.options import RunOptions
from isf_cell.run.part_step import PartStep
from isf_core.contour import Contour
from isf_core.files.job import JobFile
from isf_core.simulated_sheet import SheetKind, sheet_kind
from isf_core.types import Array
from isf_planner import plan
from isf_planner.part_library.catalogue import ribbed_pyramid
from isf_planner.part_library.part_mesh import part_mesh

CLEAR = 8.0
"""mm of depth below the opening and above the rib that are left out: more than a tool radius."""

FRAME = 2.0
"""mm from the part's opening to that of the backing plate."""

JOB = """
name: tent_effect
part: {{mesh: {mesh}, unit: mm}}
process: SPIF
rig: behera2015
sheet: {{material: AA3103, thickness: 1.5 mm}}
tool_1: {{radius: 5 mm}}
wall_angle_limit: 85 deg
backing_plate: {{shape: rectangle, size: [{opening} mm, {opening} mm], corner_radius: 8 mm}}
path: {{incremental_depth: {step} mm, point_spacing: 0.5 mm, feed: 33 mm/s, finishing_passes: {finishing}}}
control: {{rate: 100 Hz}}
springback: {{method: none}}
"""


def job(given: argparse.Namespace, folder: Path, upper_angle: float) -> JobFile:
    """Of the part with two walls, the upper of ``upper_angle`` deg, its mesh in ``folder``."""
    upper, lower = np.radians((upper_angle, given.angles[1]))
    radii = {"rib": 6e-3, "entry": 3e-3, "transition": 6e-3, "floor": 5e-3}
    name = f"part_{upper_angle:g}.stl"
    part = ribbed_pyramid(1e-3 * given.half, upper, 1e-3 * given.upper, lower, 1e-3 * given.lower, **radii)
    mesh = part_mesh(part, 1e-5)
    trimesh.Trimesh(1e3 * mesh.vertices, mesh.faces, process=False).export(folder / name)
    opening, passes = 2.0 * (given.half + FRAME), given.finishing_passes
    return JobFile(JOB.format(mesh=name, opening=opening, step=given.step, finishing=passes), folder)


def above(contours: Iterable[Contour], upper: float) -> tuple[Contour, ...]:
    """Those of a wall down to ``upper`` m."""
    return tuple(contour for contour in contours if contour.forming_tip[:, 2].min() > -upper)


def numbered(passes: Iterable[tuple[Contour, ...]], plan_id: str) -> tuple[Contour, ...]:
    """One plan of all ``passes``, the tool off the sheet between them."""
    every = [
        replace(own[0], retract=True) if k and not n else c for k, own in enumerate(passes) for n, c in enumerate(own)
    ]
    return tuple(replace(one, plan_id=plan_id, index=k, count=len(every)) for k, one in enumerate(every))


def pull(job_file: JobFile, before: Sequence[JobFile], sheet: SheetKind, places: Array, upper: float) -> Array:
    """(P, N) m, by how much the surface is higher at ``places`` (N, 2) m of a wall down to ``upper`` m, once there is a
    wall below it, and after every finishing pass. The upper walls of the jobs ``before`` are formed first."""
    made = plan(job_file)
    walls = [above((c for c in plan(one).contours if not c.stage), upper) for one in before]
    passes = [tuple(c for c in made.contours if c.stage <= stage) for stage in range(made.contours[-1].stage + 1)]
    heights = []
    for contours in (above(passes[0], upper), *passes):
        part = replace(made, contours=numbered((*walls, contours), made.plan_id))
        record = in_process.form(job_file, RunOptions(sheet=sheet), part_plan=part, progress=_tell)
        if record.scan is None or (failure := record.failure()) is not None:
            raise SystemExit(f"{sheet}: ended early, contour {len(record.results)} of {len(part.contours)}: {failure}")
        heights.append(record.scan.at(places))
    return np.array(heights[1:]) - heights[0]


def _tell(step: PartStep) -> None:
    if sys.stderr.isatty():
        print(f"\rcontour {step.index + 1} of {step.count} ", end="", file=sys.stderr, flush=True)


def main() -> None:
    """Form and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sheets", default="shell_coarse,fast")
    parser.add_argument("--angles", default=(60.0, 25.0), nargs=2, type=float, help="deg, of upper and lower wall")
    parser.add_argument("--half", default=75.0, type=float, help="mm, half of the side of the opening")
    parser.add_argument("--upper", default=35.0, type=float, help="mm, depth of the upper wall")
    parser.add_argument("--lower", default=17.5, type=float, help="mm, depth of the lower wall")
    parser.add_argument("--step", default=1.0, type=float, help="mm, incremental depth")
    finishing = {"type": int, "choices": range(6), "metavar": "N"}
    parser.add_argument("--finishing-passes", default=0, help="over the whole part", **finishing)
    parser.add_argument("--passes", default=[], nargs="*", type=float, help="deg, upper walls formed before")
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()
    if given.upper <= 2.0 * CLEAR:
        parser.error(f"--upper: {CLEAR:g} mm at either end are left out, so more than {2.0 * CLEAR:g} mm are needed")
    angle = math.radians(given.angles[0])
    depth = np.linspace(CLEAR, given.upper - CLEAR, 5)
    out = 1e-3 * (given.half - depth / math.tan(angle))
    places = np.vstack([np.column_stack([out * x, out * y]) for x, y in ((1, 0), (0, 1), (-1, 0), (0, -1))])
    rows: dict[str, list[float]] = {}
    with TemporaryDirectory() as folder:
        try:
            job_file, *before = (job(given, Path(folder), one) for one in (given.angles[0], *given.passes))
        except ValueError as error:  # of walls that do not fit into the opening
            parser.error(str(error))
        for sheet in map(sheet_kind, given.sheets.split(",")):
            moved = 1e3 * math.cos(angle) * pull(job_file, before, sheet, places, 1e-3 * given.upper)
            for passes, one in enumerate(moved.reshape(len(moved), 4, -1).mean(axis=1).round(2).tolist()):
                rows[sheet if not passes else f"{sheet}, {passes} finishing"] = one
    if given.json:
        print(json.dumps({"depth_mm": depth.round(2).tolist(), "inwards_mm": rows}))
        return
    print(f"| upper wall moves inwards by [mm], depth [mm] | {' | '.join(f'{one:.1f}' for one in depth)} |")
    print(f"|---|{'---|' * len(depth)}")
    for sheet, inwards in rows.items():
        print(f"| {sheet} | {' | '.join(f'{one:+.2f}' for one in inwards)} |")


if __name__ == "__main__":
    main()
