"""What the command shows to people: units in the heads of tables, brackets as they are."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from isf_cell.commands import compare, identify, springback_compare, terminal, tryout
from isf_cell.commands.calibrate_cell import calibrate_file
from isf_cell.commands.springback import calibrate_clamp, predict_part
from isf_core.errors import ErrorCode, IsfError
from isf_identify.identification import Finding
from isf_identify.settings import IdentifySettings, Property

JOB = Path(__file__).resolve().parents[5] / "examples" / "jobs" / "mini_cone.yaml"


@pytest.fixture(autouse=True)
def wide(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(terminal.console, "_width", 200)


def test_brackets_are_not_markup() -> None:
    with terminal.console.capture() as shown:
        terminal.show_error(IsfError(ErrorCode.FILE_FIELD, "no [mm] here", where="runs/[new]", advice="use [bold]"))
        terminal.say("picture runs/[red]/plan.png")
        terminal.warn("path [deg]")
        terminal.console.print(terminal.table_of("part [1]", "place", "depth [mm]"))
    for words in ("no [mm] here", "runs/[new]", "use [bold]", "runs/[red]/plan.png", "path [deg]", "depth [mm]"):
        assert words in shown.get()


def test_a_comparison_of_methods_reports_its_units() -> None:
    row = {"method": "none", "contours": 3, "code": 0, "slowest_correction_ms": 1.0, "largest_correction_mm": 0.5}
    row |= {f"{key}_mm": 0.1 for key in ("wall_and_base_max", "wall_and_base_mean", "base_signed", "rim_max")}
    with terminal.console.capture() as shown:
        terminal.console.print(springback_compare._table("cone", [row]))
    head = next(line for line in shown.get().splitlines() if "method" in line)
    for words in ("max [mm]", "mean [mm]", "base, signed [mm]", "rim, max [mm]", "correction, max [mm]"):
        assert words in head
    assert "slowest correction [ms]" in head


def test_a_prediction_and_a_push_report_their_units(tmp_path: Path) -> None:
    curve = tmp_path / "push.csv"
    curve.write_text("force_N,displacement_mm\n60,1.90\n240,3.91\n400,5.00\n")
    with terminal.console.capture() as shown:
        predict_part(JOB, [300.0], 1.0, "push", as_json=False)
        calibrate_clamp(JOB, curve, (0.0, 0.0), as_json=False)
    assert "contour 4, depth 1.1 mm" in shown.get()  # index 3 in --json
    for words in ("x [mm]", "y [mm]", "at 300 N [mm]", "rms difference [mm]"):
        assert words in shown.get()


def test_identified_values_have_units() -> None:
    settings = IdentifySettings.of(Property.TOOL_COMPLIANCE, 1, 1, [], 100.0)
    found = Finding(ErrorCode.OK, "", np.array([1e-6, 1e-6, 1e-7]), np.array([1e-8, 1e-8, np.nan]))
    with terminal.console.capture() as shown:
        identify._show(found, settings)
    assert "value [µm/N]" in shown.get()
    assert "standard deviation [µm/N]" in shown.get()


def test_residuals_of_a_load_cell_have_units(tmp_path: Path) -> None:
    load = np.vstack([np.zeros((2, 4)), 100.0 * np.eye(4), -100.0 * np.eye(4)])
    np.savetxt(
        tmp_path / "loads.csv",
        np.hstack([load, 2.0 * load]),
        delimiter=",",
        header="fx,fy,fz,tx,a,b,c,d",
        comments="",
    )
    with terminal.console.capture() as shown:
        calibrate_file(tmp_path / "loads.csv", None, None, as_json=False)
    first = shown.get().splitlines()[0]
    assert " N, fy " in first
    assert first.split("tx ")[1].split(";")[0].endswith(" N m")


def test_a_share_that_falls_short_does_not_read_as_the_wanted_one() -> None:
    """99.96 % of a comparison, 89.6 % of a part that is tried out."""
    lengths: dict[str, Any] = {"mean_mm": 0.1, "mean_abs_mm": 0.1, "rms_mm": 0.1, "p95_abs_mm": 0.1, "max_abs_mm": 0.1}
    lengths["table2"] = dict.fromkeys(
        ("mean_positive_mm", "mean_negative_mm", "max_mm", "min_mm", "mean_mm", "std_mm"), 0.1
    )
    shares = {"within_fraction": {"0.3": 0.9996}, "mask": {}, "beside_fraction": 0.0, "worst_mm": [0.0, 0.0, 0.0]}
    files = {
        "moved": None,
        "picture": "p",
        "table": "t",
        "first": {"kind": "k", "path": "f"},
        "second": {"kind": "k", "path": "f"},
    }
    with terminal.console.capture() as shown:
        compare._show({**lengths, **shares, **files})
    (line,) = (line for line in shown.get().splitlines() if "within 0.3 mm" in line)
    assert "99.9 %" in line
    trial: Any = SimpleNamespace(variant=0, largest=0.4e-3, mean=0.1e-3, within=0.896)
    assert tryout._cells(trial)[-1] == "89 %"
