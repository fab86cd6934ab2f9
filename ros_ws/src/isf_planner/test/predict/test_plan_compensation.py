"""Compensation in the plan: sign rules, gap, iteration, error map, and jobs that would correct twice."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from ball_gap import tool_gap
from hypothesis import given, settings
from hypothesis import strategies as st
from isf_core.contour import Contour
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile
from isf_planner.planning import finish
from isf_planner.predict import machine_error
from isf_planner.predict.compensation import SETTLED, compensate, deflections
from planner_contours import circle
from planner_parts import EXAMPLES

JOB = """\
name: cone
part: {mesh: none.stl, unit: mm}
process: DSIF
rig: ren2018
sheet: {material: Al8011, thickness: 0.8 mm}
tool_1: {radius: 5 mm, stick_out: 80 mm}
tool_2: {radius: 5 mm, stick_out: 80 mm}
path: {incremental_depth: 0.5 mm, point_spacing: 0.5 mm, feed: 30 mm/s, compensation: [WANTED]}
control: {compliance_compensation: 0}
"""


def job(*wanted: str, base: Path = EXAMPLES, **changes: str) -> JobFile:
    text = JOB.replace("WANTED", ", ".join(wanted))
    for old, new in changes.items():
        text = text.replace(old, new)
    return JobFile(text, base)


def cone(angle: float = np.radians(50), count: int = 12, opening: float = 100e-3) -> list[Contour]:
    """Contours of a wall at one angle, 0.5 mm apart."""
    contours = []
    for k in range(count):
        radius = opening - 0.5e-3 * k / np.tan(angle)
        contour = circle(radius=radius, z=-0.5e-3 * (k + 1), angle=angle, sheet=0.8e-3, tools=2)
        contours.append(replace(contour, index=k, count=count))
    return contours


def test_nothing_is_moved_unless_it_is_wanted() -> None:
    contours = tuple(cone())
    finished, _ = finish(contours, job())
    for before, after in zip(contours, finished, strict=True):
        np.testing.assert_array_equal(after.forming_tip, before.forming_tip)
        np.testing.assert_array_equal(after.support_tip, before.support_tip)


def test_sheet_moves_both_tools_by_the_same_vector() -> None:
    """Praveen 2020, 2.5: down by w cos(angle) under an upper forming tool, the gap unchanged to 1e-9 m."""
    contours = cone()
    moved, reported = compensate(contours, job("sheet"))
    found = deflections(contours, job("sheet"))
    for before, after, one in zip(contours, moved, found, strict=True):
        shift = after.forming_tip - before.forming_tip
        np.testing.assert_allclose(shift[:, :2], 0.0, atol=1e-15)
        np.testing.assert_allclose(shift[:, 2], -one.sheet * np.cos(np.radians(50)), atol=1e-12)
        np.testing.assert_allclose(after.support_tip - before.support_tip, shift, atol=1e-15)
        gap = [tool_gap(c.forming_tip, c.support_tip, 5e-3, 5e-3) for c in (before, after)]
        np.testing.assert_allclose(*gap, atol=1e-9)
        assert (one.sheet > 0.5e-3).all()
    assert "sheet deflection" in reported[0]
    assert "extrapolation" in reported[1]


def test_a_lower_forming_tool_pushes_up() -> None:
    contours = [mirrored(contour) for contour in cone()]
    moved, _ = compensate(contours, job("sheet"))
    down, _ = compensate(cone(), job("sheet"))
    for before, after, other in zip(contours, moved, down, strict=True):
        assert (after.forming_tip[:, 2] > before.forming_tip[:, 2]).all()
        np.testing.assert_allclose(after.forming_tip[:, 2], -other.forming_tip[:, 2], atol=1e-12)
        np.testing.assert_allclose(after.support_tip[:, 2], -other.support_tip[:, 2], atol=1e-12)


def mirrored(contour: Contour) -> Contour:
    """Seen from below: the lower tool forms upwards."""
    flip = np.array([1.0, 1.0, -1.0])
    return replace(
        contour,
        contact=contour.contact * flip,
        normal=contour.normal * flip,
        forming_tip=contour.forming_tip * flip,
        support_tip=contour.support_tip * flip,
        forming_tool=2,
    )


def test_axial_reading_and_gain() -> None:
    contours = cone()
    axial, _ = compensate(
        contours, job("sheet", **{", compensation": ", sheet_term: axial, sheet_gain: 0.5, compensation"})
    )
    found = deflections(
        contours, job("sheet", **{", compensation": ", sheet_term: axial, sheet_gain: 0.5, compensation"})
    )
    for before, after, one in zip(contours, axial, found, strict=True):
        np.testing.assert_allclose(after.forming_tip[:, 2] - before.forming_tip[:, 2], -0.5 * one.sheet, atol=1e-12)


def test_tool_bending_moves_the_forming_tool_alone() -> None:
    """Praveen 2020, 2.5: outwards, against the pull of the wall, by F_r times the compliance times the sine of the
    wall angle."""
    contours = cone()
    moved, reported = compensate(contours, job("tool"))
    for before, after in zip(contours, moved, strict=True):
        shift = after.forming_tip - before.forming_tip
        outward = before.contact[:, :2] / np.linalg.norm(before.contact[:, :2], axis=1, keepdims=True)
        assert ((shift[:, :2] * outward).sum(axis=1) > 10e-6).all()
        np.testing.assert_allclose(shift[:, 2], 0.0, atol=1e-15)
        np.testing.assert_array_equal(after.support_tip, before.support_tip)
        np.testing.assert_array_equal(after.contact, before.contact)
    assert "bending of the forming tool" in reported[0]
    stiff, _ = compensate(contours, job("tool", **{"stick_out: 80 mm": "stick_out: 40 mm"}))
    half = np.linalg.norm(stiff[0].forming_tip - contours[0].forming_tip)
    assert np.linalg.norm(moved[0].forming_tip - contours[0].forming_tip) == pytest.approx(8 * half, rel=1e-9)


def test_iteration_has_settled() -> None:
    """Praveen 2020, 2.5: one more pass from the wall angle of the moved path changes the deflection by less than 20
    um."""
    contours = cone()
    file = job("sheet")
    found = deflections(contours, file)
    again = deflections(
        [replace(contour, wall_angle=one.wall_angle) for contour, one in zip(contours, found, strict=True)], file
    )
    for one, other in zip(found, again, strict=True):
        assert np.abs(one.sheet - other.sheet).max() < 2 * SETTLED


def test_deflection_follows_the_opening() -> None:
    """Praveen 2020, 3.2.1.1: of an oval opening, the sheet gives way more where the opening is farther from the
    clamp."""
    contours = [
        replace(c, contact=c.contact * [1.0, 0.8, 1.0], forming_tip=c.forming_tip * [1.0, 0.8, 1.0]) for c in cone()
    ]
    w = deflections(contours, job("sheet"))[0].sheet
    assert w[45] > 1.2 * w[0]  # towards y, towards x


def test_machine_error_is_taken_from_the_support_tool(tmp_path: Path) -> None:
    """Praveen 2020, 2.4: tips 0.1 mm too far apart: the lower one goes up by that, or the upper one down when the
    lower one forms."""
    write_map(tmp_path / "map.csv", lambda x, y, r: 0.1 + 0 * x)
    file = job("machine", base=tmp_path, **{", compensation": ", machine_error: map.csv, compensation"})
    for contours, sign in ((cone(), 1.0), ([mirrored(c) for c in cone()], -1.0)):
        moved, reported = compensate(contours, file)
        for before, after in zip(contours, moved, strict=True):
            np.testing.assert_array_equal(after.forming_tip, before.forming_tip)
            np.testing.assert_allclose(after.support_tip - before.support_tip, [[0, 0, sign * 0.1e-3]] * 180, atol=1e-9)
        assert reported == ("compensated: machine error 0.100 to 0.100 mm, support tool moved",)


@pytest.mark.parametrize(("tool", "shift"), [(1, -0.1e-3), (2, 0.1e-3)])
def test_machine_error_is_taken_from_the_tool_that_is_off(tool: int, shift: float, tmp_path: Path) -> None:
    """Tips 0.1 mm too far apart: tool 1 stands too high, or tool 2 too low, whichever of them forms."""
    write_map(tmp_path / "map.csv", lambda x, y, r: 0.1 + 0 * x)
    option = f", machine_error: map.csv, machine_error_tool: tool_{tool}, compensation"
    file = job("machine", base=tmp_path, **{", compensation": option})
    for contours in (cone(), [mirrored(c) for c in cone()]):
        moved, reported = compensate(contours, file)
        for before, after in zip(contours, moved, strict=True):
            tips = {after.forming_tool: after.forming_tip - before.forming_tip}
            tips[3 - after.forming_tool] = after.support_tip - before.support_tip
            np.testing.assert_allclose(tips[tool], [[0, 0, shift]] * 180, atol=1e-9)
            np.testing.assert_array_equal(tips[3 - tool], 0.0)
            np.testing.assert_array_equal(after.contact, before.contact)
        assert reported == (f"compensated: machine error 0.100 to 0.100 mm, tool {tool} moved",)


def write_map(path: Path, error, planes: tuple[float, ...] = (-20.0, 0.0), noise: float = 0.0) -> None:  # type: ignore[no-untyped-def]
    """Readings (mm) on a grid of 7 x 7 places in each plane."""
    random = np.random.default_rng(1)
    side = np.linspace(-150, 150, 7)
    rows = [
        f"{x},{y},{z},{error(x, y, np.hypot(x, y)) + noise * random.uniform(-1, 1):.6f}"
        for z in planes
        for x in side
        for y in side
    ]
    path.write_text("\n".join(["x_mm,y_mm,z_mm,error_mm", *rows]))


def test_published_error_is_recovered_within_the_gauge(tmp_path: Path) -> None:
    """The plane with a radial sag that reproduces Praveen 2020, 2.5, read with 10 um of noise: within 0.03 mm."""
    write_map(tmp_path / "map.csv", lambda x, y, r: 6.4e-4 * x - 2.9e-4 * r - 0.002, noise=0.01)
    fitted = machine_error.load(tmp_path / "map.csv")
    assert fitted.warnings == ()
    turn = np.linspace(0, 2 * np.pi, 90)
    for radius in (75e-3, 125e-3, 305e-3):
        ring = np.column_stack([radius * np.cos(turn), radius * np.sin(turn), np.zeros(90)])
        exact = (6.4e-4 * ring[:, 0] - 2.9e-4 * radius) - 0.002e-3
        assert np.abs(fitted.at(ring) - exact).max() < 0.03e-3
    # span over the opening of the 150 mm cone, 0.00067 mm/mm published
    ring = np.column_stack([75e-3 * np.cos(turn), 75e-3 * np.sin(turn), np.zeros(90)])
    assert np.ptp(fitted.at(ring)) / 150e-3 == pytest.approx(0.00067, abs=0.00006)


@pytest.mark.parametrize(
    ("text", "code"),
    [
        ("x,y\n1,2\n", ErrorCode.FILE_SYNTAX),
        ("x_mm,y_mm,z_mm,error_mm\n1,2,3\n", ErrorCode.FILE_SYNTAX),
        ("x_mm,y_mm,z_mm,error_mm\n1,2,nan,4\n", ErrorCode.FILE_SYNTAX),
        ("x_mm,y_mm,z_mm,error_mm\n", ErrorCode.COMPENSATION_FAILED),
        ("x_mm,y_mm,z_mm,error_mm\n" + "1,2,3,0.1\n" * 9, ErrorCode.COMPENSATION_FAILED),
        (None, ErrorCode.FILE_NOT_FOUND),
    ],
)
def test_unusable_error_maps(text: str | None, code: ErrorCode, tmp_path: Path) -> None:
    if text is not None:
        (tmp_path / "map.csv").write_text(text)
    with pytest.raises(IsfError) as caught:
        machine_error.load(tmp_path / "map.csv")
    assert caught.value.code is code


def test_reading_that_does_not_fit_is_reported_with_its_place(tmp_path: Path) -> None:
    write_map(tmp_path / "map.csv", lambda x, y, r: 0.5 if (x, y) == (150.0, -150.0) else 0.0)
    assert "x = 150.0, y = -150.0" in machine_error.load(tmp_path / "map.csv").warnings[0]


@pytest.mark.parametrize(
    ("wanted", "changes", "words"),
    [
        ("sheet", {"control:": "springback: {method: analytic}\ncontrol:"}, "use one of them"),
        ("tool", {"compliance_compensation: 0": "compliance_compensation: 1"}, "set the latter to 0"),
        ("tool", {"tool_1: {radius: 5 mm, stick_out: 80 mm}": "tool_1: {radius: 5 mm}"}, "tool_1.stick_out"),
        ("machine", {}, "machine_error"),
        ("sheet, sheet", {}, "twice"),
        ("sheets", {}, "compensation"),
    ],
)
def test_jobs_that_would_correct_twice_or_lack_something(wanted: str, changes: dict[str, str], words: str) -> None:
    with pytest.raises(IsfError) as caught:
        job(wanted, **changes)
    assert caught.value.code is ErrorCode.FILE_FIELD
    assert words in str(caught.value)


@settings(max_examples=15, deadline=None)
@given(angle=st.floats(20, 65), opening=st.floats(60, 120), sheet=st.floats(0.5, 1.5))
def test_compensation_keeps_every_gap(angle: float, opening: float, sheet: float) -> None:
    file = job("sheet", **{"thickness: 0.8 mm": f"thickness: {sheet} mm"})
    contours = cone(np.radians(angle), count=5, opening=opening * 1e-3)
    moved, _ = compensate(contours, file)
    for before, after in zip(contours, moved, strict=True):
        gap = [tool_gap(c.forming_tip, c.support_tip, 5e-3, 5e-3) for c in (before, after)]
        np.testing.assert_allclose(*gap, atol=1e-9)
        after.validate()


def test_what_is_formed_within_a_pocket_hangs_in_the_opening_of_the_pocket() -> None:
    """A ring of 30 mm around an island: the sheet between it and the clamp is the pocket's wall and floor."""
    pocket = cone(count=6)
    within = [replace(circle(30e-3, -4e-3 - 0.5e-3 * k, sheet=0.8e-3, tools=2, feature=1), index=6 + k) for k in (0, 1)]
    _, alone = compensate(pocket, job("sheet"))
    _, reported = compensate([*pocket, *within], job("sheet"))
    # the clamp of 250 x 250 mm is a circle of 141 mm
    assert "opening over clamp is 0.71 to 0.71" in alone[1]
    assert "opening over clamp is 0.71 to 0.71" in reported[1]


def test_a_pocket_beside_another_one_has_its_own_opening() -> None:
    aside = np.array([45e-3, 0.0, 0.0])
    pockets = [
        replace(circle(radius, tools=2, sheet=0.8e-3, feature=k).shifted(sign * aside), index=k)
        for k, (radius, sign) in enumerate([(40e-3, -1.0), (25e-3, 1.0)])
    ]
    _, reported = compensate(pockets, job("sheet"))
    assert "opening over clamp is 0.18 to 0.28" in reported[1]
