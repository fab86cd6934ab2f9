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
        ("force_N,displacement_mm\n-100,-2\n-200,-3\n-300,-4\n", ErrorCode.PUSH_CURVE_UNUSABLE),
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


def push_file(path, force, displacement):
    rows = "".join(f"{f:g},{1e3 * d:.4f}\n" for f, d in zip(force, displacement, strict=True))
    path.write_text("force_N,displacement_mm\n" + rows)
    return path


LOADS = np.linspace(2.0, 400.0, 200)
PUSHED = 5e-3 * (LOADS / 400.0) ** 0.6
"""m, about that of the published sheet."""


def test_forces_told_in_whole_newtons_are_merged(tmp_path):
    """Five readings of the dial for each newton of the load cell: their mean, wherever the rows stand."""
    force = np.repeat([100.0, 200.0, 400.0], 5)
    moved = np.repeat([2.6e-3, 3.5e-3, 5e-3], 5) + np.tile([-2e-5, -1e-5, 0.0, 1e-5, 2e-5], 3)
    curve = read_push_curve(push_file(tmp_path / "push.csv", force, moved))
    assert curve.force == pytest.approx([100, 200, 400])
    assert curve.displacement == pytest.approx([2.6e-3, 3.5e-3, 5e-3])
    coarse = read_push_curve(push_file(tmp_path / "coarse.csv", np.round(LOADS / 5.0) * 5.0, PUSHED))
    assert (np.diff(coarse.force) > 0).all()
    assert coarse.displacement == pytest.approx(5e-3 * (coarse.force / 400.0) ** 0.6, abs=0.1e-3)


def test_an_unloading_branch_is_told(tmp_path):
    """With a noisy load cell too; one that comes back on the way there does no harm."""
    noise = np.random.default_rng(1).normal(0.0, 1.0, (2, len(LOADS)))
    back = PUSHED + 0.5e-3 * (1.0 - LOADS / 400.0)
    force = np.concatenate([LOADS + noise[0], (LOADS + noise[1])[::-1]])
    with pytest.raises(IsfError, match=r"unloading branch.*after the largest force") as failure:
        read_push_curve(push_file(tmp_path / "push.csv", force, np.concatenate([PUSHED, back[::-1]])))
    assert failure.value.code == ErrorCode.PUSH_CURVE_UNUSABLE
    curve = read_push_curve(push_file(tmp_path / "same.csv", force, np.concatenate([PUSHED, PUSHED[::-1]])))
    assert curve.force.max() == pytest.approx(400.0, abs=4.0)


@pytest.mark.parametrize(
    ("factor", "zero"),
    [(1e3, (0.0, 0.0)), (1.0, (50.0, 1e-3))],
    ids=["in um, told as mm", "neither load cell nor dial at zero"],
)
def test_a_push_that_no_edge_explains_is_refused(factor, zero):
    """Bending and tension of the published sheet, 5 mm at 400 N (Ren 2018, 4.3.2): 20 N/mm and 2.4 N/mm3."""
    moved = np.linspace(0.0, 5.0, 14)
    curve = PushCurve(20.0 * moved + 2.4 * moved**3 + zero[0], factor * 1e-3 * moved + zero[1])
    with pytest.raises(IsfError, match="no edge condition explains") as failure:
        calibrated(curve)
    assert failure.value.code == ErrorCode.PUSH_CURVE_UNUSABLE
    for word in ("units", "zero"):
        assert word in failure.value.advice


def test_between_the_edge_is_doubted():
    """A dial that stood at 0.35 mm of 5.0 mm."""
    found = calibrated(PushCurve(FORCES, np.array([2.0e-3, 3.14e-3, 5.0e-3]) + 0.35e-3))
    assert 0.03 < found.misfit < 0.07
    assert "doubtful" in found.remarks[0]
    assert calibrated(push(CONDITIONS["clamped, free in plane"])).remarks == ()
