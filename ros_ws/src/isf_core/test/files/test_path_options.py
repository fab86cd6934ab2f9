"""Options of the path section: whatever is written down has an effect, or is refused."""

from __future__ import annotations

from pathlib import Path

import pytest
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import Job, JobFile

ADSIF = "\nadsif: {surface: AA5754-O_1mm_R5}"
DIE = "\ndie: {mesh: die.stl, unit: mm}"


def job(options: str, process: str = "DSIF", more: str = "") -> Job:
    text = f"""
name: part
part: {{mesh: part.stl, unit: mm}}
process: {process}
rig: ren2018
sheet: {{material: AA5754-O, thickness: 1 mm}}
tool_1: {{radius: 5 mm}}
tool_2: {{radius: 5 mm}}
path: {{incremental_depth: 0.5 mm, point_spacing: 0.5 mm, feed: 30 mm/s{options}}}{more}
"""
    return JobFile(text + (DIE if process == "TPIF" else ""), Path()).job


@pytest.mark.parametrize(
    ("option", "needs"),
    [
        ("scallop_height: 0.02 mm", "spacing: scallop"),
        ("arc_step: 0.4 mm", "spacing: arc"),
        ("smallest_step: 0.1 mm", "spacing: arc"),
        ("largest_step: 0.6 mm", "spacing: scallop"),
        ("ramp_length: 10 mm", "transition: ramp"),
        ("sheet_term: axial", "compensation: [sheet]"),
        ("sheet_gain: 0.9", "compensation: [sheet]"),
        ("machine_error: error.csv", "compensation: [machine]"),
    ],
)
def test_an_option_needs_the_choice_that_uses_it(option: str, needs: str) -> None:
    job(f", {option}, {needs}")
    with pytest.raises(IsfError) as caught:
        job(f", {option}")
    assert f"{option.split(':')[0]} has no effect without {needs.split(':')[0]}" in str(caught.value)


def test_a_spiral_has_no_ramps() -> None:
    with pytest.raises(IsfError, match="a spiral has no ramps"):
        job(", style: spiral, transition: ramp")


def test_there_is_no_order_to_choose() -> None:
    """Contours run from the edge inwards, in ADSIF outwards; nothing else is planned."""
    with pytest.raises(IsfError, match="order"):
        job(", order: in_to_out")


@pytest.mark.parametrize(
    ("options", "accepted", "refused"),
    [
        ("support: on_blank", "DSIF", ("SPIF", "TPIF", "ADSIF")),
        ("squeeze_factor: 0.9", "DSIF", ("SPIF", "TPIF", "ADSIF")),
        ("thickness: overlap", "SPIF DSIF", ("TPIF", "ADSIF")),
        ("compensation: [sheet]", "SPIF DSIF", ("TPIF", "ADSIF")),
        ("transition: ramp", "SPIF DSIF TPIF", ("ADSIF",)),
        ("stagger: 3 mm", "SPIF DSIF TPIF", ("ADSIF",)),
        ("direction: alternating", "SPIF DSIF TPIF", ("ADSIF",)),
        ("style: contours", "SPIF DSIF TPIF", ("ADSIF",)),
        ("spacing: arc", "SPIF DSIF TPIF", ("ADSIF",)),
    ],
)
def test_processes_refuse_what_they_do_not_use(options: str, accepted: str, refused: tuple[str, ...]) -> None:
    for process in accepted.split():
        job(f", {options}", process)
    for process in refused:
        with pytest.raises(IsfError) as caught:
            job(f", {options}", process)
        assert f"path.{options.split(':')[0]}" in str(caught.value) or "path.transition, stagger" in str(caught.value)


def test_the_distance_of_two_tools_is_compensated_where_two_tools_form() -> None:
    job(", compensation: [machine], machine_error: error.csv", "DSIF")
    with pytest.raises(IsfError, match="needs two tools"):  # a section tool_2 is there
        job(", compensation: [machine], machine_error: error.csv", "SPIF")


def test_no_force_control_under_the_blank() -> None:
    job(", support: on_blank")
    with pytest.raises(IsfError, match="support_force must be 0 N"):
        job(", support: on_blank", more="\ncontrol: {support_force: 100 N}")


def test_no_deflection_of_a_free_sheet_is_compensated_where_the_support_tool_holds_it() -> None:
    job(", compensation: [sheet]", "DSIF")
    with pytest.raises(IsfError, match="not one that path") as refused:
        job(", support: on_blank, compensation: [sheet]")
    assert refused.value.code == ErrorCode.FILE_FIELD
    assert "path.compensation" in refused.value.message


def test_nothing_is_pushed_on_a_first_contour_that_the_support_tool_holds() -> None:
    assert job("", "DSIF").springback.first_contour == "predicted"
    assert not job("", "DSIF").support_stays
    on_blank = job(", support: on_blank")
    assert on_blank.support_stays
    assert on_blank.springback.first_contour == "zero"
    with pytest.raises(IsfError, match="first_contour must be zero"):
        job(", support: on_blank", more="\nspringback: {first_contour: predicted}")
