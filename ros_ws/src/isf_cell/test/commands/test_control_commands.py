"""``isf tune`` and ``isf calibrate-cell`` as a user runs them, in this process."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import yaml
from isf_cell.commands.calibrate_cell import calibrate_file
from isf_cell.commands.tune import tune_job
from isf_cell.commands.tune_legs import tune_legs
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import load_job
from isf_core.files.rig import LoadCell

JOB = Path(__file__).resolve().parents[5] / "examples" / "jobs" / "mini_cone.yaml"
TUNE = {"stiffness": None, "delay": 0.0, "noise": 1.0, "loop_gain": None, "as_json": True}


def test_tune_draws_and_reports(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    tune_job(JOB, tmp_path / "tune", **TUNE)  # type: ignore[arg-type]
    data = json.loads(capsys.readouterr().out)
    assert data["gain_margin"] > 3.0
    assert data["step_settling_s"] < 0.3
    assert all(Path(picture).stat().st_size > 10_000 for picture in data["pictures"])


def test_tune_refuses_nonsense(tmp_path: Path) -> None:
    for wrong in ({"stiffness": -1.0}, {"loop_gain": float("nan")}, {"loop_gain": 0.0}, {"delay": float("inf")}):
        with pytest.raises(IsfError, match="positive"):
            tune_job(JOB, tmp_path, **{**TUNE, **wrong})  # type: ignore[arg-type]


def write(path: Path, header: str, rows: np.ndarray, encoding: str = "utf-8") -> Path:
    np.savetxt(path, rows, delimiter=",", header=header, comments="", encoding=encoding)
    return path


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig"])
def test_matrix_of_a_table(encoding: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A table of a spreadsheet, with a byte order mark, has the same columns of loads."""
    load = np.vstack([np.zeros((1, 3)), *(size * np.eye(3) for size in (100.0, -100.0, 300.0))])
    rows = np.column_stack([load, load / 2.0 + 7.0])
    table = write(tmp_path / "loads.csv", "fx,fy,fz,u1,u2,u3", rows, encoding)
    calibrate_file(table, None, tmp_path / "cell.yaml", as_json=True)
    data = json.loads(capsys.readouterr().out)
    assert np.array(data["matrix"]) == pytest.approx(2.0 * np.eye(3), abs=1e-9)
    assert data["zero"] == pytest.approx([7.0, 7.0, 7.0])
    assert data["rejected_rows"] == []
    assert np.array(data["rig_matrix"]) == pytest.approx(np.diag([0.5, 0.5, 0.5, 1.0, 1.0, 1.0]), abs=1e-9)


@pytest.mark.parametrize("axes", [3, 6])
def test_the_piece_for_the_rig_file_can_be_pasted(tmp_path: Path, axes: int) -> None:
    response = np.eye(6)
    response[:axes, :axes] += 0.03 * np.random.default_rng(1).standard_normal((axes, axes))
    load = np.vstack([np.zeros((1, axes)), *(size * np.eye(axes) for size in (100.0, -100.0, 300.0))])
    names = ["fx", "fy", "fz", "tx", "ty", "tz"][:axes]
    header = ",".join([*names, *(f"u{k}" for k in range(axes))])
    rows = np.column_stack([load, load @ response[:axes, :axes].T + 4.0])
    calibrate_file(write(tmp_path / "loads.csv", header, rows), None, tmp_path / "cell.yaml", as_json=False)
    piece = yaml.safe_load((tmp_path / "cell.yaml").read_text(encoding="utf-8"))
    rig = load_job(JOB).rig
    cell = LoadCell(**{**rig.load_cell.model_dump(), **piece["load_cell"]})
    assert np.array(cell.matrix) == pytest.approx(response, abs=1e-5)  # reading = matrix times load


def test_a_matrix_of_volts_is_for_the_driver_only(tmp_path: Path) -> None:
    load = np.vstack([np.zeros((1, 3)), *(size * np.eye(3) for size in (100.0, -100.0, 300.0))])
    rows = np.column_stack([load, load / 2400.0])
    calibrate_file(
        write(tmp_path / "loads.csv", "fx,fy,fz,u1,u2,u3", rows), None, tmp_path / "cell.yaml", as_json=False
    )
    piece = yaml.safe_load((tmp_path / "cell.yaml").read_text(encoding="utf-8"))
    assert set(piece) == {"calibration_matrix"}
    assert np.array(piece["calibration_matrix"]) == pytest.approx(2400.0 * np.eye(3), abs=1e-6)


def test_gains_of_channels(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    load = np.array([0.0, 100.0, 500.0, 1000.0, -100.0, -500.0, -1000.0])
    volts = load / 2400.0
    volts[4] *= 10.0  # a slip of the decimal point
    calibrate_file(write(tmp_path / "loads.csv", "load,X", np.column_stack([load, volts])), None, None, as_json=True)
    data = json.loads(capsys.readouterr().out)["X"]
    assert data["gain"] == pytest.approx(2400.0, rel=1e-6)
    assert data["rejected_loads"] == [-100.0]


@pytest.mark.parametrize(
    ("text", "code"),
    [
        ("", ErrorCode.FILE_FIELD),
        ("load,X\n1,2\n3\n4,5\n", ErrorCode.FILE_SYNTAX),
        ("load,X\n1,2\n3,x\n4,5\n", ErrorCode.FILE_SYNTAX),
        ("a,b\n1,2\n3,4\n5,6\n", ErrorCode.FILE_FIELD),
        ("fx,u\n1,2\n1,2\n1,2\n", ErrorCode.FILE_FIELD),
    ],
)
def test_bad_tables_are_reported(tmp_path: Path, text: str, code: ErrorCode) -> None:
    path = tmp_path / "loads.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(IsfError) as caught:
        calibrate_file(path, None, None, as_json=False)
    assert caught.value.code is code


def test_a_missing_table(tmp_path: Path) -> None:
    with pytest.raises(IsfError) as caught:
        calibrate_file(tmp_path / "none.csv", None, None, as_json=False)
    assert caught.value.code is ErrorCode.FILE_NOT_FOUND


def test_tune_of_legs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    tune_legs(JOB.with_name("torrao_cone_45.yaml"), tmp_path / "legs", as_json=True)
    data = json.loads(capsys.readouterr().out)
    assert data["controller"] == "feedforward"
    path = data["cases"]["path"]
    assert path["feedforward"]["leg_error_um"]["largest"] < 50.0
    assert path["feedforward"]["speed_ripple"] < 0.05
    assert path["fuzzy"]["leg_error_um"]["largest"] > 300.0
    assert all(Path(picture).stat().st_size > 10_000 for picture in data["pictures"])
    with pytest.raises(IsfError, match="has no legs"):
        tune_legs(JOB, tmp_path, as_json=True)
