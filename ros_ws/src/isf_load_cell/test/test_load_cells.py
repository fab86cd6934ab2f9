"""Load cells: calibration against published data, three-cell arrangement, readings and their faults."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from isf_core.errors import ErrorCode, IsfError
from isf_load_cell.calibration import fit_channel, fit_matrix
from isf_load_cell.reading import CellReading, CellSettings
from isf_load_cell.three_cells import decomposition, force_of, readings_of

# Torrao 2013, appendix A: means of three repeats in V, positive and negative load in N.
LOADS = np.array([0, 20, 50, 100, 200, 500, 1000, 2000, 5000, 10000, 15000, 20000], dtype=float)
POSITIVE_605_X = [0.0002, 0.0189, 0.0279, 0.0472, 0.0888, 0.2140, 0.4160, 0.8283, 2.0533, 4.1067, 6.1700, 8.2200]
NEGATIVE_605_X = [
    0.0001,
    -0.0127,
    -0.0258,
    -0.1404,
    -0.0839,
    -0.1999,
    -0.4037,
    -0.7973,
    -2.0167,
    -3.9867,
    -6.0733,
    -8.0567,
]
POSITIVE_683_X = [0.0002, 0.0111, 0.0221, 0.0433, 0.0845, 0.2143, 0.4327, 0.8607, 2.1333, 4.2967, 6.4167, 8.0767]
NEGATIVE_683_X = [
    0.0002,
    -0.0112,
    -0.0071,
    -0.0427,
    -0.0845,
    -0.2150,
    -0.4240,
    -0.8600,
    -2.1433,
    -4.3133,
    -6.4533,
    -8.2300,
]
POSITIVE_711_Z = [0.0004, 0.0140, 0.0256, 0.0498, 0.0966, 0.2403, 0.4750, 0.9463, 2.3567, 4.6867, 7.0033, 9.2033]
NEGATIVE_711_Z = [0.0002, -0.0174, -0.2016, -0.3124, -0.3514, -0.2200, -0.4480, -0.8943, -2.1767, -4.3133]
NEGATIVE_711_Z += [-6.5567, -8.7467]


@pytest.mark.parametrize(
    ("positive", "negative", "gain", "offset"),
    [
        (POSITIVE_605_X, NEGATIVE_605_X, 2456.7, -40.383),
        (POSITIVE_683_X, NEGATIVE_683_X, 2391.4, 19.135),
        (POSITIVE_711_Z, NEGATIVE_711_Z, 2218.2, -79.469),
    ],
)
def test_printed_fits(positive, negative, gain, offset):
    load, volts = np.concatenate([LOADS, -LOADS]), np.array([*positive, *negative])
    fit = fit_channel(load, volts, robust=False)
    assert fit.gain == pytest.approx(gain, abs=0.05)
    assert fit.offset == pytest.approx(offset, abs=0.1)


def test_slips_are_found_and_reported():
    load, volts = np.concatenate([LOADS, -LOADS]), np.array([*POSITIVE_711_Z, *NEGATIVE_711_Z])
    fit = fit_channel(load, volts, largest=5000.0)
    # The readings at -50, -100 and -200 N are ten times too large (single trials in the source).
    rejected = set(load[fit.rejected & (np.abs(load) <= 5000.0)])
    assert {-50.0, -100.0, -200.0} <= rejected
    assert fit.gain == pytest.approx(2197.3, rel=0.01)


MATRIX = np.array([[110.0, 108.0, 2.0], [-91.0, 115.0, -1.0], [1.0, 3.0, -191.0]]) / 96.0
"""N per count, close to the published upper cell (Ren 2018, appendix B); the couplings with z are ours."""


def known_loads(noise, seed=0):
    random = np.random.default_rng(seed)
    load = np.vstack([np.zeros((3, 3)), *(sign * size * np.eye(3) for sign in (1, -1) for size in (50, 100, 300, 500))])
    reading = load @ np.linalg.inv(MATRIX).T + [12.0, -7.0, 30.0]
    return load, reading + noise * random.standard_normal(reading.shape)


def test_matrix_is_recovered_with_its_uncertainty():
    fit = fit_matrix(*known_loads(0.0))
    assert fit.matrix == pytest.approx(MATRIX, abs=1e-9)
    assert fit.zero == pytest.approx([12.0, -7.0, 30.0])
    noisy = [fit_matrix(*known_loads(0.5, seed)) for seed in range(60)]
    spread = np.std([fit.matrix for fit in noisy], axis=0)
    assert np.mean([fit.uncertainty for fit in noisy], axis=0) == pytest.approx(spread, rel=0.4)


def test_a_wrong_row_is_rejected():
    load, reading = known_loads(0.1)
    load[7] *= -1.0
    fit = fit_matrix(load, reading)
    assert np.flatnonzero(fit.rejected).tolist() == [7]
    assert fit.matrix == pytest.approx(MATRIX, abs=0.01)


def test_loads_that_do_not_determine_the_matrix():
    load, reading = known_loads(0.0)
    with pytest.raises(IsfError, match="do not determine"):
        fit_matrix(load[:4], reading[:4])
    with pytest.raises(IsfError, match="finite"):
        fit_matrix(load, np.full_like(reading, np.nan))
    with pytest.raises(IsfError, match="three different loads"):
        fit_channel(np.zeros(5), np.zeros(5))


def test_published_decomposition():
    # Eq. 3.7 with the signs of eq. 3.6; unit responses at H = 280 mm.
    assert readings_of(np.array([6500.0, 0.0, 13000.0]), 0.28)[:, 2] == pytest.approx(
        [15363.6, -1181.8, -1181.8], abs=0.1
    )
    assert readings_of(np.array([0.0, 1000.0, 0.0]), 0.28)[:, 2] == pytest.approx([0.0, 1469.6, -1469.6], abs=0.1)
    assert np.linalg.cond(decomposition(0.28)) == pytest.approx(3.60, abs=0.01)


@given(force=st.tuples(*[st.floats(-1e4, 1e4)] * 3), height=st.floats(0.2, 0.35), lost=st.sampled_from([None, 0, 1, 2]))
@settings(max_examples=40, deadline=None)
def test_any_one_cell_may_fail(force, height, lost):
    readings = readings_of(np.array(force), height)
    if lost is not None:
        readings[lost] = np.nan
    found = force_of(readings, height)
    assert found.force == pytest.approx(np.array(force), abs=0.1)  # Torrao 2013, 3.4.1, within 0.1 N
    assert found.missing == (0 if lost is None else lost + 1)


def test_disagreement_is_reported_and_two_lost_cells_are_refused():
    readings = readings_of(np.array([100.0, 50.0, 900.0]), 0.28)
    assert force_of(readings, 0.28).inconsistency == pytest.approx(0.0, abs=1e-9)
    readings[1, 0] += 40.0
    assert force_of(readings, 0.28).inconsistency == pytest.approx(40.0)
    readings[:2] = np.nan
    with pytest.raises(IsfError, match="1, 2") as caught:
        force_of(readings, 0.28)
    assert caught.value.code is ErrorCode.WRENCH_NOT_FINITE


def turn(angle):
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


def cell(**changes):
    values = {"rate": 500.0, "matrix": MATRIX, "rotation": np.eye(3), "range": np.full(3, 2048.0), "cutoff": 0.0}
    return CellReading(CellSettings(**{**values, **changes}))


def counts(force, zero):
    return np.linalg.inv(MATRIX) @ force + zero


def test_nothing_is_read_without_contact_at_any_tilt():
    # The weight turns with the cell; mass 2 kg.
    reading, zero = cell(mass=2.0), np.array([5.0, -3.0, 9.0])

    def free(angle):
        return counts(turn(angle).T @ [0.0, 0.0, -2.0 * 9.80665], zero)

    reading.tare([free(0.0)] * 10)
    for angle in np.linspace(-1.0, 1.0, 9):
        assert reading.force(free(angle), turn(angle)) == pytest.approx(0.0, abs=1e-9)
    load = np.array([30.0, -20.0, 200.0])
    loaded = counts(turn(0.4).T @ (load + [0.0, 0.0, -2.0 * 9.80665]), zero)
    assert reading.force(loaded, turn(0.4)) == pytest.approx(load)


def test_low_pass_keeps_the_mean():
    reading = cell(cutoff=40.0, taps=21)
    reading.tare(np.zeros((5, 3)))
    random = np.random.default_rng(0)
    forces = [reading.force(counts([0.0, 0.0, 100.0] + random.normal(0, 5, 3), 0.0)) for _ in range(400)]
    assert np.mean(forces[50:], axis=0) == pytest.approx([0.0, 0.0, 100.0], abs=1.0)
    assert np.std(forces[50:], axis=0).max() < 0.6 * 5.0


def test_faults_of_a_cell():
    reading = cell(frozen_after=5)
    with pytest.raises(IsfError, match="not tared"):
        reading.force(np.zeros(3))
    reading.tare(np.zeros((5, 3)))
    with pytest.raises(IsfError) as caught:
        reading.force(np.array([0.0, np.nan, 0.0]))
    assert caught.value.code is ErrorCode.WRENCH_NOT_FINITE
    with pytest.raises(IsfError, match="channel 2") as caught:
        reading.force(np.array([0.0, -2047.0, 0.0]))
    assert caught.value.code is ErrorCode.WRENCH_OUT_OF_RANGE
    for _ in range(5):
        reading.force(np.ones(3))
    with pytest.raises(IsfError, match="frozen") as caught:
        reading.force(np.ones(3))
    assert caught.value.code is ErrorCode.WRENCH_FROZEN


def test_drift_asks_for_a_tare_and_contact_refuses_one():
    reading = cell()
    reading.tare(np.zeros((5, 3)))
    assert reading.watch_drift(counts([0.0, 0.0, 4.0], 0.0)) == pytest.approx(4.0)
    with pytest.raises(IsfError, match="drifted"):
        reading.watch_drift(counts([0.0, 0.0, 25.0], 0.0))
    with pytest.raises(IsfError, match="while it is tared"):
        reading.tare([counts([0.0, 0.0, force], 0.0) for force in (0.0, 80.0, 0.0)])
