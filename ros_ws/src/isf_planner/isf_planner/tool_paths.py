"""From the loops of a part to the contours the tools follow, in the order of forming.

This is where paths are made: :func:`make_contours` gets every loop with its feature and parent and decides on order,
direction, transitions, spirals and roles of the tools. The plain order is that of :class:`LoopTree`: one feature
after the other, parents before children, each from the flange away; both tools are lifted between features.

A loop of a feature with ``forming_tool`` 2 (it rises above the blank) has its contacts on the given surface, too; the
lower tool touches the other face of the sheet, one thickness below it along the normal.
"""

from __future__ import annotations

from dataclasses import replace

from isf_core.contour import Contour
from isf_core.job import JobFile

from isf_planner.contours import make_contour
from isf_planner.feature_tree import LoopTree
from isf_planner.target_surface import TargetSurface


def make_contours(tree: LoopTree, surface: TargetSurface, job_file: JobFile, plan_id: str) -> tuple[Contour, ...]:
    """Contours of all loops.

    Parameters
    ----------
    tree : loops and features
    surface : the sampled target, on which further tips can be settled (:func:`isf_planner.tip_loops.settle`)
    job_file : the job with its rig and material
    plan_id : of the plan
    """
    contours: list[Contour] = []
    for index, loop in enumerate(tree.loops):
        contour = make_contour(loop, job_file.job, plan_id, index, len(tree.loops))
        apart = bool(contours) and contours[-1].feature != loop.feature
        contours.append(replace(contour, feature=loop.feature, retract=apart))
    return tuple(contours)
