"""The funnel of Ren 2018, 2.4.1, on the plant: how deep until the sheet tears, without and with force control.

Printed are the angle of the wall at the entry (65 deg), sheet, tools, 200 N after the entry fillet and the depths of
failure, 19.0 and 22.1 mm. Assumed is an arc from there on, steepening until the sine law reaches the limit of the wall
angle at 19.0 mm (``examples/make_parts.py``, ``funnel_65``): the first depth is put into the geometry, and only how
much deeper the part under force control gets is left to the plant. That tests the gain of squeeze on the forming limit,
which was taken from the same pair of depths as if it were a pair of strains.
"""

from __future__ import annotations

import math
import runpy
import tempfile
from pathlib import Path

import trimesh
from isf_analysis.measures.record import PartRecord
from isf_cell.in_process import form
from isf_cell.options import RunOptions
from isf_core.events import Event, EventKind
from isf_core.files.job import JobFile
from isf_core.files.material import strain_of_angle
from isf_planner import plan
from isf_planner.part_library.part_mesh import part_mesh
from plant_validation import row

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
JOB = EXAMPLES / "jobs" / "ren_funnel.yaml"
PUBLISHED = {"position control": (0.0, 19.0), "200 N on the support tool": (200.0, 22.1)}
"""Set-point N and depth of failure mm."""
PUBLISHED_RATIO = 22.1 / 19.0
LIMIT = 66.0
"""deg, largest wall angle of one pass in the file of the material."""
STEEPEST = 85.0
"""deg, limit of the planner while the part is planned: it refuses what is to tear."""


def formed_funnel(limit: float, force: float) -> PartRecord:
    """The funnel whose arc reaches ``limit`` deg at 19.0 mm, in a sheet with this limit; ``force`` 0: position control
    without compensation of compliance."""
    with tempfile.TemporaryDirectory() as folder:
        part = runpy.run_path(str(EXAMPLES / "make_parts.py"))["funnel_65"](math.radians(limit))
        mesh = part_mesh(part, 10e-6)
        path = Path(folder) / "funnel.stl"
        trimesh.Trimesh(1e3 * mesh.vertices, mesh.faces, process=False).export(path)
        file = JobFile(JOB.read_text(encoding="utf-8").replace("../parts/ren_funnel.stl", str(path)), JOB.parent)
        file.job = file.job.model_copy(update={"wall_angle_limit": math.radians(STEEPEST)})
        planned = plan(file)
    control = file.job.control.model_copy(update={"compliance_compensation": 1.0 if force else 0.0})
    file.job = file.job.model_copy(update={"control": control})
    borne = strain_of_angle(math.radians(limit))
    file.material = file.material.model_copy(update={"fracture_strain": borne})
    return form(file, RunOptions(correction="none", support_force=force), part_plan=planned)


def torn(record: PartRecord) -> tuple[float, Event | None]:
    """mm, planned depth of the tip when the sheet tore, and the event; the depth of the part when it did not."""
    for event in record.events:
        if event.kind == EventKind.FRACTURE:
            k = next(k for k, result in enumerate(record.results) if event.time <= result.end)
            return -1e3 * float(record.nominal[k].forming_tip[:, 2].min()), event
    return -1e3 * float(record.nominal[-1].forming_tip[:, 2].min()), None


def funnel() -> None:
    """Depths at which the sheet tears; the first is calibrated by the geometry, the verdict is on the ratio."""
    depths, broken = [], []
    for control, (force, published) in PUBLISHED.items():
        depth, event = torn(formed_funnel(LIMIT, force))
        depths.append(depth)
        broken.append(event is not None)
        text = f"not torn down to {depth:.1f}"
        if event is not None:
            x, y, z = (1e3 * value for value in event.position)
            text = f"{depth:.1f}, after {event.time:.0f} s at ({x:.1f}, {y:.1f}, {z:.1f})"
        check = [] if force else [(depth if event else math.inf, published)]
        row(f"Ren funnel, {control}: torn at depth [mm]", f"{published:.1f}", text, "A" if force else "C", check)
    ratio = depths[1] / depths[0]
    text = f"{ratio:.3f}" if all(broken) else f"over {ratio:.2f}" if broken[0] else "-"
    check = [(ratio if all(broken) else math.inf, PUBLISHED_RATIO)]
    row("  deeper with force control by a factor of", f"{PUBLISHED_RATIO:.3f}", text, "A", check)
