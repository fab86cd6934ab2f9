"""Load cells: calibration against published data, three-cell arrangement, readings and their faults."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from isf_core.errors import ErrorCode, IsfError
from isf_load_cell.calibration import fit_channel, fit_matrix
from isf_load_cell.cell_redundancy import CellRedundancy, decomposition
from isf_load_cell.reading import CellReading, CellSettings
from isf_load_cell.three_cells import readings_of

# Torrao 2013, appendix A: load in N; means of three repeats in V under loads of both signs, by cell and axis.
LOADS = np.array([0, 20, 50, 100, 200, 500, 1000, 2000, 5000, 10000, 15000, 20000], dtype=float)
APPENDIX = """
683 X  .0002 .0111 .0221 .0433 .0845 .2143 .4327 .8607 2.1333 4.2967 6.4167 8.0767
683 X- .0002 -.0112 -.0071 -.0427 -.0845 -.2150 -.4240 -.8600 -2.1433 -4.3133 -6.4533 -8.2300
683 Y  .0002 .0110 .0212 .0432 .0841 .2180 .4313 .8603 2.1367 4.2567 6.3867 8.0367
683 Y- .0002 -.0120 -.0231 -.0424 -.0862 -.2163 -.4250 -.8620 -2.1567 -4.3300 -6.4800 -8.4767
683 Z  .0002 .0221 .0323 .0661 .1221 .2523 .4867 1.0060 2.2400 4.4700 6.6867 8.9000
683 Z- .0003 -.0077 -.0174 -.0402 -.0802 .0737 -.4217 -.8420 -2.1000 -4.2200 -6.3333 -8.4500
605 X  .0002 .0189 .0279 .0472 .0888 .2140 .4160 .8283 2.0533 4.1067 6.1700 8.2200
605 X- .0001 -.0127 -.0258 -.1404 -.0839 -.1999 -.4037 -.7973 -2.0167 -3.9867 -6.0733 -8.0567
605 Z  .0001 .0113 .0230 .0550 .0968 .2211 .4477 .8947 2.2467 4.4767 6.7000 8.9300
605 Z- .0001 -.0090 -.0203 -.0434 -.0830 -.2120 -.4273 -.8457 -2.1100 -4.2267 -6.3400 -8.4633
711 X  .0002 .0163 .0244 .0463 .0846 .2033 .4060 .8043 2.0167 4.0167 6.0400 7.6533
711 X- .0001 -.1650 -.3203 -.6230 -.1075 -.2800 -.5423 -.8690 -2.0533 -4.0733 -6.1033 -8.1200
711 Y  .0002 .0203 .0382 .0618 .1101 .2403 .4757 .8790 2.1533 4.2900 6.3933 8.5033
711 Y- .0002 -.0190 -.0301 -.0515 -.0931 -.2217 -.4330 -.8520 -2.1167 -4.2267 -6.3467 -7.7867
711 Z  .0004 .0140 .0256 .0498 .0966 .2403 .4750 .9463 2.3567 4.6867 7.0033 9.2033
711 Z- .0002 -.0174 -.2016 -.3124 -.3514 -.2200 -.4480 -.8943 -2.1767 -4.3133 -6.5567 -8.7467
"""


def published(cell, axis):
    """Loads (24,) N and readings (24,) V of both signs."""
    rows = {tuple(line.split()[:2]): line.split()[2:] for line in APPENDIX.strip().splitlines()}
    volts = [float(value) for sign in ("", "-") for value in rows[cell, axis + sign]]
    return np.concatenate([LOADS, -LOADS]), np.array(volts)


@pytest.mark.parametrize(
    ("cell", "axis", "gain", "offset"),
    [
        ("683", "X", 2391.4, 19.135),
        ("683", "Y", 2376.6, 61.802),
        ("683", "Z", 2302.6, -177.11),
        ("605", "X", 2456.7, -40.383),
        ("605", "Z", 2298.4, -126.64),
        ("711", "X", 2497.9, 202.44),
        ("711", "Y", 2401.9, -98.962),
        ("711", "Z", 2218.2, -79.469),
    ],  # the printed fit of 605 Y is not that of the printed readings
)
def test_printed_fits(cell, axis, gain, offset):
    fit = fit_channel(*published(cell, axis), robust=False)
    assert fit.gain == pytest.approx(gain, abs=0.05)
    assert fit.offset == pytest.approx(offset, abs=0.1)


def test_slips_are_found_and_reported():
    load, volts = published("711", "Z")
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
    assert np.linalg.cond(decomposition(0.28, 0.11)) == pytest.approx(3.60, abs=0.01)


def balance(readings, height, radius):
    """N and N m left over of a spindle that hangs on three cells: force on the tip less what the cells carry, and the
    moments of both about the middle of the cells. Written from the forces, without the code's own matrices."""
    places = radius * np.array([[1.0, 0.0, 0.0], [-0.5, np.sqrt(0.75), 0.0], [-0.5, -np.sqrt(0.75), 0.0]])
    carried = -readings  # the cells push back
    return lambda force: (
        force + carried.sum(axis=0),
        np.cross([0.0, 0.0, -height], force) + np.cross(places, carried).sum(axis=0),
    )


@given(force=st.tuples(*[st.floats(-1e4, 1e4)] * 3), height=st.floats(0.2, 0.35))
@settings(max_examples=30, deadline=None)
def test_the_cells_are_in_equilibrium_with_the_force(force, height):
    readings = readings_of(np.array(force), height)
    forces, moments = balance(readings, height, 0.11)(np.array(force))
    assert np.abs(forces).max() < 1e-8 * 1e4
    assert np.abs(moments).max() < 1e-8 * 1e4  # about z too: the spindle turns freely


@given(
    force=st.tuples(*[st.floats(-1e4, 1e4)] * 3),
    height=st.floats(0.2, 0.35),
    lost=st.one_of(st.just(()), st.sampled_from([(k,) for k in range(9)] + [(0, 1, 2), (3, 4, 5), (6, 7, 8)])),
)
@settings(max_examples=60, deadline=None)
def test_any_channel_and_any_cell_may_be_lost(force, height, lost):
    live = tuple(k not in lost for k in range(9))
    readings = readings_of(np.array(force), height).ravel()
    readings[list(lost)] = 0.0
    found = CellRedundancy(height, 0.11).force_matrix(live) @ readings
    assert found == pytest.approx(np.array(force), abs=0.1)  # Torrao 2013, 3.4.2, within 0.1 N


@pytest.mark.parametrize("lost", [(2, 5), (5, 8), (2, 5, 8), (0, 1, 2, 3, 4, 5), (2, 0, 3, 6)])
def test_a_force_that_the_rest_does_not_tell_is_refused(lost):
    with pytest.raises(IsfError) as caught:
        CellRedundancy(0.28, 0.11).force_matrix(tuple(k not in lost for k in range(9)))
    assert caught.value.code is ErrorCode.WRENCH_INCONSISTENT


@given(force=st.tuples(*[st.floats(-5e3, 5e3)] * 3), channel=st.integers(0, 8), off=st.sampled_from([-90.0, 60.0]))
@settings(max_examples=60, deadline=None)
def test_a_channel_that_is_off_is_told_from_all_others(force, channel, off):
    readings = readings_of(np.array(force), 0.28).ravel()
    readings[channel] += off
    found, left = CellRedundancy(0.28, 0.11).suspects(readings, (True,) * 9)
    assert found == (channel,)
    assert left < 1e-3


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


def test_a_tare_takes_up_a_signal_that_was_frozen():
    """The last readings before the tare, and those after it, are of two counts."""
    reading = cell(frozen_after=5)
    reading.tare(np.zeros((5, 3)))
    ones = np.ones(3)
    for _ in range(5):
        reading.force(ones)
    with pytest.raises(IsfError, match="frozen"):
        reading.force(ones)
    reading.tare(np.zeros((5, 3)))
    for _ in range(5):
        reading.force(ones)
    assert ones.tolist() == [1.0, 1.0, 1.0]  # what the driver owns stays as it is
    with pytest.raises(IsfError, match="the same 5 times"):
        reading.force(ones)
