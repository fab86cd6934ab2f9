#!/usr/bin/env python3
"""Make the example parts as binary STL in mm: upper faces of cones, of a pyramid, of a funnel, of a sheet with a pocket
and a dome, of a mask, an implant and a bonnet, and a partial die.

A wall profile (flange, entry fillet, straight wall, floor fillet, floor) is swept along the closed line in
which the extended wall meets the sheet plane. Facets deviate from the smooth surface by less than 10 um, of the
parts of 260 and 610 mm, of free_form, and of the marker, the implant and the cone of 70 deg by less than 20 um, of the
mask by 30 um, of the bonnet by 0.3 mm.
Usage: make_parts.py [folder], default: the folder ``parts`` beside this file.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import trimesh
from isf_core.types import Array
from isf_planner.part_library.catalogue import (
    airfoil_ridge,
    asymmetric_cone,
    bonnet,
    cone,
    free_form,
    funnel,
    implant,
    marker,
    mask,
    pyramid,
    ribbed_pyramid,
)
from isf_planner.part_library.part import Part as LibraryPart
from isf_planner.part_library.part_mesh import part_mesh

CHORD_ERROR = 0.0095
"""mm, largest distance between a facet and the arc it stands for."""


@dataclass(frozen=True)
class Wall:
    """Profile of a wall, mm and degrees."""

    angle: float
    depth: float
    entry_radius: float
    floor_radius: float
    flange: float

    def profile(self) -> Array:
        """(M, 2) mm from the flange to the floor: distance inward from the opening line, z."""
        alpha = np.radians(self.angle)
        entry = np.linspace(0.0, alpha, arc_segments(self.entry_radius, alpha) + 1)
        floor = np.linspace(alpha, 0.0, arc_segments(self.floor_radius, alpha) + 1)
        entry_start = -self.entry_radius * np.tan(alpha / 2)
        floor_end = self.depth / np.tan(alpha) + self.floor_radius * np.tan(alpha / 2)
        upper = np.column_stack(
            [entry_start + self.entry_radius * np.sin(entry), -self.entry_radius * (1 - np.cos(entry))]
        )
        lower = np.column_stack(
            [floor_end - self.floor_radius * np.sin(floor), -self.depth + self.floor_radius * (1 - np.cos(floor))]
        )
        edge = np.array([[entry_start - self.flange, 0.0]])
        between = np.linspace(upper[-1], lower[0], 3)[1:-1]
        return np.vstack([edge, upper, between, lower])


@dataclass(frozen=True)
class Part:
    """A wall along an opening line; ``corner_radius`` equal to ``half_opening`` makes a cone (mm)."""

    half_opening: float
    corner_radius: float
    wall: Wall


PARTS = {
    "ren_cone": Part(36.0, 36.0, Wall(50.0, 21.0, 6.0, 8.0, 8.0)),
    "ren_pyramid": Part(40.0, 22.0, Wall(50.0, 20.0, 6.0, 8.0, 8.0)),
    "spif_cone": Part(45.0, 45.0, Wall(45.0, 15.0, 6.0, 8.0, 8.0)),
    "torrao_cone_45": Part(60.0, 60.0, Wall(45.0, 30.0, 6.0, 8.0, 8.0)),
    "mini_cone": Part(16.0, 16.0, Wall(45.0, 5.0, 6.0, 6.0, 6.0)),
    "lu_cone": Part(70.0, 70.0, Wall(50.0, 30.0, 8.0, 18.0, 8.0)),
    "adsif_cone": Part(24.0, 24.0, Wall(30.0, 6.0, 2.0, 6.0, 8.0)),
}

RISING = {
    "tpif_cone": Part(24.0, 24.0, Wall(40.0, 6.0, 6.0, 4.0, 8.0)),
    "lu_tpif": Part(75.0, 53.0, Wall(40.0, 35.0, 8.0, 8.0, 8.0)),
}
"""Parts that rise from their flange, with a partial die beside them (NAME_die)."""


def first_feature(part: LibraryPart) -> LibraryPart:
    """A part of the library without what is formed on its base."""
    return replace(part, features=part.features[:1])


def funnel_65(limit: float, torn: float = 19e-3) -> LibraryPart:
    """The funnel of Ren 2018, 2.4.1: its wall starts at 65 deg, which is all that is printed of its shape.

    Assumed: one arc after an entry radius of 6 mm, on which the wall reaches ``limit`` rad, where a sheet tears by the
    sine law, at the depth ``torn`` m, the published one under position control; so the arc goes on to 28 mm of depth,
    with a floor radius of 8 mm, and the opening has a radius of 32 mm.
    """
    first, depth, entry, floor = np.radians(65.0), 28e-3, 6e-3, 8e-3
    start = entry * (1.0 - np.cos(first))
    arc = (torn - start) / (np.cos(first) - np.cos(limit))
    last = np.arccos((start + arc * np.cos(first) + floor - depth) / (arc + floor))
    return funnel(32e-3, float(first), float(last), depth, entry, floor)


def two_slopes(half_side: float, upper: tuple[float, float], lower: tuple[float, float]) -> LibraryPart:
    """A pyramid of Behera 2015, case studies: ``half_side`` mm of its opening, slopes as (deg, mm of depth).

    Angles and depths are published, the opening is not; nor are the radii, chosen for a tool of 5 mm radius.
    """
    (upper_angle, upper_depth), (lower_angle, lower_depth) = upper, lower
    angles, depths = np.radians([upper_angle, lower_angle]), 1e-3 * np.array([upper_depth, lower_depth])
    slopes = {"upper_angle": angles[0], "upper_depth": depths[0], "lower_angle": angles[1], "lower_depth": depths[1]}
    return ribbed_pyramid(1e-3 * half_side, **slopes, rib=6e-3, entry=3e-3, transition=6e-3, floor=5e-3)


def steep_pyramid(angle: float, depth: float) -> LibraryPart:
    """A pyramid of Behera 2015, Table 1: ``angle`` deg and ``depth`` mm are published, opening and radii are not."""
    return two_slopes(75.0, (angle, 0.5 * depth), (angle, 0.5 * depth))


LIBRARY = {
    "ren_funnel": funnel_65(np.radians(66)),
    "lu_pyramid": pyramid(75e-3, 62e-3, np.radians(40), 35e-3, 8e-3, 14e-3),
    "lu_asymmetric": asymmetric_cone(60e-3, np.radians(52), np.radians(38), 30e-3, 8e-3, 14e-3),
    "praveen_cone_150": funnel(75e-3, np.radians(25), np.radians(60), 30e-3, 10e-3, 10e-3),
    "praveen_cone_250": funnel(125e-3, np.radians(25), np.radians(60), 40e-3, 10e-3, 10e-3),
    "praveen_cone_610": funnel(305e-3, np.radians(25), np.radians(60), 50e-3, 10e-3, 10e-3),
    "free_form": free_form(0.75, np.radians(40), 6e-3, 5e-3),
    "behera_80_25": two_slopes(75.0, (80.0, 35.0), (25.0, 25.0)),
    "behera_60_25": two_slopes(75.0, (60.0, 35.0), (25.0, 17.5)),
    "behera_60_30": two_slopes(100.0, (60.0, 60.0), (30.0, 30.0)),
    "behera_pyramid_60": steep_pyramid(60.0, 35.0),
    "behera_pyramid_76": steep_pyramid(76.0, 37.5),
    "behera_pyramid_80": steep_pyramid(80.0, 35.0),
    "behera_cone_65": cone(75e-3, np.radians(65), 35e-3, 3e-3, 5e-3),
    "behera_cone_80": cone(75e-3, np.radians(80), 30e-3, 3e-3, 5e-3),
    "behera_airfoil": airfoil_ridge(),
    "praveen_free_form": first_feature(free_form(1.94, np.radians(45), 40e-3)),
    "torrao_cone_70": cone(60e-3, np.radians(70), 30e-3, 6e-3, 8e-3),
    "torrao_marker": marker(),
    "torrao_mask": mask(),
    "torrao_implant": implant(),
    "torrao_bonnet": bonnet(),
}
"""Parts of the library in other sizes, m and rad."""

LIBRARY_CHORD = {
    "ren_funnel": 10e-6,
    "behera_80_25": 10e-6,
    "behera_60_25": 10e-6,
    "behera_60_30": 10e-6,
    "behera_pyramid_60": 20e-6,
    "behera_pyramid_76": 20e-6,
    "behera_pyramid_80": 20e-6,
    "behera_cone_65": 20e-6,
    "behera_cone_80": 20e-6,
    "behera_airfoil": 10e-6,
    "praveen_cone_150": 10e-6,
    "praveen_cone_250": 10e-6,
    "praveen_cone_610": 20e-6,
    "praveen_free_form": 20e-6,
    "free_form": 16e-6,
    "torrao_cone_70": 16e-6,
    "torrao_marker": 16e-6,
    "torrao_mask": 30e-6,
    "torrao_implant": 19e-6,
    "torrao_bonnet": 300e-6,
}
"""m, distance between facet and surface of some parts; of others half of CHORD_ERROR."""

DIES = {"tpif_cone": (1.0, 0.6), "lu_tpif": (1.6, 0.05)}
"""mm, thickness of the blank over a die; and the part of the height, from the top, that the partial die supports."""


def arc_segments(radius: float, angle: float) -> int:
    """Number of equal chords that stay within CHORD_ERROR of an arc (mm, rad)."""
    return int(np.ceil(angle / (2 * np.arccos(1 - CHORD_ERROR / radius))))


def opening_line(part: Part, largest_radius: float) -> tuple[Array, Array]:
    """Points (N, 2) mm of the opening line and its outward unit normals; corners fine enough for ``largest_radius``."""
    straight = part.half_opening - part.corner_radius
    segments = arc_segments(largest_radius, np.pi / 2)
    points, normals = [], []
    for quarter in range(4):
        turn = quarter * np.pi / 2
        rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
        angle = np.linspace(0.0, np.pi / 2, segments + 1)[: None if straight else -1]
        normal = np.column_stack([np.cos(angle), np.sin(angle)])
        corner = straight + part.corner_radius * normal
        if straight:  # facets of about 4 mm along the straight side that follows this corner
            step = np.linspace(straight, -straight, max(2, int(2 * straight / 4.0)) + 1)[1:-1]
            corner = np.vstack([corner, np.column_stack([step, np.full_like(step, part.half_opening)])])
            normal = np.vstack([normal, np.tile([0.0, 1.0], (len(step), 1))])
        points.append(corner @ rotation.T)
        normals.append(normal @ rotation.T)
    return np.vstack(points), np.vstack(normals)


def make(part: Part) -> trimesh.Trimesh:
    """Upper face of the part, mm; normals up, opening line in z = 0, centre at the origin."""
    profile = part.wall.profile()
    points, normals = opening_line(part, part.corner_radius - profile[0, 0])
    rings = [np.column_stack([points - d * normals, np.full(len(points), z)]) for d, z in profile]
    rings.append(rings[-1] * [0.5, 0.5, 1.0])
    count = len(points)
    vertices = np.vstack([*rings, [[0.0, 0.0, -part.wall.depth]]])
    outer = (np.arange(len(rings) - 1)[:, None] * count + np.arange(count)).ravel()
    outer_next = (np.arange(len(rings) - 1)[:, None] * count + (np.arange(count) + 1) % count).ravel()
    inner, inner_next = outer + count, outer_next + count
    last = (len(rings) - 1) * count
    rim, rim_next = last + np.arange(count), last + (np.arange(count) + 1) % count
    centre = np.full(count, len(vertices) - 1)
    faces = np.vstack(
        [
            np.column_stack([outer, outer_next, inner_next]),
            np.column_stack([outer, inner_next, inner]),
            np.column_stack([rim, rim_next, centre]),
        ]
    )
    return trimesh.Trimesh(vertices, faces, process=False)


def turned_over(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """The part rising from its flange instead of opening upwards; normals up."""
    return trimesh.Trimesh(mesh.vertices * [1.0, 1.0, -1.0], mesh.faces, process=False)


def die_under(mesh: trimesh.Trimesh, height: float, blank: float, share: float) -> trimesh.Trimesh:
    """Upper surface of a partial die under a rising part of ``height`` mm, top of the blank at z = 0 on the die.

    ``blank`` and ``share`` as in DIES.
    """
    kept = mesh.vertices[mesh.faces][:, :, 2].max(axis=1) > (1 - share) * height
    die = trimesh.Trimesh(mesh.vertices - [0.0, 0.0, height + blank], mesh.faces[kept], process=False)
    die.remove_unreferenced_vertices()
    return die


def two_features() -> trimesh.Trimesh:
    """A round pocket and a round dome of the same wall beside each other in one sheet, mm."""
    wall = Wall(40.0, 4.0, 5.5, 5.5, 6.0)
    pocket = make(Part(12.0, 12.0, wall))
    dome = turned_over(pocket)
    # each in half of a rectangular flange: the round outline is joined to the rectangle by a fan
    halves = [_in_rectangle(mesh, sign * 24.0) for mesh, sign in ((pocket, -1.0), (dome, 1.0))]
    return trimesh.util.concatenate(halves)


def _in_rectangle(mesh: trimesh.Trimesh, x: float) -> trimesh.Trimesh:
    """A round part moved to ``x`` mm in a square flange of 48 mm; both halves share the corners of the square."""
    outline = np.flatnonzero(np.abs(mesh.vertices[:, 2]) < 1e-9)
    radius = np.linalg.norm(mesh.vertices[outline, :2], axis=1)
    outline = outline[radius > radius.max() - 1e-6]
    points = mesh.vertices[outline]
    # as many points on the square, at the same bearing
    square = points * (24.0 / np.abs(points[:, :2]).max(axis=1))[:, None]
    order = np.argsort(np.arctan2(points[:, 1], points[:, 0]))
    inner, first = outline[order], len(mesh.vertices)
    outer = first + np.arange(len(order))
    following = np.roll(np.arange(len(order)), -1)
    faces = np.vstack(
        [
            np.column_stack([inner, outer, outer[following]]),
            np.column_stack([inner, outer[following], inner[following]]),
        ]
    )
    vertices = np.vstack([mesh.vertices, square[order]]) + [x, 0.0, 0.0]
    return trimesh.Trimesh(vertices, np.vstack([mesh.faces, faces]), process=False)


def all_parts() -> dict[str, trimesh.Trimesh]:
    """Every mesh by the name of its file, mm."""
    meshes = {name: make(part) for name, part in PARTS.items()}
    for name, part in RISING.items():
        meshes[name] = turned_over(make(part))
        meshes[f"{name}_die"] = die_under(meshes[name], part.wall.depth, *DIES[name])
    meshes["two_features"] = two_features()
    for name, shape in LIBRARY.items():
        mesh = part_mesh(shape, LIBRARY_CHORD.get(name, 0.5e-3 * CHORD_ERROR))
        meshes[name] = trimesh.Trimesh(1e3 * mesh.vertices, mesh.faces, process=False)
    return meshes


def main() -> None:
    """Write all parts."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("folder", nargs="?", type=Path, default=Path(__file__).resolve().parent / "parts")
    folder: Path = parser.parse_args().folder
    folder.mkdir(parents=True, exist_ok=True)
    for name, mesh in all_parts().items():
        path = folder / f"{name}.stl"
        mesh.export(path)
        print(f"{path.name}: {len(mesh.faces)} facets, {path.stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    main()
