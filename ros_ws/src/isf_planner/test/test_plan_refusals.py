"""Jobs that cannot be planned: every refusal has its code, a place and an advice; and what is only warned of."""

from __future__ import annotations

import itertools
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from isf_core.contour import Contour
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import Job, JobFile
from isf_planner import plan
from isf_planner.checks import backing_plate
from planner_parts import Cone, job_for, revolve, told, write
from scipy.spatial import cKDTree


def refusal(job_file: JobFile) -> IsfError:
    with pytest.raises(IsfError) as caught:
        plan(job_file)
    assert caught.value.where
    assert caught.value.advice
    assert caught.value.code.owner == "planner"
    return caught.value


def test_wrong_unit_is_reported_before_anything_else(tmp_path: Path) -> None:
    path = write(Cone().mesh(50e-6), tmp_path / "cone.stl")
    assert refusal(job_for(path, unit="m")).code is ErrorCode.MESH_UNIT_SUSPECT
    assert refusal(job_for(write(Cone().mesh(50e-6), path, 1.0))).code is ErrorCode.MESH_UNIT_SUSPECT


def test_part_larger_than_the_clamp(tmp_path: Path) -> None:
    # clamp 250 mm, tool 5 mm: formed radius may be 120 mm; entry fillet begins 2.5 mm outside of the opening
    assert refusal(job_for(write(Cone(opening=0.119).mesh(50e-6), tmp_path / "a.stl"))).code is (
        ErrorCode.PART_DOES_NOT_FIT
    )
    plan(job_for(write(Cone(opening=0.116).mesh(50e-6), tmp_path / "b.stl"), depth="4 mm"))


@pytest.mark.parametrize(
    ("process", "opening", "meets"),
    # the entry fillet begins 2.5 mm outside of the opening of 30 mm radius; the lower tool needs 5 mm more, beside it,
    # and can wait for that while a contour does not run on into the next one
    [
        ("SPIF", 66.0, ""),
        ("SPIF", 58.0, "into the backing plate"),
        ("DSIF", 66.0, ""),
        ("DSIF, path: {style: spiral}", 66.0, "lower tool"),
        ("DSIF", 80.0, ""),
    ],
)
def test_a_backing_plate_in_the_way(tmp_path: Path, process: str, opening: float, meets: str) -> None:
    process, _, path = process.partition(", path: ")
    job = job_for(write(Cone(opening=0.03).mesh(50e-6), tmp_path / "a.stl"), process=process)
    if path:
        job = JobFile(job.text.replace("path: {", f"path: {{{path.strip('{}')}, "), job.base)
    plate = f"backing_plate: {{shape: circle, size: [{opening:g} mm, {opening:g} mm]}}"
    job = JobFile(f"{job.text}\n{plate}", job.base)
    if not meets:
        plan(job)
        return
    error = refusal(job)
    assert error.code is ErrorCode.PART_DOES_NOT_FIT
    assert meets in error.what
    assert "backing_plate" in error.advice
    more = re.search(r"([\d.]+) mm more on each side", error.advice)
    assert more is not None
    wider = opening + 2.0 * float(more.group(1))
    plan(JobFile(job.text.replace(f"{opening:g} mm", f"{wider:g} mm"), job.base))  # the advice is enough


def plate_refusal(contours: Sequence[Contour], job: Job) -> str:
    """What the check of the backing plate finds; empty: nothing."""
    try:
        backing_plate.check_backing_plate(contours, job)
    except IsfError as error:
        return error.what if error.code is ErrorCode.PART_DOES_NOT_FIT and "contour" in error.where else error.message
    return ""


def test_the_sheet_around_the_tool_stays_off_the_plate(tmp_path: Path) -> None:
    """Where the wall is steep, the sheet reaches further out than the contact: by distances to points of the plate."""
    steep = Cone(opening=0.03, angle=np.radians(62), entry=5.5e-3)
    job = job_for(write(steep.mesh(20e-6), tmp_path / "a.stl"), process="SPIF")
    contours = plan(job).contours
    centre = np.vstack([contour.contact + 5e-3 * contour.normal for contour in contours])
    formed = np.concatenate([contour.thickness for contour in contours])
    found = set()
    for opening, edge in itertools.product(np.arange(26e-3, 34e-3, 0.25e-3), (0.0, 2e-3)):
        turn = np.linspace(0.0, 0.5 * np.pi, 100)
        quarter = [opening + edge * (1 - np.sin(turn)), edge * (np.cos(turn) - 1) - 1e-3]
        wall = [np.full(800, opening), np.linspace(-edge - 1e-3, -40e-3, 800)]
        flat = [np.linspace(opening + edge, 80e-3, 800), np.full(800, -1e-3)]
        plate = np.hstack([quarter, wall, flat]).T
        apart = cKDTree(plate).query(np.column_stack([np.hypot(*centre[:, :2].T), centre[:, 2]]))[0]
        into = 1e3 * float((5e-3 + formed - apart).max())
        size = f"[{2e3 * opening:.2f} mm, {2e3 * opening:.2f} mm]"
        text = f"{job.text}\nbacking_plate: {{shape: circle, size: {size}, edge_radius: {1e3 * edge:g} mm}}"
        told = plate_refusal(contours, JobFile(text, job.base).job)
        kind = told.split(" ")[1] if told else ""
        found.add(kind)
        if kind == "upper":
            assert float(re.findall(r"([\d.]+) mm into", told)[0]) == pytest.approx(into, abs=0.02)
        if not kind:
            assert into < 0.12
        if into > 0.12:
            assert kind
    assert found == {"", "part", "upper"}


def test_part_deeper_than_the_travel(tmp_path: Path) -> None:
    # travel of the rig in z: 110 mm
    deep = Cone(opening=0.06, angle=np.radians(75), depth=0.112, floor=8e-3)
    error = refusal(job_for(write(deep.mesh(50e-6), tmp_path / "a.stl"), depth="4.9 mm"))
    assert error.code is ErrorCode.PART_DOES_NOT_FIT
    assert "travel" in error.what


def test_wall_beyond_the_limit_of_the_sheet(tmp_path: Path) -> None:
    path = write(Cone(angle=np.radians(60)).mesh(10e-6), tmp_path / "cone.stl")
    error = refusal(job_for(path, limit="55 deg"))
    assert error.code is ErrorCode.WALL_TOO_STEEP
    assert "60.0 deg" in error.what
    # the place is on the straight wall
    z = float(error.where.split("z = ")[1].split()[0]) * 1e-3
    steep = Cone(angle=np.radians(60))
    assert steep.floor_begin - 0.1e-3 <= z <= steep.entry_end + 0.1e-3


def test_limit_of_the_material_is_used_when_the_job_has_none(tmp_path: Path) -> None:
    path = write(Cone(angle=np.radians(70)).mesh(50e-6), tmp_path / "cone.stl")
    text = job_for(path).text.replace("wall_angle_limit: 80 deg\n", "")
    error = refusal(JobFile(text, tmp_path))  # AA5754-O: 66 deg
    assert error.code is ErrorCode.WALL_TOO_STEEP
    assert "66.0 deg" in error.what


def test_wall_near_the_limit_is_warned_of(tmp_path: Path) -> None:
    path = write(Cone().mesh(50e-6), tmp_path / "cone.stl")
    warnings = plan(job_for(path, limit="46 deg", depth="3 mm")).warnings
    assert any("45.0 deg steep" in warning for warning in warnings)
    # 45 is 90 % of it
    assert not any("deg steep" in warning for warning in plan(job_for(path, limit="50 deg", depth="3 mm")).warnings)


def test_pocket_in_which_the_tool_does_not_reach_the_bottom(tmp_path: Path) -> None:
    """A spherical bottom of 4 mm under a ball of 5 mm: the ball rests on the wall above it."""
    bowl, angle = 4e-3, np.radians(60)
    turn = np.linspace(angle, 0.02, 30)
    lower = np.column_stack([bowl * np.sin(turn), -bowl * np.cos(turn)])
    rise = 10e-3
    upper = lower[0] + np.array([[rise / np.tan(angle), rise]])
    profile = np.vstack([upper + [8e-3, 0.0], upper, lower]) - [0.0, upper[0, 1]]
    error = refusal(job_for(write(revolve(profile, 180), tmp_path / "pit.stl")))
    assert error.code is ErrorCode.PART_TOO_SMALL_FOR_TOOL
    # both spheres touch the cone of 60 deg: the larger one's centre is (R - r) / cos higher, its tip R - r less
    missing = (5.0 - 4.0) * (1 / np.cos(angle) - 1)
    reported = float(error.what.split(" stops ")[1].split()[0])
    assert reported == pytest.approx(missing, abs=0.03)  # facets, and the bottom is cut off at 0.02 rad


def test_floor_fillet_smaller_than_the_tool_is_warned_of(tmp_path: Path) -> None:
    path = write(Cone(floor=1.5e-3).mesh(10e-6), tmp_path / "cone.stl")
    (warning,) = told(plan(job_for(path, depth="2 mm", process="SPIF")))
    assert "smaller than the tool" in warning
    assert "z = -1" in warning  # at the floor, -12 mm, or just above


def test_entry_fillet_too_tight_for_the_support_tool_is_warned_of(tmp_path: Path) -> None:
    path = write(Cone(entry=2e-3).mesh(10e-6), tmp_path / "cone.stl")
    (warning,) = told(plan(job_for(path, depth="1 mm")))
    assert "support tool" in warning
    assert told(plan(job_for(path, depth="2 mm", process="SPIF"))) == ()


def test_part_beside_the_centre_is_placed_and_reported(tmp_path: Path) -> None:
    centred = plan(job_for(write(Cone().mesh(50e-6), tmp_path / "a.stl"), depth="3 mm"))
    moved = plan(
        job_for(write(Cone().mesh(50e-6).moved(np.array([0.3, 0.1, -0.05])), tmp_path / "b.stl"), depth="3 mm")
    )
    assert "moved by" in moved.warnings[0]
    for a, b in zip(centred.contours, moved.contours, strict=True):
        np.testing.assert_allclose(a.forming_tip, b.forming_tip, atol=1e-6)  # single precision at 300 mm, Newton's rest


def test_progress_rises_and_names_the_contours(tmp_path: Path) -> None:
    path = write(Cone().mesh(50e-6), tmp_path / "cone.stl")
    reported: list[tuple[str, float]] = []
    plan(job_for(path, depth="3 mm"), progress=lambda phase, share: reported.append((phase, share)))
    shares = [share for _, share in reported]
    assert shares == sorted(shares)
    assert (shares[0], shares[-1]) == (0.0, 1.0)
    assert "contour 4 of 4" in [phase for phase, _ in reported]


def test_cancelling_between_two_contours(tmp_path: Path) -> None:
    path = write(Cone().mesh(50e-6), tmp_path / "cone.stl")
    reported: list[str] = []
    with pytest.raises(IsfError) as caught:
        plan(
            job_for(path, depth="3 mm"),
            progress=lambda phase, share: reported.append(phase),
            cancelled=lambda: "contour 2 of 4" in reported,
        )
    assert caught.value.code is ErrorCode.PLAN_CANCELLED
    assert reported[-1] == "contour 2 of 4"
