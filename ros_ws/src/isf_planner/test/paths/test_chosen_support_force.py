"""``support_force: auto``: set-points of planned contours, and what is said about them."""

from pathlib import Path

import numpy as np
import pytest
from isf_core.files.job import JobFile
from isf_planner import plan
from isf_planner.paths.support_tool import chosen_force

JOBS = Path(__file__).resolve().parents[5] / "examples" / "jobs"


def planned(force: str, material: str = "AA5754-O"):
    text = (JOBS / "mini_cone.yaml").read_text().replace("120 N", force).replace("AA5754-O", material)
    job_file = JobFile(text, JOBS)
    return job_file.job, plan(job_file).contours


def test_contours_carry_the_force_for_their_flattest_point():
    job, contours = planned("auto")
    _, given = planned("120 N")
    forced = [contour for contour in contours if contour.force_controlled]
    assert [contour.index for contour in forced] == [c.index for c in given if c.force_controlled]
    for contour in forced:
        assert (contour.support_force == job.support_force_at(float(contour.wall_angle.min()))).all()
        highest = [job.support_window.highest(angle) for angle in contour.wall_angle]
        assert (contour.support_force < np.array(highest)).all()
    reported = chosen_force(job, contours)
    assert f"{forced[0].support_force[0]:.0f} N" in reported
    assert f"on {len(forced)} of {len(contours)} contours" in reported
    assert "contact is kept from 68 N on" in reported
    assert chosen_force(*planned("120 N")) == ""


def test_walls_too_flat_for_any_force_stay_under_position_control(tmp_path):
    """With a small tool on thin soft sheet only steep walls have a force; the cone's 45 deg is not steep enough."""
    text = (JOBS / "mini_cone.yaml").read_text().replace("120 N", "auto").replace("AA5754-O", "AA1050")
    text = text.replace("radius: 5 mm", "radius: 2.6 mm").replace("thickness: 1.0 mm", "thickness: 0.5 mm")
    job_file = JobFile(text, JOBS)
    contours = plan(job_file).contours
    assert not any(contour.force_controlled for contour in contours)
    reported = chosen_force(job_file.job, contours)
    assert "no contour under force control" in reported
    assert np.degrees(job_file.job.support_window.least_wall_angle) == pytest.approx(50.0, abs=1.0)
