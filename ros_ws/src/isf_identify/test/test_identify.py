"""Identification on the simulated machine: what is found against what the plant is made of, and how it ends early."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import load_job
from isf_force_ctrl.control_state import Mode
from isf_force_ctrl.controller import ForceController
from isf_identify.fits import fit_compliance, fit_signs, fit_stiffness
from isf_identify.identification import finding, make_probe
from isf_identify.servo_probe import ServoProbe, chirp_way, fit_servo
from isf_identify.settings import IdentifySettings, Property, ToolGeometry
from isf_sim.machine.simulated_machine import SimulatedMachine
from isf_sim.variant import STANDARD_VARIANTS, make_variant
from plant_cell import EXAMPLES, PlantCell

Readings = Callable[[np.ndarray, np.ndarray], None]
"""Changes both wrenches (6,), as a fault does."""


def goal(kind: Property, *, tool: int = 1, places: Any = (), force: float = 600.0, repeats: int = 1) -> Any:
    return IdentifySettings.of(kind, tool, repeats, places, force)


class Bench:
    """The small cone on a machine of another variant, some contours formed; ``changes`` in the text of its job."""

    def __init__(self, contours: int, variant: int = 0, **changes: str) -> None:
        self.cell = PlantCell(ForceController, **changes)
        self.cell.machine = SimulatedMachine(self.cell.job_file, variant=variant)
        self.cell.machine.tare()
        self.cell.sample = self.cell.machine.sample()
        self.cell.form(contours)
        self.geometry = ToolGeometry.from_job(self.cell.job_file)
        squeeze = self.cell.machine._constants.squeeze
        gain = self.cell.machine.variant.load_cell_gain
        # forces are read too great by the gain, so compliances seem too small by it
        self.give = 1.0 / squeeze.stiffness / gain
        self.tool_1 = np.array(squeeze.forming_compliance) / gain
        self.tool_2 = np.array(squeeze.support_compliance) / gain

    def begin(self, settings: Any) -> Any:
        return self.cell.controller.measure(lambda rest: make_probe(rest, settings, self.geometry))

    def run(self, change: Readings | None = None, until: Callable[[], bool] | None = None) -> np.ndarray:
        """(T, 6) m targets until the controller rests; the true forces stay below what the cells may read."""
        cell, targets = self.cell, []
        while cell.controller.busy and not (until and until()):
            sample = cell.sample
            one, two = sample.wrench_1.copy(), sample.wrench_2.copy()
            if change:
                change(one, two)
            if sample.tick % 10 == 0:
                cell.controller.add_measured(1, sample.time, sample.tip_1)
                cell.controller.add_measured(2, sample.time, sample.tip_2)
            pair = cell.controller.tick(sample.tick, sample.time, one.tolist(), two.tolist())
            cell.sample = cell.machine.tick(pair.tip_1, pair.tip_2)
            targets.append([*pair.tip_1, *pair.tip_2])
            assert not cell.machine.faults
        return np.array(targets)

    def parked(self) -> bool:
        return np.allclose(self.cell.controller.targets[:2], [[0, 0, 0.1], [0, 0, -0.1]], atol=1e-6)


@pytest.fixture(scope="module")
def wall() -> Bench:
    """Seven contours in a variant with 20 % other compliance; each measurement leaves the part as it was."""
    variant = max(STANDARD_VARIANTS, key=lambda number: abs(make_variant(number).compliance - 1.0))
    return Bench(7, variant)


def test_compliance_of_an_off_nominal_machine(wall: Bench) -> None:
    probe = wall.begin(goal(Property.TOOL_COMPLIANCE))
    targets = wall.run()
    assert (probe.code, probe.message) == (ErrorCode.OK, "")
    assert wall.parked()
    assert wall.cell.controller.mode is Mode.ARMED
    config = wall.cell.config
    steps = np.abs(np.diff(targets, axis=0)) * config.rate
    assert steps.max() <= config.rapid_speed * 1.001
    # the compliance offset of the contour is taken back by its own limiter while the tools lift
    assert np.abs(np.diff(targets, n=2, axis=0)).max() * config.rate**2 <= config.acceleration
    assert probe.largest <= 600.0

    fit = fit_compliance(probe.readings, probe.places, wall.geometry)
    total = wall.tool_1 + wall.tool_2 + wall.give
    assert fit.total == pytest.approx(total, rel=0.01)
    assert fit.first[2] == pytest.approx(wall.tool_1[2], rel=0.12)
    assert np.isnan(fit.first[:2]).all()  # the sheet at rest does not load tool 1 in x and y
    for tool, true in ((1, wall.tool_1), (2, wall.tool_2)):
        value, deviation, how = fit.of_tool(tool, np.ones(3))
        assert value[:2] == pytest.approx(true[:2], rel=0.05)
        assert (np.abs(value - true)[:2] < 3.0 * deviation[:2]).all()
        assert "assumed" in how[0]
    assert np.isnan(fit.of_tool(2, np.ones(3))[0][2])


def test_contact_stiffness_of_an_off_nominal_machine(wall: Bench) -> None:
    probe = wall.begin(goal(Property.CONTACT_STIFFNESS))
    wall.run()
    assert probe.code is ErrorCode.OK
    fit = fit_stiffness(probe.readings, probe.places)
    normal = probe.places[0].normal
    slope = (normal[0] ** 2 + normal[1] ** 2) / (wall.give + normal**2 @ (wall.tool_1 + wall.tool_2))
    assert fit.value == pytest.approx(slope, rel=0.05)
    assert len(fit.slopes) == 4  # the flat place is left out


def test_signs_and_crosstalk_and_a_wrong_cell(wall: Bench) -> None:
    probe = wall.begin(goal(Property.LOAD_CELL_SIGNS))
    wall.run()
    fit = fit_signs(probe.readings, probe.places, wall.geometry)
    assert (fit.sign == 1.0).all()
    assert fit.faults() == []
    assert (fit.crosstalk < 0.02).all()  # the rig draws up to 0.01 for each share

    def turned(one: np.ndarray, two: np.ndarray) -> None:
        one[2] *= -1.0
        two[:2] = two[1::-1].copy()

    probe = wall.begin(goal(Property.LOAD_CELL_SIGNS))
    wall.run(turned)
    found = finding(probe, wall.cell.config, wall.cell.job_file.rig, "ren2018", "2026-01-01")
    assert found.code is ErrorCode.LOAD_CELL_SIGN
    assert found.value.tolist() == [1.0, 1.0, -1.0, 0.0, 0.0, 1.0]
    for text in ("Fz of tool_1 has the wrong sign", "Fx of tool_2 carries y", "Fy of tool_2 carries x"):
        assert text in found.message
    assert "based_on" not in found.piece


@pytest.mark.parametrize("phase", ["going there", "squeezing", "lifting"])
@pytest.mark.parametrize("how", ["cell", "cancel", "stop"])
def test_ended_early_from_any_phase(wall: Bench, how: str, phase: str) -> None:
    controller = wall.cell.controller
    probe = wall.begin(goal(Property.TOOL_COMPLIANCE))
    # the first lift is that of tools that stood on the sheet: none is left of it after the other measurements
    wall.run(
        until=lambda: phase in probe.phase and (phase != "lifting" or probe.progress > 0.0 or probe.readings != [])
    )
    wall.run(until=_countdown(40))
    sheet = wall.cell.sample.wrench_1.copy()

    def broken(one: np.ndarray, two: np.ndarray) -> None:
        one[1] = math.nan

    if how == "cancel":
        controller.cancel()
    elif how == "stop":
        controller.stop("tried")
    targets = wall.run(broken if how == "cell" else None)
    assert np.abs(np.diff(targets, n=2, axis=0)).max() * 500.0**2 <= wall.cell.config.acceleration
    assert probe.code is (ErrorCode.WRENCH_NOT_FINITE if how == "cell" else ErrorCode.STOPPED)
    assert controller.mode is (Mode.ARMED if how == "cancel" else Mode.HOLD)
    if how == "stop":
        assert not wall.parked()
        if phase == "squeezing":
            assert np.linalg.norm(wall.cell.sample.wrench_1[:3]) == pytest.approx(np.linalg.norm(sheet[:3]), rel=0.1)
        controller.disarm()
        wall.run()
        assert [tip[2] for tip in controller.targets[:2]] == pytest.approx([0.1, -0.1])
    assert wall.parked() or (how, phase) == ("stop", "going there")  # stopped at park height
    if controller.mode is not Mode.ARMED:
        arm_again(wall)


def test_forming_goes_on_after_it(wall: Bench) -> None:
    contour = wall.cell.plan.contours[7]
    wall.cell.controller.start(contour)
    with pytest.raises(IsfError, match="moving"):
        wall.begin(goal(Property.SERVO_RESPONSE))
    wall.run()
    assert wall.cell.controller.take_result().completed


def test_the_sheet_alone_may_be_too_much(wall: Bench) -> None:
    probe = wall.begin(goal(Property.TOOL_COMPLIANCE, force=60.0))
    wall.run()
    assert probe.code is ErrorCode.MEASUREMENT_FAILED
    assert wall.parked()


def test_a_flat_blank_shows_z_alone() -> None:
    bench = Bench(0)
    probe = bench.begin(goal(Property.TOOL_COMPLIANCE, force=200.0, places=(0.0, 0.0, 0.0, 0.02, 0.0, 0.0)))
    bench.run()
    fit = fit_compliance(probe.readings, probe.places, bench.geometry)
    assert fit.total[2] == pytest.approx(bench.tool_1[2] + bench.tool_2[2] + bench.give, rel=0.01)
    assert fit.first[2] == pytest.approx(bench.tool_1[2], rel=0.06)
    assert np.isnan([*fit.total[:2], *fit.first[:2]]).all()
    value, _, how = fit.of_tool(1, np.ones(3))
    assert np.isnan(value[:2]).all()
    assert "not observable" in how[0]
    with pytest.raises(IsfError, match="flat sheet") as caught:
        bench.begin(goal(Property.CONTACT_STIFFNESS))
    assert caught.value.code is ErrorCode.MEASUREMENT_REFUSED

    dead = bench.begin(goal(Property.LOAD_CELL_SIGNS, force=200.0, places=(0.0, 0.0, 0.0)))
    bench.run(lambda one, two: two.__setitem__(slice(None), 0.0))
    found = finding(dead, bench.cell.config, bench.cell.job_file.rig, "ren2018", "2026-01-01")
    assert found.code is ErrorCode.MEASUREMENT_FAILED
    assert "tool_2" in found.message


@pytest.mark.parametrize(
    "goal_fields",
    [
        {"force": 0.0},
        {"force": -5.0},
        {"force": math.nan},
        {"force": math.inf},
        {"force": 1501.0},
        {"places": (0.2, 0.0, 0.0)},
        {"places": (0.0, 0.0, -0.105)},
        {"places": (0.0, 0.0)},
        {"places": (0.0, math.nan, 0.0)},
        {"tool": 3},
        {"repeats": 0},
        {"kind": 9},
    ],
    ids=str,
)
def test_refused_goals(goal_fields: dict[str, Any], parked_cell: PlantCell) -> None:
    geometry = ToolGeometry.from_job(parked_cell.job_file)
    fields = {"kind": Property.TOOL_COMPLIANCE, **goal_fields}
    with pytest.raises(IsfError) as caught:
        parked_cell.controller.measure(lambda rest: make_probe(rest, goal(**fields), geometry))
    assert caught.value.code is ErrorCode.MEASUREMENT_REFUSED
    assert not parked_cell.controller.busy


@pytest.fixture(scope="module")
def parked_cell() -> PlantCell:
    return PlantCell(ForceController)


@pytest.mark.parametrize("guess", [20.0, 45.0])
def test_servo_is_found_from_a_wrong_guess(guess: float) -> None:
    bench = Bench(0)
    controller = bench.cell.controller
    controller.config = replace(bench.cell.config, servo_bandwidth=guess)
    probe = bench.begin(goal(Property.SERVO_RESPONSE, tool=2))
    targets = bench.run()
    assert np.abs(np.diff(targets, n=2, axis=0)).max() * 500.0**2 <= bench.cell.config.acceleration
    assert isinstance(probe, ServoProbe)
    fit = fit_servo(probe, 500.0, guess)
    # the plant is 30 Hz at -3 dB
    assert fit.bandwidth == pytest.approx(30.0, rel=0.02)
    assert abs(fit.delay) < 1e-3
    assert np.ptp(targets[:, :3], axis=0).max() < 1e-9  # the other tool stands still


def test_servo_with_a_delay_and_noise_and_too_few_reports() -> None:
    bench = Bench(0)
    probe = bench.begin(goal(Property.SERVO_RESPONSE))
    bench.run()
    noise = np.random.default_rng(0)
    late = [[(time + 6e-3, tip + noise.normal(0.0, 0.2e-6)) for time, tip in axis] for axis in probe.reports]
    probe.reports = late
    fit = fit_servo(probe, 500.0, 30.0)
    assert fit.delay == pytest.approx(6e-3, abs=0.4e-3)
    assert fit.bandwidth == pytest.approx(30.0, rel=0.03)
    probe.reports = [axis[:50] for axis in late]
    with pytest.raises(IsfError, match="50 poses"):
        fit_servo(probe, 500.0, 30.0)
    probe.reports = [[(time, tip + 1e-5 * math.sin(400.0 * time * time)) for time, tip in axis] for axis in late]
    with pytest.raises(IsfError, match="third-order"):
        fit_servo(probe, 500.0, 30.0)


@pytest.mark.parametrize("rate", [250.0, 500.0, 1000.0])
def test_the_chirp_stays_within_the_limits_of_a_move(rate: float, parked_cell: PlantCell) -> None:
    config = replace(parked_cell.config, rate=rate)
    way = np.array(chirp_way(config))
    assert way[0] == 0.0
    assert np.abs(way).max() <= 0.1e-3
    assert abs(way[-1]) < 1e-6
    speed, acceleration = np.diff(way) * rate, np.diff(way, n=2) * rate**2
    assert np.abs(speed).max() <= config.contact_speed
    assert np.abs(acceleration).max() <= config.acceleration


def arm_again(bench: Bench) -> None:
    controller = bench.cell.controller
    targets, formed = controller.targets, controller._formed
    controller.arm(bench.cell.plan.plan_id, 7, len(bench.cell.plan.contours), targets.tip_1, targets.tip_2)
    assert controller._formed is formed


def _countdown(ticks: int) -> Callable[[], bool]:
    left = iter(range(ticks))
    return lambda: next(left, None) is None


@pytest.mark.parametrize(
    ("kind", "tool", "text"),
    [(kind, 1, "both tools") for kind in Property if kind is not Property.SERVO_RESPONSE]
    + [(Property.SERVO_RESPONSE, 2, "has no tool_2")],
)
def test_one_tool_is_not_enough(parked_cell: PlantCell, kind: Property, tool: int, text: str) -> None:
    geometry = ToolGeometry.from_job(parked_cell.job_file)
    spif = replace(geometry, radii=(5e-3, 0.0))
    with pytest.raises(IsfError, match=text) as caught:
        parked_cell.controller.measure(lambda rest: make_probe(rest, goal(kind, tool=tool), spif))
    assert caught.value.code is ErrorCode.MEASUREMENT_REFUSED


@pytest.mark.parametrize("kind", [kind for kind in Property if kind is not Property.SERVO_RESPONSE])
def test_walls_of_accumulative_forming_are_no_places(parked_cell: PlantCell, kind: Property) -> None:
    geometry = ToolGeometry.from_job(load_job(EXAMPLES / "adsif_cone.yaml"))
    places = (0.0, 0.0, -1.6e-3)
    with pytest.raises(IsfError, match="in ADSIF both tools stay at one depth") as caught:
        parked_cell.controller.measure(lambda rest: make_probe(rest, goal(kind, places=places), geometry))
    assert caught.value.code is ErrorCode.MEASUREMENT_REFUSED
    assert "process DSIF" in caught.value.advice
    assert not parked_cell.controller.busy


def test_the_servo_of_a_job_with_one_tool() -> None:
    """After a contour, too: the tool is lifted first, and the one that the job does not have stays where it is."""
    bench = Bench(1, **{"DSIF\n": "SPIF\n", "tool_2:\n  radius: 5 mm\n": "", "support_force: 120 N": ""})
    assert bench.cell.job_file.job.tool_2 is None
    probe = bench.begin(goal(Property.SERVO_RESPONSE))
    targets = bench.run()
    assert (probe.code, probe.message) == (ErrorCode.OK, "")
    assert fit_servo(probe, 500.0, 30.0).bandwidth == pytest.approx(30.0, rel=0.02)
    assert np.ptp(targets[:, 3:], axis=0).max() == 0.0
    assert bench.parked()
