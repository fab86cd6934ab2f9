"""Toolpath planning for incremental sheet forming: from a CAD surface to contours and tool tips."""

from isf_planner.part_plan import Plan
from isf_planner.planning import plan, replan

__all__ = ["Plan", "plan", "replan"]
