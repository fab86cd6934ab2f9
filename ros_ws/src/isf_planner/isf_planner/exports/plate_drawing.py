"""Drawing of a backing plate for whoever cuts it: the edge of every opening as DXF, in mm, seen from above."""

from __future__ import annotations

import numpy as np
from isf_core.files.tooling import BackingPlateSpec
from trimesh.path import Path2D
from trimesh.path.entities import Arc, Entity, Line

LAYER = "OPENING"
MM = 1e3
_UNIT_MM = "\n9\n$INSUNITS\n70\n4"
"""Header variable of DXF: lengths are mm; trimesh writes none."""


def plate_drawing(plate: BackingPlateSpec) -> str:
    """Text of a DXF file: a circle, or closed polylines; 0 is the middle of the clamp.

    The edge is that of the opening at its narrowest, below the rounding of the plate's upper edge.
    """
    entities: list[Entity] = []
    if plate.shape == "circle":
        vertices = plate.edges[0][[0, 120, 240]]
        entities.append(Arc(np.arange(3), closed=True, layer=LAYER))
    else:
        vertices = np.vstack(plate.edges)
        first = 0
        for edge in plate.edges:
            entities.append(Line(first + np.append(np.arange(len(edge)), 0), layer=LAYER))
            first += len(edge)
    drawing = Path2D(entities, MM * vertices, process=False)
    return str(drawing.export(file_type="dxf")).replace("\nHEADER", f"\nHEADER{_UNIT_MM}", 1)
