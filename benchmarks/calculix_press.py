"""Force of one sheet over that of another by CalculiX, which shares the flow curve with the simulated sheets alone.

A clamped round sheet is pressed down in its middle: axisymmetric, four quadratic elements through the thickness, large
strains; what a tool would touch, a patch of its top, is moved down. Needs the solver ``ccx`` (apt: calculix-ccx).

usage: ./isf python benchmarks/calculix_press.py [--materials AA1050,DPS780] [--json]
"""

from __future__ import annotations

import argparse
import json
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from isf_core.files.hardening_law import YIELD_STRAIN
from isf_core.files.material import Material, flow_curve, load_material
from isf_core.types import Array

RADIUS, PATCH, THICKNESS, DEPTH = 30.0, 2.0, 1.0, 5.0
"""mm, of the clamp, of what is moved down, of the sheet, and how far."""
DEPTHS = (1.0, 2.0, 3.0, 4.0, 5.0)
"""mm that are printed; above 1 mm the sheet has yielded all through."""
LAYERS = 4


def input_file(material: Material) -> str:
    """Text of CalculiX's input, in mm, N and MPa."""
    ends = np.concatenate([np.linspace(0.0, 6.0, 25), np.linspace(6.0, RADIUS, 37)[1:]])
    across = np.sort(np.concatenate([ends, 0.5 * (ends[1:] + ends[:-1])]))
    up = np.linspace(-THICKNESS, 0.0, 2 * LAYERS + 1)
    places = [(i, j) for i in range(len(across)) for j in range(len(up)) if not (i % 2 and j % 2)]
    number = {place: k for k, place in enumerate(places, start=1)}
    lines = ["*NODE", *(f"{k},{across[i]:.6f},{up[j]:.6f},0" for (i, j), k in number.items())]
    lines.append("*ELEMENT,TYPE=CAX8R,ELSET=SHEET")
    corners = ((0, 0), (2, 0), (2, 2), (0, 2), (1, 0), (2, 1), (1, 2), (0, 1))
    elements = [(i, j) for i in range(0, len(across) - 1, 2) for j in range(0, 2 * LAYERS, 2)]
    for k, (i, j) in enumerate(elements, start=1):
        lines.append(",".join(str(item) for item in (k, *(number[i + a, j + b] for a, b in corners))))
    sets = {
        "PATCH": [k for (i, j), k in number.items() if j == 2 * LAYERS and across[i] <= PATCH + 1e-9],
        "CLAMP": [k for (i, _), k in number.items() if i == len(across) - 1],
        "AXIS": [k for (i, _), k in number.items() if i == 0],
    }
    for name, nodes in sets.items():
        lines += [f"*NSET,NSET={name}", *(str(k) for k in nodes)]
    lines += ["*MATERIAL,NAME=M", "*ELASTIC", f"{material.young_modulus / 1e6},{material.poisson_ratio}", "*PLASTIC"]
    strain = np.concatenate([[0.0], np.geomspace(YIELD_STRAIN, 3.0, 60)])
    stress = np.asarray(flow_curve(material).stress(strain)) / 1e6 + 1e-3 * strain  # the solver wants it to rise
    lines += [f"{s:.6f},{e:.6f}" for s, e in zip(stress, strain, strict=True)]
    lines += ["*SOLID SECTION,ELSET=SHEET,MATERIAL=M", "*BOUNDARY", "CLAMP,1,2", "AXIS,1,1"]
    lines += ["*STEP,NLGEOM,INC=1000", "*STATIC", "0.02,1,1e-6,0.05", "*BOUNDARY", f"PATCH,2,2,{-DEPTH}"]
    lines += ["*NODE PRINT,NSET=PATCH,TOTALS=ONLY", "RF", "*END STEP"]
    return "\n".join(lines) + "\n"


def forces(material: Material) -> Array:
    """(len(DEPTHS),) force at DEPTHS, N on the wedge of 2 deg that the solver makes of an axisymmetric body."""
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "press.inp").write_text(input_file(material), encoding="utf-8")
        result = subprocess.run(["ccx", "-i", "press"], cwd=folder, capture_output=True, text=True, check=False)
        found = Path(folder) / "press.dat"
        text = found.read_text(encoding="utf-8") if found.is_file() else ""
    total = r"time\s+(\S+)\s+\S+\s+(-?\d\S+)"
    rows = np.array([[float(item) for item in row] for row in re.findall(total, text)]).reshape(-1, 2)
    if not len(rows) or rows[-1, 0] < 1.0:
        sys.exit(f"CalculiX did not press {material.name} down to {DEPTH:g} mm:\n{result.stdout[-600:]}")
    return np.interp(np.array(DEPTHS) / DEPTH, rows[:, 0], np.abs(rows[:, 1]))


def main() -> None:
    """Print the ratio of the forces over the depth."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--materials", default="AA1050,DPS780", help="two, with a comma: the second over the first")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    names = options.materials.split(",")
    if len(names) != 2:
        parser.error("--materials takes two names with a comma between them")
    if shutil.which("ccx") is None:
        sys.exit("needs the solver ccx: apt-get install calculix-ccx")
    first, second = (forces(load_material(name)) for name in names)
    ratio = [round(float(value), 2) for value in second / first]
    if options.json:
        print(json.dumps({"materials": names, "depth_mm": DEPTHS, "ratio": ratio}))
        return
    print(f"| depth [mm] | {names[1]} over {names[0]} |\n|---|---|")
    for depth, value in zip(DEPTHS, ratio, strict=True):
        print(f"| {depth:g} | {value:.2f} |")


if __name__ == "__main__":
    main()
