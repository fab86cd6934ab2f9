"""The error of a formed part in the terms of Ren 2018, eq. 1-1, by hand on a wall of 45 deg."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from isf_analysis.measures.error_split import error_splits
from isf_analysis.measures.record import PartRecord
from isf_analysis.measures.summary import summary
from isf_analysis.report import finding_tables
from isf_core.contour import Contour, ContourCorrection, ContourResult, Process
from isf_core.geometry.height_map import HeightMap
from scipy.spatial.transform import Rotation
from synthetic_part import make_part

N = 5
SINE = np.sqrt(0.5)
UM = 1e-6
STEP = np.array([1e-3, 0.0, 0.0])


def points(x: float, y: float, z: float) -> np.ndarray:
    """(N, 3) m from um, the same at every point."""
    return np.tile([x * UM, y * UM, z * UM], (N, 1))


def part(*, force_control: bool = False, below: bool = False, compliance: bool = True) -> tuple[PartRecord, HeightMap]:
    """One contour along y on a wall whose upper side looks towards +x and up.

    Sent 1000 um down and streamed with 50 um of compensation in x; the encoders see 20 um more in x and 4 in z; 100 N
    along x and 400 N along z deflect the forming tool by 100 um (1 um/N) and 40 um (0.1 um/N). The support tool was
    sent as the forming one, stands 30 um off in -x and is deflected by 2 um/N of -5 N. Formed 300 um too high.
    """
    side = -1.0 if below else 1.0
    tips = np.linspace([0.0, -0.02, -0.01], [0.0, 0.02, -0.01], N)
    support = tips - STEP
    planned = Contour(
        plan_id="by hand",
        index=0,
        count=1,
        process=Process.DSIF,
        feed=0.03,
        contact=tips,
        normal=side * np.tile([SINE, 0.0, SINE], (N, 1)),
        wall_angle=np.full(N, np.pi / 4),
        thickness=np.full(N, 1e-3),
        forming_tip=tips,
        support_tip=support,
        support_force=np.full(N, 120.0) if force_control else np.empty(0),
        forming_tool=2 if below else 1,
        closed=False,
    )
    down = points(0, 0, -1000)
    sent = replace(planned, forming_tip=tips + down, support_tip=support + down)
    streamed = sent.forming_tip + points(50, 0, 0)
    none = np.empty(0)
    result = ContourResult(
        "by hand",
        0,
        1.0,
        2.0,
        True,
        forming_force=np.tile([100.0, 0.0, 400.0], (N, 1)),
        support_force=np.tile([-5.0, 0.0, 0.0], (N, 1)),
        forming_target=streamed,
        support_target=sent.support_tip,
        force_offset=none,
        compliance_offset=points(50, 0, 0),
        tick_time=none,
        tick_set_point=none,
        tick_normal_force=none,
        tick_engaged=none.astype(bool),
        forming_measured=streamed + points(20, 0, 4),
        support_measured=sent.support_tip + points(-30, 0, 0),
    )
    first, second = (UM, UM, 0.1 * UM), (2 * UM, 2 * UM, 0.2 * UM)
    tools = (second, first) if below else (first, second)
    record = replace(
        make_part(contours=2),
        nominal=(planned,),
        corrected=(sent,),
        corrections=(ContourCorrection("by hand", 0, "analytic", down, np.zeros(N)),),
        results=(result,),
        scans=(),
        tool_compliance=tools if compliance else None,
    )
    axis = np.array([-0.1, 0.1])
    return record, HeightMap(axis, axis, np.full((2, 2), 300 * UM))


@pytest.mark.parametrize(("below", "sign"), [(False, 1.0), (True, -1.0)])
def test_terms_are_those_by_hand_and_add_up(below: bool, sign: float) -> None:
    """Along the normal x and z count with the sine of 45 deg; a tool from below looks the other way."""
    record, error = part(below=below)
    (split,) = error_splits(record, error)
    by_hand = {
        "correction": -1000.0,
        "followed": 20.0 + 4.0,
        "deflected": 50.0 + 100.0 + 40.0,
        "tool": 24.0 + 190.0,
        "error": 300.0,
        "sheet": 300.0 + 1000.0 - 24.0 - 190.0,
    }
    for name, value in by_hand.items():
        assert getattr(split, name) == pytest.approx(np.full(N, sign * SINE * value * UM), abs=1e-12), name
    # away from the forming tool, horizontally: 30 um off and 10 um of deflection, both towards -x
    assert split.support == pytest.approx(np.full(N, sign * 40.0 * UM), abs=1e-12)


def test_the_movement_by_release_counts_along_the_normal_and_is_not_in_the_sum() -> None:
    record, error = part()
    (split,) = error_splits(record, error, replace(error, z=np.full((2, 2), -80 * UM)))
    assert split.released == pytest.approx(np.full(N, -SINE * 80.0 * UM), abs=1e-12)
    assert split.error == pytest.approx(np.full(N, SINE * 300.0 * UM), abs=1e-12)
    assert len(error_splits(record, error)[0].released) == 0


def test_a_part_out_of_the_clamp_tells_delta_3_wherever_it_lies() -> None:
    """It is bent by 0.2 mm at a radius of 50 mm, turned by a degree and 3 mm away; else not measured."""
    whole = make_part(contours=6, spacing=2.5e-3)
    assert whole.scan is not None
    points = whole.scan.points()
    radius = np.hypot(points[:, 0], points[:, 1])
    bent = points + np.column_stack([0 * radius, 0 * radius, 0.2e-3 * (radius / 50e-3) ** 2])
    turn = Rotation.from_euler("xyz", [0.6, -0.5, 0.3], degrees=True)
    lies = turn.apply(bent[radius < 50e-3]) + [1e-3, -2e-3, 2e-3]
    numbers = summary(replace(whole, released=lies))
    released, split = numbers["error_split"]["released"], numbers["error_split"]["error"]
    assert 0.03 < released["rms_mm"] < 0.1  # of a bowl of 0.2 mm what no motion takes away
    assert split == summary(whole)["error_split"]["error"]
    table = finding_tables.split_table(numbers)
    assert "not measured" not in table
    assert "not measured" in finding_tables.split_table(summary(whole))


def test_what_is_not_known_is_left_open() -> None:
    record, error = part(force_control=True)
    assert len(error_splits(record, error)[0].support) == 0  # it seeks a force
    blind = replace(record, results=(replace(record.results[0], forming_measured=np.empty((0, 3))),))
    assert error_splits(blind, error) == ()
    assert error_splits(replace(record, results=(replace(record.results[0], completed=False),)), error) == ()
    record, error = part(compliance=False)
    (split,) = error_splits(record, error)
    assert np.isnan(split.deflected).all()
    assert np.isnan(split.sheet).all()
    assert np.isfinite(split.followed).all()


def test_summary_and_table_tell_the_terms_in_mm() -> None:
    whole = make_part(contours=6, spacing=2.5e-3)
    numbers = summary(whole)
    split = numbers["error_split"]
    assert split["contours"] == 6
    terms = ("correction", "tool", "sheet")
    assert sum(split[name]["mean_mm"] for name in terms) == pytest.approx(split["error"]["mean_mm"], abs=1e-9)
    assert split["support"] == {"mean_mm": None, "rms_mm": None, "max_abs_mm": None}  # force control
    table = finding_tables.split_table(numbers)
    assert "Ren 2018, eq. 1-1" in table
    assert "support tool" not in table
    assert finding_tables.split_table(summary(replace(whole, scan=None))) == ""
