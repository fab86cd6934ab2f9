"""Backlash, error tables, error map, servo options: what the encoders do not see, and what the axes cannot do."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.rig import Rig, load_rig
from isf_sim.machine.axes import follow_targets, make_axis_errors, make_servo, read_error_map, true_tips

REN = load_rig("ren2018")


def rig(**tool_1: object) -> Rig:
    return REN.model_copy(update={"tool_1": REN.tool_1.model_copy(update=tool_1)})


def tip_of(encoder: list[float], spec: Rig, play: np.ndarray | None = None) -> np.ndarray:
    tips = np.empty((2, 3))
    state = np.array([*encoder, 0.0, 0.0, 0.0])
    true_tips(state, state.copy() if play is None else play, make_axis_errors(spec), tips)
    return tips[0]


def test_a_rig_without_errors_has_none() -> None:
    assert not make_axis_errors(REN).present


def test_error_table_of_the_published_machine() -> None:
    """Ren 2018, 2.2: X of the forming tool is off by 350 um over +-100 mm before correction; linear between rows."""
    table = ((-0.1, -175e-6), (0.0, 0.0), (0.1, 175e-6))
    spec = rig(error_x=table)
    assert make_axis_errors(spec).present
    assert tip_of([0.05, 0.02, -0.01], spec) == pytest.approx([0.05 + 87.5e-6, 0.02, -0.01])
    assert tip_of([0.12, 0.0, 0.0], spec)[0] == pytest.approx(0.12 + 175e-6)
    assert tip_of([-0.12, 0.0, 0.0], spec)[0] == pytest.approx(-0.12 - 175e-6)


def test_volumetric_map_reproduces_the_published_extremes() -> None:
    """Praveen 2020, 2.4: relative error +0.10 to -0.27 mm over an opening of 610 mm; fit within 0.03 mm."""
    spec = load_rig("praveen2020")
    turn = np.radians(np.arange(0, 360, 5))
    errors = [1e3 * tip_of([0.305 * np.cos(a), 0.305 * np.sin(a), 0.0], spec)[2] for a in turn]
    assert max(errors) == pytest.approx(0.10, abs=0.03)
    assert min(errors) == pytest.approx(-0.27, abs=0.03)


def test_map_is_trilinear_and_constant_beyond_its_edge(tmp_path: Path) -> None:
    rows = ["x,y,z,ex,ey,ez"]
    for x in (0.0, 10.0):
        for y in (0.0, 20.0):
            for z in (-5.0, 5.0):
                rows.append(f"{x},{y},{z},{x * y * (z + 5.0)},0,{z}")
    path = tmp_path / "map.csv"
    path.write_text("\n".join(rows))
    spec = rig(error_map=str(path))
    assert tip_of([5e-3, 5e-3, 0.0], spec)[0] - 5e-3 == pytest.approx(5 * 5 * 5 * 1e-6)
    assert tip_of([5e-3, 5e-3, 2e-3], spec)[2] - 2e-3 == pytest.approx(2e-6)
    assert tip_of([0.05, 0.05, 0.05], spec)[0] - 0.05 == pytest.approx(10 * 20 * 10 * 1e-6)


@pytest.mark.parametrize(
    ("text", "code"),
    [
        ("x,y\n1,2\n", ErrorCode.FILE_SYNTAX),
        ("x,y,z,ex,ey,ez\n1,2,3,a,5,6\n", ErrorCode.FILE_SYNTAX),
        ("x,y,z,ex,ey,ez\n1,2,3,nan,5,6\n", ErrorCode.FILE_SYNTAX),
        ("x,y,z,ex,ey,ez\n0,0,0,0,0,0\n1,1,0,0,0,0\n", ErrorCode.FILE_FIELD),
        ("x,y,z,ex,ey,ez\n0,0,0,0,0,0\n1,0,0,0,0,0\n3,0,0,0,0,0\n", ErrorCode.FILE_FIELD),
        ("x,y,z,ex,ey,ez\n0,0,0,0,0,0\n1,0,0,1,0,0\n1,0,0,2,0,0\n1,1,0,3,0,0\n", ErrorCode.FILE_FIELD),
    ],
)
def test_maps_that_are_none_are_refused(text: str, code: ErrorCode, tmp_path: Path) -> None:
    path = tmp_path / "map.csv"
    path.write_text(text)
    with pytest.raises(IsfError) as error:
        read_error_map(path)
    assert error.value.code == code
    with pytest.raises(IsfError) as missing:
        read_error_map(tmp_path / "none.csv")
    assert missing.value.code == ErrorCode.FILE_NOT_FOUND


def test_backlash_swallows_a_reversal_and_the_encoder_does_not_see_it() -> None:
    spec = rig(backlash=(40e-6, 0.0, 0.0))
    play = np.zeros(6)
    out = [tip_of([x * 1e-6, 0.0, 0.0], spec, play)[0] * 1e6 for x in (0, 100, 90, 70, 50, 0)]
    assert out == pytest.approx([0.0, 80.0, 80.0, 80.0, 70.0, 20.0])


def lag_on_a_ramp(feedforward: float) -> float:
    """m, following error after 0.6 s at 30 mm/s."""
    servo = make_servo(30.0, 2200.0, 440.0, 0.75, 1.6, feedforward=feedforward)
    axes, target = np.zeros((1, 3)), np.zeros(1)
    for _ in range(264):
        before = target.copy()
        target = target + 30e-3 / 440.0
        follow_targets(axes, before, target, servo)
    return float(target[0] - axes[0, 0])


def test_velocity_feedforward_takes_the_following_error_away() -> None:
    """Without it the lag is v (1/p + 2 zeta/wn), 0.27 mm at 30 mm/s; with all of it the error is below 1 um."""
    assert lag_on_a_ramp(0.0) > 0.2e-3
    assert lag_on_a_ramp(0.5) == pytest.approx(0.5 * lag_on_a_ramp(0.0), rel=0.01)
    assert abs(lag_on_a_ramp(1.0)) < 1e-6


def test_a_step_saturates_and_a_ramp_does_not() -> None:
    """Ren 2018, 2.3.4: the output saturates where a step begins; the loop still settles on the target."""
    servo = make_servo(30.0, 2200.0, 440.0, 0.75, 1.6, limit=0.5e-3)
    axes, start, end = np.zeros((1, 3)), np.zeros(1), np.array([2e-3])
    assert follow_targets(axes, start, end, servo) == 1
    for _ in range(300):
        last = follow_targets(axes, end, end, servo)
    assert last == 0
    assert axes[0, 0] == pytest.approx(2e-3, abs=1e-7)
    bits = 0
    target = end
    for _ in range(200):
        before, target = target, target + 20e-3 / 440.0
        bits |= follow_targets(axes, before, target, servo)
    assert bits == 0


def test_an_unlimited_loop_and_a_wide_limit_agree() -> None:
    """Same loop, closed in discrete time at 2.2 kHz instead of exactly: within 4 % of the step."""
    free, wide = (make_servo(30.0, 2200.0, 440.0, 0.75, 1.6, limit=limit) for limit in (None, 1.0))
    a, b = np.zeros((1, 3)), np.zeros((1, 3))
    start, end = np.zeros(1), np.array([1e-3])
    for _ in range(40):
        follow_targets(a, start, end, free)
        follow_targets(b, start, end, wide)
        start = end
        assert abs(a[0, 0] - b[0, 0]) < 0.04e-3


def test_a_map_on_a_grid_rounded_to_um_is_read(tmp_path: Path) -> None:
    """700 mm in six steps: 116.667 mm, 116.667 mm and 116.666 mm."""
    path = tmp_path / "map.csv"
    places = (-350.0, -233.333, -116.667, 0.0, 116.667, 233.333, 350.0)
    path.write_text("\n".join(["x,y,z,ex,ey,ez", *(f"{x},0,0,{x / 10},0,0" for x in places)]))
    read = read_error_map(path)
    assert read.step[0] == pytest.approx(0.7 / 6.0, rel=1e-12)
    assert read.error[-1, 0, 0, 0] == pytest.approx(35e-6)
    path.write_text("\n".join(["x,y,z,ex,ey,ez", *(f"{x},0,0,0,0,0" for x in (0.0, 10.0, 20.002, 30.0))]))
    with pytest.raises(IsfError, match="complete regular grid"):
        read_error_map(path)
