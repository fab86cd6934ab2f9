"""The push on the flat sheet of the simulated machine, and what it says of the clamp."""

import json
from pathlib import Path

import numpy as np
import pytest
from isf_cell.commands.springback import edge_of
from isf_cell.run.flat_push import push_flat_sheet
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import load_job
from isf_sim.variant import make_variant
from typer.testing import CliRunner

JOB = Path(__file__).resolve().parents[5] / "examples" / "jobs" / "ren_cone.yaml"


def test_the_nominal_sheet_gives_way_as_published_and_its_edge_is_free():
    """5.0 mm at 400 N (Ren 2018, 4.3.2); the rig's edge is free in plane."""
    job_file = load_job(JOB)
    push = push_flat_sheet(job_file)
    assert np.interp(400.0, push.force, push.displacement) == pytest.approx(5.0e-3, rel=0.05)
    found = edge_of(job_file, push)
    assert (found.edge.slope, found.edge.in_plane) == ("clamped", 0.0)


@pytest.mark.parametrize("variant", [1, 9])
def test_a_stiffer_edge_is_found(variant):
    """Springs of 50 and 52 N/mm per mm; modulus, thickness and load cell are off as well, and go into what is found."""
    job_file = load_job(JOB)
    spring = make_variant(variant).edge_spring
    assert spring > 45e6
    found = edge_of(job_file, push_flat_sheet(job_file, variant))
    assert found.edge.slope == "clamped"
    assert 0.7 * spring < found.edge.in_plane < 2.0 * spring


def test_a_force_that_is_not_reached_is_reported():
    with pytest.raises(IsfError) as reported:
        push_flat_sheet(load_job(JOB), force=5000.0)
    assert reported.value.code in (ErrorCode.PUSH_CURVE_UNUSABLE, ErrorCode.MACHINE_FAULTED)


def test_a_sheet_over_a_backing_plate_says_nothing_of_its_clamp():
    with pytest.raises(IsfError, match="does not hang in its clamp") as reported:
        push_flat_sheet(load_job(JOB.with_name("lu_cone.yaml")))
    assert reported.value.code == ErrorCode.FILE_FIELD


def test_a_place_that_cannot_be_reached_is_reported():
    with pytest.raises(IsfError, match="the push was stopped") as reported:
        push_flat_sheet(load_job(JOB), place=(0.5, 0.0))
    assert reported.value.code == ErrorCode.MACHINE_FAULTED


def test_the_command_pushes_the_simulated_machine():
    from isf_cell.cli import app

    result = CliRunner().invoke(app, ["springback", "calibrate", str(JOB), "--world", "9", "--json"])
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout)["edge_stiffness_MPa"] == pytest.approx(77.0, rel=0.05)
