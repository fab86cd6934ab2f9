"""Shapes that a part formed in stages goes through."""

from __future__ import annotations

from dataclasses import dataclass

from isf_core.geometry.height_map import HeightMap


@dataclass(frozen=True)
class StageShapes:
    """What stages begin and end with: ``preforms`` one after the other, then the ``part``, which its finishing passes
    form again; all on one grid."""

    part: HeightMap
    preforms: tuple[HeightMap, ...] = ()

    def end(self, stage: int) -> HeightMap:
        """The shape that ``stage``, from 0, ends with."""
        return self.preforms[stage] if stage < len(self.preforms) else self.part

    def begin(self, stage: int) -> HeightMap | None:
        """The shape that ``stage``, from 0, begins with; None: the flat blank."""
        return self.end(stage - 1) if stage > 0 else None
