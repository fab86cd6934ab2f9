"""Where the error of a part comes from: the sum of Ren 2018, eq. 1-1, at every contour point.

    error of the formed part = correction + delta_1 + delta_2 (+ delta_3)

* correction: how far the tip was sent beyond the plan, on purpose;
* delta_1: the tip beside where it was sent: what the encoders saw of it, and the deflection that they do not see, which
  is the measured force times the compliance that force control compensates with;
* delta_2: the sheet beside the tip: springback in the clamp, and what later contours moved. It is what the other terms
  leave of the measured error, so that errors of the axes that neither encoders nor force tell are in it;
* delta_3: springback by unclamping and trimming. A part is scanned in the clamp: it is in none of these numbers, and
  known by itself where the part was scanned out of it, too.

Ren 2018 (section 2.4.3) could not part delta_1 from delta_2 on a real rig. So the deflection is an estimate, as good as
the compliance is known: also on a simulated rig, whose own may differ.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from isf_core.contour import Contour, ContourResult
from isf_core.geometry.height_map import HeightMap
from isf_core.types import Array

from isf_analysis.measures.record import PartRecord, Vector

_UNKNOWN = (math.nan, math.nan, math.nan)


@dataclass(frozen=True)
class ErrorSplit:
    """Terms of the error on one contour of N points, each (N,) m along the normal of the wanted surface.

    Positive: towards the forming tool, not formed far enough. NaN where a term is not known.

    Attributes
    ----------
    index : of the contour
    correction : forming tip as sent, less as planned
    followed : forming tip as the encoders saw it, less as streamed
    deflected : of delta_1 what no encoder saw: deflection under the measured force, less the offset that compensated it
    sheet : delta_2
    error : of the formed part; the sum of the four above
    support : delta_1 of the support tool along the horizontal normal away from the forming tool, (0,) under force
        control, which seeks no position, and without a support tool
    released : delta_3, (0,) where it was not measured
    """

    index: int
    correction: Array
    followed: Array
    deflected: Array
    sheet: Array
    error: Array
    support: Array
    released: Array

    @property
    def tool(self) -> Array:
        """(N,) m, delta_1 of the forming tool."""
        return self.followed + self.deflected


def error_splits(record: PartRecord, error: HeightMap, release: HeightMap | None = None) -> tuple[ErrorSplit, ...]:
    """Of every contour of the last stage that was formed and whose machine told where its tips were.

    ``error`` : vertical deviation of the formed part, m. Deflection and delta_2 are NaN where the compliance is not
    known. ``release`` : vertical movement of the part by its release, m; None: not measured.
    """
    corrected = {contour.index: contour for contour in record.corrected}
    results = {result.index: result for result in record.results if result.completed}
    return tuple(
        split
        for contour in record.last_stage
        if contour.index in results and contour.index in corrected
        for split in _split(
            contour, corrected[contour.index], results[contour.index], record.tool_compliance, error, release
        )
    )


def _split(
    planned: Contour,
    sent: Contour,
    result: ContourResult,
    compliance: tuple[Vector, Vector] | None,
    error: HeightMap,
    release: HeightMap | None,
) -> Iterator[ErrorSplit]:
    n = len(planned)
    target, measured, force = result.forming_target, result.forming_measured, result.forming_force
    if not len(sent) == len(target) == len(measured) == len(force) == n:
        return  # no poses, or a correction that chose its own points
    normal = planned.normal

    def along(vectors: Array) -> Array:
        return np.einsum("ij,ij->i", vectors, normal)

    tools = compliance or (_UNKNOWN, _UNKNOWN)
    forming, support = tools if planned.forming_tool == 1 else tools[::-1]
    correction = along(sent.forming_tip - planned.forming_tip)
    followed = along(measured - target)
    deflected = along(force * forming + target - sent.forming_tip)
    total = error.at(planned.contact[:, :2]) * normal[:, 2]
    released = np.empty(0) if release is None else release.at(planned.contact[:, :2]) * normal[:, 2]
    sheet = total - correction - followed - deflected
    yield ErrorSplit(
        planned.index,
        correction,
        followed,
        deflected,
        sheet,
        total,
        _support_error(planned, sent, result, support),
        released,
    )


def _support_error(planned: Contour, sent: Contour, result: ContourResult, compliance: Vector) -> Array:
    measured, force = result.support_measured, result.support_force
    if planned.force_controlled or not len(sent.support_tip) == len(measured) == len(force) == len(planned):
        return np.empty(0)
    sideways = np.zeros_like(planned.normal)
    sideways[:, :2] = -planned.normal[:, :2]
    length = np.linalg.norm(sideways, axis=1, keepdims=True)
    with np.errstate(invalid="ignore", divide="ignore"):
        sideways /= length  # NaN on a floor, which has no horizontal normal
    return np.einsum("ij,ij->i", measured + force * compliance - sent.support_tip, sideways)
