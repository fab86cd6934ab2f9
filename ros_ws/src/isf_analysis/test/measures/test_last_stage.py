"""Contours that made the shape: of a part that ended in a further stage, not the few of that stage alone."""

from __future__ import annotations

from dataclasses import replace

from isf_analysis.measures.record import PartRecord
from synthetic_part import in_stages, make_part

STAGES = in_stages(make_part(contours=6, spacing=2.5e-3))
"""12 contours; those of the first stage run 0.3 mm beside those of the second."""
FINISHED = replace(
    STAGES,
    nominal=(
        *(replace(again, index=again.index - 6, stage=0) for again in STAGES.nominal[6:]),
        *STAGES.nominal[6:],
    ),
)
"""The same with a finishing pass, on the same path, as its second stage."""


def stopped(part: PartRecord, index: int) -> PartRecord:
    """``part`` stopped in contour ``index``."""
    *formed, last = part.results[: index + 1]
    results = (*formed, replace(last, completed=False, code=1402))
    return replace(part, nominal=part.nominal[: index + 1], results=results)


def indices(part: PartRecord) -> list[int]:
    return [contour.index for contour in part.last_stage]


def test_a_whole_part_is_told_by_its_last_stage() -> None:
    assert indices(STAGES) == indices(FINISHED) == [6, 7, 8, 9, 10, 11]
    lost = replace(STAGES, results=(*STAGES.results[:8], *STAGES.results[9:]))  # of one contour, on the way
    assert indices(lost) == [6, 7, 8, 9, 10, 11]


def test_stopped_in_a_finishing_pass_the_pass_before_tells_the_rest() -> None:
    """Contours 6 and 7 were formed again, contour 8 was not formed to its end."""
    assert indices(stopped(FINISHED, 8)) == [2, 3, 4, 5, 6, 7]
    assert indices(stopped(FINISHED, 6)) == [0, 1, 2, 3, 4, 5]


def test_stopped_in_a_stage_of_another_shape_the_stage_before_tells() -> None:
    assert indices(stopped(STAGES, 8)) == [0, 1, 2, 3, 4, 5]


def test_stopped_in_its_first_stage_a_part_is_told_by_what_it_has() -> None:
    assert indices(stopped(STAGES, 3)) == [0, 1, 2, 3]
    assert indices(replace(STAGES, nominal=(), results=())) == []
