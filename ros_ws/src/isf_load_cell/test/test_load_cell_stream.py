"""The cell's file, torques, three cells reading by reading, and when wrenches are given out: without ROS."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.spindle_cells import CHANNELS
from isf_load_cell.cell_file import load_cell_set_up
from isf_load_cell.reading import CellReading, CellSettings
from isf_load_cell.stream import CellStream
from isf_load_cell.three_cells import ThreeCellReading, ThreeCellSettings, readings_of
from scipy.spatial.transform import Rotation

MATRIX = "calibration_matrix: [[2, 0.1, 0], [0, -3, 0], [0, 0.2, 4]]\nrange: 1000\n"
NINE = "".join(f"  c{k}{axis}: 2456.7\n" for k in (1, 2, 3) for axis in "xyz")
THREE = f"calibration_gains:\n{NINE}three_cells: {{height: 280 mm}}\nrange: 9.5\n"


def written(folder: Path, text: str) -> str:
    path = folder / "cell.yaml"
    path.write_text(text)
    return str(path)


# -- the file ------------------------------------------------------------------------------------


def test_a_matrix_for_forces_passes_torques_on(tmp_path: Path) -> None:
    found = load_cell_set_up(written(tmp_path, MATRIX + "rotation: [0 deg, 0 deg, 90 deg]\n"), "", 1)
    assert found.channels is None
    found.reading.tare(np.zeros((3, 6)))
    wrench = found.reading.wrench(np.array([10.0, 20.0, 30.0, 1.0, 2.0, 3.0]))
    # Load in axes of the cell (22, -60, 124), turned by 90 degrees about z: (60, 22, 124); torques (1, 2, 3) likewise.
    assert wrench == pytest.approx([60.0, 22.0, 124.0, -2.0, 1.0, 3.0])


def test_gains_go_with_the_channels_of_their_names(tmp_path: Path) -> None:
    """The columns of a calibration stand in any order; ``channels`` says which one reads x, y and z."""
    text = "calibration_gains: {Z: 30, X: 10, Y: 20}\nchannels: [X, Y, Z]\nrange: 100\n"
    found = load_cell_set_up(written(tmp_path, text), "", 1)
    assert found.channels == ("X", "Y", "Z")
    found.reading.tare(np.zeros((3, 3)))
    assert found.reading.wrench(np.array([1.0, 2.0, 3.0])) == pytest.approx([10.0, 40.0, 90.0, 0.0, 0.0, 0.0])


def test_the_piece_for_a_rig_is_inverted_and_the_rig_reports_the_rest(tmp_path: Path) -> None:
    response = np.eye(6)
    response[0, 1], response[2, 2] = 0.02, 1.1
    text = "load_cell:\n  matrix:\n" + "".join(f"    - {row.tolist()}\n" for row in response)
    with pytest.raises(IsfError, match="no range"):
        load_cell_set_up(written(tmp_path, text), "", 1)
    reading = load_cell_set_up(written(tmp_path, text), "ren2018", 1).reading
    reading.tare(np.zeros((3, 6)))
    load = np.array([100.0, -50.0, 300.0, 1.0, 2.0, 3.0])
    assert reading.wrench(response @ load) == pytest.approx(load)
    with pytest.raises(IsfError) as caught:  # 2000 N by the rig file
        reading.wrench(np.array([0.0, 0.0, 1999.0, 0.0, 0.0, 0.0]))
    assert caught.value.code is ErrorCode.WRENCH_OUT_OF_RANGE


def test_the_rig_alone_is_enough_and_reports_the_weight(tmp_path: Path) -> None:
    found = load_cell_set_up("", "torrao2013", 1)
    assert isinstance(found.reading, ThreeCellReading)
    assert found.channels == CHANNELS
    upper = found.reading.settings
    assert upper.mass * 9.80665 == pytest.approx(300.0)
    # Table 3.7, rows are cells 683, 605, 711, columns X, Y, Z
    table = [[2391.4, 2376.6, 2302.6], [2456.7, 2441.7, 2298.4], [2497.9, 2401.9, 2218.2]]
    assert upper.gains == pytest.approx(np.array(table), abs=1e-6)
    assert (upper.height, upper.radius, upper.range[0, 0]) == (0.28, 0.11, 10.0)
    lower = load_cell_set_up("", "torrao2013", 2).reading
    assert isinstance(lower, CellReading)
    assert lower.settings.matrix == pytest.approx(np.eye(6))
    assert lower.settings.mass == 0.0


@pytest.mark.parametrize(
    ("text", "code", "what"),
    [
        ("range: 5\n", ErrorCode.FILE_FIELD, "no calibration"),
        (MATRIX + "weight: 20\n", ErrorCode.FILE_UNIT, "no unit"),
        (MATRIX + "cutoff: 300 Hz\n", ErrorCode.FILE_FIELD, "half the rate"),
        (MATRIX + "drift_limit: -1 N\n", ErrorCode.FILE_FIELD, "drift_limit"),
        (MATRIX + "frozen_after: 1\n", ErrorCode.FILE_FIELD, "frozen_after"),
        (MATRIX + "channels: [a, b]\n", ErrorCode.FILE_FIELD, "3 readings"),
        (MATRIX.replace("1000", "[1, 2]"), ErrorCode.FILE_FIELD, "range"),
        (MATRIX.replace("1000", "0"), ErrorCode.FILE_FIELD, "range"),
        (MATRIX.replace("4]]", ".nan]]"), ErrorCode.FILE_FIELD, "finite"),
        (MATRIX.replace("[0, 0.2, 4]", "[2, 0.1, 0]"), ErrorCode.FILE_FIELD, "some direction"),
        (MATRIX.replace("4]]", "4, 1]]"), ErrorCode.FILE_FIELD, "same length"),
        ("calibration_gains: {a: 1, b: 0, c: 1}\nrange: 5\n", ErrorCode.FILE_FIELD, "not zero"),
        (MATRIX + "calibration_gains: {a: 1, b: 1, c: 1}\n", ErrorCode.FILE_FIELD, "more than one"),
        ("calibration_gains: {a: 1, b: 1, c: 1, d: 1}\nrange: 5\n", ErrorCode.FILE_FIELD, "as a wrench"),
        ("calibration_gains: {a: 1, b: 1, c: 1}\nchannels: [a, b, u]\nrange: 5\n", ErrorCode.FILE_FIELD, "a, b, u"),
        (THREE.replace("  c1x: 2456.7\n", ""), ErrorCode.FILE_FIELD, "nine"),
        (THREE.replace("280 mm", "0 mm"), ErrorCode.FILE_FIELD, "height"),
        (THREE.replace("280 mm", "280 m"), ErrorCode.FILE_FIELD, "height"),
    ],
)
def test_a_file_that_cannot_be_used_is_refused(tmp_path: Path, text: str, code: ErrorCode, what: str) -> None:
    with pytest.raises(IsfError, match=what) as caught:
        load_cell_set_up(written(tmp_path, text), "", 1)
    assert caught.value.code is code


def test_a_file_without_calibration_goes_with_the_spindle_cells_of_the_rig(tmp_path: Path) -> None:
    text = "frozen_after: 200\ndrift_limit: 4 N\ncutoff: 50 Hz\n"
    found = load_cell_set_up(written(tmp_path, text), "torrao2013", 1)
    assert isinstance(found.reading, ThreeCellReading)
    s, of_rig = found.reading.settings, load_cell_set_up("", "torrao2013", 1)
    assert (s.frozen_after, s.drift_limit, s.cutoff, s.inconsistency_limit) == (200, 4.0, pytest.approx(50.0), 5.0)
    assert np.array_equal(s.gains, of_rig.reading.settings.gains)  # type: ignore[attr-defined]
    assert (found.channels, s.mass * 9.80665) == (CHANNELS, pytest.approx(300.0))
    turned = load_cell_set_up(written(tmp_path, "rotation: [0 deg, 0 deg, 90 deg]\nrange: 5\n"), "torrao2013", 1)
    assert turned.rotation[1, 0] == pytest.approx(1.0)
    assert turned.reading.settings.range == pytest.approx(5.0)  # type: ignore[attr-defined]
    with pytest.raises(IsfError, match="nine channels"):
        load_cell_set_up(written(tmp_path, "channels: [a, b]\n"), "torrao2013", 1)


def test_something_has_to_be_named(tmp_path: Path) -> None:
    with pytest.raises(IsfError, match="no load cell is named"):
        load_cell_set_up("", "", 1)
    with pytest.raises(IsfError) as caught:
        load_cell_set_up(str(tmp_path / "none.yaml"), "", 1)
    assert caught.value.code is ErrorCode.FILE_NOT_FOUND


# -- torques and weight --------------------------------------------------------------------------


@given(angles=st.tuples(*[st.floats(-1.2, 1.2)] * 3))
@settings(max_examples=20, deadline=None)
def test_weight_is_gone_at_any_orientation(angles: tuple[float, float, float]) -> None:
    mass, centre, zero = 3.0, np.array([0.01, -0.02, -0.12]), np.arange(6.0)
    cell = CellReading(
        CellSettings(
            rate=500.0,
            matrix=np.eye(6),
            rotation=np.eye(3),
            range=np.full(6, 1e4),
            cutoff=0.0,
            mass=mass,
            centre=centre,
        )
    )
    load = np.array([5.0, -8.0, 90.0, 0.3, 0.1, -0.2])

    def read(turn: np.ndarray, load: np.ndarray) -> np.ndarray:
        pull = turn.T @ [0.0, 0.0, -mass * 9.80665]
        torque = np.cross(centre, pull)  # r x F, as a cell feels what hangs on it
        return zero + np.concatenate([turn.T @ load[:3] + pull, turn.T @ load[3:] + torque])

    upright, turned = np.eye(3), Rotation.from_euler("xyz", angles).as_matrix()
    cell.tare(np.tile(read(upright, np.zeros(6)), (5, 1)), upright)
    assert cell.wrench(read(turned, load), turned) == pytest.approx(load, abs=1e-9)


# -- three cells ---------------------------------------------------------------------------------

HEIGHT, GAIN = 0.28, 2456.7


def three(**changes: object) -> ThreeCellReading:
    values = {
        "gains": np.full((3, 3), GAIN),
        "range": np.full((3, 3), 9.5),
        "height": HEIGHT,
        "rotation": np.eye(3),
        "frozen_after": 5,
    }
    reading = ThreeCellReading(ThreeCellSettings(**{**values, **changes}))  # type: ignore[arg-type]
    reading.tare(np.zeros((5, 9)))
    return reading


def volts(force: list[float]) -> np.ndarray:
    return readings_of(np.array(force), HEIGHT).ravel() / GAIN


@pytest.mark.parametrize("channel", range(9))
@pytest.mark.parametrize("how", ["no number", "saturated", "frozen"])
def test_one_of_nine_channels_may_fail_in_any_way(channel: int, how: str) -> None:
    reading = three()
    found = np.zeros(6)
    for k in range(12):
        force = [100.0 + 30.0 * k, 50.0 - 30.0 * k, 900.0 + 30.0 * k]
        values = volts(force)
        values[channel] = {"no number": np.nan, "saturated": 9.45, "frozen": volts([100.0, 50.0, 900.0])[channel]}[how]
        found = reading.wrench(values)
    assert found[:3] == pytest.approx(force, abs=0.1)  # exact in the model
    warning = reading.warning()
    assert warning is not None
    codes = {"no number": 1201, "saturated": 1203, "frozen": 1210}
    assert warning.code == codes[how]
    assert f"channel {CHANNELS[channel]} " in warning.what
    assert [error.code for error in reading.take_news()] == [warning.code]
    # Well again, it stays out until the next tare; then it counts.
    reading.wrench(volts([1.0, 2.0, 3.0]))
    assert list(reading.lost) == [channel]
    assert reading.take_news() == []
    reading.tare(np.tile(volts([0.0, 0.0, 0.0]), (3, 1)))
    assert reading.warning() is None


def test_two_lost_axial_channels_are_a_fault_two_of_one_cell_are_none() -> None:
    reading = three()
    values = volts([100.0, 50.0, 900.0])
    values[[0, 2]] = np.nan
    assert reading.wrench(values)[:3] == pytest.approx([100.0, 50.0, 900.0], abs=0.1)
    values[5] = 9.5
    with pytest.raises(IsfError, match=r"x1 gives no reading; .*z1 gives no .*; .*z2 is at the end") as caught:
        reading.wrench(values)
    assert caught.value.code is ErrorCode.WRENCH_OUT_OF_RANGE


def test_a_channel_may_be_missing_when_it_is_tared() -> None:
    reading = three()
    zero = np.array([0.1] * 3 + [0.3, 0.3, np.nan] + [-0.2] * 3)
    reading.tare(np.tile(zero, (4, 1)))
    assert reading.wrench(volts([100.0, 50.0, 900.0]) + zero)[:3] == pytest.approx([100.0, 50.0, 900.0], abs=0.1)
    with pytest.raises(IsfError, match=r"z2 gives no reading; .*z3"):
        reading.tare(np.tile([0.0] * 5 + [np.nan] * 4, (4, 1)))
    saturated = zero.copy()
    saturated[8] = 9.45
    with pytest.raises(IsfError, match="z3 is at the end"):
        reading.tare(np.tile(saturated, (4, 1)))


# -- channels that contradict each other ---------------------------------------------------------

FORCES = [[80.0 * np.cos(a), 80.0 * np.sin(a), 300.0 + 20.0 * a] for a in np.linspace(0.0, 6.0, 120)]
"""N, once around a wall."""


def spoiled(reading: ThreeCellReading, spoil: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
    """Error (120, 3) N of readings with noise of one step of a converter, which ``spoil`` changes."""
    noise = np.random.default_rng(5)
    gains = reading.settings.gains.ravel()

    def of(force: list[float]) -> np.ndarray:
        return readings_of(np.array(force), HEIGHT).ravel() / gains + 3e-4 * noise.standard_normal(9)

    reading.tare(np.array([spoil(of([0.0, 0.0, 0.0])) for _ in range(250)]))
    return np.array([reading.wrench(spoil(of(force)))[:3] - force for force in FORCES])


def test_sound_channels_do_not_contradict_each_other() -> None:
    reading = three(inconsistency_limit=5.0)
    errors = spoiled(reading, lambda values: values)
    assert reading.warning() is None
    assert np.abs(errors).max() < 6.0  # noise of 0.7 N in a channel


@pytest.mark.parametrize("channel", range(9))
def test_a_channel_with_a_wrong_gain_is_found_and_left_out(channel: int) -> None:
    reading = three(inconsistency_limit=5.0)
    factors = np.ones(9)
    factors[channel] = 0.5 if channel in (2, 5, 8) else -1.0  # the share of the shear is small
    errors = spoiled(reading, lambda values: factors * values)
    warning = reading.warning()
    assert warning is not None
    assert (warning.code, list(reading.lost)) == (ErrorCode.WRENCH_INCONSISTENT, [channel])
    assert f"channel {CHANNELS[channel]} disagrees" in warning.what
    assert np.abs(errors[60:].mean(axis=0)).max() < 3.0  # 1 % of 300 N


@pytest.mark.parametrize(("pair", "ends"), [((2, 5), True), ((5, 8), True), ((0, 2), False), ((4, 8), False)])
def test_exchanged_cables_are_named(pair: tuple[int, int], ends: bool) -> None:
    reading = three(inconsistency_limit=5.0)
    order = np.arange(9)
    order[list(pair)] = pair[::-1]
    words = f"{CHANNELS[pair[0]]} and {CHANNELS[pair[1]]} are exchanged"
    if ends:  # two axial channels: the force is not known any more
        with pytest.raises(IsfError, match=words) as caught:
            spoiled(reading, lambda values: values[order])
        assert caught.value.code is ErrorCode.WRENCH_INCONSISTENT
        return
    errors = spoiled(reading, lambda values: values[order])
    warning = reading.warning()
    assert warning is not None
    assert words in warning.what
    assert np.abs(errors[60:].mean(axis=0)).max() < 3.0


def converted(reading: ThreeCellReading, forces: list[list[float]], bits: int, stuck: int | None = None) -> None:
    """Readings of ``forces`` after a tare, over a converter of ``bits`` and with noise of a fifth of its step."""
    noise, step = np.random.default_rng(3), 20.0 / 2**bits
    held = np.nan

    def of(force: list[float]) -> np.ndarray:
        nonlocal held
        values = volts(force) + 0.013 * np.arange(9) + 0.2 * step * noise.standard_normal(9)
        values = step * np.round(values / step)
        if stuck is not None:
            held = values[stuck] if np.isnan(held) else held
            values[stuck] = held
        return values

    reading.tare(np.array([of([0.0, 0.0, 0.0]) for _ in range(60)]))
    for force in forces:
        reading.wrench(of(force))


REST = [[0.0, 0.0, 0.0]] * 400


@pytest.mark.parametrize("bits", [12, 14])
def test_a_quiet_sound_channel_is_not_frozen(bits: int) -> None:
    reading = three(frozen_after=20, drift_limit=20.0)
    converted(reading, REST, bits)
    assert reading._same.max() >= 20  # one that moves under the noise of the others
    converted(reading, [force for force in FORCES for _ in range(25)], bits)
    assert (reading.warning(), reading.take_news()) == (None, [])


@pytest.mark.parametrize("stuck", range(9))
def test_a_channel_stuck_since_the_tare_is_found_when_its_load_moves(stuck: int) -> None:
    reading = three(frozen_after=20)
    converted(reading, REST, 14, stuck)
    assert reading.warning() is None  # nothing tells it from a quiet one
    converted(reading, [force for force in FORCES for _ in range(5)], 14, stuck)
    assert list(reading.lost) == [stuck]
    assert reading.lost[stuck].code is ErrorCode.WRENCH_FROZEN


def test_one_wrong_reading_of_a_channel_freezes_no_other() -> None:
    reading = three(frozen_after=5)
    for k in range(20):
        values = volts([0.0, 0.0, 900.0]) + np.where(np.arange(9) < 3, 0.0, 1e-4 * (k % 2))
        values[5] += 0.5 * (k == 12)
        reading.wrench(values)
    assert reading.warning() is None


def test_an_amplifier_that_stands_still_ends_the_stream_and_is_not_tared() -> None:
    reading = three(frozen_after=5)
    for _ in range(5):
        reading.wrench(volts([0.0, 0.0, 900.0]))
    with pytest.raises(IsfError, match="all load-cell channels") as caught:
        reading.wrench(volts([0.0, 0.0, 900.0]))
    assert caught.value.code is ErrorCode.WRENCH_FROZEN
    still = np.zeros((6, 9))
    with pytest.raises(IsfError, match="all load-cell channels"):
        reading.tare(still)
    still[0, 4] = 1e-4  # one that lives
    reading.tare(still)
    assert reading.lost == {}


OFF = np.array([1.0, -1.0, 0.0, 1.0, 1.0, 0.0, -1.0, 1.0, 0.0]) / GAIN
"""Errors of the shear channels that no single one explains, per N."""


def test_a_disagreement_that_nothing_explains_is_told_once_and_the_force_goes_on() -> None:
    reading = three(inconsistency_limit=5.0, inconsistency_ratio=0.0)

    def read(off: float) -> None:
        for k in range(80):
            reading.wrench(volts([0.0, 0.0, 300.0 + 0.01 * (k % 2)]) + off * OFF)

    read(4.0)
    assert 5.0 < reading.inconsistency < 15.0
    warning = reading.warning()
    assert warning is not None
    assert warning.code is ErrorCode.WRENCH_INCONSISTENT
    assert "no single one explains it" in warning.what
    assert reading.take_news() == [warning]
    read(0.0)
    assert reading.warning() is None
    read(4.0)
    assert reading.warning() is not None
    assert reading.take_news() == []
    reading.tare(np.zeros((3, 9)))
    assert reading.warning() is None
    with pytest.raises(IsfError, match="no single one explains it"):
        read(12.0)


def test_a_search_that_found_nothing_is_not_done_again_at_every_reading(monkeypatch: pytest.MonkeyPatch) -> None:
    reading = three(inconsistency_limit=5.0, inconsistency_ratio=0.0)
    search, searches = reading._redundancy.suspects, []

    def counted(*args: object) -> object:
        searches.append(args)
        return search(*args)  # type: ignore[arg-type]

    monkeypatch.setattr(reading._redundancy, "suspects", counted)
    for k in range(300):
        reading.wrench(volts([0.0, 0.0, 300.0 + 0.01 * k]) + 4.0 * OFF)
    assert 10 <= len(searches) <= 24  # every 25th, and while it grows


def test_quick_unloading_loses_no_sound_channel() -> None:
    # Gains that bear a disagreement of nearly the limit: smoothed readings hold the old load, so the limit must too.
    reading = three(inconsistency_limit=2.0, inconsistency_ratio=0.01)
    factors, seen = np.ones(9), 0.0
    factors[[2, 5]] = 1.04, 0.99
    for k in range(200):
        reading.wrench(factors * volts([0.1 * (k % 2), 0.1 * (k % 2), 3000.0 if k < 150 else 0.0]))
        seen = max(seen, reading.inconsistency)
    assert seen > 5.0  # more than the limit at rest
    assert (reading.warning(), reading.take_news()) == (None, [])


@pytest.mark.parametrize(("height", "needed"), [(0.28, ()), (0.6, ("z1", "z2", "z3"))])
def test_channels_that_cannot_be_spared_are_named(height: float, needed: tuple[str, ...]) -> None:
    assert three(height=height).indispensable() == needed


def test_two_channels_that_are_off_end_the_stream() -> None:
    reading = three(inconsistency_limit=5.0)
    factors = np.ones(9)
    factors[[2, 5]] = 0.3, 1.9
    with pytest.raises(IsfError) as caught:
        spoiled(reading, lambda values: factors * values)
    assert caught.value.code is ErrorCode.WRENCH_INCONSISTENT


def test_three_cells_drift_and_weight() -> None:
    reading = three(mass=300.0 / 9.80665, mass_height=0.15)
    weight = np.array([0.0, 0.0, -300.0])

    def free(turn: np.ndarray) -> np.ndarray:
        return readings_of(turn.T @ weight, 0.15).ravel() / GAIN

    reading.tare(np.tile(free(np.eye(3)), (4, 1)), np.eye(3))
    tilted = Rotation.from_euler("xyz", [0.2, -0.3, 0.0]).as_matrix()
    assert reading.wrench(free(tilted), tilted) == pytest.approx(0.0, abs=1e-6)
    assert reading.watch_drift(np.tile(free(tilted), (4, 1)), tilted) == pytest.approx(0.0, abs=1e-6)
    with pytest.raises(IsfError, match="drifted by 12"):
        reading.watch_drift([free(np.eye(3)) + volts([0.0, 0.0, 12.0])], np.eye(3))


# -- the stream ----------------------------------------------------------------------------------


def stream(readings: int = 3, longest_gap: float = 1.0, **changes: object) -> CellStream:
    values = {"rate": 500.0, "matrix": np.eye(6), "rotation": np.eye(3), "range": np.full(6, 2e3), "cutoff": 0.0}
    return CellStream(CellReading(CellSettings(**{**values, **changes})), readings, longest_gap)  # type: ignore[arg-type]


def reading(value: float) -> np.ndarray:
    return np.array([0.0, 0.0, value, 0.0, 0.0, 0.0])


def test_nothing_is_given_out_before_the_tare() -> None:
    cell = stream()
    assert [cell.add(k, reading(7.0)) for k in (1, 2)] == [None, None]
    with pytest.raises(IsfError, match="2 readings so far, 3 are needed"):
        cell.tare()
    cell.add(3, reading(7.0))
    assert cell.tare() == 3
    wrench = cell.add(4, reading(107.0))
    assert wrench is not None
    assert wrench[2] == pytest.approx(100.0)


def test_a_saturated_cell_is_not_tared() -> None:
    """At 99.5 % of its range it is free of noise and steady, and its zero would be that of nothing."""
    cell = stream()
    for k in range(1, 4):
        cell.add(k, reading(1990.0 + 0.1 * k))
    with pytest.raises(IsfError, match="channel 3 of the load cell is at the end of its range") as caught:
        cell.tare()
    assert caught.value.code is ErrorCode.WRENCH_OUT_OF_RANGE
    assert cell.fault is not None
    assert cell.fault.code is ErrorCode.NO_TARE


def test_readings_from_before_a_silence_are_no_part_of_a_zero_or_a_drift() -> None:
    """A driver that was started anew has another zero, 8 N higher; 0.5 s of silence by the stamps."""
    cell = stream(3, longest_gap=0.5)
    for k in range(3):
        cell.add(10**9 + 2_000_000 * k, reading(0.1 * k))
    cell.tare()
    later = 10**9 + 4_000_000 + 500_000_001
    wrench = cell.add(later, reading(8.0))
    assert wrench is not None  # by the zero that it had
    assert wrench[2] == pytest.approx(7.9)
    for ask in (cell.tare, cell.check_drift):
        with pytest.raises(IsfError, match="1 readings so far, 3 are needed"):
            ask()
    for k in (1, 2):
        cell.add(later + 500_000_000 * k, reading(8.0))
    assert cell.tare() == 3
    wrench = cell.add(later + 1_000_000_001, reading(8.0))
    assert wrench is not None
    assert wrench[2] == 0.0
    cell.add(5, reading(8.0))  # stamps that begin anew
    with pytest.raises(IsfError, match="1 readings so far"):
        cell.tare()


@pytest.mark.parametrize(("bad", "code"), [(np.nan, 1201), (1990.0, 1203)])
def test_a_fault_lasts_until_the_next_tare(bad: float, code: int) -> None:
    cell = stream()
    for k in range(1, 4):
        cell.add(k, reading(0.0))
    cell.tare()
    assert cell.add(4, reading(bad)) is None
    assert cell.add(5, reading(1.0)) is None
    assert cell.fault is not None
    assert (cell.fault.code, cell.faults) == (code, 1)
    with pytest.raises(IsfError) as caught:  # the bad reading is among the last ones
        cell.tare()
    assert caught.value.code == code
    for k in range(6, 8):
        cell.add(k, reading(1.0))
    cell.tare()
    assert cell.add(8, reading(2.0)) is not None


def test_a_repeated_stamp_is_a_sign_of_life_and_no_reading() -> None:
    cell = stream(readings=1, frozen_after=5)
    cell.add(10, reading(7.0))
    cell.tare()
    first = cell.add(10, reading(7.0))  # time stands still in lockstep: the tare has to be answered all the same
    assert first is not None
    for _ in range(20):  # more than a frozen signal would be allowed
        again = cell.add(10, reading(7.0))
        assert again is not None
        assert again == pytest.approx(first)
    assert all(cell.add(k, reading(8.0)) is not None for k in range(11, 16))
    assert cell.add(16, reading(8.0)) is None
    assert cell.fault is not None
    assert cell.fault.code is ErrorCode.WRENCH_FROZEN


def test_stamps_left_at_zero_are_readings() -> None:
    cell = stream(readings=2)
    cell.add(0, reading(0.0))
    cell.add(0, reading(0.0))
    cell.tare()
    found = [cell.add(0, reading(value)) for value in (1.0, 2.0)]
    assert [wrench[2] for wrench in found if wrench is not None] == [1.0, 2.0]


def test_a_frozen_signal_is_not_tared() -> None:
    cell = stream(readings=60)
    for k in range(1, 61):
        cell.add(k, reading(3.0))
    with pytest.raises(IsfError) as caught:
        cell.tare()
    assert caught.value.code is ErrorCode.WRENCH_FROZEN


def test_drift_is_reported_until_the_next_tare() -> None:
    cell = stream(readings=2)
    for k in (1, 2):
        cell.add(k, reading(0.0))
    cell.tare()
    for k in (3, 4):
        cell.add(k, reading(4.0))
    assert cell.check_drift() == pytest.approx(4.0)
    for k in (5, 6):
        cell.add(k, reading(25.0))
    with pytest.raises(IsfError, match="drifted by 25"):
        cell.check_drift()
    warning = cell.warning()
    assert warning is not None
    assert warning.code is ErrorCode.NO_TARE
    assert cell.fault is None  # the part goes on
    cell.tare()
    assert cell.warning() is None
