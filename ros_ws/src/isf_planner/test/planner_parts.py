"""Meshes and jobs for the planner's tests, and what is known about them exactly. Lengths in m, angles in rad."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh
from isf_core.files.job import JobFile
from isf_core.types import Array
from isf_planner.part.meshes import Mesh
from isf_planner.part_plan import Plan

EXAMPLES = Path(__file__).resolve().parents[4] / "examples"


OF_EXAMPLES = (
    "the sheet is free for",
    "the support tool under the blank carries",
    "the lower tool waits below the sheet",
)
"""How the warnings begin that hold for examples as they are meant to be."""


def told(made: Plan) -> tuple[str, ...]:
    """Warnings of a plan but those of :data:`OF_EXAMPLES`."""
    return tuple(text for text in made.warnings if not text.startswith(OF_EXAMPLES))


@dataclass(frozen=True)
class Cone:
    """Cone with entry fillet, floor fillet and flat floor; ``opening`` is where the extended wall meets z = 0."""

    opening: float = 30e-3
    angle: float = np.radians(45.0)
    depth: float = 12e-3
    entry: float = 6e-3
    floor: float = 8e-3
    flange: float = 6e-3

    @property
    def entry_end(self) -> float:
        """z where the straight wall begins."""
        return -self.entry * (1 - np.cos(self.angle))

    @property
    def floor_begin(self) -> float:
        """z where the straight wall ends."""
        return -self.depth + self.floor * (1 - np.cos(self.angle))

    def tip(self, z: float, radius: float) -> tuple[float, float]:
        """Radius (m) of the tip circle at tip height z and wall angle (rad) at the contact, for a ball of ``radius``.

        The ball's centre runs on the profile offset by its radius: a circle of entry + radius around the centre
        of the entry fillet, a line, a circle of floor - radius around the centre of the floor fillet.
        """
        half = np.tan(self.angle / 2)
        centre = z + radius
        # angle at which the centre leaves the entry circle, and height there
        entry_low = -self.entry + (self.entry + radius) * np.cos(self.angle)
        floor_high = -self.depth + self.floor - (self.floor - radius) * np.cos(self.angle)
        if centre >= entry_low:
            turn = np.arccos((centre + self.entry) / (self.entry + radius))
            return self.opening + self.entry * half - (self.entry + radius) * np.sin(turn), float(turn)
        if centre <= floor_high:
            turn = np.arccos(np.clip((self.floor - self.depth - centre) / (self.floor - radius), -1, 1))
            middle = self.opening - self.depth / np.tan(self.angle) - self.floor * half
            return middle + (self.floor - radius) * np.sin(turn), float(turn)
        # distance from the wall line z = -(opening - r) tan(angle) is the tool radius
        return self.opening - (radius - centre * np.cos(self.angle)) / np.sin(self.angle), self.angle

    def profile(self, chord_error: float) -> Array:
        """(M, 2) m, radius and z from the flange to the floor's edge."""
        half = np.tan(self.angle / 2)

        def arc(radius: float) -> Array:
            return np.linspace(0, self.angle, 1 + _segments(radius, self.angle, chord_error))

        start = self.opening + self.entry * half
        upper = np.column_stack(
            [start - self.entry * np.sin(arc(self.entry)), -self.entry * (1 - np.cos(arc(self.entry)))]
        )
        end = self.opening - self.depth / np.tan(self.angle) - self.floor * half
        turn = arc(self.floor)[::-1]
        lower = np.column_stack([end + self.floor * np.sin(turn), -self.depth + self.floor * (1 - np.cos(turn))])
        rings = [[[start + self.flange, 0.0]], upper, np.linspace(upper[-1], lower[0], 4)[1:-1], lower]
        return np.vstack(rings)

    def mesh(self, chord_error: float = 5e-6) -> Mesh:
        """Revolved profile, facets within ``chord_error`` of the smooth surface."""
        return revolve(self.profile(chord_error), 4 * _segments(self.opening, np.pi / 2, chord_error))


def _segments(radius: float, angle: float, chord_error: float) -> int:
    return int(np.ceil(angle / (2 * np.arccos(1 - chord_error / radius))))


def revolve(profile: Array, segments: int) -> Mesh:
    """Surface of a profile (M, 2) from the outside inwards, closed by a fan at the axis; normals up."""
    angle = 2 * np.pi * np.arange(segments) / segments
    rings = [np.column_stack([r * np.cos(angle), r * np.sin(angle), np.full(segments, z)]) for r, z in profile]
    vertices = np.vstack([*rings, [[0.0, 0.0, profile[-1, 1]]]])
    index, following = np.arange(segments), (np.arange(segments) + 1) % segments
    faces = []
    for k in range(len(profile) - 1):
        outer, inner = k * segments, (k + 1) * segments
        faces.append(np.column_stack([outer + index, outer + following, inner + following]))
        faces.append(np.column_stack([outer + index, inner + following, inner + index]))
    last = (len(profile) - 1) * segments
    faces.append(np.column_stack([last + index, last + following, np.full(segments, len(vertices) - 1)]))
    return Mesh(vertices, np.vstack(faces).astype(np.int64))


def grid_mesh(x: Array, y: Array, z: Array) -> Mesh:
    """Height field z (ny, nx) over x (nx,), y (ny,) as triangles; normals up."""
    ny, nx = z.shape
    gx, gy = np.meshgrid(x, y)
    vertices = np.column_stack([gx.ravel(), gy.ravel(), z.ravel()])
    node = np.arange(ny * nx).reshape(ny, nx)
    a, b, c, d = node[:-1, :-1].ravel(), node[:-1, 1:].ravel(), node[1:, 1:].ravel(), node[1:, :-1].ravel()
    return Mesh(vertices, np.vstack([np.column_stack([a, b, c]), np.column_stack([a, c, d])]).astype(np.int64))


def write(mesh: Mesh, path: Path, scale: float = 1e3) -> Path:
    """Mesh file with coordinates in m times ``scale`` (1e3: mm)."""
    trimesh.Trimesh(mesh.vertices * scale, mesh.faces, process=False).export(path)
    return path


NO_PASSES = ", floor_step: none"
"""In the path of a job of one tool: the contours are those of the walls alone."""


def job_for(path: Path, **changes: str) -> JobFile:
    """DSIF job for a mesh file, no passes over floors; ``changes`` replace values of the text below."""
    values = {
        "name": "part",
        "unit": "mm",
        "process": "DSIF",
        "radius": "5 mm",
        "depth": "0.5 mm",
        "spacing": "0.5 mm",
        "force": "120 N",
        "engage": "2 mm",
        "squeeze": "1.0",
        "limit": "80 deg",
        "rig": "ren2018",
    } | changes
    lines = [
        f"name: {values['name']}",
        f"part: {{mesh: '{path.name}', unit: {values['unit']}}}",
        f"process: {values['process']}",
        f"rig: {values['rig']}",
        "sheet: {material: AA5754-O, thickness: 1.0 mm}",
        f"tool_1: {{radius: {values['radius']}}}",
        f"wall_angle_limit: {values['limit']}",
        f"path: {{incremental_depth: {values['depth']}, point_spacing: {values['spacing']}, feed: 30 mm/s,",
        f"  squeeze_factor: {values['squeeze']}{NO_PASSES if values['process'] == 'SPIF' else ''}}}",
    ]
    if values["process"] != "SPIF":
        lines.append(f"tool_2: {{radius: {values['radius']}}}")
        lines.append(f"control: {{support_force: {values['force']}, engage_depth: {values['engage']}}}")
    return JobFile("\n".join(lines), path.parent)
