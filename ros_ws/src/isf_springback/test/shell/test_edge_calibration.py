"""Edge condition from a push curve: plain conditions are recognised, springs recovered, bad files told."""

import numpy as np
import pytest
from isf_core.errors import ErrorCode, IsfError
from isf_springback.shell.edge_calibration import CONDITIONS, PushCurve, calibrate_edge, read_push_curve
from isf_springback.shell.load_path import follow_load
from isf_springback.shell.sheet_model import EdgeCondition
from shell_sheets import DOWN, flat_model, flat_sheet, square

FORCES = np.array([60.0, 150.0, 400.0])


def push(edge, scale=1.0):
    model = flat_model(flat_sheet(square(0.25)), 1e-3, edge)
    moved = follow_load(model, 0, DOWN, FORCES, model.factor())
    return PushCurve(FORCES, -scale * moved[:, 2])


def calibrated(curve):
    return calibrate_edge(curve, (0.25, 0.25), 1e-3, 70e9, 0.33)


def test_published_push_selects_the_published_condition():
    """Ren 2018, 4.3.2: about 5.0 mm at 400 N; the shape of the curve from von Karman finite differences."""
    curve = PushCurve(
        np.array([60.0, 120, 240, 300, 400]), 1e-3 * np.array([2.00, 2.92, 4.12, 4.59, 5.27]) * 5.0 / 5.27
    )
    found = calibrated(curve)
    assert min(found.plain, key=found.plain.get) == "clamped, free in plane"
    assert found.edge.slope == "clamped"
    assert found.deviation < 0.1e-3


def test_plain_conditions_are_recognised():
    name = "clamped, immovable"
    found = calibrated(push(CONDITIONS[name]))
    assert min(found.plain, key=found.plain.get) == name
    assert found.edge.slope == CONDITIONS[name].slope
    assert found.deviation < 0.05e-3


def test_spring_is_recovered_by_its_effect():
    truth = EdgeCondition("clamped", 1.5e8)
    found = calibrated(push(truth))
    assert found.edge.in_plane == pytest.approx(1.5e8, rel=0.25)
    assert found.deviation < 0.02e-3
    assert found.fitted == pytest.approx(found.measured, rel=0.02)


def test_file_with_units(tmp_path):
    path = tmp_path / "push.csv"
    path.write_text("# flat sheet, centre\nforce_kN,displacement_um,note\n0,0,\n0.4,5000,a\n0.1,2600,b\n0.2,3500,c\n")
    curve = read_push_curve(path)
    assert curve.force == pytest.approx([100, 200, 400])
    assert curve.displacement == pytest.approx([2.6e-3, 3.5e-3, 5e-3])


@pytest.mark.parametrize(
    ("text", "code"),
    [
        ("force,displacement_mm\n1,2\n", ErrorCode.FILE_UNIT),
        ("force_N,displacement_in\n1,2\n", ErrorCode.FILE_UNIT),
        ("", ErrorCode.FILE_UNIT),
        ("force_N,displacement_mm\n100,x\n", ErrorCode.PUSH_CURVE_UNUSABLE),
        ("force_N,displacement_mm\n", ErrorCode.PUSH_CURVE_UNUSABLE),
        ("force_N,displacement_mm\n100,2\n200,nan\n300,4\n", ErrorCode.PUSH_CURVE_UNUSABLE),
        ("force_N,displacement_mm\n100,2\n100,3\n300,4\n", ErrorCode.PUSH_CURVE_UNUSABLE),
        ("force_N,displacement_mm\n100,4\n200,3\n300,2\n", ErrorCode.PUSH_CURVE_UNUSABLE),
    ],
)
def test_bad_files_have_a_code(tmp_path, text, code):
    path = tmp_path / "push.csv"
    path.write_text(text)
    with pytest.raises(IsfError) as failure:
        read_push_curve(path)
    assert failure.value.code == code
    assert str(path) in failure.value.message


def test_missing_file_has_a_code(tmp_path):
    with pytest.raises(IsfError) as failure:
        read_push_curve(tmp_path / "none.csv")
    assert failure.value.code == ErrorCode.FILE_NOT_FOUND
