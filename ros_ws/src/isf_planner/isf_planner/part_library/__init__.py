"""Parametric parts with exact surfaces and normals: examples to form, and oracles for tests."""

from isf_planner.part_library.catalogue import PARTS
from isf_planner.part_library.part import Feature, Part
from isf_planner.part_library.part_mesh import part_mesh

__all__ = ["PARTS", "Feature", "Part", "part_mesh"]
