"""Vertical and tangential force of the support tool beside the normal one: geometry, limits, margins, the plant."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from contact_sandbox import make_config
from hypothesis import given, settings
from hypothesis import strategies as st
from isf_core.errors import IsfError
from isf_core.files.job import JobFile
from isf_force_ctrl.control_config import ControlConfig
from isf_force_ctrl.control_laws import ForceComponents
from isf_force_ctrl.control_state import Flag, Mode
from isf_force_ctrl.laws.stability import servo_response
from isf_force_ctrl.motion.segments import RESTING, Row
from plant_cell import EXAMPLES, PlantCell

REACH = 10e-3
"""m, sum of both radii."""


def config(**changes: object) -> ControlConfig:
    return make_config(vertical=True, tangential=True, ball_reach=REACH, **changes)


def row_of(angle: float, around: float, support: int, distance: float = 11e-3) -> Row:
    """Balls ``distance`` apart on a line ``angle`` from the vertical, the support tool outside at ``around``."""
    flat, height = distance * np.sin(angle), distance * np.cos(angle)
    outward = flat * np.array([np.cos(around), np.sin(around)])
    row = list(RESTING)
    place = outward if support == 2 else -outward
    row[0:3], row[3:6] = [0.0, 0.0, 0.0], [*place.tolist(), REACH - height]
    row[6], row[7] = (place / flat).tolist()
    row[8] = 120.0
    return row


def spring_force(row: Row, offset: tuple[float, float, float], support: int, normal: float) -> np.ndarray:
    """Force on the support tool along the line of the displaced centres, its horizontal part held at ``normal``."""
    line = np.array([row[3] - row[0], row[4] - row[1], row[5] - row[2] - REACH])
    line = (line if support == 2 else -line) + np.array(offset)
    return normal * line / np.hypot(line[0], line[1])


@settings(max_examples=15, deadline=None)
@given(
    angle=st.floats(0.5, 1.1),
    around=st.floats(-3.1, 3.1),
    support=st.sampled_from([1, 2]),
    vertical=st.floats(-8.0, 8.0),
    tangential=st.floats(-8.0, 8.0),
)
def test_both_set_points_are_reached_on_any_wall(angle, around, support, vertical, tangential):
    """Ideal contact: the normal loop holds 120 N; error at rest below the dead zone of 1 N."""
    row = row_of(angle, around, support)
    wanted = 120.0 / np.tan(angle) + vertical
    loops = ForceComponents(config(vertical_force=wanted, tangential_force=tangential), support)
    for _ in range(5000):
        force = spring_force(row, loops.offset, support, 120.0)
        loops.control(row, (force[0], force[1], force[2]), 120.0)
    force = spring_force(row, loops.offset, support, 120.0)
    d = np.array([row[6], row[7]])
    pressed = -force[2] if support == 2 else force[2]
    turned = (force[1] * d[0] - force[0] * d[1]) * (1.0 if support == 2 else -1.0)
    assert pressed == pytest.approx(wanted, abs=1.5)
    assert turned == pytest.approx(tangential, abs=1.5)


def test_offsets_stay_within_their_limit_and_go_back():
    loops = ForceComponents(config(vertical_force=1000.0, component_limit=0.4e-3), 2)
    row = row_of(0.8, 0.3, 2)
    before = np.zeros(3)
    for _ in range(3000):
        loops.control(row, (80.0, 20.0, -120.0), 120.0)
        now = np.array(loops.offset)
        assert np.linalg.norm(now) <= np.sqrt(2) * 0.4e-3 + 1e-12
        assert np.abs(now - before).max() < 50e-6
        before = now
    assert loops.flags & Flag.SATURATED_OFFSET
    for _ in range(3000):
        loops.ramp_back(row)
    assert np.linalg.norm(loops.offset) < 1e-6


def test_nothing_is_added_without_a_request():
    """The default leaves both components alone: no component loop exists."""
    default = make_config()
    assert not default.vertical
    assert not default.tangential


@dataclass(frozen=True)
class SupportLine:
    """Where the support tool stands when the vertical force is controlled as well.

    Attributes
    ----------
    stiffness : N/m, contact stiffness in the horizontal normal direction, K_c
    nominal_stiffness : N/m, value the gain of the normal loop was computed from
    normal_force : N, horizontal set-point ; distance : m between the ball centres
    angle : rad, of the wall: of the line of centres from the vertical
    misalignment : rad, by which the true line is turned against the commanded one
    """

    stiffness: float
    nominal_stiffness: float
    normal_force: float
    distance: float
    angle: float
    misalignment: float = 0.0


def component_margin(
    line: SupportLine, loop_gain: float, component_gain: float, bandwidth: float, delay: float
) -> float:
    """Factor by which both gains may grow before normal and vertical loop together oscillate; 0: unstable as they are.

    Force of the line of centres n with the normal force N at the distance l: dF = (K n n' - N/l t t') dp, t at right
    angles to n. Both loops have the same dynamics, integrator, servo (``bandwidth`` Hz) and ``delay`` s, so they are
    stable when that is so for each eigenvalue of the matrix of the gains.
    """
    true = line.angle + line.misalignment
    n, t = np.array([np.sin(true), np.cos(true)]), np.array([np.cos(true), -np.sin(true)])
    force = line.normal_force / np.sin(line.angle)
    contact = line.stiffness / np.sin(line.angle) ** 2 * np.outer(n, n) - force / line.distance * np.outer(t, t)
    commanded = np.array([np.cos(line.angle), -np.sin(line.angle)])
    normal = contact @ np.array([1.0, 0.0]) * loop_gain / line.nominal_stiffness
    turned = contact @ commanded * component_gain * line.distance * np.sin(line.angle) ** 2 / line.normal_force
    omega = np.linspace(0.05, 4 * np.pi * bandwidth, 40_000)
    plant = servo_response(bandwidth, omega) * np.exp(-1j * omega * delay) / (1j * omega)
    margins = []
    for value in np.linalg.eigvals(np.column_stack([normal, turned])):
        if value.real <= 0.0:
            return 0.0
        phase = np.unwrap(np.angle(plant)) - abs(np.angle(value))
        crossing = int(np.argmax(phase <= -np.pi))
        margins.append(1.0 / float(np.abs(plant[crossing] * value)))
    return min(margins)


@pytest.mark.parametrize("angle", [30, 45, 65])
@pytest.mark.parametrize("force", [60, 120, 300])
def test_margins(angle, force):
    """Gain margin at least 3 on the published rig; a line 5 deg (1 mm) off and twice the stiffness stay stable."""
    settings = make_config()
    nominal = SupportLine(0.45e6, 0.45e6, force, 11e-3, np.radians(angle))

    def margin(**changes: float) -> float:
        return component_margin(
            replace(nominal, **changes), settings.loop_gain, settings.component_gain, settings.servo_bandwidth, 7e-3
        )

    assert margin() > 3.0
    for turned in (-5, 5):
        assert margin(misalignment=np.radians(turned)) > 1.2
    assert margin(stiffness=0.9e6) > 1.5


def test_the_margin_alone_is_that_of_the_normal_loop():
    """With a vanishing gain of the vertical loop the known limit of 87 1/s comes back: 87 / 24 = 3.6."""
    line = SupportLine(0.45e6, 0.45e6, 120.0, 11e-3, np.radians(89.0))
    assert component_margin(line, 24.0, 1e-3, 30.0, 7e-3) == pytest.approx(87 / 24, rel=0.03)


def test_vertical_and_tangential_force_on_the_simulated_machine():
    """Set-points 10 N above and beside what the contact gives by itself are held; the normal force does not notice."""
    cell = PlantCell(
        **{
            "compliance_compensation: 1.0": "compliance_compensation: 1.0\n  components: [normal, vertical, tangential]"
            "\n  vertical_force: 138 N\n  tangential_force: 8 N"
        }
    )
    rows = []
    for contour in cell.plan.contours[:6]:
        cell.controller.start(contour)
        while cell.controller.busy:
            row, sample = cell.controller._playback.row, cell.sample
            pair = cell.controller.tick(sample.tick, sample.time, sample.wrench_1.tolist(), sample.wrench_2.tolist())
            if contour.index == 5 and cell.controller.mode is Mode.CONTROL:
                fx, fy, fz = sample.true_force_2
                state = cell.controller.state()
                rows.append(
                    [
                        state.normal_force - 120.0,
                        -fz,
                        row[6] * fy - row[7] * fx,
                        np.linalg.norm(state.support_offset[2]),
                    ]
                )
            cell.sample = cell.machine.tick(pair.tip_1, pair.tip_2, pair.holder_height)
        assert cell.controller.take_result().completed
    late = np.array(rows)[len(rows) // 2 :]
    assert late[:, 1].mean() == pytest.approx(138.0, abs=3.0)
    assert late[:, 2].mean() == pytest.approx(8.0, abs=2.0)
    assert np.mean(np.abs(np.array(rows)[:, 0]) <= 10.0) > 0.99
    assert late[:, 3].max() < 1.03e-3


@pytest.mark.parametrize(
    ("lines", "reported"),
    [
        ("components: [vertical]", "must hold normal"),
        ("vertical_force: 100 N", "vertical_force has no effect"),
        ("tangential_force: 5 N", "tangential_force has no effect"),
        ("components: [normal, sideways]", "components"),
    ],
)
def test_contradictory_jobs_are_refused(lines, reported):
    text = (EXAMPLES / "mini_cone.yaml").read_text()
    with pytest.raises(IsfError) as refused:
        JobFile(text.replace("engage_depth", f"{lines}\n  engage_depth"), EXAMPLES)
    assert reported in str(refused.value)
