"""``isf identify`` as a user runs it; what it writes is a rig file that a job runs with."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from isf_cell import in_process
from isf_cell.cli import app
from isf_cell.identify_run import identify
from isf_cell.options import RunOptions
from isf_core.errors import ErrorCode, IsfError
from isf_core.job import JobFile, load_job
from isf_force_ctrl.identify_settings import IdentifySettings, Property
from typer.testing import CliRunner

JOB = Path(__file__).resolve().parents[4] / "examples" / "jobs" / "mini_cone.yaml"


def run(*arguments: str) -> Any:
    return CliRunner().invoke(app, ["identify", str(JOB), *arguments])


def test_a_job_runs_with_the_identified_rig(tmp_path: Path) -> None:
    piece = tmp_path / "mine.yaml"
    done = run("-p", "stiffness", "--repeats", "1", "--world", "2", "--json", "-o", str(piece))
    assert done.exit_code == 0, done.output
    data = json.loads(done.stdout)
    assert Path(data["picture"]).stat().st_size > 10_000
    text = JOB.read_text().replace("rig: ren2018", f"rig: {piece}")
    job_file = JobFile(text, JOB.parent)
    rig = job_file.rig
    assert rig.name == "mine"
    assert rig.contact_stiffness == pytest.approx(data["value"][0], rel=1e-3)
    assert rig.provenance["contact_stiffness"].startswith("identified 20")
    assert rig.servo == load_job(JOB).rig.servo
    part = in_process.form(job_file, RunOptions(correction="none"), cancelled=_after(5))
    assert all(result.completed for result in part.results)
    assert len(part.results) == 5


def _after(count: int) -> Any:
    left = iter(range(count - 1))
    return lambda: next(left, None) is None


def test_the_servo_needs_no_part(tmp_path: Path) -> None:
    done = run("-p", "servo", "--repeats", "1", "--tool", "2", "--json", "-o", str(tmp_path / "servo.yaml"))
    assert done.exit_code == 0, done.output
    assert json.loads(done.stdout)["value"][0] == pytest.approx(30.0, rel=0.02)


@pytest.mark.parametrize(
    ("arguments", "code"),
    [
        (("-p", "weight"), ErrorCode.FILE_FIELD),
        (("-p", "servo", "--place", "1 2"), ErrorCode.FILE_FIELD),
        (("-p", "signs", "--contours", "0", "--max-force", "nan"), ErrorCode.MEASUREMENT_REFUSED),
        (("-p", "signs", "--contours", "99"), ErrorCode.FILE_FIELD),
        (("-p", "servo", "-o", "/nowhere/piece.yaml"), ErrorCode.FILE_NOT_WRITABLE),
    ],
    ids=str,
)
def test_refusals_of_the_command(arguments: tuple[str, ...], code: ErrorCode) -> None:
    done = run(*arguments)
    assert isinstance(done.exception, IsfError)
    assert done.exception.code is code


def test_a_fault_of_the_machine_is_told() -> None:
    job_file = load_job(JOB)
    settings = IdentifySettings.of(Property.LOAD_CELL_SIGNS, 1, 1, (0.0, 0.0, 0.0), 200.0)
    from isf_sim.machine import SimulatedMachine

    machine = SimulatedMachine(job_file)
    machine.tare()
    machine.latch(ErrorCode.FORCE_LIMIT, "tried")
    with pytest.raises(IsfError) as caught:
        identify(job_file, settings, contours=0, machine=machine)
    assert caught.value.code is ErrorCode.MACHINE_FAULTED
