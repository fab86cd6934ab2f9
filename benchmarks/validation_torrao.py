"""Cones of Torrao 2013, chapter 7, on the plant: which wall tears, and the force of two materials.

Printed are: AA1050, 1 mm, blank of 230 mm; 45 deg formed, 70 deg torn (7.1.1); about 1 kN in aluminium and about five
times as much in dual-phase steel of the same thickness (7.1.3). Not printed are size, tool, step and feed of the cones,
wall angle of those whose force was measured, temper of the aluminium, and any constant of the two sheets: those of the
tensile curves in Fig. 7.13 are other authors' sheets. Assumed here: 45 deg, ball of 10 mm, steps of 1 mm, both alike.
"""

from __future__ import annotations

from argparse import Namespace
from pathlib import Path

import numpy as np
from axial_force import row as shell_row
from isf_analysis.measures.record import PartRecord
from isf_cell.in_process import form
from isf_cell.options import RunOptions
from isf_core.events import torn
from isf_core.files.job import load_job
from isf_core.files.material import flow_curve, load_material
from isf_core.process.forming_force import aerens_axial_force
from plant_validation import row

JOBS = Path(__file__).resolve().parents[1] / "examples" / "jobs"
CELL = 3.5e-3
"""m, cells of the elasto-plastic sheet: coarse, so that its forces are about half too large (axial_force.py)."""
PUBLISHED = {"AA1050": 1000.0, "DPS780": 5000.0}
HALF_HARD = (105e6, 145e6)
"""Pa, tensile strength of half-hard AA1050 (EN 485-2, H14 and H24)."""
STRAINS = np.linspace(0.05, 1.2, 200)
"""Plastic strains in a wall of 45 deg and below the tool, with room to both sides."""


def formed(job: str) -> PartRecord:
    """The part of an example, without correction."""
    return form(load_job(JOBS / f"{job}.yaml"), RunOptions(correction="none"))


def axial_force(record: PartRecord) -> float:
    """N, mean of the upper tool on the last third of the contours, without the last one, where the wall ends."""
    wall = record.results[2 * len(record.results) // 3 : -1]
    return float(np.mean([result.forming_force[:, 2].mean() for result in wall]))


def shell_force(material: str) -> float:
    """N, of the elasto-plastic sheet: a cone of 45 deg, 11 mm deep, over a plate."""
    cone = Namespace(radius=22.0, angle=45.0, depth=11.0, tool=5.0, step=1.0, thickness=1.0, speed=20.0)
    cone.material = material
    return float(shell_row(cone, CELL)["force_n"])


def stress_ratio() -> tuple[float, float]:
    """Least and largest ratio of the flow stresses of both sheets.

    Limit analysis: with the velocities of one sheet's collapse, the other's power bounds its force from above, both
    ways round. So the ratio of the forces lies between these, whatever the tool does, as long as elasticity counts for
    nothing and both have gone through the same strains.
    """
    soft, hard = (flow_curve(load_material(name)) for name in PUBLISHED)
    ratio = np.asarray(hard.stress(STRAINS)) / np.asarray(soft.stress(STRAINS))
    return float(ratio.min()), float(ratio.max())


def torrao() -> None:
    """Torn walls, forces and their ratio."""
    soft = formed("torrao_cone_45")
    for angle, record, reported in ((45, soft, "formed"), (70, formed("torrao_cone_70"), "torn")):
        lost = torn(record.events)
        found = "formed" if lost is None else "torn"
        text = found if lost is None else f"torn, {lost.where}"
        check = [(float(found == reported), 1.0)]
        row(f"Torrao cone of {angle} deg, AA1050 1 mm, through the machine", reported, text, "C", check)
    forces = {"AA1050": axial_force(soft), "DPS780": axial_force(formed("torrao_cone_dps780"))}
    for name, force in forces.items():
        published = PUBLISHED[name]
        row(f"  {name}: axial force [N]", f"about {published:.0f}", f"{force:.0f}", "A", [(force, published)], 0.2)
    ratio = forces["DPS780"] / forces["AA1050"]
    row("  DPS780 over AA1050", "about 5", f"{ratio:.1f}", "A", [(ratio, 5.0)], 0.2)
    shell = {name: shell_force(name) for name in PUBLISHED}
    texts = " / ".join(f"{force:.0f}" for force in shell.values())
    row(f"  elasto-plastic sheet, cells of {1e3 * CELL:g} mm: both [N]", "about 1000 / 5000", texts, "-")
    ratio = shell["DPS780"] / shell["AA1050"]
    row("  elasto-plastic sheet: DPS780 over AA1050", "about 5", f"{ratio:.1f}", "A", [(ratio, 5.0)], 0.2)
    least, most = stress_ratio()
    row("  bounds of limit analysis with these flow curves", "-", f"{least:.1f} to {most:.1f}", "-")
    strong = load_material("DPS780").tensile_strength
    weaker = " to ".join(f"{strong / strength:.1f}" for strength in reversed(HALF_HARD))
    row("  regression, were the aluminium half-hard", "about 5", weaker, "-")
    of_tool = aerens_axial_force(load_material("AA1050").tensile_strength, 1e-3, 7.5e-3, 10e-3, np.radians(45.0))
    text = f"{forces['DPS780'] / float(of_tool):.1f}"
    row("  regression, were it formed in steps of 10 mm by the tool of 15 mm", "about 5", text, "-")
