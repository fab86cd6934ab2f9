"""Sheets and contours for the tests of the shell: discs, squares, cones."""

from dataclasses import replace

import numpy as np
from isf_springback.shell.formed_sheet import FacetSize, formed_sheet, mesh_of
from isf_springback.shell.plan_mesh import mesh_in_plan
from isf_springback.shell.sheet_model import EdgeCondition, SheetMesh, ShellModel, sine_law_thickness
from springback_parts import cone_contour

DOWN = np.array([0.0, 0.0, -1.0])
YOUNG, POISSON = 70e9, 0.33


def disc(radius, corners=64):
    turn = 2 * np.pi * np.arange(corners) / corners
    return radius * np.column_stack([np.cos(turn), np.sin(turn)])


def square(side):
    return 0.5 * side * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])


def flat_sheet(outline, load=(0.0, 0.0), at_load=3e-3, flange=14e-3, growth=0.25):
    """Flat mesh with a node at ``load``, fine there."""
    place = np.array([load])

    def size(points):
        return np.minimum(at_load + growth * np.linalg.norm(points - place, axis=1), flange)

    points, triangles, edge = mesh_in_plan(outline, place, size)
    return SheetMesh(np.column_stack([points, np.zeros(len(points))]), triangles, edge, np.array([0]))


def flat_model(mesh, thickness, edge, young=YOUNG, poisson=POISSON):
    return ShellModel(mesh, np.full(len(mesh.triangles), thickness), young, poisson, edge)


def cone_contours(opening, angle, depth, step=1e-3):
    """Contours of a straight cone with radius ``opening`` m at the flange, ``angle`` deg."""
    made = []
    for index in range(round(depth / step)):
        z = (index + 1) * step
        contour = cone_contour(index, count=100, radius=opening - z / np.tan(np.radians(angle)), angle=angle)
        contact = contour.contact.copy()
        contact[:, 2] = -z
        made.append(replace(contour, contact=contact))
    return made


def cone_model(opening, angle, depth, edge=EdgeCondition(), size=FacetSize()):  # noqa: B008
    """Shell of the cone, loaded at the first point of its last contour."""
    contours = cone_contours(opening, angle, depth)
    mesh = mesh_of(formed_sheet(contours, (0.25, 0.25)), contours[-1].contact[:1, :2], size)
    return ShellModel(mesh, sine_law_thickness(mesh, 1e-3), YOUNG, POISSON, edge)
