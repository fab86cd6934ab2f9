"""``isf identify`` as a user runs it; what it writes is a rig file that a job runs with."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from isf_cell import cli, in_process
from isf_cell.cli import app
from isf_cell.commands.exit_codes import exit_for
from isf_cell.commands.identify import rig_job
from isf_cell.options import RunOptions
from isf_cell.run import identify_run
from isf_cell.run.identify_run import identify
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile, load_job
from isf_core.files.rig import load_rig
from isf_identify.identification import Finding
from isf_identify.settings import IdentifySettings, Property
from typer.testing import CliRunner

JOB = Path(__file__).resolve().parents[5] / "examples" / "jobs" / "mini_cone.yaml"


def run(*arguments: str) -> Any:
    return _identify(str(JOB), *arguments)


def _identify(*arguments: str) -> Any:
    return CliRunner().invoke(app, ["identify", *arguments])


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


def test_a_rig_alone_is_enough(tmp_path: Path) -> None:
    done = _identify("--rig", "ren2018", "-p", "servo", "--repeats", "1", "--json", "-o", str(tmp_path / "servo.yaml"))
    assert done.exit_code == 0, done.output
    assert json.loads(done.stdout)["value"][0] == pytest.approx(30.0, rel=0.02)
    assert load_rig(str(tmp_path / "servo.yaml")).servo.bandwidth == pytest.approx(30.0, rel=0.02)


@pytest.mark.parametrize("below", ["rig", "job", "file"])
def test_compliance_by_dial_is_a_rig_file(tmp_path: Path, below: str) -> None:
    table, piece = tmp_path / "dial.csv", tmp_path / "mine: #2.yaml"
    rows = [
        f"1,{axis},{place},{repeat},{force},{5.0 + give * force + 0.1 * (-1) ** k:.3f}"
        for axis, give in (("x", 1.2), ("z", 0.12))
        for place in (1, 2, 3)
        for repeat in range(1, 7)
        for k, force in enumerate((20, 60, 100, 140))
    ]
    table.write_text("# tip of tool_1\ntool,axis,place,repeat,force_N,deflection_um\n" + "\n".join(rows))
    own = tmp_path / "rig: #1.yaml"
    own.write_text("name: own\nbased_on: ren2018\n")
    on = {"rig": ("--rig", "ren2018"), "job": (str(JOB),), "file": ("--rig", str(own))}[below]
    done = _identify(*on, "--dial", str(table), "--json", "-o", str(piece))
    assert done.exit_code == 0, done.output
    values = json.loads(done.stdout)["values"]
    assert set(values) == {"tool_1.x", "tool_1.z"}
    rig = load_rig(str(piece))
    assert rig.name == "mine: #2"
    assert rig.tool_1.compliance == pytest.approx((1.2e-6, 1.0e-6, 0.12e-6), rel=0.01)
    assert rig.tool_2 == load_rig("ren2018").tool_2
    assert "dial indicator" in rig.provenance["tool_1.compliance.x"]
    assert "+-" in rig.provenance["tool_1.compliance.x"]
    assert "kept" in rig.provenance["tool_1.compliance.y"]


def test_dial_readings_in_another_unit_are_refused(tmp_path: Path) -> None:
    table, piece = tmp_path / "dial.csv", tmp_path / "mine.yaml"
    rows = [f"1,x,{force},{1.1 * force + 0.1 * k}" for k, force in enumerate((20, 60, 100, 140, 180))]
    table.write_text("tool,axis,force_N,deflection_mm\n" + "\n".join(rows))
    done = _identify("--rig", "ren2018", "--dial", str(table), "-o", str(piece))
    assert isinstance(done.exception, IsfError)
    assert done.exception.code is ErrorCode.MEASUREMENT_FAILED
    assert "deflections are um" in str(done.exception)
    assert not piece.exists()


@pytest.mark.parametrize(
    ("text", "code"),
    [
        ("tool,axis,force_N\n1,x,20\n", ErrorCode.FILE_FIELD),
        ("tool,axis,force_N,deflection_um\n1,x,20\n", ErrorCode.FILE_SYNTAX),
        ("tool,axis,force_N,deflection_um\n1,w,20,4\n", ErrorCode.FILE_SYNTAX),
        ("tool,axis,force_N,deflection_um\n3,x,20,4\n", ErrorCode.FILE_FIELD),
        ("tool,axis,force_N,deflection_um\n1,x,nan,4\n", ErrorCode.FILE_FIELD),
        ("tool,axis,force_N,deflection_um\n", ErrorCode.FILE_FIELD),
        ("tool,axis,force_N,deflection_um\n1,x,20,4\n1,x,40,8\n", ErrorCode.MEASUREMENT_FAILED),
    ],
)
def test_tables_that_say_nothing(tmp_path: Path, text: str, code: ErrorCode) -> None:
    table = tmp_path / "dial.csv"
    table.write_text(text)
    done = _identify("--rig", "ren2018", "--dial", str(table), "-o", str(tmp_path / "mine.yaml"))
    assert isinstance(done.exception, IsfError)
    assert done.exception.code is code
    assert not (tmp_path / "mine.yaml").exists()


@pytest.mark.parametrize(
    "arguments",
    [("-p", "servo"), (str(JOB), "--rig", "ren2018", "-p", "servo"), ("--rig", "ren2018"), ("--dial", "dial.csv")],
    ids=str,
)
def test_either_a_job_or_a_rig(arguments: tuple[str, ...]) -> None:
    done = _identify(*arguments)
    assert isinstance(done.exception, IsfError)
    assert done.exception.code is ErrorCode.FILE_FIELD


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


def test_the_rig_of_a_job_that_is_made_has_any_path(tmp_path: Path) -> None:
    own = tmp_path / "my rigs: #1" / "own.yaml"
    own.parent.mkdir()
    own.write_text("name: own\nbased_on: ren2018\n")
    assert rig_job(str(own), tmp_path).rig.name == "own"


def test_a_part_of_one_tool_identifies_its_servo(tmp_path: Path) -> None:
    spif = str(JOB.with_name("spif_cone.yaml"))
    done = _identify(spif, "-p", "servo", "--repeats", "1", "--json", "-o", str(tmp_path / "mine.yaml"))
    assert done.exit_code == 0, done.output
    assert json.loads(done.stdout)["value"][0] == pytest.approx(30.0, rel=0.03)
    done = _identify(spif, "-p", "servo", "--tool", "2", "-o", str(tmp_path / "other.yaml"))
    assert isinstance(done.exception, IsfError)
    assert done.exception.code is ErrorCode.MEASUREMENT_REFUSED
    assert "only the servo of tool 1" in str(done.exception)


@pytest.mark.parametrize("name", ["compliance", "stiffness", "signs"])
@pytest.mark.parametrize("contours", ["0", "3"])
def test_a_part_of_accumulative_forming_identifies_its_servo_alone(tmp_path: Path, name: str, contours: str) -> None:
    job, piece = str(JOB.with_name("adsif_cone.yaml")), str(tmp_path / "mine.yaml")
    done = _identify(job, "-p", name, "--contours", contours, "-o", piece)
    assert isinstance(done.exception, IsfError)
    assert done.exception.code is ErrorCode.MEASUREMENT_REFUSED
    assert "with this one the servo alone" in str(done.exception)


def test_what_fails_before_measuring_leaves_no_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for arguments in (("--rig", "nowhere", "-p", "servo"), ("--rig", "ren2018", "--dial", "nowhere.csv")):
        done = _identify(*arguments)
        assert isinstance(done.exception, IsfError)
        assert done.exception.code is ErrorCode.FILE_NOT_FOUND
        assert list(tmp_path.glob("runs/*")) == []


def test_a_result_with_an_error_is_one_object(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Turned signs are found, and are an error."""
    signs, none = np.array([1.0, -1.0, 1.0, 1.0, 1.0, 1.0]), np.zeros(6)
    found = Finding(ErrorCode.LOAD_CELL_SIGN, "tool_1: Fy is turned round", signs, none, "# tool_1: Fy\n")
    monkeypatch.setattr(identify_run, "identify", lambda *_, **__: found)
    monkeypatch.setattr(cli, "keep_for_results", lambda: None)  # standard output is that of the tests
    piece = tmp_path / "signs.yaml"
    monkeypatch.setattr("sys.argv", ["isf", "identify", str(JOB), "-p", "signs", "--json", "-o", str(piece)])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    assert ended.value.code == exit_for(ErrorCode.LOAD_CELL_SIGN)
    data = json.loads(capsys.readouterr().out)
    assert data["value"] == list(signs)
    assert data["error"]["name"] == "LOAD_CELL_SIGN"
    assert "turned round" in data["error"]["message"]
    assert piece.read_text() == found.piece


def test_a_fault_of_the_machine_is_reported() -> None:
    job_file = load_job(JOB)
    settings = IdentifySettings.of(Property.LOAD_CELL_SIGNS, 1, 1, (0.0, 0.0, 0.0), 200.0)
    from isf_sim.machine.simulated_machine import SimulatedMachine

    machine = SimulatedMachine(job_file)
    machine.tare()
    machine.latch(ErrorCode.FORCE_LIMIT, "tried")
    with pytest.raises(IsfError) as caught:
        identify(job_file, settings, contours=0, machine=machine)
    assert caught.value.code is ErrorCode.MACHINE_FAULTED
